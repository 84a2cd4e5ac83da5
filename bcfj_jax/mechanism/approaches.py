"""Where a mechanism's state keeps the approach speeds that its contacts remember, and what they are at a touch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.mechanism.contacts import SLOWEST
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.equations import flat
from bcfj_jax.mechanism.model import Approaches
from bcfj_jax.mechanism.sizes import Params

# A remembered speed that is off by this share is said to be.
OFF = 0.05
# Samples of a flight from which the speed at its end is known.
_FLIGHT = 5


def places(scene: Dynamics) -> tuple[int, ...]:
    """Indices in the state of the approach speeds (``contacts.Approach``), in the order of ``approaches``."""
    found: list[int] = []
    at, members = sum(k or 1 for *_, k in (*scene._placed, *scene._free)), scene.members
    for c in scene.contacts:
        count = members[c.name] or 1
        for _ in range(c.faces if c.memory else 0):
            found += range(at, at + count) if c.remembers else ()
            at += count * len(c.memory)
    return tuple(found)


def approaches(scene: Dynamics, t: Array, y: Array, p: Params) -> Approaches:
    """As ``AbstractModel.approaches``; the memory of a regularised contact stays from the regularisation on."""
    now, members = scene.instant(t, y, p, laws=False), scene.members
    rows, counts = [], []
    for c in scene.contacts:
        if not c.remembers:
            continue
        width = c.coefficients(p).get("smoothing", 0.0)
        for face, touch in scene.faces_of(now, c.name):
            rows.append((face.depth + width, touch.rate, jnp.maximum(touch.rate, SLOWEST)))
            counts.append(members[c.name])
    return Approaches(*(flat(list(part), counts) for part in zip(*rows, strict=True)))


def doubt(scene: Dynamics, params: Mapping[str, Any], run: Any) -> tuple[str, float]:
    """Why a run's restitution is not the one asked for, and from when on [s]: a contact remembers another speed than it met.

    The speed at the end of a flight is that of its last sample, v, carried on under the flight's mean acceleration,
    sqrt(v^2 + (v^2 - u^2) g/(h - g)), with u the speed at the flight's greatest gap h, and g the gap left. Impacts at less
    than half the greatest speed of a contact are not looked at, nor flights of fewer than five samples.
    """
    times, states = run.times, run.trajectory
    at, found = iter(places(scene)), ("", float("nan"))
    for c in (c for c in scene.contacts if c.remembers):
        depths, rates = (np.asarray(x[c.name]).reshape(len(times), -1) for x in (run.penetration, run.rate))
        kept = states[:, [next(at) for _ in range(c.faces * depths.shape[1])]].reshape(len(times), c.faces, -1)
        width = float(scene.coefficient(params, c.name, "smoothing")) if c.smoothing else 0.0
        for k in range(depths.shape[1]):
            for j, met in _met(depths[:, k] + width, rates[:, k]):
                own = kept[j + 1, np.argmin(np.abs(kept[j + 1, :, k] - met)), k]
                if abs(own - met) > OFF * met and not times[j] >= found[1]:
                    text = f"contact '{c.name}' takes an approach speed of {own:.3g} m/s for one of {met:.3g} m/s"
                    right = "speeds below 1 mm/s and flights below 1 um are not resolved; use the law memory_free there"
                    found = f"{text}, so that its restitution is not the one asked for: {right}", float(times[j])
    return found


def _met(depth: np.ndarray, rate: np.ndarray) -> list[tuple[int, float]]:
    """Last samples of flights, and the speeds at which these end [m/s]; of a channel's samples (T,)."""
    ends = np.flatnonzero((depth[:-1] < 0) & (depth[1:] >= 0) & (rate[:-1] > 0))
    found = []
    for j in ends:
        begin = int(np.max(np.flatnonzero(depth[:j] >= 0), initial=-1)) + 1
        if j - begin + 1 < _FLIGHT:
            continue
        top = begin + int(np.argmin(depth[begin : j + 1]))
        high, left = -depth[top], -depth[j]
        gain = (rate[j] ** 2 - rate[top] ** 2) * left / (high - left) if high > left else 0.0
        found.append((int(j), float(np.sqrt(max(rate[j] ** 2 + gain, 0.0)))))
    fastest = max((speed for _, speed in found), default=0.0)
    return [(j, speed) for j, speed in found if speed >= 0.5 * fastest]
