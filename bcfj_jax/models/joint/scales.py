"""Natural sizes of the joint's states, and the tolerance in these units that a force error asks for."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.numerics import smooth_ramp
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.constants import laws_of
from bcfj_jax.models.joint.scene import GROOVES, PILOTS, Joint, flat
from bcfj_jax.xla.programs import ask

# Load of a ball that nothing loads [N].
LEAST = 1e-2
# How much finer than others the prescribed turn and speed of a seat are integrated.
TOLD = 1e-4


def scales(scene: Joint, params: Params, end: ArrayLike = jnp.inf) -> Array:
    """Size of each state: a place by the penetration of a ball that carries its share of the load, a velocity by
    friction's transition speed; turns, the cage's azimuth among them, by these over the pitch radius, a ball's spin by that
    over its own; a friction's state by ``AbstractFriction.reach``.

    The load is the greatest until ``end`` [s]: torque, axial load and centrifugal force. A run that ends while the
    torque still rises has no other peak to compare with. Where the contact is regularised, the penetration r(d) over its
    slope dr/dd stands for it, which is how far d may move until r has changed by itself.

    An error of a place in these units is about that fraction (times n) of a ball's force. An error of a
    velocity is that fraction of the friction of a creeping contact. Without friction a quarter of the rim speed
    stands in: only damping reads velocities then.
    """
    p = params
    torque, axial = scene.programmes.largest_torque(p, end), scene.programmes.largest_axial(p)
    load = torque / (scene.balls * p["pitch_radius"]) + axial / scene.balls
    load = load + p["ball_mass"] * p["pitch_radius"] * p["drive_speed"] ** 2 + LEAST
    laws = laws_of(scene, p, "seat_ball")
    width = jnp.zeros(()) if laws.smoothing is None else laws.smoothing
    depth, slope = smooth_ramp(jnp.logspace(-11, -2, 91) - width, width)
    force = laws.law.force(depth, jnp.zeros(91), {k: jnp.broadcast_to(v, (91,)) for k, v in laws.coefficients.items()})
    place = jnp.minimum(jnp.interp(load, force, depth / slope), 1e-3)
    speeds = [
        scene.coefficient(p, x.name, "friction_speed") * x.friction.span
        for x in scene.contacts
        if x.friction is not None
    ]
    speed = jnp.min(jnp.stack(speeds)) if speeds else 0.25 * jnp.abs(p["drive_speed"]) * p["pitch_radius"] + 1e-3
    turning = np.zeros(scene.coupling, bool)
    for name, piece in scene.slices.items():
        if piece is not None and name.endswith("turn"):
            turning[piece] = True
    coupling = jnp.where(turning, 1.0 / p["pitch_radius"], 1.0)
    # A prescribed seat must turn as it is told: what steps across a kink of its speed err by stays for ever.
    coupling = coupling.at[-1].multiply(TOLD) if scene.driven else coupling
    ball = jnp.ones((scene.balls, scene.twist)).at[:, 3:].set(1.0 / p["ball_radius"])
    parts = [jnp.full(3 * scene.balls, place), place * coupling, speed * ball.ravel(), speed * coupling]
    if scene.bristles:
        width = scene.width
        reach = {name: jnp.full((1, count, width), _reach(scene, p, name)) for name, count in scene.bristles.items()}
        balls = {name: jnp.tile(x, (scene.balls, 1, 1)) for name, x in reach.items() if name not in PILOTS}
        parts.append(flat(reach | balls))
    if scene.azimuth is not None:
        parts.append((place / p["pitch_radius"])[None])
    return jnp.concatenate(parts)


def _reach(scene: Joint, params: Params, name: str) -> Array:
    """Size of a contact's friction state [m], [m/s]."""
    friction = scene.contact(name).friction
    assert friction is not None
    return friction.reach({key: scene.coefficient(params, name, key) for key in friction.needs})


def tolerance(scene: Joint, force_error: float) -> float:
    """Local error per step in units of ``scales``: twice the force error, at most 0.02; of balls that roll a fifth of it
    below 0.05 %, of others five times it from there on.

    Derived by ``benchmarks/solve/levels.py`` on random joints: from a pitch after the load has risen rms, peak and impulse of
    every contact are then as right as was asked. Looser than 0.02 saves next to no steps: contacts that begin and end
    set them, and steps that jump into one are rejected.
    """
    if force_error >= 5e-4:
        return min(0.02, (2.0 if scene.spin else 5.0) * force_error)
    return (0.2 if scene.spin else 2.0) * force_error


def envelope_place(scene: Joint, params: Params) -> dict[str, float]:
    """How far it is from the joints on which its promised error was measured (``analysis.envelope``).

    Numbers by name; the worst contact counts, and what the joint has not is left out.
    """
    p = {name: float(value) for name, value in params.items()}
    speed, radius = abs(p["drive_speed"]), p["pitch_radius"]
    load = abs(p["load_torque"]) / (scene.balls * radius)
    rubbing = [x.name for x in scene.contacts if x.friction is not None]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.float64(speed * radius * np.sin(p["joint_angle"]))
        found = {
            "angle": p["joint_angle"],
            "centrifugal": float(np.float64(p["ball_mass"] * radius * speed**2) / load),
            "axial": float(np.float64(abs(p["axial_load"]) / scene.balls) / load),
            **{name: _worst(scene, params, name) for name in ("exponent", "damping") if name in p},
        }
        if rubbing:
            slowest = min(float(scene.coefficient(params, name, "friction_speed")) for name in rubbing)
            found |= {"friction": _worst(scene, params, "friction_static"), "sliding": float(along / slowest)}
        if scene.smoothing:
            place = float(ask("joint's place", _place, (scene,), (dict(params),)))
            found["onset_under_load"] = _worst(scene, params, "smoothing") / place
            # Between the ends of its window a ball swings freely: that is no play.
            for what, names in (("play", (*GROOVES, "cage_ball")), ("knock", scene.pilots)):
                ratios = [
                    np.float64(p[f"clearance_{name}"]) / float(scene.coefficient(params, name, "smoothing"))
                    for name in names
                    if scene.has(name)
                ]
                found |= {what: float(max(ratios))} if ratios else {}
    return found


def _place(scene: Joint, params: Params) -> Array:
    return scales(scene, params)[0]


def _worst(scene: Joint, params: Params, name: str) -> float:
    """The largest value of a coefficient over the contacts that read it; every one reads its smoothing."""
    readers = [x.name for x in scene.contacts if name in (*x.own, "smoothing")]
    return max(float(scene.coefficient(params, contact, name)) for contact in readers)
