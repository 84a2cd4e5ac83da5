"""Binary files are read by a process of its own (``child``), whose end is put into words here.

SciPy checks neither the types nor the sizes that a MATLAB file states: one changed bit crashes the process that reads it, or asks
for all its memory; it has no safe way to read. The HDF5 library may search a damaged file without end. A spreadsheet of 5 kB
may hold one cell in its first row and one in its last column and row, and a Parquet file of 2 MB may hold two columns of 2e8
zeros. None of this can be caught in the process where it happens, so a child with limits of memory and time reads them.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numpy as np

from bcfj_jax.core.errors import InputError, clip
from bcfj_jax.core.extras import library
from bcfj_jax.data import child
from bcfj_jax.data.columns import Column, Content, Tables
from bcfj_jax.data.readers import sheets
from bcfj_jax.io.opening import MEGABYTE

# What a child may have: of memory, room for its libraries and for values that were packed thirtyfold; of a core, seconds.
_BYTES, _BYTES_A_BYTE = 1024 * MEGABYTE, 32
_SECONDS, _SECONDS_A_MEGABYTE = 4, 2.0
# On a machine that is busy, or where the system knows no such limits, the clock on the wall decides.
_WAIT = 15
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_MAX_THREADS")
# Of a smaller file every table is read, for the next entry of a calibration often names another of its tables.
_SMALL = 32 * MEGABYTE


def read(path: Path, where: str, inside: str | None, reader: ModuleType) -> Content:
    """The columns of a file by table; of a large file only the table ``inside`` has values (None: the only one)."""
    found = path.stat()
    small = found.st_size < _SMALL or (inside is None and reader is sheets)
    wanted = "*" if small else (inside or "").strip("/")
    try:
        return _read(path.absolute(), wanted, found.st_mtime_ns, found.st_size, reader)
    except _Unreadable as error:
        how, remedy = error.args
        if how.startswith("ModuleNotFoundError"):
            library(reader.LIBRARY, where, "io")
        kind = path.suffix.lower() if path.suffix.lower() in reader.KINDS else reader.KINDS[0]
        raise InputError(where, f"{clip(str(path))} cannot be read as {kind} ({how})", remedy) from None


class _Unreadable(Exception):
    """What stopped the reading of a file, and the remedy."""


@lru_cache(maxsize=1)
def _read(path: Path, wanted: str, changed: int, size: int, reader: ModuleType) -> Content:
    del changed
    seconds = int(_SECONDS + _SECONDS_A_MEGABYTE * size / MEGABYTE)
    # ``-P``: a module beside the data, or beside the child, must not stand in for a library's.
    command = [sys.executable, "-P", "-W", "ignore", child.__file__, str(path), wanted]
    limits = [str(_BYTES + _BYTES_A_BYTE * size), str(seconds), str(reader.__file__)]
    # Threads of linear algebra would only reserve memory.
    environment = {**os.environ, **dict.fromkeys(_THREADS, "1")}
    wait = _WAIT * seconds + _WAIT
    try:
        done = subprocess.run(
            [*command, *limits], env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=wait
        )
    except subprocess.TimeoutExpired:
        raise _damaged(reader, f"it took longer than {wait} s") from None
    said = done.stderr.decode("utf-8", "replace").strip().splitlines()
    # A library may go on to print as its process ends.
    refused = [line for line in said if line.startswith('["') and line.endswith("]")]
    if done.returncode == child.REFUSED and refused:
        how, remedy = json.loads(refused[-1])
        if "MemoryError" in how:
            raise _oversize(reader)
        raise _Unreadable(clip(how), remedy or "write the file again, or give it the extension of its kind")
    if any("memory allocation of" in line for line in said):
        raise _oversize(reader)
    if done.returncode:
        raise _damaged(reader, _ended(done.returncode, seconds))
    content, tables = io.BytesIO(done.stdout), Tables()
    head = json.loads(content.readline())
    for table, name, unit, length, follows in head.get("tables", ()):
        values = np.lib.format.read_array(content, allow_pickle=False) if follows else np.zeros(0)
        values.flags.writeable = False
        tables.setdefault(table, {})[name] = Column(unit, length, lambda values=values: values)
    return Content(tables, head.get("note", ""), head.get("sheets", {}))


def _oversize(reader: ModuleType) -> _Unreadable:
    """More is to be kept of a file than its child may have."""
    if reader is sheets:
        how = "between its first and its last cell there are too many cells to be kept"
        return _Unreadable(how, "delete the cells that stand far from the table, or write it as CSV")
    return _damaged(reader, "it states sizes that its length cannot hold")


def _damaged(reader: ModuleType, how: str) -> _Unreadable:
    version = ", with -v7.3" if ".mat" in reader.KINDS else ""
    return _Unreadable(f"{how}: it is damaged", f"save it again{version}, or write it as CSV")


def _ended(code: int, seconds: int) -> str:
    try:
        name = signal.Signals(-code).name
    except ValueError:
        return f"the process that read it ended with code {code}"
    return f"it took longer than {seconds} s" if name in ("SIGXCPU", "SIGKILL") else f"its reader crashed, {name}"
