"""``bcfj tradeoff``: the study of a scene in a folder and in tables; it goes on where it was cut off."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from bcfj_jax.analysis.tradeoff.pages import so_far, write, write_tables
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.analysis.tradeoff.study import Study, study
from bcfj_jax.core.progress import stage
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.growing import Growing
from bcfj_jax.io.journal import NAME as JOURNAL
from bcfj_jax.io.journal import Journal, key_of
from bcfj_jax.io.scenefile import load, shown
from bcfj_jax.io.stop import heeded

DONE, FAILED, INTERRUPTED = 0, 3, 5
FILES = ("tradeoff.csv", "tradeoff.json", "tradeoff.png", *report.FILES, "run.toml", "environment.json")
# What tables, pictures and report take of the budget [s], at most a quarter of it.
_REPORT_S = 4.0
# Stages of tradeoff.json; while rows come it is written again after so long [s].
OWN, ROWS, _EVERY_S = "not compared yet", "settings left", 5.0


class Wanted(NamedTuple):
    """What is tried (``only``, ``derivatives``: as ``settings.settings``), and the seconds for this call."""

    only: Sequence[str]
    derivatives: bool
    budget: float


def run(
    what: str, wanted: Wanted, out: Path | None, say: Callable[[str], None], show: Callable[[str], None]
) -> tuple[str, int]:
    """Study a scene file, or go on with a study that its folder holds the journal of; in words, and the exit code.

    ``say`` receives the progress, ``show`` what is known before all is.
    """
    begin_s = time.monotonic()
    given, budget = shown(load(what)), wanted.budget
    todo = settings(given, wanted.only, wanted.derivatives)
    stem = given.source.stem if given.source else what
    folder = outputs.open_folder(out, stem, outputs.Claim("tradeoff", FILES, goes_on=JOURNAL))
    known = outputs.environment(data=given.sources)
    key = key_of("tradeoff", given.resolved, wanted.derivatives, known["packages"], known["device"])
    growing, next_s = Growing(folder / "tradeoff.json", show), 0.0

    def told(found: Study) -> None:
        """Show what is new, and write it from time to time."""
        nonlocal next_s
        new = growing.new(so_far(found))
        if found.reference is None:
            new.append("Not compared yet: two tight methods that agree, the reference, come next.\n")
        if new:
            show("\n".join(new))
        if found.reference is None or time.monotonic() > next_s:
            write_tables(growing, ROWS if found.reference else OWN, found)
            next_s = time.monotonic() + _EVERY_S * bool(found.reference)

    plots.get_ready()
    with heeded(), Journal(folder, key) as journal:
        if journal.resumed:
            say(f"going on in {folder}: {len(journal)} pieces are finished")
        spent = time.monotonic() - begin_s + min(_REPORT_S, 0.25 * budget)
        found = study(given, todo, journal, max(budget - spent, 0.0), say, told)
    options = {**wanted._asdict(), "only": list(wanted.only)}
    outputs.write_origin(folder, {**given.resolved, "tradeoff": options}, f"{what}, every default, SI", known)
    with stage("drawing"):
        text = write(growing, found, stem, given.scene.model_form)
    if found.interrupted:
        say(f"interrupted; go on with: bcfj tradeoff {what} --out {folder}")
        return text, INTERRUPTED
    return text, DONE if found.reference and found.reference.truth else FAILED
