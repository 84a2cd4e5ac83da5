"""Geometry and frictionless statics of the ball-cage joint: pure, differentiable, SI and radians, any broadcast shape.

Formulas: physics sheet 5.2, 5.4 and 5.5. The joint's centre O is the origin, the seat's axis is z and the head's
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


def pitch_radius(track_radius: ArrayLike, offset: ArrayLike) -> Array:
    """Rp = sqrt(Rc^2 - e^2) [m], of the ball centres' circle at no deflection.

    Args:
        track_radius: Rc [m], of the circle of ball centres along a track.
        offset: e [m], of the track circle's centre from O, |e| < Rc; its derivative is infinite at |e| = Rc.
    """
    track = jnp.asarray(track_radius, dtype=float)
    # Factored: exact for an offset close to the radius.
    return jnp.sqrt((track - offset) * (track + offset))


def track_radius(pitch_radius: ArrayLike, offset: ArrayLike) -> Array:
    """Rc = sqrt(Rp^2 + e^2) [m], the inverse of ``pitch_radius``."""
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


def ball_distance(azimuth: ArrayLike, joint_angle: ArrayLike, track_radius: ArrayLike, offset: ArrayLike) -> Array:
    """|P| = e s + sqrt(Rp^2 + e^2 s^2) [m],  s = h/sqrt(1 + h^2) the sine of the ball's latitude.

    Rises with e s, and |s| <= sin(beta/2): least at phi = 0 and greatest at phi = pi for e > 0, about
    Rp -+ e sin(beta/2). Arguments as ``ball_centre``.
    """
    h = _slope(azimuth, joint_angle)
    rise = h * offset / jnp.sqrt(1.0 + h * h)
    return rise + jnp.sqrt(jnp.square(pitch_radius(track_radius, offset)) + rise * rise)


def cage_azimuth(azimuth: ArrayLike, joint_angle: ArrayLike) -> Array:
    """Azimuth phi_c [rad] of a ball about the cage's axis b, tan(phi_c) = tan(phi) cos(beta/2), without jumps.

    phi_c = phi - atan[q sin(2 phi)/(1 + q cos(2 phi))],  q = tan^2(beta/4):  the small deviation by itself, so
    that phi_c counts revolutions as phi does.

    Args:
        azimuth: phi [rad], of the ball about the seat's (and the head's) axis; any number of turns.
        joint_angle: beta [rad], |beta| < pi.
    """
    azimuth, q = jnp.asarray(azimuth, dtype=float), window_deviation(joint_angle)
    return azimuth - jnp.arctan(q * jnp.sin(2.0 * azimuth) / (1.0 + q * jnp.cos(2.0 * azimuth)))


def window_deviation(joint_angle: ArrayLike) -> Array:
    """q = tan^2(beta/4): exactly the sine of the greatest |phi_c - phi| of ``cage_azimuth``.

    A ball thus moves by +-q times its distance from O along its window.
    """
    return jnp.square(jnp.tan(0.25 * jnp.asarray(joint_angle, dtype=float)))


def flexible_length(bend_radius: ArrayLike, clearance: ArrayLike, cylinder_radius: ArrayLike) -> Array:
    """Longest straight cylinder that fits a hole bent to a circle:  l = 4 sqrt(C (R + d)).

    It touches the inner wall at mid-span and the outer wall at both ends:
    (R + d + C)^2 = (R + d - C)^2 + (l/2)^2.  An upper bound: it neither turns nor slides there.

    Args:
        bend_radius: R [m], of the hole's axis, R > d + C.
        clearance: C [m] >= 0, hole radius less cylinder radius; the derivative is infinite at 0.
        cylinder_radius: d [m].

    Returns:
        l [m].
    """
    return 4.0 * jnp.sqrt(jnp.asarray(clearance, dtype=float) * (jnp.asarray(bend_radius) + cylinder_radius))


def flexible_length_one_sided(bend_radius: ArrayLike, clearance: ArrayLike, cylinder_radius: ArrayLike) -> Array:
    """l = 2 sqrt(2 C (R + d)) [m]: ``flexible_length`` where C is the whole play, hole radius d + C/2."""
    return flexible_length(bend_radius, 0.5 * jnp.asarray(clearance), cylinder_radius)


def chord_length(bend_radius: ArrayLike, joint_angle: ArrayLike) -> Array:
    """l = 2 R sin(beta/2) [m] between neighbouring pivots on a circle of radius R, each bent by beta.

    Args:
        bend_radius: R [m].
        joint_angle: beta [rad].
    """
    return 2.0 * jnp.asarray(bend_radius) * jnp.sin(0.5 * jnp.asarray(joint_angle, dtype=float))


def static_ball_load(
    torque: ArrayLike, pitch_radius: ArrayLike, contact_angle: ArrayLike, balls: ArrayLike
) -> tuple[Array, Array]:
    """Q = T/(z Rp) about the axis and N = Q/sin(alpha) normal to the groove, per ball, at no deflection.

    Args:
        torque: T [N m].
        pitch_radius: Rp [m].
        contact_angle: alpha [rad] in (0, pi/2], of the contact normal against the plane of the track.
        balls: z [-], that share the load evenly.

    Returns:
        Q, N [N].
    """
    tangential = jnp.asarray(torque, dtype=float) / (jnp.asarray(balls) * pitch_radius)
    return tangential, tangential / jnp.sin(contact_angle)


def static_cage_load(
    torque: ArrayLike, pitch_radius: ArrayLike, contact_angle: ArrayLike, balls: ArrayLike, offset: ArrayLike
) -> Array:
    """F_c = 2 N cos(alpha) e/Rc [N] of one ball on the cage, at no deflection.

    The sum z F_c = 2 T cot(alpha) e/(Rp Rc) is carried half by the seat and half by the head.

    Args:
        torque, pitch_radius, contact_angle, balls: as ``static_ball_load``.
        offset: e [m].
    """
    normal = static_ball_load(torque, pitch_radius, contact_angle, balls)[1]
    # At no deflection no ball is special: any azimuth.
    return deflected_cage_load(normal, 0.0, contact_angle, 0.0, track_radius(pitch_radius, offset), offset)


def separating_force(torque: ArrayLike, pitch_radius: ArrayLike, contact_angle: ArrayLike, offset: ArrayLike) -> Array:
    """T cot(alpha) e/(Rp Rc) [N] along the axis, on seat and on head, at no deflection; as ``static_cage_load``."""
    return 0.5 * static_cage_load(torque, pitch_radius, contact_angle, 1.0, offset)


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
    """kappa = tan(alpha) tan(beta/2) Rc/e [-]: unevenness of the ball loads, see ``load_sharing``.

    Infinite for concentric tracks, e = 0 (NaN if beta = 0 too); arguments as ``deflected_cage_load``.
    """
    steep = jnp.tan(contact_angle) * jnp.tan(0.5 * jnp.asarray(joint_angle, dtype=float))
    return steep * track_radius / jnp.asarray(offset, dtype=float)


def sign_alternates(
    contact_angle: ArrayLike, joint_angle: ArrayLike, track_radius: ArrayLike, offset: ArrayLike
) -> Array:
    """Whether F_c changes sign over a revolution, |kappa| > 1; also for e = 0. Arguments as ``kappa``."""
    steep = jnp.tan(contact_angle) * jnp.tan(0.5 * jnp.asarray(joint_angle, dtype=float))
    return jnp.abs(steep * track_radius) > jnp.abs(jnp.asarray(offset))


def load_sharing(
    azimuth: ArrayLike,
    torque: ArrayLike,
    pitch_radius: ArrayLike,
    contact_angle: ArrayLike,
    balls: ArrayLike,
    joint_angle: ArrayLike,
    offset: ArrayLike,
) -> Array:
    """N_i = T/(z Rp sin(alpha)) (1 - kappa sin(phi_i)) [N], of first order in beta, from the cage's balance of tilt.

    Against a solve with linear stiffness: within 10 % at beta = 6 deg and 14 % at 10 deg (alpha = 40 deg,
    e/Rc = .126). Beyond |kappa| = 1 balls unload: N_i < 0 is returned there and means that the formula ends.

    Args:
        azimuth: phi_i [rad].
        torque, pitch_radius, contact_angle, balls: as ``static_ball_load``.
        joint_angle: beta [rad].
        offset: e [m], not 0: see ``kappa``.
    """
    mean = static_ball_load(torque, pitch_radius, contact_angle, balls)[1]
    uneven = kappa(contact_angle, joint_angle, track_radius(pitch_radius, offset), offset)
    return mean * (1.0 - uneven * jnp.sin(jnp.asarray(azimuth, dtype=float)))


def secondary_couple(torque: ArrayLike, joint_angle: ArrayLike) -> Array:
    """T tan(beta/2) [N m] on either shaft, about the line normal to its axis in the plane of both axes.

    Args:
        torque: T [N m].
        joint_angle: beta [rad], |beta| < pi.
    """
    return jnp.asarray(torque, dtype=float) * jnp.tan(0.5 * jnp.asarray(joint_angle, dtype=float))
