"""The joint: cost of each part, work against error beside other people's solvers, a batch, and what options save.

    python -m benchmarks.models.joint            all, some ten minutes on a quiet machine; needs the extra ``bench`` and cc
    python -m benchmarks.models.joint costs      or any of: costs, precision, seconds, batch, options; then docs/accuracy.md

Wall times are medians, one thread of XLA, everything compiled before. Forces: normal forces of flank 1 at both races,
0.6 s of the default joint, 301 outputs. ``loaded`` leaves out samples below 200 N, where a free ball drifts in its
clearance.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.arrowhead import Arrowhead, blocks
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.scales import scales
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.rodas import Rodas
from bcfj_jax.solve.sdirk import Sdirk
from benchmarks.clock import seconds as clocked
from benchmarks.common import load, markdown, publish, save
from benchmarks.common import options as asked

REPEATS = 5


def median(run: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Median wall time [s], result awaited."""
    return float(np.median(clocked(run, repeats, time.perf_counter)))


def loaded_state(scene: Any, params: Any) -> jax.Array:
    """A state under full load."""
    found = integrate(scene, params, jnp.asarray([0.0, 0.13]), plan(scene), "forward")
    return found.states[-1]


def microseconds(body: Callable, y: jax.Array, count: int = 2000) -> float:
    """Time of ``body`` inside a scan, per pass [us]; y -> y-shaped."""
    loop = jax.jit(lambda y: jax.lax.scan(lambda y, _: (body(y), None), y, None, length=count)[0])
    compiled = loop.lower(y).compile()
    jax.block_until_ready(compiled(y))
    return 1e6 * median(lambda: compiled(y)) / count


def _sum(tree: Any) -> jax.Array:
    return sum((jnp.sum(x) for x in jax.tree.leaves(tree)), jnp.zeros(()))


def costs() -> dict[str, Any]:
    """Microseconds of field, Jacobian, factorisation, solve and step; one run, and per run of 64."""
    scene = bj.scenes.joint_of_keys(**PLAIN)
    params = scene.parameters()
    c, y = constants(scene, params), loaded_state(scene, params)
    t, h, args, a = jnp.asarray(0.13), jnp.asarray(1e-4), (scene, c), Arrowhead()
    factors = a.factor(t, y, args, 0.25 * h)
    tolerance = 0.01 * scales(scene, params)
    rodas, sdirk = Rodas(a), Sdirk(a, tolerance)
    slope = a.field(t, y, args)
    parts: dict[str, Callable] = {
        "field": lambda y: y + 1e-15 * a.field(t, y, args),
        "Jacobian": lambda y: y + 1e-30 * _sum(blocks(scene, c, y)),
        "Jacobian and factorisation": lambda y: y + 1e-30 * _sum(a.factor(t, y, args, 0.25 * h)),
        "solve": lambda y: y + 1e-15 * a.solve(factors, y),
        "RODAS3 step": lambda y: y + 1e-15 * rodas.step(None, t, t + h, y, args, None, False)[0],
        "SDIRK2 step": lambda y: y + 1e-15 * sdirk.step(None, t, t + h, y, args, slope, False)[0],
        "dense Jacobian (jacfwd)": lambda y: y + 1e-30 * jnp.sum(jax.jacfwd(lambda y: a.field(t, y, args))(y)),
        "dense factorisation and solve": lambda y: y + 1e-30 * jnp.linalg.solve(jnp.eye(y.size) + y[0], y),
    }
    many_values = y + 1e-9 * jnp.asarray(np.random.default_rng(0).normal(size=(64, y.size)))
    return {
        name: {"one": microseconds(body, y), "of 64": microseconds(jax.vmap(body), many_values, 200) / 64}
        for name, body in parts.items()
    }


@partial(jax.jit, static_argnames=("scene", "differentiable"))
def _run(scene: Any, params: Any, times: jax.Array, how: Plan, differentiable: bool = False) -> Any:
    return integrate(scene, params, times, how, "forward", differentiable)


def precision() -> dict[str, Any]:
    """Work against error: RODAS3 and SDIRK2 here, CVODES, LSODA, Radau and diffrax as shipped."""
    from benchmarks.references.joint_peers import SOLVERS, cvodes, errors, groove_forces

    scene = bj.scenes.joint_of_keys(**PLAIN)
    params = scene.parameters()
    times, sizes = np.linspace(0.0, 0.6, 301), np.asarray(scales(scene, params))
    reference = groove_forces(scene, params, cvodes(scene, params, times, 1e-9, sizes).states)
    rows: list[dict[str, Any]] = []

    def add(name: str, tol: float, states: np.ndarray, wall: float, steps: int, failed: str | None = None) -> None:
        error = errors(groove_forces(scene, params, states), reference)._asdict() if failed is None else {}
        rows.append({"solver": name, "tol": tol, "wall_s": wall, "steps": steps, "failed": failed, **error})
        print(rows[-1], file=sys.stderr, flush=True)

    for name, differentiable, tolerances in (
        ("RODAS3, arrowhead", False, (5e-2, 2e-2, 5e-3, 1e-3, 2e-4)),
        ("SDIRK2, arrowhead", True, (5e-2, 2e-2, 1e-2, 3e-3, 1e-3)),
    ):
        for tol in tolerances:
            run = partial(_run, scene, params, jnp.asarray(times), Plan(jnp.asarray(tol), 400_000), differentiable)
            found = run()
            add(name, tol, np.asarray(found.states), median(run), int(found.accepted))
    for name, tolerances in (
        ("CVODES (CasADi)", (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4)),
        ("LSODA (SciPy, C field)", (1e-1, 1e-2, 1e-3, 1e-4)),
        ("Radau (SciPy, C field)", (1e-1,)),
        ("Kvaerno3 (diffrax, Newton)", (1e-1,)),
        ("Kvaerno5 (diffrax, Newton)", (1e-1,)),
        ("Tsit5 (diffrax)", (1e-1,)),
    ):
        solve = SOLVERS[name]
        for tol in tolerances:
            runs = [
                solve(scene, params, times, tol, sizes)
                for _ in range(3 if "C field" in name or "CVODES" in name else 1)
            ]
            wall = float(np.median([run.wall_s for run in runs]))
            add(name, tol, runs[0].states, wall, runs[0].steps, runs[0].failed)
    return {"rows": rows}


def seconds() -> dict[str, Any]:
    """The paper's 3 s with an output every millisecond, at 1 %; and the quasistatic revolution."""
    scene = bj.scenes.joint_of_keys(**PLAIN)
    params, times = scene.parameters(), np.linspace(0.0, 3.0, 3001)
    first = bj.simulate(scene, params, times)
    still = bj.scenes.joint_of_keys(fidelity="quasistatic", **PLAIN)
    angles = np.linspace(0.0, 0.6, 361)[:-1] + 1.0
    cold = bj.simulate(still, still.parameters(), angles)

    def wall(scene: Any, times: np.ndarray) -> float:
        walls = [bj.simulate(scene, scene.parameters(), times).stats["wall_s"] for _ in range(REPEATS)]
        return float(np.median(walls))

    return {
        "joint_3s_wall": wall(scene, times), "joint_3s_compile": first.stats["compile_s"],
        "steps": [first.stats["accepted"], first.stats["rejected"]], "quasistatic_360_wall": wall(still, angles),
        "quasistatic_compile": cold.stats["compile_s"],
    }  # fmt: skip


def batch() -> dict[str, Any]:
    """64 runs of differing clearance, 0.6 s at 1 %: time per run beside one run alone."""
    scene = bj.scenes.joint_of_keys(**PLAIN)
    params, times = scene.parameters(), jnp.linspace(0.0, 0.6, 301)
    how = plan(scene, 1e-2)
    clearance = jnp.linspace(20e-6, 100e-6, 64)
    many_values = {name: jnp.broadcast_to(value, (64,)) for name, value in params.items()} | {
        "clearance_seat_cage": clearance
    }
    many = jax.jit(jax.vmap(lambda p: integrate(scene, p, times, how, "forward").states))
    alone = jax.jit(lambda p: integrate(scene, p, times, how, "forward").states)
    jax.block_until_ready((many(many_values), alone(params)))
    together, one = median(lambda: many(many_values), 3), median(lambda: alone(params))
    return {"lanes": 64, "per_lane_s": together / 64, "one_lane_s": one}


def _operations(jaxpr: Any) -> int:
    count = 0
    for equation in jaxpr.eqns:
        inner = [
            x for x in jax.tree.leaves(list(equation.params.values())) if hasattr(x, "eqns") or hasattr(x, "jaxpr")
        ]
        count += sum(_operations(getattr(x, "jaxpr", x)) for x in inner) if inner else 1
    return count


def _nudge(solver: Rodas, t: Any, h: Any, args: Any, y: jax.Array) -> jax.Array:
    return y + 1e-15 * solver.step(None, t, t + h, y, args, None, False)[0]


def options() -> dict[str, Any]:
    """Primitive operations of the field, states, and time a step, per configuration."""
    rows = {}
    for name, given in {
        "default": {},
        "friction off": {"friction": False},
        "cage fixed": {"cage": "fixed"},
        "head fixed": {"head": "fixed"},
        "smoothing off": {"smoothing": False},
        "circular tracks": {"track": "circular"},
        "no pilots": {"contacts": ("cage_ball", "seat_ball", "head_ball")},
        "spin on": {"spin": True},
        "flexible drive": {"drive": "flexible"},
    }.items():
        scene = bj.scenes.joint_of_keys(**PLAIN | given)
        params = scene.parameters()
        c, a = constants(scene, params), Arrowhead()
        y = loaded_state(scene, params)
        t, h = jnp.asarray(0.13), jnp.asarray(1e-4)
        jaxpr = jax.make_jaxpr(lambda y, c=c, scene=scene: system.field(0.0, y, (scene, c)))(y)
        step = microseconds(partial(_nudge, Rodas(a), t, h, (scene, c)), y, 500)
        rows[name] = {"operations": _operations(jaxpr.jaxpr), "states": scene.states, "step_us": step}
    return rows


def readme() -> str:
    """The table of docs/accuracy.md, from the kept results."""
    seconds, batch = load("joint_seconds")["seconds"], load("joint_batch")["batch"]
    rows = [["", "wall", "force error"]]
    rows.append(["joint, 3 s at 1 %, compiled", f"{seconds['joint_3s_wall']:.2f} s", ""])
    rows.append(["... compile, nothing cached", f"{seconds['joint_3s_compile']:.0f} s", ""])
    rows.append(["joint, 0.6 s, a single run", f"{1e3 * batch['one_lane_s']:.0f} ms", ""])
    rows.append(["... a run of a batch of 64", f"{1e3 * batch['per_lane_s']:.0f} ms", ""])
    rows.append(["quasistatic, 360 angles", f"{1e3 * seconds['quasistatic_360_wall']:.0f} ms", ""])
    for row in load("joint_precision")["precision"]["rows"]:
        error = f"{row['loaded']:.2g} N" if row["failed"] is None else row["failed"]
        rows.append([f"0.6 s: {row['solver']}, {row['tol']:.0e}", f"{1e3 * row['wall_s']:.0f} ms", error])
    return markdown(rows)


PARTS = {"costs": costs, "precision": precision, "seconds": seconds, "batch": batch, "options": options}


def main() -> None:
    for name in asked(__doc__, {"parts": PARTS}).parts:
        content = PARTS[name]()
        print(name, content)
        save(f"joint_{name}", {name: content})
    publish("joint", readme(), "docs/accuracy.md")


if __name__ == "__main__":
    main()
