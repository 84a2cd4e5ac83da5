"""How results show themselves: methods that every result class takes over by name.

    class Run(NamedTuple):
        times: np.ndarray
        _view = "bcfj_jax.analysis.simulation.view"
        __repr__, _repr_html_ = presented.text, presented.html

``_view`` names the module that knows what is worth showing of the class (``io.show.View`` says what such a module has).
Nothing of it is imported before it is asked for.
"""

from __future__ import annotations

from typing import Any

from bcfj_jax.core.upward import upward


def text(self: Any) -> str:
    """The result in a few lines: verdict, then a small table. No array is printed."""
    return upward("text")(self)


def html(self: Any) -> str:
    """The same for notebooks."""
    return upward("html")(self)


def to_pandas(self: Any) -> Any:
    """The result as a ``pandas.DataFrame`` (extra ``table``); units are in the columns' names, or in a column of their own."""
    return upward("frame")(self)


def to_xarray(self: Any) -> Any:
    """The result as an ``xarray.Dataset`` (extra ``table``) with named dimensions; units are in the attributes."""
    return upward("dataset")(self)


def plot(self: Any, what: str = "") -> Any:
    """One of the result's pictures, by name, as a ``matplotlib.figure.Figure``; no window opens and no file is written."""
    return upward("figure")(self, what)
