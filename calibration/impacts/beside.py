"""Runs that stand beside each other: columns of a table, or tables of a file, that hold the same readings again.

    Run 1: Time (s),Run 1: Force (N),Run 2: Time (s),Run 2: Force (N)        Time (s) Run #1,Force (N) Run #1,...
    Probe 1;;Probe 2; above Zeit;Kraft;Zeit;Kraft                            time [s],Run 1 [N],Run 2 [N]

Columns with a clock of their own, but no such label, are never read by the clock of others.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.quantities import GRAVITY
from bcfj_jax.data.clock import is_of_day, is_time, ticks
from bcfj_jax.data.record import IN_NAME, Record, statements
from bcfj_jax.io.units import column
from calibration.impacts import headers
from calibration.impacts.proposal import Hints, Part, Understood, understood

_WORDS = "run|trial|test|drop|hit|shot|impact|specimen|experiment|probe|versuch|messung|schlag|wurf|essai|data set"
# Seconds since 1970 are more than any record lasts.
_EPOCH = 1e6
# What --runs-by says where columns that are named alike but for a number are runs.
COLUMNS = "columns"
_NUMBER = re.compile(r"\d+(?:[.,]\d+)?")
_LABEL = re.compile(rf"(?i)\b(?:(?:{_WORDS})[\s#:._-]*\d+|\d+ _ \d+)\s*:?")


def label(name: str, number: re.Pattern[str] = _LABEL) -> str:
    """The part of a name that numbers a run, "" for none: "Run 2: Force (N)" has "Run 2"."""
    found = number.search(column(name)[0])
    return found[0].rstrip(" :") if found else ""


def runs(table: Record, hints: Hints) -> Understood:
    """What a table is (``understood``), of all runs that stand beside each other in it, or the one that ``hints`` name."""
    forces = [h for h in table.header if headers.read_unit(table, h) == "N"]
    alike = len({_NUMBER.sub("", h) for h in forces}) == 1
    if alike and hints.runs_by is hints.observe is None and _speeds(table, forces)[0]:
        return _by_columns(table, hints)
    if hints.runs_by == COLUMNS and COLUMNS not in table.header:
        return _by_columns(table, hints._replace(runs_by=None))
    pieces, parts = _labelled(table, _LABEL), True
    if len(pieces) < 2:
        pieces, parts = [("", piece) for piece in _clocked(table)], False
    named = [h for h in (hints.time, hints.observe) if h is not None]
    pieces = [(name, p) for name, p in pieces if all(_holds(p, h) for h in named)]
    if not pieces:
        return understood(table, hints)
    if parts or len(pieces) == 1:
        return joined([(name, understood(p, hints)) for name, p in pieces])
    found, first = [], None
    for _, piece in pieces:
        try:
            found.append(understood(piece, hints))
        except InputError as error:
            first = first or error
    if len(found) > 1:
        ways = ", or ".join(f'--time "{f.time}" --observe "{next(iter(f.columns.values()))}"' for f in found)
        raise InputError(table.name, f"{len(found)} clocks have readings that hold a contact", f"say which: {ways}")
    if not found:
        raise first or InputError(table.name, "no column is a reading", "give a record with readings")
    return found[0]


def joined(each: Sequence[tuple[str, Understood]]) -> Understood:
    """Several of the same kind as the parts of one, a record each, by their names."""
    if len(each) == 1:
        return each[0][1]
    return replace(
        each[0][1],
        records=[replace(run, name=name) for name, one in each for run in one.records],
        speeds=tuple(v for _, one in each for v in one.speeds) if all(one.speeds for _, one in each) else (),
        runs=("beside", len(each)),
        parts=tuple(Part(name, one.table, one.time, one.columns) for name, one in each),
    )


def _by_columns(table: Record, hints: Hints) -> Understood:
    """Each column that is named as the one to be read is but for a number, or else that is in its unit, as a run."""
    pieces = _labelled(table, _NUMBER)
    if hints.observe is None and len(pieces) > 1:
        return _with_speeds(table, [(name, understood(p, hints)) for name, p in pieces])
    named = hints.observe or next((h for h in table.header if headers.read_unit(table, h) in headers.READ), "")
    if not named:
        return understood(table, hints)
    read, unit = table.header[table.index(named, "--observe")], column(named)[1]
    alike, same = [h for h in table.header if _NUMBER.sub("", h) == _NUMBER.sub("", read)], column(read)[1]
    alike = alike if len(alike) > 1 else [h for h in table.header if same and column(h)[1] == same and not is_time(h)]
    if len(alike) < 2:
        way = f"take --runs-by {COLUMNS} out, or name a column beside which others stand by --observe"
        raise InputError("--runs-by", f"no other column of {table.name} is as '{read}'", way)
    each = []
    for h in alike:
        label, piece = next((p for p in pieces if h in p[1].header), (column(h)[0], table))
        time = hints.time if hints.time and _holds(piece, hints.time) else None
        said = h if column(h)[1] or not unit else f"{h} [{unit}]"
        each.append((label, understood(piece, hints._replace(observe=said, time=time))))
    return _with_speeds(table, each)


def _with_speeds(table: Record, each: list[tuple[str, Understood]]) -> Understood:
    """Runs in columns as one, each with the speed that its column's name or a list beside the table states."""
    speeds, unit = _speeds(table, [next(iter(one.columns.values())) for _, one in each])
    own = zip(each, speeds, strict=True) if speeds and all(len(one.records) == 1 for _, one in each) else ()
    return joined([(name, replace(one, speeds=(v,), given=("", unit))) for (name, one), v in own] or each)


def _speeds(table: Record, names: Sequence[str]) -> tuple[tuple[float, ...], str]:
    """Speeds [m/s] of columns of runs by their names, "F @ 0.5 m/s [N]", or by as many beside the table, and what gives them."""
    for header in IN_NAME:
        found, unit = statements(table, header, *names)[0], str(column(header)[1])
        if len(found) == len(names) > 1:
            return tuple(math.sqrt(2.0 * GRAVITY * x) if unit == "m" else x for x in found), unit
    return (), ""


def _holds(piece: Record, header: str) -> bool:
    try:
        return piece.index(header, "") >= 0
    except InputError:
        return False


def _part(table: Record, keep: Sequence[int]) -> Record:
    """Some columns of a table, without the rows at the end of a shorter one."""
    header, columns = tuple(table.header[j] for j in keep), tuple(table.columns[j] for j in keep)
    marks = tuple(table.decimals[j] for j in keep) if table.decimals else ()
    return replace(table, header=header, columns=columns, decimals=marks).held(header)


def _labelled(table: Record, number: re.Pattern[str]) -> list[tuple[str, Record]]:
    """The columns of each label, with those that have none, where all labels have the same columns."""
    labels = [label(h, number) for h in table.header]
    groups = {name: [j for j, x in enumerate(labels) if x == name] for name in dict.fromkeys(labels) if name}
    same = {tuple(number.sub("", table.header[j]).strip() for j in group) for group in groups.values()}
    # A mean of the runs stands beside them, and is none of one.
    units = {u for group in groups.values() for j in group if (u := column(table.header[j])[1])}
    shared = [j for j, h in enumerate(table.header) if not labels[j] and (is_time(h) or column(h)[1] not in units)]
    return [(name, _part(table, [*shared, *group])) for name, group in groups.items()] if len(same) == 1 else []


def _clocked(table: Record) -> list[Record]:
    """The columns behind each of several clocks, where the first column is one and the clocks differ."""
    days = [is_of_day(next(iter(c[:1].tolist()), "")) for c in table.columns]
    at = [j for j, h in enumerate(table.header) if h and (days[j] or is_time(h)) and ticks(table.columns[j])]
    blocks = [list(range(a, b)) for a, b in pairwise([*at, len(table.header)]) if b > a + 1]
    if len(blocks) < 2 or at[0] > 0:
        return []
    clocks = []
    for block in blocks:
        try:
            clock = table.numbers(table.header[block[0]], "s", table.name, True)
        except InputError:
            return []
        clocks.append(clock[np.isfinite(clock)])
    if not all(c.size for c in clocks):
        return []
    # A time of day beside one since the start is the same clock; one that begins later is not.
    first, day = clocks[0], any(days[block[0]] for block in blocks)

    def same(other: np.ndarray) -> bool:
        late = other[:1] - first[:1] if day or abs(float(other[0] - first[0])) > _EPOCH else 0.0
        near = 1e-9 + 1e-6 * float(np.ptp(first))
        return other.size == first.size and np.allclose(other - late, first, rtol=0.0, atol=near)

    return [] if all(map(same, clocks)) else [_part(table, block) for block in blocks]
