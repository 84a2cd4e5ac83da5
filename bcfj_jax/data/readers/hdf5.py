"""HDF5 by h5py, also MATLAB 7.3: a group of 1-D datasets, or a compound dataset; attribute ``unit`` or ``units``."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from bcfj_jax.data.columns import UNIT_NAMES, Column, Content, Tables, group, stated, text, with_units

KINDS, LIBRARY = (".h5", ".hdf5", ".hdf", ".nxs"), "h5py"
SIGNATURE = b""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read(file: str, wanted: str) -> Content:
    """The columns of each group by its path, with what attributes say of it and of the groups about it."""
    import h5py

    content = h5py.File(file, "r")  # Closed with the process: values are read when they are written out.
    tables, said = Tables(), {"": stated(content.attrs)}
    matrices: dict[str, dict[str, np.ndarray]] = {}

    def visit(name: str, thing: object) -> None:
        # MATLAB keeps the content of cells and objects in groups of these names.
        if name.startswith("#"):
            return
        if not isinstance(thing, h5py.Dataset):
            said[name] = stated(getattr(thing, "attrs", {}))
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
        columns.update({key: c for key, c in stated(item.attrs).items() if key not in columns})

    content.visititems(visit)
    for name, columns in tables.items():
        above = [name.rsplit("/", k)[0] for k in range(name.count("/") + 1)]
        for place in (*above, "") if max(matrices.get(name, [c.size > 1 for c in columns.values()]), default=0) else ():
            columns.update({key: c for key, c in said.get(place, {}).items() if key not in columns})
        tables[name] = group(columns, matrices.get(name, {}))
    return Content(with_units(tables))


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
