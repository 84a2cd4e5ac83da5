"""When a command shows its first answer, beside when it has ended; and how programs grow with contacts that are alike.

Whole processes with kept programs, in turns with an import of jax, diffrax and pyplot, medians; the first answer is the first
line on stdout. Growth: a body with 1, 8 and 32 equal contacts, and 2, 8 and 32 spheres in a row, nothing kept, from making the
mechanism to the end of a run.

    python -m benchmarks.solve.answers [--processes 5] [--only NAME ...] [--against OTHER]
        keeps benchmarks/results/answers.json, each part beside the others as soon as it is measured
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.common import ROOT, known, options, publish, save, table
from benchmarks.processes import bcfj, done, environment
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


def answers(name: str, processes: int, checkout: Path) -> dict[str, float]:
    """Of a command, medians: first answer, all, all cores, the import beside them, in seconds; a first run with nothing kept."""
    with tempfile.TemporaryDirectory() as cache:

        def answer() -> tuple[float, float, float]:
            with tempfile.TemporaryDirectory() as folder:
                ran = bcfj(COMMANDS[name], Path(folder), {"BCFJ_CACHE": cache}, checkout)
            return ran.first_s, ran.wall_s, ran.cpu_s

        cold = answer()
        rows = [(*answer(), importing()) for _ in range(processes)]
    medians = map(statistics.median, zip(*rows, strict=True))
    found = dict(zip(("first", "all", "cpu", "import"), medians, strict=True))
    return {**found, "cold_first": cold[0], "cold_all": cold[1]}


def growth(name: str, processes: int, checkout: Path) -> dict[str, dict[str, float]]:
    """By number of what is counted, medians: seconds of the first run, nothing kept, and of one that is compiled."""
    surroundings = environment({"BCFJ_CACHE": "off"}, checkout)
    made, counts = GROWING[name]
    rows: dict[str, list[list[float]]] = {str(count): [] for count in counts}
    for _ in range(processes):
        for count, row in rows.items():
            ran = done([sys.executable, "-c", made + _MEASURED, count], checkout, surroundings)
            row.append([float(x) for x in ran.out.split()])
    return {
        count: dict(zip(("first", "run"), map(statistics.median, zip(*row, strict=True)), strict=True))
        for count, row in rows.items()
    }


def tables(found: dict[str, dict]) -> tuple[str, str]:
    """Both tables, in Markdown."""
    first = table({
        "`bcfj ...`, kept programs": "`{name}`", "first answer": "{first:.1f} s", "all": "{all:.1f} s",
        "over the import": lambda r: f"{r['first'] / r['import']:.1f}, {r['all'] / r['import']:.1f}",
        "CPU over wall": lambda r: f"{r['cpu'] / r['all']:.2f}", "nothing kept": "{cold_first:.1f} s, {cold_all:.1f} s",
    }, ({"name": name, **row} for name, row in found.get("commands", {}).items()))  # fmt: skip
    rows = []
    for name, counts in found.get("growth", {}).items():
        least = next(iter(counts.values()))["first"]
        rows += [{"name": name, "count": count, "over": row["first"] / least, **row} for count, row in counts.items()]
    second = table({
        "what": "{name}", "number": "{count}", "first run": "{first:.1f} s", "over the least's": "{over:.2f}",
        "a compiled run": lambda r: f"{1e3 * r['run']:.1f} ms",
    }, rows)  # fmt: skip
    return first, second


def main() -> None:
    only = ([*COMMANDS, *GROWING], "parts to measure; the others stay as they are kept")
    given = options(__doc__, processes=5, only=only, against=(Path, "an older checkout, shown and not kept"))
    checkout = given.against.resolve() if given.against else ROOT
    found = {} if given.against else known("answers")
    for name in given.only:
        part, measured, every = ("commands", answers, COMMANDS) if name in COMMANDS else ("growth", growth, GROWING)
        rows = found.get(part, {}) | {name: measured(name, given.processes, checkout)}
        print(name, rows[name], flush=True)
        found[part] = {one: rows[one] for one in every if one in rows}
        if not given.against:
            save("answers", found)
    shown = tables(found)
    if given.against:
        print(*shown, sep="\n\n")
        return
    for name, text in zip(("answers", "alike"), shown, strict=True):
        publish(name, text, "docs/waiting.md")


if __name__ == "__main__":
    main()
