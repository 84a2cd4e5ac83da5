"""Spreadsheets by calamine: .xlsx, .xlsm, .xlsb, .xls and .ods, as they were last calculated; formulas and macros are not run."""

from __future__ import annotations

import datetime
import zipfile
from typing import Any

from bcfj_jax.data.columns import Content, Refused

KINDS, LIBRARY = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"), "python_calamine"
SIGNATURE = b""
# Of a spreadsheet, whose cells are texts in an archive [bytes].
_UNPACKED = 1 << 28


def read(file: str, wanted: str) -> Content:
    """Rows that hold something, by the name of their sheet: [number, cells]. Of other sheets than ``wanted`` none.

    The library keeps every cell between the first and the last that holds something, however few do.
    """
    import python_calamine

    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _UNPACKED:
            large = f"it unpacks to {size / 2**20:.3g} MB, more than the {_UNPACKED / 2**20:.3g} MB read here"
            raise Refused(large, "write it as Parquet or HDF5")
    with python_calamine.CalamineWorkbook.from_path(file) as book:
        names = book.sheet_names
        found: dict[str, list] = {name: [] for name in names}
        for name in [wanted] if wanted in names else [] if wanted != "*" else names:
            rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            numbered = ([k, list(map(_cell, row))] for k, row in enumerate(rows, 1))
            found[name] = [row for row in numbered if any(cell not in ("", None) for cell in row[1])]
    return Content({}, "", found)


def _cell(cell: Any) -> Any:
    """A cell as a text or a number: dates and times of day as texts, durations as seconds."""
    if isinstance(cell, str):
        return cell.strip()
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    if isinstance(cell, datetime.date) and not isinstance(cell, datetime.datetime):
        return f"{cell.isoformat()}T00:00:00"  # Midnight is a date alone.
    return cell.isoformat() if isinstance(cell, (datetime.datetime, datetime.time)) else cell
