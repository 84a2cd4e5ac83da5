"""Loads on the coordinates of slides and hinges: springs, dry friction, and couplings of two joints."""

# No ``from __future__ import annotations``, as in ``acting``.
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.friction import AbstractFriction, make_friction
from bcfj_jax.contact.part import checked as checked_part
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.vectors import Number, minus, times
from bcfj_jax.mechanism import sizes, springs
from bcfj_jax.mechanism.acting import CoordinateLoad, Onset
from bcfj_jax.mechanism.bodies import Drive, checked_drive
from bcfj_jax.mechanism.programmes import Table
from bcfj_jax.mechanism.sizes import Parameters, Params, Size

# A friction law's coefficients and the keys of ``JointFriction`` for them.
_RUBS = {
    "friction_dynamic": "sliding", "friction_static": "breakaway", "friction_speed": "speed",
    "bristle_stiffness": "bristle_stiffness", "bristle_damping": "bristle_damping",
}  # fmt: skip


class JointSpring(CoordinateLoad):
    """A spring and damper on the coordinate of a slide or hinge:  -f(q - q0) - c (dq/dt - dq0/dt)  on it.

    f, ``table`` (angles or lengths, torques or forces) and ``side`` are those of ``Spring``: "push" acts below q0 alone and
    pushes q up, as a stop does, "pull" above it. An angle is that of all turns.

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
    table: Table | None = springs.field("joint spring table")
    side: str = eqx.field(static=True, default="both")

    def __check_init__(self):
        springs.check(f"load '{self.name}'", self.side, self.table, self.stiffness)
        checked_drive(f"load '{self.name}'", self.drive)
        if self.drive is not None:
            sizes.check_read(f"load '{self.name}'", self, "a driven joint spring", ("rest",), "give the drive's start")

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        return [] if self.drive is None else self.drive.kinks(self.name, p)

    def _extended(self, t: Array, position: Number, rate: Number, p: Params) -> tuple[Number, Number]:
        """q - q0 and its rate."""
        if self.drive is None:
            return minus(position, sizes.values(self, ("rest",), p)[0]), rate
        rest, speed, _ = self.drive.motion(t, self.name, p)
        return minus(position, rest), minus(rate, speed)

    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params) -> Number:
        k, c = sizes.values(self, ("stiffness", "damping"), p)
        return times(-1.0, springs.force(*self._extended(t, position, rate, p), k, c, self.table, self.side))

    @property
    def corners(self) -> tuple[tuple[float, Any], ...]:
        return springs.corners(self.table, self.side)

    def onsets_on(self, t: Array, positions: Sequence[Number], rates: Sequence[Number], p: Params) -> list[Onset]:
        x, v = self._extended(t, positions[0], rates[0], p)
        k, c = sizes.values(self, ("stiffness", "damping"), p)
        return springs.onsets(x, v, (k, c, self.table, self.side), (jnp.abs(v), np.inf))

    def parameters(self, turns: bool = True) -> Parameters:
        force, way = sizes.coordinate(turns)
        found = sizes.parameters(self, {"stiffness": f"{force}/{way}", "damping": f"{force} s/{way}"})
        return found | (
            sizes.parameters(self, {"rest": way}) if self.drive is None else self.drive.needs(self.name, turns)
        )


class JointFriction(CoordinateLoad):
    """Dry friction in a slide or hinge:  -m(w^2) w  on its coordinate, w its rate, m a friction law's mobility.

    The law is a contact's, its coefficients being torques [N m] or forces [N] in place of ratios to a normal force: mu_d is
    ``sliding``, mu_s ``breakaway``, v_t ``speed``. Laws creep below ``speed``: a joint that holds a load q turns at about
    q v_t/sliding (Coulomb). ``lugre`` sticks (``contact.friction.LuGre``): its bristle z [rad, m] is a state, 0 at the start,

        z' = w - |w| sigma_0 z/g(w),   g = mu_d + (mu_s - mu_d) exp(-(w/v_t)^2),   F = -sigma_0 z - sigma_1 z'

    Attributes:
        body: whose joint; sliding: torque or force of fast motion; speed: transition speed [rad/s, m/s].
        breakaway: the highest torque or force, of laws with a static coefficient; None: ``sliding``.
        friction: a name of ``contact.friction.FRICTION``, or a law; of those with a state bristles alone.
        bristle_stiffness: sigma_0 [N m/rad, N/m]; bristle_damping: sigma_1 [N m s/rad, N s/m], None for 0; of ``lugre``.
    """

    timeless: ClassVar[bool] = True
    dry: ClassVar[bool] = True
    name: str = eqx.field(static=True)
    body: str = eqx.field(static=True)
    sliding: Size = sizes.field("joint friction sliding")
    speed: Size = sizes.field("joint friction speed")
    breakaway: Size = sizes.field("joint friction breakaway", default=None)
    friction: str | AbstractFriction = eqx.field(static=True, default="coulomb")
    bristle_stiffness: Size = sizes.field("joint friction bristle_stiffness", default=None)
    bristle_damping: Size = sizes.field("joint friction bristle_damping", default=None)

    def __check_init__(self):
        law, where = self._law, f"load '{self.name}'"
        if law.lags or not set(law.needs) <= set(_RUBS):
            found = f"{type(law).__name__} has a memory or coefficients that a joint has not"
            raise InputError(f"{where} friction", found, "give coulomb, step, brown_mcphee or lugre")
        if self.sliding is None or self.speed is None:
            raise InputError(where, "sliding or speed is missing", "give both")
        if law.bristles and self.bristle_stiffness is None:
            raise InputError(
                f"{where} bristle_stiffness", "is missing", "give about 1000 times sliding per radian or metre"
            )
        for key in ("bristle_stiffness", "bristle_damping"):
            if not law.bristles and getattr(self, key) is not None:
                raise InputError(
                    f"{where} {key}", f"{type(law).__name__} has no bristles", "leave it out, or give lugre"
                )

    @property
    def _law(self) -> AbstractFriction:
        where = f"load '{self.name}' friction"
        given = make_friction(self.friction) if isinstance(self.friction, str) else self.friction
        return checked_part(where, given, AbstractFriction, "friction law", "give a name")

    @property
    def damps(self) -> bool:
        return True

    @property
    def bristles(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._law.bristles

    def _told(self, p: Params) -> dict[str, Array]:
        """The law's coefficients, by their names there."""
        given = {name: key for name, key in _RUBS.items() if getattr(self, key) is not None}
        found = {name: jnp.asarray(sizes.length(getattr(self, key), self.name, key, p)) for name, key in given.items()}
        return {"friction_static": found["friction_dynamic"], "bristle_damping": jnp.zeros(()), **found}

    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params, *bend: Number) -> Number:
        told, rate = self._told(p), jnp.asarray(rate)
        if not bend:
            return -self._law.coefficient(rate, told)
        _, stick, viscous = self._law.bond(rate * rate, told)
        return -(stick * bend[0] + viscous * rate)

    def bending(self, rate: Number, bend: Number, p: Params) -> Number:
        """z' of a law with bristles."""
        return rate - self._law.bond(jnp.square(rate), self._told(p))[0] * bend

    def reach(self, p: Params) -> Array:
        return self._law.reach(self._told(p))

    def holding(self, slip: Array, p: Params, time: float) -> tuple[Array, Array]:
        return self._law.holding(slip * slip, self._told(p), time)

    def parameters(self, turns: bool = True) -> Parameters:
        force, way = sizes.coordinate(turns)
        units = (force, force, f"{way}/s", f"{force}/{way}", f"{force} s/{way}")
        found: Parameters = {}
        for key, of in zip(_RUBS.values(), units, strict=True):
            if (size := getattr(self, key)) is not None:
                for name, (quantity, default) in sizes.stated(size, self.name, key, of).items():
                    # Bristles bend by ``sliding`` over their stiffness.
                    above = key in ("speed", "bristle_stiffness") or (key == "sliding" and self.bristles)
                    found[name] = quantity._replace(low=0.0, open_low=above), default
        return found


class Coupling(CoordinateLoad):
    """Two joints held to one ratio: a pair of gears, a rack, a screw, a belt.

    With q_1 and q_2 their coordinates, of all turns, and e = q_2 - i q_1 - e_0 the deviation, in units of q_2:

        F = -f(e) - c de/dt  on q_2,    -i F  on q_1,

    f(e) = k e; with a backlash b it is k (e - b/2) above b/2, k (e + b/2) below -b/2, and no force in between nor any that pulls.
    Power goes through it but for the damping's, and what k stores. The teeth's own force on the bearings is not in it: a
    joint's reaction has F along its coordinate alone.

    Attributes:
        joints: the bodies of the first and the second joint, slides or hinges; one of them may be driven.
        ratio: i = dq_2/dq_1: -z_1/z_2 of external gears, z_1/z_2 of internal ones, r_1/r_2 of an open belt, the pitch radius
            [m] of a rack, the lead over 2 pi [m] of a screw.
        stiffness: k at the second joint; damping: c; backlash: b; rest: e_0.
    """

    name: str = eqx.field(static=True)
    joints: tuple[str, str] = eqx.field(static=True, converter=sizes.pair)
    ratio: Size = sizes.field("coupling ratio")
    stiffness: Size = sizes.field("coupling stiffness")
    damping: Size = sizes.field("coupling damping", default=0.0)
    backlash: Size = sizes.field("coupling backlash", default=0.0)
    rest: Size = sizes.field("coupling rest", default=0.0)

    def __check_init__(self):
        if len(self.joints) != 2 or self.joints[0] == self.joints[1]:
            found = f"{list(self.joints)}"
            raise InputError(f"load {quoted(self.name)} joints", found, "give the names of two different bodies")

    @property
    def body(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The second."""
        return self.joints[1]

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.joints

    @property
    def touches(self) -> tuple[str, ...]:
        return self.joints

    def on_coordinate(self, t: Array, position: Number, rate: Number, p: Params) -> Number:
        """F at a deviation and its rate."""
        k, c, gap = sizes.values(self, ("stiffness", "damping", "backlash"), p)
        if sizes.nothing(self.backlash):
            return times(-1.0, springs.force(position, rate, k, c, None, "both"))
        above = springs.force(position - 0.5 * gap, rate, k, c, None, "pull")
        return -above - springs.force(position + 0.5 * gap, rate, k, c, None, "push")

    def _apart(self, positions: Sequence[Number], rates: Sequence[Number], p: Params) -> tuple[Number, Number, Number]:
        """i, e and its rate."""
        ratio, rest = sizes.values(self, ("ratio", "rest"), p)
        apart, gone = (minus(x[1], times(ratio, x[0])) for x in (positions, rates))
        return ratio, minus(apart, rest), gone

    def on_coordinates(self, t: Array, positions: Sequence[Number], rates: Sequence[Number], p: Params) -> list[Number]:
        ratio, apart, gone = self._apart(positions, rates, p)
        force = self.on_coordinate(t, apart, gone, p)
        return [times(-1.0, times(ratio, force)), force]

    @property
    def corners(self) -> tuple[tuple[float, Any], ...]:
        """Both ends of a backlash."""
        return () if sizes.nothing(self.backlash) else ((1.0, 0.5), (-1.0, -0.5))

    def onsets_on(self, t: Array, positions: Sequence[Number], rates: Sequence[Number], p: Params) -> list[Onset]:
        (_, apart, gone), keys = self._apart(positions, rates, p), ("stiffness", "damping", "backlash")
        (k, c, gap), more = sizes.values(self, keys, p), (jnp.abs(gone), np.inf)
        above = springs.onsets(apart - 0.5 * gap, gone, (k, c, None, "pull"), more)
        return above + springs.onsets(apart + 0.5 * gap, gone, (k, c, None, "push"), more)

    @staticmethod
    def units(turns: bool, second: bool) -> dict[str, str]:
        """Units of its numbers, of a first joint that ``turns``, or not, and of the second."""
        (_, one), (force, unit) = sizes.coordinate(turns), sizes.coordinate(second)
        return {"ratio": "1" if turns == second else f"{unit}/{one}", "stiffness": f"{force}/{unit}",
                "damping": f"{force} s/{unit}", "backlash": unit, "rest": unit}  # fmt: skip

    def parameters(self, turns: bool = True, second: bool = True) -> Parameters:
        return sizes.parameters(self, self.units(turns, second))
