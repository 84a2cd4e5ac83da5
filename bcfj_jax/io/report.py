"""``report.html``: one file that opens offline, the verdict first; and tables as text. Jinja2 loads on first use.

Beside it lies ``report.json``, the same page without its pictures, which are PNG files of the folder.
``analysis.simulation.folder.rebuild`` makes the page again from both.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from bcfj_jax.core.errors import InputError
from bcfj_jax.io import second_process
from bcfj_jax.io.opening import LARGEST_TOML, content
from bcfj_jax.io.outputs import inside, write_json, write_text
from bcfj_jax.io.page import SIGNS, Listing, Page, Picture, Rows, Table, brief, from_content, model_form
from bcfj_jax.io.provenance import version

HTML, JSON = "report.html", "report.json"
# What every report has; a command names them among the files that it writes.
FILES = (HTML, JSON)
_PNG = b"\x89PNG\r\n\x1a\n"
# Files of the folder that a page has at its end, folded.
_SHOWN = (
    ("run.toml", "Input as it was run: every default, SI (run.toml)"),
    ("environment.json", "Environment: versions, device, checksums of the data (environment.json)"),
)
_LONGEST = 40_000  # characters of such a file
# Numbers with a unit, as the terminal prints them: "50 um"; no word: "3 unknown".
_MICRO = re.compile(r"(?<=\d) u(?=(?:m|s|g|N|J|W|V|A|C|Pa|Hz|rad)(?![A-Za-z]))")
_ANIMATION = re.compile(r"<!-- animation: begin -->(.*)<!-- animation: end -->", re.DOTALL)


def text(rows: Rows) -> str:
    """A table for a terminal: columns as wide as their widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def solver_table(stats: Mapping[str, float], more: Sequence[Sequence[str]] = ()) -> Table:
    """What a solve cost: steps, wall time and compile time [s]."""
    steps = [[f"steps {key}", str(stats[key])] for key in ("accepted", "rejected")]
    times = [[f"{key} time", brief(stats[f"{key}_s"], "s")] for key in ("wall", "compile")]
    return Table("Solver", [["solver", "value"], *more, *steps, *times])


def write(folder: Path, page: Page, known: str = "") -> Path:
    """Write ``report.json`` and ``report.html``, which it returns. ``known``: a model's ``model_form``, where a page has none."""
    if known and not page.model_form:
        page = replace(page, model_form=model_form(known))
    write_json(folder / JSON, page.content())
    path = folder / HTML
    write_text(path, html(page, folder))
    return path


def html(page: Page, folder: Path, drawn: Path | None = None) -> str:
    """The page as one file: pictures of the folder, or before them of the folder ``drawn``, inside; none is fetched.

    A picture that is not there is left out, and a warning names it.
    """
    from markupsafe import Markup  # HTML and CSS of this package, which is not escaped

    second_process.finish()
    missing: list[str] = []

    def inline(pictures: Sequence[Picture]) -> list[dict[str, Any]]:
        found = []
        for one in pictures:
            places = [inside(place, one.file, str(folder / JSON)) for place in (drawn, folder) if place is not None]
            data = next((p.read_bytes() for p in places if p.is_file()), b"")
            if data[:8] != _PNG:
                missing.append(one.file)
                continue
            width, height = struct.unpack(">II", data[16:24])
            shown = {"title": one.title, "shows": one.shows, "width": width, "height": height}
            found.append(shown | {"data": base64.b64encode(data).decode("ascii")})
        return found

    shown, more = inline(page.pictures), inline(page.more)
    lost = [f"The picture {name} is no longer in the result folder." for name in missing]
    page = replace(page, warnings=(*page.warnings, *lost))
    style = resources.files("bcfj_jax.io").joinpath("templates", "report.css").read_text(encoding="utf-8")
    return rendered(
        "report.html", page=page, main_pictures=shown, more_pictures=more, folded=[*page.folded, *_files(folder)],
        version=version(), sign=SIGNS[page.verdict.kind], style=Markup(style), animation=Markup(page.animation),
    )  # fmt: skip


def rendered(name: str, **values: Any) -> str:
    """HTML of a template of this package; values are escaped unless they are ``Markup``."""
    import jinja2

    templates = jinja2.Environment(
        loader=jinja2.PackageLoader("bcfj_jax.io", "templates"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    templates.filters["micro"] = lambda cell: _MICRO.sub(" µ", cell)
    return templates.get_template(name).render(**values).lstrip()


def _files(folder: Path) -> list[Listing]:
    found = []
    for name, title in _SHOWN:
        if (folder / name).is_file():
            text = (folder / name).read_text(encoding="utf-8", errors="replace")
            cut = f"\n... {len(text) - _LONGEST} more characters in {name}" if len(text) > _LONGEST else ""
            found.append(Listing(title, text[:_LONGEST] + cut))
    return found


def kept(folder: Path) -> Page:
    """The page that a result folder keeps, with the animation of its ``report.html`` if that is still there."""
    if not folder.is_dir():
        raise InputError(str(folder), "there is no such folder", "name a folder that a command of bcfj has written")
    path = folder / JSON
    if not path.is_file():
        results = sorted(p.name for p in folder.iterdir() if p.suffix in (".json", ".csv", ".parquet", ".md"))[:6]
        holds = f"it holds {', '.join(results)}" if results else "it holds no results"
        remedy = "name a folder that bcfj simulate, calibrate, sensitivity, study, tradeoff, design or reproduce wrote"
        raise InputError(str(folder), f"there is no {JSON} in this folder; {holds}", remedy)
    again = "run the command again in another folder"
    raw = content(path, LARGEST_TOML, str(path), again, again)
    try:
        page = from_content(json.loads(raw), str(path))
    except ValueError as error:
        raise InputError(str(path), f"is no JSON: {error}", again) from None
    return replace(page, animation=animation(folder))


def animation(folder: Path) -> str:
    """The animation in a folder's ``report.html``; "" without."""
    old = folder / HTML
    scene = _ANIMATION.search(old.read_text(encoding="utf-8", errors="replace")) if old.is_file() else None
    return scene[1] if scene else ""
