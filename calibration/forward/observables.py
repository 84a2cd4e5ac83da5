"""What a measuring chain makes of the model's forces: a sensor's low-pass, and features of a run. Pure, in JAX."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis import histories as comparison
from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names
from bcfj_jax.analysis.derivatives.measures import vector
from bcfj_jax.analysis.derivatives.names import event, feature, members
from bcfj_jax.analysis.derivatives.trains import flat, instants, planned, train
from bcfj_jax.analysis.features import EVENTS
from bcfj_jax.core.status import OK
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import Plan
from calibration.problem import Experiment

# Single contacts are sought for so many times as long as they were measured: on the way to an optimum they come late.
_LATER = 1.25
# A delay is sought over so many times its measured size, both signs together, and over so many samples at least.
_NEAR, _FEWEST = 2.5, 32


class ObservedFeatures(NamedTuple):
    """Features of one experiment: names, about what a period or a delay is [s], the last time [s], samples."""

    names: tuple[str, ...]
    about: tuple[float, ...]
    end: float
    count: int


class Passed(NamedTuple):
    """Numbers of a low-pass: rates and weights (K,) of ``filters.Filter.terms``, and whether it is run back."""

    rates: Array
    weights: Array
    back: Array


def low_pass(times: Array, values: Array, bandwidth: Array) -> Array:
    """Output of a first-order sensor, y' = 2 pi bandwidth (x - y), bandwidth [Hz], of inputs (T, C) at times (T,), not
    decreasing.

    At rest before the first time; exact for an input that is linear between samples.
    """
    return _first_order(times, values, 2.0 * jnp.pi * bandwidth)


def resonant(times: Array, values: Array, frequency: Array, damping: Array) -> Array:
    """Output of a second-order sensor, y'' + 2 z w y' + w^2 y = w^2 x, of w / 2 pi [Hz] and z above 0 and below 1; as
    ``low_pass``.

    With s = sqrt(1 - z^2), y is the imaginary part of u (z + i s)/s, u' = w (z - i s) (x - u).
    """
    s = jnp.sqrt(1.0 - jnp.square(damping))
    pole = jax.lax.complex(damping, s)
    u = _first_order(times, values, 2.0 * jnp.pi * frequency * jnp.conj(pole))
    return jnp.imag(u * pole / s)


def filtered(times: Array, values: Array, cutoff: Array, passed: Passed) -> Array:
    """Output of a low-pass (``calibration.filters``), at rest before the first time, and after the last where it is run back.

    Exact for an input that is linear between samples, and so is each of two passes.
    """
    w = 2.0 * jnp.pi * cutoff

    def once(clock: Array, x: Array) -> Array:
        each = jax.vmap(lambda rate: _first_order(clock, x, rate * w))(passed.rates)
        return jnp.real(jnp.tensordot(passed.weights, each, 1))

    forward = once(times, values)
    return jnp.where(passed.back, once(-times[::-1], forward[::-1])[::-1], forward)


def through(
    chain: Mapping[str, Array], times: Array, values: Array, offset: Array, passed: Passed | None = None
) -> Array:
    """What a measuring chain reads of values (T, C) that the model has at times (T,) of its clock, not decreasing.

    ``chain``: nuisances by name, of one record (``problem.NUISANCES``); parts that it does not name are not compiled.
    ``offset``: () or (C,) readings where there is nothing to read. ``passed``: the filter whose cutoff ``chain`` names.
    """
    if "bandwidth" in chain:
        values = low_pass(times, values, chain["bandwidth"])
    if "resonance" in chain:
        values = resonant(times, values, chain["resonance"], chain["resonance_damping"])
    if "gain_bend" in chain:
        values = values * (1.0 + chain["gain_bend"] * jnp.abs(values))
    if passed is not None:
        values = filtered(times, values, chain["cutoff"], passed)
    read, clock = chain["gain"] * values + offset, times[:, None] + chain["time_offset"]
    if "drift" in chain:
        read = read + chain["drift"] * clock
    if "hum_frequency" in chain:
        angle = 2.0 * jnp.pi * chain["hum_frequency"] * clock
        read = read + chain["hum_sine"] * jnp.sin(angle) + chain["hum_cosine"] * jnp.cos(angle)
    return read


def _first_order(times: Array, values: Array, rate: Array) -> Array:
    """Of y' = rate (x - y), ``rate`` [1/s] real or complex."""
    steps = jnp.diff(times)
    angle = rate * steps
    keep = jnp.exp(-angle)
    some = steps > 0
    mean = jnp.where(some, -jnp.expm1(-angle) / jnp.where(some, angle, 1.0), 1.0)
    pushed = (mean - keep)[:, None] * values[:-1] + (1.0 - mean)[:, None] * values[1:]
    return _recursion(keep, pushed, values[0])


def _recursion(keep: Array, pushed: Array, first: Array) -> Array:
    """u_0 = first (C,), u_n+1 = keep_n u_n + pushed_n, (N + 1, C); keep (N,), pushed (N, C).

    Blocks side by side from 0, then from block to block: some 2 sqrt(N) steps one after the other.
    """
    count = keep.size
    width = math.isqrt(max(count - 1, 0)) + 1
    rest = -count % width
    keep = jnp.pad(keep, (0, rest), constant_values=1.0).reshape(-1, width).T[..., None]
    pushed = jnp.pad(pushed, ((0, rest), (0, 0))).reshape(-1, width, pushed.shape[1]).transpose(1, 0, 2)

    def inside(
        state: tuple[Array, Array], step: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        state = step[0] * state[0], step[0] * state[1] + step[1]
        return state, state

    begin = jnp.ones_like(keep[0]), jnp.zeros_like(pushed[0])
    (kept, sums), (each_kept, each_sum) = jax.lax.scan(inside, begin, (keep, pushed))
    across = lambda u, block: (block[0] * u + block[1], u)  # noqa: E731
    starts = jax.lax.scan(across, first.astype(sums.dtype), (kept, sums))[1]
    found = (each_kept * starts + each_sum).transpose(1, 0, 2).reshape(-1, first.size)[:count]
    return jnp.concatenate([first.astype(found.dtype)[None], found])


def fine(times: Array, parts: int, beyond: float = 0.0) -> tuple[Array, Array]:
    """Times with ``parts`` steps in each of their own, from 0 or before, and where the given ones are among them.

    ``beyond``: by which share of their span they go on after the last.
    """
    first = jnp.linspace(jnp.minimum(times[0], 0.0), times[0], 8 * parts, endpoint=False)
    steps = jnp.arange(parts) / parts
    between = (times[:-1, None] + jnp.diff(times)[:, None] * steps).ravel()
    places = 8 * parts + parts * jnp.arange(times.size)
    after = times[-1] + beyond * (times[-1] - times[0]) * jnp.arange(1, 8 * parts + 1 if beyond else 1) / (8 * parts)
    return jnp.concatenate([first, between, times[-1:], after]), places


def measured(scene: AbstractModel, observed: ObservedFeatures, found: Histories) -> Array:
    """The observed features (F,) of histories at ``grid(observed)``."""
    contacts, times = scene.members, grid(observed)
    wanted = [feature(name, contacts) for name in observed.names]
    values = vector(times, found, wanted, contacts, {})
    place = {name: k for k, name in enumerate(channel_names(contacts))}
    for k, one in enumerate(wanted):
        if one.kind == "period":
            own = [place[m] for m in members(one.contacts[0], contacts)]
            cycles = [_period(scene, times, found, i, observed.about[k]) for i in own]
            values = values.at[k].set(jnp.mean(jnp.stack(cycles)))
        if one.kind == "delay":
            # Sought near the one that was measured: a period later they correlate as well.
            step, whole = float(times[1] - times[0]), float(times[-1] - times[0])
            width = min(max(_NEAR * abs(observed.about[k]), _FEWEST * step), whole)
            values = values.at[k].set(vector(times, found, [one], contacts, dict.fromkeys(place, width))[0])
    return values


def single(
    scene: AbstractModel, params: Params, observed: ObservedFeatures, how: Plan, own: Mapping[str, Array]
) -> Array:
    """The observed features of single contacts (F,), 0 for the others, as the record's clock and gain show them.

    A contact that is not there, on the way to an optimum, has no peak, impulse and width, and is as late as the run ends.
    """
    wanted = [feature(name, scene.members) for name in observed.names]
    channels = channel_names(scene.members)
    asked = {
        k: [(channels.index(m), found[1] - 1) for m in members(one.contacts[0], scene.members)]
        for k, one in enumerate(wanted)
        if (found := event(one.kind))
    }
    rows = sorted({pair for pairs in asked.values() for pair in pairs})
    how, end = planned(scene, how), jnp.asarray(_LATER * observed.end)
    contacts = instants(scene, params, end, how, 1 + max(k for _, k in rows))
    marks = flat(contacts, *np.array(rows).T)
    found, solution, _ = train(scene, params, marks, end, how)
    ran = solution.code == OK
    values = jnp.zeros(len(wanted))
    for k, pairs in asked.items():
        kind = EVENTS[event(wanted[k].kind)[0]]  # pyright: ignore[reportOptionalSubscript]
        # A kind with a time of the record's clock, one of its readings, or neither.
        late = kind.late
        each = kind.of(found)[np.array([rows.index(pair) for pair in pairs])]
        each = jnp.where(jnp.isfinite(each), each, jnp.where(ran, end if late else 0.0, jnp.nan))
        value = kind.members(each) + (own["time_offset"] if late else 0.0)
        values = values.at[k].set(own["gain"] * value if kind.unit.startswith("N") else value)
    return values


def is_single(name: str) -> bool:
    """Whether a feature is of a single contact."""
    return event(name.rpartition(".")[2]) is not None


def grid(observed: ObservedFeatures) -> np.ndarray:
    """Times of the samples that features are taken from [s]."""
    return np.linspace(0.0, observed.end, observed.count)


def tabulated(experiments: tuple[Experiment, ...]) -> tuple[np.ndarray, np.ndarray]:
    """What was measured of features, (E, F), and 1/sigma, 0 where there is none."""
    most = max(len(e.features) for e in experiments)
    values, weights = np.zeros((2, len(experiments), most))
    for i, experiment in enumerate(experiments):
        for k, seen in enumerate(experiment.features):
            values[i, k], weights[i, k] = seen.value, 1.0 / seen.sigma
    return values, weights


def observed_features(scene: AbstractModel, experiments: tuple[Experiment, ...]) -> tuple[ObservedFeatures, ...]:
    """What is to be computed for the features of each experiment; nothing where there is none at all."""
    if not any(e.features for e in experiments):
        return ()
    found = []
    for e in experiments:
        end = float(e.span if e.span is not None else e.times[-1] if e.times.size else 0.0)
        # Two digits say which repetition is meant; more would compile anew for each value.
        about = tuple(float(f"{f.value:.1e}") if f.feature.endswith((".period", ".delay")) else 0.0 for f in e.features)
        found.append(ObservedFeatures(tuple(f.feature for f in e.features), about, end, scene.samples))
    return tuple(found)


def _period(scene: AbstractModel, times: np.ndarray, found: Histories, channel: int, about: float) -> Array:
    if scene.traits.turning:
        late = times >= times[-1] / 3.0
        return comparison.repeated(times[late], found.force[late, channel, 0], about)
    return _interval(times, found.penetration[:, channel], found.rate[:, channel])


def _interval(times: np.ndarray, depth: Array, rate: Array) -> Array:
    """Mean time between the starts of contacts, (last - first)/(count - 1) [s]; NaN for fewer than two."""
    starts = (depth[:-1] <= 0) & (depth[1:] > 0)
    count = jnp.sum(starts)
    first, last = jnp.argmax(starts), starts.size - 1 - jnp.argmax(starts[::-1])
    span = _root(times, depth, rate, last) - _root(times, depth, rate, first)
    return jnp.where(count > 1, span / jnp.where(count > 1, count - 1, 1), jnp.nan)


def _root(times: np.ndarray, depth: Array, rate: Array, k: Array) -> Array:
    """Root of the Hermite cubic between samples k and k + 1; its derivative comes from the last Newton step."""
    h = times[1] - times[0]
    a, b, p, q = depth[k], depth[k + 1], h * rate[k], h * rate[k + 1]
    cubic = lambda s: a + s * (p + s * (3 * (b - a) - 2 * p - q + s * (2 * (a - b) + p + q)))  # noqa: E731
    fixed = jax.lax.stop_gradient

    def halve(_, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (bracket[0] + bracket[1])
        below = fixed(cubic(middle)) <= 0
        return jnp.where(below, middle, bracket[0]), jnp.where(below, bracket[1], middle)

    s = jax.lax.fori_loop(0, 50, halve, (jnp.zeros(()), jnp.ones(())))[0]
    slope = fixed(jax.jvp(cubic, (s,), (jnp.ones(()),))[1])
    return jnp.asarray(times)[k] + h * (s - cubic(s) / slope)
