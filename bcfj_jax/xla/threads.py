"""Work side by side in threads: XLA compiles and runs without Python's lock, and a machine has more than one core."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

S = TypeVar("S")
T = TypeVar("T")

_ahead: list[threading.Thread] = []


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def together(first: Callable[[], T], *others: Callable[[], T]) -> list[T]:
    """What each function gives, in order; the first runs in this thread. What the earliest of them raises is raised."""
    if cores() == 1:
        return [task() for task in (first, *others)]
    with ThreadPoolExecutor(max(len(others), 1)) as pool:
        waiting = [pool.submit(other) for other in others]
        return [first(), *(future.result() for future in waiting)]


def each(function: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """What a function gives of every item, in order; as many at a time as there are cores."""
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(function, items))


def begun(task: Callable[[], T]) -> Callable[[], T]:
    """Begin what is wanted later: the function gives it, and raises what it raised."""
    if cores() == 1:
        return cache(task)
    pool = ThreadPoolExecutor(1)
    waiting = pool.submit(task)
    pool.shutdown(wait=False)
    return waiting.result


def ahead(task: Callable[[], object]) -> None:
    """Begin what will be needed later. What it raises is dropped: who needs it then does it, and meets it, himself."""

    def work() -> None:
        with contextlib.suppress(Exception):
            task()

    _ahead[:] = [thread for thread in _ahead if thread.is_alive()]
    _ahead.append(threading.Thread(target=work))
    _ahead[-1].start()


def busy() -> bool:
    """Whether something that was begun ahead is not finished."""
    return any(thread.is_alive() for thread in _ahead)
