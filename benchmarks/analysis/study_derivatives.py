"""A study of 256 clearances with two derivatives, against its points one by one; and points of steady motion.

    python -m benchmarks.analysis.study_derivatives [--points 256] [--singles 16] [--steady 4] [--only NAME]

writes results/study_derivatives.json and the table in docs/studies.md. Three ways to the same columns:

- the loop: the points one after the other in this process, each a solve with its tangents (what a study did before it
  had a batch, and still does below a force error of 0.05 %), features and their derivatives on the host;
- the batch: the study's blocks one after the other in this process; CPU seconds of both, in turns, are compared;
- the study as a user runs it, on all cores: wall seconds between its first and last blocks, against the loop's wall
  seconds; it means something on a machine that has nothing else to do (the load is kept beside it).

Everything is compiled before it is timed. The largest difference of a column between loop and batch is kept, too.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import numpy as np

from bcfj_jax.analysis.derivatives import batch as derivatives
from bcfj_jax.analysis.studies import api, block
from bcfj_jax.analysis.studies.specification import Study, from_table
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import ROOT, load, markdown, put_in_readme, save

CACHE = ROOT / "build" / "jax-cache"
ROUNDS = 3
# The motion of the steady study has forgotten its start by then [s].
SETTLED = 0.5


def cases(points: int) -> dict[str, dict[str, Any]]:
    """Study tables by name."""
    joint = {"lower": 1e-5, "upper": 1e-4, "steps": points, "scale": "log"}
    return {
        "impact, 0.3 ms": {
            "scene": {"scene": {"kind": "impact"}, "time": {"end": 3e-4, "samples": 301}},
            "vary": {"approach_speed": {"lower": 0.5, "upper": 2.0, "steps": points}},
            "results": {"features": ["contact.peak", "contact.impulse"], "derivatives": ["stiffness", "damping"]},
        },
        "slider-crank with friction, one turn": {
            "scene": {"scene": {"kind": "slider_crank", "friction": True}, "time": {"end": 0.012, "samples": 301}},
            "vary": {"clearance_journal": {"lower": 1e-4, "upper": 1e-3, "steps": points, "scale": "log"}},
            "results": {
                "features": ["journal.peak", "journal.mean"],
                "derivatives": ["stiffness", "clearance_journal"],
            },
        },
        "joint in equilibrium, 13 instants": {
            "scene": {
                "scene": {"kind": "joint", "fidelity": "quasistatic", **PLAIN},
                "time": {"end": 0.1, "samples": 13},
                "parameters": {"load_ramp": 1e-6},
            },
            "vary": {"clearance_seat_cage": joint},
            "results": {
                "features": ["seat_ball.peak", "cage_ball.peak"],
                "derivatives": ["stiffness", "clearance_seat_cage"],
            },
        },
        "joint, 0.2 s": {
            "scene": {"scene": {"kind": "joint", **PLAIN}, "time": {"end": 0.2, "samples": 301}},
            "vary": {"clearance_seat_cage": joint},
            "results": {
                "features": ["seat_cage.peak", "seat_ball.peak"],
                "derivatives": ["stiffness", "clearance_seat_cage"],
            },
        },
    }


def clocked(task: Callable[[], Any]) -> tuple[float, float, Any]:
    """CPU and wall seconds of this process, and what the task gave."""
    cpu, wall = time.process_time(), time.perf_counter()
    found = task()
    return time.process_time() - cpu, time.perf_counter() - wall, found


def one_by_one(study: Study, at: np.ndarray) -> np.ndarray:
    """Columns of some points, each by itself: the study as it is where no batch is possible."""
    possible = derivatives.possible
    derivatives.possible = lambda *_: False
    try:
        return block.compute(study, at, len(at)).results
    finally:
        derivatives.possible = possible


def compared(study: Study, singles: int) -> dict[str, Any]:
    """Loop and batch in this process, in turns."""
    blocks = block.Blocks(study)
    some = np.linspace(0, study.count - 1, singles).astype(int)
    compiling = [clocked(lambda: one_by_one(study, some[:1]))[1]]
    compiling.append(clocked(lambda: block.compute(study, blocks.points(0), blocks.size))[1])
    loop, batch, columns, tables = [], [], np.zeros(0), []
    for _ in range(ROUNDS):
        cpu, wall, columns = clocked(lambda: one_by_one(study, some))
        loop.append((cpu / singles, wall / singles))
        cpu, wall, tables = clocked(
            lambda: [block.compute(study, blocks.points(k), blocks.size) for k in range(len(blocks))]
        )
        batch.append((cpu / study.count, wall / study.count))
    point = np.concatenate([table.point for table in tables])
    results = np.concatenate([table.results for table in tables])[np.argsort(point)]
    largest = np.nanmax(np.abs(columns), axis=0)
    off = np.nanmax(np.abs(results[some] - columns), axis=0) / np.where(largest == 0.0, 1.0, largest)
    loop_cpu, loop_wall = np.median(loop, axis=0)
    batch_cpu, batch_wall = np.median(batch, axis=0)
    steps = np.concatenate([table.steps for table in tables])
    slots = sum(table.rounds for table in tables) * min(blocks.size, derivatives.places())
    return {
        "points": study.count, "block": blocks.size, "failed": sum(s != "ok" for t in tables for s in t.status),
        "loop_cpu_s": loop_cpu, "loop_wall_s": loop_wall, "batch_cpu_s": batch_cpu, "batch_wall_s": batch_wall,
        "cpu_ratio": loop_cpu / batch_cpu, "wall_ratio": loop_wall / batch_wall,
        "steps": float(steps.mean()), "slots_at_work": float(steps.sum() / slots) if slots else None,
        "first_s": compiling, "load": os.getloadavg()[0],
        "off": dict(zip(study.columns, off.tolist(), strict=True)),
    }  # fmt: skip


def whole(table: dict[str, Any], loop_wall: float) -> dict[str, Any]:
    """The study on all cores, twice: the second time its programs are kept."""
    found: dict[str, Any] = {}
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            seen: list[tuple[float, int]] = []
            begin = time.perf_counter()
            study = from_table(table)
            size, total = block.Blocks(study).size, len(block.Blocks(study))
            api.study(table, Path(folder) / "out", progress=lambda done, _: seen.append((time.perf_counter(), done)))  # noqa: B023  # fmt: skip
            first, before = next((at, done) for at, done in seen if done >= 2)
            last = next(at for at, done in seen if done == total)
            each = (last - first) / ((total - before) * size) if total > before else float("nan")
            found = {
                "whole_s": time.perf_counter() - begin, "blocks": total, "wall_s": each, "over_loop": loop_wall / each
            }  # fmt: skip
    return found


def steady(points: int) -> dict[str, Any]:
    """Points of steady motion, each with two derivatives; seconds by part."""
    table = {
        "scene": {"scene": {"kind": "joint", **PLAIN}, "time": {"end": SETTLED, "samples": 3}},
        "vary": {"clearance_seat_cage": {"lower": 4e-5, "upper": 6e-5, "steps": points}},
        "results": {
            "features": ["seat_ball.mean", "seat_cage.mean"], "derivatives": ["stiffness", "contact_angle"],
            "steady": True,
        },
    }  # fmt: skip
    study = from_table(table)
    blocks = block.Blocks(study)
    block.compute(study, blocks.points(0), blocks.size)
    cpu, wall, tables = clocked(
        lambda: [block.compute(study, blocks.points(k), blocks.size) for k in range(len(blocks))]
    )
    return {
        "points": points, "cpu_s": cpu / points, "wall_s": wall / points,
        "failed": [reason for table in tables for reason in table.reason if reason],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=256)
    parser.add_argument("--singles", type=int, default=16)
    parser.add_argument("--steady", type=int, default=4)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    os.environ["BCFJ_CACHE"] = str(CACHE)
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    content: dict[str, Any] = {"cases": {}}
    if given.only:
        kept = load("study_derivatives")
        content = {"cases": kept["cases"], "steady": kept["steady"]}
    for name, table in cases(given.points).items():
        if not name.startswith(given.only):
            continue
        found = compared(from_table(table), given.singles)
        print(name, json.dumps(found, indent=1), flush=True)
        # Blocks that end at once tell nothing of the time between them.
        long = found["batch_wall_s"] * found["block"] > 0.2
        found["study"] = whole(table, found["loop_wall_s"]) if long else None
        print(name, json.dumps(found["study"], indent=1), flush=True)
        content["cases"][name] = found
    if not given.only or given.only == "steady":
        content["steady"] = steady(given.steady)
        print("steady", content["steady"], flush=True)
    save("study_derivatives", content)
    told(content)


def told(content: dict[str, Any]) -> None:
    """Put the table into docs/studies.md."""
    ways = ["loop, CPU ms a point", "batch", "ratio", "study on two cores, wall"]
    rows = [["study of 256 points", *ways, "largest difference of a derivative"]]
    for name, one in content["cases"].items():
        off = max(x for column, x in one["off"].items() if column.startswith("d("))
        ways = [f"{1e3 * one[way]:.3g}" for way in ("loop_cpu_s", "batch_cpu_s")]
        study = f"**{one['study']['over_loop']:.1f}**" if one["study"] else ""
        rows.append([name, *ways, f"**{one['cpu_ratio']:.1f}**", study, f"{off:.0e}"])
    put_in_readme("study_derivatives", markdown(rows), "docs/studies.md")


if __name__ == "__main__":
    main()
