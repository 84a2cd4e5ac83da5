"""What 32-bit numbers cost and what they save: the same batch of runs in both, against a tight 64-bit one.

The package refuses 32-bit numbers (``integrate.plan``); this works below that, on ``simulation.outcome``. A process of
its own runs the batches in each; the parent compares.

    python -m benchmarks.solve.precision [CASE ...]    writes results/precision.json and the table in docs/tradeoff.md
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bcfj_jax.models.joint.scene import PLAIN

os.environ.setdefault("EQX_ON_ERROR", "nan")

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bcfj_jax import scenes
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import outcome
from benchmarks.common import ROOT, markdown, put_in_readme, save

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
        walls = []
        for _ in range(REPEATS if asked in ASKED else 0):
            begin = time.perf_counter()
            jax.block_until_ready(run(values, how))
            walls.append(time.perf_counter() - begin)
        found = {f"force {key}": np.asarray(x, float) for key, x in force.items()}
        yield asked, found | {"code": np.asarray(code)}, statistics.median(walls) if walls else float("nan")


def child(bits: int, cases: list[str], folder: Path) -> None:
    """Run cases in numbers of so many bits."""
    if bits == 32:
        jax.config.update("jax_enable_x64", False)
        warnings.filterwarnings("ignore", message="Explicitly requested dtype")
    walls = {}
    for case in cases:
        for asked, found, wall in measured(case, BATCH, (*ASKED, TIGHT) if bits == 64 else ASKED):
            walls[f"{case} {asked:g}"] = wall
            print(f"{bits} bits, {case}, {asked:g}: {wall:.3g} s", flush=True)
            np.savez(folder / f"{bits} {case} {asked:g}.npz", allow_pickle=False, **found)
    (folder / f"{bits}.json").write_text(json.dumps(walls))


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


def main(cases: list[str]) -> None:
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for bits in ("64", "32"):
            subprocess.run([sys.executable, __file__, *cases, "--bits", bits, "--folder", place], check=True)
        walls = {bits: json.loads((folder / f"{bits}.json").read_text()) for bits in (64, 32)}
        for case in cases:
            truth = dict(np.load(folder / f"64 {case} {TIGHT:g}.npz"))
            for asked in ASKED:
                key = f"{case} {asked:g}"
                both = {bits: dict(np.load(folder / f"{bits} {key}.npz")) for bits in (64, 32)}
                rows.append({
                    "case": case, "asked": asked,
                    "error": {bits: error(found, truth) for bits, found in both.items()},
                    "failed": {bits: int((found["code"] != 0).sum()) for bits, found in both.items()},
                    "lane_ms": {bits: 1e3 * walls[bits][key] / BATCH for bits in both},
                })  # fmt: skip
    save("precision", {"lanes": BATCH, "rows": rows})
    table = [["scene", "asked", "error, 64 bit", "32 bit", f"failed of {BATCH}", "64 bit over 32 bit, time"]]
    for row in rows:
        e, ms = row["error"], row["lane_ms"]
        worst = "-" if np.isnan(e[32]) else f"{100 * e[32]:.1g} %"
        asked = "" if "kinematic" in row["case"] or "static" in row["case"] else f"{100 * row['asked']:g} %"
        table.append(
            [row["case"], asked, f"{100 * e[64]:.1g} %", worst, str(row["failed"][32]), f"{ms[64] / ms[32]:.2g}"]
        )
    put_in_readme("precision", markdown(table), "docs/tradeoff.md")
    print(markdown(table))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"by default all of {', '.join(CASES)}")
    parser.add_argument("--bits", type=int, choices=(32, 64), help="be the process that runs them in these")
    parser.add_argument("--folder", type=Path)
    asked = parser.parse_args()
    jax.config.update("jax_compilation_cache_dir", str(ROOT / "build" / "jax-cache"))
    if asked.bits:
        child(asked.bits, asked.cases, asked.folder)
    else:
        main(asked.cases or list(CASES))
