"""MATLAB up to version 7.2 by SciPy, 7.3 as HDF5: the vectors of a file by the path of the struct that holds them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from bcfj_jax.data.columns import Content, Tables, matrix, vector, with_units
from bcfj_jax.data.readers import hdf5

KINDS, LIBRARY = (".mat",), "h5py"
SIGNATURE = b""


def read(file: str, wanted: str) -> Content:
    """The vectors, and the columns of a matrix where there are no vectors, by struct."""
    from scipy.io import loadmat

    if hdf5.is_hdf5(file):
        return hdf5.read(file, wanted)
    tables: Tables = {}

    def visit(table: str, content: Mapping[str, Any]) -> None:
        columns, matrices = tables.setdefault(table, {}), {}
        for name, value in content.items():
            if isinstance(value, Mapping):
                visit(f"{table}/{name}".strip("/"), value)
            elif not name.startswith("__"):
                with contextlib.suppress(ValueError):  # A cell of vectors that differ in length.
                    array = np.asarray(value)
                    matrices |= matrix(name, array)
                    if found := vector(array):
                        columns[name] = found
        # Names of channels are no vector beside a matrix.
        if not any(c.size > 1 and np.asarray(c.values()).dtype.kind in "iufb" for c in columns.values()):
            tables[table] = {**{n: c for n, c in columns.items() if c.size == 1 or not matrices}, **matrices}

    visit("", loadmat(file, simplify_cells=True))
    return Content(with_units(tables))
