"""Where a result keeps its promised error: how far a scene is from those on which the promise was measured.

A scene is placed by a few numbers, most of them without unit (``measures``). Within the ranges of ``envelope.json``
every random scene of ``benchmarks/levels.py`` kept its promised error at every level; beyond them runs are usable and
nothing is promised, which ``warnings`` says. The joint has no range yet: not every random one kept its promise. What
cannot be computed is refused before (``quantities``, ``simulation.check``). ``docs/envelope.md`` is made of the same
numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from bcfj_jax.dynamics import contact_time, state_scales
from bcfj_jax.scene import AbstractScene, Params, Scene

# What a measure is, in words for a warning.
MEANING = {
    "onset": "smoothing over the deepest penetration",
    "loss": "share of the speed that damping takes, to first order",
    "exponent": "exponent",
    "flights": "end time over the first flight's",
    "rarity": "first flight over its contact",
    "durations": "end time over the contact's",
}

KEPT = "envelope.json"


@cache
def guaranteed() -> dict[str, dict[str, tuple[float, float]]]:
    """By scene and measure the range in which every promise was kept; written by ``benchmarks/envelope.py``."""
    text = resources.files("bcfj_jax").joinpath(KEPT).read_text()
    return {kind: {name: (low, high) for name, (low, high) in box.items()} for kind, box in json.loads(text).items()}


def warnings(scene: AbstractScene, params: Params, times: np.ndarray) -> list[str]:
    """What of a scene lies beyond the ranges in which its promised error is known to hold; none for other scenes."""
    box, found = guaranteed().get(scene.kind), []
    if box is None or not isinstance(scene, Scene):
        return []
    for name, value in measures(scene, params, times).items():
        low, high = box.get(name, (-np.inf, np.inf))
        if not low <= value <= high:
            found.append(f"{MEANING[name]} is {value:.3g}, tried from {low:.3g} to {high:.3g}")
    if not found:
        return []
    return [f"the promised force error is not guaranteed here (docs/envelope.md): {'; '.join(found)}"]


def measures(scene: Scene, params: Params, times: np.ndarray) -> dict[str, float]:
    """The numbers that place a scene of springs, by name; see ``MEANING``.

    Args:
        scene, params: as ``simulate`` takes them, values only.
        times: (T,) [s]; the last counts.
    """
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


def _loss(p: Mapping[str, float], depth: float, speed: float) -> float:
    if "restitution" in p:
        return 1.0 - p["restitution"]
    if "dashpot" in p:
        return p["dashpot"] * depth / (p["mass"] * speed)
    return p.get("damping", 0.0) * speed
