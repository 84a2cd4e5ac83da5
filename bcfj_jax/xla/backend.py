"""What JAX and XLA must be told before they are first used: 64-bit numbers, and how XLA makes kernels on a CPU."""

from __future__ import annotations

import os
import sys

_EXTRA = "--xla_backend_extra_options="
# XLA's CPU backend makes one kernel of a loop only where a round touches less than a kilobyte, and calls a loop's
# operations one by one otherwise. The steps of a mechanism's solver touch some tens of kilobytes. A loop that calls
# LAPACK stays as it was.
_LOOPS = "xla_cpu_small_while_loop_byte_threshold"
_BYTES = 1 << 20
# XLA writes a fused kernel in MLIR and lowers it in many passes, which is half of all compiling here. Its older writer
# goes to LLVM at once. benchmarks/solve/kernels.py measures what both options change, and others that are not set.
_OLDER_WRITER = "xla_cpu_disable_new_fusion_emitters"
_OPTIONS = f"{_LOOPS}={_BYTES},{_OLDER_WRITER}"


def set_up() -> None:
    """Switch JAX to 64 bits, raise XLA's limit for loops of one kernel, and choose XLA's older writer of kernels.

    Where one of the two options is set already, XLA's options stay as they are. Ours stand first, because XLA reads none
    behind a word without dashes, such as the ``intra_op_parallelism_threads=1`` that many recipes end with. Where JAX is
    not imported yet, its own variable ``JAX_ENABLE_X64`` says so, and JAX is not imported here. XLA reads ``XLA_FLAGS``
    when the first device is asked for; afterwards a change has no effect.
    """
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"
    flags = os.environ.get("XLA_FLAGS", "")
    if _LOOPS not in flags and _OLDER_WRITER not in flags:
        with_extra = flags.replace(_EXTRA, f"{_EXTRA}{_OPTIONS},", 1)
        os.environ["XLA_FLAGS"] = with_extra if _EXTRA in flags else f"{_EXTRA}{_OPTIONS} {flags}".strip()


def own_flags(flags: str) -> str:
    """What of XLA's options the user has set: all but ours."""
    return flags.replace(f"{_EXTRA}{_OPTIONS}", "").strip()


def on_cpu() -> bool:
    """Whether a CPU computes. Starts JAX's device."""
    import jax

    return jax.default_backend() == "cpu"


def memory() -> int:
    """What JAX may take of the first device's own memory [bytes]; 0 where it does not say, as of a CPU."""
    import jax

    return int((jax.local_devices()[0].memory_stats() or {}).get("bytes_limit", 0))
