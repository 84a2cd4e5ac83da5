"""The joint repeats itself: from one ball's pitch to the next its forces are the same, with the balls renumbered.

A turn of the seat by 2 pi/n takes every track to where the next one was, so nothing that acts has changed, and under
steady load a motion that has forgotten its start is that of a pitch ago: ball j does what ball j + 1 did. Of unequal
balls a pitch here is a whole turn, and each does what it did. ``fold`` turns a long run into a short one, its load's
rise and some pitches; ``mismatch`` says how far the last of these was from repeating the one before; ``unfolded`` gives
the long run's arrays. NumPy, on the host, but for ``pitch_before``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.mechanism.model import Params
from bcfj_jax.mechanism.repeating import Folded, folded
from bcfj_jax.models.joint.scene import OF_A_BALL, WINDOW_END, Joint

# Instants at which two pitches are compared: in the second half alone. A start that dies away is then larger in what is
# compared than anywhere in the pitch that is repeated, as that comes later.
_PHASES = 48


def _pitch(scene: Joint, params: Params) -> float:
    """Of a ball [s]; infinite of a seat at rest."""
    speed = abs(float(params["drive_speed"]))
    return 2.0 * np.pi / (scene.balls * speed) if speed > 0.0 else np.inf


def risen(scene: Joint, params: Params, count: float) -> float:
    """When the load has risen and ``count`` pitches have passed [s]; after one the start is forgotten."""
    return scene.programmes.risen(params) + count * _pitch(scene, params)


def fold(scene: Joint, params: Params, times: np.ndarray, end: float, whole: bool = False) -> Folded:
    """The short run that stands for a long one.

    ``end`` of the short run [s] is a pitch and a half or more after the load has risen; ``whole`` leaves all times in place.
    """
    period = scene.pitches * _pitch(scene, params)
    return folded(times, period, end, 0.5 * period * np.arange(_PHASES)[::-1] / _PHASES, whole)


def _renumbered(scene: Joint, params: Params, values: np.ndarray, pitches: np.ndarray, axis: int = 1) -> np.ndarray:
    """Values (T, balls, ...) of instants that many pitches later: ball j does what ball j + pitches did."""
    which = (np.arange(scene.balls) + (ways(scene, params) * pitches)[:, None]) % scene.balls
    return np.take_along_axis(values, which.reshape(*which.shape, *[1] * (values.ndim - 2)), axis)


def unfolded(scene: Joint, params: Params, short: Folded, histories: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Histories by contact, (M, ...), of the long run, (T, ...)."""
    found = {}
    for name, values in histories.items():
        wanted = values[short.index]
        found[name] = _renumbered(scene, params, wanted, short.pitches) if name in OF_A_BALL else wanted
    return found


def _orders(scene: Joint) -> np.ndarray:
    """Where the flat state of a joint whose balls are renumbered by so many stands in the state itself, (balls, n)."""
    n, width = scene.balls, scene.width * sum(faces for name, faces in scene.bristles.items() if name in OF_A_BALL)
    orders = np.tile(np.arange(scene.states), (n, 1))
    for first, size in ((0, 3), (3 * n + scene.coupling, scene.twist), (scene.moving, width)):
        balls = np.arange(first, first + n * size).reshape(n, size)
        for shift in range(n):
            orders[shift, first : first + n * size] = np.roll(balls, -shift, 0).ravel()
    return orders


def unfolded_states(scene: Joint, params: Params, short: Folded, states: np.ndarray) -> np.ndarray:
    """Flat states (M, n) of the long run, (T, n): balls renumbered, head and seat turned on."""
    which = ways(scene, params) * short.pitches % scene.balls
    wanted = np.take_along_axis(states[short.index], _orders(scene)[which], 1)
    wanted[:, _turning(scene)] += (_angle(scene, params) * short.pitches)[:, None]
    return wanted


def pitch_before(scene: Joint, params: Params, state: Array) -> Array:
    """Flat state (n,) that a joint in steady motion had a pitch ago. JAX, pure."""
    way = jnp.sign(jnp.asarray(params["drive_speed"]))
    if not scene.unequal:
        orders = _orders(scene)
        state = jnp.where(way > 0.0, state[orders[-1]], state[orders[1]])
    return state.at[np.array(_turning(scene))].add(-2.0 * jnp.pi * scene.pitches / scene.balls * way)


def ways(scene: Joint, params: Params) -> int:
    """By how many a pitch renumbers the balls."""
    return 0 if scene.unequal else int(np.sign(float(params["drive_speed"])))


def _angle(scene: Joint, params: Params) -> float:
    """By which the seat turns until a steady motion repeats itself [rad]."""
    return 2.0 * np.pi * scene.pitches / scene.balls * float(np.sign(float(params["drive_speed"])))


def _turning(scene: Joint) -> list[int]:
    """Where the angles stand that a pitch turns on: those of head, seat and cage, whose windows are renumbered too."""
    pieces = [scene.slices[name] for name in ("head_turn", "seat_turn")]
    turns = [3 * scene.balls + piece.start for piece in pieces if piece is not None]
    return turns if scene.azimuth is None else [*turns, scene.azimuth]


def mismatch(
    scene: Joint, params: Params, short: Folded, force: Mapping[str, Any], states: np.ndarray | None = None
) -> dict[str, float]:
    """How far the last pitch is from repeating the one before.

    Of each contact the rms over its second half of the difference of normal forces, its worst member's, as a fraction
    of the largest in the short run; 0 for one that never touches. A cage that drifts between the ends of its windows
    repeats its forces until it is at one: while these bear nothing, it is the way that the cage drifts in the pitches left
    out, as a fraction of the clearance. Forces and states are of the times of ``short``.
    """
    found = {}
    one = np.ones(_PHASES, int)
    for name, values in force.items():
        normal = np.asarray(values)[..., 0]
        first, second = normal[short.before], normal[short.last]
        if name in OF_A_BALL:
            first = _renumbered(scene, params, first, one)
        off, top = np.sqrt(np.mean(np.square(second - first), axis=0)).max(), np.abs(normal).max()
        found[name] = float(off / top) if top != 0.0 else 0.0
        if name == WINDOW_END and not (np.any(first) or np.any(second)):
            assert states is not None
            turned = np.median(states[short.last, scene.azimuth] - states[short.before, scene.azimuth])
            way = abs(turned - _angle(scene, params)) * float(params["pitch_radius"]) * short.pitches.max()
            found[name] = float(way / params[f"clearance_{WINDOW_END}"])
    return found
