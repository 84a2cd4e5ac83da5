"""Test the package on several interpreters and library versions, each in a fresh environment outside the tree.

    python -m scripts.pythons python3.11 python3.12 python3.13                 versions of constraints.txt, fast tier
    python -m scripts.pythons python3.11 --versions pinned,lowest,newest      also the oldest and the newest allowed
    python -m scripts.pythons python3.12 --tests "tests/contact tests/solve"    other tests; once more: a row of its own
    python -m scripts.pythons python3.13 --versions newest --keep ~/tried       leaves the environment, and uses it again

``pinned`` is constraints.txt; ``newest`` what pip takes without it; ``lowest`` the lowest release that each direct requirement
in pyproject.toml allows, found by uv. The package is installed as a wheel, so that no test imports the checkout. The
outcome is a table, and JSON in the file that ``--out`` names; the exit code is 1 where a run failed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import shlex
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

from scripts import fresh

FAST = ["-m", "not full and not slow", "--hypothesis-profile", "fast"]
KINDS = ("pinned", "lowest", "newest")
_SHOWN = ("jax", "diffrax", "equinox", "optax", "numpy", "scipy", "matplotlib", "pint", "pydantic", "typer")


def users_extras(project: dict) -> list[str]:
    """Names of the extras that are not for those who change the code."""
    return [name for name in project["optional-dependencies"] if name not in ("test", "bench", "docs")]


def _lowest(place: Path, python: str, env: dict[str, str], project: dict) -> str:
    """Exact versions, the lowest of every direct requirement of the package and of its extras for users, by uv."""
    programs = fresh.environment(place / "uv", python, env, "uv")
    extras = [word for name in users_extras(project) for word in ("--extra", name)]
    resolve = ["pip", "compile", "--quiet", "--resolution", "lowest-direct", "--no-header", "--no-annotate", *extras]
    resolved = fresh.must([programs / "uv", *resolve, "--python", python, "pyproject.toml"], fresh.ROOT, env).stdout
    direct = {re.split(r"[<>=!\[ ]", text)[0].lower() for text in project["dependencies"]}
    for name in users_extras(project):
        direct |= {re.split(r"[<>=!\[ ]", text)[0].lower() for text in project["optional-dependencies"][name]}
    # What they need in turn is left to pip: the extra for tests asks for newer versions of some of it.
    return "\n".join(line for line in resolved.splitlines() if line.partition("==")[0].lower() in direct)


def _copy(to: Path) -> Path:
    """Tests and what they read beside the package, without the package."""
    for name in ("tests", "benchmarks", "examples", "docs", "scripts"):
        shutil.copytree(fresh.ROOT / name, to / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in fresh.ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, to)
    return to


def tried(python: str, kind: str, tests: list[list[str]], timeout: float, keep: Path | None = None) -> Iterator[dict]:
    """Install and test in one environment: versions, counts of tests, seconds, and the end of what pytest said.

    There is a row for each selection of tests, as soon as it has run. The environment is removed afterwards. In a folder
    ``keep`` it stays and is used again, with the package installed anew.
    """
    asked = [python, "-c", "import sys; print(sys.version.split()[0])"]
    version = fresh.must(asked, fresh.ROOT, fresh.surroundings(Path(tempfile.gettempdir()))).stdout.strip()
    with tempfile.TemporaryDirectory() if keep is None else contextlib.nullcontext(keep.resolve()) as name:
        place = Path(name) / f"{version}-{kind}"
        place.mkdir(parents=True, exist_ok=True)
        yield from _tried(place, python, version, kind, tests, timeout)


def _tried(place: Path, python: str, version: str, kind: str, tests: list[list[str]], timeout: float) -> Iterator[dict]:
    project = tomllib.loads((fresh.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    env = fresh.surroundings(place, JAX_PLATFORMS="cpu")
    bounds = place / "bounds.txt"
    if kind == "pinned":
        shutil.copy(fresh.ROOT / "constraints.txt", bounds)
    else:
        bounds.write_text(f"{_lowest(place, python, env, project) if kind == 'lowest' else ''}\n", encoding="utf-8")
    programs = place / "venv" / "bin"
    if programs.exists():
        fresh.must(
            [programs / "python", "-m", "pip", "install", "--no-deps", "--force-reinstall", fresh.ROOT], place, env
        )
    else:
        fresh.environment(place / "venv", python, env, "-c", bounds, f"{fresh.ROOT}[test]")
    listed = fresh.must([programs / "python", "-m", "pip", "list", "--format", "json"], place, env)
    installed = {one["name"].lower(): one["version"] for one in json.loads(listed.stdout)}
    work = place / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    _copy(work)
    # The tests import the installed package: there is none beside them, which some tests read as text.
    (work / "bcfj_jax").symlink_to(next((programs.parent / "lib").glob("python3*")) / "site-packages" / "bcfj_jax")
    (work / "calibration").symlink_to((work / "bcfj_jax").readlink().parent / "calibration")
    # Old libraries use what newer ones below them deprecate; that is no fault of the package.
    lenient = ["-W", "default::DeprecationWarning"] if kind == "lowest" else []
    pytest = [programs / "python", "-m", "pytest", "-p", "no:cacheprovider", *lenient]
    for chosen in tests:
        done = fresh.run([*pytest, *chosen], work, env, timeout)
        counts = {
            word: int(n) for n, word in re.findall(r"(\d+) (passed|failed|error|skipped|deselected)", done.stdout)
        }
        yield {
            "python": version, "versions": kind, "installed": {n: installed.get(n, "") for n in _SHOWN},
            "tests": chosen, "exit_code": done.code, "counts": counts, "seconds": round(done.seconds, 1),
            "end": "" if done.code == 0 else (done.stdout[-6000:] + done.stderr[-2000:]).replace(str(place), ""),
        }  # fmt: skip


def table(rows: list[dict]) -> str:
    """The outcome as a table in Markdown."""
    lines = ["| Python | versions | jax | diffrax | numpy | scipy | passed | failed | s |", "|---" * 9 + "|"]
    for row in rows:
        v, c = row["installed"], row["counts"]
        bad = c.get("failed", 0) + c.get("error", 0)
        verdict = str(bad) if row["exit_code"] == 0 or bad else f"exit code {row['exit_code']}"
        cells = (row["python"], row["versions"], v["jax"], v["diffrax"], v["numpy"], v["scipy"])
        lines.append(f"| {' | '.join(cells)} | {c.get('passed', 0)} | {verdict} | {row['seconds']:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Run every combination that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("pythons", nargs="+", help="interpreters, by name or path")
    parser.add_argument("--versions", default="pinned", help=f"of {', '.join(KINDS)}, separated by commas")
    parser.add_argument("--tests", action="append", help="what pytest is given, in one word")
    parser.add_argument("--out", type=Path, help="a JSON file to add the rows to")
    parser.add_argument("--timeout", type=float, default=3600.0, help="seconds for the tests of one environment")
    parser.add_argument("--keep", type=Path, help="a folder where environments stay, to be used again")
    asked = parser.parse_args()
    kinds = asked.versions.split(",")
    if not set(kinds) <= set(KINDS):
        sys.exit(f"--versions: use {', '.join(KINDS)}")
    out, tests = asked.out, [shlex.split(one) for one in asked.tests or [shlex.join(FAST)]]
    kept = json.loads(out.read_text(encoding="utf-8"))["rows"] if out is not None and out.exists() else []
    rows = []
    for python in asked.pythons:
        for row in (row for kind in kinds for row in tried(python, kind, tests, asked.timeout, asked.keep)):
            rows.append(row)
            print(row["end"], table(rows), sep="\n", flush=True)
            if out is not None:
                out.write_text(json.dumps({"rows": kept + rows}, indent=2) + "\n", encoding="utf-8")
    sys.exit(any(row["exit_code"] for row in rows))


if __name__ == "__main__":
    main()
