"""Data files as rigs write them: dialects of one record give the same numbers; broken files get one full message."""

from __future__ import annotations

import random
import time
import zipfile
from datetime import timedelta

import numpy as np
import pytest

from bcfj_jax import InputError
from bcfj_jax.data.numbers import decimal_marks, parsed
from bcfj_jax.data.reading import read
from bcfj_jax.data.record import split
from bcfj_jax.data.textfile import Stated
from bcfj_jax.io.opening import MEGABYTE
from benchmarks.calibration.dialects import File, files, record, write
from calibration import fit, load
from calibration.impacts.proposal import understood
from calibration.problemfile import prepared

pytest.importorskip("python_calamine", reason="the extra io is not installed")
pytest.importorskip("openpyxl", reason="the extra test is not installed")
pytestmark = pytest.mark.filterwarnings("error")

RECORD = record()
FILES = files(RECORD)
CLOCK = np.array(RECORD.time, dtype=float) * 1e-3
FORCE = np.array(RECORD.force, dtype=float) * 1e3
ROWS = [",".join(cells) for cells in RECORD.rows]
NAMES = "time [ms],force [kN],position [mm]"


def test_there_are_forty_dialects():
    assert len(FILES) >= 40


@pytest.mark.parametrize("name", FILES)
def test_every_dialect_holds_the_same_numbers(name, tmp_path):
    """To the last bit, where the texts hold the same digits of the same unit."""
    file = FILES[name]
    table = read(write(file, name, tmp_path).with_suffix(file.suffix), "here")
    clock, force = table.numbers(file.time, "s", "here", False), table.numbers(file.force, "N", "here", False)
    np.testing.assert_array_equal(clock, CLOCK)
    if name.startswith("thousands"):
        np.testing.assert_allclose(force, FORCE, rtol=1e-14)
    else:
        np.testing.assert_array_equal(force, FORCE)
    assert not table.faults and "160 rows" in table.found


# One dialect of each class: separator and marks, names, units, encoding, cells, spreadsheet.
FITTED = (
    "semicolon, decimal comma", "columns of fixed width", "two lines of names and units", "Latin-1", "thousands by points",
    "spreadsheet with preamble and units",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", FITTED)
def test_the_fit_is_the_same(name, tmp_path):
    values = []
    for dialect in ("comma", name):
        found = fit(load(write(FILES[dialect], dialect, tmp_path)), starts=4)
        assert found.verdict == "identified", found.reasons
        values.append([p.value for p in found.parameters.values()])
    np.testing.assert_allclose(values[0], values[1], rtol=1e-9)


def test_one_message_says_how_the_file_is_written(tmp_path):
    (one,) = prepared(write(FILES["preamble"], "preamble", tmp_path))
    said = "; ".join(one.notes)
    for part in (
        "UTF-8 text, semicolons, decimal commas", "4 lines above the names left out", "names in line 6",
        "160 rows, lines 7 to 166", "3 columns: Zeit [ms], Kraft [kN], Weg [mm]", "160 samples over 39.75 ms, every 250 us",
    ):  # fmt: skip
        assert part in said


def data(*lines: str, second: str = "utf-8") -> File:
    """A file of lines, the second in an encoding of its own."""
    raw = [line.encode(second if k == 1 else "utf-8") for k, line in enumerate(lines)]
    return File(".csv", b"\n".join(raw) + b"\n", "time [ms]", "force [kN]")


def changed(**lines: str) -> tuple[str, ...]:
    """The rows with some of them replaced, by their line in the file; line 1 holds the names."""
    rows = [NAMES, *ROWS]
    for key, text in lines.items():
        rows[int(key.removeprefix("line")) - 1] = text
    return tuple(rows)


def halves() -> tuple[str, ...]:
    return ("time [ms],force [kN]", *(f"{t},{f}".replace(".", ",") for t, f in zip(*RECORD[:2], strict=True)))


BROKEN = {
    "cells of three kinds": (
        data(*changed(line5="0.75,0.000x,1", line9="1.75", line12="2.50,OVER,1", line20=",0.0,1", line30="7.00,inf,1",
                      line31="7.25")),
        ["3 faults", "line 9: 1 cell under 3 headers: '1.75' (2 such lines: also 31)",
         "line 20, column 'time [ms]': '' is not a finite number",
         "line 5, column 'force [kN]': '0.000x'", "line 12 'OVER', line 30 'inf'"],
    ),
    "clock and cells": (
        data(*changed(line10="1.75,0.001,1", line11="1.50,0.001,1", line40="9.50,#REF!,1")),
        ["2 faults", "line 10, column 'time [ms]'", "stands twice (2 such lines: also 11)",
         "line 40, column 'force [kN]': '#REF!'"],
    ),
    "two decimal marks": (
        data("time [ms];force [kN]",
             *(f"{c[0]};{c[1].replace('.', ',') if k in (3, 8) else c[1]}" for k, c in enumerate(RECORD.rows))),
        ["line 5, column 'force [kN]'", "nor are 2 of the column's 160 cells", "line 10", "decimals with a point"],
    ),
    "two encodings": (
        data("# Prüfer: Müller", "# 20 °C", *changed(), second="latin-1"),
        ["line 2", "byte 0xb0 is not UTF-8", "two encodings", "encoding ="],
    ),
    "an open quote and a short row": (
        data(*changed(line5='"0.75,0.0,1', line9="1.75,0.0")),
        ["2 faults", "line 5: an opening quote without its end", "line 9: 2 cells under 3 headers"],
    ),
    "unit and cells": (
        data(NAMES.replace("[ms]", "[mm]"), *ROWS[:7], "1.75,bad,2", *ROWS[8:]),
        ["2 faults", "no column 'time [ms]'", "did you mean 'time [mm]'", "line 9, column 'force [kN]': 'bad'"],
    ),
    "names that are not there": (
        data("t;F", *(f"{t};{f}" for t, f in zip(*RECORD[:2], strict=True))),
        ["2 faults", "no column 'time [ms]'", "no column 'force [kN]'"],
    ),
    "no names": (
        data(*ROWS), ["2 faults", "no column 'time [ms]'", "known here: column 1, column 2, column 3"],
    ),
    "decimals or thousands": (
        data("time [ms];force [kN]", "1.000;2.000", "2.000;3.500", "3.000;1.750", "4.000;1.250"),
        ["line 2: '1.000' is 1.000 or 1000", "--decimal of bcfj init calibration"],
    ),
    "commas for both": (
        data(*halves()), ["rows hold 4 cells under 2 headers", "commas part both columns and decimals", "semicolons"],
    ),
    "too many cells": (
        data(*changed(line5="0.75,0.0,1,7", line8="1.50,0.0,1,7,9")),
        ["line 5: 4 cells under 3 headers: '0.75 | 0.0 | 1 | 7' (2 such lines: also 8)", "take out"],
    ),
    "times after noon": (
        data(NAMES, *(f"noon +00:{float(r.split(',')[0]) / 1e3:06.3f},{r.split(',', 1)[1]}" for r in ROWS)),
        ["line 2, column 'time [ms]': 'noon +00:00.000'", "160 of the column's 160 cells", "give a time as a number"],
    ),
    "another kind": (
        File(".csv", b"PK\x03\x04 more", "time [ms]", "force [kN]"), ["is no text file", "name it .xlsx"],
    ),
    "names alone": (data(NAMES), ["has no rows below a header"]),
    "nothing": (data(""), ["has no rows below a header"]),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_one_message_names_all_that_is_wrong(name, tmp_path):
    file, parts = BROKEN[name]
    problem = write(file, name, tmp_path)
    with pytest.raises(InputError) as caught:
        load(problem)
    for part in parts:
        assert part in str(caught.value)
    assert len(str(caught.value)) < 1500 and problem.with_suffix(".csv").name in str(caught.value)


def test_two_broken_files_are_named_together(tmp_path):
    one = write(data(*changed(line5="0.75,a,1")), "one", tmp_path)
    write(data(*changed(line6="1.00,b,1")), "two", tmp_path)
    entry, law = one.read_text().removeprefix('scene = "impact"\n').split("[free]")
    one.write_text('scene = "impact"\n' + entry + entry.replace("one.csv", "two.csv") + "[free]" + law)
    with pytest.raises(InputError, match=r"(?s)one.toml: 2 faults.*one.csv: line 5.*two.csv: line 6"):
        load(one)


JUNK = [
    b"",
    b"\0",
    b'"',
    b";",
    b",",
    b"\n",
    b"\r",
    b"\xff",
    b"NaN",
    b"1e999",
    b"#",
    b"=",
    b"\t",
    b"[",
    b"9" * 30,
    b"\xc3",
    b" " * 500,
]


@pytest.mark.full
@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_file_is_read_or_refused(seed, tmp_path):
    """Never a traceback, never slow: bytes are put in, taken out, changed, repeated, or the end is cut off."""
    draw = random.Random(seed)
    file = FILES[draw.choice(sorted(FILES))]
    raw = bytearray(file.content)
    for _ in range(draw.choice([1, 2, 5, 30])):
        at, size, kind = draw.randrange(len(raw) + 1), draw.randrange(1, 60), draw.randrange(5)
        if kind == 0:
            raw[at:at] = draw.choice(JUNK)
        elif kind == 1:
            del raw[at : at + size]
        elif kind == 2:
            raw[at : at + 1] = bytes([draw.randrange(256)])
        elif kind == 3:
            raw[at:at] = raw[at // 2 : at // 2 + size]
        elif draw.random() < 0.3:
            del raw[at:]
    path = tmp_path / f"d{file.suffix}"
    path.write_bytes(raw)
    start = time.process_time()
    try:
        understood(read(path, "record"))
    except InputError as error:
        said = str(error)
    else:
        said = ""
    assert len(said) < 3000 and time.process_time() - start < 2.0


@pytest.mark.parametrize(
    ("stated", "lines", "wanted"),
    [
        (Stated(decimal=","), ("t [s];F [N]", "1.000;2,000", "2.000;3,500"), [[1000.0, 2000.0], [2.0, 3.5]]),
        (Stated(decimal="."), ("t [s];F [N]", "1.000;2.000", "2.000;3.500"), [[1.0, 2.0], [2.0, 3.5]]),
        (Stated(separator="pipe"), ("t [s]|F [N]", "1,5|2", "2,5|3"), [[1.5, 2.5], [2.0, 3.0]]),
        (Stated(separator=";", header=2), ("a;b", "t [s];F [N]", "1;2", "2;3"), [[1.0, 2.0], [2.0, 3.0]]),
        (Stated(header=[1, 2]), ("clock,cell", "t,F", "s,N", "1,2", "2,3"), [[1.0, 2.0], [2.0, 3.0]]),
        (Stated(header=0), ("1,2", "2,3"), [[1.0, 2.0], [2.0, 3.0]]),
    ],
)
def test_what_is_stated_holds(stated, lines, wanted, tmp_path):
    (tmp_path / "d.csv").write_text("\n".join(lines), encoding="utf-8")
    table = read(tmp_path / "d.csv", "here", None, stated)
    names = table.header if stated.header != 0 else ("column 1 [s]", "column 2 [N]")
    found = [table.numbers(name, unit, "here", False).tolist() for name, unit in zip(names, ("s", "N"), strict=True)]
    assert found == wanted


def test_rows_below_stated_names_are_data(tmp_path):
    (tmp_path / "d.csv").write_text("a;b\nt [s];F [N]\nc;d\n1;2\n2;3\n", encoding="utf-8")
    table = read(tmp_path / "d.csv", "here", None, Stated(header=2))
    with pytest.raises(InputError, match=r"line 3, column 't \[s\]': 'c'"):
        table.numbers("t", "s", "here", False)


def test_a_spreadsheet_of_zeros_is_refused_before_it_is_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "d.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.xml", bytes(300 * MEGABYTE))
    with pytest.raises(InputError, match="unpacks to 300 MB, more than the 256 MB"):
        read(tmp_path / "d.xlsx", "here")


def test_a_spreadsheet_with_two_tables_asks_which(tmp_path):
    import openpyxl

    book = openpyxl.Workbook()
    for sheet in (book.worksheets[0], book.create_sheet("second")):
        for row in (("t [s]", "F [N]"), (0.0, 1.5), (1.0, "2,5")):
            sheet.append(row)
    book.save(tmp_path / "d.xlsx")
    with pytest.raises(InputError, match=r"2 sheets with numbers; choose with table = .*'Sheet', 'second'"):
        read(tmp_path / "d.xlsx", "here")
    with pytest.raises(InputError, match=r"no sheet 'secnd' in .*; did you mean 'second'\?"):
        read(tmp_path / "d.xlsx", "here", "secnd")
    assert read(tmp_path / "d.xlsx", "here", "second").numbers("F", "N", "here", False).tolist() == [1.5, 2.5]


def test_a_spreadsheet_of_texts_and_durations(tmp_path):
    """A duration is a time in seconds; a text that is 1.234 or 1234 is not taken for either."""
    import openpyxl

    book = openpyxl.Workbook()
    for row in (
        ("t [s]", "F [N]", "remark"),
        (timedelta(seconds=1), "1,234", "o.k."),
        (timedelta(seconds=2), "2,500", ""),
    ):
        book.worksheets[0].append(row)
    book.save(tmp_path / "d.xlsx")
    with pytest.raises(InputError, match=r"d.xlsx: Sheet: row 2: '1,234' is 1.234 or 1234.*--decimal"):
        read(tmp_path / "d.xlsx", "here")
    table = read(tmp_path / "d.xlsx", "here", None, Stated(decimal=","))
    assert table.numbers("t", "s", "here", False).tolist() == [1.0, 2.0]
    assert table.numbers("F", "N", "here", False).tolist() == [1.234, 2.5]


def test_rows_are_chosen_by_numbers_however_they_are_written(tmp_path):
    (tmp_path / "d.csv").write_text("Winkel;Zeit [s];Kraft [N]\n0,50;1;2\n0,50;2;3,5\n1,00;1;4\n", encoding="utf-8")
    table = read(tmp_path / "d.csv", "here")
    ((_, part),) = split(table, {"Winkel": 0.5}, "here")
    assert part.numbers("Kraft", "N", "here", False).tolist() == [2.0, 3.5]
    assert [name for name, _ in split(table, {"Winkel": ["0,50", 1]}, "here")] == ["Winkel 0,50", "Winkel 1"]
    with pytest.raises(InputError, match=r"here: rows: no row has Winkel = 0.7; values there: 0,50, 1,00"):
        split(table, {"Winkel": 0.7}, "here")


def test_latin_letters_of_a_stated_encoding(tmp_path):
    (tmp_path / "d.csv").write_bytes("Zeit [µs];Kraft [N]\n1;2\n3;4\n".encode("utf-16-be"))
    assert read(tmp_path / "d.csv", "here", None, Stated(encoding="utf-16-be")).header == ("Zeit [µs]", "Kraft [N]")
    with pytest.raises(InputError, match="here encoding: no encoding 'latn'"):
        read(tmp_path / "d.csv", "here", None, Stated(encoding="latn"))
    with pytest.raises(InputError, match="here separator: '#'; give one of tab"):
        read(tmp_path / "d.csv", "here", None, Stated(separator="#"))


def test_numbers_of_two_readings():
    """1.234 alone is 1.234 or 1234; where the file says which, it is read, and where a cell contradicts, refused."""
    assert decimal_marks([["1.234", "5"], ["1"]]) is None
    assert decimal_marks([["1.234"], ["0,5"]]) == [",", ","]
    assert decimal_marks([["0.25"], ["0,5"]]) == [".", ","]
    assert parsed(["1.234", "7"], ",")[0].tolist() == [1234.0, 7.0]
    assert parsed(["0.998", "1,001"], ".")[1].tolist() == [False, True]
    assert parsed(["1,234.5", "999.5"], ".")[0].tolist() == [1234.5, 999.5]
    assert parsed(["1'234,5", "1.5D-03".replace(".", ",")], ",")[0].tolist() == [1234.5, 1.5e-3]
    assert parsed(["1_000", "", "n/a"], ".")[1].tolist() == [True, False, False]
