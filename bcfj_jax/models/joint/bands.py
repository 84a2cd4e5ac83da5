"""Pilots as bands: the cage bears where it has material, between the latitudes -lambda and lambda about its axis.

p leads from the cage's centre to that of the sphere, b is the cage's axis, and b' the plane across it. A pilot bears with
the points of its band, whose directions e from the cage's centre are unit vectors. Its force is the sum of the forces of
these points, N <e>, where N is the sum of their sizes and the mean direction q = <e> lies in the convex hull of the band,
which is the unit ball between the planes at +-sin(lambda). The point of the hull that lies deepest decides:

    d = max over the hull of  p . q + w (1 - |q|^2)/2,  less the clearance        force on the sphere  -N(d, d') q

So d is convex and C1 in p, and q is its gradient: the point of the hull nearest to p/w. w is small (``WIDTH``):

| p                                            | q                                       | what bears                        |
|----------------------------------------------|-----------------------------------------|-----------------------------------|
| in the band's latitudes, abs(p) > w          | p/abs(p)                                | a point of the band: ``contacts.pilots`` |
| beyond, further than w cos(lambda) off axis  | the point of the edge nearest to p      | a point of the edge               |
| beyond, nearer to the axis                   | +-sin(lambda) b + (part of p across)/w  | the whole edge, unevenly          |
| nearer than w to the centre                  | p/w                                     | all round, with hardly any force  |

The third row is that of an axial load: N sin(lambda) balances it, twice the load at 30 degrees. A single point of the edge
would push the sphere aside by N cos(lambda), until the opposite point bears too. The points of an edge that bears all
round spread: their second moment is  <e e'> = q q' + k B,  B = I - b b',  k = (1 - |q|^2)/2,  exact for one point and for an
even edge. With the contact's sliding  u(e) = (I - e e') v + l w x e  of twist (v, w) at the lever l, all of them sum to

    u = A v + l w x q    t = l q x v + l^2 A w    A = I - <e e'>    s^2 = u . v + t . w = <|u(e)|^2>

and friction is the force  -D u  with the moment  -D t  about the sphere's centre,  D = N mu(s)/s:  it takes  D s^2.
Friction that lags has a slip speed of late per pilot, which follows s. Bristles are of points: a band has none, and a law
with bristles acts by its steady slip there.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.models.joint import contacts
from bcfj_jax.models.joint.contacts import ContactForce, ContactLaws, Geometry, Tangents, dot, outer
from bcfj_jax.xla.small import skew

# w over the clearance: how far off the axis an edge that bears all round bears on one side alone. Edges are pressed in by a
# tenth of their clearance under load, and bear on one side alone when they have moved by about twice that. No less than LEAST.
WIDTH, LEAST = 0.2, 1e-7  # [-], [m]


class Bands(NamedTuple):
    """Numbers of the pilots' bands in a run, (k,) each but for the latitude."""

    # sine, cosine: of the band's half-width lambda.
    sine: Array
    cosine: Array
    width: Array  # w [m]; clearance [m]
    clearance: Array
    # L [m] from the sphere's centre towards q: minus the radius of a hollow sphere, the radius of an inner one.
    lever: Array

    def some(self, at: slice) -> Bands:
        """Of some pilots."""
        return Bands(self.sine, self.cosine, self.width[at], self.clearance[at], self.lever[at])


class Band(NamedTuple):
    """Where pilots bear, (k, ...); what other geometry has and a band has not is None."""

    penetration: Array  # (k, 1) d [m]
    mean: Array  # (k, 3) q
    spread: Array  # (k,)
    axis: Array  # (3,) of the cage
    lever: Array  # (k,) [m]
    gate: None = None


def band(c: Bands, place: Array, axis: Array) -> Band:
    """Pilots of spheres at ``place`` (k, 3) from the cage's centre, the cage's unit axis (3,)."""
    x = place / c.width[:, None]
    height = x @ axis
    across = x - height[:, None] * axis
    size = jnp.sqrt(jnp.maximum(dot(x, x), 1.0))
    square = dot(across, across)
    whole = square <= c.cosine**2
    reach = jnp.sqrt(jnp.where(whole, 1.0, square))
    within = jnp.abs(height) <= c.sine * size
    # Off the edge: along the axis and across it, the share of x that q has.
    share = jnp.where(whole, 1.0, c.cosine / reach)
    edge = (jnp.sign(height) * c.sine)[:, None] * axis + share[:, None] * across
    mean = jnp.where(within[:, None], x / size[:, None], edge)
    length = dot(mean, mean)
    penetration = dot(place, mean) + 0.5 * c.width * (1.0 - length) - c.clearance
    return Band(penetration[:, None], mean, 0.5 * (1.0 - length), axis, c.lever)


def _sliding(at: Band) -> Array:
    """S (k, 6, 6), symmetric:  (u, t) = S (v, w)  and  s^2 = (v, w) . S (v, w)."""
    lever, beside = at.lever[:, None, None], skew(at.mean)
    across = jnp.eye(3) - outer(at.axis, at.axis)
    still = jnp.eye(3) - outer(at.mean, at.mean) - at.spread[:, None, None] * across
    top, bottom = jnp.concatenate([still, -lever * beside], -1), jnp.concatenate([lever * beside, lever**2 * still], -1)
    return jnp.concatenate([top, bottom], -2)


def act(
    laws: ContactLaws, at: Geometry | Band, velocity: Array, spin: Array | None, bristles: Array | None = None
) -> ContactForce:
    """``contacts.act``, of bands too."""
    if not isinstance(at, Band):
        return contacts.act(laws, at, velocity, spin, bristles)
    assert spin is not None
    twist = jnp.concatenate([velocity, spin], -1)
    slide, rate = dot(_sliding(at), twist[:, None]), dot(at.mean, velocity)[:, None]
    squared = jnp.maximum(dot(slide, twist)[:, None], 0.0)
    normal = laws.normal(at.penetration, rate)
    force = -normal * at.mean
    drag = moment = jnp.zeros_like(force)
    bending = rubbed = None
    if laws.friction is not None:
        mobility, learnt = _mobility(laws, squared, bristles)
        hold, bending = normal * mobility, None if bristles is None else learnt[..., None]
        drag, moment, rubbed = -hold * slide[:, :3], -hold * slide[:, 3:], hold * squared
    seen = normal, at.penetration, rate, jnp.sqrt(squared)
    return ContactForce(force + drag, moment, drag, *seen, bending, rubbed, squared)


def _mobility(laws: ContactLaws, squared: Array, state: Array | None) -> tuple[Array, Array]:
    """Mobility and the rate of a slip speed of late, (k, 1) each; 0 where there is none."""
    if state is None:
        return laws.mobility(squared), jnp.zeros_like(squared)
    learnt, mobility = laws.lag(squared, state[..., 0])
    return mobility, learnt


def tangents(
    laws: ContactLaws,
    geometry: Callable[[Array], Any],
    arm: Array,
    velocity: Array,
    spin: Array | None,
    state: Array | None,
) -> Tangents:
    """``contacts.tangents``, of bands too."""
    at = geometry(arm)
    if not isinstance(at, Band):
        return contacts.tangents(laws, geometry, arm, velocity, spin, state)

    assert spin is not None
    twist = jnp.concatenate([velocity, spin], -1)
    way, sliding = jnp.pad(at.mean, ((0, 0), (0, 3))), _sliding(at)

    def placed(arm: Array) -> tuple[Array, Array, Array]:
        there = geometry(arm)
        return there.penetration, jnp.pad(there.mean, ((0, 0), (0, 3))), dot(_sliding(there), twist[:, None])

    deeper, turned, slid = contacts.by(placed, arm)
    slide, rate = dot(sliding, twist[:, None]), dot(at.mean, velocity)[:, None]
    squared = jnp.maximum(dot(slide, twist)[:, None], 0.0)
    one = jnp.ones_like(rate)
    normal, by_depth = jax.jvp(lambda d: laws.normal(d, rate), (at.penetration,), (one,))
    by_rate = jax.jvp(lambda v: laws.normal(at.penetration, v), (rate,), (one,))[1]
    (mobility, learnt), (slope, learning) = jax.jvp(lambda x: _mobility(laws, x, state), (squared,), (one,))
    # Of s^2 by the place, and by the twist.
    faster, swifter = jnp.sum(twist[..., None] * slid, -2), 2.0 * slide
    push, load = way + mobility * slide, normal[..., None]
    grown = by_depth * deeper[:, 0] + by_rate * jnp.sum(twist[..., None] * turned, -2)
    hold, gain = mobility[..., None], slope * slide
    place = -outer(push, grown) - load * (turned + hold * slid + outer(gain, faster))
    rates = -outer(push, by_rate * way) - load * (hold * sliding + outer(gain, swifter))
    if state is None:
        return Tangents(-normal * push, place, rates)
    forget, learn = jax.jvp(lambda late: _mobility(laws, squared, late), (state,), (jnp.ones_like(state),))[1]
    bending = tuple(x[:, None, None] for x in (learnt[:, 0], learning * faster, learning * swifter))
    return Tangents(-normal * push, place, rates, bending, (-normal * forget * slide)[..., None], -learn)
