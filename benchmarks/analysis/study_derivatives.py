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

import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives import batch as derivatives
from bcfj_jax.analysis.studies import block
from bcfj_jax.analysis.studies.specification import Study, from_table
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.analysis.study import FEATURES, PITCH, STILL, between, clearances, kept, watched
from benchmarks.clock import clocked
from benchmarks.common import known, options, publish, save, table

ROUNDS = 3
# The motion of the steady study has forgotten its start by then [s].
SETTLED = 0.5


def cases(points: int) -> dict[str, dict[str, Any]]:
    """Study tables by name."""
    wrt = ["stiffness", "clearance_seat_cage"]
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
        "joint in equilibrium, 13 instants": clearances(
            points, {"fidelity": "quasistatic", **PLAIN}, STILL, wrt, **PITCH
        ),
        "joint, 0.2 s": clearances(points, PLAIN, FEATURES, wrt, time={"end": 0.2, "samples": 301}),
    }


def one_by_one(study: Study, at: np.ndarray) -> np.ndarray:
    """Columns of some points, each by itself: the study as it is where no batch is possible."""
    possible = derivatives.possible
    derivatives.possible = lambda *_: False
    try:
        return block.compute(study, at, len(at)).results
    finally:
        derivatives.possible = possible


def whole_batch(study: Study) -> tuple[list[Any], dict[str, float]]:
    """All blocks of a study, one after the other, and their seconds."""
    blocks = block.Blocks(study)
    return clocked(lambda: [block.compute(study, blocks.points(k), blocks.size) for k in range(len(blocks))])


def compared(study: Study, singles: int) -> dict[str, Any]:
    """Loop and batch in this process, in turns."""
    blocks = block.Blocks(study)
    some = np.linspace(0, study.count - 1, singles).astype(int)
    first = [clocked(lambda: one_by_one(study, some[:1]))[1]]
    first.append(clocked(lambda: block.compute(study, blocks.points(0), blocks.size))[1])
    loop, batch, columns, tables = [], [], np.zeros(0), []
    for _ in range(ROUNDS):
        columns, took = clocked(lambda: one_by_one(study, some))
        loop.append((took["cpu_s"] / singles, took["wall_s"] / singles))
        tables, took = whole_batch(study)
        batch.append((took["cpu_s"] / study.count, took["wall_s"] / study.count))
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
        "first_s": [took["wall_s"] for took in first], "load": os.getloadavg()[0],
        "off": dict(zip(study.columns, off.tolist(), strict=True)),
    }  # fmt: skip


def whole(table: dict[str, Any], loop_wall: float) -> dict[str, Any]:
    """The study on all cores, twice: the second time its programs are kept."""
    found: dict[str, Any] = {}
    blocks = block.Blocks(from_table(table))
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            (_, seen), took = clocked(lambda folder=folder: watched(table, Path(folder) / "out"))
            seconds, many = between(seen, 2, len(blocks))
            each = seconds / (many * blocks.size) if many else float("nan")
            found = {"whole_s": took["wall_s"], "blocks": len(blocks), "wall_s": each, "over_loop": loop_wall / each}
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
    tables, took = whole_batch(study)
    return {
        "points": points, "cpu_s": took["cpu_s"] / points, "wall_s": took["wall_s"] / points,
        "failed": [reason for table in tables for reason in table.reason if reason],
    }  # fmt: skip


def main() -> None:
    given = options(__doc__, points=256, singles=16, steady=4, only="")
    kept()
    content: dict[str, Any] = {"cases": {}} | (known("study_derivatives") if given.only else {})
    for name, one in cases(given.points).items():
        if not name.startswith(given.only):
            continue
        content["cases"][name] = found = compared(from_table(one), given.singles)
        # Blocks that end at once tell nothing of the time between them.
        long = found["batch_wall_s"] * found["block"] > 0.2
        found["study"] = whole(one, found["loop_wall_s"]) if long else None
        print(name, json.dumps(found, indent=1), flush=True)
    if not given.only or given.only == "steady":
        content["steady"] = steady(given.steady)
        print("steady", content["steady"], flush=True)
    save("study_derivatives", content)
    publish("study_derivatives", text(content), "docs/studies.md")


def text(content: dict[str, Any]) -> str:
    """The table of docs/studies.md."""
    return table({
        "study of 256 points": "{name}", "loop, CPU ms a point": lambda one: f"{1e3 * one['loop_cpu_s']:.3g}",
        "batch": lambda one: f"{1e3 * one['batch_cpu_s']:.3g}", "ratio": "**{cpu_ratio:.1f}**",
        "study on two cores, wall": lambda one: f"**{one['study']['over_loop']:.1f}**" if one["study"] else "",
        "largest difference of a derivative":
            lambda one: f"{max(x for column, x in one['off'].items() if column.startswith('d(')):.0e}",
    }, ({"name": name, **one} for name, one in content["cases"].items()))  # fmt: skip


if __name__ == "__main__":
    main()
