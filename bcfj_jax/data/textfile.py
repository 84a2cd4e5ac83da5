"""Text files as rigs write them: encoding, separator, decimal mark, preamble, names and units are found, and said.

Nothing is assumed where two readings are possible: the message then names the key of [[experiment]] that settles it.
"""

from __future__ import annotations

import contextlib
import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.core.errors import InputError, clip
from bcfj_jax.data import clock, numbers
from bcfj_jax.data.decoding import decoded
from bcfj_jax.data.layout import File, Layout, Row, found, others
from bcfj_jax.data.record import Record, with_sweeps
from bcfj_jax.io.opening import LARGEST_TEXT, content
from bcfj_jax.io.units import column, known

SEPARATORS = {"tab": "\t", "semicolon": ";", "pipe": "|", "comma": ",", "blank": " "}
_SAID = {"tab": "tabs", "semicolon": "semicolons", "pipe": "pipes", "comma": "commas", "blank": "blanks"}
_COMMENTS = ("#", "%", "//", "!")
DECIMAL = 'give decimal = "." or decimal = "," under [[experiment]], or --decimal of bcfj init calibration'
# Blanks before and inside brackets, and about a slash.
_BESIDE_A_UNIT = re.compile(r"\s+(?=[\[(])|(?<=[\[(])\s+|\s+(?=[\])])|\s*/\s*")
# Numbers and times within a line, which may be a text about them: "[10:00:00.050] F=4.3 N", '{"t": 0.1, "F": 4.3}'.
_TOKEN = re.compile(
    rf"(?<![\w.])(?=\d)(?:{clock.OF_DAY})(?![\w:])|(?<![\w./+-])(?<!\d:)[-+]?(?:\d+(?:\.\d*|,\d+(?!,))?|\.\d+)(?:[eE][-+]?\d+)?"
    r"(?![\d:.]|[-/]\d)|(?<!\w)(?i:nan|null)(?!\w)"
)
_POINTED = re.compile(r"(?<![\d.])\d+\.\d+(?![\d.])")
# The name before a number, the unit behind one, and the object that is open before one: '"force": {"value": 4.3, "unit": "N"'.
_BEFORE = re.compile(r"([^\W\d][\w ./()²^-]*?)[\"'\s\]]*[:=][\"'\s\[(]*$")
_BEHIND = re.compile(
    r" ?([^\W\d_]+(?:/[^\W\d_]+[²2]?)?)(?=[\s,;|}]|$)(?![\"'\s]*[:=(])|\s*,\s*\"units?\"\s*:\s*\"([^\"]+)\""
)
_OPENED = re.compile(r".*\"([^\"]+)\"\s*:\s*\{(?=[^}]*$)")
_SENSOR = re.compile(
    r"(?<![\w.])(?<!\d,)\d+(?:\.\d+)? ?(?:[mµu]?V|[pn]C|mA|counts?|px)/(?:kN|N|g|lbf|[mu]?m|\(?m/s[\^]?[2²]\)?)(?!\w)"
)
_ALONE = re.compile(r"\s*[-+]?\d+,(\d+)\s*")
# Numbers of fixed width without a blank between, "1.0E-04-2.0E+01"; and cells that a spreadsheet marked as texts.
_JOINED = re.compile(r"(\d[eEdD][-+]\d\d\d?)(?=[-+][\d.])")
_MARKED = re.compile(r"(?:^|(?<=[;,\t]))'(?=[-+.\d])|(?<=\d)'(?=[;,\t]|$)")
# Lines on which a separator is tried, and lines over which a quoted cell may run.
_SAMPLE, _LONGEST_CELL = 1000, 8
# Lines of a text that is read at one go where it holds numbers alone, and those in which its names are looked for.
_LARGE, _HEAD = 50_000, 4000
# What weighing indicators write before a number: stable or not, gross or net.
_FLAGS = re.compile(r"(?<![^\s,;|])(?:(?:ST|US|UN|QT|GS|NT|TR|S [SDI])[\s,;|]+)+(?=[-+]?\s*\d)")
# Characters of a line that is a text about numbers, cells of a row that is a channel, and how many lines are alike.
_LONGEST_LINE, _LEAST_WIDE, _MOSTLY = 400, 80, 0.6


@dataclass(frozen=True)
class Stated:
    """What a problem file says of how a data file is written; None: to be found."""

    separator: str | None = None  # a key of ``SEPARATORS``, or the character
    decimal: str | None = None  # "." or ","
    encoding: str | None = None  # as Python names it, such as "utf-8" or "cp1252"
    header: int | list[int] | None = None  # line of the names, or lines of names in two lines; 0: the file has no names
    sensitivity: str | None = None  # of channels that are voltages or charges
    full_scale: str | None = None  # of channels that are shares of it
    rate: str | None = None  # of the samples of a file that states no clock

    def written(self) -> dict[str, Any]:
        """What is said of how a text is written."""
        return {k: v for k, v in vars(self).items() if k not in ("sensitivity", "full_scale", "rate")}

    def check(self, where: str) -> None:
        """Refuse values that are none, naming the key."""
        if self.separator is not None and self.separator not in (*SEPARATORS, *SEPARATORS.values()):
            raise InputError(f"{where} separator", f"'{clip(self.separator)}'", f"give one of {', '.join(SEPARATORS)}")
        if self.decimal not in (None, ".", ","):
            raise InputError(f"{where} decimal", f"'{clip(self.decimal)}'", 'give "." or ","')
        lines = self.header if isinstance(self.header, list) else [self.header or 0]
        if not 0 < len(lines) < 4 or any(n < 0 for n in lines) or lines != sorted(lines):
            raise InputError(
                f"{where} header", clip(self.header), "give the line of the names, or lines such as [3, 4]"
            )


def read(path: Path, where: str, stated: Stated) -> Record:
    """The table in a text file; rows that do not fit are in its ``faults``."""
    raw = content(path, LARGEST_TEXT, where, "give a path relative to the problem file", "write it as Parquet or HDF5")
    text, encoding = decoded(raw, path, where, stated.encoding)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines, labels = numbered(lines)
    match = re.fullmatch(r'\s*"?sep=(.)"?\s*', lines[0], re.IGNORECASE) if lines else None  # Excel's first line.
    first, separator = (1, {v: k for k, v in SEPARATORS.items()}.get(match[1])) if match else (0, None)
    if stated.separator is not None:
        separator = next(k for k, v in SEPARATORS.items() if stated.separator in (k, v))
    separator = separator or _separator(lines[first:])
    file = File(str(path), "line")

    def laid_out(some: list[str]) -> tuple[Layout, list[str], File]:
        rows, faults = _rows(some, first, separator, file)
        at = next((k for k, r in enumerate(rows) if labels and r.line >= labels[0].line), 0)
        rows, its_file = _upright([*rows[:at], *labels, *rows[at:]], file)
        layout = found(rows, its_file, stated.header)
        marks = decimal_marks(layout, stated, its_file, commas_part=separator == "comma")
        return replace(layout, faults=[*faults, *layout.faults]), marks, its_file

    large = None
    if len(lines) > _LARGE:
        with contextlib.suppress(InputError):
            large = _block(lines, separator, *laid_out(lines[:_HEAD]))
    layout, decimals, file = large or laid_out(lines)
    marks = " and ".join(word for mark, word in ((".", "points"), (",", "commas")) if mark in decimals)
    made = table(path, layout, decimals, file, f"{encoding} text, {_SAID[separator]}, decimal {marks}")
    sensors = set(_SENSOR.findall("\n".join(lines[: layout.rows[0].line])))
    return replace(made, sensor=sensors.pop()) if len(sensors) == 1 else made


def _block(
    lines: list[str], separator: str, layout: Layout, decimals: list[str], file: File
) -> tuple[Layout, list[str], File] | None:
    """The layout of many lines that are all numbers, read by NumPy; None where one is not: cells are then looked at."""
    marks, data = set(decimals), lines[layout.rows[0].line - 1 :]
    if layout.faults or layout.left or len(marks) != 1:
        return None
    while data and not data[-1].strip():
        data.pop()
    if marks == {","}:
        if separator == "comma" or any("." in line for line in data):
            return None
        data = [line.replace(",", ".") for line in data]
    try:
        values = np.loadtxt(
            data, delimiter=None if separator == "blank" else SEPARATORS[separator], comments=None, ndmin=2
        )
    except (ValueError, OverflowError):
        return None
    whole = len(values) == len(data) and layout.kept == tuple(range(values.shape[1]))
    return (replace(layout, block=values), decimals, file) if whole else None


def table(
    path: Path, layout: Layout, decimals: Sequence[str], file: File, how: str, inside: str = ""
) -> Record:  # fmt: skip
    """A layout as a table, with one sentence on what was found."""
    counted, names, columns = file.counted, list(layout.names), []
    if layout.block is not None:
        lines, columns, decimals = layout.rows[0].line + np.arange(len(layout.block)), [*layout.block.T], ()
    else:
        lines = np.array([r.line for r in layout.rows])
        for j in range(len(names)):
            columns.append(np.empty(lines.size, dtype=object))
            columns[j][:] = [r.cells[j] for r in layout.rows]
    # A clock of each channel's own, before it: their names must differ. Beside one clock names that stand again are numbered.
    said, several = [*names], False
    for j, name in enumerate(said):
        first = said.index(name)
        if first < j and clock.is_time(name) and not np.array_equal(columns[first], columns[j]):
            names[j], several = _with_number(name, j + 1), True
    for j, name in enumerate(said if not several else ()):
        if name and said.count(name) > 1 and not clock.is_time(name):
            names[j] = _with_number(name, said[: j + 1].count(name))
    parts = [how]
    for count, what in ((layout.above, f"{counted}@ above the names"), (layout.comments, f"comment {counted}@")):
        if count:
            parts.append(f"{count} {what.replace('@', 's' if count > 1 else '')} left out")
    parts.append(f"names in {_lines(layout.named, counted)}" if layout.named else "no names")
    if layout.united:
        parts.append(f"units in {_lines(layout.united, counted)}")
    parts.append(f"{lines.size} rows, {counted}s {lines[0]} to {lines[-1]}")
    if layout.left:
        parts.append(f"another table, {counted}s {layout.left[0]} to {layout.left[1]}, left out")
    named = ", ".join(name or "(no name)" for name in names[:12])
    parts.append(f"{len(names)} columns: {clip(named)}{', ...' if len(names) > 12 else ''}")
    made = Record(path, tuple(names), tuple(columns), lines, counted, inside, tuple(decimals), tuple(layout.faults))
    if not made.clock and (even := clock.stated(layout.facts, str(path))):
        start, step = even
        made = made.beside("time [s]", start + step * np.arange(lines.size))
        parts.append(f"a clock from {start:.6g} s every {step:.6g} s, as stated beside the table")
    return with_sweeps(replace(made, found="; ".join(parts), facts=tuple(layout.facts)))


def _with_number(name: str, number: int) -> str:
    text, unit = column(name)
    return f"{text} {number}{f' [{unit}]' * bool(unit)}"


def numbered(lines: list[str]) -> tuple[list[str], list[Row]]:
    """Lines that are one text about numbers, as logs and serial monitors write them, as the numbers; and rows of names and units.

    "12:30:01.123 -> 4.3,5.2", "t:50 us,F:4.3 N", "I (20) rig: F=4.3" and '{"t": 50, "F": 4.3}' as numbers, where no separator
    alone parts all of these from the text.
    """
    for pattern, right in ((_JOINED, r"\1 "), (_MARKED, ""), (_FLAGS, "")):
        if pattern is _FLAGS and not _FLAGS.search("".join(lines[:1])):
            continue  # A name may stand above a flag.
        if sum(pattern.search(line) is not None for line in lines[:_SAMPLE]) > 0.3 * len(lines[:_SAMPLE]):
            lines = [pattern.sub(right, line) for line in lines]
    some = [line for line in lines[:_SAMPLE] if line.strip() and len(line) <= _LONGEST_LINE]
    pointed = 2 * sum(_POINTED.search(line) is not None for line in some) > len(some)

    def parts(line: str) -> tuple[str, ...]:
        line = re.sub(r"(?<=\d),(?=[-+\d])", ", ", line) if pointed else line
        return tuple(re.sub(r" +", " ", text) for text in _TOKEN.split(line))

    kinds = Counter(map(parts, some))
    kind, count = kinds.most_common(1)[0] if kinds else (("",), 0)
    if count < _MOSTLY * len(some) or not _is_about(kind, parts("".join(some[:1])) == kind):
        return lines, []
    signs = ["".join(c for c in text if c in ("\t;,|" if pointed else "\t;|"))[:1] for text in kind[1:]]
    usual = next(filter(None, signs), "\t")
    signs = [*(sign or usual for sign in signs[:-1]), ""]
    # One sign between all numbers, as "&" or "->", parts names, too.
    parting = {text.strip() for text in kind[1:-1]}
    sign = parting.pop() if len(parting) == 1 and not re.search(r"[\w\t;,|]", "".join(parting)) else ""
    # What a monitor puts before each line stands before the names, too.
    behind = "".join(kind[1:2])
    before = re.compile(rf"\s*[\[(]?{clock.OF_DAY}{re.escape(behind)}") if behind.strip(" \t;,|.:") else None
    made, first = [], 0
    for k, line in enumerate(lines, 1):
        line = before.sub(signs[0], line, 1) if before and parts(line) != kind else line
        fits = len(line) <= _LONGEST_LINE and parts(line) == kind
        first = first or k * fits
        cells = _TOKEN.findall(re.sub(r"(?<=\d),(?=[-+\d])", ", ", line) if pointed else line) if fits else []
        own = [a + b for a, b in zip(cells, signs, strict=True)] if fits else []
        made.append(
            "".join(own) if fits else line.replace(sign, usual).replace(kind[-1].strip() or "\0", "") if sign else line
        )
    names = [(_BEFORE.search(re.split(r"[;,|{]", text)[-1]) or ["", ""])[1].strip() for text in kind[:-1]]
    named = any(names)
    if len(set(names)) < len(names) or "value" in names:
        opened = [(_OPENED.match(text) or ["", ""])[1] for text in kind]
        names = [f"{a} {b}".strip() for a, b in zip(opened, names, strict=False)]
    names = [name or f"column {k}" for k, name in enumerate(names, 1)]
    units = [m[1] or m[2] if (m := _BEHIND.match(text)) else "" for text in kind[1:]]
    units = units if all(map(known, filter(None, units))) else []
    titled = first > 1 and len(lines[first - 2].split(usual)) >= len(names)
    names = names if named or (any(units) and not titled) else []
    return made, [Row(first, [*row]) for row in (names, units) if any(row)]


def _is_about(kind: tuple[str, ...], unnamed: bool) -> bool:
    """Whether the texts about the numbers of a line are more than what separates cells; ``unnamed``: no line is above them."""
    line = "\0".join(kind)
    if not re.search(r"[^\s\0,;|'\"]", line):
        return False
    if any(re.search(r"\w.*[:=][\"'\s]*$", text) for text in kind[:-1]):
        return True
    # Without a label words are units, and what else stands in a cell is signs alone, such as "->".
    words = [word for text in kind for word in re.findall(r"[^\W\d]+[^\s,;|\"']*", text)]
    cells = max(sum(c.strip(" '\"") == "\0" for c in line.split(SEPARATORS[s])) for s in SEPARATORS)
    arrows = any(re.fullmatch(r"[^\w;,|'\"]*[^\w\s;,|'\"][^\w;,|'\"]*", text) for text in kind[1:-1])
    behind = unnamed and bool(words) and not re.search(r"\w", kind[0])
    behind = behind and all(re.fullmatch(r"(?: [^\W\d]+)?[\s,;|]*", text) for text in kind[1:])  # "4.3 kg"
    return (arrows or behind or cells < len(kind) - 1) and all(map(known, words))


def _upright(rows: list[Row], file: File) -> tuple[list[Row], File]:
    """Rows of a table whose channels stand in rows, each behind its name, as columns; others as they are."""
    wide = max((len(r.cells) for r in rows), default=0)
    long = [r.cells for r in rows if len(r.cells) == wide]
    few = len(long) > 1 and wide > 4 * max(len(rows), _LEAST_WIDE // 4)
    named = all(not numbers.is_number(cells[0]) and sum(map(numbers.is_number, cells)) > 0.9 * wide for cells in long)
    if not (few and named):
        return rows, file
    return [Row(k, [*cells]) for k, cells in enumerate(zip(*long, strict=True), 1)], file._replace(counted="column")


def _lines(lines: tuple[int, ...], counted: str) -> str:
    return f"{counted} {lines[0]}" if len(lines) == 1 else f"{counted}s {' and '.join(map(str, lines))}"


def _is_comment(line: str, separator: str) -> bool:
    start = line.lstrip()
    section = start[:1] == "*" and start[1:2].isalpha()  # "*CHANNEL" of MSR; "***" is a blank cell.
    return section or start.startswith(_COMMENTS) or (start.startswith(";") and separator != "semicolon")


def _cells(line: str, separator: str) -> list[str]:
    if separator == "blank":
        line = line.replace("\t", " ").strip()
        if '"' not in line:
            return line.split()
    sign = SEPARATORS[separator]
    if '"' not in line:
        return [cell.strip() for cell in line.split(sign)]
    blank = separator == "blank"
    return [
        cell.strip() for cell in next(csv.reader([line], delimiter=sign, skipinitialspace=True)) if cell or not blank
    ]


def _separator(lines: Sequence[str]) -> str:
    """The separator by which most lines become numbers; where none does, ``layout`` says so."""
    full = [line for line in lines if line.strip()]
    if len(full) > _SAMPLE:
        half = _SAMPLE // 2
        full = [*full[:half], *full[half :: max(1, (len(full) - half) // half)]]
    for least in (2, 1):
        scores = {separator: _score(full, separator, least) for separator in SEPARATORS}
        # Of one column of numbers, what stands above it says what parts cells.
        best = max(scores, key=lambda k: (scores[k], sum(line.count(SEPARATORS[k]) for line in full if k != "blank")))
        if scores[best] > 0.0:
            if best == "comma" and _one_column(full):
                return "semicolon" if ";" in "".join(full) and "\t" not in "".join(full) else "tab"
            return best
    return "comma"


def _one_column(lines: Sequence[str]) -> bool:
    """Whether numbers with decimal commas stand alone below one name: no whole number begins with 0, as decimals do."""
    alone = [_ALONE.fullmatch(line) for line in lines]
    first = next((k for k, found in enumerate(alone) if found), 0)
    named = first > 0 and "," not in lines[first - 1] and sum(found is None for found in alone[first:]) < 3
    return named and any(found is not None and found[1].startswith("0") and len(found[1]) > 1 for found in alone)


def _score(lines: Sequence[str], separator: str, least: int) -> float:
    """How much of the text is numbers, in lines of the most frequent number of cells with at least so many numbers."""
    shares: dict[int, float] = {}
    for line in lines:
        if _is_comment(line, separator) or len(line) > 1_000_000:
            continue
        cells = _cells(line, separator)
        given = [c for c in cells if not numbers.is_missing(c)]
        count = sum(numbers.is_number(c) or clock.is_of_day(c) for c in given)
        if count >= least:
            shares[len(cells)] = shares.get(len(cells), 0.0) + count / len(given)
    return max(shares.values(), default=0.0)


def _rows(lines: Sequence[str], first: int, separator: str, file: File) -> tuple[list[Row], list[InputError]]:
    """Rows that hold something, comments in the cells that they would have as a row."""
    rows, open_quotes = [], []
    for number, line in _logical(lines, first):
        comment = _is_comment(line, separator)
        if line.count('"') % 2 and not comment:
            open_quotes.append((number, line))
            line = line.replace('"', "")
        if len(line) > 1_000_000:
            raise InputError(file.at(number), f"{len(line)} characters in one line", "give a file of rows")
        cells = _cells(line.lstrip().lstrip("#%/!;") if comment else line, separator)
        if (
            " #" in line
            and not comment
            and numbers.is_number((short := _cells(line.partition(" #")[0], separator))[-1])
        ):
            cells = short
        if comment and cells[0] == "" and any(cells) and line.lstrip()[0] == "#":
            cells[0] = "#"  # The name of a column of numbers.
        if any(cells):
            rows.append(Row(number, cells, comment))
    rows = _glued(lines, rows, separator)
    faults = []
    if open_quotes:
        number, text = open_quotes[0]
        more = others([number for number, _ in open_quotes], "line")
        found = f"an opening quote without its end: '{clip(text, 80)}'{more}"
        faults.append(InputError(file.at(number), found, "close it, or take it out"))
    return rows, faults


def _logical(lines: Sequence[str], first: int) -> Iterable[tuple[int, str]]:
    """Lines with their numbers; a quoted cell that runs over some lines is put into one."""
    k = first
    while k < len(lines):
        line, number = lines[k], k + 1
        k += 1
        if '"' in line and line.count('"') % 2:
            end = next((e for e in range(k, min(k + _LONGEST_CELL, len(lines))) if lines[e].count('"') % 2), None)
            # A line between two open quotes that is a row of its own is no part of a cell.
            cells = [re.split(r"[,;\t| ]+", lines[e]) for e in range(k, (end or 0) + 1)]
            if end is not None and not any(sum(map(numbers.is_number, c)) >= 2 for c in cells):
                line = " ".join([line, *lines[k : end + 1]])
                k = end + 1
        if line.strip():
            yield number, line


def _glued(lines: Sequence[str], rows: list[Row], separator: str) -> list[Row]:
    """Names that are parted otherwise than the numbers: by another separator, at runs of blanks, a unit put to its name."""
    widths = [len(r.cells) for r in rows if sum(map(numbers.is_number, r.cells)) >= 2]
    wide = max(set(widths), key=widths.count) if widths else 0
    fitted = []
    for row in rows:
        other = len(row.cells) > wide if separator == "blank" else len(row.cells) == 1 < wide
        # "v0: 0,93 m/s" is no two names.
        if other and not any(numbers.is_number(c) or re.search(r"[:=] *[-+]?\d", str(c)) for c in row.cells):
            line = lines[row.line - 1].strip().lstrip("#%/!; ")
            tied = _BESIDE_A_UNIT.sub(lambda m: m[0].replace(" ", "\0") if m[0].strip() else "\0", line)
            runs = (re.split(r"\s{2,}|\t+", line), tied.split())
            for cells in (*runs, *(_cells(line, s) for s in ("comma", "semicolon", "tab"))):
                if len(cells) == wide:
                    row = row._replace(cells=[c.replace("\0", " ") for c in cells])
                    break
        fitted.append(row)
    return fitted


def decimal_marks(
    layout: Layout, stated: Stated, file: File, commas_part: bool = False
) -> list[str]:  # fmt: skip
    """The decimal mark of each column; refuses numbers that may all be read in two ways, but bare points where commas part."""
    if stated.decimal:
        return [stated.decimal] * len(layout.names)
    sample = layout.rows[:: max(1, len(layout.rows) // 5000)]
    columns = [[r.cells[j] for r in sample] for j in range(len(layout.names))]
    marks = numbers.decimal_marks(columns)
    if marks is not None:
        return marks
    marked = [(c, r.line) for r in sample for c in r.cells if isinstance(c, str) and ("." in c or "," in c)]
    cells = [(text, line) for text, line in marked if numbers.is_number(text)]
    if commas_part and not any("," in text for text, _ in cells):
        return ["."] * len(columns)
    text, line = cells[0]
    either = f"'{text}' is {text.replace(',', '.')} or {re.sub('[.,]', '', text)}, and no number of the file says which"
    raise InputError(file.at(line), either, DECIMAL)
