"""From a scene and its parameters to an ODE, and from a state to what an instrument would read.

The state is one flat array: positions, velocities, then one remembered approach speed for each contact
that has one. Contacts act along the gradient of their gap (virtual work), so a scene states geometry
once and gets rates and force directions from it.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.laws import onset_force
from bcfj_jax.scene import Contact, Params, Scene

APART, TOUCHING, STICKING, SLIDING = range(4)
STATES = ("apart", "touching", "sticking", "sliding")
UNKNOWN = -1


class Reading(NamedTuple):
    """What one contact does at one instant (or at each of T instants).

    Attributes:
        force: (..., 3) normal, axial, tangential force [N] on the body; 1-D contacts have only the first.
        penetration: (...,) overlap of the undeformed surfaces [m]; negative is the gap.
        rate: (...,) rate of the penetration [m/s], positive while approaching.
        slip: (...,) sliding speed [m/s]; None in scenes that only approach.
    """

    force: Array
    penetration: Array
    rate: Array
    slip: Array | None = None


def contact_state(normal: np.ndarray, slip: np.ndarray | None = None, transition: float | None = None) -> np.ndarray:
    """What a contact is doing, as codes that count ``STATES``, of the shape of its normal force; ``UNKNOWN`` where NaN.

    Apart: no normal force, because damping lets go in a rebound or for a gap; a smoothed onset bears a little across
    a gap, which the caller takes out. Touching: a force, without friction. With friction: sticking
    where it slides slower than friction's transition speed (these laws creep under load, so nothing ever stands),
    sliding from there on.

    Args:
        normal: normal force [N] of either sign.
        slip, transition: sliding speed and friction's transition speed [m/s]; none without friction.
    """
    state = np.where(normal == 0.0, APART, TOUCHING)
    unknown = np.isnan(normal)
    if slip is not None and transition is not None:
        state = np.where(state == APART, APART, np.where(slip < transition, STICKING, SLIDING))
        unknown = unknown | np.isnan(slip)
    return np.where(unknown, UNKNOWN, state).astype(np.int8)


def coordinates(scene: Scene) -> int:
    """Number of position coordinates."""
    return sum(body.coordinates for body in scene.bodies)


def initial_state(scene: Scene, params: Params) -> Array:
    """State at time 0, shape (2 n + remembering contacts,)."""
    q, v = scene.start(params)
    first = [c.first or c.approach for c in scene.contacts if c.remembers]
    memory = [speed(q, v, params)[None] for speed in first if speed]
    return jnp.concatenate([q, v, *memory])


def normal_force(contact: Contact, penetration: Array, rate: Array, approach: Array | None, params: Params) -> Array:
    """Normal force [N] of a contact from its penetration d [m] and rate d' [m/s], ``laws.onset_force``."""
    coefficients = {name: params[name] for name in contact.law.needs if name != "approach_speed"}
    if approach is not None:
        coefficients["approach_speed"] = approach
    width = params["smoothing"] if contact.smoothed else None
    return onset_force(contact.law, penetration, rate, coefficients, width)


def _approach(contact: Contact, q: Array, v: Array, memory: Array, params: Params) -> Array | None:
    if "approach_speed" not in contact.law.needs:
        return None
    if contact.remembers:
        return memory
    assert contact.approach is not None, f"contact '{contact.name}' has no approach speed for its law"
    return contact.approach(q, v, params)


def field(t: Array, state: Array, args: tuple[Scene, Params]) -> Array:
    """Time derivative of the state: Newton's law for the listed bodies, contacts and loads."""
    del t
    scene, params = args
    n = coordinates(scene)
    q, v, memory = state[:n], state[n : 2 * n], state[2 * n :]
    total, memory_rates, slot = jnp.zeros(n), [], 0
    for load in scene.loads:
        total = total + load.force(params)
    for contact in scene.contacts:
        gap, lift = jax.value_and_grad(contact.gap)(q, params)
        remembered = memory[slot] if contact.remembers else memory
        approach = _approach(contact, q, v, remembered, params)
        total = total + lift * normal_force(contact, -gap, -lift @ v, approach, params)
        if contact.remembers and contact.approach and contact.memory_rate:
            target = contact.approach(q, v, params)
            learning = contact.memory_rate(target, params) * (target - remembered)
            memory_rates.append(jnp.where(gap > 0, learning, 0.0)[None])
            slot += 1
    mass = jnp.concatenate([jnp.full(body.coordinates, params[body.mass]) for body in scene.bodies])
    return jnp.concatenate([v, total / mass, *memory_rates])


def observe(scene: Scene, state: Array, params: Params) -> dict[str, Reading]:
    """Every contact's reading in one state. Forces come from the law, never from interpolation."""
    n = coordinates(scene)
    q, v, memory = state[:n], state[n : 2 * n], state[2 * n :]
    readings, slot = {}, 0
    for contact in scene.contacts:
        gap, lift = jax.value_and_grad(contact.gap)(q, params)
        rate = -lift @ v
        remembered = memory[slot] if contact.remembers else memory
        slot += contact.remembers
        normal = normal_force(contact, -gap, rate, _approach(contact, q, v, remembered, params), params)
        # A law clips NaN to no force; a state that failed must not read as one that is merely apart.
        normal = jnp.where(jnp.isnan(gap + rate), jnp.nan, normal)
        force = jnp.stack([normal, jnp.zeros_like(normal), jnp.zeros_like(normal)])
        readings[contact.name] = Reading(force, -gap, rate)
    return readings


def state_scales(scene: Scene, params: Params) -> Array:
    """Natural size of each state: the penetration and speed of a typical impact.

    Error control in these units is error control of the contact force: a position error of a fraction
    of the penetration is that fraction (times n) of the force, be the body a metre away or in contact.
    """
    mass, speed = scene.impact_scale(params)
    speed = jnp.maximum(speed, 1e-9)
    energy = 0.5 * mass * jnp.square(speed)
    lengths = [_stopping_depth(contact, speed, energy, params) for contact in scene.contacts]
    n, remembered = coordinates(scene), sum(contact.remembers for contact in scene.contacts)
    return jnp.concatenate([jnp.full(n, jnp.min(jnp.stack(lengths))), jnp.full(n + remembered, speed)])


def _stopping_depth(contact: Contact, speed: Array, energy: Array, params: Params) -> Array:
    """Depth at which force times depth is twice the impact's energy, by bisection of its logarithm."""

    def halve(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        depth = jnp.exp(middle)
        force = normal_force(contact, depth, jnp.zeros_like(depth), speed, params)
        enough = force * depth > 2.0 * energy
        return jnp.where(enough, low, middle), jnp.where(enough, middle, high)

    bracket = (jnp.log(jnp.asarray(1e-15)), jnp.log(jnp.asarray(10.0)))
    return jnp.exp(jax.lax.fori_loop(0, 30, halve, bracket)[1])
