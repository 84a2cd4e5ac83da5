"""Two processes with one folder, and fifty without a folder's name at once: each folder has one process.

    python -m benchmarks.robustness.pairs [--pairs 50] [--simulate 50] [--defaults 50]
writes results/pairs.json.

A pair of ``bcfj init`` asks for one file, a pair of ``bcfj simulate`` for one folder, the second a random while after
the first. The two ask for different masses, so that a folder of both would be seen: ``run.toml`` and ``summary.json``
must be of the one that ended with 0, and the other one must say so and end with 2. The fifty run ``bcfj simulate`` at
once without ``--out``, each of its own mass from a file of one name, so that all ask for one folder: there must be fifty
folders, one of each mass.
"""

from __future__ import annotations

import collections
import csv
import json
import math
import random
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

from bcfj_jax.analysis.simulation.results import FILES, PICTURES
from benchmarks.common import markdown, options, save
from benchmarks.processes import IMPACT, ended, files, last_line, start

SAYS = ("another process writes there", "already holds")


def scene(place: Path, mass: float) -> Path:
    """A scene's file; all have the same name."""
    path = place / f"mass_{mass:g}" / "scene.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"{IMPACT}[parameters]\nmass = {mass}\n")
    return path


def belongs(folder: Path, mass: float, peaks: dict[float, float]) -> bool:
    """Whether all files of a folder are there, and of the run of one mass.

    ``peaks`` has the highest force of each mass that was seen before: the same program gives the same number.
    """
    if files(folder) != sorted((*FILES, *PICTURES)):
        return False
    run, summary = tomllib.loads((folder / "run.toml").read_text()), json.loads((folder / "summary.json").read_text())
    if run["parameters"]["mass"] != mass:
        return False
    peak = summary["contacts"]["contact"]["peak"]
    with (folder / "forces.csv").open(newline="") as file:
        highest = max(float(row["contact.normal [N]"]) for row in csv.DictReader(file))
    return math.isclose(highest, peak, rel_tol=1e-12) and peaks.setdefault(mass, peak) == peak


def pair(place: Path, kind: str, number: int, draw: random.Random, peaks: dict[float, float]) -> dict[str, Any]:
    """One pair; how it ended."""
    out = place / f"{kind}_{number}"
    masses = (0.01, 0.02)
    words = (
        [["init", "impact"]] * 2
        if kind == "init"
        else [["simulate", str(scene(place, m)), "--no-measure-error"] for m in masses]
    )
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
    line = last_line(said[0], place) if said else ""
    return {"kind": kind, "pause_s": pause, "codes": codes, "good": good, "said": line}


def defaults(place: Path, count: int, peaks: dict[float, float]) -> dict[str, Any]:
    """Many at once without a folder's name; each folder that they made must be of one of them."""
    masses = [0.01 + 0.001 * k for k in range(count)]
    team = [start(["simulate", str(scene(place, mass)), "--no-measure-error"], place) for mass in masses]
    codes = collections.Counter(ended(job)[0] for job in team)
    folders = sorted((place / "results").iterdir())
    own = {mass for folder in folders for mass in masses if belongs(folder, mass, peaks)}
    # The heavier ball hits harder: forces of two masses cannot be taken for each other's.
    rising = [peaks[mass] for mass in sorted(own)]
    return {
        "count": count,
        "codes": {str(k): v for k, v in codes.items()},
        "folders": len(folders),
        "own": len(own) if rising == sorted(set(rising)) else 0,
    }


def main() -> None:
    given = options(__doc__, pairs=(50, "pairs of init"), simulate=(50, "pairs of simulate"), defaults=50)
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
        table.append(["`simulate` at once, no folder given", str(at_once["count"]), str(at_once["own"])])
    save("pairs", {"table": table, "at_once": at_once, "pairs": rows})
    print(markdown(table))


if __name__ == "__main__":
    main()
