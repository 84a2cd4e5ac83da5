"""Newton's law for the bodies of the joint: state in, contact wrenches and accelerations out.

World axes throughout: the seat's axis is z, the head's lies in the x-z plane at the joint angle. The
coupling (everything that is not a ball) is, in this order and as far as the scene has it:

    head place (3)   head turn (1)   cage place (3)   cage axis or spin (3)   seat turn (1)

The state is flat: ball places, coupling places, ball twists (velocity, and spin where balls spin), coupling
velocities, bristles (``scene.split``), and the cage's azimuth where windows have ends. The cage's attitude is a unit axis and
that azimuth (``geometry``); without ends the cage is a body of revolution, and the axis is all. Its inertia is that of a
spherical shell (isotropic): no gyroscopic term, see ``geometry``.
A prescribed seat is a seat of infinite inertia, so that its turn is a state like any other and nothing depends on time
but the load, and the drive where its speed is not constant (``programmes``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.models.joint.bands import Band, act, band
from bcfj_jax.models.joint.constants import BALLS, Constants, groups
from bcfj_jax.models.joint.contacts import ContactForce, ContactLaws, Geometry, grooves, join, pilots, windows
from bcfj_jax.models.joint.geometry import azimuth_rate, cage_axes, windows_around
from bcfj_jax.models.joint.programmes import axial_at, drive_at, torque_at
from bcfj_jax.models.joint.scene import BODIES, OUTER, PILOTS, Flat, Joint, beside, flat, split
from bcfj_jax.xla.kept import kept


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
    """All contacts, as they are computed together (``constants.groups``): of balls (balls, m), pilots (k,)."""

    balls: tuple[ContactForce, ...]
    pilots: tuple[ContactForce, ...]


def view(scene: Joint, c: Constants, y: Array) -> State:
    """Names for the parts of a flat state; what the scene fixes comes from the constants."""
    parts, where, zero = scene.parted(y), scene.slices, jnp.zeros(3)
    head, turn, cage, tilt, seat = (where[name] for name in ("head", "head_turn", "cage", "cage_turn", "seat_turn"))
    at, rates = parts.at, parts.rate
    axis = c.bisector if tilt is None else at[tilt]
    return State(
        ball_place=parts.place,
        ball_velocity=parts.twist[:, :3],
        ball_spin=parts.twist[:, 3:] if scene.spin else None,
        head_place=zero if head is None else at[head],
        head_velocity=zero if head is None else rates[head],
        head_turn=at[turn][0],
        head_spin=rates[turn][0],
        cage_place=zero if cage is None else at[cage],
        cage_velocity=zero if cage is None else rates[cage],
        cage_axis=axis if tilt is None else axis / jnp.sqrt(axis @ axis),
        cage_spin=c.programmes["drive_speed"] * c.bisector if tilt is None else rates[tilt],
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


class Part(NamedTuple):
    """Contacts that are evaluated together: names, laws, geometry by relative place, relative motion, bristles."""

    names: tuple[str, ...]
    laws: ContactLaws
    geometry: Callable[[Array], Any]
    motion: Motion
    bristles: Array | None


def parts(
    names: list[tuple[str, ...]], laws: tuple[ContactLaws, ...], geometry: Any, motion: Motion, state: State
) -> list[Part]:
    """The parts of contacts side by side along the last axis but one; ``geometry`` of a slice of them is a part's."""
    found, first = [], 0
    for some, law in zip(names, laws, strict=True):
        at = slice(first, first + len(some))
        moving = jax.tree.map(lambda x, at=at: x[..., at, :], motion)
        found.append(Part(some, law, partial(geometry, at), moving, beside(state.bristles, some)))
        first = at.stop
    return found


class RelativeMotions(NamedTuple):
    """The bodies around the balls, m of them: seat, head, cage where there are windows, and again where these have ends."""

    motion: Motion  # of the balls relative to them, (balls, m, 3)
    spins: Array  # their angular velocities (m, 3)
    across: Array  # normals of the track planes (balls, 2, 3)
    parts: list[Part]  # contacts that are evaluated together


def shaft_axes(c: Constants, turns: Array) -> tuple[Array, Array]:
    """Where track 0 of seat and head lies, and its plane's normal, (2, 3) each, at their turns (2,)."""
    cosine, sine = jnp.cos(turns)[:, None], jnp.sin(turns)[:, None]
    return kept(cosine * c.radial + sine * c.tangent, cosine * c.tangent - sine * c.radial)


def shaft_frames(c: Constants, state: State) -> Array:
    """Axes of seat and head as columns (2, 3, 3): through the middle of track 0, around, their own."""
    radial, tangent = shaft_axes(c, jnp.stack([state.seat_turn, state.head_turn]))
    return jnp.stack([radial, tangent, c.axes], -1)


def cage_frame(state: State) -> Array:
    """The cage's axes as columns (3, 3); without an azimuth they turn as the seat does."""
    return cage_axes(state.cage_axis, state.seat_turn if state.cage_azimuth is None else state.cage_azimuth)


def track_normals(scene: Joint, c: Constants, turns: Array) -> Array:
    """Unit normals of the planes of all tracks (balls, 2, 3) at the turns (2,) of seat and head."""
    radial, tangent = shaft_axes(c, turns)
    angle = scene.azimuths[:, None, None]
    return jnp.cos(angle) * tangent - jnp.sin(angle) * radial


def around_balls(c: Constants, across: Array, axes: Array, at: slice, arm: Array) -> Geometry:
    """Contacts of balls at ``arm`` (balls, m, 3) from some of the bodies around them.

    ``across``: normals of the track planes; ``axes``: of windows, and of their ends where there are any (..., 2, 3).
    """
    races, flat = slice(at.start, min(at.stop, 2)), slice(max(at.start, 2) - 2, at.stop - 2)
    found, many = [], max(races.stop - races.start, 0)
    if many:
        shape = c.groove.races(races)
        found.append(grooves(shape, arm[:, :many] - shape.offset[:, None] * c.axes[races], across[:, races]))
    if at.stop > 2:
        clearance = c.window_clearance[..., flat, :]
        found.append(windows(clearance, c.groove.ball, arm[:, many:], axes[..., flat, :]))
    return found[0] if len(found) == 1 else join(*found)


def relative_motions(scene: Joint, c: Constants, state: State) -> RelativeMotions:
    """Where the balls are, and how they move, relative to the bodies that they touch."""
    names = groups(scene, BALLS)
    zero, planes = jnp.zeros(3), sum(map(len, names)) - 2
    place = jnp.stack([zero, state.head_place, *[state.cage_place] * planes])
    velocity = jnp.stack([zero, state.head_velocity, *[state.cage_velocity] * planes])
    spins = jnp.stack([state.seat_spin * c.axes[0], state.head_spin * c.axes[1], *[state.cage_spin] * planes])
    motion = relative(state, place, velocity, spins)
    across = track_normals(scene, c, jnp.stack([state.seat_turn, state.head_turn]))
    axes = state.cage_axis[None]
    if scene.window_ends:
        around = windows_around(state.cage_axis, state.cage_azimuth + scene.azimuths)
        axes = jnp.stack([jnp.broadcast_to(state.cage_axis, around.shape), around], 1)
    geometry = partial(around_balls, c, across, axes)
    return RelativeMotions(motion, spins, across, parts(names, c.ball_laws, geometry, motion, state))


def _acted(several: list[Part]) -> tuple[ContactForce, ...]:
    return tuple(
        act(part.laws, part.geometry(part.motion.arm), part.motion.velocity, part.motion.spin, part.bristles)
        for part in several
    )


@partial(jax.jit, static_argnums=0, inline=True)  # solver and observation both trace it
def contact_forces(scene: Joint, c: Constants, state: State) -> ContactForces:
    """Every contact of the scene in one state."""
    return ContactForces(_acted(relative_motions(scene, c, state).parts), _acted(piloted(scene, c, state)))


def guided(scene: Joint, c: Constants, state: State) -> tuple[Motion, Array]:
    """Inner spheres relative to outer ones (``Joint.pairs``), and the outer ones' angular velocities; (pilots, 3) each."""
    seat_spin, head_spin = state.seat_spin * c.axes[0], state.head_spin * c.axes[1]
    zero = jnp.zeros(3)
    bodies = {
        "seat": (zero, zero, seat_spin),
        "cage": (state.cage_place, state.cage_velocity, state.cage_spin),
        "head": (state.head_place, state.head_velocity, head_spin),
    }
    outer = [jnp.stack(part) for part in zip(*(bodies[first] for first, _ in scene.pairs), strict=True)]
    inner = [jnp.stack(part) for part in zip(*(bodies[second] for _, second in scene.pairs), strict=True)]
    arm, spin = inner[0] - outer[0], outer[2]
    return Motion(arm, inner[1] - outer[1] - jnp.cross(spin, arm), inner[2] - spin), spin


def piloted(scene: Joint, c: Constants, state: State) -> list[Part]:
    """The pilots, as far as the scene has them."""
    if not scene.pilots:
        return []

    def geometry(at: slice, arm: Array) -> Geometry | Band:
        if c.bands is not None:
            return band(c.bands.some(at), arm, state.cage_axis)
        return pilots(c.pilot_clearance[at], c.pilot_hollow[at], arm)

    return parts(groups(scene, PILOTS), c.pilot_laws, geometry, guided(scene, c, state)[0], state)


# Signs with which a pilot's force and its moments about both centres act on the motions of ``guide_maps``.
FELT = np.array([1.0] * 6 + [-1.0] * 3)


def guide_maps(scene: Joint, c: Constants) -> Array:
    """By the coupling's rates, (pilots, 9, coupling): the inner centre's velocity less the outer one's, both spins.

    Of ``Joint.pairs``. The outer sphere carries its material by its spin besides.
    """
    outer, inner = (c.body_maps[jnp.array([BODIES.index(pair[k]) for pair in scene.pairs])] for k in (0, 1))
    return jnp.concatenate([inner[:, :3] - outer[:, :3], inner[:, 3:], outer[:, 3:]], 1)


def loads(scene: Joint, c: Constants, t: Array, state: State) -> tuple[Array, Array]:
    """Resisting torque [N m] and axial load [N] on the head."""
    p = c.programmes
    return torque_at(scene.programmes, t, state.head_spin, p), axial_at(scene.programmes, t, p)


def drive_motion(scene: Joint, c: Constants, t: Array) -> tuple[Array, Array]:
    """Turn [rad] and speed [rad/s] that the drive prescribes."""
    if scene.programmes.drive is None:
        return c.programmes["drive_speed"] * t, c.programmes["drive_speed"]
    return drive_at(scene.programmes, t, c.programmes)[:2]


def seat_rate(scene: Joint, c: Constants, t: Array) -> Array:
    """Rate of a prescribed speed that is not constant [rad/s^2]."""
    return drive_at(scene.programmes, t, c.programmes)[2]


def applied(scene: Joint, c: Constants, t: Array, state: State) -> Array:
    """Generalised forces of loads and drive on the coupling coordinates, (coupling,)."""
    torque, axial = loads(scene, c, t, state)
    parts = {"head": -axial * c.axes[1], "head_turn": -torque[None]}
    driven = drive_torque(scene, c, t, state)[None] if scene.drive == "flexible" else jnp.zeros(1)
    return scene.coupled(parts | {"cage": jnp.zeros(3), "cage_turn": jnp.zeros(3), "seat_turn": driven})


def drive_torque(scene: Joint, c: Constants, t: Array, state: State) -> Array:
    """Torque on the seat [N m]: a flexible drive's; of a prescribed speed what holds it against the contacts."""
    if scene.drive != "flexible":
        return -sum((loads.moment @ c.axes[0] for loads in on_parts(scene, c, state)["seat"].values()), jnp.zeros(()))
    turn, speed = drive_motion(scene, c, t)
    return c.drive_stiffness * (turn - state.seat_turn) + c.drive_damping * (speed - state.seat_spin)


def wrench(touch: ContactForce) -> Array:
    """Force, and moment of a spinning ball, side by side."""
    return touch.force if touch.moment is None else jnp.concatenate([touch.force, touch.moment], -1)


def on_bodies(scene: Joint, c: Constants, state: State, found: ContactForces) -> tuple[Array, Array]:
    """Contact wrenches on the balls (balls, twist) and generalised forces on the coupling coordinates (coupling,)."""
    wrenches = jnp.concatenate([wrench(touch) for touch in found.balls], 1)
    places = [jnp.zeros(3), state.head_place, state.cage_place, state.cage_place][: wrenches.shape[1]]
    force = wrenches[..., :3]
    torque = jnp.cross(state.ball_place[:, None] - jnp.stack(places), force)
    if scene.spin:
        torque = torque + wrenches[..., 3:]
    push, twist = -jnp.sum(force, 0), -jnp.sum(torque, 0)
    turning = jnp.sum(twist[:2] * c.axes, -1)
    cage = jnp.sum(push[2:], 0), jnp.sum(twist[2:], 0)
    parts = {"head": push[1], "head_turn": turning[1:], "cage": cage[0], "cage_turn": cage[1], "seat_turn": turning[:1]}
    coupling = scene.coupled(parts)
    if found.pilots:
        guiding, arm = jnp.concatenate([wrench(touch) for touch in found.pilots]), guided(scene, c, state)[0].arm
        guiding = jnp.concatenate([guiding, guiding[:, 3:] + jnp.cross(arm, guiding[:, :3])], -1) * FELT
        coupling = coupling + jnp.sum(guide_maps(scene, c) * guiding[..., None], (0, 1))
    return jnp.sum(wrenches, 1), coupling


class Loads(NamedTuple):
    """Force (..., 3) [N] and moment (..., 3) [N m] about a body's centre."""

    force: Array
    moment: Array


def by_name(scene: Joint, found: ContactForces) -> dict[str, ContactForce]:
    """By contact what it does: of all balls, or of one pilot."""
    each = [
        *zip(groups(scene, BALLS), found.balls, strict=True),
        *zip(groups(scene, PILOTS), found.pilots, strict=True),
    ]
    return {
        name: jax.tree.map(lambda x, at=(i if name in PILOTS else (slice(None), i)): x[at], touch)
        for names, touch in each
        for i, name in enumerate(names)
    }


def on_parts(scene: Joint, c: Constants, state: State) -> dict[str, dict[str, Loads]]:
    """By body and contact what the contact exerts on the body, in world axes."""
    places = {"seat": jnp.zeros(3), "head": state.head_place, "cage": state.cage_place}
    exerted: dict[str, dict[str, Loads]] = {body: {} for body in places}
    pairs = dict(zip(scene.pilots, scene.pairs, strict=True))
    for name, (force, moment, *_) in by_name(scene, contact_forces(scene, c, state)).items():
        if name in pairs:
            assert moment is not None
            outer, inner = pairs[name]
            exerted[inner][name] = Loads(force, moment)
            exerted[outer][name] = Loads(-force, -moment - jnp.cross(places[inner] - places[outer], force))
            continue
        turning = jnp.cross(state.ball_place - places[OUTER[name]], force)
        turning = turning if moment is None else turning + moment
        exerted[OUTER[name]][name] = Loads(-jnp.sum(force, 0), -jnp.sum(turning, 0))
    return exerted


def _bending(scene: Joint, c: Constants, state: State, found: ContactForces) -> Array:
    """Rates of all friction's states; bristles turn with the outer body of their contact; flat."""
    spins = {"seat": state.seat_spin * c.axes[0], "head": state.head_spin * c.axes[1], "cage": state.cage_spin}
    touches = by_name(scene, found)
    rates: dict[str, Any] = {name: touches[name].bending for name in scene.bristles}
    if scene.width == 3:
        rates = {name: rate + jnp.cross(spins[OUTER[name]], state.bristles[name]) for name, rate in rates.items()}
    return flat(rates)


def field(t: Array, y: Array, args: tuple[Joint, Constants]) -> Array:
    """Time derivative of the flat state."""
    scene, c = args
    state = view(scene, c, y)
    found = contact_forces(scene, c, state)
    ball, coupling = on_bodies(scene, c, state, found)
    coupling = coupling + applied(scene, c, t, state)
    parts, tilt = scene.parted(y), scene.slices["cage_turn"]
    rates = parts.rate
    if tilt is not None:
        rates = rates.at[tilt].set(jnp.cross(state.cage_spin, parts.at[tilt]))
    changes = coupling * c.coupling_inverse_mass
    if scene.driven:
        changes = changes.at[-1].set(seat_rate(scene, c, t))
    others = [_bending(scene, c, state, found)] if scene.bristles else []
    if scene.azimuth is not None:
        others.append(azimuth_rate(state.cage_axis, state.cage_spin)[None])
    rest = jnp.concatenate(others) if others else jnp.zeros(0)
    return Flat(state.ball_velocity, rates, ball * c.ball_inverse_mass, changes, rest).whole()
