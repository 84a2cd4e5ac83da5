"""How far a joint is from those on which its promised error was measured (``analysis.envelope``)."""

from __future__ import annotations

import numpy as np
from jax import Array

from bcfj_jax.core.programs import ask
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.scales import scales
from bcfj_jax.models.joint.scene import GROOVES, Joint


def place(scene: Joint, params: Params) -> dict[str, float]:
    """Numbers by name; the worst contact counts, and what the joint has not is left out."""
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
            place = float(ask("joint's place", _place, (scene,), (dict(params),)))
            found["onset_under_load"] = _worst(scene, params, "smoothing") / place
            # Between the ends of its window a ball swings freely: that is no play.
            for what, names in (("play", (*GROOVES, "cage_ball")), ("knock", scene.pilots)):
                ratios = [
                    np.float64(p[f"clearance_{name}"]) / float(scene.coefficient(params, name, "smoothing"))
                    for name in names
                    if scene.has(name)
                ]
                found |= {what: float(max(ratios))} if ratios else {}
    return found


def _place(scene: Joint, params: Params) -> Array:
    return scales(scene, params)[0]


def _worst(scene: Joint, params: Params, name: str) -> float:
    """The largest value of a coefficient over the contacts that read it; every one reads its smoothing."""
    readers = [x.name for x in scene.contacts if name in (*x.own, "smoothing")]
    return max(float(scene.coefficient(params, contact, name)) for contact in readers)
