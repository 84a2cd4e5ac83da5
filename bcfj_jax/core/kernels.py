"""Small loops of a solver compiled as one kernel on the CPU. Imports nothing but the environment."""

from __future__ import annotations

import os

_EXTRA = "--xla_backend_extra_options="
_OPTION = "xla_cpu_small_while_loop_byte_threshold"
# XLA's CPU backend makes one kernel of a loop only where a round touches less than a kilobyte, and calls a loop's
# operations one by one otherwise. The steps of a mechanism's solver touch some tens of kilobytes. A loop that calls
# LAPACK stays as it was. benchmarks/solve/kernels.py measures what this changes.
_BYTES = 1 << 20


def compile_small_loops_whole() -> None:
    """Raise XLA's limit for loops of one kernel, in ``XLA_FLAGS``; a limit that stands there already is kept.

    XLA reads the variable when the first device is asked for. Afterwards this changes nothing.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _OPTION in flags:
        return
    option = f"{_OPTION}={_BYTES}"
    flags = flags.replace(_EXTRA, f"{_EXTRA}{option},", 1) if _EXTRA in flags else f"{flags} {_EXTRA}{option}".strip()
    os.environ["XLA_FLAGS"] = flags
