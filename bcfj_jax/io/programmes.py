"""Tables over time for drives and loads: rows of a scene file, or a CSV file with two columns, as SI numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bcfj_jax.core.errors import InputError, clip
from bcfj_jax.io.opening import MEGABYTE, content
from bcfj_jax.io.units import column, quantity

# Options of the scene ``joint`` that hold a table, with the unit of its values.
OF_JOINT = {"drive_table": "rad/s", "load_table": "N m", "axial_table": "N"}
# Loads of a mechanism that may follow one.
OF_LOADS = {"force": "N", "torque": "N m"}
# A table is a constant of the program: more points compile slowly.
_MOST = 100_000
_REMEDY = 'give a CSV file with a head such as "time [s],torque [kN m]" and a row a point'


def table(given: Any, unit: str, where: str, folder: Path | None = None) -> list[list[float]]:
    """[[times], [values]] in SI, of such rows, whose numbers may be texts with a unit, or the name of a CSV file.

    A name counts from the scene file's ``folder``; without one from the working directory.

    Raises:
        InputError: for a file that cannot be read, cells that are no numbers of the unit, and rows of unlike lengths.
    """
    if isinstance(given, str):
        return _read((folder or Path()) / given, unit, where)
    if not (
        isinstance(given, (list, tuple)) and len(given) == 2 and all(isinstance(row, (list, tuple)) for row in given)
    ):
        raise InputError(
            where, f"{clip(str(given))} is no table", "give [[times], [values]], or the name of a CSV file"
        )
    return [
        [quantity(x, one, f"{where}[{i}][{k}]") for k, x in enumerate(row)]
        for i, (row, one) in enumerate(zip(given, ("s", unit), strict=True))
    ]


def _read(path: Path, unit: str, where: str) -> list[list[float]]:
    raw = content(path, 16 * MEGABYTE, where, _REMEDY, "leave out rows that a line between their neighbours replaces")
    shown = clip(str(path))
    try:
        rows = [row for row in csv.reader(io.StringIO(raw.decode("utf-8-sig"))) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{where} {shown}", f"is no CSV file: {error}", _REMEDY) from None
    if len(rows) < 3 or any(len(row) != 2 for row in rows):
        bad = next((k + 1 for k, row in enumerate(rows) if len(row) != 2), None)
        found = f"row {bad} has {len(rows[bad - 1])} cells" if bad else f"has {len(rows)} rows"
        raise InputError(f"{where} {shown}", found, _REMEDY)
    if len(rows) > _MOST:
        raise InputError(f"{where} {shown}", f"has {len(rows)} rows", f"give at most {_MOST}")
    made: list[list[float]] = [[], []]
    for i, (head, own) in enumerate(zip(rows[0], ("s", unit), strict=True)):
        stated = column(head)[1] or own
        for k, row in enumerate(rows[1:], 2):
            cell = row[i].strip()
            made[i].append(quantity(f"{cell} {stated}", own, f"{where} {shown}, row {k}"))
    return made


def resolved(content: Mapping[str, Any], folder: Path | None, where: str) -> dict[str, Any]:
    """A scene file's content, its tables over time as SI numbers; what else is in it stays as it is, unchecked."""
    found = dict(content)
    scene = found.get("scene")
    if isinstance(scene, Mapping) and scene.get("kind") == "joint":
        found["scene"] = {
            key: table(value, OF_JOINT[key], f"{where}: [scene] {key}", folder)
            if key in OF_JOINT and value is not None
            else value
            for key, value in scene.items()
        }
    loads = found.get("load")
    if isinstance(loads, list):
        found["load"] = [_load(entry, folder, f"{where}: [[load]] {k + 1} table") for k, entry in enumerate(loads)]
    return found


def _load(entry: Any, folder: Path | None, where: str) -> Any:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("table"), str) or entry.get("kind") not in OF_LOADS:
        return entry
    return {**entry, "table": table(entry["table"], OF_LOADS[entry["kind"]], where, folder)}
