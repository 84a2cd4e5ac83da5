"""``bcfj report``: the report of a result folder made again, from what the folder holds."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from bcfj_jax.analysis.simulation import folder as runs
from bcfj_jax.analysis.simulation import results
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import report
from bcfj_jax.io.outputs import atomic, write_json, write_text
from bcfj_jax.io.page import Page, Picture


def rebuild(folder: Path, say: Callable[[str], None] = lambda text: None) -> Path:
    """Write ``report.html`` of a result folder again; pictures that its numbers are enough for are drawn again.

    Only ``report.html`` is replaced, as a whole; the path of it. A picture that is missing is written; one that is there
    is kept as it is, although the report shows it as this version draws it.

    Raises:
        InputError: for a folder that holds no results, or results that are not whole.
    """
    is_run = folder.is_dir() and all((folder / name).is_file() for name in runs.NEEDED)
    with tempfile.TemporaryDirectory() as place:
        drawn, fresh = Path(place), []
        page = report.kept(folder) if (folder / report.JSON).exists() or not is_run else None
        if is_run:
            try:
                fresh, run, given, known = runs.redrawn(folder, drawn)
                if page is None:
                    title = f"Simulation of {given.scene.kind}"
                    page = runs.page_of(title, fresh, run, given, known, results.input_rows(given))
                    page = replace(page, animation=report.animation(folder))
                    write_json(folder / report.JSON, page.content())
            except InputError as error:
                if page is None:
                    raise
                say(f"pictures are kept as they are: {error}")
        assert page is not None
        page = _with(page, fresh)
        for one in fresh:
            if not (folder / one.file).exists():
                with atomic(folder / one.file) as temporary:
                    temporary.write_bytes((drawn / one.file).read_bytes())
        write_text(folder / report.HTML, report.html(page, folder, drawn))
    return folder / report.HTML


def _with(page: Page, fresh: list[Picture]) -> Page:
    """The page with pictures that were drawn again in place of its own, and new ones at the end."""
    named = {one.file: one for one in fresh}
    own = [one.file for one in (*page.pictures, *page.more)]
    new = tuple(one for one in fresh if one.file not in own)
    first, more = (tuple(named.get(one.file, one) for one in part) for part in (page.pictures, page.more))
    return replace(page, pictures=first, more=(*more, *new))
