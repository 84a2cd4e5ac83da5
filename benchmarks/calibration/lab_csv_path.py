"""How many commands and how long from a lab's CSV file to a verdict?

    python -m benchmarks.calibration.lab_csv_path

Walks the path of a new user with examples/lab_drop.csv in an empty folder: the record's file, what it lacks, the fit.
Every command, its exit code, its time and the last line that it said are printed and kept.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import common

RECORD = common.ROOT / "examples" / "lab_drop.csv"


def step(arguments: list[str], folder: Path) -> dict:
    """One command, as a shell would run it."""
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "bcfj_jax", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return {"command": " ".join(["bcfj", *arguments]), "exit_code": done.returncode,
            "wall_s": time.perf_counter() - begin, "said": said[-1] if said else "", "stdout": done.stdout}  # fmt: skip


def main() -> int:
    """Walk and print; exit code 0 where the path ends with a verdict within five commands."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(RECORD, folder)
        steps = [step(["init", "calibration", RECORD.name], folder)]
        problem = folder / f"{RECORD.stem}.toml"
        # The one edit, which the command's last line asks for.
        assert "write it in" in steps[0]["said"] and "? kg" in problem.read_text(encoding="utf-8")
        problem.write_text(problem.read_text(encoding="utf-8").replace("? kg", "0.5 kg"), encoding="utf-8")
        steps.append(step(["validate", problem.name], folder))
        steps.append(step(["calibrate", problem.name, "--out", "fit"], folder))
        verdict = steps[-1]["stdout"].splitlines()[0] if steps[-1]["stdout"] else ""
        wrote = sorted(path.name for path in (folder / "fit").glob("*"))
    for one in steps:
        del one["stdout"]
        print(f"{one['wall_s']:7.1f} s  exit {one['exit_code']}  {one['command']}\n           {one['said'][:160]}")
    print(f"{len(steps)} commands, {sum(one['wall_s'] for one in steps):.1f} s: {verdict}; {', '.join(wrote)}")
    common.save("lab_csv_path", {"steps": steps, "verdict": verdict})
    return 0 if verdict == "verdict: identified" and len(steps) <= 5 else 1


if __name__ == "__main__":
    sys.exit(main())
