"""``hooke``: a cross-shaft (Hooke's, Cardan's) joint, or a double one, at the envelope, torque and angle of the ball-cage joint.

Shaft axes are x, tilted about y by the angle d from one shaft to the next. The pins of the input lie along z, in the plane
of the shafts at time 0. The output turns by b,  tan b = tan a/cos d, while the input turns by a. Of the double joint each
cross bends by half of the angle, the shaft between them turns by b, and the output by a.

A cross is two pins that are one body, each in the bores of a yoke at both of its ends: contacts ``pin_in_bearing``.

Without clearance the loops are closed in closed form: a tree of ideal joints has no loops. Every shaft and cross is led along
its motion, and ``transmission`` hands the torque back from shaft to shaft without loss, so that the input's drive gives what a
joint without clearance takes, save for what speeds the crosses up (1e-6 of the load).

Torque, angle, speed, friction and material are the joint's (``models.joint.defaults``); sizes are GUESSES within its seat of
80 mm; stiffness is Lankarani and Nikravesh's of a pin in its bearing, (4/3) E* sqrt(R_B R_J/(R_B - R_J)).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import PinInBearing
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.vectors import dot
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Action, Load, Moving, Torque
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Params
from bcfj_jax.mechanism.programmes import SHAPES
from bcfj_jax.models.joint.defaults import DEFAULTS as JOINT
from bcfj_jax.models.steel_ball import STEEL_BALL, loaded_turn, picked

_OF_JOINT = ("joint_angle", "drive_speed", "load_torque", "load_ramp")
_INERTIAS = ("inertia_x", "inertia_y", "inertia_z")
_OWN: tuple[tuple[Quantity, float], ...] = tuple((CATALOGUE[name], JOINT[name][0]) for name in _OF_JOINT)
_LINK = (Quantity("shaft_length", "m", "distance of the crosses", 0.0, open_low=True), 0.1)
_PINS: dict[str, float] = {
    **STEEL_BALL, **{name: value for name, (value, _) in JOINT.items()},
    "stiffness": 3.81e11, "smoothing": 0.0, "radius": 8e-3, "half_length": 0.030, "radius_difference": 10e-6,
    "reference_force": 3.81e11 * 2e-5**1.5, "reference_penetration": 2e-5, "bottoming_penetration": 2e-5,
    **{f"clearance_{name}_pins": 10e-6 for name in ("input", "output", "near", "far")},
}  # fmt: skip
_TAKEN = (*_OF_JOINT, "exponent", "damping", "friction_static", "friction_dynamic", "friction_speed")
_CROSSES = [
    f"{name}.{key}" for name in ("cross", "cross_arm", "far_cross", "far_cross_arm") for key in ("mass", *_INERTIAS)
]
_SHAFTS = [
    f"{name}.{key}" for name in ("input", "output", "shaft", "output_yoke", "shaft_yoke") for key in ("mass", "inertia")
]
SOURCES: dict[str, str] = {
    **{name: JOINT[name][1] for name in _TAKEN},
    **dict.fromkeys(_CROSSES, "derived: steel bar of 16 mm by 76 mm, 7801 kg/m^3"),
    **dict.fromkeys(_SHAFTS, "GUESS"),
    **{f"clearance_{name}_pins": "GUESS: as of the joint's balls" for name in ("input", "output", "near", "far")},
    "stiffness": "derived: Lankarani-Nikravesh, pin of 16 mm in its bearing, 10 um",
    "smoothing": "chosen: pins that carry a torque do not rattle",
    "radius": "GUESS: pin of 16 mm",
    "half_length": "GUESS: middle of the bearings; pins end at the seat's 40 mm",
    "shaft_length": "GUESS",
}
# A pin along z (``SOURCES``).
_PIN: dict[str, Any] = {"mass": 0.119, "inertia": (5.9e-5, 5.9e-5, 3.8e-6)}
# What is held on a body with its z along the body's y.
_ACROSS: dict[str, Any] = {"joint": "fixed", "tilt": ("x", lambda p: -0.5 * math.pi)}


def turned(turn: Array, angle: Array) -> Array:
    """Angle of the driven shaft [rad],  tan b = tan a/cos d, over any number of turns."""
    odd = 0.5 * jnp.sin(2.0 * turn) * (1.0 - jnp.cos(angle))
    return turn + jnp.arctan2(odd, jnp.cos(angle) * jnp.cos(turn) ** 2 + jnp.sin(turn) ** 2)


def swung(turn: Array, angle: Array) -> Array:
    """Angle of the cross in the yoke of the shaft that is turned by ``turn`` [rad]: its other pin lies across both shafts."""
    return -jnp.arctan(jnp.tan(angle) * jnp.sin(turn))


@cache
def _bend(double: bool, times: float = 1.0) -> Any:
    """Angle of one cross, or a multiple of it [rad]."""
    return lambda p: (0.5 * times if double else times) * p["joint_angle"]


def _turn(t: Array, p: Params) -> Array:
    return p["drive_speed"] * t


@cache
def _led(double: bool, motion: Any, sign: float = 1.0) -> Drive:
    """A drive along a motion of the input's turn and a cross's angle."""
    bend = _bend(double, sign)
    return Drive("function", function=lambda t, p: motion(_turn(t, p), bend(p)), breaks=())


@cache
def _fastest(double: bool) -> Any:
    """Speed of the shaft after a cross at time 0 [rad/s]."""
    angle = _bend(double)
    return lambda p: p["drive_speed"] / jnp.cos(angle(p))


@cache
def _across(double: bool, sign: float) -> Any:
    """Speed at which a cross swings about its pin along z at time 0 [rad/s]."""
    angle = _bend(double)
    return lambda p: sign * p["drive_speed"] * jnp.tan(angle(p))


def _kept(turn: Array, angle: Array) -> Array:
    """After a second cross the turn is the input's."""
    return turn


@cache
def _transmission(shafts: tuple[str, ...]) -> Load:
    """Torque that each shaft takes for its load and inertia, handed back at equal power to the one before it."""

    def function(t: Array, bodies: Moving, p: Params) -> list[Action]:
        given = p["load_torque"] * SHAPES["smooth"](t / p["load_ramp"])
        found: list[Action] = []
        for name, before in zip(reversed(shafts), reversed(("input", *shafts[:-1])), strict=True):
            part, other = bodies.parts[name], bodies.parts[before]
            way, back = part.axes[0], other.axes[0]
            inertia = sum(p[f"{one}.inertia"] for one in (name, f"{name}_yoke") if one in bodies.parts)
            given = given + inertia * dot(way, part.swirl)
            found.append(Action(name, torque=tuple(given * x for x in way)))
            given = given * dot(way, part.spin) / dot(back, other.spin)
            found.append(Action(before, torque=tuple(-given * x for x in back)))
        return found

    return Load("transmission", function, ("input", *shafts), breaks=())


def _bodies(double: bool, ideal: bool) -> list[Body]:
    """Shafts with bores along z, their yokes with bores along y, crosses as two pins that are one body."""
    angle, whole = _bend(double), _bend(double, 2.0 if double else 1.0)

    def shaft(name: str, tilt: Any, motion: Any, speed: Any, **at: Any) -> list[Body]:
        led = {"drive": _led(double, motion)} if ideal else {"start": {"speed": speed}}
        return [
            Body(name, "hinge", axis="x", tilt=("y", tilt), mass=1.0, inertia=JOINT["head_inertia"][0], **led, **at)
        ]

    def yoke(name: str) -> list[Body]:
        return [Body(f"{name}_yoke", parent=name, mass=0.5, inertia=1e-4, **_ACROSS)]

    def cross(name: str, parent: str, sign: float, **free: Any) -> list[Body]:
        led = {"joint": "hinge", "parent": parent, "drive": _led(double, swung, sign)}
        free["start"] = {"wx": "drive_speed", "wz": _across(double, -sign)}
        return [Body(name, **(led if ideal else free), **_PIN), Body(f"{name}_arm", parent=name, **_ACROSS, **_PIN)]

    drive = Drive("constant", speed="drive_speed")
    found = [Body("input", "hinge", axis="x", mass=1.0, inertia=1e-3, drive=drive), *cross("cross", "input", 1.0)]
    if not double:
        return [*found, *shaft("output", whole, turned, _fastest(double)), *yoke("output")]
    at = (lambda p: p["shaft_length"] * jnp.cos(angle(p)), 0, lambda p: -p["shaft_length"] * jnp.sin(angle(p)))
    found += [*shaft("shaft", angle, turned, _fastest(double)), *yoke("shaft")]
    found += shaft("output", whole, _kept, "drive_speed", at=at)
    return [*found, *cross("far_cross", "output", -1.0, at=at, tilt=("y", whole))]


def hooke(
    double: bool = False,
    ideal: bool = False,
    law: str = "memory_free",
    elastic: str | None = None,
    smoothing: bool = True,
    friction: bool | str = True,
) -> Mechanism:
    """Cross-shaft joint: the input turns at constant speed, a torque resists the output; pins play in the yokes' bores.

    The contacts are ``input_pins`` and ``output_pins``, of the double joint ``near_pins`` and ``far_pins`` of the shaft between
    as well, each with two members, the ends of a pin; the force that is read acts on the cross.
    At time 0 pins are in the middle of their bearings with the velocities of a joint without clearance, and nothing loads it.

    Args:
        double: two crosses at half the angle each, with a shaft between them.
        ideal: without clearance: all is led along its motion, and there is no contact.
        law, elastic, smoothing: as ``impact``.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
    """
    between = {"input": ("input", "cross"), "output": ("output_yoke", "cross_arm")}
    if double:
        between |= {"near": ("shaft_yoke", "cross_arm"), "far": ("shaft_yoke", "far_cross_arm")}
        between["output"] = ("output", "far_cross")
    how: dict[str, Any] = {"law": law, "elastic": elastic, "friction": friction, "smoothing": smoothing}
    far = {"far": (("shaft_length", 0, 0), (0, 0, 0))}
    pins = [
        Contact(f"{name}_pins", pair, PinInBearing(ends=True), at=far.get(name, ((0, 0, 0), (0, 0, 0))), **how)
        for name, pair in between.items()
    ]
    loads: list[Any] = [Torque("load", "output", "-x", "load_torque", ramp="load_ramp", follows=True)]
    if ideal:
        pins, loads = [], [*loads, _transmission(("shaft", "output") if double else ("output",))]
    reads = [*pins[0].reads, *(f"clearance_{pin.name}" for pin in pins)] if pins else []
    own = (*_OWN, _LINK) if double else _OWN
    return Mechanism(
        "hooke", _bodies(double, ideal), pins, loads, own, picked(_PINS, reads), end=loaded_turn, samples=2001,
        implicit=None if ideal else True,
    )  # fmt: skip
