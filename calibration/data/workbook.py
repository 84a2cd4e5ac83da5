"""Spreadsheets: .xlsx, .xlsm, .xlsb, .xls and .ods by python-calamine; a sheet is a table inside a file.

Values are read as they were last calculated; formulas and macros are not run.
"""

from __future__ import annotations

import datetime
import zipfile
from pathlib import Path
from typing import Any

from bcfj_jax import InputError, nearest
from bcfj_jax.io.opening import MEGABYTE
from calibration.data import numbers, textfile
from calibration.data.layout import Row, found
from calibration.data.table import Table

_LARGEST = 256 * MEGABYTE
KINDS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")


def read(path: Path, where: str, inside: str | None, stated: textfile.Stated, calamine: Any) -> Table:
    """The table on a sheet: the only one that holds numbers, or the one named ``inside``.

    Raises:
        InputError: where no sheet holds rows of numbers, several do, or the one that is named is not there.
    """
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _LARGEST:
            large = f"{path} unpacks to {size / MEGABYTE:.3g} MB, more than the {_LARGEST / MEGABYTE:.3g} MB read here"
            raise InputError(where, large, "write it as Parquet or HDF5")
    with calamine.CalamineWorkbook.from_path(str(path)) as book:
        if inside is not None and inside not in book.sheet_names:
            raise InputError(f"{where} table", f"no sheet '{inside}' in {path}", nearest(inside, book.sheet_names))
        sheets = {name: _rows(book.get_sheet_by_name(name)) for name in ([inside] if inside else book.sheet_names)}
    if inside is None and len(sheets) > 1:
        filled = {n: rows for n, rows in sheets.items() if sum(_holds_numbers(r.cells) for r in rows) > 1}
        if len(filled) > 1:
            names = ", ".join(f"'{n}'" for n in list(filled)[:8])
            raise InputError(
                where, f"{path} holds {len(filled)} sheets with numbers", f'choose with table = "...": {names}'
            )
        sheets = filled or dict(list(sheets.items())[:1])
    name, rows = next(iter(sheets.items()))
    layout = found(rows, f"{path}: {name}", "row", stated.header)
    marks = textfile.decimal_marks(layout, stated, f"{path}: {name}", "row")
    return textfile.table(path, layout, marks, "row", layout.faults, f"sheet '{name}'", inside=name)


def _rows(sheet: Any) -> list[Row]:
    cells = sheet.to_python(skip_empty_area=False)
    numbered = (Row(k, list(map(_plain, row))) for k, row in enumerate(cells, 1))
    return [r for r in numbered if any(not numbers.is_missing(c) for c in r.cells)]


def _holds_numbers(cells: list[Any]) -> bool:
    return sum(map(numbers.is_number, cells)) >= 2


def _plain(cell: Any) -> Any:
    """A cell as a text or a number: dates and times of day as texts, durations as seconds."""
    if isinstance(cell, str):
        return cell.strip()
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    return cell.isoformat() if isinstance(cell, (datetime.date, datetime.time)) else cell
