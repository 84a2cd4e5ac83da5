"""Measured files of every kind become the same record: the extension, or else the first bytes, say which reader reads them.

    .csv .txt .tsv .tab .dat .asc .prn   text; how it is written is found (``textfile``)
    .xlsx .xlsm .xlsb .xls .ods          a sheet (``workbook``)
    all others                           ``readers``, a module a kind; a user's own come first (``--code``)

A file may hold several tables: groups, structs and clocks, named by their path, as in "run_3/sensors".
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bcfj_jax.core.errors import InputError, clip, nearest
from bcfj_jax.data import clock, isolated, textfile, workbook
from bcfj_jax.data.columns import Column, Columns, Tables, vector
from bcfj_jax.data.readers import READERS, reader_of, sheets
from bcfj_jax.data.record import Record
from bcfj_jax.data.sensitivity import Sensitivities
from bcfj_jax.data.textfile import Stated
from bcfj_jax.io import opening
from bcfj_jax.io.units import column


def read(path: Path, where: str, inside: str | None = None, stated: Stated | None = None) -> Record:
    """The table in a file.

    Args:
        inside: which table, in a file that can hold several; None: the only one, or what stands outside any group.
        stated: how a text or a spreadsheet is written, where it is not to be found.

    Raises:
        InputError: when the file is missing, of an unknown or another kind, without such a table or without rows,
            when columns differ in length, or when its library is not installed.
    """
    kind, stated = path.suffix.lower(), stated or Stated()
    stated.check(where)
    missing = "give the path of a measured file" if where == "record" else "give a path relative to the problem file"
    known = kind in _TEXTS or any(kind in r.KINDS for r in READERS)
    if not (known or opening.READERS or path.exists()):
        _unknown(path, where)
    head = opening.head(path, where, missing)
    sensors = Sensitivities(stated.sensitivity or "", stated.full_scale or "", where)
    return replace(_read(path, kind, head, where, inside, stated), sensitivities=sensors)


def tables(path: Path, where: str, stated: Stated) -> list[str]:
    """Names of the tables with columns in a file that holds several; none of a text."""
    reader = reader_of(path.suffix.lower(), opening.head(path, where, "give the path of a measured file"))
    if reader is None or path.suffix.lower() in _TEXTS:
        return []
    found = isolated.read(path, where, None, reader)
    return [name for name, held in {**found.tables, **found.sheets}.items() if held]


def _unknown(path: Path, where: str) -> None:
    kinds = sorted({*_TEXTS, *(k for r in READERS for k in r.KINDS)})
    found = f"{clip(str(path))} is of no kind known here"
    raise InputError(where, found, f"known are {', '.join(kinds)}; a reader of your own needs --code FILE")


def _read(path: Path, kind: str, head: bytes, where: str, inside: str | None, stated: Stated) -> Record:
    for name, own in opening.READERS.items():
        if own.sniff(path, head):
            found = {str(k): np.asarray(v) for k, v in own.read(path).items()}
            table = {k: c for k, v in found.items() if (c := vector(v))}
            return replace(_chosen({"": table}, path, where, inside), reader=name)
    reader = reader_of(kind, head)
    if reader is None and kind not in _TEXTS and (b"\0" in head or not head.strip()):
        _unknown(path, where)
    missing = "give the path of a measured file" if where == "record" else "give a path relative to the problem file"
    if reader is None:
        if inside is not None:
            raise InputError(f"{where} table", f"{path} holds no tables inside", "take the key out")
        return textfile.read(path, where, stated)
    opening.check(path, opening.LARGEST_BINARY, where, missing, "give a smaller file")
    told = {k: v for k, v in stated.written().items() if v is not None}
    if reader is sheets:
        opening.check(path, opening.LARGEST_TEXT, where, missing, "write it as Parquet or HDF5")
        return replace(workbook.read(path, where, inside, stated), reader="sheets")
    if told:
        raise InputError(f"{where} {next(iter(told))}", f"{path} is no text", "take the key out")
    read = isolated.read(path, where, inside, reader)
    try:
        found = _chosen(read.tables, path, where, inside)
    except InputError as error:
        if read.note:
            raise InputError(where, f"{path}: {read.note}; {error.found}", "record or export the file again") from None
        raise
    said = "; ".join(filter(None, (read.note, found.found)))
    return replace(found, found=said, reader=reader.__name__.rpartition(".")[2])


def _chosen(tables: Tables, path: Path, where: str, inside: str | None) -> Record:
    """The table that is meant, its columns read and checked for one length."""
    tables = {name: columns for name, columns in tables.items() if columns}
    if not tables:
        remedy = 'store columns as vectors of numbers; of a MATLAB table: s = table2struct(t, "ToScalar", true)'
        raise InputError(where, f"{path} holds no columns", remedy)
    wanted = next(iter(tables)) if len(tables) == 1 and inside is None else (inside or "").strip("/")
    if wanted not in tables:
        if inside is None:
            names = ", ".join(f"'{name}'" for name in list(tables)[:8])
            raise InputError(where, f"{path} holds {len(tables)} tables", f'choose with table = "...": {names}')
        raise InputError(f"{where} table", f"no table '{inside}' in {path}", nearest(wanted, tables))
    found = tables[wanted]
    longest = max(c.size for c in found.values())
    # A single number beside vectors describes them, as its step of time does; it is no column.
    alone = [(name, c) for name, c in found.items() if c.size == 1 < longest]
    found = {name: c for name, c in found.items() if c.size > 1 or longest == 1}
    found, said = _with_clock(found, alone, str(path))
    if len({c.size for c in found.values()}) > 1:
        sizes = ", ".join(f"'{name}' {c.size}" for name, c in list(found.items())[:8])
        raise InputError(
            f"{path}: {wanted}" if wanted else str(path),
            f"its columns have different lengths: {sizes}",
            "put columns sampled together into a group of their own",
        )
    if longest == 0:
        raise InputError(str(path), "has no rows", "give a file with data")
    header = [f"{n} [{c.unit}]" if c.unit and column(n)[1] is None else n for n, c in found.items()]
    arrays = tuple(np.ravel(c.values()) for c in found.values())
    arrays = tuple(np.char.decode(a, "utf-8", "replace") if a.dtype.kind == "S" else a for a in arrays)
    lines = np.arange(1, longest + 1)
    named = wanted if len(tables) > 1 or inside else ""
    return Record(path, tuple(header), arrays, lines, "row", named, found=said)


def _with_clock(found: Columns, alone: list[tuple[str, Column]], where: str) -> tuple[Columns, str]:
    """Columns with a clock of the step or rate that stands beside them, where none is a column of times."""
    if any(clock.is_time(name if c.unit is None else f"{name} [{c.unit}]") for name, c in found.items()):
        return found, ""
    facts = [
        (name if c.unit is None else f"{name} [{c.unit}]", str(np.ravel(c.values())[0]))
        for name, c in alone
        if c.values().size
    ]
    even = clock.stated(facts, where)
    if even is None:
        return found, ""
    size = next(iter(found.values())).size
    column_ = Column("s", size, lambda: even[0] + even[1] * np.arange(size))
    return {"time": column_, **found}, f"its clock is every {even[1]:.6g} s, as it states"


_TEXTS = (".csv", ".txt", ".tsv", ".tab", ".dat", ".asc", ".prn")
