"""MDF 4 (and 3) by asammdf: a table for each group of channels, with the clock that the group has."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcfj_jax.data.columns import Column, Columns, Content, Tables, text, vector

KINDS, LIBRARY = (".mf4", ".mdf", ".dat4"), "asammdf"
SIGNATURE = rb"MDF     |UnFinMF "


def read(file: str, wanted: str) -> Content:
    """The channels of each group, physical values."""
    from asammdf import MDF

    tables: Tables = {}
    content: Any = MDF(file)
    for k, group in enumerate(content.groups):
        columns: Columns = {}
        master = content.masters_db.get(k)
        for j, channel in enumerate(group.channels):
            if j == master:
                clock = np.asarray(content.get_master(k), dtype=float)
                columns["time"] = Column("s", clock.size, lambda clock=clock: clock)
                continue
            signal = content.get(group=k, index=j)
            values = np.asarray(signal.samples)
            if found := vector(values, signal.unit):
                columns[channel.name] = found
        name = text(getattr(group.channel_group, "acq_name", "")) or f"group {k + 1}"
        if len(columns) > ("time" in columns):
            tables[name if name not in tables else f"{name} {k + 1}"] = columns
    unfinished = str(getattr(content, "identification", None) and content.identification.file_identification)
    return Content(tables, "the file was not finished by its writer" if "UnFin" in unfinished else "")
