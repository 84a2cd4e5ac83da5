"""What a verb would do: ``--dry-run`` checks everything, counts, estimates, and writes nothing."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path

import typer

from bcfj_jax.cli.base import DONE, SIMULATION_FAILED, result
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import report, scenefile
from bcfj_jax.io.folder import check_folder
from bcfj_jax.io.units import format_si
from bcfj_jax.xla import programs


def ended(command: str, scene: str, begin: float, good: bool) -> int:
    """The exit code of a command that began at a ``time.perf_counter()``; how long it took is kept if it went well.

    The user has his answer: nothing is computed here, which would wait for runs that a budget has left behind.
    """
    if not good:
        return SIMULATION_FAILED
    with contextlib.suppress(InputError):
        programs.remember(_such(command, scene), time.perf_counter() - begin)
    return DONE


def _such(command: str, scene: str) -> str:
    """A command with a scene of this kind: the name by which its time is kept."""
    return f"bcfj {command} {scenefile.kind(scenefile.content(scene))}"


def of_scene(command: str, scene: str, out: Path | None, rows: Sequence[Sequence[str]]) -> int:
    """Show what a verb would do with a scene, in rows of which some are the verb's own; the exit code."""
    given = scenefile.load(scene)
    took = programs.seconds(_such(command, scene))
    unknown = "unknown: no such run was timed on this machine; the first compiles its programs, which are then kept"
    known = f"about {took:.0f} s, as the last time with such a scene" if took else unknown
    first = [
        ["scene", given.scene.kind],
        ["parameters", str(len(given.params))],
        ["contacts", ", ".join(contact.name for contact in given.scene.contacts) or "none"],
        ["simulated", f"{format_si(float(given.times[-1]), 's')}, {len(given.times)} samples"],
        ["accuracy", str(given.accuracy)],
    ]
    show([*first, *rows, *([] if any(row[0] == "time" for row in rows) else [["time", known]])], out)
    return DONE


def show(rows: Sequence[Sequence[str]], out: Path | None) -> None:
    """Print the table of a dry run, and keep it for ``--json``."""
    if out is not None:
        check_folder(out)
    typer.echo(report.text([["dry run", "nothing is written"], *rows]))
    result({"dry_run": {row[0]: row[1] for row in rows}})
