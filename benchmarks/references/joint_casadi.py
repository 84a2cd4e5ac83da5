"""CVODES on the joint of ``joint_casadi_field``, compiled from C: the peer of the joint's benchmarks.

``python -m benchmarks.references.joint_casadi`` compares the two fields at random states, and times the compiled one.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from bcfj_jax.models.joint.scene import PLAIN, Joint
from benchmarks.references.joint_casadi_field import Expressions, expressions, require_defaults, rhs

FLAGS = ["-O3", "-march=native", "-fno-math-errno"]
# CVODES weights are reltol |z| + abstol. Scaled states reach 5e3, so this leaves abstol = tol to count.
RELATIVE = 1e-6
MAX_STEPS = 2_000_000


def on_scales(e: Expressions, scales: np.ndarray) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """The state z = y/scales, its rate, the derivative of that by z, and what stands for an argument that is not used."""
    z, unused = ca.SX.sym("z", scales.size), ca.SX.sym("unused", ca.Sparsity(scales.size, 1))
    unit, inverse = ca.DM(scales), ca.DM(1.0 / scales)
    rate, jacobian = ca.substitute([e.rate * inverse, e.jacobian], [e.y], [z * unit])
    return z, rate, ca.mtimes(ca.diag(inverse), ca.mtimes(jacobian, ca.diag(unit))), unused


def library(folder: str, *functions: ca.Function) -> str:
    """Functions that the C compiler has compiled; its path."""
    code = ca.CodeGenerator("field.c")
    for function in functions:
        code.add(function)
    source = Path(code.generate(f"{folder}/"))
    made = source.with_suffix(".so")
    subprocess.run(["cc", *FLAGS, "-fPIC", "-shared", str(source), "-o", str(made), "-lm"], check=True)
    return str(made)


def settings(tol: float, max_steps: int = MAX_STEPS) -> dict[str, Any]:
    """Of CVODES: BDF, Newton's method, a direct sparse solver; ``tol`` in units of the scales."""
    return {
        "abstol": tol, "reltol": RELATIVE * tol, "max_num_steps": max_steps, "newton_scheme": "direct",
        "linear_solver": "csparse", "disable_internal_warnings": True,
    }  # fmt: skip


class Build:
    """Compiled field and Jacobian of one set of parameters; integrators of any tolerance are cheap on it.

    CasADi writes C for z' = f(t, z) and its sparse Jacobian on the scaled state z = y/scales, the C compiler makes
    a library of both, and CVODES calls the library: nothing of the field is interpreted.
    """

    def __init__(self, params: Mapping[str, float], scales: np.ndarray):
        begin = time.perf_counter()
        self.scales, e = np.asarray(scales), expressions(params)
        z, rate, scaled, unused = on_scales(e, self.scales)
        self.plain = ca.Function("ode", [e.t, z], [rate], ["t", "z"], ["rate"])
        # The name, arguments and results by which an external function ``ode`` finds its derivative.
        jacobian = ca.Function("jac_ode", [e.t, z, unused], [ca.jacobian(rate, e.t), scaled])
        self.folder = tempfile.TemporaryDirectory(prefix="joint_casadi_")
        made = library(self.folder.name, self.plain, jacobian)
        self.jacobian, self.field = ca.external("jac_ode", made), ca.external("ode", made)
        self.compile_s = time.perf_counter() - begin
        self.integrators: dict[Any, ca.Function] = {}

    def callables(self) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
        """The compiled field and dense Jacobian as functions (t, z) of NumPy arrays, 1 us of Python around each."""
        n = self.scales.size
        at, z, rate = np.zeros(1), np.zeros(n), np.zeros(n)
        sparsity = self.jacobian.sparsity_out(1)
        row, column = (np.asarray(part) for part in sparsity.get_triplet())
        entries, runs = np.zeros(sparsity.nnz()), []
        for function, where, result in ((self.field, 0, rate), (self.jacobian, 1, entries)):
            buffer, run = function.buffer()
            buffer.set_arg(0, memoryview(at))
            buffer.set_arg(1, memoryview(z))
            buffer.set_res(where, memoryview(result))
            runs.append((run, buffer))

        # The buffers are held by the closures.
        def rates(t: float, state: np.ndarray) -> np.ndarray:
            at[0], z[:] = t, state
            runs[0][0]()
            return rate.copy()

        def derivative(t: float, state: np.ndarray) -> np.ndarray:
            at[0], z[:] = t, state
            runs[1][0]()
            dense = np.zeros((n, n))
            dense[row, column] = entries
            return dense

        return rates, derivative

    def integrator(self, times: np.ndarray, tol: float) -> ca.Function:
        """CVODES from ``times[0]``, with outputs at the rest, tolerance in units of the scales."""
        key = (times.tobytes(), tol)
        if key not in self.integrators:
            t, z = ca.MX.sym("t"), ca.MX.sym("z", self.scales.size)
            problem = {"t": t, "x": z, "ode": self.field(t, z)}
            grid = [float(v) for v in times[1:]]
            self.integrators[key] = ca.integrator("cvodes", "cvodes", problem, float(times[0]), grid, settings(tol))
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


def cvodes(scene: Joint, params: Mapping[str, Any], times: np.ndarray, tol: float, scales: np.ndarray) -> Peer:
    """States (T, n) at the times by CVODES (BDF, Newton, direct sparse solver); ``scales`` [SI] is the unit of ``tol``.

    Building is cached and timed apart: the wall time is that of one call of the integrator.
    """
    from bcfj_jax.models.joint.kinematic import nominal

    require_defaults(scene)
    made = build(params, scales)
    grid = np.asarray(times, dtype=float)
    begin = time.perf_counter()
    solver = made.integrator(grid, tol)
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
    from bcfj_jax.models.joint.kinematic import nominal

    rng = np.random.default_rng(seed)
    half = scene.states // 2
    tilt = scene.slices["cage_turn"]
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
    import jax.numpy as jnp

    from bcfj_jax.models.joint import system
    from bcfj_jax.models.joint.constants import constants

    require_defaults(scene)
    made = constants(scene, dict(params))
    theirs = rhs(params)

    @jax.jit
    def ours(t, y):
        view = system.view(scene, made, y)
        field = system.field(t, y, (scene, made))
        derivative = jax.jacfwd(system.field, argnums=1)(t, y, (scene, made))
        touches = system.by_name(scene, system.contact_forces(scene, made, view))
        normal = jnp.stack([touches[name].normal for name in ("seat_ball", "head_ball")], 1)
        return field, normal, derivative

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
    """The joint with the options that are written in CasADi."""
    from bcfj_jax.models.joint.model import joint_of_keys

    return joint_of_keys(**PLAIN)


def default_scales(scene: Joint, place: float = 5e-5, speed: float = 0.1) -> np.ndarray:
    """Unit of each state: a place and a speed, and both over 35.5 mm for turns and spins [SI]."""
    half = scene.states // 2
    unit = np.ones(half)
    for name, piece in scene.slices.items():
        if piece is not None and "turn" in name:
            unit[3 * scene.balls + piece.start : 3 * scene.balls + piece.stop] = 1.0 / 0.0355
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
