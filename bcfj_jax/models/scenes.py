"""The built-in scenes by name. Each is a short function in a file of its own, with the source of its numbers."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from bcfj_jax.contact.part import raised
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.mechanism.model import AbstractModel

if TYPE_CHECKING:
    from bcfj_jax.models.backlash import backlash as backlash
    from bcfj_jax.models.chain import chain as chain
    from bcfj_jax.models.four_bar import four_bar as four_bar
    from bcfj_jax.models.hooke import hooke as hooke
    from bcfj_jax.models.impact import bounce as bounce
    from bcfj_jax.models.impact import impact as impact
    from bcfj_jax.models.joint.model import joint as joint
    from bcfj_jax.models.joint.model import joint_of_keys as joint_of_keys
    from bcfj_jax.models.joint.options import JointCage as JointCage
    from bcfj_jax.models.joint.options import JointDrive as JointDrive
    from bcfj_jax.models.joint.options import JointGeometry as JointGeometry
    from bcfj_jax.models.joint.options import JointLoads as JointLoads
    from bcfj_jax.models.joint.options import JointMaterials as JointMaterials
    from bcfj_jax.models.oblique_impact import oblique_impact as oblique_impact
    from bcfj_jax.models.slider_crank import slider_crank as slider_crank
    from bcfj_jax.models.slider_guide import slider_guide as slider_guide
    from bcfj_jax.models.string_options import string as string
    from bcfj_jax.models.string_options import string_of_keys as string_of_keys

# Built-in scenes by the function that makes each of the keys of a file.
_MECHANISMS = (
    "impact", "bounce", "oblique_impact", "backlash", "chain", "slider_crank", "slider_guide", "four_bar", "hooke",
)  # fmt: skip
_BUILT_IN = {name: name for name in _MECHANISMS} | {"joint": "joint_of_keys", "string": "string_of_keys"}
# Public names by the module that holds them. It is imported when it is asked for: of a short command's time all of them
# would take a twelfth.
_PUBLIC = {
    **{name: name for name in _MECHANISMS}, "bounce": "impact",
    **dict.fromkeys(("joint", "joint_of_keys"), "joint.model"), **dict.fromkeys(("string", "string_of_keys"), "string_options"),
    **{f"Joint{part}": "joint.options" for part in ("Cage", "Drive", "Geometry", "Loads", "Materials")},
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(importlib.import_module(f"{__package__}.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})


class _Scenes(dict[str, Any]):
    """By kind of scene the function that makes it, or the name of a built-in one's that was not asked for yet."""

    def __getitem__(self, kind: str) -> Callable[..., AbstractModel]:
        found = super().__getitem__(kind)
        return __getattr__(found) if isinstance(found, str) else found


SCENES = _Scenes(_BUILT_IN)

# Scenes of two free bodies: [scene.spheres] in a scene file may give their stiffness, exponent and mass.
OF_SPHERES = ("impact",)


class Sources(NamedTuple):
    """Where a scene's default numbers are from, in words: by parameter; and what these words mean."""

    by_name: Mapping[str, str] = {}
    legend: str = ""


def sources(kind: str) -> Sources:
    """Those of a built-in scene whose file to start from says it number by number; of another, none."""
    from bcfj_jax.models import hooke, steel_ball, string, string_bending, string_motion
    from bcfj_jax.models.joint import defaults

    def told(*numbers: Mapping[str, tuple[float, str]]) -> Sources:
        return Sources({name: source for each in numbers for name, (_, source) in each.items()}, defaults.LEGEND)

    known = {
        "impact": Sources(steel_ball.SOURCES), "bounce": Sources(steel_ball.SOURCES), "joint": told(defaults.DEFAULTS),
        "hooke": Sources(hooke.SOURCES, defaults.LEGEND),
        "string": told(
            defaults.DEFAULTS, string.DEFAULTS, string_bending.BENDING, string_motion.NUMBERS, string_motion.LUGRE
        ),
    }  # fmt: skip
    return known.get(kind, Sources())


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
