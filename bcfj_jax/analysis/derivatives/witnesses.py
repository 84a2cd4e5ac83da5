"""Derivatives of features against differences of the features of other runs, which no error of tangents enters.

Solves at several tolerances share the rule by which tangents pass a touch: what is wrong there is wrong at every tolerance
alike, and a bound from them does not see it. Differences of forces see it where it changes the spike of a moving impact,
beside which a wrong impulse is small. Here the features of runs with other parameters are compared:

    f(p + h d) - f(p)  against  h (df/dp) d,    d a random direction of all parameters, h = ``_STEP`` of each;

where the two differ by more than the bounds allow, f(p + h d) - f(p - h d) against 2 h (df/dp) d; and where these do too, for
each parameter alone, with a second step a quarter as long, whose difference from the first is the differences' own error.
f(p) is of a solve that was made for the bounds, so that most results take one run more. The program is that of the
derivatives: nothing is compiled.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bcfj_jax.analysis.derivatives.bounds import SAFETY
from bcfj_jax.analysis.derivatives.differences import direction

# Share of a parameter that it is moved by, and relative difference of features that is looked into.
_STEP, SEEN = 1e-3, 1e-3

Features = Callable[[np.ndarray], np.ndarray]


def witnessed(
    features: Features, here: np.ndarray, values: np.ndarray, slopes: np.ndarray, bounds: np.ndarray
) -> np.ndarray:
    """Bounds (F, P) of the derivatives, larger where differences of features find more; of what is NaN as they are.

    Args:
        features: values (P,) -> features (F,), NaN where a run fails.
        here: (F,) at the values, at the same tolerance.
        values: of the parameters; one that is 0 is not moved.
        slopes: (F, P) derivatives; bounds: (F, P) of their relative errors.
    """
    step = np.abs(values)
    way = step * direction(len(values))

    def ahead(way: np.ndarray, h: float) -> np.ndarray:
        return features(values + h * way)

    def along(way: np.ndarray, h: float) -> np.ndarray:
        return (ahead(way, h) - ahead(-way, h)) / (2.0 * h)

    sizes = np.abs(slopes * way)
    with np.errstate(invalid="ignore"):
        allowed = np.sum(sizes * (np.nan_to_num(bounds, posinf=0.0) + SEEN), axis=1)
        # Where a bound is infinite nothing is trusted that might be looked into.
        known = np.isfinite(np.where(sizes > 0, bounds, 0.0)).all(axis=1)
        doubtful = np.zeros(len(here), bool)
        further = ahead(way, _STEP)
        for back, over in ((lambda: here, _STEP), (lambda: ahead(-way, _STEP), 2.0 * _STEP)):
            doubtful = known & (np.abs((further - back()) / over - slopes @ way) > allowed)
            if not doubtful.any():
                return bounds
    found = bounds.copy()
    for k in np.flatnonzero(step):
        alone = np.where(np.arange(len(values)) == k, step, 0.0)
        far, near = along(alone, _STEP), along(alone, 0.25 * _STEP)
        excess = np.maximum(np.abs(near - slopes @ alone) - np.abs(near - far), 0.0)
        share = SAFETY * excess / np.maximum(np.maximum(np.abs(slopes @ alone), np.abs(near)), 1e-300)
        found[:, k] = np.where(doubtful & np.isfinite(share), np.fmax(found[:, k], share), found[:, k])
    return found
