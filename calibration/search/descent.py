"""Descents of a batch of points in the unit box: Adam, and Levenberg-Marquardt.

Both ask only for residuals (B, N) and Jacobians (B, N, P) at points (B, P). A point whose simulation fails stays
where it was.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from bcfj_jax.xla.programs import program

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

_EDGE = 1e-6
# Adam's first rate, and the number of points in its program.
_RATE, _ROWS = 0.03, 12
# Damping of the first step, and what a rejected and an accepted step make of it.
_DAMPING, _WORSE, _BETTER = 1e-2, 4.0, 0.2
# No step moves a coordinate further than this share of its range: a contact found must not be jumped over.
_LONGEST = 0.15
_SHORTEST = 1e-9
# More coordinates are many: those that would move further are held, and the others solved for again, so often at most.
_MANY = 32
_AGAIN = 30
# A point gets nowhere that so many times in a row (or as asked for) gained less than this share of its cost.
_PATIENCE, _PROGRESS = 8, 1e-3
# A combination of coordinates that moves the residuals less than this share of one alone counts as this.
_LEAST_SIZE = 1e-12


class Descents(NamedTuple):
    """Where the descents are: points (B, P), costs (B,), infinite where the simulation failed, whether each converged."""

    points: np.ndarray
    costs: np.ndarray
    converged: np.ndarray


def cost_of(residuals: np.ndarray) -> np.ndarray:
    """Sums of squares (B,), infinite where a residual is not finite."""
    costs = np.sum(np.square(residuals), axis=1)
    return np.where(np.isfinite(costs), costs, np.inf)


def _adam_step(steps: int, slope: Array, state: tuple[Array, ...]) -> tuple[Any, tuple[Any, ...]]:
    """One step of optax's Adam, its rate falling as a cosine to 0: the change of the points, and the state, flat."""
    import optax  # Not needed where the program is kept.

    optimiser = optax.adam(optax.cosine_decay_schedule(_RATE, steps))
    tree = jax.tree.structure(optimiser.init(slope))
    change, after = optimiser.update(slope, jax.tree.unflatten(tree, state))
    return change, tuple(jax.tree.leaves(after))


def adam(evaluate: Evaluate, points: np.ndarray, steps: int) -> np.ndarray:
    """Adam on the logarithm of the cost; the best point of each descent."""
    at, best, least = points, points, np.full(len(points), np.inf)
    # As many rows always, so that batches share one program.
    shape = (-(-len(points) // _ROWS) * _ROWS, points.shape[1])
    count = np.zeros((), np.int32)
    state = (count, np.zeros(shape), np.zeros(shape), count)
    step, _ = program("adam", _adam_step, (steps,), (np.zeros(shape), state))
    for _ in range(steps):
        residuals, jacobians = evaluate(at)
        costs = cost_of(residuals)
        slope = 2.0 * np.einsum("bn,bnp->bp", residuals, jacobians) / (costs[:, None] + 1.0)
        better = costs < least
        best, least = np.where(better[:, None], at, best), np.where(better, costs, least)
        rows = np.zeros(shape)
        rows[: len(points)] = np.where(np.isfinite(slope), slope, 0.0)
        change, state = step(rows, state)
        at = np.clip(at + change[: len(points)], _EDGE, 1.0 - _EDGE)
    return best


def levenberg(
    evaluate: Evaluate,
    points: np.ndarray,
    iterations: int,
    tolerance: float,
    *,
    enough: float = 0.0,
    patience: int = _PATIENCE,
) -> Descents:
    """Damped Gauss-Newton within the box, each point with its own damping.

    A coordinate at a bound that the cost pushes it against is held there. Points that have converged, and points that get
    nowhere, are not waited for.

    Args:
        evaluate: residuals and Jacobians; asked at most ``iterations + 1`` times.
        tolerance, enough: a point has converged when less is left to gain, in units of cost / residuals, or at all.
        patience: how many times in a row a point may gain nothing to speak of.
    """
    at = np.clip(points, 0.0, 1.0)
    residuals, jacobians = evaluate(at)
    costs, slope, bend = _model(residuals, jacobians)
    least = tolerance / residuals.shape[1]
    damping = np.full(len(at), _DAMPING)
    converged, active, idle = np.zeros(len(at), dtype=bool), np.isfinite(costs), np.zeros(len(at), dtype=int)
    for _ in range(iterations):
        step, promise = _step(at, slope, bend, damping)
        small = (promise <= np.maximum(least * costs, enough)) | (np.abs(step).max(axis=1) < _SHORTEST)
        converged |= active & small
        active &= ~small & (idle < patience)
        if not active.any():
            break
        # Points that are done copy one that is not: equal points are evaluated once.
        trial = np.where(active[:, None], at + step, (at + step)[np.argmax(active)])
        residuals, jacobians = evaluate(trial)
        new_costs, new_slope, new_bend = _model(residuals, jacobians)
        better = active & (new_costs < costs)
        idle = np.where(new_costs < (1.0 - _PROGRESS) * costs, 0, idle + 1)
        costs = np.where(better, new_costs, costs)
        at, slope = (np.where(better[:, None], new, old) for new, old in ((trial, at), (new_slope, slope)))
        bend = np.where(better[:, None, None], new_bend, bend)
        damping = np.clip(np.where(better, _BETTER * damping, _WORSE * damping), 1e-9, 1e12)
    return Descents(at, costs, converged)


def _model(residuals: np.ndarray, jacobians: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs (B,), half their gradients (B, P) and Gauss-Newton matrices (B, P, P); infinite and zero on failure."""
    slope = np.einsum("bn,bnp->bp", residuals, jacobians)
    bend = np.swapaxes(jacobians, 1, 2) @ jacobians
    costs = cost_of(residuals)
    good = np.isfinite(costs) & np.isfinite(slope).all(axis=1) & np.isfinite(bend).all(axis=(1, 2))
    return np.where(good, costs, np.inf), np.where(good[:, None], slope, 0.0), np.where(good[:, None, None], bend, 0.0)


def _step(at: np.ndarray, slope: np.ndarray, bend: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Damped steps (B, P) within the box, and the decrease of the cost (B,) that an undamped one would promise.

    No coordinate moves further than _LONGEST: the whole step is shortened. Of many coordinates some would always go far:
    these stay at what is allowed, and the others are solved for again.
    """
    free = ~(((at <= 0.0) & (slope > 0.0)) | ((at >= 1.0) & (slope < 0.0)))
    step, promise = _damped(free, slope, bend, damping)
    if at.shape[1] <= _MANY:
        step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        return np.clip(at + step, 0.0, 1.0) - at, promise
    step, whole = (_within(at, free, slope, bend, x) for x in (damping, np.zeros_like(damping)))
    gains = [-np.einsum("bp,bp->b", x, 2.0 * slope + np.einsum("bpq,bq->bp", bend, x)) for x in (step, whole)]
    return step, np.maximum(*gains)


def _within(at: np.ndarray, free: np.ndarray, slope: np.ndarray, bend: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Damped steps (B, P) in which what would go too far stays at what is allowed."""
    lower, upper = np.maximum(-_LONGEST, -at), np.minimum(_LONGEST, 1.0 - at)
    held, step = np.zeros_like(at), np.zeros_like(at)
    for _ in range(_AGAIN):
        step = held + _damped(free, slope + np.einsum("bpq,bq->bp", bend, held), bend, damping)[0]
        out = free & ((step < lower) | (step > upper))
        if not out.any():
            break
        held, free = np.where(out, np.clip(step, lower, upper), held), free & ~out
    return np.clip(step, lower, upper)


def _damped(
    free: np.ndarray, slope: np.ndarray, bend: np.ndarray, damping: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Damped steps (B, P) of the free coordinates, 0 of the others, and what undamped ones promise to gain (B,)."""
    # In units of each column's own size, damping is the same for all coordinates.
    unit = np.sqrt(np.einsum("bpp->bp", bend))
    unit = np.where(free & (unit > 0.0), unit, np.inf)
    sizes, axes = np.linalg.eigh(bend / (unit[:, :, None] * unit[:, None, :]))
    along = np.einsum("bpk,bp->bk", axes, slope / unit)
    sizes = np.maximum(sizes, _LEAST_SIZE)
    step = -np.einsum("bpk,bk->bp", axes, along / (sizes + damping[:, None])) / unit
    return step, np.sum(np.square(along) / sizes, axis=1)
