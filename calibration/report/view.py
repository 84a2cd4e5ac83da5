"""What is worth showing of a fit in Python: a few lines, tables, its pictures (``bcfj_jax.io.show.View``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax.core.errors import clip
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import unit_of
from calibration.fit import Fit
from calibration.report import plots

_DIGITS = 4


def told(found: Fit) -> Told:
    """Verdict and reasons; per parameter its value, its 95 % interval and what that allows for."""
    residual = found.residual
    size = f"{residual['samples']} samples, reduced chi2 {residual['reduced_chi2']:.3g}"
    rows = [["parameter", "value", "95 % interval", "allows for", "at bound"]]
    given = found.conditional
    if given:
        rows[0][2] = "95 % interval, if so"
    for name, one in {**found.parameters, **(given.parameters if given else {})}.items():
        ends = "not determined"
        if one.ci95 is not None:
            ends = " to ".join(format_si(float(x), one.unit, _DIGITS) for x in one.ci95)
        rows.append([name, format_si(one.value, one.unit, _DIGITS), ends, one.headline, one.at_bound])
    answers = f"search {found.search.answer}, data {found.data.answer}, law {found.law.answer}"
    reasons = [*found.reasons[:2], *([f"if {given.condition}"] if given else [])]
    return Told(found.verdict, [clip(reason) for reason in reasons], rows, [answers, size])


def frame(found: Fit) -> tuple[dict[str, Any], str]:
    """A parameter a row: value and 95 % interval in SI, its unit, whether the data determine it."""
    values = found.parameters.values()
    nothing = (np.nan, np.nan)
    return {
        "parameter": list(found.parameters),
        "value": [one.value for one in values],
        "unit": [one.unit for one in values],
        "lower": [(one.ci95 or nothing)[0] for one in values],
        "upper": [(one.ci95 or nothing)[1] for one in values],
        "allows_for": [one.headline for one in values],
        "identifiable": [one.identifiable for one in values],
        "at_bound": [one.at_bound for one in values],
    }, "parameter"


def dataset(found: Fit) -> Dataset:
    """Values, intervals and correlation of the parameters; of every record its data, prediction and noise."""
    names = list(found.parameters)
    values = found.parameters.values()
    ends = [one.ci95 or (np.nan, np.nan) for one in values]
    variables: dict[str, Any] = {
        "value": (("parameter",), [one.value for one in values], ""),
        "ci95": (("parameter", "end"), np.reshape(ends, (len(names), 2)), ""),
    }
    coordinates: dict[str, Any] = {
        "parameter": (("parameter",), names, ""),
        "end": (("end",), ["lower", "upper"], ""),
        "unit": (("parameter",), [one.unit for one in values], ""),
    }
    if found.correlation is not None:
        coordinates["other"] = (("other",), names, "")
        variables["correlation"] = (("parameter", "other"), found.correlation, "")
    for record in found.records:
        time = f"{record.name} time"
        coordinates[time] = ((time,), record.times, "s")
        for channel in record.data:
            for what in ("data", "prediction", "sigma"):
                values = np.broadcast_to(getattr(record, what)[channel], record.times.shape)
                variables[f"{record.name} {channel} {what}"] = ((time,), values, unit_of(channel))
    return Dataset(variables, coordinates, {"verdict": found.verdict, "seed": found.seed})


def figures(found: Fit) -> dict[str, Callable[[Any], Any]]:
    """Data over prediction with residuals; the loop of the first record; where every start ended."""
    drawn: dict[str, Callable[[Any], Any]] = {"starts": partial(plots.starts, found)}
    if any(record.data for record in found.records):
        drawn = {"records": partial(plots.records, found, None), **drawn}
        if found.optimum.model.scene.members and found.records[0].data:
            drawn["loops"] = partial(plots.force_penetration, found, None)
    return drawn
