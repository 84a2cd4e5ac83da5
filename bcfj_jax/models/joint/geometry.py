"""Geometry and frictionless statics of the ball-cage joint: pure, differentiable, SI and radians, any broadcast shape.

Formulas: physics sheet 5.2 and 5.5. The joint's centre O is the origin, the seat's axis is z and the head's
axis leans by the deflection beta towards x. Track circles have the radius Rc about +e z (seat) and about -e times
the head's axis (head); the pitch radius is Rp = sqrt(Rc^2 - e^2). Nothing here raises: arguments may be traced, so
a value outside the range of a formula gives NaN or infinity, as documented. What can be built: ``joint.checks``.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


def _along(angle: ArrayLike) -> Array:
    """Unit vector (sin a, 0, cos a), shape (..., 3)."""
    angle = jnp.asarray(angle, dtype=float)
    return jnp.stack([jnp.sin(angle), jnp.zeros_like(angle), jnp.cos(angle)], axis=-1)


def bisector(joint_angle: ArrayLike) -> Array:
    """Normal b = (sin(beta/2), 0, cos(beta/2)) of the bisecting plane, which holds every ball centre; (..., 3).

    Args:
        joint_angle: deflection beta [rad] between the seat's and the head's axis.
    """
    return _along(0.5 * jnp.asarray(joint_angle, dtype=float))


def head_axis(joint_angle: ArrayLike) -> Array:
    """Axis (sin beta, 0, cos beta) of the head, the seat's being z; argument as ``bisector``; (..., 3)."""
    return _along(joint_angle)


def track_radius(pitch_radius: ArrayLike, offset: ArrayLike) -> Array:
    """Rc = sqrt(Rp^2 + e^2) [m], of the circle of ball centres along a track; e its centre's offset from O."""
    return jnp.sqrt(jnp.square(jnp.asarray(pitch_radius, dtype=float)) + jnp.square(offset))


def _slope(azimuth: ArrayLike, joint_angle: ArrayLike) -> Array:
    """h = -cos(phi) tan(beta/2): height of the bisecting plane over a unit of radius, at an azimuth."""
    return -jnp.cos(jnp.asarray(azimuth, dtype=float)) * jnp.tan(0.5 * jnp.asarray(joint_angle, dtype=float))


def ball_centre(azimuth: ArrayLike, joint_angle: ArrayLike, track_radius: ArrayLike, offset: ArrayLike) -> Array:
    """Centre P = lambda (cos phi, sin phi, h) of a ball without clearance, where its two tracks cross.

    h = -cos(phi) tan(beta/2),  lambda = [e h + sqrt((1 + h^2) Rc^2 - e^2)]/(1 + h^2).  P lies in the bisecting
    plane, Rc from either track centre, and at the azimuth phi of the head too: the joint is of constant velocity.

    Args:
        azimuth: phi [rad], of the track about the seat's axis, from the plane of deflection.
        joint_angle: beta [rad], |beta| < pi.
        track_radius: Rc [m].
        offset: e [m], |e| < Rc; 0 for concentric tracks.

    Returns:
        P [m], shape (..., 3).
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
    """F_c = 2 N [sin(alpha) sin(phi) sin(beta/2) + cos(alpha) (e/Rc) cos(beta/2)], exact for equal track loads.

    -2 N n.b with the seat's contact normal n = sin(alpha) (-sin phi, cos phi, 0) + cos(alpha) (P - O_o)/Rc.

    Args:
        normal: N [N] >= 0, on either track.
        azimuth: phi [rad], of the ball; use -sin(phi), so -phi, for the other direction of torque.
        contact_angle: alpha [rad].
        joint_angle: beta [rad].
        track_radius: Rc [m].
        offset: e [m].

    Returns:
        F_c [N] on the cage along its axis b.
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
