"""Mechanisms with friction by an explicit and by an implicit solver: error and time of each (``mechanism.stiff``).

Each solver runs at the tolerance that the package takes for the error asked for. The error is the rms of the first
contact's force over its peak, against Tsit5 at 1e-7. Medians of runs that take turns in one process.

    python -m benchmarks.solve.friction            measures, keeps benchmarks/results/friction.json
"""

from __future__ import annotations

import statistics
from typing import Any

import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from benchmarks.common import save

# Scene and end [s].
SCENES = {"oblique_impact": 2e-5, "slider_guide": 0.012, "four_bar": 0.2, "slider_crank": 0.012}
ASKED, RUNS, SAMPLES = (1e-2, 1e-3), 5, 1500


def measured(name: str, end: float) -> dict[str, Any]:
    """Errors [-] and times [s] by error asked for and solver."""
    scene = getattr(bj.scenes, name)(friction=True)
    params, times = scene.parameters(), np.linspace(0.0, end, SAMPLES)
    contact = scene.contacts[0].name
    truth = bj.simulate(scene, params, times, accuracy=1e-7, solver="tsit5").force[contact]
    found: dict[str, Any] = {}
    for asked in ASKED:
        runs: dict[str, list[Any]] = {"tsit5": [], "rodas3": []}
        for _ in range(RUNS + 1):
            for solver, kept in runs.items():
                kept.append(bj.simulate(scene, params, times, accuracy=asked, solver=solver))
        found[f"{asked:g}"] = {
            solver: {
                "error": float(np.sqrt(np.mean((kept[0].force[contact] - truth) ** 2)) / np.abs(truth).max()),
                "steps": kept[0].stats["accepted"],
                "run_s": statistics.median(run.stats["wall_s"] for run in kept[1:]),
            }
            for solver, kept in runs.items()
        }
    return found


def table(result: dict[str, Any]) -> str:
    """Both solvers side by side; above 1, the explicit one is faster."""
    rows = [{"name": name, "asked": asked, **row} for name, found in result.items() for asked, row in found.items()]
    error = lambda s: (f"{s}: error", f"{{{s}[error]:.1e}}")  # noqa: E731
    run = lambda s: ("time", lambda r: f"{r[s]['run_s'] * 1e3:.2f} ms")  # noqa: E731
    solvers = [part(s) for s in ("tsit5", "rodas3") for part in (error, run)]
    ratio = lambda r: f"{r['rodas3']['run_s'] / r['tsit5']['run_s']:.1f}"  # noqa: E731
    return harness.table([("scene", "`{name}`"), ("asked", "{asked}"), *solvers, ("rodas3 over tsit5", ratio)], rows)


def main() -> None:
    result = {name: measured(name, end) for name, end in SCENES.items()}
    save("friction", {"scenes": result})
    print(table(result))


if __name__ == "__main__":
    main()
