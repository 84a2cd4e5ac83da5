"""The look of all pictures, and how they are written. Matplotlib is imported on first use.

Figures are made without pyplot, so nothing global changes and no window can open.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

import numpy as np

from bcfj_jax.core.errors import escaped
from bcfj_jax.io.outputs import write_later
from bcfj_jax.io.units import engineering as engineering
from bcfj_jax.xla.threads import ahead

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, darkened until each has a contrast of 4.5 or more against white.
COLOURS = ("#0072b2", "#b84e00", "#007a5a", "#a8508a", "#8a6500", "#4a4a4a")


def get_ready() -> None:
    """Import what drawing needs, beside other work.

    The library of matplotlib's fonts runs Python code while the system holds a lock to load it: beside a thread that imports
    another library each could wait for the other without end. So it is loaded here, before there is another thread.
    """
    load_fonts()
    ahead(_import)


def load_fonts() -> None:
    """Load the library of matplotlib's fonts into the process, and import nothing: some milliseconds."""
    found = importlib.util.find_spec("matplotlib")
    for folder in (found.submodule_search_locations or ()) if found else ():
        for path in Path(folder).glob("ft2font*"):
            if path.suffix in (".so", ".pyd"):
                with contextlib.suppress(OSError):  # The import says why.
                    ctypes.PyDLL(str(path))


def _import() -> None:
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401


def rehearse() -> None:
    """Draw a small picture for nobody, so that modules and fonts are loaded."""
    drawing, (axis,) = figure(1, width=1.0, height=1.0)
    axis.set_title("a")
    png(drawing)


@contextmanager
def style() -> Iterator[None]:
    """The look of every picture, for the block's duration."""
    import matplotlib
    from cycler import cycler

    look: dict[Any, Any] = {
        "font.size": 10.0,
        "axes.titlesize": 11.0,
        "axes.titlelocation": "left",
        # At a given height: matplotlib would measure all ticks to find one, a fifth of the time of a picture.
        "axes.titley": 1.0,
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.prop_cycle": cycler(color=COLOURS),
        "grid.color": "#e2e2e2",
        "grid.linewidth": 0.6,
        "lines.linewidth": 1.5,
        "legend.frameon": False,
        "figure.dpi": 150,
    }
    with matplotlib.rc_context(look):
        yield


def plain(name: str) -> str:
    """A file's name for a picture: a dollar sign begins no formula, and what is no character is written as an escape."""
    return escaped(name).replace("$", r"\$")


class Margins(NamedTuple):
    """Room about each panel [in] for labels of known size; matplotlib's own layout takes as long as drawing them."""

    left: float = 0.75
    right: float = 0.2
    below: float = 0.55
    above: float = 0.35


def figure(
    rows: int, columns: int = 1, width: float = 7.5, height: float = 3.2, margins: Margins | None = None
) -> tuple[Figure, list[Axes]]:
    """A figure with its axes in reading order; size in inches, the height of one row."""
    from matplotlib.figure import Figure

    tall = height * rows
    if margins is None:
        drawing = Figure(figsize=(width, tall), layout="constrained")
        drawing.get_layout_engine().set(h_pad=0.1, w_pad=0.08)  # type: ignore[union-attr]
        return drawing, _axes(drawing, rows, columns, {})
    drawing, (left, right, below, above) = Figure(figsize=(width, tall)), margins
    place = {
        "left": left / width, "right": 1.0 - right / width, "bottom": below / tall, "top": 1.0 - above / tall,
        "wspace": (left + right) / (width / columns - left - right),
        "hspace": (below + above) / (height - below - above),
    }  # fmt: skip
    return drawing, _axes(drawing, rows, columns, place)


def _axes(drawing: Figure, rows: int, columns: int, place: dict[str, Any]) -> list[Axes]:
    axes = list(np.ravel(drawing.subplots(rows, columns, squeeze=False, gridspec_kw=place)))
    for axis in axes:
        # Of matplotlib's ten ticks six are enough; each is five artists to make and draw.
        axis.locator_params(nbins=6)
    return axes


class Look(TypedDict, total=False):
    """Size and margins of a ``figure``."""

    width: float
    height: float
    margins: Margins | None


@contextmanager
def sheet(
    path: Path | Kept, rows: int = 1, columns: int = 1, *, colours: int = 256, **look: Unpack[Look]
) -> Iterator[list[Axes]]:
    """The axes of a ``figure`` in our look, written to a PNG after the block (``save``)."""
    with style():
        drawing, axes = figure(rows, columns, **look)
        yield axes
        save(drawing, path, colours)


@contextmanager
def panels(
    count: int, columns: int, path: Path | Kept, width: float, height: float, margins: Margins | None = None
) -> Iterator[list[Axes]]:
    """As ``sheet``, with ``count`` axes of this width and height [in], in a grid of so many columns at most."""
    columns = min(count, columns)
    with sheet(
        path, -(-count // columns), columns, width=width * columns + 0.5, height=height, margins=margins
    ) as axes:
        for axis in axes[count:]:
            axis.set_visible(False)
        yield axes[:count]


def label(name: str, unit: str, prefix: str = "") -> str:
    """Text for an axis: ("time", "s", "u") -> "time [µs]"."""
    return f"{name} [{prefix.replace('u', 'µ')}{unit}]"


def over_time(axis: Axes, times: np.ndarray) -> float:
    """Name and limit an axis of times [s]; the scale of what is drawn along it."""
    scale, prefix = engineering(times)
    axis.set(xlabel=label("time", "s", prefix), xlim=(times[0] * scale, times[-1] * scale))
    return scale


class Kept:
    """In the place of a path: keeps the figure itself, for who shows it without a file."""

    name = ""
    drawing: Figure | None = None

    def __truediv__(self, name: str) -> Kept:
        return self


def save(drawing: Figure, path: Path | Kept, colours: int = 256) -> None:
    """Write a PNG (``png``), atomically; it is there when ``second_process.finish`` returns."""
    if isinstance(path, Kept):
        path.drawing = drawing
    else:
        write_later(path, png, drawing, colours)


def png(drawing: Figure, colours: int = 256) -> bytes:
    """A PNG of so many colours: a third of the bytes of one with all colours, and no slower.

    Pictures of many thin lines need 64, light fills 256; with 32 two of our colours become one.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(drawing)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    few = image.quantize(colours, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    # The palette's nearest to white is a shade darker than paper.
    palette = [255 if value >= 252 else value for value in few.getpalette() or []]
    few.putpalette(palette)
    found = io.BytesIO()
    few.save(found, format="png", compress_level=6)
    return found.getvalue()
