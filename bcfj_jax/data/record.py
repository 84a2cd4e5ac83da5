"""A measured record: channels with their units on one clock, each row with its place in the file, and numbers in SI.

What the channels mean is stated by the problem file. A file that holds several clocks holds as many records.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcfj_jax.core.errors import InputError, clip, nearest
from bcfj_jax.data.clock import is_of_day, is_time, of_day, since_1970, ticks
from bcfj_jax.data.numbers import CLIPPED, is_missing, is_number, parsed
from bcfj_jax.data.sensitivity import ELECTRICAL, NEEDED, NONE, Sensitivities
from bcfj_jax.io.units import WEIGHTS, column, quantity, same, scale_of

# An unfiltered column of one of these names numbers runs: each of its values is an experiment.
RUN_COLUMNS = (
    "run", "experiment", "trial", "drop", "hit", "shot", "test", "versuch", "messung", "schlag", "segment", "run no", "run_no",
    "run number", "trial no", "drop no", "hit no", "impact", "impact no", "essai", "prüfung", "probe", "specimen",
    "wurf", "run_id", "test_id", "trial_id", "hit_id", "drop_id", "cycle no", "shot no", "test no", "nr", "nr.", "no.", "#",
)  # fmt: skip
# What numbers the runs of a clock that begins anew, where no column does.
SWEEP = "sweep"
# What is one number in each run, how high a body fell or how fast it struck: columns, or lines beside a table.
_FELL = "(?:drop|fall(?:ing)?|free fall|chute|ca[ií]da|queda|caduta|val(?=hoogte)|낙하|落下|跌落)"
_HIGH = "(?:height|h(?:ö|oe)he|hoogte|높이|高さ|高度)"
_STRUCK = r"(?:approach|impact\w*|strik\w*|drop|fall|auf(?:prall|treff)\w*|choc|initial)"
GIVEN = {
    "m/s": re.compile(
        rf"v[ _]?(?:0|i|impact)?|(?:{_STRUCK} ?)?(?:speed|velocity|geschwindigkeit)"
        rf"|(?:vitesse|velocidad|velocità)(?: d(?:e |i |')(?:l')?{_STRUCK})?|(?:冲击|碰撞|衝突|충돌|충격) ?(?:速度|속도)"
    ),
    "m": re.compile(
        rf"h|(?:{_FELL} ?)?{_HIGH}|(?:hauteur|altura|altezza|výška|wysokość)(?: d[ei] (?:la )?{_FELL})?"
    ),
}  # fmt: skip
DROPPED = re.compile(rf"(?i)(?<![a-z]){_FELL}")
# Before the name of a column that lines beside a table or its name give, in SI. A line "speed" may be a machine's.
STATED, _BARE = "stated ", re.compile("speed|velocity|geschwindigkeit|vitesse|velocidad")
HIGH = "drop height [m]"
IN_NAME = {
    "approach speed [m/s]": r"(?:^|[\W_]|v)NUMBER(m/s|mps|mm/s)(?:$|[\W_])",
    HIGH: rf"(?:^|[\W_])(?:h|{_FELL}[ _]?{_HIGH}?|{_HIGH})[ _=:]*NUMBER([cm]?m)(?:$|[\W_])",
}  # fmt: skip
IN_SI = ("mat", "hdf5", "tdms")  # Readers of files of programs, whose numbers without a unit are in SI.
# Whole seconds, or parts of them, by name.
_SECONDS = re.compile(r"(?i)(.*?)(nano|micro|mikro|milli|[nuµμm])?[ _]?(?:s|secs?|seconds?|sekunden?)")
_PARTS = {"": 1.0, "n": 1e-9, "nano": 1e-9, "m": 1e-3, "milli": 1e-3}
# Rows of a run at least, and of all times the share within which the clocks of runs begin.
_RUN_ROWS, _ANEW = 20, 0.05
# Cells of one fault that a message quotes.
_QUOTED = 5
# A number that oscilloscopes write for such a sample: 9.9e37 is infinity of SCPI, 9.91e37 no number.
_OVERLOAD = 9.8e37
# Numbers that loggers write where they have none, and how far beyond the others they are.
_SENTINELS, _FAR = (999.0, 9999.0, 99999.0, 999999.0, 9999999.0, 999.99, 9999.99, 1e20, 1e30, 1e37, 3.697314e28), 3.0


class Channel(NamedTuple):
    """A column: its name, its unit as the file states it (None: none), and its cells (N,) as they stand."""

    name: str
    unit: str | None
    values: np.ndarray


class Provenance(NamedTuple):
    """Where a record is from: file, reader, group or sheet, SHA-256 of the file, and what was converted, in words."""

    file: Path
    reader: str
    inside: str
    sha256: str
    converted: str


@dataclass(frozen=True)
class Record:
    """The rows of a file, or of a table in it."""

    path: Path
    header: tuple[str, ...]  # names of the columns, each with its unit in brackets where it has one
    columns: tuple[np.ndarray, ...]  # (N,) arrays, of numbers or of text
    lines: np.ndarray  # (N,) where each row is in the file, for messages
    counted: str = "line"  # what ``lines`` counts: "line" of a text, "row" of a binary file (the first is 1)
    inside: str = ""  # which table of a file that holds several
    decimals: tuple[str, ...] = ()  # of each column the decimal mark of numbers that are texts; empty: points
    faults: tuple[InputError, ...] = ()  # of rows that do not fit, to be said together with those of the columns
    found: str = ""  # how the file is written, in words
    reader: str = "text"  # what read it
    facts: tuple[tuple[str, str], ...] = ()  # names and values beside the table
    sensor: str = ""  # a sensitivity that the file states somewhere, for a question
    sensitivities: Sensitivities = NONE  # of channels that are voltages, charges or shares of a full scale

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The columns with their names and units."""
        return tuple(Channel(*column(h), c) for h, c in zip(self.header, self.columns, strict=True))

    @property
    def clock(self) -> str:
        """Header of the column of times; "" where there is none."""
        named = [(h, c) for h, c in zip(self.header, self.columns, strict=True) if h and is_time(h)]
        both = zip(self.header, self.columns, strict=True)
        of_days = ((h, c) for h, c in both if c.dtype.kind in "mM" or of_day(c[:2].tolist()) is not None)
        # What stands still is when the record was made.
        return next((h for h, c in chain(named, of_days) if ticks(c)), "")

    @property
    def provenance(self) -> Provenance:
        """Where the record is from; the file is read again for its checksum."""
        with open(self.path, "rb") as content:
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        return Provenance(self.path, self.reader, self.inside, digest, self.found)

    @property
    def name(self) -> str:
        """The file, and the table in it where there are several."""
        return f"{self.path}: {self.inside}" if self.inside else str(self.path)

    @property
    def span(self) -> str:
        """The file and the rows that are here."""
        return f"{self.name}: {self.counted}s {self.lines[0]} to {self.lines[-1]}"

    def place(self, row: int, header: str) -> str:
        """A cell, as a user would look it up."""
        return f"{self.name}: {self.counted} {self.lines[row]}, column '{header}'"

    def index(self, name: str, where: str) -> int:
        """Position of a column, by its full header, its name without the unit, or with one that the header has not."""
        bare = tuple(column(h) for h in self.header)
        own, asked = column(name)
        unitless = [
            n == own and (unit is None or bool(asked and (same(unit, asked) or WEIGHTS.get(unit) == asked)))
            for n, unit in bare
        ]
        for wanted, candidates in ((name, self.header), (name, [n for n, _ in bare]), (True, unitless)):
            found = [i for i, candidate in enumerate(candidates) if candidate == wanted]
            if len(found) > 1 and is_time(self.header[found[0]]) and self._alike(found):
                return found[0]
            if len(found) > 1:
                twice = f"{len(found)} columns of {self.name} are headed '{name}'"
                raise InputError(where, twice, "rename one in the file")
            if found:
                return found[0]
        # A text's names that stand again are numbered.
        again = [k for k, (n, u) in enumerate(bare) if re.sub(r" \d+$", "", n) == own != n and asked in (None, u)]
        if len(again) > 1:
            twice = f"{len(again)} columns of {self.name} are headed '{name}'"
            ways = " or ".join(f"'{self.header[k]}'" for k in again)
            raise InputError(where, twice, f"give {ways}, or rename one in the file")
        known = [h for h in self.header if h]
        raise InputError(where, f"no column '{clip(name)}' in {self.name}", nearest(name, known))

    def _alike(self, positions: list[int]) -> bool:
        """Whether columns hold the same, as where a clock stands before each channel."""
        return all(np.array_equal(self.columns[positions[0]], self.columns[k]) for k in positions[1:])

    def bare(self, time: str) -> bool:
        """Whether no unit of a column of times is stated, by its header or since it holds times of day or dates."""
        position = self.index(time, self.name)
        header, cells = self.header[position], self.columns[position]
        known = {column(header)[1], column(time)[1]} - {None} or is_of_day(next(iter(cells[:1].tolist()), ""))
        known = known or cells.dtype.kind in "mM"
        return not known and since_1970(self._parsed(position, True)[0], header) == 1.0

    def texts(self, name: str, where: str) -> list[str]:
        """A column as it stands; numbers in their shortest form."""
        values = self.columns[self.index(name, where)]
        return [f"{v:.15g}" if isinstance(v, (int, float)) else str(v) for v in values.tolist()]

    def numbers(self, name: str, si_unit: str, where: str, blank: bool) -> np.ndarray:
        """A column in SI, NaN where blank, if that is allowed. The unit is the header's, else that of ``name``, else SI."""
        position = self.index(name, where)
        header = self.header[position]
        unit = column(header)[1] or column(name)[1]
        place = f"{self.name}: column '{header}'"
        values, bad = self._parsed(position, si_unit == "s")
        if blank:
            # A sample beyond what an instrument can read stands as infinity: where it was is known, what it was is not.
            infinite = np.flatnonzero(np.isinf(values))
            bad[[k for k in infinite if str(self.columns[position][k]).strip() not in CLIPPED]] = True
            values[np.abs(values) >= _OVERLOAD] = np.inf
            values[_no_values(values)] = np.nan
        wrong = np.flatnonzero(bad if blank else bad | ~np.isfinite(values))
        if wrong.size:
            self._refuse(position, wrong, blank)
        # Of a time of day, a unit such as [hh:mm:ss] says how it is written.
        unit = None if si_unit == "s" and is_of_day(next(iter(self.columns[position].tolist()), "")) else unit
        if si_unit == "s" and unit is None and (size := since_1970(values, header)) != 1.0:
            return (values - values[0]) * size
        with np.errstate(invalid="ignore"):  # Of a damaged file a value may be a signalling NaN.
            values = _unwrapped(values) if si_unit == "s" else values
            scaled = values * self.scale(unit, si_unit, column(header)[0], place)
        return self._carried(scaled) if si_unit == "s" and (np.diff(scaled) < 0.0).any() else scaled

    def _carried(self, parts: np.ndarray) -> np.ndarray:
        """Parts of seconds (N,) [s] that begin anew with each time of a day beside them, with these; others as they are."""
        whole = (of_day(c.tolist()) for c in self.columns if c.dtype.kind in "OUS")
        return next((w + parts for w in whole if w is not None and (np.diff(w + parts) >= 0.0).all()), parts)

    def scale(self, unit: str | None, si_unit: str, name: str, place: str) -> float:
        """The factor of a column of a unit to SI: of a force in kg or lb of the weight, of volts by the sensor's sensitivity."""
        if unit is None:
            return 1.0
        unit = WEIGHTS.get(unit, unit) if si_unit == "N" else unit
        factor = self.sensitivities.of(name, unit)
        if factor is None and unit not in ELECTRICAL:
            return scale_of(unit, si_unit, place)
        if factor is None:
            raise InputError(place, f"is in {unit}, and {si_unit} is wanted", NEEDED.get(unit, NEEDED[""]))
        if factor.si_unit != si_unit:
            found = f"its sensitivity '{factor.text}' leads to {factor.si_unit}, and {si_unit} is wanted"
            raise InputError(place, found, f"give one such as {ELECTRICAL.get(unit, 'mV')}/N for each column by name")
        return factor.factor

    def unit(self, header: str) -> str | None:
        """The unit of a column, that behind its sensor where a sensitivity is given."""
        name, text = column(header)
        found = self.sensitivities.of(name, text)
        return found.si_unit if found else text

    def holds(self, name: str, value: object, where: str) -> np.ndarray:
        """Which rows, (N,) of truth values, hold a value in a column: a text, or a number however it is written."""
        if isinstance(value, (int, float)):
            return self._parsed(self.index(name, where))[0] == value
        return np.array([text == str(value) for text in self.texts(name, where)], dtype=bool)

    def _decimal(self, position: int) -> str:
        return self.decimals[position] if self.decimals else "."

    def _parsed(self, position: int, times: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (N,) of a column as they are written, and which of its cells (N,) are none; ``times`` may be of a day."""
        cells = self.columns[position]
        if times and cells.dtype.kind in "OUS" and (seconds := of_day(cells.tolist())) is not None:
            return seconds, np.zeros(cells.size, dtype=bool)
        if times and cells.dtype.kind in "mM":
            return (cells - (cells[0] if cells.dtype.kind == "M" else np.timedelta64(0, "s"))) / np.timedelta64(
                1, "s"
            ), np.isnat(cells)
        if cells.dtype.kind in "iufb":
            return cells.astype(float), np.zeros(cells.size, dtype=bool)
        if cells.dtype.kind in "OUS":
            return parsed(cells.tolist(), self._decimal(position))
        found = f"column '{self.header[position]}' holds {cells.dtype}, no numbers"
        raise InputError(self.name, found, "store it as numbers, a time as the time since the start")

    def _refuse(self, position: int, wrong: np.ndarray, blank: bool) -> None:
        """Name the cells that are no numbers: the first, the next few, and how many there are."""
        header, cells, decimal = self.header[position], self.columns[position], self._decimal(position)
        first = str(cells[wrong[0]])
        found = f"'{clip(first)}' is not a finite number"
        if wrong.size > 1:
            quoted = [f"{self.counted} {self.lines[k]} '{clip(str(cells[k]), 40)}'" for k in wrong[1:_QUOTED]]
            more = f" and {wrong.size - _QUOTED} more" if wrong.size > _QUOTED else ""
            found += f", nor are {wrong.size} of the column's {cells.size} cells: {', '.join(quoted)}{more}"
        other = "," if decimal == "." else "."
        right = not parsed([first], other)[1][0] and other in first
        if right:
            remedy = f"write decimals with a {'point' if other == ',' else 'comma'}, as the other numbers of the file"
        elif any(mark in first for mark in ("T", ":", "/")) and any(c.isdigit() for c in first):
            remedy = "give a time as a number since the start, in a unit"
        elif 2 * wrong.size > cells.size:
            remedy = "name another column"
        else:
            cell, them = ("cells", "them") if wrong.size > 1 else ("cell", "it")
            remedy = f"correct the {cell}" + (f", or leave {them} blank if nothing was measured" if blank else "")
        raise InputError(self.place(int(wrong[0]), header), found, remedy)

    def held(self, headers: Iterable[str]) -> Record:
        """The rows in which one of the columns holds something."""
        filled = np.zeros(self.lines.size, dtype=bool)
        for header in headers:
            cells = self.columns[self.index(header, self.name)]
            filled |= np.array([not is_missing(c) for c in cells]) if cells.dtype.kind in "OUS" else cells == cells
        return self if filled.all() else self.where(filled)

    def beside(self, header: str, cells: np.ndarray) -> Record:
        """The table with a column (N,) of numbers before the others."""
        marks = (".", *self.decimals) if self.decimals else ()
        return replace(self, header=(header, *self.header), columns=(cells, *self.columns), decimals=marks)

    def where(self, keep: np.ndarray) -> Record:
        """The rows to keep, (N,) of truth values."""
        return replace(self, columns=tuple(c[keep] for c in self.columns), lines=self.lines[keep])


def _unwrapped(ticks: np.ndarray) -> np.ndarray:
    """Whole numbers (N,) of a clock that begins anew at 2^16 or 2^32, as counters of microcontrollers do, going on instead."""
    steps = np.diff(ticks)
    usual = float(np.median(steps)) if steps.size else 0.0
    for size in (2.0**16, 2.0**32):
        turned = (steps < 0.0) & (np.abs(steps + size) < 4.0 * usual)
        if turned.any() and (turned == (steps < 0.0)).all() and ticks.max() < size and (ticks == np.floor(ticks)).all():
            return ticks + size * np.cumsum(np.r_[0.0, turned])
    return ticks


def _no_values(values: np.ndarray) -> np.ndarray:
    """Which numbers (N,) stand for none: those of ``_SENTINELS`` that stand twice or more, far beyond all other numbers."""
    marked = np.isin(np.abs(values), _SENTINELS)
    if not marked.any():
        return marked
    others = np.abs(values[~marked & np.isfinite(values)])
    marked &= np.abs(values) > _FAR * np.max(others, initial=0.0)
    return marked if others.size and np.count_nonzero(marked) > 1 else np.zeros(values.size, dtype=bool)


def run_column(table: Record) -> str:
    """The first column named as in ``RUN_COLUMNS`` that does not number the rows themselves; "" where there is none."""
    for header, cells in zip(table.header, table.columns, strict=True):
        if header.strip().lower() in RUN_COLUMNS and 1 < len(set(cells.tolist())) < cells.size:
            return header
    return ""


def _in_two(table: Record) -> Record:
    """The table with one clock where whole seconds and their parts stand in two columns, "stamp.secs" and "stamp.nsecs"."""
    found = [_SECONDS.fullmatch(h.rstrip(" )]")) for h in table.header]
    at = {(m[1].lower().rstrip(" _"), (m[2] or "").lower()): j for j, m in enumerate(found) if m}
    for name, prefix in at if "time [s]" not in table.header else ():
        if prefix and (name, "") in at:
            whole, parts = (table._parsed(at[name, p], True)[0] * _PARTS.get(p, 1e-6) for p in ("", prefix))
            times, within = whole - whole[:1] + parts, (whole == np.floor(whole)) & (parts >= 0.0) & (parts < 1.0)
            if within.all() and (np.diff(times) > 0.0).all() and (np.diff(whole) <= 0.0).any():
                put = {at[name, ""]: ("time [s]", times)}
                both = [put.get(j, pair) for j, pair in enumerate(zip(table.header, table.columns, strict=True))]
                return replace(table, header=tuple(h for h, _ in both), columns=tuple(c for _, c in both))
    return table


def with_sweeps(table: Record) -> Record:
    """The table with a column "sweep", which numbers the runs where its clock begins anew; else as it is."""
    table = _in_two(table)
    if not table.clock or run_column(table) or SWEEP in table.header:
        return table
    try:
        clock = table.numbers(table.clock, "s", table.name, True)
    except InputError:
        return table
    begins = np.r_[0, np.flatnonzero(np.diff(clock) < 0.0) + 1]
    lengths = np.diff(np.r_[begins, clock.size])
    if begins.size < 2 or lengths.min() < _RUN_ROWS or np.ptp(clock[begins]) > _ANEW * np.ptp(clock):
        return table
    said = f"its clock begins anew {begins.size - 1} times: column '{SWEEP}' numbers what is between"
    return replace(table, found="; ".join(filter(None, (table.found, said)))).beside(
        SWEEP, np.repeat(np.arange(1, begins.size + 1), lengths)
    )


def stated(key: str, value: str, si_unit: str, bare: str | None = None) -> float:
    """What a line beside a table states in a unit, behind its number or in its name, else in ``bare``, SI; 0 of anything else."""
    text = value if "." in value else value.replace(",", ".")
    unit = (column(key)[1] or bare) if is_number(text) else ""
    with contextlib.suppress(InputError):
        return max(quantity(f"{text} {unit}".strip(), si_unit, key), 0.0) if unit is not None else 0.0
    return 0.0


def statements(table: Record, header: str, *names: str) -> tuple[list[float], str]:
    """Speeds or heights, SI, that lines beside a table, or else its name, state, and the words that do; or each of ``names``."""
    dropped = any(DROPPED.search(text) for text in (table.inside, table.path.stem, *names, *map(" ".join, table.facts)))
    unit = str(column(header)[1])
    if unit == "m" and not dropped:
        return [], ""
    named = re.compile(IN_NAME[header].replace("NUMBER", r"(\d+(?:[.,p]\d+)?)[ _]?"), re.IGNORECASE)
    found = [m for text in names or (table.inside, table.path.stem) if (m := named.search(text))]
    here = [(m[0], f"{re.sub('[,p]', '.', m[1])} {m[2].lower().replace('mps', 'm/s')}") for m in found]
    keys = [(column(f[0])[0].lower().replace("_", " ").strip(), f) for f in table.facts]
    said = [f for k, f in keys if GIVEN[unit].fullmatch(k) and (unit == "m" or not _BARE.fullmatch(k))]
    exact = table.reader in IN_SI
    said = (here if len(here) == len(names) else said * exact) if names else said or here[:1]
    bare = unit if unit != "m" and exact else None
    return [v for key, f in said if (v := stated(key, f, unit, bare))], " ".join(key for key, _ in said)


def with_stated(table: Record) -> Record:
    """The table with a column of the speed or else the height of its runs, where lines beside it or its name state it.

    These state one for all rows, or one for each sweep in their order.
    """
    numbered = table.columns[table.header.index(SWEEP)] if SWEEP in table.header else np.zeros(0)
    runs, place = np.unique(numbered if numbered.dtype.kind == "i" else np.zeros(table.lines.size), return_inverse=True)
    for header in IN_NAME:
        found = np.array(list(dict.fromkeys(statements(table, header)[0])))
        if found.size in {1, runs.size}:
            cells, marks = np.resize(found, runs.size)[place], (*table.decimals, ".")
            made = replace(table, header=(*table.header, STATED + header), columns=(*table.columns, cells))
            return replace(made, decimals=marks if table.decimals else ())
    return table


def split(
    table: Record, rows: Mapping[str, object], where: str, runs_by: str | None = None
) -> list[tuple[str, Record]]:
    """The experiments in a table, each with its name.

    ``rows`` keeps the rows whose column equals a value; a list of values makes one experiment of each, and so does ``runs_by``,
    or unasked the first column named as in ``RUN_COLUMNS``; "" asks for none.
    """
    parts = [("", table)]
    named = run_column(table) if runs_by is None else runs_by
    for name, choice in (({column(named)[0]: None} if named else {}) | dict(rows)).items():
        found = table.texts(name, f"{where}: rows")
        values = list(dict.fromkeys(found)) if choice is None else choice if isinstance(choice, list) else [choice]
        several = len(values) > 1 or choice is None
        parts = [
            (f"{label} {name} {value}".strip() if several else label, whole.where(whole.holds(name, value, where)))
            for label, whole in parts
            for value in values
        ]
        for value in values:
            if not table.holds(name, value, where).any():
                there = ", ".join(clip(text, 40) for text in list(dict.fromkeys(found))[:8])
                raise InputError(f"{where}: rows", f"no row has {name} = {clip(value)}", f"values there: {there}")
    return [(label or table.path.stem, part) for label, part in parts if part.lines.size]
