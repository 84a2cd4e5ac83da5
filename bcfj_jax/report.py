"""``report.html``: one file that opens offline, the verdict first. Jinja2 is imported on first use."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

from bcfj_jax.outputs import write_text
from bcfj_jax.provenance import version

Rows = Sequence[Sequence[str]]


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

    loader = jinja2.PackageLoader("bcfj_jax", "templates")
    page = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    inline = [(p.stem.replace("_", " "), base64.b64encode(p.read_bytes()).decode("ascii")) for p in pictures]
    path = folder / "report.html"
    text = page.get_template("report.html").render(
        title=title, verdict=verdict, tables=tables, pictures=inline, warnings=list(warnings), version=version()
    )
    write_text(path, text)
    return path
