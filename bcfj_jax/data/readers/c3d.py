"""C3D by ezc3d: force plates (force, moment and centre of pressure), analog channels, and points, a table each."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from bcfj_jax.data.columns import Content, Sampled, Tables, sampled, wrong_length

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
    return Content(tables, "; ".join(filter(None, (note, _length(file)))))


def _length(file: str) -> str:
    """Whether the file is shorter or longer than its head states: frames of points and analog values, in blocks of 512 bytes."""
    with open(file, "rb") as content:
        head, size = content.read(512), content.seek(0, 2)
        content.seek(512 * (head[0] - 1) + 3)
        processor = content.read(1)
    points, analog, first, last = struct.unpack("<4H", head[2:10])
    scale, begin = struct.unpack("<fH", head[12:18])
    # Words of other processors are of another order, and of long records the last frame stands elsewhere.
    if processor != b"\x54" or last == 0xFFFF or last < first:
        return ""
    end = 512 * (begin - 1) + (last - first + 1) * (4 * points + analog) * (4 if scale < 0.0 else 2)
    return wrong_length(size, end, -(-end // 512) * 512)


def _texts(parameter: Any) -> list[str]:
    return [str(x).strip() for x in parameter["value"]] if parameter else []
