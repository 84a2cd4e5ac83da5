"""Calibration files: a TOML problem becomes a ``Problem``, every mistake named by file and key.

scene = "impact.toml"            a scene file (relative to this one) or a built-in scene's name
[[experiment]]                   name; file (of a kind in ``readers``), table (which one inside it), time, rows,
                                 observe, noise (of the samples as fitted) and its correlation time, hold_out;
                                 parameters (known for it alone; "0.55 kg +- 2 %" says how well); features,
                                 feature_noise and span (``stated``);
                                 saturation = "10 kN" (or of each channel, as noise) drops samples at or beyond it;
                                 resample = "10 kHz" brings the record down to that rate; align = "onset" puts time 0
                                 where the first channel first exceeds a tenth of its peak; window = [from, to] keeps
                                 those times (after aligning)
loss = "linear"                  what a residual costs, as in ``Problem``
accuracy = 1e-6                  error of the simulated forces as a share of their peak, likewise
[free.NAME]                      lower, upper, start, scale; each = true gives every experiment its own
[[model]], [[candidate]]         other models of the same data, experiments that might be made: ``alternatives``
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic

from bcfj_jax import InputError, nearest
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.io import scenefile, tables
from bcfj_jax.io.units import quantity, toleranced
from bcfj_jax.mechanism.channels import channel, unit_of
from bcfj_jax.models import scenes
from calibration.data import stated
from calibration.data.preparation import Prepared, Recipe, prepare
from calibration.data.readers import read
from calibration.data.table import split
from calibration.problem import ADEQUATE, Channel, Experiment, Free, Problem, nuisances, units_of


class _Experiment(tables.Table):
    name: str | None = None
    file: str | None = None
    table: str | None = None
    time: str | None = None
    observe: dict[str, str] = {}
    noise: Any = "estimate"
    correlation: Any = 0.0
    features: dict[str, Any] = {}
    feature_noise: Any = None
    span: Any = None
    rows: dict[str, Any] = {}
    hold_out: bool = False
    parameters: dict[str, Any] = {}
    align: Literal["onset"] | None = None
    window: list[Any] | None = None
    resample: Any = None
    saturation: Any = None


class FreeTable(tables.Table):
    """[free.NAME]: bounds as numbers or texts with a unit."""

    lower: Any
    upper: Any
    start: Any = None
    scale: Literal["log", "linear"] | None = None
    each: bool = False


class _File(tables.Table):
    scene: str
    experiment: list[_Experiment] = pydantic.Field(min_length=1)
    free: dict[str, FreeTable]
    loss: str = "linear"
    accuracy: float | None = pydantic.Field(None, ge=1e-9, le=0.5)
    adequate: Any = None
    model: list[dict[str, Any]] = []
    candidate: list[dict[str, Any]] = []


def load(path: str | Path) -> Problem:
    """The problem that a calibration file states.

    Raises:
        InputError: for anything missing, unknown, of a wrong dimension or out of order, in it or in its data.
    """
    path = Path(path)
    file = tables.validated(_File, tables.read(path), str(path))
    base = _scene(file, path)
    known = {**base.scene.quantities, **nuisances(o for entry in file.experiment for o in entry.observe)}
    one = base.scene.canonical
    records = _records(file, path, base)
    return Problem(
        scene=base.scene,
        params={name: float(value) for name, value in base.params.items()},
        experiments=tuple(
            _experiment(entry, record, f"{path}: [[experiment]] {k + 1}", known, one) for k, entry, record in records
        ),
        free=tuple(free_of(one(name), table, path, known) for name, table in file.free.items()),
        where=str(path),
        loss=file.loss,
        accuracy=file.accuracy or 0.0,
        tolerances=dict(base.tolerances),
        adequate=ADEQUATE if file.adequate is None else quantity(file.adequate, "1", f"{path}: adequate"),
    )


def prepared(path: str | Path) -> list[Prepared]:
    """What was understood of each record that a calibration file reads, for people to look at.

    Raises:
        InputError: as ``load``.
    """
    path = Path(path)
    file = tables.validated(_File, tables.read(path), str(path))
    return [record for _, _, record in _records(file, path, _scene(file, path)) if record]


def sources(path: Path) -> list[Path]:
    """The data files a calibration file reads, for checksums."""
    file = tables.validated(_File, tables.read(path), str(path))
    return [path.parent / name for name in dict.fromkeys(e.file for e in file.experiment if e.file)]


def free_of(name: str, table: FreeTable, path: Path, known: dict[str, Quantity]) -> Free:
    """A free parameter; texts become SI by the unit that the scene, or a nuisance, gives the name."""
    unit = known[name].unit if name in known else None
    # The unit of a stiffness follows an exponent that may itself be free: its bounds' own unit is taken.
    texts = {key: getattr(table, key) for key in ("lower", "upper", "start") if getattr(table, key) is not None}
    numbers = {
        key: quantity(value, unit, f"{path}: [free.{name}] {key}") if unit else 0.0 for key, value in texts.items()
    }
    return Free(name, numbers["lower"], numbers["upper"], numbers.get("start"), table.scale, table.each)


def _scene(file: _File, path: Path) -> scenefile.SceneFile:
    beside = path.parent / file.scene
    if file.scene.endswith(".toml") and not beside.exists():
        raise InputError(f"{path}: scene", f"no file {beside}", "give a path relative to this file, or a scene's name")
    if not file.scene.endswith(".toml") and file.scene not in scenes.SCENES:
        raise InputError(f"{path}: scene", f"no scene '{file.scene}'", nearest(file.scene, scenes.SCENES))
    return scenefile.load(beside if file.scene.endswith(".toml") else file.scene)


def _records(file: _File, path: Path, base: scenefile.SceneFile) -> list[tuple[int, _Experiment, Prepared | None]]:
    """Every record (None where an entry gives only features) with the number of its entry and the entry."""
    records = []
    for k, entry in enumerate(file.experiment):
        where = f"{path}: [[experiment]] {k + 1}"
        if not entry.observe and not entry.features:
            raise InputError(f"{where} observe", "nothing is observed", 'give { "contact.normal" = "force [N]" }')
        if not entry.observe:
            records.append((k, entry, None))
            continue
        for observes in entry.observe:  # Before its column is read in a unit that a wrong name does not have.
            channel(observes, base.scene, where=f"{where} observe '{observes}'")
        if entry.file is None or entry.time is None:
            missing = "file" if entry.file is None else "time"
            raise InputError(f"{where} {missing}", f"the key '{missing}' is missing", "it must be given to observe")
        whole = read(path.parent / entry.file, f"{where} file", entry.table)
        # Where nothing turns, every record is of impacts: apart, in contact, apart.
        recipe = _recipe(entry, where, not base.scene.traits.turning, "force_offset" in file.free)
        parts = split(whole, entry.rows, where)
        for label, part in parts:
            name = label if entry.name is None else entry.name if len(parts) == 1 else f"{entry.name} {label}"
            # Results go by name, so that no two records may share one.
            name += f" ({k + 1})" if name in (r.name for _, _, r in records if r) else ""
            records.append((k, entry, prepare(name, part, entry.time, entry.observe, recipe, where)))
    return records


def _recipe(entry: _Experiment, where: str, impact: bool, offset: bool) -> Recipe:
    window = None
    if entry.window is not None:
        if len(entry.window) != 2:
            raise InputError(f"{where} window", f"{entry.window}", 'give [from, to], such as ["-20 ms", "0.3 s"]')
        first, last = (quantity(w, "s", f"{where} window") for w in entry.window)
        window = first, last
    rate = None if entry.resample is None else quantity(entry.resample, "Hz", f"{where} resample")
    limits = _limits(entry, where)
    for key, value in (("resample", rate), *(("saturation", limit) for limit in limits.values())):
        if value is not None and not 0 < value < np.inf:
            raise InputError(f"{where} {key}", f"{key} = {getattr(entry, key)}", "give a positive value")
    return Recipe(rate, limits, entry.align is not None, window, impact, offset)


def _limits(entry: _Experiment, where: str) -> dict[str, float]:
    """Saturation by channel, SI: stated of each, or once where all are in one unit."""
    if entry.saturation is None:
        return {}
    units, place = units_of(entry.observe), f"{where} saturation"
    if isinstance(entry.saturation, dict):
        for name in entry.saturation:
            if name not in entry.observe:
                raise InputError(place, f"'{name}' is not observed", nearest(name, entry.observe))
        return {o: quantity(value, unit_of(o), f"{place}.{o}") for o, value in entry.saturation.items()}
    if len(units) > 1:
        remedy = f'state it of each: {{ "{next(iter(entry.observe))}" = "{entry.saturation}" }}'
        raise InputError(place, f"one limit for channels in {' and '.join(units)}", remedy)
    return dict.fromkeys(entry.observe, quantity(entry.saturation, next(iter(units)), place))


def _experiment(
    entry: _Experiment, record: Prepared | None, where: str, known: dict[str, Quantity], one: Callable[[str], str]
) -> Experiment:
    fixed, tolerances = {}, {}
    for name, value in ((one(name), value) for name, value in entry.parameters.items()):
        if name not in known:
            raise InputError(f"{where} parameters", f"the scene has no parameter '{name}'", ", ".join(known))
        fixed[name], tolerance = toleranced(value, known[name].unit, f"{where} parameters.{name}")
        if tolerance is not None:
            tolerances[name] = tolerance
    memory = stated.correlation(entry.correlation, f"{where} correlation")
    channels = []
    for observes, reading in record.readings.items() if record else ():
        sigma, relative = stated.noise(entry.noise, observes, reading.values, f"{where} noise")
        channels.append(Channel(observes, reading.values, sigma, relative, memory))
    return Experiment(
        name=record.name if record else entry.name or where.rpartition(": ")[2],
        times=record.times if record else np.zeros(0),
        channels=tuple(channels),
        hold_out=entry.hold_out,
        fixed=fixed,
        source=record.source if record else where,
        features=stated.features(entry.features, entry.feature_noise, where),
        span=None if entry.span is None else quantity(entry.span, "s", f"{where} span"),
        tolerances=tolerances,
    )
