"""Measured files of every kind become the same record: the extension, or else the first bytes, say which reader reads them.

    .csv .txt .tsv .tab .dat .asc .prn   text; how it is written is found (``textfile``)
    .xlsx .xlsm .xlsb .xls .ods          a sheet, whose cells are laid out as those of a text
    all others                           ``readers``, a module a kind; a user's own come first (``--code``)

A file may hold several tables: groups, structs and clocks, named by their path, as in "run_3/sensors".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.core.errors import InputError, clip, nearest
from bcfj_jax.core.quantities import rounded
from bcfj_jax.data import clock, isolated, numbers, preamble, textfile
from bcfj_jax.data.columns import Column, Columns, Content, Tables, vector
from bcfj_jax.data.decoding import BINARY
from bcfj_jax.data.layout import File, Row, found
from bcfj_jax.data.readers import READERS, reader_of, sheets
from bcfj_jax.data.record import Record, with_stated, with_sweeps
from bcfj_jax.data.sensitivity import Sensitivities
from bcfj_jax.data.textfile import Stated
from bcfj_jax.io import opening
from bcfj_jax.io.units import column


def read(path: Path, where: str, inside: str | None = None, stated: Stated | None = None) -> Record:
    """The table in a file; ``stated``: how a text or a spreadsheet is written, where it is not to be found.

    ``inside``: which table, in a file that can hold several; None: the only one, or what stands outside any group.
    """
    kind, stated = path.suffix.lower(), stated or Stated()
    stated.check(where)
    known = kind in _TEXTS or any(kind in r.KINDS for r in READERS)
    if not (known or opening.READERS or path.exists()):
        _unknown(path, where, b"")
    head = opening.head(path, where, _missing(where))
    sensors = Sensitivities(stated.sensitivity or "", stated.full_scale or "", where)
    found = with_stated(_turned(replace(_read(path, kind, head, where, inside, stated), sensitivities=sensors)))
    return found if stated.rate is None else _clocked(found, stated.rate, where)


def _turned(table: Record) -> Record:
    """A table with the attitude q0 to q3, scalar first, of a body whose matrix or angles stand in columns (Qualisys).

    ``Rot[0]`` to ``Rot[8]`` are the matrix column by column. A row without one, of a body not seen, is blank.
    """
    named = [h for k in range(9) for h in table.header if h.lower().endswith(f"rot[{k}]")]
    turned = [h for h in table.header if column(h)[1] in (None, "deg", "°", "rad")]
    each = ([h for a in names for h in turned if column(h)[0].lower().endswith(a)] for names in _ANGLES)
    angles = next((found for found in each if len(found) == 3), [])
    if any(h.startswith("q0") for h in table.header) or not (len(named) == 9 or (len(angles) == 3 and table.clock)):
        return table
    from scipy.spatial.transform import Rotation

    if len(named) == 9:
        cells = np.array([table.numbers(h, "1", table.name, True) for h in named])
        matrices = np.nan_to_num(cells).reshape(3, 3, -1).transpose(2, 1, 0)
        seen = np.abs(np.linalg.det(matrices) - 1.0) < _TURNS
        turned = Rotation.from_matrix(np.where(seen[:, None, None], matrices, np.eye(3)))
    else:
        vector = "rvec" in angles[0].lower()
        bare = column(angles[0])[1] is None and not vector
        cells = np.array([table.numbers(h, "1" if bare else "rad", table.name, True) for h in angles])
        seen = np.isfinite(cells).all(axis=0)
        # Angles without a unit are degrees if they are larger than a turn; else nothing says.
        wide, scale = np.abs(cells[:, seen]).max(initial=0.0) > 2.0 * np.pi, np.pi / 180.0 if bare else 1.0
        turns = scale * np.nan_to_num(cells.T)
        ways: dict[str, Any] = {
            "turn about the body's x, y, z": Rotation.from_euler("XYZ", turns),
            "turn about the body's z, y, x": Rotation.from_euler("ZYX", turns[:, ::-1]),
            "are a rotation vector": Rotation.from_rotvec(turns),
        }
        odd = {said: _unsteady(way[seen]) for said, way in ways.items()}
        said, other = sorted(ways, key=lambda w: odd[w])[:2]
        if vector:
            said = "are a rotation vector"
        elif (bare and not wide) or not _STEADIER * odd[said] < min(odd[other], 1.0):
            return table
        turned = ways[said]
        much = rounded(odd[other] / max(odd[said], 1e-6))
        note = f"angles {said}" + f": its spin is then {much} times steadier" * (not vector)
        table = replace(table, found="; ".join(filter(None, (table.found, note))))
    parts = turned.as_quat(scalar_first=True)
    for k in (3, 2, 1, 0):
        table = table.beside(f"q{k}", np.where(seen, parts[:, k], np.nan))
    return table


def _unsteady(turned: Any) -> float:
    """By what share of itself the spin of a body that turns changes, in the median over steps of a fiftieth of a record.

    No torque acts in flight: that of a body about as wide as high stays, but not where angles are taken in another order.
    """
    if len(way := turned[:: max(1, len(turned) // 50)]) < 2:
        return 1.0
    spin = (way[1:] * way[:-1].inv()).as_rotvec()
    size, change = (np.linalg.norm(x, axis=1) for x in (spin[1:], np.diff(spin, axis=0)))
    moves = size > 0.2 * size.max(initial=0.0)
    return float(np.median(change[moves] / size[moves])) if np.count_nonzero(moves) > _FEW_TURNS else 1.0


def _clocked(table: Record, rate: str, where: str) -> Record:
    """A table with a clock of a rate that is stated of it."""
    even = clock.stated([("rate", rate)], where)
    if even is None:
        raise InputError(f"{where} rate", f"'{clip(rate)}' is no rate of samples", 'give one such as "20 kHz"')
    if table.clock:
        raise InputError(f"{where} rate", f"{table.name} has a clock, '{table.clock}'", "take the rate out")
    return table.beside("time [s]", even[1] * np.arange(table.lines.size))


def tables(path: Path, where: str, stated: Stated) -> list[str]:
    """Names of the tables with columns in a file that holds several; none of a text."""
    reader = reader_of(path.suffix.lower(), opening.head(path, where, "give the path of a measured file"))
    if reader is None or path.suffix.lower() in _TEXTS:
        return []
    found = isolated.read(path, where, None, reader)
    return [name for name, held in found.tables.items() if held] + _filled(found.sheets)


def _filled(sheets: Mapping[str, Sequence[Sequence[Any]]]) -> list[str]:
    """The sheets that hold numbers beside each other, in more than a row; rows are numbers and their cells."""
    return [n for n, rows in sheets.items() if sum(sum(map(numbers.is_number, cells)) >= 2 for _, cells in rows) > 1]


def _unknown(path: Path, where: str, head: bytes) -> None:
    kinds = sorted({*_TEXTS, *(k for r in READERS for k in r.KINDS)})
    found = f"{clip(str(path))} is of no kind known here"
    begun = next((f"it begins as {remedy}; " for mark, remedy in BINARY if head.startswith(mark)), "")
    raise InputError(where, found, f"{begun}known are {', '.join(kinds)}; a reader of your own needs --code FILE")


def _read(path: Path, kind: str, head: bytes, where: str, inside: str | None, stated: Stated) -> Record:
    for name, own in opening.READERS.items():
        if own.sniff(path, head):
            columns = {str(k): vector(np.asarray(v)) for k, v in own.read(path).items()}
            table = {k: c for k, c in columns.items() if c}
            return replace(_chosen({"": table}, path, where, inside), reader=name)
    reader = reader_of(kind, head)
    if reader is None and kind not in _TEXTS and (b"\0" in head or not head.strip()):
        _unknown(path, where, head)
    if reader is None:
        if inside is not None:
            raise InputError(f"{where} table", f"{path} holds no tables inside", "take the key out")
        return textfile.read(path, where, stated)
    if reader is sheets:
        opening.check(path, opening.LARGEST_TEXT, where, _missing(where), "write it as Parquet or HDF5")
        return _sheet(isolated.read(path, where, inside, reader), path, where, inside, stated)
    opening.check(path, opening.LARGEST_BINARY, where, _missing(where), "give a smaller file")
    if told := [key for key, value in stated.written().items() if value is not None]:
        raise InputError(f"{where} {told[0]}", f"{path} is no text", "take the key out")
    content = isolated.read(path, where, inside, reader)
    try:
        table = _chosen(content.tables, path, where, inside)
    except InputError as error:
        if not content.note:
            raise
        said = f"{path}: {content.note}; {error.found}"
        raise InputError(where, said, "record or export the file again") from None
    said = "; ".join(filter(None, (content.note, table.found)))
    return replace(table, found=said, reader=reader.__name__.rpartition(".")[2])


def _missing(where: str) -> str:
    return f"give {'the path of a measured file' if where == 'record' else 'a path relative to the problem file'}"


def _sheet(content: Content, path: Path, where: str, inside: str | None, stated: Stated) -> Record:
    """The table on a sheet: the only one that holds numbers, or the one named ``inside``."""
    if inside is not None and inside not in content.sheets:
        raise InputError(f"{where} table", f"no sheet '{inside}' in {path}", nearest(inside, content.sheets))
    sheets = {
        name: [Row(k, cells) for k, cells in rows if not all(map(numbers.is_missing, cells))]
        for name, rows in content.sheets.items()
    }
    filled = _filled(content.sheets)
    if inside is None and len(filled) > 1:
        names = ", ".join(f"'{n}'" for n in filled[:8])
        raise InputError(
            where, f"{path} holds {len(filled)} sheets with numbers", f'choose with table = "...": {names}'
        )
    name = inside or next(iter(filled or sheets))
    about = preamble.above(r for other, rows in sheets.items() if other not in (name, *filled) for r in rows)
    about += [pair for other, rows in sheets.items() if other != name for pair in _listed(rows, name)]
    file = File(f"{path}: {name}", "row")
    rows = sheets[name]
    if not any(numbers.is_number(cell) for row in rows for cell in row.cells):  # "12.4 ms" is a text of a number.
        lines, labels = textfile.numbered(["\t".join(map(str, row.cells)) for row in rows])
        rows = [row._replace(cells=line.split("\t")) for row, line in zip(rows, lines, strict=True)]
        at = labels[0].line - 1 if labels else 0
        rows[at:at] = labels
    layout = found(rows, file, stated.header)
    marks = textfile.decimal_marks(layout, stated, file)
    table = textfile.table(path, layout, marks, file, f"sheet '{name}'", name)
    return replace(table, reader="sheets", facts=(*table.facts, *about))


def _listed(rows: Sequence[Row], sheet: str) -> list[tuple[str, str]]:
    """What a sheet that lists others states of one of them: the names above its rows, and the cells of the row of that name."""
    texts = [[f"{c:.15g}" if isinstance(c, float) else str(c) for c in row.cells] for row in rows]
    own = [cells for cells in texts[1:] if cells and sheet in (cells[0], f"{texts[0][0]} {cells[0]}")]
    return [pair for cells in own[:1] for pair in zip(texts[0], cells, strict=False)]


def _chosen(tables: Tables, path: Path, where: str, inside: str | None) -> Record:
    """The table that is meant, its columns read and checked for one length."""
    tables = {name: columns for name, columns in tables.items() if columns}
    if not tables:
        remedy = 'store columns as vectors of numbers; of a MATLAB table: s = table2struct(t, "ToScalar", true)'
        raise InputError(where, f"{path} holds no columns", remedy)
    wanted = next(iter(tables)) if len(tables) == 1 and inside is None else (inside or "").strip("/")
    if wanted not in tables:
        if inside is None:
            names = ", ".join(f"'{name}'" for name in list(tables)[:8])
            raise InputError(where, f"{path} holds {len(tables)} tables", f'choose with table = "...": {names}')
        raise InputError(f"{where} table", f"no table '{inside}' in {path}", nearest(wanted, tables))
    found = tables[wanted]
    longest = max(c.size for c in found.values())
    if longest == 0:
        raise InputError(str(path), "has no rows", "give a file with data")
    # A single number beside vectors describes them, as its step of time does; it is no column.
    alone = [(name, c) for name, c in found.items() if c.size == 1 < longest]
    found = {name: c for name, c in found.items() if c.size > 1 or longest == 1}
    facts = [(_header(name, c), str(np.ravel(c.values())[0])) for name, c in alone if c.values().size]
    found, said = _with_clock(found, facts, str(path))
    timed = [{n: c for n, c in found.items() if c.size == size} for size in {c.size for c in found.values()}]
    timed = [part for part in timed if len(part) > 1 and any(clock.is_time(_header(n, c)) for n, c in part.items())]
    if len(timed) == 1 and len(timed[0]) < len(found):
        short = {n: c for n, c in found.items() if n not in timed[0]}
        left = ", ".join(f"'{n}' {c.size}" for n, c in short.items())
        facts += [(_header(n, c), str(x)) for n, c in short.items() if c.size < _FEW for x in np.ravel(c.values())]
        found, said = (
            timed[0],
            "; ".join(filter(None, (said, f"columns of another length than its clock left out: {clip(left)}"))),
        )
    if len({c.size for c in found.values()}) > 1:
        sizes = ", ".join(f"'{name}' {c.size}" for name, c in list(found.items())[:8])
        place = f"{path}: {wanted}" if wanted else str(path)
        remedy = "put columns sampled together into a group of their own"
        raise InputError(place, f"its columns have different lengths: {sizes}", remedy)
    longest = max(c.size for c in found.values())
    header = [f"{n} [{c.unit}]" if c.unit and column(n)[1] is None else n for n, c in found.items()]
    arrays = tuple(np.ravel(c.values()) for c in found.values())
    arrays = tuple(np.char.decode(a, "utf-8", "replace") if a.dtype.kind == "S" else a for a in arrays)
    lines = np.arange(1, longest + 1)
    named = wanted if len(tables) > 1 or inside else ""
    header = preamble.titled(header, facts, arrays, True)
    return with_sweeps(Record(path, tuple(header), arrays, lines, "row", named, found=said, facts=tuple(facts)))


def _with_clock(found: Columns, facts: preamble.Facts, where: str) -> tuple[Columns, str]:
    """Columns with a clock of the step or rate that stands beside them, where none is a column of times."""
    if any(clock.is_time(_header(name, c)) for name, c in found.items()):
        return found, ""
    even = clock.stated(facts, where)
    if even is None:
        return found, ""
    size, (start, step) = max(c.size for c in found.values()), even
    if any(_FEW < c.size < size for c in found.values()):
        return found, ""  # Of which of these it is the clock is not said.
    times = Column("s", size, lambda: start + step * np.arange(size))
    return {"time": times, **found}, f"its clock is every {step:.6g} s, as it states"


def _header(name: str, column: Column) -> str:
    return name if column.unit is None else f"{name} [{column.unit}]"


# How far the determinant of a rotation matrix that is rounded may be from 1.
_TURNS = 0.05
# Names of angles about x, y, z, or of a rotation vector; how much steadier one order makes the spin than another; changes of
# spin that tell it.
_ANGLES = (("roll", "pitch", "yaw"), ("rx", "ry", "rz"), ("rvec 1", "rvec 2", "rvec 3"), ("rvec_x", "rvec_y", "rvec_z"))
_STEADIER, _FEW_TURNS = 3.0, 8
# A vector of fewer numbers than these is none of samples, as speeds of runs.
_FEW = 64
_TEXTS = (".csv", ".txt", ".tsv", ".tab", ".dat", ".asc", ".prn")
