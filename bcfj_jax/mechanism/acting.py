"""What a load is: forces and torques on bodies (``AbstractLoad``), or on coordinates of joints (``CoordinateLoad``)."""

# No ``from __future__ import annotations``: equinox reads ``AbstractVar`` from the annotations themselves, and would
# take ``name`` for the first field of every load.
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.part import complete
from bcfj_jax.core.vectors import ZERO, Number, Vector, add, turned
from bcfj_jax.mechanism import sizes
from bcfj_jax.mechanism.bodies import Part
from bcfj_jax.mechanism.sizes import Parameters, Params


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


class Onset(NamedTuple):
    """A place where a load begins to act, or bends: how far beyond it is [m, rad], and the rate.

    Attributes:
        speed: of the relative motion that it depends on; ``bends``: over how much of this its course bends.
        force: beyond, where that is cut off at 0, as of a damped cable that lets go [N, N m]; else 0.
    """

    depth: Number
    rate: Number
    speed: Number
    force: Number = 0.0
    bends: Number = np.inf


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
        return {}

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        """Times [s] at which steps have to end, since the load bends there; None: looks at it find them."""
        return [] if self.timeless else None

    @property
    def touches(self) -> tuple[str, ...]:
        """Names of the bodies it acts on; empty for all."""
        return ()

    @property
    def acts_on(self) -> str:
        """The body on which its force is read, the last of ``touches``; "" of a load on all."""
        return self.touches[-1] if self.touches else ""

    def apart(self, bodies: Moving, p: Params) -> Vector | None:
        """Place of the second of its two points from the first [m], world; None of a load that has not two."""
        return None

    @property
    def corners(self) -> tuple[tuple[float, Any], ...]:
        """Where its force begins or bends: the sign of the side beyond, and the place (``springs.corners``)."""
        return ()

    def onsets(self, bodies: Moving, p: Params) -> list[Onset]:
        return []

    @property
    def damps(self) -> bool:
        return any(not sizes.nothing(getattr(self, name, 0.0)) for name in ("damping", "turning_damping"))


class CoordinateLoad(AbstractLoad):
    """A load on the coordinate of a slide or hinge.

    Attributes:
        body: whose joint; dry: whether its power is friction's.
        bristles: whether it keeps a number of every member, of which ``bending`` is the rate and ``reach`` the size.
    """

    dry: ClassVar[bool] = False
    bristles: ClassVar[bool] = False
    body: eqx.AbstractVar[str]

    @property
    def touches(self) -> tuple[str, ...]:
        return (self.body,)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The bodies on whose joints' coordinates it acts."""
        return (self.body,)

    def actions(self, t: Array, bodies: Moving, p: Params) -> list[Action]:
        return []

    @abstractmethod
    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params, *bend: Number) -> Number:
        """Force or torque on the coordinate [N, N m]; ``bend``: what it keeps."""

    def on_coordinates(
        self, t: Array, positions: Sequence[Number], rates: Sequence[Number], p: Params, *bend: Number
    ) -> list[Number]:
        """The same on each of ``coordinates``."""
        return [self.on_coordinate(t, positions[0], rates[0], p, *bend)]

    def onsets_on(self, t: Array, positions: Sequence[Number], rates: Sequence[Number], p: Params) -> list[Onset]:
        """Of each of ``corners``, at those of ``coordinates``."""
        return []

    def bending(self, rate: Number, bend: Number, p: Params) -> Number:
        """Rate of what it keeps; of a load without bristles nobody asks."""
        return 0.0

    def reach(self, p: Params) -> Array:
        """What errors of that are measured in."""
        return jnp.ones(())

    def holding(self, slip: Array, p: Params, time: float) -> tuple[Array, Array]:
        """As ``AbstractFriction.holding`` of a rate [m/s, rad/s]; nothing is held by a load that is not dry friction."""
        return jnp.zeros_like(slip), jnp.ones_like(slip)

    @abstractmethod
    def parameters(self, turns: bool = True) -> Parameters:
        """Its parameters with their defaults; ``turns``: whether the coordinate is an angle."""
