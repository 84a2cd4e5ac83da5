"""Seconds of calls, compiling apart; calls that take turns; work that ends in time; worker processes."""

from __future__ import annotations

import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from benchmarks.common import ROOT

T = TypeVar("T")


def clocked(task: Callable[[], T]) -> tuple[T, dict[str, float]]:
    """What a task gives, and its seconds by the clock and of this process."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = task()
    return found, {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}


def spent(call: Callable[[], Any], clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of one call whose result is awaited."""
    import jax

    begin = clock()
    jax.block_until_ready(call())
    return clock() - begin


def seconds(
    call: Callable[[], Any], repeats: int, clock: Callable[[], float] = time.process_time, most: float = math.inf
) -> list[float]:
    """Seconds of so many calls, of fewer once they have taken more than ``most``."""
    found: list[float] = []
    while len(found) < repeats and sum(found) <= most:
        found.append(spent(call, clock))
    return found


def turns(
    calls: Mapping[str, Callable[[], Any]], rounds: int, clock: Callable[[], float] = time.process_time
) -> dict[str, list[float]]:
    """Seconds of calls that take turns, so that whatever else the machine does meets all; the first round compiles."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds + 1):
        for name, call in calls.items():
            found[name].append(spent(call, clock))
    return {name: each[1:] for name, each in found.items()}


def until(minutes: float, things: Iterable[T]) -> Iterator[T]:
    """Things one after the other, until the time is up."""
    end = time.perf_counter() + 60.0 * minutes
    for thing in things:
        if time.perf_counter() > end:
            return
        yield thing


def keep_programs(least_s: float | None = None) -> None:
    """Keep compiled programs in the clone's build folder, those that took so long; for all processes."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(ROOT / "build" / "jax-cache"))
    if least_s is not None:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", least_s)


def pool(workers: int) -> ProcessPoolExecutor:
    """Processes of their own, which begin anew."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def on_core(number: int) -> None:
    """Keep this process to one of its cores, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[number % len(cores)]})


class Compilation:
    """Seconds that JAX has spent on tracing and compiling since it was last asked."""

    def __init__(self) -> None:
        import jax

        self.seconds = 0.0
        jax.monitoring.register_event_duration_secs_listener(self._add)

    def _add(self, event: str, duration_secs: float, **kwargs: Any) -> None:
        del kwargs
        if event.startswith("/jax/core/compile/"):
            self.seconds += duration_secs

    def since(self) -> float:
        """The seconds, which count from 0 again."""
        found, self.seconds = self.seconds, 0.0
        return found
