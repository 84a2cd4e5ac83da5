"""The commands of the README and of the start page, word by word, on a machine with nothing but Python and make.

    python -m scripts.first_run --out build/first_run.json
    python -m scripts.first_run --without "make test"         leaves commands out; can be given again

A fresh clone of what is committed, an empty home folder, no caches, and a PATH on which there are only Python, make, a
shell and a few of its basic programs. Commands are the lines of those pages' code blocks that begin with ``make`` or
``.venv/bin/``; they run in the order of the pages, in the clone. The variables PIP_* are kept: they tell pip its index
and its certificates. The outcome is a table, and JSON in the file that ``--out`` names; the exit code is 1 where a
command failed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from scripts import fresh

PAGES = ("README.md", "docs/index.md")
# Beside Python and make: what a recipe of make calls, and what any system has.
BASIC = ("sh", "rm", "mkdir", "touch", "echo", "cat", "ls", "env")
_BLOCK = re.compile(r"^```(?:sh|bash|console|shell)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def commands(text: str) -> list[str]:
    """Command lines of a page's code blocks, without their comments."""
    lines = [line for block in _BLOCK.findall(text) for line in block.splitlines()]
    bare = [re.sub(r"\s+#.*$", "", line).strip() for line in lines]
    return [line for line in bare if line.startswith(("make ", ".venv/bin/"))]


def machine(place: Path, python: str) -> dict[str, str]:
    """A PATH with nothing but Python, make and basics, a home folder of its own; the environment of a new user."""
    programs = place / "programs"
    programs.mkdir()
    for name in (*BASIC, "make"):
        found = shutil.which(name)
        if found is None:
            sys.exit(f"this machine has no {name}")
        (programs / name).symlink_to(found)
    # By its full path, so that it finds its own library.
    starter = programs / "python3"
    starter.write_text(f'#!/bin/sh\nexec "{python}" "$@"\n', encoding="utf-8")
    starter.chmod(0o755)
    home = place / "home"
    home.mkdir()
    kept = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    return {**kept, "PATH": str(programs), "HOME": str(home), "LANG": "C.UTF-8"}


def walked(python: str, without: list[str]) -> dict:
    """Run them all: command, exit code, seconds and the last lines of what was said."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        clone = ["git", "clone", "--quiet", "--no-hardlinks", str(fresh.ROOT), str(place / "clone")]
        subprocess.run(clone, check=True)
        env, rows = machine(place, python), []
        for page in PAGES:
            for command in commands((place / "clone" / page).read_text(encoding="utf-8")):
                # A command that both pages give runs once.
                if command in without or command in [row["command"] for row in rows]:
                    continue
                done = fresh.run([place / "programs" / "sh", "-c", command], place / "clone", env)
                said = (done.stdout + done.stderr).strip().splitlines()
                row = {"page": page, "command": command, "exit_code": done.code, "seconds": round(done.seconds, 1)}
                rows.append({**row, "end": [line.replace(folder, "...") for line in said[-8:]]})
                print(f"{row['seconds']:8.1f} s  exit code {done.code}  {command}", flush=True)
    version = subprocess.run(
        [python, "-c", "import sys; print(sys.version.split()[0])"], capture_output=True, text=True
    )
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=fresh.ROOT, capture_output=True, text=True)
    return {
        "python": version.stdout.strip(), "cores": os.cpu_count(), "commit": commit.stdout.strip(),
        "left_out": without, "rows": rows,
    }  # fmt: skip


def main() -> None:
    """Walk through the pages and keep the outcome."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--python", default=sys.executable, help="the interpreter of the new machine")
    parser.add_argument("--without", action="append", default=[], help="a command to leave out")
    parser.add_argument("--out", type=Path, help="a JSON file for the outcome")
    asked = parser.parse_args()
    loads = os.getloadavg()
    found = walked(os.path.realpath(shutil.which(asked.python) or asked.python), asked.without)
    # Other work on the machine makes the times too long; the mean number of waiting processes tells.
    found["load_average"] = {"before": loads, "after": os.getloadavg()}
    if asked.out is not None:
        asked.out.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    failed = [row for row in found["rows"] if row["exit_code"] != 0]
    for row in failed:
        print(f"failed: {row['command']}", *row["end"], sep="\n")
    sys.exit(bool(failed) or not found["rows"])


if __name__ == "__main__":
    main()
