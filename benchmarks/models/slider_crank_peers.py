"""The slider-crank with clearance beside what users would pick: SciPy's LSODA with a field by numba, and Exudyn.

    python -m benchmarks.models.slider_crank_peers [--only single batch]      some five minutes; needs the extra ``bench``

Scene: ``slider_crank`` at 5000 r/min, 0.5 mm of clearance, 10 turns, the normal force of the journal 1000 times a turn.
All tools solve the same equations in minimal coordinates: the rod's angle and the slider's place. Every tool gets the
coarsest tolerance at which it, and the next two of its ladder, keep the force error asked for against DOP853 at 1e-12 of
``references.slider_crank``. With friction the motion is predictable over all 10 turns, and so long is the error measured.
Without friction it is chaotic: the error is that of the first turn, and 10 turns are run at that tolerance.
A batch is one turn of 256 clearances; the peers loop over them.

One core, one thread, tools taking turns, medians of CPU times: on a busy machine they are steady where wall times are
not. Exudyn's forces stay at its own steps: they are interpolated outside
the time. numbalsoda, which has its LSODA in C++, is measured where it can be imported.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, NamedTuple

# Exudyn's build without checks of ranges.
os.environ.setdefault("EXUDYN_MODULE", "fast")

import dataclasses
import importlib.metadata
import math

import exudyn as exu
import jax
import jax.numpy as jnp
import numba
import numpy as np
from exudyn.itemInterface import NodeGenericODE2, ObjectGenericODE2, SensorNode
from scipy.integrate import odeint, solve_ivp
from scipy.interpolate import BPoly

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives.names import Feature
from bcfj_jax.analysis.studies import batch
from bcfj_jax.solve.measured_error import measured
from bcfj_jax.solve.plan import MAX_STEPS, Plan, plan
from benchmarks.clock import clocked, on_core
from benchmarks.common import add, load, options, publish, table
from benchmarks.references import slider_crank as reference

try:
    import numbalsoda
except ImportError:
    numbalsoda = None

# Waiting for another thread costs CPU time.
jax.config.update("jax_cpu_enable_async_dispatch", False)

ASKED, TURNS, SAMPLES = (1e-2, 1e-3), 10, 1000
CLEARANCES = np.linspace(0.05e-3, 0.5e-3, 256)
# Clearances of the batch whose error is measured.
PROBED = slice(None, None, 17)
ROUNDS, BATCH_ROUNDS, LONGEST_S = 7, 3, 4.0
BUDGET = 10 * MAX_STEPS
# Of Exudyn's user function in one run.
CALLS = 2_000_000
B6 = reference.SliderCrank(damping=0.333, stiffness=6.61e10)
RUBBING = {"friction": "brown_mcphee", "friction_static": 0.1, "friction_dynamic": 0.05, "friction_speed": 0.1}


class Case(NamedTuple):
    """A scene of the package, the reference's options, and the turns over which errors are measured."""

    friction: bool
    options: dict[str, Any]
    certain: int


CASES = {"friction": Case(True, RUBBING, TURNS), "no friction": Case(False, {}, 1)}
Crank = reference.SliderCrank


# The equations, for the peers


def pull(t: float, angle: float, place: float, spin: float, speed: float, p: Any) -> tuple[float, float, float]:
    """Of the rod's angle and the slider's place: generalised forces [N m, N], and the normal force [N]."""
    crank, rod, mass, clearance, radius, omega, stiffness, damping, static, dynamic, slow = p[:11]
    a_x, a_y = crank * math.cos(omega * t), crank * math.sin(omega * t)
    u_x, u_y = math.cos(angle), math.sin(angle)
    torque = 0.5 * mass * rod * omega * omega * (a_y * u_x - a_x * u_y)
    e_x, e_y = a_x + rod * u_x - place, a_y + rod * u_y
    size = math.sqrt(e_x * e_x + e_y * e_y)
    depth = size - clearance
    if depth <= 0.0:
        return torque, 0.0, 0.0
    n_x, n_y = e_x / size, e_y / size
    v_x, v_y = -omega * a_y - rod * spin * u_y - speed, omega * a_x + rod * spin * u_x
    force = stiffness * depth * math.sqrt(depth) * max(0.0, 1.0 + damping * (v_x * n_x + v_y * n_y))
    drag = 0.0
    if static > 0.0:
        x = (v_y * n_x - v_x * n_y + radius * spin) / slow
        drag = force * (dynamic * math.tanh(4.0 * x) + (static - dynamic) * x / (0.25 * x * x + 0.75) ** 2)
    f_x, f_y = force * n_x - drag * n_y, force * n_y + drag * n_x
    return torque - rod * (f_y * u_x - f_x * u_y) - radius * drag, f_x, force


_pull = numba.njit(pull)


@numba.njit
def _field(t, y, p):
    turning, along, _ = _pull(t, y[0], y[1], y[2], y[3], p)
    return np.array([y[2], y[3], turning / p[11], along / p[12]])


@numba.njit
def _forces(times, y, p):
    found = np.empty(times.size)
    for i in range(times.size):
        found[i] = _pull(times[i], y[i, 0], y[i, 1], y[i, 2], y[i, 3], p)[2]
    return found


def of(case: Case, clearance: float) -> Crank:
    """The reference's mechanism."""
    return dataclasses.replace(B6, bearing_radius=B6.journal_radius + clearance, **case.options)


def numbers(made: Crank) -> np.ndarray:
    """What ``pull`` reads, and the inertia of the rod about the crank's pin and the slider's mass, shape (13,)."""
    sizes = [made.crank, made.rod, made.rod_mass, made.clearance, made.journal_radius, made.speed]
    law = [made.stiffness, made.damping, made.friction_static, made.friction_dynamic, made.friction_speed]
    return np.array([*sizes, *law, made.rod_inertia + 0.25 * made.rod_mass * made.rod**2, made.slider_mass])


def started(made: Crank) -> np.ndarray:
    """Angle, place and their rates at time 0."""
    at = reference.ideal(made, np.zeros(()))
    return np.array([at.angle, at.position, at.angle_rate, at.velocity], float)


def instants(made: Crank, turns: int) -> np.ndarray:
    """Times [s], ``SAMPLES`` a turn."""
    return np.linspace(0.0, turns * made.period, turns * SAMPLES + 1)


@cache
def truth(name: str, clearance: float, turns: int) -> np.ndarray:
    """Normal force of the reference [N]."""
    made = of(CASES[name], clearance)
    return reference.readings(made, reference.simulate(made, instants(made, turns))).normal


# The tools. Each takes a mechanism, times and a tolerance, and returns normal forces with their times.

Forces = tuple[np.ndarray, np.ndarray]
Tool = Callable[[Crank, np.ndarray, float], Forces]
Weights = Callable[..., dict[str, Any]]


def scaled(made: Crank, tol: float) -> dict[str, Any]:
    """Absolute tolerances by the sizes of the play."""
    speed = made.crank * made.speed
    return {"rtol": 1e-12, "atol": tol * np.array([made.clearance / made.rod, made.clearance, speed / made.rod, speed])}


def plain(ratio: float, made: Crank, tol: float) -> dict[str, Any]:
    """One relative and one absolute tolerance."""
    return {"rtol": tol, "atol": ratio * tol}


def by_odeint(weights: Weights, made: Crank, times: np.ndarray, tol: float) -> Forces:
    p = numbers(made)
    y = odeint(_field, started(made), times, (p,), tfirst=True, mxstep=10**6, **weights(made, tol))
    return times, _forces(times, y, p)


def by_solve_ivp(weights: Weights, made: Crank, times: np.ndarray, tol: float) -> Forces:
    p, ends = numbers(made), (times[0], times[-1])
    y = solve_ivp(_field, ends, started(made), "LSODA", times, args=(p,), **weights(made, tol)).y
    return times, _forces(times, np.ascontiguousarray(y.T), p)


@cache
def _signature() -> Any:
    @numba.cfunc(numbalsoda.lsoda_sig)
    def rate(t, y_, dy_, p_):
        y, dy, p = numba.carray(y_, (4,)), numba.carray(dy_, (4,)), numba.carray(p_, (13,))
        turning, along, _ = _pull(t, y[0], y[1], y[2], y[3], p)
        dy[0], dy[1], dy[2], dy[3] = y[2], y[3], turning / p[11], along / p[12]

    return rate


def by_numbalsoda(weights: Weights, made: Crank, times: np.ndarray, tol: float) -> Forces:
    p = numbers(made)
    y, _ = numbalsoda.lsoda(_signature().address, started(made), times, p, mxstep=10**6, **weights(made, tol))
    return times, _forces(times, y, p)


class Exudyn:
    """A generic object of two coordinates with constant masses; its user function calls what numba has compiled.

    In plain Python, and by Exudyn's symbolic expressions, the same function took longer.
    """

    def __init__(self):
        self.p, self.left = np.zeros(13), 0

        def force(mbs, t, item, q, q_t):
            self.left -= 1
            if self.left < 0:
                raise ArithmeticError("the steps have become too small")
            turning, along, _ = _pull(t, q[0], q[1], q_t[0], q_t[1], self.p)
            return [turning, along]

        # Else it is destroyed with its system.
        self.container = exu.SystemContainer()
        self.system = self.container.AddSystem()
        self.node = self.system.AddNode(NodeGenericODE2("", [0, 0], [0, 0], [0, 0], 2))
        self.body = self.system.AddObject(
            ObjectGenericODE2(nodeNumbers=[self.node], massMatrix=np.eye(2), forceUserFunction=force)
        )
        kinds = exu.OutputVariableType.Coordinates, exu.OutputVariableType.Coordinates_t
        self.sensors = [
            self.system.AddSensor(SensorNode("", self.node, False, "", kind, storeInternal=True)) for kind in kinds
        ]

    def __call__(self, solver: str, ratio: float, made: Crank, times: np.ndarray, tol: float) -> Forces:
        """Forces at the steps; ``tol`` of generalised alpha is the step in 1/300 turn."""
        self.p, self.left, start = numbers(made), CALLS, started(made)
        self.system.SetNodeParameter(self.node, "initialCoordinates", start[:2])
        self.system.SetNodeParameter(self.node, "initialCoordinates_t", start[2:])
        self.system.SetObjectParameter(self.body, "massMatrix", np.diag(self.p[11:]))
        self.system.Assemble()
        settings = exu.SimulationSettings()
        how, kept = settings.timeIntegration, settings.solution
        fixed = solver == "GeneralizedAlpha"
        turns = times[-1] / made.period
        how.endTime, how.numberOfSteps = float(times[-1]), math.ceil(300 * turns / tol) if fixed else round(200 * turns)
        how.relativeTolerance, how.absoluteTolerance = tol, ratio * tol
        how.automaticStepSize, how.minimumStepSize, how.initialStepSize = not fixed, 1e-12, 0.0 if fixed else 1e-7
        kept.file.write, kept.sensors.writePeriod = False, 0.0
        try:
            done = self.system.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, solver))
        except (ArithmeticError, ValueError):
            # The user function met a run that diverged.
            done = False
        if not done:
            return times, np.full(times.shape, np.nan)
        q, v = (self.system.GetSensorStoredData(sensor) for sensor in self.sensors)
        own = q[:, 0].copy()
        self.states = np.hstack([q[:, 1:], v[:, 1:]])
        return own, _forces(own, self.states, self.p)

    def at(self, own: np.ndarray, made: Crank, times: np.ndarray) -> np.ndarray:
        """Forces of the last run at the times, its steps interpolated by polynomials of fifth degree."""
        p, keep = numbers(made), np.append(True, np.diff(own) > 0.0)
        own, states = own[keep], self.states[keep]
        rates = np.array([_field(t, y, p)[2:] for t, y in zip(own, states, strict=True)])
        found = []
        for k in (0, 1):
            way = BPoly.from_derivatives(own, np.stack([states[:, k], states[:, 2 + k], rates[:, k]], axis=1))
            found.append((way(times), way.derivative()(times)))
        (angle, spin), (place, speed) = found
        return _forces(times, np.stack([angle, place, spin, speed], axis=1), p)


EXUDYN = Exudyn()
_RATIOS = {"absolute a thousandth of relative": 1e-3, "equal tolerances": 1.0}
_PLAIN = {name: partial(plain, ratio) for name, ratio in _RATIOS.items()}
_WEIGHTS = {**_PLAIN, "by the sizes of the play": scaled}
# By peer its variants, of which the fastest counts.
PEERS: dict[str, dict[str, Tool]] = {
    "SciPy odeint (LSODA), numba": {name: partial(by_odeint, how) for name, how in _WEIGHTS.items()},
    "SciPy solve_ivp (LSODA), numba": {"by the sizes of the play": partial(by_solve_ivp, scaled)},
    "numbalsoda (LSODA), numba": {name: partial(by_numbalsoda, how) for name, how in _PLAIN.items()},
    "Exudyn, DOPRI5": {name: partial(EXUDYN, "DOPRI5", ratio) for name, ratio in _RATIOS.items()},
}
if numbalsoda is None:
    del PEERS["numbalsoda (LSODA), numba"]
OWN = "bcfj-jax"
BATCHED = ("SciPy odeint (LSODA), numba", "numbalsoda (LSODA), numba", "Exudyn, DOPRI5")


class Package:
    """The package's program for a case and a number of turns, and the seconds it took to compile."""

    def __init__(self, case: Case, turns: int):
        self.scene = bj.scenes.slider_crank(friction=case.friction)
        self.times = instants(B6, turns)
        shapes = self.values(B6), jnp.asarray(1e-3)
        self.program, took = clocked(lambda: jax.jit(self.force).lower(*shapes).compile())
        self.compile_s = took["cpu_s"]

    def values(self, made: Crank) -> dict[str, Any]:
        """Parameters of the scene."""
        return self.scene.parameters(clearance_journal=made.clearance)

    def force(self, params: Any, tol: Any) -> Any:
        """Force history at a tolerance, (T, 3)."""
        how = Plan(tol, BUDGET)
        return bj.force_history(self.scene, params, self.times, accuracy=how)["journal"]

    def __call__(self, made: Crank, times: np.ndarray, tol: float) -> Forces:
        """A tool."""
        return times, np.asarray(self.program(self.values(made), jnp.asarray(tol)))[:, 0]

    def as_asked(self, made: Crank, times: np.ndarray, asked: float) -> Forces:
        """A tool: the whole call of a user, at the tolerance that the package takes for a force error."""
        return times, bj.simulate(self.scene, self.values(made), times, accuracy=asked).force["journal"][:, 0]


# Measuring


def error(name: str, tool: Tool, clearance: float, turns: int, tol: float) -> tuple[float, float]:
    """Worst of rms, peak and impulse of the force over the certain turns; and the seconds of the run."""
    made, certain = of(CASES[name], clearance), min(turns, CASES[name].certain)
    times = instants(made, turns)
    (own, force), took = clocked(lambda: tool(made, times, tol))
    if own is not times:
        force = tool.func.at(own, made, times)  # pyright: ignore
    exact = truth(name, clearance, certain)
    times, force = times[: exact.size], force[: exact.size]
    sides = ({"journal": np.stack([side, 0 * side, 0 * side], axis=1)} for side in (force, exact))
    worst = measured(1.0, 0.0, times, *sides, tolerance=0.0, wall_s=0.0).worst
    return (worst if np.isfinite(worst) else np.inf), took["cpu_s"]


def ladder() -> Iterator[float]:
    """Tolerances, four a decade."""
    return (10.0 ** (-0.25 * k) for k in range(2, 45))


def tuned(
    promises: tuple[float, ...], measure: Callable[[float], tuple[float, float]]
) -> dict[float, dict[str, float]]:
    """By promise the coarsest tolerance that keeps it, as do the next two, with its error; none that takes too long."""
    found: dict[float, dict[str, float]] = {}
    rows: list[tuple[float, float]] = []
    for tol in ladder():
        worst, spent = measure(tol)
        rows.append((tol, worst))
        for asked in promises:
            last = rows[-3:]
            if asked not in found and len(last) == 3 and all(off <= asked for _, off in last):
                found[asked] = {"tolerance": last[0][0], "error": last[0][1]}
        if len(found) == len(promises) or spent > LONGEST_S:
            break
    return found


def turns_taken(calls: dict[str, Callable[[], Any]], rounds: int) -> dict[str, dict[str, float]]:
    """CPU seconds of every call, taking turns: median, least and most; and the median by the clock."""
    taken: dict[str, list[dict[str, float]]] = {name: [] for name in calls}
    for _ in range(rounds + 1):
        for name, call in calls.items():
            taken[name].append(clocked(call)[1])
    found = {}
    for name, (_, *rows) in taken.items():
        cpu, wall = ([row[key] for row in rows] for key in ("cpu_s", "wall_s"))
        found[name] = {
            "s": float(np.median(cpu)),
            "least_s": min(cpu),
            "most_s": max(cpu),
            "wall_s": float(np.median(wall)),
        }
    return found


def fastest(
    name: str, clearances: np.ndarray, turns: int, tools: dict[str, dict[str, Tool]], promises: tuple[float, ...]
) -> dict[float, dict[str, tuple[str, dict[str, float]]]]:
    """By promise and tool the variant that keeps it fastest, with tolerance and error, worst of the clearances."""
    found: dict[float, dict[str, Any]] = {asked: {} for asked in promises}
    for tool, variants in tools.items():
        for variant, run in variants.items():

            def measure(tol: float, run: Tool = run) -> tuple[float, float]:
                made = [error(name, run, c, turns, tol) for c in clearances]
                return max(worst for worst, _ in made), max(spent for _, spent in made)

            for asked, kept in tuned(promises, measure).items():
                made = of(CASES[name], clearances[-1])
                took = turns_taken({"": partial(run, made, instants(made, turns), kept["tolerance"])}, 3)[""]["s"]
                if tool not in found[asked] or took < found[asked][tool][2]:
                    found[asked][tool] = variant, kept, took
            print(f"  {name}, {turns} turns, {tool}, {variant}: {tuned_text(found, tool)}", flush=True)
    return {asked: {tool: row[:2] for tool, row in rows.items()} for asked, rows in found.items()}


def tuned_text(found: dict[float, dict[str, Any]], tool: str) -> str:
    """What is best so far."""
    rows = ((asked, by[tool]) for asked, by in found.items() if tool in by)
    return "; ".join(f"{asked:g}: {row[0]}, {row[1]['tolerance']:.1e}, {row[2]:.4f} s" for asked, row in rows)


def single(name: str) -> dict[str, Any]:
    """Ten turns at 0.5 mm."""
    own, made = Package(CASES[name], TURNS), of(CASES[name], 0.5e-3)
    tools = {OWN: {"": own}} | PEERS
    best = fastest(name, np.array([0.5e-3]), TURNS, tools, ASKED)
    content: dict[str, Any] = {"compile_s": own.compile_s}
    for asked, rows in best.items():
        calls, known = {}, {}
        for tool, (variant, kept) in rows.items():
            calls[tool] = partial(tools[tool][variant], made, own.times, kept["tolerance"])
            known[tool] = {"variant": variant, **kept}
        whole = f"{OWN}, simulate(accuracy={asked:g})"
        calls[whole] = partial(own.as_asked, made, own.times, asked)
        off = error(name, own.as_asked, 0.5e-3, TURNS, asked)[0]
        known[whole] = {"variant": "", "tolerance": float(plan(own.scene, asked).tolerance), "error": off}
        spent = turns_taken(calls, ROUNDS)
        content[f"{asked:g}"] = _with_ratios({tool: known[tool] | spent[tool] for tool in calls})
    return content


def _with_ratios(rows: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    for row in rows.values():
        row["over bcfj-jax"] = row["s"] / rows[OWN]["s"]
    return rows


def batched(name: str) -> dict[str, Any]:
    """One turn of 256 clearances: three ways of the package, and loops over the peers."""
    own, grid = Package(CASES[name], 1), np.linspace(0.0, 1.0, SAMPLES + 1)
    tools = {OWN: {"": own}} | {tool: PEERS[tool] for tool in BATCHED if tool in PEERS}
    asked = ASKED[0]
    best = fastest(name, CLEARANCES[PROBED], 1, tools, (asked,))[asked]
    everyone = [of(CASES[name], c) for c in CLEARANCES]
    params = {key: np.broadcast_to(x, CLEARANCES.shape) for key, x in own.values(B6).items()}
    params["clearance_journal"] = CLEARANCES
    given, ends = {key: jnp.asarray(x) for key, x in params.items()}, np.full(CLEARANCES.size, B6.period)
    calls: dict[str, Callable[[], Any]] = {}
    rows: dict[str, dict[str, Any]] = {}
    kept = best.pop(OWN)[1]
    tol = jnp.asarray(kept["tolerance"])
    one, how = partial(own.force, tol=tol), Plan(tol, BUDGET)
    ways = {"lax.map": partial(jax.lax.map, one), "vmap": jax.vmap(one)}
    for way, function in ways.items():
        program, took = clocked(lambda f=function: jax.jit(f).lower(given).compile())
        rows[f"{OWN}, {way}"] = {"compile_s": took["cpu_s"], **kept}
        calls[f"{OWN}, {way}"] = lambda program=program: np.asarray(program(given))
    study, wanted = f"{OWN}, a study's batch", [Feature("journal.peak", "peak", ("journal",))]
    calls[study] = lambda: batch.run(own.scene, batch.Points(params, ends, grid), wanted, how, ends.size, True)
    rows[study] = {"first_run_s": clocked(calls[study])[1]["cpu_s"], **kept}
    for tool, (variant, kept) in best.items():
        run = partial(tools[tool][variant], times=own.times, tol=kept["tolerance"])
        calls[tool] = lambda run=run: [run(made) for made in everyone]
        rows[tool] = {"variant": variant, **kept}
    spent = turns_taken(calls, BATCH_ROUNDS)
    rows = {tool: rows[tool] | spent[tool] for tool in calls}
    least = min(row["s"] for tool, row in rows.items() if tool.startswith(OWN))
    for row in rows.values():
        row["over bcfj-jax"] = row["s"] / least
    return {f"{asked:g}": rows}


def tried() -> dict[str, dict[str, float]]:
    """Error and seconds of one turn with friction by Exudyn's generalised alpha, by steps a turn: not its best."""
    runs = {300 * k: partial(EXUDYN, "GeneralizedAlpha", 1.0) for k in (10, 30, 100)}
    made = {steps: error("friction", run, 0.5e-3, 1, 300.0 / steps) for steps, run in runs.items()}
    return {str(steps): {"error": worst, "s": spent} for steps, (worst, spent) in made.items()}


def compiling() -> dict[str, float]:
    """Seconds that numba takes before its first call, of this process."""
    made, times = of(CASES["friction"], 0.5e-3), np.linspace(0.0, 1e-5, 3)
    calls = {"field by numba": by_odeint} | ({"field by numba for numbalsoda": by_numbalsoda} if numbalsoda else {})
    each = {name: clocked(lambda run=run: run(partial(plain, 1.0), made, times, 1e-3)) for name, run in calls.items()}
    return {name: took["cpu_s"] for name, (_, took) in each.items()}


def tables(content: dict[str, Any]) -> tuple[str, str]:
    """Of the single runs and of the batches."""

    def columns(factor: float, unit: str) -> dict[str, Any]:
        return {
            "tool": "{tool}", "measured error": lambda row: f"{100 * row['error']:.2g} %",
            "time": lambda row: f"{factor * row['s']:.3g} {unit}", "time over bcfj-jax": "{over bcfj-jax:.2g}",
        }  # fmt: skip

    def rows(kind: str, name: str, asked: float) -> list[dict[str, Any]]:
        each = content[kind][name][f"{asked:g}"].items()
        return [{"scene": name, "asked": f"{100 * asked:g} %", "tool": tool, **row} for tool, row in each]

    singles = [row for name in CASES for asked in ASKED for row in rows("single", name, asked)]
    batches = [row for name in CASES for row in rows("batch", name, ASKED[0])]
    return (
        table({"scene": "{scene}", "error asked": "{asked}", **columns(1e3, "ms")}, singles),
        table({"scene": "{scene}", **columns(1.0, "s")}, batches),
    )


def main() -> None:
    only = options(__doc__, only=["single", "batch"]).only
    # Before XLA counts the cores.
    on_core(-1)
    found: dict[str, Any] = {
        "asked": ASKED, "turns": TURNS, "samples_a_turn": SAMPLES, "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "versions": {name: importlib.metadata.version(name) for name in ("exudyn", "numba", "scipy", "numpy")},
        "numbalsoda": numbalsoda is not None,
    }  # fmt: skip
    if "single" in only:
        found |= {"compile_s": compiling(), "exudyn_generalised_alpha_one_turn": tried()}
        found["single"] = {name: single(name) for name in CASES}
    if "batch" in only:
        found["batch"] = {name: batched(name) for name in CASES}
    add("slider_crank_peers", found)
    markers = "slider_crank_peers", "slider_crank_batch"
    for name, text in zip(markers, tables(load("slider_crank_peers")), strict=True):
        publish(name, text, "docs/speed.md")


if __name__ == "__main__":
    main()
