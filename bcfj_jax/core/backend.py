"""What JAX and XLA must be told before they are first used: 64-bit numbers, and loops as single kernels."""

from __future__ import annotations

import os
import sys

_EXTRA = "--xla_backend_extra_options="
_OPTION = "xla_cpu_small_while_loop_byte_threshold"
# XLA's CPU backend makes one kernel of a loop only where a round touches less than a kilobyte, and calls a loop's
# operations one by one otherwise. The steps of a mechanism's solver touch some tens of kilobytes. A loop that calls
# LAPACK stays as it was. benchmarks/solve/kernels.py measures what this changes.
_BYTES = 1 << 20


def set_up() -> None:
    """Switch JAX to 64 bits, and raise XLA's limit for loops of one kernel; a limit that is set already is kept.

    Where JAX is not imported yet, its own variable ``JAX_ENABLE_X64`` says so, and JAX is not imported here. XLA reads
    ``XLA_FLAGS`` when the first device is asked for; afterwards a change has no effect.
    """
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"
    flags, option = os.environ.get("XLA_FLAGS", ""), f"{_OPTION}={_BYTES}"
    if _OPTION not in flags:
        with_extra = flags.replace(_EXTRA, f"{_EXTRA}{option},", 1)
        os.environ["XLA_FLAGS"] = with_extra if _EXTRA in flags else f"{flags} {_EXTRA}{option}".strip()
