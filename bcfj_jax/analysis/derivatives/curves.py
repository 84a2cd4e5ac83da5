"""Summits of the continuous force along the motion, with their derivatives (``analysis.crests`` says why).

Where a run lands on its contacts they are found over the two steps of the solver about the greatest force at a step's end.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.trains import LEAVES, SHORTER, SUMMIT, TILTED, ahead, summit_of
from bcfj_jax.mechanism.model import AbstractModel, Continuous, Params


def of_curve(model: AbstractModel, params: Params, whole: Continuous, first: Array, last: Array) -> Array:
    """``crests.Curve`` of every channel (C, 4) between two times [s]; NaN for no summit."""
    peak, least = summits(model, params, whole, first, last)
    return jnp.stack(Curve(peak, whole.impulse, whole.work, least), axis=1)


def summits(model: AbstractModel, params: Params, whole: Continuous, first: Array, last: Array) -> Array:
    """Normal force (2, C) [N] where it is greatest, and least; NaN where it is not smooth there, of the other sign, or
    beyond a time.
    """
    from bcfj_jax.solve.landing import bending, look  # With diffrax, which a kept program does not need.

    prepared, fixed, corners = model.prepare(params), jax.lax.stop_gradient, bending(model)

    def field(t: Array, y: Array) -> Array:
        return model.vector_field(t, y, prepared)

    def one(sign: Array, channel: Array, t: Array, y: Array, before: Array, after: Array) -> Array:
        # Neither of the two steps crosses a surface; the top's derivative is that at fixed times.
        middle, reach = fixed(t) + 0.5 * (after - before), 0.5 * (after + before)
        times = middle + reach * np.outer(SHORTER, SUMMIT).ravel()
        states = jax.vmap(lambda at: ahead(field, t, y, at - t))(times)
        forces = jax.vmap(lambda t, y: look(model, t, y, prepared).force[channel])(times, states)
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

    every = jax.vmap(one, (None, 0, 0, 0, 0, 0))
    return jax.vmap(every, (0, None, 0, 0, 0, 0))(jnp.array([1.0, -1.0]), jnp.arange(whole.impulse.size), *whole[:4])
