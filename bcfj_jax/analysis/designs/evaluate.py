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
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.batch import filling, jacobians, possible
from bcfj_jax.analysis.derivatives.jacobian import Histories, by_channel, histories
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.steady import Restless, to_the_end, turn
from bcfj_jax.analysis.designs.objective import Objective, measured, sampled
from bcfj_jax.analysis.designs.space import Space
from bcfj_jax.analysis.engine import columns, refusal
from bcfj_jax.core.dual import Dual
from bcfj_jax.core.status import NOT_FINITE, OK, STEEP, reason
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import Plan, Points
from bcfj_jax.solve.simulation import readings
from bcfj_jax.xla.programs import program
from bcfj_jax.xla.threads import cores, each


class Values(NamedTuple):
    """At N points: what the descent sees, its gradient by unit coordinates, and the true objective.

    Attributes:
        smooth: (N,) with norms or crests in place of peaks, times the objective's sign, which makes less better.
        slope: (N, P).
        goal: (N,) as ``smooth``, always with crests: by it points are compared.
        true: (N,) with greatest samples, without that sign.
        reasons: (N,) why a point has no value; "" where it has one.
    """

    smooth: np.ndarray
    slope: np.ndarray
    goal: np.ndarray
    true: np.ndarray
    reasons: list[str]


@dataclass
class Spent:
    """What was spent: batches, points that were asked for, seconds, and failures by reason."""

    batches: int = 0
    points: int = 0
    wall_s: float = 0.0
    compile_s: float = 0.0
    failures: Counter = field(default_factory=Counter)

    def batch(self, wall_s: float, compile_s: float) -> None:
        """Account for one."""
        self.batches += 1
        self.wall_s += wall_s
        self.compile_s += compile_s

    def why(self) -> str:
        """The most frequent failures, with their numbers."""
        return ", ".join(f"{text} ({n})" for text, n in self.failures.most_common(3))


class _Read(NamedTuple):
    """What N runs left, for any objective: histories (T, ...) and their derivatives (P, T, ...) per SI unit, by run; codes (N,),
    and why some have no steady motion; equilibria, from which the next search begins.
    """

    value: list[Histories]
    derivative: list[Histories]
    code: np.ndarray
    whys: list[str]
    near: Any = ()


class _Given(NamedTuple):
    """What ``_runs`` takes: all parameters, values (n, P) of the free ones, times, plan, how many count, equilibria."""

    fixed: dict[str, Any]
    points: Any
    times: Any
    how: Plan
    count: Any
    near: Any


@dataclass(frozen=True)
class Evaluator:
    """A scene's objective over the unit box of its free parameters.

    Attributes:
        scene, params, times, how: as ``force_history`` takes them.
        space, objective: what is free, what is made least.
        batch: points in one batch; spent: the account of all calls.
        steady: when the runs end [s] whose steady motion is looked at (``derivatives.steady``); ``times`` are then
            shares of a turn. None for the runs themselves.
    """

    scene: AbstractModel
    params: Params
    times: np.ndarray
    how: Plan
    space: Space
    objective: Objective
    batch: int
    spent: Spent = field(default_factory=Spent)
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
        for i, k in enumerate(good):
            code = int(read.code[i])
            if code == OK:
                smooth, goal, true = self._objectives(read.value[i], read.derivative[i], norm)
                slope = sign * smooth.slope * self.space.slope(values[k])
                if np.isfinite([smooth.value, goal.value, true.value, *slope]).all():
                    found.smooth[k], found.slope[k], found.goal[k] = sign * smooth.value, slope, sign * goal.value
                    found.true[k] = true.value
                    continue
                code = STEEP
            found.reasons[k] = read.whys[i] or reason(code, self.how.max_steps)
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
        read = self._read(values[None])
        if read.code[0] != OK:
            return None
        histories = read.value[0], read.derivative[0]
        return sampled(*histories, self.objective, self.scene.members, self.space.slope(values))

    @cached_property
    def near(self) -> Any:
        """Equilibria of the given design, from which every search begins; () for a model that searches for none."""
        origin = self.scene.origin(len(self.times))
        if not jax.tree.leaves(origin):
            return origin
        found = self._batch(np.array([[float(self.params[name]) for name in self.space.names]]), origin)
        return jax.tree.map(lambda x: x[0], found.near)

    def _read(self, points: np.ndarray) -> _Read:
        """What runs at points that can be built leave, (n, P) SI, n up to the batch."""
        return self._batch(points, self.near) if self.steady is None else self._turns(points, self.steady)

    def _turns(self, points: np.ndarray, end: float) -> _Read:
        """As ``_read``, of a turn of the steady motion."""
        begin, count, names = time.perf_counter(), len(points), self.space.names
        params = columns(self.params, names, points)
        runs = to_the_end(self.scene, params, np.full(count, end), self.how, self.batch)
        none = [Histories(None, None, None, None)] * count
        read, compile_s = _Read(none, list(none), np.array(runs.code), [""] * count), runs.compile_s

        def turned(i: int) -> tuple[Histories, Histories, float] | str:
            one = {name: leaf[i] for name, leaf in params.items()}
            problem = Problem(self.scene, one, self.times, names, max_steps=self.how.max_steps)
            try:
                return turn(problem, runs.state[i], end)
            except Restless as why:
                return str(why)

        # The first alone: it may compile, for which all others would wait.
        good = np.flatnonzero(runs.code == OK)
        for i, found in zip(good, [*map(turned, good[:1]), *each(turned, good[1:])], strict=True):
            if isinstance(found, str):
                read.code[i], read.whys[i] = NOT_FINITE, found
                continue
            read.value[i], read.derivative[i] = found[:2]
            compile_s += found[2]
        self.spent.batch(time.perf_counter() - begin - compile_s, compile_s)
        return read

    def _batch(self, points: np.ndarray, near: Any) -> _Read:
        """``_runs``, filled up with the first point; what runs one by one is shared out among the cores."""
        shares = min(cores(), len(points)) if _one_by_one(self.scene, self.how) else 1
        parts = [points[share] for share in np.array_split(np.arange(len(points)), shares)]
        sizes = [len(part) for part in parts]
        given = [
            _Given(dict(self.params), part[filling(size, self.batch)], self.times, self.how, np.asarray(size), near)
            for part, size in zip(parts, sizes, strict=True)
        ]
        runs, compile_s = program("design runs", _runs, (self.scene, self.space.names), (given[0],))
        begin = time.perf_counter()
        found = each(runs, given)

        def joined(*shared: Any) -> np.ndarray:
            wanted = [x[:size] for x, size in zip(shared, sizes, strict=True)]
            return np.concatenate(wanted)[filling(len(points), self.batch)]

        value, slopes, code, near = jax.tree.map(joined, *found)
        self.spent.batch(time.perf_counter() - begin, compile_s)
        # No objective asks for a rate.
        histories, tangents = (
            [Histories(f, d, np.zeros_like(d), None, c) for f, d, c in zip(force[..., None], depth, curve, strict=True)]
            for force, depth, curve in (value, slopes)
        )
        return _Read(histories, tangents, code, [""] * len(code), near)

    def _refusal(self, point: np.ndarray) -> str:
        """Why a point cannot be built; "" if it can."""
        illegal = self.space.legal(point)
        return illegal or refusal(self.scene, {**self.params, **dict(zip(self.space.names, point, strict=True))})


def _one_by_one(scene: AbstractModel, how: Plan) -> bool:
    """Whether points are taken one after the other: side by side a large model gains nothing on a core."""
    batched = scene.traits.history and possible(scene, how)
    return scene.traits.large and jax.default_backend() == "cpu" and not batched


def _runs(scene: AbstractModel, names: tuple[str, ...], given: _Given) -> tuple:
    """Normal forces and penetrations (N, T, C) and curves (N, C, 4) of runs, their derivatives (N, P, ...), codes; equilibria."""
    fixed, points, times, how, count, near = given
    if scene.traits.history and possible(scene, how):
        size = len(points)
        params = {name: jnp.full(size, value) for name, value in fixed.items()}
        params |= {name: points[:, k] for k, name in enumerate(names)}
        runs = Points(params, jnp.full(size, times[-1]), times / times[-1])
        value, slopes, code, *_ = jacobians(scene, names, runs, how, count)
        by = jnp.moveaxis(slopes[0], 2, 1), jnp.moveaxis(slopes[1], 2, 1), slopes[3]
        return (value[0][..., 0], value[1], value[3]), by, code, near

    def one(theta: Array) -> tuple[tuple, tuple]:
        params = {**fixed, **{name: theta[k] for k, name in enumerate(names)}}
        if scene.traits.history:
            found, (code, *_) = histories(scene, params, times, how)
            read, places = (found.force[:, :, 0], found.penetration, found.curve), near
        else:
            solution, places = scene.instants(params, times, near, rates=False)
            force, depth, _ = by_channel(scene, readings(scene, params, times, solution.states))
            read, code = (force[:, :, 0], depth, jnp.full((depth.shape[1], len(Curve._fields)), jnp.nan)), solution.code
        return read, (read, code, places)

    whole = jax.jacfwd(one, has_aux=True)
    if _one_by_one(scene, how):
        # Those beyond the count cost nothing.
        nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(whole, points[0]))
        each = (jnp.arange(len(points)), points)
        slopes, (read, code, places) = jax.lax.map(
            lambda x: jax.lax.cond(x[0] < count, whole, lambda _: nothing, x[1]), each
        )
    else:
        slopes, (read, code, places) = jax.vmap(whole)(points)
    return read, jax.tree.map(lambda x: jnp.moveaxis(x, -1, 1), slopes), code, places
