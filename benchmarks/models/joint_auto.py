"""Does ``fidelity = "auto"`` keep its budget, and what does it save? Random joints, beside the dynamic model.

    python -m benchmarks.models.joint_auto [--joints 100] [--seed 2025] [--budget 0.01] [--friction 1] [--plain] [--name NAME]

Every joint is drawn by ``random_scenes.joint``. Wanted is the last revolution before 3 s, the scene's own horizon, at
180 angles. The error is that of a budget: of each contact the rms difference of normal forces from the dynamic model's
at the same accuracy, its worst member's, over the contact's peak; the worst contact counts. Joints whose dynamic model
does not finish in ``STEPS`` steps have no truth: they are counted, and others drawn in their place. Both programs are
compiled before; seconds are the process's own, as other work shares the machine. ``--friction`` is a factor on both
coefficients; ``--plain`` takes joints without rolling balls, window ends and bands. The factors in
``bcfj_jax/models/joint/fidelity.py`` were found with other seeds.
"""

from __future__ import annotations

import os
import sys
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import numpy as np

import bcfj_jax as bj
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.clock import clocked
from benchmarks.common import markdown, options, save, tally
from benchmarks.solve.random_scenes import BY_DECADES, EVENLY, joint

END, ANGLES, STEPS = 3.0, 180, 20_000


def window(params: Params) -> np.ndarray:
    """Times of the last revolution before ``END`` [s]."""
    turn = 2.0 * np.pi / float(params["drive_speed"])
    return END - turn + turn * np.arange(1, ANGLES + 1) / ANGLES


def timed(scene: Any, params: Params, budget: float) -> tuple[Any, float]:
    """A run, and the seconds of this process that it took, compilation apart (a first run compiles)."""

    def run() -> Any:
        return bj.simulate(scene, params, window(params), accuracy=budget, max_steps=STEPS)

    found, took = clocked(run)
    if found.stats["compile_s"] > 0.1:
        found, took = clocked(run)
    return found, took["cpu_s"]


def error(found: Any, truth: Any) -> float:
    """The error that a budget is about."""
    worst = 0.0
    for name, force in truth.force.items():
        normal = force[..., 0]
        off = np.sqrt(np.mean((found.force[name][..., 0] - normal) ** 2, axis=0)).max()
        worst = max(worst, float(off / np.abs(normal).max()))
    return worst


def measured(
    count: int, seed: int, budget: float, friction: float, options: dict[str, Any]
) -> tuple[list[dict[str, Any]], int]:
    """A row a joint, and how many the dynamic model did not finish."""
    adaptive, motion = bj.scenes.joint_of_keys(fidelity="auto", **options), bj.scenes.joint_of_keys(**options)
    rng = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    unfinished = 0
    while len(rows) < count:
        params = joint(rng, friction, motion)
        truth, full = timed(motion, params, budget)
        if truth.status != "ok":
            unfinished += 1
            continue
        found, spent = timed(adaptive, params, budget)
        steps = [run.stats["accepted"] + run.stats["rejected"] for run in (found, truth)]
        row = {"fidelity": found.choice.fidelity, "estimates": found.choice.errors, "error": error(found, truth)}
        rows.append(row | {"auto_s": spent, "dynamic_s": full, "auto_steps": steps[0], "dynamic_steps": steps[1]})
        print(len(rows), unfinished, rows[-1], file=sys.stderr, flush=True)
    return rows, unfinished


def summed(rows: list[dict[str, Any]], budget: float) -> dict[str, Any]:
    """Counts and ratios over the joints."""
    ratios = np.array([row["dynamic_s"] / row["auto_s"] for row in rows])

    errors = [row["error"] for row in rows]
    low, high = np.quantile(np.random.default_rng(0).choice(ratios, (2000, ratios.size)).mean(axis=1), [0.025, 0.975])
    return {
        "joints": len(rows),
        "within_budget": sum(e <= budget for e in errors),
        "largest_error": max(errors),
        "median_error": float(np.median(errors)),
        "rungs": tally(row["fidelity"] for row in rows),
        "speed_up_mean": float(ratios.mean()),
        "speed_up_mean_95": [float(low), float(high)],
        "speed_up_median": float(np.median(ratios)),
        "speed_up_of_the_sums": sum(r["dynamic_s"] for r in rows) / sum(r["auto_s"] for r in rows),
        "speed_up_least": float(ratios.min()),
    }


def main() -> None:
    given = options(__doc__, joints=100, seed=2025, budget=0.01, friction=1.0, plain=False, name="joint_auto")
    plain = PLAIN if given.plain else {}
    rows, unfinished = measured(given.joints, given.seed, given.budget, given.friction, plain)
    total = summed(rows, given.budget)
    save(given.name, {
        "end_s": END, "angles": ANGLES, "max_steps": STEPS, "seed": given.seed, "budget": given.budget, **plain,
        "box": {"logarithmic": BY_DECADES, "even": EVENLY, "friction": given.friction}, "unfinished": unfinished,
        "summary": total, "joints": rows,
    })  # fmt: skip
    print(markdown([["", ""], *([name.replace("_", " "), value] for name, value in total.items())]))


if __name__ == "__main__":
    main()
