"""What a user waits for: whole processes of the command, cold and warm, and where their seconds go.

Cold: no program is kept. Warm: the same command before has filled the cache. Medians of whole processes, beside an import of
jax, diffrax and pyplot in the same run, since machines differ. Stages are those of one more process of each kind: import
(outermost import statements), trace, lower, compile or fetch (XLA and its cache), run and the rest, pictures.

    python -m benchmarks.solve.waiting [--processes 5] [--only NAME,...]    keeps benchmarks/results/waiting.json
    python -m benchmarks.solve.waiting --worker WORDS                       (internal) one process, its stages to stderr
"""

from __future__ import annotations

import argparse
import builtins
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, ROOT, load, markdown, put_in_readme, save

IMPORT = [sys.executable, "-c", "import jax, diffrax, matplotlib.pyplot"]
_EIGHT = (
    "stiffness,exponent,damping,friction_static,friction_dynamic,clearance_seat_cage,clearance_seat_ball,contact_angle"
)
_STUDY = """scene = "impact"
[design]
kind = "grid"
[vary.clearance_contact]
lower = "1 um"
upper = "100 um"
steps = 256
[results]
features = ["contact.peak"]
histories = false
"""
# Name: words of the command, and what issue 20 asks for, cold and warm [s].
COMMANDS: dict[str, tuple[list[str], float | None, float | None]] = {
    "--help": (["--help"], 0.3, 0.3),
    "simulate missing.toml": (["simulate", "missing.toml"], 0.3, 0.3),
    "simulate impact": (["simulate", "impact"], 4.0, 2.5),
    "simulate joint": (["simulate", "joint"], 12.0, 4.0),
    "calibrate the demo": (["calibrate", str(ROOT / "examples" / "chung_ooi_fit.toml")], 15.0, 5.0),
    "sensitivity impact": (["sensitivity", "impact", "--wrt", "stiffness,damping"], 8.0, 4.0),
    "sensitivity joint": (["sensitivity", "joint", "--wrt", _EIGHT], 60.0, 15.0),
    "study of 256 clearances": (["study", "run", "study.toml"], None, None),
}
STAGES = ("import", "trace", "lower", "compile", "pictures", "rest")
_EVENTS = {
    "jaxpr_trace_duration": "trace",
    "jaxpr_to_mlir_module_duration": "lower",
    "backend_compile_duration": "compile",
}


def worker(words: list[str]) -> None:
    """The command in this process; where its time went, as JSON, to stderr."""
    begin, depth = time.perf_counter(), [0]
    spent: dict[str, float] = dict.fromkeys(STAGES, 0.0)
    plain = builtins.__import__

    def importing(*arguments: Any, **options: Any) -> Any:
        depth[0] += 1
        start = time.perf_counter()
        try:
            return plain(*arguments, **options)
        finally:
            depth[0] -= 1
            if not depth[0]:
                spent["import"] += time.perf_counter() - start

    builtins.__import__ = importing
    from bcfj_jax.cli import main

    def drawn(function: Any) -> Any:
        def timed(*arguments: Any, **options: Any) -> Any:
            start, before = time.perf_counter(), spent["import"]
            try:
                return function(*arguments, **options)
            finally:
                spent["pictures"] += time.perf_counter() - start - (spent["import"] - before)

        return timed

    if "--help" not in words and "missing.toml" not in words:
        import jax

        from bcfj_jax.io import plots, report

        plots.save, report.write = drawn(plots.save), drawn(report.write)

        def heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
            del kwargs
            stage = _EVENTS.get(event.rpartition("/")[2])
            if stage:
                spent[stage] += duration_secs

        jax.monitoring.register_event_duration_secs_listener(heard)
    sys.argv = ["bcfj", *words]
    with contextlib.suppress(SystemExit):
        main()
    whole = time.perf_counter() - begin
    spent["rest"] = whole - sum(spent.values())
    print(json.dumps(spent), file=sys.stderr)


def process(words: list[str], cache: Path, module: str = "bcfj_jax") -> tuple[float, str]:
    """Seconds of one whole process, and what it said on stderr."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.toml").write_text(_STUDY)
        surroundings = {**os.environ, "BCFJ_CACHE": str(cache), "PYTHONPATH": str(ROOT)}
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", *module.split(), *words],
            env=surroundings,
            cwd=folder,
            capture_output=True,
            text=True,
        )
        return time.perf_counter() - begin, done.stderr


def importing() -> float:
    begin = time.perf_counter()
    subprocess.run(IMPORT, check=True)
    return time.perf_counter() - begin


def measured(words: list[str], count: int) -> dict[str, Any]:
    """Seconds cold and warm, the import beside them, and the stages of one process of each kind."""
    row: dict[str, list[float]] = {"cold": [], "warm": [], "import": []}
    stages = {}
    inner = "benchmarks.solve.waiting --worker"
    for k in range(count):
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder)
            row["cold"].append(process(words, cache)[0])
            row["import"].append(importing())
            row["warm"].append(process(words, cache)[0])
            if k == count - 1:
                stages["warm"] = json.loads(process(words, cache, inner)[1].splitlines()[-1])
                with tempfile.TemporaryDirectory() as other:
                    stages["cold"] = json.loads(process(words, Path(other), inner)[1].splitlines()[-1])
    return {name: statistics.median(values) for name, values in row.items()} | {"all": row, "stages": stages}


def table(result: dict[str, Any]) -> str:
    """Seconds, goals, and the ratio of the warm process to the import."""
    rows = [["`bcfj ...`", "cold", "goal", "warm", "goal", "warm over import"]]
    for name, row in result["commands"].items():
        goals = [f"{goal:g} s" if goal else "" for goal in COMMANDS[name][1:]]
        rows.append(
            [
                f"`{name}`",
                f"{row['cold']:.2f} s",
                goals[0],
                f"{row['warm']:.2f} s",
                goals[1],
                f"{row['warm'] / row['import']:.2f}",
            ]
        )
    return markdown(rows)


def where(result: dict[str, Any]) -> str:
    """Where the seconds go."""
    rows = [["`bcfj ...`", "", *STAGES]]
    for name, row in result["commands"].items():
        for kind in ("cold", "warm"):
            rows.append([f"`{name}`", kind, *(f"{row['stages'][kind][stage]:.2f}" for stage in STAGES)])
    return markdown(rows)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    wanted = [name for name in given.only.split(",") if name] or list(COMMANDS)
    kept = load("waiting")["commands"] if (RESULTS / "waiting.json").exists() else {}
    for name in wanted:
        kept[name] = measured(COMMANDS[name][0], given.processes)
        print(name, {k: round(kept[name][k], 2) for k in ("cold", "warm", "import")}, flush=True)
    result = {"processes": given.processes, "commands": {name: kept[name] for name in COMMANDS if name in kept}}
    save("waiting", result)
    put_in_readme("waiting", table(result), "docs/waiting.md")
    put_in_readme("stages", where(result), "docs/waiting.md")
    print(table(result), where(result), sep="\n\n")


if __name__ == "__main__":
    if "--worker" in sys.argv:
        worker(sys.argv[sys.argv.index("--worker") + 1 :])
    else:
        main()
