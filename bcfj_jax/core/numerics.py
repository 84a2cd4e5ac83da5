"""Kink-safe primitives. Every guard against a NaN derivative in this package lives here."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jax.typing import ArrayLike


def is_traced(value: Any) -> bool:
    """Whether a value is unknown yet, because JAX traces the code that computes it."""
    return isinstance(value, Tracer)


def power(base: ArrayLike, exponent: ArrayLike) -> Array:
    """``base**exponent`` where base > 0, else exactly 0, with finite derivatives of every order.

    The double ``where`` keeps the untaken branch finite: a single one gives NaN in reverse mode
    and ``maximum(base, 0)**n`` gives NaN second derivatives on the whole separated side.
    """
    base, exponent = jnp.asarray(base, dtype=float), jnp.asarray(exponent, dtype=float)
    return _power(base, exponent)


@jax.custom_jvp
def _power(base: Array, exponent: Array) -> Array:
    inside = base > 0
    return jnp.where(inside, jnp.where(inside, base, 1.0) ** exponent, 0.0)


@partial(_power.defjvp, symbolic_zeros=True)
def _(primals: tuple, tangents: tuple) -> tuple[Array, Any]:
    """n b^n / b in place of n b^(n-1), which would be a second power: one costs as much as twenty products."""
    (base, exponent), (by_base, by_exponent) = primals, tangents
    value, safe = _power(base, exponent), jnp.where(base > 0, base, 1.0)
    change = jnp.zeros_like(value)
    if not isinstance(by_base, SymbolicZero):
        change = change + exponent * value / safe * by_base
    if not isinstance(by_exponent, SymbolicZero):
        change = change + jnp.log(safe) * value * by_exponent
    return value, change


def positive(value: ArrayLike) -> Array:
    """``value`` where it is > 0, else exactly 0, with derivative 0 on the clipped side."""
    value = jnp.asarray(value)
    return jnp.where(value > 0, value, 0.0)


def smooth_step(fraction: ArrayLike) -> Array:
    """Cubic step s^2 (3 - 2 s) of a fraction clipped to [0, 1]; C1 (the ADAMS ``STEP``)."""
    s = jnp.clip(fraction, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def smooth_rise(fraction: ArrayLike) -> Array:
    """Quintic step s^3 (10 - 15 s + 6 s^2) of a fraction clipped to [0, 1]; C2."""
    s = jnp.clip(fraction, 0.0, 1.0)
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def smooth_ramp(distance: ArrayLike, width: ArrayLike) -> tuple[Array, Array]:
    """C3 regularisation of a penetration, and its (C2) slope.

    With s = (d + w) / 2 w clipped to [0, 1]:  r(d) = 2 w (5/2 s^4 - 3 s^5 + s^6)  for d < w,  r = d  above;
    dr/dd = s^3 (10 - 15 s + 6 s^2).  Exactly 0 for d <= -w, exactly d for d >= w, max(d, 0) where w = 0.

    Args:
        distance: signed overlap d [m], positive in contact.
        width: half-width w [m] of the blend, >= 0.

    Returns:
        r [m] and dr/dd [-], of the broadcast shape.
    """
    distance, width = jnp.asarray(distance), jnp.asarray(width)
    on = width > 0
    half = jnp.where(on, width, 1.0)
    s = jnp.clip((distance + half) / (2.0 * half), 0.0, 1.0)
    blend = jnp.where(distance < half, 2.0 * half * s**4 * (2.5 + s * (s - 3.0)), distance)
    slope = smooth_rise(s)
    sharp = jnp.where(distance > 0, 1.0, 0.0)
    return jnp.where(on, blend, positive(distance)), jnp.where(on, slope, sharp)


def bisected(beyond: Callable[[Array], Array], bracket: tuple[Array, Array], halvings: int) -> tuple[Array, Array]:
    """The brackets within which ``beyond`` turns true, each halved so often; elementwise."""

    def halve(_: int, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        past = beyond(middle)
        return jnp.where(past, low, middle), jnp.where(past, middle, high)

    return jax.lax.fori_loop(0, halvings, halve, bracket)


def newton_root(residual: Callable[[Array], Array], start: ArrayLike, iterations: int = 40) -> Array:
    """Root of a smooth elementwise residual by Newton, differentiated by the implicit function theorem.

    A NaN stays in its own row of the batch. A start on the convex side of the root makes the iteration monotone.
    """

    def solve(function: Callable[[Array], Array], guess: Array) -> Array:
        def step(carry):
            x, _, count = carry
            value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
            change = value / jnp.where(slope == 0, 1.0, slope)
            return x - change, jnp.any(jnp.abs(change) > 1e-15 * jnp.abs(x)), count + 1

        def more(carry):
            return carry[1] & (carry[2] < iterations)

        return jax.lax.while_loop(more, step, (guess, jnp.asarray(True), 0))[0]

    def tangent_solve(linear: Callable[[Array], Array], target: Array) -> Array:
        return target / linear(jnp.ones_like(target))

    start = jnp.asarray(start, dtype=float)
    return jax.lax.custom_root(residual, start, solve, tangent_solve)
