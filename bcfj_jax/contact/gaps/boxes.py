"""A box on a plane, a sphere on a box, which has edges, and a box on a box: corners on faces, edges across edges."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from bcfj_jax.contact.gaps.base import ROUND, AbstractEdged, Bends, Coefficients, Drawn, Face, Frame, Look, rows
from bcfj_jax.contact.gaps.edges import AXIS, MIDDLE, Segment, between
from bcfj_jax.contact.gaps.spheres import PointOnPlane
from bcfj_jax.core import shapes
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.core.vectors import (
    ZERO,
    Axes,
    Number,
    Vector,
    add,
    length,
    negative,
    scale,
    seen,
    subtract,
    times,
    turned,
)

_SIDES = ("half_length", "half_width", "half_height")
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3))).T
_POINTS = "give a list of points of three numbers [m]"


class BoxOnPlane(PointOnPlane):
    """Eight corners of a box of b on a plane of a, side by side as 8 members:  d_i = -(p + c_i) . e - clearance,  n = -e.

    The plane is that of ``PointOnPlane``. b's marker is the middle of the box, whose edges are along b's axes. The corners
    c_1 to c_8 are at (-+A, -+B, -+C) of (x, y, z), A ``half_length``, B ``half_width``, C ``half_height``, z changing sign
    first and x last; c_1 has three minus signs. An edge or a face that lies on the plane bears on its two or four corners.
    Exact for a plane without edges, for every rotation of both bodies.

    Directions: as ``PointOnPlane``.
    Coefficients: ``half_length``, ``half_width``, ``half_height`` [m]; with the option, ``clearance`` [m].
    """

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (*_SIDES, *super().needs)

    @property
    def members(self) -> int:
        return 8

    def _arms(self, up: Vector, b: Frame, c: Coefficients) -> Vector:
        return turned(b.axes, _times(_SIGNS, [c[side] for side in _SIDES]))

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf, arm=sum(c[side] for side in _SIDES))

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        half = [c[side] for side in _SIDES]
        return (self._plate(c, look, 2.0 * max(half)),), (shapes.box(half),)

    def _deepest(self, c: Mapping[str, float], look: Look) -> float:
        """Greatest depth of a corner of b below the plane [m], at most a tenth of the box."""
        reach = float(np.linalg.norm([c[side] for side in _SIDES]))
        return min(super()._deepest(c, look) + reach, 0.1 * reach)


class SphereOnBox(AbstractEdged):
    """A sphere of b on a box of a:  d = radius - |r|,  n = -r/|r|,  r from the box's nearest point to b's marker.

    The middle of the box is a's marker; its edges are along a's axes: a finite plane with what is beyond its edges. With p in
    a's axes and h the half lengths, r = p less p between -h and h, so that faces, edges and corners join smoothly. Inside
    of the box |r| is less the way to the nearest face. The point of contact is on the sphere, ``radius`` along n. Exact.

    Directions: normal is into the box. Axial is along a's z axis (its x axis where the normal is nearer than 45 degrees to z);
    tangential is across both.
    Coefficients: ``radius`` of the sphere, ``half_length``, ``half_width``, ``half_height`` of the box, along x, y, z [m].

    Attributes:
        points: centres of spheres in b's axes from its marker [m], side by side as members, in place of the one at the marker:
            ends of a capsule; with a small radius the rounded corners of a box, or some of a cylinder's rims, whose flat end
            then stands on a face. What of b is between them bears nothing: edges that cross pass through each other.
    """

    needs: ClassVar[tuple[str, ...]] = ("radius", *_SIDES)
    points: tuple[tuple[float, ...], ...] = eqx.field(
        static=True, default=(), converter=lambda x: rows("points", x, 3, _POINTS)
    )

    @property
    def members(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.points)

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        arms = turned(b.axes, tuple(np.transpose(self.points))) if self.points else ZERO
        half = [c[side] for side in _SIDES]
        distance, out = beside_box(a.axes, half, add(arms, subtract(b.place, a.place)))
        return (Face(c["radius"] - distance, negative(out), subtract(arms, scale(c["radius"], out))),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(c["radius"], arm=float(np.max(np.linalg.norm(self.points or [ZERO], axis=1))))

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        balls = tuple(shapes.ball(c["radius"]).moved(x) for x in self.points or (ZERO,))
        return (shapes.box([c[side] for side in _SIDES]),), balls


class BoxOnBox(AbstractEdged):
    """Two boxes, middles at the markers, edges along their axes:  d = 2 e - |r|,  n = -r/|r|,  160 members.

    Corners and edges are rounded by e, ``rounding``: each box is what lies within e of a box that is less by e all round. r leads
    between the nearest points of these: from the box a to the 8 corners of b (as ``SphereOnBox``), from the 8 corners of a to
    the box b, and from each of the 12 edges of a to each of b (as ``CapsuleOnCapsule``), in this order. Corners are at
    (-+A, -+B, -+C) of (x, y, z), z changing sign first. Edges end e before their corners, so that at a corner they bear
    nothing; a crossing edge meets a notch of 0.07 e there. The point of contact is midway between the surfaces. Exact for a
    corner on a face and for edges that cross. Edges that are parallel bear in their middle, besides the corners: equal boxes
    that stand flush bear on 12 places, a small one on a large one on 4. For penetrations below 2 e, and e below half of each half
    length: edges that are deeper have passed through each other.
    Bristles turn with the mean of both angular velocities. Neither body differs from the other: a and b may be exchanged.

    Directions: normal is along r, from b to a. Axial is a's z axis (its x axis where the normal is nearer than 45 degrees to z)
    less its part along the normal; tangential is across both.
    Coefficients: ``rounding`` [m]; ``half_length_a``, ``half_width_a``, ``half_height_a``, and of b, along x, y, z [m].
    """

    midway: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("rounding", *(f"{side}_{k}" for k in "ab" for side in _SIDES))
    quantities: ClassVar[Mapping[str, Quantity]] = {
        f"{side}_{k}": Quantity(
            f"{side}_{k}", "m", f"half of the {side[5:]} of the {which} body's box", 0.0, np.inf, True
        )
        for k, which in (("a", "first"), ("b", "second"))
        for side in _SIDES
    } | {"rounding": Quantity("rounding", "m", "radius of the corners and edges of both boxes", 0.0, np.inf, True)}

    @property
    def members(self) -> int:
        return 160

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        apart, inner = subtract(b.place, a.place), [[c[f"{side}_{k}"] - c["rounding"] for side in _SIDES] for k in "ab"]
        ours, theirs = (turned(x.axes, _times(_SIGNS, half)) for x, half in zip((a, b), inner, strict=True))
        far, out = beside_box(a.axes, inner[0], add(apart, theirs))
        back, normal = beside_box(b.axes, inner[1], subtract(ours, apart))
        # Edges of a down, those of b across: (12, 12).
        first, second = (
            _edges(x, half, c["rounding"], shape)
            for x, half, shape in zip((a, b), inner, ((12, 1), (1, 12)), strict=True)
        )
        across, way, arm = between(first, second, apart)
        far, down = _joined((far, back, across)), _vectors((negative(out), normal, way))
        points = _vectors((theirs, subtract(subtract(ours, apart), scale(back, normal)), arm))
        return (Face(2.0 * c["rounding"] - far, down, add(points, scale(0.5 * far, down))),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(2.0 * c["rounding"], arm=sum(c[name] for name in self.needs[1:]))

    def size(self, c: Mapping[str, float]) -> float | None:
        return min(c[name] for name in self.needs[1:])

    def misread(self, c: Mapping[str, float], deepest: float) -> str:
        if not deepest > 2.0 * c["rounding"]:
            return ""
        return f"the boxes overlap by {deepest:.3g} m, more than 2 rounding: their edges pass through each other"

    def impossible(self, c: Mapping[str, float]) -> tuple[str, str] | None:
        """A rounding that leaves edges no length."""
        least = self.size(c)
        if least is None or 2.0 * c["rounding"] <= least:
            return None
        return (
            f"rounding {c['rounding']:g} m is more than half of a half length of {least:g} m",
            "give a smaller rounding",
        )

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        first, second = ((shapes.box([c[f"{side}_{k}"] for side in _SIDES]),) for k in "ab")
        return first, second


def beside_box(axes: Axes, half: Sequence[Number], place: Vector) -> tuple[Number, Vector]:
    """Distance of places from a box of half lengths along axes about its middle [m], less than 0 inside; and the way out."""
    local = [jnp.asarray(x) for x in seen(axes, place)]
    beyond = [jnp.abs(x) - h for x, h in zip(local, half, strict=True)]
    out = [jnp.maximum(x, 0.0) for x in beyond]
    distance, (x, y, z) = length((out[0], out[1], out[2]), ROUND), beyond
    # Of faces that are equally near, the first.
    near = (x >= y) & (x >= z), (y > x) & (y >= z), (z > x) & (z > y)
    least = jnp.where(near[0], x, jnp.where(near[1], y, z))
    way = [
        jnp.where(x >= 0.0, 1.0, -1.0) * jnp.where(least > 0.0, o / distance, one)
        for x, o, one in zip(local, out, near, strict=True)
    ]
    return jnp.where(least > 0.0, distance, least), turned(axes, (way[0], way[1], way[2]))


def _times(signs: np.ndarray, half: list[Number]) -> Vector:
    x, y, z = (times(s, h) for s, h in zip(signs, half, strict=True))
    return x, y, z


def _edges(x: Frame, half: list[Number], e: Number, shape: tuple[int, int]) -> Segment:
    """The twelve of a box, which end e before its corners, in a shape."""
    ways = np.eye(3)[AXIS].T.reshape(3, *shape)
    middle = turned(x.axes, _times(MIDDLE.reshape(3, *shape), half))
    return middle, turned(x.axes, (ways[0], ways[1], ways[2])), jnp.repeat(jnp.stack(half), 4).reshape(shape) - e


def _joined(numbers: Any) -> Number:
    """Of corners of b, corners of a and pairs of edges, one after the other."""
    shapes_ = zip(numbers, ((8,), (8,), (12, 12)), strict=True)
    return jnp.concatenate([jnp.ravel(jnp.broadcast_to(x, shape)) for x, shape in shapes_])


def _vectors(vectors: Any) -> Vector:
    x, y, z = map(_joined, zip(*vectors, strict=True))
    return x, y, z
