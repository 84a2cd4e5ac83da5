"""Calibration files: a TOML problem becomes a ``Problem``, every mistake named by file and key.

What may be in one: docs/howto/problem_file.md; ``[[model]]`` and ``[[candidate]]``: ``selection.alternatives``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pydantic

from bcfj_jax import InputError, nearest
from bcfj_jax.core.errors import Faults
from bcfj_jax.core.quantities import GRAVITY, Quantity
from bcfj_jax.data.record import Record
from bcfj_jax.io import scenefile, tables
from bcfj_jax.io.units import format_si, quantity, toleranced
from bcfj_jax.mechanism.channels import channel, unit_of
from bcfj_jax.models import scenes
from calibration import given, instrument
from calibration.filters import HIGHEST, Filter
from calibration.impacts import plausible, sensor, stated, trains
from calibration.impacts.events import contacts
from calibration.impacts.flights import contradicted
from calibration.impacts.parting import files_of, runs_of
from calibration.impacts.preparation import Prepared, Recipe, prepare
from calibration.impacts.sensor import Sensor
from calibration.problem import (
    ADEQUATE,
    NUISANCES,
    OFFSETS,
    Channel,
    Doubt,
    Experiment,
    Free,
    Problem,
    nuisances,
    units_of,
)

# Options of scenes that a parameter's name asks for.
_STRUCK, _HELD = "struck_mass", "fixed"
_NAMED: dict[str, dict[str, dict[str, Any]]] = {
    "impact": {_STRUCK: {"struck": True}, "gravity": {"gravity": True}, "restitution": {"law": "flores"}},
    "bounce": {"restitution": {"law": "flores"}},
}


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
    events: bool = False
    rows: dict[str, Any] = {}
    hold_out: bool | list[str] = False
    parameters: dict[str, Any] = {}
    columns: dict[str, str] = {}
    align: Literal["onset"] | None = None
    window: list[Any] | None = None
    resample: Any = None
    saturation: Any = None
    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    header: int | list[int] | None = None
    sensitivity: str | None = None
    full_scale: str | None = None
    rate: str | None = None
    runs_by: str | None = None
    contacts: Literal["first", "each"] = "first"
    bounds: dict[str, list[Any]] = {}
    instrument: dict[str, Any] = {}

    @property
    def held(self) -> bool:
        """Whether it says that the body which is struck is fixed."""
        return self.parameters.get(_STRUCK) == _HELD

    @property
    def given(self) -> dict[str, Any]:
        """Its parameters that are quantities."""
        return {name: value for name, value in self.parameters.items() if not (name == _STRUCK and self.held)}


class _Filter(tables.Table):
    kind: Literal["butterworth", "bessel"] = "butterworth"
    order: int = pydantic.Field(2, ge=1, le=HIGHEST)
    zero_phase: bool = False
    cutoff: Any = None


class FreeTable(tables.Table):
    """[free.NAME]: bounds as numbers or texts with a unit; of a nuisance none, where records are to give them.

    NAME = [lower, upper] under [free] says no more than the bounds.
    """

    lower: tables.Number = None
    upper: tables.Number = None
    start: tables.Number = None
    scale: Literal["log", "linear"] | None = None
    each: bool | None = None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _pair(cls, given: Any) -> Any:
        if isinstance(given, list) and len(given) == 2:
            return {"lower": given[0], "upper": given[1]}
        return given


class _File(tables.Table):
    scene: str
    experiment: list[_Experiment] = pydantic.Field(min_length=1)
    free: dict[str, FreeTable]
    instrument: dict[str, Any] = {}
    loss: str = "linear"
    accuracy: float | None = pydantic.Field(None, ge=1e-9, le=0.5)
    adequate: Any = None
    sensor: Literal["free", "exact"] = "free"
    filter: _Filter | Literal["none", "unknown"] | None = None
    model: list[dict[str, Any]] = []
    candidate: list[dict[str, Any]] = []

    @property
    def passed(self) -> Filter | Literal["none", "unknown"] | None:
        """The filter that is stated."""
        said = self.filter
        return Filter(said.kind, said.order, said.zero_phase) if isinstance(said, _Filter) else said


def schema() -> dict[str, Any]:
    """The JSON Schema of a calibration file."""
    free = (dict[str, FreeTable | list[tables.Number]], ...)
    return tables.published(pydantic.create_model("Calibration", __base__=_File, free=free), "calibration")


class _Read(NamedTuple):
    """A record of an entry: the entry's number and itself, what was made of its rows, these, and what their columns give."""

    k: int
    entry: _Experiment
    record: Prepared | None = None
    part: Record | None = None
    columned: Mapping[str, tuple[float, float | None]] = {}


def load(path: str | Path) -> Problem:
    """The problem that a calibration file states.

    Raises:
        InputError: for anything missing, unknown, of a wrong dimension or out of order, in it or in its data.
    """
    return load_with_records(path)[0]


def prepared(path: str | Path) -> list[Prepared]:
    """What was understood of each record that a calibration file reads, for people to look at; raises as ``load``."""
    return load_with_records(path)[1]


def load_with_records(path: str | Path) -> tuple[Problem, list[Prepared]]:
    """The problem that a calibration file states, and what was understood of each of its records; raises as ``load``."""
    path = given.path("calibration.load", path)
    file = _content(path)
    base = _scene(file, path)
    if isinstance(file.filter, _Filter) and file.filter.cutoff is not None:
        for entry in file.experiment:
            entry.parameters.setdefault("cutoff", file.filter.cutoff)
    known = {**base.scene.quantities, **nuisances(o for entry in file.experiment for o in entry.observe)}
    one = base.scene.canonical
    for k, entry in enumerate(file.experiment):
        entry.instrument.update(instrument.merged(file.instrument, entry.instrument))
        if entry.held and (_STRUCK in known or "approach_speed" not in known):
            found = f'{_STRUCK} = "{_HELD}", where the scene '
            found += "has that mass" if _STRUCK in known else "has no body that strikes"
            raise InputError(f"{path}: [[experiment]] {k + 1} parameters", found, "give its mass, or leave it out")
    records = _records(file, path, base)
    experiments = [_experiment(r, f"{path}: [[experiment]] {r.k + 1}", known, one) for r in records]
    found = _sensor(file, path, base, records, experiments, known)
    experiments = [replace(e, bounds={**found.bounds.get(i, {}), **e.bounds}) for i, e in enumerate(experiments)]
    free = [free_of(one(name), table, path, known) for name, table in file.free.items() if one(name) not in found.names]
    for k, entry in enumerate(file.experiment):
        _check_own(entry, f"{path}: [[experiment]] {k + 1} bounds", free, found, one)
    for name in found.names:
        lower, upper = found.envelope(name)
        own = file.free.get(name, FreeTable()).model_copy(update={"lower": lower, "upper": upper})
        free.append(free_of(name, own, path, known))
    problem = Problem(
        scene=base.scene,
        params={name: float(value) for name, value in base.params.items()},
        experiments=tuple(experiments),
        free=tuple(free),
        where=str(path),
        loss=file.loss,
        accuracy=file.accuracy or 0.0,
        tolerances=dict(base.tolerances),
        filter=file.passed or ("unknown" if _measured(file, base) else "none"),
        adequate=ADEQUATE if file.adequate is None else quantity(file.adequate, "1", f"{path}: adequate"),
    )
    silent = [said for r in records if r.record and not r.entry.events and (said := plausible.unheard(r.record))]
    doubts = (*(Doubt(said, "what is there is a contact") for said in silent), *_doubts(problem, records))
    problem = replace(problem, doubts=doubts) if doubts else problem
    every = ((r.record, found.notes.get(i, [])) for i, r in enumerate(records) if r.record)
    return problem, [replace(record, notes=(*record.notes, *own)) for record, own in every]


def _content(path: Path) -> _File:
    """A calibration file, checked; names may have a point without quotes: ``[free.seat_ball.stiffness]``."""
    table = tables.read(path)
    if isinstance(table.get("free"), dict):
        table["free"] = tables.nested(table["free"], FreeTable)
    for entry in table["experiment"] if isinstance(table.get("experiment"), list) else ():
        if isinstance(entry, dict) and isinstance(entry.get("parameters"), dict):
            entry["parameters"] = tables.flat(entry["parameters"])
    return tables.validated(_File, table, str(path))


def sources(path: Path) -> list[Path]:
    """The data files a calibration file reads, for checksums."""
    file = _content(path)
    names = dict.fromkeys(e.file for e in file.experiment if e.file)
    return [found for name in names for found in files_of(path, name, str(path))]


def free_of(name: str, table: FreeTable, path: Path, known: dict[str, Quantity]) -> Free:
    """A free parameter; texts become SI by the unit that the scene, or a nuisance, gives the name."""
    for key in ("lower", "upper"):
        if getattr(table, key) is None:
            raise InputError(f"{path}: [free.{name}] {key}", f"the key '{key}' is missing", "it must be given")
    unit = known[name].unit if name in known else None
    # The unit of a stiffness follows an exponent that may itself be free: its bounds' own unit is taken.
    texts = {key: getattr(table, key) for key in ("lower", "upper", "start") if getattr(table, key) is not None}
    numbers = {
        key: quantity(value, unit, f"{path}: [free.{name}] {key}") if unit else 0.0 for key, value in texts.items()
    }
    return Free(name, numbers["lower"], numbers["upper"], numbers.get("start"), table.scale, table.each)


def _sensor(
    file: _File, path: Path, base: scenefile.SceneFile, records: list[_Read],
    experiments: list[Experiment], known: dict[str, Quantity],
) -> Sensor:  # fmt: skip
    """Nuisances that are free within bounds which the records give: those asked for without bounds, and by default."""
    found, scene, one = Sensor(), base.scene, base.scene.canonical
    bounded = {one(n): t for n, t in file.free.items() if None not in (t.lower, t.upper)}
    searched = {f.name: (f.lower, f.upper) for f in (free_of(n, t, path, known) for n, t in bounded.items())}
    stated = {one(name) for name in file.free} | {n for e in experiments for n in e.fixed}
    asked = [n for n, t in file.free.items() if n in NUISANCES and t.lower is None and t.upper is None]
    passed = file.passed if isinstance(file.passed, Filter) else None
    asked += ["cutoff"] if passed and "cutoff" not in stated else []
    # What contacts do above the reading at rest does not know its zero.
    observed = [o for entry in file.experiment for o in entry.observe if not entry.events]
    own = sensor.unasked(observed) if _measured(file, base) else []
    unasked = [n for n in dict.fromkeys(own) if n not in stated]
    if "force_offset" in stated and len(units_of(observed)) == 1:
        unasked = [n for n in unasked if n not in OFFSETS.values()]
    fitted = [e for e in experiments if not e.hold_out]
    samples = sum(e.samples for e in fitted)
    unknowns = sum(len(fitted) if t.each or n in NUISANCES else 1 for n, t in file.free.items())
    for name in (*asked, *unasked):
        proposals, doubts = {}, {}
        for i, (r, e) in enumerate(zip(records, experiments, strict=True)):
            params = {**{n: float(v) for n, v in base.params.items()}, **e.fixed}
            given: Any = "it has no history of readings"
            if r.record:
                given = sensor.proposed(name, r.record, scene, params, searched, passed)
            if not isinstance(given, str):
                proposals[i] = given
            if doubt := given if isinstance(given, str) else given.doubt:
                doubts[i] = doubt
        refused = [i for i in doubts if i not in proposals and name not in experiments[i].bounds]
        if name in asked and refused:
            unknown = f"no bounds, and none can be proposed for {experiments[refused[0]].name}: {doubts[refused[0]]}"
            raise InputError(f"{path}: [free.{name}]", unknown, "give lower and upper")
        if name in asked:
            found.add(name, proposals, known)
            continue
        if proposals and samples <= 2 * (unknowns + len(fitted)):
            few = f"{samples} samples are few for {unknowns + len(fitted)} free parameters"
            doubts = dict.fromkeys(proposals, few)
        for i, why in doubts.items() if proposals else ():
            found.say(i, f"{name} stays {format_si(0.0, known[name].unit)}: {why}")
        if proposals and not doubts:
            unknowns += len(fitted)
            found.add(name, proposals, known)
    return found


def _measured(file: _File, base: scenefile.SceneFile) -> bool:
    """Whether records are taken as measured, by sensors that leave something open."""
    return file.sensor == "free" and base.scene.traits.history and not base.scene.traits.turning


def options_of(scene: str, named: Collection[str]) -> dict[str, Any]:
    """Options of a built-in scene for physics that is there only where a parameter of it is named."""
    found: dict[str, Any] = {}
    for name, options in _NAMED.get(scene, {}).items():
        found |= options if name in named else {}
    return found


def base_of(path: Path) -> scenefile.SceneFile:
    """The scene of a calibration file; raises as ``load``."""
    return _scene(_content(path), path)


def _scene(file: _File, path: Path) -> scenefile.SceneFile:
    beside = path.parent / file.scene
    if file.scene.endswith(".toml") and not os.path.exists(beside):
        raise InputError(f"{path}: scene", f"no file {beside}", "give a path relative to this file, or a scene's name")
    if not file.scene.endswith(".toml") and file.scene not in scenes.SCENES:
        raise InputError(f"{path}: scene", f"no scene '{file.scene}'", nearest(file.scene, scenes.SCENES))
    if file.scene.endswith(".toml"):
        return scenefile.load(beside)
    options = options_of(file.scene, {name for entry in file.experiment for name in entry.given} | file.free.keys())
    if not options:
        return scenefile.load(file.scene)
    return scenefile.from_table({"scene": {"kind": file.scene, **options}}, None)


def _doubts(problem: Problem, records: list[_Read]) -> tuple[Doubt, ...]:
    """Why given masses and speeds of single impacts may be wrong, by their records (``impacts.plausible``)."""
    names, free = problem.scene.quantities, {f.name: f for f in problem.free}
    if "drop_height" in names:
        return _dropped(problem, records)
    if not {"mass", "approach_speed"} <= names.keys() or "mass" in free or len(problem.scene.members) != 1:
        return ()
    if {"impact_angle", "struck_mass"} & free.keys() or "impact_angle" in names:
        return ()
    found, masses, bodies = [], [], {}
    speed = free.get("approach_speed")
    for e, (_, entry, record, part, _) in zip(problem.experiments, records, strict=True):
        if record is None or part is None or entry.events:
            continue
        own = problem.params | e.fixed
        mass = plausible.effective(own["mass"], own.get("struck_mass"))
        masses += [(record, mass)] if "approach_speed" not in e.fixed else []
        usual = (speed.lower, speed.upper) if speed else (own["approach_speed"], own["approach_speed"])
        said, least, most = plausible.impulse(record, mass, e.bounds.get("approach_speed", usual))
        if said:
            # With one free body the mass that impulse and speed imply is its own.
            right = "mass, speed and gain are right as they are given"
            alone = _STRUCK not in own and not speed
            found.append(Doubt(said, "speed and gain are right", "mass", least, most) if alone else Doubt(said, right))
            continue
        open_ = speed and "mass" not in e.tolerances and not entry.held and _STRUCK not in names
        open_ = open_ and set(entry.observe) == {"contact.normal"}
        if open_ and (said := plausible.other_body(record, part, entry.observe, mass)):
            bodies.setdefault(said, []).append(record.name)
    found += [Doubt(f"{', '.join(n)}: {said}", "the struck body is fixed") for said, n in bodies.items()]
    if speed and not speed.per_experiment:
        said, least, most = plausible.speeds(masses)
        own = "each record has a speed of its own"
        found += [Doubt(said, own, "approach_speed", least, most, True)] if said else []
    return tuple(dict.fromkeys(found))


def _dropped(problem: Problem, records: list[_Read]) -> tuple[Doubt, ...]:
    """Why the law of a drop cannot lose what its records show, by their flights (``impacts.flights``)."""
    middle = {f.name: float(np.sqrt(f.lower * f.upper)) for f in problem.free if f.log}
    found = []
    for e, r in zip(problem.experiments, records, strict=True):
        if r.record and (reading := r.record.readings.get("contact.normal")):
            events = contacts("contact.normal", r.record.times, reading.values)
            if said := contradicted(e.name, events, problem.scene.only_law(), {**problem.params, **e.fixed, **middle}):
                found.append(Doubt(said, "the law's loss is right"))
    return tuple(dict.fromkeys(found))


def _records(file: _File, path: Path, base: scenefile.SceneFile) -> list[_Read]:
    """Every record; an entry that gives only features has none."""
    records, broken, turning = [], Faults(), base.scene.traits.turning
    for k, entry in enumerate(file.experiment):
        where = f"{path}: [[experiment]] {k + 1}"
        if not entry.observe and not entry.features:
            raise InputError(f"{where} observe", "nothing is observed", 'give { "contact.normal" = "force [N]" }')
        if not entry.observe:
            records.append(_Read(k, entry))
            continue
        for observes in entry.observe:  # Before its column is read in a unit that a wrong name does not have.
            channel(observes, base.scene, where=f"{where} observe '{observes}'")
        if entry.file is None or entry.time is None:
            missing = "file" if entry.file is None else "time"
            raise InputError(f"{where} {missing}", f"the key '{missing}' is missing", "it must be given to observe")
        wholes, parts = runs_of(path, entry, where)
        # Where nothing turns, every record is of impacts: apart, in contact, apart.
        thin = "" if entry.events or turning else "mean" if entry.correlation in (0, 0.0) else "every"
        free = "force_offset" in file.free
        recipe = replace(
            _recipe(entry, where), impact=not turning, offset=free, exact=file.sensor == "exact", thin=thin
        )
        if isinstance(entry.hold_out, list) and (unknown := set(entry.hold_out) - {label for label, _ in parts}):
            runs = ", ".join(label for label, _ in parts)
            raise InputError(f"{where} hold_out", f"there is no run '{min(unknown)}'", f"the runs are: {runs}")
        faults, said = Faults([fault for whole in wholes for fault in whole.faults]), wholes[0].found
        for label, part in parts:
            name = label if entry.name is None else entry.name if len(parts) == 1 else f"{entry.name} {label}"
            # Results go by name, so that no two records may share one.
            name += f" ({k + 1})" if name in (r.record.name for r in records if r.record) else ""
            with faults:
                own = _by_columns(entry, part, base, where, label)
                record = prepare(name, part, entry.time, entry.observe, recipe, where)
                record = replace(record, notes=(said, *record.notes) if said else record.notes)
                records.append(_Read(k, entry, record, part, own))
                said = ""  # Of a file, not of each of its runs.
        with broken:
            faults.refuse(wholes[0].name)
    broken.refuse(str(path))
    return records


def _by_columns(
    entry: _Experiment, part: Record, base: scenefile.SceneFile, where: str, label: str
) -> dict[str, tuple[float, float | None]]:
    """Parameters that columns of a record's rows give, SI, and how well they are known.

    The height h of a drop is the speed sqrt(2 g h) in a scene that has no height.
    """
    found, known, one = {}, base.scene.quantities, base.scene.canonical
    for said, text in entry.columns.items():
        name, here = one(said), f"{where} columns.{said}"
        falls = name == "drop_height" and name not in known and "approach_speed" in known
        if not falls and name not in known:
            raise InputError(here, f"the scene has no parameter '{said}'", ", ".join(known))
        target = "approach_speed" if falls else name
        if target in {one(n) for n in entry.parameters} | found.keys():
            raise InputError(here, f"'{target}' is given twice", "give it once, as a value or by a column")
        unit = "m" if falls else known[name].unit
        header, _, tolerance = (part_.strip() for part_ in text.partition("+-"))
        values = part.numbers(header, unit, here, blank=False)
        if np.ptp(values) > 1e-9 * np.abs(values).max():
            span = f"{format_si(float(values.min()), unit)} to {format_si(float(values.max()), unit)}"
            remedy = "name a column that is one number in each run, and one that numbers the runs in rows"
            raise InputError(here, f"'{header}' goes from {span} within {label}", remedy)
        value = float(values[0])
        known_to = toleranced(f"{value!r} {unit} +- {tolerance}", unit, here)[1] if tolerance else None
        if falls:
            if not value > 0.0:
                raise InputError(here, f"a height of {format_si(value, unit)}", "give one above 0")
            speed = float(np.sqrt(2.0 * GRAVITY * value))
            value, known_to = speed, known_to and 0.5 * known_to / value * speed
        found[target] = value, known_to
    return found


def _recipe(entry: _Experiment, where: str) -> Recipe:
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
    return Recipe(rate, limits, entry.align is not None, window)


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


def _experiment(read: _Read, where: str, known: dict[str, Quantity], one: Callable[[str], str]) -> Experiment:
    _, entry, record, _, columned = read
    own, channels = {}, []
    for name, value in ((one(name), value) for name, value in entry.given.items()):
        if name not in known:
            raise InputError(f"{where} parameters", f"the scene has no parameter '{name}'", ", ".join(known))
        own[name] = toleranced(value, known[name].unit, f"{where} parameters.{name}")
    own |= columned
    memory = stated.correlation(entry.correlation, f"{where} correlation")
    features = stated.features(entry.features, entry.feature_noise, where)
    span = None if entry.span is None else quantity(entry.span, "s", f"{where} span")
    if entry.events and not record:
        raise InputError(f"{where} events", "nothing is observed", 'give observe = { "contact.normal" = "force [N]" }')
    readings, times, averaged = (record.readings, record.times, record.averaged) if record else ({}, np.zeros(0), 1)
    for observes, reading in readings.items():
        # What is stated is the noise of a sample as recorded.
        noise = stated.noise(entry.noise, observes, reading.values, f"{where} noise").of_means(averaged)
        if not entry.events:
            said = instrument.stated(entry.instrument, observes, entry.observe, f"{where} instrument")
            channels.append(Channel(observes, reading.values, noise.sigma, noise.relative, memory, noise.jitter, said))
            continue
        if noise.jitter:
            raise InputError(f"{where} noise", "a clock that jitters", "state the noise of the reading for events")
        features += trains.observations(observes, times, reading.values, noise.sigma, noise.relative)
        span = float(times[-1]) if span is None else span
    return Experiment(
        name=record.name if record else entry.name or where.rpartition(": ")[2],
        times=times if channels else np.zeros(0),
        channels=tuple(channels),
        hold_out=_held_out(entry, record),
        fixed={name: value for name, (value, _) in own.items()},
        source=record.source if record else where,
        features=features,
        span=span,
        tolerances={name: tolerance for name, (_, tolerance) in own.items() if tolerance is not None},
        bounds=_bounds(entry, where, known, one),
    )


def _held_out(entry: _Experiment, record: Prepared | None) -> bool:
    """Whether a run is held out: all of an entry, or those that it lists."""
    if isinstance(entry.hold_out, bool) or record is None:
        return bool(entry.hold_out)
    label = record.name.removeprefix(f"{entry.name} ")
    return any(label == run or label.startswith(f"{run} (") for run in entry.hold_out)


def _check_own(entry: _Experiment, where: str, free: list[Free], found: Sensor, one: Callable[[str], str]) -> None:
    """Refuse bounds of a record for what is not its own."""
    own = [*(f.name for f in free if f.per_experiment), *found.names]
    for name in entry.bounds:
        if one(name) not in own:
            remedy = f"a record has its own of: {', '.join(own)}" if own else "free it with each = true"
            raise InputError(where, f"'{name}' is not free with a value of its own for each record", remedy)


def _bounds(
    entry: _Experiment, where: str, known: dict[str, Quantity], one: Callable[[str], str]
) -> dict[str, tuple[float, float]]:
    """Bounds of a record's own parameters."""
    for name in entry.bounds:
        if one(name) not in known:
            raise InputError(f"{where} bounds.{name}", f"no parameter '{name}'", nearest(name, known))
    return {one(n): given.pair(f"{where} bounds.{n}", pair, known[one(n)]) for n, pair in entry.bounds.items()}
