"""How far other choices of the model move the forces of the default joint: the error of its model form.

    python -m benchmarks.models.joint_model_form [--budget 1500]

What ``bcfj tradeoff joint --only model`` runs, over 0.75 s, in which the cage comes to the ends of its windows, against
the same reference. The largest change of a contact's peak and the worst rms of the force, each as a share of the default
joint's. The package reads the changes from ``bcfj_jax/models/joint/model_form.json``, which this writes.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path

from bcfj_jax.analysis.tradeoff.settings import MODEL, settings
from bcfj_jax.analysis.tradeoff.study import study
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.scenefile import from_table, shown
from bcfj_jax.models.joint import variants
from benchmarks.common import markdown, put_in_readme, save

END, SAMPLES = 0.75, 751


def main() -> None:
    """Run every choice, print the table, keep it for the package."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--budget", type=float, default=1500.0, help="seconds")
    given = parser.parse_args()
    table = {"scene": {"kind": "joint"}, "time": {"end": END, "samples": SAMPLES}}
    file = shown(from_table(table, None))
    todo = settings(file, [MODEL], derivatives=False)
    with tempfile.TemporaryDirectory() as folder, Journal(Path(folder), "model form") as journal:
        found = study(file, todo, journal, given.budget, print)
    own = found.rows[0]["wall_s"]
    choices = []
    for setting, row in zip(found.settings, found.rows, strict=True):
        if setting.group != MODEL:
            continue
        change, rms = row["peak_change"], row["force_rms_error"]
        choices.append(
            {
                "choice": setting.name,
                "contact": row["contact"],
                "change": round(change, 3) if math.isfinite(change) else None,
                "force_rms": round(rms, 3) if math.isfinite(rms) else None,
                "wall": round(row["wall_s"] / own, 2) if math.isfinite(row["wall_s"]) else None,
                "physics": setting.physics,
                "status": f"{row['status']} {row['reason']}".strip(),
            }
        )
    choices.sort(key=lambda one: -abs(one["change"] or 0.0))
    path = Path(str(variants.__file__)).with_name("model_form.json")
    kept = {"end_s": END, "choices": choices}
    path.write_text(json.dumps(kept, indent=1) + "\n")
    save("joint_model_form", kept)
    rows = [["choice", "contact", "peak", "force rms", "wall", "what differs"]]
    for one in choices:
        change = "-" if one["change"] is None else f"{one['change']:+.1%}"
        rms = "-" if one["force_rms"] is None else f"{one['force_rms']:.1%}"
        rows.append([one["choice"], one["contact"], change, rms, f"{one['wall']} times", one["physics"]])
    table = markdown(rows)
    put_in_readme("model_form", table, "docs/tradeoff.md")
    print(table)


if __name__ == "__main__":
    main()
