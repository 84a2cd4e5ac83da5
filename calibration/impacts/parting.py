"""Which files an entry of a problem file names, and which rows of a run are about each of its contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.data.reading import read
from bcfj_jax.data.record import Record, split
from bcfj_jax.data.textfile import Stated
from bcfj_jax.mechanism.channels import unit_of
from calibration.impacts.events import apart, contacts, telling
from calibration.impacts.preparation import signed


def matching(path: Path) -> list[Path]:
    """The file of a path, or all files of a pattern such as "run*.csv"."""
    pattern = any(sign in path.name for sign in "*?") and not path.exists()
    return sorted(path.parent.glob(path.name)) if pattern else [path]


def files_of(path: Path, name: str, where: str) -> list[Path]:
    """Files by their name beside a calibration file (``matching``); a pattern has one at least."""
    found = matching(path.parent / name)
    if not found:
        raise InputError(f"{where} file", f"no file is named as {name}", "give a pattern relative to the problem file")
    return found


def runs_of(path: Path, entry: Any, where: str) -> tuple[list[Record], list[tuple[str, Record]]]:
    """The files of an entry (``problemfile``), read, and its runs with their names."""
    how = Stated(**{key: getattr(entry, key) for key in vars(Stated())})
    files = [read(file, f"{where} file", entry.table, how) for file in files_of(path, entry.file, where)]
    runs = [run for file in files for run in split(_filled(file, entry), entry.rows, where, entry.runs_by)]
    if entry.contacts == "each":
        runs = [piece for label, run in runs for piece in _each_contact(label, run, entry, where)]
    return files, runs


def _filled(file: Record, entry: Any) -> Record:
    """A table without the rows below a column that is shorter than others, where neither clock nor reading holds anything."""
    headers = [entry.time, *(header.removeprefix("-").strip() for header in entry.observe.values())]
    try:
        return file.held(headers)
    except InputError:
        return file  # What is wrong with a name is said where it is read.


def _each_contact(label: str, part: Record, entry: Any, where: str) -> list[tuple[str, Record]]:
    """Rows about each contact of a run, cut midway between them; those too small to be fitted beside the largest are left out."""
    observes = telling(entry.observe)[0]
    clock = part.numbers(entry.time, "s", f"{where} time", blank=False)
    values = signed(part, entry.observe[observes], unit_of(observes), where)
    pieces = apart(clock, contacts(observes, clock, np.where(np.isinf(values), np.nan, values)))
    return [(f"{label} contact {k + 1}" if len(pieces) > 1 else label, part.where(keep)) for k, keep in pieces]
