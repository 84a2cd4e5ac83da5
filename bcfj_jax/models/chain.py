"""``chain``: spheres in a row, the first of which strikes the rest. Newton's cradle without gravity.

Numbers: siconos' example ChainOfBalls (physics sheet, B3): 10 steel balls of radius 10 mm, 7780 kg/m^3, E = 203 GPa,
nu = 0.3, the first at 1 m/s; elastic. Mass and Hertz's stiffness, (4/3) E* sqrt(R/2), follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import SphereOnSphere
from bcfj_jax.core import limits
from bcfj_jax.core.quantities import whole
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.steel_ball import STEEL_BALL, picked, touching

_BALL = {
    **STEEL_BALL, "radius": 0.01, "mass": 7780.0 * 4.0 / 3.0 * math.pi * 0.01**3,
    "stiffness": 4.0 / 3.0 * 203e9 / (2.0 * (1.0 - 0.3**2)) * math.sqrt(0.005), "approach_speed": 1.0,
}  # fmt: skip


def chain(count: int = 10, law: str = "hertz", elastic: str | None = None, smoothing: bool = True) -> Mechanism:
    """``count`` equal spheres along x that touch without load: ``sphere_1``, which moves at ``approach_speed``, and so on.

    ``contact_i`` lies between the spheres i and i + 1; its force acts on the latter, and its normal is towards the former.

    Args:
        count: number of spheres, 2 or more.
        law, elastic, smoothing: as ``impact``.
    """
    count = whole("scene 'chain' count", count, least=2, most=limits.MEMBERS)
    spheres, contacts = [], []
    for i in range(1, count + 1):
        start = {"velocity": "approach_speed"} if i == 1 else {}
        spheres.append(Body(f"sphere_{i}", "slide", at=(_place(i), 0, 0), axis="x", mass="mass", start=start))
    for i in range(1, count):
        between, radii = (f"sphere_{i}", f"sphere_{i + 1}"), {"radius_a": "radius", "radius_b": "radius"}
        # A law stated by restitution has the first sphere's speed: all but the last are struck at nearly it.
        contacts.append(
            Contact(f"contact_{i}", between, SphereOnSphere(), law, elastic=elastic, smoothing=smoothing, values=radii,
                    approach="parameter")
        )  # fmt: skip
    given = picked(_BALL, [*contacts[0].reads, "radius", "mass", "approach_speed"])
    return Mechanism("chain", spheres, contacts, given=given, end=_passed(count), samples=2001)


@cache
def _place(i: int) -> Callable[[Params], Array]:
    """Of the i-th sphere at time 0 [m]."""
    return lambda p: 2.0 * (i - 1) * p["radius"]


@cache
def _passed(count: int) -> Callable[[Params], Array]:
    """Somewhat longer than a blow takes through the row, half of a contact from sphere to sphere [s]."""

    def end(p: Params) -> Array:
        speed = jnp.maximum(p["approach_speed"], 1e-6)
        return (0.6 * count + 0.4) * touching(_BALL, p, 0.5 * p["mass"], speed)

    return end
