"""What a report says, the same for every command: verdict, pictures, warnings, tables, and what is folded away.

``report`` turns a ``Page`` into ``report.html`` and keeps it as ``report.json``, from which ``bcfj report`` makes the page
again. Numbers for people have three significant digits: ``brief`` and ``span``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.errors import counted as counted
from bcfj_jax.io.units import engineering, format_si

Rows = Sequence[Sequence[str]]


def by_columns(*columns: tuple[str, Sequence[str]]) -> list[list[str]]:
    """Rows of a table from its columns, each a title and its cells."""
    titles, cells = zip(*columns, strict=True)
    return [list(titles), *map(list, zip(*cells, strict=True))]


# How a verdict is meant. It has a colour, and a sign for those who do not see the colour.
GOOD, FAIR, BAD, PLAIN = "good", "fair", "bad", "plain"
SIGNS = {GOOD: "✓", FAIR: "!", BAD: "✗", PLAIN: "→"}


@dataclass(frozen=True)
class Verdict:
    """One of ``SIGNS``, a word or two, and one sentence that answers the question."""

    kind: str
    word: str
    sentence: str


@dataclass(frozen=True)
class Picture:
    """A PNG of the result folder: its name, a title, and a sentence that says what it shows, for who cannot see it."""

    file: str
    title: str
    shows: str


@dataclass(frozen=True)
class Table:
    """Rows of text, the first with the column titles; the first column names the row. ``folded`` stand below, closed."""

    title: str
    rows: Rows
    note: str = ""
    folded: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Listing:
    """Text that is shown as it is, such as lines for an input file."""

    title: str
    text: str


@dataclass(frozen=True)
class Page:
    """One report."""

    title: str  # its heading
    verdict: Verdict  # the answer
    pictures: tuple[Picture, ...] = ()  # those that matter, two at most
    warnings: tuple[str, ...] = ()  # what the reader must know before the numbers
    tables: tuple[Table | Listing, ...] = ()  # tables and listings, by type of contact where there are contacts
    more: tuple[Picture, ...] = ()  # further pictures
    # Members, input, solver; ``report`` adds the folder's run.toml and environment.json
    folded: tuple[Table | Listing, ...] = ()
    animation: str = ""  # HTML of an animation, written by this package: it is not escaped
    model_form: str = ""  # how wrong the model may be, whatever the error of its computation

    def content(self) -> dict[str, Any]:
        """The page as ``report.json`` has it; the animation is left out."""
        found = asdict(self)
        del found["animation"]
        return found


def model_form(known: str) -> str:
    """The sentence of a report, by what a model says of itself (``AbstractModel.model_form``)."""
    return f"The stated error is that of the computation; {known}."


def from_content(content: Mapping[str, Any], where: str) -> Page:
    """The page of a ``report.json``."""
    import pydantic

    try:
        page = pydantic.TypeAdapter(Page).validate_python(content)
        if other := [one.file for one in (*page.pictures, *page.more) if not one.file.endswith(".png")]:
            raise ValueError(f"'{other[0]}' is no PNG")
        if page.verdict.kind not in SIGNS:
            raise ValueError(f"no verdict '{page.verdict.kind}'")
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        listed = first["type"] in ("tuple_type", "sequence_str", "list_type")
        said = f"{first['input']!r} is no list" if listed else first["msg"]
        what = f"{'.'.join(map(str, first['loc']))}: {said}"
    except ValueError as error:
        what = str(error)
    else:
        return replace(page, animation="")
    found = f"is not what a command of bcfj writes ({what})"
    raise InputError(where, found[:200], "run the command again in another folder")


# Numbers for people.


def brief(value: float | None, unit: str = "1", digits: int = 3) -> str:
    """A value with three significant digits: (1709.03, "N") -> "1.71 kN"; "-" for None and NaN."""
    if value is None or math.isnan(value):
        return "-"
    rounded = float(f"{value:.{digits}g}")
    # Micro as it is printed; a unit never begins with u.
    return format_si(rounded, unit, max(digits, 6)).replace(" u", " µ")


def bounded(values: Sequence[float], ends: Sequence[float], unit: str = "1") -> list[str]:
    """Values that an interval bounds, in three digits or as many as show its width with two: 1.50481 in 1.484..1.526: "1.505"."""
    size, width = max((abs(x) for x in ends), default=0.0), abs(ends[-1] - ends[0]) if len(ends) > 1 else 0.0
    known = 0.0 < width < size < math.inf
    digits = min(max(3, 2 + math.floor(math.log10(size)) - math.floor(math.log10(width))), 12) if known else 3
    return [brief(x, unit, digits) for x in values]


def span(values: Iterable[float], unit: str = "1", digits: int = 3) -> str:
    """The range of some values, in one unit: "29.5 to 29.6 kN"; a single value where all read the same."""
    known = [float(v) for v in values if v is not None and math.isfinite(v)]
    if not known:
        return "-"
    low, high = (float(f"{v:.{digits}g}") for v in (min(known), max(known)))
    if low == high:
        return brief(high, unit, digits)
    scale, prefix = engineering([low, high], unit)
    ends = f"{low * scale:.{digits}g} to {high * scale:.{digits}g}"
    return ends if unit == "1" else f"{ends} {prefix.replace('u', 'µ')}{unit}"
