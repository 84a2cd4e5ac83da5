"""TDMS of LabVIEW by npTDMS: a table for each group, ``unit_string``; waveforms with different clocks are tables of their own."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from bcfj_jax.data.columns import Columns, Content, Refused, Sampled, Tables, sampled, text, vector

KINDS, LIBRARY = (".tdms",), "nptdms"
# A segment begins with a tag, its content's bits, a version, and the lengths of itself and of its description [bytes].
_TAG, _LEAD, _UNKNOWN, _SHOWN = b"TDSm", 28, 1 << 62, 4


def sniff(head: bytes) -> bool:
    """Named files alone; of others the bytes are shown (``decoding``)."""
    del head
    return False


def read(file: str, wanted: str) -> Content:
    """The columns of every group; raises ``Refused`` where the library does not know how values are scaled."""
    del wanted
    import nptdms

    tables: Tables = {}
    with _listening() as said, nptdms.TdmsFile.read(file) as content:
        for group in content.groups():
            columns, waves = Columns(), []
            for channel in group.channels():
                values, has = np.asarray(channel[:]), channel.properties
                if found := vector(values, has.get("unit_string")):
                    columns[channel.name] = found
                    if "wf_increment" in has and values.size and values.dtype.kind in "iuf":
                        waves.append((channel.name, found.unit, values, has))
            named = "time" in {name.partition("[")[0].strip().lower() for name in columns}
            if waves and not named:  # A waveform has its clock in its properties instead of in a channel.
                tables |= _waves(group.name, columns, waves)
            else:
                tables[group.name] = columns
        cut = _cut(content.file_status, file)
    if any(line.startswith("Unsupported scale") for line in said):
        found = f"npTDMS cannot scale its values, {'; '.join(dict.fromkeys(said))[:200]}"
        raise Refused(found, "write the scaled values to a new file, or to CSV")
    return Content(tables, cut)


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


def _cut(status: Any, file: str) -> str:
    """What the last segment of a TDMS file lacks, as far as the file says it; "" where the file is whole."""
    lacking = {
        name.replace("'", "").strip("/"): one.expected_length - one.read_length
        for name, one in (status.channel_statuses or {}).items()
        if one.read_length < one.expected_length
    }
    beyond = _beyond_the_end(file)
    if not (lacking or status.incomplete_final_segment or beyond):
        return ""
    named = [f"{count} of '{name[:40]}'" for name, count in list(lacking.items())[:_SHOWN]]
    more = f" and of {len(lacking) - _SHOWN} more channels" if len(lacking) > _SHOWN else ""
    # A writer that was ended has not put its segment's length in.
    size = f"{beyond} bytes" if beyond and beyond < _UNKNOWN else "how many is not known"
    what = f"at least {', '.join(named)}{more}" if named else size
    return f"the file is cut off: values are missing at its end ({what})"


def _beyond_the_end(file: str) -> int:
    """How many bytes a TDMS file lacks, by the lengths that its segments state; 0 of a whole one."""
    size, at = os.stat(file).st_size, 0
    with open(file, "rb") as content:
        while at < size:
            content.seek(at)
            lead = content.read(_LEAD)
            if len(lead) < _LEAD or lead[:4] != _TAG:
                return _UNKNOWN
            # Bit 6 of the content: the numbers stand with the highest byte first.
            order = "big" if lead[4] & 64 else "little"
            at += _LEAD + int.from_bytes(lead[12:20], order)
    return at - size
