"""Ctrl-C that does not get lost, and work that ends when its time is over.

Python raises it wherever it happens to be, and within a callback of its garbage collector, of which JAX has one, it is
reported and forgotten. Whoever works in batches asks here before the next.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TypeVar

from bcfj_jax.core import threads

T = TypeVar("T")

_asked = threading.Event()
# Whether something was left behind that still computes.
_abandoned = threading.Event()


class OutOfTime(Exception):
    """What was not done in its time."""


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


def within(seconds: float, what: Callable[[], T]) -> T:
    """What a function gives, or raises, in so many seconds.

    Neither a compilation nor a run in compiled code can be stopped. So it is done in a thread of its own, which is left
    behind when the time is over; ``leave`` then ends the process without it.

    Raises:
        OutOfTime: when the time is over, or there is none.
    """
    if seconds <= 0.0:
        raise OutOfTime
    found: list[T] = []
    raised: list[BaseException] = []
    done = threading.Event()

    def work() -> None:
        try:
            found.append(what())
        except BaseException as error:
            raised.append(error)
        finally:
            done.set()

    threading.Thread(target=work, daemon=True).start()
    try:
        in_time = done.wait(seconds if seconds < threading.TIMEOUT_MAX else None)
    except KeyboardInterrupt:
        _abandoned.set()
        raise
    if not in_time:
        _abandoned.set()
        raise OutOfTime
    if raised:
        raise raised[0]
    return found[0]


def leave(code: int) -> None:
    """End the process with this exit code, at once, if something still computes that nobody waits for."""
    if _abandoned.is_set() or threads.busy():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
