"""A measured table: named columns in one length, each row with its place in the file, numbers given out in SI.

Only what a file holds is here; what the columns mean is the problem file's business.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.io.units import column, scale_of

# An unfiltered column of one of these names numbers runs: each of its values is an experiment.
RUN_COLUMNS = ("run", "experiment", "trial")
DELIMITERS = {"comma": ",", "tab": "\t", "semicolon": ";"}


@dataclass(frozen=True)
class Table:
    """The rows of a file.

    Attributes:
        path: the file.
        header: names of the columns, each with its unit in brackets where it has one.
        columns: (N,) arrays, of numbers or of text.
        lines: (N,) where each row is in the file, for messages.
        counted: what ``lines`` counts: "line" of a text, "row" of a binary file (the first is 1).
        inside: which table of a file that holds several.
    """

    path: Path
    header: tuple[str, ...]
    columns: tuple[np.ndarray, ...]
    lines: np.ndarray
    counted: str = "line"
    inside: str = ""

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
        """Position of a column, by its full header or by its name without the unit.

        A unit may be given for a column whose header has none.
        """
        bare = tuple(column(h) for h in self.header)
        unitless = tuple(n if unit is None else None for n, unit in bare)
        for wanted, candidates in ((name, self.header), (name, [n for n, _ in bare]), (column(name)[0], unitless)):
            found = [i for i, candidate in enumerate(candidates) if candidate == wanted]
            if len(found) > 1:
                raise InputError(where, f"{len(found)} columns of {self.name} are headed '{name}'", "rename one")
            if found:
                return found[0]
        raise InputError(where, f"no column '{name}' in {self.name}", nearest(name, [h for h in self.header if h]))

    def texts(self, name: str, where: str) -> list[str]:
        """A column as it stands; numbers in their shortest form."""
        values = self.columns[self.index(name, where)]
        return [f"{v:.15g}" for v in values] if values.dtype.kind in "iufb" else [str(v) for v in values]

    def numbers(self, name: str, si_unit: str, where: str, blank: bool) -> np.ndarray:
        """A column in SI. The unit is the header's, or else that of ``name``; without one it is SI.

        Raises:
            InputError: for a cell that is no finite number (a blank or NaN one is NaN where ``blank`` allows it).
        """
        position = self.index(name, where)
        header, cells = self.header[position], self.columns[position]
        unit = column(header)[1] or column(name)[1]
        scale = 1.0 if unit is None else scale_of(unit, si_unit, f"{self.name}: column '{header}'")
        if cells.dtype.kind in "iufb":
            values, bad = cells.astype(float), np.zeros(cells.size, dtype=bool)
        elif cells.dtype.kind in "OUS":
            values, bad = _parsed(cells)
        else:
            found = f"column '{header}' holds {cells.dtype}, no numbers"
            raise InputError(self.name, found, "store it as numbers, a time as the time since the start")
        wrong = np.flatnonzero(bad | np.isinf(values) | (np.isnan(values) if not blank else False))
        if wrong.size:
            self._refuse(header, cells, wrong, blank)
        return values * scale

    def _refuse(self, header: str, cells: np.ndarray, wrong: np.ndarray, blank: bool) -> None:
        place, text = self.place(int(wrong[0]), header), str(cells[wrong[0]])
        if 2 * wrong.size > cells.size and text:
            found = f"'{text}' is not a finite number, nor are {wrong.size} of the column's {cells.size} cells"
            comma = text.replace(",", ".", 1)
            remedy = "write decimals with a point" if comma != text and _is_number(comma) else "name another column"
            raise InputError(place, found, remedy)
        remedy = "correct the cell" + (", or leave it blank if it was not measured" if blank else "")
        raise InputError(place, f"'{text}' is not a finite number", remedy)

    def where(self, keep: np.ndarray) -> Table:
        """The rows to keep, (N,) of truth values."""
        return replace(self, columns=tuple(c[keep] for c in self.columns), lines=self.lines[keep])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _parsed(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (NaN where blank), and which cells are none."""
    texts = [str(cell).strip() or "nan" for cell in cells]
    try:
        return np.array(texts, dtype=float), np.zeros(len(texts), dtype=bool)
    except ValueError:
        good = [_is_number(text) for text in texts]
        values = [float(text) if g else np.nan for text, g in zip(texts, good, strict=True)]
        return np.array(values), ~np.array(good)


def text(path: Path, where: str, separator: str) -> Table:
    """A text file with a header; ``separator`` is a key of ``DELIMITERS``.

    Raises:
        InputError: when it is missing, empty, not UTF-8, separated otherwise, or a row has another number of cells
            than the header.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream, delimiter=DELIMITERS[separator])
            numbered = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except UnicodeDecodeError as error:
        raise _encoding(path, error) from None
    except (OSError, csv.Error) as error:
        raise InputError(where, f"{path} cannot be read as text ({error})", "give a text file with a header") from None
    if len(numbered) < 2:
        raise InputError(str(path), "has no rows below a header", "give a file with a header and data")
    header = numbered[0][1]
    if len(header) == 1:
        other = [word for word, sign in DELIMITERS.items() if sign in header[0]]
        if other:
            found = f"the header has no {separator} but a {other[0]}: '{header[0]}'"
            remedy = {"tab": "name the file .tsv", "comma": "name the file .csv"}.get(other[0], "separate by commas")
            raise InputError(f"{path}: line {numbered[0][0]}", found, f"{remedy}; columns part at the {separator} here")
    for line, row in numbered[1:]:
        if len(row) != len(header):
            raise InputError(f"{path}: line {line}", f"{len(row)} cells under {len(header)} headers", "correct the row")
    cells = np.array([row for _, row in numbered[1:]], dtype=object)
    return Table(path, tuple(header), tuple(cells.T), np.array([line for line, _ in numbered[1:]]))


def _encoding(path: Path, error: UnicodeDecodeError) -> InputError:
    """What a file that is no UTF-8 probably is, and where that shows."""
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return InputError(str(path), "is UTF-16, not UTF-8", "save it as CSV in UTF-8")
    if b"\0" in raw[:1000]:
        return InputError(str(path), "is no text file", "give its kind by the extension, such as .mat or .tdms")
    # The reader decodes in blocks, so the error's own position is not that in the file.
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as whole:
        error = whole
    at = error.start
    found = f"byte 0x{raw[at]:02x} is not UTF-8; in Latin-1 it is '{raw[at : at + 1].decode('latin-1')}'"
    return InputError(f"{path}: line {raw[:at].count(10) + 1}", found, "save the file as UTF-8")


def split(table: Table, rows: Mapping[str, object], where: str) -> list[tuple[str, Table]]:
    """The experiments in a table, each with its name.

    ``rows`` keeps the rows whose column equals a value; a list of values makes one experiment of each, and so
    does, unasked, a column named as in ``RUN_COLUMNS``.

    Raises:
        InputError: when a filter leaves no row, with the values that are there.
    """
    parts = [("", table)]
    unasked = {column(h)[0]: None for h in table.header if column(h)[0].lower() in RUN_COLUMNS}
    wanted = {**unasked, **rows}
    for name, choice in wanted.items():
        found = table.texts(name, f"{where}: rows")
        values = list(choice) if isinstance(choice, list) else [choice]
        values = list(dict.fromkeys(found)) if choice is None else values
        parts = [
            (f"{label} {name} {value}".strip() if len(values) > 1 or choice is None or name in unasked else label, part)
            for label, whole in parts
            for value in values
            for part in [whole.where(np.array([_same(t, value) for t in whole.texts(name, where)], dtype=bool))]
        ]
        for value in values:
            if not any(_same(t, value) for t in found):
                there = ", ".join(list(dict.fromkeys(found))[:8])
                raise InputError(f"{where}: rows", f"no row has {name} = {value}", f"values there: {there}")
    return [(label or table.path.stem, part) for label, part in parts if part.lines.size]


def _same(text: str, value: object) -> bool:
    if isinstance(value, (int, float)):
        return _is_number(text) and float(text) == float(value)
    return text == str(value)
