"""Random scenes within the ranges that engineers use, for levels of accuracy to be derived on and tried on.

``springs`` draws parameters of ``impact`` and ``bounce`` as arrays over runs, ``joints`` whole dynamic joints. The box
of the extremes is wider: ``extremes_box``.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from bcfj_jax import AbstractModel, InputError, scenes
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.checks import check_joint
from bcfj_jax.models.joint.scene import OF_A_BALL, Joint

LAWS = ("memory_free", "exact", "kelvin_voigt", "adams_impact")
# A joint's ranges around the defaults: those that ``joint/defaults.py`` calls usual, where it does.
BY_DECADES = {
    "drive_speed": (50 * math.tau / 60, 300 * math.tau / 60),
    "load_torque": (300.0, 3000.0),
    "load_ramp": (0.02, 0.2),
    "friction_static": (0.05, 0.2),
    "friction_speed": (0.05, 0.3),
    "stiffness": (2e10, 7e10),
    "damping": (0.05, 0.5),
}
EVENLY = {
    "joint_angle": (math.radians(3), math.radians(30)),
    "contact_angle": (math.radians(35), math.radians(45)),
    "offset": (0.08 * 0.0355, 0.14 * 0.0355),
    "clearance_seat_cage": (20e-6, 100e-6),
    "clearance_head_cage": (20e-6, 100e-6),
    "clearance_cage_ball": (0.0, 40e-6),
    "clearance_seat_ball": (10e-6, 60e-6),
    "clearance_head_ball": (10e-6, 60e-6),
    "axial_load": (0.0, 1000.0),
}


def springs(kind: str, law: str, count: int, seed: int, wide: bool = False) -> tuple[AbstractModel, Params, np.ndarray]:
    """A scene of a law, ``count`` random parameter sets (each (count,)), and their end times [s] (count,).

    Masses of 1 g to 10 kg at 1 cm/s to 10 m/s, contacts of 1 um to 1 mm depth with exponents 1 to 2.5, losses from
    none to some 80 % of the speed, onsets sharp or up to a tenth of the depth wide. Bounces are from 5 cm/s to 3 m/s,
    for 1 to 10 first flights, each 30 to 3000 times as long as its contact. ``wide`` goes on to exponents of 3, twenty
    times the loss, onsets of 3 depths, 40 flights and contacts ten times as short.
    """
    rng = np.random.default_rng([seed, LAWS.index(law), kind == "bounce", wide])
    scene = getattr(scenes, kind)(law=law)

    def decades(low: float, high: float) -> np.ndarray:
        return np.exp(rng.uniform(math.log(low), math.log(high), count))

    mass, speed, depth = decades(1e-3, 10.0), decades(1e-2, 10.0), decades(1e-6, 1e-3)
    if kind == "bounce":
        # A contact takes some 3 d/v, a flight 2 v/g.
        speed = decades(0.05, 3.0)
        depth = speed**2 / (1.5 * 9.81 * decades(30.0, 3e4 if wide else 3e3))
    exponent = np.ones(count) if law == "kelvin_voigt" else rng.uniform(1.0, 3.0 if wide else 2.5, count)
    stiffness = (exponent + 1.0) * mass * speed**2 / (2.0 * depth ** (exponent + 1.0))
    loss = rng.uniform(0.0, 0.8, count)
    strong = loss * decades(1.0, 20.0) if wide else loss
    onset = decades(0.01, 3.0) if wide else rng.uniform(0.0, 0.1, count)
    flights = decades(1.0, 40.0) if wide else rng.uniform(1.0, 10.0, count)
    values = {
        "mass": mass,
        "stiffness": stiffness,
        "exponent": exponent,
        "restitution": 1.0 - loss,
        "damping": strong / speed,
        "dashpot": strong * mass * speed / depth,
        "damping_depth": depth * rng.uniform(0.01, 0.5, count),
        "smoothing": depth * onset * (rng.random(count) < 0.5),
        "approach_speed": speed,
        "clearance_contact": depth * rng.uniform(0.2, 5.0, count),
        "drop_height": speed**2 / (2 * 9.81),
    }
    base = scene.parameters()
    params = {name: jnp.asarray(values.get(name, np.full(count, float(base[name])))) for name in base}
    if kind == "bounce":
        return scene, params, 2.0 * speed / 9.81 * flights
    return scene, params, np.asarray(scene.horizon(params))


def joint(rng: np.random.Generator, friction: float = 1.0, scene: Joint | None = None) -> Params:
    """A random joint that can be built, of the default scene or another; ``friction`` is a factor on both coefficients."""
    scene = scene or scenes.joint()
    while True:
        values = {name: float(np.exp(rng.uniform(*np.log(ends)))) for name, ends in BY_DECADES.items()}
        values |= {name: float(rng.uniform(*ends)) for name, ends in EVENLY.items()}
        values["friction_static"] *= friction
        values["friction_dynamic"] = values["friction_static"] * float(rng.uniform(0.25, 1.0))
        params = scene.parameters(values)
        try:
            check_joint(scene, params)
        except InputError:
            continue
        return params


def joints(count: int, seed: int, wide: bool = False, scene: Joint | None = None) -> list[Params]:
    """Random joints, the first of many those of few.

    Their balls have less play than the onset of contact is wide, as the defaults' have: else balls that carry nothing
    rattle without order, and there is no true history. ``wide`` leaves their play as it was drawn.
    """
    rng, found = np.random.default_rng([seed, int(wide)]), []
    for _ in range(count):
        params = joint(rng, scene=scene)
        if wide:
            found.append(params)
            continue
        calm = {f"clearance_{name}": params["smoothing"] * rng.uniform(0.1, 0.6) for name in OF_A_BALL[:3]}
        found.append({**params, **calm})
    return found
