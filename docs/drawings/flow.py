"""From a file to a result: the parts of the program and what passes between them."""

from __future__ import annotations

from typing import Any

from matplotlib.patches import FancyBboxPatch

from docs.drawings.base import FIRST, GREY, INK, SECOND, arrow, canvas, save

# Name: (place, title, what it does, fill).
BOXES: dict[str, tuple[tuple[float, float], str, str, str]] = {
    "file": ((1.6, 9.2), "scene.toml", "", SECOND),
    "python": ((6.0, 9.2), "Python", "", SECOND),
    "io": ((1.6, 7.9), "io.scenefile", "checked, SI, every default", FIRST),
    "model": ((3.8, 6.6), "models, mechanism", "a model and its parameters", FIRST),
    "check": ((3.8, 5.3), "model.check", "InputError before compiling", FIRST),
    "simulate": ((3.8, 4.0), "solve.simulation", "simulate, force_history", FIRST),
    "integrate": ((3.8, 2.7), "solve.integrate", "solver, tolerance, steps", FIRST),
    "field": ((8.6, 2.7), "mechanism", "vector_field", FIRST),
    "gap": ((8.6, 6.6), "contact.gaps", "penetration, normal, lever", FIRST),
    "wrench": ((8.6, 5.3), "contact.wrench", "law, friction", FIRST),
    "equations": ((8.6, 4.0), "mechanism.equations", "mass matrix, accelerations", FIRST),
    "observe": ((3.8, 1.4), "model.observe, motions", "readings from states", FIRST),
    "run": ((3.8, 0.1), "Run", "forces, readings, status, error", SECOND),
    "results": ((0.9, -1.3), "analysis, io", "features, files, report", FIRST),
    "fit": ((6.7, -1.3), "calibration", "residuals, fit, verdict", FIRST),
}
WAYS = (
    "file io",
    "io model",
    "python model",
    "model check",
    "check simulate",
    "simulate integrate",
    "integrate observe",
)
WAYS += ("observe run", "run results", "run fit", "gap wrench", "wrench equations", "equations field")
WIDTH, HEIGHT = 3.3, 0.82


def _edge(name: str, towards: str) -> tuple[float, float]:
    """Where an arrow leaves a box."""
    (x, y), (u, v) = BOXES[name][0], BOXES[towards][0]
    if abs(v - y) < 0.1:
        return x + (WIDTH / 2 if u > x else -WIDTH / 2), y
    return x, y + (HEIGHT / 2 if v > y else -HEIGHT / 2)


def draw() -> None:
    """docs/images/flow.svg."""
    figure, axis = canvas(8.0, 8.2, (-1.0, 10.5), (-1.9, 9.9))
    for (x, y), title, what, fill in BOXES.values():
        box: Any = FancyBboxPatch(
            (x - WIDTH / 2, y - HEIGHT / 2), WIDTH, HEIGHT, boxstyle="round,pad=0,rounding_size=0.12", fc=fill, ec=GREY
        )
        axis.add_patch(box)
        axis.text(x, y + (0.17 if what else 0), title, ha="center", va="center", weight="bold", size=10.5)
        axis.text(x, y - 0.2, what, ha="center", va="center", size=9.5)
    for way in WAYS:
        a, b = way.split()
        arrow(axis, _edge(a, b), _edge(b, a), INK, lw=1.2)
    there, back = _edge("integrate", "field"), _edge("field", "integrate")
    arrow(axis, there, back, INK, "state", (6.2, 2.9), arrowstyle="<|-|>", lw=1.2)
    axis.text(6.2, 2.48, "rates", ha="center", va="center")
    save(figure, "flow")
