"""Inverses of small matrices without LAPACK: a library call costs microseconds, more than a step's arithmetic."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def product(a: Array, b: Array) -> Array:
    """a @ b of (..., i, j) and (..., j, k), elementwise."""
    return jnp.sum(a[..., None] * b[..., None, :, :], -2)


_SIGNS = np.zeros((3, 3, 3))
_SIGNS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], _SIGNS[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0


def skew(vector: Array) -> Array:
    """Matrix of a cross product, (..., 3) to (..., 3, 3):  v x w and rows x v  by it. Without slices, on which kernels branch."""
    return jnp.sum(-_SIGNS * vector[..., None, None, :], -1)


def inverse3(matrix: Array) -> Array:
    """Inverse of (..., 3, 3) by cross products."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], -1)
    return adjugate / jnp.sum(a * adjugate[..., 0], -1)[..., None, None]


def inverse6(matrix: Array) -> Array:
    """Inverse of (..., 6, 6) by its 3 x 3 blocks; the upper left one must be regular."""
    a, b, c, d = matrix[..., :3, :3], matrix[..., :3, 3:], matrix[..., 3:, :3], matrix[..., 3:, 3:]
    first = inverse3(a)
    right, left = product(first, b), product(c, first)
    last = inverse3(d - product(c, right))
    far = product(right, last)
    top = jnp.concatenate([first + product(far, left), -far], -1)
    return jnp.concatenate([top, jnp.concatenate([-product(last, left), last], -1)], -2)


def inverse(matrix: Array) -> Array:
    """Inverse of one (n, n) matrix by Gauss-Jordan elimination in place, without pivoting.

    For matrices  I/s - J  whose diagonal dominates where the step is short, and whose symmetric part is positive where
    it is long; the step-size control rejects what a small pivot spoils.
    """
    index = jnp.arange(matrix.shape[0])

    def eliminate(k, a):
        here = index == k
        row = jnp.where(here, 1.0, a[k]) / a[k, k]
        column = jnp.where(here, 0.0, a[:, k])
        rest = jnp.where(here[None, :], 0.0, a) - column[:, None] * row[None, :]
        return jnp.where(here[:, None], row[None, :], rest)

    return jax.lax.fori_loop(0, matrix.shape[0], eliminate, matrix)


def block_diagonal(blocks: Array) -> Array:
    """(n, i, j) as one (n i, n j)."""
    n, i, j = blocks.shape
    return (blocks[:, :, None] * jnp.eye(n)[:, None, :, None]).reshape(n * i, n * j)
