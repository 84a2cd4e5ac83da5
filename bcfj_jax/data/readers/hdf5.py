"""HDF5 by h5py, also MATLAB 7.3: a group of 1-D datasets, or a compound dataset; attribute ``unit`` or ``units``."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from bcfj_jax.data.columns import UNIT_NAMES, Column, Columns, Content, Tables, group, text, with_units

KINDS, LIBRARY = (".h5", ".hdf5", ".hdf", ".nxs"), "h5py"
SIGNATURE = b""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read(file: str, wanted: str) -> Content:
    """The columns of each group by its path, with what attributes say of it and of the groups about it."""
    import h5py

    content = h5py.File(file, "r")  # Closed with the process: values are read when they are written out.
    tables, said = Tables(), {"": _said(content)}
    matrices: dict[str, dict[str, np.ndarray]] = {}

    def visit(name: str, thing: object) -> None:
        # MATLAB keeps the content of cells and objects in groups of these names.
        if name.startswith("#"):
            return
        if not isinstance(thing, h5py.Dataset):
            said[name] = _said(thing)
            return
        item: Any = thing
        unit = next((item.attrs[k] for k in item.attrs if k.lower() in (*UNIT_NAMES, "yunit", "yunits")), None)
        if item.dtype.names:
            tables[name] = {f: Column(None, item.size, lambda f=f: item[f]) for f in item.dtype.names}
            return
        parent, _, own = name.rpartition("/")
        columns = tables.setdefault(parent, {})
        found = _dataset(item, unit)
        if found:
            columns[own] = found
        elif item.ndim == 2 and item.dtype.kind in "iuf" and 1 < min(item.shape) <= 64 and item.size < 1 << 24:
            matrices.setdefault(parent, {})[f"{own} [{text(unit)}]" if text(unit) else own] = item[()]
        else:
            return
        columns.update({key: c for key, c in _said(item).items() if key not in columns})

    content.visititems(visit)
    for name, columns in tables.items():
        above = [name.rsplit("/", k)[0] for k in range(name.count("/") + 1)]
        for place in (*above, "") if max(matrices.get(name, [c.size > 1 for c in columns.values()]), default=0) else ():
            columns.update({key: c for key, c in said.get(place, {}).items() if key not in columns})
        tables[name] = group(columns, matrices.get(name, {}))
    return Content(with_units(tables))


def _said(thing: Any) -> Columns:
    """What attributes of a group or dataset state: single values, and lists of texts, as names of columns are."""
    stated = {key: np.asarray(thing.attrs[key]) for key in thing.attrs if key.lower() not in UNIT_NAMES}
    kept = {key: np.ravel(v) for key, v in stated.items() if v.dtype.kind in ("OUS" if v.size > 1 else "iufOUS")}
    return {key: Column(None, v.size, lambda v=v: v) for key, v in kept.items() if v.size <= 64}


def _dataset(item: Any, unit: object) -> Column | None:
    if item.attrs.get("MATLAB_class") == b"char":
        return Column(None, 1, lambda: np.array(["".join(map(chr, np.ravel(item[()])))]))
    if item.shape is None or (item.ndim and max(item.shape) != item.size):
        return None
    if item.dtype.kind == "O":
        return Column(text(unit), item.size, lambda: item.asstr()[()]) if item.dtype.metadata else None
    return Column(text(unit), item.size, lambda: item[()]) if item.dtype.kind in "iufbS" else None


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
