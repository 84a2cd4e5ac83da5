"""``tradeoff.png``: error against wall time of every setting that ran, values and derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcfj_jax.analysis.tradeoff.advice import shared
from bcfj_jax.analysis.tradeoff.measures import worst
from bcfj_jax.analysis.tradeoff.study import OK, Study
from bcfj_jax.io import plots
from bcfj_jax.io.page import Picture, span

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
# Errors above have lost the motion; they are drawn at the edge.
_TOP, _LEAST = 10.0, 1e-12


def tradeoff(study: Study, advice: Mapping[str, Mapping[str, Any]], path: Path, title: str) -> Picture:
    """Work-precision: one panel of values, one of derivatives where there are any."""
    slopes = any(np.isfinite(row["derivative_error"]) for row in study.rows)
    with plots.sheet(path, 1, 2 if slopes else 1, width=12.5 if slopes else 8.0, height=5.4) as axes:
        errors = {row["setting"]: worst(row) for row in study.rows if row["status"] == OK}
        walls = {row["setting"]: row["wall_s"] for row in study.rows if row["status"] == OK}
        least_error = study.reference.least_error if study.reference else float("nan")
        _panel(axes[0], study, walls, errors, least_error)
        _front(axes[0], study, errors, least_error)
        _chosen(axes[0], advice, walls, errors)
        axes[0].set_title(f"{plots.plain(title)}: worst of force rms, peak and impulse")
        axes[0].set_ylabel("error [-]")
        axes[0].legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.13), ncols=4)
        if slopes:
            errors = {r["setting"]: r["derivative_error"] for r in study.rows if np.isfinite(r["derivative_error"])}
            walls = {row["setting"]: row["derivative_wall_s"] for row in study.rows}
            _panel(
                axes[1], study, walls, errors, study.reference.least_slope_error if study.reference else float("nan")
            )
            axes[1].set_title("derivatives of the forces, rms")
            axes[1].set_ylabel("error of derivatives [-]")
    known = {row["setting"]: worst(row) for row in study.rows if row["status"] == OK}
    rings = [
        f"{name} ({span([known[name]])}) for {budgets}" for name, budgets in shared(advice).items() if name in known
    ]
    shows = f"Worst error against wall time of {len(known)} settings"
    shows += f"; recommended, with their error as a share: {'; '.join(rings)}." if rings else "; none is recommended."
    return Picture(path.name, "Error against time", shows)


def _panel(
    axis: Axes, study: Study, walls: Mapping[str, float], errors: Mapping[str, float], least_error: float
) -> None:
    """Ladders of solvers as lines, other settings by what they set."""
    kinds: dict[str, list[str]] = {}
    for setting in study.settings:
        if np.isfinite(errors.get(setting.name, np.nan)):
            kind = setting.ladder if setting.group == "tolerance" else setting.group
            kinds.setdefault(kind, []).append(setting.name)
    solvers = {setting.ladder for setting in study.settings if setting.group == "tolerance"}
    for number, (kind, names) in enumerate(sorted(kinds.items(), key=lambda item: item[0] not in solvers)):
        x, y = np.array([walls[n] for n in names]), np.clip([errors[n] for n in names], _LEAST, _TOP)
        colour, mark = plots.COLOURS[number % len(plots.COLOURS)], _MARKS[number % len(_MARKS)]
        line = "-" if kind in solvers else "none"
        axis.plot(
            x, y, linestyle=line, markersize=4.5, linewidth=0.7, alpha=0.85, label=kind, color=colour, marker=mark
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("wall time of a run, compiled [s]")
    low, high = axis.get_ylim()
    if least_error > 0:
        low = min(low, least_error / 3.0)
        axis.axhspan(low, least_error, color="#9a9a9a", alpha=0.18, linewidth=0)
        inside = {"transform": axis.get_yaxis_transform(), "fontsize": 7.5, "color": "#555555"}
        axis.text(0.99, least_error, "below: not distinguished by the reference", ha="right", va="top", **inside)
    axis.set_ylim(low, high)


def _front(axis: Axes, study: Study, errors: Mapping[str, float], least_error: float) -> None:
    best = sorted((row["wall_s"], errors[row["setting"]]) for row in study.rows if row["pareto"])
    if best:
        x, y = np.array(best).T
        y = np.minimum(np.maximum(y, least_error if least_error > 0 else 0.0), _TOP)
        axis.step(x, y, where="post", color="#222222", linewidth=2.2, alpha=0.35, label="Pareto front", zorder=0)


def _chosen(axis: Axes, advice: Mapping[str, Mapping[str, Any]], walls: Mapping, errors: Mapping) -> None:
    """Rings round recommended settings, with the budgets they are for."""
    for number, (name, budgets) in enumerate(shared(advice).items()):
        place = (walls[name], max(errors[name], _LEAST))
        label = "recommended, with the budgets it keeps" if not number else None
        axis.plot(*place, "o", markersize=12, markerfacecolor="none", markeredgecolor="#b84e00", label=label)
        axis.annotate(budgets, place, (9, 7), textcoords="offset points", fontsize=8, color="#b84e00")
