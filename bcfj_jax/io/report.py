"""``report.html``: one file that opens offline, the verdict first; and tables as text. Jinja2 loads on first use."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

from bcfj_jax.io.outputs import write_text
from bcfj_jax.io.provenance import version
from bcfj_jax.io.units import format_si

Rows = Sequence[Sequence[str]]


def text(rows: Rows) -> str:
    """A table for a terminal: columns as wide as their widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def solver_rows(stats: Mapping[str, float]) -> list[list[str]]:
    """The table of what a solve cost: steps, wall time and compile time [s]."""
    return [
        ["", "value"],
        ["steps accepted", str(stats["accepted"])],
        ["steps rejected", str(stats["rejected"])],
        ["wall time", format_si(stats["wall_s"], "s")],
        ["compile time", format_si(stats["compile_s"], "s")],
    ]


def write(
    folder: Path,
    title: str,
    verdict: str,
    tables: Sequence[tuple[str, Rows]],
    pictures: Sequence[Path],
    warnings: Sequence[str] = (),
) -> Path:
    """Write ``report.html`` into a folder.

    Args:
        folder: where to.
        title, verdict: the heading, and the sentence below it.
        tables: heading and rows of each; the first row holds the column titles.
        pictures: PNG files, which are copied into the report.
        warnings: what the reader must know before the numbers.

    Returns:
        The file written.
    """
    import jinja2

    loader = jinja2.PackageLoader("bcfj_jax.io", "templates")
    page = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    inline = [(p.stem.replace("_", " "), base64.b64encode(p.read_bytes()).decode("ascii")) for p in pictures]
    path = folder / "report.html"
    content = page.get_template("report.html").render(
        title=title, verdict=verdict, tables=tables, pictures=inline, warnings=list(warnings), version=version()
    )
    write_text(path, content)
    return path
