"""Forces of the pilots in the axes of different observers, and which of these give the paper's rhythm.

In the contact's own frame (normal, axial, tangential) and in axes fixed in space equal balls repeat a force six times a turn;
in axes that turn with a part, once a turn. The paper does not name its frame. In turning and fixed axes x (radial, through
the first window or track) is in the place of "normal", z (the part's axis) of "axial", y of "tangential".
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import jax
import numpy as np

from bcfj_jax.analysis import features, histories
from bcfj_jax.core.errors import InputError
from bcfj_jax.models.joint.geometry import cage_axes
from bcfj_jax.reproduction.claims import claim
from bcfj_jax.reproduction.record import Record

CONTACT = "contact"
FRAMES = {
    CONTACT: "the contact's own: normal, axial, tangential",
    "cage": "axes that turn about the cage's axis as the cage does",
    "windows": "axes that turn about the cage's axis as balls and windows do",
    "seat": "the seat's axes",
    "head": "the head's axes",
    "world": "axes fixed in space, z along the seat",
}
# Claims whose numbers depend on the frame, and those of them by which a frame is judged: rhythm and residuals.
FRAMED = ("Q17", "Q18", "Q19", "Q20", "Q21", "Q22", "Q35", "Q36")
JUDGED = ("Q17", "Q22", "Q35", "Q36")
# Share of the run that counts as its start, order of the polynomial, windows of its fits.
EARLY = 0.4
ORDER = int(claim("Q32").values[0])
WINDOW_NORMAL = (claim("Q33").values[0], claim("Q33").values[1])
WINDOW_AXIAL = (claim("Q34").values[0], claim("Q34").values[1])


# Axes (T, 3, 3), as columns, that have turned about unit vectors (T, 3) by angles (T,).
_axes = jax.jit(jax.vmap(cage_axes))


def later(times: np.ndarray) -> tuple[float, float]:
    """The window of the settled joint."""
    return float(times[0] + EARLY * (times[-1] - times[0])), float(times[-1])


def axes(record: Record, frame: str) -> np.ndarray:
    """Axes of a frame but the contact's as columns, (T, 3, 3), in world axes."""
    turns = record.turns
    along = np.ones((turns.seat.size, 1))
    head = np.array([math.sin(record.angle), 0.0, math.cos(record.angle)])
    found = {
        "cage": (turns.cage_axis, turns.cage),
        "windows": (turns.cage_axis, turns.seat),
        "seat": (along * [0.0, 0.0, 1.0], turns.seat),
        "head": (along * head, turns.head),
        "world": (along * [0.0, 0.0, 1.0], np.zeros_like(turns.seat)),
    }
    return np.asarray(_axes(*found[frame]))


def components(record: Record, contact: str, frame: str) -> np.ndarray:
    """Force of a pilot (T, 3) [N]: normal, axial, tangential in the contact's frame, else x, z, y of the frame."""
    if frame == CONTACT:
        return record.run.force[contact]
    return np.einsum("tij,ti->tj", axes(record, frame), record.world[contact])[:, [0, 2, 1]]


def slip(record: Record) -> float:
    """How far the cage has fallen behind its balls at the end [rad]; negative where it is ahead."""
    return float(record.turns.seat[-1] - record.turns.cage[-1])


def rhythm(times: np.ndarray, seat: np.ndarray, head: np.ndarray, turn: float) -> dict[str, tuple[float, ...]]:
    """The claims of ``FRAMED`` from the forces of both pilots in a frame (T, 3) [N], in their units; NaN for what they do not
    show. ``turn`` is the time of one revolution [s].
    """
    window = later(times)
    periods = tuple(histories.period(times, seat[:, k], window) for k in range(3))
    cycle = periods[0] if math.isfinite(periods[0]) else turn
    try:
        apart = float(histories.delay(times, seat[:, 0], head[:, 0], cycle, window))
    except InputError:
        apart = math.nan
    sizes = []
    for k, where in ((0, WINDOW_NORMAL), (1, WINDOW_AXIAL)):
        inside = times[-1] >= where[1]
        sizes.append(float(features.residual_oscillation(times, seat[:, k], where, ORDER)) if inside else math.nan)
    return {
        "Q17": periods,
        "Q18": (max(periods) - min(periods) if np.isfinite(periods).all() else math.nan,),
        "Q19": (1.0 / periods[0],),
        "Q20": (float(np.max(np.abs(seat[:, 0]))),),
        "Q21": (float(np.max(np.abs(head[:, 0]))),),
        "Q22": (apart,),
        "Q35": (sizes[0],),
        "Q36": (sizes[1],),
    }


def measured(record: Record, frame: str, turn: float) -> dict[str, tuple[float, ...]]:
    """``rhythm`` of a joint with both pilots in one of ``FRAMES``; the delay (Q22) without its sign."""
    seat, head = (components(record, name, frame) for name in ("seat_cage", "head_cage"))
    found = rhythm(record.run.times, seat, head, turn)
    return found | {"Q22": (abs(found["Q22"][0]),)}


def reached(values: tuple[float, ...], id: str, within: float) -> bool:
    """Whether all numbers of a claim are met within a share of them."""
    return all(abs(v - p) <= within * abs(p) for v, p in zip(values, claim(id).values, strict=True))


def sensible(found: Mapping[str, Mapping[str, tuple[float, ...]]], within: float) -> str:
    """The frame in which most numbers of ``JUDGED`` are reached; the first of equals."""

    def score(frame: str) -> int:
        pairs = [(v, p) for id in JUDGED for v, p in zip(found[frame][id], claim(id).values, strict=True)]
        return sum(abs(v - p) <= within * abs(p) for v, p in pairs)

    return max(found, key=score)
