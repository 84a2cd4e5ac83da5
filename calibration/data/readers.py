"""Measured files of every kind become the same table: the extension says which library reads them.

    .csv .txt .tsv .tab .dat .asc .prn   text; how it is written is found (``textfile``)
    .xlsx .xlsm .xlsb .xls .ods          python-calamine; a sheet (``workbook``)
    .parquet .pq  pyarrow; field metadata ``unit``      .tdms         npTDMS; a group, ``unit_string``
    .h5 .hdf5     h5py; a group of 1-D datasets, or a compound dataset; attribute ``unit`` or ``units``
    .mat          SciPy up to version 7.2, h5py for 7.3; a struct of vectors, whose field ``units`` may be a struct
                  of texts; the vectors outside any struct are a table too

A file may hold several tables: groups and structs, named by their path, as in "run_3/sensors".
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.core.errors import clip
from bcfj_jax.io import opening
from bcfj_jax.io.units import column
from calibration.data import isolated, textfile, workbook
from calibration.data.child import Tables
from calibration.data.table import Table
from calibration.data.textfile import Stated


def read(path: Path, where: str, inside: str | None = None, stated: Stated | None = None) -> Table:
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
    if kind not in _KINDS:
        raise InputError(where, f"{clip(str(path))} is of no kind known here", f"known are {', '.join(sorted(_KINDS))}")
    missing = "give the path of a measured file" if where == "record" else "give a path relative to the problem file"
    opening.check(path, opening.LARGEST_BINARY, where, missing, "give a smaller file")
    if kind in _TEXTS:
        if inside is not None:
            raise InputError(f"{where} table", f"{path} holds no tables inside", "take the key out")
        return textfile.read(path, where, stated)
    if kind not in workbook.KINDS and (keys := [k for k, v in vars(stated).items() if v is not None]):
        raise InputError(f"{where} {keys[0]}", f"{path} is no text", "take the key out")
    if kind in workbook.KINDS:
        opening.check(path, opening.LARGEST_TEXT, where, missing, "write it as Parquet or HDF5")
        return workbook.read(path, where, inside, stated)
    read = isolated.read(path, where, inside)
    try:
        return replace(_chosen(read.tables, path, where, inside), found=read.note)
    except InputError as error:
        if read.note:
            raise InputError(where, f"{path}: {read.note}; {error.found}", "record or export the file again") from None
        raise


def _chosen(tables: Tables, path: Path, where: str, inside: str | None) -> Table:
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
    # A single number beside vectors describes them; it is no column.
    found = {name: c for name, c in found.items() if c.size > 1 or longest == 1}
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
    return Table(path, tuple(header), arrays, lines, "row", wanted if len(tables) > 1 or inside else "")


_TEXTS = (".csv", ".txt", ".tsv", ".tab", ".dat", ".asc", ".prn")
_BINARY = (".parquet", ".pq", ".h5", ".hdf5", ".mat", ".tdms")
_KINDS = (*_TEXTS, *workbook.KINDS, *_BINARY)
