"""What a user waits for: whole processes of the command or of a script, cold and warm, and where their seconds go.

Cold: no program is kept. Warm: the same command before has filled the cache. Medians of whole processes, beside an import of
jax, diffrax and pyplot in the same run, since machines differ. Stages are those of one more process of each kind: import
(outermost import statements), trace, lower, compile or fetch (XLA and its cache), run and the rest, pictures. Programs
that compile side by side count in full, so stages may add up to more than the whole. Computing: the same search or study
once more in one process.

    python -m benchmarks.solve.waiting [--processes 5] [--only NAME,...]    keeps benchmarks/results/waiting.json
    python -m benchmarks.solve.waiting --before OTHER [--only ...]          one process each of an older checkout, beside it
    python benchmarks/solve/waiting.py --worker WORDS                       (internal) one process, its stages to stderr
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

import numpy as np

ROOT = Path(__file__).resolve().parent.parent.parent

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
# Of a fit of the joint's seven coefficients (benchmarks/calibration/joint_calibration.py): damping is held wrong.
_JOINT_SCENE = """[scene]
kind = "joint"
[parameters]
damping = 0.1998
[time]
end = "0.6 s"
samples = 601
"""
_DESIGN = """import numpy as np
import bcfj_jax as bj

bj.use_cache()
scene = bj.scenes.joint(fidelity="quasistatic")
free = {"offset": ("2.84 mm", "4.97 mm", "20 um"), "clearance_cage_ball": ("0 um", "40 um", "5 um")}
print(bj.design(scene, scene.parameters(), np.linspace(0.15, 0.25, 13), "cage_ball.largest", free, starts=8).status)
"""
_QUASISTATIC = """import numpy as np
import bcfj_jax as bj

bj.use_cache()
scene = bj.scenes.joint(fidelity="quasistatic")
names = ["seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball"]
wrt = [f"clearance_{name}" for name in names]
print(bj.sensitivity(scene, scene.parameters(), np.linspace(0.0, 0.6, 121), wrt).certificate.verdict)
"""
_COMPUTING = {
    "fit": """import time
import bcfj_jax as bj

bj.use_cache()
import calibration

problem = calibration.load("joint.toml")
for _ in range(2):
    begin = time.perf_counter()
    calibration.fit(problem, starts=6)
print(time.perf_counter() - begin)
""",
    "study": """import time
import bcfj_jax as bj

bj.use_cache()
for out in ("first", "second"):
    begin = time.perf_counter()
    bj.study("study.toml", out)
print(time.perf_counter() - begin)
""",
}
# Name: words of the command or a script, and what issue 20 asks for, cold and warm [s].
COMMANDS: dict[str, tuple[list[str] | str, float | None, float | None]] = {
    "--help": (["--help"], 0.3, 0.3),
    "simulate missing.toml": (["simulate", "missing.toml"], 0.3, 0.3),
    "simulate impact": (["simulate", "impact"], 4.0, 2.5),
    "simulate joint": (["simulate", "joint"], 12.0, 4.0),
    "calibrate the demo": (["calibrate", str(ROOT / "examples" / "chung_ooi_fit.toml")], 15.0, 5.0),
    "calibrate the pad of 40 mm by three laws": (["calibrate", str(ROOT / "examples" / "pad_40mm.toml")], None, 30.0),
    "sensitivity impact": (["sensitivity", "impact", "--wrt", "stiffness,damping"], 8.0, 4.0),
    "sensitivity joint": (["sensitivity", "joint", "--wrt", _EIGHT], 60.0, 15.0),
    "calibrate the joint's seven": (["calibrate", "joint.toml", "--starts", "6"], None, None),
    "study of 256 clearances": (["study", "run", "study.toml"], None, None),
    "design": (_DESIGN, 35.0, 12.0),
    "quasistatic sensitivity": (_QUASISTATIC, 25.0, 8.0),
    "tradeoff impact --budget 30": (["tradeoff", "impact", "--budget", "30"], 33.0, 33.0),
    "tradeoff joint --budget 60": (["tradeoff", "joint", "--budget", "60"], 66.0, 66.0),
}
# What the warm command may take beyond its computing [s], and what computes.
BEYOND = {"calibrate the joint's seven": ("fit", 10.0), "study of 256 clearances": ("study", 5.0)}
STAGES = ("import", "trace", "lower", "compile", "pictures", "rest")
_EVENTS = {
    "jaxpr_trace_duration": "trace",
    "jaxpr_to_mlir_module_duration": "lower",
    "backend_compile_duration": "compile",
}


def worker(words: list[str]) -> None:
    """The command or script in this process; where its time went, as JSON, to stderr."""
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
        if words[0] == "-c":
            exec(words[1], {})
        else:
            main()
    whole = time.perf_counter() - begin
    spent["rest"] = max(whole - sum(spent.values()), 0.0)
    print(json.dumps(spent), file=sys.stderr)


def process(words: list[str] | str, cache: Path, worker: bool = False, checkout: Path = ROOT) -> tuple[float, str]:
    """Seconds of one whole process, and what it printed: a script on stdout, a worker its stages on stderr."""
    given = ["-c", words] if isinstance(words, str) else words
    inner = [str(Path(__file__).resolve()), "--worker"] if worker else ["-m", "bcfj_jax"] if given == words else []
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.toml").write_text(_STUDY)
        if "joint.toml" in given or words == _COMPUTING["fit"]:
            joint_problem(Path(folder))
        surroundings = {**os.environ, "BCFJ_CACHE": str(cache), "PYTHONPATH": str(checkout), "EQX_ON_ERROR": "nan"}
        command = [sys.executable, *inner, *given]
        begin = time.perf_counter()
        done = subprocess.run(command, env=surroundings, cwd=folder, capture_output=True, text=True)
        return time.perf_counter() - begin, done.stderr if worker else done.stdout


def joint_problem(folder: Path) -> None:
    """A problem file of the joint's seven coefficients, its record with 2 % noise, and its scene."""
    from benchmarks.calibration import joint_calibration as joint

    experiment = joint.problem(0.02, 0, {}).experiments[0]
    names = [channel.observes for channel in experiment.channels]
    columns = [experiment.times, *(channel.values for channel in experiment.channels)]
    rows = [",".join(["time [s]", *(f"{name} [N]" for name in names)])]
    rows += [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    (folder / "record.csv").write_text("\n".join(rows) + "\n")
    (folder / "scene.toml").write_text(_JOINT_SCENE)
    text = 'scene = "scene.toml"\n\n[[experiment]]\nfile = "record.csv"\ntime = "time [s]"\n'
    for name, channel in zip(names, experiment.channels, strict=True):
        text += f'observe."{name}" = "{name} [N]"\nnoise."{name}" = {channel.sigma!r}\n'
    for name, (low, high) in joint.BOUNDS.items():
        if name != "damping":
            text += f"\n[free.{name}]\nlower = {low * joint.TRUTH[name]!r}\nupper = {high * joint.TRUTH[name]!r}\n"
    (folder / "joint.toml").write_text(text)


def stages_of(words: list[str] | str, cache: Path, checkout: Path = ROOT) -> dict[str, float]:
    """Stages of one process; none of one whose budget ended it while something computed."""
    *_, last = process(words, cache, True, checkout)[1].splitlines() or [""]
    return json.loads(last) if last.startswith("{") else {}


def importing() -> float:
    begin = time.perf_counter()
    subprocess.run(IMPORT, check=True)
    return time.perf_counter() - begin


def measured(words: list[str] | str, count: int) -> dict[str, Any]:
    """Seconds cold and warm, the import beside them, and the stages of one process of each kind."""
    row: dict[str, list[float]] = {"cold": [], "warm": [], "import": []}
    stages = {}
    for k in range(count):
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder)
            row["cold"].append(process(words, cache)[0])
            row["import"].append(importing())
            row["warm"].append(process(words, cache)[0])
            if k == count - 1:
                stages["warm"] = stages_of(words, cache)
                with tempfile.TemporaryDirectory() as other:
                    stages["cold"] = stages_of(words, Path(other))
    return {name: statistics.median(values) for name, values in row.items()} | {"all": row, "stages": stages}


def before(words: list[str] | str, checkout: Path) -> dict[str, Any]:
    """Seconds of one process, cold and warm, of an older checkout, and where they went."""
    row: dict[str, Any] = {"stages": {}}
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("cold", "warm"):
            row[kind] = process(words, Path(folder), False, checkout)[0]
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("cold", "warm"):
            row["stages"][kind] = stages_of(words, Path(folder), checkout)
    return row


def table(result: dict[str, Any]) -> str:
    """Seconds, goals, and the ratio of the warm process to the import."""
    rows = [["`bcfj ...`, or a script", "before: cold", "warm", "cold", "goal", "warm", "goal", "warm over import"]]
    for name, row in result["commands"].items():
        goals = [f"{goal:g} s" if goal else "" for goal in COMMANDS[name][1:]]
        if "computing" in row:
            goals[1] = f"{row['computing'] + BEYOND[name][1]:.1f} s"
        rows.append(
            [
                f"`{name}`",
                *(f"{row['before'][kind]:.1f} s" if "before" in row else "" for kind in ("cold", "warm")),
                f"{row['cold']:.2f} s",
                goals[0],
                f"{row['warm']:.2f} s",
                goals[1],
                f"{row['warm'] / row['import']:.2f}",
            ]
        )
    from benchmarks.common import markdown

    return markdown(rows)


def where(result: dict[str, Any]) -> str:
    """Where the seconds go."""
    rows = [["`bcfj ...`, or a script", "", *STAGES]]
    for name, row in result["commands"].items():
        for kind in ("cold", "warm"):
            if "before" in row:
                old = row["before"]["stages"][kind]
                rows.append([f"`{name}`", f"before, {kind}", *(f"{old.get(stage, 0.0):.2f}" for stage in STAGES)])
            if row["stages"][kind]:
                rows.append([f"`{name}`", kind, *(f"{row['stages'][kind][stage]:.2f}" for stage in STAGES)])
    from benchmarks.common import markdown

    return markdown(rows)


def main() -> None:
    from benchmarks.common import RESULTS, load, put_in_readme, save

    parser = argparse.ArgumentParser()
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--only", default="")
    parser.add_argument("--before", type=Path)
    given = parser.parse_args()
    wanted = [name for name in given.only.split(",") if name] or list(COMMANDS)
    result: dict[str, Any] = {}
    kept = load("waiting")["commands"] if (RESULTS / "waiting.json").exists() else {}
    for name in wanted:
        old = kept.get(name, {})
        if given.before:
            kept[name] = {**old, "before": before(COMMANDS[name][0], given.before.resolve())}
        else:
            kept[name] = measured(COMMANDS[name][0], given.processes)
            if "before" in old:
                kept[name]["before"] = old["before"]
            if name in BEYOND:
                with tempfile.TemporaryDirectory() as folder:
                    text = process(_COMPUTING[BEYOND[name][0]], Path(folder))[1]
                kept[name]["computing"] = float(text.splitlines()[-1])
            print(name, {k: round(kept[name][k], 2) for k in ("cold", "warm", "import")}, flush=True)
        result = {"commands": {name: kept[name] for name in COMMANDS if "cold" in kept.get(name, {})}}
        # What was measured is kept, whatever comes after it.
        save("waiting", result)
    put_in_readme("waiting", table(result), "docs/waiting.md")
    put_in_readme("stages", where(result), "docs/waiting.md")
    print(table(result), where(result), sep="\n\n")


if __name__ == "__main__":
    if "--worker" in sys.argv:
        worker(sys.argv[sys.argv.index("--worker") + 1 :])
    else:
        main()
