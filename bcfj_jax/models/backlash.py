"""``backlash``: two bodies on one line with play between them, a stop on either side.

Law and numbers: the mass between two ElastoGap of Modelica.Mechanics.Translational.Examples.ElastoGap (Modelica Standard
Library 4.0; physics sheet 1.2): 1 kg, 10 N/m, 1.5 N s/m, stops 0.5 m to either side. There walls hold the stops; here a
body of its own, the driver. Its mass, its motion (driven) and the follower's speed (free) are GUESSES.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import TwoSidedStop
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.models.steel_ball import STEEL_BALL, picked

_AMPLITUDE = (Quantity("drive_amplitude", "m", "amplitude of the driver's motion"), 1.0)
_FREQUENCY = (Quantity("drive_frequency", "rad/s", "angular frequency of the driver's motion"), 2.0)
_SPEED = (Quantity("follower_speed", "m/s", "speed of the follower at time 0"), 1.0)
_STOP = {
    **STEEL_BALL, "mass": 1.0, "stiffness": 10.0, "exponent": 1.0, "dashpot": 1.5, "clearance_stop": 0.5,
    "reference_force": 10.0, "reference_penetration": 1.0, "bottoming_stiffness": 1e3, "bottoming_penetration": 0.2,
    "bottoming_width": 0.02, "relaxation_time": 0.1, "yield_penetration": 0.2,
}  # fmt: skip


def _swing(t: Array, p: Any) -> Array:
    """Place of the driver [m]."""
    return p["drive_amplitude"] * jnp.sin(p["drive_frequency"] * t)


def backlash(
    law: str = "elasto_gap", elastic: str | None = None, smoothing: bool = True, driven: bool = True
) -> Mechanism:
    """A ``driver`` carries two stops and a ``follower`` between them, ``clearance_stop`` to either side; both along x.

    Starts with the follower in the middle. The contact is ``stop``; its force acts on the follower, and its normal is
    signed: positive while the follower presses the stop ahead, at +x. The follower's place is in world axes.

    Args:
        law, elastic, smoothing: as ``impact``; ``elasto_gap`` is Modelica's, and has corners.
        driven: the driver swings as  amplitude sin(frequency t)  and the follower starts at rest; else both are free, the
            driver starts at rest and the follower at its own speed.
    """
    swing = Drive("function", function=_swing, breaks=()) if driven else None
    driver = Body("driver", "slide", axis="x", mass=1.0, drive=swing)
    follower = Body("follower", "slide", axis="x", mass="mass", start={"velocity": "follower_speed"})
    stop = Contact("stop", ("driver", "follower"), TwoSidedStop("x"), law, elastic=elastic, smoothing=smoothing)
    own = (_AMPLITUDE, _FREQUENCY, (_SPEED[0], 0.0)) if driven else (_SPEED,)
    given = picked(_STOP, [*stop.reads, "mass", "clearance_stop"])
    return Mechanism("backlash", (driver, follower), (stop,), own=own, given=given, end=10.0, samples=2001)
