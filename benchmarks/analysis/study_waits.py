"""What a user waits for a study, from the command to its report: this checkout beside another.

    python -m benchmarks.analysis.study_waits --against DIR [--rounds 3] [--only NAME ...]
writes results/study_waits.json and the table in docs/studies.md. DIR is a checkout of an older commit; both run with this
Python, in turns, each with programs of its own, kept by a run before. Wall seconds, medians.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.io.outputs import write_toml
from benchmarks.common import ROOT, load, markdown, put_in_readme, save


def clearances(points: int, **scene: Any) -> dict[str, Any]:
    """Clearances of the joint's seat pilot over a decade."""
    return {
        "scene": {"scene": {"kind": "joint", **scene.pop("options", {})}, **scene},
        "vary": {"clearance_seat_cage": {"lower": 1e-5, "upper": 1e-4, "steps": points, "scale": "log"}},
        "results": {"features": ["seat_ball.peak", "cage_ball.peak"]},
    }


STUDIES: dict[str, dict[str, Any]] = {
    "joint, 0.6 s, 256 points": clearances(256, time={"end": 0.6, "samples": 601}),
    "joint, 0.1 s, 256 points": clearances(256, time={"end": 0.1, "samples": 101}),
    # One ball's pitch, after the ramp of the load.
    "joint in equilibrium, 13 instants, 20 000 points": clearances(
        20_000, options={"fidelity": "quasistatic"}, time={"end": 0.1, "samples": 13}, parameters={"load_ramp": 1e-6}
    ),
    "slider-crank with friction, two turns, 2 048 points": {
        "scene": {"scene": {"kind": "slider_crank", "friction": True}, "time": {"end": 0.024, "samples": 601}},
        "vary": {"clearance_journal": {"lower": 1e-4, "upper": 5e-4, "steps": 2048}},
        "results": {"features": ["journal.peak"]},
    },
    "impact, 40 000 points": {
        "scene": {"scene": {"kind": "impact"}, "time": {"end": 3e-4, "samples": 301}},
        "vary": {"approach_speed": {"lower": 0.5, "upper": 2.0, "steps": 40_000}},
        "results": {"features": ["contact.peak", "contact.impulse"]},
    },
}


def waited(checkout: Path, study: Path, cache: Path) -> float:
    """Wall seconds of ``bcfj study run`` in a fresh folder."""
    out = study.parent / "out"
    shutil.rmtree(out, ignore_errors=True)
    environment = {**os.environ, "PYTHONPATH": str(checkout), "BCFJ_CACHE": str(cache)}
    begin = time.perf_counter()
    command = [sys.executable, "-m", "bcfj_jax", "study", "run", str(study), "--out", str(out)]
    subprocess.run(command, env=environment, cwd=study.parent, check=True, capture_output=True)
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=list(STUDIES))
    given = parser.parse_args()
    trees = {"before": given.against.resolve(), "now": ROOT}
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=trees["before"], capture_output=True, text=True, check=True
    )
    found: dict[str, Any] = load("study_waits")["studies"] if set(given.only) < set(STUDIES) else {}
    for name in given.only:
        with tempfile.TemporaryDirectory() as place:
            study = Path(place) / "study.toml"
            write_toml(study, STUDIES[name], name)
            first = {tree: waited(path, study, Path(place) / tree) for tree, path in trees.items()}
            warm: dict[str, list[float]] = {tree: [] for tree in trees}
            for _ in range(given.rounds):
                for tree, path in trees.items():
                    warm[tree].append(waited(path, study, Path(place) / tree))
        median = {tree: float(np.median(times)) for tree, times in warm.items()}
        found[name] = {"first_s": first, "warm_s": warm, "median_s": median, "ratio": median["before"] / median["now"]}
        print(name, found[name], flush=True)
    save("study_waits", {"against": commit.stdout.strip(), "studies": found})
    rows = [["study", "before, s", "now, s", "times as quick", "the first time, before and now, s"]]
    for name, one in found.items():
        before, now = (f"{one['median_s'][tree]:.3g}" for tree in ("before", "now"))
        firsts = " and ".join(f"{one['first_s'][tree]:.3g}" for tree in ("before", "now"))
        rows.append([name, before, now, f"**{one['ratio']:.1f}**", firsts])
    put_in_readme("study_waits", markdown(rows), "docs/studies.md")


if __name__ == "__main__":
    main()
