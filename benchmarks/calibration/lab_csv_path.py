"""How many commands and how long from a lab's CSV file to a verdict?

    python -m benchmarks.calibration.lab_csv_path

Walks the path of a new user with examples/lab_drop.csv in an empty folder: the record's file, what it lacks, the fit.
Every command, its exit code, its time and the last line that it said are printed and kept.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import common
from benchmarks.processes import Done, bcfj

RECORD = common.ROOT / "examples" / "lab_drop.csv"


def main() -> int:
    """Walk and print; exit code 0 where the path ends with a verdict within five commands."""
    steps: list[dict[str, Any]] = []

    def step(*words: str) -> Done:
        done = bcfj(words, folder, {"BCFJ_CACHE": os.environ.get("BCFJ_CACHE")})
        said = [line for line in (done.out + done.err).splitlines() if line.strip()]
        steps.append({"command": " ".join(["bcfj", *words]), "exit_code": done.code, "wall_s": done.wall_s})
        steps[-1]["said"] = said[-1] if said else ""
        print(f"{done.wall_s:7.1f} s  exit {done.code}  {steps[-1]['command']}\n           {steps[-1]['said'][:160]}")
        return done

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(RECORD, folder)
        step("init", "calibration", RECORD.name)
        problem = folder / f"{RECORD.stem}.toml"
        # The one edit, which the command's last line asks for.
        assert "write it in" in steps[0]["said"] and "? kg" in problem.read_text(encoding="utf-8")
        problem.write_text(problem.read_text(encoding="utf-8").replace("? kg", "0.5 kg"), encoding="utf-8")
        step("validate", problem.name)
        verdict = step("calibrate", problem.name, "--out", "fit").out.partition("\n")[0]
        wrote = sorted(path.name for path in (folder / "fit").glob("*"))
    print(f"{len(steps)} commands, {sum(one['wall_s'] for one in steps):.1f} s: {verdict}; {', '.join(wrote)}")
    common.save("lab_csv_path", {"steps": steps, "verdict": verdict})
    return 0 if verdict == "verdict: identified" and len(steps) <= 5 else 1


if __name__ == "__main__":
    sys.exit(main())
