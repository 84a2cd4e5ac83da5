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


def table(given: Any, unit: str, where: str, folder: Path | None = None, over: str = "s") -> list[list[float]]:
    """[[times], [values]] in SI, of such rows, whose numbers may be texts with a unit, or the name of a CSV file.

    ``over``: the unit of the first row. A name counts from the scene file's ``folder``; without one from the working directory.
    """
    if isinstance(given, str):
        return _read((folder or Path()) / given, unit, where)
    if not (
        isinstance(given, (list, tuple)) and len(given) == 2 and all(isinstance(row, (list, tuple)) for row in given)
    ):
        remedy = "give [[times], [values]], or the name of a CSV file"
        raise InputError(where, f"{clip(str(given))} is no table", remedy)
    return [
        [quantity(x, one, f"{where}[{i}][{k}]") for k, x in enumerate(row)]
        for i, (row, one) in enumerate(zip(given, (over, unit), strict=True))
    ]


def _read(path: Path, unit: str, where: str) -> list[list[float]]:
    raw = content(path, 16 * MEGABYTE, where, _REMEDY, "leave out rows that a line between their neighbours replaces")
    place = f"{where} {clip(str(path))}"
    try:
        rows = [row for row in csv.reader(io.StringIO(raw.decode("utf-8-sig"))) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(place, f"is no CSV file: {error}", _REMEDY) from None
    for k, row in enumerate(rows, 1):
        if len(row) != 2:
            raise InputError(place, f"row {k} has {len(row)} cells", _REMEDY)
    if not 3 <= len(rows) <= _MOST:
        remedy = _REMEDY if len(rows) < 3 else f"give at most {_MOST}"
        raise InputError(place, f"has {len(rows)} rows", remedy)
    units = [(column(head)[1] or own, own) for head, own in zip(rows[0], ("s", unit), strict=True)]
    return [
        [quantity(f"{row[i].strip()} {stated}", own, f"{place}, row {k}") for k, row in enumerate(rows[1:], 2)]
        for i, (stated, own) in enumerate(units)
    ]


def resolved(content: Mapping[str, Any], folder: Path | None, where: str) -> dict[str, Any]:
    """A scene file's content, its tables over time as SI numbers; what else is in it stays as it is, unchecked."""
    found = dict(content)
    scene, loads = found.get("scene"), found.get("load")
    if isinstance(scene, Mapping) and scene.get("kind") == "joint":
        found["scene"] = dict(scene)
        for key, unit in OF_JOINT.items():
            if scene.get(key) is not None:
                found["scene"][key] = table(scene[key], unit, f"{where}: [scene] {key}", folder)
    if isinstance(loads, list):
        found["load"] = list(loads)
        for k, entry in enumerate(loads):
            if isinstance(entry, Mapping) and isinstance(entry.get("table"), str) and entry.get("kind") in OF_LOADS:
                place = f"{where}: [[load]] {k + 1} table"
                found["load"][k] = {**entry, "table": table(entry["table"], OF_LOADS[entry["kind"]], place, folder)}
    return found
