"""A fit of 200 starts, cut off by Ctrl-C or kill -9 at random moments, gone on with, and compared with the uncut one.

python -m benchmarks.calibration.interruptions [TIMES] [--starts N]    writes results/interruptions.json, docs/fits_measured.md
"""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.io.journal import NAME
from benchmarks.calibration.trap import FREE, GRAVITY, HEIGHT, MASS, record
from benchmarks.common import ROOT, options, publish, save
from benchmarks.processes import start as started

CONTACTS, NOISE, SEED = 2, 0.01, 0


def write_problem(folder: Path) -> Path:
    """A calibration file and its data: a mass that bounces twice, integrated by SciPy, with noise."""
    times, force = record(CONTACTS, "scipy")
    sigma = NOISE * force.max()
    noisy = force + sigma * np.random.default_rng(SEED).standard_normal(times.size)
    rows = "".join(f"{t!r},{f!r}\n" for t, f in zip(times.tolist(), noisy.tolist(), strict=True))
    (folder / "drop.csv").write_text(f"time [s],force [N]\n{rows}")
    free = "".join(f"[free.{f.name}]\nlower = {f.lower}\nupper = {f.upper}\n" for f in FREE)
    known = f'mass = "{MASS} kg", drop_height = "{HEIGHT} m", gravity = "{GRAVITY} m/s^2"'
    path = folder / "drop.toml"
    path.write_text(
        'scene = "bounce"\n[[experiment]]\nfile = "drop.csv"\ntime = "time [s]"\n'
        f'observe = {{ "contact.normal" = "force [N]" }}\nnoise = "{sigma:.6g} N"\nparameters = {{ {known} }}\n{free}'
    )
    return path


def begin(problem: Path, out: Path, starts: int) -> subprocess.Popen[str]:
    """The command as a user runs it."""
    words = ["calibrate", str(problem), "--out", str(out), "--starts", str(starts)]
    return started(words, ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def fitted(out: Path) -> dict[str, Any]:
    """``fit.json`` without the wall time."""
    found = json.loads((out / "fit.json").read_text())
    found.pop("wall_s")
    return found


def whole_lines(path: Path) -> bytes:
    """A journal's finished lines."""
    content = path.read_bytes() if path.exists() else b""
    return content[: content.rfind(b"\n") + 1]


def cut_and_go_on(problem: Path, out: Path, starts: int, how: signal.Signals, moment: float) -> dict[str, Any]:
    """Cut one run off after some seconds, go on to the end; what was kept and how long the rest took."""
    job = begin(problem, out, starts)
    time.sleep(moment)
    job.send_signal(how)
    code = job.wait()
    kept = whole_lines(out / NAME)
    again = begin(problem, out, starts)
    preserved = True
    start = time.perf_counter()
    while again.poll() is None:
        # The journal goes with the last file; until then it holds all that was finished before.
        preserved &= not (out / NAME).exists() or (out / NAME).stat().st_size >= len(kept)
        time.sleep(0.02)
    return {
        "signal": how.name, "moment_s": moment, "exit": code, "batches_kept": max(kept.count(b"\n") - 1, 0),
        "nothing_lost": bool(preserved), "exit_after": again.returncode, "rest_s": time.perf_counter() - start,
    }  # fmt: skip


def main() -> None:
    """Cut off at random moments and compare."""
    given = options(__doc__, {"times": 20}, starts=200)
    rng, rows = np.random.default_rng(SEED), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        problem = write_problem(folder)
        begin(problem, folder / "warm", given.starts).wait()  # compiles
        start = time.perf_counter()
        code = begin(problem, folder / "straight", given.starts).wait()
        seconds, straight = time.perf_counter() - start, fitted(folder / "straight")
        for k in range(given.times):
            how = (signal.SIGKILL, signal.SIGINT)[k % 2]
            out = folder / f"cut {k}"
            row = cut_and_go_on(problem, out, given.starts, how, float(rng.uniform(0.1, 0.95)) * seconds)
            rows.append({**row, "equal": fitted(out) == straight})
            print(rows[-1], flush=True)
    good = sum(r["equal"] and r["nothing_lost"] and r["exit_after"] == code for r in rows)
    save("interruptions", {"starts": given.starts, "straight_s": seconds, "exit": code, "good": good, "cuts": rows})
    sentence = f"{good} of {len(rows)}: nothing that was finished is lost, and the result equals that of the uncut run."
    publish("interruptions", sentence, "docs/fits_measured.md")


if __name__ == "__main__":
    main()
