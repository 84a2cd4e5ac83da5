"""What a reader of a binary file hands on: columns by name, tables by path, and a clock where channels have one of their own.

This file and the readers import NumPy alone at their top, for the start of the process that reads (``child``) is most of what
reading a file costs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

UNIT_NAMES = ("unit", "units")
# What a channel of samples without a physical unit is in: a share of its full scale.
FULL_SCALE = "FS"


class Refused(Exception):
    """What is wrong with a file, and the remedy."""


class Column(NamedTuple):
    """A column that is there: its unit, its number of values, and how to read them."""

    unit: str | None
    size: int
    values: Callable[[], Any]


# The columns of a table by name, and the tables of a file by path; "" is what stands outside any group.
Columns = dict[str, Column]
Tables = dict[str, Columns]


class Content(NamedTuple):
    """What a file holds: its tables, or of a spreadsheet its sheets of numbered rows; and what it lacks, "" for nothing."""

    tables: Tables
    note: str = ""
    sheets: dict[str, list] = {}


class Sampled(NamedTuple):
    """A channel with a clock of its own: values (N,), sampled from ``start`` [s] every ``step`` [s]."""

    name: str
    unit: str | None
    values: np.ndarray
    start: float
    step: float


def vector(values: np.ndarray, unit: object = None) -> Column | None:
    """An array as a column, or None for what is none: a matrix, a reference, a complex number."""
    if values.dtype.kind not in "iufbOSUMm" or (values.ndim and max(values.shape) != values.size):
        return None
    if values.dtype.kind == "O" and not all(isinstance(v, str) for v in values.flat):
        return None
    return Column(text(unit), values.size, lambda: values)


def stated(properties: Mapping[str, Any]) -> Columns:
    """What properties of a file, group, dataset or struct state: single values, and lists of texts, as names of columns are."""
    plain = {str(k): np.asarray(v).ravel() for k, v in properties.items() if not isinstance(v, (Mapping, list))}
    kept = {k: v for k, v in plain.items() if v.dtype.kind in ("OUS" if v.size > 1 else "iufOUS") and v.size <= 64}
    return {k: c for k, v in kept.items() if k.lower() not in UNIT_NAMES and (c := vector(v))}


def alone(struct: Mapping[str, Any]) -> Columns:
    """Single values that a struct states about all in it, also those of structs of nothing else, as of one "meta"."""
    single, inner = (str, int, float, np.generic), [v for v in struct.values() if isinstance(v, Mapping)]
    notes = [v for v in inner if all(isinstance(x, single) for x in v.values())]
    every = {k: c for part in (*notes, struct) for k, c in stated(part).items()}
    return {k: c for k, c in every.items() if c.size == 1 and k[:2] != "__" and k not in ("name", "label")}


def matrix(name: str, values: np.ndarray, names: Sequence[str] = (), units: Sequence[str] = ()) -> Columns:
    """The columns of a matrix (N, m) or (m, N) of numbers, m the smaller, by as many names and units; none of anything else."""
    if values.ndim != 2 or values.dtype.kind not in "iuf" or min(values.shape) < 2 or min(values.shape) > 64:
        return {}
    tall = values if values.shape[0] >= values.shape[1] else values.T
    named = names if len(set(names)) == tall.shape[1] else [f"{name} {j + 1}" for j in range(tall.shape[1])]
    own = units if len(units) == tall.shape[1] else [None] * tall.shape[1]
    return {named[j]: Column(text(own[j]), len(tall), lambda j=j: tall[:, j]) for j in range(tall.shape[1])}


def group(columns: Columns, matrices: dict[str, np.ndarray]) -> Columns:
    """Vectors, single values and matrices that stand together as one table.

    Beside vectors of numbers a matrix counts if it is as long at least; texts as many as its columns are the names of these.
    """
    few = {n: np.asarray(c.values()) for n, c in columns.items() if 1 < c.size <= 64}
    texts = {n: v for n, v in few.items() if v.dtype.kind in "OUS"}
    longest = max((c.size for n, c in columns.items() if c.size > 1 and n not in texts), default=0)
    made: Columns = {}
    for name, values in matrices.items():
        units = next((v.tolist() for n, v in texts.items() if n.lower().endswith(UNIT_NAMES)), ())
        names = (n for n, v in texts.items() if v.size == min(values.shape) and not n.lower().endswith(UNIT_NAMES))
        names = next(names, "")
        found = matrix(name, values, [str(text(t)) for t in texts[names].tolist()] if names else (), units)
        if found and longest <= max(values.shape):
            made |= found
            columns = {n: c for n, c in columns.items() if n != names}
    return {**{n: c for n, c in columns.items() if not made or n not in texts or c.size == longest}, **made}


def headed(struct: Mapping[str, Any]) -> dict[str, Any]:
    """A struct in which "Channel_1_Data" and the struct "Channel_1_Header" about it (catman) are one channel."""
    heads = {
        n.replace("_Header", "_Data"): v for n, v in struct.items() if n.endswith("_Header") and isinstance(v, Mapping)
    }
    own = {n: {**v, "name": v.get("SignalName"), "unit": v.get("Unit")} for n, v in heads.items() if n in struct}
    kept = {n: v for n, v in struct.items() if n.replace("_Header", "_Data") not in own}
    # Structs of "Name", "Data" and "Unit", one or a list of them (dSPACE), are channels by their names.
    for n, v in [*kept.items()]:
        each: list[Any] = [*v] if isinstance(v, list) or (isinstance(v, np.ndarray) and v.dtype.kind == "O") else [v]
        if all(isinstance(c, Mapping) and {"Name", "Data"} <= c.keys() for c in each) and each:
            del kept[n]
            kept |= {str(text(c["Name"])): {k.lower(): x for k, x in c.items()} for c in each}
    return kept | {n: {**v, "values": struct[n]} for n, v in own.items()}


def text(value: object) -> str | None:
    """A text in any of the forms in which files hold one."""
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value).strip() or None if isinstance(value, str) else None


def wrong_length(size: int, *stated: int) -> str:
    """What is said of a file whose size [bytes] is none of those that its head states; "" of one that has such a size."""
    if size in stated:
        return ""
    least = min(stated)
    return (
        f"the file is cut off: it lacks {least - size} bytes" if size < least
        else f"the file has {size - least} bytes more than it states: samples may be wrong"
    )  # fmt: skip


def sampled(path: str, channels: Sequence[Sampled]) -> Tables:
    """Channels as tables, each with its clock "time": one where all share it, else one a clock, named after its first channel."""
    by_clock: dict[tuple[float, float, int], list[Sampled]] = {}
    for channel in channels:
        by_clock.setdefault((channel.start, channel.step, channel.values.size), []).append(channel)
    tables: Tables = {}
    for (start, step, size), group in by_clock.items():
        names = [c.name for c in group]
        columns: Columns = {"time": Column("s", size, lambda a=start, b=step, n=size: a + b * np.arange(n))}
        for k, c in enumerate(group):
            name = c.name if names.count(c.name) == 1 and c.name not in columns else f"{c.name} {k + 1}"
            columns[name] = Column(c.unit, size, lambda values=c.values: values)
        tables[path if len(by_clock) == 1 else f"{path}/{names[0]}".strip("/")] = columns
    return tables


def with_units(tables: Tables) -> Tables:
    """Units from a struct of texts named ``units`` inside a struct, which is then no table of its own."""
    united: Tables = {}
    for name, columns in tables.items():
        parent, _, own = name.rpartition("/")
        if own in UNIT_NAMES and parent in tables:
            continue
        beside: Iterable[Columns] = (tables.get(f"{name}/{key}".strip("/"), {}) for key in UNIT_NAMES)
        units = {k: text(np.asarray(c.values())) for texts in beside for k, c in texts.items() if c.size == 1}
        united[name] = {k: c._replace(unit=c.unit or units.get(k)) for k, c in columns.items()}
    return united
