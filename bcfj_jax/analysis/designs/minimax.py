"""The last digits where several peaks are equally high: no gradient vanishes there, and Newton's method has nothing to solve.

Least of a greatest sample, min_u max_k F_k(u), is the smooth problem

    min z   with   F_k(u) <= z  for all k,   0 <= u <= 1

in (u, z), for SciPy's SLSQP with the slopes of all samples, which one run gives. Whether it ended at an optimum is decided
without it: there are weights l_k >= 0 of sum 1 over the samples that are as high as the highest, with
sum_k l_k dF_k/du = 0 but for what bounds hold (Clarke 1983); non-negative least squares finds the best ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize, nnls

from bcfj_jax.analysis.designs.evaluate import Evaluator
from bcfj_jax.analysis.designs.newton import ARRIVED

# Samples this much lower than the highest are left out; those within the second share of it are as high.
_LOW, _EQUAL = 0.5, 1e-7
# Sum of weighted slopes over the largest slope that counts as none.
_STATIONARY = 1e-5
_ITERATIONS, _PRECISION = 60, 1e-12
# The second descent begins this far away, to see whether it comes back.
_AWAY = 1e-3


class Kink(NamedTuple):
    """Where several samples are equally high.

    Attributes:
        point: unit coordinates (P,); value: the highest sample; equal: how many samples are as high.
        residual: of the weighted slopes, over the largest one.
        step: how far a second descent from near by ended, the longest coordinate.
        arrived: whether residual and step are small.
    """

    point: np.ndarray
    value: float
    equal: int
    residual: float
    step: float
    arrived: bool


def minimax(evaluate: Evaluator, point: np.ndarray, seed: int) -> Kink | None:
    """Descend from a point (P,) of the unit box; None where the objective is no greatest sample, or a run fails."""
    first = _descend(evaluate, point)
    if first is None:
        return None
    away = np.random.default_rng(seed).choice([-_AWAY, _AWAY], first.size)
    second = _descend(evaluate, np.clip(first + away, 0.0, 1.0))
    ends = [(u, evaluate.samples(u)) for u in (first, second) if u is not None]
    good = [(float(read[0].max()), u, read) for u, read in ends if read is not None]
    if not good:
        return None
    value, u, (values, slopes, _) = min(good, key=lambda end: end[0])
    step = float(np.max(np.abs(first - second))) if second is not None else float("nan")
    equal, residual = stationarity(u, values, slopes)
    return Kink(u, value, equal, residual, step, bool(residual < _STATIONARY and step < ARRIVED))


def _descend(evaluate: Evaluator, point: np.ndarray) -> np.ndarray | None:
    begin = evaluate.samples(point)
    if begin is None:
        return None
    size = max(float(np.abs(begin[0]).max()), 1e-300)
    rows = begin[0] >= begin[0].max() - _LOW * size
    last: list = [point, begin]

    def read(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if not np.array_equal(x[:-1], last[0]):
            found = evaluate.samples(np.clip(x[:-1], 0.0, 1.0))
            # A failed run stands far above all others.
            high = np.full(rows.size, 10.0 * size), np.zeros((rows.size, point.size)), rows
            last[:] = x[:-1].copy(), found or high
        return last[1]

    below = {
        "type": "ineq",
        "fun": lambda x: x[-1] - read(x)[0][rows] / size,
        "jac": lambda x: np.column_stack([-read(x)[1][rows] / size, np.ones(rows.sum())]),
    }
    end = minimize(
        lambda x: x[-1], np.append(point, begin[0].max() / size), jac=lambda x: np.eye(x.size)[-1], method="SLSQP",
        bounds=[(0.0, 1.0)] * point.size + [(None, None)], constraints=[below],
        options={"maxiter": _ITERATIONS, "ftol": _PRECISION},
    )  # fmt: skip
    return np.clip(end.x[:-1], 0.0, 1.0)


def stationarity(point: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> tuple[int, float]:
    """How many samples are as high as the highest, and the residual of Clarke's condition over the largest slope."""
    near = values >= values.max() - _EQUAL * np.abs(values).max()
    active = slopes[near]
    size = max(float(np.abs(active).max()), 1e-300)
    # A bound's multiplier cancels a slope that pushes against it.
    walls = [-np.eye(point.size)[k] for k in np.flatnonzero(point <= ARRIVED)]
    walls += [np.eye(point.size)[k] for k in np.flatnonzero(point >= 1.0 - ARRIVED)]
    columns = np.vstack([active / size, *(w[None] for w in walls)]).T
    weights = np.concatenate([np.ones(len(active)), np.zeros(len(walls))])
    left, right = np.vstack([columns, weights]), np.append(np.zeros(point.size), 1.0)
    return int(near.sum()), float(nnls(left, right)[1])
