"""Other choices for the same joint, whose effect on the forces is the error of its model form.

Each changes one thing of the user's joint: an option, or a number that stands for a regime. ``bcfj tradeoff --only
model`` runs them beside the user's own; ``model_form.json`` has what they moved in the default joint
(``benchmarks/models/joint_model_form.py``).
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping
from importlib import resources
from typing import Any

from jax import Array

from bcfj_jax.mechanism.model import Variant
from bcfj_jax.models.joint.scene import WINDOW_END, Joint

# Speed at which the greatest friction acts [m/s]: measured of lubricated steel; the default lies above all sliding.
_HONEST_SPEED = 0.01
# Time of a sudden torque [s].
_SUDDEN = 1e-4
_SHOWN = 3


def variants(scene: Joint, params: Mapping[str, Array]) -> tuple[Variant, ...]:
    """Every other choice for a joint in motion; none for one without a motion."""
    return tuple(_each(scene, params)) if scene.in_motion else ()


def _each(scene: Joint, params: Mapping[str, Array]) -> Iterator[Variant]:
    def option(name: str, physics: str, **options: Any) -> Variant:
        return Variant(name, {"scene": options}, physics)

    if scene.spin:
        yield option("balls do not turn", "balls slide in their grooves", spin=False)
    else:
        yield option("balls roll", "balls turn, and so roll in their grooves", spin=True)
    if scene.cage == "free":
        names = [contact.name for contact in scene.contacts if contact.name != WINDOW_END]
        left = {"contacts": [x for x in names if x != "seat_cage"], "window_ends": False, "bands": False}
        yield option("cage fixed", "the cage stays on the bisecting plane", cage="fixed", **left)
        if scene.has(WINDOW_END):
            physics = "the cage slips through its own windows"
            yield option("windows without ends", physics, contacts=names, window_ends=False)
        else:
            yield option("windows with ends", "windows end around the cage, so that it cannot slip", window_ends=True)
        if scene.bands:
            yield option("pilots all round", "the cage's pilots are full spheres", bands=False)
        elif scene.pilots:
            yield option("pilots as bands", "the cage's pilots end at a latitude, with an edge", bands=True)
    if scene.head == "free":
        yield option("head fixed", "the head cannot shift", head="fixed")
    else:
        yield option("head free", "the head shifts in its play", head="free")
    if scene.track == "gothic":
        yield option("circular track", "grooves have one flank, as wide as ball and clearance", track="circular")
    else:
        yield option("gothic track", "grooves have two flanks at the contact angle", track="gothic")
    speeds = {name: _HONEST_SPEED for name in params if name.rpartition(".")[2] == "friction_speed"}
    if speeds and any(float(params[name]) > _HONEST_SPEED for name in speeds):
        physics = f"the greatest friction acts at {_HONEST_SPEED:g} m/s, as measured of lubricated steel: both coefficients count"
        # Without memory balls chatter on the falling part of the curve, in hundreds of times the steps.
        kept = any(x.friction is not None and (x.friction.lags or x.friction.bristles) for x in scene.contacts)
        change = {"parameters": speeds} if kept else {"scene": {"friction": "frictional_lag"}, "parameters": speeds}
        yield Variant(f"friction_speed {_HONEST_SPEED:g} m/s", change, physics)
    if "load_ramp" in params and float(params["load_ramp"]) > _SUDDEN:
        physics = "the torque comes within 0.1 ms: parts cross their play and strike"
        yield Variant("sudden torque", {"parameters": {"load_ramp": _SUDDEN}}, physics)
    if scene.programmes.drive is None and scene.cage == "free":
        yield option("start from rest", "the drive speeds up from rest", drive_profile="smooth")


@functools.cache
def _measured() -> list[dict[str, Any]]:
    return json.loads(resources.files("bcfj_jax.models.joint").joinpath("model_form.json").read_text())["choices"]


def model_form() -> str:
    """What choices of the model moved in the default joint, the largest first, in a sentence."""
    known = "other choices of the model (bcfj tradeoff SCENE --only model) "
    found = sorted((one for one in _measured() if one["change"] is not None), key=lambda one: -abs(one["change"]))
    parts = [f"{one['choice']} ({one['contact']} peak {one['change']:+.0%})" for one in found[:_SHOWN]]
    return f"{known}move the default joint by more: {', '.join(parts)}"
