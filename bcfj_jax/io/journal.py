"""A crash-safe record of finished work: JSON lines that are on disk before the next begins.

A job that was cut off, by Ctrl-C or by the power, starts again and finds here what it had finished. The numbers are
written in full, and what is computed from them is the same as without the cut. Each line has a digest of the job and of
what it says; a line whose digest is wrong costs its own piece, which is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from bcfj_jax.core.errors import InputError
from bcfj_jax.io import opening, usercode
from bcfj_jax.io.outputs import atomic, plain

NAME = "journal.jsonl"
_REMEDY = f"name another folder, or remove {NAME} there to begin again"
# Of a journal that is read [bytes].
_LARGEST = 1 << 30


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
    """Finished pieces of one job (``key_of``) by name, kept in ``folder/journal.jsonl``.

    A line that is torn by a crash, or damaged, is dropped, which is said, and its work done again. Refused is the journal of
    another job, and one of which nothing can be read.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.path = Path(folder) / NAME
        self._key = key
        self._pieces: dict[str, Any] = {}
        self.resumed = self._read()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.path.open("ab")
        if not self.resumed:
            self._write(self._line({"key": key}))

    def _read(self) -> bool:
        if not self.path.exists():
            return False
        lines = opening.content(self.path, _LARGEST, str(self.path), _REMEDY, _REMEDY).splitlines(keepends=True)
        if not lines or lines == [lines[0].rstrip(b"\n")]:  # A crash while the first line was written.
            os.truncate(self.path, 0)
            return False
        head, *others = [_parsed(line) for line in lines]
        # The first line names the job; where it is damaged, the digests of the others do.
        named = head is not None and _holds(head, {"key": head.get("key")}, head.get("key"))
        if head is not None and named and head["key"] != self._key:
            found = "holds the finished pieces of another problem, of other options, or of another version"
            raise InputError(f"--out {self.path.parent}", found, _REMEDY)
        good = [_piece(found) for found in others if found is not None and _holds(found, _piece(found), self._key)]
        if not named and not good:
            raise InputError(str(self.path), "is damaged, and none of its pieces can be read", _REMEDY)
        self._pieces = {str(piece["name"]): piece["result"] for piece in good}
        bad = len(others) - len(good)
        if bad:
            sys.stderr.write(f"{self.path}: {bad} of {len(others)} pieces are damaged and computed again\n")
        if bad or not named:
            with atomic(self.path) as temporary:
                temporary.write_bytes(b"".join(map(self._line, [{"key": self._key}, *good])))
        return True

    def _line(self, piece: Mapping[str, Any]) -> bytes:
        return json.dumps({**piece, "digest": _digest(self._key, piece)}, allow_nan=False).encode() + b"\n"

    def __len__(self) -> int:
        return len(self._pieces)

    def get(self, name: str) -> Any | None:
        """What a finished piece gave; None if it is not finished."""
        return self._pieces.get(name)

    def add(self, name: str, result: Mapping[str, Any]) -> None:
        """Keep a finished piece; on disk when this returns. NaN and infinities become None, as in a resumed job."""
        result = plain(result)
        self._write(self._line({"name": name, "result": result}))
        self._pieces[name] = result

    def _write(self, line: bytes) -> None:
        before = self._file.seek(0, os.SEEK_END)
        try:
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError:
            # Half a line, on a disk that is full.
            with contextlib.suppress(OSError):
                os.truncate(self.path, before)
            raise

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
    """The pieces of one part of a job, by its name, in the journal of the whole."""

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


def _piece(line: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": line.get("name"), "result": line.get("result")}


def _holds(line: Mapping[str, Any], said: Mapping[str, Any], key: Any) -> bool:
    """Whether a line says this, of the job of this key, and no more."""
    with contextlib.suppress(RecursionError):
        return line == {**said, "digest": _digest(key, said)}
    return False


def _digest(key: Any, piece: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps([key, piece], sort_keys=True).encode()).hexdigest()


def _parsed(line: bytes) -> dict[str, Any] | None:
    with contextlib.suppress(ValueError, RecursionError):
        piece = json.loads(line)
        return piece if line.endswith(b"\n") and isinstance(piece, dict) else None
    return None
