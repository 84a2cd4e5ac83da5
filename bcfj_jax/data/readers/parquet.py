"""Parquet by pyarrow; a field's metadata may hold its ``unit``."""

from __future__ import annotations

import os

import numpy as np

from bcfj_jax.data.columns import UNIT_NAMES, Columns, Content, vector

KINDS, LIBRARY = (".parquet", ".pq"), "pyarrow.parquet"
SIGNATURE = b""


def read(file: str, wanted: str) -> Content:
    """The columns of a file."""
    # The system's own allocator keeps to the limit of memory; one core is all that a child has.
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
    from pyarrow import parquet as library

    content = library.read_table(file, use_threads=False, pre_buffer=False)
    columns: Columns = {}
    for field, chunks in zip(content.schema, content.columns, strict=True):
        metadata = {k.decode().lower(): v for k, v in (field.metadata or {}).items()}
        values = np.asarray(chunks.to_numpy())
        if values.dtype.kind == "O":
            values = np.array(["" if v is None else v for v in values], dtype=object)
        if found := vector(values, next((metadata[k] for k in UNIT_NAMES if k in metadata), None)):
            columns[field.name] = found
    return Content({"": columns})
