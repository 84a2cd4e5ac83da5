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

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.studies.design import block_length, unit_box
from bcfj_jax.analysis.studies.finished import Finished, Source, read
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.extras import library

# Fewest blocks, or points where there are none, from which an estimate and its interval mean something: of Saltelli's
# blocks enough for a bootstrap, of trajectories as many as Morris used (Campolongo: 10), of points several for each of
# RBD-FAST's 10 harmonics.
FEWEST = {"saltelli": 32, "morris": 4, "latin_hypercube": 100, "sobol": 100}
# Points fail where parameters are extreme, not at random: with less than this share left it is another distribution.
_SHARE_LEFT = 0.5
# A feature that varies by less than this, relative to its size, does not vary.
_NOTHING = 1e-12
_RESAMPLES = 200
METHODS = {"saltelli": "Sobol", "morris": "Morris", "latin_hypercube": "RBD-FAST, PAWN", "sobol": "RBD-FAST, PAWN"}


class Indices(NamedTuple):
    """Sensitivity indices of one feature.

    Attributes:
        feature: its name.
        method: one of ``METHODS``.
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
    """Sensitivity indices of a feature over a finished study, by the method that its design is for.

    Args:
        source: what ``bcfj_jax.study`` gave back, or the study's folder.
        feature: such as "contact.peak".
        seed: of the bootstrap.

    Raises:
        InputError: for a design that says nothing of a distribution (grid, list), a feature that is not there or does
            not vary, and where failed points leave too little.
    """
    found = read(source)
    study, y = found.study, found.feature(feature)
    where = f"feature '{feature}'"
    if study.kind not in METHODS:
        remedy = "use the design saltelli, morris, latin_hypercube or sobol"
        raise InputError(where, f"points of a {study.kind} have no distribution, which indices need", remedy)
    length = block_length(study.kind, len(study.names), study.options)
    kept = whole_blocks(y, length)
    blocks, left = len(y) // length, int(np.count_nonzero(kept)) // length
    called = {"saltelli": "blocks", "morris": "trajectories"}.get(study.kind, "points")
    if left < FEWEST[study.kind] or left < _SHARE_LEFT * blocks:
        need = max(FEWEST[study.kind], int(np.ceil(_SHARE_LEFT * blocks)))
        lack = f"only {left} of {blocks} {called} have no failed or undefined point; {need} are needed"
        raise InputError(where, lack, "draw more, or narrow the ranges to where runs do not fail")
    y, shares = y[kept], found.shares[kept]
    if np.ptp(y) <= _NOTHING * np.max(np.abs(y)):
        raise InputError(where, f"is {y[0]:.6g} at every point", "vary parameters that change it")
    values, pairs, dummy = _estimate(found, shares, y, seed)
    failed = int(np.count_nonzero(~found.ok))
    undefined = int(np.count_nonzero(found.ok & ~np.isfinite(found.feature(feature))))
    return Indices(
        feature, METHODS[study.kind], study.names, values, pairs, dummy, len(y), left, blocks - left, failed, undefined
    )


def every(source: Source, seed: int = 0) -> tuple[list[Indices], dict[str, str]]:
    """Indices of every feature of a study, and why those that have none have none.

    Raises:
        InputError: if no feature has any.
    """
    found = read(source)
    good: list[Indices] = []
    errors: dict[str, InputError] = {}
    for feature in found.study.features:
        try:
            good.append(indices(found, feature.name, seed))
        except InputError as error:
            errors[feature.name] = error
    if not good:
        raise next(iter(errors.values()))
    return good, {name: f"{error.found}; {error.remedy}" for name, error in errors.items()}


def whole_blocks(y: np.ndarray, length: int) -> np.ndarray:
    """(N,) whether each point's block, of so many consecutive points, has a finite value at all of them."""
    whole = np.isfinite(y).reshape(-1, length).all(axis=1)
    return np.repeat(whole, length)


def _estimate(
    found: Finished, shares: np.ndarray, y: np.ndarray, seed: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], float]:
    """What SALib makes of whole blocks: by parameter, by pair, and PAWN's dummy."""
    study, box = found.study, unit_box(found.study.axes)
    # SALib takes a seed of 0 for none.
    common: dict[str, Any] = {"num_resamples": _RESAMPLES, "conf_level": 0.95, "seed": seed + 1}
    if study.kind == "saltelli":
        second = study.options.second_order
        got = library("SALib.analyze.sobol", "bcfj study", "study").analyze(box, y, calc_second_order=second, **common)
        pairs = {name: np.asarray(got[name]) for name in ("S2", "S2_conf") if second}
        return {name: np.asarray(got[name]) for name in ("S1", "S1_conf", "ST", "ST_conf")}, pairs, np.nan
    if study.kind == "morris":
        levels = study.options.levels
        got = library("SALib.analyze.morris", "bcfj study", "study").analyze(
            box, shares, y, num_levels=levels, **common
        )
        # SALib masks what groups leave out; there are none.
        return {name: np.array(got[name], float) for name in ("mu", "mu_star", "mu_star_conf", "sigma")}, {}, np.nan
    got = library("SALib.analyze.rbd_fast", "bcfj study", "study").analyze(box, shares, y, **common)
    pawn, dummy = _pawn(shares, y, seed)
    return {"S1": np.array(got["S1"]), "S1_conf": np.array(got["S1_conf"]), "pawn": pawn}, {}, dummy


def _pawn(shares: np.ndarray, y: np.ndarray, seed: int) -> tuple[np.ndarray, float]:
    """Median PAWN indices (D,), and that of a dummy parameter: the mean over a few, which have nothing to do with y."""
    dummies = np.random.default_rng(seed).random((len(y), 10))
    columns = np.concatenate([shares, dummies], axis=1)
    names = [str(k) for k in range(columns.shape[1])]
    box = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    median = np.asarray(library("SALib.analyze.pawn", "bcfj study", "study").analyze(box, columns, y, S=10)["median"])
    return median[: shares.shape[1]], float(np.mean(median[shares.shape[1] :]))
