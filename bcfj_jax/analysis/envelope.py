"""Where a result keeps its promised error: how far a scene is from those on which the promise was measured.

A scene is placed by a few numbers, most of them without unit (``measures``). Within the ranges of ``envelope.json``
every random scene of ``benchmarks/solve/levels.py`` kept its promised error at every level; beyond them runs are usable and
nothing is promised, which ``warnings`` says. A joint's promise begins when its load has risen and a ball's pitch has
passed, which is when it has forgotten its start: ``of_the_start`` says which peaks are from before. What cannot be
computed is refused before (``quantities``, ``simulation.check``). ``docs/envelope.md`` is made of the same numbers.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.dynamics import contact_time, state_scales
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.mechanism.scene import Scene
from bcfj_jax.models import scenes
from bcfj_jax.models.joint.periodic import risen
from bcfj_jax.models.joint.scales import scales
from bcfj_jax.models.joint.scene import OF_A_BALL, Joint

# What a measure is, in words for a warning.
MEANING = {
    "onset": "smoothing over the deepest penetration",
    "loss": "share of the speed that damping takes, to first order",
    "exponent": "exponent",
    "flights": "end time over the first flight's",
    "rarity": "first flight over its contact",
    "durations": "end time over the contact's",
    "sliding": "a ball's speed along its track over friction's transition speed",
    "play": "a ball's clearance over the onset of contact",
    "knock": "the cage's clearance over the onset of contact",
    "onset_under_load": "onset of contact over the penetration under load",
    "angle": "joint angle [rad]",
    "friction": "static friction",
    "damping": "damping [s/m]",
    "centrifugal": "centrifugal force of a ball over its load",
    "axial": "axial load over the balls' load",
}

KEPT = "envelope.json"
# Peaks as high as later ones, to a percent, are told by these.
_HIGHER = 0.01
# When a joint's promise begins.
_FROM = "the load has risen and a ball's pitch has passed"


@cache
def guaranteed() -> dict[str, dict[str, tuple[float, float]]]:
    """By scene and measure the range in which every promise was kept; written by ``benchmarks/analysis/envelope.py``."""
    text = resources.files("bcfj_jax.analysis").joinpath(KEPT).read_text()
    return {kind: {name: (low, high) for name, (low, high) in box.items()} for kind, box in json.loads(text).items()}


def warnings(scene: AbstractModel, params: Params, times: np.ndarray) -> list[str]:
    """What of a scene lies beyond the ranges in which its promised error is known to hold; none for other scenes."""
    if isinstance(scene, Joint) and not scene.in_motion:
        # Nothing is integrated.
        return []
    box, found = guaranteed()[scene.kind], []
    for name, value in measures(scene, params, times).items():
        low, high = box.get(name, (-np.inf, np.inf))
        if not low <= value <= high:
            found.append(f"{MEANING[name]} is {value:.3g}, tried from {low:.3g} to {high:.3g}")
    if isinstance(scene, Joint):
        found += _untried(scene, params, times)
    if not found:
        return []
    return [f"the promised force error is not guaranteed here (docs/envelope.md): {'; '.join(found)}"]


def _untried(scene: Joint, params: Params, times: np.ndarray) -> list[str]:
    """What of a joint no number tells."""
    found = []
    if dataclasses.replace(scene, fidelity="dynamic") != scenes.joint():
        found.append("options other than the defaults")
    if times[-1] <= risen(scene, params, 1):
        found.append(f"the run ends before {_FROM} ({format_si(risen(scene, params, 1), 's')})")
    return found


def of_the_start(
    scene: AbstractModel, params: Params, times: np.ndarray, forces: Mapping[str, np.ndarray]
) -> list[str]:
    """Contacts of a moving joint whose peak is from before its promise begins, and higher than any later.

    Args:
        scene, params: as ``simulate`` takes them.
        times: (T,) [s].
        forces: per contact (T, 3) or (T, members, 3) [N].
    """
    if not isinstance(scene, Joint) or not scene.in_motion:
        return []
    begin, found = risen(scene, params, 1), []
    for name, force in forces.items():
        normal = np.abs(force[..., 0]).reshape(len(times), -1).max(axis=1)
        first = int(normal.argmax())
        if not times[first] < begin < times[-1] or not np.isfinite(normal).all():
            continue
        after = normal[times >= begin].max()
        if normal[first] > (1.0 + _HIGHER) * after:
            found.append(
                f"{name} {format_si(normal[first], 'N')} at {format_si(times[first], 's')} "
                f"({format_si(after, 'N')} from then on)"
            )
    if not found:
        return []
    return [f"no error is promised of peaks before {_FROM} ({format_si(begin, 's')}): {'; '.join(found)}"]


def measures(scene: AbstractModel, params: Params, times: np.ndarray) -> dict[str, float]:
    """The numbers that place a scene, by name; see ``MEANING``.

    Args:
        scene, params: as ``simulate`` takes them, values only.
        times: (T,) [s]; the last counts.
    """
    if isinstance(scene, Joint):
        return _of_a_joint(scene, params)
    assert isinstance(scene, Scene)
    p = {name: float(value) for name, value in params.items()}
    sizes = state_scales(scene, params)
    depth, speed, contact = float(sizes[0]), float(sizes[-1]), float(contact_time(sizes))
    found = {"onset": p.get("smoothing", 0.0) / depth, "loss": _loss(p, depth, speed)}
    if "exponent" in p:
        found["exponent"] = p["exponent"]
    if scene.flight is not None:
        flight = float(scene.flight(params))
        found |= {"flights": float(times[-1]) / flight, "rarity": flight / contact}
    else:
        found["durations"] = float(times[-1]) / contact
    return found


def _of_a_joint(scene: Joint, params: Params) -> dict[str, float]:
    """The worst contact counts; what the joint has not is left out."""
    p = {name: float(value) for name, value in params.items()}
    speed, radius = abs(p["drive_speed"]), p["pitch_radius"]
    load = abs(p["load_torque"]) / (scene.balls * radius)
    rubbing = [x.name for x in scene.contacts if x.friction is not None]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.float64(speed * radius * np.sin(p["joint_angle"]))
        found = {
            "angle": p["joint_angle"],
            "centrifugal": float(np.float64(p["ball_mass"] * radius * speed**2) / load),
            "axial": float(np.float64(abs(p["axial_load"]) / scene.balls) / load),
            **{name: _worst(scene, params, name) for name in ("exponent", "damping") if name in p},
        }
        if rubbing:
            slowest = min(float(scene.coefficient(params, name, "friction_speed")) for name in rubbing)
            found |= {"friction": _worst(scene, params, "friction_static"), "sliding": float(along / slowest)}
        if scene.smoothing:
            place = float(scales(scene, params)[0])
            found["onset_under_load"] = _worst(scene, params, "smoothing") / place
            for what, names in (("play", OF_A_BALL), ("knock", scene.pilots)):
                ratios = [
                    np.float64(p[f"clearance_{name}"]) / float(scene.coefficient(params, name, "smoothing"))
                    for name in names
                    if scene.has(name)
                ]
                found |= {what: float(max(ratios))} if ratios else {}
    return found


def _worst(scene: Joint, params: Params, name: str) -> float:
    """The largest value of a coefficient over the contacts that read it; every one reads its onset."""
    readers = [x.name for x in scene.contacts if name in (*x.needs, "smoothing")]
    return max(float(scene.coefficient(params, contact, name)) for contact in readers)


def _loss(p: Mapping[str, float], depth: float, speed: float) -> float:
    if "restitution" in p:
        return 1.0 - p["restitution"]
    if "dashpot" in p:
        return p["dashpot"] * depth / (p["mass"] * speed)
    return p.get("damping", 0.0) * speed
