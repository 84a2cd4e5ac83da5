"""Many points at once: how each run ended, its features, and on request its forces. One program a size of batch.

Scenes with a history go through a batch with a work queue; instants that are solved for themselves, each run from the one
before it. On several devices each has its own part of the batch and its own queue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from bcfj_jax.analysis.derivatives.batch import divided, filled
from bcfj_jax.analysis.derivatives.jacobian import Histories, by_channel, channel_names
from bcfj_jax.analysis.derivatives.measures import vector
from bcfj_jax.analysis.derivatives.names import Feature, members
from bcfj_jax.analysis.derivatives.starting import START, of_members, starting
from bcfj_jax.analysis.features import contact_interval
from bcfj_jax.analysis.histories import delay, settled_period
from bcfj_jax.core.programs import program
from bcfj_jax.core.status import NO_FORCE, OK, reason
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan
from bcfj_jax.solve.simulation import readings

# What grows with the duration where the samples' times are those of a run that takes one second.
_OF_FORCE = ("peak", "mean", "impulse")
_PER_SECOND = ("impulse", "period", "delay", *START)
# Periods, delays and times of a start are sought on the host.
HOST = ("period", "delay", *START)
# Points whose histories are in memory at once while features are taken.
_AT_ONCE = 8


class Batch(NamedTuple):
    """What N points gave.

    Attributes:
        features: (N, F), NaN where a run failed.
        reason: (N,) why each run failed, "" where it did not; end: (N,) when it ended [s].
        steps: (N,) attempted steps, or iterations.
        rounds: rounds of all places of the batch; 0 where there are none.
        force: (N, T, C, 3) [N] if asked for, else (N, 0, 0, 0).
    """

    features: np.ndarray
    reason: list[str]
    end: np.ndarray
    steps: np.ndarray
    rounds: int
    force: np.ndarray


def has_history(scene: AbstractModel) -> bool:
    """Whether the scene is integrated; not of one whose level is yet to be chosen."""
    return scene.traits.history and not scene.traits.open


def places() -> int:
    """Runs under way at one time: what keeps a core busy and its cache not full; an accelerator wants many."""
    if jax.default_backend() != "cpu":
        return 1024
    return 32


def run(
    scene: AbstractModel,
    params: Mapping[str, np.ndarray],
    ends: np.ndarray,
    grid: np.ndarray,
    wanted: Sequence[Feature],
    how: Plan,
    size: int,
    forces: bool = False,
) -> Batch:
    """Run N points, N at most ``size``.

    Args:
        scene: one whose level is chosen.
        params: leaves (N,).
        ends: (N,) last time of each [s].
        grid: (T,) from 0 to 1.
        wanted: the features.
        how: tolerance and budget of steps.
        size: of the program; fewer points need no other one.
        forces: whether forces are given back.
    """
    count = len(ends)
    fill, mesh = filled(count, size)
    host = forces or any(feature.kind in HOST for feature in wanted)
    arguments = {name: leaf[fill] for name, leaf in params.items()}, ends[fill], how, np.asarray(count)
    # The grid as bytes, which are hashable.
    static = scene, grid.tobytes(), tuple(wanted), host, mesh
    batch, _ = program("batch", _program, static, arguments)
    found = batch(*arguments)
    values, code, end, steps, rounds = (np.asarray(x) if not np.ndim(x) else x[:count] for x in found[:5])
    # Histories only where they are asked for.
    nothing = np.zeros((count, 0, 0, 0))
    force, depth, rate = (x[:count] for x in found[5:]) if host else (nothing,) * 3
    values = np.array(values)
    for k, feature in enumerate(wanted):
        if feature.kind in HOST:
            values[:, k] = [
                _on_host(scene, grid, feature, force[i, :, :, 0], depth[i], rate[i]) if code[i] == OK else np.nan
                for i in range(count)
            ]
        if feature.kind in _PER_SECOND:
            values[:, k] *= ends
    # A peak or a mean that is not finite is that of a force that is not.
    sums = [k for k, feature in enumerate(wanted) if feature.kind in _OF_FORCE]
    lost = ~np.isfinite(values[:, sums]).all(axis=1)
    code = np.where((code == OK) & lost, NO_FORCE, code)
    values[code != OK] = np.nan
    reasons = [reason(one, how.max_steps) for one in code]
    return Batch(values, reasons, end, steps, int(np.max(rounds)), force if forces else nothing)


def _program(
    scene: AbstractModel, grid: bytes, wanted: tuple[Feature, ...], host: bool, mesh: Mesh | None, params: dict,
    ends: Array, how: Plan, count: Array,
) -> tuple:  # fmt: skip
    shares = np.frombuffer(grid)

    def part(params: dict, ends: Array, how: Plan, count: Array) -> tuple:
        return _part(scene, shares, wanted, host, params, ends, how, count)

    return divided(part, mesh, params, ends, how, count)


def _part(
    scene: AbstractModel, grid: np.ndarray, wanted: tuple[Feature, ...], host: bool, params: dict, ends: Array,
    how: Plan, count: Array,
) -> tuple:  # fmt: skip
    """What one device does."""
    from bcfj_jax.solve.work_queue import equilibria, integrate_queue  # With diffrax, which a kept program needs not.

    contacts = scene.members

    def look(one: tuple) -> tuple:
        params, end, states = one
        force, depth, rate = read = by_channel(scene, readings(scene, params, end * grid, states))
        features = vector(grid, Histories(force, depth, rate, None), wanted, contacts, {})
        return features, *(read if host else (None, None, None))

    rounds = jnp.asarray(0)
    if has_history(scene):
        solution, rounds = integrate_queue(scene, params, ends, jnp.asarray(grid), how, count, min(places(), ends.size))
    else:
        solution = equilibria(scene, params, ends, jnp.asarray(grid))
    features, *read = jax.lax.map(look, (params, ends, solution.states), batch_size=min(_AT_ONCE, ends.size))
    return features, solution.code, solution.end, solution.accepted + solution.rejected, rounds, *read


def _on_host(
    scene: AbstractModel, grid: np.ndarray, feature: Feature, force: np.ndarray, depth: np.ndarray, rate: np.ndarray
) -> float:
    """A period or a delay of a run that takes one second, as ``outputs.summary`` and ``measures`` have it."""
    contacts = scene.members
    place = {name: i for i, name in enumerate(channel_names(contacts))}

    def cycle(name: str) -> float:
        at = place[name]
        if scene.traits.turning:
            return settled_period(grid, force[:, at])
        return contact_interval(grid, depth[:, at], rate[:, at])

    parts = [members(part, contacts) for part in feature.contacts]
    if feature.kind == "period":
        return float(np.mean([cycle(name) for name in parts[0]]))
    if feature.kind in START:
        none = np.zeros((0, len(grid)))
        each = []
        for name in parts[0]:
            span = cycle(name) if feature.kind == "settling" else float("nan")
            each.append(starting(feature.kind, grid, force[:, place[name]], none, span))
        return of_members(feature.kind, each)[0]
    first, second = parts if len(parts[0]) == len(parts[1]) else (parts[0][:1], parts[1][:1])
    shifts = []
    for a, b in zip(first, second, strict=True):
        span = cycle(a)
        within = span if np.isfinite(span) else float(grid[-1] - grid[0])
        shifts.append(float(delay(grid, force[:, place[a]], force[:, place[b]], within)))
    return float(np.mean(shifts))
