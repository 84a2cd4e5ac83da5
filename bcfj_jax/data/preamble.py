"""What a text says beside its table: names and values above it, in comments, or in columns left of it; a clock, units.

Sample Interval,5e-05        Sampling rate (Hz)    20000        # rate: 20 kHz        X,CH1,Start,Increment
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise, product
from typing import Any

from bcfj_jax.data import clock
from bcfj_jax.data.numbers import is_missing, is_number
from bcfj_jax.io.units import column, known

Facts = list[tuple[str, str]]
# Columns beside a table end before this row, and a table has as many rows at least.
_LAST, _FEWEST = 40, 30
_UNITS = (
    "verticalunits", "verticalunit", "yunits", "yunit", "yunitlabel", "unitname", "verticalunitsch", "vunit", "unit", "units",
    "einheit", "einheiten", "yaxisunit", "yaxisunits", "yeinheit", "単位", "单位", "unité", "unidad",
)  # fmt: skip
_PLACE = re.compile(r"(?i)(?:pos(?:ition)?[ _.]?)?[xyz]")
_SOURCES = (
    "source", "channel", "sourcechannel", "tracename", "nameofthechannel", "channeltitle", "channelname", "kanal",
    "ch名称", "信号名",
)  # fmt: skip
# A line that says that numbers follow, and no names.
_DATA = re.compile(r"(?i)[\[\s]*(?:.*\b)?(?:data|daten|values|werte|messwerte|points|begin)\s*[\]:]?\s*")
# "column 2: force [kN]".
_DESCRIBED = re.compile(r"(?i)\W*(?:col(?:umn)?|spalte|ch(?:annel)?)?\W*(\d{1,2})\s*[:=.)-]+\s*([^\W\d].*?)\s*")
# What stands before names in their own line.
_BEFORE = re.compile(r"(?i)(?:channel|column|marker)?[_ ]?(?:names|headers?|labels|channels|columns|fields)\s*:?")
_SAMPLED = re.compile(r"(?i)(?:sampled|recorded|abgetastet)(?: at| with| mit)? ([\d.]+ ?[kM]?(?:Hz|S/s))\b")
# A number and its unit; a letter may be of a name, as in "1A".
_AMOUNT = re.compile(r"[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)? ?([^\W\d_]{2}[^\s\d]*)")
_KEY = re.compile(r"\[([^\]]{2,})\]")
_INLINE = re.compile(r"\s*(\w+)\s*=\s*([-+.]?\d.*)")
# Lines of a word and a line of a number, the rate: sections of Vicon's files.
_SECTIONS = ("devices", "trajectories", "model outputs", "segments", "joints")
_VALUE = re.compile(r"\s*(.*?[^\s:=\d])\s*[:=]?\s+([-+]?\d[\d.,]*(?:[eE][-+]?\d+)?\s*[\w/%]*)\s*")


def beside(rows: Sequence[Any]) -> tuple[list[Any], Facts, int]:
    """Rows without the columns left of a table that hold settings, these settings, and how many rows stand above the table.

    Settings stand beside the table (Tektronix), or above it as titles of rows (Yokogawa, DIAdem).
    """
    last, j = min(_LAST, len(rows) // 2), 0
    while all(j >= len(r.cells) or is_missing(r.cells[j]) for r in rows[last:]) and j < 8:
        j += 1
    titled = [k for k, r in enumerate(rows[:last]) if any(not is_missing(c) and not is_number(c) for c in r.cells[:j])]
    if len(rows) < _FEWEST or len(titled) < 2:
        return list(rows), [], 0
    within = all(sum(map(is_number, r.cells[j:])) >= 1 for r in rows[:last])
    found = [pair for r in rows[:last] for pair in _pairs(r.cells[:j] if within else r.cells)]
    return [r._replace(cells=r.cells[j:]) for r in rows], found, 0 if within else titled[-1] + 1


def above(rows: Iterable[Any]) -> Facts:
    """Names and values in rows above a table."""
    found, before = Facts(), ""
    for row in rows:
        cells = [c for c in row.cells if not is_missing(c)]
        if cells and is_number(cells[0]) and len(set(map(str, cells))) == 1 and before:
            found.append(("rate" if before in _SECTIONS else before.rstrip(":= "), str(cells[0])))
        before = str(cells[0]).strip().lower() if len(cells) == 1 else ""
        if sampled := _SAMPLED.search(" ".join(map(str, cells))):
            found.append(("rate", sampled[1]))
        found += _pairs(row.cells)
    return found


def valued(cell: Any) -> bool:
    """Whether a cell is a value, which names no column: a number, also with its unit, a date or a time of day."""
    number = _AMOUNT.fullmatch(str(cell).strip())
    return is_number(cell) or clock.is_of_day(cell) or clock.day(str(cell)) > 0 or bool(number and known(number[1]))


def states(cells: Sequence[Any]) -> bool:
    """Whether a row above data is a setting or says that data follow, and so holds no names."""
    given = [str(c).strip() for c in cells if not is_missing(c)]
    if len(given) == 1:
        key, sign, value = given[0].replace("=", ":").partition(":")
        said = bool(value.strip()) and (is_number(value) or _is_known(key))
        marked = len(cells) > 1 or sign != "" or given[0].startswith("[") or given[0] == "BEGIN"
        return bool(sign and said) or (marked and _DATA.fullmatch(given[0]) is not None)
    # Of units all stand in brackets.
    if len(given) > 1 and _KEY.fullmatch(given[0]) and not any(c.startswith(("[", "(")) for c in given[1:]):
        return True
    if given and (given[0].endswith("=") or (len(given) == 2 and given[0].endswith(":"))):
        return True
    if given and clock.plain(given[0]) in _UNITS:
        return len(given) == 2 or all(map(known, given[1:]))
    if len(given) != 2 or is_number(given[0]) or clock.is_of_day(given[0]):
        return False
    return valued(given[1]) and not clock.is_time(given[0])


def described(rows: Sequence[Any], wide: int) -> list[str]:
    """Names of all columns in lines "column 2: force [kN]"; none where there are none."""
    names: dict[int, str] = {}
    for row in rows:
        if found := _DESCRIBED.fullmatch(" ".join(filter(None, map(str, row.cells)))):
            names.setdefault(int(found[1]), found[2])
    first = min(names, default=1)
    listed = [names.get(first + j, "") for j in range(wide)]
    return listed if first < 2 and all(listed) else []


def in_words(titles: Sequence[str], rows: Sequence[Any]) -> list[str]:
    """Titles with units that lines about the table state of their names: "time in ms, force: kN", "force unit: kN"."""
    texts = [" ".join(filter(None, map(str, r.cells))) for r in rows]
    listed = _listed(rows)
    united = [f"{t} [{listed[t]}]" if t in listed and column(t)[1] is None else t for t in titles]
    for j, title in enumerate(titles):
        if not title or column(title)[1] is not None:
            continue
        said = rf"(?i:(?<![^\W_]){re.escape(title)}(?:e?s)?(?![^\W_])(?:[ -]?axis)?)"
        how = r"\s*(?i:is in|are in|in|units?\s*[:=]?|[:=/]\s*(?:in\b)?|(?=[\[(]))\s*[\[(]?([^\s,;)\]]+)"
        found = [m for text in texts for m in re.finditer(said + how, text)]
        # "Rate (samples/sec)" says nothing of samples, nor does "200 counts/mm" of counts.
        found = [m for m in found if "/" not in m[0] or not re.search(r"[(\[]$|\d\s*$", m.string[: m.start()])]
        units = {m[1].rstrip(".") for m in found}
        units = {u for u in units if u not in "ABCDEFGHIJKLMPQRTUXYZaef" and known(u) and not is_missing(u)}
        if len(units) == 1:
            united[j] = f"{title} [{units.pop()}]"
    return united


def _listed(rows: Sequence[Any]) -> dict[str, str]:
    """The unit of each channel by its name, where a table of settings above has a column of units and a row a channel."""
    found, at = {}, 0
    for cells in ([str(c).strip("[]() ") for c in r.cells] for r in rows):
        at = next((j for j, c in enumerate(cells) if j and clock.plain(c) in _UNITS), at)
        if 0 < at < len(cells) and cells[at] and known(cells[at]) and not is_number(cells[at]):
            found.setdefault(cells[0], cells[at])
    return found


def before_names(cell: Any) -> bool:
    """Whether a cell says that names follow, as "CHANNEL_NAMES" does."""
    return isinstance(cell, str) and _BEFORE.fullmatch(cell.strip()) is not None


def inline(cells: Sequence[Any]) -> tuple[list[Any], Facts]:
    """Names without cells such as "tInc = 5e-05", and these."""
    found = [(c, m) for c in cells if isinstance(c, str) and (m := _INLINE.fullmatch(c))]
    found = [(c, m) for c, m in found if _is_known(m[1])]
    said = {c for c, _ in found}
    return ["" if c in said else c for c in cells], [(m[1], m[2]) for _, m in found]


def _pairs(cells: Sequence[Any]) -> Iterator[tuple[str, str]]:
    filled = [str(c).strip() for c in cells if not is_missing(c)]
    filled[:1] = [_KEY.sub(r"\1", c) for c in filled[:1]]
    if len(filled) > 1 and ":" not in filled[0].rstrip(": "):
        each = clock.plain(filled[0]) in (*_UNITS, *_SOURCES)
        yield filled[0].rstrip(":= "), "\t".join(filled[1:]) if each else filled[1]
    # All settings in one row.
    yield from ((a, b) for a, b in pairwise(filled[2:]) if _is_known(a))
    joined = " ".join(filled)
    for text, mark in product(dict.fromkeys([joined, *filled, *re.split(r"[,;]\s+", joined)]), ":="):
        name, _, said = text.partition(mark)
        if name.strip() and said.strip():
            yield name.strip(), said.strip()
    if found := _VALUE.fullmatch(joined):
        yield found[1], found[2]


def increments(names: Sequence[str], below: Sequence[Any]) -> Facts:
    """A start and a step in the row below the names, under names of their own."""
    found = [(n, str(c)) for n, c in zip(names, below, strict=False) if is_number(c)]
    found = [(n, c) for n, c in found if clock.is_step(str(n)) or clock.plain(str(n)) in clock.STARTS]
    return found if any(clock.is_step(n) for n, _ in found) else []


def _is_known(key: str) -> bool:
    """Whether a name is that of a setting that is used."""
    other = {*clock.STARTS, *_UNITS, *_SOURCES, "lengthunits"}
    return clock.is_step(key) or clock.is_rate(key) or clock.plain(key) in other


def titled(titles: list[str], facts: Facts, columns: Sequence[Any], named: bool) -> list[str]:
    """Titles with the units, and where the table has no names the names, that stand beside it."""
    said = {clock.plain(key): value.strip() for key, value in reversed(facts)}
    unit = next((said[key].strip("()[]") for key in _UNITS if key in said), "")
    timed = next((j for j, t in enumerate(titles) if clock.is_time(t)), None)
    even = clock.stated(facts, "") if timed is None else None
    timed = next((j for j, c in enumerate(columns) if not named and even and _steps(c, even[1])), timed)
    titles = ["time [s]" if j == timed and even else t for j, t in enumerate(titles)]
    # Of each channel its own name and unit.
    channels = [j for j in range(len(titles)) if j != timed]
    if not named and len(names := sources(facts)) == len(channels) and all(names):
        titles = [names[channels.index(j)] if j in channels else t for j, t in enumerate(titles)]
    units = [u for each in re.split(r"[\s,;|]+", unit) if (u := each.rpartition(":")[2].strip("[]()"))]  # "CH1:V,CH2:V"
    unit = units[0] if len(units) == 1 else unit
    whole = next((part for part in (channels, range(len(titles))) if len(part) == len(units) > 1), ())
    if whole and all(map(known, units)):
        marks = {j: u for j, u in zip(whole, units, strict=True) if column(titles[j])[1] is None}
        return [f"{t} [{marks[j]}]" if j in marks else t for j, t in enumerate(titles)]
    if (lengths := said.get("lengthunits", "").lower()) and known(lengths):
        titles = [f"{t} [{lengths}]" if _PLACE.fullmatch(t) else t for t in titles]
    bare = [j for j, t in enumerate(titles) if j != timed and t and column(t)[1] is None]
    bare = [j for j in bare if j or not _steps(columns[0], 1.0)]  # What counts the samples has no unit.
    if any(column(t)[1] == unit for t in titles):
        unit = ""
    if unit and (timed is not None or even) and len({re.sub(r"\d+", "#", titles[j]) for j in bare}) == 1:
        titles = [f"{t} [{unit}]" if j in bare else t for j, t in enumerate(titles)]
    return titles


def sources(facts: Facts) -> list[str]:
    """Names of the channels, in the order of these, as rows or lines beside the table state them."""
    said = {clock.plain(key): value for key, value in reversed(facts)}
    return next((said[key] for key in _SOURCES if key in said), "").split("\t")


def _steps(cells: Any, step: float) -> bool:
    try:
        first, last = (float(str(c).replace(",", ".")) for c in (cells[0], cells[-1]))
    except (ValueError, IndexError):
        return False
    return len(cells) > 1 and abs((last - first) / (len(cells) - 1) / step - 1.0) < 1e-2
