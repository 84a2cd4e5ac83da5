"""Errors that speak to the user: where, what was found, what would be right."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence

QUOTED = 200  # characters of a value that a message repeats
_LONGEST_LINE, _LONGEST_MESSAGE = 1000, 8000
_LONG_QUOTE = re.compile(rf"'([^'\n]{{{QUOTED + 1},}})'")


def clip(value: object, most: int = QUOTED) -> str:
    """A value as a message quotes it: its beginning, and how long it is where it is longer than ``most`` characters."""
    try:
        text = value if isinstance(value, str) else repr(value)
    except Exception:
        return f"a value of type {type(value).__name__}"
    return text if len(text) <= most else f"{text[: most - 30]}... ({len(text)} characters)"


def escaped(text: str) -> str:
    """A text whose control characters, and what is no character, are written as escapes; its lines stay."""
    return "".join(x if x.isprintable() or x in "\n\t" else x.encode("unicode_escape").decode("ascii") for x in text)


def _short(text: str) -> str:
    """A part of a message: no quoted value, no line of it and not all of it beyond what can be read."""
    if len(text) <= QUOTED:
        return text
    text = _LONG_QUOTE.sub(lambda found: f"'{clip(found[1])}'", text)
    if len(text) <= _LONGEST_LINE:
        return text
    return clip("\n".join(clip(line, _LONGEST_LINE) for line in text.split("\n")), _LONGEST_MESSAGE)


class InputError(ValueError):
    """Bad input, reported as ``where: what; remedy``: the file and key or row as the user would look it up, what is wrong with
    the value quoted, and what would be right. The command line exits 2 on it.
    """

    def __init__(self, where: str, found: str, remedy: str) -> None:
        where, found, remedy = _short(where), _short(found), _short(remedy)
        super().__init__(f"{where}: {found}; {remedy}")
        self.where, self.found, self.remedy = where, found, remedy
        self.faults: list[InputError] = []  # those that it lists, where it lists several

    def __reduce__(self) -> tuple:
        """So that one raised in a worker process arrives."""
        return type(self), (self.where, self.found, self.remedy)


class Faults:
    """Faults of one place, collected to be said in one message.

    ``with faults:`` keeps an ``InputError`` and goes on behind the block; ``refuse`` raises them all.
    """

    def __init__(self, faults: Iterable[InputError] = ()) -> None:
        self.found = list(faults)

    def __enter__(self) -> Faults:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        if isinstance(error, InputError):
            self.found.append(error)
        return isinstance(error, InputError)

    def refuse(self, where: str) -> None:
        """Raise what was found, each fault once: the fault itself where there is one, else all of them, a line each."""
        if self.found:
            raise together(where, list({str(fault): fault for fault in self.found}.values()))


def together(where: str, faults: Sequence[InputError]) -> InputError:
    """Several faults of one place as one message, a line each; a single fault stays as it is."""
    if len(faults) == 1:
        return faults[0]
    single = [one for fault in faults for one in (fault.faults or [fault])]
    lines = [f"  {str(fault).removeprefix(where).lstrip(': ')}" for fault in single]
    error = InputError(where, f"{len(single)} faults", "\n".join(["correct them, then repeat the command:", *lines]))
    error.faults = single
    return error


def quoted(value: object) -> str:
    """A value as it is written in Python, on one line, at most ``QUOTED`` characters of it."""
    return clip(" ".join(clip(value if not isinstance(value, str) else repr(value), 2 * QUOTED).split()))


def counted(number: int, what: str) -> str:
    """A number of things: "1 record", "2 records"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def texts(where: str, given: object, remedy: str) -> tuple[str, ...]:
    """Names as a tuple, of one name or several; refuses what is no text, and no sequence of texts."""
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, Iterable) or isinstance(names, (bytes, Mapping)):
        raise InputError(where, f"{quoted(given)} names nothing", remedy)
    names = tuple(names)
    wrong = [name for name in names if not isinstance(name, str)]
    if wrong:
        raise InputError(where, f"{quoted(wrong[0])} is not a name", remedy)
    return names  # type: ignore[return-value]


def nearest(name: object, known: Iterable[str]) -> str:
    """Say which of the known names was probably meant, or list them all."""
    names, name = sorted(known), str(name)[:QUOTED]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    return "known here: " + (", ".join(names) or "nothing")


def one_of(where: str, what: str, name: object, known: Collection[str], hint: str = "") -> None:
    """Refuse what is none of the known names of "scene", "format" and the like; ``hint`` follows the nearest of them."""
    if not isinstance(name, str) or name not in known:
        raise InputError(where, f"no {what} '{name}'", nearest(name, known) + hint)


def origin(error: BaseException) -> str:
    """File and line of the user's own code that an error came from: "my_file.py, line 12"; "" where none took part."""
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    found, frame = "", error.__traceback__
    while frame is not None:
        name = frame.tb_frame.f_code.co_filename
        known = name.startswith((here + os.sep, os.path.dirname(os.__file__) + os.sep, "<"))
        if not known and f"{os.sep}site-packages{os.sep}" not in name:
            found = f"{name}, line {frame.tb_lineno}"
        frame = frame.tb_next
    return found
