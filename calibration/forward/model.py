"""From a point of the search space to weighted residuals and their Jacobian, all experiments at once.

A point is a vector of unit-box coordinates: 0 and 1 are a parameter's bounds, in its logarithm where
its scale is logarithmic. Where stiffness K and exponent n are both free, the coordinate of K is that of
F_ref = K d_ref^n at a penetration d_ref inside the data, which the data determine far better than K.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax import reading_history
from bcfj_jax.analysis.derivatives.jacobian import Histories, histories
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.xla.programs import program
from calibration import attitudes
from calibration.filters import Filter
from calibration.forward.coordinates import Coordinate, coordinates_of
from calibration.forward.losses import loss_of
from calibration.forward.observables import (
    ObservedFeatures,
    Passed,
    fine,
    grid,
    is_single,
    measured,
    observed_features,
    single,
    tabulated,
    through,
)
from calibration.problem import NEUTRAL, NUISANCES, OFFSETS, Experiment, Problem, offsets_of
from calibration.solver_budget import budget

# Parts of a measuring chain, by their nuisances: what no experiment names is not compiled.
_CHAIN = (
    ("time_offset", "force_offset", "gain"), ("bandwidth",), ("cutoff",), ("resonance", "resonance_damping"), ("gain_bend",),
    ("drift",), ("hum_frequency", "hum_sine", "hum_cosine"),
)  # fmt: skip
# Steps over a record that its force is sampled in where a sensor's low-pass is to be applied.
_FINE_STEPS = 2000
# A filter that is run back over a record begins by so much of its span after the last sample.
_BEYOND = 0.25
# So many times the steps where tangents count in their control: of the joint with all options, 0.3 s by BDF at 3e-4 take
# more than a method of order 2 would say.
_FOR_TANGENTS = 4
# Points that one call of the compiled program takes, one after the other: on a CPU a batch of them would cost several
# times as much, and all would wait for the slowest.
_ROWS = 12


class Data(eqx.Module):
    """Records padded to one length, and features: E experiments, C channels, T times, F features."""

    times: Array  # (E, T) [s]
    # values, weights: (E, C, T) readings, SI, and 1/sigma; weight 0 is no sample.
    values: Array
    weights: Array
    memory: Array  # (E, C, T) correlation of a sample's noise with the one before, whose index is ``previous``
    previous: Array
    # features, feature_weights: (E, F) likewise.
    features: Array
    feature_weights: Array
    # fixed, chain: by name (E,), scene parameters and nuisances where they are not searched.
    fixed: dict[str, Array]
    chain: dict[str, Array]
    passed: Passed | None = None  # the filter between sensor and record, or None

    def white(self, errors: Any) -> Any:
        """Errors of the readings (E, C, T) [SI] as residuals: in deviations, freed of the noise's memory, 0 of no sample."""
        xp, seen = _numpy(errors, self.weights), self.weights > 0
        weighted = xp.where(seen, errors, 0.0) * self.weights
        before = xp.take_along_axis(weighted, self.previous, axis=-1)
        return xp.where(seen, (weighted - self.memory * before) / xp.sqrt(1.0 - xp.square(self.memory)), 0.0)


class Model(eqx.Module):
    """The residual function of a problem's experiments, ready to be compiled once.

    Its arrays are NumPy's, and of NumPy arrays its methods are NumPy; inside the compiled program both are traced.
    Problems that differ in numbers only share that program. ``bounds`` (2, P) are the coordinates' own; ``log_depth`` is the
    logarithm of the reference penetration [m].
    """

    scene: AbstractModel
    coordinates: tuple[Coordinate, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    data: Data
    how: Plan
    bounds: Array
    log_depth: Any = 0.0
    observed_features: tuple[ObservedFeatures, ...] = eqx.field(static=True, default=())
    parts: int = eqx.field(static=True, default=0)
    loss: str = eqx.field(static=True, default="linear")

    @property
    def unknowns(self) -> int:
        """Numbers that are searched."""
        return len(self.coordinates)

    @property
    def referenced(self) -> bool:
        """Whether stiffness is searched as a reference force."""
        shared = {axis.name for axis in self.coordinates if axis.experiment is None}
        return {"stiffness", "exponent"} <= shared and all(s.log for s in self.coordinates if s.name == "stiffness")

    def at_depth(self, log_depth: float) -> Model:
        """The model with another reference penetration."""
        return replace(self, log_depth=log_depth)

    def values(self, points: Any) -> Any:
        """Parameter values (..., P), SI, at unit-box points (..., P)."""
        xp = _numpy(points, self.log_depth, self.bounds)
        lower, width = self.box
        z = lower + points * width
        values = [xp.exp(z[..., i]) if axis.log else z[..., i] for i, axis in enumerate(self.coordinates)]
        if self.referenced:
            k, n = self.pair()
            values[k] = xp.exp(z[..., k] - values[n] * self.log_depth)
        return xp.stack(values, axis=-1)

    def point(self, values: np.ndarray) -> np.ndarray:
        """The inverse of ``values``, for NumPy vectors (..., P)."""
        z = np.array(values, dtype=float)
        log = [axis.log for axis in self.coordinates]
        z[..., log] = np.log(z[..., log])
        if self.referenced:
            k, n = self.pair()
            z[..., k] += np.asarray(values)[..., n] * self.log_depth
        lower, width = self.box
        return (z - lower) / width

    def pair(self) -> tuple[int, int]:
        """Coordinates of the shared stiffness and exponent."""
        names = [axis.name if axis.experiment is None else "" for axis in self.coordinates]
        return names.index("stiffness"), names.index("exponent")

    @property
    def box(self) -> tuple[Any, Any]:
        """Lower bounds and widths of the coordinates on the search scale."""
        xp = _numpy(self.log_depth, self.bounds)
        lower, upper = self.bounds
        if self.referenced:
            k, n = self.pair()
            shifts = (xp.exp(self.bounds[:, n]) if self.coordinates[n].log else self.bounds[:, n]) * self.log_depth
            stiffness = np.arange(len(self.coordinates)) == k
            lower, upper = lower + stiffness * shifts.min(), upper + stiffness * shifts.max()
        return lower, upper - lower

    def settings(self, point: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Scene parameters and nuisances (E,) by name at a point (P,), or at one for each experiment (E, P)."""
        xp, count = _numpy(point, self.log_depth, self.bounds), self.data.times.shape[0]
        table, chain = (
            {name: xp.broadcast_to(v, (count,)) for name, v in known.items()}
            for known in (self.data.fixed, self.data.chain)
        )
        for axis, value in zip(self.coordinates, xp.moveaxis(self.values(point), -1, 0), strict=True):
            target = chain if axis.name in NUISANCES else table
            own = axis.experiment is None or np.arange(count) == axis.experiment
            target[axis.name] = xp.where(own, value, target[axis.name])
        return table, chain

    @property
    def own(self) -> np.ndarray | None:
        """Coordinates (E, L) that each experiment depends on, -1 for none; None where all depend on all."""
        owners = [axis.experiment for axis in self.coordinates]
        if all(k is None for k in owners):
            return None
        each = [[k for k, of in enumerate(owners) if of in (None, i)] for i in range(self.data.times.shape[0])]
        most = max(map(len, each))
        return np.array([one + [-1] * (most - len(one)) for one in each])

    def predictions(self, point: Array) -> Array:
        """What each channel would have read, (E, C, T), SI; of an attitude as ``attitudes.compared``."""
        passed = self.data.passed

        def one(params: dict, own: dict, times: Array, values: Array) -> Array:
            shifted = times - own["time_offset"]
            # Samples may stand in any order; of those that read the initial state, a batch is done at its first step.
            order = jnp.argsort(shifted)
            beyond = 0.0 if passed is None else _BEYOND
            places = jnp.argsort(order)
            sampled, places = fine(shifted, self.parts, beyond) if self.parts else (shifted[order], places)
            # A body that is at a place at time 0 came there with the speed that it has then.
            speeds = {
                c: c.replace(".place.", ".velocity.") for c in self.channels if ".place." in c and " in " not in c
            }
            chained = (*self.channels, *self.scalars)
            read = tuple(dict.fromkeys((*chained, *speeds.values())))
            seen = reading_history(self.scene, params, sampled, read, accuracy=self.how)
            before = jnp.minimum(sampled, 0.0)
            readings = [seen[c] + (seen[speeds[c]][0] * before if c in speeds else 0.0) for c in chained]
            read = through(own, sampled, jnp.stack(readings, axis=1), self._offsets(own, chained), passed)[places].T
            if not self.scalars:
                return read
            known = attitudes.compared(
                dict(zip(chained, read, strict=True)), dict(zip(self.channels, values, strict=True))
            )
            return jnp.stack([known[c] for c in self.channels])

        if not self.channels:
            return jnp.zeros(self.data.values.shape)
        return jax.vmap(one)(*self.settings(point), self.data.times, jnp.asarray(self.data.values))

    @property
    def scalars(self) -> tuple[str, ...]:
        """Scalar parts of the attitudes among the channels."""
        return tuple(attitudes.scalar(parts["q1"]) for parts in attitudes.attitudes(self.channels).values())

    def _offsets(self, own: dict[str, Array], channels: tuple[str, ...]) -> Array:
        """What each channel reads where there is nothing to read, (C,)."""
        sums = [sum(own[o] for o in offsets_of(c, channels) if o in own) for c in channels]
        return jnp.stack([jnp.asarray(x, dtype=float) for x in sums])

    def features(self, point: Array) -> Array:
        """What each experiment's features would have been, (E, F), 0 where there is none."""
        table, chain = self.settings(point)
        rows = []
        for i, observed in enumerate(self.observed_features):
            values = jnp.zeros(self.data.features.shape[1])
            if observed.names:
                times, own = jnp.asarray(grid(observed)), {name: v[i] for name, v in chain.items()}
                params = {name: v[i] for name, v in table.items()}
                ones = np.array([is_single(name) for name in observed.names])
                if ones.any():
                    each = single(self.scene, params, observed, self.how, own)
                    values = values.at[: len(observed.names)].set(each)
                if ones.all():
                    rows.append(values)
                    continue
                found, _ = histories(self.scene, params, times, self.how)
                flat = found.force.reshape(times.size, -1)
                force = through(own, times, flat, own["force_offset"], self.data.passed).reshape(found.force.shape)
                seen = Histories(force, found.penetration, found.rate, None)
                whole = measured(self.scene, observed, seen)
                values = values.at[: len(observed.names)].set(jnp.where(ones, values[: len(ones)], whole))
            rows.append(values)
        return jnp.stack(rows) if rows else jnp.zeros(self.data.features.shape)

    def residuals(self, point: Array) -> Array:
        """Residuals (prediction - value) / sigma, freed of their noise's memory, flat: readings, then features.

        0 where there is no sample.
        """
        return self.compared(point)[0]

    def compared(self, point: Array) -> tuple[Array, Array]:
        """``residuals``, and the ``predictions`` that they are of."""
        d, read, fitted = self.data, self.predictions(point), self.data.feature_weights > 0
        features = jnp.where(fitted, self.features(point) - d.features, 0.0) * d.feature_weights
        return jnp.concatenate([d.white(read - d.values).ravel(), features.ravel()]), read

    def cost(self, residuals: np.ndarray) -> np.ndarray:
        """Sum of what each of the residuals (..., N) costs."""
        return np.sum(loss_of(self.loss, np.square(residuals))[0], axis=-1)


def _numpy(*values: Any) -> Any:
    """NumPy for arrays of the host, on which nothing is compiled; ``jax.numpy`` for traced ones."""
    return jnp if any(isinstance(x, Array) for x in values) else np


class Evaluated(NamedTuple):
    """At B points: residuals (B, N), their Jacobians (B, N, P), and what each channel would have read (B, E, C, T), SI."""

    residuals: Any
    jacobians: Any
    readings: Any


def evaluation(model: Model) -> Callable[[np.ndarray], Evaluated]:
    """The model at unit-box points (B, P), B as many as may be: always the same compiled program."""
    rows, width = 1 if budget(model).apart else _ROWS, len(model.coordinates)
    frame, numbers = divided(model)
    run, _ = program("calibration", _evaluated, (frame,), (numbers, np.zeros((rows, width)), 0))
    # Handed over once: a run may take a millisecond, of which NumPy's arrays would take half.
    numbers = jax.tree.map(lambda x: x if np.isscalar(x) else jax.device_put(x), numbers)

    def at(points: np.ndarray) -> Evaluated:
        found = []
        for block in (points[first : first + rows] for first in range(0, len(points), rows)):
            filled = np.zeros((rows, width))
            filled[: len(block)] = block
            found.append(tuple(part[: len(block)] for part in run(numbers, filled, len(block))))
        return Evaluated(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    return at


def residuals_and_jacobian(model: Model, point: Any) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (N,) and their forward-mode Jacobian (N, P) at one point."""
    found = evaluation(model)(np.asarray(point)[None])
    return found.residuals[0], found.jacobians[0]


def predictions(model: Model, point: Any) -> np.ndarray:
    """What each channel would have read, (E, C, T), SI."""
    return evaluation(model)(np.asarray(point)[None]).readings[0]


def divided(model: Model) -> tuple[Model, tuple[Any, ...]]:
    """A model without its numbers, which is what a program is made of, and these."""
    bare = tuple(axis._replace(lower=0.0, upper=1.0, decades=False) for axis in model.coordinates)
    how = replace(model.how, tolerance=None, longest=None)
    frame = replace(model, data=None, how=how, bounds=None, log_depth=None, coordinates=bare, loss="")
    return frame, (model.data, (model.how.tolerance, model.how.longest), model.bounds, float(model.log_depth))


def whole(frame: Model, numbers: tuple[Any, ...]) -> Model:
    """The model of ``divided``'s two parts."""
    data, (tolerance, longest), bounds, log_depth = numbers
    how = replace(frame.how, tolerance=tolerance, longest=longest)
    return replace(frame, data=data, how=how, bounds=bounds, log_depth=log_depth)


def _evaluated(frame: Model, numbers: tuple[Any, ...], points: Array, count: Array) -> Evaluated:
    """The first ``count`` points, one after the other; zeros for the others."""
    model = whole(frame, numbers)
    own = model.own

    def along(u: Array) -> tuple[Array, tuple[Array, Array]]:
        """Jacobian (N, P), and what stands beside it: an experiment has tangents by its own coordinates alone."""
        # Not by ``jax.linearize``, which wants a tangent for every point and not all directions at once.
        if own is None:
            return jax.jacfwd(both, has_aux=True)(u)
        columns = jnp.asarray((own[:, :, None] == np.arange(u.size)).astype(float))
        slopes, beside = jax.jacfwd(lambda by: both(u + jnp.einsum("l,elp->ep", by, columns)), has_aux=True)(
            jnp.zeros(own.shape[1])
        )
        parts = jnp.split(slopes, [model.data.values.size])
        spread = [jnp.einsum("enl,elp->enp", part.reshape(len(own), -1, own.shape[1]), columns) for part in parts]
        return jnp.concatenate([part.reshape(-1, u.size) for part in spread]), beside

    def both(u: Array) -> tuple[Array, tuple[Array, Array]]:
        residuals, read = model.compared(u)
        return residuals, (residuals, read)

    def one(k: Array, found: Evaluated) -> Evaluated:
        jacobian, (residuals, read) = along(points[k])
        return Evaluated(*(a.at[k].set(b) for a, b in zip(found, (residuals, jacobian, read), strict=True)))

    data = model.data
    shape = (len(points), data.values.size + data.features.size)
    parts = shape, (*shape, points.shape[1]), (len(points), *data.values.shape)
    return jax.lax.fori_loop(0, count, one, Evaluated(*map(jnp.zeros, parts)))


def build(
    problem: Problem, experiments: tuple[Experiment, ...], coordinates: tuple[Coordinate, ...] | None = None
) -> Model:
    """The model of some of a problem's experiments (those to fit, or those held out)."""
    channels = tuple(dict.fromkeys(c.observes for e in experiments for c in e.channels))
    longest = max(1, *(e.times.size for e in experiments))
    shape = (len(experiments), len(channels), longest)
    values, weights, memory, times = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros((shape[0], longest))
    previous = np.zeros(shape, dtype=int)
    for i, experiment in enumerate(experiments):
        count = experiment.times.size
        step = experiment.times[-1] - experiment.times[-2] if count > 1 else 1e-6
        times[i, :count] = experiment.times
        times[i, count:] = (experiment.times[-1] if count else 0.0) + 1e-3 * step * np.arange(1, longest - count + 1)
        for channel in experiment.channels:
            j = channels.index(channel.observes)
            own = np.flatnonzero(np.isfinite(channel.values))
            values[i, j, own] = channel.values[own]
            weights[i, j, own] = 1.0 / channel.deviation(channel.values[own], experiment.times[own])
            previous[i, j, own[1:]] = own[:-1]
            if channel.correlation:
                memory[i, j, own[1:]] = np.exp(-np.diff(experiment.times[own]) / channel.correlation)
    # A contact's own coefficient that is searched, or known of a run, needs a place of its own.
    known = {name for e in experiments for name in e.fixed}
    own = [f.name for f in problem.free if f.name not in NUISANCES] + sorted(known - NUISANCES.keys())
    given: dict[str, Any] = dict(problem.params)
    params = complete(problem.scene, given, tuple(dict.fromkeys(own)))[0] if own else given
    named = known | {f.name for f in problem.free}
    filtered = bool(named & {"bandwidth", "resonance", "cutoff"})
    parts = [part for part in _CHAIN if part is _CHAIN[0] or named & set(part)]
    chain = {name: NEUTRAL[name] for part in parts for name in part}
    chain |= {name: 0.0 for name in OFFSETS.values() if name in named}
    fixed, chain = (
        {name: np.array([e.fixed.get(name, float(value)) for e in experiments]) for name, value in table.items()}
        for table in (params, chain)
    )
    features, feature_weights = tabulated(experiments)
    arrays = (times, values, weights, memory, previous, features, feature_weights)
    axes = coordinates or coordinates_of(problem, experiments)
    how = plan(problem.scene, problem.accuracy, max_steps=_steps(problem))
    observed = observed_features(problem.scene, experiments)
    # Single contacts are followed by such steps always.
    followed = problem.scene.traits.stiff and any(is_single(name) for one in observed for name in one.names)
    if how.tangents or followed:
        how = replace(how, max_steps=_FOR_TANGENTS * how.max_steps)
    return Model(
        scene=problem.scene,
        coordinates=axes,
        channels=channels,
        data=Data(*arrays, fixed=fixed, chain=chain, passed=passed_of(problem)),  # pyright: ignore[reportArgumentType]
        bounds=np.array([[axis.lower for axis in axes], [axis.upper for axis in axes]]),  # pyright: ignore[reportArgumentType]
        how=how,
        observed_features=observed,
        parts=max(4, -(-_FINE_STEPS // longest)) if filtered else 0,
        loss=problem.loss,
    )


def passed_of(problem: Problem) -> Passed | None:
    """Numbers of the filter between sensor and record: all filters share one program."""
    if not isinstance(problem.filter, Filter):
        return None
    return Passed(*problem.filter.terms, np.array(problem.filter.zero_phase))  # pyright: ignore[reportArgumentType]


def _steps(problem: Problem) -> int:
    """Attempted steps of a run until it has failed: more where finer ones are asked for, as of a method of order 2."""
    means = budget(problem)
    return int(means.steps * max(1.0, means.accuracy / problem.accuracy) ** 0.5)
