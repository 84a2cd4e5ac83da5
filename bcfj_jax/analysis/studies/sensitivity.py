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
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.studies.design import KINDS, needs
from bcfj_jax.analysis.studies.finished import Finished, Source, read
from bcfj_jax.core.errors import InputError

# Points fail where parameters are extreme, not at random: with less than this share left it is another distribution.
_SHARE_LEFT = 0.5
# A feature that varies by less than this, relative to its size, does not vary.
_NOTHING = 1e-12
_RESAMPLES = 200


class Indices(NamedTuple):
    """Sensitivity indices of one feature.

    Attributes:
        feature: its name.
        method: of ``design.KINDS``.
        parameters: (D,) names.
        values: by name, (D,): "S1", "S1_conf", "ST", "ST_conf"; "mu", "mu_star", "mu_star_conf", "sigma"; "S1",
            "S1_conf", "pawn". What ends in _conf is half of a 95 % interval, by bootstrap.
        pairs: by name, (D, D), NaN on and below the diagonal: "S2", "S2_conf", where the study drew for them.
        dummy: PAWN of a parameter that does nothing; what is not above it has no visible effect.
            NaN with other methods.
        points, blocks: what was used; blocks are points where the design has none.
        dropped: blocks left out since a point of them failed or has no such feature.
        failed, undefined: points of each kind.
    """

    feature: str
    method: str
    parameters: tuple[str, ...]
    values: Mapping[str, np.ndarray]
    pairs: Mapping[str, np.ndarray]
    dummy: float
    points: int
    blocks: int
    dropped: int
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
