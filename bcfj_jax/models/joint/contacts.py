"""Geometry of the joint's contacts, and the one way in which all of them act.

A contact is a penetration d, its direction n (= grad d: the way in which the second body, the ball or the inner sphere,
has moved into the first) and the lever l n from the second body's centre to the point of contact. The relative place p
of the centres decides them; the relative twist (v, w) decides the rest:

    rate  d' = n . v        sliding  u = v + w x l n - d' n        force  f = -N n - D u,   D = N mu(|u|)/|u|

with N from the normal-force law. A friction law with bristles, deflected by z, has its force by their part in the
contact plane,  b = z - n (n . z),  and they bend (``LuGre.bond`` has k, s and m; o is ``ContactLaws.apart``):

    force  -N (s b + m u)        z' = W x z + (1 - o) (u - k z) - o z/tau

as in ``contact.wrench``, whose formulas these are for arrays of contacts: W is the outer body's angular velocity. Friction
that lags keeps a number w of each face, the slip speed of late (``Memory.lag``). A contact acts at the ball's centre
unless the ball spins (w given): a ball without spin is a particle, so that force, moment and power balance exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps.balls import sector
from bcfj_jax.contact.laws import AbstractFriction, AbstractLaw, regularised_force
from bcfj_jax.contact.normal import regularised_energy
from bcfj_jax.contact.wrench import RELAX, separated
from bcfj_jax.xla.kept import kept
from bcfj_jax.xla.small import product, skew


class ContactLaws(eqx.Module):
    """One law and one friction law, or none, over any broadcast shape of contacts."""

    law: AbstractLaw
    friction: AbstractFriction | None
    coefficients: Mapping[str, Array]  # by the laws' names; scalars, or arrays that broadcast against the contacts
    smoothing: Array | None  # half-width of the contact regularisation [m]; None for none

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
            none = jnp.zeros_like(slip_squared)
            return none, none, none
        return self.friction.bond(slip_squared, self.coefficients)

    def lag(self, slip_squared: Array, late: Array) -> tuple[Array, Array]:
        """w' [m/s^2] and mobility [s/m] of ``Memory.lag``, zero without friction: the traction is  -N mobility v."""
        if self.friction is None:
            return jnp.zeros_like(late), jnp.zeros_like(late)
        return self.friction.lag(slip_squared, late, self.coefficients)

    def apart(self, penetration: Array) -> Array:
        """``contact.wrench.separated``."""
        return separated(penetration, {} if self.smoothing is None else {"smoothing": self.smoothing})

    def first(self, count: int) -> ContactLaws:
        """The first of contacts side by side."""
        coefficients, smoothing = jax.tree.map(lambda x: x[:count], (dict(self.coefficients), self.smoothing))
        return ContactLaws(self.law, self.friction, coefficients, smoothing)

    def energy(self, penetration: Array) -> Array:
        """Elastic energy E(d) [J]: integral of the law's force at rest from 0 to r(d), the regularised penetration."""
        still = jnp.zeros_like(penetration)
        return regularised_energy(self.law, penetration, still, self.coefficients, {}, self.smoothing)[0]


class Geometry(NamedTuple):
    """Where contacts are; f faces (or flanks) each."""

    penetration: Array  # (..., f) [m], positive in contact
    normal: Array  # (..., f, 3)
    lever: Array  # (..., f) l [m]
    gate: Array | None = None  # (..., f) 1 where the face is there, 0 beyond its edge; None for a face without edges


class ContactForce(NamedTuple):
    """What contacts do."""

    # force, moment: (..., 3) on the second body and about its centre [N], [N m]; moment None without spin.
    force: Array
    moment: Array | None
    drag: Array  # (..., 3) the part of ``force`` that is friction
    # normal, penetration, rate, slip: (..., f) of each face: [N] >= 0, [m], [m/s], sliding speed [m/s].
    normal: Array
    penetration: Array
    rate: Array
    slip: Array
    # (..., f, 3) z' less W x z [m/s], or (..., f, 1) w' [m/s^2]; None without a state of friction.
    bending: Array | None = None
    rubbed: Array | None = None  # (..., f) power that friction takes [W]; None without friction
    slip_squared: Array | None = None  # (..., f) of ``slip``, whose own derivative is not finite at rest


class Groove(NamedTuple):
    """Shape of the tracks of both races; axes of length 2 are (seat, head)."""

    radius: Array  # track centre circle R_c [m]
    offset: Array  # (2,) centre circles' distance along the race's axis from its centre, (+e, -e) [m]
    side: Array  # (2,) +1 for the outer race, -1 for the inner
    flank: Array  # r_g - r of the nominal groove [m]; 0 for a circular section
    # sine, cosine: of the contact angle.
    sine: Array
    cosine: Array
    clearance: Array  # (2,) normal clearance to each flank [m]; (balls, 2) of unequal balls
    ball: Array  # ball radius [m]
    gothic: Array  # (2,) +1 and -1, the flanks; (1,) zero for a circular section

    def races(self, at: slice) -> Groove:
        """Of some of both races."""
        return self._replace(offset=self.offset[at], side=self.side[at], clearance=self.clearance[..., at])


def dot(a: Array, b: Array) -> Array:
    """Inner product along the last axis."""
    return jnp.sum(a * b, axis=-1)


def grooves(shape: Groove, place: Array, across: Array) -> Geometry:
    """Balls in the tracks of both races: torus of circular or gothic section (physics sheet 5.3, rows 4 and 5).

    In the section, t across the track's plane and a outward of the track circle, flank s = +-1 has its circle's
    centre at  -(r_g - r)(s sin(alpha), side cos(alpha))  and  d = |(t, a) - centre| - (r_g - r) - clearance.
    ``place`` (..., 2, 3) is the ball's centre less the track circle's [m], ``across`` the unit normal of the track's plane.
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
    gate = sector(shape.gothic * n_t) if shape.gothic.size == 2 else None
    penetration = length - (shape.flank + shape.clearance[..., None])
    return Geometry(penetration, normal, jnp.broadcast_to(shape.ball, penetration.shape), gate)


def windows(clearance: Array, ball: Array, place: Array, axis: Array) -> Geometry:
    """Balls between two planes of the cage (physics sheet 5.3, row 3):  d = +-p . axis - clearance.

    ``place`` (..., 3) is the ball's centre less the cage's [m]; ``axis`` the unit normal that turns with the cage, to broadcast
    against it: the cage's axis for the faces of windows, around the cage (``geometry.windows_around``) for their ends.
    """
    sides = jnp.array([1.0, -1.0])
    penetration = sides * dot(place, axis)[..., None] - clearance
    normal = jnp.broadcast_to(sides[:, None] * axis[..., None, :], penetration.shape + (3,))
    return Geometry(penetration, normal, jnp.broadcast_to(ball, penetration.shape))


def pilots(clearance: Array, hollow: Array, place: Array) -> Geometry:
    """Spheres at ``place`` (k, 3) in hollow spheres of radius ``hollow`` (k,) [m] (physics sheet 5.3):  d = |p| - clearance."""
    distance = jnp.sqrt(dot(place, place) + 1e-24)[:, None]
    normal = (place / distance)[:, None, :]
    return Geometry(distance - clearance[:, None], normal, hollow[:, None] - distance)


def join(first: Geometry, second: Geometry) -> Geometry:
    """Contacts with two groups of bodies side by side, (n, m, f) and (n, k, f), as one (n, m + k, f); the second has no edges."""
    gate = None if first.gate is None else jnp.concatenate([first.gate, jnp.ones_like(second.lever)], 1)
    joined = (jnp.concatenate(x, 1) for x in zip(first[:3], second[:3], strict=True))
    return Geometry(*joined, gate=gate)


def act(
    laws: ContactLaws, at: Geometry, velocity: Array, spin: Array | None, bristles: Array | None = None
) -> ContactForce:
    """Forces of contacts (module docstring), of relative twist (``velocity``, ``spin``); a particle has no spin.

    ``bristles`` are (..., f, 3) deflections z [m], or (..., f, 1) slip speeds of late w [m/s]; without them every law acts by its
    steady slip.
    """
    rate, slide = sliding(at, velocity, spin)
    normal = laws.normal(at.penetration, rate)
    if at.gate is not None:
        normal = normal * at.gate
    normal, slide = kept(normal, slide)
    slip_squared = dot(slide, slide)
    force = -jnp.sum(normal[..., None] * at.normal, -2)
    drag = moment = jnp.zeros_like(force)
    bending = rubbed = None
    if laws.friction is not None:
        pull, bending = traction(laws, at.normal, at.penetration, slide, bristles)
        drags = kept(-normal[..., None] * pull)
        drag, rubbed = jnp.sum(drags, -2), -dot(drags, slide)
        force = force + drag
        moment = jnp.sum(jnp.cross(at.lever[..., None] * at.normal, drags), -2)
    moment = None if spin is None else moment
    seen = normal, at.penetration, rate, jnp.sqrt(slip_squared)
    return ContactForce(force, moment, drag, *seen, bending, rubbed, slip_squared)


def sliding(at: Geometry, velocity: Array, spin: Array | None) -> tuple[Array, Array]:
    """Rate d' (..., f) and sliding velocity u (..., f, 3) of faces, of relative twist (``velocity``, ``spin``)."""
    velocity = velocity[..., None, :]
    rate = dot(at.normal, velocity)
    slide = velocity - rate[..., None] * at.normal
    if spin is not None:
        slide = slide + jnp.cross(spin[..., None, :], at.lever[..., None] * at.normal)
    return rate, slide


def traction(
    laws: ContactLaws, normal: Array, penetration: Array, slide: Array, state: Array | None
) -> tuple[Array, Array | None]:
    """g (..., f, 3) of friction's force  -N g,  and ``ContactForce.bending``."""
    squared = dot(slide, slide)
    if state is None:
        return laws.mobility(squared)[..., None] * slide, None
    if state.shape[-1] == 1:
        learnt, mobility = (x[..., None] for x in laws.lag(squared, state[..., 0]))
        return mobility * slide, learnt
    forget, stick, mobility = (x[..., None] for x in laws.bond(squared))
    bent = state - dot(normal, state)[..., None] * normal
    apart = laws.apart(penetration)[..., None]
    return stick * bent + mobility * slide, (1.0 - apart) * (slide - forget * state) - apart / RELAX * state


class Tangents(NamedTuple):
    """What contacts exert on the second body, (..., o), and its derivatives: force, and moment where it spins."""

    value: Array  # (..., o)
    place: Array  # (..., o, 3) by the relative place
    twist: Array  # (..., o, k) by the relative twist
    # (..., f, w) rates of friction's states, and these by place and twist (..., f, w, 3 | k); None without states.
    bending: tuple[Array, Array, Array] | None = None
    pull: Array | None = None  # (..., o, f w) by friction's states
    decay: Array | None = None  # (..., f) how fast a state forgets itself [1/s]


class _Learning(NamedTuple):
    """Of friction with states: ``traction``'s derivatives by the normal and the state, the states' rates, and theirs."""

    by_normal: Array
    by_state: Array
    rate: Array
    by_slide: Array
    by_depth: Array
    decay: Array


def _traction(
    laws: ContactLaws, at: Geometry, slide: Array, state: Array | None
) -> tuple[Array, Array, _Learning | None]:
    """``traction`` and its derivative by the slide (..., f, 3, 3)."""
    if state is None:
        squared = dot(slide, slide)
        mobility, slope = kept(*jax.jvp(laws.mobility, (squared,), (jnp.ones_like(squared),)))
        by_slide = mobility[..., None, None] * jnp.eye(3) + (2.0 * slope)[..., None, None] * outer(slide, slide)
        return mobility[..., None] * slide, by_slide, None

    def found(normal: Array, depth: Array, slide: Array, state: Array) -> tuple[Array, Array | None]:
        return traction(laws, normal, depth[..., 0], slide, state)

    n, depth = at.normal, at.penetration[..., None]
    value, rate = found(n, depth, slide, state)
    by_slide, swung = by(lambda u: found(n, depth, u, state), slide)
    by_state, felt = by(lambda z: found(n, depth, slide, z), state)
    by_normal, by_depth = (
        by(lambda n: found(n, depth, slide, state)[0], n),
        by(lambda d: found(n, d, slide, state)[1], depth),
    )
    assert rate is not None
    return value, by_slide, _Learning(by_normal, by_state, rate, swung, by_depth, -felt[..., 0, 0])


def tangents(
    laws: ContactLaws,
    geometry: Callable[[Array], Geometry],
    arm: Array,
    velocity: Array,
    spin: Array | None,
    state: Array | None,
) -> Tangents:
    """Derivatives of ``act`` in one state; ``geometry`` is that of a relative place, ``arm``.

    With H = dn/dp, r = l n and the velocity  v + w x r  of the point of contact, a face's force  F = -N (n + g)  has

        by that velocity    -(n + g) N_d' n' - N g_u (I - n n')
        by the place        -(n + g) (N_d n + N_d' H v)' - N (H + g_u u_p + g_n H),    u_p = w x r_p - n (H v)' - d' H

    Its moment is  r x F,  since g is across n.
    """
    at, moved = geometry(arm), by(geometry, arm)
    rate, slide = sliding(at, velocity, spin)
    one, gate = jnp.ones_like(rate), 1.0 if at.gate is None else at.gate
    bare, by_depth = jax.jvp(lambda d: laws.normal(d, rate), (at.penetration,), (one,))
    by_rate = gate * jax.jvp(lambda v: laws.normal(at.penetration, v), (rate,), (one,))[1]
    load, swept = gate * bare, jnp.sum(velocity[..., None, :, None] * moved.normal, -2)
    grown = (gate * by_depth)[..., None] * moved.penetration + by_rate[..., None] * swept
    if moved.gate is not None:
        grown = grown + bare[..., None] * moved.gate
    lever = at.lever[..., None] * at.normal
    levered = at.lever[..., None, None] * moved.normal + outer(at.normal, moved.lever)
    slid = -outer(at.normal, swept) - rate[..., None, None] * moved.normal
    if spin is not None:
        slid = slid + product(skew(spin)[..., None, :, :], levered)
    load, by_rate, grown, arm_of, levered, slid = kept(load, by_rate, grown, skew(lever), levered, slid)
    pull, by_slide, learning = _traction(laws, at, slide, state)
    push, load = at.normal + pull, load[..., None, None]
    pressed = moved.normal + product(by_slide, slid)
    if learning is not None:
        pressed = pressed + product(learning.by_normal, moved.normal)
    force = -load[..., 0] * push
    place = -outer(push, grown) - load * pressed
    twist = -outer(push, by_rate[..., None] * at.normal) - load * _across(by_slide, at.normal)
    place, twist = kept(place, twist)
    changes = [force[..., None], place, twist if spin is None else _whole(twist, arm_of)]
    if learning is not None:
        changes.append(-load * learning.by_state)
    if spin is not None:
        moments = [product(arm_of, x) for x in changes]
        moments[1] = moments[1] - product(skew(force), levered)
        changes = [jnp.concatenate(x, -2) for x in zip(changes, moments, strict=True)]
    value, place, twist = (jnp.sum(x, -3) for x in changes[:3])
    if learning is None:
        return Tangents(value[..., 0], place, twist)
    bent = product(learning.by_slide, slid) + learning.by_depth * moved.penetration[..., None, :]
    swung = _across(learning.by_slide, at.normal)
    pull = jnp.moveaxis(changes[3], -3, -2)
    bending = learning.rate, bent, swung if spin is None else _whole(swung, arm_of)
    return Tangents(value[..., 0], place, twist, bending, pull.reshape(*pull.shape[:-2], -1), learning.decay)


def _across(rows: Array, normal: Array) -> Array:
    """Rows (..., i, 3) times I - n n'."""
    return rows - outer(jnp.sum(rows * normal[..., None, :], -1), normal)


def _whole(rows: Array, lever: Array) -> Array:
    """By the velocity of the point of contact (..., i, 3): by the twist (..., i, 6); ``lever``: its ``skew``."""
    return jnp.concatenate([rows, -product(rows, lever)], -1)


def outer(a: Array, b: Array) -> Array:
    """a b', (..., i, j)."""
    return a[..., :, None] * b[..., None, :]


def by(function: Callable[[Array], Any], x: Array) -> Any:
    """Derivatives of ``function`` by x (..., k), along a last axis more."""

    def along(way: Array) -> Any:
        return jax.jvp(function, (x,), (jnp.broadcast_to(way, x.shape),))[1]

    return jax.vmap(along, out_axes=-1)(jnp.eye(x.shape[-1]))
