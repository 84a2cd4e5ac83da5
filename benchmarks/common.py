"""The harness of all benchmarks: options, where a result was made, how it is kept, how a page gets its tables.

Time is measured by ``clock``, other processes are run by ``processes``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images"
# What ``known`` leaves out.
_OF_THE_RUN = "environment"


class Some(list):
    """The values of an option that takes any number of values, whichever they are; these are the default."""


def options(doc: str | None, positional: Mapping[str, Any] | None = None, **named: Any) -> argparse.Namespace:
    """The options of a command, each by its default.

    A number, text or path is the default of one value, a type stands for one value without a default, False for a switch.
    Of a list or table any number of its names is taken, all by default; of ``Some`` any values. (default, help) says more.
    What is positional and has no default must be given.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, given in (positional or {}).items():
        parser.add_argument(name, **_option(given, {} if isinstance(given, type) else {"nargs": "?"}))
    for name, given in named.items():
        parser.add_argument("--" + name.replace("_", "-"), dest=name, **_option(given, {}))
    return parser.parse_args()


def _option(given: Any, single: dict[str, Any]) -> dict[str, Any]:
    """Arguments of ``add_argument``; ``single``: those of one value beside its type."""
    default, said = given if isinstance(given, tuple) else (given, None)
    about = {"help": said and said.replace("%", "%%")}
    if default is False:
        return {"action": "store_true", **about}
    if isinstance(default, Some):
        return {"nargs": "*", "default": list(default), "type": type(next(iter(default), "")), **about}
    if isinstance(default, list | Mapping):
        return {"nargs": "*", "default": list(default), "type": _among(list(default)), **about}
    if isinstance(default, type):
        return {"type": default, **about, **single}
    kind = Path if isinstance(default, Path) else type(default)
    return {"type": kind, "default": default, **about, **single}


def _among(names: list[Any]) -> Callable[[str], Any]:
    def name(text: str) -> Any:
        found = [one for one in names if one == type(one)(text)]
        if not found:
            raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(map(str, names))}")
        return found[0]

    return name


def machine() -> dict[str, Any]:
    """The machine and versions of a run; no host name, no path."""
    from bcfj_jax.io.provenance import environment

    known = environment()
    return {"cores": os.cpu_count(), "machine": platform.machine(), "packages": known["packages"], "git": known["git"]}


def save(name: str, content: Mapping[str, Any]) -> None:
    """Keep a result in benchmarks/results, where it is committed."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps({_OF_THE_RUN: machine(), **content}, indent=2) + "\n")


def load(name: str) -> dict[str, Any]:
    """A kept result."""
    return json.loads((RESULTS / f"{name}.json").read_text())


def known(name: str) -> dict[str, Any]:
    """A kept result without the environment of its run; empty where there is none."""
    path = RESULTS / f"{name}.json"
    return {key: one for key, one in load(name).items() if key != _OF_THE_RUN} if path.exists() else {}


def add(name: str, content: Mapping[str, Any]) -> None:
    """Keep parts of a result beside its other parts."""
    save(name, {**known(name), **content})


def parts(name: str, todo: Mapping[str, Callable[[], Any]], chosen: Iterable[str]) -> None:
    """Measure the parts chosen of a result; each is kept as soon as it is there, beside the others."""
    for part in chosen:
        add(name, {part: todo[part]()})


def markdown(rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table; the first row is its header."""
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def table(columns: Mapping[str, Any] | Sequence[tuple[str, Any]], rows: Iterable[Any]) -> str:
    """A Markdown table by its columns: (head, cell), a cell as a format of the row's keys or a function of the row."""
    pairs = list(columns.items()) if isinstance(columns, Mapping) else list(columns)
    cells = ([of.format_map(row) if isinstance(of, str) else of(row) for _, of in pairs] for row in rows)
    return markdown([[head for head, _ in pairs], *cells])


def tally(values: Iterable[Any]) -> dict[Any, int]:
    """How often each value comes, sorted by value."""
    every = list(values)
    return {value: every.count(value) for value in sorted(set(every))}


def told(counts: Mapping[Any, int]) -> str:
    """A tally in words."""
    return ", ".join(f"{value} {count}" for value, count in counts.items())


def keep_arrays(path: Path, settings: Mapping[str, Any], times: Any, arrays: Mapping[str, Any]) -> None:
    """Keep histories of a reference at times [s] as 32-bit numbers, with the settings that they were made with."""
    import numpy as np

    short = {name: np.asarray(one, dtype=np.float32) for name, one in arrays.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, times=times, settings=np.array(json.dumps(settings)), **short)  # pyright: ignore
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


def kept_arrays(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Kept histories as 64-bit numbers, "times" among them, and their settings."""
    import numpy as np

    with np.load(path, allow_pickle=False) as kept:
        settings = json.loads(str(kept["settings"]))
        return {name: kept[name].astype(float) for name in kept if name != "settings"}, settings


def publish(name: str, text: str, page: str = "README.md") -> None:
    """Print a table, and put it between its markers in the README or another page."""
    print(text, flush=True)
    path = ROOT / page
    whole = path.read_text()
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if whole.count(begin) != 1 or whole.count(end) != 1:
        raise ValueError(f"{page}: the markers '{begin}' and '{end}' must stand there once each")
    head, rest = whole.split(begin)
    path.write_text(f"{head}{begin}\n{text}\n{end}{rest.split(end)[1]}")


@contextmanager
def drawing(name: str, size: tuple[float, float], columns: int = 1, **options: Any) -> Iterator[Any]:
    """Axes of a picture of docs/images, in the package's style; it is written at the end."""
    from matplotlib.figure import Figure

    from bcfj_jax.io import plots

    with plots.style():
        figure = Figure(figsize=size, layout="constrained")
        yield figure.subplots(1, columns, **options)
        figure.savefig(IMAGES / name, dpi=110)
