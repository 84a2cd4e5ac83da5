"""From a scene and its parameters to an ODE, and from a state to what an instrument would read.

The state is one flat array: positions, velocities, then one remembered approach speed for each contact
that has one. Contacts act along the gradient of their gap (virtual work), so a scene states geometry
once and gets rates and force directions from it.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from bcfj_jax.contact.laws import onset_force
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import positive, smooth_ramp
from bcfj_jax.mechanism.model import Params, Reading
from bcfj_jax.mechanism.scene import Contact, Scene

# Contacts until the end of a run whose errors, all of one sign at worst, the tolerance already allows for.
_MANY = 5.0
# A flight of so many contacts' length shifts a force by no more than the tolerance allows for.
_RARE = 10.0


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
    width = params["smoothing"] if contact.smoothed else None
    return onset_force(contact.law, penetration, rate, _coefficients(contact, approach, params), width)


def _coefficients(contact: Contact, approach: Array | None, params: Params) -> dict[str, Array]:
    own = {name: params[name] for name in contact.law.needs if name != "approach_speed"}
    return own if approach is None else own | {"approach_speed": approach}


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
            # Within a smoothed onset there is a force: that is no flight.
            free = gap > (params["smoothing"] if contact.smoothed else 0.0)
            memory_rates.append(jnp.where(free, learning, 0.0)[None])
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
    A body that starts inside an onset is thrown out of it: what is stored there counts as well.
    """
    mass, speed = scene.impact_scale(params)
    q, _ = scene.start(params)
    stored = [_stored(contact, q, params) for contact in scene.contacts]
    energy = 0.5 * mass * jnp.square(jnp.maximum(speed, 1e-9)) + jnp.sum(jnp.stack(stored))
    speed = jnp.sqrt(2.0 * energy / mass)
    lengths = [_stopping_depth(contact, speed, energy, params) for contact in scene.contacts]
    n, remembered = coordinates(scene), sum(contact.remembers for contact in scene.contacts)
    return jnp.concatenate([jnp.full(n, jnp.min(jnp.stack(lengths))), jnp.full(n + remembered, speed)])


def error_sizes(scene: Scene, params: Params, end: Array) -> Array:
    """What a step's error is measured in: ``state_scales``, less where contacts are many until ``end`` [s], or rare.

    For an infinite end: ``state_scales``.

    Every rebound adds its error to the speed, and to the energy: twice the contacts ask for half of it. A speed that is
    wrong shifts the next touch by that part of a flight, and a force that lasts a thousandth of it is gone: errors go
    as flight over contact (benchmarks/solve/levels.py: to the power 0.99).
    """
    sizes = state_scales(scene, params)
    if scene.flight is None:
        return sizes
    flight = scene.flight(params)
    finer = jnp.minimum(1.0, _MANY * flight / end) * jnp.minimum(1.0, _RARE * contact_time(sizes) / flight)
    return sizes * jnp.where(jnp.isinf(end), 1.0, finer)


def contact_time(sizes: Array) -> Array:
    """Duration [s] of an undamped contact, some three times its depth over its speed, from ``state_scales``."""
    return 3.0 * sizes[0] / sizes[-1]


def check_start(scene: Scene, params: Params, where: str = "") -> None:
    """Refuse a body that a smoothed onset throws out, under a law whose damping goes by the approach speed.

    Such a law is rigid to a body that leaves at more than the speed it is told of. Batched and traced values pass.

    Raises:
        InputError: naming the smoothing, and what would be right.
    """
    if not any(contact.smoothed and "approach_speed" in contact.law.needs for contact in scene.contacts):
        return
    if any(isinstance(value, Tracer) or np.ndim(value) for value in params.values()):
        return
    width = float(params["smoothing"])
    for gap, thrown in _starts(scene, dict(params)) if width > 0.0 else ():
        if thrown:
            found = f"an onset of {width:g} m throws out the body, which starts {float(gap):g} m away"
            remedy = "give less smoothing, a start further away, or a law without restitution (memory_free)"
            raise InputError((where or f"scene '{scene.kind}'") + " smoothing", found, remedy)


def place(scene: Scene, params: Params, times: np.ndarray) -> dict[str, float]:
    """``AbstractModel.envelope``'s numbers."""
    p = {name: float(value) for name, value in params.items()}
    sizes = state_scales(scene, params)
    depth, speed, contact = float(sizes[0]), float(sizes[-1]), float(contact_time(sizes))
    found = {"onset": p.get("smoothing", 0.0) / depth, "loss": _loss(p, depth, speed)}
    if "exponent" in p:
        found["exponent"] = p["exponent"]
    if scene.flight is not None:
        flight = float(scene.flight(params))
        found |= {"flights": float(times[-1]) / flight, "rarity": flight / contact}
    else:
        found["durations"] = float(times[-1]) / contact
    return found


def _loss(p: dict[str, float], depth: float, speed: float) -> float:
    if "restitution" in p:
        return 1.0 - p["restitution"]
    if "dashpot" in p:
        return p["dashpot"] * depth / (p["mass"] * speed)
    return p.get("damping", 0.0) * speed


@partial(jax.jit, static_argnums=0)
def _starts(scene: Scene, params: Params) -> list[tuple[Array, Array]]:
    """Gap [m] at the start, and whether more is stored there than the approach brings, of each contact that has one."""
    q, v = scene.start(params)
    found = []
    for contact in scene.contacts:
        first = contact.first or contact.approach
        if contact.smoothed and first:
            brought = 0.5 * scene.impact_scale(params)[0] * jnp.square(first(q, v, params))
            found.append((contact.gap(q, params), _stored(contact, q, params) > brought))
    return found


def _stored(contact: Contact, q: Array, params: Params) -> Array:
    """Energy [J] of a contact with a body at rest at q, to a factor of n + 1: force times depth, of its onset's."""
    depth = positive(-contact.gap(q, params))
    if contact.smoothed:
        depth, _ = smooth_ramp(-contact.gap(q, params), params["smoothing"])
    # At rest no approach speed counts.
    at_rest = _coefficients(contact, jnp.ones_like(depth), params)
    return contact.law.force(depth, jnp.zeros_like(depth), at_rest) * depth


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
