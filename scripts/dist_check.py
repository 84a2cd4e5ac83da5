"""Install each distribution of a folder into a fresh environment outside the tree, and use it there.

    python -m scripts.dist_check build/dist          (make dist-check builds them first)

Checked of the wheel and of the sdist: the version that the command prints is the file's; ``bcfj simulate impact`` writes
its results; ``bcfj init mechanism`` finds its template and ``bcfj study run clearance --dry-run`` says which extra it
needs; ``bcfj verify --json`` passes. The sdist also has to hold tests, documents, examples and the licence.
"""

from __future__ import annotations

import json
import re
import sys
import tarfile
import tempfile
from pathlib import Path

from scripts import fresh

_RESULTS = ("forces.csv", "summary.json", "report.html", "run.toml", "environment.json")
_IN_SDIST = ("tests/test_architecture.py", "docs/index.md", "examples/chung_ooi_fit.toml", "LICENSE", "constraints.txt")


def _document(text: str) -> dict:
    """What ``bcfj verify --json`` found, with or without the envelope that every verb's document has."""
    found = json.loads(text)
    return found.get("result", found)


def used(programs: Path, place: Path, env: dict[str, str], version: str) -> dict[str, float]:
    """Use an installed package; seconds by command."""
    bcfj, took = programs / "bcfj", {}
    said = fresh.must([bcfj, "--version"], place, env)
    if said.stdout.strip() != f"bcfj-jax {version}":
        sys.exit(f"the command says {said.stdout.strip()!r}, the file is of version {version}")
    took["--version"] = said.seconds
    took["simulate impact"] = fresh.must([bcfj, "simulate", "impact", "--out", "r"], place, env).seconds
    missing = [name for name in _RESULTS if not (place / "r" / name).exists()]
    if missing:
        sys.exit(f"bcfj simulate impact did not write {', '.join(missing)}")
    took["init mechanism"] = fresh.must([bcfj, "init", "mechanism"], place, env).seconds
    asked = fresh.run([bcfj, "study", "run", "clearance", "--dry-run"], place, env)
    if asked.code != 2 or "bcfj-jax[study]" not in asked.stderr:
        sys.exit(f"a study without its extra: exit code {asked.code}\n{asked.stdout}{asked.stderr}")
    checked = fresh.run([bcfj, "verify", "--json"], place, env)
    found = _document(checked.stdout) if checked.code in (0, 1) else {}
    if checked.code != 0 or not found["passed"]:
        sys.exit(f"bcfj verify: exit code {checked.code}\n{checked.stdout[-6000:]}{checked.stderr[-2000:]}")
    took[f"verify ({len(found['checks'])} checks)"] = checked.seconds
    return took


def main(folder: Path, python: str) -> None:
    """Check every distribution there; end with exit code 1 where one fails."""
    files = sorted([*folder.glob("*.whl"), *folder.glob("*.tar.gz")])
    if len(files) != 2:
        sys.exit(f"{folder} holds {len(files)} distributions; expected one wheel and one sdist")
    for file in files:
        version = re.search(r"bcfj_jax-([^-]+?)(-py3|\.tar)", file.name)
        if version is None:
            sys.exit(f"{file.name} names no version")
        if file.suffix == ".gz":
            with tarfile.open(file) as archive:
                names = {name.partition("/")[2] for name in archive.getnames()}
            lacking = [name for name in _IN_SDIST if name not in names]
            if lacking:
                sys.exit(f"{file.name} lacks {', '.join(lacking)}")
        with tempfile.TemporaryDirectory() as place:
            work = Path(place) / "work"
            work.mkdir()
            env = fresh.surroundings(Path(place))
            programs = fresh.environment(
                Path(place) / "venv", python, env, "-c", fresh.ROOT / "constraints.txt", file.resolve()
            )
            for what, seconds in used(programs, work, env, version[1]).items():
                print(f"{file.name}  bcfj {what}: {seconds:.1f} s", flush=True)
        print(f"{file.name}: ok", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "build/dist"), sys.executable)
