"""Mutation testing: change one operator or number of the sources at a time, and see whether a test fails.

``python -m scripts.mutants contact noise --count 24 --seed 1 --out build/mutants.jsonl`` takes 24 places of each folder at
random. ``--again build/mutants.jsonl`` runs the survivors of a file once more. Each mutant lies in a copy of the tree, one at
a time. Its tests are those of its folder in the tier of CI that take at most ``--slowest`` seconds: first those in files that
name its module, the cheapest first.

No places are docstrings, messages, annotations, decorators, pictures, and numbers that only keep a division from 0. Each
line of the result has folder, file, line, before, after, outcome (killed, survived, timeout), by (a test), seconds.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
_UNCERTAINTY = ("law_miss", "systematic", "estimates", "unstated_filter", "noise", "profile", "posterior", "filters")
# Those whose files end within twenty seconds: the others compile for minutes.
_SOLVE = ("crossings", "program", "bdf", "steps")
# Sources and tests of each folder.
FOLDERS = {
    "contact": (("bcfj_jax/contact",), ("tests/contact/test_[fgls]*.py", "tests/contact/test_re[gs]*.py")),
    "mechanism": (("bcfj_jax/mechanism",), ("tests/mechanism/test_[!a]*.py", "tests/models/test_mechanism_energy.py")),
    "solve": (("bcfj_jax/solve",), tuple(f"tests/solve/test_{name}.py" for name in _SOLVE)),
    "uncertainty": (
        ("calibration/uncertainty", "calibration/uncertainty/systematic.py"),
        tuple(f"tests/calibration/test_{name}.py" for name in _UNCERTAINTY),
    ),
    "noise": (("calibration/noise",), ("tests/calibration/test_noise.py", "tests/calibration/test_averaging.py")),
}
OPERATORS: dict[type, tuple[str, tuple[str, ...]]] = {
    ast.Add: ("+", ("-",)), ast.Sub: ("-", ("+",)), ast.Mult: ("*", ("/",)), ast.Div: ("/", ("*",)),
    ast.Lt: ("<", ("<=", ">")), ast.LtE: ("<=", ("<", ">=")), ast.Gt: (">", (">=", "<")), ast.GtE: (">=", (">", "<=")),
    ast.Eq: ("==", ("!=",)), ast.NotEq: ("!=", ("==",)), ast.And: ("and", ("or",)), ast.Or: ("or", ("and",)),
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "sin": "cos", "cos": "sin"}
# Numbers beyond are guards against a division by 0.
LEAST = 1e-8
# A mutant is found again by these, where lines have moved.
_SAME = ("file", "text", "before", "after")
_SKIPPED = (ast.Raise, ast.JoinedStr, ast.Assert)


class Place(NamedTuple):
    """A mutant: file, line and its text, offset in the file's bytes, and what stands there before and after."""

    file: str
    line: int
    text: str
    begin: int
    before: str
    after: str


def places(tree: Path, file: str) -> Iterator[Place]:
    """Every mutant of a file."""
    data = (tree / file).read_bytes()
    starts = [0, *(m.end() for m in re.finditer(rb"\n", data))]

    def span(node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno and node.end_col_offset is not None
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def mutant(line: int, begin: int, end: int, after: str) -> Place:
        text = data[starts[line - 1] : starts[line] if line < len(starts) else None].decode().strip()
        return Place(file, line, text, begin, data[begin:end].decode(), after)

    def between(left: ast.expr, right: ast.expr, operator: ast.AST) -> Iterator[Place]:
        if type(operator) in OPERATORS:
            sign, others = OPERATORS[type(operator)]
            begin = data.index(sign.encode(), span(left)[1], span(right)[0])
            yield from (mutant(right.lineno, begin, begin + len(sign), other) for other in others)

    def walk(node: ast.AST) -> Iterator[Place]:
        if isinstance(node, _SKIPPED):
            return
        if isinstance(node, ast.FunctionDef) and (node.name == "drawn" or b"shapes." in data[slice(*span(node))]):  # type: ignore[arg-type]
            return
        if isinstance(node, ast.BinOp):
            yield from between(node.left, node.right, node.op)
        elif isinstance(node, ast.Compare):
            for left, sign, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
                yield from between(left, right, sign)
        elif isinstance(node, ast.BoolOp):
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from between(left, right, node.op)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield mutant(node.lineno, span(node)[0], span(node.operand)[0], "")
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            if not 0 < abs(node.value) < LEAST and abs(node.value) < 1.0 / LEAST:
                others = {node.value + 1, 2 * node.value} - {node.value}
                yield from (mutant(node.lineno, *span(node), repr(other)) for other in sorted(others))
        elif isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in NAMES:
                end = span(node.func)[1]
                yield mutant(node.lineno, end - len(name), end, NAMES[name])
        for field, child in ast.iter_fields(node):
            if field not in ("annotation", "returns", "decorator_list"):
                for one in child if isinstance(child, list) else [child]:
                    if isinstance(one, ast.AST):
                        yield from walk(one)

    yield from walk(ast.parse(data))


def every(tree: Path, folder: str) -> list[Place]:
    """Every mutant of a folder's files."""
    found = [tree / name for name in FOLDERS[folder][0]]
    files = [file for path in found for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]
    return [place for file in files for place in places(tree, file.relative_to(tree).as_posix())]


def pytest(tree: Path, arguments: list[str], seconds: float) -> tuple[int, str]:
    """Exit code and output; 124 for one that ran out of time."""
    tier = ["-m", "not slow", "--hypothesis-profile", "fast", "--assert=plain", "-q", "-p", "no:cacheprovider"]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *tier, *arguments], cwd=tree, capture_output=True, text=True,
            timeout=seconds, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, ""
    return done.returncode, done.stdout


def cheap(tree: Path, folder: str, slowest: float) -> dict[str, float]:
    """Seconds of each test of a folder that takes at most so long."""
    files = [str(p.relative_to(tree)) for name in FOLDERS[folder][1] for p in sorted(tree.glob(name))]
    code, output = pytest(tree, [*files, "--durations=0", "--durations-min=0"], 3600.0)
    assert code == 0, f"{folder}: tests fail before any change\n{output[-3000:]}"
    times: dict[str, float] = {}
    for seconds, test in re.findall(r"^([\d.]+)s \w+ +(.+)$", output, re.MULTILINE):
        times[test] = times.get(test, 0.0) + float(seconds)
    return {test: seconds for test, seconds in times.items() if seconds <= slowest}


def tried(tree: Path, place: Place, times: dict[str, float]) -> dict[str, object]:
    """What the tests say to a mutant."""
    path = tree / place.file
    data, begin, seconds = path.read_bytes(), time.perf_counter(), 3.0 * sum(times.values()) + 120.0
    files = {file: path.stem in (tree / file).read_text() for file in {test.split("::")[0] for test in times}}
    tests = sorted(times, key=lambda test: (not files[test.split("::")[0]], times[test]))
    path.write_bytes(data[: place.begin] + place.after.encode() + data[place.begin + len(place.before) :])
    (tree / "tests.txt").write_text("\n".join(tests))
    try:
        code, output = pytest(tree, ["-x", "@tests.txt"], seconds)
    finally:
        path.write_bytes(data)
    by = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    outcome = {0: "survived", 124: "timeout"}.get(code, "killed")
    return {"outcome": outcome, "by": by[1] if by else "", "seconds": round(time.perf_counter() - begin, 1)}


def main() -> None:
    """Try the mutants that were asked for, and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folders", nargs="+", choices=FOLDERS)
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--slowest", type=float, default=3.0)
    parser.add_argument("--again", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants.jsonl")
    asked = parser.parse_args()
    former = [json.loads(line) for line in asked.again.read_text().splitlines()] if asked.again else []
    survived = {tuple(row[key] for key in _SAME) for row in former if row["outcome"] == "survived"}
    with tempfile.TemporaryDirectory() as held, asked.out.open("a") as out:
        tree = Path(held) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv"), symlinks=True)
        for folder in asked.folders:
            known = every(tree, folder)
            chosen = random.Random(asked.seed).sample(known, min(asked.count, len(known)))
            if asked.again:
                chosen = [place for place in known if tuple(getattr(place, key) for key in _SAME) in survived]
            times = cheap(tree, folder, asked.slowest)
            print(f"{folder}: {len(chosen)} of {len(known)} mutants, {len(times)} tests", flush=True)
            for place in chosen:
                row = {"folder": folder, "seed": asked.seed, **place._asdict()}
                row |= tried(tree, place, times)
                out.write(json.dumps(row) + "\n")
                out.flush()
                print(f"{row['outcome']:9}{place.file}:{place.line} {place.before} -> {place.after}", flush=True)


if __name__ == "__main__":
    main()
