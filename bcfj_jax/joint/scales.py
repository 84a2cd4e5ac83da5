"""Natural sizes of the joint's states, and the tolerance in these units that a force error asks for."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.joint.bristles import flat
from bcfj_jax.joint.scene import PILOTS, Joint
from bcfj_jax.scene import Params


def scales(scene: Joint, params: Params) -> Array:
    """Size of each state: a place by the penetration of a ball that carries its share of the torque, a velocity
    by friction's transition speed; turns by these over the pitch radius, a ball's spin by that over its own; a
    bristle by its deflection at break-away.

    An error of a place in these units is about that fraction (times n) of a ball's force. An error of a
    velocity is that fraction of the friction of a sticking contact. Without friction a quarter of the rim speed
    stands in: only damping reads velocities then.
    """
    p = params
    load = jnp.abs(p["load_torque"]) / (scene.balls * p["pitch_radius"]) + jnp.abs(p["axial_load"]) / scene.balls + 10.0
    law = scene.contact("seat_ball").law
    coefficients = {name: scene.coefficient(p, "seat_ball", name) for name in law.needs}
    trial = jnp.logspace(-8, -3, 51)
    force = law.force(trial, jnp.zeros(51), {k: jnp.broadcast_to(v, (51,)) for k, v in coefficients.items()})
    place = jnp.clip(jnp.interp(load, force, trial), 1e-7, 1e-3)
    speeds = [scene.coefficient(p, x.name, "friction_speed") for x in scene.contacts if x.friction is not None]
    speed = jnp.min(jnp.stack(speeds)) if speeds else 0.25 * jnp.abs(p["drive_speed"]) * p["pitch_radius"] + 1e-3
    turning = np.zeros(scene.border, bool)
    for name, slot in scene.slots.items():
        if slot is not None and name.endswith("turn"):
            turning[slot] = True
    border = jnp.where(turning, 1.0 / p["pitch_radius"], 1.0)
    ball = jnp.ones((scene.balls, scene.twist)).at[:, 3:].set(1.0 / p["ball_radius"])
    parts = [jnp.full(3 * scene.balls, place), place * border, speed * ball.ravel(), speed * border]
    if scene.bristles:
        break_away = {
            name: jnp.full((1, count, 3), _break_away(scene, p, name)) for name, count in scene.bristles.items()
        }
        balls = {name: jnp.tile(x, (scene.balls, 1, 1)) for name, x in break_away.items() if name not in PILOTS}
        parts.append(flat(break_away | balls))
    return jnp.concatenate(parts)


def _break_away(scene: Joint, params: Params, name: str) -> Array:
    """Deflection of a contact's bristles at break-away [m]."""
    return scene.coefficient(params, name, "friction_static") / scene.coefficient(params, name, "bristle_stiffness")


def tolerance(force_error: float) -> float:
    """Local error per step in units of ``scales``: 10 times the force error, at most 0.02.

    Measured by ``benchmarks/joint_reference.py check``: every contact's rms error over the loaded 3 s is then below
    what was asked. Looser than 0.02 saves no steps: contacts that begin and end set them, and steps that jump into
    one are rejected.
    """
    return min(0.02, 10.0 * force_error)
