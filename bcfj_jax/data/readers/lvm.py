"""LabVIEW measurement files (.lvm): segments with a head each, whose channels have starts and steps of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcfj_jax.data.columns import Column, Content, Refused, Sampled, Tables, sampled

KINDS, LIBRARY = (".lvm",), ""
SIGNATURE = rb"[\xef\xbb\xbf]*LabVIEW Measurement"
_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}


def read(file: str, wanted: str) -> Content:
    """Its segments: as one table with a column "segment" where all hold the same channels of one clock, else a table each."""
    with open(file, encoding="utf-8", errors="replace", newline=None) as content:
        lines = content.read().split("\n")
    if not any(line.startswith("LabVIEW Measurement") for line in lines[:3]):
        raise Refused("it does not begin with 'LabVIEW Measurement'", "name a text table .txt or .csv")
    first = lines[0].lstrip("\ufeff")
    separator = next((s for s in "\t;," if first.endswith(s)), "\t")
    head = dict(line.split(separator)[:2] for line in lines[1:40] if separator in line)
    separator = _SEPARATORS.get(head.get("Separator", "").strip().lower(), separator)
    comma, kind = head.get("Decimal_Separator", ".").strip() == ",", head.get("X_Columns", "One").strip()
    ends = [k for k, line in enumerate(lines) if line.startswith(_END)]
    if len(ends) < 2:
        raise Refused("it has no head of a segment", "write the file with its headers, or name it .txt")
    parts = [_segment(lines, ends[k : k + 3], separator, comma, kind) for k in range(1, len(ends))]
    if len(parts) == 1 or not all(len(p) == 1 for p in parts):
        named = [(f"segment {k + 1}" if len(parts) > 1 else "", p) for k, p in enumerate(parts)]
        return Content({f"{s}/{n}".strip("/"): columns for s, p in named for n, columns in p.items()})
    tables = [next(iter(p.values())) for p in parts]
    if len({tuple((n, c.unit) for n, c in t.items()) for t in tables}) > 1:
        return Content({f"segment {k + 1}": t for k, t in enumerate(tables)})
    sizes = [next(iter(t.values())).size for t in tables]
    joined = {
        name: Column(c.unit, sum(sizes), lambda name=name: np.concatenate([t[name].values() for t in tables]))
        for name, c in tables[0].items()
    }
    numbers = np.repeat(np.arange(1, len(sizes) + 1), sizes)
    return Content({"": {"segment": Column(None, numbers.size, lambda: numbers), **joined}})


def _segment(lines: Sequence[str], ends: Sequence[int], separator: str, comma: bool, kind: str) -> Tables:
    """The channels of the segment whose head ends at the first of ``ends``, before the head of the next."""
    begin, stop = ends[0] + 1, len(lines)
    if len(ends) > 1:  # The head of the next begins at its number of channels.
        stop = next(k for k in range(ends[1], begin, -1) if lines[k].startswith("Channels"))
    top = next(k for k in range(ends[0], 0, -1) if lines[k].startswith("Channels"))
    said = {cells[0]: cells[1:] for cells in (line.split(separator) for line in lines[top : ends[0]])}
    count = int(float(said["Channels"][0]))
    names, rows = lines[begin].split(separator), [line for line in lines[begin + 1 : stop] if line.strip()]
    rows = [[c.strip() for c in (row.replace(",", ".") if comma else row).split(separator)] for row in rows]
    # The last column holds comments; of several clocks one stands before each channel.
    own = kind.lower() == "multi"
    at = [2 * j + 1 if own else j + 1 for j in range(count)]
    if any(len(row) <= at[-1] for row in rows) or len(names) <= at[-1]:
        short = next((k for k, row in enumerate(rows) if len(row) <= at[-1]), 0)
        raise Refused(f"line {begin + 2 + short} holds fewer cells than {count} channels need", "complete the row")
    channels = []
    for j, k in enumerate(at):
        texts = [row[k] for row in rows]
        while own and texts and not texts[-1]:
            texts.pop()  # A channel that has fewer samples than the longest.
        stated = int(float(_of(said, "Samples", j, len(texts))))
        if stated != len(texts) and not (own and stated < len(texts)):
            raise Refused(f"'{names[k]}' states {stated} samples and holds {len(texts)}", "record the file again")
        start, step = float(_of(said, "X0", j, 0)), float(_of(said, "Delta_X", j, 0))
        if not step > 0.0:
            raise Refused(f"'{names[k]}' has a step of {step:g} s", "write the file with X_Columns = One")
        values = np.array([float(text) for text in texts])
        if kind.lower() == "one" and not own and (uneven := _uneven([row[0] for row in rows], start, step)):
            raise Refused(
                f"its X_Value leaves X0 and Delta_X by {uneven:.3g} steps", "write it with X_Columns = No, or as CSV"
            )
        unit = str(_of(said, "Y_Unit_Label", j, "")).strip()
        channels.append(Sampled(names[k].strip() or f"channel {j + 1}", unit or None, values, start, step))
    return sampled("", channels)


def _uneven(texts: Sequence[str], start: float, step: float) -> float:
    """By how many steps the first column leaves the stated clock, where by more than it may be rounded; else 0."""
    if not all(texts):
        return 0.0
    away = np.abs(np.array([float(t) for t in texts]) - start - step * np.arange(len(texts)))
    return float(away.max() / step) if away.max() > 0.6 * step + 1e-6 else 0.0


def _of(said: dict[str, list[str]], key: str, j: int, default: object) -> str:
    cells = [c for c in said.get(key, []) if c.strip()]
    return cells[min(j, len(cells) - 1)].replace(",", ".") if cells else str(default)
