"""The last step of a descent: SciPy's bounded trust region on residuals and forward-mode Jacobian, point by point."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from bcfj_jax.xla.threads import each
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
    """Where one start ended: cost of the weighted residuals, these and their Jacobian at ``point`` (of the ends that the
    trust region refined; else empty), whether the optimiser met its own tolerance, and why the end cannot count; "" if it
    can.
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
    order = [int(k) for k in np.argsort(found.costs, kind="stable")]
    first = [k for k in order[:_BEST] if np.isfinite(found.costs[k])]
    # At once where each is a run after the other.
    run = each if budget(model).apart else map
    early = dict(zip(first, run(lambda k: finish(model, starts[k], found.points[k]), first), strict=True))
    for k in order:
        start, point, cost = starts[k], found.points[k], float(found.costs[k])
        low = min((end.cost for end in best), default=cost)
        near = any(np.abs(end.point - point).max() < budget(model).elsewhere for end in best)
        elsewhere = not near and cost < low + _AS_LOW * max(1.0, low / samples)
        if k in early or (np.isfinite(cost) and elsewhere and len(best) < _BEST + _OTHERS):
            ends.append(early.get(k) or finish(model, start, point))
            best.append(ends[-1])
            log.info("refined start %d: chi2 %.6g", k + 1, ends[-1].cost)
        else:
            failure = "" if np.isfinite(cost) else "the simulation failed"
            empty = np.zeros((0, point.size))
            ends.append(End(start, point, cost, empty[:, 0], empty, bool(found.converged[k]), failure))
    # The best is one that was refined: another may seem lower by the integration's own error, no more.
    first = min(best, key=lambda end: (bool(end.failure), end.cost), default=None)
    return tuple(sorted(ends, key=lambda end: (end is not first, bool(end.failure), end.cost)))


class Refined(NamedTuple):
    """Where a trust region ended: the point (P,), residuals and Jacobian there, and whether it met a tolerance."""

    point: np.ndarray
    residuals: np.ndarray
    jacobian: np.ndarray
    converged: bool

    @property
    def failed(self) -> bool:
        """Whether nothing simulates there."""
        return bool(np.all(self.residuals == FAILED_RESIDUAL))


def trust_region(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], point: np.ndarray, bounds: Any = (0.0, 1.0), **options: Any
) -> Refined:  # fmt: skip
    """Least squares within bounds (SciPy TRF) by residuals (N,) and Jacobian (N, P) of a point; ``options`` are SciPy's."""
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def kept(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if u.tobytes() not in seen:
            seen.clear()
            residuals, jacobian = evaluate(u)
            if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
                residuals, jacobian = np.full_like(residuals, FAILED_RESIDUAL), np.zeros_like(jacobian)
            seen[u.tobytes()] = residuals, jacobian
        return seen[u.tobytes()]

    if not point.size:
        return Refined(point, *kept(point), True)
    slopes: Any = lambda u: kept(u)[1]  # noqa: E731
    found = least_squares(lambda u: kept(u)[0], point, jac=slopes, bounds=bounds, x_scale="jac", **options)
    return Refined(found.x, *kept(found.x), found.status > 0)


def finish(model: Model, start: np.ndarray, point: np.ndarray) -> End:
    """One start brought to its optimum by the trust region, from a point."""
    at, means = evaluation(model), budget(model)

    def evaluate(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = at(u[None])
        return found.residuals[0], found.jacobians[0]

    limits = {"xtol": means.step, "ftol": means.gain, "gtol": 1e-10, "max_nfev": 100}
    found = trust_region(evaluate, point, loss=model.loss, **limits)
    failure = "the simulation failed" if found.failed else refusal(model, found.point)
    cost = float(model.cost(found.residuals))
    return End(start, found.point, cost, found.residuals, found.jacobian, found.converged, failure)
