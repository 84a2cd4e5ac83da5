"""Options of the scene ``string``: from Python, and as keys of [scene] of a scene file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from bcfj_jax.contact.friction import AbstractFriction, make_friction
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.quantities import whole
from bcfj_jax.models.joint.build import structure
from bcfj_jax.models.joint.model import JointModel
from bcfj_jax.models.joint.options import (
    JointCage,
    JointDrive,
    JointGeometry,
    JointLoads,
    JointMaterials,
    JointOptions,
    keyed,
    with_keys,
)
from bcfj_jax.models.string import LEVELS, WHERE, StringModel
from bcfj_jax.models.string_dynamic import DynamicString
from bcfj_jax.models.string_motion import MOTIONS, MovingString, in_motion

# Friction laws of the bit: those of hinges.
BITS = ("none", "coulomb", "step", "brown_mcphee", "lugre")


def _law(bit: str, options: JointOptions) -> AbstractFriction | None:
    """The bit's friction law, of a string in motion."""
    if bit not in BITS:
        raise InputError(f"{WHERE} bit_friction", f"no friction {quoted(bit)}", nearest(str(bit), BITS))
    if bit == "none":
        return None
    if options.loads.stick_slip:
        found = "beside stick_slip, which says by itself how the torque falls"
        raise InputError(f"{WHERE} bit_friction", found, "give one of them")
    return make_friction(bit)


def _made(n: int, motion: str, bending: bool, bit: str, options: JointOptions) -> StringModel:
    count = whole(f"{WHERE} n", n, least=1, most=limits.MEMBERS)
    if motion not in MOTIONS:
        raise InputError(f"{WHERE} motion", f"no motion {quoted(motion)}", nearest(str(motion), MOTIONS))
    if options.fidelity not in LEVELS:
        raise InputError(f"{WHERE} fidelity", f"no level {quoted(options.fidelity)}", nearest(options.fidelity, LEVELS))
    dynamic = options.fidelity == "dynamic"
    if dynamic and motion == "none":
        found = "'dynamic': joints of a string without motion exchange no dynamics"
        raise InputError(f"{WHERE} fidelity", found, "give motion = 'torsional', or fidelity = 'quasistatic'")
    if dynamic and bit == "lugre":
        found = "'lugre' beside joints in motion, where bristles of the bit have no place"
        raise InputError(f"{WHERE} bit_friction", found, "give brown_mcphee, or fidelity = 'quasistatic'")
    usual = replace(options, drive=JointDrive(), loads=JointLoads())
    joint = JointModel(**structure(usual))
    if motion == "torsional":
        moving = JointModel(**structure(replace(options, fidelity="dynamic")))
        made, samples = (DynamicString, 1001) if dynamic else (MovingString, 301)
        rest = StringModel(joint, count, bending=bending, samples=samples)
        return in_motion(rest, moving, _law(bit, options), made)
    if options != usual or bit != "none":
        found = "a drive or a load over time in a string without motion"
        raise InputError(
            f"{WHERE} motion", found, "give motion = 'torsional', or leave the options of drive and loads out"
        )
    return StringModel(joint, count, bending=bending)


@dataclass(frozen=True)
class _Options:
    """Of the scene file.

    Args:
        n: number of joints.
        motion: one of none, torsional. none: every instant is one of equilibrium. torsional: segments and joints twist,
            and lumps between them turn with inertia; drive and loads may then be over time.
        fidelity: one of kinematic, quasistatic, dynamic. Of the joints. kinematic: closed-form load sharing.
            quasistatic: equilibrium under the torque that passes through each, without friction. dynamic: all joints in full
            motion, of a string with motion = torsional.
        bending: whether segments bend: those that do not pass straight pass bent, pressed on the wall in their middle.
        bit_friction: one of none, coulomb, step, brown_mcphee, lugre. none: the bit's torque is what the loads say. Others: it
            is friction, bit_torque where the bit is fast, stick_ratio times that at most, fading below stick_width; of lugre
            the bit holds, by bristles.
    """

    n: int = 5
    motion: str = "none"
    bending: bool = False
    bit_friction: str = "none"
    materials: JointMaterials = field(default_factory=JointMaterials)
    geometry: JointGeometry = field(default_factory=JointGeometry)
    cage: JointCage = field(default_factory=JointCage)
    drive: JointDrive = field(default_factory=JointDrive)
    loads: JointLoads = field(default_factory=JointLoads)
    fidelity: str = "quasistatic"


def string(
    n: int = 5, motion: str = "none", bending: bool = False, bit_friction: str = "none", fidelity: str = "quasistatic",
    **groups: Any,
) -> StringModel:  # fmt: skip
    """``n`` equal ball-cage joints with segments in a curved hole, from drive to bit (``models.string``).

    Args:
        n: number of joints.
        motion: one of none, torsional: whether the string twists and swings (``models.string_motion``).
        bending: whether segments bend where they do not pass straight (``models.string_bending``).
        bit_friction: one of none, coulomb, step, brown_mcphee, lugre: a friction law of the bit, in place of a torque.
        fidelity: one of kinematic, quasistatic, dynamic: of the joints (``models.string_dynamic``).
        groups: geometry, cage, materials of every joint; drive, loads of a string in motion, as ``joint``.

    Raises:
        InputError: as ``joint``.
    """
    known = ("geometry", "cage", "materials", "drive", "loads")
    for name in groups:
        if name not in known:
            own = ("n", "motion", "bending", "bit_friction", "fidelity")
            raise InputError(WHERE, f"no option '{name}'", nearest(name, (*own, *known)))
    options = JointOptions(fidelity=fidelity, **{key: group for key, group in groups.items() if group is not None})
    return _made(n, motion, bending, bit_friction, options)


@keyed(_Options)
def string_of_keys(
    n: int = 5, motion: str = "none", bending: bool = False, bit_friction: str = "none", **given: Any
) -> StringModel:
    """n ball-cage joints in a curved hole from the keys of [scene] of a scene file."""
    return _made(n, motion, bending, bit_friction, with_keys(JointOptions(fidelity="quasistatic"), given, WHERE))
