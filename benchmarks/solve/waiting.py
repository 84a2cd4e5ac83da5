"""What a user waits for: whole processes of the command or of a script, cold and warm, and where their seconds go.

Cold: no program is kept. Warm: the same command before has filled the cache. Medians of whole processes, beside an import of
jax, diffrax and pyplot in the same run, since machines differ. Stages are those of one more process of each kind: import
(outermost import statements), trace, lower, compile or fetch (XLA and its cache), run and the rest, pictures. Programs
that compile side by side count in full, so stages may add up to more than the whole. Computing: the same search or study
once more in one process.

    python -m benchmarks.solve.waiting [--processes 5] [--only NAME,...]    keeps benchmarks/results/waiting.json
    python -m benchmarks.solve.waiting --before OTHER [--only ...]          one process each of an older checkout, beside it
"""

from __future__ import annotations

import builtins
import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
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


def worker(words: list[str], folder: str) -> dict[str, float]:
    """The command or script in this process, and where its time went."""
    os.chdir(folder)
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
    return spent


def prepared(folder: Path) -> None:
    """The files that commands and scripts name."""
    (folder / "study.toml").write_text(_STUDY)
    joint_problem(folder)


def process(words: list[str] | str, cache: Path, checkout: Path = ROOT) -> tuple[float, str]:
    """Seconds of one whole process, and what it printed."""
    from benchmarks.processes import done, environment

    with tempfile.TemporaryDirectory() as folder:
        prepared(Path(folder))
        inner = ["-c", words] if isinstance(words, str) else ["-m", "bcfj_jax", *words]
        surroundings = environment({"BCFJ_CACHE": str(cache), "EQX_ON_ERROR": "nan"}, checkout)
        ran = done([sys.executable, *inner], Path(folder), surroundings)
        return ran.wall_s, ran.out


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
    from benchmarks.processes import call

    given = ["-c", words] if isinstance(words, str) else words
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(SystemExit, ValueError, IndexError):
        prepared(Path(folder))
        variables = {"BCFJ_CACHE": str(cache), "EQX_ON_ERROR": "nan"}
        return call(__file__, "worker", given, folder, variables=variables, checkout=checkout)
    return {}


def importing() -> float:
    begin = time.perf_counter()
    subprocess.run(IMPORT, check=True)
    return time.perf_counter() - begin


def both(of: Callable[[Path], Any]) -> dict[str, Any]:
    """What is found of a process with nothing kept, and of the next one."""
    with tempfile.TemporaryDirectory() as folder:
        return {kind: of(Path(folder)) for kind in ("cold", "warm")}


def measured(words: list[str] | str, count: int) -> dict[str, Any]:
    """Seconds cold and warm, the import beside them, and the stages of one process of each kind."""
    rows = [both(lambda cache: process(words, cache)[0]) | {"import": importing()} for _ in range(count)]
    row = {name: [one[name] for one in rows] for name in rows[0]}
    stages = both(lambda cache: stages_of(words, cache))
    return {name: statistics.median(values) for name, values in row.items()} | {"all": row, "stages": stages}


def before(words: list[str] | str, checkout: Path) -> dict[str, Any]:
    """Seconds of one process, cold and warm, of an older checkout, and where they went."""
    stages = both(lambda cache: stages_of(words, cache, checkout))
    return {**both(lambda cache: process(words, cache, checkout)[0]), "stages": stages}


def table(result: dict[str, Any]) -> str:
    """Seconds, goals, and the ratio of the warm process to the import."""
    from benchmarks.common import table

    def goal(row: dict[str, Any], kind: int) -> str:
        given = COMMANDS[row["name"]][kind]
        if kind == 2 and "computing" in row:
            return f"{row['computing'] + BEYOND[row['name']][1]:.1f} s"
        return f"{given:g} s" if given else ""

    def old(kind: str) -> Callable[[dict[str, Any]], str]:
        return lambda row: f"{row['before'][kind]:.1f} s" if "before" in row else ""

    columns = [
        ("`bcfj ...`, or a script", "`{name}`"), ("before: cold", old("cold")), ("warm", old("warm")), ("cold", "{cold:.2f} s"),
        ("goal", lambda row: goal(row, 1)), ("warm", "{warm:.2f} s"), ("goal", lambda row: goal(row, 2)),
        ("warm over import", lambda row: f"{row['warm'] / row['import']:.2f}"),
    ]  # fmt: skip
    return table(columns, ({"name": name, **row} for name, row in result["commands"].items()))


def where(result: dict[str, Any]) -> str:
    """Where the seconds go."""
    from benchmarks.common import markdown

    rows = [["`bcfj ...`, or a script", "", *STAGES]]
    for name, row in result["commands"].items():
        for kind in ("cold", "warm"):
            sides = {f"before, {kind}": row["before"]["stages"][kind]} if "before" in row else {}
            sides |= {kind: row["stages"][kind]} if row["stages"][kind] else {}
            rows += [[f"`{name}`", k, *(f"{s.get(stage, 0.0):.2f}" for stage in STAGES)] for k, s in sides.items()]
    return markdown(rows)


def main() -> None:
    # A worker has the package of its checkout, whose benchmarks may be others.
    from benchmarks.common import known, options, publish, save

    given = options(__doc__, processes=5, only="", before=Path)
    result: dict[str, Any] = {}
    kept = known("waiting").get("commands", {})
    for name in [name for name in given.only.split(",") if name] or COMMANDS:
        old = kept.get(name, {})
        if given.before:
            kept[name] = {**old, "before": before(COMMANDS[name][0], given.before.resolve())}
        else:
            kept[name] = measured(COMMANDS[name][0], given.processes)
            kept[name] |= {"before": old["before"]} if "before" in old else {}
            if name in BEYOND:
                with tempfile.TemporaryDirectory() as folder:
                    text = process(_COMPUTING[BEYOND[name][0]], Path(folder))[1]
                kept[name]["computing"] = float(text.splitlines()[-1])
            print(name, {k: round(kept[name][k], 2) for k in ("cold", "warm", "import")}, flush=True)
        result = {"commands": {name: kept[name] for name in COMMANDS if "cold" in kept.get(name, {})}}
        # What was measured is kept, whatever comes after it.
        save("waiting", result)
    publish("waiting", table(result), "docs/waiting.md")
    publish("stages", where(result), "docs/waiting.md")


if __name__ == "__main__":
    main()
