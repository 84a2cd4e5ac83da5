"""Results as text, as HTML for notebooks, as tables of pandas and xarray, and as figures: what all kinds share.

What is particular to one kind of result is in the module that its class names as ``_view`` (``View``).
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from bcfj_jax.core.errors import InputError, one_of
from bcfj_jax.core.extras import library
from bcfj_jax.io import plots, report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Sequence[str]]
# Rows of a table that are shown.
MOST_ROWS = 9


class Told(NamedTuple):
    """A result in short: how it ended, in a few words; sentences; a table, titles first; sentences below it."""

    verdict: str
    lines: Sequence[str] = ()
    rows: Rows = ()
    after: Sequence[str] = ()


class Dataset(NamedTuple):
    """What becomes an ``xarray.Dataset``: per variable its dimensions, values and unit; coordinates likewise."""

    variables: Mapping[str, tuple[tuple[str, ...], Any, str]]
    coordinates: Mapping[str, tuple[tuple[str, ...], Any, str]]
    attributes: Mapping[str, Any]


class View(Protocol):
    """What a result's ``_view`` module has."""

    # The result in short.
    told: Callable[[Any], Told]
    # Columns by their heads, and the head of the one that is the index; "" for none.
    frame: Callable[[Any], tuple[Mapping[str, Any], str]]
    dataset: Callable[[Any], Dataset]
    # By name, what draws a picture to a path or a ``plots.Kept``; the first is drawn where none is named.
    figures: Callable[[Any], Mapping[str, Callable[[Any], Any]]]


def _view(found: Any) -> View:
    return importlib.import_module(type(found)._view)  # type: ignore[return-value]


def _short(rows: Rows) -> tuple[list[Sequence[str]], list[str]]:
    """The rows that are shown, and a line that says how many more there are."""
    left = len(rows) - 1 - MOST_ROWS
    return list(rows[: MOST_ROWS + 1]), [f"... and {left} more"] if left > 0 else []


def text(found: Any) -> str:
    """A result in at most 15 lines."""
    told = _view(found).told(found)
    rows, more = _short(told.rows)
    table = report.text([[str(cell) for cell in row] for row in rows]).splitlines() if rows else []
    return "\n".join([f"{type(found).__name__}: {told.verdict}", *told.lines, *table, *more, *told.after])


def html(found: Any) -> str:
    """The same as HTML; all of it is escaped."""
    told = _view(found).told(found)
    rows, more = _short(told.rows)
    return report.rendered("result.html", kind=type(found).__name__, told=told, rows=rows, after=[*more, *told.after])


def frame(found: Any) -> Any:
    """A result as a ``pandas.DataFrame``."""
    pandas = library("pandas", "to_pandas", "table")
    columns, index = _view(found).frame(found)
    made = pandas.DataFrame(dict(columns))
    return made.set_index(index) if index else made


def dataset(found: Any) -> Any:
    """A result as an ``xarray.Dataset``."""
    xarray = library("xarray", "to_xarray", "table")
    content = _view(found).dataset(found)

    def made(parts: Mapping[str, tuple[tuple[str, ...], Any, str]]) -> dict[str, Any]:
        return {
            name: (dims, np.asarray(values), {"units": unit} if unit else {})
            for name, (dims, values, unit) in parts.items()
        }

    return xarray.Dataset(made(content.variables), coords=made(content.coordinates), attrs=dict(content.attributes))


def figure(found: Any, what: str = "") -> Figure:
    """One of a result's pictures."""
    known = _view(found).figures(found)
    if not known:
        raise InputError("plot", f"this {type(found).__name__} has nothing to draw", "see its status and reason")
    if what:
        one_of("plot", "picture", what, known)
    kept = plots.Kept()
    known[what or next(iter(known))](kept)
    drawing = kept.drawing
    assert drawing is not None
    # Notebooks show a figure that pyplot has not made only if it says how.
    drawing._repr_png_ = partial(_png, drawing)  # type: ignore[attr-defined]
    return drawing


def _png(drawing: Figure) -> bytes:
    buffer = io.BytesIO()
    drawing.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()
