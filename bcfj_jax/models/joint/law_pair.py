"""Contact laws of the joint: forces from penetration, its rate and slip.

``ContactLaws`` are a normal-force law and a friction law with their coefficients, for arrays of contacts.
"""

from __future__ import annotations

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.laws import AbstractFriction, AbstractLaw, regularised_force
from bcfj_jax.core.numerics import smooth_step

# A bristle that touches nothing springs back: over this gap [m], with this time constant [s].
GAP, RELAX = 1e-6, 1e-5


class ContactLaws(eqx.Module):
    """One law and one friction law over any broadcast shape of contacts.

    Attributes:
        law, friction: static; no friction law, no friction operations.
        coefficients: by the laws' names; scalars, or arrays that broadcast against the contacts.
        smoothing: half-width of the contact regularisation [m]; None for none.
    """

    law: AbstractLaw
    friction: AbstractFriction | None
    coefficients: Mapping[str, Array]
    smoothing: Array | None

    def normal(self, penetration: Array, rate: Array) -> Array:
        """Normal force [N] >= 0 from penetration [m] and its rate [m/s]."""
        return regularised_force(self.law, penetration, rate, self.coefficients, self.smoothing)

    def mobility(self, slip_squared: Array) -> Array:
        """mu(|v|)/|v| [s/m]: the traction is  -N mobility v."""
        assert self.friction is not None
        return self.friction.mobility(slip_squared, self.coefficients)

    def bond(self, slip_squared: Array) -> tuple[Array, Array, Array]:
        """k [1/s], s [1/m], m [s/m] of ``LuGre.bond``, all zero without friction: the traction is  -N (s z + m v)."""
        if self.friction is None:
            nothing = jnp.zeros_like(slip_squared)
            return nothing, nothing, nothing
        return self.friction.bond(slip_squared, self.coefficients)

    def lag(self, slip_squared: Array, late: Array) -> tuple[Array, Array]:
        """w' [m/s^2] and mobility [s/m] of ``Memory.lag``, zero without friction: the traction is  -N mobility v."""
        if self.friction is None:
            return jnp.zeros_like(late), jnp.zeros_like(late)
        return self.friction.lag(slip_squared, late, self.coefficients)

    def apart(self, penetration: Array) -> Array:
        """0 wherever there may be a normal force, 1 from a gap of ``GAP`` beyond; C1."""
        return smooth_step((-penetration - (0.0 if self.smoothing is None else self.smoothing)) / GAP)


class LawPair(eqx.Module):
    """Two unlike ``ContactLaws`` side by side: the first along index 0 of axis ``axis``, the second along index 1."""

    first: ContactLaws
    second: ContactLaws
    axis: int = eqx.field(static=True)

    @property
    def friction(self) -> AbstractFriction | None:
        """A friction law where either has one."""
        return self.first.friction or self.second.friction

    def normal(self, penetration: Array, rate: Array) -> Array:
        """As ``ContactLaws.normal``."""
        a, b = (jnp.take(penetration, jnp.array([i]), self.axis) for i in (0, 1))
        p, q = (jnp.take(rate, jnp.array([i]), self.axis) for i in (0, 1))
        return jnp.concatenate([self.first.normal(a, p), self.second.normal(b, q)], self.axis)

    def mobility(self, slip_squared: Array) -> Array:
        """As ``ContactLaws.mobility``; 0 for the one without friction."""
        parts = []
        for index, laws in enumerate((self.first, self.second)):
            slip = jnp.take(slip_squared, jnp.array([index]), self.axis)
            parts.append(laws.mobility(slip) if laws.friction is not None else jnp.zeros_like(slip))
        return jnp.concatenate(parts, self.axis)

    def bond(self, slip_squared: Array) -> tuple[Array, Array, Array]:
        """As ``ContactLaws.bond``."""
        slips = (jnp.take(slip_squared, jnp.array([i]), self.axis) for i in (0, 1))
        parts = (laws.bond(slip) for laws, slip in zip((self.first, self.second), slips, strict=True))
        first, second, third = (jnp.concatenate(x, self.axis) for x in zip(*parts, strict=True))
        return first, second, third

    def lag(self, slip_squared: Array, late: Array) -> tuple[Array, Array]:
        """As ``ContactLaws.lag``."""
        slips, lates = ([jnp.take(x, jnp.array([i]), self.axis) for i in (0, 1)] for x in (slip_squared, late))
        parts = [laws.lag(*each) for laws, *each in zip((self.first, self.second), slips, lates, strict=True)]
        rate, mobility = (jnp.concatenate(x, self.axis) for x in zip(*parts, strict=True))
        return rate, mobility

    def apart(self, penetration: Array) -> Array:
        """As ``ContactLaws.apart``."""
        depths = (jnp.take(penetration, jnp.array([i]), self.axis) for i in (0, 1))
        parts = [laws.apart(depth) for laws, depth in zip((self.first, self.second), depths, strict=True)]
        return jnp.concatenate(parts, self.axis)
