"""Finding optima: scrambled Sobol starts, descents in batches over a growing horizon, a bounded trust region.

Every start goes its own way: none is moved to where another did well, so that their agreement means something.
Starts descend in batches of one size, one compiled program for all. After each stage they are ordered by cost, so that
those that have arrived go on together and wait for none that has not; of many, those that are far off are given up.
Nothing here judges: every start is reported with where it ended, failures included.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from bcfj_jax import simulate
from calibration.descent import Lanes, adam, cost_of, levenberg
from calibration.evaluate import evaluator as evaluator
from calibration.horizon import impulses, stages, until
from calibration.journal import Journal
from calibration.model import Model, dear
from calibration.polish import End as End
from calibration.polish import finish as finish
from calibration.polish import polished

log = logging.getLogger("calibration")

# Lanes of a batch. On a CPU a bounce costs in proportion to them, the joint hardly more; all wait for the slowest.
LANES = 12
_ADAM, _ARRIVE, _DESCEND = 40, 12, 40
# What the batched descent may leave to gain, in units of cost / residuals, on the way and at the end: the judge
# distinguishes 0.1.
_ROUGHLY, _TOLERANCE = 1.0, 1e-2
# Given up after a stage: starts beyond the first batch that cost so much more than the best, on that stage's data.
_HOPELESS = 4.0
# Points of a dear model's design that are asked what all data tell of each coordinate.
_FEW = 4


@dataclass(frozen=True)
class Screen:
    """A Sobol design of unit-box points, their costs up to the second contact (NaN: failed), and how far each
    coordinate moves any residual of all data.
    """

    design: np.ndarray
    costs: np.ndarray
    reach: np.ndarray


@dataclass(frozen=True)
class Search:
    """All starts' ends, best first, and the logarithm of the reference penetration used."""

    ends: tuple[End, ...]
    log_depth: float


class Interrupted(KeyboardInterrupt):
    """The user stopped a search; what is best so far is told.

    Attributes:
        finished: how many starts were done, of how many.
        values: SI, by name, of the best; None if nothing was finished.
        cost: of it, on the data of its stage.
        stage: "3 of 6", or "polish" after them.
    """

    def __init__(self, finished: str, values: dict[str, float] | None, cost: float, stage: str) -> None:
        super().__init__(f"{finished} starts finished")
        self.finished, self.values, self.cost, self.stage = finished, values, cost, stage


def lanes(count: int) -> int:
    """Size of the batches that ``count`` starts descend in."""
    return -(-count // -(-count // LANES))


def screen(model: Model, count: int, seed: int) -> Screen:
    """Evaluate a scrambled Sobol design some eight times as large as the number of starts, in batches.

    Args:
        model: residual function.
        count: number of starts to come.
        seed: of the scrambling.
    """
    design = qmc.Sobol(len(model.slots), rng=seed).random_base2(3 + int(np.ceil(np.log2(count))))
    ends, depth, reach = stages(model), 0.0, np.zeros(design.shape[1])
    first, costs = evaluator(until(model, ends[0]), depth), []
    for block in _blocks(design, lanes(count)):
        residuals, jacobians = first(block)
        costs.append(np.sum(residuals**2, axis=1))
        reach = np.maximum(reach, _reach(jacobians))
    if len(ends) > 1:  # What the first contact does not show, a few points of all data will.
        few = np.argsort(np.concatenate(costs)[: len(design)])[:_FEW] if dear(model.scene) else np.arange(64)
        for block in _blocks(design[few], lanes(count)):
            reach = np.maximum(reach, _reach(evaluator(model, depth)(block)[1]))
    costs = np.concatenate(costs)[: len(design)]
    log.info("%d of %d Sobol points simulate", np.isfinite(costs).sum(), len(design))
    return Screen(design, costs, reach)


def _reach(jacobians: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(jacobians), np.abs(jacobians), 0.0).max(axis=(0, 1), initial=0.0)


def _blocks(points: np.ndarray, size: int) -> list[np.ndarray]:
    """Blocks of one size, so that they share one program; the last one is filled up with the first points."""
    return [points[np.arange(first, first + size) % len(points)] for first in range(0, len(points), size)]


def search(
    model: Model, screened: Screen, starts: list[np.ndarray], count: int, journal: Journal | None = None
) -> Search:
    """Descend to optima from the best spread of a screened design.

    Args:
        model: residual function.
        screened: the design, from ``screen``.
        starts: parameter values (SI, one a slot) that must be among the starts.
        count: number of starts that descend, >= 2.
        journal: where finished batches are kept, and taken from.

    Raises:
        Interrupted: on Ctrl-C.
    """
    design, costs = screened.design, screened.costs
    chosen = [values_at(model, u, 0.0) for u in _spread(design, costs, count)]
    chosen = [*starts, *chosen][: max(count, len(starts))]
    log_depth = 0.0
    if model.referenced and np.isfinite(costs).any():
        log_depth = reference_depth(model, design[int(np.nanargmin(costs))], log_depth)
    points = np.clip([model.point(v, log_depth) for v in chosen], 1e-3, 1 - 1e-3)
    found = _staged(model, points, log_depth, lanes(len(points)), journal)
    if model.referenced and np.isfinite(found.costs).any():
        old, best = log_depth, int(np.argmin(found.costs))
        log_depth = reference_depth(model, found.points[best], old)
        points, moved = (
            np.array([model.point(values_at(model, u, old), log_depth) for u in several])
            for several in (points, found.points)
        )
        found = found._replace(points=np.clip(moved, 0.0, 1.0))
    try:
        return Search(polished(model, points, found, log_depth), log_depth)
    except KeyboardInterrupt:
        k = int(np.argmin(found.costs))
        values, all_of_them = _named(model, found.points[k], log_depth), f"{len(points)} of {len(points)}"
        raise Interrupted(all_of_them, values, float(found.costs[k]), "polish") from None


def values_at(model: Model, point: np.ndarray, log_depth: float) -> np.ndarray:
    """Parameter values, SI, one a slot, at a unit-box point."""
    return np.array([float(v) for v in model.values(jnp.asarray(point), jnp.asarray(log_depth))])


def _named(model: Model, point: np.ndarray, log_depth: float) -> dict[str, float]:
    several = model.data.times.shape[0] > 1
    names = [f"{s.name}[{s.experiment + 1}]" if several and s.experiment is not None else s.name for s in model.slots]
    return dict(zip(names, values_at(model, point, log_depth).tolist(), strict=True))


def _spread(design: np.ndarray, costs: np.ndarray, count: int) -> np.ndarray:
    """Half the best points, half taken evenly over the rest: good ones, and some that know nothing."""
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
    good = order[: count - count // 2]
    rest = order[len(good) :]
    rest = rest[np.isfinite(costs[rest])] if np.isfinite(costs[rest]).any() else rest
    return design[np.concatenate([good, rest[:: max(1, len(rest) // max(1, count // 2))][: count // 2]])]


def reference_depth(model: Model, point: np.ndarray, log_depth: float) -> float:
    """Force-weighted mean of ln(penetration) over the contact at a point: a depth inside the data."""
    params = {name: float(v[0]) for name, v in model.data.fixed.items()}
    for slot, value in zip(model.slots, values_at(model, point, log_depth), strict=True):
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


def _staged(model: Model, points: np.ndarray, log_depth: float, size: int, journal: Journal | None) -> Lanes:
    """All starts through all stages; costs and points in the order of ``points``, costs on all data."""
    ends, count = stages(model), len(points)
    at, costs, converged = points.copy(), np.full(count, np.inf), np.zeros(count, dtype=bool)
    going, given_up, best = np.arange(count), np.zeros(0, dtype=int), (np.inf, None)
    for number, end in enumerate(ends):
        part = until(model, end)
        whole = number == len(ends) - 1

        def descend(block: np.ndarray, part: Model = part, number: int = number) -> Lanes:
            return _descend(part, block, log_depth, number, len(ends))

        least = np.inf
        for first in range(0, len(going), size):
            lane = going[first : first + size]
            try:
                done = _kept(journal, f"stage {number} from {first}", at[lane], size, descend)
            except KeyboardInterrupt:
                finished = f"{len(given_up) + (first if whole else 0)} of {count}"
                values = None if best[1] is None else _named(model, best[1], log_depth)
                raise Interrupted(finished, values, best[0], f"{number + 1} of {len(ends)}") from None
            at[lane], costs[lane], converged[lane] = done
            k = int(np.argmin(done.costs))
            if done.costs[k] < least:
                least = float(done.costs[k])
                best = (least, done.points[k])
            _tell(number, len(ends), first + len(lane), len(going), len(given_up), least)
        if not whole:
            going = going[np.argsort(costs[going], kind="stable")]
            hopeless = np.arange(len(going)) >= size
            hopeless &= ~(costs[going] <= _HOPELESS * max(least, float(np.count_nonzero(part.data.weights))))
            given_up = np.concatenate([given_up, going[hopeless]])
            going = going[~hopeless]
    for first in range(0, len(given_up), size):
        lane = given_up[first : first + size]
        at_end = _kept(journal, f"given up from {first}", at[lane], size, lambda b: _evaluated(model, b, log_depth))
        costs[lane], converged[lane] = at_end.costs, False
    return Lanes(at, costs, converged)


def _tell(stage: int, stages: int, done: int, of: int, given_up: int, least: float) -> None:
    more = f", {given_up} given up before" if given_up else ""
    log.info("stage %d of %d: %d of %d starts done%s, best chi2 %.6g", stage + 1, stages, done, of, more, least)


def _kept(
    journal: Journal | None, name: str, points: np.ndarray, size: int, work: Callable[[np.ndarray], Lanes]
) -> Lanes:
    """A batch's outcome from the journal, or else worked out and put there."""
    known = journal.get(name) if journal is not None else None
    if known is None:
        made = work(_blocks(points, size)[0])
        known = {name: values[: len(points)].tolist() for name, values in made._asdict().items()}
        if journal is not None:
            journal.add(name, known)
    costs = [np.inf if cost is None else cost for cost in known["costs"]]
    return Lanes(np.array(known["points"]), np.array(costs), np.array(known["converged"], dtype=bool))


def _descend(part: Model, points: np.ndarray, log_depth: float, stage: int, stages: int) -> Lanes:
    """One batch on one stage's data: far off by Adam, then to the right arrivals, then to the least squares."""
    evaluate = evaluator(part, log_depth)
    if stage == 0 and not dear(part.scene):
        points = adam(evaluate, points, _ADAM)
    if stages > 1 and not dear(part.scene):  # A joint's contacts come when its drive brings them, never far off.

        def arrivals(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            residuals, jacobians = evaluate(at)
            return impulses(part, residuals), impulses(part, jacobians)

        points = levenberg(arrivals, points, _ARRIVE, _ROUGHLY).points
    return levenberg(evaluate, points, _DESCEND, _TOLERANCE if stage == stages - 1 else _ROUGHLY)


def _evaluated(model: Model, points: np.ndarray, log_depth: float) -> Lanes:
    costs = cost_of(evaluator(model, log_depth)(points)[0])
    return Lanes(points, costs, np.zeros(len(points), dtype=bool))
