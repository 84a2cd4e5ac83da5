"""What is waited for: nothing is said in Python by default; the command ``bcfj`` prints lines, or draws bars.

There is one mechanism, ``stage``. Where its lines go is set in ``Waiting``; a terminal's bars are plugged in there, too.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

# How often stages are looked at [s].
_TICK = 0.05


class Shown(Protocol):
    """A stage as it is shown: how long it has taken, how much of it is done, and that it has ended."""

    def tick(self, took: float, last: bool) -> None:
        """So long it has taken [s]; whether no stage began after it. Called now and then, by another thread."""

    def advance(self, done: int) -> None:
        """So many parts are done."""

    def close(self) -> None:
        """The stage has ended."""


class Waiting:
    """How stages are shown."""

    say: Callable[[str], None] | None = None  # where a line goes; None for nowhere, then no stage is shown
    after: float = 1.0  # after how many seconds of waiting a stage is shown [s]
    every: float = 15.0  # time between two lines of one stage [s]; it doubles where nothing is counted
    times: bool = False  # whether a line says how long a stage took, once it has ended
    # What shows a stage in place of lines, from its text and its number of parts
    bar: Callable[[str, int | None], Shown] | None = None


@contextlib.contextmanager
def stage(text: str, total: int | None = None, hint: str = "") -> Iterator[Callable[[int], None]]:
    """Say what is waited for, once it takes long (``hint`` once, after it), and then now and then how far it is.

    Yields a function to be called with the number of parts that are done, of ``total`` where that is known.
    """
    if Waiting.say is None:
        yield _nothing
        return
    shown = Waiting.bar(f"{text}{hint}", total) if Waiting.bar else Lines(text, total, Waiting.say, hint)
    _CLOCK.begin(shown)
    try:
        yield shown.advance
    finally:
        _CLOCK.end(shown)
        shown.close()


def _nothing(done: int) -> None:
    del done


class _Clock:
    """One thread for all stages: a stage that is over soon costs microseconds."""

    def __init__(self) -> None:
        self.known = threading.Condition()
        self.stages: dict[int, tuple[Shown, float]] = {}
        self.thread: threading.Thread | None = None

    def begin(self, shown: Shown) -> None:
        """A stage begins."""
        with self.known:
            self.stages[id(shown)] = shown, time.monotonic()
            if self.thread is None or not self.thread.is_alive():
                self.thread = threading.Thread(target=self._run, daemon=True)
                self.thread.start()
            self.known.notify()

    def end(self, shown: Shown) -> None:
        """A stage has ended; none of its lines comes later."""
        with self.known:
            del self.stages[id(shown)]

    def _run(self) -> None:
        while True:
            with self.known:
                while not self.stages:
                    self.known.wait()
                now = time.monotonic()
                every = list(self.stages.values())
                for number, (shown, begin) in enumerate(every, 1):
                    shown.tick(now - begin, number == len(every))
            time.sleep(_TICK)


_CLOCK = _Clock()


class Lines:
    """A stage as plain lines: its text when it takes long; then, now and then, what is done, or how long it has taken."""

    def __init__(self, text: str, total: int | None, say: Callable[[str], None], hint: str = "") -> None:
        self.text, self.total, self.say, self.hint = text, total, say, hint
        self.next, self.every = Waiting.after, Waiting.every
        self.done, self.spoken = 0, 0
        self.first: int | None = None
        self.heard, self.begin = False, time.monotonic()
        if not Waiting.after:
            self.tick(0.0, True)

    def tick(self, took: float, last: bool) -> None:
        """Say what is due; of stages without a count, the last one speaks for all."""
        if took < self.next:
            return
        if not self.heard:
            self.heard = True
            self.say(f"{self.text}{self.hint}")
        elif self.total is None and not last:
            return
        elif self.total is None:
            self.say(f"{self.text} ({_time(took)} so far)")
            self.every *= 2.0
        elif self.done != self.spoken:
            self.spoken = self.done
            self.say(self._counted(took))
        self.next = took + self.every

    def advance(self, done: int) -> None:
        """So many parts are done; those of the first call were done before the stage began."""
        self.first = done if self.first is None else self.first
        self.done = done

    def close(self) -> None:
        """The stage has ended."""
        if Waiting.times and self.heard:
            self.say(f"{self.text}: done in {time.monotonic() - self.begin:.2f} s")

    def _counted(self, took: float) -> str:
        fresh, total = self.done - (self.first or 0), self.total or 0
        left = f", about {_time((total - self.done) * took / fresh)} left" if fresh > 0 and self.done < total else ""
        return f"{self.text}: {self.done} of {total}{left}"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
