"""``bcfj init calibration RECORD``: a problem file of a dozen lines from a measured table, with what was found in it.

What a record cannot tell, such as the mass, stands in the file as "? kg": ``bcfj calibrate`` then names the key.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.core.quantities import GRAVITY, rounded
from bcfj_jax.data.readers import sheets
from bcfj_jax.data.reading import read, tables
from bcfj_jax.data.record import RUN_COLUMNS, STATED
from bcfj_jax.io.outputs import create, placed
from bcfj_jax.io.units import WEIGHTS, column, format_si
from calibration import problemfile
from calibration.impacts import beside, slow_tests, tosses
from calibration.impacts.events import apart, contacts, telling
from calibration.impacts.inspection import clock_note, plateau
from calibration.impacts.lines import FIXED, NOISE, Draft, Line, Said, box, joined, read_as, toml
from calibration.impacts.otherwise import InMotion, Steady
from calibration.impacts.parting import matching
from calibration.impacts.plausible import TARGET, effective, one_of_two
from calibration.impacts.proposal import Run, Sizes, Understood, sizes, specific

_FILE = "or a scene file: another law, two stages"
_SAID = {
    "impact": f"one contact, no gravity; {_FILE}",
    "bounce": f"a drop under gravity, several contacts; {_FILE}",
    "oblique_impact": f"a sphere with friction and spin; {_FILE}",
}
SCENES, _ALIGN, _TABLES = tuple(_SAID), "onset", "tables"
# Depth of a half sine over speed and duration; a restitution where no reading gives it.
_DEPTH, _USUAL = 3.2, 0.7
# Restitution from the impulse above which nothing is lost: no damping is searched where it is above by so many deviations of its
# noise, and damping from 0 on where these leave open that it is.
_ELASTIC, _SURE = 0.98, 2.0
# Shares of its noise in an impulse from which on a record may show no contact.
_UNHEARD = 0.2
# Below this exponent of the speed the loss of a contact does not grow as that of a damping.
_GROWS = 0.5
# Flights over contacts from which on contacts are apart, and of a bounce at most over the one before; share of its speed that a
# body gains by gravity in contact, to be said; peak of a bounce over the one before at most, samples being what they are.
_APART, _KEPT, _PULLED, _GAINED = 2.0, 0.995, 0.01, 1.2
# Bounds beyond what the record says: of a stiffness, a damping times the speed, a speed or mass from an impulse.
_WIDE, _LOSS, _MARGIN = 30.0, (0.01, 5.0), 1.4
# From the middle of what tells a speed to the touch, over the duration that a contact seems to have.
_BEFORE = 0.6
# Speeds that a mass which is not known yet leaves open [m/s].
_ANY_SPEED = (0.01, 100.0)
_EXPONENTS = (1.0, 2.5)
_BODY = (
    "Force over acceleration is {}, the mass of the body with that sensor: it is the mass of the contact only where the other "
    "body is fixed. Of two free bodies give mass (what strikes) and struck_mass"
)
# The one question of a record with a force and the acceleration of a body: what the other body is.
_STRUCK = 'QUESTION: take the first # away where the struck body cannot move, else give its mass, "4.8 kg"'


class _Known(NamedTuple):
    """Mass and speed, SI, with where they are from: a pair is bounds to search between, None is not known.

    ``by_column``: whether a column gives the speed of each run, of which the pair is the least and the largest.
    """

    mass: float | tuple[float, float] | None
    speed: float | tuple[float, float] | None
    mass_from: str
    speed_from: str
    by_column: bool = False


def run(record: Path, out: Path | None, said: Said, say: Callable[[str], None]) -> int:
    """Write RECORD's problem file into a folder, by default this one; never over another. ``say`` prints.

    Raises:
        InputError: for a file that holds no clock, no reading or no contact, and where the problem file is there already.
    """
    path, relative = _paths(record, out)
    draft, made = _drafted(record, said, path, relative), []
    try:
        for file, text in draft.files.items():
            create(file, text)
            made.append(file)
        for one in problemfile.prepared(path) if draft.whole else ():
            say(f"{one.name}: {'; '.join(one.notes)}")
    except InputError:
        for file in made:
            file.unlink()
        raise
    for text in draft.said:
        say(text)
    return 0


def _drafted(record: Path, said: Said, path: Path, file: str) -> Draft:
    """What is proposed at ``path`` of the record ``file``, by the kind that it is."""
    try:
        found = found_in(record, said)
    except InMotion as moved:
        if said.scene:
            raise
        return tosses.draft(moved, record, said, path, file)
    except Steady as curve:
        if said.scene:
            raise
        return slow_tests.steady(curve, path)
    if not said.scene:
        slow_tests.refuse(found)
    if not said.scene and (slow_tests.pulls(found.records[0], str(record)) or slow_tests.is_slow(found.records[0])):
        return slow_tests.draft(found, said, path, file)
    kind = said.scene or _kind(found)
    if kind not in SCENES:
        raise InputError("--scene", f"no problem file is proposed for the scene '{kind}'", nearest(kind, SCENES))
    if said.struck is not None and kind != "impact":
        raise InputError("--struck-mass", f"the scene is '{kind}'", "give it of an impact")
    found = _believed(found, said)
    found = _each(found, said) if kind == "impact" else found
    text, missing = _text(found, kind, said, file)
    wrote, after = f"wrote {path}", f"bcfj calibrate {quote(str(path))}"
    if missing:
        facts = "; ".join(filter(None, (found.said, clock_note(found.records[0].clock))))
        them, marks = ("it", "the question mark") if len(missing) == 1 else ("them", "the question marks")
        left = f"the record does not give {' and '.join(missing)}: write {them} in {path} in place of {marks}, then: {after}"
        return Draft({path: text}, [f"{record}: {facts}", wrote, left], False)
    question = f'one question is left in {path}, struck_mass: "{FIXED}", or the mass of the body that is struck'
    asked = [question] if _asks(found, kind, said) else []
    return Draft({path: text}, [wrote, *asked, f"next: {after}"], True)


def _paths(record: Path, out: Path | None) -> tuple[Path, str]:
    """Where the problem file goes, and the record as seen from there."""
    name = f"{re.sub('[*?]+', '', record.stem).strip(' _-') or 'records'}.toml"
    path = placed(out, name)
    return path, Path(os.path.relpath(record, path.parent)).as_posix()


def found_in(record: Path, said: Said) -> Understood:
    """What a record is: a file, the one table of several that holds a contact, or all files of a pattern."""
    tabled = said.hints.runs_by == _TABLES
    hints = said.hints._replace(runs_by=None) if tabled else said.hints

    def seen(path: Path, table: str | None) -> Understood:
        return beside.runs(read(path, "record", table, said.stated), hints)

    if (paths := matching(record)) != [record]:
        if not paths:
            raise InputError("record", f"no file is named as {record}", "put the pattern in quotes: 'run*.csv'")
        each = [seen(p, said.table) for p in paths]
        for one in each:
            if (one.columns, one.time) != (each[0].columns, each[0].time):
                found = f"{one.path} has other columns than {paths[0]}: {', '.join(one.columns.values())}"
                raise InputError("record", found, "propose a file for each kind")
        records = [r for e in each for r in e.records]
        speeds = tuple(v for e in each for v in e.speeds) if all(e.speeds for e in each) else ()
        return replace(each[0], records=records, speeds=speeds, runs=("file", len(records)))
    if said.table is not None or len(names := tables(record, "record", said.stated)) < 2:
        return seen(record, said.table)
    found, refused, moved = [], [], []
    for name in names:
        try:
            found.append(seen(record, name))
        except InputError as error:
            moved += [error] if isinstance(error, InMotion) else []
            refused.append(f"'{name}': {error.found}; {error.remedy}")
    if moved and not found and all(m.columns == moved[0].columns for m in moved):
        moved[0].tables = [m.table.inside for m in moved]
        raise moved[0]
    kinds = {(f.time, tuple(f.columns.items())) for f in found}
    # Sheets named alike but for a number are runs, as "h = 30 mm"; "plate 1" and "plate 2" of other files are sensors.
    alike = record.suffix in sheets.KINDS and len({re.sub(r"\d+(?:[.,]\d+)?", "#", f.table) for f in found}) == 1
    if len(found) == 1 or (len(kinds) == 1 and (tabled or alike or all(beside.label(f.table) for f in found))):
        return beside.joined([(f.table, f) for f in found])
    which = ", ".join(f'--table "{f.table}"' for f in found) or "; ".join(refused)
    many = f"{len(found)} of them hold a contact" if found else "none holds a clock, a reading and a contact"
    ways = f"give {which}" + f"; where each is a run --runs-by {_TABLES}" * (len(kinds) == 1)
    raise InputError(str(record), f"holds {len(names)} tables, and {many}", ways if found else which)


def _believed(found: Understood, said: Said) -> Understood:
    """What was understood, but for stated speeds v that impulses J = m v to 2 m v + m g T deny, or a vague height without m."""
    pushed = [r for r in map(specific, found.records) if "N" in r.readings]
    mass = said.number("mass", "kg") or found.mass
    beside = (found.given[0] or STATED).startswith(STATED)  # Of a column of runs a fit says what is wrong.
    if said.speed is not None or not (found.speeds and beside) or len(pushed) != len(found.speeds):
        return found
    mass = 1.0 if "N" not in found.columns else None if mass is None else effective(mass, said.other)
    each = [(r.impulse(), v, GRAVITY * r.events[0].duration) for r, v in zip(pushed, found.speeds, strict=True)]
    least, most = max(j / (2.0 * v + more) for j, v, more in each) / _MARGIN, min(j / v for j, v, _ in each) * _MARGIN
    vague = found.vague and mass is None and len(set(found.speeds)) == 1
    if not vague and max(least, mass or 0.0) <= min(most, mass or np.inf):
        return found
    why = "no word says that the body fell from it, and no mass is given" if vague else "impulse and mass deny it"
    text = f"CHECK: a stated {format_si(min(found.speeds), 'm/s', 3)} is not used: {why}; --speed says the right one"
    return replace(found, speeds=(), given=("", ""), doubt=text)


def _each(found: Understood, said: Said) -> Understood:
    """What was understood with each contact as a record, where several stand far apart and each may have a speed of its own."""
    s = sizes(found)
    if said.speed is not None or found.given[0] or not s.flights or min(s.flights) < _APART * s.duration:
        return found
    unit = next((u for u in ("N", "m/s^2") if u in found.columns), "")
    if not unit or (len(found.records) > 1 and max(len(r.events) for r in found.records) == 1):
        return found
    pieces = []
    for record in found.records:
        for k, keep in apart(record.clock, record.events):
            readings = {u: v[keep] for u, v in record.readings.items()}
            seen = -readings[unit] if unit == "m/s^2" else readings[unit]
            if events := contacts("contact.normal", record.clock[keep], seen):
                pieces.append(Run(f"{record.name} contact {k + 1}", record.clock[keep], readings, events[:1]))
    left = sum(len(r.events) for r in found.records) - len(pieces)
    note = f"; {left} contacts below a tenth of the largest peak left out" if left else ""
    runs = (found.runs[0] or "contact", len(pieces))
    return replace(found, records=pieces, runs=runs, each=True, said=found.said + note)


def _kind(found: Understood) -> str:
    """The scene that a record looks like: flights longer than contacts that get shorter are bounces, equal ones a swing's."""
    if "tangential" in found.columns:
        return "oblique_impact"
    s = sizes(found)
    peaks = [e.peak for e in max(found.records, key=lambda r: len(r.events)).events]
    falling = all(b < _KEPT * a for a, b in pairwise(s.flights)) and all(b < _GAINED * a for a, b in pairwise(peaks))
    return "bounce" if found.falls or (s.flights and falling and min(s.flights) > s.duration) else "impact"


def _text(found: Understood, kind: str, said: Said, file: str) -> tuple[str, list[str]]:
    """The problem file of a record ``file``, and the keys that are left to fill in."""
    s, mass, speed, other = sizes(found), said.number("mass", "kg"), said.number("speed", "m/s"), said.other
    stated = mass is None and found.mass is not None
    mass = found.mass if stated else mass
    if s.silent:
        lost = "what is taken for a contact has no impulse: its readings may be noise alone"
        raise InputError(f"{found.path} {', '.join(s.silent)}", lost, "choose a column, or rows, that show a contact")
    # What a contact feels of two free bodies is their effective mass.
    felt = None if mass is None else effective(mass, other)
    if kind == "impact" and "N" not in found.columns:
        found, s = one_of_two(found, s, (mass, other), speed, said.struck is not None)
    known = _bounced(s, mass, speed, found) if kind == "bounce" else _known(s, felt, speed, found)
    # 1 + e from the impulse, where mass and speed are both known.
    ratio = float("nan")
    if isinstance(known.mass, float) and isinstance(known.speed, float):
        # Of an acceleration what is summed up is a change of speed already.
        each = s.impulse / (known.mass if "N" in found.columns else 1.0)
        # What falls is held up in contact, too.
        ratio = (each - found.pull * s.duration * (kind == "bounce")) / known.speed
    doubt = _SURE * s.doubt * ratio
    elastic = kind == "impact" and ratio - doubt > 1.0 + _ELASTIC
    lossless = kind == "impact" and ratio + doubt > 1.0 + _ELASTIC
    # A drop goes on falling in contact.
    dropped = found.dropped and said.struck is None
    falls = kind == "impact" and (dropped or (known.by_column and found.given[1] == "m"))
    own = known if mass is None else known._replace(mass=mass)
    own = own._replace(mass_from="CHECK the mass, which the file states") if stated else own
    entries = _entries(own, kind, elastic, falls)
    if found.pull != GRAVITY and kind == "bounce":
        entries.append(
            _Entry("gravity", found.pull, "m/s^2 +- 1 %", "CHECK the gravity: it is that between the contacts")
        )
    by_name, why = known.by_column and not found.given[0], "CHECK the speed, which is stated"
    own_speed = [_Entry("approach_speed", v, "m/s", why) for v in found.speeds if by_name]
    runs = [replace(found, parts=(p,), table=p.table, time=p.time, columns=p.columns) for p in found.parts]
    said_of = _other(found, kind)
    if s.doubt > _UNHEARD:
        said_of.append(
            f"CHECK: the impulse of this contact is {rounded(1.0 / s.doubt)} deviations of the noise: the record may show none"
        )
    elif ratio + doubt <= 0.95 or ratio - doubt >= 2.05:
        wrong = "and 1 + e is 1 to 2: mass, speed, a unit or the gain is wrong"
        said_of.append(f"CHECK: impulse / (mass x speed) is {ratio:.3g}, {wrong}")
    pull = GRAVITY * s.duration / _DEPTH / (_middle(known.speed) or 1.0)
    if kind == "impact" and not falls and pull > _PULLED and known.speed != _ANY_SPEED:
        way = f'add gravity = "9.80665 m/s^2" to parameters: it is {pull:.1g} of the speed'
        said_of.append(f"CHECK: no gravity acts; where the body falls, {way}")
    if said.struck is None and "N" not in found.columns and TARGET.search(str(found.columns)):
        said_of.append("CHECK: it seems to be read on the body that is struck: give --mass and --struck-mass")
    if s.mass and not s.speed and mass is None:
        said_of.append(_BODY.format(format_si(s.mass, "kg", 3)))
    name = f"{found.path.stem}.toml"
    lines = [
        f"# A contact law from {found.path.name}, proposed by bcfj init calibration. Next: bcfj calibrate {quote(name)}",
        *([f"# Read as {found.said}."] if found.said else []),
        f"# Found: {_summary(found, s)}.",
        *(f"# {text}." for text in said_of),
        Line(f'scene = "{kind}"', f"one contact under the gravity below; {_FILE}" if falls else _SAID[kind]),
        Line('sensor = "free"', 'each record\'s clock and zero are found, too; "exact" holds them at 0'),
        *(
            line
            for k, one in enumerate(runs or [found])
            for line in (
                "[[experiment]]",
                *read_as(one, said, file),
                *[Line('contacts = "each"', "every contact is a record, each with a speed of its own")] * found.each,
                *[f"runs_by = {toml(found.runs[0])}"] * _asked_runs(found, said),
                _observed(one, kind),
                *_saturated(found),
                NOISE,
                *_window(s, kind, found.records),
                *[_columned(found, kind)] * (known.by_column and not by_name),
                *_parameters(entries + own_speed[k : k + 1], said.struck, _asks(found, kind, said)),
            )
        ),
        "[free]",
        *_free(s, known, kind, found, None if elastic else lossless),
    ]
    return joined(lines), [e.key for e in entries if e.value is None]


def _asks(found: Understood, kind: str, said: Said) -> bool:
    """Whether a record of a force and one body's acceleration leaves open what the other body is."""
    return kind == "impact" and said.struck is None and said.speed is None and {"N", "m/s^2"} <= found.columns.keys()


class _Entry(NamedTuple):
    """A parameter of every record; its value is None where it is left to fill in."""

    key: str
    value: float | None
    unit: str
    origin: str = ""

    @property
    def text(self) -> str:
        return f'"{"?" if self.value is None else f"{self.value:.6g}"} {self.unit}"'


def _entries(known: _Known, kind: str, elastic: bool, falls: bool) -> list[_Entry]:
    entries = []
    if not isinstance(known.mass, tuple):
        entries.append(_Entry("mass", known.mass, "kg", known.mass_from))
    if kind != "bounce" and not isinstance(known.speed, tuple):
        entries.append(_Entry("approach_speed", known.speed, "m/s", known.speed_from))
    if kind == "oblique_impact":
        entries += [_Entry("impact_angle", None, "deg"), _Entry("radius", None, "mm")]
    if elastic:
        entries.append(_Entry("damping", 0.0, "s/m", "the impulse says that nothing is lost: no damping is searched"))
    if falls:
        entries.append(_Entry("gravity", GRAVITY, "m/s^2", "a drop has its weight in contact, too"))
    return entries


def _parameters(entries: list[_Entry], struck: str | None, asks: bool) -> list[Line]:
    """What is known of every record, with the question of the struck body."""
    texts = {e.key: e.text for e in entries} | ({"struck_mass": toml(struck)} if struck else {})
    origins = dict.fromkeys(e.origin for e in entries if e.value is not None and e.origin)
    note = "FILL IN the question marks" if any(e.value is None for e in entries) else "; ".join(origins)
    if asks:  # A line each: one of them is to be taken in.
        lines = [Line(f"parameters.{key} = {x}", "" if k else note) for k, (key, x) in enumerate(texts.items())]
        return [*lines, Line(f'# parameters.struck_mass = "{FIXED}"', _STRUCK)]
    text = ", ".join(f"{key} = {x}" for key, x in texts.items())
    return [Line(f"parameters = {{ {text} }}", note)] if texts else []


def _columned(found: Understood, kind: str) -> Line:
    """The line by which a column gives the speed of every run."""
    header, unit = found.given
    key = "drop_height" if unit == "m" else "approach_speed"
    how = "of each run, which strikes at sqrt(2 g h)" if unit == "m" and kind != "bounce" else "of each run"
    note = f'{how}; CHECK, and say how well it is known: "{header} +- 2 %"'
    return Line(f"columns = {{ {key} = {toml(header)} }}", note)


def rows_of(text: str | None) -> dict[str, Any]:
    """What --rows says: a column and a value."""
    if text is None:
        return {}
    name, mark, value = (part.strip() for part in text.partition("="))
    if not (name and mark and value):
        raise InputError("--rows", f"'{text}'", 'give a column and a value: "Sensor = A"')
    return {name: value}


def _asked_runs(found: Understood, said: Said) -> bool:
    """Whether the file must say what numbers its runs, since no name of the column does."""
    named = found.runs[0].strip().lower() in RUN_COLUMNS
    return found.runs[0] not in ("", "file", "contact", "beside") and (said.hints.runs_by is not None or not named)


def _summary(found: Understood, s: Sizes) -> str:
    what = "contacts" if found.each else "files" if found.runs[0] == "file" else "runs"
    many = f"{found.runs[1]} {what}, " if found.runs[0] else ""
    of = "" if not many else " a run" if what == "runs" else " each"
    parts = [
        f"{many}a sample every {format_si(s.step, 's', 3)}",
        f"{s.contacts} contact{'s' if s.contacts > 1 else ''}{of}, the first of "
        f"{format_si(s.duration, 's', 3)} and {s.samples} samples",
    ]
    if np.isfinite(s.peak):
        peak, impulse = ("N", "N s") if "N" in found.columns else ("m/s^2", "m/s")
        parts.append(f"peak {format_si(s.peak, peak, 3)}, impulse {format_si(s.impulse, impulse, 3)}")
    if "N" in found.columns:
        level = float(np.median([r.rest("N") for r in found.records]))
        parts.append(f"rest at {format_si(level, 'N', 2)}")
    if s.speed:
        parts.append(f"approach at {format_si(float(np.mean(s.speed)), 'm/s', 3)}")
    return "; ".join(parts)


def _wider(least: float, most: float) -> tuple[float, float]:
    """Bounds of a mass or speed by impulses: J/2 to J over the other, since 1 + e is 1 to 2."""
    return least / 2.0 / _MARGIN, most * _MARGIN


def _known(s: Sizes, mass: float | None, speed: float | None, found: Understood) -> _Known:
    """Mass and speed of an impact: as given, else as other columns show them, else as the impulse bounds them."""
    if speed is None and found.speeds and not (s.speed and found.given[0].startswith(STATED)):
        return _with_speeds(mass, found)
    mass_from = speed_from = "as given"
    v: float | tuple[float, float] | None = speed
    m: float | tuple[float, float] | None = mass
    if v is None and s.speed:
        v, speed_from = (s.speed[0] / _MARGIN, s.speed[1] * _MARGIN), "from the motion before contact"
    if m is None and s.mass and s.mass > 0 and s.speed:
        m, mass_from = float(f"{s.mass:.3g}"), "CHECK the mass, the impulse over the change of the speed: weigh it"
    least, most = s.impulses
    pushed = np.isfinite(s.impulse) and s.impulse > 0
    force = "N" in found.columns and pushed
    if m is None and isinstance(v, float) and force:
        m = _wider(least / v, most / v)
    if v is None and isinstance(m, float) and force:
        v, speed_from = _wider(least / m, most / m), "from the impulse and the mass"
    elif v is None and pushed and not force:  # What an acceleration sums up to is v (1 + e).
        v, speed_from = _wider(least, most), "from the change of speed in contact"
    return _Known(m, v if v is not None else _ANY_SPEED, mass_from, speed_from)


def _with_speeds(mass: float | None, found: Understood) -> _Known:
    """Where a column gives the speed of each run: the mass follows from each run's own impulse."""
    ends = min(found.speeds), max(found.speeds)
    if mass is not None or "N" not in found.columns:
        return _Known(mass, ends, "as given", "", True)
    masses = [m for r, v in zip(found.records, found.speeds, strict=True) if (m := r.impulse() / v) > 0.0]
    return _Known(_wider(min(masses), max(masses)) if masses else None, ends, "", "", True)


def _bounced(s: Sizes, mass: float | None, speed: float | None, found: Understood) -> _Known:
    """Mass and speed of a drop: a flight of length t ends the impact at g t/2, and the next begins with that."""
    if found.falls and s.speed and not (s.flights and (len(found.records) > 1 or found.given[0])):
        # That of the stretch before a contact, which ends when the body touches.
        v = speed if speed is not None else float(np.mean(s.speed)) + _BEFORE * found.pull * s.duration
        return _Known(mass, v, "as given", "from the motion before contact")
    if not s.flights:
        remedy = "take --scene impact, or a record of two contacts"
        raise InputError("--scene", "bounce, but no record holds two contacts", remedy)
    after = 0.5 * found.pull * s.flights[0]
    kept = min(max(s.flights[1] / s.flights[0], 0.2), 0.99) if len(s.flights) > 1 else _USUAL
    v = speed if speed is not None else after / kept
    m: float | tuple[float, float] | None = mass
    if m is None and "N" in found.columns:
        m = (s.impulse / (v + after) / 2.0, s.impulse / (v + after) * 2.0)
    origin = "from the flights between contacts" if speed is None else "about the speed given"
    named = found.given[0] and not found.given[0].startswith(STATED)
    return _Known(m, v, "as given", origin, bool(speed is None and found.given[1] == "m" and named))


def _middle(value: float | tuple[float, float] | None) -> float | None:
    return float(np.sqrt(value[0] * value[1])) if isinstance(value, tuple) else value


def _columns(found: Understood, kind: str) -> tuple[dict[str, str], list[str]]:
    """Headers with their sign, by the readings of the scene, and which are fitted: forces, or what tells a contact best.

    An impact goes along +x, a fall along -y.
    """
    axis, sign = ("x", 1.0) if kind == "impact" else ("y", -1.0)
    names = {"N": "contact.normal", "tangential": "contact.tangential" if kind == "oblique_impact" else ""}
    moved = {"m/s^2": "acceleration", "m/s": "velocity", "m": "place"}
    names |= {unit: f"{found.body}.{what}.{axis}" for unit, what in moved.items()}
    signed = {}
    for unit, header in found.columns.items():
        if names[unit]:
            minus = header.startswith("-") != ((sign < 0 and unit.startswith("m")) or found.body == "struck")
            signed[names[unit]] = f"{'-' if minus else ''}{header.removeprefix('-')}"
    return signed, [name for name in signed if name.startswith("contact.")] or telling(signed)[:1]


def _observed(found: Understood, kind: str) -> Line:
    columns, taken = _columns(found, kind)
    text = ", ".join(f'"{name}" = {toml(columns[name])}' for name in taken)
    flipped = columns.get("contact.normal", "").startswith("-")
    return Line(f"observe = {{ {text} }}", "its sign is flipped: a contact pushes" if flipped else "")


def _saturated(found: Understood) -> list[Line]:
    """Where forces stand still at one peak, which no contact does."""
    read = [r.readings["N"] for r in found.records if "N" in r.readings]
    tops = [plateau(values[np.isfinite(values)]) for values in read]
    level, count = min((top for top in tops if top[1]), default=(0.0, 0))
    note = f"CHECK that it clips there: it reads so {count} times in a row"
    return [Line(f'saturation = "{format_si(0.99999 * level, "N")}"', note)] if count else []


def _other(found: Understood, kind: str) -> list[str]:
    """What the table holds beside what is fitted."""
    columns, taken = _columns(found, kind)
    more = [f'"{name}" = "{h}"' for name, h in columns.items() if name not in taken]
    said = [f"It could observe more: {', '.join(more)}"] if more else []
    bare = [h for h in (h.removeprefix("-") for h in found.columns.values()) if column(h)[1] is None]
    bare[:0] = [found.time] * found.bare
    said += [f"CHECK: no unit is stated of {', '.join(bare)}; SI is taken"] if bare else []
    heavy = found.columns.get("N", "")
    unit = column(heavy.removeprefix("-"))[1]
    said += [f"CHECK: {heavy} is taken as the weight of so many {unit}"] if unit in WEIGHTS else []
    how = "freely: gravity" if found.pull == GRAVITY else f"by {found.pull:.3g} m/s^2, as on a slope, which"
    said += [f"CHECK: {h} falls {how} acts along it" for h in [*found.columns.values()][: found.falls]]
    said += [text for text in (found.plate, found.doubt) if text]
    return said + ([f"Not understood: {', '.join(found.others)}"] if found.others else [])


def _window(s: Sizes, kind: str, runs: list[Run]) -> list[Line]:
    """About the first contact of an impact; a bounce is taken whole, from where a held accelerometer stops to read its weight."""
    if kind == "bounce":
        read, clock = runs[0].readings, runs[0].clock
        seen = np.flatnonzero(np.isfinite(read.get("m/s^2", np.zeros(1))))
        if len(runs) > 1 or "N" in read or not seen.size or not seen[0]:
            return []
        ends = [format_si(float(clock[k]), "s", 6) for k in (seen[0], -1)]
        return [Line(f'window = ["{ends[0]}", "{ends[1]}"]', "from its release on: it reads its weight before")]
    before = max(s.duration, 12.0 * s.step)
    after = s.duration + max(0.75 * s.duration, 6.0 * s.step)
    note = ""
    if s.flights:
        after = min(after, s.duration + 0.7 * s.flights[0])
        note = f"the first of {s.contacts} contacts; --scene bounce takes all"
    ends = f'["{format_si(-before, "s", 3)}", "{format_si(after, "s", 3)}"]'
    return [Line(f'align = "{_ALIGN}"', "time 0 where the record first rises"), Line(f"window = {ends}", note)]


def _free(s: Sizes, known: _Known, kind: str, found: Understood, lossless: bool | None) -> list[Line]:
    """What is searched, with bounds that follow from the impulse, the duration and the peak.

    ``lossless``: whether the impulse leaves open that nothing is lost; None where no damping is searched.
    """
    m, v, force = _middle(known.mass), _middle(known.speed), "N" in found.columns
    open_scale = m is None or known.speed == _ANY_SPEED
    speeds: tuple[float, float] = known.speed if isinstance(known.speed, tuple) else (v, v) if v else _ANY_SPEED
    peak = s.peak
    if not force:  # The mass times what is read; without an acceleration a half sine of the change of speed.
        each_kg = s.peak if np.isfinite(s.peak) else 1.6 * (v or 1.0) * (1.0 + _USUAL) / s.duration
        peak = each_kg * (m or 1.0)
    depths = [x * s.duration / _DEPTH for x in speeds]
    ends = [peak / d**n for d in depths for n in _EXPONENTS]
    unknown = 1.0 if m is not None or force else 1e3
    origin = f"depth about {format_si(float(np.sqrt(depths[0] * depths[-1])), 'm', 2)}, force {format_si(peak, 'N', 2)}"
    origin = "wide: the mass is not known yet" if open_scale else origin
    each = ", each = true" if found.runs[0] else ""
    stiff = (f"{min(ends) / _WIDE / unknown:.1g}", f"{max(ends) * _WIDE * unknown:.1g}")
    lines = [
        box("stiffness", stiff, f"N/m^n; {origin}"),
        box("exponent", (f"{n}" for n in _EXPONENTS), "1.5 of a smooth elastic bump"),
    ]
    if kind == "oblique_impact":
        lines += [box("friction_dynamic", ("0.01", "1.0")), box("restitution", ("0.1", "1.0"))]
    elif kind == "bounce" and s.loss is not None and s.loss.exponent + 2.0 * s.loss.deviation < _GROWS:
        most, least = s.loss.kept.max(), s.loss.kept.min()
        bounds = f"{max(1.0 - 2.0 * (1.0 - least), 0.05):.3g}", f"{1.0 - 0.5 * (1.0 - most):.3g}"
        note = f"{least:.3g} to {most:.3g} by the flights, whatever the speed: law of Flores"
        lines.append(box("restitution", bounds, note))
    elif lossless is not None:
        bounds = f"{_LOSS[0] / max(speeds):.2g}", f"{_LOSS[1] / min(speeds):.2g}"
        note = "s/m; 0.01 to 5 over the speed"
        if lossless:
            bounds, note = ("0.0", bounds[1]), "s/m; 0 to 5 over the speed: the impulse leaves open whether any is lost"
        lines.append(box("damping", bounds, note, ', scale = "linear"' if lossless else ""))
    if isinstance(known.mass, tuple):
        lines.append(box("mass", (f'"{x:.3g} kg"' for x in known.mass), "from the impulse and the speed"))
    if known.by_column:
        return lines
    if kind == "bounce":
        height = (v or 1.0) ** 2 / (2.0 * found.pull)
        # Runs may be of several heights, whose flights are as the speeds.
        heights = [height * (t / s.flights[0]) ** 2 for t in s.after] if s.flights else [height] * 2
        most = 4.0 if known.speed_from == "from the flights between contacts" else 2.0
        bounds = (f'"{x:.3g} m"' for x in (0.5 * heights[0], most * heights[1]))
        lines.append(box("drop_height", bounds, known.speed_from, each))
    elif isinstance(known.speed, tuple):
        note = "any: the mass is not known yet" if open_scale else known.speed_from
        lines.append(box("approach_speed", (f'"{x:.3g} m/s"' for x in known.speed), note, each))
    return lines
