"""Loads: what acts on bodies beside contacts. Each says which force and torque it puts where; nothing else is compiled.

To add one in a file of your own: ``Load(name, function)`` with a function (t, bodies, p) -> list of ``Action``.
"""

# No ``from __future__ import annotations``: equinox reads ``AbstractVar`` from the annotations themselves, and would
# take ``name`` for the first field of every load.
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.friction import AbstractFriction, make_friction
from bcfj_jax.contact.part import checked as checked_part
from bcfj_jax.contact.part import complete
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.vectors import (
    ZERO,
    Number,
    Vector,
    add,
    dot,
    length,
    minus,
    negative,
    scale,
    subtract,
    times,
    turned,
    unit,
)
from bcfj_jax.mechanism import arrays, sizes
from bcfj_jax.mechanism.bodies import GROUND, Drive, Part
from bcfj_jax.mechanism.programmes import Programme, Table, checked_shape, given_breaks, given_table
from bcfj_jax.mechanism.sizes import ORIGIN, Parameters, Params, Place, Size


class Moving(NamedTuple):
    """All bodies at one instant, by name, the ground among them.

    Attributes:
        parts: origin, axes and velocities (``bodies.Part``).
        mass: [kg].
        center: from the origin to the centre of mass [m], world.
        rows: names of bodies that are alike and have numbers (k,) as one, and of all others.
    """

    parts: Mapping[str, Part]
    mass: Mapping[str, Number]
    center: Mapping[str, Vector]
    rows: tuple[str, ...] = ()

    def place(self, body: str, at: Vector = ZERO) -> Vector:
        """Place of a point given in the body's axes [m], world."""
        part = self.parts[body]
        return add(part.place, turned(part.axes, at))

    def velocity(self, body: str, at: Vector = ZERO) -> Vector:
        """Velocity of a point given in the body's axes [m/s], world."""
        part = self.parts[body]
        return part.velocity_at(turned(part.axes, at))


class Action(NamedTuple):
    """A force [N] at a point given in the body's axes [m], and a torque [N m]; force and torque in world axes."""

    body: str
    force: Vector = ZERO
    at: Vector = ZERO
    torque: Vector = ZERO


class AbstractLoad(eqx.Module):
    """What acts on bodies.

    Attributes:
        name: unique; its numbers are ``<name>.<key>``.
        timeless: whether it knows no time.
    """

    example: ClassVar[str] = """
class Pull(bj.loads.AbstractLoad):
    name: str = eqx.field(static=True, default="pull")

    def actions(self, t, bodies, p):
        return [bj.loads.Action("mass", force=(-10.0, 0.0, 0.0))]
"""
    timeless: ClassVar[bool] = False
    name: eqx.AbstractVar[str]

    def __new__(cls, *args: Any, **more: Any) -> Any:
        """Refuse a class that leaves something out."""
        complete(cls, [*getattr(cls, "__abstractmethods__", ()), *getattr(cls, "__abstractvars__", ())], cls.example)
        return super().__new__(cls)

    @abstractmethod
    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        """Forces and torques now; the powers of an action and of its reaction may differ, which is what it stores."""

    def parameters(self) -> Parameters:
        """Its parameters with their defaults."""
        return {}

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        """Times [s] at which steps have to end, since the load bends there; None: looks at it find them."""
        return [] if self.timeless else None

    @property
    def touches(self) -> tuple[str, ...]:
        """Names of the bodies it acts on; empty for all."""
        return ()

    @property
    def damps(self) -> bool:
        """Whether it may oppose a velocity."""
        return any(not sizes.nothing(getattr(self, name, 0.0)) for name in ("damping", "turning_damping"))


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
        size: [N]; ramp: rise time [s] or None; table: linear between its points, in place of ``size``.
        shape: of the rise, a name of ``programmes.SHAPES``.
        amplitude, frequency: of a fluctuation about ``size`` [N, Hz]; None for none.
        reversal, reversal_ramp: when the force begins to change its sign, and over what time [s]; None for never.
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

    def _sizes(self: Any, p: Params) -> list[Number]:
        return [sizes.length(getattr(self, key), self.name, key, p) for key in self.units]

    def parameters(self: Any) -> Parameters:
        found: Parameters = {}
        for key, one in self.units.items():
            found |= sizes.stated(getattr(self, key), self.name, key, one)
        return found | _of_point(self.at[0], self.name, "a") | _of_point(self.at[1], self.name, "b")


class Spring(_BetweenPoints):
    """A spring and damper along the line between two points:  F = k (L - L0) + c dL/dt, pulling for F > 0.

    Attributes:
        between, at: bodies and points in their axes [m].
        stiffness: k [N/m]; damping: c [N s/m]; free_length: L0 [m].
    """

    units: ClassVar[Mapping[str, str]] = {"stiffness": "N/m", "damping": "N s/m", "free_length": "m"}
    name: str = eqx.field(static=True)
    between: tuple[str, str] = eqx.field(static=True, converter=lambda x: tuple(x))
    stiffness: Size = sizes.field("spring stiffness", default=0.0)
    damping: Size = sizes.field("spring damping", default=0.0)
    free_length: Size = sizes.field("spring free_length", default=0.0)
    at: tuple[Place, Place] = sizes.field("spring at", default=(ORIGIN, ORIGIN))

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        (a, b), arm, rate = self._apart(bodies, p)
        (k, c, free), way = self._sizes(p), unit(arm)
        pull = times(k, minus(length(arm), free)) + times(c, dot(way, rate))
        first, second = self.between
        return [Action(first, scale(pull, way), a), Action(second, negative(scale(pull, way)), b)]


class Bush(_BetweenPoints):
    """A compliant bush: two points held together,  F = -k r - c dr/dt  on the second; it closes a loop of bodies.

    r is the second point's place from the first's. ``turning_damping`` resists the relative spin; nothing resists the
    relative angle.

    Attributes:
        between, at: bodies and points in their axes [m].
        stiffness: k [N/m], every direction; damping: c [N s/m]; turning_damping: [N m s/rad].
    """

    units: ClassVar[Mapping[str, str]] = {"stiffness": "N/m", "damping": "N s/m", "turning_damping": "N m s/rad"}
    name: str = eqx.field(static=True)
    between: tuple[str, str] = eqx.field(static=True, converter=lambda x: tuple(x))
    stiffness: Size = sizes.field("bush stiffness", default=1e7)
    damping: Size = sizes.field("bush damping", default=0.0)
    turning_damping: Size = sizes.field("bush turning_damping", default=0.0)
    at: tuple[Place, Place] = sizes.field("bush at", default=(ORIGIN, ORIGIN))

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        (a, b), arm, rate = self._apart(bodies, p)
        k, c, turning = self._sizes(p)
        first, second = self.between
        pull = add(scale(k, arm), scale(c, rate))
        drag = scale(turning, subtract(bodies.parts[second].spin, bodies.parts[first].spin))
        return [Action(first, pull, a, drag), Action(second, negative(pull), b, negative(drag))]


class CoordinateLoad(AbstractLoad):
    """A load on the coordinate of a slide or hinge; ``body``: whose joint; ``dry``: whether its power is friction's."""

    dry: ClassVar[bool] = False
    body: eqx.AbstractVar[str]

    @property
    def touches(self) -> tuple[str, ...]:
        return (self.body,)

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        return []

    @abstractmethod
    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params) -> Number:
        """Force or torque on the coordinate [N, N m]."""

    @abstractmethod
    def parameters(self, turns: bool = True) -> Parameters:
        """Its parameters with their defaults; ``turns``: whether the coordinate is an angle."""


class JointSpring(CoordinateLoad):
    """A spring and damper on the coordinate of a slide or hinge:  -k (q - q0) - c (dq/dt - dq0/dt)  on it.

    Attributes:
        body: whose joint; stiffness: k [N/m or N m/rad]; damping: c; rest: q0 [m or rad].
        drive: a motion q0(t), in place of ``rest``: a flexible drive.
    """

    name: str = eqx.field(static=True)
    body: str = eqx.field(static=True)
    stiffness: Size = sizes.field("joint spring stiffness", default=0.0)
    damping: Size = sizes.field("joint spring damping", default=0.0)
    rest: Size = sizes.field("joint spring rest", default=0.0)
    drive: Drive | None = None

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        return [] if self.drive is None else self.drive.kinks(self.name, p)

    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params) -> Number:
        k, c, rest = (
            sizes.length(size, self.name, name, p)
            for size, name in ((self.stiffness, "stiffness"), (self.damping, "damping"), (self.rest, "rest"))
        )
        if self.drive is not None:
            rest, speed, _ = self.drive.motion(t, self.name, p)
            rate = minus(rate, speed)
        return minus(times(-1.0, times(k, minus(position, rest))), times(c, rate))

    def parameters(self, turns: bool = True) -> Parameters:
        found = sizes.stated(self.stiffness, self.name, "stiffness", "N m/rad" if turns else "N/m")
        found |= sizes.stated(self.damping, self.name, "damping", "N m s/rad" if turns else "N s/m")
        if self.drive is not None:
            return found | self.drive.needs(self.name, turns)
        return found | sizes.stated(self.rest, self.name, "rest", "rad" if turns else "m")


class JointFriction(CoordinateLoad):
    """Dry friction in a slide or hinge:  -m(w^2) w  on its coordinate, w its rate, m a friction law's mobility.

    The law is a contact's, its coefficients being torques [N m] or forces [N] in place of ratios to a normal force: mu_d is
    ``sliding``, mu_s ``breakaway``, v_t ``speed``. Laws creep below ``speed``: a joint that holds a load q turns at about
    q v_t/sliding (Coulomb).

    Attributes:
        body: whose joint; sliding: torque or force of fast motion; speed: transition speed [rad/s, m/s].
        breakaway: the highest torque or force, of laws with a static coefficient; None: ``sliding``.
        friction: a name of ``contact.friction.FRICTION`` without a state of its own, or a law.
    """

    timeless: ClassVar[bool] = True
    dry: ClassVar[bool] = True
    name: str = eqx.field(static=True)
    body: str = eqx.field(static=True)
    sliding: Size = sizes.field("joint friction sliding")
    speed: Size = sizes.field("joint friction speed")
    breakaway: Size = sizes.field("joint friction breakaway", default=None)
    friction: str | AbstractFriction = eqx.field(static=True, default="coulomb")

    def __check_init__(self):
        law, known = self._law, {"friction_static", "friction_dynamic", "friction_speed"}
        if law.bristles or law.lags or not set(law.needs) <= known:
            found = f"{type(law).__name__} has a state or coefficients that a joint has not"
            raise InputError(f"load '{self.name}' friction", found, "give coulomb, step or brown_mcphee")
        if self.sliding is None or self.speed is None:
            raise InputError(f"load '{self.name}'", "sliding or speed is missing", "give both")

    @property
    def _law(self) -> AbstractFriction:
        where = f"load '{self.name}' friction"
        given = make_friction(self.friction) if isinstance(self.friction, str) else self.friction
        return checked_part(where, given, AbstractFriction, "friction law", "give a name")

    @property
    def damps(self) -> bool:
        return True

    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params) -> Number:
        sliding, speed = (sizes.length(getattr(self, key), self.name, key, p) for key in ("sliding", "speed"))
        held = sliding if self.breakaway is None else sizes.length(self.breakaway, self.name, "breakaway", p)
        told = {"friction_dynamic": sliding, "friction_static": held, "friction_speed": speed}
        return -self._law.coefficient(jnp.asarray(rate), {name: jnp.asarray(x) for name, x in told.items()})

    def parameters(self, turns: bool = True) -> Parameters:
        force, speed = ("N m", "rad/s") if turns else ("N", "m/s")
        found: Parameters = {}
        for key, of in (("sliding", force), ("breakaway", force), ("speed", speed)):
            if (size := getattr(self, key)) is not None:
                for name, (quantity, default) in sizes.stated(size, self.name, key, of).items():
                    found[name] = quantity._replace(low=0.0, open_low=key == "speed"), default
        return found


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
    bodies: tuple[str, ...] = eqx.field(static=True, default=())
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

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The load's."""
        return self.part.name

    @property
    def touches(self) -> tuple[str, ...]:
        return self.part.touches

    @property
    def damps(self) -> bool:
        return self.part.damps

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        return arrays.filled(self.part, p, f"{self.name}.").actions(t, bodies, p)

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        return self.part.kinks(p)

    def parameters(self) -> Parameters:
        return self.part.parameters() | arrays.of_load(self.part)


def kept(load: Any) -> Any:
    """A load as a mechanism keeps it; what is no load stays as it is."""
    if not isinstance(load, AbstractLoad):
        return load
    found = arrays.taken(f"load {quoted(load.name)}", load)
    return found if found is load else HeldLoad(part=found)  # pyright: ignore[reportCallIssue]


def quantities(where: str, given: Any) -> tuple[tuple[Quantity, Any], ...]:
    """Quantities of the user's with defaults: a ``float``, an array as ``arrays.Held``, or None."""
    found = []
    for entry in given:
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
    return given


LOADS: dict[str, type[AbstractLoad]] = {
    "gravity": Gravity, "force": Force, "torque": Torque, "spring": Spring, "bush": Bush, "joint_spring": JointSpring,
    "joint_friction": JointFriction,
}  # fmt: skip


def _of_point(place: Place, name: str, key: str) -> Parameters:
    return sizes.of_point(place, name, key, f"{key} {{}} of {name}")
