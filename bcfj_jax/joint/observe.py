"""What instruments on the joint would read in one state.

Components of a force (the last axis, normal, axial, tangential); friction is that on the second body named here:

| contact                | normal                                       | axial                   | tangential         |
|------------------------|----------------------------------------------|-------------------------|--------------------|
| seat_ball, head_ball   | sum of both flanks' normal forces            | along the track         | around the section |
| cage_ball              | force on the cage along its axis, either sign| outward from its centre | around the cage    |
| seat_cage, head_cage   | normal force between the spheres             | along the cage's axis   | around that axis   |

Axial and tangential are friction alone: normal, axial and tangential directions are at right angles.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.dynamics import Reading
from bcfj_jax.joint.constants import Constants
from bcfj_jax.joint.contacts import Touch, dot
from bcfj_jax.joint.scene import Joint
from bcfj_jax.joint.system import State, races, touches, view

APART, TOUCHING, STICKING, SLIDING = range(4)
STATES = ("apart", "touching", "sticking", "sliding")


def _unit(vector: Array) -> Array:
    """A direction; zero for the zero vector, with finite derivatives."""
    squared = dot(vector, vector)[..., None]
    safe = jnp.where(squared > 0, squared, 1.0)
    return jnp.where(squared > 0, vector / jnp.sqrt(safe), 0.0)


def _read(touch: Touch, normal: Array, axial: Array) -> Reading:
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
    return Reading(jnp.where(jnp.isnan(depth)[..., None], jnp.nan, force), depth, rate, slip)


def observe(scene: Joint, c: Constants, y: Array) -> dict[str, Reading]:
    """Every contact's reading in one flat state; with six members (6, 3) and (6,), else (3,) and ()."""
    state = view(scene, c, y)
    found = touches(scene, c, state)
    readings: dict[str, Reading] = {}
    if found.pilots is not None:
        reading = _read(found.pilots, jnp.sum(found.pilots.normal, -1), state.cage_axis)
        readings = {name: _member(reading, i) for i, name in enumerate(scene.pilots)}
    if found.windows is not None:
        normal = found.windows.normal[..., 0] - found.windows.normal[..., 1]
        readings["cage_ball"] = _read(found.windows, normal, state.ball_place - state.cage_place)
    along = _along(c, state)
    reading = _read(found.grooves, jnp.sum(found.grooves.normal, -1), along)
    for i, name in enumerate(("seat_ball", "head_ball")):
        readings[name] = _member(reading, (slice(None), i))
    return {contact.name: readings[contact.name] for contact in scene.contacts}


def observe_at_rest(scene: Joint, c: Constants, y: Array) -> dict[str, Reading]:
    """As ``observe``, with forces as if nothing moved (no damping, no friction); rates and sliding as they are."""
    velocities = jnp.arange(y.size) >= 3 * scene.balls + scene.border
    moving, still = observe(scene, c, y), observe(scene, c, jnp.where(velocities, 0.0, y))
    return {name: still[name]._replace(rate=moving[name].rate, slip=moving[name].slip) for name in moving}


def _member(reading: Reading, index: Any) -> Reading:
    return jax.tree.map(lambda part: part[index], reading)


def _along(c: Constants, state: State) -> Array:
    """Direction of either track at each ball, (balls, 2, 3)."""
    motion, across, _ = races(c, state)
    place = motion.arm - c.groove.offset[:, None] * c.axes
    return _unit(jnp.cross(place, across))
