"""Vectors by components, in which an exact zero costs nothing.

A vector is a tuple of three numbers; a number is an array (a scalar, or (k,) over the members of a body) or a Python
float. A Python 0.0 is known to be zero when the program is traced, so products with it, and sums, leave the program: a
planar mechanism has no third component, a slide no rotation, and nobody says so twice. Arithmetic by components also
lets the batch be the vector axis: nothing is reduced over an axis of length 3.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

Number = Any  # Array | float
Vector = tuple[Number, Number, Number]
# Axes of a frame, as columns in world components.
Axes = tuple[Vector, Vector, Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
WORLD: Axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _is(x: Number, value: float) -> bool:
    return isinstance(x, (int, float)) and x == value


def plus(a: Number, b: Number) -> Number:
    """a + b."""
    return b if _is(a, 0.0) else a if _is(b, 0.0) else a + b


def minus(a: Number, b: Number) -> Number:
    """a - b."""
    return a if _is(b, 0.0) else -b if _is(a, 0.0) else a - b


def times(a: Number, b: Number) -> Number:
    """a b."""
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    return b if _is(a, 1.0) else a if _is(b, 1.0) else -b if _is(a, -1.0) else -a if _is(b, -1.0) else a * b


def add(*vectors: Vector) -> Vector:
    """Sum."""
    total = vectors[0]
    for v in vectors[1:]:
        total = (plus(total[0], v[0]), plus(total[1], v[1]), plus(total[2], v[2]))
    return total


def subtract(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2]))


def scale(s: Number, v: Vector) -> Vector:
    """s v."""
    return (times(s, v[0]), times(s, v[1]), times(s, v[2]))


def negative(v: Vector) -> Vector:
    """-v."""
    return scale(-1.0, v)


def dot(a: Vector, b: Vector) -> Number:
    """a . b."""
    return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (
        minus(times(a[1], b[2]), times(a[2], b[1])),
        minus(times(a[2], b[0]), times(a[0], b[2])),
        minus(times(a[0], b[1]), times(a[1], b[0])),
    )


def turned(axes: Axes, v: Vector) -> Vector:
    """A vector given in a frame's axes, in world components."""
    return add(scale(v[0], axes[0]), scale(v[1], axes[1]), scale(v[2], axes[2]))


def seen(axes: Axes, v: Vector) -> Vector:
    """A world vector in a frame's axes."""
    return (dot(axes[0], v), dot(axes[1], v), dot(axes[2], v))


def length(v: Vector, least: float = 0.0) -> Number:
    """sqrt(v . v + least^2); smooth at zero where ``least`` > 0, finite derivatives where it is not."""
    if all(_is(x, 0.0) for x in v):
        return least
    squared = dot(v, v)
    if least:
        return jnp.sqrt(squared + least**2)
    some = squared > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)


def unit(v: Vector) -> Vector:
    """Direction of a vector; zero for the zero vector, with finite derivatives."""
    if all(_is(x, 0.0) for x in v):
        return ZERO
    squared = dot(v, v)
    if isinstance(squared, (int, float)):
        return scale(1.0 / squared**0.5, v) if squared else ZERO
    some = squared > 0
    inverse = jnp.where(some, 1.0 / jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)
    return scale(inverse, v)


def array(v: Vector) -> Any:
    """The components along a last axis, (..., 3)."""
    return jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(x, dtype=jnp.float64) for x in v)), -1)


def spread(x: Number, members: int) -> Any:
    """A number for each of so many members, (k,); a scalar where there are none."""
    return jnp.broadcast_to(jnp.asarray(x, dtype=jnp.float64), (members,) if members else ())


def stacked(v: Vector, members: int) -> Any:
    """The components along a last axis for each of so many members, (k, 3); (3,) where there are none."""
    return jnp.stack([spread(x, members) for x in v], -1)
