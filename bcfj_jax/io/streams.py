"""Standard output and error of a command whose reader may go away: the results are in files, and the run goes on."""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO


class _Patient(io.FileIO):
    """A stream that takes what nobody reads any more. It says once why, where it is not that."""

    def __init__(self, number: int, name: str) -> None:
        super().__init__(number, "wb", closefd=False)
        self._called, self._given_up = name, False
        # Why something was not written, where it is not that its reader went away.
        self.lost = ""

    def write(self, content) -> int:
        try:
            return super().write(content) or 0
        except OSError as error:
            if not isinstance(error, BrokenPipeError):
                self.lost = error.strerror or str(error)
                if not (self._given_up or self._called == "stderr"):
                    sys.stderr.write(f"warning: {self._called} cannot be written ({self.lost}); the run goes on\n")
            self._given_up = True
            return len(content)


def _patient(stream: TextIO | None, name: str) -> TextIO:
    if stream is None:  # It was closed before the process began.
        return open(os.devnull, "w", encoding="utf-8")
    try:
        number, encoding = stream.fileno(), stream.encoding
    except (OSError, ValueError):
        return stream
    if number < 0:
        return stream
    raw = io.BufferedWriter(_Patient(number, name))
    # A name of other characters than the stream's is written as its escapes.
    return io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=name == "stderr" or raw.isatty())


def be_patient() -> None:
    """Let this process's output outlive its readers (``| head``), whatever characters it has."""
    sys.stdout, sys.stderr = _patient(sys.stdout, "stdout"), _patient(sys.stderr, "stderr")


def lost() -> str:
    """Why something of standard output was not written; "" where all was, or where its reader went away."""
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return raw.lost if isinstance(raw, _Patient) else ""
