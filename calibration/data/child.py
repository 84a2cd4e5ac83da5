"""Reads a binary file in a process of its own, which a damaged file may end: see ``isolated``.

    python -P child.py FILE TABLE BYTES SECONDS

Two things go to the standard output: a line of JSON, {"tables": [[path of the table, name, unit, size, whether values follow],
...], "note": what the file lacks}, and then, in this order, the values of the table TABLE ("*" for every table, "" for the only
one), each as an .npy. A column is a vector of numbers or texts, or one of either; no object leaves. Of a spreadsheet the line is
{"sheets": {name: [[number of the row, its cells], ...]}}, of the sheet TABLE or of all. This file imports nothing of ours, for
its start is most of what reading a file costs.

Exit codes: 0 done, 3 the file is refused: the last line on the standard error is JSON, [the reason, the remedy or null].
"""

from __future__ import annotations

import contextlib
import datetime
import json
import logging
import os
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

REFUSED = 3
UNIT_NAMES = ("unit", "units")
# Of a spreadsheet, whose cells are texts in an archive [bytes].
_UNPACKED = 1 << 28
SHEETS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
# A segment of a TDMS file begins with a tag, its content's bits, a version, and the lengths of itself and of its description
# [bytes].
_TAG, _LEAD = b"TDSm", 28
_UNKNOWN = 1 << 62
_SHOWN = 4


class Refused(Exception):
    """What is wrong with a file, and the remedy."""


class Column(NamedTuple):
    """A column that is there: its unit, its number of values, and how to read them."""

    unit: str | None
    size: int
    values: Callable[[], Any]


# The columns of a table by name, and the tables of a file by path; "" is what stands outside any group.
Columns = dict[str, Column]
Tables = dict[str, Columns]


def vector(values: np.ndarray, unit: object = None) -> Column | None:
    """An array as a column, or None for what is none: a matrix, a reference, a complex number."""
    if values.dtype.kind not in "iufbOSUMm" or (values.ndim and max(values.shape) != values.size):
        return None
    if values.dtype.kind == "O" and not all(isinstance(v, str) for v in values.flat):
        return None
    return Column(text(unit), values.size, lambda: values)


def text(value: object) -> str | None:
    """A text in any of the forms in which files hold one."""
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value).strip() or None if isinstance(value, str) else None


def mat(file: str) -> Tables:
    """The vectors of a MATLAB file up to version 7.2, by the path of the struct that holds them."""
    from scipy.io import loadmat

    tables: Tables = {}

    def visit(table: str, content: Mapping[str, Any]) -> None:
        columns = tables.setdefault(table, {})
        for name, value in content.items():
            if isinstance(value, Mapping):
                visit(f"{table}/{name}".strip("/"), value)
            elif not name.startswith("__"):
                with contextlib.suppress(ValueError):  # A cell of vectors that differ in length.
                    if found := vector(np.asarray(value)):
                        columns[name] = found

    visit("", loadmat(file, simplify_cells=True))
    return _with_units(tables)


def hdf5(content: Any, h5py: Any) -> Tables:
    """The vectors of an open HDF5 file, also of a MATLAB file of version 7.3, by the path of their group."""
    tables: Tables = {}

    def visit(name: str, item: Any) -> None:
        # MATLAB keeps the content of cells and objects in groups of these names.
        if name.startswith("#") or not isinstance(item, h5py.Dataset):
            return
        unit = next((item.attrs[k] for k in UNIT_NAMES if k in item.attrs), None)
        if item.dtype.names:
            tables[name] = {field: Column(None, item.size, _part(item, field)) for field in item.dtype.names}
            return
        parent, _, own = name.rpartition("/")
        found = _matlab_text(item) if item.attrs.get("MATLAB_class") == b"char" else _dataset(item, unit)
        if found:
            tables.setdefault(parent, {})[own] = found

    content.visititems(visit)
    return _with_units(tables)


def _part(item: Any, field: str) -> Callable[[], Any]:
    return lambda: item[field]


def _dataset(item: Any, unit: object) -> Column | None:
    if item.shape is None or (item.ndim and max(item.shape) != item.size):
        return None
    if item.dtype.kind == "O":
        return Column(text(unit), item.size, lambda: item.asstr()[()]) if item.dtype.metadata else None
    return Column(text(unit), item.size, lambda: item[()]) if item.dtype.kind in "iufbS" else None


def _matlab_text(item: Any) -> Column:
    letters = "".join(chr(code) for code in np.ravel(item[()]))
    return Column(None, 1, lambda: np.array([letters]))


def parquet(file: str) -> Tables:
    """The columns of a Parquet file; a field's metadata may hold its unit."""
    # The system's own allocator keeps to the limit of memory; one core is all that a child has.
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
    from pyarrow import parquet as library

    content = library.read_table(file, use_threads=False, pre_buffer=False)
    columns: Columns = {}
    for field, chunks in zip(content.schema, content.columns, strict=True):
        metadata = {k.decode().lower(): v for k, v in (field.metadata or {}).items()}
        values = np.asarray(chunks.to_numpy())
        if values.dtype.kind == "O":
            values = np.array(["" if v is None else v for v in values], dtype=object)
        if found := vector(values, next((metadata[k] for k in UNIT_NAMES if k in metadata), None)):
            columns[field.name] = found
    return {"": columns}


def tdms(file: str) -> tuple[Tables, str]:
    """The columns of every group of a TDMS file, and a note on what is missing from them; "" for nothing.

    Raises:
        Refused: where the library does not know how a channel's values are scaled.
    """
    import nptdms

    tables: Tables = {}
    with _listening() as said, nptdms.TdmsFile.read(file) as content:
        for group in content.groups():
            columns: Columns = {}
            for channel in group.channels():
                if found := vector(np.asarray(channel[:]), channel.properties.get("unit_string")):
                    columns[channel.name] = found
            # A waveform has its clock in its properties instead of in a channel.
            waves = [c for c in group.channels() if "wf_increment" in c.properties and len(c)]
            clocks = {(c.properties["wf_increment"], c.properties.get("wf_start_offset", 0.0)) for c in waves}
            if "time" not in {name.partition("[")[0].strip().lower() for name in columns} and len(clocks) == 1:
                columns["time"] = Column("s", len(waves[0]), waves[0].time_track)
            tables[group.name] = columns
        cut = _cut(content.file_status, file)
    if any(text.startswith("Unsupported scale") for text in said):
        found = f"npTDMS cannot scale its values, {'; '.join(dict.fromkeys(said))[:200]}"
        raise Refused(found, "write the scaled values to a new file, or to CSV")
    return tables, cut


@contextlib.contextmanager
def _listening() -> Iterator[list[str]]:
    """Within, what npTDMS says through loggers of its own is collected."""
    said: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    from nptdms.log import log_manager

    ear = Ear(logging.WARNING)
    for logger in log_manager.loggers.values():
        logger.addHandler(ear)
    yield said


def _cut(status: Any, file: str) -> str:
    """What the last segment of a TDMS file lacks, as far as the file says it; "" where the file is whole."""
    lacking = {
        name.replace("'", "").strip("/"): one.expected_length - one.read_length
        for name, one in (status.channel_statuses or {}).items()
        if one.read_length < one.expected_length
    }
    beyond = _beyond_the_end(file)
    if not (lacking or status.incomplete_final_segment or beyond):
        return ""
    named = [f"{count} of '{name[:40]}'" for name, count in list(lacking.items())[:_SHOWN]]
    more = f" and of {len(lacking) - _SHOWN} more channels" if len(lacking) > _SHOWN else ""
    # A writer that was ended has not put its segment's length in.
    size = f"{beyond} bytes" if beyond and beyond < _UNKNOWN else "how many is not known"
    what = f"at least {', '.join(named)}{more}" if named else size
    return f"the file is cut off: values are missing at its end ({what})"


def _beyond_the_end(file: str) -> int:
    """How many bytes a TDMS file lacks, by the lengths that its segments state; 0 of a whole one."""
    size, at = os.stat(file).st_size, 0
    with open(file, "rb") as content:
        while at < size:
            content.seek(at)
            lead = content.read(_LEAD)
            if len(lead) < _LEAD or lead[:4] != _TAG:
                return _UNKNOWN
            # Bit 6 of the content: the numbers stand with the highest byte first.
            order = "big" if lead[4] & 64 else "little"
            at += _LEAD + int.from_bytes(lead[12:20], order)
    return at - size


def sheets(file: str, wanted: str) -> dict[str, list]:
    """Rows that hold something, by the name of their sheet: [number, cells]. Of other sheets than ``wanted`` none.

    Values as they were last calculated; formulas and macros are not run. Between the first and the last cell that holds
    something the library keeps every cell of a sheet, whatever little the file holds of them.
    """
    import python_calamine

    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _UNPACKED:
            large = f"it unpacks to {size / 2**20:.3g} MB, more than the {_UNPACKED / 2**20:.3g} MB read here"
            raise Refused(large, "write it as Parquet or HDF5")
    with python_calamine.CalamineWorkbook.from_path(file) as book:
        names = book.sheet_names
        read = [wanted] if wanted in names else [] if wanted != "*" else names
        found: dict[str, list] = {name: [] for name in names}
        for name in read:
            rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            numbered = ([k, list(map(_cell, row))] for k, row in enumerate(rows, 1))
            found[name] = [row for row in numbered if any(cell not in ("", None) for cell in row[1])]
    return found


def _cell(cell: Any) -> Any:
    """A cell as a text or a number: dates and times of day as texts, durations as seconds."""
    if isinstance(cell, str):
        return cell.strip()
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    return cell.isoformat() if isinstance(cell, (datetime.date, datetime.time)) else cell


def _with_units(tables: Tables) -> Tables:
    """Units from a struct of texts named ``units`` inside a struct, which is then no table of its own."""
    united: Tables = {}
    for name, columns in tables.items():
        parent, _, own = name.rpartition("/")
        if own in UNIT_NAMES and parent in tables:
            continue
        beside: Iterable[Columns] = (tables.get(f"{name}/{key}".strip("/"), {}) for key in UNIT_NAMES)
        units = {k: text(np.asarray(c.values())) for texts in beside for k, c in texts.items() if c.size == 1}
        united[name] = {k: c._replace(unit=c.unit or units.get(k)) for k, c in columns.items()}
    return united


def limit(size: int, seconds: int) -> None:
    """Let this process have at most so many bytes and so many seconds of a core, where the system can hold it to that."""
    with contextlib.suppress(ImportError):
        import resource

        for what, most in (
            (resource.RLIMIT_AS, (size, size)),
            (resource.RLIMIT_CPU, (seconds, seconds + 1)),
            (resource.RLIMIT_CORE, (0, 0)),
        ):
            # A lower limit of the surroundings stays.
            with contextlib.suppress(OSError, ValueError):
                resource.setrlimit(what, most)


def write(tables: Tables, wanted: str, note: str = "") -> None:
    """Write the columns to the standard output."""
    filled = [name for name, columns in tables.items() if columns]
    wanted = filled[0] if wanted == "" and len(filled) == 1 else wanted
    index, arrays = [], []
    for table, columns in tables.items():
        for name, column in columns.items():
            values = _plain(column.values()) if wanted in ("*", table) else None
            index.append((table, name, column.unit, column.size, values is not None))
            arrays += [] if values is None else [values]
    with os.fdopen(os.dup(1), "wb") as out:
        out.write(json.dumps({"tables": index, "note": note}).encode() + b"\n")
        for values in arrays:
            # To NumPy a file is one that has positions, which a pipe has not.
            np.lib.format.write_array(cast(Any, SimpleNamespace(write=out.write)), values, allow_pickle=False)


def _plain(values: Any) -> np.ndarray:
    """An array without objects; a field of a compound dataset that is no vector becomes as many blank texts."""
    values = np.asarray(values)
    found = vector(values)
    if found is None:
        return np.full(values.shape[:1], "")
    return np.array(values.tolist(), dtype=str).reshape(values.shape) if values.dtype.kind == "O" else values


def main() -> int:
    """Limit this process, then read the file that it was given."""
    file, wanted, size, seconds = sys.argv[1:]
    limit(int(size), int(seconds))
    kind = os.path.splitext(file)[1].lower()
    try:
        if kind in SHEETS:
            print(json.dumps({"sheets": sheets(file, wanted)}))
        elif kind in (".parquet", ".pq"):
            write(parquet(file), wanted)
        elif kind == ".tdms":
            tables, note = tdms(file)
            write(tables, wanted, note)
        elif kind == ".mat" and not _is_hdf5(file):
            write(mat(file), wanted)
        else:
            import h5py

            with h5py.File(file, "r") as content:
                write(hdf5(content, h5py), wanted)
    # Libraries raise what they please on a broken file; a panic in Rust is no Exception.
    except BaseException as error:
        said = error.args if isinstance(error, Refused) else (f"{type(error).__name__}: {str(error)[:400]}", None)
        print(json.dumps([said[0].split("\n")[0], said[1]]), file=sys.stderr)
        return REFUSED
    return 0


def _is_hdf5(file: str) -> bool:
    """Whether the signature of HDF5 stands where a file may have it: at 0, 512, 1024, 2048, ... bytes."""
    with open(file, "rb") as content:
        at, end = 0, os.fstat(content.fileno()).st_size
        while at < end:
            content.seek(at)
            if content.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
            at = 2 * at or 512
    return False


if __name__ == "__main__":
    sys.exit(main())
