"""Pictures of sensitivities: which parameter moves which feature, and histories with their derivative bands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import BROKEN
from bcfj_jax.analysis.derivatives.ranking import Ranking, meaningful
from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity
from bcfj_jax.io.page import Picture, brief
from bcfj_jax.io.plots import COLOURS, label, panels
from bcfj_jax.io.units import engineering
from bcfj_jax.mechanism.channels import is_reading, quantity_of, unit_of

_MOST_PANELS, _MOST_BANDS = 6, 3
# Changes of a parameter that a band may stand for, and the share of the largest value that one can see.
_CHANGES, _SEEN = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5), 0.05


def tornado(ranked: Ranking, path: Path) -> Picture:
    """Bars of % per %, one panel for each of the strongest features, the strongest parameter on top.

    What is not known within 10 % has no bar.
    """
    ranked = ranked._replace(elasticity=np.where(ranked.apart > BROKEN, np.nan, ranked.elasticity))
    known = np.isfinite(ranked.elasticity).any(axis=1) if len(ranked.features) else np.zeros(0, bool)
    rows = np.flatnonzero(known)[:_MOST_PANELS]
    title, said = "Which parameter moves which feature", []
    height = 1.1 + 0.28 * len(ranked.parameters)
    with panels(max(1, len(rows)), 2, path, 6.2, height) as axes:
        if not len(rows):
            axes[0].text(0.5, 0.5, "no feature has a derivative", transform=axes[0].transAxes, ha="center")
        for axis, row in zip(axes, rows, strict=False):
            line = np.nan_to_num(ranked.elasticity[row])
            order = np.argsort(np.abs(line), kind="stable")
            colours = [COLOURS[0] if line[k] >= 0 else COLOURS[1] for k in order]
            bars = axis.barh([ranked.parameters[k] for k in order], line[order], color=colours)
            axis.bar_label(bars, [f"{line[k]:+.2g}" for k in order], padding=3, fontsize=8)
            axis.set_axisbelow(True)
            axis.margins(x=0.16)
            axis.axvline(0.0, color=COLOURS[5], linewidth=0.8)
            axis.set_title(ranked.features[row])
            axis.set_xlabel("change [% per % of the parameter]")
            strongest = ranked.parameters[order[-1]]
            said.append(f"{ranked.features[row]} most by {strongest} ({line[order[-1]]:+.2g} % per %)")
    if not said:
        return Picture(path.name, title, "No feature has a derivative that is known within 10 %.")
    return Picture(path.name, title, f"Change of each feature per 1 % of each parameter: {'; '.join(said)}.")


def bands(found: Sensitivity, values: Mapping[str, Any], path: Path) -> Picture:
    """Normal forces with what a change of the strongest parameters does to them, to first order; first members only.

    The change of a parameter is the least of ``_CHANGES`` that one can see. A parameter whose verdict is ``not
    differentiable here`` has no band.
    """
    # Of steady motion one turn: over many, a band is as thin as a line.
    turn = found.steady.turn if found.steady is not None and not found.steady.reason else 0.0
    part = found.times >= found.times[-1] - 1.0001 * turn if turn else slice(None)
    times = found.times[part]
    scale_t, prefix_t = engineering(times)
    said = []
    several = len(found.force) > 1
    with panels(len(found.force), 2, path, 6.2 if several else 9.5, 3.0 if several else 3.6) as axes:
        for axis, (name, force) in zip(axes, found.force.items(), strict=True):
            pick = (lambda x: x[part, 0, 0]) if force.ndim == 3 else (lambda x: x[part, 0])
            line = pick(force)
            scale, prefix = engineering(line, unit_of(name))
            top = float(np.nanmax(np.abs(line), initial=0.0))
            slopes = {p: float(values[p]) * pick(found.derivative[p][name]) for p in meaningful(found)}
            sizes = {p: float(np.max(np.abs(m))) for p, m in slopes.items() if np.isfinite(m).all()}
            shown = []
            for k, p in enumerate(sorted(sizes, key=lambda p: -sizes[p])[:_MOST_BANDS]):
                change = next((c for c in _CHANGES if c * sizes[p] >= _SEEN * top), _CHANGES[-1])
                move = np.clip(change * np.abs(slopes[p]), 0.0, 10.0 * top)
                low, high = (line - move) * scale, (line + move) * scale
                text = f"{p} ± {100 * change:g} %"
                axis.fill_between(times * scale_t, low, high, color=COLOURS[k + 1], alpha=0.35, lw=0, label=text)
                shown.append(f"{text}: at most {brief(float(np.max(move)), unit_of(name))}")
            axis.plot(times * scale_t, line * scale, color=COLOURS[0], linewidth=1.2)
            read = is_reading(name)
            called = name if read or force.ndim == 2 else f"{name}_1"
            axis.set_title(called if read else f"{called}: normal force")
            axis.set_xlabel(label("time", "s", prefix_t))
            axis.set_ylabel(label(*quantity_of(name), prefix) if read else label("force", "N", prefix))
            if sizes:
                axis.legend(fontsize=8, loc="best")
            said.append(f"{called}: {', '.join(shown) or 'no derivative'}")
    title = "What a change of a parameter does to the histories"
    when = "over the last turn" if turn else "over the run"
    return Picture(path.name, title, f"Histories with bands {when}, to first order. {'; '.join(said)}.")
