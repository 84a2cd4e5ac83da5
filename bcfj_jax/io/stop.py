"""Ctrl-C that does not get lost, and work that ends when its time is over.

Python raises it wherever it happens to be, and within a callback of its garbage collector, of which JAX has one, it is
reported and forgotten. Here it is sent again right after such a callback, and after an import, within which a library's
compiled code would make something else of it. Whoever works in batches asks before the next.
"""

from __future__ import annotations

import _thread
import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from types import FrameType
from typing import TypeVar

from bcfj_jax.xla import threads

T = TypeVar("T")
# A process that ends by a signal and keeps nothing has this and the signal's number as its exit code, as in a shell.
SIGNALLED = 128

_asked = threading.Event()
# Whether something was left behind that still computes.
_abandoned = threading.Event()
# Whether it came where nobody can hear it, and has not been raised since.
_unheard = threading.Event()
# Whether it is being found out that it was: raised there, it would be lost again.
_hearing = threading.Event()
# Whether no thread is there that sends it again.
_idle = threading.Event()
_idle.set()
# The signal that asked last.
_last: list[int] = []
# Imports that were under way when ``heeded`` began.
_imports = [0]
# After a callback in which Ctrl-C was lost [s]: it must have returned, or Ctrl-C is lost in it again.
_RETURNED_S = 0.01


class OutOfTime(Exception):
    """What was not done in its time."""


def _remember(number: int, frame: FrameType | None) -> None:
    _asked.set()
    _last[:] = [number]
    if _hearing.is_set():
        return  # It comes again.
    if _importing(frame) > _imports[0]:
        # A library's compiled code may swallow it, take it for a fault of its own, or end the process.
        _send_again()
        return
    _unheard.clear()
    raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> int:
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename == "<frozen importlib._bootstrap>"
        frame = frame.f_back
    return count


def _send_again() -> None:
    _unheard.set()
    if _idle.is_set():
        _idle.clear()
        # Not a Thread: the signal may have come while this thread holds the locks of their module.
        _thread.start_new_thread(_send, ())


@contextlib.contextmanager
def _sent_again() -> Iterator[None]:
    """Within, Ctrl-C that is raised in a callback, which cannot pass it on, comes again when that has returned."""
    report = sys.unraisablehook

    def hear(lost: sys.UnraisableHookArgs) -> None:
        if not (issubclass(lost.exc_type, KeyboardInterrupt) and _asked.is_set()):
            report(lost)
            return
        _hearing.set()
        try:
            _send_again()
        finally:
            _hearing.clear()

    sys.unraisablehook = hear
    try:
        yield
    finally:
        _unheard.clear()
        sys.unraisablehook = report
        # What is about to be sent must find the handler that is still ours.
        _idle.wait(1.0)


def _send() -> None:
    while True:
        time.sleep(_RETURNED_S)
        number = last()
        if not _unheard.is_set() or signal.getsignal(number) is not _remember:
            _idle.set()
            return
        if os.name == "posix":
            os.kill(os.getpid(), number)  # Wakes a thread that waits, too.
        else:
            _thread.interrupt_main(number)


def last() -> int:
    """Number of the signal that asked to stop: SIGINT's where none is known."""
    return _last[0] if _last else int(signal.SIGINT)


@contextlib.contextmanager
def heeded(*others: signal.Signals) -> Iterator[None]:
    """Within, Ctrl-C is remembered, and ``others`` like it; where it is ignored, as by a shell's background jobs, it stays so.

    Within another it raises what came since that one began and was reported to nobody.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if any(signal.getsignal(number) is _remember for number in (signal.SIGINT, signal.SIGTERM)):
        check()
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *others)}
    before = {number: known for number, known in before.items() if known not in (signal.SIG_IGN, None)}
    _asked.clear()
    _last.clear()
    _imports[0] = _importing(sys._getframe())
    for number in before:
        signal.signal(number, _remember)
    try:
        with _sent_again():
            yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is _remember:
                signal.signal(number, handler)
        _asked.clear()


def ended() -> None:
    """The work is done, and its exit code is known: what asks to stop now would only take that code away."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is _remember:
            signal.signal(number, signal.SIG_IGN)


def check() -> None:
    """Raise ``KeyboardInterrupt`` if Ctrl-C came since ``heeded`` began: it may have been forgotten."""
    if _asked.is_set():
        _unheard.clear()
        raise KeyboardInterrupt


def within(seconds: float, what: Callable[[], T]) -> T:
    """What a function gives, or raises, in so many seconds; ``OutOfTime`` when they are over.

    Neither a compilation nor a run in compiled code can be stopped. So it is done in a thread of its own, which is left
    behind; ``leave`` then ends the process without it.
    """
    if seconds <= 0.0:
        raise OutOfTime
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(what())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    try:
        return future.result(seconds if seconds < threading.TIMEOUT_MAX else None)
    except BaseException as error:
        if future.done() and future.exception() is error:
            raise
        abandon()
        if isinstance(error, TimeoutError):
            raise OutOfTime from None
        raise


def abandon() -> None:
    """Nobody waits any more for what threads of this process still compute."""
    _abandoned.set()


def leave(code: int) -> None:
    """End the process with this exit code, at once, if something still computes that nobody waits for."""
    if _abandoned.is_set() or threads.busy():
        _end(code)


def end_process(code: int) -> None:
    """End the process with this exit code, and do what is registered for its end. Python would take modules and programs apart
    first, which takes a third as long as to import JAX; under a profiler or a tracer, which write then, it does.
    """
    monitoring = getattr(sys, "monitoring", None)  # Of Python 3.12 and later, whose profiler is no function.
    profiled = monitoring is not None and monitoring.get_tool(monitoring.PROFILER_ID)
    if not (profiled or sys.getprofile() or sys.gettrace()):
        atexit._run_exitfuncs()
        _end(code)


def _end(code: int) -> None:
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    os._exit(code)
