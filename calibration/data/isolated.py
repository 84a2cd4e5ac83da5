"""MATLAB and HDF5 files are read by a process of its own (``child``), whose end is put into words here.

SciPy checks neither the types nor the sizes that a MATLAB file states: one changed bit crashes the process that reads it, or asks
for all its memory; it has no safe way to read. The HDF5 library may search a damaged file without end. Neither can be caught in
the process where it happens, so a child with limits of memory and time reads them.
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

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.errors import clip
from bcfj_jax.core.extras import library
from bcfj_jax.io.opening import MEGABYTE
from calibration.data import child

# What a child may have: of memory, room for its libraries and for values that were packed thirtyfold; of a core, seconds.
_BYTES, _BYTES_A_BYTE = 1024 * MEGABYTE, 32
_SECONDS, _SECONDS_A_MEGABYTE = 2, 0.5
# On a machine that is busy, or where the system knows no such limits, the clock on the wall decides.
_WAIT = 15
# Of a smaller file every table is read, for the next entry of a calibration often names another of its tables.
_SMALL = 32 * MEGABYTE


def tables(path: Path, where: str, inside: str | None) -> child.Tables:
    """The columns of a file by table; of a large file only the table that is meant has values.

    Args:
        path: a .mat, .h5 or .hdf5.
        where: place in the problem file, for messages.
        inside: which table; None: the only one.

    Raises:
        InputError: where the file cannot be read, or crashes or exceeds the process that reads it.
    """
    found = path.stat()
    wanted = "*" if found.st_size < _SMALL else (inside or "").strip("/")
    try:
        return _tables(path.absolute(), wanted, found.st_mtime_ns, found.st_size)
    except _Unreadable as error:
        how, remedy = error.args
        if how.startswith("ModuleNotFoundError"):
            library("h5py", where, "io")
        raise InputError(where, f"{clip(str(path))} cannot be read as {path.suffix.lower()} ({how})", remedy) from None


class _Unreadable(Exception):
    """What stopped the reading of a file, and the remedy."""


@lru_cache(maxsize=1)
def _tables(path: Path, wanted: str, changed: int, size: int) -> child.Tables:
    del changed
    seconds = int(_SECONDS + _SECONDS_A_MEGABYTE * size / MEGABYTE)
    # ``-P``: a module beside the data, or beside the child, must not stand in for a library's.
    command = [sys.executable, "-P", "-W", "ignore", child.__file__, str(path), wanted]
    limits = [str(_BYTES + _BYTES_A_BYTE * size), str(seconds)]
    # Threads of linear algebra would only reserve memory.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [*command, *limits],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_WAIT * seconds + _WAIT,
        )
    except subprocess.TimeoutExpired:
        raise _damaged(f"it took longer than {_WAIT * seconds + _WAIT} s") from None
    said = done.stderr.decode("utf-8", "replace").strip().splitlines()
    if done.returncode == child.REFUSED and said:
        if "MemoryError" in said[-1]:
            raise _damaged("it states sizes that its length cannot hold")
        raise _Unreadable(clip(said[-1]), "write the file again, or give it the extension of its kind")
    if done.returncode:
        raise _damaged(_ended(done.returncode, seconds))
    content, read = io.BytesIO(done.stdout), {}
    for table, name, unit, length, follows in json.loads(content.readline()):
        values = np.lib.format.read_array(content, allow_pickle=False) if follows else np.zeros(0)
        values.flags.writeable = False
        read.setdefault(table, {})[name] = child.Column(unit, length, lambda values=values: values)
    return read


def _damaged(how: str) -> _Unreadable:
    return _Unreadable(f"{how}: it is damaged", "save it again, a .mat with -v7.3, or write it as CSV")


def _ended(code: int, seconds: int) -> str:
    """How a child ended, in words."""
    try:
        name = signal.Signals(-code).name
    except ValueError:
        return f"the process that read it ended with code {code}"
    return f"it took longer than {seconds} s" if name in ("SIGXCPU", "SIGKILL") else f"its reader crashed, {name}"
