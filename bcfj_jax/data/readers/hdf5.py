"""HDF5 by h5py, also MATLAB 7.3: a group of 1-D datasets, or a compound dataset; attribute ``unit`` or ``units``."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from bcfj_jax.data.columns import UNIT_NAMES, Column, Columns, Content, Tables, matrix, text, with_units

KINDS, LIBRARY = (".h5", ".hdf5", ".hdf", ".nxs"), "h5py"
SIGNATURE = b""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Attributes that make a clock, without blanks and signs, in lower case.
_RATES = ("dt", "fs", "xinc", "sampleinterval", "samplerate", "samplingrate", "samplingfrequency", "samplefrequency")


def read(file: str, wanted: str) -> Content:
    """The vectors of a file by the path of their group, and matrices where a group holds no vectors."""
    import h5py

    content = h5py.File(file, "r")  # Closed with the process: values are read when they are written out.
    tables, matrices, rates = Tables(), Tables(), {"": _rates(content)}

    def visit(name: str, thing: object) -> None:
        # MATLAB keeps the content of cells and objects in groups of these names.
        if name.startswith("#"):
            return
        if not isinstance(thing, h5py.Dataset):
            rates[name] = _rates(thing)
            return
        item: Any = thing
        unit = next((item.attrs[k] for k in item.attrs if k.lower() in (*UNIT_NAMES, "yunit", "yunits")), None)
        if item.dtype.names:
            tables[name] = {field: Column(None, item.size, _part(item, field)) for field in item.dtype.names}
            return
        parent, _, own = name.rpartition("/")
        found = _matlab_text(item) if item.attrs.get("MATLAB_class") == b"char" else _dataset(item, unit)
        if found:
            columns = tables.setdefault(parent, {})
            columns[own] = found
            columns.update({key: c for key, c in _rates(item).items() if key not in columns})
        elif item.ndim == 2 and item.dtype.kind in "iuf" and 1 < min(item.shape) <= 64 and item.size < 1 << 24:
            matrices.setdefault(parent, {}).update(matrix(own, item[()]))

    content.visititems(visit)
    for name, columns in matrices.items():
        if not any(c.size > 1 for c in tables.get(name, {}).values()):
            tables.setdefault(name, {}).update(columns)
    for name, columns in tables.items():
        above = [name.rsplit("/", k)[0] for k in range(name.count("/") + 1)]
        for group in (*above, "") if any(c.size > 1 for c in columns.values()) else ():
            columns.update({key: c for key, c in rates.get(group, {}).items() if key not in columns})
    return Content(with_units(tables))


def _rates(thing: Any) -> Columns:
    """The rate or step that attributes of a group or dataset state."""
    stated = [key for key in thing.attrs if re.sub(r"[\W_]+", "", key.lower()) in _RATES]
    return {key: Column(None, 1, lambda key=key: np.ravel(thing.attrs[key])[:1]) for key in stated}


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


def is_hdf5(file: str) -> bool:
    """Whether the signature of HDF5 stands where a file may have it: at 0, 512, 1024, 2048, ... bytes."""
    with open(file, "rb") as content:
        at, end = 0, os.fstat(content.fileno()).st_size
        while at < end:
            content.seek(at)
            if content.read(8) == _SIGNATURE:
                return True
            at = 2 * at or 512
    return False
