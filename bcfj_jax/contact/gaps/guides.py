"""A pin in a bearing and in a slot, a block in a guide, a stop on both sides."""

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
    counted,
    direction,
    yes_or_no,
)
from bcfj_jax.contact.gaps.spheres import Direction, in_plane
from bcfj_jax.core import shapes
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.vectors import ZERO, Number, Vector, add, dot, length, negative, scale, subtract, times, turned


def between(a: Frame, b: Frame, normal: Vector, clearance: Number, reach: Number = 0.0) -> tuple[Face, Face]:
    """b between two parallel faces of a:  d = +-p . n - clearance,  p from a's marker, midway between them, to b's.

    n leads from the middle to the first face, world; ``reach``: of the point of contact from b's marker, towards the face [m].
    """
    height = dot(normal, subtract(b.place, a.place))
    back = negative(normal)
    first = Face(height - clearance, normal, scale(reach, normal))
    return first, Face(-height - clearance, back, scale(reach, back))


def travel(axis: Any) -> Direction:
    """A direction across a's z axis."""
    way = direction(axis)
    if way[2] != 0.0:
        raise InputError("gap, option 'axis'", f"axis {axis!r} is not across z", "give x, -x, y, -y, or [cos, sin, 0]")
    return way


def across_z(way: Direction) -> Direction:
    """z x way."""
    return (-way[1] if way[1] else 0.0, way[0], 0.0)


def _walls(
    axes: np.ndarray, apart: float, clearance: float, half: Any, middle: Any = (0.0, 0.0, 0.0)
) -> tuple[shapes.Mesh, ...]:
    """Two walls whose inner faces are ``apart`` from the middle along the y axis of ``axes``; ``half`` of a wall [m]."""
    found = []
    for sign in (1.0, -1.0):
        wall = shapes.box(half).moved((0.0, sign * (apart + half[1]), 0.0))
        found.append(shapes.with_slack(wall, (0.0, sign * clearance, 0.0)).moved(middle, axes))
    return tuple(found)


class TwoSidedStop(AbstractFlat):
    """A point of b between two stops of a:  d = +-p . e - clearance,  n = +-e,  p from a's marker to b's.

    The stops are planes across e, ``clearance`` to either side of a's marker. The point of contact is b's marker. First
    face: the stop on the side of +e. Two of Modelica's ElastoGap back to back (physics sheet 1.2).
    Exact for planes without edges, for every rotation of both bodies.

    Directions: normal is along e, and the reading is signed: positive while b pushes the stop at +e. Axial is along
    a's z axis in the stop's plane (a's x axis where e is nearer than 45 degrees to z); tangential is across both.
    Coefficient: ``clearance`` [m], from the middle to either stop; negative where both press there (preload), by so much each.

    Attributes:
        axis: e in a's axes: "x", "y", "z", "-x", "-y", "-z", or three numbers.
    """

    needs: ClassVar[tuple[str, ...]] = ("clearance",)
    signed: ClassVar[bool] = True
    preloads: ClassVar[bool] = True
    axis: Any = eqx.field(static=True, default="z", converter=direction)

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        return between(a, b, turned(a.axes, self.axis), c["clearance"])

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return in_plane(a.axes, self.axis)

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        size, way = look.size, np.array(self.axis)
        # The y axis of these is along e.
        axes = shapes.frame(way, (0.0, 1.0, 0.0) if abs(way[1]) < 0.7 else (1.0, 0.0, 0.0))[:, [1, 2, 0]]
        thick, tall = 0.05 * size, 0.14 * size
        walls = _walls(axes, c["clearance"] + thick, c["clearance"], (tall, 0.015 * size, tall))
        bar = shapes.box((0.3 * tall, c["clearance"] + thick, 0.012 * size)).moved(-tall * axes[:, 2], axes)
        block = shapes.box((0.6 * tall, thick, 0.6 * tall)).moved(0.1 * tall * axes[:, 2], axes)
        return (*walls, bar), (block,)


class PinInSlot(AbstractFlat):
    """A pin of b between the two parallel walls of a slot of a:  d = +-p . e - clearance,  n = +-e.

    p leads from a's marker, on the slot's centre line, to b's, on the pin's axis. The slot runs along ``axis``, the pin
    along a's z axis, and e = z x axis is across the walls. The point of contact is on the pin, ``radius`` along n. First
    face: the wall on the side of +e. The slot has no ends; a ``TwoSidedStop`` along it gives them.
    Exact while the pin's axis is parallel to a's z axis; a pin tilted by t touches sooner, by the order of t^2 radius.

    Directions: normal is across the walls, and the reading is signed: positive while the pin pushes the wall at +e.
    Axial is along the slot; tangential is along the pin.
    Coefficients: ``clearance`` [m], half of slot width less pin diameter; ``radius`` of the pin [m].

    Attributes:
        axis: direction of the slot in a's axes, across z: "x", "y", "-x", "-y", or three numbers, the last 0. The pin slides
            freely along it and is held across it: the slot of a yoke that slides along x has the axis "y".
    """

    needs: ClassVar[tuple[str, ...]] = ("clearance", "radius")
    signed: ClassVar[bool] = True
    preloads: ClassVar[bool] = True
    axis: Any = eqx.field(static=True, default="x", converter=travel)

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        return between(a, b, turned(a.axes, across_z(self.axis)), c["clearance"], c["radius"])

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return turned(a.axes, self.axis)

    def misread(self, c: Mapping[str, float], deepest: float) -> str:
        if not deepest > c["radius"]:
            return ""
        way = ", ".join(f"{x:g}" for x in self.axis)
        return (
            f"the pin goes {deepest:.3g} m into a wall of the slot, more than its own radius of {c['radius']:.3g} m: the slot "
            f"lies across the pin's travel. It runs along its axis, here ({way}) of the first body, and holds the pin across"
        )

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        axes, radius = shapes.frame((0.0, 0.0, 1.0), self.axis), c["radius"]
        half = (np.abs(axes[:, 0]) @ look.half + 1.5 * radius, 0.3 * radius, 0.8 * radius)
        middle = (look.middle @ axes[:, 0]) * axes[:, 0]
        walls = _walls(axes, radius + c["clearance"], c["clearance"], half, middle)
        # Its centre line is its axis, whatever is drawn of its walls.
        line = shapes.rod(middle - half[0] * axes[:, 0], middle + half[0] * axes[:, 0], 0.04 * radius)
        return (*walls, line), (shapes.cylinder(radius, 1.2 * radius),)


class PinInBearing(AbstractGap):
    """A pin (journal) of b in a bearing of a, a revolute joint with clearance:  d = |e| - clearance,  n = e/|e|.

    The clearance vector e is the part across a's z axis, the bearing's, of the vector from a's marker to b's. |e| is
    sqrt(e . e + (1e-12 m)^2), so that coincident centres have no direction, and finite derivatives. The point of contact
    is on the pin, ``radius`` along n. The bearing is as long as need be: the pin slides along it freely.
    With ``ends`` the pin touches at both of its ends, ``half_length`` along +z and -z of b from b's marker, members 0
    and 1: the contact then resists tilt, as a spatial revolute joint does. Without, it does not resist tilt.
    With ``pads`` it touches the bearing in so many directions u_i around a's z axis, from its x axis on, side by side:

        d_i = e . u_i - clearance,    n = u_i,    at ``radius`` u_i of the pin,

    (those of the end at +z first). A negative clearance is then an interference, by so much at each: a press fit. Under a
    linear law it is as stiff as N/2 pads in every direction while all press, and holds a torque of friction N mu F radius.
    Exact while the axes are parallel; a pin tilted by t touches sooner, by the order of t^2 radius.
    Source: Flores and Ambrosio, Computers and Structures 82, 1359 (2004); physics sheet 4 (B5, B6).

    Directions: normal is along the clearance vector, axial along the bearing's axis, tangential around it.
    Coefficients: ``clearance``, radius of the bearing less radius of the pin [m]; ``radius`` of the pin [m]; with the
    option, ``half_length`` of the pin [m].

    Attributes:
        ends: whether the pin touches at both of its ends and not in one plane.
        pads: number of directions in which it touches; 0: in that of e.
    """

    round: ClassVar[bool] = True
    ends: bool = eqx.field(static=True, default=False)
    pads: int = eqx.field(static=True, default=0, converter=lambda n: counted("pads", n, "pin"))

    def __check_init__(self):
        yes_or_no("ends", self.ends)

    @property
    def preloads(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.pads > 0

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return ("clearance", "radius", "half_length") if self.ends else ("clearance", "radius")

    @property
    def members(self) -> int:
        return (2 if self.ends else min(self.pads, 1)) * (self.pads or 1)

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        each = np.repeat([1.0, -1.0], self.pads or 1)
        arm = scale(each * c["half_length"], b.axes[2]) if self.ends else ZERO
        apart = subtract(add(b.place, arm), a.place)
        if self.pads:
            angle = np.tile(2.0 * np.pi * np.arange(self.pads) / self.pads, 2 if self.ends else 1)
            way = turned(a.axes, (np.cos(angle), np.sin(angle), 0.0))
            return (Face(dot(way, apart) - c["clearance"], way, add(arm, scale(c["radius"], way))),)
        axis = a.axes[2]
        across = subtract(apart, scale(dot(axis, apart), axis))
        distance = length(across, ROUND)
        normal = scale(1.0 / distance, across)
        return (Face(distance - c["clearance"], normal, add(arm, scale(c["radius"], normal))),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf if self.pads else c["clearance"], arm=c["half_length"] if self.ends else 0.0)

    def line(self, c: Mapping[str, Any]) -> tuple[Any, Any] | None:
        """R = r (r + clearance)/clearance, r the pin's; none of pads."""
        if self.pads:
            return None
        return c["radius"] * (c["radius"] + c["clearance"]) / c["clearance"], c["radius"]

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        radius, hole = c["radius"], c["radius"] + c["clearance"]
        long = c["half_length"] if self.ends else 0.7 * radius
        # A ring where the pin touches: of two ends one each, so that bearings of crossing pins do not cut each other.
        thick = min(0.7 * radius, 0.3 * long) if self.ends else 0.75 * long
        ring = shapes.cylinder(1.4 * hole, thick, hole, c["clearance"])
        rings = tuple(ring.moved((0.0, 0.0, sign * (long - thick))) for sign in ((1.0, -1.0) if self.ends else (0.0,)))
        pin = shapes.cylinder(radius, long)
        # A mark shows how the pin turns.
        return rings, (pin, shapes.box((0.45 * radius, 0.1 * radius, 1.04 * long)).moved((0.45 * radius, 0.0, 0.0)))


class SliderInGuide(AbstractGap):
    """Four corners of a block of b between two parallel walls of a guide of a, side by side as 4 members.

    The guide runs along ``axis``; e = z x axis, of a, is across its walls. Of the block the marker is in the middle, x is
    its length and y its width. Corners are at (-A, B), (A, B), (-A, -B), (A, -B) of (x, y), A ``half_length`` and B
    ``half_width``. The first two touch the wall at +e, the last two the wall at -e, each at its own place:

        d_1,2 = h_1,2 - (B + clearance)     n = e         h = e . (corner less a's marker)
        d_3,4 = -h_3,4 - (B + clearance)    n = -e

    Penetrations of the four gaps of Flores, Leine and Glocker, Multibody System Dynamics 23, 165 (2010): physics sheet 4
    (B4), d = -g, in the same order. Exact for corners on walls without ends, while the block is turned against the guide
    by less than 90 degrees; in three dimensions a corner stands for an edge along z.

    Directions: normal is across the walls, axial along the guide, tangential along a's z axis.
    Coefficients: ``clearance`` [m], half of guide width less block width; ``half_length``, ``half_width`` [m].

    Attributes:
        axis: direction of the guide in a's axes, across z: "x", "y", "-x", "-y", or three numbers, the last 0.
    """

    preloads: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("clearance", "half_length", "half_width")
    axis: Any = eqx.field(static=True, default="x", converter=travel)

    @property
    def members(self) -> int:
        return 4

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        side = np.array([1.0, 1.0, -1.0, -1.0])
        along = np.array([-1.0, 1.0, -1.0, 1.0]) * c["half_length"]
        corner = turned(b.axes, (along, side * c["half_width"], 0.0))
        across = turned(a.axes, across_z(self.axis))
        height = dot(across, add(subtract(b.place, a.place), corner))
        depth = times(side, height) - (c["half_width"] + c["clearance"])
        return (Face(depth, scale(side, across), corner),)

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf, arm=c["half_length"] + c["half_width"])

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return turned(a.axes, self.axis)

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        axes, long, wide = shapes.frame((0.0, 0.0, 1.0), self.axis), c["half_length"], c["half_width"]
        half = (np.abs(axes[:, 0]) @ look.half + 1.3 * long, 0.2 * wide, 0.6 * wide)
        middle = (look.middle @ axes[:, 0]) * axes[:, 0]
        walls = _walls(axes, wide + c["clearance"], c["clearance"], half, middle)
        return walls, (shapes.box((long, wide, 0.5 * wide)),)
