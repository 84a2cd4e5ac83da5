"""``bcfj study surface``: response surfaces of a finished study as a table of errors, ``surface.json`` and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.axes import Axis
from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.studies import surface, view
from bcfj_jax.analysis.studies.command import DONE, INTERRUPTED, finished
from bcfj_jax.analysis.studies.finished import Finished
from bcfj_jax.analysis.studies.surface import Surface
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.page import brief

JSON = "surface.json"
_CURVE, _MAP = 241, 81  # points
# What the columns mean, for the screen.
_MEANING = (
    "Errors at each point of a surface through all other points; spread: standard deviation of the feature itself."
)


def run(what: str, out: Path | None, features: Sequence[str], derivatives: bool) -> tuple[str, int]:
    """Surfaces of some features, or of all; in words, and the exit code: 5 while the study is not finished."""
    found, folder, first = finished(what, out)
    if found is None:
        return first, INTERRUPTED
    good, errors = found.each(lambda name: surface.fit(found, name, derivatives), features)
    outputs.write_json(folder / JSON, {one.feature: content(one) for one in good})
    for one in good:
        name = f"surface-{one.feature.replace(':', '-')}.png"
        draw(one, found, outputs.inside(folder, name, f"feature {one.feature}"))
    refused = [f"{name}: no surface: {why}" for name, why in errors.items()]
    return "\n".join([table(good), *refused, f"results in {folder}"]), DONE


def content(one: Surface) -> dict[str, Any]:
    """What ``surface.json`` says of a feature."""
    hyper, names = one.fitted.hyper, [axis.name for axis in one.axes]
    return {
        "derivatives": [names[k] for k in one.directions],
        "correlation_length": dict(zip(names, hyper.length.tolist(), strict=True)),
        "noise": float(one.scale * np.sqrt(one.fitted.variance * hyper.nugget)),
        "leave_one_out": one.error._asdict(),
    }


def table(good: Sequence[Surface]) -> str:
    """Leave-one-out errors, a row a feature."""
    rows = [["", "points", "left out", "rms error", "largest", "spread", "within 1, 2 deviations"]]
    for one in good:
        e = one.error
        numbers = (brief(x, feature_unit(one.feature)) for x in (e.rms, e.largest, e.spread))
        within = f"{100 * e.within_1:.0f} %, {100 * e.within_2:.0f} %"
        called = f"{one.feature}{' (with derivatives)' if one.directions else ''}"
        rows.append([called, str(e.points), str(e.dropped), *numbers, within])
    return f"{report.text(rows)}\n\n{_MEANING}"


def draw(one: Surface, found: Finished, path: Path) -> None:
    """One parameter: a curve with its band; two: maps of the feature and of its deviation; more: curves through the middle."""
    if len(one.axes) == 2:
        _maps(one, found, path)
    else:
        _curves(one, found, path)


def _unit(one: Surface) -> tuple[str, str]:
    kind = one.feature.rpartition(".")[2]
    return kind.replace("_", " "), feature_unit(one.feature)


def _scale(panel: Any, which: str, axis: Axis) -> None:
    """A parameter's scale, with few ticks of plain numbers on a log one, where ranges are often short of a decade."""
    if axis.scale != "log":
        return
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    panel.set(**{f"{which}scale": "log"})
    line = panel.xaxis if which == "x" else panel.yaxis
    line.set_major_locator(MaxNLocator(5) if axis.upper < 5 * axis.lower else LogLocator(subs=(1.0, 2.0, 5.0)))
    line.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    line.set_minor_locator(NullLocator())


def _curves(one: Surface, found: Finished, path: Path) -> None:
    middle = np.array([float(axis.at(np.array(0.5))) for axis in one.axes])
    kind, unit = _unit(one)
    y = found.feature(one.feature)
    lines = []
    for k, axis in enumerate(one.axes):
        values = np.tile(middle, (_CURVE, 1))
        values[:, k] = axis.at(np.linspace(0.0, 1.0, _CURVE))
        lines.append((values[:, k], *surface.predicted(one, values)))
    scale, prefix = plots.engineering(np.concatenate([mean for _, mean, _ in lines]))
    with plots.panels(len(lines), 2 if len(lines) == 4 else 3, path, 4.6 if len(lines) > 1 else 6.5, 3.6) as axes:
        ends = [(mean + side * deviation) * scale for _, mean, deviation in lines for side in (-2, 2)]
        margin = 0.05 * np.ptp(ends)
        for k, (panel, (x, mean, deviation)) in enumerate(zip(axes, lines, strict=True)):
            low, high = (mean - 2 * deviation) * scale, (mean + 2 * deviation) * scale
            panel.fill_between(x, low, high, alpha=0.25, lw=0, label="± 2 deviations")
            panel.plot(x, mean * scale, label="surface")
            if len(lines) == 1:
                panel.plot(found.values[:, 0], y * scale, "o", ms=4, color="#333333", label="study")
            _scale(panel, "x", one.axes[k])
            # One scale for all, so that what matters shows.
            if len(lines) > 1:
                panel.set_ylim(np.min(ends) - margin, np.max(ends) + margin)
            panel.set(xlabel=view.label(found.study, one.axes[k].name), ylabel=plots.label(kind, unit, prefix))
            rest = "" if len(lines) == 1 else ", the others in the middle"
            panel.set_title(f"{one.feature}{rest if k == 0 else ''}")
            if k == 0:
                panel.legend(fontsize=8)


def _maps(one: Surface, found: Finished, path: Path) -> None:
    ends = [axis.at(np.linspace(0.0, 1.0, _MAP)) for axis in one.axes]
    mesh = np.meshgrid(*ends, indexing="ij")
    mean, deviation = (x.reshape(_MAP, _MAP) for x in surface.predicted(one, np.stack([m.ravel() for m in mesh], 1)))
    good = np.isfinite(found.feature(one.feature))
    kind, unit = _unit(one)
    with plots.panels(2, 2, path, 5.2, 4.2) as axes:
        for panel, field, called in ((axes[0], mean, kind), (axes[1], deviation, "deviation")):
            scale, prefix = plots.engineering(field.ravel())
            panel.grid(False)
            drawn = panel.contourf(*mesh, field * scale, levels=24)
            panel.figure.colorbar(drawn, ax=panel, label=plots.label(called, unit, prefix))
            panel.plot(*found.values[good].T, "o", ms=3.5, mfc="none", mec="white", mew=0.9)
            _scale(panel, "x", one.axes[0])
            _scale(panel, "y", one.axes[1])
            panel.set(xlabel=view.label(found.study, one.axes[0].name))
            panel.set(ylabel=view.label(found.study, one.axes[1].name))
        axes[0].contour(*mesh, mean, levels=8, colors="white", linewidths=0.6)
        axes[0].set_title(f"{one.feature}; circles: the study's points")
        axes[1].set_title(f"{one.feature}: predicted deviation")
