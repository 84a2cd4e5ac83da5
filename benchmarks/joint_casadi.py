"""The joint a second time, written in CasADi from the formulas, and CVODES on it: the peer of the joint's benchmarks.

Shares nothing with ``bcfj_jax`` but the names of parameters, the start and the layout of the state. The geometry is
written in the frames of the tracks, where ``bcfj_jax.joint.contacts`` uses world axes; friction as vectors, where
that has components.
Default options only: gothic track, free cage and head, prescribed drive, memory-free power law, Brown-McPhee
friction, smoothed onset, balls without spin.

    python benchmarks/joint_casadi.py     compares the two fields at random states, and times the compiled one
"""

from __future__ import annotations

import math
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from bcfj_jax.joint.scene import Joint

FLAGS = ["-O3", "-march=native", "-fno-math-errno"]
LINEAR_SOLVER = "csparse"
# CVODES weights are reltol |z| + abstol. Scaled states reach 5e3, so this leaves abstol = tol to count.
RELATIVE = 1e-6
MAX_STEPS = 2_000_000
TRACKS = ("seat_ball", "head_ball")


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
        made = (type(contact.law).__name__, type(contact.law.elastic).__name__, type(contact.friction).__name__)
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


def _mobility(slip_squared: ca.SX, p: Mapping[str, float]) -> ca.SX:
    """Brown and McPhee: [mu_d tanh(4 r)/r + (mu_s - mu_d)/(r^2/4 + 3/4)^2]/v_t, r = v/v_t."""
    square = slip_squared / p["friction_speed"] ** 2
    # At r^2 = 1e-9 tanh(4 r)/r = 4 - 64/3 r^2 is exact to 1e-16.
    r = ca.sqrt(ca.fmax(square, 1e-9))
    ratio = ca.if_else(square > 1e-9, ca.tanh(4.0 * r) / r, 4.0 - 64.0 / 3.0 * square)
    static, dynamic = p["friction_static"], p["friction_dynamic"]
    return (dynamic * ratio + (static - dynamic) / (0.25 * square + 0.75) ** 2) / p["friction_speed"]


def _normal(penetration: ca.SX, rate: ca.SX, p: Mapping[str, float]) -> ca.SX:
    """r'(d) K r(d)^n max(0, 1 + a d'), with the onset r(d) of half-width w."""
    w = p["smoothing"]
    ramp, slope = ca.fmax(penetration, 0.0), 1.0
    if w > 0.0:
        x = (penetration + w) / (2.0 * w)
        ramp = ca.if_else(penetration < w, 2.0 * w * _step(x, (0, 0, 0, 0, 2.5, -3.0, 1.0)), penetration)
        slope = _step(x, (0, 0, 0, 10.0, -15.0, 6.0))
    elastic = p["stiffness"] * (ramp * ca.sqrt(ramp) if p["exponent"] == 1.5 else ramp ** p["exponent"])
    # sqrt' at 0 is infinite, and 0 times it not a number: no contact, no expression.
    elastic = ca.if_else(ramp > 0.0, elastic, 0.0)
    return slope * elastic * ca.fmax(1.0 + p["damping"] * rate, 0.0)


def _turned(angle: ca.SX) -> ca.SX:
    """Rotation about z."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def _own(params: Mapping[str, float], contact: str) -> dict[str, float]:
    names = ("stiffness", "exponent", "damping", "smoothing", "friction_static", "friction_dynamic", "friction_speed")
    return {name: float(params.get(f"{contact}.{name}", params[name])) for name in names}


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


def expressions(params: Mapping[str, float], balls: int = 6) -> Expressions:
    """The field of the joint."""
    p = {name: float(value) for name, value in params.items()}
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
    sine, cosine = math.sin(p["contact_angle"]), math.cos(p["contact_angle"])
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


class Build:
    """Compiled field and Jacobian of one set of parameters; integrators of any tolerance are cheap on it.

    CasADi writes C for z' = f(t, z) and its sparse Jacobian on the scaled state z = y/scales, the C compiler makes
    a library of both, and CVODES calls the library: nothing of the field is interpreted.
    """

    def __init__(self, params: Mapping[str, float], scales: np.ndarray):
        begin = time.perf_counter()
        e = expressions(params)
        n = e.y.numel()
        z, unused = ca.SX.sym("z", n), ca.SX.sym("unused", ca.Sparsity(n, 1))
        unit, inverse = ca.DM(np.asarray(scales)), ca.DM(1.0 / np.asarray(scales))
        rate, jacobian = ca.substitute([e.rate * inverse, e.jacobian], [e.y], [z * unit])
        scaled = ca.mtimes(ca.diag(inverse), ca.mtimes(jacobian, ca.diag(unit)))
        by_time = ca.jacobian(rate, e.t)
        self.plain = ca.Function("ode", [e.t, z], [rate], ["t", "z"], ["rate"])
        # The name, arguments and results by which an external function ``ode`` finds its derivative.
        self.plain_jacobian = ca.Function("jac_ode", [e.t, z, unused], [by_time, scaled])
        self.loads = ca.Function("loads", [e.t, e.y], [e.loads])
        self.scales = np.asarray(scales)
        self.folder = tempfile.TemporaryDirectory(prefix="joint_casadi_")
        self.field = self._compiled()
        self.compile_s = time.perf_counter() - begin
        self.integrators: dict[Any, ca.Function] = {}

    def _compiled(self) -> ca.Function:
        code = ca.CodeGenerator("field.c")
        code.add(self.plain)
        code.add(self.plain_jacobian)
        where = Path(self.folder.name)
        source = Path(code.generate(f"{where}/"))
        library = where / "field.so"
        command = ["cc", *FLAGS, "-fPIC", "-shared", str(source), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)
        self.jacobian = ca.external("jac_ode", str(library))
        return ca.external("ode", str(library))

    def callables(self) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
        """The compiled field and dense Jacobian as functions (t, z) of NumPy arrays, 1 us of Python around each."""
        n = self.scales.size
        at, z, rate = np.zeros(1), np.zeros(n), np.zeros(n)
        sparsity = self.jacobian.sparsity_out(1)
        row, column = (np.asarray(part) for part in sparsity.get_triplet())
        entries = np.zeros(sparsity.nnz())
        field, run_field = self.field.buffer()
        field.set_arg(0, memoryview(at))
        field.set_arg(1, memoryview(z))
        field.set_res(0, memoryview(rate))
        jacobian, run_jacobian = self.jacobian.buffer()
        jacobian.set_arg(0, memoryview(at))
        jacobian.set_arg(1, memoryview(z))
        jacobian.set_res(1, memoryview(entries))

        def rates(t: float, state: np.ndarray) -> np.ndarray:
            at[0], z[:] = t, state
            run_field()
            return rate.copy()

        def derivative(t: float, state: np.ndarray) -> np.ndarray:
            at[0], z[:] = t, state
            run_jacobian()
            dense = np.zeros((n, n))
            dense[row, column] = entries
            return dense

        # The buffers are held by the closures.
        rates.keep, derivative.keep = field, jacobian  # type: ignore[attr-defined]
        return rates, derivative

    def integrator(self, times: np.ndarray, tol: float, options: Mapping[str, Any] | None = None) -> ca.Function:
        """CVODES from ``times[0]``, with outputs at the rest, tolerance in units of the scales."""
        key = (times.tobytes(), tol, repr(options))
        if key not in self.integrators:
            t, z = ca.MX.sym("t"), ca.MX.sym("z", self.scales.size)
            problem = {"t": t, "x": z, "ode": self.field(t, z)}
            settings = {
                "abstol": tol,
                "reltol": RELATIVE * tol,
                "max_num_steps": MAX_STEPS,
                "newton_scheme": "direct",
                "linear_solver": LINEAR_SOLVER,
                "disable_internal_warnings": True,
                **(options or {}),
            }
            grid = [float(v) for v in times[1:]]
            self.integrators[key] = ca.integrator("cvodes", "cvodes", problem, float(times[0]), grid, settings)
        return self.integrators[key]


_BUILDS: dict[Any, Build] = {}


def build(params: Mapping[str, float], scales: np.ndarray) -> Build:
    """The compiled problem, made once for each set of numbers."""
    key = (tuple(sorted((name, float(value)) for name, value in params.items())), np.asarray(scales).tobytes())
    if key not in _BUILDS:
        _BUILDS[key] = Build(params, np.asarray(scales, dtype=float))
    return _BUILDS[key]


class Peer(NamedTuple):
    """What a solver returned. ``failed`` says why it did not finish; then the states are not numbers."""

    states: np.ndarray
    wall_s: float
    steps: int
    compile_s: float
    failed: str | None = None


def cvodes(
    scene: Joint,
    params: Mapping[str, Any],
    times: np.ndarray,
    tol: float,
    scales: np.ndarray,
    options: Mapping[str, Any] | None = None,
) -> Peer:
    """States (T, n) at the times by CVODES (BDF, Newton, direct sparse solver); ``scales`` [SI] is the unit of ``tol``.

    Building is cached and timed apart: the wall time is that of one call of the integrator.
    """
    from bcfj_jax.joint.start import nominal

    require_defaults(scene)
    made = build(params, scales)
    grid = np.asarray(times, dtype=float)
    begin = time.perf_counter()
    solver = made.integrator(grid, tol, options)
    setup = time.perf_counter() - begin
    start = np.asarray(nominal(scene, dict(params), np.zeros(()))) / made.scales
    begin = time.perf_counter()
    try:
        z = np.asarray(solver(x0=start)["xf"])
    except RuntimeError as error:
        wall = time.perf_counter() - begin
        return Peer(np.full((grid.size, start.size), np.nan), wall, 0, made.compile_s, str(error).splitlines()[-1])
    wall = time.perf_counter() - begin
    states = np.vstack([start, z.T]) * made.scales
    return Peer(states, wall, int(solver.stats()["nsteps"]), made.compile_s + setup)


def random_states(scene: Joint, params: Mapping[str, Any], count: int, seed: int = 0) -> np.ndarray:
    """Assembled states at random turns, shaken by 30 um and 0.3 m/s so that every kind of contact is closed in some."""
    from bcfj_jax.joint.start import nominal

    rng = np.random.default_rng(seed)
    half = scene.states // 2
    tilt = scene.slots["cage_turn"]
    assert tilt is not None
    axis = slice(3 * scene.balls + tilt.start, 3 * scene.balls + tilt.stop)
    states = []
    for _ in range(count):
        y = np.array(nominal(scene, dict(params), np.asarray(rng.uniform(0.0, 2.0 * np.pi))))
        y[:half] += 3e-5 * rng.standard_normal(half)
        y[half:] += 0.3 * rng.standard_normal(half)
        y[axis] /= np.linalg.norm(y[axis])
        states.append(y)
    return np.array(states)


def check(scene: Joint, params: Mapping[str, Any], count: int = 20) -> dict[str, float]:
    """Greatest disagreement with ``system.field``, over the largest entry of each kind of rate, and of the loads."""
    import jax

    from bcfj_jax.joint import system
    from bcfj_jax.joint.constants import constants

    require_defaults(scene)
    made = constants(scene, dict(params))
    theirs = rhs(params)

    @jax.jit
    def ours(t, y):
        view = system.view(scene, made, y)
        field = system.field(t, y, (scene, made))
        derivative = jax.jacfwd(system.field, argnums=1)(t, y, (scene, made))
        return field, system.touches(scene, made, view).grooves.normal, derivative

    n, half = 3 * scene.balls, scene.states // 2
    after = half + n
    blocks = {
        "places": slice(0, half),
        "balls": slice(half, after),
        "head": slice(after, after + 3),
        "head turn": slice(after + 3, after + 4),
        "cage": slice(after + 4, after + 7),
        "cage turn": slice(after + 7, after + 10),
    }
    worst = {name: 0.0 for name in (*blocks, "loads", "jacobian")}
    for y in random_states(scene, params, count):
        a, loads, derivative = (np.asarray(v) for v in ours(0.03, y))
        b, theirs_loads, theirs_derivative = (np.asarray(v).squeeze() for v in theirs(0.03, y))
        pairs = {name: (a[where], b[where]) for name, where in blocks.items()}
        pairs |= {"loads": (loads.ravel(), theirs_loads), "jacobian": (derivative, theirs_derivative)}
        for name, (p, q) in pairs.items():
            worst[name] = max(worst[name], float(np.max(np.abs(p - q)) / np.max(np.abs(p))))
    return worst


def cost(made: Build, y: np.ndarray, count: int = 5000) -> dict[str, float]:
    """Microseconds of one call of the field and of its Jacobian, compiled and interpreted, in a loop inside CasADi."""
    z = ca.repmat(ca.DM(y / made.scales), 1, count)
    t = ca.DM(np.full((1, count), 0.03))
    found = {}
    functions = {"field, compiled": (made.field, (t, z)), "field, interpreted": (made.plain, (t, z))}
    functions["jacobian, compiled"] = (made.field.jacobian(), (t, z, z))
    for name, (function, arguments) in functions.items():
        looped = function.map(count)
        walls = []
        for _ in range(4):
            begin = time.perf_counter()
            looped(*arguments)
            walls.append(time.perf_counter() - begin)
        found[name] = min(walls) / count * 1e6
    return found


def default_scene() -> Joint:
    """The joint with default options."""
    from bcfj_jax import laws
    from bcfj_jax.joint.scene import CONTACTS, JointContact

    friction = laws.make_friction(True)
    return Joint(tuple(JointContact(name, laws.make("memory_free"), friction) for name in CONTACTS))


def default_scales(scene: Joint, place: float = 5e-5, speed: float = 0.1) -> np.ndarray:
    """Unit of each state: a place and a speed, and both over 35.5 mm for turns and spins [SI]."""
    half = scene.states // 2
    unit = np.ones(half)
    for name, slot in scene.slots.items():
        if slot is not None and "turn" in name:
            unit[3 * scene.balls + slot.start : 3 * scene.balls + slot.stop] = 1.0 / 0.0355
    return np.concatenate([place * unit, speed * unit])


def main() -> None:
    scene = default_scene()
    params = scene.parameters()
    for name, value in check(scene, params).items():
        print(f"{name:12s} {value:.1e}")
    made = build(params, default_scales(scene))
    print(f"compile {made.compile_s:.1f} s, {made.field.jac_sparsity(0, 1).nnz()} of {scene.states**2} entries")
    print(cost(made, random_states(scene, params, 1)[0]))


if __name__ == "__main__":
    main()
