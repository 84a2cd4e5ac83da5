"""What steps of a mechanism must not pass over: surfaces that meet, kinks of amounts over time, touches that are remembered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.vectors import length, plus, spread, subtract, times
from bcfj_jax.mechanism.contacts import SLOWEST
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.equations import flat
from bcfj_jax.mechanism.model import Approaches, Params, Proximity

# A function of time of the user's own is looked at so many times in a run, and steps end at so many instants of it.
_LOOKS, _ENDS = 2**14, 64
# Breaks nearer to each other than this share of the run are one.
_CLOSE = 1e-12
# A remembered speed that is off by this share is said to be.
OFF = 0.05
# Samples of a flight from which the speed at its end is known.
_FLIGHT = 5
# Second differences below this share of a function's size are rounding.
_ROUNDING = 1e-10


def proximity(m: Dynamics, t: Array, y: Array, p: Params) -> Proximity:
    """``AbstractModel.proximity``: of every face, members apart, in the order of contacts; then where loads begin to act.

    A gap is a function of the place of b's marker in a's axes and, unless rotations do not bend it (``AbstractGap.bends``),
    of b's rotation. The speed is that of this place, in a's axes where a's rotation counts, and of what b's rotation carries.
    """
    now, rows = m.instant(t, y, p, laws=False), []
    for c in m.bundles:
        first, second = c.parts(now.bodies.parts)
        a, b = c.frames(now.bodies.parts, p)
        values = c.coefficients(p)
        bends = c.gap.bends(values)
        turns = np.isfinite(bends.angle)
        there = b.place if turns else a.place
        ours, theirs = subtract(there, first.place), subtract(b.place, second.place)
        moved = subtract(second.velocity_at(theirs), first.velocity_at(ours))
        spin = plus(length(first.spin), length(second.spin)) if turns else 0.0
        speed = plus(length(moved), times(bends.arm, spin))
        width, members = values.get("smoothing", 0.0), m.side_by_side(c)
        for face, touch in now.faces[c.name]:
            fast = jnp.maximum(speed, jnp.abs(touch.rate))
            row = face.depth + width, touch.rate, fast, spin / bends.angle, bends.length
            rows.append([jnp.atleast_1d(spread(x, members)) for x in row])
    begun = [(x.depth, x.rate, x.speed, jnp.zeros_like(x.depth), x.bends) for x in m.begun(t, now, p)]
    faces = [jnp.concatenate(part)[_order(m)] for part in zip(*rows, strict=True)] if rows else [jnp.zeros(0)] * 5
    return Proximity(*(jnp.concatenate([x, *more]) for x, *more in zip(faces, *begun, strict=True)) if begun else faces)


def _order(m: Dynamics) -> np.ndarray | slice:
    """Rows of ``bundles`` in the order of contacts, faces one after the other, members within."""
    if len(m.bundles) == len(m.contacts):
        return slice(None)
    found: dict[str, list[np.ndarray]] = {c.name: [] for c in m.contacts}
    at = 0
    for c in m.bundles:
        for _ in range(c.faces):
            count = m.side_by_side(c) or 1
            rows, at = np.arange(at, at + count), at + count
            for one, own in zip(c.each, np.split(rows, len(c.each)), strict=True):
                found[one.name].append(own)
    return np.concatenate([row for rows in found.values() for row in rows])


def breaks(m: Dynamics, p: Params, end: ArrayLike) -> Array | None:
    """``AbstractModel.breaks``: of loads and drives what they say of themselves, and of functions what looks find."""
    drives = [(b.name, b.drive) for b in m.ordered if b.drive is not None]
    said = [(drive, drive.kinks(name, p)) for name, drive in drives] + [(load, load.kinks(p)) for load in m.loads]
    known = [x for _, found in said for x in found or ()]
    unknown = [part for part, found in said if found is None]
    looked: list[Array] = []
    if unknown:
        start, loads = m.initial_state(p), [load for load in m.loads if load in unknown]

        def amounts(t: Array) -> Array:
            """Motions of drives and forces of loads at a time, with everything else as it starts."""
            moved = [drive.position(t, name, p) for name, drive in drives if drive in unknown]
            return jnp.concatenate([jnp.asarray(moved, dtype=jnp.float64), m.loaded(loads, t, start, p)])

        grid = jnp.asarray(end) * jnp.linspace(0.0, 1.0, _LOOKS + 1)
        looked.append(_ends(grid, jax.vmap(amounts)(grid)))
    # XLA takes seconds to sort the numbers of a long table while it compiles.
    xp = jnp if any(is_traced(x) for x in (*known, *looked)) else np
    times = [xp.asarray(x, dtype=np.float64).ravel() for x in (*known, *looked)]
    if not sum(x.size for x in times):
        return None
    found = xp.concatenate(times)
    found = jax.lax.stop_gradient(jnp.asarray(xp.sort(xp.where(xp.isfinite(found), found, np.inf))))
    # Between two that are as good as one no step has room.
    return jnp.sort(jnp.where(jnp.diff(found, prepend=-jnp.inf) > _CLOSE * end, found, jnp.inf))


def _ends(grid: Array, values: Array) -> Array:
    """Instants (K,) at which steps have to end, of functions (N + 1, n) of time on an even grid.

    They lie where the functions bend: each pair has the same sum of roots of second differences between it. Infinite for
    functions that do not bend.
    """
    bent, high, low = jnp.abs(jnp.diff(values, 2, axis=0)), jnp.max(values, axis=0), jnp.min(values, axis=0)
    bent = jnp.where(bent > _ROUNDING * jnp.maximum(jnp.abs(high), jnp.abs(low)), bent, 0.0)
    bent = jnp.max(bent / jnp.maximum(high - low, 1e-300), axis=1, initial=0.0)
    # Each look stands for the interval before it and the one after it.
    gone = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.sqrt(jnp.append(bent, 0.0) + jnp.append(0.0, bent)))])
    share = (jnp.arange(_ENDS) + 0.5) / _ENDS
    # ``interp`` wants places that increase: those without bend are passed over at once.
    gone = gone + 1e-12 * gone[-1] * jnp.linspace(0.0, 1.0, gone.size)
    at = jnp.interp(share * gone[-1], gone, grid)
    return jnp.where(gone[-1] > 0, at, jnp.inf)


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
