"""Contact laws of the joint: forces from penetration, its rate and slip.

``ContactLaws`` are a normal-force law and a friction law with their coefficients, for arrays of contacts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.laws import AbstractFriction, AbstractLaw, regularised_force
from bcfj_jax.core.numerics import positive, smooth_ramp, smooth_step

# A bristle that touches nothing springs back: over this gap [m], with this time constant [s].
GAP, RELAX = 1e-6, 1e-5
# Gauss-Legendre on (0, 1) in s, x = r s^2: exact for d^1.5, and to rounding for every elastic part with its
# power n >= 1 or its root.
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(24), (1.0, 0.0), strict=True))


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
        """mu(|v|)/|v| [s/m], zero without friction: the traction is  -N mobility v."""
        if self.friction is None:
            return jnp.zeros_like(slip_squared)
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

    def energy(self, penetration: Array) -> Array:
        """Elastic energy E(d) [J]: integral of the law's force at rest from 0 to r(d), the regularised penetration."""
        depth = positive(penetration) if self.smoothing is None else smooth_ramp(penetration, self.smoothing)[0]
        s = _NODES.reshape(-1, *[1] * penetration.ndim)
        force = self.law.force(depth * s * s, jnp.zeros_like(depth * s), self.coefficients)
        return depth * jnp.sum((2.0 * _NODES * _WEIGHTS).reshape(s.shape) * force, 0)


class LawPair(eqx.Module):
    """Two unlike ``ContactLaws`` side by side: the first along index 0 of axis ``axis``, the second along index 1."""

    first: ContactLaws
    second: ContactLaws
    axis: int = eqx.field(static=True)

    @property
    def friction(self) -> AbstractFriction | None:
        """A friction law where either has one."""
        return self.first.friction or self.second.friction

    def _each(self, answer: str, *given: Array) -> Any:
        """What both answer to their halves, side by side."""
        halves = [[jnp.take(x, jnp.array([i]), self.axis) for x in given] for i in (0, 1)]
        parts = [getattr(laws, answer)(*half) for laws, half in zip((self.first, self.second), halves, strict=True)]
        return jax.tree.map(lambda *x: jnp.concatenate(x, self.axis), *parts)

    def normal(self, penetration: Array, rate: Array) -> Array:
        """As ``ContactLaws.normal``; what follows likewise."""
        return self._each("normal", penetration, rate)

    def mobility(self, slip_squared: Array) -> Array:
        """0 for the one without friction."""
        return self._each("mobility", slip_squared)

    def bond(self, slip_squared: Array) -> tuple[Array, Array, Array]:
        """As ``ContactLaws.bond``."""
        return self._each("bond", slip_squared)

    def lag(self, slip_squared: Array, late: Array) -> tuple[Array, Array]:
        """As ``ContactLaws.lag``."""
        return self._each("lag", slip_squared, late)

    def apart(self, penetration: Array) -> Array:
        """As ``ContactLaws.apart``."""
        return self._each("apart", penetration)

    def energy(self, penetration: Array) -> Array:
        """As ``ContactLaws.energy``."""
        return self._each("energy", penetration)
