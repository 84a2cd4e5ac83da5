"""Where a result keeps its promised error: how far a scene is from those on which the promise was measured.

A scene is placed by a few numbers, most of them without unit (``measures``). Within the ranges of ``envelope.json``
every random scene of ``benchmarks/levels.py`` kept its promised error at every level; beyond them runs are usable and
nothing is promised, which ``warnings`` says. The joint has measures and no range yet: not every random one kept it.
What cannot be computed is refused before (``quantities``, ``dynamics.check_start``, ``joint.checks``).
``docs/envelope.md`` is made of the same numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from bcfj_jax.dynamics import CONTACT, state_scales
from bcfj_jax.joint.scene import OF_A_BALL, Joint
from bcfj_jax.scene import AbstractScene, Params, Scene

# What a measure is, in words for a warning.
MEANING = {
    "onset": "smoothing over the deepest penetration",
    "loss": "share of the speed that damping takes, to first order",
    "exponent": "exponent",
    "flights": "end time over the first flight's",
    "rarity": "first flight over its contact",
    "durations": "end time over the contact's",
    "joint_angle": "joint angle [rad]",
    "contact_angle": "contact angle [rad]",
    "rim_speed": "speed of the seat's pitch circle [m/s]",
    "creep": "friction's transition speed over that of the pitch circle",
    "friction": "largest friction coefficient",
    "ball_load": "load of a ball, T/(z Rp) + axial load/z [N]",
    "play": "largest clearance of a ball over the onset's width",
    "revolutions": "turns of the drive",
}

KEPT = "envelope.json"


@cache
def guaranteed() -> dict[str, dict[str, tuple[float, float]]]:
    """By scene and measure the range in which every promise was kept; written by ``benchmarks/envelope.py``."""
    text = resources.files("bcfj_jax").joinpath(KEPT).read_text()
    return {kind: {name: (low, high) for name, (low, high) in box.items()} for kind, box in json.loads(text).items()}


def warnings(scene: AbstractScene, params: Params, times: np.ndarray) -> list[str]:
    """What of a scene lies beyond the ranges in which its promised error is known to hold; none for other scenes."""
    box, found = guaranteed().get(scene.kind, {}), []
    for name, value in measures(scene, params, times).items():
        low, high = box.get(name, (-np.inf, np.inf))
        if not low <= value <= high:
            found.append(f"{MEANING[name]} is {value:.3g}, tried from {low:.3g} to {high:.3g}")
    if not found:
        return []
    return [f"the promised force error is not guaranteed here (docs/envelope.md): {'; '.join(found)}"]


def measures(scene: AbstractScene, params: Params, times: np.ndarray) -> dict[str, float]:
    """The numbers that place a scene, by name; see ``MEANING``. None for a joint without inertia: it takes no steps.

    Args:
        scene, params: as ``simulate`` takes them, values only.
        times: (T,) [s]; the last counts.
    """
    p = {name: float(value) for name, value in params.items()}
    if isinstance(scene, Joint):
        return _of_joint(scene, p, float(times[-1])) if scene.fidelity == "dynamic" else {}
    assert isinstance(scene, Scene)
    sizes = np.asarray(state_scales(scene, params))
    depth, speed = float(sizes[0]), float(sizes[-1])
    found = {"onset": p.get("smoothing", 0.0) / depth, "loss": _loss(p, depth, speed)}
    if "exponent" in p:
        found["exponent"] = p["exponent"]
    if scene.flight is not None:
        flight = float(scene.flight(params))
        found |= {"flights": float(times[-1]) / flight, "rarity": flight * speed / (CONTACT * depth)}
    else:
        found["durations"] = float(times[-1]) * speed / (CONTACT * depth)
    return found


def _loss(p: Mapping[str, float], depth: float, speed: float) -> float:
    if "restitution" in p:
        return 1.0 - p["restitution"]
    if "dashpot" in p:
        return p["dashpot"] * depth / (p["mass"] * speed)
    return p.get("damping", 0.0) * speed


def _of_joint(scene: Joint, p: Mapping[str, float], end: float) -> dict[str, float]:
    rim = abs(p["drive_speed"]) * p["pitch_radius"]
    load = (abs(p["load_torque"]) / p["pitch_radius"] + abs(p["axial_load"])) / scene.balls
    balls = [c.name for c in scene.contacts if c.name in OF_A_BALL]
    rough = [c.name for c in scene.contacts if c.friction is not None]

    def of(name: str) -> list[float]:
        return [p.get(f"{contact}.{name}", p[name]) for contact in rough if name in p]

    found = {
        "joint_angle": abs(p["joint_angle"]),
        "contact_angle": p["contact_angle"],
        "rim_speed": rim,
        "ball_load": load,
        "play": max(p[f"clearance_{name}"] for name in balls) / max(p.get("smoothing", 0.0), 1e-9),
        "revolutions": end * abs(p["drive_speed"]) / (2.0 * np.pi),
    }
    if of("friction_speed") and rim > 0:
        found |= {"creep": min(of("friction_speed")) / rim, "friction": max(of("friction_static"))}
    return found
