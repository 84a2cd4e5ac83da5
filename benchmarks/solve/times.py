"""Cold and warm times of simulate and calibrate, compile apart from run.

Three situations, each in fresh processes: nothing cached; the persistent cache filled; and, in one process, a
second call with new parameter values. Medians of several repetitions.

    python -m benchmarks.solve.times            measures, keeps benchmarks/results/times.json, and docs/accuracy.md
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from typing import Any

from benchmarks.clock import clocked
from benchmarks.common import ROOT, load, markdown, publish, save
from benchmarks.processes import call

PROCESSES, WARM_CALLS = 3, 20


def worker() -> dict[str, float]:
    """One process."""
    begin = time.perf_counter()
    import jax

    jax.config.update("jax_compilation_cache_dir", os.environ["BCFJ_CACHE"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    import bcfj_jax as bj
    import calibration
    from bcfj_jax.io import scenefile

    imported = time.perf_counter()
    file = scenefile.load(ROOT / "examples" / "chung_ooi_test1.toml")
    loaded = time.perf_counter()
    first = bj.simulate(file.scene, file.params, file.times, accuracy=file.accuracy)
    runs = []
    for k in range(WARM_CALLS):
        params = {**file.params, "stiffness": file.params["stiffness"] * (1.0 + 1e-3 * (k + 1))}
        runs.append(bj.simulate(file.scene, params, file.times, accuracy=file.accuracy).stats["wall_s"])
    problem = calibration.load(ROOT / "examples" / "chung_ooi_fit.toml")
    fits = [clocked(lambda seed=seed: calibration.fit(problem, seed=seed))[1]["wall_s"] for seed in range(4)]
    return {
        "import_s": imported - begin, "load_s": loaded - imported, "simulate_compile_s": first.stats["compile_s"],
        "simulate_run_s": statistics.median(runs), "fit_first_s": fits[0], "fit_again_s": statistics.median(fits[1:]),
    }  # fmt: skip


def median(rows: list[dict[str, float]]) -> dict[str, float]:
    return {key: statistics.median(row[key] for row in rows) for key in rows[0]}


def table(result: dict[str, Any]) -> str:
    cold, cached = result["cold"], result["cached"]
    rows = [["", "nothing cached", "from the persistent cache", "same process again"]]
    names = {"import_s": "import", "simulate_compile_s": "`simulate`: compile"}
    rows += [[text, f"{cold[key]:.2f} s", f"{cached[key]:.2f} s", ""] for key, text in names.items()]
    rows.append(["`simulate`: run, 2001 samples", "", "", f"{cached['simulate_run_s'] * 1e3:.2f} ms"])
    fit = [f"{cold['fit_first_s']:.2f} s", f"{cached['fit_first_s']:.2f} s", f"{cached['fit_again_s']:.2f} s"]
    rows.append(["`calibration.fit`: 3 parameters, 24 samples, 12 starts", *fit])
    share = [f"{row['fit_first_s'] - row['fit_again_s']:.2f} s" for row in (cold, cached)]
    rows.append(["... of which compile", *share, "0 s"])
    return markdown(rows)


def main() -> None:
    cold, cached = [], []
    for _ in range(PROCESSES):
        with tempfile.TemporaryDirectory() as cache:
            for rows in (cold, cached):
                rows.append(call(__file__, "worker", variables={"BCFJ_CACHE": cache, "EQX_ON_ERROR": "nan"}))
    save("times", {"cold": median(cold), "cached": median(cached), "processes": PROCESSES})
    publish("times", table(load("times")), "docs/accuracy.md")


if __name__ == "__main__":
    main()
