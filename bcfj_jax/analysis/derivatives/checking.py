"""From solves at several tolerances, and central differences beside them, to a certificate.

Central differences are taken of forces that were computed without any derivative: along one random direction of all
parameters first, of each parameter alone where that one disagrees, the strongest first, since the budget may end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives import certificate as verdicts
from bcfj_jax.analysis.derivatives.bounds import Budget, Climb, safer, target
from bcfj_jax.analysis.derivatives.certificate import Certificate, Check, Comparison, Seen
from bcfj_jax.analysis.derivatives.differences import Beside as Runs
from bcfj_jax.analysis.derivatives.differences import against, scales
from bcfj_jax.analysis.derivatives.differences import direction as random_direction
from bcfj_jax.analysis.derivatives.jacobian import forces
from bcfj_jax.analysis.derivatives.norms import norm
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.core.progress import stage
from bcfj_jax.io.stop import OutOfTime
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import MAX_STEPS, Plan, plan

# Pitches of steady motion over which central differences are taken.
_PITCHES = 2
# Difference from central differences that is looked into.
_SEEN = 1e-3
_TOGETHER = "central differences along one random direction of all parameters"


class Beside(NamedTuple):
    """What central differences found: of all parameters together, None where none was made, and of each alone.

    Attributes:
        both: along the random direction.
        alone: by number of the parameter.
        also: (P,) in words, the comparison that each passed with the others, or "".
        unchecked: (P,) why one was not compared, in a sentence, or "".
    """

    both: Comparison | None
    alone: Mapping[int, Comparison]
    also: Sequence[str]
    unchecked: Sequence[str]


def unasked(problem: Problem) -> Beside:
    """No central differences."""
    nothing = [""] * len(problem.names)
    return Beside(None, {}, nothing, nothing)


def beside(problem: Problem, climbed: Climb, histories: Sequence[Comparison], each: bool, spend: Budget) -> Beside:
    """Compare R with central differences.

    Args:
        problem: what is differentiated.
        climbed, histories: its solves, and what bounds their histories.
        each: whether of each parameter alone, whatever all together show.
        spend: time for it.
    """
    values, last = problem.values, climbed.last
    if not last.good or any(map(verdicts.chaotic, verdicts.growths(problem.times, last, values), histories)):
        return unasked(problem)
    fine = finer(problem.scene, problem.error * last.tolerance / climbed.levels[0].tolerance)
    # Values alone, by the program of ``simulate``.
    how = Plan(plan(problem.scene, fine).tolerance, last_budget(last.steps))
    short, every = _shortened(problem)
    count, names = len(short), problem.names
    slopes = verdicts.flat(last.derivative.force)[:, :count]
    size = last.value.force.reshape(len(problem.times), -1)[:count]
    step = np.array([scales(short, p, size, d) for p, d in zip(values, slopes, strict=True)])

    def run(at: np.ndarray) -> np.ndarray:
        return forces(problem.scene, problem.moved(at), every, how).reshape(len(every), -1)[:count]

    runs = Runs(short, run, values, fine, problem.width)

    def along(what: str, way: np.ndarray, enough: float) -> Comparison:
        slope = np.tensordot(way, slopes, 1)
        with stage(f"comparing with {what}"):
            compared = spend.on(lambda: against(runs, way, slope, what, enough))
        early = count < len(problem.times) and not np.isfinite(compared.until)
        return compared._replace(what=f"{compared.what}, until {short[-1]:.4g} s") if early else compared

    both, also, unchecked = None, [""] * len(names), [""] * len(names)
    if not each and np.any(step):
        way = step * random_direction(len(names))
        # What the levels know of needs no second witness.
        sizes = np.abs(way) * norm(short, slopes) / max(float(norm(short, np.tensordot(way, slopes, 1))), 1e-300)
        stated = [(c.pointwise.relative, c.average.relative) for c in histories]
        known = np.maximum(np.nan_to_num(sizes @ np.array(stated), nan=np.inf), _SEEN)
        try:
            both = along(_TOGETHER, way, known[0])
        except OutOfTime:
            unchecked = [f"central differences do not check it: {spend.over}" if s else "" for s in step]
        if both is not None:
            each = bool(both.pointwise.relative > known[0] or both.average.relative > known[1]) and not both.vague
            if np.isfinite(both.until) and not each:
                late = f"central differences check nothing after {both.until:.4g} s: a run beside this one failed there"
                unchecked = [late] * len(names)
            # A parameter at 0 was not moved.
            also = [both.what if s and not each and not both.vague else "" for s in step]
    strength, alone = verdicts.influences(problem.times, last, values), {}
    for k in sorted(np.flatnonzero(step).tolist() if each else (), key=lambda k: -strength[k]):
        unit = np.where(np.arange(len(names)) == k, step, 0.0)
        try:
            alone[k] = safer(along("central differences", unit, max(_SEEN, histories[k].pointwise.relative)))
        except OutOfTime:
            late = f"central differences do not check it alone: {spend.over}"
            unchecked[k] = verdicts.joined(unchecked[k], late)
    return Beside(both, alone, also, unchecked)


def certified(
    problem: Problem, climbed: Climb, histories: Sequence[Comparison], features: np.ndarray, found: Beside
) -> Certificate:
    """The certificate, from what bounds histories and features (F, P), and from central differences."""
    last, both = climbed.last, found.both
    grown = verdicts.growths(problem.times, last, problem.values)
    strength = verdicts.influences(problem.times, last, problem.values)
    table, end = problem.by_name(features), last.end if not last.good else float("nan")
    checks: dict[str, Check] = {}
    for k, name in enumerate(problem.names):
        comparisons = [histories[k], *([found.alone[k]] if k in found.alone else [])]
        unchecked = verdicts.joined(climbed.unchecked, found.unchecked[k])
        vague = both is not None and both.vague
        seen = Seen(table[name], grown[k], float(strength[k]), end, found.also[k], unchecked, vague)
        checks[name] = verdicts.check(comparisons, seen)
    direction = None
    if both is not None and not both.vague:
        direction = {"pointwise": both.pointwise.relative, "average": both.average.relative}
    tolerances, steps = (tuple(getattr(r, key) for r in climbed.levels) for key in ("tolerance", "steps"))
    return Certificate(
        verdicts.worst_verdict(checks), checks, problem.width, target(problem.error), tolerances, steps, direction,
        last.tolerance,
    )  # fmt: skip


def _shortened(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Times that differences are taken over, and as many times as there were, so that one program serves both.

    What repeats itself after a pitch is compared until a few pitches after the start is forgotten.
    """
    scene, times = problem.scene, problem.times
    if not scene.recurs(problem.params):
        return times, times
    end = scene.settled_from(problem.params) + _PITCHES * scene.period(problem.params)[1]
    end = min(end, problem.fold.end) if problem.fold else end
    count = int(np.searchsorted(times, end, side="right"))
    if not 2 <= count < len(times):
        return times, times
    apart = 1e-9 * (times[count] - times[count - 1]) * np.arange(1, len(times) - count + 1) / len(times)
    return times[:count], np.concatenate([times[:count], times[count - 1] + apart])


def finer(scene: AbstractModel, error: float) -> float:
    """Error of the forces that differences are taken of: their noise is amplified by 1/h."""
    return max(min(error, 1e-5 if scene.traits.stiff else 1e-7), 1e-9)


def last_budget(steps: int) -> int:
    """Steps allowed to the forces that differences are taken of: four times those of the derivatives, or more.

    Few different numbers, since each is a program of its own.
    """
    allowed = MAX_STEPS
    while allowed < 4 * steps:
        allowed *= 10
    return allowed
