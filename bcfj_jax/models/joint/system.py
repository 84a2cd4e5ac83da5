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
from jax import Array

from bcfj_jax.models.joint.bands import Band, act, band
from bcfj_jax.models.joint.constants import BALLS, Constants
from bcfj_jax.models.joint.contacts import ContactForce, ContactLaws, Geometry, LawPair, grooves, join, pilots, windows
from bcfj_jax.models.joint.geometry import azimuth_rate, cage_axes, windows_around
from bcfj_jax.models.joint.programmes import axial_at, drive_at, torque_at
from bcfj_jax.models.joint.scene import BODIES, GROOVES, GUIDES, OUTER, WINDOW_END, Flat, Joint, beside, flat, split
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
    """All contacts: grooves (balls, 2 races), windows and their ends (balls,), pilots (k,), as far as the scene has them."""

    grooves: ContactForce
    windows: ContactForce | None
    pilots: ContactForce | None
    ends: ContactForce | None = None


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
    laws: ContactLaws | LawPair
    geometry: Callable[[Array], Any]
    motion: Motion
    bristles: Array | None


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
    contacts: tuple[tuple[ContactLaws | LawPair, Any, int], ...]
    bristles: dict[str, Array]

    def parts(self) -> list[Part]:
        """Contacts that are evaluated together."""
        found, first = [], 0
        for laws, at, count in self.contacts:
            last = first + count
            motion = jax.tree.map(lambda x, i=first, j=last: x[:, i:j], self.motion)
            names = BALLS[first:last]
            found.append(Part(names, laws, at, motion, beside(self.bristles, names)))
            first = last
        return found


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


def relative_motions(scene: Joint, c: Constants, state: State) -> RelativeMotions:
    """Where the balls are, and how they move, relative to the bodies that they touch."""
    zero, planes = jnp.zeros(3), 0 if c.window_laws is None else 1 if c.cage_laws is None else 2
    place = jnp.stack([zero, state.head_place, *[state.cage_place] * planes])
    velocity = jnp.stack([zero, state.head_velocity, *[state.cage_velocity] * planes])
    spins = jnp.stack([state.seat_spin * c.axes[0], state.head_spin * c.axes[1], *[state.cage_spin] * planes])
    motion = relative(state, place, velocity, spins)
    across = track_normals(scene, c, jnp.stack([state.seat_turn, state.head_turn]))
    laws, clearance, axis = c.window_laws, c.window_clearance, state.cage_axis
    if c.cage_laws is not None:
        around = windows_around(axis, state.cage_azimuth + scene.azimuths)
        laws, clearance = c.cage_laws, c.cage_clearance
        axis = jnp.stack([jnp.broadcast_to(axis, around.shape), around], 1)

    def in_grooves(arm: Array) -> Geometry:
        return grooves(c.groove, arm - c.groove.offset[:, None] * c.axes, across)

    def in_windows(arm: Array) -> Geometry:
        return windows(clearance, c.groove.ball, arm, axis)

    def both(arm: Array) -> Geometry:
        return join(in_grooves(arm[:, :2]), in_windows(arm[:, 2:]))

    contacts: tuple[Any, ...] = ((c.groove_laws, in_grooves, 2), (laws, in_windows, planes))[: 2 if planes else 1]
    if c.ball_laws is not None:
        contacts = ((c.ball_laws, both, 2 + planes),)
    return RelativeMotions(motion, spins, across, contacts, state.bristles)


def _acted(part: Part) -> ContactForce:
    motion = part.motion
    return act(part.laws, part.geometry(motion.arm), motion.velocity, motion.spin, part.bristles)


@partial(jax.jit, static_argnums=0, inline=True)  # solver and observation both trace it
def contact_forces(scene: Joint, c: Constants, state: State) -> ContactForces:
    """Every contact of the scene in one state."""
    parts = relative_motions(scene, c, state).parts()
    acted = [_acted(part) for part in parts]
    groove = jax.tree.map(lambda x: x[:, :2], acted[0])
    pilot = window = end = None
    if c.cage_laws is not None:
        window, end = (jax.tree.map(lambda x, i=i: x[:, i], acted[-1]) for i in (-2, -1))
    elif c.window_laws is not None:
        window = jax.tree.map(lambda x: x[:, -1], acted[-1])
    if c.pilot_laws is not None:
        pilot = _acted(piloted(scene, c, state))
    return ContactForces(groove, window, pilot, end)


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


def piloted(scene: Joint, c: Constants, state: State) -> Part:
    """The pilots, of a scene that has them."""
    assert c.pilot_laws is not None

    def geometry(arm: Array) -> Geometry | Band:
        if c.bands is not None:
            return band(c.bands, arm, state.cage_axis)
        return pilots(c.pilot_clearance, c.pilot_hollow, arm)

    motion = guided(scene, c, state)[0]
    return Part(scene.pilots, c.pilot_laws, geometry, motion, beside(state.bristles, scene.pilots))


def on_inner(scene: Joint, pilots: ContactForce) -> ContactForce:
    """Pilots' forces on the inner spheres (``GUIDES``), of bands too; moments are those that the contacts have."""
    if not scene.banded:
        return pilots
    sign = jnp.array(
        [1.0 if GUIDES[name] == pair else -1.0 for name, pair in zip(scene.pilots, scene.pairs, strict=True)]
    )
    return pilots._replace(force=sign[:, None] * pilots.force, drag=sign[:, None] * pilots.drag)


class GuideMaps(NamedTuple):
    """Motion of the inner spheres relative to the outer ones, by the coupling (``Joint.pairs``).

    Attributes:
        twist: (pilots, 6, coupling) relative to the outer one's material at the inner centre, by velocities.
        place: (pilots, 3, coupling) by displacements.
        turning: (pilots, 3, coupling) angular velocity of the outer sphere, which carries its material by  w x arm.
    """

    twist: Array
    place: Array
    turning: Array


def guide_maps(scene: Joint, c: Constants, arm: Array) -> GuideMaps:
    """The maps where the inner centres are at ``arm`` (pilots, 3) from the outer ones."""
    outer, inner = (jnp.array([BODIES.index(pair[k]) for pair in scene.pairs]) for k in (0, 1))
    apart, turning = c.body_maps[inner] - c.body_maps[outer], c.body_maps[outer, 3:]
    return GuideMaps(apart.at[:, :3].add(cross_columns(arm, turning)), apart[:, :3], turning)


def cross_columns(a: Array, matrix: Array) -> Array:
    """a x (each column of the matrix)."""
    return jnp.cross(a[..., None, :], matrix.swapaxes(-1, -2)).swapaxes(-1, -2)


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
    coupling = scene.coupled(parts)
    if found.pilots is not None:
        maps = guide_maps(scene, c, guided(scene, c, state)[0].arm).twist
        coupling = coupling + jnp.sum(maps * wrench(found.pilots)[..., None], (0, 1))
    return jnp.sum(wrenches, 1), coupling


class Loads(NamedTuple):
    """Force (..., 3) [N] and moment (..., 3) [N m] about a body's centre."""

    force: Array
    moment: Array


def by_name(scene: Joint, found: ContactForces) -> dict[str, ContactForce]:
    """By contact what it does: of all balls, or of one pilot."""
    each: list[tuple[str, Any, Any]] = [(name, found.grooves, (slice(None), i)) for i, name in enumerate(GROOVES)]
    each += [("cage_ball", found.windows, slice(None)), (WINDOW_END, found.ends, slice(None))]
    each += [(name, found.pilots, i) for i, name in enumerate(scene.pilots)]
    return {name: jax.tree.map(lambda x, at=at: x[at], touch) for name, touch, at in each if touch is not None}


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
