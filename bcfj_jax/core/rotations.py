"""Rotations: axes as columns, unit quaternions with the scalar first, rotation vectors; of arrays of them at a time.

SciPy's ``Rotation`` does the same; to import it takes a tenth of a short command's time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from bcfj_jax.core.vectors import Axes, Number


def attitude(q: Sequence[Number] | np.ndarray) -> Axes:
    """Axes of a quaternion (any length but 0), scalar first, as columns."""
    w, x, y, z = q
    size = w * w + x * x + y * y + z * z
    two = 2.0 / size
    return (
        (1.0 - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)),
        (two * (x * y - w * z), 1.0 - two * (x * x + z * z), two * (y * z + w * x)),
        (two * (x * z + w * y), two * (y * z - w * x), 1.0 - two * (x * x + y * y)),
    )


def quaternion(axes: Any, xp: Any = jnp) -> Any:
    """Unit quaternion (..., 4), scalar first and not negative, of axes (..., 3, 3) as columns; by NumPy where ``xp`` is.

    From the largest of its four components (Shepperd, J. Guidance and Control 1, 1978), so that none is a difference of
    equal numbers.
    """
    a = axes
    x, y, z = a[..., 0, 0], a[..., 1, 1], a[..., 2, 2]
    one = xp.ones_like(x)
    wx, wy, wz = (a[..., i, j] - a[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    xy, yz, zx = (a[..., i, j] + a[..., j, i] for i, j in ((1, 0), (2, 1), (0, 2)))
    # Four times q_i q_j, row by row.
    rows = (
        (one + x + y + z, wx, wy, wz),
        (wx, one + x - y - z, xy, zx),
        (wy, xy, one - x + y - z, yz),
        (wz, zx, yz, one - x - y + z),
    )
    table = xp.stack([xp.stack(row, -1) for row in rows], -2)
    best = xp.argmax(xp.diagonal(table, axis1=-2, axis2=-1), -1)
    row = xp.take_along_axis(table, best[..., None, None], -2)[..., 0, :]
    q = row / xp.linalg.norm(row, axis=-1, keepdims=True)
    return xp.where(q[..., :1] < 0.0, -q, q)


def matrix(q: np.ndarray) -> np.ndarray:
    """Axes (..., 3, 3) as columns of quaternions (..., 4), by NumPy."""
    return np.stack([np.stack(column, -1) for column in attitude(np.moveaxis(q, -1, 0))], -1)


def vector(axes: np.ndarray) -> np.ndarray:
    """Rotation vector (..., 3) [rad], at most half a turn long, of axes (..., 3, 3), by NumPy."""
    q = quaternion(axes, np)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    half = np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > 0.0, 2.0 * half / np.where(sine > 0.0, sine, 1.0), 2.0)


def turned_by(turn: np.ndarray) -> np.ndarray:
    """Axes (..., 3, 3) of a rotation vector (..., 3) [rad], by NumPy."""
    half = 0.5 * np.linalg.norm(turn, axis=-1, keepdims=True)
    return matrix(np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turn], -1))
