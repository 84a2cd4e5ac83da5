"""What a command's process finds around it, checked once before JAX computes: variables of JAX, XLA, equinox, Matplotlib.

A variable that JAX or XLA cannot work with would end in a traceback, or in the process's end, far from its cause.
"""

from __future__ import annotations

import os
import re
import sys

from bcfj_jax.core.errors import InputError
from bcfj_jax.xla.backend import own_flags
from bcfj_jax.xla.compile_cache import open_cache

_CHECKS = ("nan", "raise", "off")
_MOST = 10_000


def get_ready() -> None:
    """Open the cache, import JAX and start its device.

    Pictures are written to files here, so that Matplotlib's variable for windows and notebooks is set aside.

    Raises:
        InputError: for a variable that cannot be worked with, and a device that cannot be started.
    """
    os.environ["MPLBACKEND"] = "agg"
    checks = os.environ.get("EQX_ON_ERROR", "nan")
    if checks not in _CHECKS:
        # "breakpoint" opens a debugger within compiled programs.
        raise InputError("EQX_ON_ERROR", f"'{checks[:200]}' does not work here", f"unset it; {', '.join(_CHECKS)} work")
    try:
        open_cache()
        import jax
    except ValueError as error:  # JAX's own words for a value of its variables that it does not know.
        raise InputError("environment", str(error)[:200], f"unset the variable; {_set()}") from None
    if jax.config.jax_disable_jit:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError("JAX_DISABLE_JIT", "is set, and programs are compiled here", "unset it")
    if os.environ.get("JAX_TRANSFER_GUARD", "allow") not in ("allow", "log", "log_explicit"):
        raise InputError("JAX_TRANSFER_GUARD", "forbids to give numbers to compiled programs", "unset it")
    if own_flags(os.environ.get("XLA_FLAGS", "")) and (fault := _fault_of_flags()):
        raise InputError("XLA_FLAGS", fault, "correct or unset it")
    try:
        jax.devices()
    except Exception as error:  # RuntimeError for an unknown platform; for one without a device, an AssertionError.
        said = str(error)[:200] or "no device was found"
        asked = os.environ.get("JAX_PLATFORMS", "")[:200]
        raise InputError(f"JAX_PLATFORMS={asked}", f"JAX cannot start: {said}", "unset it, or say cpu") from None


def _set() -> str:
    names = sorted(name for name in os.environ if name.startswith("JAX_") and name != "JAX_ENABLE_X64")
    return f"set are {', '.join(names)[:200]}" if names else "none of JAX's is set"


def _fault_of_flags() -> str:
    """What XLA says of options that are not ours: it ends the process for one that it does not know, so a child asks."""
    if not hasattr(os, "fork"):
        return ""
    import jax

    if sys.stderr is not None:  # It is None where a process has no stderr.
        sys.stderr.flush()
    readable, writable = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.dup2(writable, 2)
            jax.devices("cpu")
            code = 0
        finally:
            os._exit(code)
    os.close(writable)
    with os.fdopen(readable, "rb") as file:
        said = file.read(_MOST).decode(errors="replace")
    if os.waitpid(child, 0)[1] == 0:
        return ""
    lines = [re.sub(r"^F\d+ .*?\] ", "", line) for line in said.splitlines() if re.match(r"^F\d+ ", line)]
    return (lines[-1] if lines else "XLA does not start with these options")[:200]
