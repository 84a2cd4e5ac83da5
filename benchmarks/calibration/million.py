"""How long does a record of a million samples take, from the file to a verdict, and how much memory?

    python -m benchmarks.calibration.million [--samples 1000000] [--keep]

One contact at 400 kHz, 2.5 s long, as a CSV file of 18 MB and as TDMS, through ``bcfj init calibration`` and ``bcfj calibrate``,
each a process of its own. With ``--keep`` the table is kept in ``benchmarks/results/million.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.calibration import instruments

# Step of the clock [s], noise [N], and how long after touch the force is computed [s].
STEP, NOISE, LONG = 2.5e-6, 2.0, 0.03


def record(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Clock (N,) [s] and force (N,) [N]: the contact of ``instruments`` in the middle, by SciPy."""
    from scipy.integrate import solve_ivp

    clock = STEP * np.arange(samples)
    after = clock - 0.5 * clock[-1]
    inside = (after >= 0.0) & (after < LONG)
    k, n, a, mass = instruments.STIFFNESS, instruments.EXPONENT, instruments.DAMPING, instruments.MASS

    def law(d: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.maximum(k * np.maximum(d, 0.0) ** n * (1.0 + a * v), 0.0)

    start = [0.0, instruments.SPEED]
    rates = lambda t, y: [y[1], -law(y[0], y[1]) / mass]  # noqa: E731
    run = solve_ivp(rates, (0.0, LONG), start, "DOP853", t_eval=after[inside], rtol=1e-10, atol=1e-13)
    force = np.zeros(samples)
    force[inside] = law(*run.y)
    return clock, force + NOISE * np.random.default_rng(7).standard_normal(samples)


def write(folder: Path, samples: int) -> dict[str, Path]:
    """The record as files, by their kind."""
    import nptdms

    clock, force = record(samples)
    csv, tdms = folder / "long.csv", folder / "long_tdms.tdms"
    with csv.open("w") as out:
        out.write("time [s],force [N]\n")
        out.writelines(f"{t:.7f},{f:.4f}\n" for t, f in zip(clock.tolist(), force.tolist(), strict=True))
    has = {"wf_increment": STEP, "wf_start_offset": 0.0, "wf_samples": samples, "unit_string": "N"}
    with nptdms.TdmsWriter(str(tdms)) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", "Force", force, properties=has)])
    return {"csv": csv, "tdms": tdms}


def timed(*command: str) -> tuple[int, float, float]:
    """Exit code, seconds of a core, and peak of memory [MB] of a command of the command line."""
    child = subprocess.Popen([sys.executable, "-m", "bcfj_jax", *command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    return child.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main() -> int:
    """Time both files, print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--keep", action="store_true")
    given, rows = parser.parse_args(), {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, path in write(folder, given.samples).items():
            problem, out = folder / f"{kind}.toml", folder / f"{kind}_fit"
            known = ("--mass", "0.8 kg", "--speed", "1.2 m/s", "--out", str(problem))
            first = timed("init", "calibration", str(path), *known)
            then = timed("calibrate", str(problem), "--out", str(out), "-q")
            fit = json.loads((out / "fit.json").read_text()) if (out / "fit.json").exists() else {}
            rows[kind] = {
                "megabytes": round(path.stat().st_size / 1e6, 1),
                "init": {"exit": first[0], "cpu_s": round(first[1], 1), "peak_mb": round(first[2])},
                "calibrate": {"exit": then[0], "cpu_s": round(then[1], 1), "peak_mb": round(then[2])},
                "verdict": fit.get("verdict"),
            }
            print(kind, rows[kind], flush=True)
    if given.keep:
        common.save("million", {"samples": given.samples, "files": rows})
    most = max(r[step]["peak_mb"] for r in rows.values() for step in ("init", "calibrate"))
    return int(most > 2048 or any(r["init"]["cpu_s"] + r["calibrate"]["cpu_s"] > 60 for r in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
