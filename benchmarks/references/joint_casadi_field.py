"""The joint a second time, written in CasADi from the formulas.

Shares nothing with ``bcfj_jax`` but the names of parameters, the start and the layout of the state. The geometry is
written in the frames of the tracks, where ``bcfj_jax.models.joint.contacts`` uses world axes; friction as vectors, where
that has components.
Parameters are numbers or CasADi symbols; smoothing, joint angle, pitch radius and offset are numbers.
Default options only: gothic track, free cage and head, prescribed drive, memory-free power law, Brown-McPhee
friction, smoothed onset, balls without spin.
"""

# CasADi has no types, and is not installed where types are checked.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from bcfj_jax.models.joint.scene import Joint

TRACKS = ("seat_ball", "head_ball")
# Numbers or symbols.
Parameters = Mapping[str, Any]


class Unsupported(ValueError):
    """A scene with other options than those written here."""


def require_defaults(scene: Joint) -> None:
    """Raise ``Unsupported`` for a scene that this field does not describe."""
    wanted = {
        "track": "gothic",
        "cage": "free",
        "head": "free",
        "drive": "prescribed",
        "spin": False,
        "smoothing": True,
    }
    for name, value in wanted.items():
        if getattr(scene, name) != value:
            raise Unsupported(f"{name} = {getattr(scene, name)!r}: only {value!r} is written in CasADi")
    for contact in scene.contacts:
        made = (
            type(contact.law).__name__,
            type(getattr(contact.law, "elastic", None)).__name__,
            type(contact.friction).__name__,
        )
        if made != ("MemoryFree", "Power", "BrownMcPhee"):
            raise Unsupported(f"{contact.name}: {made}")
    if len(scene.contacts) != 5:
        raise Unsupported("all five contacts")


# The laws, from their definitions.


def _step(x: ca.SX, coefficients: Sequence[float]) -> ca.SX:
    """Polynomial of a fraction clipped to [0, 1]; coefficients from the constant up."""
    s = ca.fmin(ca.fmax(x, 0.0), 1.0)
    total: Any = 0.0
    for coefficient in reversed(coefficients):
        total = total * s + coefficient
    return total


def _mobility(slip_squared: ca.SX, p: Parameters) -> ca.SX:
    """Brown and McPhee: [mu_d tanh(4 r)/r + (mu_s - mu_d)/(r^2/4 + 3/4)^2]/v_t, r = v/v_t."""
    square = slip_squared / p["friction_speed"] ** 2
    # At r^2 = 1e-9 tanh(4 r)/r = 4 - 64/3 r^2 is exact to 1e-16.
    r = ca.sqrt(ca.fmax(square, 1e-9))
    ratio = ca.if_else(square > 1e-9, ca.tanh(4.0 * r) / r, 4.0 - 64.0 / 3.0 * square)
    static, dynamic = p["friction_static"], p["friction_dynamic"]
    return (dynamic * ratio + (static - dynamic) / (0.25 * square + 0.75) ** 2) / p["friction_speed"]


def _elastic(ramp: ca.SX, p: Parameters) -> ca.SX:
    """K r^n, of finite derivatives where r = 0."""
    n = p["exponent"]
    if isinstance(n, ca.SX):
        # 1e-60 m bears nothing, and its logarithm is finite.
        return p["stiffness"] * ca.exp(n * ca.log(ca.fmax(ramp, 1e-60)))
    # sqrt' at 0 is infinite, and 0 times it not a number: no contact, no expression.
    return ca.if_else(ramp > 0.0, p["stiffness"] * (ramp * ca.sqrt(ramp) if n == 1.5 else ramp**n), 0.0)


def _normal(penetration: ca.SX, rate: ca.SX, p: Parameters) -> ca.SX:
    """r'(d) K r(d)^n max(0, 1 + a d'), with the onset r(d) of half-width w."""
    w = p["smoothing"]
    ramp, slope = ca.fmax(penetration, 0.0), 1.0
    if w > 0.0:
        x = (penetration + w) / (2.0 * w)
        ramp = ca.if_else(penetration < w, 2.0 * w * _step(x, (0, 0, 0, 0, 2.5, -3.0, 1.0)), penetration)
        slope = _step(x, (0, 0, 0, 10.0, -15.0, 6.0))
    return slope * _elastic(ramp, p) * ca.fmax(1.0 + p["damping"] * rate, 0.0)


def _turned(angle: ca.SX) -> ca.SX:
    """Rotation about z."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def _own(p: Parameters, contact: str) -> dict[str, Any]:
    names = ("stiffness", "exponent", "damping", "smoothing", "friction_static", "friction_dynamic", "friction_speed")
    return {name: p.get(f"{contact}.{name}", p[name]) for name in names}


class Expressions(NamedTuple):
    """The field and its derivative in symbols; the loads are those of the grooves, over (balls, race, flank)."""

    t: ca.SX
    y: ca.SX
    rate: ca.SX
    jacobian: ca.SX
    loads: ca.SX


class Contacts:
    """Forces as functions of few local inputs: names for both, and the derivative of the one by the other.

    CasADi colours the columns of a Jacobian, and the arrowhead's dense rows leave it no two columns to share: the
    assembled field differentiated whole takes 51 000 operations. By links, inputs (state) -> forces (inputs) -> rates
    (state, forces), it takes 36 000.
    """

    def __init__(self):
        self.inputs: list[ca.SX] = []
        self.input_values: list[ca.SX] = []
        self.forces: list[ca.SX] = []
        self.force_values: list[ca.SX] = []
        self.blocks: list[ca.SX] = []

    def named(self, value: ca.SX) -> ca.SX:
        """Symbols that stand for local inputs."""
        symbol = ca.SX.sym(f"w{len(self.inputs)}", value.numel())
        self.inputs.append(symbol)
        self.input_values.append(value)
        return symbol

    def force(self, value: ca.SX) -> ca.SX:
        """Symbols that stand for forces, functions of the latest inputs."""
        symbol = ca.SX.sym(f"f{len(self.forces)}", value.numel())
        self.forces.append(symbol)
        self.force_values.append(value)
        self.blocks.append(ca.jacobian(value, self.inputs[-1]))
        return symbol

    def resolve(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Expressions of symbols as expressions of the state."""
        # Forces contain inputs, so they go first.
        without = ca.substitute(list(expressions), [ca.vertcat(*self.forces)], [ca.vertcat(*self.force_values)])
        return ca.substitute(without, [ca.vertcat(*self.inputs)], [ca.vertcat(*self.input_values)])

    def chain(self, rate: ca.SX, y: ca.SX) -> ca.SX:
        """Derivative of the rate, in symbols still."""
        by_input = ca.diagcat(*self.blocks)
        by_state = ca.jacobian(ca.vertcat(*self.input_values), y)
        through = ca.mtimes(by_input, by_state)
        return ca.jacobian(rate, y) + ca.mtimes(ca.jacobian(rate, ca.vertcat(*self.forces)), through)


def expressions(params: Parameters, balls: int = 6) -> Expressions:
    """The field of the joint."""
    p = {name: value if isinstance(value, ca.SX) else float(value) for name, value in params.items()}
    n, half = balls, 3 * balls + 11
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 2 * half)
    places, velocities = ca.reshape(y[: 3 * n], 3, n), ca.reshape(y[half : half + 3 * n], 3, n)
    at, rates = y[3 * n : half], y[half + 3 * n :]
    head, head_turn, cage, raw_axis, seat_turn = at[0:3], at[3], at[4:7], at[7:10], at[10]
    head_velocity, head_spin, cage_velocity = rates[0:3], rates[3], rates[4:7]
    cage_spin, seat_spin = rates[7:10], rates[10]
    axis = raw_axis / ca.sqrt(ca.sumsqr(raw_axis))
    lean = p["joint_angle"]
    # Columns: the race's frame at turn 0. The third is its axis.
    about_y = np.array([[math.cos(lean), 0, math.sin(lean)], [0, 1, 0], [-math.sin(lean), 0, math.cos(lean)]])
    frames = {"seat_ball": ca.DM(np.eye(3)), "head_ball": ca.DM(about_y)}

    contacts = Contacts()
    ball_force = [ca.SX.zeros(3) for _ in range(n)]
    head_force, cage_force, cage_moment = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3)
    torque = {"seat_ball": ca.SX(0), "head_ball": ca.SX(0)}
    reach = math.hypot(p["pitch_radius"], p["offset"])
    flank = p["ball_radius"] * (2.0 * p["conformity"] - 1.0)
    sine, cosine = ca.sin(p["contact_angle"]), ca.cos(p["contact_angle"])
    loads = []
    for i in range(n):
        for name in TRACKS:
            seat = name == "seat_ball"
            side = 1.0 if seat else -1.0
            centre = ca.SX.zeros(3) if seat else head
            drift = ca.SX.zeros(3) if seat else head_velocity
            turn, spin = (seat_turn, seat_spin) if seat else (head_turn, head_spin)
            own, clearance = _own(p, name), p[f"clearance_{name}"]
            # The track's frame: x outward in the track's plane, y across it, z the race's axis.
            to_world = ca.mtimes(frames[name], _turned(turn + 2.0 * math.pi * i / n))
            q = ca.mtimes(to_world.T, places[:, i] - centre)
            u = ca.mtimes(to_world.T, velocities[:, i] - drift) - ca.vertcat(-spin * q[1], spin * q[0], 0)
            where = contacts.named(ca.vertcat(q, u))
            q, u = where[:3], where[3:]
            up = q[2] - side * p["offset"]
            distance = ca.sqrt(q[0] ** 2 + up**2)
            outward = ca.vertcat(q[0] / distance, 0, up / distance)
            force = ca.SX.zeros(3)
            for s in (1.0, -1.0):
                # From the centre of the flank's circle to the ball's centre.
                a = distance - reach + side * flank * cosine
                b = q[1] + s * flank * sine
                length = ca.sqrt(a * a + b * b)
                normal = (a / length) * outward + (b / length) * ca.DM([0, 1, 0])
                rate = ca.dot(u, normal)
                facing = _step(20.0 * s * b / length, (0, 0, 3.0, -2.0))
                load = facing * _normal(length - flank - clearance, rate, own)
                slide = u - rate * normal
                force -= load * (normal + _mobility(ca.sumsqr(slide), own) * slide)
                loads.append(load)
            force = ca.mtimes(to_world, contacts.force(force))
            ball_force[i] += force
            arm = places[:, i] - centre
            torque[name] -= ca.dot(ca.cross(arm, force), frames[name][:, 2])
            if not seat:
                head_force -= force

        own = _own(p, "cage_ball")
        arm = places[:, i] - cage
        u = velocities[:, i] - cage_velocity - ca.cross(cage_spin, arm)
        climb = ca.dot(u, axis)
        slide = u - climb * axis
        where = contacts.named(ca.vertcat(ca.dot(arm, axis), climb, ca.sumsqr(slide)))
        above = _normal(where[0] - p["clearance_cage_ball"], where[1], own)
        below = _normal(-where[0] - p["clearance_cage_ball"], -where[1], own)
        found = contacts.force(ca.vertcat(below - above, (above + below) * _mobility(where[2], own)))
        push = found[0] * axis - found[1] * slide
        ball_force[i] += push
        cage_force -= push
        cage_moment -= ca.cross(arm, push)

    head_axis = ca.DM(about_y[:, 2])
    outer_of_head = p["head_radius"] + p["clearance_head_cage"]
    seat_turning, head_turning = ca.vertcat(0, 0, seat_spin), head_spin * head_axis
    spheres = {
        "seat_cage": (cage, cage_velocity, seat_turning, cage_spin, p["seat_radius"]),
        "head_cage": (head - cage, head_velocity - cage_velocity, cage_spin, head_turning, outer_of_head),
    }
    for name, (apart, u, outer_spin, inner_spin, hollow) in spheres.items():
        own = _own(p, name)
        # The inner arm is the outer one less ``apart``: slide = u - inner x apart + (inner - outer) x outer arm.
        where = contacts.named(ca.vertcat(apart, u - ca.cross(inner_spin, apart), inner_spin - outer_spin))
        apart_, u_, spin_ = where[:3], where[3:6], where[6:]
        distance = ca.sqrt(ca.sumsqr(apart_) + 1e-24)
        normal = apart_ / distance
        # The part inner x apart lies across the normal.
        load = _normal(distance - p[f"clearance_{name}"], ca.dot(u_, normal), own)
        slide = u_ + ca.cross(spin_, hollow * normal)
        slide -= ca.dot(slide, normal) * normal
        force = contacts.force(-load * (normal + _mobility(ca.sumsqr(slide), own) * slide))
        point = hollow * apart / ca.sqrt(ca.sumsqr(apart) + 1e-24)
        inner_moment = ca.cross(point - apart, force)
        if name == "seat_cage":
            cage_force += force
            cage_moment += inner_moment
        else:
            head_force += force
            torque["head_ball"] += ca.dot(inner_moment, head_axis)
            cage_force -= force
            cage_moment -= ca.cross(point, force)

    resisting = p["load_torque"] * _step(t / p["load_ramp"], (0, 0, 0, 10.0, -15.0, 6.0))
    head_force -= p["axial_load"] * head_axis
    rate = ca.vertcat(
        y[half : half + 3 * n],
        head_velocity,
        head_spin,
        cage_velocity,
        ca.cross(cage_spin, raw_axis),
        seat_spin,
        ca.vertcat(*ball_force) * (1.0 / p["ball_mass"]),
        head_force * (1.0 / p["head_mass"]),
        (torque["head_ball"] - resisting) * (1.0 / p["head_inertia"]),
        cage_force * (1.0 / p["cage_mass"]),
        cage_moment * (1.0 / p["cage_inertia"]),
        0,
    )
    both = contacts.resolve([rate, contacts.chain(rate, y), ca.vertcat(*loads)])
    return Expressions(t, y, *(ca.cse(e) for e in both))


def rhs(params: Mapping[str, float]) -> ca.Function:
    """The field as a CasADi function (t, y) -> (y', 24 groove normal forces)."""
    e = expressions(params)
    return ca.Function("joint", [e.t, e.y], [e.rate, e.loads, e.jacobian], ["t", "y"], ["rate", "loads", "jacobian"])
