"""C3D by ezc3d: force plates (force and moment in the plate's axes), analog channels, and points, a table each."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcfj_jax.data.columns import Content, Sampled, Tables, sampled

KINDS, LIBRARY = (".c3d",), "ezc3d"
# The second byte of a C3D file.
_KEY = 0x50


def sniff(head: bytes) -> bool:
    """Named files alone: two bytes are too few to tell."""
    del head
    return False


def read(file: str, wanted: str) -> Content:
    """The plates; analog channels only where no plate uses them; the places of points where there are some."""
    del wanted
    import ezc3d

    content: Any = ezc3d.c3d(file, extract_forceplat_data=True)
    has, head, tables = content["parameters"], content["header"], Tables()
    rate = float(head["analogs"]["frame_rate"])
    plates = content["data"].get("platform", [])
    for k, plate in enumerate(plates):
        force, moment = np.asarray(plate["force"]), np.asarray(plate["moment"])
        units = str(plate.get("unit_force", "N")), str(plate.get("unit_moment", "N m"))
        axes = [("F", force, units[0]), ("M", moment, units[1].replace("Nmm", "N mm"))]
        channels = [
            Sampled(f"{letter}{axis}", unit, values[j], 0.0, 1.0 / rate)
            for letter, values, unit in axes
            for j, axis in enumerate("xyz")
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
    return Content(tables)


def _texts(parameter: Any) -> list[str]:
    return [str(x).strip() for x in parameter["value"]] if parameter else []
