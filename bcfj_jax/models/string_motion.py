"""The string in motion: segments and joints twist, and what hangs between them turns with inertia, from drive to bit.

Lump i, counted from the drive, is segment i with the head of joint i above it; the bit is on the last. Torque T_i passes
through joint i and segment i, from lump i - 1, or the drive, to lump i:

    I_i dw_i/dt = T_i - T_(i+1) - friction of the wall - bit,   T_i = k_i (a_(i-1) - a_i) + c_i (w_(i-1) - w_i)
    1/k_i = 1/K_i + L/(G J),   c_i = tau k_i,   I_i = rho J L + I_head,   J = pi/2 (d^4 - b^4),   G = E/(2 (1 + nu))

K_i is the joint's own stiffness at the torque that passes through it in steady turning (``models.string.loads``): a chord of its
equilibria (``joint_stiffness``). A flexible drive is in series with the first. Segment and joint have their inertia
at the segment's lower end, so that the string is the spring-mass chain of textbooks; a rod of N lumps has its lowest
frequency within 1/(2 N) (Rao, Mechanical Vibrations, 2017, 8.4).

The wall takes mu b d dN_i (``models.string``) from the lump above joint i, or the drive, by Coulomb's law regularised
below ``wall_speed``. It is in proportion to the weight on the bit W, which may be over time: axial force is handed down at
once, as it is while W changes slowly against the string's lowest axial frequency, c/(4 n L) with c = 5.1 km/s. The bit takes
what drive and loads of a joint may be over time, falling with its speed where it sticks and slips, or follows a friction law.
Bodies, hinges and loads are those of every mechanism: lumps are members of one body, so that a program does not grow with them.

Contact forces are those of each joint in equilibrium under T_i at the angle of the lump above it. Left out: inertia within the
joints (their balls' frequencies are far above), ripple of their stiffness over a turn, axial and lateral motion.
Joints in full motion are those of ``models.string_dynamic``.
"""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax.linalg import tridiagonal_solve
from jax.typing import ArrayLike

from bcfj_jax.contact.friction import AbstractFriction, Coulomb
from bcfj_jax.contact.part import of
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.loads import CoordinateLoad
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import BodyMotion, Chain, Flows, ModelTraits, Params, Reading, Scenery
from bcfj_jax.mechanism.sizes import Parameters
from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.models import string_drawing
from bcfj_jax.models.joint.defaults import DEFAULTS as JOINT
from bcfj_jax.models.joint.model import JointModel
from bcfj_jax.models.joint.programmes import Programmes, axial_at, drive_at, torque_at
from bcfj_jax.models.string import StringModel, chord, handed, polar, torsional_stiffness
from bcfj_jax.xla.programs import QUICK, ask, program

MOTIONS = ("none", "torsional")
# A chord of the joint's equilibria: torques this share below and above, and instants over a ball's pitch.
_CHORD, _PHASES = 0.1, 3
# A joint's stiffness is not asked for below this share of the drive's torque, where play decides.
_LEAST = 0.01
_STIFFNESS = "joint_stiffness"
# The bristles' coefficients (``contact.friction.LuGre``) at the bit.
_BRISTLES = {"bristle_stiffness": "bit_bristle_stiffness", "bristle_damping": "bit_bristle_damping"}
LUGRE: dict[str, tuple[float, str]] = {
    "bit_bristle_stiffness": (1e3, "GUESS: breaks away after some milliradians"),
    "bit_bristle_damping": (0.1, "GUESS: a sixth of critical at the default inertia"),
}
NUMBERS: dict[str, tuple[float, str]] = {
    "segment_density": (7801.0, "paper: steel"),
    "bit_inertia": (0.1, "GUESS"),
    "twist_relaxation": (1e-5, "GUESS: 1 % of critical damping at 300 Hz"),
    "wall_speed": (5e-3, "GUESS: a hundredth of the rim's speed"),
}


class _OnLumps(CoordinateLoad):
    """A load on the lumps whose numbers are the string's; ``over``: which of the programmes it follows, and its name there."""

    over: ClassVar[tuple[str, str]]
    programmes: Programmes
    body: str = eqx.field(static=True, default="lump")

    def kinks(self, p: Params) -> list[ArrayLike] | None:
        programme = getattr(self.programmes, self.over[0])
        return [] if programme is None else programme.kinks(self.over[1], p)

    def parameters(self, turns: bool = True) -> Parameters:
        return {}


class Shaft(_OnLumps):
    """Springs and dampers between neighbouring members of one body, the first of them held by the drive."""

    over: ClassVar[tuple[str, str]] = ("drive", "seat")
    name: str = eqx.field(static=True, default="shaft")

    def torques(self, t: Array, position: Array, rate: Array, p: Params) -> tuple[Array, Array, Array, Array]:
        """(n,) elastic and damping torque of every spring, its stretch; speed of the drive."""
        turn, speed = self.drive(t, p)
        stretch = jnp.concatenate([jnp.asarray(turn)[None], position[:-1]]) - position
        closing = jnp.concatenate([jnp.asarray(speed)[None], rate[:-1]]) - rate
        return p["coupling"] * stretch, p["coupling_damping"] * closing, stretch, jnp.asarray(speed)

    def drive(self, t: Array, p: Params) -> tuple[Array, Array]:
        """Turn and speed of the drive."""
        if self.programmes.drive is None:
            return p["drive_speed"] * t, p["drive_speed"]
        return drive_at(self.programmes, t, p)[:2]

    def on_coordinate(self, t: Array, position: Any, rate: Any, p: Params) -> Array:
        """T_i - T_(i+1) on every lump."""
        elastic, damping, _, _ = self.torques(t, position, rate, p)
        torque = elastic + damping
        return torque - jnp.append(torque[1:], 0.0)


class Wall(_OnLumps):
    """Coulomb's friction on every member, in proportion to the weight on the bit at the time."""

    dry: ClassVar[bool] = True
    over: ClassVar[tuple[str, str]] = ("axial", "axial_load")
    name: str = eqx.field(static=True, default="wall")

    def on_coordinate(self, t: Array, position: Any, rate: Any, p: Params) -> Array:
        told = {"friction_dynamic": p["wall_arm"] * weight(self.programmes, t, p) + p["wall_kept"]}
        return -Coulomb().coefficient(rate, told | {"friction_speed": p["wall_speed"] / p["segment_radius"]})


def weight(over: Programmes, t: Array, p: Params) -> Array:
    """On the bit at a time [N]; never below 0, since rock does not pull."""
    return jnp.maximum(axial_at(over, t, {**p, "axial_load": p["weight_on_bit"]}), 0.0)


class Bit(_OnLumps):
    """Torque of the rock on the last member: over time, by the speed (``joint.programmes.torque_at``), or by a friction law.

    The law's normal force is the torque T of a bit that turns fast, its mu_d 1 and its mu_s ``stick_ratio``. Bristles of
    ``lugre`` (``contact.friction.LuGre``) are a state, a number of every member of which the last has a rate: z [rad],

        z' = w - |w| s0 z/g(w),   g = 1 + (stick_ratio - 1) exp(-(w/v_t)^2),   torque = T (s0 z + s1 z')
    """

    over: ClassVar[tuple[str, str]] = ("torque", "load_torque")
    name: str = eqx.field(static=True, default="bit")
    law: AbstractFriction | None = None

    def on_coordinate(self, t: Array, position: Any, rate: Any, p: Params, *bend: Any) -> Array:
        amount = torque_at(self.programmes, t, rate[-1], {**p, "load_torque": p["bit_torque"]})
        if self.law is not None and self.bristles:
            _, stick, viscous = self.law.bond(rate[-1] ** 2, self._told(p))
            amount = amount * (stick * bend[0][-1] + viscous * rate[-1])
        elif self.law is not None:
            amount = amount * self.law.coefficient(rate[-1], self._told(p))
        return jnp.zeros_like(rate).at[-1].set(-amount)

    @property
    def bristles(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.law is not None and self.law.bristles

    def _told(self, p: Params) -> dict[str, Array]:
        found = {
            "friction_dynamic": jnp.ones(()),
            "friction_static": p["stick_ratio"],
            "friction_speed": p["stick_width"],
        }
        return found | {name: p[own] for name, own in _BRISTLES.items() if own in p}

    def bending(self, rate: Any, bend: Any, p: Params) -> Array:
        """z' of the last member."""
        assert self.law is not None
        forget = self.law.bond(rate[-1] ** 2, self._told(p))[0]
        return jnp.zeros_like(rate).at[-1].set(rate[-1] - forget * bend[-1])

    def reach(self, p: Params) -> Array:
        """z of a bit that breaks away."""
        assert self.law is not None
        return self.law.reach(self._told(p))


def inertias(p: Params, count: int) -> Array:
    """(n,) of the lumps about the string's axis [kg m^2]."""
    each = p["segment_density"] * polar(p) * p["segment_length"] + p["head_inertia"]
    return jnp.full(count, each).at[-1].add(p["bit_inertia"])


def joint_stiffness(scene: StringModel, params: Params) -> Array:
    """Torsional stiffness (n,) of each joint at its own torque, bend and axial load [N m/rad], differentiable.

    Chord between a tenth less and a tenth more torque, of the head's lag behind the seat in equilibrium, the mean over a pitch.
    """
    rest, spots = scene.joint.level("quasistatic"), scene.joint.coordinates()
    head, seat = (spots[name][0] for name in ("head_turn", "seat_turn"))
    told, count = dict(scene.joints(params)), scene.count
    torque = jnp.maximum(told["load_torque"], _LEAST * params["drive_torque"])
    # A joint that turns by a pitch a second, under a load that has risen after one.
    pitch = jnp.full(count, 2.0 * jnp.pi / scene.joint.balls)
    told |= {"load_ramp": jnp.ones(count), "drive_speed": pitch}
    both = jax.tree.map(lambda x: jnp.concatenate([x, x]), told)
    both["load_torque"] = jnp.concatenate([(1.0 - _CHORD) * torque, (1.0 + _CHORD) * torque])
    near = jax.tree.map(jnp.asarray, rest.origin(_PHASES))

    def lag(p: Params) -> Array:
        states = rest.instants(p, 1.0 + jnp.arange(_PHASES) / _PHASES, near, False)[0].states
        return jnp.mean(states[:, seat] - states[:, head])

    less, more = jax.lax.map(lag, both).reshape(2, count)
    return 2.0 * _CHORD * torque / (more - less)


class _Factors(NamedTuple):
    """Bands (3, n) below, on and above the diagonal of  I/s - B - s A - C D/(1/s - E)  and of A; s; C, D and 1/s - E (n,)."""

    whole: Array
    by_angle: Array
    scale: Array
    bent: tuple[Array, Array, Array] | None = None


class Row(AbstractStructure):
    """The string's linear algebra: every lump meets its two neighbours alone.

    Of the Jacobian [0 1; A B] of angles and speeds A and B are tridiagonal: three tangents each tell all their entries
    (Curtis, Powell and Reid 1974), and cost is linear in n. Bristles of the bit (a third block, z' = D w + E z, whose force on
    the speeds is C z) are those of one member each: C, D and E are diagonal.
    """

    def field(self, t: Any, y: Array, args: Any) -> Array:
        model, prepared = args
        return model.vector_field(t, y, prepared)

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> _Factors:
        """Bands of the matrix of the speeds, angles eliminated."""
        count = args[0].count
        lump, colours = np.arange(count), np.arange(3)[:, None]
        ways = jnp.asarray(lump % 3 == colours, float)
        none, (_, along) = jnp.zeros_like(ways), jax.linearize(lambda y: self.field(t, y, args)[count:], y)
        bristly, rest = y.size > 2 * count, jnp.zeros((6, y.size - 2 * count))
        moved = jnp.block([[ways, none], [none, ways]])
        pushed = jax.vmap(along)(jnp.concatenate([moved, rest], 1))
        found = pushed[:, :count]
        # Of row i the entries i - 1, i, i + 1; those beyond the ends do not exist.
        beside = lump + colours - 1
        picked = np.where((beside >= 0) & (beside < count), 1.0, 0.0)
        by_angle, by_speed = (x[beside % 3, lump] * picked for x in jnp.split(found, 2))
        whole = (-by_speed - scale * by_angle).at[1].add(1.0 / scale)
        if not bristly:
            return _Factors(whole, by_angle, jnp.asarray(scale))
        push, own = jnp.split(along(jnp.concatenate([jnp.zeros(2 * count), jnp.ones(count)])), 2)
        bends, kept = pushed[3:, count:][lump % 3, lump], 1.0 / scale - own
        return _Factors(whole.at[1].add(-push * bends / kept), by_angle, jnp.asarray(scale), (push, bends, kept))

    def solve(self, factors: Any, right: Array) -> Array:
        """Speeds by elimination along the string (LAPACK's gtsv), then angles."""
        whole, by_angle, s, bent = factors
        push, bends, kept = bent or (0.0, 0.0, 1.0)
        angle, speed, *bend = jnp.split(right, 3 if bent else 2)
        speed = sum((push / kept * x for x in bend), speed)
        pushed = by_angle[1] * angle + by_angle[0] * above(angle) + by_angle[2] * below(angle)
        rate = tridiagonal_solve(whole[0], whole[1], whole[2], (speed + s * pushed)[:, None])[:, 0]
        return jnp.concatenate([s * (angle + rate), rate, *((x + bends * rate) / kept for x in bend)])

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        return jax.jvp(lambda t: self.field(t, y, args), (t,), (jnp.ones_like(t),))[1]


def above(x: Array) -> Array:
    """Of the neighbour above each, 0 above the first."""
    return jnp.concatenate([jnp.zeros_like(x[:1]), x[:-1]])


def below(x: Array) -> Array:
    """Of the neighbour below each, 0 below the last."""
    return jnp.concatenate([x[1:], jnp.zeros_like(x[:1])])


class MovingString(StringModel):
    """A string that twists and swings; made by ``in_motion``."""

    torsion: Mechanism = eqx.field(static=True, kw_only=True)  # its lumps, in a row
    # Parameters of drive and loads over time.
    names: tuple[tuple[str, float], ...] = eqx.field(static=True, kw_only=True)
    flexible: bool = eqx.field(static=True, default=False)  # whether the drive is

    # At first every lump turns as the drive does, untwisted.
    initial_state, vector_field, tolerance, breaks = map(
        partial(of, "torsion"), ("initial_state", "vector_field", "tolerance", "breaks")
    )  # pyright: ignore[reportAssignmentType]

    @property
    def traits(self) -> ModelTraits:
        """Friction of wall and bit is stiff; to look at the joints takes far longer than a step."""
        return ModelTraits(stiff=True, turning=True, large=True)

    @property
    def title(self) -> str:
        return f"torsional {super().title}"

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The string's at rest, and what motion needs."""
        return super().quantities | {name: CATALOGUE[name] for name in (*NUMBERS, *dict(self.names))}

    @property
    def defaults(self) -> tuple[tuple[str, float], ...]:
        """As ``quantities``; of a table its greatest value."""
        own = {name: value for name, (value, _) in NUMBERS.items()} | dict(self.names)
        return tuple((dict(super().defaults) | own).items())

    def completed(self, params: Params) -> Params:
        """With the joints' stiffness, by a program of its own where the parameters are numbers."""
        if _STIFFNESS in params:
            return params
        told = {name: params[name] for name in self.quantities if name in params}
        if any(is_traced(x) for x in told.values()):
            return {**params, _STIFFNESS: joint_stiffness(self, told)}
        rest = StringModel(self.joint, self.count, bending=self.bending)
        return {**params, _STIFFNESS: program(_STIFFNESS, joint_stiffness, (rest,), (told,), QUICK)[0](told)}

    def prepare(self, params: Params) -> dict[str, Array]:
        """Stiffness and damping of the springs, friction of the wall."""
        found = self.completed(params)
        return self.coupled(params, found[_STIFFNESS])

    def coupled(self, params: Params, own: Array) -> dict[str, Array]:
        """``prepare`` with the joints' own stiffness (n,) [N m/rad]."""
        each = 1.0 / (1.0 / own + 1.0 / torsional_stiffness(params))
        damping = params["twist_relaxation"] * each
        if self.flexible:
            each = each.at[0].set(1.0 / (1.0 / each[0] + 1.0 / params["drive_stiffness"]))
            damping = damping.at[0].set(params["drive_damping"])
        # Joint i hands down what is left below its own bend: the wall there takes its share from the lump above. What bends
        # segments does not follow the weight.
        arms = handed({**params, "weight_on_bit": jnp.ones(())}, self.count)
        kept = handed(params, self.count, True) - handed(params, self.count) if self.bending else jnp.zeros_like(arms)
        held = {"wall_arm": arms[1:], "wall_kept": kept[1:], "wall_arm_above": arms[0], "wall_kept_above": kept[0]}
        return {**params, **held, "coupling": each, "coupling_damping": damping}

    def structure(self) -> AbstractStructure:
        return Row()

    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        """Twist of a segment under the bit's torque, and the speed that this swings at."""
        k = torsional_stiffness(params)
        twist = (params["bit_torque"] + 1e-3 * params["drive_torque"]) / k
        bend = [jnp.full(self.count, self._bit.reach(params))] if self._bit.bristles else []
        return jnp.concatenate([jnp.full(self.count, twist), twist * jnp.sqrt(k / inertias(params, self.count)), *bend])

    def first_step(self, params: Params, scales: Array) -> Array:
        """A hundredth of the time in which a twist is gone at its speed."""
        return 1e-2 * scales[0] / scales[self.count]

    def coordinates(self) -> dict[str, tuple[int, int]]:
        return {f"lump[{i + 1}]": (i, self.count + i) for i in range(self.count)}

    @property
    def body_names(self) -> tuple[str, ...]:
        """Lumps; joints, whose ``torque`` is what passes through them; the drive as ``top``."""
        return ("lump", "joint", "top")

    @property
    def _shaft(self) -> Shaft:
        found: Any = self.torsion.loads[0]
        return found

    @property
    def _bit(self) -> Bit:
        found: Any = self.torsion.loads[2]
        return found

    def _springs(self, t: Array, y: Array, prepared: Any) -> tuple[Array, Array, Array, Array]:
        angle, speed, _ = self._split(y)
        return self._shaft.torques(t, angle, speed, prepared)

    def _split(self, y: Array) -> tuple[Array, Array, list[Array]]:
        """Angles and speeds of the lumps, bristles of the bit."""
        angle, speed, *bend = y.reshape(-1, self.count)
        return angle, speed, bend

    def torque(self, t: Array, y: Array, prepared: Any) -> Array:
        """(n,) what passes through each joint [N m]."""
        elastic, damping, _, _ = self._springs(t, y, prepared)
        return elastic + damping

    def _top(self, t: Array, y: Array, prepared: Any) -> tuple[Array, Array, Array]:
        """Speed of the drive [rad/s], its torque, and what of it the wall takes from the upper connection [N m]."""
        speed, wall = self._springs(t, y, prepared)[3], self.torsion.loads[1]
        told = {**prepared, "wall_arm": prepared["wall_arm_above"], "wall_kept": prepared["wall_kept_above"]}
        rubs = -wall.on_coordinate(t, 0.0, speed, told)  # pyright: ignore[reportAttributeAccessIssue]
        return speed, self.torque(t, y, prepared)[0] + rubs, rubs

    def motions(self, t: Array, y: Array, prepared: Any) -> dict[str, BodyMotion]:
        """Of the lumps; of joints torque and twist, with the segment's; of the drive torque and speed."""
        still = jnp.zeros((self.count, 3))
        joint = BodyMotion(still, still, still, angle=self._twist(t, y, prepared), drive=self.torque(t, y, prepared))
        speed, torque, _ = self._top(t, y, prepared)
        top = BodyMotion(still[0], still[0], still[0], drive=torque, joint={"speed": speed})
        return {"lump": self._lumps(t, y, prepared), "joint": joint, "top": top}

    def _twist(self, t: Array, y: Array, prepared: Any) -> Array:
        """(n,) from lump to lump [rad]."""
        return self._springs(t, y, prepared)[2]

    def _lumps(self, t: Array, y: Array, prepared: Any) -> BodyMotion:
        return self.torsion.motions(t, y, prepared)["lump"]

    def flows(self, t: Array, y: Array, prepared: Any) -> Flows:
        """Power of the drive; what bit, wall and twisting take; kinetic and elastic energy."""
        angle, speed, bend = self._split(y)
        elastic, damping, stretch, top = self._shaft.torques(t, angle, speed, prepared)
        closing = jnp.concatenate([top[None], speed[:-1]]) - speed
        bit = self._bit.on_coordinate(t, angle, speed, prepared, *bend)
        wall = self.torsion.loads[1].on_coordinate(t, angle, speed, prepared)  # pyright: ignore[reportAttributeAccessIssue]
        _, given, rubs = self._top(t, y, prepared)
        taken = {"bit": -bit @ speed, "wall": rubs * top - wall @ speed, "damping": damping @ closing}
        kinetic = 0.5 * inertias(prepared, self.count) @ speed**2
        return Flows({"drive": given * top}, taken, {"kinetic": kinetic, "elastic": 0.5 * elastic @ stretch})

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """Each joint's contacts under the torque that passes through it, at the angle of the lump above it."""
        torque, (angle, speed, _) = self.torque(t, y, prepared), self._split(y)
        stretch, top = self._shaft.torques(t, angle, speed, prepared)[2:]
        # A joint that turns by this in the first second, under a load that has risen by then. Never 0: rates go by it.
        turn = jnp.mod(angle + stretch, 2.0 * jnp.pi) + 2.0 * jnp.pi
        above = jnp.concatenate([top[None], speed[:-1]])
        own = {name: prepared[name] for name in self.quantities if name in prepared}
        told = dict(self.joints(own | {"weight_on_bit": weight(self._shaft.programmes, t, prepared)}))
        told |= {"load_torque": torque, "drive_speed": turn, "load_ramp": jnp.ones(self.count)}

        near = jax.tree.map(jnp.asarray, self.joint.origin(1)) or None

        def one(given: tuple[Params, Array]) -> dict[str, Reading]:
            p, share = given
            state = self.joint.instants(p, jnp.ones(1), near)[0].states[0]
            found = self.joint.observe(jnp.ones(()), state, self.joint.prepare(p))
            slip = lambda x: None if x.slip is None else x.slip * jnp.abs(share)  # noqa: E731
            return {name: x._replace(rate=x.rate * share, slip=slip(x)) for name, x in found.items()}

        return self.side_by_side(jax.lax.map(one, (told, above / turn)))

    def greatest(self, params: Params) -> tuple[float, float]:
        """Of a fluctuation at its top, of a bit that sticks where it breaks away."""
        over, law = self._shaft.programmes, self._bit.law
        told = {**params, "load_torque": params["bit_torque"], "axial_load": params["weight_on_bit"]}
        sticks = params["stick_ratio"] if law and "friction_static" in law.needs else 1.0
        torque = over.largest_torque(told, params["load_ramp"]) * sticks
        return float(torque), float(over.largest_axial(told))

    def settled_from(self, params: Params) -> float:
        """When what rises has risen."""
        shaft = self._shaft.programmes
        return shaft.risen({**params, "load_torque": params["bit_torque"]})

    def scenery(self, t: Array, y: Array, params: Params) -> Scenery:
        """Segments at the lumps' angles, the upper connection at the drive's."""
        top = self._shaft.drive(t, params)[0]
        turns = jnp.concatenate([jnp.asarray(top)[None], self._split(y)[0]])
        return string_drawing.scenery(params, chord(params), turns)

    def chain(self, params: Params) -> Chain:
        """Of steady turning, and called so."""
        found = super().chain(params)
        return found._replace(loads={f"{name} in steady turning": x for name, x in found.loads.items()})

    def whole(self, params: Params, run: Any) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
        """``string``: the statics of steady turning; by joint least and greatest torque; the bit's speed."""
        entry, tables = super().whole(params, run)
        states = np.asarray(run.trajectory)
        bit = states[:, self.coordinates()[f"lump[{self.count}]"][1]]
        torque = np.asarray(
            ask("torques", _torques, (self,), (dict(self.completed(params)), np.asarray(run.times), states))
        )
        most = int(np.argmax(np.nanmax(np.abs(torque), 0))) + 1
        found = {
            "torque_least": np.nanmin(torque, 0).tolist(), "torque_greatest": np.nanmax(torque, 0).tolist(),
            "bit_speed": [float(np.nanmin(bit)), float(np.nanmax(bit))],
            "most_loaded": most, "why": f"the greatest torque passes through joint {most}",
        }  # fmt: skip
        return {"string": entry["string"] | found}, tables


def _torques(scene: MovingString, params: Params, times: Array, states: Array) -> Array:
    """(T, n) through each joint."""
    prepared = scene.prepare(params)
    return jax.vmap(lambda t, y: scene.torque(t, y, prepared))(times, states)


def in_motion(
    scene: StringModel, moving: JointModel, law: AbstractFriction | None, made: type[MovingString]
) -> MovingString:
    """A string that moves under drive and loads of a joint in motion, and a friction law of the bit; of the class ``made``."""
    count, over = scene.count, moving.programmes
    lumps = Body(
        "lump", "hinge", members=count, mass=lambda p: p["head_mass"], inertia=lambda p: inertias(p, count),
        start={"speed": lambda p: jnp.full(count, over.start_speed(p))},
    )  # fmt: skip
    acting: Any = [Shaft(programmes=over), Wall(programmes=over), Bit(programmes=over, law=law)]  # pyright: ignore[reportCallIssue]
    torsion = Mechanism("torsion", [lumps], [], acting, end=1.0, implicit=True)
    known, flexible = dict(moving.defaults), moving.drive == "flexible"
    names = {name: known[name] for name in over.names if name != "load_ramp"}
    names |= {name: known[name] for name in ("drive_stiffness", "drive_damping") if flexible}
    names |= {"seat_inertia": JOINT["seat_inertia"][0]} if scene.joint.in_motion and (flexible or count > 1) else {}
    names |= {name: JOINT[name][0] for name in (("stick_ratio", "stick_width") if law else ())}
    names |= {name: value for name, (value, _) in LUGRE.items() if law and law.bristles}
    tables = {"bit_torque": "load_torque", "drive_speed": "drive_speed", "weight_on_bit": "axial_load"}
    names |= {own: value for own, theirs in tables.items() for name, value in over.greatest if name == theirs}
    own: Any = {"torsion": torsion, "names": tuple(names.items()), "flexible": flexible}
    return made(scene.joint, count, bending=scene.bending, samples=scene.samples, **own)
