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

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.core.errors import clip
from bcfj_jax.core.extras import library
from bcfj_jax.io import opening
from bcfj_jax.io.units import column
from calibration.data import textfile, workbook
from calibration.data.table import Table
from calibration.data.textfile import Stated

UNIT_NAMES = ("unit", "units")


class _Column(NamedTuple):
    """A column that is there: its unit, its number of values, and how to read them."""

    unit: str | None
    size: int
    values: Callable[[], Any]


# The columns of a table by name, and the tables of a file by path; "" is what stands outside any group.
_Columns = dict[str, _Column]
_Tables = dict[str, _Columns]


def read(path: Path, where: str, inside: str | None = None, stated: Stated | None = None) -> Table:
    """The table in a file.

    Args:
        path: of a kind that the extension names.
        where: place in the problem file, for messages.
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
    try:
        if kind in workbook.KINDS:
            opening.check(path, opening.LARGEST_TEXT, where, missing, "write it as Parquet or HDF5")
            return workbook.read(path, where, inside, stated, library("python_calamine", where, "io"))
        return _READERS[kind](path, where, inside)
    except InputError:
        raise
    # Libraries raise what they please on a broken file; to the user all of it is one thing.
    except Exception as error:
        reason = clip(f"{type(error).__name__}: {error}".splitlines()[0])
        remedy = "write the file again, or give it the extension of its kind"
        raise InputError(where, f"{path} cannot be read as {kind} ({reason})", remedy) from error


def _chosen(tables: _Tables, path: Path, where: str, inside: str | None) -> Table:
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


def _vector(values: np.ndarray, unit: object = None) -> _Column | None:
    """An array as a column, or None for what is none: a matrix, a reference, a complex number."""
    if values.dtype.kind not in "iufbOSUMm" or (values.ndim and max(values.shape) != values.size):
        return None
    if values.dtype.kind == "O" and not all(isinstance(v, str) for v in values.flat):
        return None
    return _Column(_text(unit), values.size, lambda: values)


def _text(value: object) -> str | None:
    """A text in any of the forms in which files hold one."""
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value).strip() or None if isinstance(value, str) else None


def _parquet(path: Path, where: str, inside: str | None) -> Table:
    parquet = library("pyarrow.parquet", where, "io")
    content = parquet.read_table(path)
    columns: _Columns = {}
    for field, chunks in zip(content.schema, content.columns, strict=True):
        metadata = {k.decode().lower(): v for k, v in (field.metadata or {}).items()}
        values = np.asarray(chunks.to_numpy())
        if values.dtype.kind == "O":
            values = np.array(["" if v is None else v for v in values], dtype=object)
        found = _vector(values, next((metadata[k] for k in UNIT_NAMES if k in metadata), None))
        if found:
            columns[field.name] = found
    return _chosen({"": columns}, path, where, inside)


def _tdms(path: Path, where: str, inside: str | None) -> Table:
    nptdms = library("nptdms", where, "io")
    tables: _Tables = {}
    with nptdms.TdmsFile.read(path) as content:
        for group in content.groups():
            columns: _Columns = {}
            for channel in group.channels():
                found = _vector(np.asarray(channel[:]), channel.properties.get("unit_string"))
                if found:
                    columns[channel.name] = found
            # A waveform has its clock in its properties instead of in a channel.
            waves = [c for c in group.channels() if "wf_increment" in c.properties and len(c)]
            clocks = {(c.properties["wf_increment"], c.properties.get("wf_start_offset", 0.0)) for c in waves}
            if "time" not in {column(name)[0].lower() for name in columns} and len(clocks) == 1:
                columns["time"] = _Column("s", len(waves[0]), waves[0].time_track)
            tables[group.name] = columns
    return _chosen(tables, path, where, inside)


def _hdf5(path: Path, where: str, inside: str | None) -> Table:
    h5py = library("h5py", where, "io")
    tables: _Tables = {}

    def visit(name: str, item: Any) -> None:
        # MATLAB keeps the content of cells and objects in groups of these names.
        if name.startswith("#") or not isinstance(item, h5py.Dataset):
            return
        unit = next((item.attrs[k] for k in UNIT_NAMES if k in item.attrs), None)
        if item.dtype.names:
            tables[name] = {field: _Column(None, item.size, _part(item, field)) for field in item.dtype.names}
            return
        parent, _, own = name.rpartition("/")
        found = _matlab_text(item) if item.attrs.get("MATLAB_class") == b"char" else _dataset(item, unit)
        if found:
            tables.setdefault(parent, {})[own] = found

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        return _chosen(_with_units(tables), path, where, inside)


def _part(item: Any, field: str) -> Callable[[], Any]:
    return lambda: item[field]


def _dataset(item: Any, unit: object) -> _Column | None:
    if item.shape is None or (item.ndim and max(item.shape) != item.size):
        return None
    if item.dtype.kind == "O":
        return _Column(_text(unit), item.size, lambda: item.asstr()[()]) if item.dtype.metadata else None
    return _Column(_text(unit), item.size, lambda: item[()]) if item.dtype.kind in "iufbS" else None


def _matlab_text(item: Any) -> _Column:
    letters = "".join(chr(code) for code in np.ravel(item[()]))
    return _Column(None, 1, lambda: np.array([letters]))


def _mat(path: Path, where: str, inside: str | None) -> Table:
    h5py = library("h5py", where, "io")
    if h5py.is_hdf5(path):
        return _hdf5(path, where, inside)
    from scipy.io import loadmat

    tables: _Tables = {}

    def visit(name: str, content: Mapping[str, Any]) -> None:
        columns = tables.setdefault(name, {})
        for key, value in content.items():
            if key.startswith("__"):
                continue
            if isinstance(value, Mapping):
                visit(f"{name}/{key}".strip("/"), value)
                continue
            found = _vector(np.asarray(value))
            if found:
                columns[key] = found

    visit("", loadmat(path, simplify_cells=True))
    return _chosen(_with_units(tables), path, where, inside)


def _with_units(tables: _Tables) -> _Tables:
    """Units from a struct of texts named ``units`` inside a struct, which is then no table of its own."""
    united: _Tables = {}
    for name, columns in tables.items():
        parent, _, own = name.rpartition("/")
        if own in UNIT_NAMES and parent in tables:
            continue
        beside: Iterable[_Columns] = (tables.get(f"{name}/{key}".strip("/"), {}) for key in UNIT_NAMES)
        units = {k: _text(np.asarray(c.values())) for texts in beside for k, c in texts.items() if c.size == 1}
        united[name] = {k: c._replace(unit=c.unit or units.get(k)) for k, c in columns.items()}
    return united


_TEXTS = (".csv", ".txt", ".tsv", ".tab", ".dat", ".asc", ".prn")
_READERS: dict[str, Callable[[Path, str, str | None], Table]] = {
    ".parquet": _parquet,
    ".pq": _parquet,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".mat": _mat,
    ".tdms": _tdms,
}
_KINDS = (*_TEXTS, *workbook.KINDS, *_READERS)
