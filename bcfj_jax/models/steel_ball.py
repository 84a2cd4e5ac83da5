"""Numbers of the ball of ``impact``, ``bounce`` and others: the BCFJ's 16 mm steel ball meeting a flat steel face.

E = 207 GPa and nu = 0.29 are the paper's; the ball's size is the group's published key size; mass and stiffness follow
from them (physics sheet 1.4: ball on flat window 1.3476e10 N/m^1.5). The damping is a GUESS (restitution 0.9 at 1.5 m/s),
as it is nowhere stated; so are the coefficients of friction's transition, of a stop behind a layer, of relaxation and of
yielding.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.restitution import undamped_duration
from bcfj_jax.mechanism.model import Params

STEEL_BALL: dict[str, float] = {
    "stiffness": 1.3476e10,
    "exponent": 1.5,
    "reference_force": 1.3476e10 * 2e-5**1.5,
    "reference_penetration": 2e-5,
    "bottoming_stiffness": 1e9,
    "bottoming_penetration": 2e-5,
    "bottoming_width": 2e-6,
    "bottoming_damping": 0.111,
    "effective_modulus": 113.0e9,
    "contact_length": 16e-3,
    "radius": 8e-3,
    "radius_difference": 50e-6,
    "damping": 0.111,
    "restitution": 0.9,
    "dashpot": 100.0,
    "damping_depth": 1e-4,
    "relaxation": 0.1,
    "relaxation_time": 1e-5,
    "yield_penetration": 5e-6,
    "smoothing": 0.0,
    "mass": 0.016731,
    "friction_static": 0.12,
    "friction_dynamic": 0.03,
    "friction_speed": 0.01,
    "bristle_stiffness": 1e5,
    "bristle_damping": 1.0,
    "friction_memory": 5e-3,
    "friction_viscous": 0.1,
}

SOURCES = {
    "damping": "GUESS, nowhere stated: gives e = 0.9 at 1.5 m/s",
    "friction_memory": "GUESS: 3 to 9 ms in a lubricated line contact (Hess and Soom 1990)",
    "friction_viscous": "GUESS: of a lubricant film",
}


def picked(values: Mapping[str, float], names: Iterable[str]) -> dict[str, float]:
    """Those of the values that are read."""
    wanted = set(names)
    return {name: value for name, value in values.items() if name in wanted}


def loaded_turn(p: Params) -> Array:
    """A turn after the load has risen [s]."""
    return p["load_ramp"] + 2.0 * jnp.pi / jnp.maximum(jnp.abs(p["drive_speed"]), 1e-3)


@cache
def half(length: str, sign: float = 1.0) -> Any:
    """Place of a rod's end from its middle, or of its middle from its end, by the name of its length."""
    return (lambda p: 0.5 * sign * p[length], 0, 0)


def arriving(values: Mapping[str, float], p: Params, mass: Array, speed: Array) -> Array:
    """Time of a flight across ``clearance_contact`` at a speed [m/s], and of one and a half undamped contacts [s]."""
    speed = jnp.maximum(speed, 1e-6)
    return p["clearance_contact"] / speed + 1.5 * touching(values, p, mass, speed)


def touching(values: Mapping[str, float], p: Params, mass: Array, speed: Array) -> Array:
    """Time of an undamped contact [s]; a scene without K d^n gets the stiffness of the values."""
    stiffness = p["stiffness"] if "stiffness" in p else jnp.asarray(values["stiffness"])
    exponent = p["exponent"] if "exponent" in p else jnp.asarray(1.0)
    return undamped_duration(stiffness, exponent, mass, speed)
