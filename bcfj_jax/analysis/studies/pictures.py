"""What people draw of a study: every feature against what was varied."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcfj_jax.analysis.derivatives.names import UNITS, feature_unit
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.io import plots
from bcfj_jax.io.outputs import atomic

if TYPE_CHECKING:
    from bcfj_jax.analysis.studies.api import Result

NAME = "study.png"
_MOST = 12  # panels
_FEWEST = 4  # values of either parameter on a map


def label(study: Study, name: str) -> str:
    """A varied parameter's name and unit."""
    unit = study.given.scene.quantities[name].unit
    return name if unit == "1" else f"{name} [{unit}]"


def overview(study: Study, result: Result, folder: Path) -> list[Path]:
    """``study.png``: one parameter: curves, a panel a kind of feature; a grid of two: maps; else clouds.

    Returns:
        The files drawn.
    """
    good = result.column("status") == "ok"
    if not good.any() or not study.features:
        return []
    if len(study.names) == 1:
        found = _curves(study, result)
    elif len(study.names) == 2 and study.kind == "grid" and min(axis.steps for axis in study.axes) >= _FEWEST:
        found = _maps(study, result)
    else:
        found = _clouds(study, result, good)
    with atomic(folder / NAME) as temporary:
        found.savefig(temporary, format="png", dpi=110)
    return [folder / NAME]


def _panels(count: int, across: int, title: str) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    rows = -(-count // across)
    figure = Figure(figsize=(5.2 * across, 3.6 * rows + 0.4), layout="constrained")
    figure.suptitle(title)
    axes = figure.subplots(rows, across, squeeze=False).ravel()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, list(axes[:count])


def _curves(study: Study, result: Result) -> Any:
    """Features against the one parameter, those of a kind together; failed points leave a gap."""
    name = study.names[0]
    x = result.column(name)
    order = np.argsort(x)
    kinds = list(dict.fromkeys(f.kind for f in study.features))
    with plots.style():
        figure, panels = _panels(len(kinds), min(2, len(kinds)), f"{study.given.scene.kind}: {study.count} points")
        for axes, kind in zip(panels, kinds, strict=True):
            for feature in (f for f in study.features if f.kind == kind):
                y = result.column(feature.name)
                mark = "." if study.count < 60 else ""
                axes.plot(x[order], y[order], marker=mark, lw=1.2, label=":".join(feature.contacts))
            unit = UNITS[kind]
            axes.set_ylabel(kind.replace("_", " ") + (f" [{unit}]" if unit != "1" else ""))
            axes.set_xlabel(label(study, name))
            if study.axes[0].scale == "log":
                axes.set_xscale("log")
            axes.legend(fontsize=8)
    return figure


def _maps(study: Study, result: Result) -> Any:
    """Features over the two parameters of a grid; failed points stay white."""
    shape = tuple(axis.steps for axis in study.axes)
    x, y = (result.column(name).reshape(shape) for name in study.names)
    shown = study.features[:_MOST]
    with plots.style():
        figure, panels = _panels(len(shown), min(3, len(shown)), f"{study.given.scene.kind}: {study.count} points")
        for axes, feature in zip(panels, shown, strict=True):
            axes.grid(False)
            drawn = axes.pcolormesh(x, y, result.column(feature.name).reshape(shape), shading="nearest")
            unit = feature_unit(feature.name)
            figure.colorbar(drawn, ax=axes, label=unit if unit != "1" else None)
            axes.set(xlabel=label(study, study.names[0]), ylabel=label(study, study.names[1]), title=feature.name)
            for axis, scale in zip(study.axes, (axes.set_xscale, axes.set_yscale), strict=True):
                scale(axis.scale)
    return figure


def _clouds(study: Study, result: Result, good: np.ndarray) -> Any:
    """Every feature against every parameter."""
    pairs = [(f, name) for f in study.features for name in study.names][:_MOST]
    with plots.style():
        figure, panels = _panels(len(pairs), min(3, len(pairs)), f"{study.given.scene.kind}: {study.count} points")
        for axes, (feature, name) in zip(panels, pairs, strict=True):
            axes.plot(result.column(name)[good], result.column(feature.name)[good], ".", ms=3)
            axes.set(xlabel=label(study, name), ylabel=feature.name)
            axes.set_xscale(next(axis.scale for axis in study.axes if axis.name == name))
    return figure
