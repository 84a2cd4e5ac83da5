"""The assembled, load-free state at time 0: balls on both tracks and in the bisecting plane, all turning."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import geometry
from bcfj_jax.models.joint.scene import Flat, Joint


def nominal(scene: Joint, params: Params, seat_turn: Array) -> Array:
    """Flat state of the zero-clearance joint at a seat angle, turning at the drive's first speed (physics sheet 5.2).

    Constant velocity: the head turns by the seat's angle, and so does the cage, centred on the bisector: balls swing
    evenly about the middles of their windows. Spinning balls turn with the cage.
    """
    p = params
    radius = geometry.track_radius(p["pitch_radius"], p["offset"])

    def centres(turn):
        return geometry.ball_centre(turn + scene.azimuths, p["joint_angle"], radius, p["offset"])

    speed = scene.programmes.start_speed(p)
    places, velocities = jax.jvp(centres, (seat_turn,), (speed,))
    axis, none, turn = geometry.bisector(p["joint_angle"]), jnp.zeros(3), seat_turn[None]
    at = {"head": none, "head_turn": turn, "cage": none, "cage_turn": axis, "seat_turn": turn}
    rate = {"head": none, "head_turn": speed[None], "cage": none, "cage_turn": speed * axis, "seat_turn": speed[None]}
    if scene.spin:
        velocities = jnp.concatenate([velocities, jnp.broadcast_to(speed * axis, (scene.balls, 3))], -1)
    others = jnp.zeros(scene.states - scene.moving)
    others = others if scene.azimuth is None else others.at[-1].set(seat_turn)
    return Flat(places, scene.coupled(at), velocities, scene.coupled(rate), others).whole()
