"""``bcfj study indices``: sensitivity indices of a finished study as a table, ``indices.json`` and bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.studies import sensitivity
from bcfj_jax.analysis.studies.command import DONE, INTERRUPTED, finished
from bcfj_jax.analysis.studies.sensitivity import Indices
from bcfj_jax.io import outputs, plots, report

JSON, PICTURE = "indices.json", "indices.png"
_MOST = 12  # panels
# What is drawn of each method, what it is called, and the key of its half interval.
_BARS = {
    "Sobol": (("S1", "first order"), ("ST", "total")),
    "Morris": (("mu_star", "mu*"), ("sigma", "sigma")),
    "RBD-FAST, PAWN": (("S1", "first order"), ("pawn", "PAWN")),
}
# What the columns mean, for the screen.
_MEANINGS = {
    "Sobol": "S1: share of the variance that this parameter brings alone; ST: with all its interactions; ±: 95 %.",
    "Morris": "mu_star: mean size of an elementary effect; sigma: its standard deviation, by interactions and curvature.",
    "RBD-FAST, PAWN": "S1: share of the variance that this parameter brings alone; pawn: how far it moves the distribution.",
}


def run(what: str, out: Path | None, features: Sequence[str], seed: int) -> tuple[str, int]:
    """Indices of some features, or of all; in words, and the exit code: 5 while the study is not finished."""
    found, folder, first = finished(what, out)
    if found is None:
        return first, INTERRUPTED
    good, refused = sensitivity.every(found, seed, features)
    outputs.write_json(folder / JSON, content(good, refused, seed))
    picture(good, folder / PICTURE)
    meant = dict.fromkeys(_MEANINGS[one.method] for one in good if one.method in _MEANINGS)
    return "\n\n".join([text(good, refused), *meant, f"results in {folder}"]), DONE


def content(good: Sequence[Indices], refused: dict[str, str], seed: int) -> dict[str, Any]:
    """``indices.json``: by feature, by index, by parameter or pair."""
    found: dict[str, Any] = {}
    for one in good:
        entry: dict[str, Any] = {"method": one.method}
        entry |= {name: dict(zip(one.parameters, x, strict=True)) for name, x in one.values.items()}
        for name, matrix in one.pairs.items():
            entry[name] = {
                f"{a} x {b}": matrix[i, j]
                for i, a in enumerate(one.parameters)
                for j, b in enumerate(one.parameters)
                if i < j
            }
        if np.isfinite(one.dummy):
            entry["pawn_dummy"] = one.dummy
        counts = ("points", "blocks", "dropped", "failed", "undefined")
        found[one.feature] = entry | {name: getattr(one, name) for name in counts}
    return {"features": found, "without": refused, "confidence": 0.95, "seed": seed}


def text(good: Sequence[Indices], refused: dict[str, str]) -> str:
    """A table a feature, what was left out, and features without indices."""
    parts = []
    for one in good:
        names = [name for name in one.values if not name.endswith("_conf")]
        rows = [[one.feature, *names]]
        for k, parameter in enumerate(one.parameters):
            rows.append([parameter, *(_cell(one, name, k) for name in names)])
        if np.isfinite(one.dummy):
            rows.append(["(one that does nothing)", *("" for _ in names[1:]), f"{one.dummy:.3f}"])
        basis = f"{one.method} from {one.points} points; {one.failed} points failed"
        basis += f", {one.undefined} without the feature" if one.undefined else ""
        basis += f"; {one.dropped} of {one.blocks + one.dropped} blocks left out" if one.dropped else ""
        second = [["pair", "S2"], *pairs(one)]
        tables = [rows, second] if len(second) > 1 else [rows]
        parts.append("\n\n".join([*map(report.text, tables), basis]) + "\n")
    parts += [f"{name}: no indices: {why}" for name, why in refused.items()]
    return "\n".join(parts)


def pairs(one: Indices) -> list[list[str]]:
    """Second-order indices in words, a row a pair, the largest first."""
    if "S2" not in one.pairs:
        return []
    value, half = one.pairs["S2"], one.pairs["S2_conf"]
    above = [(i, j) for i, j in zip(*np.triu_indices(len(one.parameters), 1), strict=True)]
    above.sort(key=lambda at: -value[at])
    names = one.parameters
    return [[f"{names[i]} x {names[j]}", f"{value[i, j]:.3f} ± {half[i, j]:.3f}"] for i, j in above]


def _cell(one: Indices, name: str, k: int) -> str:
    form = ".4g" if one.method == "Morris" else ".3f"
    half = one.values.get(f"{name}_conf")
    value = format(one.values[name][k], form)
    return value if half is None else f"{value} ± {format(half[k], '.2g' if form == '.4g' else form)}"


def picture(good: Sequence[Indices], path: Path) -> None:
    """Bars with 95 % intervals, a panel a feature, the strongest parameter above; twelve features at most."""
    shown = good[:_MOST]
    tall = 1.3 + 0.45 * len(shown[0].parameters)
    with plots.panels(len(shown), 2, path, 5.6, tall) as axes:
        for axis, one in zip(axes, shown, strict=True):
            kinds = _BARS[one.method]
            order = np.argsort(one.values[kinds[-1][0] if one.method == "Sobol" else kinds[0][0]])
            at = np.arange(len(order), dtype=float)
            for shift, (name, called) in zip((0.19, -0.19), kinds, strict=True):
                half = one.values.get(f"{name}_conf")
                error = None if half is None else half[order]
                bar = {"height": 0.36, "label": called, "ecolor": "#333333", "error_kw": {"elinewidth": 1.0}}
                axis.barh(at + shift, one.values[name][order], xerr=error, **bar)
            if np.isfinite(one.dummy):
                axis.axvline(one.dummy, color="#777777", lw=1.0, ls="--", label="PAWN of nothing")
            axis.set_yticks(at, [one.parameters[k] for k in order])
            axis.grid(False, axis="y")
            axis.set_axisbelow(True)
            axis.axvline(0.0, color="#333333", lw=0.8)
            axis.set_title(one.feature)
            unit = feature_unit(one.feature)
            axis.set_xlabel(plots.label("change over the range", unit) if one.method == "Morris" else "index")
            axis.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, columnspacing=1.0)
