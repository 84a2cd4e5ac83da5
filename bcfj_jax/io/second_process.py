"""Contents of files that a second process makes, while this one goes on: pictures and long tables.

It is forked before JAX is imported, while there is one thread. It gets a function and its arguments and gives bytes; this process
uses them in ``finish``, and makes itself what the other has not begun by then. Where there is no second process, ``later`` is at
once.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe
from typing import Any

from bcfj_jax.xla.threads import cores

# How long what the second process has begun is waited for [s].
_PATIENCE_S = 60.0


@dataclass
class _Task:
    use: Callable[[bytes], None]
    function: Callable[..., bytes]
    arguments: tuple[Any, ...]
    made: bytes = b""

    def make(self) -> None:
        self.made = self.function(*self.arguments)

    def end(self) -> None:
        if not self.made:
            self.make()
        self.use(self.made)


class _Second:
    """Where the second process is reached, if there is one; what waits for it, and all whose end is not made."""

    channel: Connection | None = None
    sender = threading.Thread()
    waiting: deque[_Task] = deque()
    tasks: list[_Task] = []


def begin(ready: Callable[[], object]) -> None:
    """Fork the second process, where that is safe and a core is free for it; it gets ``ready`` before it is waited for."""
    if sys.platform != "linux" or "jax" in sys.modules or threading.active_count() > 1 or cores() == 1:
        return
    here, there = Pipe()
    try:
        child = os.fork()
    except OSError:  # No room for one more.
        return
    if child:
        there.close()
        _Second.channel = here
        atexit.register(_end, child)
        return
    try:
        here.close()
        _serve(there, ready)
    finally:
        os._exit(0)


def _end(child: int) -> None:
    with contextlib.suppress(OSError):
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _serve(channel: Connection, ready: Callable[[], object]) -> None:
    """Do what comes, until the other process has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to both; the first says when to end.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):  # Who reads the command's output waits until no process holds it.
        os.dup2(nowhere, stream)
    ready()
    while True:
        try:
            function, arguments = channel.recv()
            found = function(*arguments)
        except EOFError:
            return
        except Exception:  # The first process does it then, and meets the error itself.
            found = b""
        channel.send_bytes(found)


def later(use: Callable[[bytes], None], function: Callable[..., bytes], *arguments: Any) -> None:
    """Use what a function of a module gives: at once, or in ``finish`` where there is a second process."""
    task = _Task(use, function, arguments)
    if _Second.channel is None:
        task.end()
        return
    _Second.tasks.append(task)
    _Second.waiting.append(task)
    if not _Second.sender.is_alive():
        _Second.sender = threading.Thread(target=_send, args=(_Second.channel,), daemon=True)
        _Second.sender.start()


def _send(channel: Connection) -> None:
    # None waits, an argument cannot be sent, or the process is gone: what is left is made in this process.
    with contextlib.suppress(Exception):
        while True:
            task = _Second.waiting.popleft()
            channel.send((task.function, task.arguments))
            task.made = channel.recv_bytes()


def finish() -> None:
    """All is used when it returns: the last that waits is made here, while the second process makes the first."""
    with contextlib.suppress(IndexError):
        while True:
            _Second.waiting.pop().make()
    if _Second.sender.is_alive():
        _Second.sender.join(_PATIENCE_S)
        if _Second.sender.is_alive():
            _Second.channel, _Second.sender = None, threading.Thread()
    tasks, _Second.tasks = _Second.tasks, []
    for task in tasks:
        task.end()
