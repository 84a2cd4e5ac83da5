"""Texts that are numbers: decimal points or commas, marks between thousands, exponents by D, and words for no number.

Which mark is the decimal one is decided by column, or where a column says nothing, by the whole file. "1.234" alone can
be 1.234 or 1234; "0.5", "12.34" and "1,234.5" are sure. Where no number of a file is sure, ``decimal_marks`` says so and
nothing is assumed.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Sequence

import numpy as np

# Words for a cell that holds no number, as spreadsheets and C libraries write them.
MISSING = frozenset(
    ["", "nan", "na", "n/a", "n.a.", "null", "none", "nil", "missing", "-", "--", "---", "?", "#n/a", "#na", "#nv", "#div/0!",
     "#value!", "#wert!", "1.#qnan", "-1.#ind", "1.#ind", "-1.#qnan", "-nan", "+nan", "-nan(ind)", "nan(ind)"]
)  # fmt: skip
# How instruments write a sample beyond what they can show.
CLIPPED = (
    *("∞", "-∞", "+∞", "Infinity", "-Infinity", "+Infinity"),
    *("OL", "-OL", "+OL", "OVLD", "OVERLOAD", "OVERFLOW", "OVR"),
)
_BLANKS = "\u00a0\u202f\u2009 "
_DIGITS = rf"(?:[1-9]\d{{0,2}}(?:(?P<mark>[.,'’{_BLANKS}])\d{{3}})(?:(?P=mark)\d{{3}})*|\d+)"  # noqa: RUF001
_NUMBER = re.compile(rf"[-+]?(?:{_DIGITS}(?P<point>\.\d*|,\d+)?|(?P<bare>[.,]\d+))(?:[eEdD][-+]?\d+)?", re.ASCII)
# One mark before three digits: thousands, or three decimals.
_EITHER = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
_SIGNS = str.maketrans({"\u2212": "-", "\u2013": "-", "d": "e", "D": "e"})


def is_missing(cell: object) -> bool:
    """Whether a cell says that there is no number."""
    return cell is None or (isinstance(cell, str) and cell.strip(" *\t").lower() in MISSING)  # Fortran's "****".


def is_number(cell: object) -> bool:
    """Whether a cell is a number, whatever its marks mean."""
    if not isinstance(cell, str):
        return isinstance(cell, (int, float)) and not isinstance(cell, bool)
    text = cell.strip()
    match = _NUMBER.fullmatch(text.replace("\u2212", "-")) if len(text) <= 64 else None
    return match is not None and not (match["mark"] and match["point"] and match["mark"] == match["point"][0])


def _decimal(cell: str) -> tuple[str, bool]:
    """The decimal mark of a number, and whether it is sure; ("", True) where it has no mark."""
    text = cell.strip()
    if "." not in text and "," not in text:
        return "", True
    if "." in text and "," in text:
        return text[max(text.rfind("."), text.rfind(","))], True
    mark = "." if "." in text else ","
    if text.count(mark) > 1:
        return ("," if mark == "." else "."), True
    return mark, _EITHER.fullmatch(text) is None


def decimal_marks(columns: Sequence[Iterable[object]]) -> list[str] | None:
    """The decimal mark of each column by a sample of its cells; a column that says nothing has the mark of most others.

    None where there are marks, and no number of the file is sure.
    """
    counts = [{".": 0, ",": 0, "": 0} for _ in columns]
    doubtful = 0
    for column, sure in zip(columns, counts, strict=True):
        for cell in column:
            if isinstance(cell, str) and is_number(cell):
                mark, certain = _decimal(cell)
                sure[mark] += certain
                doubtful += not certain
    points, commas = (sum(sure[mark] for sure in counts) for mark in (".", ","))
    if doubtful and not points and not commas:
        return None
    file = "," if commas > points else "."
    own = [",."[sure["."] > sure[","]] for sure in counts]
    return [mark if sure["."] != sure[","] else file for mark, sure in zip(own, counts, strict=True)]


def parsed(cells: Sequence[object], decimal: str = ".") -> tuple[np.ndarray, np.ndarray]:
    """Numbers (N,), NaN where a cell holds none, and which cells (N,) are neither a number (infinity is) nor a word for none."""
    texts = [c.strip() if isinstance(c, str) else c for c in cells]
    strings = [t for t in texts if isinstance(t, str)]
    if len(strings) == len(texts) and not any("_" in t or (decimal == "," and "." in t) for t in strings):
        plain = [(t.replace(",", ".") if decimal == "," else t) or "nan" for t in strings]
        with contextlib.suppress(ValueError):
            return np.array(plain, dtype=float), np.zeros(len(plain), dtype=bool)
    grouped = _grouped(texts, decimal)
    found = [_value(cell, decimal, grouped) for cell in texts]
    bad = np.array([number is None for number in found], dtype=bool)
    return np.array([np.nan if number is None else number for number in found], dtype=float), bad


def _grouped(texts: Sequence[object], decimal: str) -> bool:
    """Whether a column's other mark parts thousands: twice in a number, beside the decimal mark, or without any decimals."""
    other = "," if decimal == "." else "."
    numbers = [t for t in texts if isinstance(t, str) and is_number(t)]
    return any(t.count(other) > 1 or (other in t and decimal in t) for t in numbers) or not any(
        decimal in t for t in numbers
    )


def _value(cell: object, decimal: str, grouped: bool) -> float | None:
    if is_missing(cell):
        return float("nan")
    if isinstance(cell, bool):
        return None
    if isinstance(cell, (int, float)):
        return float(cell)
    if not isinstance(cell, str) or len(cell) > 64:
        return None
    text = cell.replace("\u2212", "-")
    if text in CLIPPED:
        return float("-inf" if text.startswith("-") else "inf")
    if text.lstrip("+-").lower() in ("inf", "infinity", "∞"):
        return float(text.replace("∞", "inf"))
    match = _NUMBER.fullmatch(text)
    if match is None:
        return None
    mark, point = match["mark"], (match["point"] or match["bare"] or "")[:1]
    if mark == decimal and not point and text.count(mark) == 1:
        mark, point = None, decimal  # Three decimals.
    if point not in ("", decimal) or mark == decimal or (mark in (".", ",") and not grouped):
        return None
    text = text.replace(mark, "") if mark else text
    return float(text.replace(",", ".").translate(_SIGNS))
