"""A point or a sphere on a plane, two spheres, a sphere in a spherical socket."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from bcfj_jax.contact.gaps.base import (
    ROUND,
    AbstractFlat,
    AbstractGap,
    Bends,
    Coefficients,
    Drawn,
    Face,
    Frame,
    Look,
    direction,
    one_of,
    yes_or_no,
)
from bcfj_jax.core import shapes
from bcfj_jax.core.vectors import ZERO, Axes, Number, Vector, dot, length, negative, plus, scale, subtract, turned

Direction = tuple[float, float, float]


def in_plane(axes: Axes, normal: Direction) -> Vector:
    """The axial reference of a face across ``normal``: the body's z axis, or its x axis where z is near the normal."""
    return axes[0] if normal[2] ** 2 > 0.5 else axes[2]


def _above(a: Frame, b: Frame, normal: Vector, c: Coefficients, receded: bool) -> Number:
    """Height of b's marker above the plane [m]."""
    height = dot(normal, subtract(b.place, a.place))
    return height + c["clearance"] if receded else height


class PointOnPlane(AbstractFlat):
    """A point of b on a plane of a:  d = -(p . e) - clearance,  n = -e,  p from a's marker to b's.

    The plane holds a's marker and its outer normal is e. The point of contact is b's marker. With ``clearance`` the
    plane lies that much below a's marker: a stop on one side, which b reaches after the clearance along -e. It is negative
    of a plane above the marker, which presses by so much there.
    Exact for a plane without edges, for every rotation of both bodies.

    Directions: normal is into the plane, along -e. Axial is along a's z axis in the plane (a's x axis where e is nearer
    than 45 degrees to z); tangential is across both.
    Coefficients: none; with the option, ``clearance`` [m].

    Attributes:
        axis: e in a's axes: "x", "y", "z", "-x", "-y", "-z", or three numbers.
        clearance: whether the plane lies the coefficient ``clearance`` below a's marker.
    """

    preloads: ClassVar[bool] = True
    axis: Any = eqx.field(static=True, default="z", converter=direction)
    clearance: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        yes_or_no("clearance", self.clearance)

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return ("clearance",) if self.clearance else ()

    def _arms(self, up: Vector, b: Frame, c: Coefficients) -> Vector:
        """From b's marker to what may touch the plane, whose normal is ``up``; world."""
        return ZERO

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        up = turned(a.axes, self.axis)
        arms = self._arms(up, b, c)
        height = plus(dot(up, arms), _above(a, b, up, c, self.clearance))
        return (Face(-height, negative(up), arms),)

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return in_plane(a.axes, self.axis)

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        radius = max(0.16 * look.size, 4.0 * self._deepest(c, look))
        ball = shapes.ball(radius).moved(radius * np.array(self.axis))
        return (self._plate(c, look, max(1.5 * radius, 0.3 * look.size)),), (ball,)

    def _deepest(self, c: Mapping[str, float], look: Look) -> float:
        """Greatest depth of b's marker below the plane [m]."""
        up = np.array(self.axis)
        lowest = look.middle @ up - np.abs(up) @ look.half
        return max(0.0, -float(lowest) - (c["clearance"] if self.clearance else 0.0))

    def _plate(self, c: Mapping[str, float], look: Look, least: float) -> shapes.Mesh:
        up, thick = np.array(self.axis), max(0.03 * look.size, 0.8 * self._deepest(c, look))
        axes = shapes.frame(up)
        half = np.maximum(np.abs(axes[:, :2]).T @ look.half + 0.5 * least, least)
        below = c["clearance"] if self.clearance else 0.0
        middle = look.middle - (look.middle @ up + below + thick) * up
        return shapes.box((*half, thick)).moved(middle, axes)


class SphereOnPlane(PointOnPlane):
    """A sphere of b on a plane of a:  d = radius - p . e - clearance,  n = -e,  p from a's marker to b's.

    The sphere's centre is b's marker; the plane holds a's marker and its outer normal is e. The point of contact is the
    sphere's lowest point, ``radius`` along n. With ``clearance`` the plane lies that much below a's marker.
    Exact for a plane without edges, for every rotation of both bodies.

    Directions: as ``PointOnPlane``.
    Coefficients: ``radius`` of the sphere [m]; with the option, ``clearance`` [m].
    Options: as ``PointOnPlane``.
    """

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return ("radius", "clearance") if self.clearance else ("radius",)

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        up = turned(a.axes, self.axis)
        down = negative(up)
        return (Face(c["radius"] - _above(a, b, up, c, self.clearance), down, scale(c["radius"], down)),)

    def radius(self, c: Mapping[str, float]) -> float | None:
        return c["radius"]

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        return (self._plate(c, look, max(1.4 * c["radius"], 0.3 * look.size)),), (shapes.ball(c["radius"]),)


class SphereOnSphere(AbstractGap):
    """Two spheres, centres at the markers:  d = radius_a + radius_b - |p|,  n = -p/|p|,  p from a's centre to b's.

    |p| is sqrt(p . p + (1e-12 m)^2): coincident centres have no direction, and derivatives are finite there. The point
    of contact is midway between the surfaces, (radius_b - d/2) n from b's centre. Exact, for every rotation of both bodies.
    Bristles turn with the mean of both angular velocities. Neither body differs from the other: a and b may be exchanged.
    Source: physics sheet 4 (B1, B3, B7).

    Directions: normal is along the line of centres, from b to a. Axial is a's z axis less its part along the normal: it
    is not defined while the line of centres is parallel to that axis.
    Coefficients: ``radius_a``, ``radius_b`` [m].
    """

    midway: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("radius_a", "radius_b")

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        apart = subtract(b.place, a.place)
        distance = length(apart, ROUND)
        normal = scale(-1.0 / distance, apart)
        middle = 0.5 * (c["radius_b"] - c["radius_a"] + distance)
        return (Face(c["radius_a"] + c["radius_b"] - distance, normal, scale(middle, normal)),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(c["radius_a"] + c["radius_b"], np.inf)

    def radius(self, c: Mapping[str, float]) -> float | None:
        return 1.0 / (1.0 / c["radius_a"] + 1.0 / c["radius_b"])

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        return (shapes.ball(c["radius_a"]),), (shapes.ball(c["radius_b"]),)


class SphereInSocket(AbstractGap):
    """A sphere of b in a hollow sphere of a, centres at the markers:  d = |p| - clearance,  n = p/|p|.

    p leads from the socket's centre to the sphere's; |p| is sqrt(p . p + (1e-12 m)^2), so that coincident centres have
    no direction, and finite derivatives. The point of contact is on the socket, ``radius`` from its centre along n: the
    lever is (radius - |p|) n. A spherical joint with clearance; a pilot of the ball-cage joint.
    Full spheres: a real socket is a band, whose edge carries an axial load a little off the pole.
    With ``pads`` the sphere touches in 6 directions u_i, along +x, -x, +y, -y, +z, -z of a, side by side as 6 members:

        d_i = p . u_i - clearance,    n = u_i,    at (radius - clearance) u_i of the sphere.

    A negative clearance is then an interference, by so much at each. Under a linear law it is as stiff as 2 pads in every
    direction while all press.
    Source: physics sheet 5.3, rows 1 and 2; Flores, Ambrosio and Claro, Multibody System Dynamics 16 (2006).

    Directions: normal is along the eccentricity. Axial is the z axis of a or of b, as ``axis_of`` says, less its part
    along the normal: it is not defined while the eccentricity is parallel to that axis.
    Coefficients: ``clearance``, radius of the socket less radius of the sphere [m]; ``radius`` of the socket [m].

    Attributes:
        axis_of: the body whose z axis is the axial reference: "a" or "b".
        pads: whether it touches in six directions and not in that of p.
    """

    needs: ClassVar[tuple[str, ...]] = ("clearance", "radius")
    round: ClassVar[bool] = True
    axis_of: str = eqx.field(static=True, default="a")
    pads: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        one_of("axis_of", self.axis_of, ("a", "b"))
        yes_or_no("pads", self.pads)

    @property
    def preloads(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.pads

    @property
    def members(self) -> int:
        return 6 if self.pads else 0

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        apart = subtract(b.place, a.place)
        if self.pads:
            x, y, z = np.repeat(np.eye(3), 2, axis=1) * np.tile([1.0, -1.0], 3)
            way = turned(a.axes, (x, y, z))
            return (Face(dot(way, apart) - c["clearance"], way, scale(c["radius"] - c["clearance"], way)),)
        distance = length(apart, ROUND)
        normal = scale(1.0 / distance, apart)
        return (Face(distance - c["clearance"], normal, scale(c["radius"] - distance, normal)),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf) if self.pads else Bends(c["clearance"], np.inf)

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return b.axes[2] if self.axis_of == "b" else a.axes[2]

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        angle = np.linspace(0.35, -0.5 * np.pi, 16)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        bowl = shapes.revolved(c["radius"] * ring, c["clearance"] * ring)
        return (bowl,), (shapes.ball(c["radius"] - c["clearance"]),)
