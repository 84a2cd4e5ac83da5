"""Colours, ink and files of the drawings in the pages; ``python -m docs.drawings.draw`` makes all of them again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt

IMAGES = Path(__file__).resolve().parent.parent / "images"
# Okabe and Ito's colours, which colour-blind readers tell apart; text is ink.
INK, GREY = "#222222", "#8a8a8a"
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9"
FIRST, SECOND = "#c9dcec", "#f6dfb4"  # fill of the first and of the second body of a contact
STYLE = {
    "svg.hashsalt": "bcfj-jax",  # the same file each time
    "svg.fonttype": "path",
    "font.size": 11,
    "font.family": "DejaVu Sans",
    "mathtext.fontset": "dejavusans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}


def canvas(width: float, height: float, x: tuple[float, float], y: tuple[float, float]) -> tuple[Any, Any]:
    """A figure [inches] and one axis without a frame, equal scales, over these ranges."""
    figure, axis = plt.subplots(figsize=(width, height))
    axis.set(xlim=x, ylim=y, aspect="equal")
    axis.axis("off")
    figure.subplots_adjust(0, 0, 1, 1)
    return figure, axis


def save(figure: Any, name: str) -> None:
    """Write docs/images/NAME.svg."""
    figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)


def arrow(axis: Any, start: Any, end: Any, colour: str = INK, text: str = "", at: Any = None, **more: Any) -> None:
    """An arrow from start to end, with a text at a place (by default beyond its point)."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 13}
    axis.annotate("", end, start, arrowprops={**style, **more}, zorder=6)
    if text:
        axis.text(*(end if at is None else at), text, color=colour, ha="center", va="center", zorder=7)


def measure(axis: Any, start: Any, end: Any, text: str, at: Any, colour: str = RED) -> None:
    """A length between two points: a double arrow and its name."""
    arrow(axis, start, end, colour, text, at, arrowstyle="<|-|>", lw=1.2, mutation_scale=9)
