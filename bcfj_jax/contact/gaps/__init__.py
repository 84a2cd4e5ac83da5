"""Gaps by name: where two bodies touch (``base``), for spheres, guides, balls, parts with edges; or one of your own.

In every gap a is the first body and b the second; sizes are coefficients of the contact by name. To add a gap:
``from_depth``, or a module with ``needs`` and ``faces`` (``AbstractGap``).
"""

from __future__ import annotations

import dataclasses
from typing import Any

from bcfj_jax.contact.gaps.balls import BallBetweenPlanes as BallBetweenPlanes
from bcfj_jax.contact.gaps.balls import BallInGroove as BallInGroove
from bcfj_jax.contact.gaps.base import AbstractGap as AbstractGap
from bcfj_jax.contact.gaps.base import Coefficients as Coefficients
from bcfj_jax.contact.gaps.base import Face as Face
from bcfj_jax.contact.gaps.base import Frame as Frame
from bcfj_jax.contact.gaps.base import FromDepth as FromDepth
from bcfj_jax.contact.gaps.base import Look as Look
from bcfj_jax.contact.gaps.base import from_depth as from_depth
from bcfj_jax.contact.gaps.boxes import BoxOnBox as BoxOnBox
from bcfj_jax.contact.gaps.boxes import BoxOnPlane as BoxOnPlane
from bcfj_jax.contact.gaps.boxes import SphereOnBox as SphereOnBox
from bcfj_jax.contact.gaps.edges import CapsuleOnCapsule as CapsuleOnCapsule
from bcfj_jax.contact.gaps.edges import CapsuleOnPlane as CapsuleOnPlane
from bcfj_jax.contact.gaps.edges import CylinderOnPlane as CylinderOnPlane
from bcfj_jax.contact.gaps.edges import SphereOnWedge as SphereOnWedge
from bcfj_jax.contact.gaps.guides import PinInBearing as PinInBearing
from bcfj_jax.contact.gaps.guides import PinInSlot as PinInSlot
from bcfj_jax.contact.gaps.guides import SliderInGuide as SliderInGuide
from bcfj_jax.contact.gaps.guides import TwoSidedStop as TwoSidedStop
from bcfj_jax.contact.gaps.spheres import PointOnPlane as PointOnPlane
from bcfj_jax.contact.gaps.spheres import SphereInSocket as SphereInSocket
from bcfj_jax.contact.gaps.spheres import SphereOnPlane as SphereOnPlane
from bcfj_jax.contact.gaps.spheres import SphereOnSphere as SphereOnSphere
from bcfj_jax.core.errors import InputError, nearest

# A gap of the user's own (``io.usercode``) may be an object, which has no options.
GAPS: dict[str, type[AbstractGap] | AbstractGap] = {
    "point_on_plane": PointOnPlane,
    "sphere_on_plane": SphereOnPlane,
    "box_on_plane": BoxOnPlane,
    "sphere_on_sphere": SphereOnSphere,
    "sphere_in_socket": SphereInSocket,
    "pin_in_bearing": PinInBearing,
    "pin_in_slot": PinInSlot,
    "slider_in_guide": SliderInGuide,
    "two_sided_stop": TwoSidedStop,
    "ball_in_groove": BallInGroove,
    "ball_between_planes": BallBetweenPlanes,
    "capsule_on_plane": CapsuleOnPlane,
    "cylinder_on_plane": CylinderOnPlane,
    "capsule_on_capsule": CapsuleOnCapsule,
    "sphere_on_box": SphereOnBox,
    "sphere_on_wedge": SphereOnWedge,
    "box_on_box": BoxOnBox,
}


def make_gap(name: str, **options: Any) -> AbstractGap:
    """A gap by name.

    Args:
        name: one of ``GAPS``.
        options: its static options, the attributes of its class; lists are read as tuples.

    Raises:
        InputError: for a name or an option that is not known, with the nearest one that is, and for an option's value.
    """
    if name not in GAPS:
        raise InputError("gap", f"no gap '{name}'", nearest(name, GAPS))
    gap = GAPS[name]
    known = [field.name for field in dataclasses.fields(gap)] if isinstance(gap, type) else []
    for option in options:
        if option not in known:
            raise InputError(f"gap '{name}'", f"no option '{option}'", nearest(option, known))
    if not isinstance(gap, type):
        return gap
    return gap(**{key: tuple(x) if isinstance(x, list) else x for key, x in options.items()})
