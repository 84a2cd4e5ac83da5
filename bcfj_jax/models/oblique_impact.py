"""``oblique_impact``: a sphere strikes a plane at an angle, with friction and spin.

Numbers: Kharaz, Gorham and Salman, Powder Technology 120 (2001) 281 (physics sheet, B16): a 5 mm sphere of aluminium oxide
(4000 kg/m^3, 380 GPa, 0.23) on soda-lime glass (70 GPa, 0.25) at 3.9 m/s; normal restitution 0.98, friction 0.092.
Stiffness is Hertz's. Where friction passes from creeping to sliding is a GUESS, 0.01 m/s. LuGre's bristles have the
stiffness of Mindlin's contact under half the peak force at 30 degrees, and no damping.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact import laws
from bcfj_jax.contact.gaps import SphereOnPlane
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.steel_ball import STEEL_BALL, arriving, picked

_ANGLE = Quantity("impact_angle", "rad", "angle of the approach from the plane's normal", -1.57, 1.57)
_OWN = (
    (CATALOGUE["approach_speed"], 3.9),
    (_ANGLE, math.radians(30.0)),
    (Quantity("spin", "rad/s", "spin at time 0, positive where it rolls the sphere the way it flies"), 0.0),
    (
        Quantity(
            "inertia_ratio", "1", "inertia over mass and radius squared; 2/5 of a solid sphere", 0.0, open_low=True
        ),
        0.4,
    ),
)
_BALL = {
    **STEEL_BALL, "radius": 2.5e-3, "mass": 4000.0 * 4.0 / 3.0 * math.pi * 2.5e-3**3, "stiffness": 4.1968e9,
    "restitution": 0.98, "damping": 0.009, "bottoming_damping": 0.009, "clearance_contact": 0.0,
    "friction_static": 0.092, "friction_dynamic": 0.092, "friction_speed": 0.01,
    "bristle_stiffness": 1.3e5, "bristle_damping": 0.0,
}  # fmt: skip


def _closing(p: Params) -> Array:
    """Speed along the normal at time 0 [m/s]."""
    return p["approach_speed"] * jnp.cos(p["impact_angle"])


def _down(p: Params) -> Array:
    return -_closing(p)


def _along(p: Params) -> Array:
    """Speed along the plane at time 0 [m/s]."""
    return p["approach_speed"] * jnp.sin(p["impact_angle"])


def _inertia(p: Params) -> Array:
    return p["inertia_ratio"] * p["mass"] * p["radius"] ** 2


def _end(p: Params) -> Array:
    return arriving(_BALL, p, p["mass"], _closing(p))


def oblique_impact(
    law: str = "exact", elastic: str | None = None, smoothing: bool = True, friction: bool | str = True
) -> Mechanism:
    """A sphere in the plane of x and y strikes a plane across y at ``approach_speed``, ``impact_angle`` from its normal.

    At time 0 the sphere is ``clearance_contact`` above the plane and moves along +x and -y. The force that is read acts
    on the sphere: normal into the plane, axial along z, tangential along -x.

    Args:
        law, elastic, smoothing: as ``impact``; a law stated by restitution has the speed along the normal.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
    """
    sphere = Body(
        "sphere", "planar", at=(0, "radius", 0), mass="mass", inertia=_inertia,
        start={"vx": _along, "vy": _down, "speed": "-spin"},
    )  # fmt: skip
    made = laws.make(law, elastic)
    plane = Contact(
        "contact", ("ground", "sphere"), SphereOnPlane("y", clearance=True), made, friction, smoothing=smoothing,
        values={"approach_speed": _closing} if "approach_speed" in made.needs else {}, approach="parameter",
    )  # fmt: skip
    given = picked(_BALL, [*plane.reads, "radius", "mass", "clearance_contact"])
    return Mechanism("oblique_impact", (sphere,), (plane,), own=_OWN, given=given, end=_end, samples=1001, touch=_met)


def _met(p: Mapping[str, float]) -> float | None:
    """First contact [s]: the clearance at the speed along the normal."""
    speed = p["approach_speed"] * math.cos(p["impact_angle"])
    return p["clearance_contact"] / speed if speed > 0 else None
