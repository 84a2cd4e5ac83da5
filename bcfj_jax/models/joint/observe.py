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

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import BodyMotion, Reading
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.contacts import ContactForce, dot
from bcfj_jax.models.joint.scene import FLAT, GROOVES, GUIDES, PILOTS, Joint
from bcfj_jax.models.joint.system import (
    State,
    by_name,
    cage_frame,
    contact_forces,
    drive_torque,
    field,
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
    touches = by_name(scene, contact_forces(scene, c, state))
    for name, pair in zip(scene.pilots, scene.pairs, strict=True):
        # Of bands, too, the forces on the inner spheres; moments are those that the contacts have.
        if pair != GUIDES[name]:
            touches[name] = touches[name]._replace(force=-touches[name].force, drag=-touches[name].drag)
    along, outward = _along(scene, c, state), state.ball_place - state.cage_place
    axial = dict.fromkeys(PILOTS, state.cage_axis) | dict.fromkeys(FLAT, outward)
    axial |= {name: along[:, i] for i, name in enumerate(GROOVES)}
    # Of windows the sense counts: faces push against each other.
    sign = jnp.array([1.0, -1.0])
    readings = {}
    for contact in scene.contacts:
        touch = touches[contact.name]
        normal = jnp.sum(touch.normal * sign if contact.name in FLAT else touch.normal, -1)
        readings[contact.name] = _read(touch, normal, axial[contact.name])
    return readings


def observe_at_rest(scene: Joint, c: Constants, y: Array) -> dict[str, Reading]:
    """As ``observe``, with forces as if nothing moved (no damping, no friction); rates and sliding as they are."""
    index = jnp.arange(y.size)
    velocities = (index >= 3 * scene.balls + scene.coupling) & (index < scene.moving)
    # Of the first only rates and slips are read, of the second only forces; one program looks at both.
    both = jax.vmap(lambda y: observe(scene, c, y))(jnp.stack([y, jnp.where(velocities, 0.0, y)]))
    moving, still = (jax.tree.map(lambda x, i=i: x[i], both) for i in (0, 1))
    return {name: still[name]._replace(rate=moving[name].rate, slip=moving[name].slip) for name in moving}


def resultants(scene: Joint, c: Constants, y: Array) -> dict[str, Array]:
    """Sum over its members of each contact's whole force, friction included, (3,) [N], in one flat state.

    World axes: z the seat's axis, x in the plane of both axes, the head's axis leaning to +x. Forces are those on the
    second body: on the cage of seat_cage, on the head of head_cage, on the balls of all others.
    """
    readings = observe(scene, c, y)
    return {name: jnp.sum(jnp.atleast_2d(jnp.asarray(x.world)), 0) for name, x in readings.items()}


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
    state, zero = view(scene, c, y), jnp.zeros(3)
    rate = scene.parted(field(t, y, (scene, c)))

    def of(name: str) -> Array:
        piece = scene.slices[name]
        return zero if piece is None else rate.rate[piece]

    ball = BodyMotion(state.ball_place, state.ball_velocity, rate.twist[:, :3])
    found = {"ball": ball._replace(spin=state.ball_spin, spin_rate=rate.twist[:, 3:]) if scene.spin else ball}
    frames = shaft_frames(c, state)
    shafts = {
        "seat": (zero, zero, zero, state.seat_spin, state.seat_turn, drive_torque(scene, c, t, state)),
        "head": (state.head_place, state.head_velocity, of("head"), state.head_spin, state.head_turn, None),
    }
    for i, (name, (place, velocity, acceleration, spin, turn, drive)) in enumerate(shafts.items()):
        spins = spin * c.axes[i], of(f"{name}_turn")[0] * c.axes[i]
        found[name] = BodyMotion(place, velocity, acceleration, frames[i], *spins, turn, drive)
    found["cage"] = BodyMotion(
        state.cage_place, state.cage_velocity, of("cage"), cage_frame(state), state.cage_spin, of("cage_turn"),
        angle=state.cage_azimuth,
    )  # fmt: skip
    return found
