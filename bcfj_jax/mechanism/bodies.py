"""Bodies in a tree of ideal joints: from coordinates to places, velocities and partial velocities.

A joint is a row of steps from the parent's frame: slides and hinges along or about an axis, a ball joint. Each step adds
one coordinate, or a prescribed motion in its place. With u the velocities of the free coordinates, the velocity of a
body's origin is  v = sum_j v_j u_j + (what is prescribed),  its angular velocity  w = sum_j w_j u_j + ...;  v_j and w_j are
its partial velocities (Kane and Levinson, Dynamics, 1985). Accelerations are  sum_j v_j du_j/dt + drift.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.part import raised
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, nearest, one_of, quoted
from bcfj_jax.core.quantities import whole
from bcfj_jax.core.rotations import attitude
from bcfj_jax.core.vectors import WORLD, ZERO, Axes, Number, Vector, add, cross, minus, plus, scale, times, turned
from bcfj_jax.mechanism import sizes
from bcfj_jax.mechanism.programmes import (
    SHAPES,
    Table,
    area,
    checked_shape,
    checked_table,
    given_breaks,
    given_table,
    looked_up,
    progress,
    risen,
)
from bcfj_jax.mechanism.sizes import GROUND, ORIGIN, Parameters, Params, Place, Size

# By joint: the coordinates' names, with what they are: a slide along or a hinge about the first, second or third of
# (e1, e2, n), n the joint's axis; "ball": attitude by a quaternion; "spin": angular velocity of a body whose attitude
# does not matter (a sphere).
JOINTS: dict[str, tuple[tuple[str, str, int], ...]] = {
    "fixed": (),
    "slide": (("position", "slide", 2),),
    "hinge": (("angle", "hinge", 2),),
    "planar": (("x", "slide", 0), ("y", "slide", 1), ("angle", "hinge", 2)),
    "bearing": (("x", "slide", 0), ("y", "slide", 1), ("z", "slide", 2), ("angle", "hinge", 2)),
    "particle": (("x", "slide", 0), ("y", "slide", 1), ("z", "slide", 2)),
    "universal": (("first", "hinge", 0), ("second", "hinge", 1)),
    "spherical": (("", "ball", 2),),
    "free": (("x", "slide", 0), ("y", "slide", 1), ("z", "slide", 2), ("", "ball", 2)),
    "sphere": (("x", "slide", 0), ("y", "slide", 1), ("z", "slide", 2), ("", "spin", 2)),
}
RATES = {"position": "velocity", "angle": "speed"} | {key: f"v{key}" for key in "xyz"}
RATES |= {key: f"{key}_speed" for key in ("first", "second")}
# Of a matrix of inertia: about its axes, and its entries beside the diagonal, which are less the integrals of x y dm.
INERTIAS = ("x", "y", "z", "xy", "yz", "zx")
QUATERNION, SPINS = ("q0", "q1", "q2", "q3"), ("wx", "wy", "wz")


# What a kind of drive reads.
DRIVES = {
    "constant": ("speed", "start"), "ramp": ("speed", "over", "first", "shape", "start"), "table": ("table",),
    "speeds": ("table", "speed", "start"), "function": ("function", "breaks"),
}  # fmt: skip


class Drive(eqx.Module):
    """A prescribed motion of a slide or a hinge: position [m or rad] as a function of time; a driven joint has no state.

    Attributes:
        kind: "constant" speed, "ramp" (the speed rises over a time and stays), "table", "speeds", or "function".
        speed: [m/s or rad/s], of "constant" and "ramp"; of "speeds" what its values are multiplied by, 1 for None.
        over: rise time [s], of "ramp"; the speed is first + (V - first) s(t/over), s a shape of ``programmes``.
        start: position at time 0; first: speed at time 0 of "ramp"; shape: its shape.
        table: (times, positions) of "table": a natural cubic spline through them, constant speed beyond the ends;
            (times, speeds) of "speeds": linear between them, constant beyond.
        function: (t, params) -> position, twice differentiable.
        breaks: times [s] at which steps have to end, of "function"; None: looks at the function find where it bends.
    """

    kind: str = eqx.field(static=True, default="constant")
    speed: Size = sizes.field("drive speed", default=None)
    over: Size = sizes.field("drive over", default=None)
    start: Size = sizes.field("drive start", default=0.0)
    table: Table | None = eqx.field(static=True, default=None, converter=lambda x: given_table("drive table", x))
    function: Callable[[Array, Params], Array] | None = sizes.field("drive function", default=None)
    shape: str = eqx.field(static=True, default="smooth")
    first: Size = sizes.field("drive first", default=0.0)
    breaks: tuple[float, ...] | None = eqx.field(static=True, default=None, converter=given_breaks)

    def __check_init__(self):
        where = "drive"
        one_of(where, "kind of drive", self.kind, DRIVES)
        sizes.check_fields(where, self)
        reads = DRIVES[self.kind]
        others = {one.name for one in dataclasses.fields(self)} - {"kind", *reads}
        sizes.check_read(where, self, f"a drive of kind '{self.kind}'", others, f"it reads {', '.join(reads)}")
        checked_shape(f"{where} shape", self.shape)
        if self.kind in ("table", "speeds"):
            checked_table(f"{where} table", self.table, 3 if self.kind == "table" else 2)
        if self.kind == "function" and self.function is None:
            raise InputError(
                where, "a drive of kind 'function' needs a function", "give function = (t, params) -> position"
            )

    def needs(self, body: str, turns: bool) -> Parameters:
        unit = "rad" if turns else "m"
        found: Parameters = {}
        if self.kind in ("constant", "ramp"):
            found |= sizes.own(self.speed, body, "drive_speed", f"{unit}/s", f"speed of the drive of {body}")
        if self.kind == "speeds" and self.speed is not None:
            found |= sizes.own(self.speed, body, "drive_speed", "1", f"what the speeds of {body} are multiplied by")
        if self.kind == "ramp":
            found |= sizes.own(
                self.over, body, "drive_ramp", "s", f"time over which the drive of {body} reaches its speed"
            )
            found |= sizes.stated(
                self.first, body, "drive_first", f"{unit}/s", f"speed of the drive of {body} at time 0"
            )
        meaning = f"position of the drive of {body} at time 0"
        return found | sizes.stated(self.start, body, "drive_start", unit, meaning)

    def kinks(self, body: str, p: Params) -> list[ArrayLike] | None:
        """Times at which the motion bends [s]; None of a function that says nothing of it."""
        if self.kind == "function":
            return None if self.breaks is None else [np.asarray(self.breaks)]
        if self.table is not None:
            return [np.asarray(self.table[0])]
        return [sizes.value(self.over, body, "drive_ramp", p)] if self.kind == "ramp" else []

    def position(self, t: Array, body: str, p: Params) -> Number:
        """Position [m or rad]."""
        if self.kind == "function":
            assert self.function is not None
            try:
                return self.function(t, p)
            except Exception as error:
                raise raised(f"body '{body}' drive", error) from error
        if self.kind == "table":
            return self._spline(t)
        start = sizes.length(self.start, body, "drive_start", p)
        if self.kind == "speeds":
            assert self.table is not None
            return plus(times(self._speed(body, p), area(t, self.table)), start)
        speed = sizes.value(self.speed, body, "drive_speed", p)
        if self.kind == "constant":
            return plus(speed * t, start)
        over, first = sizes.value(self.over, body, "drive_ramp", p), sizes.length(self.first, body, "drive_first", p)
        # The integral of the shape, and full speed from its end on.
        gone = over * risen(self.shape, progress(t, over)) + jnp.maximum(t - over, 0.0)
        return plus(plus(times(minus(speed, first), gone), times(first, t)), start)

    def _speed(self, body: str, p: Params) -> Number:
        """What the values of a table of speeds are multiplied by."""
        return 1.0 if self.speed is None else sizes.value(self.speed, body, "drive_speed", p)

    def motion(self, t: Array, body: str, p: Params) -> tuple[Number, Number, Number]:
        """Position, velocity and acceleration."""
        if self.kind == "constant":
            return self.position(t, body, p), sizes.value(self.speed, body, "drive_speed", p), 0.0
        if self.kind == "ramp":
            speed, over = sizes.value(self.speed, body, "drive_speed", p), sizes.value(self.over, body, "drive_ramp", p)
            first = sizes.length(self.first, body, "drive_first", p)
            step, slope = jax.jvp(lambda t: SHAPES[self.shape](progress(t, over)), (t,), (jnp.ones_like(t),))
            rise = minus(speed, first)
            return self.position(t, body, p), plus(times(rise, step), first), times(rise, slope)
        if self.kind == "speeds":
            table = self.table
            assert table is not None
            share, slope = jax.jvp(lambda t: looked_up(t, table), (t,), (jnp.ones_like(t),))
            speed = self._speed(body, p)
            return self.position(t, body, p), times(speed, share), times(speed, slope)
        one = jnp.ones_like(t)
        rate = lambda t: jax.jvp(lambda t: jnp.asarray(self.position(t, body, p)), (t,), (one,))[1]  # noqa: E731
        velocity, acceleration = jax.jvp(rate, (t,), (one,))
        return self.position(t, body, p), velocity, acceleration

    def _spline(self, t: Array) -> Array:
        from scipy.interpolate import CubicSpline

        assert self.table is not None
        knots, values = (np.asarray(x, dtype=float) for x in self.table)
        spline = CubicSpline(knots, values, bc_type="natural")
        inside = jnp.clip(t, knots[0], knots[-1])
        i = jnp.clip(jnp.searchsorted(jnp.asarray(knots), inside, side="right") - 1, 0, len(knots) - 2)
        c, x = jnp.asarray(spline.c)[:, i], inside - jnp.asarray(knots)[i]
        ends = spline(knots[[0, -1]], 1)
        beyond = jnp.where(
            t > knots[-1], ends[1] * (t - knots[-1]), jnp.where(t < knots[0], ends[0] * (t - knots[0]), 0.0)
        )
        return c[3] + x * (c[2] + x * (c[1] + x * c[0])) + beyond


def checked_drive(where: str, given: Any) -> None:
    """Refuse what is neither a drive nor None."""
    if not isinstance(given, Drive | None):
        raise InputError(f"{where} drive", f"{quoted(given)} is no drive", 'give bj.Drive("constant", speed=2.0)')


class Body(eqx.Module):
    """One body, or ``members`` like ones side by side.

    Attributes:
        name: unique; "ground" is what does not move.
        joint: a name of ``JOINTS``; the coordinates are those of the joint.
        parent: the body that the joint holds on to.
        at: the joint's place in the parent's axes [m]; the body's origin is there at coordinates 0.
        axis: the joint's axis n in the joint's own axes: "x", "y", "z", or three numbers.
        tilt: (axis, angle [rad]) that turns the joint's axes from the parent's.
        center: the centre of mass in the body's axes [m].
        mass: [kg]; None reads ``<name>.mass``, else the shared ``mass``.
        inertia: about the centre of mass [kg m^2]: one number (isotropic, or about the only axis it turns about), or
            three about the body's axes, or six, (xx, yy, zz, xy, yz, zx) of its matrix in these axes, I_xy being the integral
            of -x y dm; None reads ``<name>.inertia`` or the shared one; read by bodies that turn.
        start: by coordinate or velocity name, its value at time 0 (0 where not given).
        drive: a motion that takes the coordinate's place (slide and hinge only).
        members: number of like bodies; 0 for one. Members hang on the ground and carry nothing.
    """

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True, default="free")
    parent: str = eqx.field(static=True, default=GROUND)
    at: Place = sizes.field("body at", default=ORIGIN)
    axis: Any = sizes.field("body axis", default="z")
    tilt: tuple[Any, Size] | None = sizes.field("body tilt", default=None)
    center: Place = sizes.field("body center", default=ORIGIN)
    mass: Size = sizes.field("body mass", default=None)
    inertia: Any = sizes.field("body inertia", default=None)
    start: tuple[tuple[str, Size], ...] = eqx.field(
        static=True, default=(), converter=partial(sizes.items, "body start")
    )
    drive: Drive | None = None
    members: int = eqx.field(
        static=True, default=0, converter=lambda n: whole("body members", n, least=0, most=limits.MEMBERS)
    )

    def __check_init__(self):
        where = sizes.checked_name("body", self.name)
        sizes.check_fields(where, self)
        one_of(f"{where} joint", "joint", self.joint, JOINTS)
        if self.parent == self.name:
            raise InputError(f"{where} parent", "the body is its own parent", f"give another body, or '{GROUND}'")
        sizes.axis(self.axis, f"{where} axis")
        if self.tilt is not None:
            if not isinstance(self.tilt, tuple) or len(self.tilt) != 2:
                raise InputError(f"{where} tilt", quoted(self.tilt), "give (axis, angle [rad])")
            sizes.axis(self.tilt[0], f"{where} tilt")
        self._check_inertia(where)
        checked_drive(where, self.drive)
        if self.drive is not None and self.joint not in ("slide", "hinge"):
            found = f"a drive moves one coordinate, and the joint '{self.joint}' has {len(JOINTS[self.joint])}"
            raise InputError(f"{where} drive", found, "drive a slide or a hinge")
        if self.joint == "sphere" and (any(self.center) or isinstance(self.inertia, tuple)):
            found = "joint = 'sphere' needs its centre of mass in the middle and one inertia, since its rotation is not computed"
            raise InputError(f"{where} joint", found, "give joint = 'free'")
        if self.members and (self.parent != GROUND or self.drive is not None):
            raise InputError(
                f"{where} members", "bodies with members need the ground as parent, and no drive", "leave one out"
            )
        for key, _ in self.start:
            if key not in (*self.coordinates, *self.rates):
                raise self._no_start(f"{where} start", key)

    def _no_start(self, where: str, key: str) -> InputError:
        """Why the start says nothing by this name."""
        if self.drive is None:
            known = (*self.coordinates, *self.rates)
            return InputError(where, f"the joint '{self.joint}' has no coordinate '{key}'", nearest(key, known))
        found = f"'{key}' of a body that is driven: its drive says where it is"
        return InputError(where, found, "give the drive's own 'start', and 'speed' (of a ramp 'first') at time 0")

    def _check_inertia(self, where: str) -> None:
        if not isinstance(self.inertia, tuple):
            return
        if len(self.inertia) not in (3, 6) or any(isinstance(x, tuple) for x in self.inertia):
            found = f"{len(self.inertia)} numbers or rows {list(self.inertia)}"
            remedy = "give one number, three about the body's axes, or six: xx, yy, zz, xy, yz, zx"
            raise InputError(f"{where} inertia", found, remedy)
        if all(isinstance(x, (int, float)) for x in self.inertia):
            refuse_impossible(f"{where} inertia", principal(self.inertia))

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of its coordinates in the state; none of a driven body."""
        if self.drive is not None:
            return ()
        parts = ((name,) if kind in ("slide", "hinge") else QUATERNION if kind == "ball" else ()
                 for name, kind, _ in JOINTS[self.joint])  # fmt: skip
        return tuple(name for part in parts for name in part)

    @property
    def rates(self) -> tuple[str, ...]:
        if self.drive is not None:
            return ()
        parts = ((RATES[name],) if kind in ("slide", "hinge") else SPINS for name, kind, _ in JOINTS[self.joint])
        return tuple(name for part in parts for name in part)

    @property
    def massless(self) -> bool:
        """Whether its mass is written as 0: what hangs on it gives its joint inertia."""
        return sizes.nothing(self.mass)

    @property
    def turns(self) -> bool:
        """Whether it turns by its own joint."""
        return any(kind != "slide" for _, kind, _ in JOINTS[self.joint])

    def starting(self, p: Params) -> tuple[list[Number], list[Number]]:
        """Coordinates and velocities at time 0."""
        found = dict.fromkeys((*self.coordinates, *self.rates), 0.0) | ({"q0": 1.0} if "q0" in self.coordinates else {})
        found |= {key: sizes.value(size, self.name, key, p) for key, size in self.start}
        return [found[key] for key in self.coordinates], [found[key] for key in self.rates]

    def parameters(self, turning: bool) -> Parameters:
        """Its own parameters with their defaults; ``turning``: whether anything turns it."""
        name = self.name
        found = sizes.stated(self.mass, name, "mass", "kg", f"mass of {name}")
        if self.massless and (self.inertia is None or sizes.nothing(self.inertia)):
            pass
        elif turning and isinstance(self.inertia, tuple):
            for key, size in zip(INERTIAS, self.inertia, strict=False):
                meaning = f"inertia of {name} about its {key} axis through its centre of mass"
                if len(key) == 2:
                    meaning = f"entry {key} of the matrix of inertia of {name}"
                found |= sizes.stated(size, name, f"inertia_{key}", "kg m^2", meaning)
        elif turning:
            meaning = f"inertia of {name} about its centre of mass"
            found |= sizes.own(self.inertia, name, "inertia", "kg m^2", meaning)
        found |= sizes.of_point(self.at, name, "at", f"place of the joint of {name}, {{}}")
        found |= sizes.of_point(self.center, name, "center", f"centre of mass of {name}, {{}}")
        if self.tilt is not None:
            found |= sizes.own(self.tilt[1], name, "tilt", "rad", f"angle that turns the joint of {name}")
        for key, size in self.start:
            found |= sizes.own(size, name, key, unit_of(key), f"{key} of {name} at time 0")
        if self.drive is not None:
            found |= self.drive.needs(name, self.joint == "hinge")
        return found


def principal(inertia: Sequence[Any]) -> tuple[float, ...]:
    """Principal moments of three numbers, or of six of a matrix of inertia."""
    x, y, z, xy, yz, zx = (*map(float, inertia), 0.0, 0.0, 0.0)[:6]
    return tuple(map(float, np.linalg.eigvalsh([[x, xy, zx], [xy, y, yz], [zx, yz, z]])))


def refuse_impossible(where: str, moments: tuple[Any, ...]) -> None:
    """Refuse principal moments of inertia that no body has: each is at most the sum of the other two."""
    greatest, others = max(moments), sum(moments) - max(moments)
    if min(moments) <= 0.0:
        found = f"principal moments ({', '.join(f'{float(x):.4g}' for x in moments)}) kg m^2"
        raise InputError(where, found, "give a matrix of inertia whose principal moments are all above 0")
    if greatest > others * (1.0 + 1e-9):
        found = f"({', '.join(f'{float(x):g}' for x in moments)}) kg m^2: {greatest:g} is more than the others' sum, {others:g}"
        remedy = "no body has such moments of inertia: correct them, so that none is more than the other two together"
        raise InputError(where, found, remedy)


def unit_of(key: str) -> str:
    """Unit of a coordinate or a velocity by its name."""
    if key in ("position", "x", "y", "z"):
        return "m"
    if key in ("angle", "first", "second"):
        return "rad"
    return "m/s" if key in ("velocity", "vx", "vy", "vz") else "1" if key in QUATERNION else "rad/s"


class Part(NamedTuple):
    """A body in motion, world components; numbers are scalars, or (k,) of a body with members."""

    # axes, place: the body's axes and its origin [m].
    axes: Axes
    place: Vector
    # velocity, spin: of the origin [m/s]; angular [rad/s].
    velocity: Vector
    spin: Vector
    partials: dict[int, tuple[Vector, Vector]]  # by index of a velocity, (w_j, v_j of the origin)
    # drift, swirl: acceleration of the origin and angular acceleration less the partials' part.
    drift: Vector
    swirl: Vector
    turn: Number = 0.0  # angle of the body's own joint, of all its turns [rad]; of two hinges the second's, 0 without
    # Of one body in a row (``rows``) its place, and how many there are: its partials are that of the row's velocities.
    of: tuple[int, int] | None = None

    def velocity_at(self, arm: Vector) -> Vector:
        """Velocity of the material at ``arm`` from the origin."""
        return add(self.velocity, cross(self.spin, arm))

    def drift_at(self, arm: Vector) -> Vector:
        """Drift there."""
        return add(self.drift, cross(self.swirl, arm), cross(self.spin, cross(self.spin, arm)))

    def shifted(self, arm: Vector) -> Part:
        """The same body with another origin."""
        partials = {j: (w, add(v, cross(w, arm))) for j, (w, v) in self.partials.items()}
        return self._replace(
            place=add(self.place, arm), velocity=self.velocity_at(arm), partials=partials, drift=self.drift_at(arm)
        )

    def gained(self, rates: Sequence[Number]) -> tuple[Vector, Vector]:
        """Acceleration of its origin and its angular one, at accelerations of the free velocities; world."""
        own = [(rates[j], w, v) for j, (w, v) in self.partials.items() if j < len(rates)]
        drift = add(self.drift, *(scale(rate, v) for rate, _, v in own))
        return drift, add(self.swirl, *(scale(rate, w) for rate, w, _ in own))


STILL = Part(WORLD, ZERO, ZERO, ZERO, {}, ZERO, ZERO)


class Own(NamedTuple):
    """A body's own coordinates and velocities; index of its first velocity, and that of its drive's partial velocity."""

    q: list[Number]
    v: list[Number]
    first: int
    driven: int


class _Along(NamedTuple):
    """Motion along or about an axis: how far, how fast, what a drive adds to the acceleration; index of the velocity."""

    position: Number
    rate: Number
    jerk: Number
    index: int


def carried(body: Body, at: Vector, parent: Part, own: Own, t: Array, p: Params) -> Part:
    """A body from the one that it hangs on, ``at`` a point of that one's axes, at a time [s]."""
    part = parent.shifted(turned(parent.axes, at))._replace(turn=0.0)
    if body.tilt is not None:
        angle = sizes.length(body.tilt[1], body.name, "tilt", p)
        part = part._replace(axes=rotated(part.axes, sizes.axis(body.tilt[0], body.name), angle))
    basis = _basis(sizes.axis(body.axis, body.name), p)
    q, v, j = list(own.q), list(own.v), own.first
    for _, kind, which in JOINTS[body.joint]:
        if kind in ("slide", "hinge"):
            if body.drive is not None:
                along = _Along(*body.drive.motion(t, body.name, p), own.driven)
            else:
                along, j = _Along(q.pop(0), v.pop(0), 0.0, j), j + 1
            # Slides come first and are along the joint's axes; a second hinge turns with the first.
            way = turned(part.axes, basis[which])
            part = _slid(part, way, along) if kind == "slide" else _hinged(part, way, basis[which], along)
        else:
            rates = (v.pop(0), v.pop(0), v.pop(0))
            spun = turned(part.axes, rates)
            partials = part.partials | {j + k: (part.axes[k], ZERO) for k in range(3)}
            swirl = add(part.swirl, cross(part.spin, spun))
            axes = part.axes
            if kind == "ball":
                axes = tuple(turned(part.axes, column) for column in attitude(q[:4]))
                q = q[4:]
            part = part._replace(axes=axes, spin=add(part.spin, spun), partials=partials, swirl=swirl)
            j += 3
    return part


def _slid(part: Part, way: Vector, along: _Along) -> Part:
    part = part.shifted(scale(along.position, way))
    moving = scale(along.rate, way)
    drift = add(part.drift, scale(2.0, cross(part.spin, moving)), scale(along.jerk, way))
    partials = part.partials | {along.index: (ZERO, way)}
    return part._replace(velocity=add(part.velocity, moving), partials=partials, drift=drift)


def _hinged(part: Part, way: Vector, axis: Vector, along: _Along) -> Part:
    turning = scale(along.rate, way)
    swirl = add(part.swirl, cross(part.spin, turning), scale(along.jerk, way))
    partials = part.partials | {along.index: (way, ZERO)}
    axes = rotated(part.axes, axis, along.position)
    spin = add(part.spin, turning)
    return part._replace(axes=axes, spin=spin, partials=partials, swirl=swirl, turn=along.position)


def rotated(axes: Axes, k: Vector, angle: Number) -> Axes:
    """Axes turned about a unit vector k, given in these axes (Rodrigues)."""
    c, s = jnp.cos(angle), jnp.sin(angle)

    def entry(i: int, j: int) -> Number:
        kk = times(k[i], k[j])
        if i == j:
            # c + (1 - c) k_i k_i, written so that a turn about an axis leaves an exact 1 there.
            return plus(times(c, minus(1.0, kk)), kk)
        odd = times(s, times(1.0 if (j - i) % 3 == 2 else -1.0, k[3 - i - j]))
        return plus(minus(kk, times(c, kk)), odd)

    columns = ((entry(0, j), entry(1, j), entry(2, j)) for j in range(3))
    first, second, third = (turned(axes, column) for column in columns)
    return first, second, third


def quaternion_rate(q: list[Number], u: list[Number]) -> list[Number]:
    """dq/dt = (0, u) q/2: the angular velocity u is in the axes of the joint, not of the body."""
    w, x, y, z = q
    a, b, c = u
    return [
        -0.5 * (a * x + b * y + c * z),
        0.5 * (a * w + b * z - c * y),
        0.5 * (b * w + c * x - a * z),
        0.5 * (c * w + a * y - b * x),
    ]


def _basis(n: Any, p: Params) -> tuple[Vector, Vector, Vector]:
    """(e1, e2, n), right-handed; of z it is x, y, z."""
    if callable(n):
        raise InputError("axis", "is a function", "give an axis, and turn the joint by tilt = (axis, angle)")
    order = {(0.0, 0.0, 1.0): (0, 1), (1.0, 0.0, 0.0): (1, 2), (0.0, 1.0, 0.0): (2, 0)}
    if n in order:
        i, j = order[n]
        return WORLD[i], WORLD[j], n
    least = int(np.argmin(np.abs(n)))
    first = np.cross(n, np.eye(3)[least])
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    return tuple(map(float, first)), tuple(map(float, second)), n  # pyright: ignore[reportReturnType]
