"""C3D by ezc3d: force plates (force, moment and centre of pressure), analog channels, and points, a table each."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcfj_jax.data.columns import Content, Sampled, Tables, sampled

KINDS, LIBRARY = (".c3d",), "ezc3d"
SIGNATURE = b""


def read(file: str, wanted: str) -> Content:
    """The plates; analog channels only where no plate uses them; the places of points where there are some."""
    import ezc3d

    note = ""
    try:
        content: Any = ezc3d.c3d(file, extract_forceplat_data=True)
    except ValueError as error:
        content = ezc3d.c3d(file)
        note = f"its force plates are not described in full ({error}): its analog channels are given"
    has, head, tables = content["parameters"], content["header"], Tables()
    rate = float(head["analogs"]["frame_rate"])
    plates = content["data"].get("platform", [])
    for k, plate in enumerate(plates):
        units = {
            key: str(plate.get(f"unit_{key}", "")).replace("Nmm", "N mm") for key in ("force", "moment", "position")
        }
        read = [
            ("F", "force", "xyz", "force"),
            ("M", "moment", "xyz", "moment"),
            ("COP ", "center_of_pressure", "xy", "position"),
        ]
        channels = [
            Sampled(f"{letter}{axis}", units[unit] or None, np.asarray(plate[key])[j], 0.0, 1.0 / rate)
            for letter, key, axes, unit in read
            for j, axis in enumerate(axes)
        ]
        tables |= sampled(f"plate {k + 1}", channels)
    analogs = np.asarray(content["data"]["analogs"])
    if analogs.size and not plates:
        names, units = (_texts(has["ANALOG"].get(key)) for key in ("LABELS", "UNITS"))
        channels = [
            Sampled(
                names[j] if j < len(names) else f"channel {j + 1}", units[j] if j < len(units) else None,
                row, 0.0, 1.0 / rate,
            )
            for j, row in enumerate(analogs[0])
        ]  # fmt: skip
        tables |= sampled("analog", channels)
    points = np.asarray(content["data"]["points"])
    if points.size and points.shape[1]:
        slow, unit = float(head["points"]["frame_rate"]), (_texts(has["POINT"].get("UNITS")) or ["mm"])[0]
        names = _texts(has["POINT"].get("LABELS"))
        channels = [
            Sampled(f"{names[j]} {axis}", unit, points[i, j], 0.0, 1.0 / slow)
            for j in range(points.shape[1])
            for i, axis in enumerate("xyz")
        ]
        tables |= sampled("points", channels)
    return Content(tables, note)


def _texts(parameter: Any) -> list[str]:
    return [str(x).strip() for x in parameter["value"]] if parameter else []
