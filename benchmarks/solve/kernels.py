"""What two options of XLA change (``bcfj_jax.core.backend``): run time, compile time and forces, with and without.

Each scene runs in fresh processes that differ in these options alone, in turn; medians over the processes.

    python -m benchmarks.solve.kernels            measures, keeps benchmarks/results/kernels.json and docs/waiting.md
    python -m benchmarks.solve.kernels --worker   (internal) one process: all scenes
"""

from __future__ import annotations

import base64
import json
import os
import statistics
import subprocess
import sys
from typing import Any

import numpy as np

from benchmarks.common import ROOT, markdown, put_in_readme, save

LOOPS, WRITER = "xla_cpu_small_while_loop_byte_threshold", "xla_cpu_disable_new_fusion_emitters"
# As XLA comes; loops as single kernels; and kernels by the older writer, which is what the package sets.
OPTIONS = {"without": f"{LOOPS}=1024", "loops": f"{LOOPS}={1 << 20}", "with": f"{LOOPS}={1 << 20},{WRITER}"}
PROCESSES, RUNS = 2, 9
# Scene and end [s]; forces at 400 times are compared.
SCENES = {
    "impact": 5e-5, "bounce": 0.2, "chain": 1e-4, "slider_crank": 0.012, "slider_guide": 0.012, "four_bar": 0.1,
    "backlash": 0.1, "oblique_impact": 2e-5, "joint": 0.1,
}  # fmt: skip


def worker() -> None:
    import bcfj_jax as bj

    found = {}
    for name, end in SCENES.items():
        scene = getattr(bj.scenes, name)()
        params, times = scene.parameters(), np.linspace(0.0, end, 400)
        first = bj.simulate(scene, params, times)
        walls = [bj.simulate(scene, params, times).stats["wall_s"] for _ in range(RUNS)]
        forces = np.concatenate([f.ravel() for f in first.force.values()])
        found[name] = {
            "run_s": statistics.median(walls),
            "compile_s": first.stats["compile_s"],
            "status": first.status,
            "forces": base64.b64encode(np.nan_to_num(forces).tobytes()).decode(),
        }
    print(json.dumps(found))


def one_process(options: str) -> dict[str, Any]:
    surroundings = {**os.environ, "XLA_FLAGS": f"--xla_backend_extra_options={options}", "EQX_ON_ERROR": "nan"}
    command = [sys.executable, "-m", "benchmarks.solve.kernels", "--worker"]
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True, cwd=ROOT)
    return json.loads(done.stdout.splitlines()[-1])


def forces(row: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(row["forces"]))


def main() -> None:
    rounds = [{name: one_process(options) for name, options in OPTIONS.items()} for _ in range(PROCESSES)]
    result: dict[str, Any] = {}
    for scene in SCENES:
        before, after = (forces(rounds[0][side][scene]) for side in ("without", "with"))
        off, peak = np.abs(after - before).max(), np.abs(before).max()
        row: dict[str, Any] = {"force_difference": float(off / peak) if off else 0.0}
        for key in ("run_s", "compile_s"):
            for side in OPTIONS:
                row[f"{key}_{side}"] = statistics.median(r[side][scene][key] for r in rounds)
        result[scene] = {**row, "status": rounds[0]["with"][scene]["status"]}
    save("kernels", {"processes": PROCESSES, "scenes": result})
    put_in_readme("kernels", table(result), "docs/waiting.md")
    print(table(result))


def table(result: dict[str, Any]) -> str:
    """Ratios of XLA as it comes to each side: above 1, the side is faster."""
    rows = [
        [
            "scene",
            "run: loops",
            "run: both",
            "compile: loops",
            "compile: both",
            "largest difference of a force, of the peak",
        ]
    ]
    for name, r in result.items():
        ratios = [
            f"{r[f'{key}_without'] / r[f'{key}_{side}']:.2f}"
            for key in ("run_s", "compile_s")
            for side in ("loops", "with")
        ]
        rows.append([f"`{name}`", *ratios, f"{r['force_difference']:.1e}"])
    return markdown(rows)


if __name__ == "__main__":
    worker() if "--worker" in sys.argv else main()
