"""What is worth showing of a study: a few lines and tables in Python (``io.show.View``), and every feature in a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.studies.api import Result
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.io import plots
from bcfj_jax.io.page import Picture, brief, span
from bcfj_jax.io.show import Dataset, Told

NAME = "study.png"
_MOST = 12  # panels
_FEWEST = 4  # values of either parameter on a map


def told(found: Result) -> Told:
    """Points that ran and that failed; the range of every varied parameter and feature."""
    study, state = found.study, found.state
    verdict = f"{state['status']}, {state['points']} points of scene '{study.given.scene.kind}', {found.failed} failed"
    lines = [f"{count} failed: {reason}" for reason, count in list(state["reasons"].items())[:2]]
    names = [*study.names, *(feature.name for feature in study.features)]
    return Told(verdict, lines, ranges(found, names), [f"in {found.folder}"])


def ranges(result: Result, names: Sequence[str], first: str = "") -> list[list[str]]:
    """A table of columns: least, median and largest value over the points that have one."""
    study, rows = result.study, [[first, "least", "median", "largest"]]
    units = {feature.name: feature_unit(feature.name) for feature in study.features}
    units |= {name: study.given.scene.quantities[name].unit for name in study.names}
    for name in names:
        values = result.column(name)
        values = values[np.isfinite(values)]
        ends = (np.min(values), np.median(values), np.max(values)) if values.size else [np.nan] * 3
        rows.append([name, *(brief(float(x), units.get(name, "1")) for x in ends)])
    return rows


def frame(found: Result) -> tuple[dict[str, Any], str]:
    """The table of ``results.parquet``: a point a row."""
    return {name: found.column(name) for name in found.table.column_names}, "point"


def dataset(found: Result) -> Dataset:
    """Of a grid a dimension a varied parameter; of any other design the points."""
    study = found.study
    scene = study.given.scene
    columns = {name: found.column(name) for name in study.columns}
    units = {feature.name: feature_unit(feature.name) for feature in study.features}
    about = {"design": study.design.kind, "scene": scene.kind, "failed": found.failed}
    grid = study.design.kind == "grid"
    dims, shape = (
        (study.names, tuple(axis.steps for axis in study.design.axes)) if grid else (("point",), (study.count,))
    )
    coordinates: dict[str, Any] = {} if grid else {"point": (dims, found.column("point"), "")}
    for k, name in enumerate(study.names):
        at = found.column(name)
        at = np.moveaxis(at.reshape(shape), k, 0).reshape(shape[k], -1)[:, 0] if grid else at
        coordinates[name] = ((name,) if grid else dims, at, scene.quantities[name].unit)
    variables: dict[str, Any] = {n: (dims, x.reshape(shape), units.get(n, "")) for n, x in columns.items()}
    status = found.column("status").astype(str).reshape(shape)
    return Dataset({**variables, "status": (dims, status, "")}, coordinates, about)


def figures(found: Result) -> dict[str, Callable[[Any], Any]]:
    """Every feature against what was varied."""
    study = found.study
    if found.failed == study.count or not study.features:
        return {}
    return {"overview": partial(overview, found)}


def label(study: Study, name: str) -> str:
    """A varied parameter's name and unit."""
    unit = study.given.scene.quantities[name].unit
    return name if unit == "1" else f"{name} [{unit}]"


def overview(result: Result, folder: Path) -> list[Picture]:
    """``study.png``, if there is anything to draw: of one parameter curves, of a grid of two maps, else clouds.

    Parameters that were varied together, each rising or falling with the first, are one parameter.
    """
    study, good = result.study, result.column("status") == "ok"
    if not good.any() or not study.features:
        return []
    path, first, steps = folder / NAME, study.names[0], [axis.steps for axis in study.design.axes]
    if together(result):
        left_out = _curves(result, path)
        beside = f" (with it {', '.join(study.names[1:])})" if study.names[1:] else ""
        shows = f"Each feature against {first}{beside}, in its own unit"
    elif len(steps) == 2 and study.design.kind == "grid" and min(steps) >= _FEWEST:
        left_out = _maps(result, path)
        shows = f"Each feature over {first} and {study.names[1]}"
    else:
        left_out = _clouds(result, good, path)
        shows = "Each feature against each parameter"
    names = [feature.name for feature in study.features[:6]]
    ranges = "; ".join(f"{name} {span(result.column(name)[good], feature_unit(name))}" for name in names)
    more = f" {left_out} more are in results.parquet." if left_out else ""
    return [Picture(NAME, "The study", f"{shows}, {study.count} points: {ranges}.{more}")]


def together(result: Result) -> bool:
    """Whether one parameter was varied, or several that rise or fall strictly with the first."""
    values = [result.column(name) for name in result.study.names]
    order = np.argsort(values[0], kind="stable")
    steps = [np.diff(x[order]) for x in values]
    return len(values) == 1 or all(bool(np.all(d > 0) or np.all(d < 0)) for d in steps)


def _curves(result: Result, path: Path) -> int:
    """Features against the one parameter, a panel each; failed points leave a gap. How many features are left out."""
    study, name = result.study, result.study.names[0]
    values, across_unit = result.column(name), study.given.scene.quantities[name].unit
    scale, prefix = plots.engineering(values, across_unit)
    x, text = values * scale, name if across_unit == "1" else plots.label(name, across_unit, prefix)
    order = np.argsort(x)
    shown = study.features[:_MOST]
    across = 2 if len(shown) < 5 else 3
    with plots.panels(len(shown), across, path, 4.4, 2.7, plots.Margins(0.85)) as panels:
        for number, (axes, feature) in enumerate(zip(panels, shown, strict=True)):
            unit = feature_unit(feature.name)
            y = result.column(feature.name)
            scale, prefix = plots.engineering(y[np.isfinite(y)], unit)
            mark = "o" if study.count < 60 else ""
            axes.plot(x[order], y[order] * scale, marker=mark, markersize=3, lw=1.3)
            axes.set_title(feature.name)
            if unit != "1":
                axes.set_ylabel(f"[{prefix}{unit}]".replace("u", "µ"))
            if number >= len(shown) - across:
                axes.set_xlabel(text)
            if study.design.axes[0].scale == "log":
                axes.set_xscale("log")
    return len(study.features) - len(shown)


def _maps(result: Result, path: Path) -> int:
    """Features over the two parameters of a grid; failed points stay white. How many features are left out."""
    study, shape = result.study, tuple(axis.steps for axis in result.study.design.axes)
    x, y = (result.column(name).reshape(shape) for name in study.names)
    shown = study.features[:_MOST]
    with plots.panels(len(shown), 3, path, 5.0, 3.6) as panels:
        for axes, feature in zip(panels, shown, strict=True):
            axes.grid(False)
            drawn = axes.pcolormesh(x, y, result.column(feature.name).reshape(shape), shading="nearest", cmap="cividis")
            unit = feature_unit(feature.name)
            axes.figure.colorbar(drawn, ax=axes, label=unit if unit != "1" else None)
            axes.set(xlabel=label(study, study.names[0]), ylabel=label(study, study.names[1]), title=feature.name)
            for axis, scale in zip(study.design.axes, (axes.set_xscale, axes.set_yscale), strict=True):
                scale("log" if axis.scale == "log" else "linear")
    return len(study.features) - len(shown)


def _clouds(result: Result, good: np.ndarray, path: Path) -> int:
    """Every feature against every parameter. How many pairs are left out."""
    study = result.study
    pairs = [(f, name) for f in study.features for name in study.names]
    with plots.panels(len(pairs[:_MOST]), 3, path, 4.6, 3.0) as panels:
        for axes, (feature, name) in zip(panels, pairs[:_MOST], strict=True):
            axes.plot(result.column(name)[good], result.column(feature.name)[good], ".", ms=3)
            axes.set(xlabel=label(study, name), ylabel=feature.name)
            if any(axis.name == name and axis.scale == "log" for axis in study.design.axes):
                axes.set_xscale("log")
    return max(0, len(pairs) - _MOST)
