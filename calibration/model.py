"""From a point of the search space to weighted residuals and their Jacobian, all experiments at once.

A point is a vector of unit-box coordinates: 0 and 1 are a parameter's bounds, in its logarithm where
its scale is logarithmic. Where stiffness K and exponent n are both free, the coordinate of K is that of
F_ref = K d_ref^n at a penetration d_ref inside the data, which the data determine far better than K.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax import force_history
from bcfj_jax.derivatives.names import complete
from bcfj_jax.integrate import Plan, plan
from bcfj_jax.scene import AbstractScene
from calibration.problem import COMPONENTS, NUISANCES, Experiment, Problem


class Slot(NamedTuple):
    """One coordinate: which parameter, which experiment (None: shared), its bounds on the search scale."""

    name: str
    experiment: int | None
    log: bool
    lower: float
    upper: float

    def label(self, experiments: tuple[Experiment, ...]) -> str:
        """Name in results: the experiment is added where there are several."""
        own = self.experiment is not None and len(experiments) > 1
        return f"{self.name}[{experiments[self.experiment].name}]" if own and self.experiment is not None else self.name


class Data(eqx.Module):
    """Records padded to one length: times (E, T), values and weights 1/sigma (E, C, T); weight 0 is no sample."""

    times: Array
    values: Array
    weights: Array
    fixed: dict[str, Array]


class Model(eqx.Module):
    """The residual function of a problem's experiments, ready to be compiled once."""

    scene: AbstractScene
    slots: tuple[Slot, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    data: Data
    how: Plan

    @property
    def referenced(self) -> bool:
        """Whether stiffness is searched as a reference force."""
        shared = {slot.name for slot in self.slots if slot.experiment is None}
        return {"stiffness", "exponent"} <= shared and all(s.log for s in self.slots if s.name == "stiffness")

    def values(self, point: Array, log_depth: Array) -> list[Array]:
        """Parameter values, SI, one a slot, at a unit-box point; ``log_depth`` is ln d_ref."""
        lower, width = self.box(log_depth)
        z = lower + point * width
        values = [jnp.exp(z[i]) if slot.log else z[i] for i, slot in enumerate(self.slots)]
        if self.referenced:
            k, n = self.pair()
            values[k] = jnp.exp(z[k] - values[n] * log_depth)
        return values

    def point(self, values: np.ndarray, log_depth: float) -> np.ndarray:
        """The inverse of ``values``, for NumPy vectors."""
        z = np.array([np.log(v) if slot.log else v for v, slot in zip(values, self.slots, strict=True)])
        if self.referenced:
            k, n = self.pair()
            z[k] += values[n] * log_depth
        lower, width = self.box(jnp.asarray(log_depth))
        return (z - np.asarray(lower)) / np.asarray(width)

    def pair(self) -> tuple[int, int]:
        """Slots of the shared stiffness and exponent."""
        names = [slot.name if slot.experiment is None else "" for slot in self.slots]
        return names.index("stiffness"), names.index("exponent")

    def box(self, log_depth: Array) -> tuple[Array, Array]:
        """Lower bounds and widths of the coordinates on the search scale."""
        lower = jnp.array([slot.lower for slot in self.slots])
        upper = jnp.array([slot.upper for slot in self.slots])
        if self.referenced:
            k, n = self.pair()
            exponents = [jnp.exp(b[n]) if self.slots[n].log else b[n] for b in (lower, upper)]
            shifts = jnp.stack([e * log_depth for e in exponents])
            lower, upper = lower.at[k].add(shifts.min()), upper.at[k].add(shifts.max())
        return lower, upper - lower

    def predictions(self, point: Array, log_depth: Array) -> Array:
        """What each channel would have read, (E, C, T) [N]."""
        values = self.values(point, log_depth)
        count = self.data.times.shape[0]
        table = {name: jnp.broadcast_to(v, (count,)) for name, v in self.data.fixed.items()}
        nuisance = {"time_offset": jnp.zeros(count), "force_offset": jnp.zeros(count), "gain": jnp.ones(count)}
        for slot, value in zip(self.slots, values, strict=True):
            target = nuisance if slot.name in NUISANCES else table
            where = slice(None) if slot.experiment is None else slot.experiment
            target[slot.name] = target[slot.name].at[where].set(value)

        def one(params, own, times):
            shifted = times - own["time_offset"]
            forces = force_history(self.scene, params, shifted, accuracy=self.how, mode="forward")
            readings = [_component(forces, channel) for channel in self.channels]
            return own["gain"] * jnp.stack(readings) + own["force_offset"]

        return jax.vmap(one)(table, nuisance, self.data.times)

    def residuals(self, point: Array, log_depth: Array) -> Array:
        """Weighted residuals (prediction - value) / sigma, flat; 0 where there is no sample."""
        seen = self.data.weights > 0
        difference = jnp.where(seen, self.predictions(point, log_depth) - self.data.values, 0.0)
        return (difference * self.data.weights).ravel()


def _component(forces: dict[str, Array], channel: str) -> Array:
    contact, _, component = channel.partition(".")
    if contact in forces:
        return forces[contact][:, COMPONENTS.index(component)]
    whole, _, member = contact.rpartition("_")
    return forces[whole][:, int(member) - 1, COMPONENTS.index(component)]


@eqx.filter_jit
def residuals_and_jacobian(model: Model, point: Array, log_depth: Array) -> tuple[Array, Array]:
    """Residuals (N,) and their forward-mode Jacobian (N, P) at one point."""
    return _both(model, log_depth, point)


@eqx.filter_jit
def batch(model: Model, points: Array, log_depth: Array) -> tuple[Array, Array]:
    """Residuals (B, N) and Jacobians (B, N, P) at several points, in one program."""
    return jax.vmap(partial(_both, model, log_depth))(points)


@eqx.filter_jit
def predictions(model: Model, point: Array, log_depth: Array) -> Array:
    """What each channel would have read, (E, C, T) [N]."""
    return model.predictions(point, log_depth)


def _both(model: Model, log_depth: Array, point: Array) -> tuple[Array, Array]:
    function = partial(model.residuals, log_depth=log_depth)
    residual, push = jax.linearize(function, point)
    return residual, jax.vmap(push, out_axes=1)(jnp.eye(point.size))


def assumed_sigma(channel_values: np.ndarray) -> float:
    """Weight of a channel whose noise is to be estimated: 1 % of its largest reading [N]."""
    return 0.01 * float(np.nanmax(np.abs(channel_values)))


def build(problem: Problem, experiments: tuple[Experiment, ...], slots: tuple[Slot, ...] | None = None) -> Model:
    """The model of some of a problem's experiments (those to fit, or those held out)."""
    channels = tuple(dict.fromkeys(c.observes for e in experiments for c in e.channels))
    longest = max(e.times.size for e in experiments)
    shape = (len(experiments), len(channels), longest)
    values, weights, times = np.zeros(shape), np.zeros(shape), np.zeros((shape[0], longest))
    for i, experiment in enumerate(experiments):
        count = experiment.times.size
        step = experiment.times[-1] - experiment.times[-2] if count > 1 else 1e-6
        times[i, :count] = experiment.times
        times[i, count:] = experiment.times[-1] + 1e-3 * step * np.arange(1, longest - count + 1)
        for channel in experiment.channels:
            j = channels.index(channel.observes)
            seen = np.isfinite(channel.values)
            sigma = channel.sigma if channel.sigma is not None else assumed_sigma(channel.values)
            values[i, j, :count] = np.where(seen, channel.values, 0.0)
            weights[i, j, :count] = seen / sigma
    # A contact's own coefficient that is searched, or known of a run, needs a place of its own.
    own = [f.name for f in problem.free if f.name not in NUISANCES] + [name for e in experiments for name in e.fixed]
    given = {name: jnp.asarray(value) for name, value in problem.params.items()}
    params = complete(problem.scene, given, tuple(dict.fromkeys(own)))[0] if own else given
    fixed = {
        name: jnp.array([e.fixed.get(name, float(value)) for e in experiments], dtype=float)
        for name, value in params.items()
    }
    data = Data(jnp.asarray(times), jnp.asarray(values), jnp.asarray(weights), fixed)
    how = plan(problem.scene, problem.accuracy, max_steps=20_000)
    return Model(problem.scene, slots or make_slots(problem, len(experiments)), channels, data, how)


def make_slots(problem: Problem, experiments: int) -> tuple[Slot, ...]:
    """One coordinate for each shared parameter, then one for each experiment of the others."""
    slots = []
    for f in sorted(problem.free, key=lambda f: f.per_experiment):
        low, high = (np.log(f.lower), np.log(f.upper)) if f.log else (f.lower, f.upper)
        owners = range(experiments) if f.per_experiment else [None]
        slots += [Slot(f.name, owner, f.log, float(low), float(high)) for owner in owners]
    return tuple(slots)
