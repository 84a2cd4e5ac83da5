"""Result files: where they go, that none is overwritten or left half written, and what each one holds."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcfj_jax.core.errors import escaped
from bcfj_jax.io import second_process
from bcfj_jax.io.folder import Claim as Claim
from bcfj_jax.io.folder import already_there, check_folder, unwritable
from bcfj_jax.io.folder import inside as inside
from bcfj_jax.io.folder import open_folder as open_folder
from bcfj_jax.io.folder import session as session
from bcfj_jax.io.provenance import environment as environment
from bcfj_jax.mechanism.readings import STATES

if TYPE_CHECKING:
    from bcfj_jax.solve.simulation import Run

# Every file that this process has written, in its order: ``bcfj --json`` lists them.
written: list[Path] = []

COMPONENTS = ("normal", "axial", "tangential")


@contextlib.contextmanager
def atomic(path: Path, place: Callable[[str, Path], None] = os.replace) -> Iterator[Path]:
    """A temporary name beside a file; the file appears whole when the block ends without error."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        error.filename = str(path)
        raise
    os.close(handle)
    try:
        yield Path(name)
        # mkstemp makes the file private; results get the mode any new file has.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        place(name, path)
        written.append(path)
    except OSError as error:
        # A full disk names no file, and a temporary name says nothing to a user.
        if error.filename in (None, name):
            error.filename = str(path)
        raise
    finally:
        Path(name).unlink(missing_ok=True)


def write_text(path: Path, text: str, place: Callable[[str, Path], None] = os.replace) -> None:
    """A UTF-8 file, atomically. What is no character, as in a file name of other bytes, is written as its escape."""
    with atomic(path, place) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def write_later(path: Path, function: Callable[..., bytes], *arguments: Any) -> None:
    """What a function of a module gives, atomically; it is there when ``second_process.finish`` returns."""

    def write(content: bytes) -> None:
        with atomic(path) as temporary:
            temporary.write_bytes(content)

    second_process.later(write, function, *arguments)


def placed(out: Path | None, name: str) -> Path:
    """The file that ``--out`` asks for: ``out`` itself where it ends as ``name`` does, else ``name`` in that folder, or here."""
    return out if out and out.suffix == Path(name).suffix else (out or Path(".")) / name


def create(path: Path, text: str) -> None:
    """A UTF-8 file that was not there, whole: of two processes that ask at once, one gets it, the other is refused."""
    check_folder(path.parent, [path.name])
    try:
        write_text(path, text, _new)
    except OSError as error:
        raise unwritable(f"--out {path.parent}", error) from None


def _new(temporary: str, path: Path) -> None:
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise already_there(path.parent, [path.name]) from None
    except OSError:  # A file system without links.
        if path.exists():
            raise already_there(path.parent, [path.name]) from None
        os.replace(temporary, path)


def plain(value: Any) -> Any:
    """A value as JSON knows it: arrays to lists, paths to texts, NaN and infinities to None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON file, atomically; NaN and infinities become null."""
    write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A CSV file, atomically; floats in full precision, NaN as an empty cell."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(["" if value != value else value for value in row] for row in rows)
    write_text(path, buffer.getvalue())


def write_columns(path: Path, columns: Mapping[str, np.ndarray | Sequence[str]]) -> None:
    """As ``write_csv``, by columns of numbers (T,) or of texts that need no quotes: several times as fast. The file is there when
    ``second_process.finish`` returns.
    """
    write_later(path, _table, columns)


def _table(columns: Mapping[str, np.ndarray | Sequence[str]]) -> bytes:
    texts = [
        ["" if x != x else repr(x) for x in column.tolist()] if isinstance(column, np.ndarray) else column
        for column in columns.values()
    ]
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(columns)
    buffer.writelines(f"{line}\n" for line in map(",".join, zip(*texts, strict=True)))
    return buffer.getvalue().encode("utf-8", "backslashreplace")


def write_toml(path: Path, content: Mapping[str, Any], comment: str = "") -> None:
    """A TOML file, atomically, under comment lines."""
    import tomli_w

    # A comment may not hold control characters, which a file's name may.
    head = "".join(f"# {escaped(line)}\n" for line in comment.split("\n")) if comment else ""
    write_text(path, head + tomli_w.dumps(dict(content)))


def write_origin(folder: Path, resolved: Mapping[str, Any], comment: str, known: Mapping[str, Any]) -> None:
    """``run.toml`` and ``environment.json``: what was run, with every default, and in which ``environment``."""
    write_toml(folder / "run.toml", resolved, comment)
    write_json(folder / "environment.json", known)


def channels(history: Mapping[str, np.ndarray], components: int = 0) -> dict[str, np.ndarray]:
    """Histories by contact, members apart: (T, 6, 3) under ``seat_ball`` becomes ``seat_ball_1`` .. ``_6``; ``components``: axes
    after time and members, 1 for forces.
    """
    apart: dict[str, np.ndarray] = {}
    for name, values in history.items():
        if values.ndim == 2 + components:
            apart.update({f"{name}_{k + 1}": values[:, k] for k in range(values.shape[1])})
        else:
            apart[name] = values
    return apart


def force_columns(run: Run) -> dict[str, np.ndarray]:
    """Every contact's three components [N], by heads that hold the unit."""
    forces = channels(run.force, 1)
    return {f"{name}.{part} [N]": x[:, k] for name, x in forces.items() for k, part in enumerate(COMPONENTS)}


def contact_columns(run: Run) -> dict[str, np.ndarray | list[str]]:
    """Every contact's penetration [m], sliding speed [m/s] where it slides, and state in words."""
    slip, state = channels(run.slip), channels(run.state)
    columns: dict[str, np.ndarray | list[str]] = {}
    for name, depth in channels(run.penetration).items():
        columns[f"{name}.penetration [m]"] = depth
        if name in slip:
            columns[f"{name}.sliding_speed [m/s]"] = slip[name]
        # A failed run's state is unknown: an empty cell, as its numbers.
        columns[f"{name}.state"] = [STATES[code] if code >= 0 else "" for code in state[name].tolist()]
    return columns
