"""What springs do, whatever they hold: by a stiffness or a table, on one side or both, along axes and about them."""

from __future__ import annotations

import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from bcfj_jax.core.errors import InputError, one_of
from bcfj_jax.core.vectors import Axes, Number, Vector, dot, minus, plus, scale, seen, times, turned
from bcfj_jax.mechanism import sizes
from bcfj_jax.mechanism.acting import Onset
from bcfj_jax.mechanism.programmes import Table, given_table

SIDES = ("both", "pull", "push")
# So many inner knots of a table are looked at, from its first on; the others are passed as if the table were smooth there.
_KNOTS = 16


def field(where: str) -> Any:
    """A field that is a table of extensions and forces, or None."""
    return eqx.field(static=True, default=None, converter=lambda x: given_table(where, x, "extensions"))


def check(where: str, side: str, table: Table | None, stiffness: Any) -> None:
    """Refuse a side that is none, and a table that stands beside a stiffness."""
    one_of(f"{where} side", "side", side, SIDES)
    if table is not None and not sizes.nothing(stiffness):
        raise InputError(f"{where} table", "is given beside a stiffness", "give one of them")


def force(x: Number, rate: Number, k: Number, c: Number, table: Table | None, side: str) -> Number:
    """f(x) + c x' of an extension x and its rate; on one side max(f + c x', 0) for x > 0, or min for x < 0, else 0."""
    found = plus(times(k, x) if table is None else _by(table, x), times(c, rate))
    if side == "both":
        return found
    if side == "pull":
        return jnp.where(jnp.asarray(x) > 0.0, jnp.maximum(found, 0.0), 0.0)
    return jnp.where(jnp.asarray(x) < 0.0, jnp.minimum(found, 0.0), 0.0)


def corners(table: Table | None, side: str) -> tuple[tuple[float, float], ...]:
    """Where the force of an extension x begins or bends: of each the sign and the place, sign (x - place) > 0 beyond."""
    sides = {"both": (), "pull": ((1.0, 0.0),), "push": ((-1.0, 0.0),)}[side]
    return sides if table is None else (*sides, *((1.0, knot) for knot in table[0][1:-1][:_KNOTS]))


def onsets(
    x: Number, rate: Number, law: tuple[Number, Number, Table | None, str], more: tuple[Number, Number]
) -> list[Onset]:
    """Of each of ``corners``, of an extension x and its rate; ``law``: what ``force`` reads; ``more``: speed and bends."""
    *_, table, side = law
    forces = itertools.chain((0.0 if side == "both" else force(x, rate, *law),), itertools.repeat(0.0))
    return [
        Onset(times(sign, minus(x, at)), times(sign, rate), more[0], held, more[1])
        for (sign, at), held in zip(corners(table, side), forces, strict=False)
    ]


def _by(table: Table, x: Number) -> Number:
    """Linear between the points of a table, and on with the slope at its ends."""
    knots, values = (np.asarray(row, float) for row in table)
    slopes = np.diff(values) / np.diff(knots)
    found = jnp.asarray(values[0] + slopes[0] * (x - knots[0]))
    for knot, bend in zip(knots[1:-1], np.diff(slopes), strict=True):
        found = found + bend * jnp.maximum(x - knot, 0.0)
    return found


def along(k: Any, axes: Axes, v: Vector) -> Vector:
    """k v of a world vector, k one number or three along axes."""
    if not isinstance(k, tuple):
        return scale(k, v)
    x, y, z = seen(axes, v)
    return turned(axes, (times(k[0], x), times(k[1], y), times(k[2], z)))


def turn(a: Axes, b: Axes) -> Vector:
    """Rotation vector [rad] from one frame's axes to another's, in the first's; its length is below pi.

    With R = A' B, of an angle q about n:  n sin q = (R_32 - R_23, R_13 - R_31, R_21 - R_12)/2,  cos q = (tr R - 1)/2.
    """
    r = [[jnp.asarray(dot(x, y)) for y in b] for x in a]
    x, y, z = (0.5 * (r[i][j] - r[j][i]) for i, j in ((2, 1), (0, 2), (1, 0)))
    cosine = 0.5 * (r[0][0] + r[1][1] + r[2][2] - 1.0)
    squared = x * x + y * y + z * z
    some = squared > 1e-12
    size = jnp.sqrt(jnp.where(some, squared, 1.0))
    # q/sin q, by its series at 0.
    ratio = jnp.where(some, jnp.arctan2(size, cosine) / size, 1.0 + squared / 6.0)
    return scale(ratio, (x, y, z))
