"""``slider_guide``: a slider-crank whose slider has play in its guide and may touch it with each of its four corners.

Numbers: Flores, Leine and Glocker, Multibody System Dynamics 23 (2010) 165, in the data of siconos' example SliderCrank
(physics sheet, B4): crank 153 mm, 0.038 kg, 7.4e-5 kg m^2; rod 306 mm, 0.038 kg, 5.9e-4 kg m^2; slider 100 mm by 50 mm,
0.076 kg, 2.7e-6 kg m^2, 1 mm of play to either side; 150 rad/s at first and no torque; friction 0.01. There walls are
rigid with a restitution of 0.4. The stiffness here is a GUESS; the damping gives 0.4 at the first touch, of
0.84 m/s, and less at faster ones.
"""

from __future__ import annotations

from jax import Array

from bcfj_jax.contact.gaps import SliderInGuide
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Gravity
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.steel_ball import STEEL_BALL, half, picked

_OWN = (
    (Quantity("crank_length", "m", "distance of the crank's pins", 0.0, open_low=True), 0.153),
    (Quantity("rod_length", "m", "distance of the rod's pins", 0.0, open_low=True), 0.306),
    (Quantity("crank_speed", "rad/s", "speed of the crank at time 0"), 150.0),
    (Quantity("rod_speed", "rad/s", "angular velocity of the rod at time 0"), -75.0),
)
_WALL = {
    **STEEL_BALL, "stiffness": 1e9, "damping": 2.47, "restitution": 0.4, "bottoming_damping": 2.47,
    "friction_static": 0.01, "friction_dynamic": 0.01, "friction_speed": 0.01,
    "half_length": 0.05, "half_width": 0.025, "clearance_guide": 1e-3, "gravity": 9.81,
}  # fmt: skip


def _bend(p: Params) -> Array:
    """Speed of the rod against the crank at time 0 [rad/s]."""
    return p["rod_speed"] - p["crank_speed"]


def slider_guide(
    law: str = "memory_free", elastic: str | None = None, smoothing: bool = True, friction: bool | str = False
) -> Mechanism:
    """Crank about z, rod on the crank, slider on the rod; the slider lies between two walls along x. Gravity is along -y.

    Starts with crank, rod and slider in line along x and moves by itself. The contact ``guide`` has four members: the
    slider's corners at the back and at the front of its upper side, then of its lower side. The force that is read acts
    on the slider: normal across the walls, axial along x.

    Args:
        law, elastic, smoothing: as ``impact``.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
    """
    parts = (
        Body("crank", "hinge", mass=0.038, inertia=7.4e-5, center=half("crank_length"), start={"speed": "crank_speed"}),
        Body(
            "rod", "hinge", "crank", ("crank_length", 0, 0), mass=0.038, inertia=5.9e-4, center=half("rod_length"),
            start={"speed": _bend},
        ),
        Body(
            "slider", "hinge", "rod", ("rod_length", 0, 0), mass=0.076, inertia=2.7e-6, start={"speed": "-rod_speed"}
        ),
    )  # fmt: skip
    guide = Contact(
        "guide", ("ground", "slider"), SliderInGuide("x"), law, elastic=elastic, friction=friction, smoothing=smoothing
    )
    given = picked(_WALL, [*guide.reads, "clearance_guide", "gravity"])
    return Mechanism("slider_guide", parts, (guide,), (Gravity("-y"),), _OWN, given, end=0.02, samples=4001)
