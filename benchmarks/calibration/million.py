"""How long does a record of a million samples take, from the file to a verdict, and how much memory?

    python -m benchmarks.calibration.million [--samples 1000000] [--keep]

One contact at 400 kHz, 2.5 s long, as a CSV file of 18 MB and as TDMS, through ``bcfj init calibration`` and ``bcfj calibrate``,
each a process of its own. With ``--keep`` the table is kept in ``benchmarks/results/million.json``.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import common
from benchmarks.calibration import instruments
from benchmarks.common import options
from benchmarks.processes import bcfj
from benchmarks.references.impact import contact

# Step of the clock [s], noise [N].
STEP, NOISE = 2.5e-6, 2.0


def record(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Clock (N,) [s] and force (N,) [N]: the contact of ``instruments`` in the middle, by SciPy."""
    clock = STEP * np.arange(samples)
    hit = contact(instruments.LAW, instruments.MASS, instruments.SPEED, begin=0.5 * float(clock[-1]))

    return clock, hit.force(clock) + NOISE * np.random.default_rng(7).standard_normal(samples)


def write(folder: Path, samples: int) -> dict[str, Path]:
    """The record as files, by their kind."""
    clock, force = record(samples)
    csv, tdms = folder / "long.csv", folder / "long_tdms.tdms"
    with csv.open("w") as out:
        out.write("time [s],force [N]\n")
        out.writelines(f"{t:.7f},{f:.4f}\n" for t, f in zip(clock.tolist(), force.tolist(), strict=True))
    has = {"wf_increment": STEP, "wf_start_offset": 0.0, "wf_samples": samples, "unit_string": "N"}
    tdms.write_bytes(instruments.tdms("rig", {"Force": (force, has)}))
    return {"csv": csv, "tdms": tdms}


def main() -> int:
    """Time both files, print and keep the table."""
    given, rows = options(__doc__, samples=1_000_000, keep=False), {}

    def row(*words: str) -> dict[str, Any]:
        done = bcfj(words, variables={"BCFJ_CACHE": os.environ.get("BCFJ_CACHE")})
        return {"exit": done.code, "cpu_s": round(done.cpu_s, 1), "peak_mb": round(done.peak_mb)}

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, path in write(folder, given.samples).items():
            problem, out = folder / f"{kind}.toml", folder / f"{kind}_fit"
            known = ("--mass", "0.8 kg", "--speed", "1.2 m/s", "--out", str(problem))
            rows[kind] = {
                "megabytes": round(path.stat().st_size / 1e6, 1),
                "init": row("init", "calibration", str(path), *known),
                "calibrate": row("calibrate", str(problem), "--out", str(out), "-q"),
            }  # fmt: skip
            fit = json.loads((out / "fit.json").read_text()) if (out / "fit.json").exists() else {}
            rows[kind]["verdict"] = fit.get("verdict")
            print(kind, rows[kind], flush=True)
    if given.keep:
        common.save("million", {"samples": given.samples, "files": rows})
    most = max(r[step]["peak_mb"] for r in rows.values() for step in ("init", "calibrate"))
    return int(most > 2048 or any(r["init"]["cpu_s"] + r["calibrate"]["cpu_s"] > 60 for r in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
