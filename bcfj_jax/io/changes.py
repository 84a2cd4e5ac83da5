"""Changes of the command line to what a file says: ``--set path=value``, and options that are short for one.

A path's first word is a table of the file, or a key at its top: ``time.end=3 s``, ``scene.friction=true``. Any other
path is a parameter of the scene: ``stiffness=4e10`` and ``seat_ball.stiffness=4e10`` are ``parameters.stiffness`` and
``parameters.seat_ball.stiffness``. A table of a list goes by its name or its number, from 1: ``contact.stop.law=hertz``,
``experiment.1.noise=2 %``.

A change is made to the table that is read, before anything of it is checked: its errors are those of a file.
``tables.read`` asks here for what was changed.
"""

from __future__ import annotations

import contextlib
import difflib
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bcfj_jax.core.errors import InputError, nearest, quoted

# The tables of a file of each kind, and the keys at its top.
SCENE = ("scene", "parameters", "time", "accuracy", "body", "contact", "load", "quantity", "read", "life")
STUDY = ("design", "vary", "results")
CALIBRATION = (
    "scene", "experiment", "free", "instrument", "loss", "accuracy", "adequate", "sensor", "filter", "model", "candidate",
)  # fmt: skip
DESIGN = ("objective", "vary", "search")
# Tables of tables, whose names may have a point: ``free.seat_ball.stiffness.lower``.
_NAMED = ("free", "vary", "quantity")
_KEYS = ("lower", "upper", "start", "scale", "each", "steps", "values", "unit", "default", "tolerance", "relative")
# Of two keys that exclude each other the one that is set holds.
_INSTEAD = {("accuracy", "level"): "force_error", ("accuracy", "force_error"): "level"}


class Change(NamedTuple):
    """One change: how the user wrote it ("--set stiffness=1e10"), the path's words, and the value."""

    text: str
    words: tuple[str, ...]
    value: Any


# What was changed, by the file or the built-in scene that it was changed of.
_changed: dict[str, tuple[Change, ...]] = {}


def parse(text: str) -> Change:
    """A change from ``path=value``: a value is read as in TOML, and what is no TOML is a text."""
    path, equals, given = (part.strip() for part in text.partition("="))
    words = tuple(word.strip().strip("\"'") for word in path.split("."))
    if not equals or not all(words) or not given:
        remedy = "write --set stiffness=4e10, or time.end='3 s'"
        raise InputError(f"--set {text[:200]}", "this is no path=value", remedy)
    return Change(f"--set {text}", words, value(given))


def value(text: str) -> Any:
    """What stands after "=": as in TOML; what is no TOML is a number as Python writes it, or a text."""
    import tomllib

    with contextlib.suppress(ValueError, RecursionError):
        found = tomllib.loads(f"x = {text}")
        if list(found) == ["x"] and isinstance(found["x"], (bool, int, float, str, list, dict)):
            return found["x"]
    with contextlib.suppress(ValueError):
        return float(text)
    return text


@contextlib.contextmanager
def changing(
    what: str | Path, changes: Sequence[Change], tables: Sequence[str] = SCENE, inside: str = ""
) -> Iterator[None]:
    """Within, a file (or a built-in scene) reads as if it said what the changes say; run.toml then has them.

    ``tables``: of a file of this kind, which may be ``inside`` another table. An error that a change is to blame for names it.
    """
    placed = [_placed(change, tables) for change in changes]
    for k, change in enumerate(placed):
        if change.words in [other.words for other in placed[:k]]:
            raise InputError(change.text[:200], f"{'.'.join(change.words)} is set twice", "set it once")
    where = str(Path(what))
    before = _changed.get(where, ())
    _changed[where] = (*before, *(c._replace(words=(inside, *c.words)) if inside else c for c in placed))
    try:
        yield
    except InputError as error:
        blamed = next((k for k, change in enumerate(placed) if _about(error.where, change)), None)
        if blamed is None:
            raise
        remedy = _table_meant(changes[blamed], tables) or error.remedy
        raise InputError(changes[blamed].text[:200], error.found, remedy) from None
    finally:
        _changed[where] = before


def as_options() -> str:
    """What is changed now as options of a command, to be said again: " --set mass=1 --seed 3"; "" for nothing."""
    texts = dict.fromkeys(change.text for changes in _changed.values() for change in changes)
    return "".join(f" {option} {shlex.quote(value)}" for option, _, value in (text.partition(" ") for text in texts))


def applied(what: str | Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """A file's content with what was changed of it."""
    content = dict(table)
    for change in _changed.get(str(Path(what)), ()):
        content = _set(content, change.words, change)
    return content


def _placed(change: Change, tables: Sequence[str]) -> Change:
    first, *rest = change.words
    if first not in tables:
        if "parameters" not in tables:
            raise InputError(change.text[:200], f"the file has no table '{first}'", nearest(first, tables))
        return change._replace(words=("parameters", ".".join(change.words)))
    if first == "parameters" and rest:
        return change._replace(words=("parameters", ".".join(rest)))
    if first in _NAMED and len(rest) > 1:
        inner, last = (rest[:-1], rest[-1:]) if rest[-1] in _KEYS else (rest, [])
        return change._replace(words=(first, ".".join(inner), *last))
    return change


def _set(table: Any, words: Sequence[str], change: Change, name: str = "") -> Any:
    """A copy of a table, or of a list of tables, in which one place has another value."""
    first, *rest = words
    if isinstance(table, list) and len(table) in (2, 3) and first in _KEYS:
        # NAME = [lower, upper] under [free]; under a design's [vary] the tolerance may follow.
        table = dict(zip(("lower", "upper", "tolerance"), table, strict=False))
    if isinstance(table, list):
        numbers = [str(k + 1) for k in range(len(table))]
        names = [str(entry.get("name", "")) if isinstance(entry, dict) else "" for entry in table]
        k = next((known.index(first) for known in (names, numbers) if first in known), None)
        if k is None:
            shown = [name or number for name, number in zip(names, numbers, strict=True)]
            raise InputError(change.text[:200], f"no entry '{first}'", nearest(first, shown))
        made = _set(table[k], rest, change, first) if rest else change.value
        return [*table[:k], made, *table[k + 1 :]]
    if not isinstance(table, dict):
        # A study's scene: what is inside of it is not in this file.
        found = f"'{name}' is {quoted(table)} in the file"
        raise InputError(change.text[:200], found, "give its table in the file, or set it as a whole")
    if not rest:
        return {**table, first: change.value}
    inner, other = table.get(first, {}), _INSTEAD.get((first, rest[0]))
    if isinstance(inner, dict):
        inner = {key: value for key, value in inner.items() if key != other}
    return {**table, first: _set(inner, rest, change, first)}


def _about(where: str, change: Change) -> bool:
    """Whether an error's place is that of a change: "file: [time] end" or "[free.stiffness]" of what is inside."""
    place, own = _words(where.rpartition(": ")[2]), _words(" ".join(change.words))
    same = min(len(place), len(own))
    return bool(place) and place[:same] == own[:same] and (same > 1 or len(place) == len(own))


def _words(text: str) -> list[str]:
    return re.findall(r"\w+", re.sub(r"(\w+)\.clearance\b", r"clearance_\1", text))


def _table_meant(change: Change, tables: Sequence[str]) -> str:
    """What to say where a table's name was misspelt; "" where it was not."""
    first, *rest = change.words
    if first in tables or not rest:
        return ""
    close = difflib.get_close_matches(first, tables, n=1, cutoff=0.75)
    return f"did you mean '{'.'.join((*close, *rest))}'?" if close else ""
