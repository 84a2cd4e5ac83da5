"""Spreadsheets: .xlsx, .xlsm, .xlsb, .xls and .ods; a sheet is a table inside a file."""

from __future__ import annotations

from pathlib import Path

from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.data import isolated, numbers, textfile
from bcfj_jax.data.layout import File, Row, found
from bcfj_jax.data.readers import sheets as reader
from bcfj_jax.data.record import Record


def read(path: Path, where: str, inside: str | None, stated: textfile.Stated) -> Record:
    """The table on a sheet: the only one that holds numbers, or the one named ``inside``.

    Raises:
        InputError: where no sheet holds rows of numbers, several do, or the one that is named is not there.
    """
    read = isolated.read(path, where, inside, reader).sheets
    if inside is not None and inside not in read:
        raise InputError(f"{where} table", f"no sheet '{inside}' in {path}", nearest(inside, read))
    sheets = {name: _rows(read[name]) for name in ([inside] if inside else read)}
    if inside is None and len(sheets) > 1:
        filled = {n: rows for n, rows in sheets.items() if sum(_holds_numbers(r.cells) for r in rows) > 1}
        if len(filled) > 1:
            names = ", ".join(f"'{n}'" for n in list(filled)[:8])
            raise InputError(
                where, f"{path} holds {len(filled)} sheets with numbers", f'choose with table = "...": {names}'
            )
        sheets = filled or dict(list(sheets.items())[:1])
    name, rows = next(iter(sheets.items()))
    file = File(f"{path}: {name}", "row")
    layout = found(rows, file, stated.header)
    return textfile.table(path, layout, textfile.decimal_marks(layout, stated, file), file, f"sheet '{name}'", name)


def _rows(numbered: list[tuple[int, list]]) -> list[Row]:
    return [Row(k, cells) for k, cells in numbered if any(not numbers.is_missing(c) for c in cells)]


def _holds_numbers(cells: list) -> bool:
    return sum(map(numbers.is_number, cells)) >= 2
