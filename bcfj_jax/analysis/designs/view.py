"""What is worth showing of a design: a few lines and tables in Python (``io.show.View``), its report, its words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax.analysis.designs import result
from bcfj_jax.analysis.designs.result import FAILED, Design
from bcfj_jax.analysis.plausibility import Finding, judged
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Table, Verdict, brief
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import format_si

_DIGITS = 4


def told(found: Design) -> Told:
    """Its status, what it gained, and the free parameters before and after."""
    before, after = (format_si(x, found.unit, _DIGITS) for x in (found.before, found.after))
    lines = [] if found.status == FAILED else [f"{found.sense} {found.objective}: {before} to {after}{found.change}"]
    return Told(found.status, lines, value_rows(found), [found.reason])


def value_rows(found: Design) -> list[list[str]]:
    """Table of the free parameters: before, after, bounds."""
    rows = [["parameter", "before", "after", "lower", "upper", "remark"]]
    for axis, quantity in zip(found.space.axes, found.space.quantities, strict=True):
        side = found.at_bound.get(axis.name)
        numbers = (found.before_values[axis.name], found.values[axis.name], axis.lower, axis.upper)
        rows.append([axis.name, *(shown(x, quantity) for x in numbers), f"at its {side} bound" if side else ""])
    return rows


def shown(value: float, quantity: Quantity) -> str:
    """A parameter's value for people, angles in degrees."""
    if quantity.unit == "rad" and math.isfinite(value):
        return f"{math.degrees(value):.{_DIGITS}g} deg"
    return format_si(value, quantity.unit, _DIGITS)


def frame(found: Design) -> tuple[dict[str, Any], str]:
    """A free parameter a row, SI."""
    space = found.space
    return {
        "parameter": list(space.names),
        "before": [found.before_values[name] for name in space.names],
        "after": [found.values[name] for name in space.names],
        "unit": [quantity.unit for quantity in space.quantities],
        "lower": np.array([axis.lower for axis in space.axes]),
        "upper": np.array([axis.upper for axis in space.axes]),
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
    drawn: dict[str, Callable[[Any], Any]] = {"slices": partial(result.draw_slices, found)} if found.slices else {}
    return drawn | {"starts": partial(result.draw_starts, found)}


def verdict(found: Design) -> str:
    """The outcome in a sentence."""
    if found.status == FAILED:
        return "No design was found."
    before, after = (brief(x, found.unit) for x in (found.before, found.after))
    state = "" if found.status == "ok" else f" Status: {found.status}."
    return f"{found.objective}: {before} before, {after} after{found.change}.{state}"


def reason(found: Design) -> str:
    """All that is to be said of the outcome, as a sentence."""
    return f"{found.reason[:1].upper()}{found.reason[1:]}."


def page(title: str, found: Design, note: str, drawn: list[Picture], absurd: Sequence[Finding]) -> Page:
    """The report: what the objective became, by which values, and how far that is to be trusted."""
    kind = GOOD if found.status == "ok" else BAD if found.status == FAILED else FAIR
    word = "Improved" if found.status == "ok" else found.status[:1].upper() + found.status[1:]
    sentence = verdict(found)
    if found.status != FAILED:
        ends = f"{brief(found.before, found.unit)} to {brief(found.after, found.unit)}"
        quantities = dict(zip(found.space.names, found.space.quantities, strict=True))
        place = ", ".join(
            f"{name} {shown(x, quantities[name]).replace(' u', ' µ')}" for name, x in found.values.items()
        )
        sentence = f"{found.objective} goes from {ends}{found.change}, at {place}."
    answer = judged(absurd, Verdict(kind, word, sentence))
    tables = (Table("Design", value_rows(found), reason(found)), Table("Objective", fact_rows(found)))
    rows = [["search", "value"], *([name, f"{value:.4g}"] for name, value in found.stats.items())]
    folded = (Table("Search", rows),)
    return Page(title, answer, tuple(drawn), (note,) if note else (), tables, folded=folded)


def fact_rows(found: Design) -> list[list[str]]:
    """Table of the objective: before, after, the independent check, tolerances."""
    rows = [["objective", "before", "after"], [found.objective, *_pair(found.before, found.after, found.unit)]]
    if (check := found.confirmation) is not None:
        rows.append([f"checked by the {check.how}", *_pair(check.before, check.after, found.unit)])
    if (wide := found.robustness) is not None:
        first = found.robustness_before.sampled_worst if found.robustness_before else math.nan
        rows.append(["worst over the tolerances, by runs", *_pair(first, wide.sampled_worst, found.unit)])
    return rows


def _pair(first: float, second: float, unit: str) -> list[str]:
    return [brief(x, unit) if math.isfinite(x) else "-" for x in (first, second)]
