"""Features of histories and their derivatives along the histories' tangents.

What ``features`` has in JAX is differentiated by JAX. A period is found on the host; its derivative comes from what
defines it: a root of the penetration, or the best correlation of a history with itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis import features
from bcfj_jax.analysis import histories as comparison
from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names, compiled
from bcfj_jax.analysis.derivatives.names import Feature, members

_FEWEST = 11  # samples: a residual of order 9 over fewer is rounding


def channel_features(times: np.ndarray, force: Array, depth: Array) -> dict[str, Array]:
    """Features of one channel, (T,) normal force [N] and penetration [m], that JAX differentiates. Pure."""
    unknown = jnp.asarray(jnp.nan)
    several = len(times) > 1
    return {
        "peak": features.peak(force),
        "largest": features.peak(jnp.abs(force)),
        "mean": features.mean(times, force) if several else unknown,
        "impulse": features.impulse(times, force) if several else unknown,
        "dissipated_work": features.dissipated_work(jnp.abs(force), depth) if several else unknown,
        "residual_oscillation": features.residual_oscillation(times, force) if len(times) >= _FEWEST else unknown,
        "contact_fraction": features.contact_fraction(times, depth) if several else unknown,
    }


def grouped(kind: str, values: Array) -> Array:
    """One number of the members' (k,): the largest peak, the mean of anything else. Pure."""
    return jnp.max(values) if kind in ("peak", "largest") else jnp.mean(values)


def vector(
    times: np.ndarray, found: Histories, wanted: Sequence[Feature], contacts: Mapping[str, int], periods: Mapping
) -> Array:
    """The wanted features (F,) of histories. Pure; ``times`` and ``periods`` are numbers.

    Args:
        times: (T,) [s].
        found: the histories.
        wanted, contacts: which features, and the members of each contact.
        periods: by channel, the period [s] within which a delay is sought; without one, or NaN: the whole history.
    """
    place = {name: i for i, name in enumerate(channel_names(contacts))}
    normal = found.force[:, :, 0]
    every = jax.vmap(lambda f, d: channel_features(times, f, d), in_axes=1)(normal, found.penetration)

    def one(feature: Feature) -> Array:
        if feature.kind == "period":
            return jnp.asarray(0.0)  # filled in by ``measure``
        if feature.kind == "delay":
            first, second = (members(c, contacts) for c in feature.contacts)
            pairs = list(zip(first, second, strict=True)) if len(first) == len(second) else [(first[0], second[0])]
            span = float(times[-1] - times[0])
            shifts = [
                comparison.delay(
                    times, normal[:, place[a]], normal[:, place[b]],
                    periods[a] if np.isfinite(periods.get(a, np.nan)) else span,
                )
                for a, b in pairs
            ]  # fmt: skip
            return jnp.mean(jnp.stack(shifts))
        index = np.array([place[m] for m in members(feature.contacts[0], contacts)])
        return grouped(feature.kind, every[feature.kind][index])

    return jnp.stack([one(feature) for feature in wanted])


def measure(
    times: np.ndarray,
    value: Histories,
    derivative: Histories,
    wanted: Sequence[Feature],
    contacts: Mapping[str, int],
    turning: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Features (F,) and their derivatives (F, P) from histories and theirs.

    Args:
        times: (T,) [s].
        value, derivative: of a run.
        wanted, contacts: which features, and the members of each contact.
        turning: whether a period is that of the force history (of the last two thirds), as in a joint, or the mean
            interval between contacts.
    """
    names = channel_names(contacts)
    needed = {m for f in wanted if f.kind in ("period", "delay") for c in f.contacts for m in members(c, contacts)}
    periods = {n: _period(times, value, derivative, i, turning) for i, n in enumerate(names) if n in needed}

    cycles = {name: found[0] for name, found in periods.items()}

    def along(force: Array, depth: Array, force_slope: Array, depth_slope: Array) -> tuple[Array, Array]:
        def function(force: Array, depth: Array) -> Array:
            return vector(times, Histories(force, depth, None, None), wanted, contacts, cycles)

        push = lambda *tangents: jax.jvp(function, (force, depth), tangents)[1]  # noqa: E731
        return function(force, depth), jax.vmap(push, out_axes=1)(force_slope, depth_slope)

    arguments = (value.force, value.penetration, derivative.force, derivative.penetration)
    paired = {c for f in wanted if f.kind == "delay" for part in f.contacts for c in members(part, contacts)}
    # No NaN in the key: it equals no other, and would be compiled anew each time.
    fixed = tuple((name, cycle if np.isfinite(cycle) else None) for name, cycle in cycles.items() if name in paired)
    key = ("measure", times.tobytes(), tuple(wanted), tuple(contacts.items()), derivative.force.shape, fixed)
    numbers, slopes = (np.array(x) for x in compiled(key, along, *arguments)[0](*arguments))
    for i, feature in enumerate(wanted):
        if feature.kind == "period":
            found = [periods[m] for m in members(feature.contacts[0], contacts)]
            numbers[i] = np.mean([p for p, _ in found])
            slopes[i] = np.mean([d for _, d in found], axis=0)
    return numbers, slopes


def _period(times, value: Histories, derivative: Histories, channel: int, turning: bool) -> tuple[float, np.ndarray]:
    force, slope = value.force[:, channel, 0], derivative.force[:, :, channel, 0]
    unknown = (float("nan"), np.full(len(slope), np.nan))
    if len(times) < 2 or not np.isfinite(force).all():
        return unknown
    if turning:
        return _repeat(times, force, slope) or unknown
    depth, rate = value.penetration[:, channel], value.rate[:, channel]
    starts = [start for start, _ in features.contact_times(times, depth, rate)][int(depth[0] > 0) :]
    if len(starts) < 2:
        return unknown
    ends = [
        _start_slope(times, depth, rate, derivative.penetration[:, :, channel], derivative.rate[:, :, channel], at)
        for at in (starts[0], starts[-1])
    ]
    return (starts[-1] - starts[0]) / (len(starts) - 1), (ends[1] - ends[0]) / (len(starts) - 1)


def _start_slope(times, depth, rate, depth_slope, rate_slope, at: float) -> np.ndarray:
    """d t*/d p of a root d(t*) = 0, -(dd/dp)/d', from the samples' Hermite cubics; NaN for one between samples."""
    k = int(np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2))
    if not depth[k] <= 0 <= depth[k + 1]:
        return np.full(len(depth_slope), np.nan)
    h = times[k + 1] - times[k]
    s = (at - times[k]) / h
    basis = np.array([(1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2 * h, s * s * (3 - 2 * s), s * s * (s - 1) * h])
    steep = np.array([6 * s * (s - 1) / h, (1 - s) * (1 - 3 * s), 6 * s * (1 - s) / h, s * (3 * s - 2)])
    speed = steep @ np.array([depth[k], rate[k], depth[k + 1], rate[k + 1]])
    change = np.stack([depth_slope[:, k], rate_slope[:, k], depth_slope[:, k + 1], rate_slope[:, k + 1]], axis=1)
    return -(change @ basis) / speed


def _repeat(times: np.ndarray, force: np.ndarray, slope: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Period of a history's last two thirds and its derivative.

    T = (k h + s)/m with s the delay of the history k samples later against itself, m the periods in 3/4 of the window.
    The derivative is good to about 1 %: the window holds no whole number of periods.
    """
    window = times >= times[0] + (times[-1] - times[0]) / 3.0
    t = times[window]
    if t.size < 16:
        return None
    period = comparison.period(t, force[window])
    if not np.isfinite(period):
        return None
    even = np.linspace(t[0], t[-1], t.size)
    step = even[1] - even[0]
    many = max(1, int(0.75 * (t[-1] - t[0]) / period))
    later = round(many * period / step)
    if t.size - later < 8 or period < 8 * step:
        return period, np.full(len(slope), np.nan)
    width = min(period, 0.9 * float(even[-1 - later] - even[0]))

    def shift(values: Array) -> Array:
        x = jnp.interp(even, t, values)
        return comparison.delay(even[: t.size - later], x[: t.size - later], x[later:], width) / many

    push = lambda tangent: jax.jvp(shift, (jnp.asarray(force[window]),), (tangent,))[1]  # noqa: E731
    return period, np.asarray(jax.vmap(push)(jnp.asarray(slope[:, window])))
