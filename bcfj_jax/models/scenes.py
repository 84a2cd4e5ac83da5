"""The built-in scenes by name. Each is a short function in a file of its own, with the source of its numbers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import NamedTuple

from bcfj_jax.contact.part import raised
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.models import steel_ball
from bcfj_jax.models.backlash import backlash
from bcfj_jax.models.chain import chain
from bcfj_jax.models.four_bar import four_bar
from bcfj_jax.models.hooke import SOURCES as HOOKE_SOURCES
from bcfj_jax.models.hooke import hooke
from bcfj_jax.models.impact import bounce, impact
from bcfj_jax.models.joint import defaults as joint_numbers
from bcfj_jax.models.joint.model import joint as joint
from bcfj_jax.models.joint.model import joint_of_keys
from bcfj_jax.models.joint.options import JointCage as JointCage
from bcfj_jax.models.joint.options import JointDrive as JointDrive
from bcfj_jax.models.joint.options import JointGeometry as JointGeometry
from bcfj_jax.models.joint.options import JointLoads as JointLoads
from bcfj_jax.models.joint.options import JointMaterials as JointMaterials
from bcfj_jax.models.oblique_impact import oblique_impact
from bcfj_jax.models.slider_crank import slider_crank
from bcfj_jax.models.slider_guide import slider_guide
from bcfj_jax.models.string import DEFAULTS as STRING_NUMBERS
from bcfj_jax.models.string_bending import BENDING
from bcfj_jax.models.string_motion import LUGRE
from bcfj_jax.models.string_motion import NUMBERS as STRING_IN_MOTION
from bcfj_jax.models.string_options import string as string
from bcfj_jax.models.string_options import string_of_keys

_MECHANISMS = impact, bounce, oblique_impact, backlash, chain, slider_crank, slider_guide, four_bar, hooke
SCENES: dict[str, Callable[..., AbstractModel]] = {scene.__name__: scene for scene in _MECHANISMS}
SCENES |= {"joint": joint_of_keys, "string": string_of_keys}

# Scenes of two free bodies: [scene.spheres] in a scene file may give their stiffness, exponent and mass.
OF_SPHERES = ("impact",)


class Sources(NamedTuple):
    """Where a scene's default numbers are from, in words: by parameter; and what these words mean."""

    by_name: Mapping[str, str] = {}
    legend: str = ""


def _told(numbers: Mapping[str, tuple[float, str]]) -> Sources:
    return Sources({name: source for name, (_, source) in numbers.items()}, joint_numbers.LEGEND)


# Of scenes whose files to start from say it number by number.
SOURCES: dict[str, Sources] = {
    "impact": Sources(steel_ball.SOURCES),
    "bounce": Sources(steel_ball.SOURCES),
    "joint": _told(joint_numbers.DEFAULTS),
    "hooke": Sources(HOOKE_SOURCES, joint_numbers.LEGEND),
    "string": _told(joint_numbers.DEFAULTS | STRING_NUMBERS | BENDING | STRING_IN_MOTION | LUGRE),
}


def make(kind: str, **options: object) -> AbstractModel:
    """A built-in scene by name, with its options.

    Raises:
        InputError: for a kind or an option that does not exist, with the nearest that does.
    """
    if kind not in SCENES:
        raise InputError("scene", f"no scene '{kind}'", nearest(kind, SCENES))
    known = inspect.signature(SCENES[kind]).parameters
    for name, value in options.items():
        if name not in known:
            raise InputError(f"scene '{kind}'", f"no option '{name}' = {value}", nearest(name, known))
    function = SCENES[kind]
    if function.__module__.startswith(f"{__package__}."):
        return function(**options)
    # A function of the user's own (``io.usercode``).
    try:
        found = function(**options)
    except Exception as error:
        raise raised(f"scene '{kind}'", error) from error
    if not isinstance(found, AbstractModel):
        raise InputError(f"scene '{kind}'", f"its function returned {found!r}", "return a model, such as a Mechanism")
    return found
