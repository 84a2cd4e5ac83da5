"""How many points a second a study computes, against single runs: one process in a loop, and a pool of two.

    python -m benchmarks.analysis.study [--points 256] [--singles 12] [--static 20000]
writes results/study.json and the table in docs/studies.md. Side by side in one run, compiled programs kept:

- the dynamic joint, clearances of the seat's pilot over a decade, 0.6 s, 601 samples, at ``balanced``;
- the same against the slots of a batch (with one core), also as docs/images/study_slots.png;
- a bounce whose points cost up to ten times as much as others: the share of slots at work;
- the quasistatic joint at 13 instants of a ball's pitch under full load.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax import scenes, simulate
from bcfj_jax.analysis.derivatives import batch as derivatives
from bcfj_jax.analysis.derivatives.names import feature
from bcfj_jax.analysis.studies import api, batch
from bcfj_jax.analysis.studies.block import Blocks
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.analysis.studies.store import facts_of
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import plan
from benchmarks.clock import clocked, keep_programs, on_core, pool
from benchmarks.common import ROOT, drawing, markdown, options, publish, save

TIMES = np.linspace(0.0, 0.6, 601)
LOW, HIGH = 1e-5, 1e-4
FEATURES = ["seat_cage.peak", "seat_ball.peak"]


# Of equilibria one ball's pitch at 100 r/min, after the ramp of the load.
PITCH: dict[str, Any] = {"time": {"end": 0.1, "samples": 13}, "parameters": {"load_ramp": 1e-6}}
STILL = ["seat_ball.peak", "cage_ball.peak"]


def clearances(
    points: int, options: dict[str, Any], features: list[str], derivatives: list[str] | None = None, **scene: Any
) -> dict[str, Any]:
    """A study of clearances of the joint's seat pilot over a decade."""
    return {
        "scene": {"scene": {"kind": "joint", **options}, **scene},
        "vary": {"clearance_seat_cage": {"lower": LOW, "upper": HIGH, "steps": points, "scale": "log"}},
        "results": {"features": features, **({"derivatives": derivatives} if derivatives else {})},
    }


def dynamic(points: int) -> dict[str, Any]:
    return clearances(points, PLAIN, FEATURES, time={"end": 0.6, "samples": 601})


def static(points: int) -> dict[str, Any]:
    return clearances(points, {"fidelity": "quasistatic", **PLAIN}, STILL, **PITCH)


def kept() -> None:
    """Keep compiled programs, here and in workers."""
    os.environ["BCFJ_CACHE"] = str(ROOT / "build" / "jax-cache")
    keep_programs(0.2)


def singles(task: tuple[list[float], int]) -> float:
    """Wall seconds of single runs one after the other, compiling left out."""
    clearances, core = task
    kept()
    on_core(core)
    scene = scenes.joint_of_keys(**PLAIN)
    simulate(scene, scene.parameters(), TIMES)
    every = [scene.parameters(clearance_seat_cage=clearance) for clearance in clearances]
    return clocked(lambda: [simulate(scene, params, TIMES) for params in every])[1]["wall_s"]


def watched(table: dict[str, Any], out: Path, **how: Any) -> tuple[Any, list[tuple[float, int]]]:
    """A study, and when [s] how many of its blocks were done."""
    seen: list[tuple[float, int]] = []
    found = api.study(table, out, progress=lambda done, _: seen.append((time.perf_counter(), done)), **how)
    return found, seen


def between(seen: list[tuple[float, int]], least: int, total: int) -> tuple[float, int]:
    """Seconds from when so many blocks were done to when all were, and how many blocks came between."""
    first, before = next((at, done) for at, done in seen if done >= least)
    return next(at for at, done in seen if done == total) - first, total - before


def study(table: dict[str, Any]) -> dict[str, Any]:
    """A study in a fresh folder, twice: the second time its programs are kept. Seconds between first and last block."""
    found: dict[str, Any] = {}
    threads, blocks = api.default_workers(), Blocks(from_table(table))
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            (result, seen), took = clocked(lambda out=out: watched(table, out))
            facts = [facts_of(p) for p in sorted((out / "blocks").glob("*.parquet"))]
            steps, rounds = sum(sum(f["steps"]) for f in facts), sum(f["rounds"] for f in facts)
            seconds, many = between(seen, threads, len(blocks))
            found = {
                "points": result.table.num_rows, "failed": result.failed, "whole_s": took["wall_s"], "blocks": len(blocks),
                "size": blocks.size, "rate": many * blocks.size / seconds,
                "efficiency": steps / (rounds * min(blocks.size, derivatives.places())) if rounds else None,
            }  # fmt: skip
    return found


def by_places(count: int) -> list[dict[str, float]]:
    """Points a second of one core against the number of slots."""
    scene, rows = scenes.joint_of_keys(**PLAIN), []
    params = {name: np.full(count, float(x)) for name, x in scene.parameters().items()}
    params["clearance_seat_cage"] = np.geomspace(LOW, HIGH, count)
    wanted = [feature(name, {"seat_cage": 0, "seat_ball": 6}) for name in FEATURES]
    given = derivatives.places
    for places in (1, 2, 4, 8, 16, 32, 64, 128):
        derivatives.places = lambda places=places: places
        # Another size for each: the program's key does not know the slots.
        args = (scene, batch.Points(params, np.full(count, 0.6), TIMES / 0.6), wanted, plan(scene), count + places)
        batch.run(*args)
        rows.append({"slots": places, "rate": count / clocked(lambda args=args: batch.run(*args))[1]["wall_s"]})
        print(rows[-1], flush=True)
    derivatives.places = given
    return rows


def drawn(rows: list[dict[str, float]]) -> None:
    slots = [r["slots"] for r in rows]
    with drawing("study_slots.png", (5.5, 3.4)) as axes:
        axes.plot(slots, [r["rate"] for r in rows], "o-")
        axes.set_xscale("log", base=2)
        axes.set_xticks(slots, [f"{one}" for one in slots])
        axes.set_ylim(0.0)
        axes.set(xlabel="slots of a batch", ylabel="joints of 0.6 s a second, one core")


def spread() -> dict[str, Any]:
    """A bounce whose points last 0.3 to 3 s."""
    scene, count = scenes.bounce(), 256
    params = {name: np.full(count, float(x)) for name, x in scene.parameters().items()}
    last = np.geomspace(3.0, 0.3, count)
    points = batch.Points(params, last, np.linspace(0, 1, 101))
    found = batch.run(scene, points, [feature("contact.peak", {"contact": 0})], plan(scene), count)
    share = float(found.steps.sum() / (found.rounds * derivatives.places()))
    return {"largest_over_least": float(found.steps.max() / found.steps.min()), "efficiency": share}


def main() -> None:
    given = options(__doc__, points=256, singles=12, static=20_000)
    kept()
    some = np.geomspace(LOW, HIGH, given.singles).tolist()
    with pool(2) as processes:
        list(processes.map(singles, [(some[:1], 0), (some[:1], 1)]))
        loop = [given.singles / processes.submit(singles, (some, 0)).result()]
        two = max(processes.map(singles, [(some[::2], 0), (some[1::2], 1)]))
        joint = study(dynamic(given.points))
        # The loop again: the machine may have changed in between.
        loop.append(given.singles / processes.submit(singles, (some, 0)).result())
    one, pair = float(np.mean(loop)), given.singles / two
    print("loop", loop, "pool", pair, "study", joint, flush=True)
    still = study(static(given.static))
    print("quasistatic", still, flush=True)
    on_core(0)
    wide, places = spread(), by_places(128)
    drawn(places)
    content = {
        "loop_points_s": loop, "pool_points_s": pair, "dynamic": joint, "over_loop": joint["rate"] / one,
        "over_pool": joint["rate"] / pair, "quasistatic": still, "spread": wide, "slots": places,
        "largest_worker_mb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
    }  # fmt: skip
    save("study", content)
    publish("study", text(content, given.points, given.static), "docs/studies.md")


def text(content: dict[str, Any], points: int, static: int) -> str:
    """What docs/studies.md shows."""
    one, pair = float(np.mean(content["loop_points_s"])), content["pool_points_s"]
    joint, still, wide, places = (content[key] for key in ("dynamic", "quasistatic", "spread", "slots"))
    rows = [
        ["what", "points a second", "against"],
        ["dynamic joint, 0.6 s, single runs in a loop", f"{one:.3g}", ""],
        ["the same, a pool of two processes", f"{pair:.3g}", f"{pair / one:.1f} times the loop"],
        [
            f"the same as a study of {points} clearances, 2 threads", f"{joint['rate']:.3g}",
            f"**{joint['rate'] / one:.1f} times the loop, {joint['rate'] / pair:.1f} times the pool**",
        ],
        [f"quasistatic joint, 13 instants, {static} points, 2 threads", f"{still['rate']:.4g}", ""],
    ]  # fmt: skip
    more = [["slots", *(r["slots"] for r in places)]]
    more.append(["points a second, one core", *(f"{r['rate']:.3g}" for r in places)])
    said = (
        f"Runs that cost up to {wide['largest_over_least']:.0f} times as much as others keep {wide['efficiency']:.0%} "
    )
    said += f"of the slots at work; those of the joint above {joint['efficiency']:.0%}."
    image = "![points a second against slots](images/study_slots.png)"
    return "\n\n".join((markdown(rows), markdown(more), image, said))


if __name__ == "__main__":
    main()
