"""Where the joint's energy comes from, where it is and where it goes, in one state; what it transmits; Newton's test.

Along every solution, term by term, exactly:

    drive + hold = load + axial + friction + damping + edge + d(kinetic + elastic + spring)/dt

``analysis.energy_balance`` integrates it. A contact of penetration d, smoothed to r(d), with normal force N(d, d') at a flank's
gate g (1 but at a flank's edge) holds  g E(d),  E = integral of N(x, 0) dx = integral of law(x, 0) dx from 0 to r(d),
and takes in  g N d' = d(g E)/dt + damping + edge.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.errors import InputError
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.bands import Band, act
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.contacts import ContactForce, Geometry
from bcfj_jax.models.joint.law_pair import ContactLaws, LawPair
from bcfj_jax.models.joint.scene import Joint


class Power(NamedTuple):
    """Power [W] in one state; in: drive and hold, out: load and axial, lost: friction, damping and edge.

    Attributes:
        drive: torque that holds the seat's speed, times it; of a flexible drive its torque times the prescribed speed.
        hold: torque that turns a fixed cage at the drive's speed, times it; 0 for a free cage.
        load: load torque times the head's speed.
        axial: axial load times the head's velocity along its axis.
        friction: sum over all faces of  N mu(|u|) |u|  >= 0, u the sliding velocity; of bristles  N traction . u,
            of either sign, as it holds what they store, N sigma0 z.z/2, and give back.
        damping: sum of  (N(d, d') - N(d, 0)) d',  and  c (speed lag)^2  of a flexible drive; >= 0 for every law but a
            Kelvin-Voigt one with tension (where damping pulls harder than the spring pushes, N is 0 and the spring's
            energy counts as lost).
        edge: -E dg/dt of flanks whose gate g is neither 0 nor 1, of either sign; 0 in service.
    """

    drive: Array
    hold: Array
    load: Array
    axial: Array
    friction: Array
    damping: Array
    edge: Array

    @property
    def lost(self) -> Array:
        """Friction, damping and edge [W]."""
        return self.friction + self.damping + self.edge

    @property
    def net(self) -> Array:
        """What goes into the store: d(stored)/dt [W]."""
        return self.drive + self.hold - self.load - self.axial - self.lost


class Stored(NamedTuple):
    """Energy [J] in one state.

    Attributes:
        kinetic: of balls with their spin, cage, head, and the seat where its drive is flexible.
        elastic: of all contacts.
        spring: of a flexible drive,  k (lag)^2 / 2.
    """

    kinetic: Array
    elastic: Array
    spring: Array

    @property
    def total(self) -> Array:
        """All of it [J]."""
        return self.kinetic + self.elastic + self.spring


class _Acting(NamedTuple):
    """One group of contacts in one state: its names, its laws, where it is, the relative motion, what it does."""

    names: tuple[str, ...]
    laws: ContactLaws | LawPair
    geometry: Callable[[Array], Geometry | Band]
    at: Geometry | Band
    motion: system.Motion
    touch: ContactForce


def _acting(scene: Joint, c: Constants, state: system.State) -> list[_Acting]:
    """Every group of contacts that is evaluated together, along the last axis but one."""
    parts = system.relative_motions(scene, c, state).parts()
    parts += [system.piloted(scene, c, state)] if c.pilot_laws is not None else []
    found = []
    for names, laws, geometry, motion, bent in parts:
        at = geometry(motion.arm)
        found.append(_Acting(names, laws, geometry, at, motion, act(laws, at, motion.velocity, motion.spin, bent)))
    return found


def _friction(part: _Acting) -> Array:
    """Power [W] that friction takes at each face:  N mu(|u|) |u|,  of bristles what their actual force takes."""
    if part.touch.rubbed is not None:
        return part.touch.rubbed
    if part.laws.friction is None:
        return jnp.zeros_like(part.touch.normal)
    squared = part.touch.slip**2
    return part.touch.normal * part.laws.mobility(squared) * squared


def rubbed(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Power [W] that friction takes by contact, all members', in one flat state; their sum is ``Power.friction``."""
    found: dict[str, Array] = {}
    for part in _acting(scene, c, system.view(scene, c, y)):
        faces = jnp.sum(_friction(part), -1)
        # Of pilots each is one; of balls all are.
        found |= dict(zip(part.names, jnp.sum(faces, 0) if faces.ndim == 2 else faces, strict=True))
    return {contact.name: found[contact.name] for contact in scene.contacts}


def _damping(part: _Acting) -> Array:
    """Sum of  (N(d, d') - N(d, 0)) d'  [W] over all faces."""
    still = part.laws.normal(part.at.penetration, jnp.zeros_like(part.touch.rate))
    gated = still if part.at.gate is None else still * part.at.gate
    return jnp.sum((part.touch.normal - gated) * part.touch.rate)


def _edge(part: _Acting) -> Array:
    """Sum of  -E dg/dt  [W] over all faces."""
    if part.at.gate is None:
        return jnp.zeros(())
    rate = jax.jvp(lambda arm: part.geometry(arm).gate, (part.motion.arm,), (part.motion.velocity,))[1]
    return -jnp.sum(part.laws.energy(part.at.penetration) * rate)


def power(scene: Joint, c: Constants, t: Array, y: Array) -> Power:
    """Every flow of energy in one flat state y at time t [s]."""
    state = system.view(scene, c, y)
    found, on = _acting(scene, c, state), system.on_parts(scene, c, state)
    prescribed = system.drive_motion(scene, c, t)[1]
    speed, driving = state.seat_spin, system.drive_torque(scene, c, t, state)
    if scene.drive == "flexible":
        speed = prescribed
    torque, axial = system.loads(scene, c, t, state)
    # A fixed cage is turned against its contacts.
    held = [-loads.moment @ state.cage_spin for loads in on["cage"].values()] if scene.cage == "fixed" else []
    return Power(
        drive=driving * speed,
        hold=sum(held, jnp.zeros(())),
        load=torque * state.head_spin,
        axial=axial * (state.head_velocity @ c.axes[1]),
        friction=sum((jnp.sum(_friction(part)) for part in found), jnp.zeros(())),
        damping=sum((_damping(part) for part in found), c.drive_damping * (prescribed - state.seat_spin) ** 2),
        edge=sum((_edge(part) for part in found), jnp.zeros(())),
    )


def stored(scene: Joint, c: Constants, t: Array, y: Array) -> Stored:
    """Every store of energy in one flat state y at time t [s]."""
    state = system.view(scene, c, y)
    twists = y[3 * scene.balls + scene.coupling :][: scene.twist * scene.balls].reshape(scene.balls, scene.twist)
    rates = y[(3 + scene.twist) * scene.balls + scene.coupling : scene.moving]
    # A prescribed seat has no inverse_mass, and no energy of its own.
    moved = c.coupling_inverse_mass > 0
    coupling = jnp.where(moved, rates**2 / jnp.where(moved, c.coupling_inverse_mass, 1.0), 0.0)
    elastic = jnp.zeros(())
    for part in _acting(scene, c, state):
        energy = part.laws.energy(part.at.penetration)
        elastic = elastic + jnp.sum(energy if part.at.gate is None else energy * part.at.gate)
    lag = system.drive_motion(scene, c, t)[0] - state.seat_turn
    return Stored(
        kinetic=0.5 * (jnp.sum(twists**2 / c.ball_inverse_mass) + jnp.sum(coupling)),
        elastic=elastic,
        spring=0.5 * c.drive_stiffness * lag**2,
    )


def cage_forces(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Resultants on the cage of each kind of contact it has, (3,) [N] in world axes, by the contacts' names."""
    return {name: loads.force for name, loads in system.on_parts(scene, c, system.view(scene, c, y))["cage"].items()}


def cage_equilibrium(scene: Joint, c: Constants, y: Array, t: Array) -> Array:
    """Newton's law of the cage,  F(1) + F(2) + F(3) - m a,  (3,) [N], of seat, head and balls; 0 but for rounding.

    The paper's test (its Table 3). The forces are those of the contacts; a is the field's acceleration.

    Raises:
        InputError: for a cage that is fixed.
    """
    piece = scene.slices["cage"]
    if piece is None:
        raise InputError("cage_equilibrium", "a fixed cage", "take a scene with cage = 'free'")
    acceleration = system.field(t, y, (scene, c))[(3 + scene.twist) * scene.balls + scene.coupling :][piece]
    total = sum(cage_forces(scene, c, y).values(), jnp.zeros(3))
    return total - acceleration / c.coupling_inverse_mass[piece]
