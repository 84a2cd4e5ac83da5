"""Finding optima: scrambled Sobol starts, descents in batches over a growing horizon, a bounded trust region.

Every start goes its own way: none is moved to where another did well, so that their agreement means something. Every one is
reported with where it ended, failures included.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcfj_jax.core.quantities import rounded
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.stop import check
from calibration.forward.model import Model, build
from calibration.forward.runs import instants, params_at, ran, refusal
from calibration.problem import Problem
from calibration.search.continuation import Interrupted, blocks, continued, named
from calibration.search.descent import Descents, levenberg
from calibration.search.evaluate import evaluator, loosened
from calibration.search.horizon import stages, until
from calibration.search.refinement import End, refined
from calibration.solver_budget import budget

log = logging.getLogger("calibration")

# Descents of a batch: what is kept in the journal at once, and done before a stop is heeded.
BATCH = 12


@dataclass(frozen=True)
class Screen:
    """A Sobol design of unit-box points, their costs up to the second contact (NaN: failed), and how far each
    coordinate moves any residual of all data.
    """

    design: np.ndarray
    costs: np.ndarray
    reach: np.ndarray


def batch_size(count: int) -> int:
    """Size of the batches that ``count`` starts descend in."""
    return -(-count // -(-count // BATCH))


def screen(model: Model, count: int, seed: int) -> Screen:
    """Evaluate a scrambled Sobol design some times as large as the number of starts (``solver_budget``), in batches.

    Raises:
        Interrupted: on Ctrl-C.
    """
    try:
        return _screened(model, count, seed)
    except KeyboardInterrupt:
        raise Interrupted(f"0 of {count}", None, float("nan"), "screening") from None


def _screened(model: Model, count: int, seed: int) -> Screen:
    from scipy.stats import qmc

    size = budget(model).drawn * count
    even = qmc.Sobol(len(model.coordinates), rng=seed).random_base2(int(np.ceil(np.log2(size))))
    design = np.stack([axis.drawn(u) for axis, u in zip(model.coordinates, even.T, strict=True)], axis=1)
    ends, reach = stages(model), np.zeros(design.shape[1])
    first, costs = evaluator(loosened(until(model, ends[0]))), []
    for block in blocks(design, batch_size(count)):
        check()
        residuals, jacobians = first(block)
        costs.append(np.sum(residuals**2, axis=1))
        reach = np.maximum(reach, _reach(jacobians))
    costs = np.concatenate(costs)[: len(design)]
    if len(ends) > 1 and np.any(reach < 1.0):  # What the first contact does not show, all data may.
        few = np.argsort(costs)[: budget(model).asked]
        for block in blocks(design[few], batch_size(count)):
            reach = np.maximum(reach, _reach(evaluator(loosened(model))(block)[1]))
    log.info("%d of %d Sobol points simulate", np.isfinite(costs).sum(), len(design))
    return Screen(design, costs, reach)


def _reach(jacobians: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(jacobians), np.abs(jacobians), 0.0).max(axis=(0, 1), initial=0.0)


class Searched(NamedTuple):
    """The problem, its model at the reference penetration that the best end gives, and all starts' ends, best first.

    Where a body tumbles and the model goes another way after some time, it is the problem up to there; ``said`` says so.
    """

    problem: Problem
    model: Model
    ends: tuple[End, ...]
    said: list[str]


def search(
    problem: Problem,
    model: Model,
    screened: Screen,
    starts: list[np.ndarray],
    count: int,
    journal: Journal | None = None,
) -> Searched:
    """Descend to optima from the best spread of a screened design.

    Args:
        starts: parameter values (SI, one a coordinate) that must be among the starts.
        count: number of starts that descend, >= 2.

    Raises:
        Interrupted: on Ctrl-C.
    """
    design, costs = screened.design, screened.costs
    chosen = np.array([*starts, *model.values(_spread(design, costs, count))])[: max(count, len(starts))]
    model = referred(model, by_cost(design, costs))
    points = np.clip(model.point(chosen), 1e-3, 1 - 1e-3)
    found, followed, shares = continued(model, points, batch_size(len(points)), journal)
    said = []
    if followed is None:
        found = _straight(model, points[: len(starts)], found)
    else:
        problem, said = problem.until(followed), [_lost(followed, shares)]
        model = build(problem, problem.fitted)
    old, model = model, referred(model, by_cost(found.points, found.costs))
    if model is not old:
        points, moved = (model.point(old.values(u)) for u in (points, found.points))
        found = found._replace(points=np.clip(moved, 0.0, 1.0))
    try:
        return Searched(problem, model, refined(model, points, found), said)
    except KeyboardInterrupt:
        k = int(np.argmin(found.costs))
        values, all_of_them = named(model, found.points[k]), f"{len(points)} of {len(points)}"
        raise Interrupted(all_of_them, values, float(found.costs[k]), "refinement") from None


def _lost(followed: np.ndarray, shares: tuple[float, float]) -> str:
    """Up to where records are fitted, and why no farther."""
    times = sorted({f"{t:.3g}" for t in followed}, key=float)
    upto = times[0] if len(times) == 1 else f"{times[0]} to {times[-1]}"
    more = rounded(shares[1] / max(shares[0], 1e-300))
    return (
        f"records are fitted up to {upto} s: farther on a sample costs {more} times as much. "
        "Where a body that tumbles falls next hangs on all its contacts before: a little change of the law or of a first state "
        "leads elsewhere. What helps: records that begin between two contacts"
    )


def _straight(model: Model, points: np.ndarray, found: Descents) -> Descents:
    """Given starts, fitted to all data at once too, where that ends lower: by the first contacts alone they may move too far."""
    if not len(points) or len(stages(model)) == 1:
        return found
    check()
    means = budget(model)
    direct = levenberg(evaluator(model), points, means.descend, means.tolerance)
    lower = np.flatnonzero(direct.costs < found.costs[: len(points)])
    for old, new in zip(found, direct, strict=True):
        old[lower] = new[lower]
    return found


def _spread(design: np.ndarray, costs: np.ndarray, count: int) -> np.ndarray:
    """Half the best points, half taken evenly over the rest: good ones, and some that know nothing."""
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
    good = order[: count - count // 2]
    rest = order[len(good) :]
    rest = rest[np.isfinite(costs[rest])] if np.isfinite(costs[rest]).any() else rest
    return design[np.concatenate([good, rest[:: max(1, len(rest) // max(1, count // 2))][: count // 2]])]


def by_cost(points: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """The points (B, P) that simulate, best first."""
    return points[np.argsort(costs, kind="stable")][: np.isfinite(costs).sum()]


def referred(model: Model, points: Sequence[np.ndarray] | np.ndarray) -> Model:
    """The model with its reference penetration inside the data, at the first point that is a scene's.

    Its logarithm is the force-weighted mean of ln(penetration) over the contact; it stays where there is none.
    """
    point = next((p for p in points if not refusal(model, p)), None) if model.referenced else None
    if point is None:
        return model
    params = params_at(model, point)[0]
    last = max(float(model.data.times[0].max()), *(o.end for o in model.observed_features[:1]), 0.0)
    times = instants(model, 0, params["time_offset"], 0.0, last)
    run = ran(loosened(model), params, times)
    force = np.concatenate([f[..., 0].ravel() for f in run.force.values()])
    depth = np.concatenate([d.ravel() for d in run.penetration.values()])
    inside = (depth > 0) & (force > 0)
    if not inside.any():
        return model
    return model.at_depth(float(np.average(np.log(depth[inside]), weights=force[inside])))
