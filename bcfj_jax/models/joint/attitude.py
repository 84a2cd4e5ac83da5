"""The cage's attitude: its unit axis b and, where its windows have ends, its azimuth psi about that axis.

psi is measured from the plane of deflection towards y, the normal of that plane. With  m = sqrt(1 - (b . y)^2):

    f = (y x b)/m    g = (y - b (b . y))/m    x = cos(psi) f + sin(psi) g    psi' = w . h,    h = (b - y (b . y))/m^2

f and g are across b, x is the cage's own axis through the middle of the first window, and h . b = 1. Regular unless the
cage has tilted by 90 degrees onto y. One angle and not a second vector: it counts turns, it drifts by no length, and
``arrowhead`` eliminates it by one division.

Gyroscopic terms are left out: the inertia is that of a spherical shell. A ring between +-30 degrees has 0.917 m R^2 about
its axis and 0.542 m R^2 across it, in place of 0.667. Its gyroscopic couple  (0.917 - 0.542) m R^2 |w x (w . b) b|  is below
1e-3 N m in the default joint under load, where contacts turn the cage with some 20 N m
(tests/models/joint/test_joint_cage.py).
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bcfj_jax.xla.kept import kept


def frame(axis: Array) -> tuple[Array, Array]:
    """f and g, (3,) each, of a unit axis (3,)."""
    y = jnp.array([0.0, 1.0, 0.0])
    size = jnp.sqrt(1.0 - axis[1] ** 2)
    return jnp.cross(y, axis) / size, (y - axis * axis[1]) / size


def windows_around(axis: Array, azimuths: Array) -> Array:
    """Unit vectors around the cage at azimuths (n,) [rad] of its windows' middles, (n, 3): normals of their ends."""
    first, second = frame(axis)
    cosine, sine = kept(jnp.cos(azimuths)[:, None], jnp.sin(azimuths)[:, None])
    return cosine * second - sine * first


def cage_axes(axis: Array, azimuth: Array) -> Array:
    """The cage's axes as columns (3, 3): through the first window's middle, around, its own axis."""
    first, second = frame(axis)
    cosine, sine = jnp.cos(azimuth), jnp.sin(azimuth)
    return jnp.stack([cosine * first + sine * second, cosine * second - sine * first, axis], -1)


def turning(axis: Array) -> Array:
    """h (3,): the azimuth's rate by the angular velocity."""
    return (axis - jnp.array([0.0, axis[1], 0.0])) / (1.0 - axis[1] ** 2)


def azimuth_rate(axis: Array, spin: Array) -> Array:
    """psi' [1/s] of a cage that turns at ``spin`` (3,)."""
    return spin @ turning(axis)


def rate_by_axis(axis: Array, spin: Array) -> Array:
    """Derivative of ``azimuth_rate`` by the axis (3,), whose length is kept at 1."""
    y = jnp.array([0.0, 1.0, 0.0])
    square = 1.0 - axis[1] ** 2
    slope = (spin - spin[1] * y + 2.0 * axis[1] * azimuth_rate(axis, spin) * y) / square
    return slope - (slope @ axis) * axis
