"""NumPy's own files: a matrix, the fields of a structured array, or the arrays of an archive by their names."""

from __future__ import annotations

import os

import numpy as np

from bcfj_jax.data.columns import Content, Refused, group, vector, wrong_length

KINDS, LIBRARY = (".npy", ".npz"), ""
SIGNATURE = rb"\x93NUMPY"


def read(file: str, wanted: str) -> Content:
    """One table; pickled objects are refused, which could run anything."""
    content = np.load(file, allow_pickle=False)
    arrays = {"column": content} if isinstance(content, np.ndarray) else {k: content[k] for k in content.files}
    parts = {k: v[k] if v.dtype.names else v for n, v in arrays.items() for k in v.dtype.names or (n,)}
    vectors = {k: own for k, part in parts.items() if (own := vector(part))}
    columns = group(vectors, {k: v for k, v in parts.items() if v.ndim == 2 and k not in vectors})
    if not columns:
        raise Refused("it holds neither vectors nor a matrix of numbers", "save columns as vectors: numpy.savez")
    return Content({"": columns}, _length(file, content) if isinstance(content, np.ndarray) else "")


def _length(file: str, content: np.ndarray) -> str:
    """Whether a file of one array is longer than it states; an archive has checksums."""
    with open(file, "rb") as raw:
        version = np.lib.format.read_magic(raw)
        (np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0)(raw)
        return wrong_length(os.path.getsize(file), raw.tell() + content.nbytes)
