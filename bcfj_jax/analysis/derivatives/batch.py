"""Histories and their derivatives of many runs at once: one compiled program for a number of runs.

What ``jacobian.level`` gives of one run. Tangents go beside the states through the work queue
(``solve.work_queue``), so that no run waits for the slowest. Explicit runs that land on their contacts are solved one after
the other within the program, on a CPU. Instants that are solved for themselves are each searched from the run before, or all
from where it is said. On several devices each has its own part of the batch and its own queue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, PartitionSpec

from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.jacobian import Histories, Search, by_channel, by_shares, histories
from bcfj_jax.core.status import NO_FORCE, OK, STEEP
from bcfj_jax.mechanism.model import AbstractModel, Solution
from bcfj_jax.solve.plan import Plan, Points
from bcfj_jax.xla import backend
from bcfj_jax.xla.batched_jvp import along, changes
from bcfj_jax.xla.programs import program

# Runs under way at one time on a core: with its tangents and matrices a run takes several times a run's place in a cache.
_PLACES = 32
# On an accelerator: beyond, a step costs as much a run.
MANY = 16384
# Samples that are read at once.
_SAMPLES = 64
# Runs that are read at once on an accelerator.
_AT_ONCE = 64


class More(NamedTuple):
    """What is wanted of runs besides."""

    whole: bool = False  # all of a force, not the normal part alone
    lean: bool = False  # of runs that are solved by themselves normal forces and penetrations alone, with rates of 0
    # From where all instants are searched (``AbstractModel.instants``); None: each from the run before.
    near: Any = None


_NOTHING_MORE = More()


class Runs(NamedTuple):
    """What N runs left, and how they ended."""

    value: Histories  # (N, ...) of ``Histories`` without states; of a force the normal part, (N, T, C, 1), or all
    derivative: Histories  # (N, P, ...) per SI unit, of a force the normal part
    # code, end: (N,) how and when [s] they ended.
    code: np.ndarray
    end: np.ndarray
    steps: np.ndarray  # (N,) attempted
    rounds: int  # of all places of the batch; 0 where there are none
    near: Any = None  # (N, ...) from where instants near each run's are searched
    compile_s: float = 0.0  # what compiling took [s]

    def one(self, run: int) -> tuple[Histories, Histories]:
        """One of them, and its derivatives."""
        return jax.tree.map(lambda x: x[run], (self.value, self.derivative))


def possible(scene: AbstractModel, how: Plan) -> bool:
    """Whether derivatives of many runs go through one batch: not where tangents have a say in the steps."""
    return not (scene.traits.open or how.solver or (scene.traits.history and how.tangents))


def alone(scene: AbstractModel, how: Plan) -> bool:
    """Whether a run with a history is solved by itself: one that lands on its contacts, or whose tangents have a say."""
    return scene.traits.history and bool(how.tangents or (scene.contacts and not scene.traits.stiff))


def run(
    scene: AbstractModel, points: Points, wrt: tuple[str, ...], how: Plan, size: int, more: More = _NOTHING_MORE
) -> Runs:  # fmt: skip
    """Run N points of a scene whose level is chosen, with derivatives by ``wrt``.

    N is at most the ``size`` of the program: fewer points need no other one.
    """
    count = len(points.ends)
    fill, mesh = filled(count, size)
    given = Points(points.one(fill), points.ends[fill], np.asarray(points.grid))
    arguments = given, how, np.asarray(count), more.near
    batch, compile_s = program("batched jacobian", _program, (scene, wrt, more[:2], mesh), arguments)
    *kept, rounds, steps, near = batch(*arguments)
    value, slopes, code, end, steps, near = jax.tree.map(lambda x: x[:count], (*kept, steps, near))
    force, *others = (np.moveaxis(x, 2, 1) for x in slopes[:3])
    derivative = Histories(force[..., None], *others, state=None, curve=slopes[3])
    value = Histories(*value[:3], state=None, curve=value[3])
    return Runs(value, derivative, code, end, steps, int(np.max(rounds)), near, compile_s)


def filled(count: int, size: int) -> tuple[np.ndarray, Mesh | None]:
    """Numbers of runs that fill a batch, and its devices, where there are several.

    What fills up is the first run again, which is computed only where there is no work queue.
    """
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("runs",)) if len(devices) > 1 else None
    return filling(count, -(-size // len(devices)) * len(devices)), mesh


def filling(count: int, size: int) -> np.ndarray:
    """(size,) numbers of so many runs, the first again in the places that are left."""
    return np.where(np.arange(size) < count, np.arange(size), 0)


def divided(part: Callable[..., tuple], mesh: Mesh | None, points: Points, how: Plan, count: Array) -> tuple:
    """``part(points, how, count)`` on every device for its share of the runs; the fifth result is one number."""
    if mesh is None:
        return part(points, how, count)
    share = points.ends.size // mesh.size
    runs, every = PartitionSpec("runs"), PartitionSpec()

    def mine(points: Points, how: Plan, count: Array) -> tuple:
        found = part(points, how, jnp.clip(count - share * jax.lax.axis_index("runs"), 0, share))
        return (*found[:4], found[4][None], *found[5:])

    specs: Any = Points(runs, runs, every), every, every  # pyright: ignore[reportArgumentType]
    return jax.shard_map(mine, mesh=mesh, in_specs=specs, out_specs=runs, check_vma=False)(points, how, count)


def _program(
    scene: AbstractModel, wrt: tuple[str, ...], kept: tuple[bool, bool], mesh: Mesh | None, *given: Any
) -> tuple:
    *runs, near = given

    def part(points: Points, how: Plan, count: Array) -> tuple:
        return jacobians(_Sharing(scene, wrt, points.grid, how, More(*kept, near)), points, count)

    return divided(part, mesh, *runs)


def places() -> int:
    """Runs under way at one time."""
    return _PLACES if backend.on_cpu() else MANY


@dataclass(frozen=True, eq=False)
class _Sharing:
    """How each of N runs is solved with its derivatives by the named parameters, and read."""

    scene: AbstractModel
    wrt: Sequence[str]
    grid: Array
    how: Plan
    more: More

    def kept(self, value: tuple, slopes: tuple, tangents: Array) -> tuple:
        """What is kept of some samples, and in which of them forces or derivatives are not finite.

        As ``jacobian.level``: a force that is 0 has a derivative of 0, whatever the state's is. Slopes (P, S, ...).
        """
        force, by = value[0], slopes[0]
        lost = ~jnp.isfinite(force).all(axis=(1, 2))
        steep = ~(jnp.isfinite(by).all(axis=(0, 2, 3)) & jnp.isfinite(tangents).all(axis=(0, 2)))
        slopes = tuple(jnp.moveaxis(x, 0, 1) for x in (by[..., 0], *slopes[1:]))
        return (force if self.more.whole else force[..., :1], *value[1:]), slopes, lost, steep

    def look(self, one: tuple) -> tuple:
        """What a run's contacts read, and how that changes along the tangents; some samples at once."""
        from bcfj_jax.solve.work_queue import shifted, sizes  # With diffrax, which a kept program needs not.

        (params, end, rows), scene, grid, wrt = one, self.scene, self.grid, self.wrt
        prepare = lambda shares: scene.prepare({**params, **shifted(params, wrt, shares)})  # noqa: E731
        still, unit = jnp.zeros(len(wrt)), sizes(params, wrt)
        prepared, changing = prepare(still), changes(prepare, still)

        def some(at: Array) -> tuple:
            times, here = jnp.maximum((end * grid)[at], 0.0), rows[at]

            def read(x: tuple) -> tuple:
                states, prepared = x
                return by_channel(scene, jax.vmap(scene.observe, (0, 0, None))(times, states, prepared))

            tangents = jnp.moveaxis(here[:, 1:], 1, 0)
            value, slopes = along(read, (here[:, 0], prepared), (tangents, changing))
            by = tuple(x / unit.reshape(-1, *[1] * (x.ndim - 1)) for x in slopes)
            return self.kept(value, by, tangents)

        # The last sample again fills up.
        take = jnp.minimum(jnp.arange(-(-grid.size // _SAMPLES) * _SAMPLES), grid.size - 1).reshape(-1, _SAMPLES)
        found = jax.lax.map(some, take)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[: grid.size], found)

    def single(self, near: Any, one: tuple) -> tuple:
        """A run by itself, whose instants are searched from ``near`` if it has no history; where the next may begin."""
        params, end = one
        search = None if self.scene.traits.history else Search(near, not self.more.lean)

        def at(given: dict) -> tuple:
            found, ended = histories(self.scene, given, end * self.grid, self.how, search=search)
            if self.more.lean:
                none = jnp.zeros_like(found.rate)
                found = found._replace(force=found.force[..., :1], rate=none, state=found.state[:, :0])
            return found, ended

        by, (value, (*ended, ahead)) = by_shares(at, params, self.wrt)
        kept, slopes, *bad = self.kept(tuple(value[:3]), tuple(by[:3]), by.state)
        return (*kept, value.curve), (*slopes, by.curve), *bad, Solution(end, *ended), ahead

    def queued(self, points: Points, count: Array) -> tuple:
        """All runs through one queue, which knows no continuous curve; and the rounds of its places."""
        from bcfj_jax.solve.work_queue import integrate_queue  # With diffrax, which a kept program needs not.

        (params, ends, _), total = points, points.ends.size
        found, rounds = integrate_queue(self.scene, points, self.how, count, min(places(), total), self.wrt)
        few = None if backend.on_cpu() else min(_AT_ONCE, total)
        value, slopes, *bad = jax.lax.map(self.look, (params, ends, found.states), batch_size=few)
        shape = total, value[1].shape[-1], len(Curve._fields)
        unknown, still = jnp.full(shape, jnp.nan), jnp.zeros((total, len(self.wrt), *shape[1:]))
        return (*value, unknown), (*slopes, still), *bad, found, (), rounds

    def solved(self, points: Points, count: Array) -> tuple:
        """Values and slopes of all runs, where they are not finite, how they ended, where to search next; rounds."""
        scene, near, runs, none = self.scene, self.more.near, (points.params, points.ends), jnp.asarray(0)
        history, on_cpu = scene.traits.history, backend.on_cpu()
        if history and not alone(scene, self.how):
            return self.queued(points, count)
        if on_cpu and (history or (near is not None and scene.traits.large)):
            # One after the other; those beyond the count cost nothing.
            whole = partial(self.single, near)
            nothing = jax.eval_shape(whole, (points.one(0), points.ends[0]))
            nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), nothing)
            each = jnp.arange(points.ends.size), runs
            return *jax.lax.map(lambda x: jax.lax.cond(x[0] < count, whole, lambda _: nothing, x[1]), each), none
        if near is None:
            near = jax.tree.map(jnp.asarray, scene.origin(self.grid.size))
            if jax.tree.leaves(near) and on_cpu:
                return *jax.lax.scan(self.after, near, runs)[1], (), none
        return *jax.vmap(lambda *one: self.single(near, one))(*runs), none

    def after(self, near: Any, one: tuple) -> tuple:
        """A run that is searched from the one before it."""
        *found, ahead = self.single(near, one)
        return ahead, tuple(found)


def jacobians(each: _Sharing, points: Points, count: Array) -> tuple:
    """Force, penetration and rate of N runs (as ``work_queue.integrate_queue``) with their derivatives per SI unit. Pure.

    Values (N, T, C, 3), (N, T, C) twice, (N, C, 4) of the continuous curve (``Histories``); of a force (N, T, C, 1), the normal
    part, unless all is wanted. Derivatives (N, T, P, C) of normal force, penetration and rate, (N, P, C, 4) of the curve. Then
    (N,) codes and ends, the rounds of all places, (N,) attempted steps, and from where to search next.
    """
    value, slopes, lost, steep, solution, near, rounds = each.solved(points, count)
    code, end = solution.code, solution.end
    for bad, why in ((lost, NO_FORCE), (steep, STEEP)):
        now = (code == OK) & bad.any(axis=1)
        code, end = jnp.where(now, why, code), jnp.where(now, points.ends * each.grid[jnp.argmax(bad, axis=1)], end)
    return value, slopes, code, end, rounds, solution.accepted + solution.rejected, near
