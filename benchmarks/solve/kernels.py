"""What options of XLA change (``bcfj_jax.xla.backend``): run time, compile time and forces, side by side.

Each program runs in fresh processes that differ in these options alone, in turn; CPU seconds of all threads, the least
of the processes.

    python -m benchmarks.solve.kernels [--processes 2]    keeps benchmarks/results/kernels.json and docs/xla.md
"""

from __future__ import annotations

import base64
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

import benchmarks.common as harness
from benchmarks.clock import clocked, seconds
from benchmarks.common import options, publish, save
from benchmarks.processes import call

LOOPS, WRITER = "xla_cpu_small_while_loop_byte_threshold", "xla_cpu_disable_new_fusion_emitters"
EXTRA, MANY = "--xla_backend_extra_options=", 1 << 20
# What stands in XLA_FLAGS.
OPTIONS = {
    "as XLA comes": f"{EXTRA}{LOOPS}=1024",
    "loops": f"{EXTRA}{LOOPS}={MANY}",
    # What the package sets.
    "loops, older writer": f"{EXTRA}{LOOPS}={MANY},{WRITER}",
    "loops, several results a kernel": f"{EXTRA}{LOOPS}={MANY},xla_cpu_use_multi_output_fusion",
    # Products of small matrices by a library keep a loop from being one kernel.
    "whole solver one kernel": f"--xla_cpu_experimental_ynn_fusion_type= {EXTRA}{LOOPS}={1 << 30},{WRITER}",
}
BEFORE, OURS = "as XLA comes", "loops, older writer"
RUNS = 9
# Scene and end [s]; forces at 400 times are compared.
SCENES = {"impact": 5e-5, "slider_crank": 0.012, "joint": 0.1}
# The plain joint's Jacobian by eight parameters, 0.1 s: tolerance, and whether tangents are in the step control.
JACOBIANS = {"joint, 8 derivatives": (2e-4, True)}


def measured(run: Callable[[], Any]) -> tuple[dict[str, Any], Any]:
    """CPU seconds of a first call less a run's, and of a run; what the first call gave."""
    found, cold = clocked(run)
    least = min(seconds(run, RUNS))
    return {"run_s": least, "compile_s": cold["cpu_s"] - least}, found


def worker() -> dict[str, Any]:
    """All programs in this process."""
    import jax
    import jax.numpy as jnp

    import bcfj_jax as bj
    from bcfj_jax.models.joint.scene import PLAIN
    from bcfj_jax.solve.plan import Plan
    from benchmarks.analysis.derivatives import MOVED, moved, normals

    def kept(row: dict[str, Any], numbers: Any) -> dict[str, Any]:
        return {**row, "numbers": base64.b64encode(np.nan_to_num(np.asarray(numbers).ravel()).tobytes()).decode()}

    found = {}
    for name, end in SCENES.items():
        scene, at = getattr(bj.scenes, name)(), np.linspace(0.0, end, 400)
        run = functools.partial(bj.simulate, scene, scene.parameters(), at)
        row, first = measured(run)
        found[name] = kept(row, np.concatenate([f.ravel() for f in first.force.values()]))
    scene, times, none = bj.scenes.joint_of_keys(**PLAIN), jnp.linspace(0.0, 0.1, 101), jnp.zeros(len(MOVED))
    for name, (tolerance, controlled) in JACOBIANS.items():
        how = Plan(jnp.asarray(tolerance), 400_000, controlled)

        @jax.jit
        @jax.jacfwd
        def slopes(logs: Any, how: Plan = how) -> Any:
            params = moved(scene.parameters(), logs)
            return normals(bj.force_history(scene, params, times, accuracy=how, mode="forward"))

        row, first = measured(lambda f=slopes: jax.block_until_ready(f(none)))
        found[name] = kept(row, first)
    return found


def numbers(row: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(row["numbers"]))


def main() -> None:
    rounds, processes = [], options(__doc__, processes=2).processes
    for _ in range(processes):
        rounds.append({})
        for name, flags in OPTIONS.items():
            variables = {"XLA_FLAGS": flags, "EQX_ON_ERROR": "nan", "BCFJ_CACHE": "off"}
            rounds[-1][name] = call(__file__, "worker", variables=variables)
            print(name, {k: (r["run_s"], r["compile_s"]) for k, r in rounds[-1][name].items()}, flush=True)
    result: dict[str, Any] = {}
    for program in (*SCENES, *JACOBIANS):
        sides = {name: [r[name][program] for r in rounds] for name in OPTIONS}
        before = numbers(sides[BEFORE][0])
        result[program] = {
            name: {
                **{key: min(row[key] for row in rows) for key in ("run_s", "compile_s")},
                "difference": float(np.abs(numbers(rows[0]) - before).max() / np.abs(before).max()),
            }
            for name, rows in sides.items()
        }
    save("kernels", {"processes": processes, "options": OPTIONS, "programs": result})
    publish("kernels", table(result), "docs/xla.md")


def table(result: dict[str, Any]) -> str:
    """CPU milliseconds of a run and CPU seconds of the first call less a run, by program and options."""
    runs = [(f"run [ms]: {side}", lambda r, s=side: f"{1e3 * r[s]['run_s']:.3g}") for side in OPTIONS]
    firsts = [(f"first call [s]: {side}", lambda r, s=side: f"{r[s]['compile_s']:.3g}") for side in OPTIONS]
    difference = ("difference", lambda r: f"{r[OURS]['difference']:.1e}")
    rows = ({"name": name, **sides} for name, sides in result.items())
    return harness.table([("program", "`{name}`"), *runs, *firsts, difference], rows)


if __name__ == "__main__":
    main()
