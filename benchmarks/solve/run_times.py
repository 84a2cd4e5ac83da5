"""Run times of compiled programs in two checkouts, in turn: the joint, its Jacobian, batches, and three mechanisms.

A change of how programs are made must not make them slower. Each round is a fresh process in either checkout; a figure is
the least of some runs in a process, then the median over the rounds.

    python -m benchmarks.solve.run_times OTHER    OTHER: folder of an older checkout; keeps run_times.json, docs/waiting.md
    ... OTHER --values                            without derivatives; keeps run_times_values.json, no page
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

RUNS, ROUNDS, LANES = 5, 3, 64
_EIGHT = (
    "stiffness", "exponent", "damping", "friction_static", "friction_dynamic", "clearance_seat_cage",
    "clearance_seat_ball", "contact_angle",
)  # fmt: skip


def worker(derivatives: bool) -> dict[str, float]:
    """One process, with the package of its checkout."""
    import numpy as np

    import bcfj_jax as bj

    import jax  # isort: skip

    def quickest(run: Any) -> float:
        run()
        walls = []
        # Short runs many times: their least is what a busy machine leaves alone.
        while len(walls) < RUNS or sum(walls) < 0.5:
            begin = time.perf_counter()
            run()
            walls.append(time.perf_counter() - begin)
        return min(walls)

    found = {}
    scene, t = bj.scenes.joint_of_keys(spin=False, window_ends=False, bands=False), np.linspace(0.0, 0.1, 101)
    params = scene.parameters()
    forces = jax.jit(lambda p: bj.force_history(scene, p, t))
    found["joint, 0.1 s"] = quickest(lambda: jax.block_until_ready(forces(params)))
    if derivatives:
        slopes = [bj.sensitivity(scene, params, t, _EIGHT, certify=False) for _ in range(1 + RUNS)]
        found["joint, 0.1 s, Jacobian of 8"] = min(s.stats["wall_s"] for s in slopes[1:])
    short = np.linspace(0.0, 0.02, 21)
    for name, times in (("joint", short), ("slider_crank", np.linspace(0.0, 0.012, 101))):
        one = getattr(bj.scenes, name)()
        at = one.parameters()
        moved = {k: np.repeat(np.asarray(v), LANES) for k, v in at.items()}
        moved["stiffness"] = moved["stiffness"] * np.linspace(0.9, 1.1, LANES)
        batch = jax.jit(jax.vmap(lambda p, one=one, times=times: bj.force_history(one, p, times)))
        found[f"{name}, batch of {LANES}"] = quickest(
            lambda batch=batch, moved=moved: jax.block_until_ready(batch(moved))
        )
    for name, end in (("impact", 5e-5), ("bounce", 0.5), ("slider_crank", 0.012), ("four_bar", 0.1)):
        one = getattr(bj.scenes, name)()
        at, times = one.parameters(), np.linspace(0.0, end, 400)
        run = jax.jit(lambda p, one=one, times=times: bj.force_history(one, p, times))
        found[name] = quickest(lambda run=run, at=at: jax.block_until_ready(run(at)))
    return found


def main() -> None:
    # A worker has the package of its checkout, whose benchmarks may be others.
    from benchmarks.common import ROOT, options, publish, save, table
    from benchmarks.processes import call, commit

    given = options(__doc__, {"other": Path}, values=False)
    sides = {"before": given.other.resolve(), "after": ROOT}
    variables = {"EQX_ON_ERROR": "nan", "BCFJ_CACHE": "off"}
    rounds = [
        {
            side: call(__file__, "worker", not given.values, variables=variables, checkout=path)
            for side, path in sides.items()
        }
        for _ in range(ROUNDS)
    ]
    runs = {
        name: {side: statistics.median(r[side][name] for r in rounds) for side in sides} for name in rounds[0]["after"]
    }
    name = "run_times_values" if given.values else "run_times"
    save(name, {"before": commit(sides["before"]), "rounds": ROUNDS, "runs": runs})
    times = {side: lambda row, side=side: f"{1e3 * row[side]:.3g} ms" for side in sides}
    ratio = {"before over after": lambda row: f"{row['before'] / row['after']:.2f}"}
    text = table({"": "{name}", **times, **ratio}, ({"name": name, **row} for name, row in runs.items()))
    print(text) if given.values else publish("run-times", text, "docs/waiting.md")


if __name__ == "__main__":
    main()
