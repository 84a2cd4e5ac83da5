"""Newton's law for the bodies of the joint: state in, contact wrenches and accelerations out.

World axes throughout: the seat's axis is z, the head's lies in the x-z plane at the joint angle. The
coupling (everything that is not a ball) is, in this order and as far as the scene has it:

    head place (3)   head turn (1)   cage place (3)   cage axis or spin (3)   seat turn (1)

The state is flat: ball places, coupling places, ball twists (velocity, and spin where balls spin), coupling
velocities, bristles (``bristles``), and the cage's azimuth where windows have ends. The cage's attitude is a unit axis and
that azimuth (``attitude``); without ends the cage is a body of revolution, and the axis is all. Its inertia is that of a
spherical shell (isotropic): no gyroscopic term, see ``attitude``.
A prescribed seat is a seat of infinite inertia, so that its turn is a state like any other and nothing depends on time
but the load, and the drive where its speed is not constant (``programmes``).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.kept import kept
from bcfj_jax.core.numerics import smooth_rise
from bcfj_jax.models.joint.attitude import azimuth_rate, windows_around
from bcfj_jax.models.joint.bands import Band, act, band
from bcfj_jax.models.joint.bristles import beside, flat, split
from bcfj_jax.models.joint.constants import BALLS, Constants
from bcfj_jax.models.joint.contacts import ContactForce, Geometry, grooves, join, pilots, windows
from bcfj_jax.models.joint.guides import GUIDES, pairs
from bcfj_jax.models.joint.law_pair import ContactLaws, LawPair
from bcfj_jax.models.joint.programmes import axial_at, drive_at, torque_at, torque_slope
from bcfj_jax.models.joint.scene import GROOVES, PILOTS, Joint


class State(NamedTuple):
    """A named view of the flat state. Velocities in world axes, and the deflections that ``bristles.split`` gives."""

    ball_place: Array
    ball_velocity: Array
    ball_spin: Array | None
    head_place: Array
    head_velocity: Array
    head_turn: Array
    head_spin: Array
    cage_place: Array
    cage_velocity: Array
    cage_axis: Array
    cage_spin: Array
    cage_azimuth: Array | None
    seat_turn: Array
    seat_spin: Array
    bristles: dict[str, Array]


class ContactForces(NamedTuple):
    """All contacts: grooves (balls, 2 races), windows and their ends (balls,), pilots (k,), as far as the scene has them."""

    grooves: ContactForce
    windows: ContactForce | None
    pilots: ContactForce | None
    ends: ContactForce | None = None


def view(scene: Joint, c: Constants, y: Array) -> State:
    """Names for the parts of a flat state; what the scene fixes comes from the constants."""
    n, k = scene.balls, scene.twist
    places, twists = y[: 3 * n].reshape(n, 3), y[3 * n + scene.coupling :][: k * n].reshape(n, k)
    at, rates = y[3 * n : 3 * n + scene.coupling], y[(3 + k) * n + scene.coupling : scene.moving]
    where = scene.slices
    zero = jnp.zeros(3)
    head, turn, cage, tilt, seat = (where[name] for name in ("head", "head_turn", "cage", "cage_turn", "seat_turn"))
    axis = c.bisector if tilt is None else at[tilt]
    return State(
        ball_place=places,
        ball_velocity=twists[:, :3],
        ball_spin=twists[:, 3:] if scene.spin else None,
        head_place=zero if head is None else at[head],
        head_velocity=zero if head is None else rates[head],
        head_turn=at[turn][0],
        head_spin=rates[turn][0],
        cage_place=zero if cage is None else at[cage],
        cage_velocity=zero if cage is None else rates[cage],
        cage_axis=axis if tilt is None else axis / jnp.sqrt(axis @ axis),
        cage_spin=c.drive_speed * c.bisector if tilt is None else rates[tilt],
        cage_azimuth=None if scene.azimuth is None else y[scene.azimuth],
        seat_turn=at[seat][0],
        seat_spin=rates[seat][0],
        bristles=split(scene, y) if scene.bristles else {},
    )


class Motion(NamedTuple):
    """Motion of the balls relative to a body; shapes (balls, ..., 3)."""

    arm: Array
    velocity: Array
    spin: Array | None


def relative(state: State, place: Array, velocity: Array, spin: Array) -> Motion:
    """Motion of the balls relative to bodies at ``place`` (..., 3): arm from the body's centre, and rates."""
    shape = (slice(None),) + (None,) * (place.ndim - 1)
    arm = state.ball_place[shape] - place
    rate = state.ball_velocity[shape] - velocity - jnp.cross(spin, arm)
    return Motion(arm, rate, None if state.ball_spin is None else state.ball_spin[shape] - spin)


class RelativeMotions(NamedTuple):
    """The bodies around the balls, m of them: seat, head, cage where there are windows, and again where these have ends.

    Attributes:
        motion: of the balls relative to them, (balls, m, 3); spins: their angular velocities (m, 3).
        across: normals of the track planes (balls, 2, 3).
        contacts: laws and geometries, of all bodies together (balls, m, f) or one after the other.
        bristles: by contact.
    """

    motion: Motion
    spins: Array
    across: Array
    contacts: tuple[tuple[ContactLaws | LawPair, Geometry], ...]
    bristles: dict[str, Array]

    def parts(self) -> list[tuple[ContactLaws | LawPair, Geometry, Motion, Array | None]]:
        """Laws and geometry of each contact with the motion and the bristles that go with it."""
        found, first = [], 0
        for laws, at in self.contacts:
            last = first + at.penetration.shape[1]
            motion = jax.tree.map(lambda x, i=first, j=last: x[:, i:j], self.motion)
            found.append((laws, at, motion, beside(self.bristles, BALLS[first:last])))
            first = last
        return found


def relative_motions(scene: Joint, c: Constants, state: State) -> RelativeMotions:
    """Where the balls are, and how they move, relative to the bodies that they touch."""
    zero, planes = jnp.zeros(3), 0 if c.window_laws is None else 1 if c.cage_laws is None else 2
    place = jnp.stack([zero, state.head_place, *[state.cage_place] * planes])
    velocity = jnp.stack([zero, state.head_velocity, *[state.cage_velocity] * planes])
    races = [state.seat_spin * c.axes[0], state.head_spin * c.axes[1]]
    spins = jnp.stack([*races, *[state.cage_spin] * planes])
    motion = relative(state, place, velocity, spins)
    turns = jnp.stack([state.seat_turn, state.head_turn])
    cosine, sine = jnp.cos(turns)[:, None], jnp.sin(turns)[:, None]
    radial, tangent = kept(cosine * c.radial + sine * c.tangent, cosine * c.tangent - sine * c.radial)
    angle = scene.azimuths[:, None, None]
    across = np.cos(angle) * tangent - np.sin(angle) * radial
    at = grooves(c.groove, motion.arm[:, :2] - c.groove.offset[:, None] * c.axes, across)
    if c.window_laws is None:
        return RelativeMotions(motion, spins, across, ((c.groove_laws, at),), state.bristles)
    laws, clearance, axis = c.window_laws, c.window_clearance, state.cage_axis
    if c.cage_laws is not None:
        around = windows_around(axis, state.cage_azimuth + scene.azimuths)
        laws, clearance = c.cage_laws, c.cage_clearance
        axis = jnp.stack([jnp.broadcast_to(axis, around.shape), around], 1)
    window = windows(clearance, c.groove.ball, motion.arm[:, 2:], axis)
    if c.ball_laws is not None:
        return RelativeMotions(motion, spins, across, ((c.ball_laws, join(at, window)),), state.bristles)
    return RelativeMotions(motion, spins, across, ((c.groove_laws, at), (laws, window)), state.bristles)


@partial(jax.jit, static_argnums=0, inline=True)  # solver and observation both trace it
def contact_forces(scene: Joint, c: Constants, state: State) -> ContactForces:
    """Every contact of the scene in one state."""
    parts = relative_motions(scene, c, state).parts()
    acted = [act(laws, at, motion.velocity, motion.spin, bent) for laws, at, motion, bent in parts]
    groove = jax.tree.map(lambda x: x[:, :2], acted[0])
    pilot = window = end = None
    if c.cage_laws is not None:
        window, end = (jax.tree.map(lambda x, i=i: x[:, i], acted[-1]) for i in (-2, -1))
    elif c.window_laws is not None:
        window = jax.tree.map(lambda x: x[:, -1], acted[-1])
    if c.pilot_laws is not None:
        at, motion, bent, _ = piloted(scene, c, state)
        pilot = act(c.pilot_laws, at, motion.velocity, motion.spin, bent)
    return ContactForces(groove, window, pilot, end)


def guided(scene: Joint, c: Constants, state: State) -> tuple[Motion, Array]:
    """Inner spheres relative to outer ones (``pairs``), and the outer ones' angular velocities; (pilots, 3) each."""
    seat_spin, head_spin = state.seat_spin * c.axes[0], state.head_spin * c.axes[1]
    zero = jnp.zeros(3)
    bodies = {
        "seat": (zero, zero, seat_spin),
        "cage": (state.cage_place, state.cage_velocity, state.cage_spin),
        "head": (state.head_place, state.head_velocity, head_spin),
    }
    outer = [jnp.stack(part) for part in zip(*(bodies[first] for first, _ in pairs(scene)), strict=True)]
    inner = [jnp.stack(part) for part in zip(*(bodies[second] for _, second in pairs(scene)), strict=True)]
    arm, spin = inner[0] - outer[0], outer[2]
    return Motion(arm, inner[1] - outer[1] - jnp.cross(spin, arm), inner[2] - spin), spin


def piloted(scene: Joint, c: Constants, state: State) -> tuple[Geometry | Band, Motion, Array | None, Array]:
    """The pilots' geometry, ``guided``'s motion, bristles, and the outer spheres' angular velocities."""
    motion, spin = guided(scene, c, state)
    bent = beside(state.bristles, scene.pilots)
    if c.bands is not None:
        return band(c.bands, motion.arm, state.cage_axis), motion, bent, spin
    return pilots(c.pilot_clearance, c.pilot_hollow, motion.arm), motion, bent, spin


def on_inner(scene: Joint, pilots: ContactForce) -> ContactForce:
    """Pilots' forces on the inner spheres (``GUIDES``), of bands too; moments are those that the contacts have."""
    if not scene.banded:
        return pilots
    sign = jnp.array(
        [1.0 if GUIDES[name] == pair else -1.0 for name, pair in zip(scene.pilots, pairs(scene), strict=True)]
    )
    return pilots._replace(force=sign[:, None] * pilots.force, drag=sign[:, None] * pilots.drag)


def guide_maps(c: Constants, arm: Array) -> Array:
    """Twists of the inner spheres relative to the outer ones' material, by coupling velocities, (pilots, 6, coupling)."""
    # Elementwise, here and below: a call of a library keeps a loop from being one kernel.
    return c.guides.still + jnp.sum(arm[..., None, None] * c.guides.lever, 1)


def load_torque(c: Constants, t: Array) -> Array:
    """Resisting torque on the head [N m], raised from 0 over the load ramp with continuous second derivative."""
    return c.load_torque * smooth_rise(t / c.load_ramp)


def loads(scene: Joint, c: Constants, t: Array, state: State) -> tuple[Array, Array]:
    """Resisting torque [N m] and axial load [N] on the head."""
    if scene.programmes.usual:
        return load_torque(c, t), c.axial_load
    p = c.programmes
    return torque_at(scene.programmes, t, state.head_spin, p), axial_at(scene.programmes, t, p)


def load_slope(scene: Joint, c: Constants, t: Array, state: State) -> Array:
    """Derivative of a resisting torque that sticks and slips by the head's speed [N m s/rad]."""
    return torque_slope(scene.programmes, t, state.head_spin, c.programmes)


def drive_motion(scene: Joint, c: Constants, t: Array) -> tuple[Array, Array]:
    """Turn [rad] and speed [rad/s] that the drive prescribes."""
    if scene.programmes.drive is None:
        return c.drive_speed * t, c.drive_speed
    return drive_at(scene.programmes, t, c.programmes)[:2]


def seat_rate(scene: Joint, c: Constants, t: Array) -> Array:
    """Rate of a prescribed speed that is not constant [rad/s^2]."""
    return drive_at(scene.programmes, t, c.programmes)[2]


def applied(scene: Joint, c: Constants, t: Array, state: State) -> Array:
    """Generalised forces of loads and drive on the coupling coordinates, (coupling,)."""
    torque, axial = loads(scene, c, t, state)
    parts = {"head": -axial * c.axes[1], "head_turn": -torque[None]}
    parts |= {"cage": jnp.zeros(3), "cage_turn": jnp.zeros(3), "seat_turn": drive_torque(scene, c, t, state)[None]}
    return jnp.concatenate([parts[name] for name, piece in scene.slices.items() if piece is not None])


def drive_torque(scene: Joint, c: Constants, t: Array, state: State) -> Array:
    """Torque of a flexible drive on the seat [N m]; 0 where the speed is prescribed."""
    if scene.drive != "flexible":
        return jnp.zeros(())
    turn, speed = drive_motion(scene, c, t)
    return c.drive_stiffness * (turn - state.seat_turn) + c.drive_damping * (speed - state.seat_spin)


def wrench(touch: ContactForce) -> Array:
    """Force, and moment of a spinning ball, side by side."""
    return touch.force if touch.moment is None else jnp.concatenate([touch.force, touch.moment], -1)


def on_bodies(scene: Joint, c: Constants, state: State, found: ContactForces) -> tuple[Array, Array]:
    """Contact wrenches on the balls (balls, twist) and generalised forces on the coupling coordinates (coupling,)."""
    wrenches, places = wrench(found.grooves), [jnp.zeros(3), state.head_place]
    for touch in (found.windows, found.ends):
        if touch is not None:
            wrenches = jnp.concatenate([wrenches, wrench(touch)[:, None]], 1)
            places.append(state.cage_place)
    force = wrenches[..., :3]
    torque = jnp.cross(state.ball_place[:, None] - jnp.stack(places), force)
    if scene.spin:
        torque = torque + wrenches[..., 3:]
    push, twist = -jnp.sum(force, 0), -jnp.sum(torque, 0)
    turning = jnp.sum(twist[:2] * c.axes, -1)
    cage = jnp.sum(push[2:], 0), jnp.sum(twist[2:], 0)
    parts = {"head": push[1], "head_turn": turning[1:], "cage": cage[0], "cage_turn": cage[1], "seat_turn": turning[:1]}
    coupling = jnp.concatenate([parts[name] for name, piece in scene.slices.items() if piece is not None])
    if found.pilots is not None:
        maps = guide_maps(c, guided(scene, c, state)[0].arm)
        coupling = coupling + jnp.sum(maps * wrench(found.pilots)[..., None], (0, 1))
    return jnp.sum(wrenches, 1), coupling


def _bending(scene: Joint, c: Constants, state: State, found: ContactForces) -> Array:
    """Rates of all friction's states; bristles turn with the outer body of their contact; flat."""
    spins = {"seat": state.seat_spin * c.axes[0], "head": state.head_spin * c.axes[1], "cage": state.cage_spin}
    rates = {}
    for name in scene.bristles:
        if name in PILOTS:
            outer, touch, member = GUIDES[name][0], found.pilots, scene.pilots.index(name)
        else:
            race = name in GROOVES
            outer = name.removesuffix("_ball") if race else "cage"
            touch = found.grooves if race else found.windows if name == "cage_ball" else found.ends
            member = (slice(None), *([BALLS.index(name)] if race else []))
        assert touch is not None and touch.bending is not None
        rates[name] = touch.bending[member]
        if scene.width == 3:
            rates[name] = rates[name] + jnp.cross(spins[outer], state.bristles[name])
    return flat(rates)


def field(t: Array, y: Array, args: tuple[Joint, Constants]) -> Array:
    """Time derivative of the flat state."""
    scene, c = args
    state = view(scene, c, y)
    found = contact_forces(scene, c, state)
    ball, coupling = on_bodies(scene, c, state, found)
    coupling = coupling + applied(scene, c, t, state)
    n = scene.balls
    rates = y[(3 + scene.twist) * n + scene.coupling : scene.moving]
    tilt = scene.slices["cage_turn"]
    if tilt is not None:
        axis = y[3 * n : 3 * n + scene.coupling][tilt]
        rates = rates.at[tilt].set(jnp.cross(state.cage_spin, axis))
    changes = coupling * c.coupling_inverse_mass
    if scene.driven:
        changes = changes.at[-1].set(seat_rate(scene, c, t))
    others = [_bending(scene, c, state, found)] if scene.bristles else []
    if scene.azimuth is not None:
        others.append(azimuth_rate(state.cage_axis, state.cage_spin)[None])
    return jnp.concatenate(
        [
            state.ball_velocity.ravel(),
            rates,
            (ball * c.ball_inverse_mass).ravel(),
            changes,
            *others,
        ]
    )
