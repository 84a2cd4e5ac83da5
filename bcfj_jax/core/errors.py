"""Errors that speak to the user: where, what was found, what would be right."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable


class InputError(ValueError):
    """Bad input, reported as ``where: what; remedy``. The command line exits 2 on it.

    Args:
        where: file and key, or file and row, as the user would look it up.
        found: what is wrong, quoting the value.
        remedy: what would be right.
    """

    def __init__(self, where: str, found: str, remedy: str) -> None:
        super().__init__(f"{where}: {found}; {remedy}")
        self.where, self.found, self.remedy = where, found, remedy

    def __reduce__(self) -> tuple:
        """So that one raised in a worker process arrives."""
        return type(self), (self.where, self.found, self.remedy)


def nearest(name: str, known: Iterable[str]) -> str:
    """Say which of the known names was probably meant, or list them all."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    return "known here: " + (", ".join(names) or "nothing")


def origin(error: BaseException) -> str:
    """File and line of the user's own code that an error came from: "my_file.py, line 12"; "" where none took part."""
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    found, frame = "", error.__traceback__
    while frame is not None:
        name = frame.tb_frame.f_code.co_filename
        theirs = name.startswith((here + os.sep, "<")) or f"{os.sep}site-packages{os.sep}" in name
        if not theirs and not name.startswith(os.path.dirname(os.__file__) + os.sep):
            found = f"{name}, line {frame.tb_lineno}"
        frame = frame.tb_next
    return found
