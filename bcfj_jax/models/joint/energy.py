"""Where the joint's energy comes from, where it is and where it goes, in one state; what it transmits; Newton's test.

Along every solution, term by term, exactly:

    drive + hold = load + axial + friction + damping + edge + d(kinetic + elastic + spring)/dt

``analysis.energy_balance`` integrates it. A contact of penetration d, smoothed to r(d), with normal force N(d, d') at a flank's
gate g (1 but at a flank's edge) holds  g E(d),  E = integral of N(x, 0) dx = integral of law(x, 0) dx from 0 to r(d),
and takes in  g N d' = d(g E)/dt + damping + edge.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.errors import InputError
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.bands import Band, act
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.contacts import ContactForce, Geometry
from bcfj_jax.models.joint.scene import Joint


class Power(NamedTuple):
    """Power [W] in one state; in: drive and hold, out: load and axial, lost: friction, damping and edge."""

    # Torque that holds the seat's speed, times it; of a flexible drive its torque times the prescribed speed.
    drive: Array
    hold: Array  # torque that turns a fixed cage at the drive's speed, times it; 0 for a free cage
    load: Array  # load torque times the head's speed
    axial: Array  # axial load times the head's velocity along its axis
    # Sum over all faces of  N mu(|u|) |u|  >= 0, u the sliding velocity; of bristles  N traction . u, of either sign,
    # as it holds what they store, N sigma0 z.z/2, and give back.
    friction: Array
    # Sum of  (N(d, d') - N(d, 0)) d',  and  c (speed lag)^2  of a flexible drive; >= 0 for every law but a Kelvin-Voigt
    # one with tension (where damping pulls harder than the spring pushes, N is 0 and the spring's energy counts as
    # lost).
    damping: Array
    edge: Array  # -E dg/dt of flanks whose gate g is neither 0 nor 1, of either sign; 0 in service

    @property
    def lost(self) -> Array:
        """Friction, damping and edge [W]."""
        return self.friction + self.damping + self.edge

    @property
    def net(self) -> Array:
        """What goes into the store: d(stored)/dt [W]."""
        return self.drive + self.hold - self.load - self.axial - self.lost


class Stored(NamedTuple):
    """Energy [J] in one state."""

    kinetic: Array  # of balls with their spin, cage, head, and the seat where its drive is flexible
    elastic: Array  # of all contacts
    spring: Array  # of a flexible drive,  k (lag)^2 / 2

    @property
    def total(self) -> Array:
        """All of it [J]."""
        return self.kinetic + self.elastic + self.spring


class _Acting(NamedTuple):
    """Contacts that are evaluated together in one state, where they are, what they do, and gates (1 without edges)."""

    part: system.Part
    at: Geometry | Band
    touch: ContactForce
    gate: Array


def _acting(scene: Joint, c: Constants, state: system.State) -> list[_Acting]:
    found = []
    for part in [*system.relative_motions(scene, c, state).parts, *system.piloted(scene, c, state)]:
        at = part.geometry(part.motion.arm)
        touch = act(part.laws, at, part.motion.velocity, part.motion.spin, part.bristles)
        found.append(_Acting(part, at, touch, jnp.ones(()) if at.gate is None else at.gate))
    return found


def _friction(one: _Acting) -> Array:
    """Power [W] that friction takes at each face:  N mu(|u|) |u|,  of bristles what their actual force takes."""
    return jnp.zeros_like(one.touch.normal) if one.touch.rubbed is None else one.touch.rubbed


def rubbed(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Power [W] that friction takes by contact, all members', in one flat state; their sum is ``Power.friction``."""
    found: dict[str, Array] = {}
    for one in _acting(scene, c, system.view(scene, c, y)):
        faces = jnp.sum(_friction(one), -1)
        # Of pilots each is one; of balls all are.
        found |= dict(zip(one.part.names, jnp.sum(faces, 0) if faces.ndim == 2 else faces, strict=True))
    return {contact.name: found[contact.name] for contact in scene.contacts}


def _damping(one: _Acting) -> Array:
    """Sum of  (N(d, d') - N(d, 0)) d'  [W] over all faces."""
    still = one.part.laws.normal(one.at.penetration, jnp.zeros_like(one.touch.rate))
    return jnp.sum((one.touch.normal - still * one.gate) * one.touch.rate)


def _edge(one: _Acting) -> Array:
    """Sum of  -E dg/dt  [W] over all faces."""
    if one.at.gate is None:
        return jnp.zeros(())
    rate = jax.jvp(lambda arm: one.part.geometry(arm).gate, (one.part.motion.arm,), (one.part.motion.velocity,))[1]
    return -jnp.sum(one.part.laws.energy(one.at.penetration) * rate)


def power(scene: Joint, c: Constants, t: Array, y: Array) -> Power:
    """Every flow of energy in one flat state y at time t [s]."""
    state = system.view(scene, c, y)
    found, none = _acting(scene, c, state), jnp.zeros(())
    prescribed = system.drive_motion(scene, c, t)[1]
    torque, axial = system.loads(scene, c, t, state)
    # A fixed cage is turned against its contacts.
    on_cage = system.on_parts(scene, c, state)["cage"].values() if scene.cage == "fixed" else ()
    speed = prescribed if scene.drive == "flexible" else state.seat_spin
    return Power(
        drive=system.drive_torque(scene, c, t, state) * speed,
        hold=sum((-loads.moment @ state.cage_spin for loads in on_cage), none),
        load=torque * state.head_spin,
        axial=axial * (state.head_velocity @ c.axes[1]),
        friction=sum((jnp.sum(_friction(one)) for one in found), none),
        damping=sum(map(_damping, found), c.drive_damping * (prescribed - state.seat_spin) ** 2),
        edge=sum(map(_edge, found), none),
    )


def stored(scene: Joint, c: Constants, t: Array, y: Array) -> Stored:
    """Every store of energy in one flat state y at time t [s]."""
    state, parts = system.view(scene, c, y), scene.parted(y)
    # A prescribed seat has no inverse_mass, and no energy of its own.
    moved = c.coupling_inverse_mass > 0
    coupling = jnp.where(moved, parts.rate**2 / jnp.where(moved, c.coupling_inverse_mass, 1.0), 0.0)
    elastic = [jnp.sum(x.part.laws.energy(x.at.penetration) * x.gate) for x in _acting(scene, c, state)]
    lag = system.drive_motion(scene, c, t)[0] - state.seat_turn
    return Stored(
        kinetic=0.5 * (jnp.sum(parts.twist**2 / c.ball_inverse_mass) + jnp.sum(coupling)),
        elastic=sum(elastic, jnp.zeros(())),
        spring=0.5 * c.drive_stiffness * lag**2,
    )


def cage_forces(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Resultants on the cage of each kind of contact it has, (3,) [N] in world axes, by the contacts' names."""
    return {name: loads.force for name, loads in system.on_parts(scene, c, system.view(scene, c, y))["cage"].items()}


def cage_equilibrium(scene: Joint, c: Constants, y: Array, t: Array) -> Array:
    """Newton's law of the cage,  F(1) + F(2) + F(3) - m a,  (3,) [N], of seat, head and balls; 0 but for rounding.

    The paper's test (its Table 3). The forces are those of the contacts; a is the field's acceleration. InputError for a
    cage that is fixed.
    """
    piece = scene.slices["cage"]
    if piece is None:
        raise InputError("cage_equilibrium", "a fixed cage", "take a scene with cage = 'free'")
    acceleration = scene.parted(system.field(t, y, (scene, c))).rate[piece]
    return sum(cage_forces(scene, c, y).values(), jnp.zeros(3)) - acceleration / c.coupling_inverse_mass[piece]
