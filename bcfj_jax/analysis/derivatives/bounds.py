"""Bounds of derivatives, from solves at tolerances far apart.

R is the derivative that is reported, T that of a far tighter solve, C that of one in between, D the exact one:

    |R - D| <= |R - T| + |T - D|,    |T - D| <= |C - T|  where T is at most half as wrong as C,
    stated = 1.2 |R - T| + |C - T|.

An explicit method's errors of derivatives do not fall evenly with the tolerance, although its steps end where contacts begin
and end: two solves a factor 4 apart agree by luck. From R to C and from C to T the tolerance falls by 16, which costs at
most 1.7 times the steps each. BDF has the tangents' error in its step control, and its errors fall evenly: T is R's
at a tolerance 40 times tighter, which costs 1.4 times the steps, and there is no C. The factor 1.2 pays for T's error. These
three numbers were chosen on some scenes and are held to others by ``benchmarks/analysis/derivative_bounds.py``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import INF, INFLUENCE, NAN, Comparison, apart
from bcfj_jax.analysis.derivatives.jacobian import Level
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.trains import STIFF
from bcfj_jax.core.progress import stage
from bcfj_jax.io.stop import OutOfTime, within
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.xla.threads import together

SAFETY = 1.2
# |C - T| over |R - T| above which solves are not seen to converge.
_WELL = 0.5
# Share of the target that a pitch may be off the one before, of derivatives that are read pitches earlier.
_UNEVEN = 0.3
# By whether the model is stiff: solves that a bound takes; the ratio of their tolerances; the tightest that there is.
NEEDED, APART = {False: 3, True: 2}, {False: 16.0, True: 40.0}
_TIGHTEST = {False: 1e-14, True: 2.5e-13}
T = TypeVar("T")


class Climb(NamedTuple):
    """Solves of one problem, loosest first: the last ``needed`` that are good are R, C and T, or R and T.

    ``unchecked``: why T is missing, in a sentence, or "".
    """

    levels: tuple[Level, ...]
    needed: int
    unchecked: str = ""

    @property
    def _good(self) -> tuple[Level, ...]:
        return tuple(r for r in self.levels if r.good)[-self.needed :]

    @property
    def bounded(self) -> bool:
        """Whether all that are needed are there."""
        return len(self._good) == self.needed

    @property
    def last(self) -> Level:
        """R, whose derivatives are reported; where none is good, the last that failed."""
        return self._good[0] if self._good else self.levels[-1]

    @property
    def beside(self) -> tuple[Level, Level] | None:
        """C and T, the same where there is one; None where there is none."""
        return (self._good[1], self._good[-1]) if len(self._good) > 1 else None

    def uneven(self, count: int) -> np.ndarray:
        """By how much the tightest solve's last pitch is off the one before, by parameter (P,); 0 of what was solved whole."""
        found = (self.beside[-1] if self.beside else self.last).uneven[1:]
        return found if found.size else np.zeros(count)

    def repeats(self, problem: Problem) -> bool:
        """Whether the last pitch repeats the one before well enough."""
        return bool(np.all(self.uneven(len(problem.names)) <= _UNEVEN * target(problem.error)))


class Budget:
    """Seconds for comparisons, compiling included: none is begun that is not expected to end within, by the quickest."""

    def __init__(self, seconds: float | None):
        self.seconds, self.left, self.quickest = seconds, seconds or 0.0, 0.0

    def on(self, comparing: Callable[[], T], expected: float | None = None) -> T:
        """What a comparison gives.

        Raises:
            OutOfTime: where it did not end within the budget, or was not begun, since as much is ``expected`` [s].
        """
        if self.seconds is None:
            return comparing()
        begin = time.perf_counter()
        least = self.quickest if expected is None else expected
        try:
            found = within(self.left if least <= self.left else 0.0, comparing)
        finally:
            took = time.perf_counter() - begin
            self.left -= took
        self.quickest = min(self.quickest or took, took) if expected is None else self.quickest
        return found

    @property
    def over(self) -> str:
        """Why a comparison is missing."""
        return f"the budget of {self.seconds:g} s was spent, compiling included"


def first_plan(scene: AbstractModel, how: Plan, error: float) -> Plan:
    """How R is solved at first: with steps that are chosen for derivatives; of a stiff model so tightly that they can be."""
    if not scene.traits.stiff:
        return Plan(how.tolerance, how.max_steps, tangents=True)
    good = plan(scene, min(error, STIFF), how.max_steps)
    return Plan(np.minimum(how.tolerance, good.tolerance), how.max_steps, good.tangents)  # pyright: ignore[reportArgumentType]


def climb(
    problem: Problem, how: Plan, levels: int, spend: Budget, first: Callable[[Level], None] = lambda level: None,
    before: Callable[[], None] = lambda: None,
) -> Climb:  # fmt: skip
    """Solve R, C and T, and go on until the averages of R are within ``target``, or nothing helps.

    By ``levels`` tightenings at most; 0 for R alone. ``spend``: time for what is tighter than the first two. ``first``
    receives the first solve as soon as it has ended, beside the second; ``before`` is done ahead of it.
    """
    scene, stiff = problem.scene, problem.scene.traits.stiff
    how = first_plan(scene, how, problem.error) if levels else how
    tolerances = _ladder(float(how.tolerance), stiff, levels)

    def solve(tolerance: float) -> Level:
        at: Any = np.asarray(tolerance)
        return problem.solve(Plan(at, how.max_steps, how.tangents))

    def told(tolerance: float) -> Level:
        before()
        found = solve(tolerance)
        first(found)
        return found

    with stage("solving with derivatives at two tolerances" if levels else "solving with derivatives"):
        found = list(together(partial(told, tolerances[0]), *(partial(solve, each) for each in tolerances[1:2])))
    now, why = Climb(tuple(found), NEEDED[stiff]), ""
    for tolerance in tolerances[2:] if scene.traits.history else ():
        if now.bounded and _enough(problem, now):
            break
        longer = (found[-1].tolerance / tolerance) ** 0.2
        if not found[-1].good or 2.0 * longer * found[-1].steps > how.max_steps:
            why = "it failed" if not found[-1].good else f"it would take more than {how.max_steps} steps"
            break
        with stage(f"solving with derivatives, tolerance {len(found) + 1} of {len(tolerances)} at most"):
            try:
                found.append(spend.on(partial(solve, tolerance), longer * found[-1].wall_s))
            except OutOfTime:
                why = spend.over
                break
        now = now._replace(levels=tuple(found))
    if now.bounded or not scene.traits.history or not now.last.good:
        return now
    why = why or ("no tightening was left for it" if found[-1].good else "it failed")
    return now._replace(unchecked=f"no far tighter solve bounds its error: {why}")


def _enough(problem: Problem, now: Climb) -> bool:
    """Whether the averages of all that has influence are within the limit, or nothing is gained by going on."""
    every, strong = bounded(problem, now), problem.influences(now.last) > INFLUENCE
    worst = max((c.average.relative for c, s in zip(every, strong, strict=True) if s), default=0.0)
    return worst <= target(problem.error) or (worst > 0.5 and problem.chaotic(now.last, every))


def _ladder(tolerance: float, stiff: bool, levels: int) -> list[float]:
    """Tolerances, loosest first: R's, and as many tighter ones as are allowed and are above rounding."""
    apart, least = APART[stiff], min(tolerance, _TIGHTEST[stiff])
    needed = min(NEEDED[stiff], levels + 1)
    # Near rounding as far apart as there is room.
    apart = min(apart, (tolerance / least) ** (1.0 / max(needed - 1, 1)))
    ladder = [tolerance * apart**-k for k in range(levels + 1)]
    return [x for k, x in enumerate(ladder) if k < needed or x >= least]


def bounded(problem: Problem, climb: Climb) -> list[Comparison]:
    """What bounds the error of R's histories, one comparison a parameter; infinite where R is alone."""
    if climb.beside is None:
        # Nothing is known of R beyond the time at which a solve beside it failed.
        broken = min((r.end for r in climb.levels if not r.good), default=NAN)
        alone = problem.between(climb.last, climb.last)
        unknown = [[x._replace(relative=INF, broken=broken) for x in (c.pointwise, c.average)] for c in alone]
        return [c._replace(pointwise=x, average=y) for c, (x, y) in zip(alone, unknown, strict=True)]
    between, tight = climb.beside
    stated, far, near = [], problem.between(climb.last, tight), problem.between(between, tight)
    for a, b, off in zip(far, near, climb.uneven(len(problem.names)), strict=True):
        one = a.with_relative(lambda x, own, off=off: SAFETY * x + own + off, b)
        stated.append(one._replace(unbounded=b.average.relative > _WELL * a.average.relative))
    return stated


def feature_bounds(slopes: Sequence[np.ndarray], numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Bounds (F, P) of the derivatives of features (F,) by parameters (P,): relative, of R's, from R's, C's and T's."""
    reported, between, tight = slopes
    off, own = (apart(x, tight, numbers, values) for x in (reported, between))
    return SAFETY * off + own


def luckless(climb: Climb, histories: Sequence[Comparison]) -> np.ndarray:
    """Least bounds (P,) of features' derivatives from those of their histories.

    One number of R and of T may agree by luck where there is no C; a history does not. Half of its bound is then the least.
    What is read pitches earlier is off by what its last pitch is off the one before.
    """
    uneven = climb.uneven(len(histories))
    if climb.needed > 2 or not climb.bounded:
        return uneven
    return np.maximum(uneven, [0.5 * min(c.pointwise.relative, c.average.relative) for c in histories])


def target(error: float) -> float:
    """Bound of the averages at which the tightening ends: 10 % fast, 3 % balanced, 1 % reference."""
    return float(np.clip(3.0 * error, 0.01, 0.10))
