"""A reader for each kind of binary file, in a module each.

A reader has ``KINDS``, the extensions of its files, ``LIBRARY``, the module that reads them ("" for NumPy alone),
``SIGNATURE``, how the first bytes of its files read whatever the extension (b"": two bytes are too few to tell, or a wrong
extension is to be said by ``decoding``), and ``read(file, wanted)``, the ``Content``. It runs in a process of its own
(``child``), and imports its library on use. A reader of the user's own is any class with ``sniff(path, head)`` and
``read(path)`` in a file that ``--code`` names.
"""

from __future__ import annotations

import re
from types import ModuleType

from bcfj_jax.data.readers import c3d, hdf5, lvm, mat, mdf, npy, parquet, sheets, tdms, uff, wav

READERS: tuple[ModuleType, ...] = (tdms, mat, hdf5, parquet, sheets, lvm, uff, mdf, c3d, wav, npy)


def named(name: str) -> ModuleType:
    """A reader by the last part of its module's name."""
    return next(r for r in READERS if r.__name__.endswith(f".{name}"))


def reader_of(kind: str, head: bytes) -> ModuleType | None:
    """The reader of a file with an extension and first bytes; None where it is none of these, as a text is."""
    if kind == ".xls" and b"\0" not in head:
        return None  # Many programs name a text so, that a spreadsheet opens it.
    found = next((r for r in READERS if kind in r.KINDS), None)
    return found or next((r for r in READERS if r.SIGNATURE and re.match(r.SIGNATURE, head)), None)
