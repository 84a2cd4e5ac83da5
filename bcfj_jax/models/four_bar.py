"""``four_bar``: a four-bar linkage with clearance in three of its joints, its crank led along a path by a controller.

Numbers and controller: siconos' example FourBarLinkageWith3clearance (physics sheet, B5): ground link 3 m, uniform rods of
1, 4 and 2.5 m, 1 kg each, pins of 55 mm in bearings of 60 mm, friction 0.1. There contacts are rigid and without rebound;
the stiffness here, and the damping, so large that little rebounds, are GUESSES.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import PinInBearing
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Action, Gravity, Load, Moving
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.steel_ball import STEEL_BALL, half, picked

CONTROLLERS = ("siconos", "corrected", "none")
_LENGTHS = {"ground_length": 3.0, "crank_length": 1.0, "coupler_length": 4.0, "rocker_length": 2.5}
_OWN = (
    *((Quantity(name, "m", f"length of the {name[:-7]}", 0.0, open_low=True), x) for name, x in _LENGTHS.items()),
    (Quantity("crank_angle", "rad", "angle of the crank at time 0"), 1.57082377240798),
)
_CONTROL = (
    (Quantity("control_gain", "N m s/rad", "gain K_p of the controller"), 200.0),
    (Quantity("control_slope", "1/s", "lambda of the controller: how fast it forgets an error of the angle"), 10.0),
    (Quantity("path_amplitude", "rad", "amplitude of the path that the crank is to follow"), 6.0),
    (Quantity("path_frequency", "rad/s", "angular frequency of that path"), 0.75 * math.pi),
)
_PINS = {
    **STEEL_BALL, "stiffness": 1e9, "damping": 20.0, "bottoming_damping": 20.0, "restitution": 0.05, "dashpot": 1e4,
    "friction_static": 0.1, "friction_dynamic": 0.1, "friction_speed": 0.01, "radius": 0.055,
    "radius_difference": 5e-3, "gravity": 9.81, **{f"clearance_pin_{i}": 5e-3 for i in (1, 2, 3)},
}  # fmt: skip


def _closed(crank: Array, p: Params) -> tuple[Array, Array]:
    """Angles of coupler and rocker [rad] of the linkage without clearance, open branch, at the crank's angle [rad]."""
    x, y = p["ground_length"] - p["crank_length"] * jnp.cos(crank), -p["crank_length"] * jnp.sin(crank)
    far, link = jnp.hypot(x, y), p["coupler_length"]
    inner = jnp.arccos((link**2 + far**2 - p["rocker_length"] ** 2) / (2.0 * link * far))
    coupler = jnp.arctan2(y, x) + inner
    return coupler, jnp.arctan2(link * jnp.sin(coupler) - y, link * jnp.cos(coupler) - x)


def _slope(function: Any, x: Array) -> tuple[Any, Any]:
    """A function's value and derivative."""
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


def _inertia(crank: Array, p: Params, share: float) -> Array:
    """Inertia of the linkage without clearance about the crank's angle [kg m^2], with a share of the rocker's."""
    (coupler, _), (first, second) = _slope(lambda angle: _closed(angle, p), crank)
    m1, m2, m3 = (p[f"{name}.mass"] for name in ("crank", "coupler", "rocker"))
    l1, l2, l3 = (p[f"{name}_length"] for name in ("crank", "coupler", "rocker"))
    own = (m1 / 3.0 + m2) * l1**2 + m2 * l2**2 / 3.0 * first**2 + share * m3 * l3**2 / 3.0 * second**2
    return own + m2 * l1 * l2 * jnp.cos(crank - coupler) * first


def _height(crank: Array, p: Params) -> Array:
    """Sum of mass times height of the linkage without clearance [kg m]."""
    coupler, rocker = _closed(crank, p)
    of_crank = (0.5 * p["crank.mass"] + p["coupler.mass"]) * p["crank_length"] * jnp.sin(crank)
    of_coupler = 0.5 * p["coupler.mass"] * p["coupler_length"] * jnp.sin(coupler)
    return of_crank + of_coupler + 0.5 * p["rocker.mass"] * p["rocker_length"] * jnp.sin(rocker)


def _torque(t: Array, bodies: Moving, p: Params, siconos: bool) -> list[Action]:
    """Slotine and Li's controller for the linkage without clearance, of inertia M and potential energy V.

        tau = M (w'' - lambda s') + (M'/2) v r + V' - K_p (s' + lambda s),   s = angle - w,   r = w' - lambda s

    with w the path, v the crank's speed. As siconos has it, r = v - lambda s and M' counts half of the rocker: slips, it
    seems, but those of the published results. s is within half a turn.
    """
    axes, speed = bodies.parts["crank"].axes, bodies.parts["crank"].spin[2]
    slope, phase = p["control_slope"], p["path_frequency"] * t
    path = p["path_amplitude"] * jnp.sin(phase)
    rate = p["path_amplitude"] * p["path_frequency"] * jnp.cos(phase)
    x, y = axes[0][0], axes[0][1]
    off = jnp.arctan2(y * jnp.cos(path) - x * jnp.sin(path), x * jnp.cos(path) + y * jnp.sin(path))
    angle, late = path + off, speed - rate
    _, change = _slope(lambda a: _inertia(a, p, 0.5 if siconos else 1.0), angle)
    _, weight = _slope(lambda a: p["gravity"] * _height(a, p), angle)
    wanted = -(p["path_frequency"] ** 2) * path - slope * late
    torque = _inertia(angle, p, 1.0) * wanted + weight - p["control_gain"] * (late + slope * off)
    torque = torque + 0.5 * change * speed * ((speed if siconos else rate) - slope * off)
    return [Action("crank", torque=(0.0, 0.0, torque))]


@cache
def _control(controller: str) -> Load:
    """The controller as a load."""
    function = lambda t, bodies, p: _torque(t, bodies, p, controller == "siconos")  # noqa: E731
    return Load("control", function, ("crank",), _CONTROL, breaks=())


def _coupler(p: Params) -> tuple[Array, Array, Array]:
    """Place of its middle and angle at time 0, every pin in the middle of its bearing."""
    angle, half = _closed(p["crank_angle"], p)[0], 0.5 * p["coupler_length"]
    x, y = p["crank_length"] * jnp.cos(p["crank_angle"]), p["crank_length"] * jnp.sin(p["crank_angle"])
    return x + half * jnp.cos(angle), y + half * jnp.sin(angle), angle


def _rocker(p: Params) -> tuple[Array, Array, Array]:
    """The same of the rocker, from its pin in the ground."""
    angle, half = _closed(p["crank_angle"], p)[1], 0.5 * p["rocker_length"]
    return half * jnp.cos(angle), half * jnp.sin(angle), angle


@cache
def _entry(function: Callable[[Params], tuple], i: int) -> Callable[[Params], Array]:
    return lambda p: function(p)[i]


@cache
def _slender(name: str) -> Callable[[Params], Array]:
    """Inertia of a uniform rod about its middle."""
    return lambda p: p[f"{name}.mass"] * p[f"{name}_length"] ** 2 / 12.0


def four_bar(
    law: str = "memory_free",
    elastic: str | None = None,
    smoothing: bool = True,
    friction: bool | str = True,
    controller: str = "siconos",
) -> Mechanism:
    """Crank about z, coupler and rocker free in the plane of x and y, the ground link along x; gravity is along -y.

    ``pin_1`` is the crank's pin in the coupler, ``pin_2`` the coupler's in the rocker, ``pin_3`` the rocker's in the ground.
    The force that is read acts on the body with the pin: normal along the eccentricity, tangential across it in the plane.
    At time 0 all is at rest, every pin in the middle of its bearing. Places of coupler and rocker are of their middles.

    Args:
        law, elastic, smoothing: as ``impact``.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
        controller: "siconos", as published, or "corrected" (``_torque``), or "none": the linkage falls.
    """
    if controller not in CONTROLLERS:
        raise InputError(
            "scene 'four_bar' controller", f"no controller '{controller}'", nearest(controller, CONTROLLERS)
        )
    crank_end, base = ("crank_length", 0, 0), ("ground_length", 0, 0)
    rods = [Body(
        "crank", "hinge", center=half("crank_length"), mass=1.0, inertia=_slender("crank"), start={"angle": "crank_angle"}
    )]  # fmt: skip
    for name, at, placed in (("coupler", (0, 0, 0), _coupler), ("rocker", base, _rocker)):
        start = {key: _entry(placed, i) for i, key in enumerate(("x", "y", "angle"))}
        rods.append(Body(name, "planar", at=at, mass=1.0, inertia=_slender(name), start=start))
    how: dict[str, Any] = {"law": law, "elastic": elastic, "friction": friction, "smoothing": smoothing}
    ends: dict[tuple[str, str], Any] = {
        ("coupler", "crank"): (half("coupler_length", -1.0), crank_end),
        ("rocker", "coupler"): (half("rocker_length"), half("coupler_length")),
        ("ground", "rocker"): (base, half("rocker_length", -1.0)),
    }
    pins = [Contact(f"pin_{i}", pair, PinInBearing(), at=at, **how) for i, (pair, at) in enumerate(ends.items(), 1)]
    loads = (Gravity("-y"), *(() if controller == "none" else (_control(controller),)))
    given = picked(_PINS, [*pins[0].reads, "gravity", *(f"clearance_{pin.name}" for pin in pins)])
    return Mechanism("four_bar", rods, pins, loads, _OWN, given, end=1.0, samples=4001)
