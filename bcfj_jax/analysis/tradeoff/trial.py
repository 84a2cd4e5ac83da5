"""One setting run: what came out, what it cost. Compiling apart, every result waited for.

``python -m bcfj_jax.analysis.tradeoff.trial FOLDER`` runs the scene files 0.json, 1.json, ... of a folder in 32-bit numbers,
to know what they would cost: the package refuses them, and JAX's width of numbers belongs to a whole process.
"""

from __future__ import annotations

import json
import math
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from bcfj_jax.analysis.engine import differentiated, simulated
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.status import reason
from bcfj_jax.io import usercode
from bcfj_jax.io.outputs import atomic, plain
from bcfj_jax.io.scenefile import SceneFile, from_table, shown
from bcfj_jax.io.stop import OutOfTime, check, within
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import Run, timed
from bcfj_jax.xla.compile_cache import open_cache

# Parameters that derivatives are taken by, the first few that a scene has and that are not 0.
_MAIN = (
    "stiffness", "friction_static", "load_torque", "damping", "restitution", "approach_speed", "drop_height",
    "exponent", "mass",
)  # fmt: skip
_AT_MOST = 3
# Seconds spent on repeating a run, and how often at least and at most; longer ones than the last are run once.
_SPEND, _LEAST, _MOST, _ONCE = 0.2, 3, 9, 5.0
# No program compiles in less; to look one up takes a millisecond, more on a busy machine.
_LOOK_UP = 0.05
# What of a run is compared, contact by contact.
READ = ("force", "penetration", "rate", "slip")
# How much dearer the next level of a ladder is taken to be, at least; derivatives than values, compiling included.
_NEXT, TANGENTS = 1.5, 4.0
T = TypeVar("T")


class Clock:
    """Seconds left, and what the next piece of work will take by those before it, compiling included."""

    def __init__(self, budget: float) -> None:
        self._end, self._programs, self._ladders = time.monotonic() + budget, set[Hashable](), dict[str, float]()
        self._compiles, self._tangents = list[float](), list[float]()

    def left(self) -> float:
        """Seconds, below 0 where it is over."""
        return self._end - time.monotonic()

    @property
    def over(self) -> bool:
        """Whether something was begun that did not end in time."""
        return self._end == -math.inf

    def within(self, what: Callable[[], T]) -> T:
        """What a function gives in the time left; none is left if that was not enough, for what is left behind still computes,
        and would disturb what is measured.
        """
        try:
            return within(self.left(), what)
        except OutOfTime:
            self._end = -math.inf
            raise

    def takes(self, ladder: str, program: Hashable) -> float:
        """What a setting will take [s]."""
        compile_s = statistics.median(self._compiles) if self._compiles and program not in self._programs else 0.0
        return compile_s + _NEXT * self._ladders.get(ladder, 0.0)

    def took(self, ladder: str, program: Hashable, row: Mapping[str, Any]) -> None:
        """A setting's row is there."""
        self.compiled([row.get("compile_s", 0.0)], [row.get("derivative_compile_s", 0.0)])
        self._programs.add(program)
        runs = row.get("repeats", 0) * row.get("wall_s", 0.0), row.get("derivative_wall_s", 0.0)
        self._ladders[ladder] = float(np.nansum(runs))

    def compiled(self, values: Sequence[float], tangents: Sequence[float]) -> None:
        """Seconds that compiling took, of values and of derivatives; 0 and NaN where nothing was."""
        self._compiles += [s for s in values if s > 0.0]
        self._tangents += [s for s in tangents if s > 0.0]

    def derivatives(self, program: Hashable, wall_s: float) -> float:
        """What derivatives will take beside a run of so many seconds."""
        known = self._tangents and program not in self._programs
        return (statistics.median(self._tangents) if known else 0.0) + TANGENTS * wall_s


class Trial(NamedTuple):
    """A run and its cost: ``wall_s`` the median of ``repeats``, ``compile_s`` 0 where the program was there."""

    run: Run
    cost: dict[str, float]


def loaded(table: Mapping[str, Any]) -> SceneFile:
    """A setting's scene file; errors as ``scenefile.load``."""
    return shown(from_table(table, None))


def trial(given: SceneFile, repeated: bool = True) -> Trial:
    """Run a scene file, several times where that is cheap; errors as ``simulate``."""

    def again() -> Run:
        """The same run, of what was checked already."""
        scene = given.scene.suited(given.params, float(given.times[-1]), given.solver)
        tolerance = plan(scene, given.accuracy, given.max_steps, given.solver).tolerance
        return timed(scene, given.params, given.times, Plan(tolerance, given.max_steps, solver=given.solver))

    return repeatedly(lambda: simulated(given, resolved_peaks=False), again if repeated else None)


def repeatedly(once: Callable[[], Run], again: Callable[[], Run] | None) -> Trial:
    """A run and what it costs, by several that are the same, which ``again`` makes; None where one is enough."""
    run = once()
    compile_s, walls = run.stats["compile_s"], [run.stats["wall_s"]]
    if again is not None and walls[0] < _ONCE:
        # The first run after a compilation also fills caches: it is not counted.
        walls = [again().stats["wall_s"] for _ in range(int(np.clip(_SPEND / walls[0], _LEAST, _MOST)))]
    cost = {"wall_s": float(np.median(walls)), "compile_s": compile_s if compile_s > _LOOK_UP else 0.0}
    return Trial(run, cost | {"repeats": len(walls), "steps": run.stats["accepted"] + run.stats["rejected"]})


def parameters(given: SceneFile) -> tuple[str, ...]:
    """Names of up to three main parameters."""
    values = given.resolved["parameters"]
    return tuple(name for name in _MAIN if values.get(name))[:_AT_MOST]


class Slopes(NamedTuple):
    """d(force)/d ln(parameter) (P, T, C, 3) [N], its cost [s], and why there is none."""

    value: np.ndarray | None
    wall_s: float
    compile_s: float
    reason: str


def slopes(given: SceneFile, names: tuple[str, ...]) -> Slopes:
    """Derivatives of a scene file's forces by the logarithms of parameters, by forward tangents."""
    try:
        found = differentiated(given, names)
        compile_s = found.compile_s
        if compile_s > _LOOK_UP and found.wall_s < _ONCE:
            found = differentiated(given, names)
    except InputError as error:
        return Slopes(None, float("nan"), float("nan"), str(error))
    compile_s = compile_s if compile_s > _LOOK_UP else 0.0
    if not found.good:
        why = reason(found.code, given.max_steps) or "derivatives that are not finite"
        return Slopes(None, found.wall_s, compile_s, f"{why}, at {found.end:g} s")
    sizes = np.array([float(given.params[name]) for name in names])
    return Slopes(found.derivative.force * sizes[:, None, None, None], found.wall_s, compile_s, "")


def singles(every: Sequence[Mapping[str, Any]], seconds: float) -> list[Trial | RuntimeError]:
    """Run scene files in 32-bit numbers, in one other process, for so many seconds at most: of each its run, or an error where
    that process failed, with its last line, or did not come so far in time. A Ctrl-C that came meanwhile is raised.
    """
    with tempfile.TemporaryDirectory() as place:
        for k, table in enumerate(every):
            Path(place, f"{k}.json").write_text(json.dumps(plain(table)))
        command = [sys.executable, "-m", "bcfj_jax.analysis.tradeoff.trial", place, *usercode.arguments()]
        why = ""
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=max(seconds, 1.0), check=False)
            if done.returncode:
                why = ([line for line in done.stderr.splitlines() if line.strip()] or [f"exit {done.returncode}"])[-1]
        except subprocess.TimeoutExpired:
            why = f"not done within the {seconds:.0f} s that were left"
        check()
        return [_read(Path(place, f"{k}.npz"), why) for k in range(len(every))]


def _read(path: Path, why: str) -> Trial | RuntimeError:
    """A run of the other process, or ``why`` there is none."""
    if not path.exists():
        return RuntimeError(f"32-bit numbers: {why}")
    with np.load(path) as kept:
        result = json.loads(str(kept["result"]))
        if "error" in result:
            return RuntimeError(f"32-bit numbers: {result['error']}")
        parts = {name: {c: kept[f"{name} {c}"] for c in result["contacts"][name]} for name in READ}
        return Trial(Run(times=kept["times"], **parts, **result["status"]), result["cost"])


def _child(folder: Path) -> None:
    files = sorted(folder.glob("*.json"), key=lambda path: int(path.stem))
    for path in files:
        jax.config.update("jax_enable_x64", True)  # Planned in the width that planning asks for.
        try:
            given = loaded(json.loads(path.read_text()))
            given.scene.check(given.params)
            tolerance = float(plan(given.scene, given.accuracy, given.max_steps, given.solver).tolerance)
        except InputError as error:
            np.savez(path.with_suffix(".npz"), result=json.dumps({"error": str(error)}))
            continue
        jax.config.update("jax_enable_x64", False)
        warnings.filterwarnings("ignore", message="Explicitly requested dtype")
        _narrow(given, tolerance, path.with_suffix(".npz"))


def _narrow(given: SceneFile, tolerance: float, out: Path) -> None:
    params = {name: jax.numpy.asarray(np.float32(value)) for name, value in given.params.items()}
    how = Plan(jax.numpy.asarray(np.float32(tolerance)), given.max_steps, solver=given.solver)
    once = lambda: timed(given.scene, params, given.times, how)  # noqa: E731
    run, cost = repeatedly(once, once)
    result = {
        "contacts": {name: list(getattr(run, name)) for name in READ},
        "status": {"status": run.status, "reason": run.reason, "failure_time": run.failure_time, "stats": run.stats},
        "cost": cost,
    }
    arrays = {f"{name} {c}": np.asarray(x, float) for name in READ for c, x in getattr(run, name).items()}
    with atomic(out) as temporary, temporary.open("wb") as file:
        np.savez(file, times=given.times, result=json.dumps(result), **arrays)  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    open_cache()
    usercode.from_arguments(sys.argv)
    _child(Path(sys.argv[1]))
