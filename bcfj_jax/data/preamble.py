"""What a text says beside its table: names and values above it, in comments, or in columns left of it; a clock, units.

Sample Interval,5e-05        Sampling rate (Hz)    20000        # rate: 20 kHz        X,CH1,Start,Increment
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from bcfj_jax.data import clock
from bcfj_jax.data.numbers import is_missing, is_number
from bcfj_jax.io.units import column

Facts = list[tuple[str, str]]
# Columns beside a table end before this row, and a table has as many rows at least.
_LAST, _FEWEST = 40, 30
_UNITS = ("verticalunits", "verticalunit", "yunits", "yunit", "yunitlabel", "verticalunitsch")
_SOURCES = ("source", "channel", "sourcechannel")
# Lines of a word and a line of a number, the rate: sections of Vicon's files.
_SECTIONS = ("devices", "trajectories", "model outputs")
_VALUE = re.compile(r"\s*(.*?[^\s:=\d])\s*[:=]?\s+([-+]?\d[\d.,]*(?:[eE][-+]?\d+)?\s*[\w/%]*)\s*")


def beside(rows: Sequence[Any]) -> tuple[list[Any], Facts]:
    """Rows without the columns left of a table that hold names and values of its settings, and these."""
    if len(rows) < _FEWEST:
        return list(rows), []
    last, j = min(_LAST, len(rows) // 2), 0
    while all(j >= len(r.cells) or is_missing(r.cells[j]) for r in rows[last:]) and j < 8:
        j += 1
    top = rows[:last]
    texts = sum(any(not is_missing(c) and not is_number(c) for c in r.cells[:j]) for r in top)
    if not j or texts < 2 or not all(sum(map(is_number, r.cells[j:])) >= 1 for r in top):
        return list(rows), []
    found = [pair for r in top for pair in _pairs(r.cells[:j])]
    return [r._replace(cells=r.cells[j:]) for r in rows], found


def above(rows: Iterable[Any]) -> Facts:
    """Names and values in rows above a table."""
    found, before = Facts(), ""
    for row in rows:
        cells = [c for c in row.cells if not is_missing(c)]
        if len(cells) == 1 and is_number(cells[0]) and before:
            found.append(("rate" if before in _SECTIONS else before.rstrip(":= "), str(cells[0])))
        before = str(cells[0]).strip().lower() if len(cells) == 1 else ""
        found += _pairs(row.cells)
    return found


def _pairs(cells: Sequence[Any]) -> Iterator[tuple[str, str]]:
    filled = [str(c).strip() for c in cells if not is_missing(c)]
    if len(filled) > 1:
        yield filled[0].rstrip(":= "), filled[1]
    joined = " ".join(filled)
    key, mark, value = joined.partition(":")
    for name, sign, said in ((key, mark, value), joined.partition("=")):
        if sign and name.strip() and said.strip():
            yield name.strip(), said.strip()
    if found := _VALUE.fullmatch(joined):
        yield found[1], found[2]


def increments(names: Sequence[str], below: Sequence[Any]) -> Facts:
    """A start and a step in the row below the names, under names of their own."""
    known = clock.STEPS | clock.STARTS
    found = [(n, str(c)) for n, c in zip(names, below, strict=False) if clock.plain(str(n)) in known and is_number(c)]
    return found if any(clock.plain(n) in clock.STEPS for n, _ in found) else []


def titled(titles: list[str], facts: Facts, columns: Sequence[Sequence[Any]], named: bool) -> list[str]:
    """Titles with the units, and where the table has no names the names, that stand beside it."""
    said = {clock.plain(key): value.rpartition(":")[2].strip() for key, value in reversed(facts)}
    unit = next((said[key] for key in _UNITS if key in said), "")
    timed = next((j for j, t in enumerate(titles) if clock.is_time(t)), None)
    if not named and timed is None and (even := clock.stated(facts, "")) and _steps(columns[0], even[1]):
        source = next((said[key] for key in _SOURCES if key in said), "")
        titles = ["time [s]", *(source if source and len(titles) == 2 else t for t in titles[1:])]
        timed = 0
    bare = [j for j, t in enumerate(titles) if j != timed and t and column(t)[1] is None]
    if unit and timed is not None and len(bare) == 1:
        titles = [f"{t} [{unit}]" if j in bare else t for j, t in enumerate(titles)]
    return titles


def _steps(cells: Sequence[Any], step: float) -> bool:
    try:
        first, last = (float(str(c).replace(",", ".")) for c in (cells[0], cells[-1]))
    except (ValueError, IndexError):
        return False
    return len(cells) > 1 and abs((last - first) / (len(cells) - 1) / step - 1.0) < 1e-2
