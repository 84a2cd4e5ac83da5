"""Pictures of sensitivities: which parameter moves which feature, and histories with their derivative bands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import BROKEN
from bcfj_jax.analysis.derivatives.ranking import Ranking, meaningful
from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity
from bcfj_jax.io.plots import figure, label, save, style
from bcfj_jax.io.units import engineering
from bcfj_jax.mechanism.channels import is_reading, quantity_of, unit_of

_CHANGE, _MOST_PANELS, _MOST_BANDS = 0.01, 6, 3


def tornado(ranked: Ranking, path: Path) -> None:
    """Bars of % per %, one panel for each of the strongest features, the strongest parameter on top.

    What two tolerances do not agree about within 10 % has no bar.
    """
    ranked = ranked._replace(elasticity=np.where(ranked.apart > BROKEN, np.nan, ranked.elasticity))
    known = np.isfinite(ranked.elasticity).any(axis=1) if len(ranked.features) else np.zeros(0, bool)
    rows = np.flatnonzero(known)[:_MOST_PANELS]
    with style():
        drawing, axes = figure(max(1, len(rows)), height=1.1 + 0.25 * len(ranked.parameters))
        if not len(rows):
            axes[0].text(0.5, 0.5, "no feature has a derivative", transform=axes[0].transAxes, ha="center")
        for axis, row in zip(axes, rows, strict=False):
            line = np.nan_to_num(ranked.elasticity[row])
            order = np.argsort(np.abs(line), kind="stable")
            colours = ["#1f5fa8" if line[k] >= 0 else "#c4501b" for k in order]
            axis.barh([ranked.parameters[k] for k in order], line[order], color=colours)
            axis.set_axisbelow(True)
            axis.axvline(0.0, color="#4a4a4a", linewidth=0.8)
            axis.set_title(f"{ranked.features[row]}: change per 1 % of each parameter")
            axis.set_xlabel("change [%]")
        save(drawing, path)


def bands(found: Sensitivity, values: Mapping[str, Any], path: Path) -> None:
    """Normal forces with what a change of 1 % in the strongest parameters does to them; first members only.

    A parameter whose verdict is ``not differentiable here`` has no band.
    """
    scale_t, prefix_t = engineering(found.times)
    with style():
        drawing, axes = figure(len(found.force))
        for axis, (name, force) in zip(axes, found.force.items(), strict=True):
            pick = (lambda x: x[:, 0, 0]) if force.ndim == 3 else (lambda x: x[:, 0])
            line = pick(force)
            scale, prefix = engineering(line, unit_of(name))
            moves = {p: _CHANGE * float(values[p]) * pick(found.derivative[p][name]) for p in meaningful(found)}
            sizes = {p: float(np.max(np.abs(m))) for p, m in moves.items() if np.isfinite(m).all()}
            for k, p in enumerate(sorted(sizes, key=lambda p: -sizes[p])[:_MOST_BANDS]):
                move = np.clip(np.abs(moves[p]), 0.0, 10.0 * np.max(np.abs(line)))
                low, high = (line - move) * scale, (line + move) * scale
                text = f"{p} ± {100 * _CHANGE:g} %"
                axis.fill_between(found.times * scale_t, low, high, color=f"C{k + 1}", alpha=0.3, lw=0, label=text)
            axis.plot(found.times * scale_t, line * scale, color="C0")
            read = is_reading(name)
            axis.set_title(name if read else f"{name if force.ndim == 2 else f'{name}_1'}: normal force")
            axis.set_xlabel(label("time", "s", prefix_t))
            axis.set_ylabel(label(*quantity_of(name), prefix) if read else label("force", "N", prefix))
            if sizes:
                axis.legend(fontsize=8, loc="best")
        save(drawing, path)
