"""Geometry and force of the joint's contacts, from the motion of one body relative to another.

Every function here is frame-indifferent: it takes relative position and velocity and directions fixed to the
bodies, and gives the force in the same axes. So it is differentiated locally, by relative motion, and the
chain to the bodies' coordinates (``arrowhead``) is the same for all. Normal force acts along the
gradient of the gap (physics sheet 5.3); traction acts against the sliding velocity.

A contact acts at the ball's centre unless the ball spins (``spin`` given): a ball without spin is a particle, so
that force, moment and power balance exactly in either case.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from bcfj_jax.joint.skin import Skin, SkinPair, sector


class Touch(NamedTuple):
    """What one kind of contact does; leading axes are those of the contacts.

    Attributes:
        force: (..., 3) on the second body (ball; inner sphere) [N].
        moment: (..., 3) on a spinning ball about its centre [N m]; None without spin.
        normal: (..., f) normal force of each face or flank [N] >= 0.
        traction: (..., 2) friction on the second body along the contact's two tangents [N].
        penetration, rate: (..., f) [m], [m/s].
        slip: (..., f) sliding speed [m/s]; of frictionless contacts too.
    """

    force: Array
    moment: Array | None
    normal: Array
    traction: Array
    penetration: Array
    rate: Array
    slip: Array


class Groove(NamedTuple):
    """Shape of the tracks of both races; the axis -1 of arrays is (seat, head).

    Attributes:
        radius: track centre circle R_c [m].
        offset: (2,) centre circles' distance along the race's axis from its centre, (+e, -e) [m].
        side: (2,) +1 for the outer race, -1 for the inner.
        flank: r_g - r of the nominal groove [m]; 0 for a circular section.
        sine, cosine: of the contact angle.
        clearance: (2,) normal clearance to each flank [m].
        ball: ball radius [m].
        gothic: (2,) +1 and -1, the flanks; (1,) zero for a circular section.
    """

    radius: Array
    offset: Array
    side: Array
    flank: Array
    sine: Array
    cosine: Array
    clearance: Array
    ball: Array
    gothic: Array


def _dot(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=-1)


def grooves(
    shape: Groove, skin: Skin | SkinPair, place: Array, velocity: Array, spin: Array | None, across: Array
) -> Touch:
    """Balls in the tracks of both races: torus of circular or gothic section (physics sheet 5.3, rows 4, 5).

    With t = place . across, a = (distance from the race's axis through the track's centre, in the track's plane) - R_c:
    flank s = +-1 has its circle's centre at  -(r_g - r)(s sin(alpha), side cos(alpha))  in (t, a);
    penetration  |(t, a) - centre| - (r_g - r) - clearance.  Tangents: along the track, across the groove.

    Args:
        place: (..., 2, 3) ball centre less track-circle centre [m].
        velocity: (..., 2, 3) of the ball's centre relative to the race's material there [m/s].
        spin: (..., 2, 3) ball's angular velocity less the race's [1/s], or None.
        across: (..., 2, 3) unit normal of the track's plane.
    """
    t = _dot(place, across)
    plane = place - t[..., None] * across
    distance = jnp.sqrt(_dot(plane, plane))
    radial = plane / distance[..., None]
    along = jnp.cross(radial, across)
    y_t = t[..., None] + shape.gothic * (shape.flank * shape.sine)
    y_a = (distance - shape.radius + shape.side * (shape.flank * shape.cosine))[..., None]
    # 1e-12 m: a ball exactly in the middle of a circular groove has no direction, and no force.
    length = jnp.sqrt(y_t * y_t + y_a * y_a + 1e-24)
    n_t, n_a = y_t / length, y_a / length
    v_t, v_a, v_s = _dot(velocity, across)[..., None], _dot(velocity, radial)[..., None], _dot(velocity, along)[..., None]
    penetration = length - (shape.flank + shape.clearance[:, None])
    rate = n_t * v_t + n_a * v_a
    normal = skin.normal(penetration, rate)
    if shape.gothic.size == 2:
        normal = normal * sector(shape.gothic * n_t)
    v_c = n_a * v_t - n_t * v_a
    if spin is not None:
        w_t, w_a, w_s = (_dot(spin, axis)[..., None] for axis in (across, radial, along))
        v_c = v_c + shape.ball * w_s
        v_s = v_s + shape.ball * (w_a * n_t - w_t * n_a)
    slip_squared = v_c * v_c + v_s * v_s
    f_t, f_a = -normal * n_t, -normal * n_a
    moment = None
    traction = jnp.zeros(t.shape + (2,))
    if skin.friction is not None:
        drag = normal * skin.mobility(slip_squared)
        q_c, q_s = -drag * v_c, -drag * v_s
        f_t, f_a = f_t + q_c * n_a, f_a - q_c * n_t
        f_s = jnp.sum(q_s, -1)
        traction = jnp.stack([f_s, jnp.sum(q_c, -1)], -1)
        force = f_s[..., None] * along
        if spin is not None:
            m_t, m_a, m_s = (jnp.sum(m, -1)[..., None] for m in (-q_s * n_a, q_s * n_t, q_c))
            moment = shape.ball * (m_t * across + m_a * radial + m_s * along)
    else:
        force = 0.0
        moment = None if spin is None else jnp.zeros_like(place)
    force = force + jnp.sum(f_t, -1)[..., None] * across + jnp.sum(f_a, -1)[..., None] * radial
    return Touch(force, moment, normal, traction, penetration, rate, jnp.sqrt(slip_squared))


def windows(
    skin: Skin, clearance: Array, ball: Array, place: Array, velocity: Array, spin: Array | None, axis: Array
) -> Touch:
    """Balls between the two plane faces of their cage windows (physics sheet 5.3, row 3).

    Penetration of the faces at +axis and -axis:  +-place . axis - clearance.  Tangents: radially outward, around the
    cage (axis x outward). A window has no ends around the cage.

    Args:
        clearance: gap of a centred ball to either face [m].
        place: (..., 3) ball centre less cage centre [m].
        velocity: (..., 3) of the ball's centre relative to the cage's material there [m/s].
        spin: (..., 3) ball's angular velocity less the cage's [1/s], or None.
        axis: (3,) the cage's unit axis.
    """
    sides = jnp.array([1.0, -1.0])
    height, climb = _dot(place, axis)[..., None], _dot(velocity, axis)[..., None]
    penetration, rate = sides * height - clearance, sides * climb
    normal = skin.normal(penetration, rate)
    force = -jnp.sum(sides * normal, -1)[..., None] * axis
    slide = (velocity - climb * axis)[..., None, :]
    if spin is not None:
        slide = slide + (ball * sides)[:, None] * jnp.cross(spin, axis)[..., None, :]
    slip_squared = _dot(slide, slide)
    moment = None if spin is None else jnp.zeros_like(place)
    traction = jnp.zeros(place.shape[:-1] + (2,))
    if skin.friction is not None:
        drag = -(normal * skin.mobility(slip_squared))[..., None] * slide
        pull = jnp.sum(drag, -2)
        outward = place - height * axis
        outward = outward / jnp.sqrt(_dot(outward, outward))[..., None]
        traction = jnp.stack([_dot(pull, outward), _dot(pull, jnp.cross(axis, outward))], -1)
        force = force + pull
        if spin is not None:
            moment = jnp.cross(ball * axis, jnp.sum(sides[:, None] * drag, -2))
    return Touch(force, moment, normal, traction, penetration, rate, jnp.sqrt(slip_squared))


def pilots(
    skin: Skin | SkinPair,
    clearance: Array,
    hollow: Array,
    place: Array,
    velocity: Array,
    outer_spin: Array,
    inner_spin: Array,
    axis: Array,
) -> tuple[Touch, Array, Array]:
    """Spheres in hollow spheres (physics sheet 5.3, rows 1 and 2): penetration  |place| - clearance.

    Tangents: the part of ``axis`` (the cage's) across the normal, and normal x that; both zero where the normal is the
    axis. Full spheres: a real pilot is a band, whose edge carries an axial load a little off the pole.

    Args:
        clearance: (k,) radial clearance [m].
        hollow: (k,) radius of the hollow sphere [m].
        place, velocity: (k, 3) inner centre less outer centre and its rate [m], [m/s].
        outer_spin, inner_spin: (k, 3) angular velocities [1/s].
        axis: (3,) reference for the tangents.

    Returns:
        The touch (force on the inner sphere), and the moments (k, 3) about the outer and inner centres.
    """
    distance = jnp.sqrt(_dot(place, place) + 1e-24)[..., None]
    normal_way = place / distance
    rate = jnp.sum(velocity * normal_way, -1, keepdims=True)
    penetration = distance - clearance[:, None]
    normal = skin.normal(penetration, rate)
    force = -normal * normal_way
    outer_arm = hollow[:, None] * normal_way
    inner_arm = outer_arm - place
    slide = velocity + jnp.cross(inner_spin, inner_arm) - jnp.cross(outer_spin, outer_arm)
    slide = slide - jnp.sum(slide * normal_way, -1, keepdims=True) * normal_way
    slip_squared = jnp.sum(slide * slide, -1, keepdims=True)
    traction = jnp.zeros(place.shape[:-1] + (2,))
    if skin.friction is not None:
        drag = -normal * skin.mobility(slip_squared) * slide
        axial = axis - _dot(normal_way, axis)[..., None] * normal_way
        axial = axial / jnp.sqrt(_dot(axial, axial) + 1e-24)[..., None]
        traction = jnp.stack([_dot(drag, axial), _dot(drag, jnp.cross(normal_way, axial))], -1)
        force = force + drag
    touch = Touch(force, None, normal, traction, penetration, rate, jnp.sqrt(slip_squared))
    return touch, -jnp.cross(outer_arm, force), jnp.cross(inner_arm, force)
