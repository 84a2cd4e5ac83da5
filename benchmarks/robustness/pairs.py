"""Two processes with one folder, and fifty without a folder's name at once: each folder has one process.

    python -m benchmarks.robustness.pairs [--pairs 100] [--simulate 100] [--defaults 50]
writes results/pairs.json.

A pair of ``bcfj init`` asks for one file, a pair of ``bcfj simulate`` for one folder, the second a random while after
the first. The two ask for different masses, so that a folder of both would be seen: ``run.toml`` and ``summary.json``
must be of the one that ended with 0, and the other one must say so and end with 2. The fifty run ``bcfj simulate`` of
fifty masses without ``--out``.
"""

from __future__ import annotations

import argparse
import collections
import json
import random
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

from bcfj_jax.analysis.simulation.results import FILES, PICTURES
from benchmarks.common import markdown, save
from benchmarks.robustness.running import IMPACT, ended, files, last_line, start

SAYS = ("another process writes there", "already holds")


def scene(place: Path, mass: float) -> Path:
    path = place / f"mass_{mass:g}.toml"
    path.write_text(f"{IMPACT}[parameters]\nmass = {mass}\n")
    return path


def belongs(folder: Path, mass: float, peaks: dict[float, float]) -> bool:
    """Whether all files of a folder are of the run of one mass."""
    if files(folder) != sorted((*FILES, *PICTURES)):
        return False
    run, summary = tomllib.loads((folder / "run.toml").read_text()), json.loads((folder / "summary.json").read_text())
    peak = summary["contacts"]["contact"]["peak"]
    return run["parameters"]["mass"] == mass and peaks.setdefault(mass, peak) == peak


def pair(place: Path, kind: str, number: int, draw: random.Random, peaks: dict[float, float]) -> dict[str, Any]:
    """One pair; how it ended."""
    out = place / f"{kind}_{number}"
    masses = (0.01, 0.02)
    words = [["init", "impact"]] * 2 if kind == "init" else [["simulate", str(scene(place, m))] for m in masses]
    first = start([*words[0], "--out", str(out)], place)
    pause = draw.choice((0.0, draw.uniform(0.0, 1.0 if kind == "init" else 3.0)))
    time.sleep(pause)
    both = [ended(job) for job in (first, start([*words[1], "--out", str(out)], place))]
    codes = [code for code, _, _ in both]
    won = [k for k in (0, 1) if codes[k] == 0]
    said = [err for code, _, err in both if code == 2]
    good = sorted(codes) == [0, 2] and any(text in said[0] for text in SAYS)
    if good and kind == "simulate":
        good = belongs(out, masses[won[0]], peaks)
    elif good:
        good = files(out) == ["impact.toml"]
    return {
        "kind": kind,
        "pause_s": pause,
        "codes": codes,
        "good": good,
        "said": last_line(said[0].replace(f"{place}/", "")) if said else "",
    }


def defaults(place: Path, count: int, peaks: dict[float, float]) -> dict[str, Any]:
    """Many at once without a folder's name."""
    masses = [0.01 + 0.001 * k for k in range(count)]
    team = [start(["simulate", str(scene(place, mass))], place) for mass in masses]
    codes = collections.Counter(ended(job)[0] for job in team)
    # The stem is the mass's, so each has a name; of one name there are as many folders as runs.
    good = sum(belongs(place / "results" / f"simulate-mass_{mass:g}", mass, peaks) for mass in masses)
    same = scene(place, 0.5)
    team = [start(["simulate", str(same)], place) for _ in range(count)]
    codes += collections.Counter(ended(job)[0] for job in team)
    own = [p for p in (place / "results").glob("simulate-mass_0.5*") if belongs(p, 0.5, peaks)]
    return {"count": count, "codes": {str(k): v for k, v in codes.items()}, "different": good, "same": len(own)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=100, help="pairs of init")
    parser.add_argument("--simulate", type=int, default=100, help="pairs of simulate")
    parser.add_argument("--defaults", type=int, default=50)
    given = parser.parse_args()
    draw, peaks, rows = random.Random(0), {}, []
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        for kind, count in (("init", given.pairs), ("simulate", given.simulate)):
            for number in range(count):
                rows.append(pair(place, kind, number, draw, peaks))
                print(rows[-1], flush=True)
        at_once = defaults(place, given.defaults, peaks) if given.defaults else None
    table = [["what", "asked", "one wins, the other says so, nothing mixed"]]
    for kind in ("init", "simulate"):
        of = [row for row in rows if row["kind"] == kind]
        table.append([f"pairs of `{kind}`, one folder", str(len(of)), str(sum(row["good"] for row in of))])
    if at_once:
        table.append(
            ["`simulate` at once, no folder, different scenes", str(at_once["count"]), str(at_once["different"])]
        )
        table.append(["the same, one scene", str(at_once["count"]), str(at_once["same"])])
    save("pairs", {"pairs": rows, "at_once": at_once})
    print(markdown(table))


if __name__ == "__main__":
    main()
