"""What a measured table is: its clock, its channels with units and signs, its runs and contacts, and sizes that follow.

Sizes of an impact follow from its impulse J = m v (1 + e), its peak F and its duration T: with m or v known the other
lies between J/2 and J over it, the depth is about v T/3.2 (half a sine), and K = F / depth^n.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.errors import Faults, clip
from bcfj_jax.core.quantities import GRAVITY
from bcfj_jax.data.clock import TIMES, evened
from bcfj_jax.data.numbers import is_missing
from bcfj_jax.data.record import DROPPED, GIVEN, HIGH, RUN_COLUMNS, STATED, SWEEP, Record, run_column, split, statements
from bcfj_jax.io.units import GRAVITIES, WEIGHTS, column
from calibration.impacts import headers, plates
from calibration.impacts.events import Event, contacts, even_pull, pushes, rest, wrong
from calibration.impacts.flights import Loss, loss
from calibration.impacts.inspection import check_clock
from calibration.impacts.otherwise import in_metres, refuse_motion, without_time
from calibration.noise.scatter import scatter

# Of several forces the sum goes with those that are named, of which the largest is read.
_SUMS = {"sum", "summe", "total", "gesamt", "combined", "somme", "resultant"}
_MOST_RUNS, _RUN_ROWS = 50, 20
_MARKER = re.compile(r"(?i)\b[xyz]\d*$")
# Durations of a contact over those of its event (``contacts``), which leaves out a speed's ends and what follows a place's turn.
_WHOLE = {"m/s": 1.5, "m": 4.0}
# Times the noise from which on a contact is seen; a load that keeps so much of its greatest is no impact's.
_SEEN, _SUSTAINED = 12.0, 0.5
# Deviations of its noise from which on a body moves before contact.
_MOVES = 5.0
# Readings that are a channel; a speed before contact below that share of the one behind it is that of a body that is struck.
_FEWEST, _STRUCK = 3, 0.1


@dataclass(frozen=True)
class Run:
    """One run: clock (N,) [s] and readings (N,) by unit, SI, signs turned so that contacts push and bodies approach."""

    name: str
    clock: np.ndarray
    readings: dict[str, np.ndarray]
    events: list[Event]

    def impulse(self) -> float:
        """Of the first contact [N s]."""
        force, inside = self.readings["N"], self._inside
        level = self.rest("N")
        return float(np.trapezoid(np.nan_to_num(force[inside] - level), self.clock[inside]))

    def doubt(self) -> float:
        """Deviation that white noise gives the impulse [N s]: of the contact's samples, and of the rest taken off them."""
        count, step = len(self.clock[self._inside]), self.events[0].step
        before = max(self.events[0].first - 1, 1)
        force = self.readings["N"]
        return scatter(force[np.isfinite(force)]) * step * float(np.sqrt(count + count**2 / before))

    @property
    def _inside(self) -> slice:
        return slice(max(self.events[0].first - 1, 0), self.events[0].last + 2)

    def rest(self, unit: str) -> float:
        """Reading before the first contact."""
        before = self.readings[unit][: max(self.events[0].first - 1, 0)]
        before = before[np.isfinite(before)]
        return float(np.mean(before)) if before.size >= 3 else rest(self.readings[unit]) or 0.0

    def speeds(self) -> tuple[float, float] | None:
        """Speeds just before and after the first contact [m/s], from a velocity or else a position that moves before it."""
        e, found = self.events[0], []
        span = max(0.75 * e.duration, 5.5 * e.step)
        for first, last in ((e.begin - span - e.step, e.begin - 0.1 * e.step), (e.end + e.step, e.end + span + e.step)):
            inside = (self.clock >= first) & (self.clock <= last)
            seen = {u: inside & np.isfinite(self.readings[u]) for u in ("m/s", "m") if u in self.readings}
            unit = next((u for u, rows in seen.items() if np.count_nonzero(rows) >= 3), None)
            if unit is None:
                return None
            t, x, read = self.clock[seen[unit]], self.readings[unit][seen[unit]], self.readings[unit]
            found.append(float(np.median(x)) if unit == "m/s" else float(np.polyfit(t, x, 1)[0]))
            lever = np.sqrt(x.size) if unit == "m/s" else np.linalg.norm(t - t.mean())
            if len(found) < 2 and abs(found[0]) * lever < _MOVES * scatter(read[np.isfinite(read)]):
                return None  # It stands still, as what holds the rig does.
        return found[0], found[1]


@dataclass(frozen=True)
class Understood:
    """What a table holds."""

    path: Path
    table: str
    time: str
    # Header by unit, "-" before it where the sign is to be flipped; "tangential" for a second force.
    columns: dict[str, str]
    others: list[str]
    runs: tuple[str, int]  # the column that numbers runs, and how many; "file" where each file is one
    records: list[Run]  # every run, at most 50
    rows: dict[str, str] = field(default_factory=dict)  # which value of a column of text its readings stand beside
    said: str = ""  # how the file is written, in words
    # The column of heights [m] or speeds [m/s] of the runs, and its unit; "" for none.
    given: tuple[str, str] = ("", "")
    speeds: tuple[float, ...] = ()  # of each record [m/s], by that column
    each: bool = False  # whether each contact is a record, cut from its run
    plate: str = ""  # of a force plate, which force is read and where it acts
    parts: tuple[Part, ...] = ()  # runs that stand beside each other in columns or tables; empty for none
    mass: float | None = None  # of what strikes [kg], as the file states it
    falls: bool = False  # whether the places read are those of a body that falls freely
    pull: float = GRAVITY  # what they fall by [m/s^2], less of a body on a slope
    body: str = "body"  # whose acceleration or velocity is read, or "struck"
    dropped: bool = False  # whether a line beside the table, or what numbers its runs, says so
    vague: bool = False  # whether one height is stated, and no word says that the body fell from it
    bare: bool = True  # whether its clock has no unit
    doubt: str = ""  # a statement that is not used, since the impulse is not as it says


class Part(NamedTuple):
    """Of several runs beside each other: the name of one, its table, and its columns as ``Understood`` has them."""

    name: str
    table: str
    time: str
    columns: dict[str, str]


class Hints(NamedTuple):
    """What a user says of the columns: that of the clock, the reading, what numbers runs, each by its header."""

    time: str | None = None
    observe: str | None = None
    runs_by: str | None = None
    rows: dict[str, Any] = {}


def understood(table: Record, hints: Hints = Hints()) -> Understood:  # noqa: B008
    """What a table is, by its headers and by what its columns do."""
    where, faults = table.name, Faults(table.faults)
    if hints.observe is None:
        refuse_motion(table)
    run = _run_column(table) if hints.runs_by is None else hints.runs_by
    if run:
        run = table.header[table.index(run, "--runs-by")]
    found = _columns(table, run)
    _hinted(table, hints, found)
    if "s" not in found and table.clock:
        found["s"] = table.clock
    table = split(table, hints.rows, where, "")[0][1] if hints.rows else table
    rows, table = _filtered(table, found.get("s", ""))
    parts = split(table, {}, where, run)
    count, parts = len(parts) if run else 1, parts[:_MOST_RUNS]
    every = clip(", ".join(h for h in table.header if h), 200)
    if "s" not in found:
        if known := without_time(table, found, headers.clock_of(table, found)):
            raise known
        faults.found.append(InputError(where, f"no column is a time: {every}", headers.clock_remedy(table, found)))
    if not found.keys() & headers.READ.keys():
        kinds = "no column is a force, a position, a velocity or an acceleration"
        faults.found.append(InputError(where, f"{kinds}: {every}", headers.reading_remedy(table, found)))
    for unit in found.keys() & headers.READ.keys() if hints.observe is None else ():
        with faults:
            headers.physical(table, found[unit], unit)
            if unit.startswith("m") and unit != next(u for u in headers.READ if u in found):
                continue
            if not run and not _SUMS & headers.words_of(found[unit]):
                headers.one_of(table, found[unit], unit)
    time = found.pop("s", "")
    found = {u: found[u] for u in ("N", "tangential", *headers.READ) if u in found}
    raw = [_read(part, time, found, faults) for _, part in parts]
    faults.refuse(where)
    found = {u: h for u, h in found.items() if max(np.isfinite(r[u]).sum() for _, r in raw) >= _FEWEST}
    if not found:
        raise InputError(where, f"no column of readings holds {_FEWEST} numbers", "give a record with readings")
    if "N" not in found and all(_of_places(*one) for one in raw):
        found, raw = {"m": found["m"]}, [(clock, {"m": r["m"]}) for clock, r in raw]
    pulls = [even_pull(*one) for one in raw] if "N" not in found else [0.0]
    pull = float(np.median(pulls)) if all(pulls) else GRAVITY
    if pull != GRAVITY:  # An acceleration beside such places is derived, or reads nothing between contacts.
        kept = "m" if "m" in found else "m/s"
        found, raw = {kept: found[kept]}, [(clock, {kept: r[kept]}) for clock, r in raw]
    pace = float(np.sqrt(pull / GRAVITY))  # On a clock that goes so much slower it falls by gravity.
    signs = {u: _sign(u, [(pace * clock, r[u]) for clock, r in raw]) for u in found}
    unit = next(u for u in headers.READ if u in found)
    records = []
    for (label, _), (clock, readings) in zip(parts, raw, strict=True):
        records.append(_run(label, clock, {u: signs.get(u, 1.0) * v for u, v in readings.items()}, unit))
        if not records[-1].events:
            missing = f"{label}: no contact is found in '{found[unit]}'"
            raise InputError(where, missing, "choose a record that holds one, or another column by --observe")
        event = records[-1].events[0]
        if not event.first and event.last == clock.size - 1 and (turns := headers.torque(table)):
            raise InputError(where, f"{label}: '{found[unit]}' never rests, and is no impact's", turns)
    fallen = any(_fallen(unit, pace * r.clock, r.readings[unit]) for r in records)
    if time and table.bare(time):
        whole = 1.0 if fallen else _WHOLE.get(unit, 1.0)
        headers.seconds(where, time, whole * float(np.median([r.events[0].duration for r in records])))
    given, speeds = _speeds(table, [part for _, part in parts], run)
    rows = {**rows, **hints.rows}
    known = {column(time)[0], time, run, given[0], *found.values(), *(column(h)[0] for h in found.values()), *rows}
    first = records[0]
    return Understood(
        path=table.path,
        table=table.inside,
        time=time,
        columns={u: ("-" if signs[u] < 0 else "") + h for u, h in found.items()},
        others=[h for h in table.header if h and h not in known and column(h)[0] not in known],
        runs=(run, count),
        records=records,
        rows=rows,
        said=table.found,
        given=given,
        speeds=speeds,
        mass=headers.stated_mass(table),
        bare=bool(time) and table.bare(time),
        falls=fallen,
        pull=pull,
        body="body"
        if fallen or unit != "m/s" or any(first_and_last(r.readings[unit])[0] for r in records)
        else "struck",
        vague=given[0] == STATED + HIGH and not DROPPED.search(statements(table, HIGH)[1]),
        dropped=any(DROPPED.search(text) for text in (run, table.inside, *map(" ".join, table.facts))),
        plate=plates.said(parts[0][1], found["N"], first.readings["N"] - first.rest("N")) if "N" in found else "",
    )


def _run(label: str, clock: np.ndarray, readings: dict[str, np.ndarray], unit: str) -> Run:
    """A run with its contacts, by the reading of a unit; wrong samples of what pulses are blanked."""
    pulses = {u: -1.0 if u == "m/s^2" else 1.0 for u in {"N", "m/s^2"} & readings.keys()}
    for u, sign in pulses.items():
        readings[u] = np.where(wrong("contact.normal", clock, sign * readings[u]), np.nan, readings[u])
    kind = "contact.normal" if unit in pulses else headers.READ[unit]
    if unit == "m/s^2":
        readings[unit] = np.where(np.arange(clock.size) < _released(readings[unit]), np.nan, readings[unit])
    return Run(label, clock, readings, contacts(kind, clock, pulses.get(unit, 1.0) * readings[unit]))


def _released(read: np.ndarray) -> int:
    """The sample at which an accelerometer (N,) that is held, and reads its weight, is let go, and reads nothing; 0 of none."""
    held = np.abs(np.abs(read) - GRAVITY) < 0.5 * GRAVITY
    flies = np.abs(read[np.argmin(held) :]) < 0.5 * GRAVITY
    return int(np.argmin(held)) if held[:_FEWEST].all() and flies[:_FEWEST].all() else 0


def _of_places(clock: np.ndarray, readings: dict[str, np.ndarray]) -> bool:
    """Whether readings are of places that fall, as an acceleration is whose mean is no weight: an accelerometer's is one."""
    mean = float(np.mean(np.nan_to_num(readings.get("m/s^2", np.zeros(1)))))
    return "m" in readings and abs(mean) < 0.5 * GRAVITY and _fallen("m", clock, readings["m"])


def _hinted(table: Record, hints: Hints, found: dict[str, str]) -> None:
    """Put the columns that a user names to those that were found."""
    if hints.time is not None:
        table.index(hints.time, "--time")
        found["s"] = hints.time
    if hints.observe is not None:
        header = table.header[table.index(hints.observe, "--observe")]
        said = header if column(header)[1] is not None else hints.observe
        # Who names a column in g as a reading means gravities: a mass is none.
        gravities = column(said)[1] in GRAVITIES and not headers.named(said, "N")
        stated = headers.read_unit(table, said) or next((u for u in headers.READ if headers.named(said, u)), None)
        stated = "N" if column(said)[1] in WEIGHTS else stated
        unit = "m/s^2" if gravities else stated
        if unit not in headers.READ:
            remedy = 'give its unit, as in "column 2 [N]", or its sensor\'s sensitivity: --sensitivity "10 mV/N"'
            raise InputError("--observe", f"'{hints.observe}' has no unit of a reading", remedy)
        for u in headers.READ:
            if unit != "N" or not u.startswith("m") or u == "m/s^2":  # A motion beside a force says what it is of.
                found.pop(u, None)
        found[unit] = said


def _run_column(table: Record) -> str:
    """The column that numbers runs: by its name, or since each whole number stands in one block of rows, apart from the next."""
    if named := run_column(table):
        return named
    clock = headers.values_of(table, table.clock, "s") if table.clock else np.zeros(0)
    sweep = SWEEP if SWEEP in table.header else ""
    if clock.size < 2 * _RUN_ROWS:
        return sweep
    for h, cells in zip(table.header, table.columns, strict=True):
        if h in ("", SWEEP) or column(h)[1] is not None:
            continue
        texts = cells.astype(str)
        changes = np.flatnonzero(texts[1:] != texts[:-1]) + 1
        if not 1 <= changes.size < _MOST_RUNS or not headers.is_numeric(cells):
            continue
        numbers = table.numbers(h, "1", table.name, True)[np.r_[0, changes]]
        lengths = np.diff(np.r_[0, changes, texts.size])
        steps = np.diff(clock)
        # Runs are apart in time, or each has a clock of its own; the samples of a slower channel are not.
        apart = (steps[changes - 1] < 0) | (steps[changes - 1] > 5.0 * np.median(steps))
        begins = numbers[0] in (0.0, 1.0) or sweep
        if apart.all() and (np.diff(numbers) == 1.0).all() and begins and lengths.min() >= _RUN_ROWS:
            return h
    return sweep


def _read(
    part: Record, time: str, found: dict[str, str], faults: Faults
) -> tuple[np.ndarray, dict[str, np.ndarray]]:  # fmt: skip
    """Clock (N,) [s] and readings (N,) by unit of one run; what is wrong with them is put to ``faults``."""
    readings, clock = {}, np.arange(float(part.lines.size))
    with faults:
        clock = evened(part.numbers(time, "s", part.name, blank=False))[0] if time else clock
        check_clock(clock, part, time)
    for unit, header in found.items():
        with faults:
            values = part.numbers(header, "N" if unit == "tangential" else unit, part.name, True)
            readings[unit] = np.where(np.isinf(values), np.nan, values)
    return clock, readings


def _speeds(table: Record, parts: list[Record], run: str = "") -> tuple[tuple[str, str], tuple[float, ...]]:
    """The column that gives speeds, or else heights, of runs, with its unit, and the speed of each run [m/s]."""
    for unit in ("m/s", "m"):
        for header in table.header:
            if not header or not _is_given(header, unit) or not _is_fixed(table, header, run):
                continue
            if column(header)[1] is not None and headers.read_unit(table, header) != unit:
                continue
            values = np.array([next(iter(headers.values_of(part, header, unit)), np.nan) for part in parts])
            if ((values > 0.0) & (values < np.inf)).all():
                speeds = values if unit == "m/s" else np.sqrt(2.0 * GRAVITY * values)
                return (header, unit), tuple(speeds.tolist())
    return ("", ""), ()


def _is_given(header: str, unit: str) -> bool:
    """Whether a name is that of a height or speed of runs."""
    return GIVEN[unit].fullmatch(headers.name_of(header).removeprefix(STATED).replace("_", " ")) is not None


def _filtered(table: Record, time: str) -> tuple[dict[str, str], Record]:
    """Rows beside the one text that has a clock, where a column of text parts the table into curves."""
    if not time:
        return {}, table
    timed = np.array([not is_missing(text) for text in table.texts(time, str(table.path))])
    for h, cells in zip(table.header, table.columns, strict=True):
        if h and h != time and not headers.is_numeric(cells):
            texts = np.array([str(c) for c in cells])
            if timed.all():
                headers.one_channel(table, h, texts, time)
                continue
            whole = [t for t in dict.fromkeys(texts.tolist()) if timed[texts == t].all()]
            if len(whole) == 1 and timed[texts == whole[0]].sum() == timed.sum():
                return {h: whole[0]}, table.where(texts == whole[0])
    return {}, table


def _columns(table: Record, run: str = "") -> dict[str, str]:
    """Headers by unit: those that state one, then those whose name says what they are.

    A column that is one number in each run, such as a drop height, is no reading. Of several accelerations the one that
    changes most is taken: a hit is on one axis.
    """
    found: dict[str, str] = {}
    numeric = [h for h, c in zip(table.header, table.columns, strict=True) if h and headers.is_numeric(c)]
    numeric = [h for h in numeric if h != run and h.strip().lower() not in RUN_COLUMNS and not _is_fixed(table, h, run)]
    numeric = [h for h in numeric if not plates.is_pressure(table, h)]
    own = {column(h)[1] for h in numeric if not headers.BESIDE.search(h.lower())}
    numeric = [h for h in numeric if not headers.BESIDE.search(h.lower()) or column(h)[1] not in own]
    stated = {h: u for h in numeric if (u := headers.read_unit(table, h))}

    def later(header: str) -> tuple[bool, bool, float]:
        unit = stated[header]
        size = -_range(table, header, unit) if unit in ("m/s^2", "N", "m") else 0.0
        total = unit == "N" and not _SUMS.isdisjoint(headers.words_of(header))
        return not (headers.named(header, unit) or total), headers.name_of(header) not in headers.NAMES[unit], size

    # A column named as what it is goes before another of its unit; a second force is tangential only by its name.
    for h in sorted(stated, key=later):
        unit = stated[h]
        unit = "tangential" if unit == "N" and headers.TANGENTIAL & headers.words_of(h) else unit
        found.setdefault(unit, h)
    bare = [h for h in numeric if h not in stated and column(h)[1] is None]
    kinds = {h: u for h in bare if (u := next((u for u in headers.KINDS if headers.named(h, u)), None))}
    # A clock that is named by one of its words alone, as "MocapTime", increases.
    kinds = {h: u for h, u in kinds.items() if u != "s" or headers.name_of(h) in TIMES or headers.rises(table, h)}
    for h in sorted(kinds, key=lambda h: -_range(table, h, kinds[h]) if kinds[h] in ("m/s^2", "N", "m") else 0.0):
        found.setdefault(kinds[h], h)
    for h in bare:  # "F_top_N" and "uptime_s" end in their unit.
        if (unit := h.rpartition("_")[2]) in ("N", "s") and "_" in h[1:]:
            found.setdefault(unit, h)
        if unit == "g" and found.get("N") == h:  # A force named so is a weight; "acc_g" is no force.
            found["N"] = f"{h} [g]"
    load = np.abs(headers.values_of(table, found["N"], "N")) if "N" in found else np.zeros(0)
    stays = bool(table.clock) and not (load < _SUSTAINED * np.fmax.reduce(load, initial=0.0)).any()
    if "tangential" in found and found.keys() & {"m", "m/s"} and (stays or not load.size):
        found["N"] = found.pop("tangential")  # Of a rig that rubs under a load; else it is that of an oblique impact.
    # A letter alone, without a unit, is a place only beside another reading, or where it falls as one: then its unit is known.
    if not found.keys() & {"N", "m/s^2", "m/s"} and (h := found.get("m", "")) in bare:
        found["m"] = in_metres(table, h)
        if found["m"] == h and len(headers.name_of(h)) == 1:
            del found["m"]
    if not found.keys() & headers.READ.keys():  # "ball Z", "Ball Y1": places of a marker where they fall.
        marker = max((h for h in bare if _MARKER.search(h)), key=lambda h: _range(table, h, "m"), default="")
        if marker and (said := in_metres(table, marker)) != marker:
            found["m"] = said
    return found


def _range(table: Record, header: str, unit: str) -> float:
    """How far a column moves; of a place how far from a straight line, for along one no contact is."""
    values = headers.values_of(table, header, unit)
    values, at = values[np.isfinite(values)], np.flatnonzero(np.isfinite(values))
    if unit == "m" and values.size > 2:
        values = values - np.polyval(np.polyfit(at, values, 1), at)
    return float(np.ptp(values)) if values.size else 0.0


def _is_fixed(table: Record, header: str, run: str = "") -> bool:
    """Whether a column is one number in each of several runs; of a table without runs, one that is named as such a number."""
    column_of = dict(zip(table.header, table.columns, strict=True))
    labels = column_of[run].tolist() if run else [""] * table.lines.size
    seen: dict[str, set[str]] = {}
    for label, cell in zip(labels, column_of[header].tolist(), strict=True):
        seen.setdefault(str(label), set()).add(str(cell))
    named = any(_is_given(header, unit) for unit in GIVEN)
    return (len(seen) > 1 or named) and all(len(cells) == 1 for cells in seen.values())


def _fallen(unit: str, clock: np.ndarray, values: np.ndarray) -> bool:
    """Whether places or velocities are those of a body that falls freely."""
    kind, seen = headers.READ[unit].split(".")[1], np.isfinite(values)
    return pushes(kind, clock[seen], values[seen]) is not None


def _sign(unit: str, records: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """-1 of a column to flip: a force pushes; an approach is along +x, and the acceleration in contact against it."""

    def vote(clock: np.ndarray, values: np.ndarray) -> float:
        seen = values[np.isfinite(values)]
        if unit == "m/s" and _fallen(unit, clock, values):  # Held at first it has no way yet.
            return float(np.median(np.gradient(seen)))
        if unit == "m/s":
            before, after = first_and_last(seen)
            return before or -after
        if unit == "m":  # Upwards at first, before it turns?
            return float(seen[np.argmax(np.abs(seen - seen[0]))] - seen[0])
        # A wrong sample has no vote, as far as a contact is seen without: of each three the middle one.
        middle = np.median([seen[:-2], seen[1:-1], seen[2:]], axis=0) if seen.size > 2 else seen
        seen = middle if np.ptp(middle) > _SEEN * scatter(seen) else seen
        level = seen - (rest(seen) or 0.0)  # Further upwards from its rest than downwards?
        return float(np.max(level) + np.min(level))

    upwards = np.nansum(np.sign([vote(*record) for record in records])) >= 0
    return 1.0 if upwards != (unit == "m/s^2") else -1.0


def first_and_last(speeds: np.ndarray) -> tuple[float, float]:
    """The means of the first and of the last twentieth of velocities (N,); the first is 0 of a body that is struck at rest."""
    seen, few = speeds[np.isfinite(speeds)], max(3, speeds.size // 20)
    before, after = float(np.mean(seen[:few])), float(np.mean(seen[-few:]))
    return (before if abs(before) > _STRUCK * abs(after) else 0.0), after


class Sizes(NamedTuple):
    """What the first contacts say, by medians: peak [N], impulse [N s], duration [s], samples in contact and step [s].

    Of records without a force, peak and impulse are per mass; NaN where neither is read.
    """

    peak: float
    impulse: float
    duration: float
    samples: int
    step: float
    # contacts, flights: of the run that has most, their number and the times between them [s].
    contacts: int
    # Least and largest before contact [m/s], from a velocity or position; None where neither is read.
    speed: tuple[float, float] | None
    mass: float | None  # from the impulse over the change of the speed, or from force over acceleration, or None
    flights: list[float]
    # impulses, after: least and largest impulse, and time to the second contact [s], of all records.
    impulses: tuple[float, float]
    after: tuple[float, float]
    loss: Loss | None
    doubt: float  # deviation of the impulse by noise, as a share of it
    silent: list[str]  # names of the records whose contact has no impulse


def sizes(found: Understood) -> Sizes:
    """The sizes of all records together."""
    records, events = found.records, [r.events[0] for r in found.records]
    whole = 1.0 if found.falls else _WHOLE.get(next(u for u in headers.READ if u in found.columns), 1.0)
    has = [r for r in map(specific, records) if "N" in r.readings]
    speeds = [s[0] for r in records if (s := r.speeds()) is not None and s[0] > 0]
    longest = max(records, key=lambda r: len(r.events)).events
    pushed = [r.impulse() for r in has]

    def middle(values: list[float]) -> float:
        return float(np.median(values)) if values else float("nan")

    def ends(values: list[float]) -> tuple[float, float]:
        return min(values, default=np.nan), max(values, default=np.nan)

    return Sizes(
        peak=middle([r.events[0].peak for r in has]),
        impulse=middle(pushed),
        duration=whole * middle([e.duration for e in events]),
        samples=int(whole * np.median([e.last - e.first + 1 for e in events])),
        step=middle([e.step for e in events]),
        contacts=len(longest),
        speed=ends(speeds) if speeds else None,
        mass=_mass(records, bool(speeds)),
        flights=[float(b.begin - a.end) for a, b in pairwise(longest)],
        impulses=ends(pushed),
        after=ends([float(r.events[1].begin - r.events[0].end) for r in records if len(r.events) > 1]),
        loss=loss(longest),
        doubt=middle([r.doubt() / max(abs(r.impulse()), 1e-300) for r in has]),
        silent=[r.name for r, j in zip(has, pushed, strict=True) if j <= 0.0],
    )


def _mass(records: list[Run], moving: bool) -> float | None:
    """Mass by the force: of impulses over changes of speed, or of the acceleration; None where neither is read."""
    read = {u for u in ("N", "m/s^2") if all(u in r.readings for r in records)}
    if "N" in read and moving:
        changes = [r.impulse() / (s[0] - s[1]) for r in records if (s := r.speeds()) is not None and s[0] > s[1]]
        return float(np.median(changes)) if changes else None
    if len(read) < 2:
        return None
    pairs = [(r.readings["N"] - r.rest("N"), -(r.readings["m/s^2"] - r.rest("m/s^2"))) for r in records]
    f, a = (np.nan_to_num(np.concatenate(x)) for x in zip(*pairs, strict=True))
    return float(f @ a / (a @ a)) if a @ a > 0 else None


def specific(record: Run) -> Run:
    """A record of an acceleration as one of a force per mass."""
    if "N" in record.readings or "m/s^2" not in record.readings:
        return record
    return replace(record, readings={**record.readings, "N": -record.readings["m/s^2"]})
