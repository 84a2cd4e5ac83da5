"""``bcfj tradeoff``: the study of a scene in a folder and in tables; it goes on where it was cut off."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bcfj_jax.analysis.tradeoff.pages import write
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.analysis.tradeoff.study import study
from bcfj_jax.io import outputs, report
from bcfj_jax.io.journal import NAME as JOURNAL
from bcfj_jax.io.journal import Journal, key_of
from bcfj_jax.io.scenefile import load, shown
from bcfj_jax.io.stop import heeded

DONE, FAILED, INTERRUPTED = 0, 3, 5
FILES = ("tradeoff.csv", "tradeoff.json", "tradeoff.png", *report.FILES, "run.toml", "environment.json")
# What tables, pictures and report take of the budget [s], at most a quarter of it.
_REPORT_S = 4.0


def run(
    what: str, only: Sequence[str], derivatives: bool, budget: float, out: Path | None, say: Callable[[str], None]
) -> tuple[str, int]:
    """Study a scene file, or go on with a study that its folder holds the journal of; in words, and the exit code.

    ``only``, ``derivatives``: as ``settings.settings``; ``budget``: seconds for this call.
    """
    begin_s = time.monotonic()
    given = shown(load(what))
    todo = settings(given, only, derivatives)
    stem = given.source.stem if given.source else what
    folder = outputs.open_folder(out, "tradeoff", stem, FILES, goes_on=JOURNAL)
    known = outputs.environment(data=[given.source] if given.source else [])
    key = key_of("tradeoff", given.resolved, derivatives, known["packages"], known["device"])
    with heeded(), Journal(folder, key) as journal:
        if journal.resumed:
            say(f"going on in {folder}: {len(journal)} pieces are finished")
        spent = time.monotonic() - begin_s + min(_REPORT_S, 0.25 * budget)
        found = study(given, todo, journal, max(budget - spent, 0.0), say)
    options = {"only": list(only), "derivatives": derivatives, "budget": budget}
    outputs.write_toml(folder / "run.toml", {**given.resolved, "tradeoff": options}, f"{what}, every default, SI")
    outputs.write_json(folder / "environment.json", known)
    text = write(folder, found, stem, given.scene.model_form)
    if found.interrupted:
        say(f"interrupted; go on with: bcfj tradeoff {what} --out {folder}")
        return text, INTERRUPTED
    return text, DONE if found.reference and found.reference.truth else FAILED
