"""When a command shows its first answer, beside when it has ended; and how programs grow with contacts that are alike.

Whole processes with kept programs, in turns with an import of jax, diffrax and pyplot, medians; the first answer is the first
line on stdout. Growth: a body with 1, 8 and 32 equal contacts, and 2, 8 and 32 spheres in a row, nothing kept, from making the
mechanism to the end of a run.

    python -m benchmarks.solve.answers [--processes 5] [--against OTHER]    keeps benchmarks/results/answers.json
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.common import ROOT, markdown, put_in_readme, save
from benchmarks.solve.waiting import importing

COMMANDS = {
    "sensitivity joint, two parameters": ["sensitivity", "joint", "--wrt", "clearance_cage_ball,stiffness"],
    "sensitivity joint, all clearances": ["sensitivity", "joint", "--wrt", "clearances"],
    "sensitivity impact, two parameters": ["sensitivity", "impact", "--wrt", "stiffness,damping"],
    "tradeoff impact": ["tradeoff", "impact"],
    "design impact, two parameters": [
        "design", "impact", "--minimize", "contact.peak", "--vary", "damping=0.1:1", "--vary", "mass=10g:30g", "--starts", "4",
    ],
    "calibrate the demo": ["calibrate", str(ROOT / "examples" / "chung_ooi_fit.toml")],
}  # fmt: skip
_MEASURED = """
begin = time.perf_counter()
scene = bj.Mechanism("many", bodies, contacts, loads, given=given)
params, times = scene.parameters(), np.linspace(0.0, end, 401)
run = bj.simulate(scene, params, times)
assert run.status == "ok", run.reason
first = time.perf_counter() - begin
begin = time.perf_counter()
for _ in range(5):
    bj.simulate(scene, params, times)
print(first, (time.perf_counter() - begin) / 5)
"""
_CONTACTS = """import sys, time
import numpy as np
import bcfj_jax as bj

count, rng = int(sys.argv[1]), np.random.default_rng(0)
bodies = [bj.Body("cube", "free", mass=1.0, inertia=(1e-3, 1e-3, 1e-3), start={"z": 0.06, "wx": 3.0})]
marks = [tuple(float(x) for x in rng.uniform(-0.05, 0.05, 3)) for _ in range(count)]
laws = {"law": "memory_free", "friction": "brown_mcphee"}
contacts = [
    bj.Contact(f"corner_{k}", ("ground", "cube"), bj.gaps.SphereOnPlane(), at=((0, 0, 0), mark), **laws)
    for k, mark in enumerate(marks)
]
given = {"stiffness": 1e6, "exponent": 1.5, "damping": 0.1, "radius": 1e-3}
given |= {"friction_static": 0.3, "friction_dynamic": 0.2, "friction_speed": 0.01}
loads, end = [bj.loads.Gravity()], 0.2
"""
_ROW = """import sys, time
import numpy as np
import bcfj_jax as bj

count = int(sys.argv[1])
place = lambda k: {"position": 0.0201 * k, "velocity": 0.0 if k else 1.0}
bodies = [bj.Body(f"ball_{k}", "slide", axis="x", mass=0.1, start=place(k)) for k in range(count)]
contacts = [bj.Contact(f"touch_{k}", (f"ball_{k}", f"ball_{k + 1}"), bj.gaps.SphereOnSphere()) for k in range(count - 1)]
given = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1, "radius_a": 0.01, "radius_b": 0.01}
loads, end = [], 0.005
"""
# By what is counted: how it is made, and how many.
GROWING = {
    "equal contacts on one body": (_CONTACTS, (1, 8, 32)),
    "spheres in a row": (_ROW, (2, 8, 32)),
}


def answer(words: list[str], cache: Path, checkout: Path) -> tuple[float, float, float]:
    """Seconds to the first line on stdout, to the end, and of all cores."""
    surroundings = {**os.environ, "BCFJ_CACHE": str(cache), "PYTHONPATH": str(checkout)}
    with tempfile.TemporaryDirectory() as folder:
        begin, spent = time.perf_counter(), os.times()
        run = subprocess.Popen(
            [sys.executable, "-m", "bcfj_jax", *words], env=surroundings, cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        assert run.stdout is not None
        run.stdout.readline()
        first = time.perf_counter() - begin
        run.stdout.read()
        run.wait()
        after = os.times()
    cpu = after.children_user + after.children_system - spent.children_user - spent.children_system
    return first, time.perf_counter() - begin, cpu


def answers(processes: int, checkout: Path) -> dict[str, dict[str, float]]:
    """By command, medians: first answer, all, all cores, the import beside them, in seconds; a first run with nothing kept."""
    found = {}
    for name, words in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder)
            cold = answer(words, cache, checkout)
            rows = [(*answer(words, cache, checkout), importing()) for _ in range(processes)]
        found[name] = dict(
            zip(("first", "all", "cpu", "import"), map(statistics.median, zip(*rows, strict=True)), strict=True)
        )
        found[name] |= {"cold_first": cold[0], "cold_all": cold[1]}
        print(name, {key: round(x, 2) for key, x in found[name].items()}, flush=True)
    return found


def growth(processes: int, checkout: Path) -> dict[str, dict[str, dict[str, float]]]:
    """By what is counted and its number, medians: seconds of the first run, nothing kept, and of one that is compiled."""
    surroundings = {**os.environ, "BCFJ_CACHE": "off", "PYTHONPATH": str(checkout)}
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, (made, counts) in GROWING.items():
        rows: dict[str, list[list[float]]] = {str(count): [] for count in counts}
        for _ in range(processes):
            for count in rows:
                command = [sys.executable, "-c", made + _MEASURED, count]
                done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True)
                rows[count].append([float(x) for x in done.stdout.split()])
        found[name] = {
            count: dict(zip(("first", "run"), map(statistics.median, zip(*row, strict=True)), strict=True))
            for count, row in rows.items()
        }
    return found


def tables(found: dict[str, dict]) -> tuple[str, str]:
    """Both tables, in Markdown."""
    first = [["`bcfj ...`, kept programs", "first answer", "all", "over the import", "CPU over wall", "nothing kept"]]
    for name, row in found["commands"].items():
        ratios = f"{row['first'] / row['import']:.1f}, {row['all'] / row['import']:.1f}"
        kept = f"{row['cold_first']:.1f} s, {row['cold_all']:.1f} s"
        seconds = f"{row['first']:.1f} s", f"{row['all']:.1f} s"
        first.append([f"`{name}`", *seconds, ratios, f"{row['cpu'] / row['all']:.2f}", kept])
    second = [["what", "number", "first run", "over the least's", "a compiled run"]]
    for name, rows in found["growth"].items():
        least = next(iter(rows.values()))["first"]
        for count, row in rows.items():
            seconds = f"{row['first']:.1f} s", f"{row['first'] / least:.2f}", f"{1e3 * row['run']:.1f} ms"
            second.append([name, count, *seconds])
    return markdown(first), markdown(second)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--against", type=Path, help="an older checkout, shown and not kept")
    given = parser.parse_args()
    checkout = given.against.resolve() if given.against else ROOT
    found = {"growth": growth(given.processes, checkout), "commands": answers(given.processes, checkout)}
    first, second = tables(found)
    print(first, second, sep="\n\n")
    if not given.against:
        save("answers", found)
        put_in_readme("answers", first, "docs/waiting.md")
        put_in_readme("alike", second, "docs/waiting.md")


if __name__ == "__main__":
    main()
