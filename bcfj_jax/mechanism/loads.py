"""Loads: what acts on bodies beside contacts. Each says which force and torque it puts where; nothing else is compiled.

To add one in a file of your own: ``Load(name, function)`` with a function (t, bodies, p) -> list of ``Action``.
"""

# No ``from __future__ import annotations``: equinox reads ``AbstractVar`` from the annotations themselves, and would
# take ``name`` for the first field of every load.
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.part import checked as checked_part
from bcfj_jax.contact.part import of
from bcfj_jax.core.errors import InputError, nearest, quoted, texts
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.vectors import (
    Number,
    Vector,
    add,
    cross,
    dot,
    length,
    minus,
    negative,
    scale,
    seen,
    subtract,
    times,
    turned,
    unit,
)
from bcfj_jax.mechanism import arrays, sizes, springs
from bcfj_jax.mechanism.acting import AbstractLoad as AbstractLoad
from bcfj_jax.mechanism.acting import Action as Action
from bcfj_jax.mechanism.acting import CoordinateLoad as CoordinateLoad
from bcfj_jax.mechanism.acting import Moving as Moving
from bcfj_jax.mechanism.acting import Onset
from bcfj_jax.mechanism.bodies import GROUND, Part
from bcfj_jax.mechanism.jointloads import Coupling as Coupling
from bcfj_jax.mechanism.jointloads import JointFriction as JointFriction
from bcfj_jax.mechanism.jointloads import JointSpring as JointSpring
from bcfj_jax.mechanism.programmes import Programme, Table, checked_shape, given_breaks, given_table
from bcfj_jax.mechanism.sizes import ORIGIN, Parameters, Params, Place, Size


class Gravity(AbstractLoad):
    """Weight of every body, m g; g is the shared parameter ``gravity`` [m/s^2]."""

    timeless: ClassVar[bool] = True
    direction: Any = sizes.field("gravity direction", default="-y")
    name: str = eqx.field(static=True, default="gravity")

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        way = sizes.axis(self.direction, "gravity direction")
        found = []
        for body in bodies.rows or bodies.mass:
            mass, axes = bodies.mass[body], bodies.parts[body].axes
            arm = bodies.center[body]
            at = (dot(axes[0], arm), dot(axes[1], arm), dot(axes[2], arm))
            found.append(Action(body, scale(times(mass, p["gravity"]), way), at))
        return found

    def parameters(self) -> Parameters:
        return {"gravity": (CATALOGUE["gravity"], 9.81)}


class Force(AbstractLoad):
    """A force on a body along a direction, [N]: constant, raised over a ramp [s], or from a table (times, forces).

    Attributes:
        body, at: where; the point in the body's axes [m].
        direction: "x", "-y" or three numbers; of the world, or of the body where ``follows``.
        size: [N]; table: linear between its points, in place of it; the others are ``programmes.Programme``'s.
    """

    name: str = eqx.field(static=True)
    body: str = eqx.field(static=True)
    direction: Any = sizes.field("force direction", default="x")
    size: Size = sizes.field("force size", default=None)
    at: Place = sizes.field("force at", default=ORIGIN)
    ramp: Size = sizes.field("force ramp", default=None)
    table: Table | None = eqx.field(static=True, default=None, converter=lambda x: given_table("force table", x))
    follows: bool = eqx.field(static=True, default=False)
    shape: str = eqx.field(static=True, default="smooth")
    amplitude: Size = sizes.field("force amplitude", default=None)
    frequency: Size = sizes.field("force frequency", default=None)
    reversal: Size = sizes.field("force reversal", default=None)
    reversal_ramp: Size = sizes.field("force reversal_ramp", default=None)

    def __check_init__(self):
        where = f"load '{self.name}'"
        checked_shape(f"{where} shape", self.shape)
        for first, second in (("amplitude", "frequency"), ("reversal", "reversal_ramp")):
            if (getattr(self, first) is None) != (getattr(self, second) is None):
                raise InputError(f"{where} {first}", f"needs {second} beside it", f"give {first} and {second}, or none")
        if self.table is not None:
            rest = ("ramp", "shape", "amplitude", "frequency", "reversal", "reversal_ramp")
            sizes.check_read(where, self, "a table", rest, "put all of its course into the table")

    @property
    def touches(self) -> tuple[str, ...]:
        return (self.body,)

    @property
    def programme(self) -> Programme:
        """Its size over time."""
        return Programme(
            self.size, self.ramp, self.shape, self.table, self.amplitude, self.frequency, self.reversal,
            self.reversal_ramp,
        )  # fmt: skip

    def _amount(self, t: Array, p: Params) -> Number:
        return self.programme(t, self.name, p)

    def _way(self, bodies: Moving) -> Vector:
        way = sizes.axis(self.direction, f"load '{self.name}' direction")
        return turned(bodies.parts[self.body].axes, way) if self.follows else way

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        at = sizes.point(self.at, self.name, "at", p)
        return [Action(self.body, scale(self._amount(t, p), self._way(bodies)), at)]

    def kinks(self, p: Params) -> list[ArrayLike]:
        return self.programme.kinks(self.name, p)

    def parameters(self) -> Parameters:
        unit = "N m" if isinstance(self, Torque) else "N"
        return self.programme.parameters(self.name, unit) | _of_point(self.at, self.name, "at")


class Torque(Force):
    """A torque on a body about a direction, [N m], and its reaction on another where ``against`` names one."""

    against: str = eqx.field(static=True, default=GROUND)

    @property
    def touches(self) -> tuple[str, ...]:
        return (self.body, self.against)

    @property
    def acts_on(self) -> str:
        return self.body

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        torque = scale(self._amount(t, p), self._way(bodies))
        return [Action(self.body, torque=torque), Action(self.against, torque=negative(torque))]


class _BetweenPoints(AbstractLoad):
    """A load between points ``at`` two bodies; ``units``: of its sizes, by name."""

    timeless: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]]
    # ``between`` and ``at`` are fields of the loads, in an order of theirs.

    @property
    def touches(self: Any) -> tuple[str, ...]:
        return self.between

    def _apart(self: Any, bodies: Moving, p: Params) -> tuple[list[Vector], Vector, Vector]:
        """Both points in their bodies' axes; the second's place and velocity from the first's, world."""
        points = [sizes.point(at, self.name, side, p) for side, at in zip("ab", self.at, strict=True)]
        places = [bodies.place(body, at) for body, at in zip(self.between, points, strict=True)]
        rates = [bodies.velocity(body, at) for body, at in zip(self.between, points, strict=True)]
        return points, subtract(places[1], places[0]), subtract(rates[1], rates[0])

    def apart(self, bodies: Moving, p: Params) -> Vector:
        return self._apart(bodies, p)[1]

    def parameters(self: Any) -> Parameters:
        found = sizes.parameters(self, self.units)
        return found | _of_point(self.at[0], self.name, "a") | _of_point(self.at[1], self.name, "b")


class Spring(_BetweenPoints):
    """A spring and damper along the line between two points:  F = f(L - L0) + c dL/dt, pulling for F > 0.

    f(x) = k x, or by ``table`` linear between its points (extensions [m], forces [N]) and going on with the slope at its ends;
    steps are looked at for its knots. With a ``side`` it acts on one side alone, and never the other way:
    F = max(f + c dL/dt, 0) for x > 0 else 0 of "pull", a cable; F = min(f + c dL/dt, 0) for x < 0 else 0 of "push", a bump stop.

    Attributes:
        between, at: bodies and points in their axes [m].
        stiffness: k [N/m]; damping: c [N s/m]; free_length: L0 [m]; a preload is an L0 other than the length at the start.
        table: in place of ``stiffness``; side: "both", "pull" or "push".
    """

    units: ClassVar[Mapping[str, str]] = {"stiffness": "N/m", "damping": "N s/m", "free_length": "m"}
    name: str = eqx.field(static=True)
    between: tuple[str, str] = eqx.field(static=True, converter=sizes.pair)
    stiffness: Size = sizes.field("spring stiffness", default=0.0)
    damping: Size = sizes.field("spring damping", default=0.0)
    free_length: Size = sizes.field("spring free_length", default=0.0)
    at: tuple[Place, Place] = sizes.field("spring at", default=(ORIGIN, ORIGIN))
    table: Table | None = springs.field("spring table")
    side: str = eqx.field(static=True, default="both")

    def __check_init__(self):
        springs.check(f"load '{self.name}'", self.side, self.table, self.stiffness)

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        (a, b), arm, rate = self._apart(bodies, p)
        (k, c, free), way = sizes.values(self, self.units, p), unit(arm)
        pull = springs.force(minus(length(arm), free), dot(way, rate), k, c, self.table, self.side)
        first, second = self.between
        return [Action(first, scale(pull, way), a), Action(second, negative(scale(pull, way)), b)]

    @property
    def corners(self) -> tuple[tuple[float, Any], ...]:
        return springs.corners(self.table, self.side)

    def onsets(self, bodies: Moving, p: Params) -> list[Onset]:
        _, arm, rate = self._apart(bodies, p)
        (k, c, free), far = sizes.values(self, self.units, p), length(arm)
        more = length(rate), far
        return springs.onsets(minus(far, free), dot(unit(arm), rate), (k, c, self.table, self.side), more)


class Bush(_BetweenPoints):
    """A compliant bush: two points held together; it closes a loop of bodies.

    On the second act

        F = -k r - c (dr/dt - w_m x r),        T = -k_t a - c_t w,

    r its point's place from the first's, w_m the mean of both spins, a the rotation vector from the first's axes to the
    second's, w the relative spin. Each of k, c, k_t and c_t is one number, or three along the first body's axes. A motion of
    the whole is not damped, and no momentum is made: the spring's part acts on both bodies at the second's point, and the
    damper's midway between both. k_t along three axes is right for turns about one axis at a time, else to the second order of
    a; a is below half a turn.

    Attributes:
        between, at: bodies and points in their axes [m].
        stiffness: k [N/m]; damping: c [N s/m]; turning_damping: c_t [N m s/rad]; turning_stiffness: k_t [N m/rad].
    """

    units: ClassVar[Mapping[str, str]] = {
        "stiffness": "N/m", "damping": "N s/m", "turning_damping": "N m s/rad", "turning_stiffness": "N m/rad",
    }  # fmt: skip
    name: str = eqx.field(static=True)
    between: tuple[str, str] = eqx.field(static=True, converter=sizes.pair)
    stiffness: Any = sizes.field("bush stiffness", default=1e7)
    damping: Any = sizes.field("bush damping", default=0.0)
    turning_damping: Any = sizes.field("bush turning_damping", default=0.0)
    at: tuple[Place, Place] = sizes.field("bush at", default=(ORIGIN, ORIGIN))
    turning_stiffness: Any = sizes.field("bush turning_stiffness", default=0.0)

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        (a, b), arm, rate = self._apart(bodies, p)
        k, c, turning, twisting = sizes.values(self, self.units, p)
        first, second = (bodies.parts[name] for name in self.between)
        rate = subtract(rate, cross(scale(0.5, add(first.spin, second.spin)), arm))
        damper = springs.along(c, first.axes, rate)
        pull, a = add(springs.along(k, first.axes, arm), damper), add(a, seen(first.axes, arm))
        drag = springs.along(turning, first.axes, subtract(second.spin, first.spin))
        drag = subtract(drag, scale(0.5, cross(arm, damper)))
        if not sizes.nothing(self.turning_stiffness):
            turn = springs.turn(first.axes, second.axes)
            drag = add(drag, springs.along(twisting, first.axes, turned(first.axes, turn)))
        names = self.between
        return [Action(names[0], pull, a, drag), Action(names[1], negative(pull), b, negative(drag))]


class Load(AbstractLoad):
    """A load of the user's own.

    Attributes:
        function: (t, bodies: Moving, p) -> list of ``Action``; an equinox module with arrays, too (``arrays``).
        bodies: names of the bodies it acts on.
        quantities: what the parameters of its own are, as (``Quantity``, default); it reads them from p by name.
        breaks: times [s] at which steps have to end; None: looks at the function find where it bends.
    """

    name: str = eqx.field(static=True)
    function: Callable[[Array, Moving, Params], list[Action]]
    bodies: tuple[str, ...] = eqx.field(
        static=True, default=(), converter=lambda x: texts("load bodies", x, "give names of bodies")
    )
    quantities: tuple[tuple[Quantity, Any], ...] = eqx.field(
        static=True, default=(), converter=lambda x: quantities("quantities", x)
    )
    breaks: tuple[float, ...] | None = eqx.field(static=True, default=None, converter=given_breaks)

    @property
    def touches(self) -> tuple[str, ...]:
        return self.bodies

    @property
    def damps(self) -> bool:
        return True

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        return list(self.function(t, bodies, p))

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        return None if self.breaks is None else [np.asarray(self.breaks)]

    def parameters(self) -> Parameters:
        return {quantity.name: (quantity, arrays.plain(default)) for quantity, default in self.quantities}


class HeldLoad(AbstractLoad):
    """A load with arrays, which are parameters: ``<name>.<path>`` (``mechanism.arrays``)."""

    part: AbstractLoad

    name, touches, acts_on, damps, corners, apart, onsets, kinks = map(
        partial(of, "part"), ("name", "touches", "acts_on", "damps", "corners", "apart", "onsets", "kinks")
    )  # pyright: ignore[reportAssignmentType]

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        return arrays.filled(self.part, p, f"{self.name}.").actions(t, bodies, p)

    def parameters(self) -> Parameters:
        return self.part.parameters() | arrays.of_load(self.part)


def kept(load: Any) -> Any:
    """A load as a mechanism keeps it; what is no load stays as it is."""
    if not isinstance(load, AbstractLoad):
        return load
    sizes.check_fields(f"load {quoted(load.name)}", load)
    return arrays.kept(f"load {quoted(load.name)}", load, HeldLoad)


def quantities(where: str, given: Any) -> tuple[tuple[Quantity, Any], ...]:
    """Quantities of the user's with defaults: a ``float``, an array as ``arrays.Held``, or None."""
    found = []
    for entry in given if isinstance(given, Iterable) else (given,):
        quantity, default = entry if isinstance(entry, tuple) and not isinstance(entry, Quantity) else (entry, None)
        if not isinstance(quantity, Quantity):
            raise InputError(where, quoted(entry), "give (Quantity(name, unit, meaning), default)")
        default = None if default is None else arrays.number(f"{where} {quantity.name}", default)
        shape = quantity.shape if default is None else np.shape(arrays.plain(default))
        if quantity.shape not in ((), shape):
            raise InputError(f"{where} {quantity.name}", f"shape {shape}", f"give an array of shape {quantity.shape}")
        found.append((quantity._replace(shape=shape), default))
    return tuple(found)


def checked(where: str, given: Any) -> AbstractLoad:
    """A load that was given as itself."""
    if callable(given) and not isinstance(given, (AbstractLoad, type)):
        remedy = f'give it a name: bj.Load("my_load", {getattr(given, "__name__", "function")})'
        raise InputError(where, f"{quoted(given)} is no load", remedy)
    return checked_part(where, given, AbstractLoad, "load", "give a load of bj.loads")


def checked_action(where: str, given: Any, bodies: Mapping[str, Part]) -> Action:
    """An action of a user's load."""
    if not isinstance(given, Action):
        remedy = 'return a list such as [bj.loads.Action("mass", force=(0.0, -10.0, 0.0))]'
        raise InputError(where, f"{quoted(given)} is no Action", remedy)
    if given.body not in bodies:
        raise InputError(where, f"acts on {quoted(given.body)}, which is no body", nearest(str(given.body), bodies))
    for key in ("force", "at", "torque"):
        value = getattr(given, key)
        if not hasattr(value, "__len__") or len(value) != 3:
            raise InputError(where, f"an Action with {key} = {quoted(value)}", "give its three components")
    return given


LOADS: dict[str, type[AbstractLoad]] = {
    "gravity": Gravity, "force": Force, "torque": Torque, "spring": Spring, "bush": Bush, "joint_spring": JointSpring,
    "joint_friction": JointFriction, "coupling": Coupling,
}  # fmt: skip


def _of_point(place: Place, name: str, key: str) -> Parameters:
    return sizes.of_point(place, name, key, f"{key} {{}} of {name}")
