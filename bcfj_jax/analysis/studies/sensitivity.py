"""Global sensitivity: how much of a feature's variation each varied parameter brings, from a finished study.

SALib estimates; which method follows from the study's design. Parameters are uniform on their ranges and independent,
on a log axis uniform in the logarithm.

| design | method | columns |
|---|---|---|
| saltelli | Sobol indices (Saltelli 2010), second order (Saltelli 2002) if it was drawn | S1, ST, S2 |
| morris | elementary effects (Morris 1991, Campolongo 2007) | mu, mu_star, sigma |
| latin_hypercube, sobol | RBD-FAST (Tarantola 2006, Tissot 2012), PAWN (Pianosi and Wagener 2018) | S1, pawn |

S1 = V(E[y | x_i])/V(y), ST = E[V(y | x_~i)]/V(y), S2 that of a pair beyond its S1. An elementary effect is the
feature's change over a step divided by the step's share of the range: mu is its mean, mu_star that of its size
(Campolongo), sigma its deviation, all in the feature's unit. PAWN is the median Kolmogorov-Smirnov distance, over
tenths of a parameter's range, of the feature's distribution there from that everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.studies.api import Finished, Source, read
from bcfj_jax.analysis.studies.command import DONE, INTERRUPTED, finished
from bcfj_jax.analysis.studies.specification import KINDS, needs
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import outputs, plots, report

# Points fail where parameters are extreme, not at random: with less than this share left it is another distribution.
_SHARE_LEFT = 0.5
# A feature that varies by less than this, relative to its size, does not vary.
_NOTHING = 1e-12
_RESAMPLES = 200


class Indices(NamedTuple):
    """Sensitivity indices of one feature."""

    feature: str  # its name
    method: str  # of ``specification.KINDS``
    parameters: tuple[str, ...]  # (D,) names
    # By name, (D,): "S1", "S1_conf", "ST", "ST_conf"; "mu", "mu_star", "mu_star_conf", "sigma"; "S1", "S1_conf",
    # "pawn". What ends in _conf is half of a 95 % interval, by bootstrap.
    values: Mapping[str, np.ndarray]
    # By name, (D, D), NaN on and below the diagonal: "S2", "S2_conf", where the study drew for them.
    pairs: Mapping[str, np.ndarray]
    # PAWN of a parameter that does nothing; what is not above it has no visible effect. NaN with other methods.
    dummy: float
    # points, blocks: what was used; blocks are points where the design has none.
    points: int
    blocks: int
    dropped: int  # blocks left out since a point of them failed or has no such feature
    # failed, undefined: points of each kind.
    failed: int
    undefined: int


def indices(source: Source, feature: str, seed: int = 0) -> Indices:
    """Sensitivity indices of a feature ("contact.peak") over a finished study, by the method that its design is for.

    Args:
        source: what ``bcfj_jax.study`` gave back, or the study's folder.
        feature, seed: its name; of the bootstrap.

    Raises:
        InputError: for a design that says nothing of a distribution (grid, list), a feature that is not there or does
            not vary, and where failed points leave too little.
    """
    found = read(source)
    design, y = found.study.design, found.feature(feature)
    where, kind, length = f"feature '{feature}'", KINDS[design.kind], design.length
    if not kind.method:
        remedy = "use the design saltelli, morris, latin_hypercube or sobol"
        raise InputError(where, f"points of a {design.kind} have no distribution, which indices need", remedy)
    # A block counts where it has a finite value at all of its points.
    kept = np.repeat(np.isfinite(y).reshape(-1, length).all(axis=1), length)
    blocks, left = len(y) // length, int(np.count_nonzero(kept)) // length
    if left < (need := max(kind.fewest, int(np.ceil(_SHARE_LEFT * blocks)))):
        lack = f"only {left} of {blocks} {kind.parts} have no failed or undefined point; {need} are needed"
        raise InputError(where, lack, "draw more, or narrow the ranges to where runs do not fail")
    y, shares = y[kept], found.shares[kept]
    if np.ptp(y) <= _NOTHING * np.max(np.abs(y)):
        raise InputError(where, f"is {y[0]:.6g} at every point", "vary parameters that change it")
    values, pairs, dummy = _estimate(found, shares, y, seed)
    failed = int(np.count_nonzero(~found.ok))
    undefined = int(np.count_nonzero(found.ok & ~np.isfinite(found.feature(feature))))
    names, counts = found.study.names, (len(y), left, blocks - left, failed, undefined)
    return Indices(feature, kind.method, names, values, pairs, dummy, *counts)


def every(source: Source, seed: int = 0, features: Sequence[str] = ()) -> tuple[list[Indices], dict[str, str]]:
    """Indices of the features named, or of every feature that has any; and why the others have none."""
    found = read(source)
    return found.each(lambda name: indices(found, name, seed), features)


def _estimate(found: Finished, shares: np.ndarray, y: np.ndarray, seed: int) -> tuple[dict, dict, float]:
    """What SALib makes of whole blocks: by parameter, by pair, and PAWN's dummy."""
    design = found.study.design
    # SALib takes a seed of 0 for none.
    common: dict[str, Any] = {"num_resamples": _RESAMPLES, "conf_level": 0.95, "seed": seed + 1}

    def salib(method: str, *given: Any, **more: Any) -> Any:
        return needs(f"SALib.analyze.{method}").analyze(design.box, *given, **more, **common)

    def taken(got: Any, *names: str) -> dict[str, np.ndarray]:
        # SALib masks what groups leave out; there are none.
        return {name: np.array(got[name], float) for name in names}

    if design.kind == "saltelli":
        got = salib("sobol", y, calc_second_order=design.second_order)
        pairs = taken(got, "S2", "S2_conf") if design.second_order else {}
        return taken(got, "S1", "S1_conf", "ST", "ST_conf"), pairs, np.nan
    if design.kind == "morris":
        got = salib("morris", shares, y, num_levels=design.levels)
        return taken(got, "mu", "mu_star", "mu_star_conf", "sigma"), {}, np.nan
    pawn, dummy = _pawn(shares, y, seed)
    return taken(salib("rbd_fast", shares, y), "S1", "S1_conf") | {"pawn": pawn}, {}, dummy


def _pawn(shares: np.ndarray, y: np.ndarray, seed: int) -> tuple[np.ndarray, float]:
    """Median PAWN indices (D,), and that of a dummy parameter: the mean over a few, which have nothing to do with y."""
    dummies = np.random.default_rng(seed).random((len(y), 10))
    columns = np.concatenate([shares, dummies], axis=1)
    names = [str(k) for k in range(columns.shape[1])]
    box = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    median = np.asarray(needs("SALib.analyze.pawn").analyze(box, columns, y, S=10)["median"])
    return median[: shares.shape[1]], float(np.mean(median[shares.shape[1] :]))


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
    good, refused = every(found, seed, features)
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
        above = list(zip(*np.triu_indices(len(one.parameters), 1), strict=True))
        for name, matrix in one.pairs.items():
            entry[name] = {f"{one.parameters[i]} x {one.parameters[j]}": matrix[i, j] for i, j in above}
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
    value, half, names = one.pairs["S2"], one.pairs["S2_conf"], one.parameters
    above = sorted(zip(*np.triu_indices(len(names), 1), strict=True), key=lambda at: -value[at])
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
