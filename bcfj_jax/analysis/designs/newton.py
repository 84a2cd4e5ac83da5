"""The last digits: Newton's method on the gradient, within the box, and whether it ended at an optimum.

Values decide a place only to the square root of their error; gradients decide it to their own. The Hessian comes from
central differences of gradients, all in one batch. What lies at a bound and is pushed against it stays there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis.designs.evaluate import Values

Evaluate = Callable[..., Values]

# Differences of gradients over this share of a range; a step longer than the second is not Newton's to take.
_DIFFERENCE, _LONGEST = 1e-4, 0.05
_ITERATIONS = 12
# The last step's size that counts as arrived, in shares of the ranges.
ARRIVED = 1e-6


class Refined(NamedTuple):
    """Where Newton's method ended.

    Attributes:
        point: unit coordinates (P,).
        values: of one point, there.
        active: (P,) -1 at a lower bound that the objective pushes against, 1 at an upper one, 0 free.
        step: the next step's longest coordinate, as a share of its range: how far from the optimum; NaN: unknown.
        curvature: least eigenvalue of the Hessian of what is free over the objective's size; infinite with none.
        arrived: whether the step is below ``ARRIVED`` and the curvature positive.
    """

    point: np.ndarray
    values: Values
    active: np.ndarray
    step: float
    curvature: float
    arrived: bool


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
    shift = np.zeros((2 * free.size, u.size))
    for i, k in enumerate(free):
        shift[2 * i, k], shift[2 * i + 1, k] = _DIFFERENCE, -_DIFFERENCE
    points = np.clip(u + shift, 0.0, 1.0)
    slopes = evaluate(points).slope[:, free]
    gaps = np.array([points[2 * i, k] - points[2 * i + 1, k] for i, k in enumerate(free)])
    rows = (slopes[0::2] - slopes[1::2]) / gaps[:, None]
    return 0.5 * (rows + rows.T)
