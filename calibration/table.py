"""Measured tables: a CSV with a header becomes columns in SI, every doubt named by its row.

Only reading happens here; what the columns mean is the problem file's business.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.units import column, scale_of

# An unfiltered column of one of these names numbers runs: each of its values is an experiment.
RUN_COLUMNS = ("run", "experiment", "trial")


@dataclass(frozen=True)
class Table:
    """The rows of a file: ``lines`` are their line numbers, for messages."""

    path: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]

    def index(self, name: str, where: str) -> int:
        """Position of a column, by its full header or by its name without the unit."""
        for candidates in (self.header, tuple(column(h)[0] for h in self.header)):
            if name in candidates:
                return candidates.index(name)
        raise InputError(where, f"no column '{name}' in {self.path}", nearest(name, self.header))

    def texts(self, name: str, where: str) -> list[str]:
        """A column as it stands."""
        position = self.index(name, where)
        return [row[position] for row in self.rows]

    def numbers(self, name: str, si_unit: str, where: str, blank: bool) -> np.ndarray:
        """A column in SI. The unit is the header's; without one it is SI.

        Raises:
            InputError: for a cell that is no finite number (a blank one is NaN where ``blank`` allows it).
        """
        position = self.index(name, where)
        unit = column(self.header[position])[1]
        scale = 1.0 if unit is None else scale_of(unit, si_unit, f"{self.path}: column '{self.header[position]}'")
        values = np.full(len(self.rows), np.nan)
        for i, row in enumerate(self.rows):
            text = row[position].strip()
            if not text and blank:
                continue
            try:
                values[i] = float(text)
            except ValueError:
                values[i] = np.nan
            if not np.isfinite(values[i]):
                place = f"{self.path}: line {self.lines[i]}, column '{self.header[position]}'"
                remedy = "correct the cell" + (", or leave it blank if it was not measured" if blank else "")
                raise InputError(place, f"'{text}' is not a finite number", remedy)
        return values * scale

    def where(self, keep: list[bool]) -> Table:
        """The rows to keep."""
        rows = tuple(r for r, k in zip(self.rows, keep, strict=True) if k)
        return Table(self.path, self.header, rows, tuple(n for n, k in zip(self.lines, keep, strict=True) if k))


def read(path: Path, where: str) -> Table:
    """A CSV file with a header.

    Raises:
        InputError: when it is missing, empty, not text, or a row has another number of cells than the header.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            numbered = [(reader.line_num, tuple(cell.strip() for cell in row)) for row in reader if any(row)]
    except FileNotFoundError:
        raise InputError(where, f"no file {path}", "give a path relative to the problem file") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            where, f"{path} cannot be read as CSV ({error})", "give a CSV file in UTF-8 with a header"
        ) from None
    if len(numbered) < 2:
        raise InputError(str(path), "has no rows below a header", "give a CSV file with a header and data")
    header = numbered[0][1]
    for line, row in numbered[1:]:
        if len(row) != len(header):
            raise InputError(f"{path}: line {line}", f"{len(row)} cells under {len(header)} headers", "correct the row")
    return Table(path, header, tuple(r for _, r in numbered[1:]), tuple(n for n, _ in numbered[1:]))


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
        values = [str(v) for v in choice] if isinstance(choice, list) else [choice]
        values = list(dict.fromkeys(found)) if choice is None else values
        parts = [
            (f"{label} {name} {value}".strip() if len(values) > 1 or choice is None or name in unasked else label, part)
            for label, whole in parts
            for value in values
            for part in [whole.where([_same(t, value) for t in whole.texts(name, where)])]
        ]
        for value in values:
            if not any(_same(t, value) for t in found):
                there = ", ".join(list(dict.fromkeys(found))[:8])
                raise InputError(f"{where}: rows", f"no row has {name} = {value}", f"values there: {there}")
    return [(label or table.path.stem, part) for label, part in parts if part.rows]


def _same(text: str, value: object) -> bool:
    if isinstance(value, (int, float)):
        try:
            return float(text) == float(value)
        except ValueError:
            return False
    return text == str(value)
