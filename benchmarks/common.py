"""What every benchmark needs: where it ran, how results are kept, how a page gets its tables."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"


def machine() -> dict[str, Any]:
    """The machine and versions of a run; no host name, no path."""
    from bcfj_jax.io.provenance import environment

    known = environment()
    return {"cores": os.cpu_count(), "machine": platform.machine(), "packages": known["packages"], "git": known["git"]}


def save(name: str, content: dict[str, Any]) -> None:
    """Keep a result in benchmarks/results, where it is committed."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps({"environment": machine(), **content}, indent=2) + "\n")


def load(name: str) -> dict[str, Any]:
    """A kept result."""
    return json.loads((RESULTS / f"{name}.json").read_text())


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first row is its header."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def put_in_readme(name: str, table: str, page: str = "README.md") -> None:
    """Replace the text between the markers of a table, in the README or another page."""
    path = ROOT / page
    text = path.read_text()
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"{page}: the markers '{begin}' and '{end}' must stand there once each")
    head, rest = text.split(begin)
    path.write_text(f"{head}{begin}\n{table}\n{end}{rest.split(end)[1]}")
