"""Geometry and frictionless statics of the ball-cage joint: pure, differentiable, SI and radians, any broadcast shape.

Formulas: physics sheet 5.2 and 5.5. The joint's centre O is the origin, the seat's axis is z and the head's
axis leans by the deflection beta towards x. Track circles have the radius Rc about +e z (seat) and about -e times
the head's axis (head); the pitch radius is Rp = sqrt(Rc^2 - e^2). Nothing here raises: arguments may be traced, so
a value outside the range of a formula gives NaN or infinity, as documented. What can be built: ``joint.checks``.

The cage's attitude: its unit axis b and, where its windows have ends, its azimuth psi about that axis.

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
from jax.typing import ArrayLike

from bcfj_jax.xla.kept import kept


def _along(angle: ArrayLike) -> Array:
    """Unit vector (sin a, 0, cos a), shape (..., 3)."""
    angle = jnp.asarray(angle, dtype=float)
    return jnp.stack([jnp.sin(angle), jnp.zeros_like(angle), jnp.cos(angle)], axis=-1)


def bisector(joint_angle: ArrayLike) -> Array:
    """Normal b = (sin(beta/2), 0, cos(beta/2)) of the bisecting plane, which holds every ball centre; (..., 3)."""
    return _along(0.5 * jnp.asarray(joint_angle, dtype=float))


def head_axis(joint_angle: ArrayLike) -> Array:
    """Axis (sin beta, 0, cos beta) of the head, the seat's being z; (..., 3)."""
    return _along(joint_angle)


def track_radius(pitch_radius: ArrayLike, offset: ArrayLike) -> Array:
    """Rc = sqrt(Rp^2 + e^2) [m], of the circle of ball centres along a track; e its centre's offset from O."""
    return jnp.sqrt(jnp.square(jnp.asarray(pitch_radius, dtype=float)) + jnp.square(offset))


def _slope(azimuth: ArrayLike, joint_angle: ArrayLike) -> Array:
    """h = -cos(phi) tan(beta/2): height of the bisecting plane over a unit of radius, at an azimuth."""
    return -jnp.cos(jnp.asarray(azimuth, dtype=float)) * jnp.tan(0.5 * jnp.asarray(joint_angle, dtype=float))


def ball_centre(azimuth: ArrayLike, joint_angle: ArrayLike, track_radius: ArrayLike, offset: ArrayLike) -> Array:
    """Centre P = lambda (cos phi, sin phi, h) [m] of a ball without clearance, where its two tracks cross; (..., 3).

    h = -cos(phi) tan(beta/2),  lambda = [e h + sqrt((1 + h^2) Rc^2 - e^2)]/(1 + h^2).  P lies in the bisecting
    plane, Rc from either track centre, and at the azimuth phi of the head too: the joint is of constant velocity.
    phi is the track's azimuth about the seat's axis, from the plane of deflection; |beta| < pi, |e| < Rc.
    """
    azimuth, h = jnp.asarray(azimuth, dtype=float), _slope(azimuth, joint_angle)
    steep = 1.0 + h * h
    reach = (h * offset + jnp.sqrt(steep * jnp.square(track_radius) - jnp.square(offset))) / steep
    parts = jnp.broadcast_arrays(reach * jnp.cos(azimuth), reach * jnp.sin(azimuth), reach * h)
    return jnp.stack(parts, axis=-1)


def deflected_cage_load(
    normal: ArrayLike,
    azimuth: ArrayLike,
    contact_angle: ArrayLike,
    joint_angle: ArrayLike,
    track_radius: ArrayLike,
    offset: ArrayLike,
) -> Array:
    """F_c = 2 N [sin(alpha) sin(phi) sin(beta/2) + cos(alpha) (e/Rc) cos(beta/2)] [N], exact for equal track loads N >= 0.

    -2 N n.b with the seat's contact normal n = sin(alpha) (-sin phi, cos phi, 0) + cos(alpha) (P - O_o)/Rc: on the cage along
    its axis b. For the other direction of torque use -phi.
    """
    half = 0.5 * jnp.asarray(joint_angle, dtype=float)
    tangential = jnp.sin(contact_angle) * jnp.sin(azimuth) * jnp.sin(half)
    radial = jnp.cos(contact_angle) * jnp.cos(half) * jnp.asarray(offset) / track_radius
    return 2.0 * jnp.asarray(normal) * (tangential + radial)


def kappa(contact_angle: ArrayLike, joint_angle: ArrayLike, track_radius: ArrayLike, offset: ArrayLike) -> Array:
    """kappa = tan(alpha) tan(beta/2) Rc/e [-]: unevenness of the ball loads, see ``kinematic.ball_loads``.

    Infinite for concentric tracks, e = 0 (NaN if beta = 0 too); arguments as ``deflected_cage_load``.
    """
    steep = jnp.tan(contact_angle) * jnp.tan(0.5 * jnp.asarray(joint_angle, dtype=float))
    return steep * track_radius / jnp.asarray(offset, dtype=float)


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
