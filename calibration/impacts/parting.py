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


def files_of(path: Path, name: str, where: str) -> list[Path]:
    """The file of a name beside a calibration file, or all files of a pattern such as "run*.csv".

    Raises:
        InputError: where a pattern has none.
    """
    if not any(sign in name for sign in "*?") or (path.parent / name).exists():
        return [path.parent / name]
    given_ = Path(name)
    found = sorted((path.parent / given_.parent).glob(given_.name))
    if not found:
        raise InputError(f"{where} file", f"no file is named as {name}", "give a pattern relative to the problem file")
    return found


def runs_of(path: Path, entry: Any, where: str) -> tuple[list[Record], list[tuple[str, Record]]]:
    """The files of an entry (``problemfile``), read, and its runs with their names."""
    how = Stated(entry.separator, entry.decimal, entry.encoding, entry.header, entry.sensitivity, entry.full_scale)
    files = [read(file, f"{where} file", entry.table, how) for file in files_of(path, entry.file, where)]
    runs = [run for file in files for run in split(file, entry.rows, where, entry.runs_by)]
    if entry.contacts == "each":
        columns = str(entry.time), entry.observe
        runs = [piece for label, run in runs for piece in each_contact(label, run, columns, where)]
    return files, runs


def each_contact(
    label: str, part: Record, columns: tuple[str, dict[str, str]], where: str
) -> list[tuple[str, Record]]:  # fmt: skip
    """Rows about each contact of a run, cut midway between them; those too small to be fitted beside the largest are left out.

    ``columns``: that of the clock, and those of the readings.
    """
    time, observe = columns
    observes = telling(list(observe))[0]
    sign, name = (-1.0 if observe[observes].startswith("-") else 1.0), observe[observes].removeprefix("-").strip()
    clock = part.numbers(time, "s", f"{where} time", blank=False)
    values = sign * part.numbers(name, unit_of(observes), f"{where} observe", blank=True)
    pieces = apart(clock, contacts(observes, clock, np.where(np.isinf(values), np.nan, values)))
    return [(f"{label} contact {k + 1}" if len(pieces) > 1 else label, part.where(keep)) for k, keep in pieces]
