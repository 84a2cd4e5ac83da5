"""The last digits of an optimum: Newton's method on the gradient, or a minimax where several peaks are equally high.

Values decide a place only to the square root of their error; gradients decide it to their own. The Hessian comes from
central differences of gradients, all in one batch. What lies at a bound and is pushed against it stays there.

Where several peaks are equally high no gradient vanishes, and Newton's method has nothing to solve. Least of a greatest
sample, min_u max_k F_k(u), is the smooth problem

    min z   with   F_k(u) <= z  for all k,   0 <= u <= 1

in (u, z), for SciPy's SLSQP with the slopes of all samples, which one run gives. Whether it ended at an optimum is decided
without it: there are weights l_k >= 0 of sum 1 over the samples that are as high as the highest, with
sum_k l_k dF_k/du = 0 but for what bounds hold (Clarke 1983); non-negative least squares finds the best ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize, nnls

from bcfj_jax.analysis.designs.descent import Evaluate
from bcfj_jax.analysis.designs.evaluate import Evaluator, Values

# Differences of gradients over this share of a range; a step longer than the second is not Newton's to take.
_DIFFERENCE, _LONGEST = 1e-4, 0.05
_ITERATIONS = 12
# The last step's size that counts as arrived, in shares of the ranges.
ARRIVED = 1e-6
# Samples this much lower than the highest are left out; those within the second share of it are as high.
_LOW, _EQUAL = 0.5, 1e-7
# Sum of weighted slopes over the largest slope that counts as none.
_STATIONARY = 1e-5
_DESCENT, _PRECISION = 60, 1e-12
# The second descent begins this far away, to see whether it comes back.
_AWAY = 1e-3


class Refined(NamedTuple):
    """Where Newton's method ended."""

    # point, values: unit coordinates (P,), and what is there.
    point: np.ndarray
    values: Values
    active: np.ndarray  # (P,) -1 at a lower bound that the objective pushes against, 1 at an upper one, 0 free
    step: float  # the next step's longest coordinate, as a share of its range: how far from the optimum; NaN: unknown
    curvature: float  # least eigenvalue of the Hessian of what is free over the objective's size; infinite with none
    arrived: bool  # whether the step is below ``ARRIVED`` and the curvature positive


def activity(point: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(P,) -1, 0, 1 as ``Refined.active`` has it; bounds are met to within a millionth of a range."""
    low, high = point <= ARRIVED, point >= 1.0 - ARRIVED
    return np.where(low & (slope > 0), -1, np.where(high & (slope < 0), 1, 0))


def refine(evaluate: Evaluate, point: np.ndarray) -> Refined:
    """Newton's method from a descent's end (P,); steps are kept only where they lessen the projected gradient."""
    u = _snapped(point)
    here = evaluate(u[None])
    best, step, curvature = (u, here), np.nan, np.nan
    for _ in range(_ITERATIONS):
        u, here = best
        if here.reasons[0]:
            break
        slope = here.slope[0]
        active = activity(u, slope)
        free = np.flatnonzero(active == 0)
        if not free.size:
            step, curvature = 0.0, np.inf
            break
        hessian = _hessian(evaluate, u, free)
        if not np.isfinite(hessian).all():
            step, curvature = np.nan, np.nan
            break
        size = max(abs(float(here.goal[0])), 1e-300)
        curvature = float(np.linalg.eigvalsh(hessian).min() / size)
        if curvature <= 0.0:
            step = np.nan
            break
        move = np.zeros_like(u)
        move[free] = -np.linalg.solve(hessian, slope[free])
        trial = _snapped(u + move)
        step = float(np.max(np.abs(trial - u)))
        if step < 1e-10 or step > _LONGEST:
            break
        there = evaluate(trial[None])
        if there.reasons[0] or not _pull(trial, there) < _pull(u, here):
            break
        best = (trial, there)
    u, here = best
    active = np.zeros(len(u), dtype=int) if here.reasons[0] else activity(u, here.slope[0])
    return Refined(u, here, active, step, curvature, bool(step < ARRIVED and curvature > 0.0))


def _snapped(point: np.ndarray) -> np.ndarray:
    """Within the box; on a bound what is as good as there."""
    return np.where(point <= ARRIVED, 0.0, np.where(point >= 1.0 - ARRIVED, 1.0, point))


def _pull(u: np.ndarray, values: Values) -> float:
    """Length of the projected gradient."""
    slope = values.slope[0]
    return float(np.linalg.norm(np.where(activity(u, slope) == 0, slope, 0.0)))


def _hessian(evaluate: Evaluate, u: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Of the free coordinates; one-sided steps at a bound."""
    units = np.eye(u.size)[free]
    points = np.clip(u + _DIFFERENCE * np.stack([units, -units], axis=1).reshape(-1, u.size), 0.0, 1.0)
    slopes, gaps = evaluate(points).slope[:, free], np.sum((points[0::2] - points[1::2]) * units, axis=1)
    rows = (slopes[0::2] - slopes[1::2]) / gaps[:, None]
    return 0.5 * (rows + rows.T)


class Kink(NamedTuple):
    """Where several samples are equally high: unit coordinates (P,), the highest sample, how many are as high, the residual of
    weighted slopes over the largest one, how far a second descent from near by ended, whether both are small.
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
        options={"maxiter": _DESCENT, "ftol": _PRECISION},
    )  # fmt: skip
    return np.clip(end.x[:-1], 0.0, 1.0)


def stationarity(point: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> tuple[int, float]:
    """How many samples are as high as the highest, and the residual of Clarke's condition over the largest slope."""
    near = values >= values.max() - _EQUAL * np.abs(values).max()
    active = slopes[near]
    size = max(float(np.abs(active).max()), 1e-300)
    # A bound's multiplier cancels a slope that pushes against it.
    units = np.eye(point.size)
    walls = np.vstack([-units[point <= ARRIVED], units[point >= 1.0 - ARRIVED]])
    columns = np.vstack([active / size, walls]).T
    weights = np.concatenate([np.ones(len(active)), np.zeros(len(walls))])
    left, right = np.vstack([columns, weights]), np.append(np.zeros(point.size), 1.0)
    return int(near.sum()), float(nnls(left, right)[1])
