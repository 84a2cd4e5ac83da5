"""``string``: upper connection, n ball-cage joints and lower connection in a curved hole, in quasi-static coupling.

The string is solved from bit to drive in closed form; then every joint is the scene ``joint`` without inertia under its own
torque and axial load. Joints exchange no dynamics: what one does over a turn does not reach the next (but in
``models.string_dynamic``).

Geometry (physics sheet 5.5). Segments are chords of a circle of radius R, the hole's axis, so that joints bend by
beta = 2 asin(L/2R) each. A straight cylinder of radius d and length L passes where L <= 4 sqrt(C (R + d)), C its clearance.
A longer one passes where segments bend (``models.string_bending``), and rubs on the wall by 2 P more; its joints bend by less.

Soft string. Below the lowest joint the axial force is W and the torque T. In the angle theta from there the hole bears
dN = F dtheta, of which friction mu takes the share a along the string and b = sqrt(1 - a^2) around it,
a = v/sqrt(v^2 + (w d)^2) of a string that is fed at v and turns at w:

    F = W exp(mu a theta),    N = (F - W)/(mu a),    torque = T + mu b d N

Joint i, counted from the drive, has n - i joints below it: theta = (n - i) beta. The drive stands above all, theta = n beta.
Left out: weight, what twist of segments changes in the loads, the moments 2 T tan(beta/2) by which the bends turn the torque
(told as ``side``), buckling into helices; friction's shares are those of a string that slides everywhere.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.part import of
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.shapes import Drawing
from bcfj_jax.core.status import OK
from bcfj_jax.mechanism.model import (
    AbstractModel,
    Chain,
    Life,
    Params,
    Reading,
    Scenery,
    Solution,
)
from bcfj_jax.models import string_drawing
from bcfj_jax.models.joint.model import JointModel
from bcfj_jax.models.joint.scene import OF_A_BALL
from bcfj_jax.models.steel_ball import loaded_turn
from bcfj_jax.models.string_bending import BENDING, Bent, bent, check_length, rigidity, swayed

WHERE = "scene 'string'"
# What a joint is told by the string, and not by the user.
_TOLD = ("joint_angle", "load_torque", "axial_load")
LEVELS = ("kinematic", "quasistatic", "dynamic")
POISSON = 0.29  # Of steel (paper).
DEFAULTS: dict[str, tuple[float, str]] = {
    "hole_radius": (1.0, "paper: 1 m; usual 1 to 4 m"),
    "segment_length": (0.3987, "derived: chord of joints bent by 23 degrees (paper) at 1 m"),
    "segment_radius": (0.05, "GUESS: fits a hole of 120 mm"),
    "segment_bore": (0.02, "GUESS"),
    "hole_clearance": (0.01, "GUESS: segments of 0.41 m pass"),
    "bend_limit": (math.radians(35.0), "GUESS: half of the paper's swing of 70 degrees"),
    "bit_torque": (1800.0, "paper: resisting torque 1.8 kN m"),
    "weight_on_bit": (20e3, "GUESS"),
    "drive_torque": (6000.0, "GUESS"),
    "wall_friction": (0.25, "GUESS: 0.2 to 0.3 in water-based mud"),
    "feed_speed": (1e-3, "GUESS: 3.6 m an hour"),
    "segment_modulus": (207e9, "paper: steel"),
}


class Loads(NamedTuple):
    """What the string bears, by joint from the drive to the bit, (n,), and at the drive."""

    bend: Array  # of every joint [rad]; torque [N m] and axial force [N]: what each joint hands down
    torque: Array
    axial: Array
    wall: Array  # force of the hole on the string over the joint's bend [N]
    side: Array  # 2 T tan(beta/2)/L, shear between segments [N]
    # drive_torque, hook_load: torque of the drive [N m], force that feeds the string [N].
    drive_torque: Array
    hook_load: Array
    # around, along: friction of the wall by joint, with that of the segment below it, torque [N m] and force [N].
    around: Array
    along: Array
    pushed: Array  # force of the wall on the middle of the segment below the joint, which bends it [N]


def chord(params: Params) -> Array:
    """Angle between neighbouring segments' chords [rad]: by how much a joint of rigid segments bends."""
    return 2.0 * jnp.arcsin(0.5 * params["segment_length"] / params["hole_radius"])


@partial(jax.jit, static_argnums=(1, 2))
def loads(params: Params, count: int, bending: bool = False) -> Loads:
    """The string's statics (module docstring), differentiable in every parameter.

    Segments that bend are as stiff as the axial force of a string of rigid ones leaves them.
    """
    p, bend = params, chord(params)
    rim = p["drive_speed"] * p["segment_radius"]
    # A string that neither turns nor is fed is taken as turning.
    fast = jnp.sqrt(p["feed_speed"] ** 2 + rim**2 + 1e-30)
    along, around = p["wall_friction"] * p["feed_speed"] / fast, p["wall_friction"] * jnp.abs(rim) / fast
    grown = jnp.exp(along * bend * jnp.arange(count, -1, -1))
    axial = p["weight_on_bit"] * grown
    held = bent(p, axial[1:]) if bending else Bent(*[jnp.zeros(count)] * 4)
    # Of a segment that is bent 2 P, above which the axial force grows as all does.
    rubs = 2.0 * held.push
    added = jnp.cumsum((rubs / grown[1:])[::-1])[::-1]
    axial = axial + along * grown * jnp.append(added[0], added)
    small = along * bend < 1e-8
    share = jnp.where(small, 1.0 + 0.5 * along * bend, jnp.expm1(along * bend) / jnp.where(small, 1.0, along * bend))
    wall = axial[1:] * bend * share
    below = jnp.cumsum((wall + rubs)[::-1])[::-1]
    arm = around * p["segment_radius"]
    torque = p["bit_torque"] + arm * jnp.append(below[0], below - wall)
    side = 2.0 * torque[1:] * jnp.tan(0.5 * bend) / p["segment_length"]
    slopes = held.slope + jnp.append(0.0, held.slope[:-1])
    return Loads(
        bend - slopes, torque[1:], axial[1:], wall, side, torque[0], axial[0],
        arm * (wall + rubs), along * (wall + rubs), held.push,
    )  # fmt: skip


def handed(params: Params, count: int, bending: bool = False) -> Array:
    """(n + 1,) torque that the wall takes from the upper connection and from each segment below a joint [N m]."""
    found = loads(params, count, bending)
    torque = jnp.concatenate([found.drive_torque[None], found.torque, params["bit_torque"][None]])
    return torque[:-1] - torque[1:]


class Segments(NamedTuple):
    """How the segments below the joints give and what they are stressed by, (n,) from the drive to the bit."""

    twist: Array  # T L/(G J) [rad]
    stretch: Array  # -F L/(E A) [m], shortening
    moment: Array  # T tan(beta/2) [N m], by which either end holds the segment across its axis
    shear: Array  # T d/J [Pa]
    # F/A [Pa], bending: M d/I [Pa], all at the outer fibre; M the greater of that moment and of the wall's in the
    # middle.
    axial: Array
    bending: Array
    stress: Array  # sqrt((axial + bending)^2 + 3 shear^2) [Pa], von Mises
    # How far the hole bends the middle [m]; slope [rad] and sway [m]: of the ends, and at the quarters, by that moment.
    bow: Array
    slope: Array
    sway: Array


def segments(params: Params, count: int, bending: bool = False) -> Segments:
    """Segments under the loads of steady turning (Timoshenko, Strength of Materials 1, 1955), differentiable.

    A constant-velocity joint bent by beta turns the torque's axis by beta: it holds each of its shafts by T tan(beta/2) across
    its axis (Seherr-Thoss et al., Universal Joints and Driveshafts, 2006). Where a segment is an S by its ends' moments and bent
    in the other plane by the hole, the greatest moment of both is at an end or in the middle, for F up to Euler's.
    """
    p, found = params, loads(params, count, bending)
    area = jnp.pi * (p["segment_radius"] ** 2 - p["segment_bore"] ** 2)
    moment = found.torque * jnp.tan(0.5 * found.bend)
    shear = found.torque * p["segment_radius"] / polar(p)
    hole = bent(p, found.axial) if bending else Bent(*[jnp.zeros(count)] * 4)
    axial, outer = found.axial / area, jnp.maximum(moment, hole.moment) * p["segment_radius"] / (0.5 * polar(p))
    return Segments(
        found.torque / torsional_stiffness(p), -found.axial * p["segment_length"] / (p["segment_modulus"] * area),
        moment, shear, axial, outer, jnp.sqrt((axial + outer) ** 2 + 3.0 * shear**2),
        hole.bow, *swayed(p, found.axial, moment),
    )  # fmt: skip


def polar(p: Params) -> Array:
    """Polar second moment of a segment's section, pi/2 (d^4 - b^4) [m^4]."""
    return 0.5 * jnp.pi * (p["segment_radius"] ** 4 - p["segment_bore"] ** 4)


def torsional_stiffness(p: Params) -> Array:
    """G J/L of a segment [N m/rad], G = E/(2 (1 + nu))."""
    return p["segment_modulus"] / (2.0 * (1.0 + POISSON)) * polar(p) / p["segment_length"]


class StringModel(AbstractModel):
    """n joints in a hole as a model; made by ``string``.

    Every contact of the joint is one of the string, with the members of joint 1 (at the drive) first.
    """

    joint: JointModel = eqx.field(static=True)
    count: int = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="string")
    bending: bool = eqx.field(static=True, default=False)
    settled_when: ClassVar[str] = "the load has risen"
    samples: int = eqx.field(static=True, default=301)
    life: Life = eqx.field(static=True, default=())  # pyright: ignore[reportIncompatibleMethodOverride]

    contacts, traits, tolerance, bodies_at = map(partial(of, "joint"), ("contacts", "traits", "tolerance", "bodies_at"))  # pyright: ignore[reportAssignmentType]
    # Options whose default depends on others: a template of a scene file shows what they are.
    spin, window_ends, bands = map(partial(of, "joint"), ("spin", "window_ends", "bands"))

    @property
    def title(self) -> str:
        return f"string of {self.count} joint{'s' if self.count > 1 else ''}, {self.joint.fidelity}"

    @property
    def members(self) -> dict[str, int]:
        """Of the balls of all joints; of pilots the joints, where there are several."""
        one = self.count if self.count > 1 else 0
        return {c.name: self.count * self.joint.balls if c.name in OF_A_BALL else one for c in self.contacts}

    @property
    def body_members(self) -> dict[str, int]:
        """Segments below the joints, and joints: as they are drawn."""
        return {"lump": self.count, "joint": self.count}

    @property
    def _own(self) -> dict[str, tuple[float, str]]:
        return DEFAULTS | (BENDING if self.bending else {})

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The string's, then the joint's without what the string tells each."""
        own = {name: CATALOGUE[name] for name in self._own}
        return own | {name: x for name, x in self.joint.quantities.items() if name not in _TOLD}

    @property
    def defaults(self) -> tuple[tuple[str, float], ...]:
        own = tuple((name, value) for name, (value, _) in self._own.items())
        return own + tuple((name, value) for name, value in self.joint.defaults if name not in _TOLD)

    def horizon(self, params: Params) -> Array:
        return loaded_turn(params)

    def joints(self, params: Params) -> Params:
        """Parameters of the joints, each (n,)."""
        found = loads(params, self.count, self.bending)
        told = {"joint_angle": found.bend, "load_torque": found.torque, "axial_load": found.axial}
        shared = {name: value for name, value in params.items() if name not in self._own}
        return told | {name: jnp.broadcast_to(value, (self.count,)) for name, value in shared.items()}

    def prepare(self, params: Params) -> Any:
        return {"joints": jax.vmap(self.joint.prepare)(self.joints(params))}

    def initial_state(self, params: Params) -> Array:
        return jax.vmap(self.joint.initial_state)(self.joints(params)).reshape(-1)

    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        return jnp.zeros_like(y)

    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        return jax.vmap(lambda p: self.joint.error_scale(p, end))(self.joints(params)).reshape(-1)

    def instants(self, params: Params, times: Array, near: Any = None, rates: bool = True) -> tuple[Solution, Any]:
        """Joint after joint by one program: compilation does not grow with their number."""

        def one(p: Params) -> Solution:
            return self.joint.instants(p, times, None, rates)[0]

        found = jax.lax.map(one, self.joints(params))
        states = jnp.moveaxis(found.states, 0, 1).reshape(times.shape[0], -1)
        worst = jnp.argmax(found.code != OK)
        status, end = found.code[worst], jnp.min(found.end)
        return Solution(states, status, end, jnp.sum(found.accepted), jnp.sum(found.rejected)), near

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        return self.side_by_side(
            jax.vmap(lambda y, c: self.joint.observe(t, y, c))(y.reshape(self.count, -1), prepared["joints"])
        )

    def side_by_side(self, found: dict[str, Reading]) -> dict[str, Reading]:
        """Readings of joints (n, ...) with the members of all one after the other; of one joint its own."""
        if self.count == 1:
            return jax.tree.map(lambda x: x[0], found)
        of_a_ball = lambda name, x: x.reshape(-1, *x.shape[2:]) if name in OF_A_BALL else x  # noqa: E731
        return {name: jax.tree.map(lambda x, name=name: of_a_ball(name, x), reading) for name, reading in found.items()}

    def unit_pressure(self, params: Params, contact: str, material: Any) -> Array | None:
        return self.joint.unit_pressure({name: x[0] for name, x in self.joints(params).items()}, contact, material)

    def settled_from(self, params: Params) -> float:
        """When the load has risen."""
        return float(params["load_ramp"])

    def check(self, params: Params, where: str = "") -> None:
        """Refuse a string that does not pass, bend or turn, with the number that would do; then joints as joints are."""
        where = where or WHERE
        if any(is_traced(x) or np.ndim(x) for x in params.values()):
            return
        numbers = {name: float(params[name]) for name in (*self._own, "drive_speed")}
        _check(numbers, where)
        check_length(numbers, self.bending, where)
        self._check_drive(params, where)
        self.joint.check({name: np.asarray(value)[0] for name, value in self.joints(params).items()}, where)

    def greatest(self, params: Params) -> tuple[float, float]:
        """Torque of the bit [N m] and weight on it [N]."""
        return float(params["bit_torque"]), float(params["weight_on_bit"])

    def _check_drive(self, params: Params, where: str) -> None:
        given, has = float(params["bit_torque"]), float(params["drive_torque"])
        top, weight = self.greatest(params)
        greatest = {**params, "bit_torque": jnp.asarray(top), "weight_on_bit": jnp.asarray(weight)}
        told = loads(greatest, self.count, self.bending)
        needed, pushed = float(told.drive_torque), float(told.hook_load)
        if needed > has:
            grows = self.greatest({**params, "bit_torque": jnp.asarray(given + 1.0)})[0] - top
            found = f"{given:g} N m at the bit{f', {top:g} N m at its greatest,' if top != given else ''} takes "
            found += f"{needed:.5g} N m at the drive, which has {has:g} N m"
            most = (
                given - (needed - has) / grows if grows > 0.0 else 0.0
            )  # A torque so large that one more is rounding.
            # What the wall takes may be more than the drive has; of it what follows the weight, and what bends segments.
            idle = loads({**greatest, "weight_on_bit": jnp.zeros(())}, self.count, self.bending).drive_torque
            lighter = weight * (has - float(idle)) / (needed - float(idle)) if needed > float(idle) else 0.0
            less = f"at most {most:.5g} N m, or " if most > 0.0 else ""
            if most <= 0.0 and lighter > 0.0:
                less = f"{_lighter(params, weight, lighter, 'a weight_on_bit of ')}, or "
            remedy = f"give {less}a drive_torque of {needed:.5g} N m"
            raise InputError(f"{where} bit_torque", found, remedy)
        bears = float(buckling_force(params))
        if pushed > bears:
            found = f"{weight:g} N: the highest segment bears {pushed:.4g} N and buckles at {bears:.4g} N"
            raise InputError(
                f"{where} weight_on_bit", found, f"give {_lighter(params, weight, weight * bears / pushed)}"
            )

    def chain(self, params: Params) -> Chain:
        """The hole's axis from the drive (0, 0) downwards, a joint at each corner, and what each hands down."""
        found, radius = loads(params, self.count, self.bending), float(params["hole_radius"])
        bend = float(chord(params))
        turn = bend * (0.5 + np.arange(-1, self.count + 1))
        corners = radius * np.stack([1.0 - np.cos(turn), -np.sin(turn)], -1)
        named = {
            "torque": ("N m", found.torque),
            "axial force": ("N", found.axial),
            "force of the wall": ("N", found.wall),
        }
        if self.bending:
            named["push on the middle"] = ("N", found.pushed)
        pushed = np.asarray(found.wall)[:, None] * np.stack([np.cos(turn[1:-1]), np.sin(turn[1:-1])], -1)
        each = {name: (unit, np.asarray(value)) for name, (unit, value) in named.items()}
        round_ = np.linspace(turn[0], turn[-1], 40 * self.count)
        aside = radius + np.array([[-1.0], [1.0]]) * float(params["segment_radius"] + params["hole_clearance"])
        walls = np.stack([radius - aside * np.cos(round_), -aside * np.sin(round_)], -1)
        return Chain("joint", corners - corners[0], pushed, "force of the wall", each, walls - corners[0])

    def drawing(self, params: Params, size: float = 1.0, travel: Any = None) -> Drawing:
        """The string has sizes of its own."""
        return string_drawing.drawing(params, self.count)

    def scenery(self, t: Array, y: Array, params: Params) -> Scenery:
        """Every segment turns as the drive does."""
        turns = jnp.full(self.count + 1, params["drive_speed"] * t)
        return string_drawing.scenery(params, chord(params), turns)

    def whole(self, params: Params, run: Any) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
        """``string``: by joint what it hands down and its greatest contact forces, and which is loaded most."""
        found = loads(params, self.count, self.bending)
        peaks = {}
        for contact in self.contacts:
            force = np.abs(np.asarray(run.force[contact.name])[..., 0]).reshape(len(run.times), self.count, -1)
            peaks[contact.name] = np.nanmax(force, axis=(0, 2)).tolist()
        most = int(np.argmax(np.asarray(found.torque))) + 1
        entry: dict[str, Any] = {name: np.asarray(value).tolist() for name, value in found._asdict().items()}
        entry["segments"] = {
            k: np.asarray(x).tolist() for k, x in segments(params, self.count, self.bending)._asdict().items()
        }
        why = f"joint {most} hands down the torque of the bit and of all wall friction below it"
        return {"string": entry | {"peaks": peaks, "most_loaded": most, "why": why}}, {}


def _lighter(params: Params, weight: float, most: float, what: str = "") -> str:
    """What to give of a weight on the bit that may be ``most`` at its greatest [N], and is ``weight``: it may swing."""
    swing = weight - float(params["weight_on_bit"])
    if most > swing:
        return f"{what}at most {most - swing:.4g} N"
    return f"less weight_on_bit and axial_amplitude, {most:.4g} N together"


def _check(v: dict[str, float], where: str) -> None:
    half, radius, length = 0.5 * v["segment_length"], v["hole_radius"], v["segment_length"]
    least = half / math.sin(0.5 * v["bend_limit"])
    if radius < least:
        found = f"{radius:g} m: segments of {length:g} m ask joints to bend by more than {math.degrees(v['bend_limit']):.3g} deg"
        remedy = f"give at least {least:.4g} m, or a segment_length of at most {2.0 * radius * half / least:.4g} m"
        raise InputError(f"{where} hole_radius", found, remedy)
    if v["segment_bore"] >= v["segment_radius"]:
        found = f"{v['segment_bore']:g} m"
        raise InputError(f"{where} segment_bore", found, f"give less than segment_radius, {v['segment_radius']:g} m")


def buckling_force(params: Any) -> Any:
    """Euler's force of a segment between two joints, pi^2 E I/L^2 [N], I = pi/4 (d^4 - b^4)."""
    return math.pi**2 * rigidity(params) / params["segment_length"] ** 2
