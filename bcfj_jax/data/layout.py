"""Where the table stands in a file: lines above it, its names, its units, its rows, its empty columns.

Input is a list of rows of cells, texts from a text file or texts and numbers from a spreadsheet. The data are found
first, as the rows with numbers. What stands above them is then names, units or a preamble.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.errors import InputError, clip, counted
from bcfj_jax.data import preamble
from bcfj_jax.data.clock import TIMES, is_of_day, is_time
from bcfj_jax.data.numbers import is_missing, is_number
from bcfj_jax.io.units import column, known

# Rows that are looked at to find the columns of numbers.
_SAMPLE = 600
# Units of one letter that are more often a name: t, F, x, v, a, f.
_AGAIN = {*TIMES, "no.", "no", "nr.", "nr", "#", "index", "date", "ts", "rn"}
_UNITS_OF_ONE_LETTER = frozenset("smNgVJWKh%°-秒")
_QUOTED_ROWS = 5
# A column that holds something in fewer of the rows does not tell which are data: settings may stand above it.
_SPARSE = 0.02
# Rows of a table, at least; rows of sums below one, at most; and how these are named.
_FEWEST, _LAST_ROWS, _WORD = 8, 12, re.compile(r"\W*[^\W\d_]{3}[^\d]*")
# A number with its unit.
_AMOUNT = re.compile(r"([-+]?(?:\d[\d.,]*|[.,]\d+)(?:[eE][-+]?\d+)?) ?([^\W\d][^\s\d]*)")
# A line drawn below names.
_RULE = re.compile(r":?[-=_+]{3,}:?|")
NO_ROWS = ("has no rows below a header", "give a file with a header and data")
NO_NUMBERS = "a record has a column of times and one of readings; if it holds both, give separator, decimal or header"


class Row(NamedTuple):
    """A row: where it stands in the file, counted from 1, its cells, and whether it is a comment."""

    line: int
    cells: list[Any]
    comment: bool = False


class File(NamedTuple):
    """A file's name in messages, and what its rows are called: "line" or "row"."""

    name: str
    counted: str

    def at(self, row: int) -> str:
        """One row, as a user would look it up."""
        return f"{self.name}: {self.counted} {row}"


@dataclass(frozen=True)
class Layout:
    """What was found."""

    names: tuple[str, ...]  # of the columns, with the unit in brackets where a row of units gives it
    rows: list[Row]  # of data, each as long as ``names``
    kept: tuple[int, ...]  # positions in the file of the columns that are kept, from 0
    named: tuple[int, ...] = ()  # lines of the names; empty where the file has none
    united: tuple[int, ...] = ()  # lines of the units
    above: int = 0  # how many rows stand above the names
    comments: int = 0  # how many rows are comments
    faults: list[InputError] = field(default_factory=list)
    facts: preamble.Facts = field(default_factory=list)  # names and values beside the table
    left: tuple[int, int] | None = None  # first and last line of what follows the table, another one, which is left out
    # (N, m) numbers of all rows, where they were read at one go; ``rows`` are then the first ones
    block: np.ndarray | None = None


def found(rows: Sequence[Row], file: File, header: Any = None) -> Layout:
    """The table in rows, comments included. ``header``: lines of the names as stated; 0: there are none; None: to be found."""
    rows = [r for r in rows if not all(_RULE.fullmatch(str(c)) for c in r.cells)]
    plain, facts, titled = preamble.beside([r for r in rows if not r.comment])
    wide, numeric = _shape(plain)
    stated = _stated(rows, header, file)
    begin = next((k for k, r in enumerate(plain) if wide and k >= titled and _is_data(r.cells, numeric)), None)
    if begin is None:
        raise _nothing(plain, file)
    begin, end = _largest(plain, begin, numeric) if stated is None else (begin, len(plain))
    left = (plain[end].line, plain[-1].line) if end < len(plain) else None
    plain = plain[:end]
    if stated is not None:
        names, units = stated
        last = max((r.line for r in (*names, *units)), default=0)
        begin = next((k for k, r in enumerate(plain) if r.line > last), len(plain)) if last else begin
        above = sum(r.line < min(x.line for x in names) for r in rows) if names else begin
    else:
        given = len(preamble.sources([*preamble.above(plain[:begin]), *facts]))
        first, (names, units, begin, above) = begin, _above(plain, begin, numeric, wide)
        if len(numeric) - 2 < given > 1 and not any(is_time(str(c)) for r in names for c in r.cells):
            names, units, begin, above = [], [], first, first  # The settings name the channels.
        begin = max(begin, titled)
        if not names:
            names, units = _commented(rows, plain[begin].line, wide)
    data = plain[begin:]
    if not data:
        found = f"has no rows below {file.counted} {plain[-1].line}"
        raise InputError(file.name, found, "give a file with names and data")
    top = {r.line for r in (*names, *units)}
    facts += preamble.above(r for r in rows if (r.line < data[0].line or r.comment) and r.line not in top)
    data, tail = _table_alone(data, [*names, *units], numeric)
    left = left or tail
    names, units, data, more = _incremented(names, units, data, numeric, wide)
    facts += more
    about = [r for r in rows if r.line < data[0].line and r.line not in top]
    told = preamble.described(about, wide) if header is None else []
    titles = told if told and not any(column(t)[1] for t in _titles(names, wide)) else _titles(names, wide)
    kept = _kept(titles, data, wide)
    faults = _ragged(titles, data, kept, wide, file, len(names[-1].cells) if names else 0)
    marks = [
        _bare(next(filter(None, texts), "")) for texts in zip(*(_texts(r.cells, wide) for r in units), strict=True)
    ]
    marks = ["" if m.lower() in _AGAIN and not known(m) else m for m in marks]
    if names and not units and _is_units(names[-1].cells):
        marks = list(titles)  # "s;N": the units are the names.
    marks += [""] * (len(titles) - len(marks))
    titles = [f"{t} [{m}]" if m and column(t)[1] is None else t for t, m in zip(titles, marks, strict=False)]
    # Rows that do not fit are faults already; their cells would be named a second time.
    last = kept[-1] + 1 if kept else 0
    whole = [r for r in data if len(r.cells) >= last and all(map(is_missing, r.cells[wide:]))] or data
    if len(kept) < wide or any(len(r.cells) != wide for r in whole):
        whole = [r._replace(cells=[r.cells[j] if j < len(r.cells) else "" for j in kept]) for r in whole]
    titles = _weighed(whole, titles, kept)
    columns = [[r.cells[j] for r in whole] for j in range(min(2, len(kept)))]
    named = preamble.in_words([titles[j] for j in kept], about)
    named = preamble.titled(named, facts, columns, bool(names))
    if not any(map(is_time, named)):
        named = [t or f"column {j + 1}" for j, t in zip(kept, named, strict=True)]
    lines_named, lines_united = (tuple(r.line for r in some) for some in (names, units))
    comments = sum(r.comment and r not in names for r in rows)
    return Layout(
        tuple(named), whole, tuple(kept), lines_named, lines_united, above, comments, faults, facts, left
    )  # fmt: skip


def _weighed(rows: list[Row], titles: list[str], kept: list[int]) -> list[str]:
    """Titles with the unit that stands behind each number of a column, "-0.04 kg", which is taken off its cells."""
    titles = [*titles]
    for j, k in enumerate(kept):
        if _AMOUNT.fullmatch(str(rows[0].cells[j])):
            found = [_AMOUNT.fullmatch(str(r.cells[j])) for r in rows]
            units = {m[2] if m else "" for m in found}
            if len(units) == 1 and known(unit := units.pop()):
                titles[k] = titles[k] if column(titles[k])[1] else f"{titles[k]} [{unit}]"
                for row, m in zip(rows, found, strict=True):
                    row.cells[j] = m[1] if m else ""
    return titles


def _table_alone(data: list[Row], top: list[Row], numeric: list[int]) -> tuple[list[Row], tuple[int, int] | None]:
    """Rows without what is no sample: names that stand again above each run, sums below, counts above; lines of the sums."""
    again = [r.cells for r in top]
    if any(r.cells in again for r in data):
        # What stands above names that stand again is a block's own heading.
        heads = [k for k, r in enumerate(data) if r.cells in again]
        titled = {
            j
            for k in heads
            for j in range(k - 1, max(k - _LAST_ROWS, -1), -1)
            if not any(_is_data(data[i].cells, numeric) for i in range(j, k))
        }
        data = [r for k, r in enumerate(data) if k not in titled]
        data = [r for r in data if r.cells not in again and (any(map(_holds, r.cells)) or len(_given(r.cells)) > 1)]
    if not numeric or len(data) < _FEWEST:
        return data, None
    first, end = numeric[0], len(data)

    def cell(row: Row) -> str:
        return str(row.cells[first]) if first < len(row.cells) else ""

    while end > len(data) - _LAST_ROWS and _WORD.fullmatch(cell(data[end - 1])) and not is_missing(cell(data[end - 1])):
        end -= 1
    tail = (data[end].line, data[-1].line) if end < len(data) else None
    counts = is_missing(cell(data[0])) and not any(is_missing(cell(r)) for r in data[1:_FEWEST])
    return data[int(counts) : end], tail


def _given(cells: Sequence[Any]) -> list[Any]:
    return [c for c in cells if not is_missing(c)]


def _incremented(
    names: list[Row], units: list[Row], data: list[Row], numeric: list[int], wide: int
) -> tuple[list[Row], list[Row], list[Row], preamble.Facts]:
    """Names, units and data where the row below the names holds a start and a step (Rigol), and these; else as they are."""
    if names:
        cells, inline = preamble.inline(names[-1].cells)
        if len(cells) == wide - 1 and all(cells) and _numbers_rows(data):
            cells = ["", *cells]  # R gives the numbers of rows no name.
        elif len(cells) - 1 in (wide, wide / 3) and preamble.before_names(cells[0]):
            axes = ("",) if len(cells) > wide else (" X", " Y", " Z")  # A marker has three places (Qualisys).
            cells = [f"{c}{axis}" for c in cells[1:] for axis in axes]
        names = [*names[:-1], names[-1]._replace(cells=cells)]
    below = data[0] if names and not _is_data(data[0].cells, numeric) else None
    more = preamble.increments(names[-1].cells, below.cells) if below and len(data) > 1 else []
    if below is None or not more:
        return names, units, data, inline if names else []
    said = {name for name, _ in more}
    cells = ["" if c in said else c for c in names[-1].cells[:wide]]
    texts = [c if isinstance(c, str) and not is_number(c) else "" for c in below.cells[:wide]]
    return [names[-1]._replace(cells=cells)], [below._replace(cells=texts)], data[1:], more


def _numbers_rows(data: Sequence[Row]) -> bool:
    """Whether the first cells of rows count them."""
    first = [str(r.cells[0]) for r in data]
    return first[0] in ("0", "1") and first == [str(k + int(first[0])) for k in range(len(first))]


def _largest(rows: Sequence[Row], begin: int, numeric: list[int]) -> tuple[int, int]:
    """First row of data of the table with most rows, and the row that ends it (texts alone); all where none has most."""
    # A row within data begins another table: two texts or more and nothing else, or one as "data:".
    given = ((k, _given(rows[k].cells)) for k in range(begin + 1, len(rows)))
    texts = ((k, g) for k, g in given if len(g) > 1 or str(next(iter(g), "")).endswith(":"))
    heads = [k for k, g in texts if not any(map(_holds, g))]
    if not heads:
        return begin, len(rows)
    ends = [begin, *heads, len(rows)]
    parts = [(sum(_is_data(r.cells, numeric) for r in rows[a:b]), a, b) for a, b in pairwise(ends)]
    count, first, last = max(parts)
    # Between two tables may stand lines of the second's: its name, its rate.
    while last < len(rows) and last > first and not _is_data(rows[last - 1].cells, numeric):
        last -= 1
    if count < 0.8 * sum(n for n, *_ in parts) or count < 3:
        return begin, len(rows)
    first = next(k for k in range(first, last) if _is_data(rows[k].cells, numeric))
    return first, last


def _holds(cell: Any) -> bool:
    return is_number(cell) or is_of_day(cell)


def _shape(rows: Sequence[Row]) -> tuple[int, list[int]]:
    """How many cells a row of data has, and which columns hold numbers."""
    some = rows if len(rows) <= _SAMPLE else [*rows[: _SAMPLE // 2], *rows[:: len(rows) // (_SAMPLE // 2)]]
    numbered = [(r.cells, [_holds(c) for c in r.cells]) for r in some]
    least = 2 if any(sum(flags) >= 2 for _, flags in numbered) else 1
    counts = Counter(len(cells) for cells, flags in numbered if sum(flags) >= least)
    if not counts:
        return 0, []
    wide = counts.most_common(1)[0][0]
    chosen = [(cells, flags) for cells, flags in numbered if len(cells) == wide and any(flags)]
    numeric = []
    for j in range(wide):
        given = sum(not is_missing(cells[j]) for cells, _ in chosen)
        if given > _SPARSE * len(chosen) and sum(flags[j] for _, flags in chosen) >= 0.5 * given:
            numeric.append(j)
    return wide, numeric


def _is_data(cells: Sequence[Any], numeric: list[int]) -> bool:
    inside = [cells[j] for j in numeric if j < len(cells)]
    numbers = sum(_holds(c) for c in inside)
    return numbers >= min(2, len(numeric)) and all(_holds(c) or is_missing(c) for c in inside)


def _is_text(cells: Sequence[Any], columns: int = 2) -> bool:
    """Whether a row can hold names or units: two texts at least, of one column one, and no number."""
    given = [c for c in cells if not (isinstance(c, str) and not c.strip()) and c is not None]
    beside = len(cells) == columns == 2 and cells[0] == ""  # The numbers of rows and clocks need no name.
    if all(map(preamble.valued, given)):  # A name may be a size, "50 mm", but not all are.
        return False
    return len(given) >= min(1 if beside else 2, columns) and not any(map(_holds, given))


def _above(rows: Sequence[Row], begin: int, numeric: list[int], wide: int) -> tuple[list[Row], list[Row], int, int]:
    """Rows of names, rows of units, where the data begin, and how many rows stand above the names."""
    k = begin - 1

    def text(j: int) -> bool:
        return j >= 0 and _is_text(rows[j].cells, len(numeric))

    def summed(j: int) -> bool:
        return len(rows[j].cells) == wide and _WORD.fullmatch(str(rows[j].cells[0])) is not None and not text(j)

    over = next((j for j in range(k, -1, -1) if not summed(j)), -1)
    sums = over < k and text(over) and any(is_time(str(c)) for c in rows[over].cells)
    k = over if sums else k
    # A first row of data with a fault looks like no data; names stand above it all the same.
    while k >= 0 and not (text(k) or preamble.states(rows[k].cells)):
        k -= 1
    alone = (j for j in range(k, 0, -1) if len(_given(rows[j - 1].cells)) == 1)
    listed = next((j for j in alone if text(j) and preamble.before_names(_given(rows[j - 1].cells)[0])), -1)
    if k >= 0 and preamble.states(rows[k].cells) and len(rows[listed].cells) >= len(numeric) and listed > 0:
        return [rows[listed]], [], begin, listed
    if k < 0 or preamble.states(rows[k].cells):
        return [], [], begin, begin
    first, united = begin if sums else k + 1, []
    over = rows[k - 1] if text(k - 1) and not preamble.states(rows[k - 1].cells) else None
    if over is None and k and _is_units(rows[k].cells, most=True) and _names_numbers(rows[k - 1].cells, rows[k].cells):
        over = rows[k - 1]
    if over and len(over.cells) >= len(numeric):
        if _is_units(rows[k].cells, most=not _is_units(over.cells)):
            united, k = [rows[k]], k - 1
        elif _is_units(over.cells) and not _is_units(rows[k].cells):
            top = rows[k - 2] if text(k - 2) and len(rows[k - 2].cells) >= len(numeric) else rows[k]
            return [top], [over], first, k - 1
    # A unit alone below the names is no row of two texts.
    lone = next((j for j in range(first, begin) if len(rows[j].cells) == wide and _is_units(rows[j].cells)), None)
    if not united and lone is not None:
        united, first = [rows[lone]], lone + 1
    named = [rows[k]]
    above = rows[k - 1] if text(k - 1) and len(rows[k - 1].cells) >= len(numeric) else None
    texts = _texts(rows[k].cells, wide)
    lacking = [texts[j] for j in numeric if j < wide]
    if above and (not all(lacking) or len(set(lacking)) < len(lacking)):
        named = [above, rows[k]]
        k -= 1
    return named, united, first, k


def _commented(rows: Sequence[Row], first: int, wide: int) -> tuple[list[Row], list[Row]]:
    """Names, and units below them, in the last comments above the data, as numpy.savetxt writes them."""
    rows = [
        r._replace(cells=r.cells[1:])
        if r.comment and len(r.cells) == wide + 1 and preamble.before_names(r.cells[0])
        else r
        for r in rows
    ]
    fitting = [r for r in rows if r.comment and r.line < first and len(r.cells) == wide and _is_text(r.cells)]
    fitting = [r for r in fitting if not preamble.states(r.cells)]
    if len(fitting) > 1 and _is_units(fitting[-1].cells):
        return [fitting[-2]], [fitting[-1]]
    return fitting[-1:], []


def _names_numbers(cells: Sequence[Any], units: Sequence[Any]) -> bool:
    """Whether a row above one of units names columns, some of them by a number, as oscilloscopes name channels."""
    given = [c for c in cells if not is_missing(c)]
    numbered = all(str(c).strip().isdigit() for c in given if is_number(c))
    return len(given) == sum(not is_missing(c) for c in units) and not is_number(given[0]) and numbered


def _is_units(cells: Sequence[Any], most: bool = False) -> bool:
    """Whether all texts of a row are units, or ``most`` of them."""
    texts = [_bare(c) for c in cells if isinstance(c, str) and c.strip()]
    # What counts rows or tells the time is named again where it has no unit.
    texts = [t for t in texts if t.lower() not in _AGAIN or known(t)] if most else texts
    if not texts:
        return False
    letters = [t for t in texts if len(t) == 1 and t not in _UNITS_OF_ONE_LETTER]
    bracketed = all(c.strip()[0] in "[(" for c in cells if isinstance(c, str) and c.strip())
    # "t (ms)", "t / ms" and "t in ms" are names with their units.
    count = sum(known(t) and not re.search(r"\w\s*[(\[]|\w\s+(?:/|in)\s+\w", t) for t in texts)
    return (bracketed or not letters) and (count == len(texts) or (most and count >= max(2, 0.6 * len(texts))))


def _bare(cell: str) -> str:
    text = cell.strip()
    text = text[3:].strip() if text[:3].lower() == "in " else text
    return text[1:-1].strip() if text[:1] + text[-1:] in ("[]", "()") else text


def _texts(cells: Sequence[Any], wide: int) -> list[str]:
    texts = [" ".join(str("" if c is None else c).split()) for c in cells[:wide]]
    texts = [t[1:-1] if len(t) > 2 and t[0] == t[-1] == "'" else t.rstrip(" ;:,") for t in texts]
    return texts + [""] * (wide - len(texts))


def _titles(names: list[Row], wide: int) -> list[str]:
    """One name a column: of one row, or of two where the second alone does not part the columns."""
    if not names:
        return [f"column {j + 1}" for j in range(wide)]
    wide = max(wide, *(len(r.cells) for r in names))
    last = _texts(names[-1].cells, wide)
    if len(names) == 1:
        return last
    first = _texts(names[0].cells, wide)
    for j in range(1, wide):
        first[j] = first[j] or (first[j - 1] if last[j] else "")
    return [" ".join(x for x in pair if x) for pair in zip(first, last, strict=True)]


def _kept(titles: list[str], data: Sequence[Row], wide: int) -> list[int]:
    """Columns but those without a name and without a cell, which separators at the ends of lines make."""
    made = titles == [f"column {j + 1}" for j in range(wide)]
    nameless = [j for j in range(max(wide, len(titles))) if made or j >= len(titles) or not titles[j]]
    filled = {j for j in nameless if any(j < len(r.cells) and not is_missing(r.cells[j]) for r in data)}
    return [j for j in range(wide) if j not in nameless or j in filled]


def _ragged(
    titles: list[str], data: Sequence[Row], kept: list[int], wide: int, file: File, named: int
) -> list[InputError]:
    """Rows with too many or too few cells, and names that do not fit the rows; ``named`` cells hold the names."""
    columns = max((j + 1 for j, t in enumerate(titles) if t), default=0) if named else wide
    filled = max((j for j in kept if j >= named), default=-1) + 1 if named else wide
    if columns > wide or filled > max(columns, named):
        halves = columns * 2 == wide and all(str(c).strip("+- ").isdigit() for r in data[:50] for c in r.cells)
        shown = clip(" | ".join(t for t in titles if t))
        found = f"the rows hold {counted(wide, 'cell')} under {columns} headers: '{shown}'"
        remedy = f"give each column one name; {file.counted} {data[0].line} is the first of the rows"
        if halves:
            found += "; commas part both columns and decimals"
            remedy = "export it with semicolons between columns, or with decimal points"
        return [InputError(file.name, found, remedy)]
    last = kept[-1] + 1 if kept else 0
    short = [r for r in data if len(r.cells) < last]
    long = [r for r in data if any(not is_missing(c) for c in r.cells[wide:])]
    faults = []
    for rows, remedy in ((short, "complete the row, or take it out"), (long, "take out what is too much")):
        if rows:
            shown = clip(" | ".join(map(str, rows[0].cells)), 80)
            lines = [row.line for row in rows]
            cells, more = counted(len(rows[0].cells), "cell"), others(lines, file.counted)
            found = f"{cells} under {len(kept)} headers: '{shown}'{more}"
            faults.append(InputError(file.at(rows[0].line), found, remedy))
    return faults


def others(lines: Sequence[int], called: str) -> str:
    """How many rows have the same fault as the first, and where the next few stand."""
    if len(lines) < 2:
        return ""
    more = f" and {len(lines) - _QUOTED_ROWS} more" if len(lines) > _QUOTED_ROWS else ""
    return f" ({len(lines)} such {called}s: also {', '.join(map(str, lines[1:_QUOTED_ROWS]))}{more})"


def _stated(rows: Sequence[Row], header: Any, file: File) -> tuple[list[Row], list[Row]] | None:
    """Rows of names and units that are stated by their lines."""
    if header is None:
        return None
    lines = header if isinstance(header, list) else [header]
    if lines == [0]:
        return [], []
    by_line = {r.line: r for r in rows}
    named = [by_line[n] for n in lines if n in by_line]
    if len(named) < len(lines):
        missing = f"header = {header}, and {file.counted} {lines[len(named)]} is blank or not there"
        raise InputError(file.name, missing, f"count {file.counted}s from 1, or take header out")
    below = next((r for r in rows if r.line > lines[-1]), None)
    if len(named) > 1 and _is_units(named[-1].cells):
        return named[:-1], named[-1:]
    return named, [below] if below and _is_units(below.cells) else []


def _nothing(rows: Sequence[Row], file: File) -> InputError:
    if len(rows) < 2 or (len(rows) == 2 and all(_is_text(r.cells) for r in rows)):
        return InputError(file.name, *NO_ROWS)
    middle = rows[len(rows) // 2]
    shown = clip(" | ".join(map(str, middle.cells)), 80)
    found = f"no {file.counted} holds a number; {file.counted} {middle.line} reads '{shown}'"
    return InputError(file.name, found, NO_NUMBERS)
