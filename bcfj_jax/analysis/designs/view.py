"""What is worth showing of a design in Python: a few lines, tables, its pictures (``io.show.View``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax.analysis.designs import pictures
from bcfj_jax.analysis.designs.result import FAILED, Design
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import format_si

_DIGITS = 4


def told(found: Design) -> Told:
    """Its status, what it gained, and the free parameters before and after."""
    unit = found.unit or "1"
    change = f"{format_si(found.before, unit, _DIGITS)} to {format_si(found.after, unit, _DIGITS)}"
    share = f" ({100.0 * (found.after - found.before) / abs(found.before):+.3g} %)" if found.before else ""
    lines = [] if found.status == FAILED else [f"{found.sense} {found.objective}: {change}{share}"]
    rows = [["parameter", "before", "after", "lower", "upper", "at bound"]]
    for k, name in enumerate(found.space.names):
        numbers = (found.before_values[name], found.values[name], found.space.lower[k], found.space.upper[k])
        unit = found.space.quantities[k].unit
        rows.append([name, *(format_si(float(x), unit, _DIGITS) for x in numbers), found.at_bound.get(name, "")])
    return Told(found.status, lines, rows, [found.reason])


def frame(found: Design) -> tuple[dict[str, Any], str]:
    """A free parameter a row, SI."""
    space = found.space
    return {
        "parameter": list(space.names),
        "before": [found.before_values[name] for name in space.names],
        "after": [found.values[name] for name in space.names],
        "unit": [quantity.unit for quantity in space.quantities],
        "lower": space.lower,
        "upper": space.upper,
        "at_bound": [found.at_bound.get(name, "") for name in space.names],
        "gradient": [found.gradient[name] for name in space.names],
        "tolerance": space.tolerance,
    }, "parameter"


def dataset(found: Design) -> Dataset:
    """The objective along each parameter through the optimum: a dimension a parameter."""
    units = {name: quantity.unit for name, quantity in zip(found.space.names, found.space.quantities, strict=True)}
    coordinates = {name: ((name,), cut.values, units[name]) for name, cut in found.slices.items()}
    variables = {f"objective along {name}": ((name,), cut.objective, found.unit) for name, cut in found.slices.items()}
    about = {"status": found.status, "objective": found.objective, "before": found.before, "after": found.after}
    return Dataset(variables, coordinates, about)


def figures(found: Design) -> dict[str, Callable[[Any], Any]]:
    """The objective along each parameter, and what every start did."""
    if found.status == FAILED or not any(np.isfinite(way.value) for way in found.starts):
        return {}
    drawn: dict[str, Callable[[Any], Any]] = {"slices": partial(pictures.slices, found)} if found.slices else {}
    return drawn | {"starts": partial(pictures.starts, found)}
