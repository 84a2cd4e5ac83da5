"""What a user waits for a study, from the command to its report: this checkout beside another.

    python -m benchmarks.analysis.study_waits --against DIR [--rounds 3] [--only NAME ...]
writes results/study_waits.json and the table in docs/studies.md. DIR is a checkout of an older commit; both run with this
Python, in turns, each with programs of its own, kept by a run before. Wall seconds, medians.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.io.outputs import write_toml
from benchmarks.analysis.study import PITCH, STILL, clearances
from benchmarks.common import ROOT, known, options, publish, save, table
from benchmarks.processes import bcfj, commit

STUDIES: dict[str, dict[str, Any]] = {
    "joint, 0.6 s, 256 points": clearances(256, {}, STILL, time={"end": 0.6, "samples": 601}),
    "joint, 0.1 s, 256 points": clearances(256, {}, STILL, time={"end": 0.1, "samples": 101}),
    "joint in equilibrium, 13 instants, 20 000 points": clearances(20_000, {"fidelity": "quasistatic"}, STILL, **PITCH),
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
    ran = bcfj(["study", "run", str(study), "--out", str(out)], study.parent, {"BCFJ_CACHE": str(cache)}, checkout)
    assert ran.code == 0, ran.err
    return ran.wall_s


def main() -> None:
    given = options(__doc__, against=Path, rounds=3, only=STUDIES)
    if given.against is None:
        raise SystemExit("--against DIR is missing: a checkout of an older commit")
    trees = {"before": given.against.resolve(), "now": ROOT}
    found: dict[str, Any] = known("study_waits")["studies"] if set(given.only) < set(STUDIES) else {}
    for name in given.only:
        with tempfile.TemporaryDirectory() as place:
            study = Path(place) / "study.toml"
            write_toml(study, STUDIES[name], name)
            each = [
                {t: waited(path, study, Path(place) / t) for t, path in trees.items()} for _ in range(given.rounds + 1)
            ]
        first, warm = each[0], {tree: [one[tree] for one in each[1:]] for tree in trees}
        median = {tree: float(np.median(times)) for tree, times in warm.items()}
        found[name] = {"first_s": first, "warm_s": warm, "median_s": median, "ratio": median["before"] / median["now"]}
        print(name, found[name], flush=True)
    save("study_waits", {"against": commit(trees["before"]), "studies": found})
    publish("study_waits", text(found), "docs/studies.md")


def text(found: dict[str, Any]) -> str:
    """The table of docs/studies.md."""
    return table({
        "study": "{name}", "before, s": "{median_s[before]:.3g}", "now, s": "{median_s[now]:.3g}",
        "times as quick": "**{ratio:.1f}**",
        "the first time, before and now, s": "{first_s[before]:.3g} and {first_s[now]:.3g}",
    }, ({"name": name, **one} for name, one in found.items()))  # fmt: skip


if __name__ == "__main__":
    main()
