"""Where a result keeps its promised error: how far a scene is from those on which the promise was measured.

A scene is placed by a few numbers, most of them without unit (``AbstractModel.envelope``). Within the ranges of
``envelope.json`` every random scene of ``benchmarks/solve/levels.py`` kept its promised error at every level; beyond them
runs are usable and nothing is promised, which ``warnings`` says. A model that forgets its start has its promise from
there on (``AbstractModel.settled_from``; a joint's begins when its load has risen and a ball's pitch has passed):
``of_the_start`` says which peaks are from before. What cannot be computed is refused before (``AbstractModel.check``).
``docs/envelope.md`` is made of the same numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.model import AbstractModel, Params

# What a measure is, in words for a warning.
MEANING = {
    "onset": "smoothing over the deepest penetration",
    "loss": "share of the speed that damping takes, to first order",
    "exponent": "exponent",
    "flights": "end time over the first flight's",
    "rarity": "first flight over its contact",
    "durations": "end time over the contact's",
    "sliding": "a ball's speed along its track over friction's transition speed",
    "play": "a ball's clearance over the width of contact regularisation",
    "knock": "the cage's clearance over the width of contact regularisation",
    "onset_under_load": "width of contact regularisation over the penetration under load",
    "angle": "joint angle [rad]",
    "friction": "static friction",
    "damping": "damping [s/m]",
    "centrifugal": "centrifugal force of a ball over its load",
    "axial": "axial load over the balls' load",
}

KEPT = "envelope.json"
# Peaks as high as later ones, to a percent, are identified by these.
_HIGHER = 0.01


@cache
def guaranteed() -> dict[str, dict[str, tuple[float, float]]]:
    """By scene and measure the range in which every promise was kept; written by ``benchmarks/analysis/envelope.py``."""
    text = resources.files("bcfj_jax.analysis").joinpath(KEPT).read_text()
    return {kind: {name: (low, high) for name, (low, high) in box.items()} for kind, box in json.loads(text).items()}


def warnings(scene: AbstractModel, params: Params, times: np.ndarray) -> list[str]:
    """What of a scene lies beyond the ranges in which its promised error is known to hold.

    Nothing of a model without a history, which takes no steps, and of kinds of which ``envelope.json`` has no ranges.
    """
    box = guaranteed().get(scene.kind)
    if box is None or not scene.traits.history:
        return []
    numbers, untried = scene.envelope(params, times)
    found = []
    for name, value in numbers.items():
        low, high = box.get(name, (-np.inf, np.inf))
        if not low <= value <= high:
            found.append(f"{MEANING[name]} is {value:.3g}, measured from {low:.3g} to {high:.3g}")
    found += untried
    begin = scene.settled_from(params)
    if begin > 0.0 and times[-1] <= begin:
        when = format_si(begin, "s") if np.isfinite(begin) else "never, because the drive does not turn"
        found.append(f"the run ends before {scene.settled_when} ({when})")
    if not found:
        return []
    return [f"the promised force error is not guaranteed here (docs/envelope.md): {'; '.join(found)}"]


def of_the_start(
    scene: AbstractModel, params: Params, times: np.ndarray, forces: Mapping[str, np.ndarray]
) -> list[str]:
    """Contacts whose peak is from before the promise begins, and higher than any later; forces as of a ``Run``."""
    if not scene.traits.history:
        return []
    begin, found = scene.settled_from(params), []
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
    return [
        f"the force error is not promised for peaks before {scene.settled_when} ({format_si(begin, 's')}): {'; '.join(found)}"
    ]
