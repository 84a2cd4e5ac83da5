"""Damaged records of every reader: no traceback, no hang, no memory beyond 2 GB, and no wrong number without a word.

    python -m benchmarks.robustness.damaged [--cases 500] [--only text,tdms,...] [--seed 0]

A file of an instrument is cut off, bytes of it are flipped, lines or blocks are twice there or gone, fields are replaced. What
is read then is held to the undamaged file: a damage of some rows moves the numbers of no other row. What no reader can see, a
digit that became another or a rate in a head, is read as it stands and not held to anything.
"""

from __future__ import annotations

import collections
import re
import resource
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcfj_jax.data.readers import named
from benchmarks.calibration import instruments
from benchmarks.common import options
from benchmarks.robustness import records
from benchmarks.robustness.forked_reading import imported
from benchmarks.robustness.fuzz import Case, run_case
from benchmarks.robustness.mutations import CELLS, Rng

LARGEST = 2 << 30
# Files by reader, by their names among ``instruments.files`` or their extension among ``records.FORMATS``.
FILES = {
    "text": (
        "siglent.csv", "vicon_two.csv", "bluehill_de.csv", "testxpert.txt", "iso.csv", "dewesoft_rate.txt", "kgf.csv",
        "spaced.txt", "rigol_ds.csv", "tek_tbs.csv", "am_pm.csv", "german_16.csv", "signal_express.txt",
    ),
    "lvm": ("lvm_two.lvm", "lvm_comma.lvm"),
    "tdms": ("wave.tdms",),
    "uff": ("force58.uff", "force58b.uff"),
    "wav": ("int16.wav", "int24.wav"),
    "mat": ("rate.mat",),
    "hdf5": ("rate.h5",),
    "mdf": ("drop.mf4",),
    "c3d": ("plate.c3d", "plate_arm.c3d"),
    "npy": ("named.npz", "matrix.npy"),
    "sheets": (".xlsx",),
    "parquet": (".parquet",),
}  # fmt: skip
# Of files of these a block may be gone unseen: they state the length of each array, and none of the file.
UNSEEN = ("mat",)
# Of a word that is said of a file as a whole.
WORDS = ("cut off", "cannot", "than it states", "do not agree")
# Of these the numbers stand in lines, one row each.
LINES = ("text", "lvm")


class Damaged(NamedTuple):
    """A damaged file: its content, and how many rows may hold other numbers; None: whatever it holds may be wrong unseen."""

    content: bytes
    rows: int | None


def of_lines(rng: Rng, good: bytes, encoding: str) -> Damaged:
    """One damage of the rows of a text, of its head, or its end."""
    lines = good.decode(encoding).splitlines()
    head = next(k for k in range(len(lines)) if sum(c.isdigit() for line in lines[k : k + 8] for c in line) > 40)
    at, inside = int(rng.integers(0, len(lines))), True
    match int(rng.integers(0, 6)):
        case 0:
            lines = lines[:at]
        case 1:
            lines[at] = lines[at][: int(rng.integers(0, len(lines[at]) + 1))]
        case 2:
            lines.insert(at, lines[int(rng.integers(head + 9, len(lines)))])
        case 3:
            del lines[at]
        case 4:
            cells = re.split(r"([,;\t])", lines[at])
            cells[2 * int(rng.integers(0, (len(cells) + 1) // 2))] = CELLS[int(rng.integers(0, len(CELLS)))]
            lines[at] = "".join(cells)
        case _:
            content = bytearray("\n".join(lines).encode(encoding, "replace"))
            flips = int(rng.integers(1, 4))
            for _ in range(flips):
                content[int(rng.integers(0, len(content)))] ^= 1 << int(rng.integers(0, 8))
            inside = (
                bytes(content[: len(content) // 6]) == "\n".join(lines).encode(encoding, "replace")[: len(content) // 6]
            )
            return Damaged(bytes(content), 2 * flips if inside and encoding == "utf-8" else None)
    return Damaged("\n".join(lines).encode(encoding, "surrogatepass"), 2 if at > head + 8 else None)


def of_blocks(rng: Rng, good: bytes, encoding: str) -> Damaged:
    """One damage of a binary file: its end, some bytes, a block twice or gone."""
    del encoding
    data, at = bytearray(good), int(rng.integers(0, len(good)))
    length = int(2 ** rng.integers(0, 10))
    match int(rng.integers(0, 4)):
        case 0:
            # What is left is as it was.
            return Damaged(bytes(data[:at]), 0)
        case 1:
            del data[at : at + length]
            return Damaged(bytes(data), 2)
        case 2:
            data[at:at] = data[at : at + length]
            return Damaged(bytes(data), 2)
        case _:
            for _ in range(int(rng.integers(1, 4))):
                data[int(rng.integers(0, len(data)))] ^= 1 << int(rng.integers(0, 8))
    return Damaged(bytes(data), None)


class Source(NamedTuple):
    """A good file: how it is read, its numbers (N,), what is said of it, and its encoding."""

    name: str
    content: bytes
    read: Callable[[Path], tuple[np.ndarray, str]]
    values: np.ndarray
    said: str
    encoding: str


def source(name: str, folder: Path) -> Source:
    """A good file, read once."""
    from bcfj_jax.data.reading import read
    from bcfj_jax.data.textfile import Stated
    from calibration import init
    from calibration.impacts.proposal import Hints

    own = name.startswith(".")
    file = instruments.File(f"record{name}", records.FORMATS[name]()) if own else instruments.files()[name]()
    said = file.said
    stated = Stated(sensitivity=said.get("sensitivity"), full_scale=said.get("full_scale"))
    path = folder / file.name
    path.write_bytes(file.content)
    found = init.found_in(
        path, init.Said(table=said.get("table"), stated=stated, hints=Hints(said.get("time"), said.get("observe")))
    )
    header = found.columns[file.si].removeprefix("-")
    table = said.get("table") or found.table or None

    def numbers(path: Path) -> tuple[np.ndarray, str]:
        record = read(path, "record", table, stated)
        if record.faults:
            raise record.faults[0]
        return record.numbers(header, file.si, "record", True), record.found

    values, words = numbers(path)
    encoding = "utf-16" if file.content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8"
    try:
        file.content.decode(encoding)
    except UnicodeDecodeError:
        encoding = "cp1252"
    return Source(file.name, file.content, numbers, values, words, encoding)


def wrong(good: Source, damaged: Damaged, found: tuple[np.ndarray, str]) -> str:
    """What is wrong with the numbers of a damaged file that was accepted; "" for nothing."""
    values, said = found
    if damaged.rows is None or any(word in said and word not in good.said for word in WORDS):
        return ""
    seen = values[np.isfinite(values)]
    others = int((~np.isin(seen, good.values)).sum())
    return f"{others} of {seen.size} numbers are none of the file's" if others > damaged.rows else ""


def cases(reader: str, count: int, folder: Path, seed: int) -> Iterator[tuple[str, int, Case]]:
    """Damaged files of a reader, each with its file's name and its seed."""
    files = [source(name, folder) for name in FILES[reader]]
    damage = of_lines if reader in LINES else of_blocks
    # A text is read by this process.
    forks = nullcontext() if reader == "text" else imported(named(reader), folder / files[0].name)
    with forks:
        for k in range(count):
            good = files[k % len(files)]
            made = damage(np.random.default_rng([seed, k]), good.content, good.encoding)
            made = made._replace(rows=None) if reader in UNSEEN else made
            check = lambda found, good=good, made=made: wrong(good, made, found)  # noqa: E731
            yield good.name, k, run_case(good.read, check, folder / good.name, made.content)


def largest() -> int:
    """The most memory that this process or one of its own has held [bytes]."""
    return 1024 * max(resource.getrusage(w).ru_maxrss for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main() -> int:
    """Try every reader, print what came of it, and fail where anything was wrong."""
    given, bad = options(__doc__, cases=500, seed=0, only=",".join(FILES)), 0
    for reader in given.only.split(","):
        with tempfile.TemporaryDirectory() as folder:
            ends: collections.Counter[str] = collections.Counter()
            for name, k, case in cases(reader, given.cases, Path(folder), given.seed):
                ends[case.outcome] += 1
                if case.outcome not in ("accepted", "refused"):
                    bad += 1
                    print(f"  {name} case {k}: {case.outcome}: {case.detail}")
        print(f"{reader:8} {dict(ends)}, {largest() >> 20} MB")
    return int(bad > 0 or largest() > LARGEST)


if __name__ == "__main__":
    sys.exit(main())
