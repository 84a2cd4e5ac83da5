"""What instruments on the joint would read in one state, contact by contact.

Components of a force (the last axis, normal, axial, tangential); friction is that on the second body named here:

| contact                | normal                                       | axial                   | tangential         |
|------------------------|----------------------------------------------|-------------------------|--------------------|
| seat_ball, head_ball   | sum of both flanks' normal forces            | along the track         | around the section |
| cage_ball              | force on the cage along its axis, either sign| outward from its centre | around the cage    |
| cage_window_end        | force on the cage around it, either sign     | outward from its centre | along its axis     |
| seat_cage, head_cage   | normal force between the spheres             | along the cage's axis   | around that axis   |

The normal force of a pilot that is a band is the sum of the sizes along its edge; its direction is that of their resultant.
Axial and tangential are friction alone: normal, axial and tangential directions are at right angles.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import BodyMotion, Reading
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.contacts import ContactForce, dot
from bcfj_jax.models.joint.scene import GROOVES, Joint
from bcfj_jax.models.joint.system import (
    State,
    cage_frame,
    contact_forces,
    drive_torque,
    field,
    on_inner,
    on_parts,
    relative_motions,
    shaft_frames,
    view,
)


def _unit(vector: Array) -> Array:
    """A direction; zero for the zero vector, with finite derivatives."""
    squared = dot(vector, vector)[..., None]
    safe = jnp.where(squared > 0, squared, 1.0)
    return jnp.where(squared > 0, vector / jnp.sqrt(safe), 0.0)


def _read(touch: ContactForce, normal: Array, axial: Array) -> Reading:
    """Components from a touch, its signed normal and a reference that is not along the normal."""
    way = _unit(touch.drag - touch.force)
    first = _unit(axial - dot(axial, way)[..., None] * way)
    second = jnp.cross(way, first)
    force = jnp.stack([normal, dot(touch.drag, first), dot(touch.drag, second)], -1)
    deepest = jnp.argmax(touch.penetration, axis=-1, keepdims=True)
    depth, rate, slip = (
        jnp.take_along_axis(x, deepest, -1)[..., 0] for x in (touch.penetration, touch.rate, touch.slip)
    )
    # A law clips NaN to no force; a state that failed must not read as one that is merely apart.
    force, world = (jnp.where(jnp.isnan(depth)[..., None], jnp.nan, x) for x in (force, touch.force))
    return Reading(force, depth, rate, slip, world)


def observe(scene: Joint, c: Constants, y: Array) -> dict[str, Reading]:
    """Every contact's reading in one flat state; of a contact a ball (balls, 3) and (balls,), else (3,) and ()."""
    state = view(scene, c, y)
    found = contact_forces(scene, c, state)
    readings: dict[str, Reading] = {}
    if found.pilots is not None:
        reading = _read(on_inner(scene, found.pilots), jnp.sum(found.pilots.normal, -1), state.cage_axis)
        readings = {name: _member(reading, i) for i, name in enumerate(scene.pilots)}
    if found.windows is not None:
        normal = found.windows.normal[..., 0] - found.windows.normal[..., 1]
        readings["cage_ball"] = _read(found.windows, normal, state.ball_place - state.cage_place)
    if found.ends is not None:
        normal = found.ends.normal[..., 0] - found.ends.normal[..., 1]
        readings["cage_window_end"] = _read(found.ends, normal, state.ball_place - state.cage_place)
    along = _along(scene, c, state)
    reading = _read(found.grooves, jnp.sum(found.grooves.normal, -1), along)
    for i, name in enumerate(GROOVES):
        readings[name] = _member(reading, (slice(None), i))
    return {contact.name: readings[contact.name] for contact in scene.contacts}


def observe_at_rest(scene: Joint, c: Constants, y: Array) -> dict[str, Reading]:
    """As ``observe``, with forces as if nothing moved (no damping, no friction); rates and sliding as they are."""
    index = jnp.arange(y.size)
    velocities = (index >= 3 * scene.balls + scene.coupling) & (index < scene.moving)
    # Of the first only rates and slips are read; XLA leaves its laws out.
    moving, still = observe(scene, c, y), observe(scene, c, jnp.where(velocities, 0.0, y))
    return {name: still[name]._replace(rate=moving[name].rate, slip=moving[name].slip) for name in moving}


def resultants(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Sum over its members of each contact's whole force, friction included, (3,) [N], in one flat state.

    World axes: z the seat's axis, x in the plane of both axes, the head's axis leaning to +x. Forces are those on the
    second body: on the cage of seat_cage, on the head of head_cage, on the balls of all others.
    """
    exerted = on_parts(scene, c, view(scene, c, y))
    first = {"seat_ball": "seat", "head_ball": "head", "cage_ball": "cage", "cage_window_end": "cage"}
    second = {"seat_cage": "cage", "head_cage": "head"}
    of_balls = {name: -exerted[body][name].force for name, body in first.items() if name in exerted[body]}
    sums = of_balls | {name: exerted[second[name]][name].force for name in scene.pilots}
    return {contact.name: sums[contact.name] for contact in scene.contacts}


def _member(reading: Reading, index: Any) -> Reading:
    return jax.tree.map(lambda part: part[index], reading)


def _along(scene: Joint, c: Constants, state: State) -> Array:
    """Direction of either track at each ball, (balls, 2, 3)."""
    found = relative_motions(scene, c, state)
    place = found.motion.arm[:, :2] - c.groove.offset[:, None] * c.axes
    return _unit(jnp.cross(place, found.across))


BODIES = ("seat", "head", "cage", "ball")


def motions(scene: Joint, c: Constants, t: Array, y: Array) -> dict[str, BodyMotion]:
    """How every body moves; balls side by side. Without window ends the cage has no azimuth: its axes then turn as the
    seat does, which is what a cage that does not slip does on average, and it has no ``angle``.

    The seat's ``drive`` is the torque that holds its speed, or a flexible drive's.
    """
    state, rate = view(scene, c, y), field(t, y, (scene, c))
    n, k = scene.balls, scene.twist
    ball = rate[3 * n + scene.coupling :][: k * n].reshape(n, k)
    rates = rate[(3 + k) * n + scene.coupling : scene.moving]
    zero = jnp.zeros(3)

    def of(name: str) -> Array:
        piece = scene.slices[name]
        return zero if piece is None else rates[piece]

    found = {"ball": BodyMotion(state.ball_place, state.ball_velocity, ball[:, :3])}
    if scene.spin:
        found["ball"] = found["ball"]._replace(spin=state.ball_spin, spin_rate=ball[:, 3:])
    frames = shaft_frames(c, state)
    places, velocities = (zero, state.head_place), (zero, state.head_velocity)
    for i, (name, turn, spin) in enumerate(
        (("seat", state.seat_turn, state.seat_spin), ("head", state.head_turn, state.head_spin))
    ):
        found[name] = BodyMotion(
            place=places[i],
            velocity=velocities[i],
            acceleration=of("head") if i else zero,
            axes=frames[i],
            spin=spin * c.axes[i],
            spin_rate=of(f"{name}_turn")[0] * c.axes[i],
            angle=turn,
            drive=None if i else drive_torque(scene, c, t, state),
        )
    found["cage"] = BodyMotion(
        state.cage_place, state.cage_velocity, of("cage"), cage_frame(state), state.cage_spin, of("cage_turn"),
        angle=state.cage_azimuth,
    )  # fmt: skip
    return found
