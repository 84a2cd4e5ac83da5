"""One force record in every format that a calibration reads, written by each format's own library."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.calibration import instruments

TIME = np.linspace(0.0, 1.2, 61)
FORCE = 100.0 * np.clip(np.sin(np.pi * TIME), 0.0, None)
# Names of its columns in the calibration file of ``problem``.
TIME_COLUMN, FORCE_COLUMN = "time [ms]", "force [N]"


def problem(file: str) -> str:
    """A calibration file of the record."""
    time, force = (
        ("time", OWN[file[file.rfind(".") :]]) if file[file.rfind(".") :] in OWN else (TIME_COLUMN, FORCE_COLUMN)
    )
    scale = 'full_scale = "500 N"\n' if file.endswith(".wav") else ""
    return (
        f'scene = "impact"\n[[experiment]]\nfile = "{file}"\ntime = "{time}"\n{scale}'
        f'observe = {{ "contact.normal" = "{force}" }}\nnoise = "1 N"\n[free.stiffness]\nlower = 1e6\nupper = 1e10\n'
    )


def _text(separator: str, comma: bool = False) -> bytes:
    rows = [separator.join((TIME_COLUMN, FORCE_COLUMN))]
    rows += [separator.join((f"{t:.3f}", f"{f:.6f}")) for t, f in zip(TIME, FORCE, strict=True)]
    text = "\n".join(rows) + "\n"
    return (text.replace(".", ",") if comma else text).encode()


def _parquet() -> bytes:
    import pyarrow
    from pyarrow import parquet

    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table({TIME_COLUMN: TIME, FORCE_COLUMN: FORCE}), buffer)
    return buffer.getvalue()


def _pair(unit: str) -> dict[str, tuple[np.ndarray, dict[str, Any]]]:
    """Both columns with the attribute that tells their unit."""
    return {"time": (TIME, {unit: "ms"}), "force": (FORCE, {unit: "N"})}


def _xlsx() -> bytes:
    import openpyxl

    book, buffer = openpyxl.Workbook(), io.BytesIO()
    sheet: Any = book.active
    sheet.append([TIME_COLUMN, FORCE_COLUMN])
    for row in zip(TIME.tolist(), FORCE.tolist(), strict=True):
        sheet.append(row)
    book.save(buffer)
    return buffer.getvalue()


# Columns of force of files that instruments write, whose clock is "time".
OWN = {".lvm": "Force 1", ".uff": "force", ".wav": "channel", ".mf4": "Force", ".c3d": "Fz"}


def _own(name: str) -> Callable[[], bytes]:
    return lambda: instruments.files()[name]().content


FORMATS: dict[str, Callable[[], bytes]] = {
    ".csv": lambda: _text(","),
    ".tsv": lambda: _text("\t"),
    ".txt": lambda: _text(";", comma=True),
    ".parquet": _parquet,
    ".h5": lambda: instruments.hdf5(_pair("unit")),
    ".mat": lambda: instruments.mat({"run": {"time": TIME, "force": FORCE, "units": {"time": "ms", "force": "N"}}}),
    ".tdms": lambda: instruments.tdms("run", _pair("unit_string")),
    ".xlsx": _xlsx,
    ".lvm": _own("lvm_two.lvm"),
    ".uff": _own("force58.uff"),
    ".wav": _own("int16.wav"),
    ".mf4": _own("drop.mf4"),
    ".c3d": _own("plate.c3d"),
}
