"""Geometry of the joint's contacts, and the one way in which all of them act.

A contact is a penetration d, its direction n (= grad d: the way in which the second body, the ball or the inner sphere,
has moved into the first) and the lever l n from the second body's centre to the point of contact. The relative place p
of the centres decides them; the relative twist (v, w) decides the rest:

    rate  d' = n . v        sliding  u = v + w x l n - d' n        force  f = -N n - D u,   D = N mu(|u|)/|u|

with N from the normal-force law. Everything is frame-indifferent: force in the axes of its arguments.
Gaps and normals: physics sheet 5.3. A contact acts at the ball's centre unless the ball spins (w given): a ball
without spin is a particle, so that force, moment and power balance exactly in either case.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.joint.skin import Skin, SkinPair, sector


class Geometry(NamedTuple):
    """Where contacts are; f faces (or flanks) each.

    Attributes:
        penetration: (..., f) [m], positive in contact.
        normal: (..., f, 3).
        lever: (..., f) l [m].
        gate: (..., f) 1 where the face is there, 0 beyond its edge; None for a face without edges.
        bends: [(unit vector (..., f, 3), 1/m)] the Hessian of d as a sum of dyads  e e' / R.
        gate_slope: (..., f, 3) derivative of ``gate`` by p; None without gate.
        lever_slope: dl/dd: -1 between spheres, whose lever shortens as they part; 0 elsewhere.
    """

    penetration: Array
    normal: Array
    lever: Array
    gate: Array | None
    bends: tuple[tuple[Array, Array], ...]
    gate_slope: Array | None = None
    lever_slope: float = 0.0


class Touch(NamedTuple):
    """What contacts do.

    Attributes:
        force, moment: (..., 3) on the second body and about its centre [N], [N m]; moment None without spin.
        drag: (..., 3) the part of ``force`` that is friction.
        normal, penetration, rate, slip: (..., f) of each face: [N] >= 0, [m], [m/s], sliding speed [m/s].
    """

    force: Array
    moment: Array | None
    drag: Array
    normal: Array
    penetration: Array
    rate: Array
    slip: Array


class Groove(NamedTuple):
    """Shape of the tracks of both races; axes of length 2 are (seat, head).

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


def dot(a: Array, b: Array) -> Array:
    """Inner product along the last axis."""
    return jnp.sum(a * b, axis=-1)


def grooves(shape: Groove, place: Array, across: Array) -> Geometry:
    """Balls in the tracks of both races: torus of circular or gothic section (physics sheet 5.3, rows 4 and 5).

    In the section, t across the track's plane and a outward of the track circle, flank s = +-1 has its circle's
    centre at  -(r_g - r)(s sin(alpha), side cos(alpha))  and  d = |(t, a) - centre| - (r_g - r) - clearance.

    Args:
        place: (..., 2, 3) ball centre less track-circle centre [m].
        across: (..., 2, 3) unit normal of the track's plane.
    """
    t = dot(place, across)
    plane = place - t[..., None] * across
    distance = jnp.sqrt(dot(plane, plane))
    radial = (plane / distance[..., None])[..., None, :]
    across = across[..., None, :]
    y_t = t[..., None] + shape.gothic * (shape.flank * shape.sine)
    y_a = (distance - shape.radius + shape.side * (shape.flank * shape.cosine))[..., None]
    # 1e-12 m: a ball exactly in the middle of a circular groove has no direction, and no force.
    length = jnp.sqrt(y_t * y_t + y_a * y_a + 1e-24)
    n_t, n_a = y_t / length, y_a / length
    normal = n_t[..., None] * across + n_a[..., None] * radial
    upward = n_a[..., None] * across - n_t[..., None] * radial
    along = jnp.cross(radial, across)
    bends = ((upward, 1.0 / length), (along, n_a / distance[..., None]))
    gate = slope = None
    if shape.gothic.size == 2:
        gate, gate_rate = jax.jvp(sector, (shape.gothic * n_t,), (shape.gothic * n_a / length,))
        slope = gate_rate[..., None] * upward
    penetration = length - (shape.flank + shape.clearance[:, None])
    return Geometry(penetration, normal, jnp.broadcast_to(shape.ball, t.shape + (1,)), gate, bends, slope)


def windows(clearance: Array, ball: Array, place: Array, axis: Array) -> Geometry:
    """Balls between the plane faces of their cage windows (physics sheet 5.3, row 3):  d = +-p . axis - clearance.

    A window has no ends around the cage.

    Args:
        clearance: gap of a centred ball to either face [m].
        ball: ball radius [m].
        place: (..., 3) ball centre less cage centre [m].
        axis: (3,) the cage's unit axis.
    """
    sides = jnp.array([1.0, -1.0])
    penetration = sides * dot(place, axis)[..., None] - clearance
    normal = jnp.broadcast_to(sides[:, None] * axis, penetration.shape + (3,))
    return Geometry(penetration, normal, jnp.broadcast_to(ball, penetration.shape), None, ())


def pilots(clearance: Array, hollow: Array, place: Array) -> Geometry:
    """Spheres in hollow spheres (physics sheet 5.3, rows 1 and 2):  d = |p| - clearance.

    Full spheres: a real pilot is a band, whose edge carries an axial load a little off the pole.

    Args:
        clearance: (k,) radial clearance [m].
        hollow: (k,) radius of the hollow sphere [m].
        place: (k, 3) inner centre less outer centre [m].
    """
    distance = jnp.sqrt(dot(place, place) + 1e-24)[:, None]
    normal = (place / distance)[:, None, :]
    across = jnp.eye(3) - normal * jnp.swapaxes(normal, -1, -2)
    # I - n n' is the sum of its own columns' dyads.
    bends = tuple((across[:, None, :, i], 1.0 / distance) for i in range(3))
    return Geometry(distance - clearance[:, None], normal, hollow[:, None] - distance, None, bends, None, -1.0)


def join(first: Geometry, second: Geometry) -> Geometry:
    """Contacts with two groups of bodies side by side, (n, m, f) and (n, f), as one (n, m + 1, f).

    The second is without edges, curvature or change of lever, as a window is.
    """
    second = jax.tree.map(lambda x: x[:, None], second._replace(lever_slope=None))
    flat = second.normal
    bends = tuple(
        (
            jnp.concatenate([jnp.broadcast_to(unit, first.normal.shape), flat], 1),
            jnp.concatenate([jnp.broadcast_to(curve, first.normal.shape[:-1]), jnp.zeros_like(second.lever)], 1),
        )
        for unit, curve in first.bends
    )
    gate = slope = None
    if first.gate is not None:
        gate = jnp.concatenate([first.gate, jnp.ones_like(second.lever)], 1)
        slope = jnp.concatenate([_given(first.gate_slope), jnp.zeros_like(flat)], 1)
    lever = jnp.broadcast_to(first.lever, first.normal.shape[:-1])
    return Geometry(
        jnp.concatenate([first.penetration, second.penetration], 1),
        jnp.concatenate([first.normal, flat], 1),
        jnp.concatenate([lever, second.lever], 1),
        gate,
        bends,
        slope,
    )


def act(skin: Skin | SkinPair, at: Geometry, velocity: Array, spin: Array | None) -> Touch:
    """Forces of contacts (module docstring).

    Args:
        velocity: (..., 3) v of the second centre relative to the first body's material there [m/s].
        spin: (..., 3) w, relative angular velocity [1/s]; None for a body that is a particle.
    """
    velocity = velocity[..., None, :]
    rate = dot(at.normal, velocity)
    normal = skin.normal(at.penetration, rate)
    if at.gate is not None:
        normal = normal * at.gate
    slide = velocity - rate[..., None] * at.normal
    if spin is not None:
        slide = slide + jnp.cross(spin[..., None, :], at.lever[..., None] * at.normal)
    slip_squared = dot(slide, slide)
    force = -jnp.sum(normal[..., None] * at.normal, -2)
    drag = moment = jnp.zeros_like(force)
    if skin.friction is not None:
        drags = -(normal * skin.mobility(slip_squared))[..., None] * slide
        drag = jnp.sum(drags, -2)
        force = force + drag
        moment = jnp.sum(jnp.cross(at.lever[..., None] * at.normal, drags), -2)
    slip = jnp.sqrt(slip_squared)
    return Touch(force, None if spin is None else moment, drag, normal, at.penetration, rate, slip)


def slopes(skin: Skin | SkinPair, at: Geometry, velocity: Array, spin: Array | None) -> tuple[Array, Array, Array]:
    """Wrench (..., k) of ``act``, and its derivatives by place (..., k, 3) and by twist (..., k, k), k = 3 or 6.

    With H the Hessian of d, g = H v and the laws' slopes N_d, N_r, D_2 = N d(mu/|u|)/d(u.u):

        dN = (N_d n + N_r g) . dp + N_r n . dv        du = (I - nn') dv - (n g' + d' H) dp    (no spin)
        df = -n dN - N H dp - u dD - D du             dD = (mu/|u|) dN + 2 D_2 u . du

    and with spin the lever's sweep  w x d(l n) + dw x l n  in du, and the moment  l n x (-D u).
    """
    v, n = velocity[..., None, :], at.normal
    rate = dot(n, v)
    normal, by_depth = jax.jvp(lambda d: skin.normal(d, rate), (at.penetration,), (jnp.ones_like(at.penetration),))
    by_rate = jax.jvp(lambda r: skin.normal(at.penetration, r), (rate,), (jnp.ones_like(rate),))[1]
    hessian = sum(((e * curve[..., None])[..., :, None] * e[..., None, :] for e, curve in at.bends), jnp.zeros(()))
    curved = len(at.bends) > 0
    drift = sum(((e * (curve * dot(e, v))[..., None]) for e, curve in at.bends), jnp.zeros(3))
    load_place = by_depth[..., None] * n + by_rate[..., None] * drift
    if at.gate is not None:
        load_place = at.gate[..., None] * load_place + normal[..., None] * at.gate_slope
        normal, by_rate = normal * at.gate, by_rate * at.gate
    load_twist = by_rate[..., None] * n
    by_place = -_dyad(n, load_place) - (normal[..., None, None] * hessian if curved else 0.0)
    by_twist = -_dyad(n, load_twist)
    force = -normal[..., None] * n
    if skin.friction is None:
        k = 3 if spin is None else 6
        wide = [(0, 0)] * (by_place.ndim - 3)
        value, by_place, by_twist = jnp.sum(force, -2), jnp.sum(by_place, -3), jnp.sum(by_twist, -3)
        value = jnp.pad(value, [*wide, (0, k - 3)])
        return value, jnp.pad(by_place, [*wide, (0, k - 3), (0, 0)]), jnp.pad(by_twist, [*wide, *[(0, k - 3)] * 2])
    slide = v - rate[..., None] * n
    plane = jnp.eye(3) - _dyad(n, n)
    slide_place = -(_dyad(n, drift) + rate[..., None, None] * hessian) if curved else jnp.zeros_like(plane)
    slide_twist = plane
    lever = at.lever[..., None]
    if spin is not None:
        w = spin[..., None, :]
        slide = slide + jnp.cross(w, lever * n)
        sweep = lever[..., None] * hessian + at.lever_slope * _dyad(n, n) if curved else jnp.zeros_like(plane)
        slide_place = slide_place + _cross_columns(w, sweep)
        turned = -jnp.cross(lever[..., None] * n[..., None, :], jnp.eye(3)).swapaxes(-1, -2)
        slide_twist = jnp.concatenate([plane, turned], -1)
        load_twist = jnp.concatenate([load_twist, jnp.zeros_like(load_twist)], -1)
        by_twist = jnp.concatenate([by_twist, jnp.zeros_like(by_twist)], -1)
    squared = dot(slide, slide)
    mobility, bend = jax.jvp(skin.mobility, (squared,), (jnp.ones_like(squared),))
    drag, pull = normal * mobility, (2.0 * normal * bend)[..., None] * slide
    drag_place = mobility[..., None] * load_place + _row(pull, slide_place)
    drag_twist = mobility[..., None] * load_twist + _row(pull, slide_twist)
    rub = -drag[..., None] * slide
    rub_place = -_dyad(slide, drag_place) - drag[..., None, None] * slide_place
    rub_twist = -_dyad(slide, drag_twist) - drag[..., None, None] * slide_twist
    value, by_place, by_twist = force + rub, by_place + rub_place, by_twist + rub_twist
    if spin is not None:
        arm = lever * n
        value = jnp.concatenate([value, jnp.cross(arm, rub)], -1)
        moment_place = _cross_columns(arm, rub_place) - _cross_columns(rub, sweep)
        by_place = jnp.concatenate([by_place, moment_place], -2)
        by_twist = jnp.concatenate([by_twist, _cross_columns(arm, rub_twist)], -2)
    return jnp.sum(value, -2), jnp.sum(by_place, -3), jnp.sum(by_twist, -3)


def _given(array: Array | None) -> Array:
    assert array is not None
    return array


def _dyad(a: Array, b: Array) -> Array:
    return a[..., :, None] * b[..., None, :]


def _row(a: Array, matrix: Array) -> Array:
    return jnp.sum(a[..., :, None] * matrix, -2)


def _cross_columns(a: Array, matrix: Array) -> Array:
    """a x (each column of the matrix)."""
    return jnp.cross(a[..., None, :], matrix.swapaxes(-1, -2)).swapaxes(-1, -2)
