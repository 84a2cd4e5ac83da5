"""The string with every joint in full motion: balls, cage, head and seat of each, coupled by torques.

Each joint is the scene ``joint`` at ``dynamic``, turning about axes that stand still. Counted from the drive, the torque

    T_i = k (b_(i-1) - a_i) + c (b_(i-1)' - a_i'),   k = G J/L,   c = tau k

turns seat i (its angle a_i) and holds head i - 1 (b_(i-1)): a segment is a spring with half of its inertia rho J L at either end.
The lowest one is rigid and has the bit on it. So a seat has, from the second on, seat_inertia + rho J L/2; a head head_inertia +
rho J L/2, the last head_inertia + rho J L + bit_inertia. Seat 1 is driven as that of a joint is, prescribed or by a flexible
drive. Friction of the wall acts on the head above each joint, the bit on the last, by the laws of ``models.string_motion``.

Prescribed are each joint's bend and axial force: those of the statics (``models.string``), the force by the weight on the bit
at the time, since it is handed down at once. Segments only twist: that a head shifts within its clearances does not move the seat
below it, and the moments by which bent joints turn the torque's axis act on nothing.

Linear algebra (``Chained``): joints meet by the speeds of seats and heads alone. What a unit torque on either does to its joint
follows from that joint's arrowhead. With the speeds eliminated a tridiagonal system of the T_i is left, so that cost is linear
in n. Joints are rows of data of one joint, so that compilation does not grow with them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax.linalg import tridiagonal_solve
from jax.typing import ArrayLike

from bcfj_jax.contact.part import of
from bcfj_jax.mechanism.model import BodyMotion, Flows, Params
from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.models.joint import energy, system
from bcfj_jax.models.joint.programmes import drive_at
from bcfj_jax.models.joint.scales import TOLD
from bcfj_jax.models.string import StringModel, loads, polar
from bcfj_jax.models.string_motion import MovingString, above, below, weight


class _Factors(NamedTuple):
    """Of n joints."""

    own: Any  # each joint's
    answer: Array  # (n, 2, states) what a unit torque on seat and on head does to a joint whose head rubs
    slope: Array  # (n,) of the torque of wall and bit by the head's speed
    # by_place, by_speed: (n,) torque above a joint by what its ends close at in places known, and in speeds.
    by_place: Array
    by_speed: Array
    bands: Array  # (3, n) below, on and above the diagonal of the system of torques


class Chained(AbstractStructure):
    """Arrowheads in a row; ``args`` is (model, prepared).

    In a step of s a joint's ends have the speeds  v + C (T_i, -T_(i+1)),  v those without torques between joints and C (2 x 2)
    the answers to unit torques on seat and head. With places eliminated (r: their right-hand side) the torques follow from

        T_i = (s k + c) (head's speed of joint i - 1, less the seat's of joint i) + s k (r_head(i-1) - r_seat(i))
    """

    string: Any = eqx.field(static=True)

    def field(self, t: Any, y: Array, args: Any) -> Array:
        return self.string.vector_field(t, y, args[1])

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> _Factors:
        """Each joint by itself, its answers, and the bands of the torques' system."""
        string, (_, held) = self.string, args
        joint, one, n, (_, at) = string.joint, string.joint.structure(), string.count, string.ends
        own = jax.vmap(lambda y, c: one.factor(t, y, (joint, c), scale))(y.reshape(n, -1), held["joints"])
        mass = held["joints"].coupling_inverse_mass[:, at - string.rates.start]
        unit = jnp.zeros((n, 2, joint.states)).at[:, np.arange(2), at].set(mass)
        answer = jax.vmap(jax.vmap(one.solve, (None, 0)))(own, unit)
        speed = string.turns(y)[1][:, 1]
        slope = jax.jvp(lambda speed: string.rubbed(t, speed, held), (speed,), (jnp.ones(n),))[1]
        # A head that rubs answers to its own friction, too.
        rub = (slope / (1.0 - slope * answer[:, 1, at[1]]))[:, None]
        answer = answer + (rub * answer[..., at[1]])[..., None] * answer[:, 1:]
        by_place = scale * held["coupling"]
        by_speed = by_place + held["coupling_damping"]
        seat, head = (jnp.moveaxis(answer[:, k][:, at], -1, 0) for k in (0, 1))
        bands = jnp.stack([-above(seat[1]), seat[0] + above(head[1]), -head[0].at[-1].set(0.0)])
        return _Factors(own, answer, slope, by_place, by_speed, (by_speed * bands).at[1].add(1.0))

    def solve(self, factors: Any, right: Array) -> Array:
        """Joints by themselves, the torques between them, and what these do."""
        (place, at), n = self.string.ends, self.string.count
        right = right.reshape(n, -1)
        found = jax.vmap(self.string.joint.structure().solve)(factors.own, right)
        found = found + (factors.slope * found[:, at[1]])[:, None] * factors.answer[:, 1]
        known, closing = (above(x[:, k[1]]) - x[:, k[0]] for x, k in ((right, place), (found, at)))
        known = factors.by_place * known + factors.by_speed * closing
        torque = tridiagonal_solve(factors.bands[0], factors.bands[1], factors.bands[2], known[:, None])
        return (found + torque * factors.answer[:, 0] - below(torque) * factors.answer[:, 1]).ravel()

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        """Of what acts on the joints: by themselves they do not depend on time."""
        string, (_, held) = self.string, args
        rate = jax.jvp(lambda t: string.pushed(t, y, held), (t,), (jnp.ones_like(t),))[1]
        return jnp.zeros((string.count, string.joint.states)).at[:, string.rates].set(rate).ravel()


class DynamicString(MovingString):
    """A string of joints in motion; made by ``string_motion.in_motion``. Its state is that of joint after joint."""

    # What StringModel has of joints is right of joints in motion.
    observe, traits, tolerance = StringModel.observe, StringModel.traits, StringModel.tolerance
    first_step, settled_when = of("joint", "first_step"), of("joint", "settled_when")

    @property
    def rates(self) -> slice:
        """The coupling's speeds in a joint's state."""
        return slice(self.joint.moving - self.joint.coupling, self.joint.moving)

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the angles of seat and head are in a joint's state, and where their speeds."""
        spots = self.joint.coordinates()
        place, rate = np.array([spots["seat_turn"], spots["head_turn"]]).T
        return place, rate

    def turns(self, y: Array) -> tuple[Array, Array]:
        """Angles and speeds (n, 2) of seats and heads."""
        states, (place, rate) = y.reshape(self.count, -1), self.ends
        return states[:, place], states[:, rate]

    def completed(self, params: Params) -> Params:
        """As they are: joints in motion have their stiffness by their contacts."""
        return params

    def joints(self, params: Params) -> Params:
        """With the segments' inertia at their ends; a seat that is prescribed has an infinite one."""
        segment = params["segment_density"] * polar(params) * params["segment_length"]
        half = jnp.full(self.count, 0.5 * segment)
        seat = params.get("seat_inertia", 0.0) + half.at[0].set(0.0 if self.flexible else jnp.inf)
        head = params["head_inertia"] + half.at[-1].add(0.5 * segment + params["bit_inertia"])
        return {**super().joints(params), "seat_inertia": seat, "head_inertia": head}

    def prepare(self, params: Params) -> Any:
        """Of all joints, without loads of their own; of segments, wall and axial force."""
        held, n = self.coupled(params, jnp.full(self.count, jnp.inf)), self.count
        for name, own in (("coupling", "drive_stiffness"), ("coupling_damping", "drive_damping")):
            held[name] = held[name].at[0].set(params[own] if self.flexible else 0.0)
        share = loads({**params, "weight_on_bit": jnp.ones(())}, n).axial
        more = loads(params, n, True).axial - loads(params, n).axial if self.bending else jnp.zeros(n)
        told: dict[str, Array] = {**self.joints(params), "load_torque": jnp.zeros(n), "axial_load": jnp.zeros(n)}
        joints, seat = jax.vmap(self.joint.prepare)(told), self.joint.slices["seat_turn"]
        mass = joints.coupling_inverse_mass.at[:, seat].set(1.0 / told["seat_inertia"][:, None])
        joints = eqx.tree_at(lambda c: c.coupling_inverse_mass, joints, mass)
        return {**held, "joints": joints, "axial_share": share, "axial_kept": more}

    def initial_state(self, params: Params) -> Array:
        """Every joint as one alone, at the drive's first speed."""
        first = self._shaft.programmes.start_speed(params)
        return StringModel.initial_state(self, {**params, "drive_speed": first})

    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        states = y.reshape(self.count, -1)
        rates = jax.vmap(lambda y, c: self.joint.structure().field(t, y, (self.joint, c)))(states, prepared["joints"])
        return rates.at[:, self.rates].add(self.pushed(t, y, prepared)).ravel()

    def pushed(self, t: Array, y: Array, prepared: Any) -> Array:
        """(n, coupling) accelerations by segments, drive, wall, bit and axial force."""
        c, over = prepared["joints"], self._shaft.programmes
        elastic, damping = self._springs(t, y, prepared)[:2]
        torque, speed = elastic + damping, self.turns(y)[1]
        axial = -self.axial(t, prepared)[:, None] * c.axes[:, 1]
        parts = {"head": axial, "cage": jnp.zeros((self.count, 3)), "cage_turn": jnp.zeros((self.count, 3))}
        parts["seat_turn"] = torque[:, None]
        parts["head_turn"] = (self.rubbed(t, speed[:, 1], prepared) - below(torque))[:, None]
        found = self.joint.coupled(parts) * c.coupling_inverse_mass
        if self.flexible or over.drive is None:
            return found
        return found.at[0, self.joint.slices["seat_turn"]].set(drive_at(over, t, prepared)[2])

    def axial(self, t: Array, prepared: Any) -> Array:
        """(n,) force on each joint [N]."""
        return prepared["axial_share"] * weight(self._shaft.programmes, t, prepared) + prepared["axial_kept"]

    def rubbed(self, t: Array, speed: Array, prepared: Any) -> Array:
        """(n,) torque of wall and bit on the heads at their speeds [N m]."""
        return sum((load.on_coordinate(t, None, speed, prepared) for load in self._rubbing), jnp.zeros(self.count))

    @property
    def _rubbing(self) -> list[Any]:
        return list(self.torsion.loads[1:])

    def structure(self) -> AbstractStructure:
        return Chained(self)

    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        over = self._shaft.programmes
        told = {**params, "load_torque": params["bit_torque"], "axial_load": params["weight_on_bit"]}
        most = {"bit_torque": over.largest_torque(told, end), "weight_on_bit": over.largest_axial(told)}
        scale = StringModel.error_scale(self, {**params, **most}).reshape(self.count, -1)
        if over.drive is not None and not self.flexible:
            # A seat that turns as it is told (``joint.scales``).
            scale = scale.at[0, np.stack(self.ends)[:, 0]].multiply(TOLD)
        return scale.ravel()

    def settled_from(self, params: Params) -> float:
        """When what rises has risen and a ball's pitch has passed."""
        return super().settled_from(params) + float(self.joint.pitch(params))

    def coordinates(self) -> dict[str, tuple[int, int]]:
        """Of the lumps, which are the heads, and of all joints."""
        own, size = self.joint.coordinates(), self.joint.states
        found = {
            f"joint[{i + 1}].{name}": (size * i + place, size * i + rate)
            for i in range(self.count)
            for name, (place, rate) in own.items()
        }
        return {f"lump[{i + 1}]": found[f"joint[{i + 1}].head_turn"] for i in range(self.count)} | found

    def _springs(self, t: Array, y: Array, prepared: Any) -> tuple[Array, Array, Array, Array]:
        """Of what turns each seat: elastic and damping torque, twist, speed of the drive."""
        place, rate = self.turns(y)
        turn, speed = self._shaft.drive(t, prepared)
        twist, closing = (above(x[:, 1]).at[0].set(x0) - x[:, 0] for x, x0 in ((place, turn), (rate, speed)))
        return prepared["coupling"] * twist, prepared["coupling_damping"] * closing, twist, jnp.asarray(speed)

    def _split(self, y: Array) -> tuple[Array, Array, list[Array]]:
        place, rate = self.turns(y)
        return place[:, 1], rate[:, 1], []

    def torque(self, t: Array, y: Array, prepared: Any) -> Array:
        """(n,) on the joints' seats [N m]; of a prescribed one what holds it."""
        found = super().torque(t, y, prepared)
        if self.flexible:
            return found
        first = jax.tree.map(lambda x: x[0], prepared["joints"])
        state = system.view(self.joint, first, y[: self.joint.states])
        return found.at[0].set(system.drive_torque(self.joint, first, t, state))

    def _twist(self, t: Array, y: Array, prepared: Any) -> Array:
        place = self.turns(y)[0]
        return super()._twist(t, y, prepared) + place[:, 0] - place[:, 1]

    def _lumps(self, t: Array, y: Array, prepared: Any) -> BodyMotion:
        """The heads, as bodies on hinges, with the accelerations that they have here."""
        angle, speed, _ = self._split(y)
        found = super()._lumps(t, jnp.concatenate([angle, speed]), prepared)
        rate = self._split(self.vector_field(t, y, prepared))[1]
        return found._replace(spin_rate=jnp.zeros((self.count, 3)).at[:, 2].set(rate))

    def flows(self, t: Array, y: Array, prepared: Any) -> Flows:
        """Of the joints (``joint.energy``), and of what is between and beside them."""
        _, rate = self.turns(y)
        c = eqx.tree_at(lambda c: c.programmes["axial_load"], prepared["joints"], self.axial(t, prepared))
        both = jax.vmap(lambda y, c: (energy.power(self.joint, c, t, y), energy.stored(self.joint, c, t, y)))
        power, stored = jax.tree.map(jnp.sum, both(y.reshape(self.count, -1), c))
        elastic, damping, twist, top = self._springs(t, y, prepared)
        closing = above(rate[:, 1]).at[0].set(top) - rate[:, 0]
        wall, bit = (-load.on_coordinate(t, None, rate[:, 1], prepared) @ rate[:, 1] for load in self._rubbing)
        _, given, rubs = self._top(t, y, prepared)
        taken = {"bit": bit, "wall": rubs * top + wall, "axial": power.axial, "friction": power.friction}
        taken |= {"damping": power.damping + damping @ closing, "edge": power.edge}
        held = {"drive": given * top} | ({"hold": power.hold} if self.joint.cage == "fixed" else {})
        return Flows(held, taken, {"kinetic": stored.kinetic, "elastic": stored.elastic + 0.5 * elastic @ twist})
