"""What is waited for, in a line: nothing in Python by default; the command ``bcfj`` prints it to stderr."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator


class Waiting:
    """Where a line goes: None for nowhere; and after how many seconds [s] of waiting."""

    say: Callable[[str], None] | None = None
    after: float = 1.0


@contextlib.contextmanager
def stage(text: str) -> Iterator[None]:
    """Say what is waited for, once it takes long."""
    if Waiting.say is None:
        yield
        return
    late = threading.Timer(Waiting.after, Waiting.say, (text,))
    late.daemon = True
    late.start()
    try:
        yield
    finally:
        late.cancel()
