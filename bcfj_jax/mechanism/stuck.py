"""Friction that holds in a start at rest (``statics``): every contact is a tangential spring from where it touched.

A contact that has moved by z [m] along itself since it touched bears what its friction law has at the slip s = z/T, with T = 1 us
and with the normal force at rest N:

    f = -N mobility(s . s) s,    |s| up to where the coefficient is greatest: there it slides, and s stays at that.

So a stuck contact gives by T times its creep speed, below 0.1 um, and friction acts up to the law's greatest coefficient. It
is a penalty with an allowable elastic slip, as in finite elements (Wriggers, Computational Contact Mechanics, 2006, 5.2).
Where several contacts could share a load in many ways, this is the one of equal slip.

A law that creeps has these forces at once, and goes on creeping. What such a law would bear while a contact goes deeper, as
across a groove, is gone in well under a millisecond: so z is of the part of a move that leaves depths as they are
(``Ways.level``), and at last one velocity u that does so gives all slips, where depths and u balance every force (``creep``).
Bristles bear the whole z themselves, f = -N sigma_0 z up to break-away, and are at rest; a creep of other friction passes them by
as a roll without slip. Rolling and drilling resistance and friction in joints act in the same way, by the turn.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from bcfj_jax.contact.wrench import couple
from bcfj_jax.core.vectors import Vector, add, dot, scale, spread, subtract
from bcfj_jax.mechanism.alike import apart
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.dynamics import Dynamics, Instant
from bcfj_jax.mechanism.loads import CoordinateLoad
from bcfj_jax.mechanism.sizes import Params

# By contact and face (slip [m/s], turn [rad/s], the slip by which a fall on the face goes along it a speed into it), world; by
# load on a joint the rate of its coordinate.
Slips = dict[str, Any]


class Ways(NamedTuple):
    """What slips of velocities (n,) are at some places."""

    slips: Slips  # with the part along the normal, (..., n) numbers by which to multiply velocities
    faces: dict[str, list[tuple[Vector, Array]]]  # by contact and face its normal, and its normal force [N]
    level: Array  # (n, n), of a move the part by which nothing that touches goes deeper or apart

    def along(self, v: Array) -> Slips:
        """Slips of velocities."""
        return jax.tree.map(lambda x: x @ v, self.slips)


# T [s]; of friction without a limit the mobility [s/m].
TIME, _WITHOUT = 1e-6, 1e3
# A slip [m/s] beyond every limit.
_FAR = 1e6
# A contact keeps its depth from this share of the greatest normal force on. Of a move along a normal ``level`` leaves _LEFT^4. A
# mass counts as this share of the greatest at least.
_BEARS, _LEFT, _LEAST = 1e-9, 1e-6, 1e-12
# Steps to the velocities of creep.
_CREEPS = 16


def _dry(m: Dynamics) -> list[CoordinateLoad]:
    return [load for load in m.loads if isinstance(load, CoordinateLoad) and load.dry]


def _contacts(m: Dynamics, bound: bool) -> tuple[Contact, ...]:
    """All where anything rubs, since those without friction keep their depths; none where nothing does."""
    rubs = not bound or _dry(m) or any(c.friction is not None or c.rolling for c in m.bundles)
    return m.bundles if rubs else ()


def ways(m: Dynamics, now: Instant, places: Array, mass: Array, p: Params, bound: bool) -> Ways:
    """Of an instant at rest and its places; ``level`` is nearest by ``mass`` (n,), the mass matrix' diagonal."""
    if not _contacts(m, bound) and not _dry(m):
        return Ways({}, {}, jnp.eye(mass.size))

    def seen(v: Array) -> Slips:
        t = jnp.zeros(())
        state = jnp.concatenate([places, v, jnp.zeros(sum(k or 1 for _, k in m._memory))])
        now, found = m.instant(t, state, p, laws=False), {}
        for c in _contacts(m, bound):
            first, second = c.parts(now.bodies.parts)
            turn, k = subtract(second.spin, first.spin), m.side_by_side(c)
            found[c.name] = [
                tuple(tuple(spread(x, k) for x in vector) for vector in (slip, turn, slip))
                for face, touch in now.faces[c.name]
                for slip in (add(touch.slide, scale(touch.rate, face.normal)),)
            ]
        return found | {load.name: jnp.asarray(m._coordinate(load.body, t, now, p)[2]) for load in _dry(m)}

    slips, faces, closing = jax.jacfwd(seen)(jnp.zeros_like(mass)), {}, []
    for c in _contacts(m, bound):
        faces[c.name] = [(face.normal, jnp.asarray(touch.normal)) for face, touch in now.faces[c.name]]
        for (normal, force), (slip, *_) in zip(faces[c.name], slips[c.name], strict=True):
            rate = sum((jnp.asarray(x)[..., None] * way for x, way in zip(normal, slip, strict=True)), jnp.zeros(()))
            closing.append((jnp.broadcast_to(force, jnp.shape(rate)[:-1]), rate))
    return Ways(slips, faces, _level(closing, mass))


def _level(closing: list[tuple[Array, Array]], mass: Array) -> Array:
    """``Ways.level`` of normal forces (...,) and how velocities close them (..., n)."""
    if not closing:
        return jnp.eye(mass.size)
    root = jnp.sqrt(jnp.maximum(mass, _LEAST * jnp.max(mass)))
    rows = jnp.concatenate([jnp.reshape(rate, (-1, mass.size)) for _, rate in closing]) / root
    normal = jnp.concatenate([jnp.ravel(force) for force, _ in closing])
    sizes = jnp.sum(rows * rows, 1) * (1.0 + _BEARS * jnp.max(normal) / jnp.where(normal > 0.0, normal, 1.0))
    keeps = (normal > 0.0) & (sizes > 0.0)
    across = rows.T @ (jnp.where(keeps, 1.0 / jnp.where(keeps, sizes, 1.0), 0.0)[:, None] * rows)
    stays = jnp.linalg.inv(jnp.eye(mass.size) + across / _LEFT)
    return jnp.linalg.matrix_power(stays, 4) * root / root[:, None]


def _mobility(c: Contact, slip: Vector, read: Params, bound: bool) -> tuple[Array, Array]:
    """Mobility of a face, and the share of its slip that stays; not ``bound``, friction has no limits, everywhere."""
    squared = jnp.asarray(dot(slip, slip))
    if not bound:
        return jnp.full_like(squared, _WITHOUT), jnp.ones_like(squared)
    if c.friction is None:
        return jnp.zeros_like(squared), jnp.ones_like(squared)
    return c.friction.holding(squared, read, TIME)


def fallen(here: Ways, held: Slips, move: Array) -> Slips:
    """Slips of a start that is moved (n,): what fell on a face from there comes down elsewhere along it."""
    found, ways = dict(held), here.along(move / TIME)
    for name, faces in here.faces.items():
        rows = zip(faces, held[name], ways[name], strict=True)
        found[name] = [
            (subtract(slip, scale(dot(normal, way), fall)), turn, fall)
            for (normal, _), (slip, turn, fall), (*_, way) in rows
        ]
    return found


def added(m: Dynamics, here: Ways, held: Slips, move: Array, p: Params, bound: bool) -> Slips:
    """Slips after a move (n,): none where nothing touches, and no more than friction holds."""
    if not held:
        return held
    found: Slips = {}
    new, creeping = (here.along(v / TIME) for v in (move, here.level @ move))
    for c in _contacts(m, bound):
        read, found[c.name], moved = c.coefficients(p), [], new if c.bristles else creeping
        ways = (way for *_, way in new[c.name])
        for (normal, force), one, more, way in zip(here.faces[c.name], held[c.name], moved[c.name], ways, strict=True):
            slip, turn = (add(x, y) for x, y in zip(one[:2], more[:2], strict=True))
            slip = subtract(slip, scale(dot(normal, slip), normal))
            share = _mobility(c, slip, read, bound)[1]
            kept = [[jnp.where(force > 0.0, x, 0.0) for x in vector] for vector in (scale(share, slip), turn)]
            closing = jnp.asarray(dot(normal, way))
            fall = scale(jnp.where(closing > 0.0, 1.0 / jnp.where(closing > 0.0, closing, 1.0), 0.0), way)
            fall = subtract(fall, scale(dot(normal, fall), normal))
            fall = [jnp.where(force > 0.0, x, y) for x, y in zip(one[2], fall, strict=True)]
            found[c.name].append((*map(tuple, kept), tuple(fall)))
    for load in _dry(m):
        slip = held[load.name] + (new if load.bristles else creeping)[load.name]
        found[load.name] = slip * (load.holding(slip, p, TIME)[1] if bound else 1.0)
    return found


def rubbed(m: Dynamics, now: Instant, held: Slips, p: Params, bound: bool) -> tuple[Instant, dict[str, Array]]:
    """An instant at rest with the friction of slips; and by load on a joint its force."""
    faces = dict(now.faces)
    for c in _contacts(m, bound):
        read, faces[c.name] = c.coefficients(p), []
        for (face, touch), (slip, turn, _) in zip(now.faces[c.name], held[c.name], strict=True):
            mobility, _ = _mobility(c, slip, read, bound)
            drag = scale(-touch.normal * mobility, slip)
            bears = touch._replace(force=add(touch.force, drag), drag=drag)
            if c.rolling:
                bears = bears._replace(couple=couple(touch, face.normal, turn, read))
            faces[c.name].append((face, bears))
    forces = {}
    for load in _dry(m):
        slip = held[load.name]
        mobility = load.holding(slip if bound else 0.0 * slip, p, TIME)[0]
        forces[load.name] = -mobility * slip
    return now._replace(faces=faces), forces


def creep(forces: Callable[[Array], Array], mass: Array) -> tuple[Array, Array]:
    """Where ``forces`` (n,) of velocities (n,) are 0, and what is left of them [N, N m]; mass (n,)."""

    def step(v: Array, _: None) -> tuple[Array, Array]:
        left, slope = forces(v), jax.jacfwd(forces)(v)
        # Without friction along it a velocity is 0; what friction damps is known to this share of a millisecond's.
        return v + jnp.linalg.solve(jnp.diag(1e-6 * mass) - slope, left - 1e-6 * mass * v), left

    # From rest Newton's method does not go beyond the crest, and gains a half a step where friction is nearly used up.
    speeds, left = lax.scan(step, jnp.zeros_like(mass), length=_CREEPS)
    return speeds, left[-1]


def given(m: Dynamics, held: Slips, creeping: Slips) -> Slips:
    """Slips as they creep; bristles give by the creep from where they are held, and turns alone creep where they are."""
    found = dict(creeping)
    for c in _contacts(m, True):
        if c.bristles:
            pairs = zip(held[c.name], creeping[c.name], strict=True)
            found[c.name] = [(add(slip, more), *rest) for (slip, *_), (more, *rest) in pairs]
    return found | {load.name: held[load.name] + creeping[load.name] for load in _dry(m) if load.bristles}


def bent(m: Dynamics, held: Slips) -> dict[str, Any]:
    """Bristles [m, rad] of slips by contact and face, and by load."""
    found: dict[str, Any] = {}
    for c in m.bundles:
        if c.bristles:
            found |= apart(c, [scale(TIME, slip) for slip, *_ in held[c.name]])
    return found | {load.name: TIME * held[load.name] for load in _dry(m) if load.bristles}


def needed(m: Dynamics, now: Instant, held: Slips, p: Params) -> dict[str, tuple[Array, Array]]:
    """Of slips without limits by contact the friction coefficient, by load its force: what they need and what there is."""
    found: dict[str, list[tuple[Array, Array]]] = {}
    for c in m.bundles:
        read = c.coefficients(p)
        for (_, touch), (slip, *_) in zip(now.faces[c.name], held[c.name], strict=True):
            size = jnp.where(jnp.asarray(touch.normal) > 0.0, _WITHOUT * jnp.sqrt(jnp.asarray(dot(slip, slip))), 0.0)
            mobility, share = _mobility(c, (_FAR, 0.0, 0.0), read, True)
            for name, pair in apart(c, (size, jnp.broadcast_to(mobility * share * _FAR, size.shape))).items():
                found.setdefault(name, []).append(pair)
    for load in _dry(m):
        slip = jnp.abs(held[load.name])
        mobility, share = load.holding(jnp.full_like(slip, _FAR), p, TIME)
        found[load.name] = [(load.holding(jnp.zeros_like(slip), p, TIME)[0] * slip, mobility * share * _FAR)]

    def greatest(pairs: list[tuple[Array, Array]]) -> tuple[Array, Array]:
        need, has = (jnp.max(jnp.stack(x)) for x in zip(*pairs, strict=True))
        return need, has

    return {name: greatest(pairs) for name, pairs in found.items()}
