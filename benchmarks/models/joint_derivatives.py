"""Work and precision of the joint's derivatives: ``jacfwd`` of ``force_history`` beside CVODES and differences.

    PJRT_NPROC=1 python -m benchmarks.models.joint_derivatives [work] [kernel] [batch] [more] [long]    needs ``bench``
        writes those parts of results/joint_derivatives.json, docs/images/joint_derivatives.png, tables of
        docs/derivatives.md

Against the file of ``derivatives.py``: 0.6 s at 1 ms, 20 normal forces, 8 logarithms. The error of a row is that of
its worst parameter among those whose influence is above 1 % of the largest: relative, L2 over all histories, of their
5 ms averages. ``work``, alone where nothing is asked for: work against error beside CVODES, and what programs take to
compile. ``kernel``: BDF again, with options of XLA that make one kernel of the whole solver, in a process of its own.
``batch``: 64 of them at once, whose groove clearances are 0.8 to 1.25 times the joint's. ``more``: a Jacobian by 32
parameters, and steps. ``long``: the scene's whole 3 s. Seconds are of the process, the least of several runs, for 601
outputs, programs compiled. PJRT_NPROC leaves XLA one thread, as CVODES has.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import LEVELS, Plan, plan
from benchmarks.analysis.derivatives import MOVED, Reference, errors, grid, influence, load, moved, normals
from benchmarks.clock import clocked
from benchmarks.clock import seconds as took
from benchmarks.common import ROOT, Some, drawing, known, options, publish
from benchmarks.solve.kernels import OPTIONS

# Tolerance, and whether tangents count in the step control (BDF) or not (SDIRK2). The first ``TAKEN`` are what ``plan``
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
# Lanes of ``batch``; tolerance and method.
LANES, BATCHED = 64, ((2e-2, False), (2e-4, True))
TAKEN, INFLUENTIAL, MANY, MAX_STEPS, REPEATS, LONG_S = 8, 0.01, 32, 400_000, 3, 3.0
PAGE = "docs/derivatives.md"
PROGRAMS = {
    "value": "values (RODAS3)",
    "forward": "a run of SDIRK2 alone",
    "jacobian": "Jacobian of 8, SDIRK2",
    "jacobian, bdf": "Jacobian of 8, BDF",
}

_ONE = "whole solver one kernel"
SCENE = bj.scenes.joint_of_keys(**PLAIN)
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
    """The program of a function of ``size`` logarithms, and how long it took [s]."""
    lowered = jax.jit(lambda logs, tolerance: function(logs, tolerance, controlled)).lower
    made, spent = clocked(lambda: lowered(jnp.zeros(size), jnp.asarray(1e-2)).compile())
    return made, spent["cpu_s"]


def timed(program: Callable[..., Any], size: int, tolerance: float) -> tuple[np.ndarray, float]:
    """What a program returns, and the least time of several runs [s]."""
    arguments = jnp.zeros(size), jnp.asarray(tolerance)
    result = jax.block_until_ready(program(*arguments))
    return np.asarray(result), min(took(lambda: program(*arguments), REPEATS, most=3.0))


def judged(found: np.ndarray, kept: Reference) -> dict[str, Any]:
    """Errors of derivatives, per parameter and of the worst."""
    average, point = errors(found, kept.slope), errors(found, kept.slope, 1)
    counted = influence(kept.slope) > INFLUENTIAL
    # Where in time the pointwise error sits: the share of its square in the worst twentieth of the samples.
    sizes = np.sqrt(np.sum(kept.slope**2, axis=(0, 1)))
    square = np.sort(np.sum(((found - kept.slope) / sizes)[..., counted] ** 2, axis=(1, 2)))
    return {
        "error": float(average[counted].max()), "pointwise": float(point[counted].max()),
        "errors": dict(zip(MOVED, average.tolist(), strict=True)),
        "errors_pointwise": dict(zip(MOVED, point.tolist(), strict=True)),
        "share_in_worst_twentieth": float(square[-len(square) // 20 :].sum() / square.sum()),
        "largest": float(np.abs(found).max()), "bounded": bool(np.isfinite(found).all()),
    }  # fmt: skip


def ours(kept: Reference) -> dict[str, Any]:
    """Rows of our own derivatives, and what programs take to compile: anew, and from JAX's cache."""
    k, made, compile_s = len(MOVED), {}, {}
    programs = {
        "value": (values, False),
        "forward": (forces, False),
        "jacobian": (jax.jacfwd(forces), False),
        "jacobian, bdf": (jax.jacfwd(forces), True),
    }
    # The first program traced takes what all share.
    jax.eval_shape(jax.jacfwd(lambda logs: forces(logs, 1e-2, True)), jnp.zeros(k))
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
        for name, (function, controlled) in programs.items():
            made[name], cold = compiled(function, k, controlled)
            jax.clear_caches()
            made[name], cached = compiled(function, k, controlled)
            compile_s[name] = {"cold": cold, "cached": cached}
            compile_s[name]["over_value"] = cold / compile_s["value"]["cold"]
            print(f"compile {name}: {compile_s[name]}", flush=True)
        jax.config.update("jax_compilation_cache_dir", None)
    rows = []
    for tolerance, controlled in TOLERANCES:
        found, seconds = timed(made["jacobian, bdf" if controlled else "jacobian"], k, tolerance)
        _, forward = timed(made["forward"], k, tolerance)
        value, rodas = timed(made["value"], k, tolerance)
        row = {
            "tolerance": tolerance, "controlled": controlled, **judged(found, kept), "cpu_s": seconds,
            "forward_cpu_s": forward, "value_cpu_s": rodas,
            "value_rms_N": float(np.sqrt(np.mean((value - kept.force) ** 2))),
        }  # fmt: skip
        rows.append(row)
        print(row["tolerance"], {x: row[x] for x in ("error", "pointwise", "cpu_s", "forward_cpu_s")}, flush=True)
    return {"compile_s": compile_s, "rows": rows}


def one_kernel() -> dict[str, Any]:
    """Rows of BDF where the whole solver is one kernel, and what its program takes to compile [s]."""
    begin = [sys.executable, "-m", "benchmarks.models.joint_derivatives", "kernel"]
    if os.environ.get("XLA_FLAGS") != OPTIONS[_ONE]:
        # XLA reads its options once a process.
        subprocess.run(begin, env={**os.environ, "XLA_FLAGS": OPTIONS[_ONE]}, cwd=ROOT, check=True)
        return known("joint_derivatives")["kernel"]
    kept, rows = load(), []
    made, compile_s = compiled(jax.jacfwd(forces), len(MOVED), True)
    for tolerance in (x for x, controlled in TOLERANCES[:TAKEN] if controlled):
        found, seconds = timed(made, len(MOVED), tolerance)
        rows.append({"tolerance": tolerance, **judged(found, kept), "cpu_s": seconds})
        print("one kernel", tolerance, rows[-1]["error"], seconds, flush=True)
    return {"compile_s": compile_s, "rows": rows}


def batch() -> list[dict[str, Any]]:
    """Seconds a lane of ``LANES`` Jacobians at once, by one program, beside one alone."""
    rows, place = [], list(MOVED).index("groove clearance")
    lanes = jnp.zeros((LANES, len(MOVED))).at[:, place].set(jnp.linspace(np.log(0.8), np.log(1.25), LANES))
    for tolerance, controlled in BATCHED:
        function = jax.jacfwd(forces)
        alone, _ = compiled(function, len(MOVED), controlled)
        together = jax.jit(jax.vmap(lambda logs, tol, f=function, c=controlled: f(logs, tol, c), (0, None)))
        once = timed(alone, len(MOVED), tolerance)[1]
        arguments = lanes, jnp.asarray(tolerance)
        # Compiled, not run: a batch of BDF takes minutes.
        together = together.lower(*arguments).compile()
        lanes_s = took(lambda program=together, given=arguments: program(*given), 1)[0]
        rows.append({"tolerance": tolerance, "lane_cpu_s": lanes_s / LANES, "alone_cpu_s": once})
        print("batch", rows[-1], flush=True)
    return rows


def more() -> list[dict[str, Any]]:
    """A Jacobian by ``MANY`` parameters and steps, by tolerance."""
    made = {
        (name, controlled): compiled(function, size, controlled)[0]
        for controlled in (False, True)
        for name, function, size in (
            ("many", jax.jacfwd(many_forces), MANY),
            ("steps", jax.jacfwd(steps, has_aux=True), len(MOVED)),
        )
    }
    rows = []
    for tolerance, controlled in TOLERANCES:
        _, many = timed(made["many", controlled], MANY, tolerance)
        _, counts = made["steps", controlled](jnp.zeros(len(MOVED)), jnp.asarray(tolerance))
        row = {"tolerance": tolerance, "controlled": controlled, "many_cpu_s": many}
        rows.append({**row, "accepted": int(counts[0]), "rejected": int(counts[1])})
        print(rows[-1], flush=True)
    return rows


def long_run() -> list[dict[str, Any]]:
    """The scene's whole 3 s: ``balanced`` and ``reference`` against CVODES' sensitivities at 1e-7."""
    from benchmarks.analysis.derivatives import reader
    from benchmarks.references.joint_casadi import default_scales
    from benchmarks.references.joint_sensitive import Sensitive

    times = np.linspace(0.0, LONG_S, round(LONG_S / 1e-3) + 1)
    states, slopes, seconds = Sensitive(SCENE, PARAMS, default_scales(SCENE), MOVED).sensitivities(times, 1e-7)
    force, slope = reader(SCENE, PARAMS)(states, slopes)
    kept = Reference(times, force, slope, {})
    rows = [{"level": "CVODES 1e-7", "cpu_s": seconds}]
    for level in ("balanced", "reference"):
        how = plan(SCENE, level)

        def program(logs: Any, tolerance: Any, controlled: bool = how.tangents) -> Any:
            how = Plan(tolerance, 2 * MAX_STEPS, controlled)
            changed = moved(PARAMS, logs)
            return normals(bj.force_history(SCENE, changed, jnp.asarray(times), accuracy=how, mode="forward"))

        found, seconds = timed(jax.jit(jax.jacfwd(program)), len(MOVED), float(how.tolerance))
        rows.append({"level": level, **judged(found, kept), "cpu_s": seconds})
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
        row = {"tolerance": tolerance, **judged(slope, kept), "cpu_s": min(x[2] for x in solved)}
        found["CVODES sensitivities"].append(row)
        print("CVODES", tolerance, row["error"], row["cpu_s"], flush=True)
    for tolerance, step in DIFFERENCES:
        slope, seconds = differences(made, times, tolerance, step, central=False)
        row = {"tolerance": tolerance, "step": step, **judged(slope, kept), "cpu_s": seconds}
        found["differences on CVODES"].append(row)
        print("differences", tolerance, step, row["error"], seconds, flush=True)
    return found


def seconds_at(rows: list[dict[str, Any]], error: float) -> float | None:
    """The least time [s] of a peer at an error, by interpolation of logarithms between rows; None if never as good."""
    best = None
    for a, b in itertools.pairwise(rows):
        low, high = sorted((a["error"], b["error"]))
        if low <= error <= high and low < high:
            share = np.log(error / a["error"]) / np.log(b["error"] / a["error"])
            took = float(a["cpu_s"] ** (1 - share) * b["cpu_s"] ** share)
            best = took if best is None else min(best, took)
    good = [row["cpu_s"] for row in rows if row["error"] <= error]
    return min([*good, *([best] if best is not None else [])], default=None)


def work() -> dict[str, Any]:
    """Ours beside its peers."""
    kept = load()
    mine, theirs = ours(kept), peers(kept)
    for row in mine["rows"]:
        for name, rows in theirs.items():
            seconds = seconds_at(rows, row["error"])
            row[f"speedup over {name}"] = None if seconds is None else seconds / row["cpu_s"]
    levels = {name: float(plan(SCENE, name).tolerance) for name in LEVELS}
    what = "derivatives of 20 normal forces by 8 logarithms, 0.6 s, outputs every 1 ms"
    return {"what": what, "levels": levels, "reference": kept.settings, "ours": mine, "peers": theirs}


def drawn(found: dict[str, Any], kernel: dict[str, Any] | None) -> None:
    """Work against error; what ``plan`` does not take is hollow."""
    rows = found["ours"]["rows"]
    curves = {
        "SDIRK2": [row for row in rows[:TAKEN] if not row["controlled"]],
        "BDF, tangents controlled": [row for row in rows[:TAKEN] if row["controlled"]],
        **found["peers"],
        **({"BDF, whole solver one kernel": kernel["rows"]} if kernel else {}),
    }
    with drawing("joint_derivatives.png", (8, 5)) as axes:
        for (name, curve), mark in zip(curves.items(), ("o", "s", "^", "x", "d"), strict=False):
            x, y = ([100 * row["error"] for row in curve], [row["cpu_s"] for row in curve])
            (line,) = axes.plot(x, y, mark, ls="-", label=name)
            for a, b, row in zip(x, y, curve, strict=True):
                axes.annotate(f"{row['tolerance']:g}", (a, b), (4, 4), textcoords="offset points", fontsize=6)
            other = [row for row in rows[TAKEN:] if row["controlled"] == (mark == "s") and row["error"] < 10.0]
            if mark in "os":
                x, y = ([100 * row["error"] for row in other], [row["cpu_s"] for row in other])
                axes.plot(x, y, mark, mfc="none", color=line.get_color())
        axes.set(
            xscale="log", yscale="log", ylabel="CPU seconds of the Jacobian of 8",
            xlabel="error of the worst parameter, 5 ms averages [%]; at each point its tolerance",
        )  # fmt: skip
        axes.legend(fontsize=8)


PARTS: dict[str, Callable[[], Any]] = {
    "work": work, "kernel": one_kernel, "batch": batch, "more": more, "long": long_run,
}  # fmt: skip


def main() -> None:
    harness.parts("joint_derivatives", PARTS, options(__doc__, {"parts": Some(["work"])}).parts)
    show(known("joint_derivatives"))


def tables(work: dict[str, Any]) -> tuple[str, str, str]:
    """Ours by tolerance, what programs take to compile, and the peers."""
    ours, peers = work["ours"], work["peers"]
    levels = {tolerance: f" (`{name}`)" for name, tolerance in work["levels"].items()}
    percents = {
        head: lambda row, key=key: f"{100 * row[key]:.2g} %"
        for head, key in {"error, 5 ms averages": "error", "pointwise": "pointwise"}.items()
    }

    def gain(row: dict[str, Any], name: str) -> str:
        over = row[f"speedup over {name}"]
        return "-" if over is None else f"{over:.1f} times as long"

    own = harness.table({
        "tolerance": lambda row: f"{row['tolerance']:g}{levels.get(row['tolerance'], '')}", **percents, "s": "{cpu_s:.2f}",
        "over SDIRK2's run alone": lambda row: f"{row['cpu_s'] / row['forward_cpu_s']:.1f}",
        "over a run of values": lambda row: f"{row['cpu_s'] / row['value_cpu_s']:.1f}",
        **{f"{name} at that error take": lambda row, name=name: gain(row, name) for name in peers},
    }, ours["rows"][:TAKEN])  # fmt: skip
    compiling = harness.table({
        "program": "{name}", "compiled anew, s": "{cold:.1f}", "over that of values": "{over_value:.1f}",
        "from JAX's cache, s": "{cached:.1f}",
    }, ({"name": PROGRAMS[name], **row} for name, row in ours["compile_s"].items()))  # fmt: skip
    theirs = harness.table(
        {"peer": "{name}", "tolerance": "{tolerance:g}", **percents, "s": "{cpu_s:.2f}"},
        ({"name": name, **row} for name, rows in peers.items() for row in rows),
    )
    return own, compiling, theirs


def show(found: dict[str, Any]) -> None:
    """The picture, and the tables of docs/derivatives.md."""
    if "work" in found:
        drawn(found["work"], found.get("kernel"))
        for row in found.get("kernel", {}).get("rows", []):
            peers = found["work"]["peers"].items()
            gains = {name: (seconds_at(rows, row["error"]) or np.nan) / row["cpu_s"] for name, rows in peers}
            print("one kernel", row["tolerance"], row["error"], row["cpu_s"], gains)
        own, compiling, theirs = tables(found["work"])
        publish("joint-derivatives", own, PAGE)
        publish("joint-derivatives-compiling", compiling, PAGE)
        print(theirs)
    for part in ("batch", "more", "long"):
        for row in found.get(part, []):
            print(part, {x: y for x, y in row.items() if not isinstance(y, dict)})


if __name__ == "__main__":
    main()
