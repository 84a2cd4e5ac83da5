"""TDMS of LabVIEW by npTDMS: a table for each group, ``unit_string``; waveforms with different clocks are tables of their own."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from typing import Any

import numpy as np

from bcfj_jax.data.columns import Columns, Content, Refused, Sampled, Tables, sampled, stated, text, vector
from bcfj_jax.data.tdms_segments import cut

KINDS, LIBRARY = (".tdms",), "nptdms"
SIGNATURE = b""


def read(file: str, wanted: str) -> Content:
    """The columns of every group; raises ``Refused`` where the library does not know how values are scaled."""
    import nptdms

    tables: Tables = {}
    with _listening() as said, nptdms.TdmsFile.read(file) as content:
        for group in content.groups():
            columns, waves = Columns(), []
            for channel in group.channels():
                values, has = np.asarray(channel[:]), channel.properties
                if found := vector(values, has.get("unit_string") or has.get("NI_UnitDescription")):
                    columns[channel.name] = found
                    if "wf_increment" in has and values.size and values.dtype.kind in "iuf":
                        waves.append((channel.name, found.unit, values, has))
            named = "time" in {name.partition("[")[0].strip().lower() for name in columns}
            if waves and not named:  # A waveform has its clock in its properties instead of in a channel.
                tables |= _waves(group.name, columns, waves)
            else:
                tables[group.name] = columns
            beside = stated({k: v for k, v in {**content.properties, **group.properties}.items() if k != "name"})
            for name in [n for n in tables if columns and (n == group.name or n.startswith(f"{group.name}/"))]:
                tables[name] = {**beside, **tables[name]}
        lacking = cut(content.file_status, file)
    if any(line.startswith("Unsupported scale") for line in said):
        found = f"npTDMS cannot scale its values, {'; '.join(dict.fromkeys(said))[:200]}"
        raise Refused(found, "write the scaled values to a new file, or to CSV")
    return Content(tables, lacking)


def _waves(group: str, columns: Columns, waves: list[tuple[str, str | None, np.ndarray, Any]]) -> Tables:
    """Waveforms by clock: the time at which each began, its offset and its increment."""
    begun = [has.get("wf_start_time") for *_, has in waves]
    known = [np.datetime64(b, "ns") for b in begun if b is not None]
    if len(known) != len(waves):
        known = []
    channels = []
    for k, (name, unit, values, has) in enumerate(waves):
        late = 1e-9 * float((known[k] - min(known)).astype("timedelta64[ns]").astype(int)) if known else 0.0
        channels.append(
            Sampled(name, text(unit), values, late + float(has.get("wf_start_offset", 0.0)), float(has["wf_increment"]))
        )
    found = sampled(group, channels)
    if len(found) == 1:  # A text or a number beside waveforms of one clock stays with them.
        size = channels[0].values.size
        more = {n: c for n, c in columns.items() if n not in found[group] and c.size in (1, size)}
        found[group].update(more)
    return found


@contextlib.contextmanager
def _listening() -> Iterator[list[str]]:
    """Within, what npTDMS says through loggers of its own is collected."""
    said: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    from nptdms.log import log_manager

    ear = Ear(logging.WARNING)
    for logger in log_manager.loggers.values():
        logger.addHandler(ear)
    yield said
