"""Where the joint's energy comes from, where it is and where it goes, in one state; what it transmits; Newton's test.

Along every solution, term by term, exactly:

    drive + hold = load + axial + friction + damping + edge + d(kinetic + elastic + spring)/dt

``analysis.energy_balance`` integrates it. A contact of penetration d, smoothed to r(d), with normal force N(d, d') at a flank's
gate g (1 but at a flank's edge) holds  g E(d),  E = integral of N(x, 0) dx = integral of law(x, 0) dx from 0 to r(d),
and takes in  g N d' = d(g E)/dt + damping + edge.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import positive, smooth_ramp
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.bands import Band, act
from bcfj_jax.models.joint.constants import BALLS, Constants
from bcfj_jax.models.joint.contacts import ContactForce, Geometry, dot
from bcfj_jax.models.joint.guides import GUIDES
from bcfj_jax.models.joint.law_pair import ContactLaws, LawPair
from bcfj_jax.models.joint.scene import Joint

# Gauss-Legendre on (0, 1) in s, x = r s^2: exact for d^1.5, and to rounding for every elastic part with its
# power n >= 1 or its root.
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(24), (1.0, 0.0), strict=True))


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
    """One kind of contact in one state: its laws, where it is, the relative motion, what it does."""

    laws: ContactLaws | LawPair
    at: Geometry | Band
    motion: system.Motion
    touch: ContactForce


def _acting(scene: Joint, c: Constants, state: system.State) -> dict[str, _Acting]:
    """Every group of contacts that is evaluated together."""
    parts = system.relative_motions(scene, c, state).parts()
    found: dict[str, tuple] = dict(zip(("balls", "windows"), parts, strict=False))
    if c.pilot_laws is not None:
        at, motion, bent, _ = system.piloted(scene, c, state)
        found["pilots"] = c.pilot_laws, at, motion, bent
    return {
        name: _Acting(laws, at, motion, act(laws, at, motion.velocity, motion.spin, bent))
        for name, (laws, at, motion, bent) in found.items()
    }


def _elastic(laws: ContactLaws | LawPair, penetration: Array) -> Array:
    """Elastic energy E(d) [J] of each face: integral of the law's force at rest from 0 to r(d)."""
    if isinstance(laws, LawPair):
        halves = (jnp.take(penetration, jnp.array([i]), laws.axis) for i in (0, 1))
        parts = [_elastic(one, half) for one, half in zip((laws.first, laws.second), halves, strict=True)]
        return jnp.concatenate(parts, laws.axis)
    depth = positive(penetration) if laws.smoothing is None else smooth_ramp(penetration, laws.smoothing)[0]
    s = _NODES.reshape(-1, *[1] * penetration.ndim)
    weight = (2.0 * _NODES * _WEIGHTS).reshape(s.shape)
    force = laws.law.force(depth * s * s, jnp.zeros_like(depth * s), laws.coefficients)
    return depth * jnp.sum(weight * force, 0)


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
    for name, part in _acting(scene, c, system.view(scene, c, y)).items():
        faces = _friction(part)
        if name == "pilots":
            found |= dict(zip(scene.pilots, jnp.sum(faces, -1), strict=True))
        else:
            first = BALLS.index("cage_ball") if name == "windows" else 0
            found |= dict(zip(BALLS[first : first + faces.shape[1]], jnp.sum(faces, (0, 2)), strict=True))
    return {contact.name: found[contact.name] for contact in scene.contacts}


def _damping(part: _Acting) -> Array:
    """Sum of  (N(d, d') - N(d, 0)) d'  [W] over all faces."""
    still = part.laws.normal(part.at.penetration, jnp.zeros_like(part.touch.rate))
    gated = still if part.at.gate is None else still * part.at.gate
    return jnp.sum((part.touch.normal - gated) * part.touch.rate)


def _edge(part: _Acting) -> Array:
    """Sum of  -E dg/dt  [W] over all faces."""
    if part.at.gate_slope is None:
        return jnp.zeros(())
    gate_rate = dot(part.at.gate_slope, part.motion.velocity[..., None, :])
    return -jnp.sum(_elastic(part.laws, part.at.penetration) * gate_rate)


def _hold(scene: Joint, c: Constants, state: system.State) -> Array:
    """Power [W] that turns a fixed cage against its contacts."""
    hold = jnp.zeros(())
    if scene.cage != "fixed":
        return hold
    found = system.contact_forces(scene, c, state)
    arms = {"windows": state.ball_place - state.cage_place}
    if found.pilots is not None:
        arms["pilots"] = system.guided(scene, c, state)[0].arm
    for name, arm in arms.items():
        touch = getattr(found, name)
        if touch is not None:
            # Minus the moment about its centre of all forces on the cage, the outer body in all of its contacts.
            twist = jnp.cross(arm, touch.force) + (0.0 if touch.moment is None else touch.moment)
            hold = hold + jnp.sum(twist, 0) @ state.cage_spin
    return hold


def _contact_torque(scene: Joint, c: Constants, state: system.State) -> Array:
    """Contacts' generalised force on the seat's turn [N m]."""
    piece = scene.slices["seat_turn"]
    assert piece is not None
    return system.on_bodies(scene, c, state, system.contact_forces(scene, c, state))[1][piece][0]


def torque_in(scene: Joint, c: Constants, t: Array, y: Array) -> Array:
    """Torque on the seat [N m]: a flexible drive's; else minus the contacts', to hold the speed."""
    state = system.view(scene, c, y)
    if scene.drive == "flexible":
        return system.drive_torque(scene, c, t, state)
    return -_contact_torque(scene, c, state)


def power(scene: Joint, c: Constants, t: Array, y: Array) -> Power:
    """Every flow of energy in one flat state y at time t [s]."""
    state = system.view(scene, c, y)
    found = _acting(scene, c, state)
    flexible = scene.drive == "flexible"
    prescribed = system.drive_motion(scene, c, t)[1]
    speed = prescribed if flexible else state.seat_spin
    slip = prescribed - state.seat_spin
    torque, axial = system.loads(scene, c, t, state)
    return Power(
        drive=torque_in(scene, c, t, y) * speed,
        hold=_hold(scene, c, state),
        load=torque * state.head_spin,
        axial=axial * (state.head_velocity @ c.axes[1]),
        friction=sum((jnp.sum(_friction(part)) for part in found.values()), jnp.zeros(())),
        damping=sum((_damping(part) for part in found.values()), c.drive_damping * slip**2),
        edge=sum((_edge(part) for part in found.values()), jnp.zeros(())),
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
    for part in _acting(scene, c, state).values():
        energy = _elastic(part.laws, part.at.penetration)
        elastic = elastic + jnp.sum(energy if part.at.gate is None else energy * part.at.gate)
    lag = system.drive_motion(scene, c, t)[0] - state.seat_turn
    return Stored(
        kinetic=0.5 * (jnp.sum(twists**2 / c.ball_inverse_mass) + jnp.sum(coupling)),
        elastic=elastic,
        spring=0.5 * c.drive_stiffness * lag**2,
    )


def cage_forces(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Resultants on the cage of each kind of contact it has, (3,) [N] in world axes, by the contacts' names."""
    found = system.contact_forces(scene, c, system.view(scene, c, y))
    forces: dict[str, Array] = {}
    if found.pilots is not None:
        pilots = system.on_inner(scene, found.pilots)
        for i, name in enumerate(scene.pilots):
            forces[name] = pilots.force[i] * (1.0 if GUIDES[name][1] == "cage" else -1.0)
    if found.windows is not None:
        forces["cage_ball"] = -jnp.sum(found.windows.force, 0)
    if found.ends is not None:
        forces["cage_window_end"] = -jnp.sum(found.ends.force, 0)
    return forces


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
