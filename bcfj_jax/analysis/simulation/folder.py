"""A run of ``bcfj simulate`` read back from its folder, for a report that is made again.

The files hold what pictures and tables need; the rates of penetration and the states of the solver are not in them.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.simulation import page
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.opening import LARGEST_TEXT, content
from bcfj_jax.io.outputs import COMPONENTS
from bcfj_jax.io.page import Page, Picture, Table
from bcfj_jax.io.scenefile import SceneFile, load
from bcfj_jax.mechanism.readings import CREEPING, STATES, UNKNOWN
from bcfj_jax.solve.extremes import Extremes
from bcfj_jax.solve.simulation import Run

NEEDED = ("forces.csv", "contacts.csv", "summary.json", "run.toml")


def _read(path: Path) -> str:
    raw = content(path, LARGEST_TEXT, str(path), "name the folder of a run", "it is larger than a run's file")
    return raw.decode("utf-8", errors="replace")


def _columns(path: Path) -> dict[str, list[str]]:
    """A CSV file's columns of text by their heads.

    Raises:
        InputError: for a file without rows, or with rows of different lengths.
    """
    rows = list(csv.reader(io.StringIO(_read(path))))
    if len(rows) < 3 or any(len(row) != len(rows[0]) for row in rows):
        raise InputError(str(path), "is no table of a run", "run bcfj simulate again in another folder")
    return dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True))


def _numbers(cells: list[str], where: str) -> np.ndarray:
    try:
        return np.array([float(cell) if cell else math.nan for cell in cells])
    except ValueError as error:
        raise InputError(where, str(error), "run bcfj simulate again in another folder") from None


def summary(folder: Path) -> dict[str, Any]:
    """``summary.json``.

    Raises:
        InputError: where it cannot be read.
    """
    path = folder / "summary.json"
    try:
        found = json.loads(_read(path))
        if not {"contacts", "status", "solver"} <= set(found):
            raise ValueError("it has no contacts, status and solver")
    except (ValueError, TypeError) as error:
        raise InputError(str(path), f"is no summary of a run: {error}", "run bcfj simulate again") from None
    return found


def read(folder: Path, given: SceneFile, known: dict[str, Any]) -> Run:
    """The run of a folder from its ``summary.json``: forces, penetrations, slips, states and peaks; rates are NaN.

    Raises:
        InputError: for a file that does not hold what ``bcfj simulate`` writes.
    """
    forces, contacts = _columns(folder / "forces.csv"), _columns(folder / "contacts.csv")
    if "time [s]" not in forces or forces["time [s]"] != contacts.get("time [s]"):
        found = "forces.csv and contacts.csv have no time [s] in common"
        raise InputError(str(folder), found, "run bcfj simulate again in another folder")
    times = _numbers(forces["time [s]"], "forces.csv")

    def stacked(table: dict[str, list[str]], name: str, count: int, end: str, codes: bool = False) -> np.ndarray | None:
        heads = [f"{name}_{k + 1}{end}" for k in range(count)] or [f"{name}{end}"]
        if any(head not in table for head in heads):
            return None
        made = [_codes(table[h]) if codes else _numbers(table[h], h) for h in heads]
        return np.stack(made, 1) if count else made[0]

    force, depth, slip, state = {}, {}, {}, {}
    for name, count in given.scene.members.items():
        parts = [stacked(forces, name, count, f".{part} [N]") for part in COMPONENTS]
        deep = stacked(contacts, name, count, ".penetration [m]")
        if deep is None or any(part is None for part in parts):
            raise InputError(str(folder), f"has no history of {name}", "run bcfj simulate again in another folder")
        force[name], depth[name] = np.stack([p for p in parts if p is not None], -1), deep
        slides, codes = (
            stacked(contacts, name, count, ".sliding_speed [m/s]"),
            stacked(contacts, name, count, ".state", True),
        )
        slip |= {} if slides is None else {name: slides}
        state |= {} if codes is None else {name: codes}
    stats = {**known["solver"], "wall_s": known.get("wall_s", math.nan), "compile_s": known.get("compile_s", math.nan)}
    failure = known.get("failure_time")
    return Run(
        times, force, depth, {name: np.full_like(x, np.nan) for name, x in depth.items()}, slip, known["status"],
        known.get("reason", ""), math.nan if failure is None else failure, stats, state,
        extremes=_extremes(given.scene.members, known["contacts"]),
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


def _codes(words: list[str]) -> np.ndarray:
    # "sticking" is what older runs' files say of creeping.
    number = {word: code for code, word in enumerate(STATES)} | {"sticking": CREEPING}
    return np.array([number.get(word, UNKNOWN) for word in words], dtype=np.int8)


def redrawn(folder: Path, place: Path) -> tuple[list[Picture], Run, SceneFile, dict[str, Any]]:
    """Draw the pictures of a run's folder again, into another place: those that its files are enough for.

    Raises:
        InputError: where the folder's files do not hold a run, or its scene cannot be made, as without its own code.
    """
    known = summary(folder)
    given = load(folder / "run.toml")
    run = read(folder, given, known)
    return page.drawn(place, run, given.scene, given.params, (), known["contacts"]), run, given, known


def page_of(
    title: str, shown: list[Picture], run: Run, given: SceneFile, known: dict[str, Any], rows: list[list[str]]
) -> Page:
    """The page of a folder that keeps none, from what ``redrawn`` gives and the table of the input."""
    more = [Table("Input: values and what they mean", rows)]
    return page.made(title, run, given.scene, known, shown, more, [])
