"""Many points of a study at once: how each run ended, its features and their derivatives, and on request its forces.

Scenes with a history go through a batch with a work queue, on several devices a part each; instants that are solved for
themselves, each run from the one before it. What has no batch is done one by one. One program a size of batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from bcfj_jax.analysis.derivatives import batch as derivatives
from bcfj_jax.analysis.derivatives.contact_events import TIGHTER
from bcfj_jax.analysis.derivatives.contact_events import filled as with_events
from bcfj_jax.analysis.derivatives.jacobian import Histories, by_channel, of_run
from bcfj_jax.analysis.derivatives.measures import measure, vector
from bcfj_jax.analysis.derivatives.names import Feature, complete, event, members
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.steady import steady, to_the_end
from bcfj_jax.analysis.engine import differentiated, planned, simulated
from bcfj_jax.analysis.features import KINDS, PAIR
from bcfj_jax.analysis.simulation.results import resolved
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.core.status import NO_FORCE, OK, reason
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan, Points, plan
from bcfj_jax.solve.simulation import readings
from bcfj_jax.xla import backend
from bcfj_jax.xla.programs import program

_OF_FORCE = ("peak", "mean", "impulse")
# Points whose histories are in memory at once while features are taken: on a CPU, on an accelerator.
_AT_ONCE = {True: 8, False: 256}


class Batch(NamedTuple):
    """What N points gave."""

    features: np.ndarray  # (N, F), NaN where a run failed; with derivatives these behind them, (N, F (1 + P))
    reason: list[str]  # (N,) why each run failed, "" where it did not
    end: np.ndarray  # (N,) when it ended [s]
    steps: np.ndarray  # (N,) attempted
    rounds: int  # of all places of the batch; 0 where there are none
    force: np.ndarray  # (N, T, C, 3) [N] if asked for, else (N, 0, 0, 0)


def of_study(study: Study, values: np.ndarray, ends: np.ndarray, size: int, safety: float) -> Batch:
    """Run points with values (n, D) of the varied parameters until their ends (n,) [s], n up to the program's ``size``, at
    ``safety`` times the scene's tolerance.
    """
    given, scene, how = study.given, study.given.scene, planned(study.given, safety)
    params, wrt = study.params(values), ()
    if study.derivatives:
        params, wrt = complete(scene, params, study.derivatives)  # pyright: ignore[reportArgumentType]
    points = Points(params, ends, given.times / given.times[-1])
    if study.steady:
        return _of_steady(study, points, wrt, how, size)
    if not together(study):
        return _one_by_one(study, points, wrt, safety)
    if wrt:
        return _with_derivatives(study, points, wrt, how, size)
    return run(scene, points, study.features, Plan(how.tolerance, given.max_steps), size, study.histories)


def together(study: Study) -> bool:
    """Whether all points of a batch are one program, in which no point is taken by itself."""
    given, scene = study.given, study.given.scene
    if study.steady or any(event(f.kind) for f in study.features):
        return False
    if study.derivatives:
        return derivatives.possible(scene, planned(given, 1.0))
    return given.solver is None and not given.resolved_peaks and not scene.traits.open


def has_history(scene: AbstractModel) -> bool:
    """Whether the scene is integrated; not of one whose level is yet to be chosen."""
    return scene.traits.history and not scene.traits.open


def run(
    scene: AbstractModel, points: Points, wanted: Sequence[Feature], how: Plan, size: int, forces: bool = False
) -> Batch:
    """Features of N points of a scene whose level is chosen, without derivatives; their forces where these are wanted.

    ``size`` is the program's: fewer points need no other one.
    """
    ends, grid, count = points.ends, points.grid, len(points.ends)
    fill, mesh = derivatives.filled(count, size)
    host = forces or any(map(on_host, wanted))
    arguments = Points(points.one(fill), ends[fill], np.asarray(grid)), how, np.asarray(count)
    # The grid as bytes, which are hashable.
    static = scene, (np.asarray(grid).tobytes(), tuple(wanted), host), mesh
    batch, _ = program("batch", _program, static, arguments)
    found = batch(*arguments)
    values, code, end, steps, rounds = (np.asarray(x) if not np.ndim(x) else x[:count] for x in found[:5])
    # Histories only where they are asked for.
    nothing = np.zeros((count, 0, 0, 0))
    force, depth, rate = (x[:count] for x in found[5:]) if host else (nothing,) * 3
    values = np.array(values)
    for k, feature in enumerate(wanted):
        if on_host(feature):
            for i in range(count):
                one = Histories(force[i], depth[i], rate[i], None)
                values[i, k] = measured(scene, [feature], grid, one)[0][0] if code[i] == OK else np.nan
        # The samples' times are those of a run that takes one second.
        if KINDS[feature.kind].per_second:
            values[:, k] *= ends
    # A peak or a mean that is not finite is that of a force that is not.
    sums = [k for k, feature in enumerate(wanted) if feature.kind in _OF_FORCE]
    lost = ~np.isfinite(values[:, sums]).all(axis=1)
    code = np.where((code == OK) & lost, NO_FORCE, code)
    values[code != OK] = np.nan
    reasons = [reason(one, how.max_steps) for one in code]
    return Batch(values, reasons, end, steps, int(np.max(rounds)), force if forces else nothing)


def on_host(feature: Feature) -> bool:
    """Whether a feature is sought in a finished run: a period, a delay, a time of a start."""
    return KINDS[feature.kind].host or feature.kind == PAIR


def measured(
    scene: AbstractModel, wanted: Sequence[Feature], times: np.ndarray, value: Histories,
    slopes: Histories | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Features (F,) of a finished run, and their derivatives (F, P); by no parameter without ``slopes``."""
    by = value.constant if slopes is None else slopes
    return measure(times, value, by, wanted, scene.members, scene.traits.turning)


def _program(scene: AbstractModel, asked: tuple, mesh: Mesh | None, points: Points, how: Plan, count: Array) -> tuple:
    return derivatives.divided(partial(_part, scene, asked), mesh, points, how, count)


def _part(scene: AbstractModel, asked: tuple, points: Points, how: Plan, count: Array) -> tuple:
    """What one device does; ``asked``: the samples' times, the features, and whether histories are wanted on the host."""
    from bcfj_jax.solve.work_queue import equilibria, integrate_queue  # With diffrax, which a kept program needs not.

    (samples, wanted, host), (params, ends, _) = asked, points
    grid = np.frombuffer(samples)

    def look(one: tuple) -> tuple:
        params, end, states = one
        force, depth, rate = read = by_channel(scene, readings(scene, params, end * grid, states))
        features = vector(grid, Histories(force, depth, rate, None), wanted, scene.members, {})
        return features, *(read if host else (None, None, None))

    rounds = jnp.asarray(0)
    if has_history(scene):
        solution, rounds = integrate_queue(scene, points, how, count, min(derivatives.places(), ends.size))
    else:
        solution = equilibria(scene, points)
    features, *read = jax.lax.map(
        look, (params, ends, solution.states), batch_size=min(_AT_ONCE[backend.on_cpu()], ends.size)
    )
    return features, solution.code, solution.end, solution.accepted + solution.rejected, rounds, *read


def _with_derivatives(study: Study, points: Points, wrt: tuple[str, ...], how: Plan, size: int) -> Batch:
    """As ``run``, with derivatives of the features."""
    found = derivatives.run(study.given.scene, points, wrt, how, size, derivatives.More(study.histories))
    rows = np.full((len(points.ends), len(study.columns)), np.nan)
    for i in np.flatnonzero(found.code == OK):
        both = measured(study.given.scene, study.features, points.ends[i] * points.grid, *found.one(int(i)))
        rows[i] = np.concatenate([x.ravel() for x in both])
    reasons = [reason(code, how.max_steps) for code in found.code]
    force = found.value.force if study.histories else np.zeros((len(rows), 0, 0, 0))
    return Batch(rows, reasons, found.end, found.steps, found.rounds, force)


def _one_by_one(study: Study, points: Points, wrt: tuple[str, ...], safety: float) -> Batch:
    """As ``run``, for what has no batch (``together``)."""
    given, scene = study.given, study.given.scene
    finer = plan(scene, given.accuracy, given.max_steps)
    rows: list[tuple] = []
    for i, end in enumerate(points.ends):
        one, times, peaks, slopes = points.one(i), end * points.grid, {}, None
        if wrt:
            found = differentiated(given, wrt, one, times, safety)
            value, slopes, stop, steps = found.value, found.derivative, found.end, found.steps
            why = reason(found.code, given.max_steps)
        else:
            single = simulated(given, one, times, safety)
            value = of_run(single)
            why, stop, steps = single.reason, single.failure_time, single.stats["accepted"] + single.stats["rejected"]
            peaks = {name: x["peak"] for name, x in resolved(single).items()} if given.resolved_peaks else {}
        numbers, by = measured(scene, study.features, times, value, slopes)
        with_events(Problem(scene, one, times, wrt, study.features), finer, numbers, by, safety * TIGHTER)
        for k, feature in enumerate(study.features):
            if feature.kind == "peak" and peaks:
                numbers[k] = max(peaks[name] for name in members(feature.contacts[0], scene.members))
        row = np.concatenate([numbers, by.ravel()])
        rows.append((np.full_like(row, np.nan) if why else row, why, stop, int(steps), value.force))
    features, whys, stop, steps, force = zip(*rows, strict=True)
    return Batch(np.array(features), list(whys), np.array(stop), np.array(steps), 0, np.array(force))


def _of_steady(study: Study, points: Points, wrt: tuple[str, ...], how: Plan, size: int) -> Batch:
    """As ``run``, of one turn of steady motion; where it does not repeat itself, the reason says so.

    All points run to their ends in one batch; from there each point's orbit is found by itself, whose matrix over all states
    leaves nothing to gain by doing several side by side (docs/studies.md). It has its own tolerances.
    """
    scene, count = study.given.scene, len(points.ends)
    found = to_the_end(scene, points.params, points.ends, how, size)
    rows, steps = np.full((count, len(study.columns)), np.nan), found.steps.copy()
    reasons = [reason(int(code), how.max_steps) for code in found.code]
    for i in np.flatnonzero(found.code == OK):
        problem = Problem(scene, points.one(i), points.ends[i : i + 1], wrt, study.features, max_steps=how.max_steps)
        orbit = steady(problem, found.state[i], float(points.ends[i]))
        reasons[i] = "its motion has no pitch" if orbit is None else orbit.reason
        if orbit is None or orbit.reason:
            continue
        steps[i] += orbit.steps
        numbers = [orbit.features[f.name] for f in study.features]
        rows[i] = numbers + [orbit.feature_derivatives[p][f.name] for f in study.features for p in wrt]
    return Batch(rows, reasons, found.end, steps, found.rounds, np.zeros((count, 0, 0, 0)))
