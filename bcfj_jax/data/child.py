"""Reads a binary file in a process of its own, which a damaged file may end: see ``isolated``.

    python -P child.py FILE TABLE BYTES SECONDS READER

Two things go to the standard output: a line of JSON, {"tables": [[path of the table, name, unit, size, whether values follow],
...], "note": what the file lacks, "sheets": {name: [[number of the row, its cells], ...]}}, and then, in this order, the values
of the table TABLE ("*" for every table, "" for the only one), each as an .npy. A column is a vector of numbers or texts, or one
of either; no object leaves. READER is the file of a module of ``readers``.

Exit codes: 0 done, 3 the file is refused: a line on the standard error is JSON, [the reason, the remedy or null].
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import numpy as np

REFUSED = 3


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


def stand_in(reader: str) -> str:
    """Packages of the names of ours, without what their front doors do, which imports JAX; the name of a reader's module."""
    folder, name = os.path.split(os.path.abspath(reader))
    here = os.path.dirname(folder)
    for front, path in (("bcfj_jax", os.path.dirname(here)), ("bcfj_jax.data", here)):
        package = ModuleType(front)
        package.__path__ = [path]
        sys.modules[package.__name__] = package
    return name.removesuffix(".py")


def write(content: Any, wanted: str) -> None:
    """Write what a file holds to the standard output."""
    from bcfj_jax.data.columns import vector

    tables = content.tables
    filled = [name for name, columns in tables.items() if columns]
    wanted = filled[0] if wanted == "" and len(filled) == 1 else wanted
    index, arrays = [], []
    for table, columns in tables.items():
        for name, column in columns.items():
            values = None
            if wanted in ("*", table):
                values = np.asarray(column.values())
                # A field of a compound dataset that is no vector becomes as many blank texts; no object leaves.
                values = np.full(values.shape[:1], "") if vector(values) is None else values
                values = (
                    np.array(values.tolist(), dtype=str).reshape(values.shape) if values.dtype.kind == "O" else values
                )
            index.append((table, name, column.unit, column.size, values is not None))
            arrays += [] if values is None else [values]
    with os.fdopen(os.dup(1), "wb") as out:
        out.write(json.dumps({"tables": index, "note": content.note, "sheets": content.sheets}).encode() + b"\n")
        for values in arrays:
            # To NumPy a file is one that has positions, which a pipe has not.
            np.lib.format.write_array(cast(Any, SimpleNamespace(write=out.write)), values, allow_pickle=False)


def main() -> int:
    """Limit this process, then read the file that it was given."""
    file, wanted, size, seconds, reader = sys.argv[1:]
    limit(int(size), int(seconds))
    name = stand_in(reader)
    from bcfj_jax.data.columns import Refused
    from bcfj_jax.data.readers import named

    # What a library prints must not stand among the values.
    out, sys.stdout = sys.stdout, sys.stderr
    try:
        write(named(name).read(file, wanted), wanted)
    # Libraries raise what they please on a broken file; a panic in Rust is no Exception.
    except BaseException as error:
        said = error.args if isinstance(error, Refused) else (f"{type(error).__name__}: {str(error)[:400]}", None)
        print(json.dumps([said[0].split("\n")[0], said[1]]), file=sys.stderr)
        return REFUSED
    finally:
        sys.stdout = out
    return 0


if __name__ == "__main__":
    ended = main()
    sys.stderr.flush()
    # To take libraries apart takes up to a sixth of the time.
    os._exit(ended)
