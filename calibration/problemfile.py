"""Calibration files: a TOML problem becomes a ``Problem``, every mistake named by file and key.

scene = "impact.toml"            a scene file (relative to this one) or a built-in scene's name
[[experiment]]                   file, time, rows, observe, noise, hold_out; parameters (known for it alone);
                                 align = "onset" puts time 0 where the force first exceeds a tenth of its
                                 peak; window = [from, to] keeps those times (after aligning)
[free.NAME]                      lower, upper, start, scale; each = true gives every experiment its own
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic

from bcfj_jax import InputError, nearest, scenefile, scenes, tables
from bcfj_jax.quantities import Quantity
from bcfj_jax.units import quantity
from calibration.problem import NUISANCES, Channel, Experiment, Free, Problem
from calibration.table import Table, read, split


class _Experiment(tables.Table):
    file: str
    time: str
    observe: dict[str, str]
    noise: Any = "estimate"
    rows: dict[str, Any] = {}
    hold_out: bool = False
    parameters: dict[str, Any] = {}
    align: Literal["onset"] | None = None
    window: list[Any] | None = None


class _Free(tables.Table):
    lower: Any
    upper: Any
    start: Any = None
    scale: Literal["log", "linear"] | None = None
    each: bool = False


class _File(tables.Table):
    scene: str
    experiment: list[_Experiment] = pydantic.Field(min_length=1)
    free: dict[str, _Free]


def load(path: str | Path) -> Problem:
    """The problem that a calibration file states.

    Raises:
        InputError: for anything missing, unknown, of a wrong dimension or out of order, in it or in its data.
    """
    path = Path(path)
    file = tables.validated(_File, tables.read(path), str(path))
    beside = path.parent / file.scene
    if file.scene.endswith(".toml") and not beside.exists():
        raise InputError(f"{path}: scene", f"no file {beside}", "give a path relative to this file, or a scene's name")
    if not file.scene.endswith(".toml") and file.scene not in scenes.SCENES:
        raise InputError(f"{path}: scene", f"no scene '{file.scene}'", nearest(file.scene, scenes.SCENES))
    base = scenefile.load(beside if file.scene.endswith(".toml") else file.scene)
    known = base.scene.quantities
    experiments: list[Experiment] = []
    for k, entry in enumerate(file.experiment):
        experiments += _experiments(entry, path, f"{path}: [[experiment]] {k + 1}", known)
    return Problem(
        scene=base.scene,
        params={name: float(value) for name, value in base.params.items()},
        experiments=tuple(experiments),
        free=tuple(_free(name, table, path, known) for name, table in file.free.items()),
        where=str(path),
    )


def sources(path: Path) -> list[Path]:
    """The data files a calibration file reads, for checksums."""
    file = tables.validated(_File, tables.read(path), str(path))
    return [path.parent / name for name in dict.fromkeys(entry.file for entry in file.experiment)]


def _free(name: str, table: _Free, path: Path, known: dict[str, Quantity]) -> Free:
    unit = {**known, **NUISANCES}[name].unit if name in known or name in NUISANCES else None
    # The unit of a stiffness follows an exponent that may itself be free: its bounds' own unit is taken.
    texts = {key: getattr(table, key) for key in ("lower", "upper", "start") if getattr(table, key) is not None}
    numbers = {
        key: quantity(value, unit, f"{path}: [free.{name}] {key}") if unit else 0.0 for key, value in texts.items()
    }
    return Free(name, numbers["lower"], numbers["upper"], numbers.get("start"), table.scale, table.each)


def _experiments(entry: _Experiment, path: Path, where: str, known: dict[str, Quantity]) -> list[Experiment]:
    whole = read(path.parent / entry.file, f"{where} file")
    fixed = {}
    for name, value in entry.parameters.items():
        if name not in known:
            raise InputError(f"{where} parameters", f"the scene has no parameter '{name}'", ", ".join(known))
        fixed[name] = quantity(value, known[name].unit, f"{where} parameters.{name}")
    if not entry.observe:
        raise InputError(f"{where} observe", "nothing is observed", 'give { "contact.normal" = "force [N]" }')
    return [_experiment(entry, name, part, where, fixed) for name, part in split(whole, entry.rows, where)]


def _experiment(entry: _Experiment, name: str, part: Table, where: str, fixed: dict[str, float]) -> Experiment:
    times = part.numbers(entry.time, "s", f"{where} time", blank=False)
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = int(late[0]) + 1
        raise InputError(
            f"{part.path}: line {part.lines[k]}, column '{entry.time}'",
            f"time {times[k]:g} s follows {times[k - 1]:g} s",
            "times must increase: sort the rows, or split the runs with rows = { column = [values] }",
        )
    columns = {}
    for observes, header in entry.observe.items():
        sign = -1.0 if header.startswith("-") else 1.0
        columns[observes] = sign * part.numbers(header.removeprefix("-").strip(), "N", f"{where} observe", blank=True)
    if entry.align:
        times = times - _onset(times, next(iter(columns.values())), where)
    keep = np.ones(times.size, dtype=bool)
    if entry.window is not None:
        if len(entry.window) != 2:
            raise InputError(f"{where} window", f"{entry.window}", 'give [from, to], such as ["-20 ms", "0.3 s"]')
        first, last = (quantity(w, "s", f"{where} window") for w in entry.window)
        keep = (times >= first) & (times <= last)
        if np.count_nonzero(keep) < 3:
            raise InputError(
                f"{where} window", f"{np.count_nonzero(keep)} samples of {name} lie in it", "widen the window"
            )
    channels = tuple(
        Channel(observes, values[keep], _noise(entry.noise, values[keep], f"{where} noise"))
        for observes, values in columns.items()
    )
    source = f"{part.path}: lines {part.lines[0]} to {part.lines[-1]}"
    return Experiment(name, times[keep], channels, entry.hold_out, fixed, source)


def _onset(times: np.ndarray, values: np.ndarray, where: str) -> float:
    """Time of the first sample above a tenth of the peak."""
    peak = np.nanmax(values)
    if not peak > 0:
        raise InputError(f"{where} observe", "the force is never positive", 'flip its sign with "-" before the column')
    return float(times[np.flatnonzero(values > 0.1 * peak)[0]])


def _noise(noise: object, values: np.ndarray, where: str) -> float | None:
    """Standard deviation [N]: a force, or a percentage of the channel's largest reading; None to estimate it."""
    if not np.nanmax(np.abs(values), initial=0.0) > 0:
        raise InputError(where, "the record holds no force at all", "choose another column, or widen the window")
    if noise == "estimate":
        return None
    largest = float(np.nanmax(np.abs(values)))
    share = isinstance(noise, str) and noise.strip().endswith("%")
    sigma = quantity(noise, "1", where) * largest if share else quantity(noise, "N", where)
    if not sigma > 0:
        raise InputError(
            where, f"noise = {noise} gives a deviation of {sigma:g} N", 'give "2 %", "0.1 kN" or "estimate"'
        )
    return sigma
