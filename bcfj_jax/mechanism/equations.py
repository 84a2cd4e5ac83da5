"""The equations of motion of a mechanism: one place for the mass matrix, the forces and the accelerations.

Kane's form, with partial velocities v_j (of a point) and w_j (angular) of the velocities u:

    sum_k M_jk du_k/dt = Q_j - h_j,   M_jk = sum m v_j . v_k + w_j . I w_k,
    h_j = sum m v_j . drift + w_j . (I swirl + w x I w),   Q_j = sum v_j . F + w_j . T

over the bodies' centres of mass. A driven coordinate has a partial velocity, too: its row gives the drive's force. The
matrix falls into blocks, one a branch of the tree; members of a body are solved side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from bcfj_jax.core.vectors import ZERO, Axes, Number, Vector, add, cross, dot, minus, plus, scale, seen, times, turned
from bcfj_jax.mechanism.bodies import Part

Inertia = Number | tuple[Number, ...]


def inertial(inertia: Inertia, axes: Axes, v: Vector) -> Vector:
    """I v of a world vector; I isotropic, or principal about the body's axes, or (xx, yy, zz, xy, yz, zx) of its matrix."""
    if not isinstance(inertia, tuple):
        return scale(inertia, v)
    x, y, z = seen(axes, v)
    along = (times(inertia[0], x), times(inertia[1], y), times(inertia[2], z))
    if len(inertia) == 6:
        xy, yz, zx = inertia[3:]
        beside = (plus(times(xy, y), times(zx, z)), plus(times(xy, x), times(yz, z)), plus(times(zx, x), times(yz, y)))
        along = add(along, beside)
    return turned(axes, along)


def total(value: Number, members: int) -> Number:
    """A force on a coordinate: of a body with members one each, of any other the sum over a contact's members."""
    return jnp.sum(value) if not members and getattr(value, "ndim", 0) else value


def onto(value: Number, members: int, of: tuple[int, int] | None) -> Number:
    """``total`` of a body, or of one of several that are side by side, 0 for the others."""
    if of is None or _zero(value):
        return total(value, members)
    return jnp.where(np.arange(of[1]) == of[0], total(value, 0), 0.0)


class Equations:
    """Mass matrix and forces being gathered; ``members`` by velocity, driven ones among them."""

    def __init__(self, members: Sequence[int]) -> None:
        self.members = members
        self.matrix: dict[tuple[int, int], Number] = {}
        self.forces: list[Number] = [0.0 for _ in members]

    def body(self, part: Part, arm: Vector, mass: Number, inertia: Inertia | None) -> None:
        """One body's mass [kg], and inertia [kg m^2] about its centre, ``arm`` away; None of a body that does not turn."""
        at = part.shifted(arm)
        turning = {j: w for j, (w, _) in at.partials.items()}
        swirl = ZERO
        if inertia is not None:
            swirl = add(
                inertial(inertia, part.axes, part.swirl),
                cross(part.spin, inertial(inertia, part.axes, part.spin)) if isinstance(inertia, tuple) else ZERO,
            )
        for j, (w, v) in at.partials.items():
            push = plus(times(mass, dot(v, at.drift)), dot(w, swirl))
            self.forces[j] = minus(self.forces[j], total(push, self.members[j]))
            spun = inertial(inertia, part.axes, w) if inertia is not None else ZERO
            for k, (_, other) in at.partials.items():
                if k > j:
                    continue
                entry = plus(times(mass, dot(v, other)), dot(spun, turning[k]))
                self.matrix[j, k] = plus(self.matrix.get((j, k), 0.0), entry)

    def act(self, part: Part, arm: Vector, force: Vector, torque: Vector = ZERO) -> None:
        """A force at ``arm`` from a body's origin, and a torque; world."""
        for j, (w, v) in part.partials.items():
            self.push(j, plus(dot(add(v, cross(w, arm)), force), dot(w, torque)), part.of)

    def wrench(self, part: Part, force: Vector, moment: Vector, arm: Vector) -> None:
        """A force at ``arm`` from a body's origin whose moment about that is known; world."""
        for j, (w, v) in part.partials.items():
            self.push(j, plus(dot(v, force), dot(w, moment)), part.of)

    def push(self, j: int, force: Number, of: tuple[int, int] | None = None) -> None:
        """A force on the velocity j; ``of``: on one of several."""
        self.forces[j] = plus(self.forces[j], onto(force, self.members[j], of))

    def entry(self, j: int, k: int) -> Number:
        """M_jk."""
        return self.matrix.get((max(j, k), min(j, k)), 0.0)

    def blocks(self, count: int) -> list[list[int]]:
        """Free velocities (the first ``count``) that the mass matrix couples, together."""
        group = list(range(count))

        def root(j: int) -> int:
            while group[j] != j:
                j = group[j]
            return j

        for j, k in self.matrix:
            if j < count and k < count and not _zero(self.matrix[j, k]):
                group[root(j)] = root(k)
        found: dict[int, list[int]] = {}
        for j in range(count):
            found.setdefault(root(j), []).append(j)
        return list(found.values())

    def accelerations(self, count: int) -> list[Number]:
        """du/dt of the free velocities, by L D L' of each block, written out."""
        result: list[Number] = [0.0] * count
        for block in self.blocks(count):
            matrix = [[self.entry(j, k) for k in block] for j in block]
            for j, x in zip(block, solved(matrix, [self.forces[j] for j in block]), strict=True):
                result[j] = x
        return result

    def reaction(self, j: int, accelerations: Sequence[Number]) -> Number:
        """Force or torque that a drive exerts on its coordinate j."""
        found = times(-1.0, self.forces[j])
        for k, du in enumerate(accelerations):
            found = plus(found, times(self.entry(j, k), du))
        return found


def _zero(x: Any) -> bool:
    return isinstance(x, (int, float)) and x == 0


def _over(a: Number, b: Number) -> Number:
    return 0.0 if _zero(a) else a / b


def solved(matrix: list[list[Number]], right: list[Number]) -> list[Number]:
    """Solution of a small symmetric positive definite system by L D L', entries scalars or (k,)."""
    n = len(right)
    lower: list[list[Number]] = [[0.0] * n for _ in range(n)]
    diagonal: list[Number] = [0.0] * n
    x = list(right)
    for j in range(n):
        pivot = matrix[j][j]
        for k in range(j):
            pivot = minus(pivot, times(times(lower[j][k], lower[j][k]), diagonal[k]))
        diagonal[j] = pivot
        for i in range(j + 1, n):
            entry = matrix[i][j]
            for k in range(j):
                entry = minus(entry, times(times(lower[i][k], lower[j][k]), diagonal[k]))
            lower[i][j] = _over(entry, pivot)
    for i in range(n):
        for k in range(i):
            x[i] = minus(x[i], times(lower[i][k], x[k]))
    x = [_over(x[i], diagonal[i]) for i in range(n)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i] = minus(x[i], times(lower[k][i], x[k]))
    return x


def flat(numbers: Sequence[Number], members: Sequence[int]) -> Array:
    """One array of numbers, each a scalar or (k,) over members."""
    if not numbers:
        return jnp.zeros(0)
    if not any(members):
        return jnp.stack([jnp.asarray(x, dtype=jnp.float64) for x in numbers])
    return jnp.concatenate(
        [
            jnp.broadcast_to(jnp.asarray(x, dtype=jnp.float64), (k,) if k else (1,))
            for x, k in zip(numbers, members, strict=True)
        ]
    )


def apart(y: Array, members: Sequence[int]) -> list[Array]:
    """The numbers that ``flat`` put together."""
    found, at = [], 0
    for k in members:
        # Indexing by [] takes JAX ten times as long to trace.
        found.append(lax.slice_in_dim(y, at, at + k) if k else lax.index_in_dim(y, at, keepdims=False))
        at += k or 1
    return found
