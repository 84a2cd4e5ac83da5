"""The last step of a descent: SciPy's bounded trust region on residuals and forward-mode Jacobian, point by point."""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calibration.forward.model import Model, evaluation
from calibration.forward.runs import refusal
from calibration.search.descent import Descents
from calibration.solver_budget import budget

log = logging.getLogger("calibration")

# A residual of a failed simulation: far above any real one, finite so that the trust region backs off.
FAILED_RESIDUAL = 1e4
# Refined by the trust region: the best few, and so many others at most that ended elsewhere about as low.
_BEST, _OTHERS, _AS_LOW = 3, 9, 25.0


@dataclass(frozen=True)
class End:
    """Where one start ended.

    Attributes:
        start, point: unit-box coordinates before and after.
        cost: of the weighted residuals, the sum of their squares or what the loss makes of it.
        residuals, jacobian: at ``point``, of the ends that the trust region refined; else empty.
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


def refined(model: Model, starts: np.ndarray, found: Descents) -> tuple[End, ...]:
    """Ends, best first; those that matter brought to their optimum by the trust region."""
    samples = max(int(np.count_nonzero(model.data.weights)), 1)
    ends: list[End] = []
    best: list[End] = []
    order = np.argsort(found.costs, kind="stable")
    early: dict[int, End] = {}
    if budget(model.scene).apart:  # Side by side: each is a run after the other.
        first = [int(k) for k in order[:_BEST] if np.isfinite(found.costs[k])]
        with ThreadPoolExecutor(len(first) or 1) as pool:
            done = pool.map(lambda k: finish(model, starts[k], found.points[k]), first)
            early = dict(zip(first, done, strict=True))
    for k in order:
        start, point, cost = starts[k], found.points[k], float(found.costs[k])
        low = min((end.cost for end in best), default=cost)
        near = any(np.abs(end.point - point).max() < budget(model.scene).elsewhere for end in best)
        elsewhere = not near and cost < low + _AS_LOW * max(1.0, low / samples)
        if np.isfinite(cost) and (len(best) < _BEST or (elsewhere and len(best) < _BEST + _OTHERS)):
            ends.append(early.get(int(k)) or finish(model, start, point))
            best.append(ends[-1])
            log.info("refined start %d: chi2 %.6g", k + 1, ends[-1].cost)
        else:
            failure = "" if np.isfinite(cost) else "the simulation failed"
            empty = np.zeros((0, point.size))
            ends.append(End(start, point, cost, empty[:, 0], empty, bool(found.converged[k]), failure))
    # The best is one that was refined: another may seem lower by the integration's own error, no more.
    first = min(best, key=lambda end: (bool(end.failure), end.cost), default=None)
    return tuple(sorted(ends, key=lambda end: (end is not first, bool(end.failure), end.cost)))


def finish(model: Model, start: np.ndarray, point: np.ndarray) -> End:
    """Bounded trust region (SciPy TRF) on residuals and forward-mode Jacobian from one point."""
    at = evaluation(model)
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def evaluate(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = u.tobytes()
        if key not in seen:
            seen.clear()
            residuals, jacobian = (part[0] for part in at(u[None])[:2])
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
        xtol=budget(model.scene).step,
        ftol=budget(model.scene).gain,
        gtol=1e-10,
        max_nfev=100,
        loss=model.loss,
    )
    residuals, jacobian = evaluate(result.x)
    failed = np.all(residuals == FAILED_RESIDUAL)
    failure = "the simulation failed" if failed else refusal(model, result.x)
    return End(start, result.x, float(model.cost(residuals)), residuals, jacobian, result.status > 0, failure)
