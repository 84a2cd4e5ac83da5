"""The one place where a file that a user names is opened: a regular file of a limited size, or a sentence why not.

A pipe or a device would block or never end, so what is no regular file is refused before a byte is read.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

from bcfj_jax.core.errors import InputError, clip

# Readers of measured files of the user's own, by name (``usercode``): objects with ``sniff(path, head)`` and ``read(path)``.
READERS: dict[str, Any] = {}
MEGABYTE = 1 << 20
# Tables of text are held as Python texts, some twenty times their size: at most 1.5 GB.
LARGEST_TEXT, LARGEST_TOML, LARGEST_BINARY = 64 * MEGABYTE, 2 * MEGABYTE, 16384 * MEGABYTE


def check(path: Path, largest: int, where: str, missing: str, remedy: str) -> None:
    """Refuse what is not a regular file of at most ``largest`` bytes; the last three arguments are parts of the message."""
    os.close(_opened(path, largest, where, missing, remedy))


def head(path: Path, where: str, missing: str, size: int = 4096) -> bytes:
    """The first bytes of a regular file; arguments as ``check``."""
    with os.fdopen(_opened(path, LARGEST_BINARY, where, missing, "give a smaller file"), "rb") as file:
        return file.read(size)


def content(path: Path, largest: int, where: str, missing: str, remedy: str) -> bytes:
    """All bytes of a regular file; arguments as ``check``."""
    handle = _opened(path, largest, where, missing, remedy)
    with os.fdopen(handle, "rb") as file:
        try:
            # A file may grow while it is read.
            raw = file.read(largest + 1)
        except OSError as error:
            raise InputError(where, f"{clip(str(path))} cannot be read ({error.strerror})", missing) from None
    if len(raw) > largest:
        raise _too_large(path, len(raw), largest, where, remedy)
    return raw


def _opened(path: Path, largest: int, where: str, missing: str, remedy: str) -> int:
    shown = clip(str(path))
    try:
        # A pipe without a writer would block; the flag does not change how a regular file is read.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise InputError(where, f"no file {shown}", missing) from None
    except (OSError, ValueError) as error:  # A path with a NUL is a ValueError.
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(where, f"{shown!r} cannot be read ({reason})", missing) from None
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device, not a file"
            raise InputError(where, f"{shown} is {kind}", missing)
        if found.st_size > largest:
            raise _too_large(path, found.st_size, largest, where, remedy)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _too_large(path: Path, size: int, largest: int, where: str, remedy: str) -> InputError:
    found = f"{clip(str(path))} holds {size / MEGABYTE:.3g} MB, more than the {largest / MEGABYTE:.3g} MB read here"
    return InputError(where, found, remedy)
