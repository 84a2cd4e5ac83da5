"""Ctrl-C that does not get lost.

Python raises it wherever it happens to be, and within a callback of its garbage collector, of which JAX has one, it is
reported and forgotten. Whoever works in batches asks here before the next.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_asked = threading.Event()


def _remember(_: int, __: FrameType | None) -> None:
    _asked.set()
    raise KeyboardInterrupt


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """Within, Ctrl-C is remembered. Where it is ignored, as by a shell's background jobs, it stays ignored.

    Within another, what came since the outer one began, and was reported to nobody, is raised at once.

    Raises:
        KeyboardInterrupt: if Ctrl-C came since an outer one began.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is signal.SIG_IGN:
        yield
        return
    if before is _remember:
        check()
        yield
        return
    _asked.clear()
    signal.signal(signal.SIGINT, _remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _asked.clear()


def check() -> None:
    """Raise what was asked for and may have been forgotten.

    Raises:
        KeyboardInterrupt: if Ctrl-C came since ``heeded`` began.
    """
    if _asked.is_set():
        raise KeyboardInterrupt
