"""Work and precision of the joint's derivatives: ``jacfwd`` of ``force_history`` beside CVODES and differences.

    python -m benchmarks.models.joint_derivatives    writes results/joint_derivatives.json, prints tables; needs ``bench``

Against the file of ``derivatives.py``: 0.6 s at 1 ms, 20 normal forces, 8 logarithms. The error of a row is that of
its worst parameter among those whose influence is above 1 % of the largest: relative, L2 over all histories, of their
5 ms averages. Walls are of one core and of 601 outputs, programs compiled.
"""

from __future__ import annotations

import itertools
import os
import tempfile
import time
from collections.abc import Callable
from typing import Any

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are.
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import LEVELS, Plan, plan
from benchmarks.analysis.derivatives import MOVED, Reference, errors, grid, influence, load, moved, normals
from benchmarks.common import markdown, save

# Tolerance, and whether tangents count in the step control (BDF) or not (SDIRK2). The first eight are what ``plan``
# takes (``balanced`` is the second, ``reference`` the sixth), the others what it does not, and why.
TOLERANCES = (
    *((tolerance, False) for tolerance in (1e-1, 2e-2, 5e-3)),
    *((tolerance, True) for tolerance in (1e-3, 2e-4, 2e-5, 1e-6, 1e-7)),
    *((tolerance, False) for tolerance in (1e-3, 1e-4)),
    *((tolerance, True) for tolerance in (2e-2, 5e-3)),
)
CVODES_TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# Tolerance of CVODES, step of the logarithm.
DIFFERENCES = ((1e-3, 1e-2), (1e-4, 1e-2), (1e-5, 3e-3), (1e-6, 1e-3), (1e-7, 1e-3), (1e-8, 3e-4), (1e-9, 1e-4))
INFLUENTIAL, MANY, MAX_STEPS, REPEATS, LONG_S = 0.01, 32, 400_000, 3, 3.0

SCENE = bj.scenes.joint(**PLAIN)
PARAMS = SCENE.parameters()
NAMES = [name for name, value in PARAMS.items() if float(value) != 0.0][:MANY]
TIMES = jnp.asarray(grid())


def forces(logs: Any, tolerance: Any, controlled: Any) -> Any:
    """Normal forces (T, 20) under the eight logarithms."""
    how = Plan(tolerance, MAX_STEPS, controlled)
    return normals(bj.force_history(SCENE, moved(PARAMS, logs), TIMES, accuracy=how, mode="forward"))


def values(logs: Any, tolerance: Any, controlled: Any) -> Any:
    """The same by the solver of values."""
    how = Plan(tolerance, MAX_STEPS, controlled)
    return normals(bj.force_history(SCENE, moved(PARAMS, logs), TIMES, accuracy=how))


def many_forces(logs: Any, tolerance: Any, controlled: Any) -> Any:
    """Normal forces under the logarithms of the first ``MANY`` parameters that are not 0."""
    changed = {**PARAMS, **{name: PARAMS[name] * jnp.exp(logs[i]) for i, name in enumerate(NAMES)}}
    return normals(
        bj.force_history(SCENE, changed, TIMES, accuracy=Plan(tolerance, MAX_STEPS, controlled), mode="forward")
    )


def steps(logs: Any, tolerance: Any, controlled: Any) -> Any:
    """The last states, and accepted and rejected steps: with derivatives, those that the tangents ask for."""
    found = integrate(SCENE, moved(PARAMS, logs), TIMES, Plan(tolerance, MAX_STEPS, controlled), "forward", True)
    return found.states[-1], (found.accepted, found.rejected)


def compiled(function: Callable[..., Any], size: int, controlled: bool) -> tuple[Callable[..., Any], float]:
    """The program of a function of ``size`` logarithms, and how long it took."""
    begin = time.perf_counter()
    made = jax.jit(lambda logs, tolerance: function(logs, tolerance, controlled))
    made = made.lower(jnp.zeros(size), jnp.asarray(1e-2)).compile()
    return made, time.perf_counter() - begin


def timed(program: Callable[..., Any], size: int, tolerance: float) -> tuple[np.ndarray, float]:
    """What a program returns, and the shortest wall of several runs."""
    arguments = jnp.zeros(size), jnp.asarray(tolerance)
    walls = []
    result = jax.block_until_ready(program(*arguments))
    for _ in range(REPEATS):
        begin = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        walls.append(time.perf_counter() - begin)
        if sum(walls) > 5.0:
            break
    return np.asarray(result), min(walls)


def judged(found: np.ndarray, kept: Reference) -> dict[str, Any]:
    """Errors of derivatives, per parameter and of the worst."""
    average, point = errors(found, kept.slope), errors(found, kept.slope, 1)
    counted = influence(kept.slope) > INFLUENTIAL
    # Where in time the pointwise error sits: the share of its square in the worst twentieth of the samples.
    sizes = np.sqrt(np.sum(kept.slope**2, axis=(0, 1)))
    square = np.sort(np.sum(((found - kept.slope) / sizes)[..., counted] ** 2, axis=(1, 2)))
    return {
        "error": float(average[counted].max()),
        "pointwise": float(point[counted].max()),
        "errors": dict(zip(MOVED, average.tolist(), strict=True)),
        "errors_pointwise": dict(zip(MOVED, point.tolist(), strict=True)),
        "share_in_worst_twentieth": float(square[-len(square) // 20 :].sum() / square.sum()),
        "largest": float(np.abs(found).max()),
        "bounded": bool(np.isfinite(found).all()),
    }


def ours(kept: Reference) -> dict[str, Any]:
    """Rows of our own derivatives, and compile times."""
    k = len(MOVED)
    programs = {
        "value": (values, k, False),
        "forward": (forces, k, False),
        "jacobian": (jax.jacfwd(forces), k, False),
        "many": (jax.jacfwd(many_forces), MANY, False),
        "steps": (jax.jacfwd(steps, has_aux=True), k, False),
        "jacobian, bdf": (jax.jacfwd(forces), k, True),
        "many, bdf": (jax.jacfwd(many_forces), MANY, True),
        "steps, bdf": (jax.jacfwd(steps, has_aux=True), k, True),
    }
    made, compile_s = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
        for name, (function, size, controlled) in programs.items():
            made[name], cold = compiled(function, size, controlled)
            compile_s[name] = {"cold": cold}
            if size == k and not name.startswith("steps"):
                jax.clear_caches()
                made[name], compile_s[name]["cached"] = compiled(function, size, controlled)
            print(f"compile {name}: {compile_s[name]}", flush=True)
        jax.config.update("jax_compilation_cache_dir", None)
    rows = []
    for tolerance, controlled in TOLERANCES:
        way = ", bdf" if controlled else ""
        found, wall = timed(made["jacobian" + way], k, tolerance)
        _, forward = timed(made["forward"], k, tolerance)
        value, rodas = timed(made["value"], k, tolerance)
        _, many = timed(made["many" + way], MANY, tolerance)
        _, (accepted, rejected) = made["steps" + way](jnp.zeros(k), jnp.asarray(tolerance))
        row = {
            "tolerance": tolerance,
            "controlled": controlled,
            **judged(found, kept),
            "wall_s": wall,
            "forward_wall_s": forward,
            "value_wall_s": rodas,
            "value_rms_N": float(np.sqrt(np.mean((value - kept.force) ** 2))),
            "many_wall_s": many,
            "accepted": int(accepted),
            "rejected": int(rejected),
        }
        rows.append(row)
        print(row["tolerance"], {x: row[x] for x in ("error", "pointwise", "wall_s", "forward_wall_s", "many_wall_s")})
    return {"compile_s": compile_s, "rows": rows}


def long_run() -> list[dict[str, Any]]:
    """The scene's whole 3 s: ``balanced`` and ``reference`` against CVODES' sensitivities at 1e-7."""
    from benchmarks.analysis.derivatives import reader
    from benchmarks.references.joint_casadi import default_scales
    from benchmarks.references.joint_sensitive import Sensitive

    times = np.linspace(0.0, LONG_S, round(LONG_S / 1e-3) + 1)
    states, slopes, wall = Sensitive(SCENE, PARAMS, default_scales(SCENE), MOVED).sensitivities(times, 1e-7)
    force, slope = reader(SCENE, PARAMS)(states, slopes)
    kept = Reference(times, force, slope, {})
    rows = [{"level": "CVODES 1e-7", "wall_s": wall}]
    for level in ("balanced", "reference"):
        how = plan(SCENE, level)

        def program(logs: Any, tolerance: Any, controlled: bool = how.tangents) -> Any:
            how = Plan(tolerance, 2 * MAX_STEPS, controlled)
            changed = moved(PARAMS, logs)
            return normals(bj.force_history(SCENE, changed, jnp.asarray(times), accuracy=how, mode="forward"))

        found, seconds = timed(jax.jit(jax.jacfwd(program)), len(MOVED), float(how.tolerance))
        rows.append({"level": level, **judged(found, kept), "wall_s": seconds})
        print("3 s", level, rows[-1]["error"], rows[-1]["pointwise"], seconds, flush=True)
    return rows


def peers(kept: Reference) -> dict[str, list[dict[str, Any]]]:
    """Rows of CVODES' sensitivities and of one-sided differences on CVODES."""
    from benchmarks.analysis.derivatives import differences, reader
    from benchmarks.references.joint_casadi import default_scales
    from benchmarks.references.joint_sensitive import Sensitive

    made = Sensitive(SCENE, PARAMS, default_scales(SCENE), MOVED)
    read, times = reader(SCENE, PARAMS), grid()
    found: dict[str, list[dict[str, Any]]] = {"CVODES sensitivities": [], "differences on CVODES": []}
    for tolerance in CVODES_TOLERANCES:
        solved = [made.sensitivities(times, tolerance) for _ in range(2)]
        slope = read(*solved[0][:2])[1]
        row = {"tolerance": tolerance, **judged(slope, kept), "wall_s": min(x[2] for x in solved)}
        found["CVODES sensitivities"].append(row)
        print("CVODES", tolerance, row["error"], row["wall_s"], flush=True)
    for tolerance, step in DIFFERENCES:
        slope, wall = differences(made, times, tolerance, step, central=False)
        row = {"tolerance": tolerance, "step": step, **judged(slope, kept), "wall_s": wall}
        found["differences on CVODES"].append(row)
        print("differences", tolerance, step, row["error"], wall, flush=True)
    return found


def wall_at(rows: list[dict[str, Any]], error: float) -> float | None:
    """The least wall [s] of a peer at an error, by interpolation of logarithms between rows; None if never as good."""
    best = None
    for a, b in itertools.pairwise(rows):
        low, high = sorted((a["error"], b["error"]))
        if low <= error <= high and low < high:
            share = np.log(error / a["error"]) / np.log(b["error"] / a["error"])
            wall = float(a["wall_s"] ** (1 - share) * b["wall_s"] ** share)
            best = wall if best is None else min(best, wall)
    good = [row["wall_s"] for row in rows if row["error"] <= error]
    return min([*good, *([best] if best is not None else [])], default=None)


def main() -> None:
    kept = load()
    mine, theirs = ours(kept), peers(kept)
    for row in mine["rows"]:
        for name, rows in theirs.items():
            wall = wall_at(rows, row["error"])
            row[f"speedup over {name}"] = None if wall is None else wall / row["wall_s"]
    levels = {name: float(plan(SCENE, name).tolerance) for name in LEVELS}
    what = "derivatives of 20 normal forces by 8 logarithms, 0.6 s, outputs every 1 ms, one core"
    save(
        "joint_derivatives",
        {
            "what": what,
            "levels": levels,
            "reference": kept.settings,
            "ours": mine,
            "peers": theirs,
            "long": long_run(),
        },
    )
    table = [["tolerance", "error, 5 ms", "pointwise", "steps", "Jacobian s", "/ forward", "32 / forward", "/ values"]]
    table[0] += [f"{name}: times slower" for name in theirs]
    for row in mine["rows"]:
        forward, value = row["forward_wall_s"], row["value_wall_s"]
        ratios = (row["wall_s"] / forward, row["many_wall_s"] / forward, row["wall_s"] / value)
        gains = [row[f"speedup over {name}"] for name in theirs]
        table.append(
            [
                f"{row['tolerance']:g}{', BDF' if row['controlled'] else ''}",
                f"{100 * row['error']:.2g} %",
                f"{100 * row['pointwise']:.2g} %",
                f"{row['accepted']} + {row['rejected']}",
                f"{row['wall_s']:.3f}",
                *(f"{ratio:.1f}" for ratio in ratios),
                *("-" if gain is None else f"{gain:.1f}" for gain in gains),
            ]
        )
    print(markdown(table))
    table = [["peer", "tolerance", "error, 5 ms", "pointwise", "s"]]
    for name, rows in theirs.items():
        for row in rows:
            error = [f"{100 * row[key]:.2g} %" for key in ("error", "pointwise")]
            table.append([name, f"{row['tolerance']:g}", *error, f"{row['wall_s']:.2f}"])
    print(markdown(table))


if __name__ == "__main__":
    main()
