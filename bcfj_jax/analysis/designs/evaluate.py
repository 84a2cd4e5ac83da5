"""The objective and its gradient at many points of the unit box: one compiled batch, whatever asks.

One program makes the runs and their tangents, NumPy the objective out of them, so that another objective compiles
nothing. Equilibria are all searched for from those of the given design. A point that is refused (a
joint that does not assemble) or whose run fails is NaN, with its reason.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from bcfj_jax.analysis.derivatives.batch import More, Runs, alone, run
from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.steady import Restless, to_the_end, turn
from bcfj_jax.analysis.designs.objective import Objective, measured, sampled
from bcfj_jax.analysis.designs.space import Space
from bcfj_jax.analysis.engine import columns, refusal
from bcfj_jax.core.dual import Dual
from bcfj_jax.core.status import OK, STEEP, reason
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import Plan, Points
from bcfj_jax.xla import backend
from bcfj_jax.xla.threads import cores, each


class Values(NamedTuple):
    """At N points: what the descent sees, its gradient by unit coordinates, and the true objective."""

    # (N,) with norms or crests in place of peaks, times the objective's sign, which makes less better.
    smooth: np.ndarray
    slope: np.ndarray  # (N, P)
    goal: np.ndarray  # (N,) as ``smooth``, always with crests: by it points are compared
    true: np.ndarray  # (N,) with greatest samples, without that sign
    reasons: list[str]  # (N,) why a point has no value; "" where it has one


@dataclass
class Spent:
    """What was spent: batches, points that were asked for, seconds, and failures by reason."""

    batches: int = 0
    points: int = 0
    wall_s: float = 0.0
    compile_s: float = 0.0
    failures: Counter = field(default_factory=Counter)

    def batch(self, begin: float, compile_s: float) -> None:
        """Account for one that began at a ``time.perf_counter()``."""
        self.batches += 1
        self.wall_s += time.perf_counter() - begin - compile_s
        self.compile_s += compile_s

    def why(self) -> str:
        """The most frequent failures, with their numbers."""
        return ", ".join(f"{text} ({n})" for text, n in self.failures.most_common(3))


# Of every point its histories and their derivatives per SI unit, or why there are none.
_Read = list[tuple[Histories, Histories] | str]


@dataclass(frozen=True)
class Evaluator:
    """A scene's objective over the unit box of its free parameters."""

    # scene, params, times, how: as force_history takes them.
    scene: AbstractModel
    params: Params
    times: np.ndarray
    how: Plan
    # space, objective: what is free, what is made least.
    space: Space
    objective: Objective
    batch: int  # points in one batch
    spent: Spent = field(default_factory=Spent)  # the account of all calls
    # When the runs end [s] whose steady motion is looked at (``derivatives.steady``); ``times`` are then shares of a
    # turn. None for the runs themselves.
    steady: float | None = None

    def __call__(self, unit: np.ndarray, norm: float = np.inf) -> Values:
        """Values at points (N, P), with the norm q in place of peaks; infinity takes crests."""
        return self.at(self.space.values(unit), norm)

    def at(self, values: np.ndarray, norm: float = np.inf) -> Values:
        """As a call, at SI values (N, P), which may lie outside of the bounds."""
        parts = [self._block(values[k : k + self.batch], norm) for k in range(0, len(values), self.batch)]
        *numbers, reasons = zip(*parts, strict=True)
        smooth, slope, goal, true = map(np.concatenate, numbers)
        return Values(smooth, slope, goal, true, [text for part in reasons for text in part])

    def _block(self, values: np.ndarray, norm: float) -> Values:
        refused = [self._refusal(point) for point in values]
        good = [k for k, text in enumerate(refused) if not text]
        self.spent.points += len(values)
        self.spent.failures.update(text.split(":")[0] for text in refused if text)
        nothing = np.full(len(values), np.nan)
        found = Values(nothing.copy(), np.full(values.shape, np.nan), nothing.copy(), nothing.copy(), refused)
        if not good:
            return found
        read, sign = self._read(values[good]), self.objective.sign
        begin = time.perf_counter()
        for k, one in zip(good, read, strict=True):
            if not isinstance(one, str):
                smooth, goal, true = self._objectives(*one, norm)
                slope = sign * smooth.slope * self.space.slope(values[k])
                if np.isfinite([smooth.value, goal.value, true.value, *slope]).all():
                    found.smooth[k], found.slope[k], found.goal[k] = sign * smooth.value, slope, sign * goal.value
                    found.true[k] = true.value
                    continue
            found.reasons[k] = one if isinstance(one, str) else reason(STEEP, self.how.max_steps)
            self.spent.failures[found.reasons[k]] += 1
        self.spent.wall_s += time.perf_counter() - begin
        return found

    def _objectives(self, value: Histories, derivative: Histories, norm: float) -> tuple[Dual, Dual, Dual]:
        """Of a run the objective on norms, on crests, and as it is reported."""

        def of(norm: float | None) -> Dual:
            wanted, contacts = self.objective, self.scene.members
            return wanted.of(measured(self.times, value, derivative, wanted, contacts, norm))

        true = of(None)
        if not self.objective.peaked:
            return true, true, true
        crest = of(np.inf)
        return of(norm) if np.isfinite(norm) else crest, crest, true

    def samples(self, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """What the greatest sample is chosen from at one point (P,): ``objective.sampled``, by unit coordinates; None where
        the run fails, and for an objective that is no greatest sample.
        """
        values = self.space.values(unit)
        self.spent.points += 1
        if not self.objective.sampled or self._refusal(values):
            return None
        (read,) = self._read(values[None])
        if isinstance(read, str):
            return None
        return sampled(*read, self.objective, self.scene.members, self.space.slope(values))

    @cached_property
    def near(self) -> Any:
        """Equilibria of the given design, from which every search begins; () for a model that searches for none."""
        origin = self.scene.origin(len(self.times))
        if not jax.tree.leaves(origin):
            return origin
        (found,) = self._runs(np.array([[float(self.params[name]) for name in self.space.names]]), origin)
        return jax.tree.map(lambda x: x[0], found.near)

    def _read(self, points: np.ndarray) -> _Read:
        """What runs at points that can be built leave, (n, P) SI, n up to the batch."""
        if self.steady is not None:
            return self._turns(points, self.steady)
        parts = self._runs(points, None if self.scene.traits.history else self.near)
        ended = [(part, i, int(code)) for part in parts for i, code in enumerate(part.code)]
        return [part.one(i) if code == OK else reason(code, self.how.max_steps) for part, i, code in ended]

    def _turns(self, points: np.ndarray, end: float) -> _Read:
        """As ``_read``, of a turn of the steady motion."""
        begin, names = time.perf_counter(), self.space.names
        params = columns(self.params, self.space.names, points)
        runs = to_the_end(self.scene, params, np.full(len(points), end), self.how, self.batch)
        spent = [runs.compile_s]

        def turned(i: int) -> tuple[Histories, Histories] | str:
            if runs.code[i] != OK:
                return reason(int(runs.code[i]), self.how.max_steps)
            one = {name: leaf[i] for name, leaf in params.items()}
            problem = Problem(self.scene, one, self.times, names, max_steps=self.how.max_steps)
            try:
                *found, compile_s = turn(problem, runs.state[i], end)
            except Restless as why:
                return str(why)
            spent.append(compile_s)
            return found[0], found[1]

        # The first alone: it may compile, for which all others would wait.
        first, *others = range(len(points))
        read = [turned(first), *each(turned, others)]
        self.spent.batch(begin, sum(spent))
        return read

    def _runs(self, points: np.ndarray, near: Any) -> list[Runs]:
        """Runs at points (n, P) as one batch; what runs one by one is shared out among the cores."""
        scene, times, names = self.scene, self.times, self.space.names
        one_by_one = scene.traits.large and not scene.traits.history if near is not None else alone(scene, self.how)
        shares = min(cores(), len(points)) if one_by_one and backend.on_cpu() else 1

        def some(part: np.ndarray) -> Runs:
            runs = Points(columns(self.params, names, part), np.full(len(part), times[-1]), times / times[-1])
            return run(scene, runs, names, self.how, self.batch, More(lean=True, near=near))

        begin, found = time.perf_counter(), each(some, np.array_split(points, shares))
        self.spent.batch(begin, max(part.compile_s for part in found))
        return found

    def _refusal(self, point: np.ndarray) -> str:
        """Why a point cannot be built; "" if it can."""
        illegal = self.space.legal(point)
        return illegal or refusal(self.scene, {**self.params, **dict(zip(self.space.names, point, strict=True))})
