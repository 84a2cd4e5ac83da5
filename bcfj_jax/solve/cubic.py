"""Hermite's cubic through values and slopes at both ends of a step, by powers of the share of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array


class Extreme(NamedTuple):
    """A greatest or least value of a cubic, and the share of the step where it is; (C,) each."""

    depth: Array
    at: Array


class Cubic(NamedTuple):
    """Of C channels, (C,) each; ``hermite`` makes it."""

    value: Array
    slope: Array
    second: Array
    third: Array

    def at(self, s: Any) -> Array:
        """Values at shares of the step."""
        return self.value + s * (self.slope + s * (self.second + s * self.third))

    def slope_at(self, s: Any) -> Array:
        """Slopes there, per step."""
        return self.slope + s * (2.0 * self.second + 3.0 * s * self.third)

    def extremes(self) -> tuple[Extreme, Extreme]:
        """Greatest and least between 0 and 1."""
        # Roots of the slope, by the form that loses no digits.
        root = jnp.sqrt(jnp.maximum(self.second**2 - 3.0 * self.third * self.slope, 0.0))
        sum_of = -(self.second + jnp.where(self.second >= 0.0, root, -root))
        ratio = lambda a, b: jnp.where(b == 0.0, 0.0, a / jnp.where(b == 0.0, 1.0, b))  # noqa: E731
        first, last = self.value, self.value + self.slope + self.second + self.third
        high, low = (Extreme(jnp.where(x, last, first), jnp.where(x, 1.0, 0.0)) for x in (last > first, last <= first))
        for s in (jnp.clip(ratio(sum_of, 3.0 * self.third), 0.0, 1.0), jnp.clip(ratio(self.slope, sum_of), 0.0, 1.0)):
            value = self.at(s)
            higher, lower = value > high.depth, value < low.depth
            high = Extreme(jnp.where(higher, value, high.depth), jnp.where(higher, s, high.at))
            low = Extreme(jnp.where(lower, value, low.depth), jnp.where(lower, s, low.at))
        return high, low


def hermite(values: tuple[Array, Array], rates: tuple[Array, Array], length: Any) -> Cubic:
    """The cubic through values and rates at the begin and the end of a step of a length [s]."""
    (a, b), (p, q) = values, (length * rate for rate in rates)
    rise = b - a
    return Cubic(a, p, 3.0 * rise - 2.0 * p - q, p + q - 2.0 * rise)
