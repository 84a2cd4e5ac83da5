"""A crash-safe record of finished work: JSON lines that are on disk before the next begins.

A job that was cut off, by Ctrl-C or by the power, starts again and finds here what it had finished. The numbers are
written in full, and what is computed from them is the same as without the cut.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from bcfj_jax.core.errors import InputError
from bcfj_jax.io import usercode
from bcfj_jax.io.outputs import plain

NAME = "journal.jsonl"


def key_of(*parts: Any, packages: Sequence[str] = ("bcfj_jax",)) -> str:
    """SHA-256 of plain data, and of the code at work, the user's own too: other code may find other numbers."""
    digest = hashlib.sha256(json.dumps([plain(part) for part in parts], sort_keys=True).encode())
    root = Path(__file__).resolve().parents[2]
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    for code in usercode.used():
        digest.update(code.sha256.encode())
    return digest.hexdigest()


class Journal:
    """Finished pieces of one job by name, kept in ``folder/journal.jsonl``.

    A last line that is torn, as a crash while writing leaves it, is dropped and its work done again.

    Args:
        folder: where; made if it is not there.
        key: what job it is, ``key_of``.

    Raises:
        InputError: if the folder holds the journal of another job.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.path = Path(folder) / NAME
        self._key = key
        self._pieces: dict[str, Any] = {}
        self.resumed = self._read()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.path.open("ab")
        if not self.resumed:
            self._write({"key": key})

    def _read(self) -> bool:
        if not self.path.exists():
            return False
        content, good = self.path.read_bytes(), 0
        for number, line in enumerate(content.splitlines(keepends=True)):
            piece = _parsed(line)
            if piece is None:
                break
            if number == 0 and piece.get("key") != self._key:
                raise InputError(
                    f"--out {self.path.parent}",
                    "holds the finished pieces of another problem, of other options, or of another version",
                    f"name another folder, or remove {NAME} there to begin again",
                )
            if number:
                self._pieces[piece["name"]] = piece["result"]
            good += len(line)
        if good < len(content):
            os.truncate(self.path, good)
        return good > 0

    def __len__(self) -> int:
        return len(self._pieces)

    def get(self, name: str) -> Any | None:
        """What a finished piece gave; None if it is not finished."""
        return self._pieces.get(name)

    def add(self, name: str, result: Mapping[str, Any]) -> None:
        """Keep a finished piece; on disk when this returns. NaN and infinities become None, as in a resumed job."""
        result = plain(result)
        self._write({"name": name, "result": result})
        self._pieces[name] = result

    def _write(self, piece: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(piece, allow_nan=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def remove(self) -> None:
        """Take the journal away: its job is done and its results are written."""
        self.close()
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        self.close()


class Chapter(Journal):
    """The pieces of one part of a job, in the journal of the whole.

    Args:
        whole: the journal.
        name: of the part.
    """

    def __init__(self, whole: Journal, name: str) -> None:
        self._whole, self._name = whole, name

    def __len__(self) -> int:
        return len(self._whole)

    def get(self, name: str) -> Any | None:
        """What a finished piece of this part gave; None if it is not finished."""
        return self._whole.get(f"{self._name}: {name}")

    def add(self, name: str, result: Mapping[str, Any]) -> None:
        """Keep a finished piece of this part."""
        self._whole.add(f"{self._name}: {name}", result)


def _parsed(line: bytes) -> dict[str, Any] | None:
    if not line.endswith(b"\n"):
        return None
    try:
        piece = json.loads(line)
    except ValueError:
        return None
    return piece if isinstance(piece, dict) else None
