"""``slider_crank``: a planar slider-crank whose rod meets the slider in a revolute joint with clearance.

Numbers: Flores and Ambrosio, "Revolute joints with clearance in multibody systems", Computers and Structures 82 (2004)
1359 (physics sheet, B6): crank 50 mm, 0.30 kg, 1.0e-4 kg m^2; rod 120 mm, 0.21 kg, 2.5e-4 kg m^2; slider 0.14 kg;
bearing of radius 10 mm, journal of 9.5 mm, steel, 5000 r/min, restitution 0.9, no friction. Stiffness is Lankarani and
Nikravesh's for these radii. The damping (restitution 0.9 at 0.5 m/s) is a GUESS: the paper's law goes by restitution.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import PinInBearing
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.models.steel_ball import STEEL_BALL, half, picked

SIZES = {"crank_length": 0.05, "rod_length": 0.12, "crank_speed": 5000.0 * 2.0 * math.pi / 60.0}
_OWN = (
    (Quantity("crank_length", "m", "distance of the crank's pins", 0.0, open_low=True), SIZES["crank_length"]),
    (Quantity("rod_length", "m", "distance of the rod's pins", 0.0, open_low=True), SIZES["rod_length"]),
    (Quantity("crank_speed", "rad/s", "speed of the crank"), SIZES["crank_speed"]),
)
# Of a steel journal in a steel bearing, (4/3) E* sqrt(R_B R_J/(R_B - R_J)), E = 207 GPa, nu = 0.3.
_STEEL = {
    **STEEL_BALL, "stiffness": 6.61e10, "damping": 0.333, "bottoming_damping": 0.333, "clearance_journal": 0.5e-3,
    "radius": 9.5e-3, "effective_modulus": 113.7e9, "contact_length": 20e-3, "radius_difference": 0.5e-3,
    "reference_force": 6.61e10 * 2e-5**1.5, "friction_static": 0.1, "friction_dynamic": 0.05, "friction_speed": 0.1,
}  # fmt: skip


def _turns(p: Any) -> Array:
    """Time of one turn [s]."""
    return 2.0 * jnp.pi / jnp.abs(p["crank_speed"])


def _outmost(p: Any) -> Array:
    return p["crank_length"] + p["rod_length"]


def _fold(p: Any) -> Array:
    """Speed of the rod against the crank in line [rad/s]: it turns back by the ratio of the lengths."""
    return -p["crank_speed"] * (1.0 + p["crank_length"] / p["rod_length"])


def _rod_angle(t: Array, p: Any) -> Array:
    """Angle of the ideal rod against the crank [rad]: the slider stays on the axis."""
    turn = p["crank_speed"] * t
    return -jnp.arcsin(p["crank_length"] / p["rod_length"] * jnp.sin(turn)) - turn


def _slider_place(t: Array, p: Any) -> Array:
    """Place of the ideal slider [m]."""
    turn, ratio = p["crank_speed"] * t, p["crank_length"] / p["rod_length"]
    return p["crank_length"] * jnp.cos(turn) + p["rod_length"] * jnp.sqrt(1.0 - (ratio * jnp.sin(turn)) ** 2)


def slider_crank(
    law: str = "memory_free",
    elastic: str | None = None,
    smoothing: bool = True,
    friction: bool | str = False,
    ideal: bool = False,
) -> Mechanism:
    """Crank driven at constant speed about z, rod on the crank, slider along x; the rod's pin plays in the slider.

    Starts with all pins in line along x, the ideal velocities, the journal in the middle of its bearing. The contact is
    ``journal``; the force that is read acts on the rod: normal along the eccentricity, tangential across it in the plane.
    Turns are read from ``crank.angle``, the drive's torque from ``crank.torque``.

    Args:
        law, elastic, smoothing: as ``impact``.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
        ideal: without clearance: rod and slider move as the crank's turn says, and there is no contact.
    """
    crank = Body("crank", "hinge", mass=0.30, inertia=1.0e-4, drive=Drive("constant", speed="crank_speed"))
    rod: dict[str, Any] = {"parent": "crank", "at": ("crank_length", 0, 0), "mass": 0.21, "inertia": 2.5e-4}
    rod["center"] = half("rod_length")
    more: list[dict[str, Any]]
    if ideal:
        more = [{"drive": Drive("function", function=motion, breaks=())} for motion in (_rod_angle, _slider_place)]
    else:
        more = [{"start": {"speed": _fold}}, {"start": {"position": _outmost}}]
    parts = (crank, Body("rod", "hinge", **rod, **more[0]), Body("slider", "slide", axis="x", mass=0.14, **more[1]))
    if ideal:
        return Mechanism("slider_crank", parts, own=_OWN, end=_turns, samples=2001)
    journal = Contact(
        "journal", ("slider", "rod"), PinInBearing(), law=law, elastic=elastic, friction=friction, smoothing=smoothing,
        at=((0, 0, 0), ("rod_length", 0, 0)),
    )  # fmt: skip
    given = picked(_STEEL, ["stiffness", *journal.reads, "clearance_journal"])
    return Mechanism("slider_crank", parts, (journal,), own=_OWN, given=given, end=_turns, samples=4001)
