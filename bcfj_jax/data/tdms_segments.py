"""What a TDMS file lacks that was cut off, by the lengths that its segments state."""

from __future__ import annotations

import os
from typing import Any

# A segment begins with a tag, its content's bits, a version, and the lengths of itself and of its description [bytes].
_TAG, _LEAD, _UNKNOWN, _SHOWN = b"TDSm", 28, 1 << 62, 4


def cut(status: Any, file: str) -> str:
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
