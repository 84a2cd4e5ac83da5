"""How far other choices of the model move the forces of the default joint: the error of its model form.

    python -m benchmarks.models.joint_model_form [--budget 1500]

What ``bcfj tradeoff joint --only model`` runs, over 0.75 s, in which the cage comes to the ends of its windows, against
the same reference. The largest change of a contact's peak and the worst rms of the force, each as a share of the default
joint's. The package reads the changes from ``bcfj_jax/models/joint/model_form.json``, which this writes.
"""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path

from bcfj_jax.analysis.tradeoff.settings import MODEL, settings
from bcfj_jax.analysis.tradeoff.study import study
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.scenefile import from_table, shown
from bcfj_jax.models.joint import variants
from benchmarks.common import options, publish, save, table

END, SAMPLES = 0.75, 751


def main() -> None:
    """Run every choice, print the table, keep it for the package."""
    budget = options(__doc__, budget=(1500.0, "seconds")).budget
    file = shown(from_table({"scene": {"kind": "joint"}, "time": {"end": END, "samples": SAMPLES}}, None))
    todo = settings(file, [MODEL], derivatives=False)
    with tempfile.TemporaryDirectory() as folder, Journal(Path(folder), "model form") as journal:
        found = study(file, todo, journal, budget, print)
    own = found.rows[0]["wall_s"]

    def rounded(value: float, digits: int) -> float | None:
        return round(value, digits) if math.isfinite(value) else None

    choices = [
        {
            "choice": setting.name, "contact": row["contact"], "change": rounded(row["peak_change"], 3),
            "force_rms": rounded(row["force_rms_error"], 3), "wall": rounded(row["wall_s"] / own, 2),
            "physics": setting.physics, "status": f"{row['status']} {row['reason']}".strip(),
        }
        for setting, row in zip(found.settings, found.rows, strict=True) if setting.group == MODEL
    ]  # fmt: skip
    choices.sort(key=lambda one: -abs(one["change"] or 0.0))
    kept = {"end_s": END, "choices": choices}
    Path(str(variants.__file__)).with_name("model_form.json").write_text(json.dumps(kept, indent=1) + "\n")
    save("joint_model_form", kept)
    publish("model_form", table({
        "choice": "{choice}", "contact": "{contact}",
        "peak": lambda one: "-" if one["change"] is None else f"{one['change']:+.1%}",
        "force rms": lambda one: "-" if one["force_rms"] is None else f"{one['force_rms']:.1%}",
        "wall": "{wall} times", "what differs": "{physics}",
    }, choices), "docs/tradeoff.md")  # fmt: skip


if __name__ == "__main__":
    main()
