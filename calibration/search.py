"""Finding optima: scrambled Sobol starts in one batch, a rough descent by optax, a bounded trust region.

Nothing here judges: every start is reported with where it ended, failures included.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import optax
from scipy.optimize import least_squares
from scipy.stats import qmc

from bcfj_jax import simulate
from calibration.model import Model, batch, residuals_and_jacobian

log = logging.getLogger("calibration")

# A residual of a failed simulation: far above any real one, finite so that the trust region backs off.
FAILED_RESIDUAL = 1e4
_ROUGH_STEPS, _ROUGH_RATE = 60, 0.03


@dataclass(frozen=True)
class End:
    """Where one start ended.

    Attributes:
        start, point: unit-box coordinates before and after.
        cost: sum of squared weighted residuals.
        jacobian: of the residuals at ``point``.
        converged: whether the optimiser met its own tolerance.
        failure: why it cannot count; "" if it can.
    """

    start: np.ndarray
    point: np.ndarray
    cost: float
    residuals: np.ndarray
    jacobian: np.ndarray
    converged: bool
    failure: str = ""


@dataclass(frozen=True)
class Screen:
    """A Sobol design of unit-box points, its costs (NaN: failed), and how far each coordinate moves any residual."""

    design: np.ndarray
    costs: np.ndarray
    reach: np.ndarray


@dataclass(frozen=True)
class Search:
    """All starts' ends, best first, and the logarithm of the reference penetration used."""

    ends: tuple[End, ...]
    log_depth: float


def screen(model: Model, count: int, seed: int) -> Screen:
    """Evaluate a scrambled Sobol design some eight times as large as the number of starts, in one batched program.

    Args:
        model: residual function.
        count: number of starts to come, which is also the number of lanes.
        seed: of the scrambling.
    """
    design = qmc.Sobol(len(model.slots), rng=seed).random_base2(3 + int(np.ceil(np.log2(count))))
    costs, reach = [], np.zeros(design.shape[1])
    # Blocks of one size, the last one filled up, so that screening and descent share one program.
    for first in range(0, len(design), count):
        block = design[np.arange(first, first + count) % len(design)]
        residuals, jacobians = (np.asarray(a) for a in batch(model, jnp.asarray(block), jnp.asarray(0.0)))
        costs.extend(np.sum(residuals**2, axis=1)[: len(design) - first])
        finite = np.where(np.isfinite(jacobians), np.abs(jacobians), 0.0)
        reach = np.maximum(reach, finite.max(axis=(0, 1), initial=0.0))
    log.info("%d of %d Sobol points simulate", np.isfinite(costs).sum(), len(design))
    return Screen(design, np.array(costs), reach)


def search(model: Model, screened: Screen, starts: list[np.ndarray], count: int) -> Search:
    """Descend to optima from the best spread of a screened design.

    Args:
        model: residual function.
        screened: the design, from ``screen``.
        starts: parameter values (SI, one a slot) that must be among the starts.
        count: number of starts that descend to the end, >= 2.
    """
    log_depth, design, costs = 0.0, screened.design, screened.costs
    values = [np.asarray(model.values(jnp.asarray(u), jnp.asarray(log_depth))) for u in _spread(design, costs, count)]
    values = [*starts, *values][: max(count, len(starts))]
    if model.referenced:
        log_depth = (
            _reference_depth(model, design[int(np.nanargmin(costs))], log_depth) if np.isfinite(costs).any() else 0.0
        )
    points = np.clip([model.point(v, log_depth) for v in values], 1e-3, 1 - 1e-3)
    rough = _descend(model, points, log_depth)
    if model.referenced:
        best = int(np.nanargmin(_costs(model, rough, log_depth)))
        moved = [np.asarray(model.values(jnp.asarray(u), jnp.asarray(log_depth))) for u in rough]
        log_depth = _reference_depth(model, rough[best], log_depth)
        rough = np.clip([model.point(v, log_depth) for v in moved], 1e-6, 1 - 1e-6)
    ends = []
    for i, (first, point) in enumerate(zip(points, rough, strict=True)):
        ends.append(finish(model, first, point, log_depth))
        log.info("start %d of %d: chi2 %.6g %s", i + 1, len(rough), ends[-1].cost, ends[-1].failure)
    ends.sort(key=lambda end: (bool(end.failure), end.cost))
    return Search(tuple(ends), log_depth)


def _spread(design: np.ndarray, costs: np.ndarray, count: int) -> np.ndarray:
    """Half the best points, half taken evenly over the rest: good ones, and some that know nothing."""
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf))
    good = order[: count - count // 2]
    rest = order[len(good) :]
    rest = rest[np.isfinite(costs[rest])] if np.isfinite(costs[rest]).any() else rest
    return design[np.concatenate([good, rest[:: max(1, len(rest) // max(1, count // 2))][: count // 2]])]


def _reference_depth(model: Model, point: np.ndarray, log_depth: float) -> float:
    """Force-weighted mean of ln(penetration) over the contact at a point: a depth inside the data."""
    values = model.values(jnp.asarray(point), jnp.asarray(log_depth))
    params = {name: float(v[0]) for name, v in model.data.fixed.items()}
    for slot, value in zip(model.slots, values, strict=True):
        if slot.name in params and slot.experiment in (None, 0):
            params[slot.name] = float(value)
    times = np.linspace(0.0, float(model.data.times[0].max()), 2001)
    run = simulate(model.scene, model.scene.parameters(params), times)
    force = np.concatenate([f[..., 0].ravel() for f in run.force.values()])
    depth = np.concatenate([d.ravel() for d in run.penetration.values()])
    inside = (depth > 0) & (force > 0)
    if not inside.any():
        return log_depth
    return float(np.average(np.log(depth[inside]), weights=force[inside]))


def _costs(model: Model, points: np.ndarray, log_depth: float) -> np.ndarray:
    residuals, _ = batch(model, jnp.asarray(points), jnp.asarray(log_depth))
    cost = np.sum(np.asarray(residuals) ** 2, axis=1)
    return np.where(np.isfinite(cost), cost, FAILED_RESIDUAL**2 * residuals.shape[1])


def _descend(model: Model, points: np.ndarray, log_depth: float) -> np.ndarray:
    """Adam on the logarithm of the cost, all starts in one batch; a failed lane stays where it is."""
    optimiser = optax.adam(optax.cosine_decay_schedule(_ROUGH_RATE, _ROUGH_STEPS))
    at = jnp.asarray(points)
    state = optimiser.init(at)
    best, best_cost = at, jnp.full(len(points), jnp.inf)
    for _ in range(_ROUGH_STEPS):
        residuals, jacobians = batch(model, at, jnp.asarray(log_depth))
        cost = jnp.sum(jnp.square(residuals), axis=1)
        slope = 2.0 * jnp.einsum("bn,bnp->bp", residuals, jacobians) / (cost[:, None] + 1.0)
        slope = jnp.where(jnp.isfinite(slope), slope, 0.0)
        better = cost < best_cost
        best, best_cost = jnp.where(better[:, None], at, best), jnp.where(better, cost, best_cost)
        step, state = optimiser.update(slope, state, at)
        at = jnp.clip(jnp.asarray(optax.apply_updates(at, step)), 1e-6, 1.0 - 1e-6)
    return np.asarray(best)


def finish(model: Model, start: np.ndarray, point: np.ndarray, log_depth: float) -> End:
    """Bounded trust region (SciPy TRF) on residuals and forward-mode Jacobian from one point."""
    depth = jnp.asarray(log_depth)
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def evaluate(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = u.tobytes()
        if key not in seen:
            seen.clear()
            residuals, jacobian = (np.asarray(a) for a in residuals_and_jacobian(model, jnp.asarray(u), depth))
            if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
                residuals, jacobian = np.full_like(residuals, FAILED_RESIDUAL), np.zeros_like(jacobian)
            seen[key] = residuals, jacobian
        return seen[key]

    result = least_squares(
        lambda u: evaluate(u)[0],
        point,
        jac=lambda u: evaluate(u)[1],  # pyright: ignore[reportArgumentType]
        bounds=(0.0, 1.0),
        x_scale="jac",
        xtol=1e-10,
        ftol=1e-12,
        gtol=1e-10,
        max_nfev=100,
    )
    residuals, jacobian = evaluate(result.x)
    failure = "the simulation failed" if np.all(residuals == FAILED_RESIDUAL) else ""
    return End(start, result.x, float(np.sum(residuals**2)), residuals, jacobian, result.status > 0, failure)
