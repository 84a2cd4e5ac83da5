"""Capsules and cylinders on a plane and on each other; edges on edges; a sphere on a wedge."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from bcfj_jax.contact.gaps.base import (
    ROUND,
    AbstractEdged,
    AbstractGap,
    Bends,
    Coefficients,
    Drawn,
    Face,
    Frame,
    Look,
    counted,
    rows,
)
from bcfj_jax.contact.gaps.guides import across_z, travel
from bcfj_jax.contact.gaps.spheres import PointOnPlane
from bcfj_jax.core import shapes
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.vectors import ZERO, Number, Vector, add, cross, dot, length, negative, scale, subtract, turned

# Of the edges of a box the axis of each (12,), and where its middle is (3, 12), in half lengths.
AXIS = np.repeat(np.arange(3), 4)
MIDDLE = np.array([np.insert(k, i, 0.0) for i in range(3) for k in itertools.product((1.0, -1.0), repeat=2)]).T
# Angle below which two capsules count as parallel [rad], squared.
_PARALLEL = 1e-10


# Middle from a body's marker and direction, world, and half length [m].
Segment = tuple[Vector, Vector, Number]


class CapsuleOnPlane(PointOnPlane):
    """A capsule of b on a plane of a, side by side as 2 members:  d_i = radius - (p +- A z) . e - clearance,  n = -e.

    The capsule is what lies within ``radius`` of a segment along b's z axis, A ``half_length`` to either side of b's marker:
    a cylinder with half a sphere on either end. Its lowest point is below an end of the segment; lying on the plane it bears
    on both. The members are the end at +z, and that at -z. The plane is that of ``PointOnPlane``. Exact.

    Directions: as ``PointOnPlane``.
    Coefficients: ``radius``, ``half_length`` [m]; with the option, ``clearance`` [m].
    """

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return ("radius", "half_length", *super().needs)

    @property
    def members(self) -> int:
        return 2

    def _arms(self, up: Vector, b: Frame, c: Coefficients) -> Vector:
        return subtract(_ends(b, c), scale(c["radius"], up))

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf, arm=c["half_length"])

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        return (self._plate(c, look, 2.0 * (c["half_length"] + c["radius"])),), (
            _capsule(c["radius"], c["half_length"]),
        )


class CylinderOnPlane(CapsuleOnPlane):
    """A cylinder of b on a plane of a:  d_i = -(p + c_i) . e - clearance,  n = -e.

    The cylinder is along b's z axis, A ``half_length`` to either side of b's marker, with sharp rims of the radius r. By
    default the c_i are the lowest points of both rims, 2 members, the rim at +z first:

        c_i = +-A z + r w/|w|,    w = z (z . e) - e,

    exact for a cylinder that lies, rolls, lands on a rim or leans on it as a coin does. One that stands has no lowest point:
    it bears at one point of a rim that goes around, and a run takes small steps. It is to have ``points``.

    Directions: as ``PointOnPlane``.
    Coefficients: as ``CapsuleOnPlane``.

    Attributes:
        points: so many of each rim, fixed to the cylinder, from its x axis on, are the c_i in place of the lowest: it
            stands, tips and slides, and rolls as a prism does.
    """

    points: int = eqx.field(static=True, default=0, converter=lambda n: counted("points", n, "rim"))

    @property
    def members(self) -> int:
        return 2 * (self.points or 1)

    def _arms(self, up: Vector, b: Frame, c: Coefficients) -> Vector:
        if self.points:
            angle = np.tile(2.0 * np.pi * np.arange(self.points) / self.points, 2)
            ends = np.repeat([1.0, -1.0], self.points) * c["half_length"]
            return turned(b.axes, (c["radius"] * np.cos(angle), c["radius"] * np.sin(angle), ends))
        # z (z . e) - e, without its cancellation where the cylinder nearly stands.
        down = cross(b.axes[2], cross(b.axes[2], up))
        return add(_ends(b, c), scale(c["radius"] / length(down, ROUND), down))

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf, arm=c["half_length"] + c["radius"])

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        return (self._plate(c, look, 2.0 * (c["half_length"] + c["radius"])),), (
            shapes.cylinder(c["radius"], c["half_length"]),
        )


class CapsuleOnCapsule(AbstractEdged):
    """Two capsules, along their z axes about their markers:  d = radius_a + radius_b - |r|,  n = -r/|r|.

    r leads between the nearest points of both segments, s from a's marker along a's z axis and t from b's along b's:

        r = p + t z_b - s z_a,   |s| <= half_length_a,   |t| <= half_length_b,   r . r + e ((s - s_0)^2 + (t - t_0)^2) least

    (two segments: Ericson, Real-Time Collision Detection, 2005, 5.1.9), with s_0 and t_0 the middle of what either segment has
    beside the other if they are parallel, and e = 1e-10: capsules parallel to 1e-5 rad touch in the middle of where they lie
    beside each other, and one that rocks on the other bears at an end from there on. The error of |r| is e (s - s_0)^2/(2 |r|) or
    so. The point of contact is midway between the surfaces. A half length of 0 is a sphere. Of two cylinders it is where their
    sides touch; their flat ends are not in it.
    Bristles turn with the mean of both angular velocities. Neither body differs from the other: a and b may be exchanged.

    Directions: normal is along r, from b to a. Axial is a's z axis less its part along the normal (with edges its x axis where
    the normal is nearer than 45 degrees to z); tangential is across both.
    Coefficients: ``radius_a``, ``radius_b`` [m]; of a body without edges ``half_length_a``, ``half_length_b`` [m].

    Attributes:
        edges_a, edges_b: in place of the segment along z several, from end to end [x, y, z, x, y, z] in the body's axes from its
            marker [m]; or the three half lengths of a box, whose twelve edges they are, rounded by the radius. Every edge of a
            with every edge of b is a member. Faces bear nothing: ``SphereOnBox`` has them. Edges that meet in a corner each
            bear there.
    """

    midway: ClassVar[bool] = True
    edges_a: tuple[tuple[float, ...], ...] = eqx.field(
        static=True, default=(), converter=lambda x: _edges("edges_a", x)
    )
    edges_b: tuple[tuple[float, ...], ...] = eqx.field(
        static=True, default=(), converter=lambda x: _edges("edges_b", x)
    )

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        plain = [f"half_length_{k}" for k, edges in (("a", self.edges_a), ("b", self.edges_b)) if not edges]
        return ("radius_a", "radius_b", *plain)

    @property
    def members(self) -> int:
        return max(len(self.edges_a), 1) * max(len(self.edges_b), 1) if self.edges_a or self.edges_b else 0

    def _segments(self, a: Frame, b: Frame, c: Coefficients) -> list[Segment]:
        """Those of both bodies, every one of a with every one of b, side by side."""
        ours, theirs = np.reshape(self.edges_a, (-1, 6)), np.reshape(self.edges_b, (-1, 6))
        ours, theirs = np.repeat(ours, max(len(theirs), 1), 0), np.tile(theirs, (max(len(ours), 1), 1))
        found: list[Segment] = []
        for k, frame, edges in (("a", a, ours), ("b", b, theirs)):
            if not len(edges):
                found.append((ZERO, frame.axes[2], c[f"half_length_{k}"]))
                continue
            middle, way = 0.5 * (edges[:, 3:] + edges[:, :3]).T, 0.5 * (edges[:, 3:] - edges[:, :3]).T
            half = np.linalg.norm(way, axis=0)
            found.append((turned(frame.axes, tuple(middle)), turned(frame.axes, tuple(way / half)), half))
        return found

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        first, second = self._segments(a, b, c)
        distance, normal, arm = between(first, second, subtract(b.place, a.place))
        middle = 0.5 * (c["radius_b"] - c["radius_a"] + distance)
        return (Face(c["radius_a"] + c["radius_b"] - distance, normal, add(arm, scale(middle, normal))),)

    def axial_by(self, a: Frame, b: Frame, c: Coefficients, normal: Vector) -> Vector:
        return super().axial_by(a, b, c, normal) if self.members else a.axes[2]

    def bends(self, c: Coefficients) -> Bends:
        # As either turns, the nearest point slides along both.
        reach = [
            float(np.abs(edges).max()) * 3.0**0.5 if edges else c[f"half_length_{k}"]
            for k, edges in (("a", self.edges_a), ("b", self.edges_b))
        ]
        return Bends(c["radius_a"] + c["radius_b"], arm=reach[0] + reach[1])

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        def rods(k: str, edges: tuple[tuple[float, ...], ...]) -> tuple[shapes.Mesh, ...]:
            if not edges:
                return (_capsule(c[f"radius_{k}"], c[f"half_length_{k}"]),)
            ends = np.reshape(edges, (-1, 2, 3))
            half = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            each = zip(half, ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / (2.0 * half[:, None]), strict=True)
            return tuple(_capsule(c[f"radius_{k}"], x).moved(middle, shapes.frame(way)) for x, middle, way in each)

        return rods("a", self.edges_a), rods("b", self.edges_b)


class SphereOnWedge(AbstractGap):
    """A sphere of b on a wedge of a:  d = radius - |r|,  n = -r/|r|,  r from the wedge's nearest point to b's marker.

    The wedge's edge is a's z axis through its marker, its middle plane holds ``axis`` e, which points out of it, and either
    face is turned by ``half_angle`` g from -e. With x = p . e, y = |p . (z x e)| the nearest point is on a face where
    s = y sin g - x cos g > 0, and |r| = x sin g + y cos g; else on the edge, and |r| = sqrt(x^2 + y^2). The point of contact is
    on the sphere, ``radius`` along n. Exact for a wedge without ends. A groove is two ``SphereOnPlane``.

    Directions: normal is into the wedge, axial along the edge, tangential across both.
    Coefficients: ``radius`` of the sphere [m], ``half_angle`` [rad], below a right angle.

    Attributes:
        axis: e in a's axes, across z: "x", "y", "-x", "-y", or three numbers, the last 0.
    """

    needs: ClassVar[tuple[str, ...]] = ("radius", "half_angle")
    axis: Any = eqx.field(static=True, default="y", converter=travel)

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        apart, out, aside = subtract(b.place, a.place), turned(a.axes, self.axis), turned(a.axes, across_z(self.axis))
        x, y, sine, cosine = dot(apart, out), dot(apart, aside), jnp.sin(c["half_angle"]), jnp.cos(c["half_angle"])
        sign = jnp.where(y >= 0.0, 1.0, -1.0)
        away = jnp.sqrt(x * x + y * y + ROUND**2)
        plain = sign * y * sine - x * cosine > 0.0
        distance = jnp.where(plain, x * sine + sign * y * cosine, away)
        way = jnp.where(plain, sine, x / away), jnp.where(plain, sign * cosine, y / away)
        normal = negative(add(scale(way[0], out), scale(way[1], aside)))
        return (Face(c["radius"] - distance, normal, scale(c["radius"], normal)),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(c["radius"])

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        long, tall = float(look.half[2]) + 2.0 * c["radius"], 4.0 * c["radius"]
        wide = min(tall * np.tan(c["half_angle"]), 3.0 * tall)
        middle, half = np.array([0.0, 0.0, float(look.middle[2])]), long * np.array([0.0, 0.0, 1.0])
        out, aside = np.array(self.axis), np.array(across_z(self.axis))
        lines = np.array([[middle, middle - tall * out + k * wide * aside] for k in (1.0, -1.0)])
        outward = np.array([np.sin(c["half_angle"]) * out + k * np.cos(c["half_angle"]) * aside for k in (1.0, -1.0)])
        return (shapes.wall(lines, outward, half),), (shapes.ball(c["radius"]),)


def between(first: Segment, second: Segment, apart: Vector) -> tuple[Number, Vector, Vector]:
    """|r| [m] of ``CapsuleOnCapsule``, n, and the nearest point of the second from its marker, which is ``apart`` from a's."""
    (here, one, ours), (there, other, theirs) = first, second
    apart = subtract(add(there, apart), here)
    dots = dot(one, other), dot(one, apart), dot(other, apart)
    s, t, beside = _nearest(dots, cross(one, other), ours, theirs)
    arm = scale(t, other)
    way = subtract(add(apart, arm), scale(s, one))
    return jnp.sqrt(dot(way, way) + beside + ROUND**2), scale(-1.0 / length(way, ROUND), way), add(there, arm)


def _edges(option: str, given: Any) -> tuple[tuple[float, ...], ...]:
    """Edges of an option: six numbers each, or a box's from its three half lengths."""
    remedy = "give a list of edges, six numbers from end to end [m] each, or the three half lengths of a box"
    try:
        box = np.shape(given) == (3,) and min(given) > 0.0
    except (TypeError, ValueError):
        box = False
    if box:
        (half,) = rows(option, given, 3, remedy)
        ways = np.array([half[i] * (np.arange(3) == i) for i in AXIS])
        given = np.concatenate([MIDDLE.T * half - ways, MIDDLE.T * half + ways], 1)
    found = rows(option, given, 6, remedy)
    if not all(row[:3] != row[3:] for row in found):
        raise InputError(f"gap, option '{option}'", f"{given!r}", remedy)
    return found


def _ends(b: Frame, c: Coefficients) -> Vector:
    """From b's marker to the ends along its z axis, side by side."""
    return scale(np.array([1.0, -1.0]) * c["half_length"], b.axes[2])


def _capsule(radius: float, half: float) -> shapes.Mesh:
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 24)
    height = np.where(angle < 0.0, -half, half) + radius * np.sin(angle)
    return shapes.revolved(np.stack([radius * np.cos(angle), height], axis=1))


def _nearest(
    dots: tuple[Number, Number, Number], across: Vector, ours: Number, theirs: Number
) -> tuple[Number, Number, Number]:
    """s, t and e ((s - s_0)^2 + (t - t_0)^2) of ``CapsuleOnCapsule``, from z_a . z_b, z_a . p, z_b . p and z_a x z_b."""
    (both, u, w), one = dots, 1.0 + _PARALLEL

    def middle(at: Number, own: Number, other: Number) -> Number:
        """Of what a segment has beside the other, whose middle is beside ``at``."""
        return 0.5 * (jnp.maximum(-own, at - other) + jnp.minimum(own, at + other))

    s_0, t_0 = middle(u, ours, theirs), middle(-w, theirs, ours)
    u, w = u + _PARALLEL * s_0, w - _PARALLEL * t_0
    # The determinant one^2 - both^2, without its cancellation.
    s = jnp.clip((one * u - both * w) / (dot(across, across) + one * one - 1.0), -ours, ours)
    free = (both * s - w) / one
    t = jnp.clip(free, -theirs, theirs)
    s = jnp.where(free == t, s, jnp.clip((both * t + u) / one, -ours, ours))
    return s, t, _PARALLEL * (jnp.square(s - s_0) + jnp.square(t - t_0))
