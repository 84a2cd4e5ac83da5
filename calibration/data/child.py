"""Reads a MATLAB or HDF5 file in a process of its own, which a damaged file may end: see ``isolated``.

    python -P child.py FILE TABLE BYTES SECONDS

Two things go to the standard output: a line of JSON, [[path of the table, name, unit, size, whether values follow], ...], and
then, in this order, the values of the table TABLE ("*" for every table, "" for the only one), each as an .npy. A column is a
vector of numbers or texts, or one of either; no object leaves. This file imports nothing of ours, for its start is most of what
reading a file costs.

Exit codes: 0 done, 3 the library refuses the file; its reason is the last line on the standard error.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

REFUSED = 3
UNIT_NAMES = ("unit", "units")


class Column(NamedTuple):
    """A column that is there: its unit, its number of values, and how to read them."""

    unit: str | None
    size: int
    values: Callable[[], Any]


# The columns of a table by name, and the tables of a file by path; "" is what stands outside any group.
Columns = dict[str, Column]
Tables = dict[str, Columns]


def vector(values: np.ndarray, unit: object = None) -> Column | None:
    """An array as a column, or None for what is none: a matrix, a reference, a complex number."""
    if values.dtype.kind not in "iufbOSUMm" or (values.ndim and max(values.shape) != values.size):
        return None
    if values.dtype.kind == "O" and not all(isinstance(v, str) for v in values.flat):
        return None
    return Column(text(unit), values.size, lambda: values)


def text(value: object) -> str | None:
    """A text in any of the forms in which files hold one."""
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value).strip() or None if isinstance(value, str) else None


def mat(file: str) -> Tables:
    """The vectors of a MATLAB file up to version 7.2, by the path of the struct that holds them."""
    from scipy.io import loadmat

    tables: Tables = {}

    def visit(table: str, content: Mapping[str, Any]) -> None:
        columns = tables.setdefault(table, {})
        for name, value in content.items():
            if isinstance(value, Mapping):
                visit(f"{table}/{name}".strip("/"), value)
            elif not name.startswith("__"):
                with contextlib.suppress(ValueError):  # A cell of vectors that differ in length.
                    if found := vector(np.asarray(value)):
                        columns[name] = found

    visit("", loadmat(file, simplify_cells=True))
    return _with_units(tables)


def hdf5(content: Any, h5py: Any) -> Tables:
    """The vectors of an open HDF5 file, also of a MATLAB file of version 7.3, by the path of their group."""
    tables: Tables = {}

    def visit(name: str, item: Any) -> None:
        # MATLAB keeps the content of cells and objects in groups of these names.
        if name.startswith("#") or not isinstance(item, h5py.Dataset):
            return
        unit = next((item.attrs[k] for k in UNIT_NAMES if k in item.attrs), None)
        if item.dtype.names:
            tables[name] = {field: Column(None, item.size, _part(item, field)) for field in item.dtype.names}
            return
        parent, _, own = name.rpartition("/")
        found = _matlab_text(item) if item.attrs.get("MATLAB_class") == b"char" else _dataset(item, unit)
        if found:
            tables.setdefault(parent, {})[own] = found

    content.visititems(visit)
    return _with_units(tables)


def _part(item: Any, field: str) -> Callable[[], Any]:
    return lambda: item[field]


def _dataset(item: Any, unit: object) -> Column | None:
    if item.shape is None or (item.ndim and max(item.shape) != item.size):
        return None
    if item.dtype.kind == "O":
        return Column(text(unit), item.size, lambda: item.asstr()[()]) if item.dtype.metadata else None
    return Column(text(unit), item.size, lambda: item[()]) if item.dtype.kind in "iufbS" else None


def _matlab_text(item: Any) -> Column:
    letters = "".join(chr(code) for code in np.ravel(item[()]))
    return Column(None, 1, lambda: np.array([letters]))


def _with_units(tables: Tables) -> Tables:
    """Units from a struct of texts named ``units`` inside a struct, which is then no table of its own."""
    united: Tables = {}
    for name, columns in tables.items():
        parent, _, own = name.rpartition("/")
        if own in UNIT_NAMES and parent in tables:
            continue
        beside: Iterable[Columns] = (tables.get(f"{name}/{key}".strip("/"), {}) for key in UNIT_NAMES)
        units = {k: text(np.asarray(c.values())) for texts in beside for k, c in texts.items() if c.size == 1}
        united[name] = {k: c._replace(unit=c.unit or units.get(k)) for k, c in columns.items()}
    return united


def limit(size: int, seconds: int) -> None:
    """Let this process have at most so many bytes and so many seconds of a core, where the system can hold it to that."""
    with contextlib.suppress(ImportError):
        import resource

        for what, most in (
            (resource.RLIMIT_AS, (size, size)),
            (resource.RLIMIT_CPU, (seconds, seconds + 1)),
            (resource.RLIMIT_CORE, (0, 0)),
        ):
            # A lower limit of the surroundings stays.
            with contextlib.suppress(OSError, ValueError):
                resource.setrlimit(what, most)


def write(tables: Tables, wanted: str) -> None:
    """Write the columns to the standard output."""
    filled = [name for name, columns in tables.items() if columns]
    wanted = filled[0] if wanted == "" and len(filled) == 1 else wanted
    index, arrays = [], []
    for table, columns in tables.items():
        for name, column in columns.items():
            values = _plain(column.values()) if wanted in ("*", table) else None
            index.append((table, name, column.unit, column.size, values is not None))
            arrays += [] if values is None else [values]
    with os.fdopen(os.dup(1), "wb") as out:
        out.write(json.dumps(index).encode() + b"\n")
        for values in arrays:
            # To NumPy a file is one that has positions, which a pipe has not.
            np.lib.format.write_array(cast(Any, SimpleNamespace(write=out.write)), values, allow_pickle=False)


def _plain(values: Any) -> np.ndarray:
    """An array without objects; a field of a compound dataset that is no vector becomes as many blank texts."""
    values = np.asarray(values)
    found = vector(values)
    if found is None:
        return np.full(values.shape[:1], "")
    return np.array(values.tolist(), dtype=str).reshape(values.shape) if values.dtype.kind == "O" else values


def main() -> int:
    """Limit this process, then read the file that it was given."""
    file, wanted, size, seconds = sys.argv[1:]
    limit(int(size), int(seconds))
    try:
        if file.lower().endswith(".mat") and not _is_hdf5(file):
            write(mat(file), wanted)
        else:
            import h5py

            with h5py.File(file, "r") as content:
                write(hdf5(content, h5py), wanted)
    # Libraries raise what they please on a broken file.
    except Exception as error:
        print(f"{type(error).__name__}: {str(error)[:400]}".split("\n")[0], file=sys.stderr)
        return REFUSED
    return 0


def _is_hdf5(file: str) -> bool:
    """Whether the signature of HDF5 stands where a file may have it: at 0, 512, 1024, 2048, ... bytes."""
    with open(file, "rb") as content:
        at, end = 0, os.fstat(content.fileno()).st_size
        while at < end:
            content.seek(at)
            if content.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
            at = 2 * at or 512
    return False


if __name__ == "__main__":
    sys.exit(main())
