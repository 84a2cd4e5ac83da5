"""Do data files in forty dialects of one record give one fit?

    python -m benchmarks.calibration.dialects [NAME ...]

Each file holds the same digits as another rig or program would write them. ``tests/calibration/test_dialects.py`` holds
the parsed numbers to each other; here every file is fitted, and the table is printed and kept.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.clock import clocked
from benchmarks.common import add, options
from benchmarks.references.impact import contact

# Of the law F = K d^n (1 + a d') that made the record.
LAW = {"stiffness": 9e4, "exponent": 1.3, "damping": 0.15}
MASS, SPEED = 0.4, 1.2
GERMAN = "Zeit [ms];Kraft [kN];Weg [mm]"


class File(NamedTuple):
    """A file: its suffix, its content, and its headers of time and force, as a problem file names them."""

    suffix: str
    content: bytes
    time: str
    force: str


class Record(NamedTuple):
    """One record as texts with decimal points: time [ms], force [kN], position [mm]."""

    time: list[str]
    force: list[str]
    place: list[str]

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """One row a sample."""
        return list(zip(*self, strict=True))


def record() -> Record:
    """A drop on a pad, 12 ms of flight before the contact, 1 % noise; by SciPy."""
    times = np.arange(0.0, 0.04, 2.5e-4)
    drop = contact(LAW, MASS, SPEED, begin=12.1e-3)

    force, place = drop.force(times), drop.depth(times)
    force += 0.01 * force.max() * np.random.default_rng(7).standard_normal(times.size)
    return Record(
        [f"{1e3 * t:.2f}" for t in times], [f"{1e-3 * f:.6f}" for f in force], [f"{1e3 * x + 350.0:.4f}" for x in place]
    )


def _text(
    r: Record, separator: str = ",", decimal: str = ".", head: tuple[str, ...] | None = None, suffix: str = ".csv",
    end: str = "\n", encoding: str = "utf-8", tail: str = "", row: Callable[[tuple[str, ...]], tuple[str, ...]] | None = None,
    time: str = "time [ms]", force: str = "force [kN]", every: str = "{}",
) -> File:  # fmt: skip
    """A text file: lines of the head, then the rows with another separator, decimal mark, line end and encoding."""
    names = separator.join(("time [ms]", "force [kN]", "position [mm]"))
    rows = [row(cells) if row else cells for cells in r.rows]
    body = [every.format(separator.join(c.replace(".", decimal) for c in cells)) for cells in rows]
    lines = [*(head if head is not None else (names,)), *body]
    return File(suffix, (end.join(lines) + end + tail.replace("\n", end)).encode(encoding), time, force)


def _sheet(
    rows: Sequence[Sequence[object]], notes: bool = False, time: str = "time [ms]", force: str = "force [kN]"
) -> File:
    import openpyxl

    book = openpyxl.Workbook()
    for cells in rows:
        book.worksheets[0].append(list(cells))  # pyright: ignore[reportArgumentType]
    if notes:
        book.create_sheet("notes").append(["measured by hand"])
    file = io.BytesIO()
    book.save(file)
    return File(".xlsx", file.getvalue(), time, force)


def _thousands(texts: list[str], mark: str, decimal: str) -> list[str]:
    """Kilonewtons as newtons with a mark between thousands."""
    numbers = [f"{float(t) * 1e3:,.3f}" for t in texts]
    return [n.replace(",", "\0").replace(".", decimal).replace("\0", mark) for n in numbers]


def _in_newtons(r: Record, mark: str, decimal: str, separator: str, quoted: bool = False) -> File:
    rows = zip((t.replace(".", decimal) for t in r.time), _thousands(r.force, mark, decimal), strict=True)
    lines = [f"time [ms]{separator}force [N]"]
    quote = '"' if quoted else ""
    lines += [f"{t}{separator}{quote}{f}{quote}" for t, f in rows]
    return File(".csv", ("\n".join(lines) + "\n").encode(), "time [ms]", "force [N]")


def files(r: Record) -> dict[str, File]:
    """The dialects by name."""
    preamble = ("Messung: Fallversuch 7", "Datum;12.03.2024", "Kanal;Kraft;Weg", "Abtastrate [Hz];4000", "")
    german: dict[str, Any] = {"separator": ";", "decimal": ",", "time": "Zeit", "force": "Kraft"}
    bracket: dict[str, Any] = {**german, "time": "Zeit [ms]", "force": "Kraft [kN]"}
    numbers = [[float(c) for c in cells] for cells in r.rows]
    names = ["time [ms]", "force [kN]", "position [mm]"]
    return {
        "comma": _text(r),
        "semicolon, decimal comma": _text(r, ";", ","),
        "semicolon, decimal point": _text(r, ";"),
        "tab": _text(r, "\t", suffix=".tsv"),
        "tab, decimal comma": _text(r, "\t", ",", suffix=".txt"),
        "pipe": _text(r, "|"),
        "pipes about each row": _text(r, " | ", head=("| time [ms] | force [kN] | position [mm] |",), every="| {} |"),
        "blanks": _text(r, "  ", head=("time[ms] force[kN] position[mm]",), suffix=".dat", time="time", force="force"),
        "columns of fixed width": _text(
            r, suffix=".prn", separator="", row=lambda cells: tuple(f"{c:>14}" for c in cells),
            head=("     time [ms]    force [kN] position [mm]",),
        ),
        "blanks, decimal comma": _text(r, "   ", ",", suffix=".asc"),
        "comma and blank": _text(r, ", "),
        "comments with #": _text(r, head=("# rig 3", "#", "time [ms],force [kN],position [mm]", "# begin")),
        "comments with %": _text(r, head=("% rig 3, 4 kHz", "time [ms],force [kN],position [mm]")),
        "comments with //": _text(r, head=("// rig 3", "time [ms],force [kN],position [mm]")),
        "comments with ;": _text(r, head=("; rig 3; 4 kHz", "time [ms],force [kN],position [mm]")),
        "names in a comment": _text(
            r, " ", head=("# time[ms] force[kN] position[mm]",), suffix=".txt", time="time", force="force"
        ),
        "preamble": _text(r, head=(*preamble, GERMAN), **bracket),
        "preamble of full rows": _text(r, head=("Rig;3;", "Operator;Schmidt;", "Rate;4000;", GERMAN), **bracket),
        "row of units": _text(r, head=("Zeit;Kraft;Weg", "ms;kN;mm"), **german),
        "row of units in brackets": _text(r, head=("Zeit;Kraft;Weg", "[ms];[kN];[mm]"), **german),
        "row of units in parentheses": _text(r, head=("Time,Force,Travel", "(ms),(kN),(mm)"), time="Time", force="Force"),
        "two lines of names and units": _text(
            r, head=("clock,load cell,laser", "value,value,value", "ms,kN,mm"), time="clock value", force="load cell value",
        ),
        "a line above the names": _text(
            r, ";", head=("rig;load cell;", "time [ms];peak [kN];x [mm]"), time="time [ms]", force="peak [kN]",
        ),
        "units in parentheses": _text(r, head=("Time (ms),Force (kN),Position (mm)",), time="Time", force="Force (kN)"),
        "units after a slash": _text(r, ";", ",", head=("t / ms;F / kN;x / mm",), time="t", force="F / kN"),
        "units after a slash, DIN": _text(r, ";", ",", head=("t/ms;F/kN;x/mm",), time="t/ms", force="F"),
        "units after an underscore": _text(r, head=("time_ms,force_kN,x_mm",), time="time_ms", force="force_kN"),
        "byte order mark": _text(r, encoding="utf-8-sig"),
        "UTF-16": _text(r, "\t", encoding="utf-16"),
        "UTF-16 without a mark": _text(r, "\t", encoding="utf-16-le"),
        "Latin-1": _text(r, head=("Prüfer: Müller, µ-Halle", GERMAN), encoding="latin-1", **bracket),
        "Windows-1252": _text(r, head=("# 20 °C \u2013 Halle 2", GERMAN), encoding="cp1252", **bracket),
        "separators at the ends": _text(r, head=("time [ms],force [kN],position [mm],",), every="{},"),
        "empty tail": _text(r, ";", ",", tail=";;\n;;\n\n"),
        "blank lines": _text(r, every="{}\n", end="\n"),
        "quoted": _text(r, head=('"time [ms]","force [kN]","position [mm]"',), row=lambda c: tuple(f'"{x}"' for x in c)),
        "quoted names with commas and line breaks": _text(
            r, head=('"time [ms]","force, filtered\n[kN]","x"',), force="force, filtered [kN]",
        ),
        "Windows line ends": _text(r, ";", ",", end="\r\n"),
        "old Mac line ends": _text(r, ";", ",", end="\r"),
        "D exponents": _text(r, row=lambda c: (c[0], f"{c[1]}D+00", f"{c[2]}d0"), suffix=".dat"),
        "E exponents, decimal comma": _text(r, "\t", ",", row=lambda c: (f"{c[0]}E+00", f"{c[1]}E+0", c[2])),
        "words for no number": _text(r, row=lambda c: (*c[:2], ("NaN", "#N/A", "-", "1.#QNAN", "")[len(c[2]) % 5])),
        "sep= of Excel": _text(r, ";", ",", head=("sep=;", "time [ms];force [kN];position [mm]")),
        "signs of typography": _text(r, "\t", row=lambda c: tuple(x.replace("-", "\u2212") for x in c)),
        "index and remarks": _text(r, head=(",time [ms],force [kN],remark",), row=lambda c: ("1", *c[:2], "ok")),
        "thousands by commas": _in_newtons(r, ",", ".", ",", quoted=True),
        "thousands by points": _in_newtons(r, ".", ",", ";"),
        "thousands by blanks": _in_newtons(r, "\u202f", ",", ";"),
        "thousands by apostrophes": _in_newtons(r, "'", ".", ";"),
        "spreadsheet": _sheet([list(names), *map(list, numbers)]),
        "spreadsheet with preamble and units": _sheet(
            [["Rig 3"], ["Rate", 4000], [], ["Zeit", "Kraft", "Weg"], ["ms", "kN", "mm"], *map(list, numbers)],
            True, "Zeit", "Kraft",
        ),
        "spreadsheet of texts": _sheet([list(names), *([c.replace(".", ",") for c in cells] for cells in r.rows)]),
    }  # fmt: skip


PROBLEM = """scene = "impact"
[[experiment]]
file = "{file}"
time = "{time}"
observe = {{ "contact.normal" = "{force}" }}
noise = "estimate"
align = "onset"
window = ["-4 ms", "20 ms"]
parameters = {{ mass = "0.4 kg", approach_speed = "1.2 m/s" }}
[free]
stiffness = [1e3, 1e7]
exponent = [1.0, 2.5]
damping = [0.01, 3]
"""


def write(file: File, name: str, folder: Path) -> Path:
    """The file and its problem file; the path of the latter."""
    data = folder / f"{''.join(c if c.isalnum() else '_' for c in name)}{file.suffix}"
    data.write_bytes(file.content)
    problem = data.with_suffix(".toml")
    problem.write_text(PROBLEM.format(file=data.name, time=file.time, force=file.force), encoding="utf-8")
    return problem


def main() -> int:
    """Fit every dialect and print the table."""
    import calibration

    every = files(record())
    chosen, rows, first = options(__doc__, {"dialects": every}).dialects, [], None
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen:
            problem = write(every[name], name, Path(folder))
            fit, took = clocked(lambda problem=problem: calibration.fit(calibration.load(problem), starts=4))
            values = {key: p.value for key, p in fit.parameters.items()}
            first = first or values
            worst = max(abs(value / first[key] - 1.0) for key, value in values.items())
            rows.append(
                {"dialect": name, "verdict": fit.verdict, **values, "deviation": worst, "wall_s": took["wall_s"]}
            )
            print(*rows[-1].values(), flush=True)
    if chosen == list(every):
        add("dialects", {"rows": rows})
    return 0 if all(row["verdict"] == "identified" and row["deviation"] < 1e-6 for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
