"""What a gap is: from the frames of two bodies to penetration, direction and point of contact.

A gap reads two frames, markers on a first body a and a second body b, in world components (``core.vectors``), and gives
faces. A face's normal n is the way in which b has moved into a: the derivative of the penetration by b's place. The
contact pushes b along -n and a along +n, friction included, at one point in space, ``lever`` away from b's marker, where the
surfaces touch: on one of them or between them. Velocities are the mechanism's business (``contact.wrench``): those of the
material of a and of b at that point, whatever holds the bodies. The rate of the penetration is n . (v_b - v_a) there,
because the point of contact slides along surfaces but not across them.

To add a gap in a file of your own: ``from_depth(function)`` of one line, or a module with ``needs`` and ``faces``. The
rate above holds for every gap whose penetration reads b's place in a's axes alone and whose lever is along n, and for
every gap whose penetration is that of one material point of b and whose lever leads to that point.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.part import Part
from bcfj_jax.core import errors, limits, shapes
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.quantities import Quantity, whole
from bcfj_jax.core.shapes import Mesh
from bcfj_jax.core.vectors import ZERO, Axes, Number, Vector, add, array, dot, scale, seen, subtract, turned

Coefficients = Mapping[str, Array]
# Lengths are sqrt(v . v + ROUND^2) [m]: coincident centres have no direction, no force and finite derivatives.
ROUND = 1e-12


# Lengths of bodies among the sizes that gaps read.
_OF_BODIES = ("radius", "radius_a", "radius_b", "ball_radius", "half_length", "half_width")


class Frame(NamedTuple):
    """A marker on a body: its place [m] and its body's axes, as columns, in world components.

    ``turn`` is the angle of the body's own hinge, planar or bearing joint, of all its turns [rad]; 0 without.
    """

    place: Vector
    axes: Axes
    turn: Number = 0.0


class Face(NamedTuple):
    """One place where two bodies may touch; numbers are scalars, or (k,) over members.

    Attributes:
        depth: penetration [m], positive in contact.
        normal: unit vector, world: the way in which b has moved into a.
        lever: from b's marker to the point of contact [m], world.
        gate: 1 where the face is there, 0 beyond its edge; it multiplies the normal force.
    """

    depth: Number
    normal: Vector
    lever: Vector = ZERO
    gate: Number = 1.0


class Look(NamedTuple):
    """What a gap is drawn by.

    Attributes:
        size: of the whole scene [m], for what has no size of its own.
        low, high: (3,) least and greatest place of b's marker in a's axes from a's marker, in a run [m].
    """

    size: float
    low: np.ndarray
    high: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Middle of the travel."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> np.ndarray:
        """Half of the travel."""
        return 0.5 * (self.high - self.low)


class Bends(NamedTuple):
    """Relative motion over which a penetration's course bends: over a small share of it, it is a cubic of time.

    Attributes:
        length: of b's marker past a's [m]; infinite between planes, 0 where not known.
        angle: of both bodies' rotations [rad]; infinite where they change nothing, as those of spheres.
        arm: how far from b's marker that of b which touches is carried by b's rotation [m].
    """

    length: Number
    angle: float = 1.0
    arm: Number = 0.0


# Meshes on a, and on b, each in the body's axes and from its marker.
Drawn = tuple[tuple[Mesh, ...], tuple[Mesh, ...]]


class AbstractGap(Part):
    """The geometry of one contact.

    Attributes:
        needs: names of the sizes it reads from the contact's coefficients, ``clearance`` among them where it has one.
        quantities: what names of its own mean, beside those of ``core.quantities.CATALOGUE``.
        members: number of like contacts that ``faces`` gives side by side; 0 where its bodies decide.
        signed: whether the normal force that is read is the first face's less the second's, and not their sum.
        preloads: whether its clearance may be negative: surfaces that overlap by so much in the middle, so that both press.
        midway: whether neither body holds a plane or a hollow: bristles turn with the mean of both angular velocities.
        round: whether b's marker is free within a circle about a's, of the radius ``clearance``, across a's z axis.
    """

    example: ClassVar[str] = """
class Ground(bj.gaps.AbstractGap):
    def faces(self, a, b, c):
        return (bj.gaps.Face(depth=-b.place[2], normal=(0.0, 0.0, -1.0)),)
"""

    needs: ClassVar[tuple[str, ...]] = ()
    quantities: ClassVar[Mapping[str, Quantity]] = {}
    signed: ClassVar[bool] = False
    midway: ClassVar[bool] = False
    round: ClassVar[bool] = False
    preloads: ClassVar[bool] = False

    @property
    def members(self) -> int:
        """0: the bodies decide."""
        return 0

    @abstractmethod
    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        """The faces, always as many.

        Args:
            a, b: markers on the first and on the second body.
            c: the coefficients named by ``needs``, SI; each a scalar, or (k,) over members.
        """

    def carried(self, a: Vector, b: Vector) -> Vector:
        """Angular velocity with which bristles turn, from those of a and b: a's, which holds the plane or the hollow."""
        return scale(0.5, add(a, b)) if self.midway else a

    def bends(self, c: Coefficients) -> Bends:
        """What bends the penetration's course near contact (``Bends``); where not known, every step is looked at."""
        return Bends(0.0)

    def size(self, c: Mapping[str, float]) -> float | None:
        """Least length of a body that it reads [m], a radius or half a side; None where it reads none. ``c`` holds numbers."""
        return min((c[name] for name in self.needs if name in _OF_BODIES), default=None)

    def radius(self, c: Mapping[str, float]) -> float | None:
        """Relative radius R of bodies that touch at a point of two equal curvatures, 1/R = 1/R_1 + 1/R_2 [m]; else None."""
        return None

    def line(self, c: Mapping[str, Any]) -> tuple[Any, Any] | None:
        """Relative radius R [m] of bodies that touch along a line, and the smaller body's radius; else None."""
        return None

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        """Direction that a force's axial component is read along, less its part along the normal: a's z axis.

        It need not have length 1. Tangential is across the normal and the axial direction. Arguments as ``faces``.
        """
        return a.axes[2]

    def axial_by(self, a: Frame, b: Frame, c: Coefficients, normal: Vector) -> Vector:
        """``axial`` where the normal is known: what would have to find it again has it from here."""
        return self.axial(a, b, c)

    def misread(self, c: Mapping[str, float], deepest: float) -> str:
        """What the greatest penetration of a run [m] says against how the gap was written; "" for nothing. On the host."""
        return ""

    def impossible(self, c: Mapping[str, float]) -> tuple[str, str] | None:
        """What is wrong with sizes that do not fit each other, and a remedy; None for nothing. On the host."""
        return None

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        """What it looks like; nothing by default. ``c`` holds numbers. On the host."""
        return (), ()


class AbstractFlat(AbstractGap):
    """A gap between planes and a point or a round part: rotations alone bend the penetration's course."""

    def bends(self, c: Coefficients) -> Bends:
        return Bends(np.inf)


class AbstractEdged(AbstractGap):
    """A gap whose normal may be any: axial is a's z axis, or its x axis where the normal is nearer than 45 degrees to z."""

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return self.axial_by(a, b, c, self.faces(a, b, c)[0].normal)

    def axial_by(self, a: Frame, b: Frame, c: Coefficients, normal: Vector) -> Vector:
        steep = jnp.square(dot(a.axes[2], normal)) > 0.5
        x, y, z = (jnp.where(steep, x, z) for x, z in zip(a.axes[0], a.axes[2], strict=True))
        return x, y, z


class FromDepth(AbstractGap):
    """A gap given by its penetration alone, a function of b's place in a's axes; the normal is its gradient.

    Force acts at b's marker. Made by ``from_depth``.
    """

    function: Callable[[Array, Coefficients], Array] = eqx.field(static=True)
    reads: tuple[str, ...] = eqx.field(static=True, default=())
    known: tuple[Quantity, ...] = eqx.field(static=True, default=())

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.reads

    @property
    def quantities(self) -> Mapping[str, Quantity]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Those that it was given, by name."""
        return {q.name: q for q in self.known}

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        # Computed once: where XLA computes it again with other roundings, |x| = max(|x|, |y|) is false for both, and the
        # slope of jnp.hypot, or of any maximum, is lost.
        place = jax.lax.optimization_barrier(array(seen(a.axes, subtract(b.place, a.place))))
        depth, slope = self._depth_and_slope(place, {name: c[name] for name in self.reads})
        local = (slope[..., 0], slope[..., 1], slope[..., 2])
        return (Face(depth, turned(a.axes, local)),)

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        """Where the penetration is 0 about the marker's travel, as a wall; and a small ball at the marker.

        The wall lies along that axis of a on which the penetration depends least.
        """
        reach = 1.4 * float(np.max(look.half)) or 0.25 * look.size
        values = {name: np.asarray(c[name], float) for name in self.reads}
        corners = look.middle + reach * np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
        slopes = np.abs(self._on_host(corners, values)[1]).mean(axis=0)
        along = min((2, 1, 0), key=lambda k: (round(float(slopes[k]), 6), look.half[k]))
        i, j = (k for k in range(3) if k != along)
        ticks = np.linspace(-reach, reach, 81)
        grid = np.tile(look.middle, (81, 81, 1))
        grid[..., i] += ticks[:, None]
        grid[..., j] += ticks
        depth = self._on_host(grid.reshape(-1, 3), values)[0].reshape(81, 81)
        lines = shapes.level(grid, depth)
        if not len(lines):
            return (), (shapes.ball(0.05 * reach),)
        outward = -self._on_host(lines.mean(axis=1), values)[1]
        return (shapes.wall(lines, outward, 0.2 * reach * np.eye(3)[along]),), (shapes.ball(0.05 * reach),)

    def _on_host(self, places: np.ndarray, c: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Penetrations (k,) and slopes (k, 3) at places (k, 3)."""
        one = jax.jit(jax.vmap(jax.value_and_grad(self.function), (0, None)))
        depth, slope = one(places, dict(c))
        return np.asarray(depth), np.asarray(slope)

    def _depth_and_slope(self, place: Array, c: dict[str, Array]) -> tuple[Array, Array]:
        one = jax.value_and_grad(self.function)
        if place.ndim == 1:
            return one(place, c)
        return jax.vmap(one, (0, {name: 0 if np.ndim(x) else None for name, x in c.items()}))(place, c)


def from_depth(
    function: Callable[[Array, Coefficients], Array], needs: tuple[str, ...] = (), quantities: tuple[Quantity, ...] = ()
) -> FromDepth:
    """A gap from one function: penetration [m] of b's marker at r (3,) in a's axes [m], given coefficients.

    The function must be a distance (its gradient has length 1), or the penetration is not the overlap.

    Args:
        function: (r, coefficients) -> penetration, positive in contact.
        needs: names of the coefficients it reads.
        quantities: what names of its own mean.
    """
    if not callable(function):
        raise InputError(
            "bj.gaps.from_depth", f"{quoted(function)} is no function", "give (r, coefficients) -> penetration"
        )
    return FromDepth(function, tuple(needs), tuple(quantities))


def one_of(option: str, value: Any, known: Iterable[str]) -> None:
    """Refuse an option's value that is not known."""
    errors.one_of(f"gap, option '{option}'", option, value, tuple(known))


def counted(option: str, value: Any, around: str = "") -> int:
    """A number of members as an ``int``; 0 leaves it to the bodies; ``around`` what is not held by fewer than 3."""
    found = whole(f"gap, option '{option}'", value, least=0, most=limits.MEMBERS)
    if around and found in (1, 2):
        raise InputError(f"gap, option '{option}'", f"{found} {option} hold no {around}", "give 3 or more, or 0")
    return found


def yes_or_no(option: str, value: Any) -> None:
    """Refuse an option's value that is not a truth value."""
    if not isinstance(value, bool):
        raise InputError(f"gap, option '{option}'", f"{value!r} is neither true nor false", "give true or false")


def rows(option: str, given: Any, width: int, remedy: str) -> tuple[tuple[float, ...], ...]:
    """An option that is rows of so many numbers."""
    try:
        found = np.asarray(given, dtype=float)
        right = found.ndim and np.isfinite(found).all() and (not found.size or width % found.shape[-1] == 0)
        return tuple(tuple(map(float, row)) for row in found.reshape(-1, width if right else 0))
    except (TypeError, ValueError):
        raise InputError(f"gap, option '{option}'", f"{given!r}", remedy) from None


def direction(axis: Any, where: str = "gap, option 'axis'") -> tuple[float, float, float]:
    """A unit vector in a body's axes, as Python floats: from "x", "-z", or three numbers."""
    remedy = "give x, y or z, with a minus or without, or three numbers, not all zero"
    if isinstance(axis, str):
        if axis.removeprefix("-") not in ("x", "y", "z"):
            raise InputError(where, f"no axis '{axis}'", remedy)
        sign = -1.0 if axis.startswith("-") else 1.0
        x, y, z = (sign if axis[-1] == letter else 0.0 for letter in "xyz")
        return x, y, z
    try:
        x, y, z = (float(part) for part in axis)
        size = float(np.hypot(np.hypot(x, y), z))
        if not (0.0 < size < np.inf):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(where, f"axis {quoted(axis)} is not a direction", remedy) from None
    return x / size, y / size, z / size
