"""Cold and warm times of simulate and calibrate, compile apart from run.

Three situations, each in fresh processes: nothing cached; the persistent cache filled; and, in one process, a
second call with new parameter values. Medians of several repetitions.

    python -m benchmarks.solve.times            measures, keeps benchmarks/results/times.json, and docs/accuracy.md
    python -m benchmarks.solve.times --worker   (internal) one process
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

from benchmarks.common import ROOT, load, markdown, put_in_readme, save

PROCESSES, WARM_CALLS = 3, 20


def worker() -> None:
    begin = time.perf_counter()
    os.environ["EQX_ON_ERROR"] = "nan"
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
        again = bj.simulate(file.scene, params, file.times, accuracy=file.accuracy)
        runs.append(again.stats["wall_s"])
    problem = calibration.load(ROOT / "examples" / "chung_ooi_fit.toml")
    start = time.perf_counter()
    calibration.fit(problem, seed=0)
    fitted = time.perf_counter()
    refits = []
    for seed in (1, 2, 3):
        begin_fit = time.perf_counter()
        calibration.fit(problem, seed=seed)
        refits.append(time.perf_counter() - begin_fit)
    result = {
        "import_s": imported - begin,
        "load_s": loaded - imported,
        "simulate_compile_s": first.stats["compile_s"],
        "simulate_run_s": statistics.median(runs),
        "fit_first_s": fitted - start,
        "fit_again_s": statistics.median(refits),
    }
    print(json.dumps(result))


def one_process(cache: str) -> dict[str, Any]:
    environment = {**os.environ, "BCFJ_CACHE": cache}
    command = [sys.executable, __file__, "--worker"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, cwd=ROOT)
    return json.loads(done.stdout.splitlines()[-1])


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
            cold.append(one_process(cache))
            cached.append(one_process(cache))
    save("times", {"cold": median(cold), "cached": median(cached), "processes": PROCESSES})
    put_in_readme("times", table(load("times")), "docs/accuracy.md")
    print(table(load("times")))


if __name__ == "__main__":
    worker() if "--worker" in sys.argv else main()
