"""What steps of a mechanism must not pass over: surfaces that meet within a step, kinks and bursts of amounts over time."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.vectors import length, plus, spread, subtract, times
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.model import Params, Proximity

# A function of time of the user's own is looked at so many times in a run, and steps end at so many instants of it.
_LOOKS, _ENDS = 2**14, 64
# Breaks nearer to each other than this share of the run are one.
_CLOSE = 1e-12
# Second differences below this share of a function's size are rounding.
_ROUNDING = 1e-10


def proximity(m: Dynamics, t: Array, y: Array, p: Params) -> Proximity:
    """``AbstractModel.proximity``: of every face, members apart, in the order of contacts.

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
        moved = subtract(
            second.velocity_at(subtract(b.place, second.place)), first.velocity_at(subtract(there, first.place))
        )
        spin = plus(length(first.spin), length(second.spin)) if turns else 0.0
        speed = plus(length(moved), times(bends.arm, spin))
        width, members = values.get("smoothing", 0.0), m.side_by_side(c)
        for face, touch in now.faces[c.name]:
            row = (
                face.depth + width,
                touch.rate,
                jnp.maximum(speed, jnp.abs(touch.rate)),
                spin / bends.angle,
                bends.length,
            )
            rows.append([jnp.atleast_1d(spread(x, members)) for x in row])
    return Proximity(*(jnp.concatenate(part)[_order(m)] for part in zip(*rows, strict=True)))


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
