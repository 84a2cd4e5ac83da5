"""Stages as progress bars on a terminal, by rich: one live display, a line for each stage that takes long."""

from __future__ import annotations

import threading
from typing import Any

from bcfj_jax.core.progress import Waiting


class Bars:
    """The display. It is there while a stage is shown; other lines on stderr appear above it."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.display: Any = None

    def __call__(self, text: str, total: int | None) -> Bar:
        """A stage's bar; it appears once the stage takes long."""
        return Bar(self, text, total)

    def add(self, text: str, total: int | None, **done: Any) -> Any:
        """Show one more stage; its key."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        with self.lock:
            if self.display is None:
                columns = (
                    SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=20),
                    TextColumn("{task.fields[count]}"), TimeElapsedColumn(),
                )  # fmt: skip
                self.display = Progress(*columns, console=Console(stderr=True), transient=True)
                self.display.start()
            return self.display.add_task(text, total=total, **done)

    def update(self, key: Any, **done: Any) -> None:
        """So many parts of a stage are done."""
        with self.lock:
            if self.display is not None:
                self.display.update(key, **done)

    def remove(self, key: Any) -> None:
        """A stage has ended."""
        with self.lock:
            self.display.remove_task(key)
            if not self.display.tasks:
                self.display.stop()
                self.display = None


class Bar:
    """One stage."""

    def __init__(self, bars: Bars, text: str, total: int | None) -> None:
        self.bars, self.text, self.total, self.key = bars, text, total, None
        self.done: dict[str, Any] = {}
        self.advance(0)

    def tick(self, took: float, last: bool) -> None:
        """Appear once the stage takes long."""
        del last
        if self.key is None and took >= Waiting.after:
            self.key = self.bars.add(self.text, self.total, **self.done)

    def advance(self, done: int) -> None:
        """So many parts are done."""
        self.done = {"completed": done, "count": "" if self.total is None else f"{done} of {self.total}"}
        if self.key is not None:
            self.bars.update(self.key, **self.done)

    def close(self) -> None:
        """The stage has ended."""
        if self.key is not None:
            self.bars.remove(self.key)
