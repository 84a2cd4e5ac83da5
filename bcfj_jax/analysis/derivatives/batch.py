"""Histories and their derivatives of many runs at once: one compiled program for a number of runs.

What ``jacobian.level`` gives of one run. Tangents go beside the states through the work queue
(``solve.work_queue``), so that no run waits for the slowest. Explicit runs that land on their contacts are solved one after
the other within the program, on a CPU. Instants that are solved for themselves are each searched from the run before. On
several devices each has its own part of the batch and its own queue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, PartitionSpec

from bcfj_jax.analysis.derivatives.jacobian import Histories, by_channel, by_shares, histories
from bcfj_jax.core.status import NO_FORCE, OK, STEEP
from bcfj_jax.mechanism.model import AbstractModel, Solution
from bcfj_jax.solve.plan import Plan, Points
from bcfj_jax.solve.simulation import readings
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


class Runs(NamedTuple):
    """What N runs left, and how they ended.

    Attributes:
        value: (N, ...) of ``Histories`` without states; of a force the normal part, (N, T, C, 1), or all.
        derivative: (N, P, ...) per SI unit, of a force the normal part.
        code, end: (N,) how and when [s] they ended; steps: (N,) attempted.
        rounds: of all places of the batch; 0 where there are none.
    """

    value: Histories
    derivative: Histories
    code: np.ndarray
    end: np.ndarray
    steps: np.ndarray
    rounds: int


def possible(scene: AbstractModel, how: Plan) -> bool:
    """Whether derivatives of many runs go through one batch: not where tangents have a say in the steps."""
    return not (scene.traits.open or how.solver or (scene.traits.history and how.tangents))


def run(scene: AbstractModel, points: Points, wrt: tuple[str, ...], how: Plan, size: int, whole: bool = False) -> Runs:
    """Run N points of a scene whose level is chosen, as ``possible`` allows, with derivatives by ``wrt``.

    N is at most the ``size`` of the program: fewer points need no other one. ``whole``: whether all of a force is given back.
    """
    count = len(points.ends)
    fill, mesh = filled(count, size)
    arguments = Points(points.one(fill), points.ends[fill], np.asarray(points.grid)), how, np.asarray(count)
    batch, _ = program("batched jacobian", _program, (scene, wrt, whole, mesh), arguments)
    found = batch(*arguments)
    rounds = int(np.max(found[4]))
    value, slopes, code, end, steps = (jax.tree.map(lambda x: x[:count], part) for part in (*found[:4], found[5]))
    force, *others = (np.moveaxis(x, 2, 1) for x in slopes[:3])
    derivative = Histories(force[..., None], *others, state=None, curve=slopes[3])
    return Runs(Histories(*value[:3], state=None, curve=value[3]), derivative, code, end, steps, rounds)


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
    scene: AbstractModel, wrt: tuple[str, ...], whole: bool, mesh: Mesh | None, points: Points, how: Plan, count: Array
) -> tuple:
    def part(points: Points, how: Plan, count: Array) -> tuple:
        return jacobians(scene, wrt, points, how, count, whole)

    return divided(part, mesh, points, how, count)


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
    whole: bool

    def kept(self, value: tuple, slopes: tuple, tangents: Array) -> tuple:
        """What is kept of some samples, and in which of them forces or derivatives are not finite.

        As ``jacobian.level``: a force that is 0 has a derivative of 0, whatever the state's is. Slopes (P, S, ...).
        """
        force, by = value[0], slopes[0]
        lost = ~jnp.isfinite(force).all(axis=(1, 2))
        steep = ~(jnp.isfinite(by).all(axis=(0, 2, 3)) & jnp.isfinite(tangents).all(axis=(0, 2)))
        slopes = tuple(jnp.moveaxis(x, 0, 1) for x in (by[..., 0], *slopes[1:]))
        return (force if self.whole else force[..., :1], *value[1:]), slopes, lost, steep

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

    def instants(self, near: Any, one: tuple) -> tuple:
        """A run without a history, searched from another."""
        params, end = one

        def at(given: dict) -> tuple:
            solution, ahead = self.scene.instants(given, end * self.grid, near)
            value = by_channel(self.scene, readings(self.scene, given, end * self.grid, solution.states))
            return (value, solution.states), (solution, ahead)

        (by, tangents), ((value, _), (solution, ahead)) = by_shares(at, params, self.wrt)
        return ahead, (*self.kept(value, by, tangents), solution._replace(states=end))

    def landed(self, one: tuple) -> tuple:
        """A run that lands on its contacts, by itself."""
        params, end = one
        by, (value, ended) = by_shares(
            lambda given: histories(self.scene, given, end * self.grid, self.how), params, self.wrt
        )
        kept, slopes, *bad = self.kept(tuple(value[:3]), tuple(by[:3]), by.state)
        return (*kept, value.curve), (*slopes, by.curve), *bad, Solution(end, *ended)


def jacobians(
    scene: AbstractModel, wrt: Sequence[str], points: Points, how: Plan, count: Array, whole: bool = False
) -> tuple:
    """Force, penetration and rate of N runs (as ``work_queue.integrate_queue``) with their derivatives per SI unit. Pure.

    Values (N, T, C, 3), (N, T, C) twice, (N, C, 4) of the continuous curve (``Histories``); of a force (N, T, C, 1), the normal
    part, unless ``whole``. Derivatives (N, T, P, C) of normal force, penetration and rate, (N, P, C, 4) of the curve. Then (N,)
    codes and ends, the rounds of all places, and (N,) attempted steps.
    """
    from bcfj_jax.solve.work_queue import integrate_queue  # With diffrax, which a kept program needs not.

    params, ends, grid = points
    each = _Sharing(scene, wrt, grid, how, whole)
    rounds = jnp.asarray(0)
    if scene.traits.history and scene.contacts and not scene.traits.stiff:
        runs = jnp.arange(ends.size), params, ends
        # Those beyond the count cost nothing.
        nothing = jax.tree.map(
            lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(each.landed, (points.one(0), ends[0]))
        )
        if backend.on_cpu():
            found = jax.lax.map(lambda x: jax.lax.cond(x[0] < count, each.landed, lambda _: nothing, x[1:]), runs)
        else:
            found = jax.vmap(each.landed)(runs[1:])
        value, slopes, lost, steep, solution = found
    elif scene.traits.history:
        width = min(places(), ends.size)
        solution, rounds = integrate_queue(scene, points, how, count, width, wrt)
        few = None if backend.on_cpu() else min(_AT_ONCE, ends.size)
        value, slopes, lost, steep = jax.lax.map(each.look, (params, ends, solution.states), batch_size=few)
    else:
        near = jax.tree.map(jnp.asarray, scene.origin(grid.size))
        if jax.tree.leaves(near) and backend.on_cpu():
            found = jax.lax.scan(each.instants, near, (params, ends))[1]
        else:
            found = jax.vmap(lambda *one: each.instants(near, one)[1])(params, ends)
        value, slopes, lost, steep, solution = found
    if len(value) < 4:
        shape = (ends.size, value[1].shape[-1], 3)
        value, slopes = (*value, jnp.full(shape, jnp.nan)), (*slopes, jnp.zeros((shape[0], len(wrt), *shape[1:])))
    code, end = solution.code, solution.end
    for bad, why in ((lost, NO_FORCE), (steep, STEEP)):
        now = (code == OK) & bad.any(axis=1)
        code, end = jnp.where(now, why, code), jnp.where(now, ends * grid[jnp.argmax(bad, axis=1)], end)
    return value, slopes, code, end, rounds, solution.accepted + solution.rejected
