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


_AGAIN = "run bcfj simulate again in another folder"


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
        raise InputError(str(folder), "forces.csv and contacts.csv have no time [s] in common", _AGAIN)
    members = given.scene.members

    def histories(table: dict[str, list[str]], end: str, read: Any = _numbers) -> dict[str, np.ndarray]:
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
