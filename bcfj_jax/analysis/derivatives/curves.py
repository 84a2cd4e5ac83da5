"""Peaks of the continuous force, which lie between samples, with their derivatives.

The derivative of a greatest value is the derivative at a fixed time, at the summit (envelope theorem; Danskin 1966). At the
highest sample it is another one: there the force's rate times the shift of the whole curve is added, which in an impact is a
hundred times as much. The summit is found in two ways:

- *along the motion* (``summits``), over the two steps of the solver about the greatest force at a step's end, where a run lands
  on its contacts;
- *between samples* (``crest``), of the polynomial through the five samples about the highest, for every other history. The
  difference to the polynomial through four of them, twice, is the error that is stated.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.trains import LEAVES, SHORTER, SUMMIT, TILTED, ahead, summit_of
from bcfj_jax.mechanism.model import AbstractModel, Continuous, Params

# Columns of what is of the continuous curve (C, 3), by features.
PEAK, IMPULSE, WORK = range(3)
# A sample that is higher than the summit by this share is of another one.
_HIGHER = 1e-3
# How far a crest may rise above its greatest sample, over the spread of its five: a parabola's rises by up to 1/24.
_RISE = 0.06


def of_curve(model: AbstractModel, params: Params, whole: Continuous, first: Array, last: Array) -> Array:
    """Peak [N], impulse [N s] and work [J] of every channel (C, 3) between two times [s]; a peak is NaN that is no summit."""
    peaks = summits(model, params, whole, first, last)
    return jnp.stack([peaks, whole.impulse, whole.work], axis=1)


def summits(model: AbstractModel, params: Params, whole: Continuous, first: Array, last: Array) -> Array:
    """Normal force (C,) [N], of either sign, where its size is greatest; NaN where it is not smooth there, or beyond a time."""
    from bcfj_jax.solve.landing import bending, look  # With diffrax, which a kept program does not need.

    prepared, fixed, corners = model.prepare(params), jax.lax.stop_gradient, bending(model)

    def field(t: Array, y: Array) -> Array:
        return model.vector_field(t, y, prepared)

    def one(channel: Array, t: Array, y: Array, before: Array, after: Array) -> Array:
        # Neither of the two steps crosses a surface; the top's derivative is that at fixed times.
        middle, reach = fixed(t) + 0.5 * (after - before), 0.5 * (after + before)
        times = middle + reach * np.outer(SHORTER, SUMMIT).ravel()
        states = jax.vmap(lambda at: ahead(field, t, y, at - t))(times)
        forces = jax.vmap(lambda t, y: look(model, t, y, prepared).force[channel])(times, states)
        sign = fixed(jnp.sign(forces[0]))
        later, value, curve, slope, left = summit_of(sign * forces.reshape(SHORTER.size, -1), middle, reach)
        good = (curve < 0) & (jnp.abs(slope) * reach <= TILTED * value) & (left < LEAVES)
        if corners:
            # The step ends at the corner, where the force is greatest.
            force = lambda t, y: sign * look(model, t, y, prepared).force[channel]  # noqa: E731
            size, slope = jax.jvp(force, (t, y), (jnp.ones_like(t), field(t, y)))
            there = jnp.isin(channel, jnp.asarray(corners))
            later, value = jnp.where(there, t, later), jnp.where(there, size, value)
            good = jnp.where(there, jnp.abs(slope) * reach <= TILTED * size, good)
        return jnp.where(fixed(good & (later >= first) & (later <= last)), sign * value, jnp.nan)

    return jax.vmap(one)(jnp.arange(whole.time.size), *whole[:4])


def known(curve: Any, highest: Any) -> Any:
    """Which of peaks are those of the continuous curve, by the size of the greatest sample."""
    size = (jnp if isinstance(curve, Array) else np).abs(curve)
    return (size > 0) & (highest <= (1.0 + _HIGHER) * size)


def crest(times: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Greatest value of a curve through samples (T,), its derivatives (P,), and how far these may be off.

    Where the curve has no summit within the five samples about the highest one, it is that sample: at an end of the
    samples its derivative is right, elsewhere its error is taken to be its difference to the neighbours'.

    Args:
        times, values: (T,) samples.
        slopes: (P, T) derivatives of the values.
    """
    top, last = int(np.argmax(values)), len(times) - 1
    first = int(np.clip(top - 2, 0, max(last - 4, 0)))
    if 0 < top < last and last >= 4:
        near = slice(first, first + 5)
        nodes = (times[near] - times[top]) / (times[top + 1] - times[top - 1])
        found = _summit(nodes, values[near])
        if found is not None and found[1] - values[top] <= _RISE * np.ptp(values[near]):
            place, high, weights = found
            by = slopes[:, near] @ weights
            # Of the five samples the four nearest to the summit.
            four = np.sort(np.argsort(np.abs(nodes - place), kind="stable")[:4])
            coarse = _summit(nodes[four], values[near][four])
            error = (
                np.full(len(by), np.inf) if coarse is None else 2.0 * np.abs(slopes[:, near][:, four] @ coarse[2] - by)
            )
            return high, by, error
    error = np.zeros(len(slopes))
    if 0 < top < last:
        error = np.max(np.abs(slopes[:, [top - 1, top + 1]] - slopes[:, [top]]), axis=1, initial=0.0)
    return float(values[top]), slopes[:, top], error


def _summit(nodes: np.ndarray, values: np.ndarray) -> tuple[float, float, np.ndarray] | None:
    """Place and height of the maximum near 0 of the polynomial through values at nodes, and their weights (N,) there."""
    powers = np.arange(len(nodes))
    inverse = np.linalg.inv(nodes[:, None] ** powers)
    terms = np.polynomial.Polynomial(inverse @ values)
    first, second = terms.deriv(), terms.deriv(2)
    place, limit = 0.0, 0.6
    for _ in range(8):
        bend = second(place)
        if not bend < 0.0:
            return None
        place = float(np.clip(place - first(place) / bend, -limit, limit))
    if abs(place) >= limit or not second(place) < 0.0:
        return None
    return place, float(terms(place)), place**powers @ inverse


def quartic(times: np.ndarray, values: Array) -> Array:
    """Maximum over time and members of (T, k) samples at increasing times (T,), between samples, too.

    With s the place of the quartic's maximum in samples from the greatest one: Newton's method finds it, and one more
    step of it that is differentiated carries ds/dF = -(dp'/dF)/p''. The greatest sample itself, where it is the
    first or last two, or the quartic has no maximum within a sample of it.
    """
    count = values.shape[0]
    greatest = jnp.max(values)
    if count < 5:
        return greatest
    flat = jnp.argmax(jax.lax.stop_gradient(values))
    top, member = flat // values.shape[1], flat % values.shape[1]
    start = jnp.clip(top - 2, 0, count - 5)
    near = jax.lax.dynamic_slice_in_dim(jnp.take(values, member, axis=1), start, 5)
    at = jax.lax.dynamic_slice_in_dim(jnp.asarray(times), start, 5)
    nodes = 2.0 * (at - at[2]) / (at[3] - at[1])
    c = jnp.linalg.solve(nodes[:, None] ** jnp.arange(5), near - jax.lax.stop_gradient(near[2]))

    def step(c: Array, s: Array) -> tuple[Array, Array]:
        first = c[1] + s * (2.0 * c[2] + s * (3.0 * c[3] + s * 4.0 * c[4]))
        return first, 2.0 * c[2] + s * (6.0 * c[3] + s * 12.0 * c[4])

    fixed, s = jax.lax.stop_gradient(c), jnp.zeros(())

    def closer(_: int, s: Array) -> Array:
        first, second = step(fixed, s)
        return jnp.clip(s - first / jnp.where(second < 0.0, second, -jnp.inf), -1.0, 1.0)

    s = jax.lax.stop_gradient(jax.lax.fori_loop(0, 6, closer, s))
    second = step(fixed, s)[1]
    inside = (top >= 2) & (top < count - 2) & (second < 0.0) & (jnp.abs(s) < 1.0)
    safe = jnp.where(inside, second, -1.0)
    s = s - jnp.where(inside, step(c, s)[0], 0.0) / safe
    high = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4]))) + jax.lax.stop_gradient(near[2])
    # A parabola's rises by up to 1/24; a jump within the five samples makes a quartic that rises further.
    spread = jax.lax.stop_gradient(jnp.max(near) - jnp.min(near))
    return jnp.where(inside & (high - greatest <= _RISE * spread), high, greatest)
