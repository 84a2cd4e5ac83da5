"""What is worth showing of a study in Python: a few lines, tables, its picture (``io.show.View``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.studies import pictures, specification
from bcfj_jax.analysis.studies.api import Result
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import format_si

_DIGITS = 4


def _study(found: Result) -> Study:
    return specification.load(found.folder / "run.toml")


def told(found: Result) -> Told:
    """Points that ran and that failed; of every varied parameter and feature the least and the largest value."""
    study, state = _study(found), found.state
    verdict = f"{state['status']}, {state['points']} points of scene '{study.given.scene.kind}', {found.failed} failed"
    lines = [f"{count} failed: {reason}" for reason, count in list(state["reasons"].items())[:2]]
    rows = [["", "least", "largest"]]
    units = {name: study.given.scene.quantities[name].unit for name in study.names}
    units |= {feature.name: feature_unit(feature.name) for feature in study.features}
    for name, unit in units.items():
        values = found.column(name)
        known = values[np.isfinite(values)]
        ends = (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)
        rows.append([name, *(format_si(x, unit, _DIGITS) for x in ends)])
    return Told(verdict, lines, rows, [f"in {found.folder}"])


def frame(found: Result) -> tuple[dict[str, Any], str]:
    """The table of ``results.parquet``: a point a row."""
    return {name: found.column(name) for name in found.table.column_names}, "point"


def dataset(found: Result) -> Dataset:
    """Of a grid a dimension a varied parameter; of any other design the points."""
    study = _study(found)
    scene = study.given.scene
    columns = {name: found.column(name) for name in study.columns}
    units = {feature.name: feature_unit(feature.name) for feature in study.features}
    about = {"design": study.design.kind, "scene": scene.kind, "failed": found.failed}
    dims, shape = ("point",), (study.count,)
    coordinates: dict[str, Any] = {"point": (dims, found.column("point"), "")}
    if study.design.kind == "grid":
        dims, shape = study.names, tuple(axis.steps for axis in study.design.axes)
        at = {name: found.column(name).reshape(shape) for name in study.names}
        coordinates = {
            name: ((name,), np.moveaxis(at[name], k, 0).reshape(shape[k], -1)[:, 0], scene.quantities[name].unit)
            for k, name in enumerate(study.names)
        }
    else:
        coordinates |= {name: (dims, found.column(name), scene.quantities[name].unit) for name in study.names}
    variables: dict[str, Any] = {n: (dims, x.reshape(shape), units.get(n, "")) for n, x in columns.items()}
    status = found.column("status").astype(str).reshape(shape)
    return Dataset({**variables, "status": (dims, status, "")}, coordinates, about)


def figures(found: Result) -> dict[str, Callable[[Any], Any]]:
    """Every feature against what was varied."""
    study = _study(found)
    if found.failed == study.count or not study.features:
        return {}
    return {"overview": partial(pictures.overview, study, found)}
