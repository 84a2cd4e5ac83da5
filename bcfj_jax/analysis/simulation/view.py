"""What is worth showing of a run in Python: a few lines, tables, its pictures (``io.show.View``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.analysis.simulation import pictures
from bcfj_jax.core.quantities import percent
from bcfj_jax.io.outputs import COMPONENTS, channels, force_columns
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import unit_of
from bcfj_jax.solve.simulation import Run

_si = partial(format_si, digits=3)


def told(found: Run) -> Told:
    """How it ended; per contact peak, penetration, share of the time in contact and measured error."""
    if found.status == "ok":
        verdict = f"ok, reached {_si(float(found.times[-1]), 's')}"
    else:
        verdict = f"failed at {_si(found.failure_time, 's')}: {found.reason}"
    lines = [f"fidelity {found.choice.fidelity}: {found.choice.reason}"] if found.choice else []
    span = f"{_si(float(found.times[0]), 's')} to {_si(float(found.times[-1]), 's')}"
    steps = f"{found.stats['accepted']} steps, {found.stats['rejected']} rejected"
    seconds = f"{_si(found.stats['wall_s'], 's')}, compiled in {_si(found.stats['compile_s'], 's')}"
    return Told(verdict, lines, _rows(found), [f"{len(found.times)} samples from {span}; {steps}; {seconds}"])


def _rows(found: Run) -> list[list[str]]:
    """A contact a row, its members together; of a run without contacts its readings."""
    if not found.force:
        rows = [["reading", "least", "largest"]]
        for name, values in found.readings.items():
            ends = (_known(np.nanmin, values), _known(np.nanmax, values))
            rows.append([name, *(_si(x, unit_of(name)) for x in ends)])
        return rows if len(rows) > 1 else []
    measured = found.accuracy
    rows = [["contact", "peak force", "penetration", "in contact", *(["measured error"] if measured else [])]]
    for name, force in found.force.items():
        # Of the solver's steps where they were looked at.
        steps = found.extremes.get(name) if found.status != "failed" else None
        top, deep = (steps.peak, steps.deepest) if steps else (np.abs(force[..., 0]), found.penetration[name])
        row = [name, _si(_known(np.nanmax, top), "N"), _si(_known(np.nanmax, deep), "m")]
        whole = float(found.times[-1])
        row.append(percent(float(np.mean(steps.touching)) / whole if steps and whole > 0.0 else _share(found, name)))
        if measured:
            row.append(percent(max(part[name] for part in (measured.rms, measured.peak, measured.impulse))))
        rows.append(row)
    return rows


def _known(what: Callable[[Any], Any], values: np.ndarray) -> float:
    return float(what(values)) if np.isfinite(values).any() else math.nan


def _share(found: Run, name: str) -> float:
    depth = found.penetration[name].reshape(len(found.times), -1)
    if len(found.times) < 2:
        return math.nan
    return float(np.mean([features.contact_fraction(found.times, one) for one in depth.T]))


def frame(found: Run) -> tuple[dict[str, Any], str]:
    """Time [s] as the index; forces as in forces.csv, penetrations, rates, sliding speeds and readings."""
    columns: dict[str, Any] = {"time [s]": found.times, **force_columns(found)}
    for what, unit, history in _scalars(found):
        columns |= {f"{name}.{what} [{unit}]": values for name, values in channels(history).items()}
    for name, values in found.readings.items():
        columns |= {f"{one} [{unit_of(name)}]": column for one, column in channels({name: values}).items()}
    return columns, "time [s]"


def _scalars(found: Run) -> list[tuple[str, str, Mapping[str, np.ndarray]]]:
    return [
        ("penetration", "m", found.penetration), ("rate", "m/s", found.rate), ("sliding_speed", "m/s", found.slip),
    ]  # fmt: skip


def dataset(found: Run) -> Dataset:
    """Dimensions time, component (normal, axial, tangential) and, of a contact with members, ``<contact>_member``."""
    coordinates: dict[str, Any] = {"time": (("time",), found.times, "s")}
    if found.force:
        coordinates["component"] = (("component",), list(COMPONENTS), "")
    variables: dict[str, Any] = {}

    def along(name: str, values: np.ndarray, last: tuple[str, ...] = ()) -> tuple[str, ...]:
        if values.ndim == 1 + len(last):
            return "time", *last
        member = f"{name}_member"
        coordinates[member] = ((member,), np.arange(1, values.shape[1] + 1), "")
        return "time", member, *last

    for name, force in found.force.items():
        variables[f"{name}.force"] = (along(name, force, ("component",)), force, "N")
    for what, unit, history in _scalars(found):
        variables |= {f"{name}.{what}": (along(name, values), values, unit) for name, values in history.items()}
    for name, values in found.readings.items():
        variables[name] = (along(name, values), values, unit_of(name))
    # Text and numbers alone, so that it can be written to NetCDF.
    about = {"status": found.status, "reason": found.reason, "failure_time": found.failure_time, **found.stats}
    return Dataset(variables, coordinates, about)


def figures(found: Run) -> dict[str, Callable[[Any], Any]]:
    """Forces against time, and against penetration."""
    if not found.force:
        return {}
    return {"forces": partial(pictures.forces, found), "loops": partial(pictures.loops, found)}
