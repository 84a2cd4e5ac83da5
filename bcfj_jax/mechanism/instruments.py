"""What instruments read of a mechanism in one state: forces of contacts, motions of bodies, the energy balance."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import Face
from bcfj_jax.contact.normal import regularised_energy, regularised_force
from bcfj_jax.contact.wrench import ContactForce
from bcfj_jax.core.vectors import (
    ZERO,
    Number,
    Vector,
    add,
    cross,
    dot,
    length,
    minus,
    plus,
    scale,
    spread,
    stacked,
    subtract,
    times,
    turned,
    unit,
)  # fmt: skip
from bcfj_jax.mechanism import equations
from bcfj_jax.mechanism.bodies import JOINTS, RATES, Part, unit_of
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.dynamics import Dynamics, Instant
from bcfj_jax.mechanism.loads import AbstractLoad, CoordinateLoad
from bcfj_jax.mechanism.model import Account, BodyMotion, Flows, Params, Reading


def read(m: Dynamics, t: Array, y: Array, p: Params) -> list[Reading]:
    """``AbstractModel.read``: the force on each contact's second body, from the law, never from interpolation."""
    now = m.instant(t, y, p)
    return [_reading(m, c, now, p) for c in m.bundles]


def observe(m: Dynamics, t: Array, y: Array, p: Params) -> dict[str, Reading]:
    """``AbstractModel.observe``."""
    return m.by_contact(read(m, t, y, p))


def _reading(m: Dynamics, c: Contact, now: Instant, p: Params) -> Reading:
    first, second = c.frames(now.bodies.parts, p)
    touching = now.faces[c.name]
    normals = [touch.normal for _, touch in touching]
    force = add(*(touch.force for _, touch in touching))
    drag = add(*(touch.drag for _, touch in touching))
    normal = minus(*normals) if c.gap.signed else reduce(plus, normals)
    way = touching[0][0].normal if len(touching) == 1 else unit(subtract(drag, force))
    axial = c.gap.axial_by(first, second, c.coefficients(p), way)
    along = unit(subtract(axial, scale(dot(axial, way), way)))
    across = cross(way, along)
    members = m.side_by_side(c)
    depth, rate, slip = (spread(x, members) for x in _deepest(touching))
    whole, own = (stacked(v, members) for v in (force, (normal, dot(drag, along), dot(drag, across))))
    # A law clips NaN to no force; a state that failed must not read as one that is merely apart.
    lost = jnp.isnan(depth + rate)[..., None]
    slides = slip if c.friction is not None else None
    return Reading(jnp.where(lost, jnp.nan, own), depth, rate, slides, jnp.where(lost, jnp.nan, whole))


def _deepest(touching: list[tuple[Face, ContactForce]]) -> tuple[Number, Number, Number]:
    """Penetration, rate and sliding speed of the deepest face."""
    rows = [(face.depth, touch.rate, length(touch.slide)) for face, touch in touching]
    if len(rows) == 1:
        return rows[0]
    depths, rates, slips = (
        jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, column))) for column in zip(*rows, strict=True)
    )
    best = jnp.argmax(depths, axis=0, keepdims=True)
    depth, rate, slip = (jnp.take_along_axis(x, best, 0)[0] for x in (depths, rates, slips))
    return depth, rate, slip


def motions(m: Dynamics, t: Array, y: Array, p: Params) -> dict[str, BodyMotion]:
    """``AbstractModel.motions``: centres of mass, axes, accelerations and the drives' forces."""
    now = m.instant(t, y, p)
    gathered = m.assembled(t, now, p)
    count = len(m._velocities)
    rates = gathered.accelerations(count)
    found, driven = {}, count
    for row in m.rows:
        b, part, arm, k = row.body, now.bodies.parts[row.name], now.bodies.center[row.name], row.members
        at, turns = part.shifted(arm), m.turning(b.name)
        gain, swirl = at.gained(rates)
        drive, joint = None, {key: now.q[i] for i, (name, key, _) in enumerate(m._coordinates) if name == row.name}
        joint |= {key: now.v[j] for j, (name, key, _) in enumerate(m._velocities) if name == row.name}
        if b.drive is not None:
            key = JOINTS[b.joint][0][0]
            joint = dict(zip((key, RATES[key]), b.drive.motion(t, b.name, p), strict=False))
            drive, driven = jnp.asarray(gathered.reaction(driven, rates)), driven + 1
        found |= row.apart(BodyMotion(
            place=stacked(at.place, k), velocity=stacked(at.velocity, k), acceleration=stacked(gain, k),
            axes=jnp.stack([stacked(x, k) for x in part.axes], -1) if turns else None,
            spin=stacked(at.spin, k) if turns else None, spin_rate=stacked(swirl, k) if turns else None,
            angle=None if joint.get("angle") is None else spread(joint["angle"], k), drive=drive,
            joint={key: spread(jnp.asarray(x), k) for key, x in joint.items()},
        ))  # fmt: skip
    return {b.name: found[b.name] for b in m.ordered}


def flows(m: Dynamics, t: Array, y: Array, p: Params) -> Flows:
    """``AbstractModel.flows``: power of drives and loads, what friction and damping take, kinetic and elastic energy.

    What a law's states lose, by relaxation or plastic deformation, is damping, too.
    """
    now = m.instant(t, y, p)
    gathered = m.assembled(t, now, p)
    rates = gathered.accelerations(len(m._velocities))
    given: dict[str, Array] = {}
    for k, b in enumerate(m._driven):
        assert b.drive is not None
        speed = b.drive.motion(t, b.name, p)[1]
        given[f"{b.name} drive"] = jnp.asarray(gathered.reaction(len(m._velocities) + k, rates) * speed)
    friction: Number = jnp.zeros(())
    for load in m.loads:
        brought = jnp.asarray(power(m, load, t, now, p))
        if isinstance(load, CoordinateLoad) and load.dry:
            friction = friction - brought
        else:
            given[load.name] = brought
    kinetic: Number = 0.0
    for row in m.rows:
        part, arm = now.bodies.parts[row.name], now.bodies.center[row.name]
        v = part.velocity_at(arm)
        kinetic = plus(kinetic, jnp.sum(0.5 * now.bodies.mass[row.name] * dot(v, v)))
        inertia = m.inertias(row, p)
        if inertia is not None:
            turning = dot(part.spin, equations.inertial(inertia, part.axes, part.spin))
            kinetic = plus(kinetic, jnp.sum(0.5 * jnp.asarray(turning)))
    damping: Number = jnp.zeros(())
    elastic: Number = jnp.zeros(())
    for c in m.bundles:
        for (face, touch), own in zip(now.faces[c.name], now.memory[c.name], strict=True):
            values = c.recalled(own, p)
            width = values.get("smoothing")
            changes = dict(zip(c.memory, c.learning(face, touch, own, p), strict=True))
            friction = friction - jnp.sum(jnp.asarray(dot(touch.drag, touch.slide)))
            if touch.couple is not None:
                spin = subtract(*(body.spin for body in c.parts(now.bodies.parts)[::-1]))
                friction = friction - jnp.sum(jnp.asarray(dot(touch.couple, spin)))
            depth, rate = jnp.broadcast_arrays(jnp.asarray(face.depth), jnp.asarray(touch.rate))
            still = regularised_force(c.law, depth, jnp.zeros_like(depth), values, width)
            stored, lost = regularised_energy(c.law, depth, rate, values, changes, width)
            damping = damping + jnp.sum((touch.normal - face.gate * still) * touch.rate + face.gate * lost)
            elastic = elastic + jnp.sum(face.gate * stored)
    return Flows(
        given, {"friction": friction, "damping": damping}, {"kinetic": jnp.asarray(kinetic), "elastic": elastic}
    )


def power(m: Dynamics, load: AbstractLoad, t: Array, now: Instant, p: Params) -> Number:
    """Power of a load [W]: what it gives to the bodies."""
    if isinstance(load, CoordinateLoad):
        return reduce(plus, (jnp.sum(jnp.asarray(times(force, v))) for _, force, v in m.sprung(load, t, now, p)))
    found: Number = 0.0
    for action in load.actions(t, now.bodies, p):
        part = now.bodies.parts[action.body]
        each = plus(dot(action.force, part.velocity_at(turned(part.axes, action.at))), dot(action.torque, part.spin))
        found = plus(found, jnp.sum(jnp.asarray(each)))
    return found


# Rounding of a force's share in a momentum's rate, of the force times its arm: a moment of exactly 0 is computed as so much.
_ROUNDING = 1e-12


class Forces(equations.Equations):
    """Forces alone, and the sums of their sizes, at least of their rounding: those of a body in balance cancel each other.

    ``rounding``: the share of a force, times its arm, that counts where it has none along a velocity.
    """

    def __init__(self, members: Sequence[int], rounding: float = _ROUNDING) -> None:
        super().__init__(members)
        self.rounding = rounding
        self.sizes: list[Number] = [0.0 for _ in members]

    def push(self, j: int, force: Number, of: tuple[int, int] | None = None) -> None:
        super().push(j, force, of)
        self._add(j, jnp.abs(jnp.asarray(force)), of)

    def act(self, part: Part, arm: Vector, force: Vector, torque: Vector = ZERO) -> None:
        super().act(part, arm, force, torque)
        self._rounded(part, arm, force)

    def wrench(self, part: Part, force: Vector, moment: Vector, arm: Vector) -> None:
        super().wrench(part, force, moment, arm)
        self._rounded(part, arm, force)

    def _rounded(self, part: Part, arm: Vector, force: Vector) -> None:
        """What rounding may leave of a force whose moment is 0."""
        for j, (w, v) in part.partials.items():
            self._add(j, self.rounding * (_extent(v) + _extent(w) * _extent(arm)) * _extent(force), part.of)

    def _add(self, j: int, size: Number, of: tuple[int, int] | None) -> None:
        self.sizes[j] = plus(self.sizes[j], equations.onto(size, self.members[j], of))


def _extent(x: Vector) -> Number:
    """Sum of the sizes of its components."""
    return reduce(plus, map(abs, x))


def momenta(m: Dynamics, t: Array, y: Array, p: Params) -> dict[str, Account]:
    """Generalised momentum of every free velocity u_j, and what changes it, from forces alone.

    With Kane's partial velocities v_j (of the centres of mass) and w_j (``equations``), summed over the bodies,

        p_j = sum m v_j . v + w_j . H,   dp_j/dt = Q_j + sum m dv_j/dt . v + dw_j/dt . H,   H = I w,

    Q_j the contacts and loads. Of a slide p_j is the momentum [N s] along it of its body and all that hangs on it, of a
    hinge their angular momentum about its axis [N m s], of a free body both, angular momentum about its own origin along
    its own axes. Reactions of joints are in none. Neither the mass matrix nor accelerations are used.
    """
    now, count = m.instant(t, y, p), len(m._velocities)
    found = Forces(m._members)
    m._pressed(found, now, p)
    for load in m.loads:
        m._loaded(found, load, t, now, p)
    moved: dict[str, tuple] = {}
    for row in m.rows:
        part, inertia = now.bodies.parts[row.name], m.inertias(row, p)
        spun = ZERO if inertia is None else equations.inertial(inertia, part.axes, part.spin)
        velocity = part.velocity_at(now.bodies.center[row.name])
        moved[row.name] = (scale(now.bodies.mass[row.name], velocity), spun)

    def momenta(t: Array, q: list[Array]) -> list[Array]:
        """The momenta of other places and the same velocities."""
        bodies, along = m.moving(t, list(q), list(now.v), p), [jnp.zeros(k or ()) for *_, k in m._velocities]
        for name, (push, spun) in moved.items():
            for j, (w, v) in bodies.parts[name].shifted(bodies.center[name]).partials.items():
                if j < count:
                    share = equations.total(plus(dot(v, push), dot(w, spun)), m._members[j])
                    along[j] = along[j] + share
        return along

    ways = [jnp.broadcast_to(jnp.asarray(x, float), jnp.shape(q)) for x, q in zip(m._rates(now), now.q, strict=True)]
    values, leaned = jax.jvp(momenta, (jnp.asarray(t, float), now.q), (jnp.ones(()), ways))
    accounts, each = {}, {row.name: row for row in m.rows}
    for j, (name, rate, _) in enumerate(m._velocities):
        shape = values[j].shape
        force, size = (jnp.broadcast_to(jnp.asarray(x, float), shape) for x in (found.forces[j], found.sizes[j]))
        what = "angular_momentum" if unit_of(rate) == "rad/s" else "momentum"
        account = Account(values[j], force + leaned[j], size + jnp.abs(leaned[j]))
        accounts |= {f"{body} {what} {rate}": one for body, one in each[name].apart(account).items()}
    return accounts
