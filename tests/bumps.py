"""A chaotic scene for tests: a ball bouncing without loss on a floor of bumps, which defocus it."""

from __future__ import annotations

import jax.numpy as jnp

from bcfj_jax.contact.gaps import from_depth
from bcfj_jax.core.quantities import CATALOGUE
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Gravity
from bcfj_jax.mechanism.mechanism import Mechanism


def _depth(place, c):
    del c
    return 0.02 * jnp.cos(20.0 * place[0]) - place[1]


def bumps() -> Mechanism:
    """Bumps of 20 mm, 0.3 m apart, under a drop of 0.3 m."""
    ball = Body("body", "particle", mass="mass", start={"x": 0.013, "y": "drop_height"})
    floor = Contact("contact", ("ground", "body"), from_depth(_depth), law="hertz", smoothing=False)
    given = {"stiffness": 1e5, "exponent": 1.5, "mass": 0.02, "gravity": 9.81, "drop_height": 0.3}
    return Mechanism(
        "bumps", (ball,), (floor,), (Gravity("-y"),), own=(CATALOGUE["drop_height"],), given=given, end=8.0
    )
