"""A box on a box: corners on faces, edges across edges."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from bcfj_jax.contact.gaps.base import AbstractGap, Bends, Coefficients, Drawn, Face, Frame, Look
from bcfj_jax.contact.gaps.edges import Segment, beside_box, between, lying
from bcfj_jax.core import shapes
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.core.vectors import Number, Vector, add, negative, scale, subtract, times, turned

_SIDES = ("half_length", "half_width", "half_height")
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3))).T
# Of each edge its axis (12,), and where its middle is (3, 12), in half lengths.
_AXIS = np.repeat(np.arange(3), 4)
_MIDDLE = np.array([np.insert(k, i, 0.0) for i in range(3) for k in itertools.product((1.0, -1.0), repeat=2)]).T


class BoxOnBox(AbstractGap):
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

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return lying(a, self.faces(a, b, c)[0].normal)

    def axial_by(self, a: Frame, b: Frame, c: Coefficients, normal: Vector) -> Vector:
        """``axial``."""
        return lying(a, normal)

    def carried(self, a: Vector, b: Vector) -> Vector:
        return scale(0.5, add(a, b))

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


def _times(signs: np.ndarray, half: list[Number]) -> Vector:
    x, y, z = (times(s, h) for s, h in zip(signs, half, strict=True))
    return x, y, z


def _edges(x: Frame, half: list[Number], e: Number, shape: tuple[int, int]) -> Segment:
    """The twelve of a box, which end e before its corners, in a shape."""
    ways = np.eye(3)[_AXIS].T.reshape(3, *shape)
    middle = turned(x.axes, _times(_MIDDLE.reshape(3, *shape), half))
    return middle, turned(x.axes, (ways[0], ways[1], ways[2])), jnp.repeat(jnp.stack(half), 4).reshape(shape) - e


def _joined(numbers: Any) -> Number:
    """Of corners of b, corners of a and pairs of edges, one after the other."""
    shapes_ = zip(numbers, ((8,), (8,), (12, 12)), strict=True)
    return jnp.concatenate([jnp.ravel(jnp.broadcast_to(x, shape)) for x, shape in shapes_])


def _vectors(vectors: Any) -> Vector:
    x, y, z = map(_joined, zip(*vectors, strict=True))
    return x, y, z
