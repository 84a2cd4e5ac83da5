"""``bcfj report``: the report of a folder made again; a run of ``bcfj simulate`` is read back for it.

The files hold what pictures and tables need; the rates of penetration and the states of the solver are not in them.
"""

from __future__ import annotations

import csv
import io
import json
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.simulation import page as pages
from bcfj_jax.analysis.simulation import results
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import report
from bcfj_jax.io.opening import LARGEST_TEXT, content
from bcfj_jax.io.outputs import COMPONENTS, atomic, write_json, write_text
from bcfj_jax.io.page import Page, Picture, Table
from bcfj_jax.io.scenefile import SceneFile, load
from bcfj_jax.mechanism.readings import CREEPING, STATES, UNKNOWN
from bcfj_jax.solve.extremes import Extremes
from bcfj_jax.solve.simulation import Run

NEEDED = ("forces.csv", "contacts.csv", "summary.json", "run.toml")
_AGAIN = "run bcfj simulate again in another folder"


def _read(path: Path) -> str:
    raw = content(path, LARGEST_TEXT, str(path), "name the folder of a run", "it is larger than a run's file")
    return raw.decode("utf-8", errors="replace")


def _columns(path: Path) -> dict[str, list[str]]:
    """A CSV file's columns of text by their heads."""
    rows = list(csv.reader(io.StringIO(_read(path))))
    if len(rows) < 3 or any(len(row) != len(rows[0]) for row in rows):
        raise InputError(str(path), "is no table of a run", _AGAIN)
    return dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True))


def _numbers(cells: list[str], where: str) -> np.ndarray:
    try:
        return np.array([float(cell) if cell else math.nan for cell in cells])
    except ValueError as error:
        raise InputError(where, str(error), _AGAIN) from None


def _codes(words: list[str], where: str) -> np.ndarray:
    del where
    # "sticking" is what older runs' files say of creeping.
    number = {word: code for code, word in enumerate(STATES)} | {"sticking": CREEPING}
    return np.array([number.get(word, UNKNOWN) for word in words], dtype=np.int8)


def summary(folder: Path) -> dict[str, Any]:
    """``summary.json``; ``InputError`` where it cannot be read."""
    path = folder / "summary.json"
    try:
        found = json.loads(_read(path))
        if not {"contacts", "status", "solver"} <= set(found):
            raise ValueError("it has no contacts, status and solver")
    except (ValueError, TypeError) as error:
        raise InputError(str(path), f"is no summary of a run: {error}", "run bcfj simulate again") from None
    return found


def read(folder: Path, given: SceneFile, known: dict[str, Any]) -> Run:
    """The run of a folder from its ``summary.json``: forces, penetrations, slips, states and peaks; rates are NaN."""
    forces, contacts = _columns(folder / "forces.csv"), _columns(folder / "contacts.csv")
    if "time [s]" not in forces or forces["time [s]"] != contacts.get("time [s]"):
        raise InputError(str(folder), "forces.csv and contacts.csv have no time [s] in common", _AGAIN)
    members = given.scene.members

    def histories(
        table: dict[str, list[str]], end: str, read: Callable[..., np.ndarray] = _numbers
    ) -> dict[str, np.ndarray]:
        """By contact the columns of this end, members side by side, where the table has them all."""
        found = {}
        for name, count in members.items():
            heads = [f"{name}_{k + 1}{end}" for k in range(count)] or [f"{name}{end}"]
            if all(head in table for head in heads):
                each = [read(table[head], head) for head in heads]
                found[name] = np.stack(each, 1) if count else each[0]
        return found

    parts = [histories(forces, f".{part} [N]") for part in COMPONENTS]
    depth = histories(contacts, ".penetration [m]")
    if lost := [name for name in members if any(name not in part for part in (*parts, depth))]:
        raise InputError(str(folder), f"has no history of {lost[0]}", _AGAIN)
    force = {name: np.stack([part[name] for part in parts], -1) for name in members}
    stats = {**known["solver"], **{key: known.get(key, math.nan) for key in ("wall_s", "compile_s")}}
    failure = known.get("failure_time")
    return Run(
        _numbers(forces["time [s]"], "forces.csv"), force, depth, {n: np.full_like(x, np.nan) for n, x in depth.items()},
        histories(contacts, ".sliding_speed [m/s]"), known["status"], known.get("reason", ""),
        math.nan if failure is None else failure, stats, histories(contacts, ".state", _codes),
        extremes=_extremes(members, known["contacts"]),
    )  # fmt: skip


def _extremes(members: Mapping[str, int], contacts: Mapping[str, Mapping[str, Any]]) -> dict[str, Extremes]:
    """What the summary knows of the solver's steps: peaks and their times; nothing where they were not looked at."""
    found = {}
    for name, count in members.items():
        rows = [contacts.get(f"{name}_{k + 1}" if count else name, {}) for k in range(count or 1)]
        if any("peak_of_samples" not in row for row in rows):
            return {}
        values = ([row.get(key) for row in rows] for key in Extremes._fields)
        columns: Any = [np.array([math.nan if x is None else x for x in column], float) for column in values]
        found[name] = Extremes(*(column if count else column[0] for column in columns))
    return found


def rebuild(folder: Path, say: Callable[[str], None] = lambda text: None) -> Path:
    """Write ``report.html`` of any command's folder again; the path of it.

    Pictures of a run are drawn anew in it; a picture file that is missing is written, one that is there is kept as it is.
    ``InputError`` for a folder that holds no results, or results that are not whole.
    """
    is_run = folder.is_dir() and all((folder / name).is_file() for name in NEEDED)
    page = report.kept(folder) if (folder / report.JSON).exists() or not is_run else None
    with tempfile.TemporaryDirectory() as place:
        drawn, fresh = Path(place), []
        if is_run:
            try:
                known = summary(folder)
                given = load(folder / "run.toml")
                run = read(folder, given, known)
                fresh = pages.drawn(drawn, run, given.scene, given.params, (), known["contacts"])
                if page is None:
                    page = _page(folder, pages.Ran(run, given.scene, known), fresh, given)
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


def _page(folder: Path, of: pages.Ran, shown: list[Picture], given: SceneFile) -> Page:
    rows = Table("Input: values and what they mean", results.input_rows(given))
    page = pages.made(f"Simulation of {given.scene.kind}", of, shown, [rows])
    write_json(folder / report.JSON, page.content())
    return replace(page, animation=report.animation(folder))


def _with(page: Page, fresh: list[Picture]) -> Page:
    """The page with pictures that were drawn again in place of its own, and new ones at the end."""
    named = {one.file: one for one in fresh}
    own = [one.file for one in (*page.pictures, *page.more)]
    new = tuple(one for one in fresh if one.file not in own)
    first, more = (tuple(named.get(one.file, one) for one in part) for part in (page.pictures, page.more))
    return replace(page, pictures=first, more=(*more, *new))
