"""TDMS files by npTDMS: its groups, and what a file that was cut off lacks."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.errors import clip
from bcfj_jax.io.units import column
from calibration.data.child import Column, Columns, Tables, vector

# A segment begins with a tag, its content's bits, a version, and the lengths of itself and of its description [bytes].
_TAG, _LEAD = b"TDSm", 28
_UNKNOWN = 1 << 62
_SHOWN = 4


def read(path: Path, where: str, nptdms: Any) -> tuple[Tables, str]:
    """The columns of every group, and a note on what is missing from them; "" for nothing.

    Raises:
        InputError: where the library does not know how a channel's values are scaled.
    """
    tables: Tables = {}
    with _listening() as said, nptdms.TdmsFile.read(path) as content:
        for group in content.groups():
            columns: Columns = {}
            for channel in group.channels():
                found = vector(np.asarray(channel[:]), channel.properties.get("unit_string"))
                if found:
                    columns[channel.name] = found
            # A waveform has its clock in its properties instead of in a channel.
            waves = [c for c in group.channels() if "wf_increment" in c.properties and len(c)]
            clocks = {(c.properties["wf_increment"], c.properties.get("wf_start_offset", 0.0)) for c in waves}
            if "time" not in {column(name)[0].lower() for name in columns} and len(clocks) == 1:
                columns["time"] = Column("s", len(waves[0]), waves[0].time_track)
            tables[group.name] = columns
        cut = _cut(content.file_status, path)
    if any(text.startswith("Unsupported scale") for text in said):
        found = f"{path}: npTDMS cannot scale its values ({clip('; '.join(dict.fromkeys(said)))})"
        raise InputError(where, found, "write the scaled values to a new file, or to CSV")
    return tables, cut


@contextmanager
def _listening() -> Iterator[list[str]]:
    """Within, the library's words are collected instead of printed; it warns through loggers of its own."""
    said: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    from nptdms.log import log_manager

    ear, before = Ear(logging.WARNING), log_manager.console_handler.level
    own = list(log_manager.loggers.values())
    spread = [logger.propagate for logger in own]
    log_manager.console_handler.setLevel(logging.CRITICAL + 1)
    for logger in own:
        logger.addHandler(ear)
        logger.propagate = False
    try:
        yield said
    finally:
        log_manager.console_handler.setLevel(before)
        for logger, spreads in zip(own, spread, strict=True):
            logger.removeHandler(ear)
            logger.propagate = spreads


def _cut(status: Any, path: Path) -> str:
    """What the last segment of a file lacks, as far as the file says it; "" where the file is whole."""
    lacking = {
        name.replace("'", "").strip("/"): one.expected_length - one.read_length
        for name, one in (status.channel_statuses or {}).items()
        if one.read_length < one.expected_length
    }
    beyond = _beyond_the_end(path)
    if not (lacking or status.incomplete_final_segment or beyond):
        return ""
    named = [f"{count} of '{clip(name, 40)}'" for name, count in list(lacking.items())[:_SHOWN]]
    more = f" and of {len(lacking) - _SHOWN} more channels" if len(lacking) > _SHOWN else ""
    # A writer that was ended has not put its segment's length in.
    size = f"{beyond} bytes" if beyond and beyond < _UNKNOWN else "how many is not known"
    what = f"at least {', '.join(named)}{more}" if named else size
    return f"the file is cut off: values are missing at its end ({what})"


def _beyond_the_end(path: Path) -> int:
    """How many bytes a file lacks, by the lengths that its segments state; 0 of a whole one."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as content:
        while at < size:
            content.seek(at)
            lead = content.read(_LEAD)
            if len(lead) < _LEAD or lead[:4] != _TAG:
                return _UNKNOWN
            # Bit 6 of the content: the numbers stand with the highest byte first.
            order = "big" if lead[4] & 64 else "little"
            at += _LEAD + int.from_bytes(lead[12:20], order)
    return at - size
