"""A result that is written and shown as it grows: the first figures as soon as they are there, marked as not complete."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bcfj_jax.io import folder, outputs

# The last stage; a command names those before it itself.
COMPLETE = "complete"


class Growing:
    """A result as it grows: its main file names its ``stage``, in which an interruption leaves it, and what is new is shown."""

    def __init__(self, path: Path, show: Callable[[str], None]) -> None:
        self.path, self.show = path, show
        self.shown: list[str] = []

    def write(self, stage: str, content: Mapping[str, Any]) -> None:
        """The main file, with its stage first."""
        outputs.write_json(self.path, {"stage": stage, **content})
        folder.stays(self.path.parent, stage)

    def tell(self, parts: Sequence[str], after: str) -> None:
        """Show the paragraphs that were not shown before, and what comes after them."""
        self.show("\n\n".join([*self.new(parts), after]) + "\n")

    def new(self, parts: Sequence[str]) -> list[str]:
        """The paragraphs that were not shown before; from now on they were."""
        found = [part for part in parts if part and part not in self.shown]
        self.shown += found
        return found
