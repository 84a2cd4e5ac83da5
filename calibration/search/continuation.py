"""All starts through a growing horizon, in batches of one size: ordered by cost and thinned after every leg.

On the way a run is integrated loosely. The horizon grows as far as the model, fitted up to here, meets the contacts to
come; where it misses the next one, to that one only. Of a body that tumbles it stops where the model no longer follows.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.io.journal import Journal
from bcfj_jax.io.stop import check
from calibration.forward.model import Model
from calibration.search.descent import Descents, Evaluate, adam, cost_of, levenberg
from calibration.search.evaluate import evaluator, loosened
from calibration.search.horizon import impulses, meets, stages, tumbles, until
from calibration.solver_budget import budget

log = logging.getLogger("calibration")

_ADAM, _ARRIVE = 20, 12
# On the way this much of the cost is left for the last leg, which sees soon that no more is to be had: of a record
# without noise, what remains is the integrator's.
_LEFT, _AT_REST = 1e-3, 3
# Draws of what the data before a contact leave open, and the farthest, in unit-box coordinates.
_DRAWS, _FARTHEST = 48, 0.3
# How often a start draws, until its arrivals cost less than this share.
_ROUNDS, _HIT = 4, 0.1
# Given up after a leg: starts that cost so much more than the best, on that leg's data, but for some.
_HOPELESS = 4.0
# A body that tumbles is followed no further where a sample costs so many times what it did on the data before, or, if that is
# more, what it would at a tenth of the variance that is assumed of noise. At 10 times, eight measured tosses of a cube are
# followed twice as far, and a fit takes more than 15 CPU minutes in place of three.
_LOST, _LITTLE = 3.0, 0.1


class Interrupted(KeyboardInterrupt):
    """The user stopped a search: how many starts were ``finished`` of how many; ``values`` (SI, by name; None if nothing was
    finished) and ``cost`` of the best, on the data of its ``stage``: "screening", "3 of 6" stages of the horizon, "the
    optimum" or "refinement".
    """

    def __init__(self, finished: str, values: dict[str, float] | None, cost: float, stage: str) -> None:
        super().__init__(f"{finished} starts finished")
        self.finished, self.values, self.cost, self.stage = finished, values, cost, stage


class _Leg(NamedTuple):
    """One pass of the starts: stage of the horizon reached, whether its contacts may be missed, whether it is the last.

    The last is integrated as finely as was asked for.
    """

    reached: int
    missed: bool
    last: bool

    def title(self, stages: int) -> str:
        return "the optimum" if self.last else f"{self.reached + 1} of {stages}"


class Continued(NamedTuple):
    """Where starts end, in their order, with costs on all data; or on those up to ``followed`` (E,) [s], where they are
    followed no further, and what a sample costs there and farther, ``shares``.
    """

    found: Descents
    followed: np.ndarray | None = None
    shares: tuple[float, float] = (0.0, 0.0)


def continued(model: Model, points: np.ndarray, size: int, journal: Journal | None = None) -> Continued:
    """Where all starts (B, P) end.

    Raises:
        Interrupted: on Ctrl-C.
    """
    ends, count = stages(model), len(points)
    at, costs, converged = points.copy(), np.full(count, np.inf), np.zeros(count, dtype=bool)
    going, given_up, best = np.arange(count), np.zeros(0, dtype=int), (np.inf, None)
    tumbling, known = tumbles(model), Continued(Descents(at, costs, converged))
    leg: _Leg | None = _Leg(0, len(ends) > 1, len(ends) == 1 and budget(model).apart)
    while leg is not None:
        part = model if leg.last else loosened(until(model, ends[leg.reached]))
        before = loosened(until(model, ends[leg.reached - 1])) if leg.missed and leg.reached else None

        def descend(block: np.ndarray, part: Model = part, leg: _Leg = leg, before: Model | None = before) -> Descents:
            return _descend(part, block, leg, before)

        least, stage = np.inf, leg.title(len(ends))
        for first in range(0, len(going), size):
            rows = going[first : first + size]
            try:
                done = _once(journal, f"stage {stage} from {first}", at[rows], size, descend)
            except KeyboardInterrupt:
                finished = f"{len(given_up) + (first if leg.last else 0)} of {count}"
                values = None if best[1] is None else named(model, best[1])
                raise Interrupted(finished, values, best[0], stage) from None
            at[rows], costs[rows], converged[rows] = done
            k = int(np.argmin(done.costs))
            if done.costs[k] < least:
                least = float(done.costs[k])
                best = (least, done.points[k])
            more = f", {len(given_up)} given up before" if len(given_up) else ""
            title = first + len(rows), len(going), more, least
            log.info("stage %s: %d of %d starts done%s, best chi2 %.6g", stage, *title)
        if tumbling and not leg.last:
            share = least / max(np.count_nonzero(part.data.weights), 1)
            if known.followed is not None and share > _LOST * max(known.shares[0], _LITTLE):
                return known._replace(shares=(known.shares[0], share))
            # Those given up cost that much on less data.
            most = np.max(costs[going], initial=0.0, where=np.isfinite(costs[going]))
            sums = np.where(np.isin(np.arange(count), going), costs, np.maximum(costs, most))
            known = Continued(Descents(at.copy(), sums, converged.copy()), ends[leg.reached], (share, share))
        if not leg.last:
            going = going[np.argsort(costs[going], kind="stable")]
            hopeless = np.arange(len(going)) >= budget(model).kept
            hopeless &= ~(costs[going] <= _HOPELESS * max(least, float(np.count_nonzero(part.data.weights))))
            given_up = np.concatenate([given_up, going[hopeless]])
            going = going[~hopeless]
        leg = _next(model, leg, ends, blocks(at[going], size)[0])
    for first in range(0, len(given_up), size):
        rows = given_up[first : first + size]
        name = f"given up from {first}"
        costs[rows] = _once(journal, name, at[rows], size, lambda b: _evaluated(model, b)).costs
        converged[rows] = False
    return Continued(Descents(at, costs, converged))


def _next(model: Model, leg: _Leg, ends: list[np.ndarray], points: np.ndarray) -> _Leg | None:
    """The leg after one, given the best batch of points; None after the last."""
    whole = len(ends) - 1
    if leg.last:
        return None
    if leg.reached == whole:
        return _Leg(whole, False, True)
    if model.scene.traits.turning:  # Contacts come when the drive brings them, never far off.
        return _Leg(leg.reached + 1, False, False)
    residuals, _ = evaluator(loosened(model))(points)
    met = meets(model, residuals, ends)
    # The farthest stage up to which most starts meet every contact; the next of a body that tumbles.
    reached, farthest = leg.reached, leg.reached + 1 if tumbles(model) else whole
    while reached < farthest and np.mean(met[:, leg.reached + 1 : reached + 2].all(axis=1)) > 0.5:
        reached += 1
    return _Leg(reached, False, False) if reached > leg.reached else _Leg(leg.reached + 1, True, False)


def blocks(points: np.ndarray, size: int) -> list[np.ndarray]:
    """Blocks of one size; the last one is filled up with the first points."""
    return [points[np.arange(first, first + size) % len(points)] for first in range(0, len(points), size)]


def named(model: Model, point: np.ndarray) -> dict[str, float]:
    """Parameter values, SI, by name, at a unit-box point."""
    several = model.data.times.shape[0] > 1
    names = [
        f"{s.name}[{s.experiment + 1}]" if several and s.experiment is not None else s.name for s in model.coordinates
    ]
    return dict(zip(names, model.values(point).tolist(), strict=True))


def _once(
    journal: Journal | None, name: str, points: np.ndarray, size: int, work: Callable[[np.ndarray], Descents]
) -> Descents:
    """A batch's outcome from the journal, or else worked out and put there."""
    known = journal.get(name) if journal is not None else None
    if not _fits(known, points):
        check()
        made = work(blocks(points, size)[0])
        known = {name: values[: len(points)].tolist() for name, values in made._asdict().items()}
        if journal is not None:
            journal.add(name, known)
    assert known is not None
    costs = [np.inf if cost is None else cost for cost in known["costs"]]
    return Descents(np.array(known["points"]), np.array(costs), np.array(known["converged"], dtype=bool))


def _fits(known: Any, points: np.ndarray) -> bool:
    """Whether what is kept is the outcome of so many points."""
    try:
        shapes = [np.shape(known[name]) for name in Descents._fields]
        return shapes == [points.shape, points.shape[:1], points.shape[:1]]
    except (TypeError, KeyError, ValueError):
        return False


def _descend(part: Model, points: np.ndarray, leg: _Leg, before: Model | None) -> Descents:
    """One batch on one leg: far off by Adam, then to the right arrivals, which the leg ``before`` leaves open, then to the least
    squares.
    """
    evaluate, means = evaluator(part), budget(part)
    if means.apart:
        return levenberg(evaluate, points, means.descend, means.tolerance if leg.last else means.roughly)
    if leg.last:
        return levenberg(evaluate, points, means.descend, means.tolerance, patience=_AT_REST)
    if leg.reached == 0:
        points = adam(evaluate, points, _ADAM)
    if leg.missed:

        def arrivals(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            residuals, jacobians = evaluate(at)
            return impulses(part, residuals), impulses(part, jacobians)

        if before is not None and not means.apart:
            points = _drawn(evaluator(before), arrivals, points)
        points = levenberg(arrivals, points, _ARRIVE, means.roughly).points
    return levenberg(evaluate, points, means.descend, means.roughly, enough=_LEFT)


def _drawn(before: Evaluate, arrivals: Evaluate, points: np.ndarray) -> np.ndarray:
    """Of each point and draws of what the data before leave open, the one that meets the next arrivals best.

    No slope leads to a hard contact from beside. Starts that have met nothing draw again, a few times, while most have not.
    """
    residuals, jacobians = before(points)
    begun, rng = cost_of(arrivals(points)[0]), np.random.default_rng(0)
    best, least = points.copy(), begun.copy()
    for _ in range(_ROUNDS):
        for k, (r, j) in enumerate(zip(residuals, jacobians, strict=True)):
            normal = rng.standard_normal((_DRAWS, points.shape[1]))
            if least[k] < _HIT * begun[k] or not (np.isfinite(r).all() and np.isfinite(j).all()):
                continue
            _, singular, directions = np.linalg.svd(j, full_matrices=False)
            size = np.sqrt(max(float(r @ r) / max(np.count_nonzero(r), 1), 1.0))
            spread = np.minimum(size / np.maximum(singular, 1e-300), _FARTHEST)
            trial = np.clip(points[k] + normal @ (spread[:, None] * directions), 0.0, 1.0)
            costs = cost_of(arrivals(trial)[0])
            if np.min(costs) < least[k]:
                best[k], least[k] = trial[int(np.argmin(costs))], float(np.min(costs))
        if np.mean(least < _HIT * begun) > 0.5:
            break
    return best


def _evaluated(model: Model, points: np.ndarray) -> Descents:
    costs = cost_of(evaluator(model)(points)[0])
    return Descents(points, costs, np.zeros(len(points), dtype=bool))
