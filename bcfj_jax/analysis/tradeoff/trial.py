"""One setting run: what came out, what it cost. Compiling apart, every result waited for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.engine import differentiated, simulated
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.status import reason
from bcfj_jax.io.scenefile import SceneFile, from_table, shown
from bcfj_jax.solve.simulation import Run

# Parameters that derivatives are taken by, the first few that a scene has and that are not 0.
_MAIN = (
    "stiffness", "friction_static", "load_torque", "damping", "restitution", "approach_speed", "drop_height",
    "exponent", "mass",
)  # fmt: skip
_AT_MOST = 3
# Seconds spent on repeating a run, and how often at least and at most; longer ones than the last are run once.
_SPEND, _LEAST, _MOST, _ONCE = 0.4, 3, 9, 5.0
# No program compiles in less; to look one up takes a millisecond, more on a busy machine.
_LOOK_UP = 0.05


class Trial(NamedTuple):
    """A run and its cost: ``wall_s`` the median of ``repeats``, ``compile_s`` 0 where the program was there."""

    run: Run
    cost: dict[str, float]


def loaded(table: Mapping[str, Any]) -> SceneFile:
    """A setting's scene file; errors as ``scenefile.load``."""
    return shown(from_table(table, None))


def trial(given: SceneFile, repeated: bool = True) -> Trial:
    """Run a scene file, several times where that is cheap; errors as ``simulate``."""
    return repeatedly(lambda: simulated(replace(given, resolved_peaks=False)), repeated)


def repeatedly(once: Callable[[], Run], repeated: bool = True) -> Trial:
    """The first of several runs that are the same, and what they cost."""
    run = once()
    compile_s, walls = run.stats["compile_s"], [run.stats["wall_s"]]
    if repeated and walls[0] < _ONCE:
        # The first run after a compilation also fills caches: it is not counted.
        walls = [once().stats["wall_s"] for _ in range(int(np.clip(_SPEND / walls[0], _LEAST, _MOST)))]
    cost = {
        "wall_s": float(np.median(walls)),
        "compile_s": compile_s if compile_s > _LOOK_UP else 0.0,
        "repeats": len(walls),
        "steps": run.stats["accepted"] + run.stats["rejected"],
    }
    return Trial(run, cost)


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
