"""What 32-bit numbers cost and what they save: the same batch of runs in both, against a tight 64-bit one.

The package refuses 32-bit numbers (``integrate.plan``); this works below that, on ``simulation.outcome``. A process of
its own runs the batches in each; the parent compares.

    python -m benchmarks.solve.precision [CASE ...]    writes results/precision.json and the table in docs/tradeoff.md
"""

from __future__ import annotations

import statistics
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import benchmarks.common as harness
from bcfj_jax import scenes
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import outcome
from benchmarks.clock import keep_programs, seconds
from benchmarks.common import load, options, publish, save
from benchmarks.processes import call

BATCH, REPEATS, BUDGET = 16, 5, 200_000
ASKED = (1e-2, 1e-3, 1e-4)
TIGHT = 1e-6
# Scene, options, what varies over the batch, samples and end [s].
CASES: dict[str, tuple[str, dict[str, Any], str, int, float | None]] = {
    "impact": ("impact", {}, "stiffness", 1001, None),
    "bounce": ("bounce", {}, "stiffness", 2001, None),
    "joint, kinematic": ("joint", {"fidelity": "kinematic", **PLAIN}, "load_torque", 61, 0.6),
    "joint, quasistatic": ("joint", {"fidelity": "quasistatic", **PLAIN}, "clearance_cage_ball", 61, 0.6),
    "joint, dynamic": ("joint", PLAIN, "clearance_cage_ball", 301, 0.3),
}


def measured(case: str, count: int, asks: tuple[float, ...]) -> Iterator[tuple[float, dict[str, np.ndarray], float]]:
    """At each accuracy forces and codes of every run, and the median wall of the batch [s], compiling apart."""
    name, options, varied, samples, end = CASES[case]
    scene = scenes.make(name, **options)
    params = scene.parameters()
    times = jnp.linspace(0.0, float(scene.horizon(params)) if end is None else end, samples)
    values = jnp.asarray(np.geomspace(0.7, 1.4, count) * float(params[varied]))
    numbers = {key: jnp.asarray(np.asarray(value)) for key, value in params.items()}

    def one(value: jax.Array, how: Plan) -> tuple[jax.Array, dict[str, jax.Array]]:
        solution, readings = outcome(scene, {**numbers, varied: value}, times, how, "forward")
        return solution.code, {key: reading.force for key, reading in readings.items()}

    run = jax.jit(jax.vmap(one, in_axes=(0, None)))
    for asked in asks:
        with jax.enable_x64(True):
            planned = plan(scene, asked, BUDGET)
        how = eqx.tree_at(lambda p: p.tolerance, planned, jnp.asarray(float(planned.tolerance)))
        code, force = jax.device_get(run(values, how))
        walls = seconds(lambda how=how: run(values, how), REPEATS if asked in ASKED else 0, time.perf_counter)
        found = {f"force {key}": np.asarray(x, float) for key, x in force.items()}
        yield asked, found | {"code": np.asarray(code)}, statistics.median(walls) if walls else float("nan")


def child(bits: int, cases: list[str], folder: str) -> dict[str, float]:
    """Run cases in numbers of so many bits, whose forces it writes into a folder; median walls by case and accuracy [s]."""
    keep_programs()
    if bits == 32:
        jax.config.update("jax_enable_x64", False)
        warnings.filterwarnings("ignore", message="Explicitly requested dtype")
    walls = {}
    for case in cases:
        for asked, found, wall in measured(case, BATCH, (*ASKED, TIGHT) if bits == 64 else ASKED):
            walls[f"{case} {asked:g}"] = wall
            np.savez(Path(folder) / f"{bits} {case} {asked:g}.npz", allow_pickle=False, **found)
    return walls


def error(found: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> float:
    """Worst contact's rms error over the batch's good runs, in fractions of the run's peak."""
    good = (found["code"] == 0) & (truth["code"] == 0)
    if not good.any():
        return float("nan")
    worst = []
    for key, right in truth.items():
        if key.startswith("force"):
            flat = right[good].reshape(good.sum(), right.shape[1], -1)
            off = found[key][good].reshape(flat.shape) - flat
            peak = np.abs(flat).max(axis=(1, 2))
            each = np.sqrt(np.mean(np.square(off), axis=1)).max(axis=1) / np.where(peak > 0, peak, 1.0)
            worst.append(each.max())
    return float(np.max(worst))


def main() -> None:
    rows, cases = [], options(__doc__, {"cases": CASES}).cases
    with tempfile.TemporaryDirectory() as folder:
        walls = {bits: call(__file__, "child", bits, cases, folder) for bits in (64, 32)}

        def runs(bits: int, key: str) -> dict[str, np.ndarray]:
            return dict(np.load(Path(folder) / f"{bits} {key}.npz"))

        for case in cases:
            truth = runs(64, f"{case} {TIGHT:g}")
            for asked in ASKED:
                key = f"{case} {asked:g}"
                both = {bits: runs(bits, key) for bits in (64, 32)}
                rows.append({
                    "case": case, "asked": asked,
                    "error": {bits: error(found, truth) for bits, found in both.items()},
                    "failed": {bits: int((found["code"] != 0).sum()) for bits, found in both.items()},
                    "lane_ms": {bits: 1e3 * walls[bits][key] / BATCH for bits in both},
                })  # fmt: skip
    save("precision", {"lanes": BATCH, "rows": rows})
    publish("precision", table(load("precision")["rows"]), "docs/tradeoff.md")


def table(rows: list[dict[str, Any]]) -> str:
    """Of kept rows, whose bits are texts."""
    free = ("kinematic", "static")
    return harness.table({
        "scene": "{case}",
        "asked": lambda r: "" if any(word in r["case"] for word in free) else f"{100 * r['asked']:g} %",
        "error, 64 bit": lambda r: f"{100 * r['error']['64']:.1g} %",
        "32 bit": lambda r: "-" if np.isnan(r["error"]["32"]) else f"{100 * r['error']['32']:.1g} %",
        f"failed of {BATCH}": lambda r: r["failed"]["32"],
        "64 bit over 32 bit, time": lambda r: f"{r['lane_ms']['64'] / r['lane_ms']['32']:.2g}",
    }, rows)  # fmt: skip


if __name__ == "__main__":
    main()
