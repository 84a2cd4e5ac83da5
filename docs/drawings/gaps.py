"""The gaps: first body blue, second body orange, p from marker to marker, n the way in which b moves into a."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patches import Arc, Circle, Polygon, Rectangle, Wedge

from docs.drawings.base import FIRST, GREY, INK, RED, SECOND, arrow, canvas, measure, save

A, B, NORMAL = "#00528a", "#9a6700", RED


def _frame(x: tuple[float, float] = (-3, 3), y: tuple[float, float] = (-2.2, 2.2)) -> tuple[Any, Any]:
    scale = 0.78
    return canvas(scale * (x[1] - x[0]), scale * (y[1] - y[0]), x, y)


def _marker(axis: Any, place: Any, colour: str, name: str, text: Any) -> None:
    axis.plot(*place, marker="o", color=colour, ms=6, zorder=9)
    axis.text(*text, name, color=colour, weight="bold", ha="center", va="center", zorder=9)


def _ground(axis: Any, low: float, high: float, left: float = -3, right: float = 3, fill: str = FIRST) -> None:
    axis.add_patch(Rectangle((left, low), right - left, high - low, fc=fill, ec=INK, lw=1.2))


def _names(axis: Any, a: Any, b: Any) -> None:
    for place, text, colour in ((a, "first body a", A), (b, "second body b", B)):
        axis.text(*place, text, color=colour, ha="center", va="center", size=9.5, zorder=9)


def point_on_plane() -> None:
    """A point above a plane."""
    figure, axis = _frame()
    _ground(axis, -2.2, -0.8)
    axis.add_patch(Polygon([(0.9, 0.6), (0.2, 2.1), (1.6, 2.1)], fc=SECOND, ec=INK, lw=1.2))
    _marker(axis, (0.9, 0.6), B, "b", (1.35, 0.55))
    _marker(axis, (-1.9, -0.8), A, "a", (-2.25, -1.15))
    arrow(axis, (-1.9, -0.8), (0.9, 0.6), INK, "p", (-0.6, 0.25), lw=1.2)
    arrow(axis, (-1.9, -0.8), (-1.9, 0.7), A, "e", (-2.2, 0.7))
    measure(axis, (0.9, -0.8), (0.9, 0.55), "-d", (1.3, -0.15))
    arrow(axis, (2.3, -0.8), (2.3, -1.9), NORMAL, "n", (2.6, -1.6))
    _names(axis, (0.2, -1.5), (-0.75, 1.7))
    save(figure, "gap_point_on_plane")


def sphere_on_plane() -> None:
    """A sphere above a plane."""
    figure, axis = _frame()
    _ground(axis, -2.2, -1.0)
    axis.add_patch(Circle((0.7, 0.75), 1.2, fc=SECOND, ec=INK, lw=1.2))
    _marker(axis, (0.7, 0.75), B, "b", (0.95, 1.05))
    _marker(axis, (-1.9, -1.0), A, "a", (-2.25, -1.35))
    arrow(axis, (-1.9, -1.0), (0.7, 0.75), INK, "p", (-1.1, 0.05), lw=1.2)
    arrow(axis, (-1.9, -1.0), (-1.9, 0.6), A, "e", (-2.2, 0.6))
    arrow(axis, (0.7, 0.75), (1.7, 1.41), B, "radius", (2.4, 1.6), lw=1.2)
    measure(axis, (0.7, -1.0), (0.7, -0.45), "-d", (1.1, -0.72))
    arrow(axis, (2.3, -1.0), (2.3, -2.05), NORMAL, "n", (2.6, -1.7))
    _names(axis, (0.0, -1.65), (-1.75, 1.75))
    save(figure, "gap_sphere_on_plane")


def box_on_plane() -> None:
    """A tilted box above a plane, one corner in it."""
    figure, axis = _frame()
    _ground(axis, -2.2, -0.8)
    turn, half, middle = np.radians(24.0), np.array([1.25, 0.75]), np.array([0.6, 0.3])
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = [middle + axes @ (half * s) for s in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    axis.add_patch(Polygon(corners, fc=SECOND, ec=INK, lw=1.2, alpha=0.9))
    _marker(axis, middle, B, "b", middle + [0.3, 0.05])
    _marker(axis, (-1.9, -0.8), A, "a", (-2.25, -1.15))
    arrow(axis, (-1.9, -0.8), middle, INK, "p", (-1.1, -0.05), lw=1.2)
    arrow(axis, (-1.9, -0.8), (-1.9, 0.7), A, "e", (-2.2, 0.7))
    low = corners[0]
    arrow(axis, middle, low, B, "c", (0.15, -0.35), lw=1.2)
    arrow(axis, low, low + [0.0, -0.9], NORMAL, "n", low + [0.3, -0.75])
    arrow(axis, middle, middle + axes @ [1.25, 0.0], B, "A", middle + [1.0, 0.75], lw=1.2)
    arrow(axis, middle, middle + axes @ [0.0, 0.75], B, "B, C", middle + [-0.75, 0.65], lw=1.2)
    _names(axis, (1.7, -1.5), (2.0, 1.75))
    save(figure, "gap_box_on_plane")


def sphere_on_sphere() -> None:
    """Two spheres that overlap."""
    figure, axis = _frame()
    axis.add_patch(Circle((-1.2, -0.1), 1.5, fc=FIRST, ec=INK, lw=1.2))
    axis.add_patch(Circle((1.35, 0.25), 1.2, fc=SECOND, ec=INK, lw=1.2, alpha=0.85))
    _marker(axis, (-1.2, -0.1), A, "a", (-1.5, -0.4))
    _marker(axis, (1.35, 0.25), B, "b", (1.6, -0.05))
    arrow(axis, (-1.2, -0.1), (1.35, 0.25), INK, "p", (-0.6, 0.3), lw=1.2)
    measure(axis, (0.05, 1.75), (0.42, 1.75), "d", (0.24, 2.0))
    for x, low in ((0.05, 0.35), (0.42, 0.35)):
        axis.plot([x, x], [low, 1.85], color=GREY, lw=0.8, ls=":")
    arrow(axis, (1.35, 1.0), (0.45, 0.87), NORMAL, "n", (1.0, 1.2))
    arrow(axis, (-1.2, -0.1), (-1.95, -1.4), A, "radius_a", (-0.85, -1.15), lw=1.2)
    arrow(axis, (1.35, 0.25), (1.9, -0.82), B, "radius_b", (2.35, -1.15), lw=1.2)
    _names(axis, (-1.4, 0.9), (1.7, 1.85))
    save(figure, "gap_sphere_on_sphere")


def _ring(axis: Any, inner: float, pin: float, away: Any, outer: float = 2.0) -> None:
    axis.add_patch(Wedge((0, 0), outer, 0, 360, width=outer - inner, fc=FIRST, ec=INK, lw=1.2))
    axis.add_patch(Circle(away, pin, fc=SECOND, ec=INK, lw=1.2))


def _eccentric(name: str, of_a: str, of_b: str, vector: str, note: str) -> None:
    figure, axis = _frame((-3.2, 3.2), (-2.4, 2.3))
    away = np.array([0.42, 0.28])
    _ring(axis, 1.55, 0.95, away)
    _marker(axis, (0, 0), A, "a", (-0.28, -0.1))
    _marker(axis, away, B, "b", away + (0.02, 0.35))
    arrow(axis, (0, 0), away, INK, lw=1.4)
    axis.text(0.42, -0.12, vector, ha="center", va="center")
    way = away / np.hypot(*away)
    measure(axis, 1.45 * way, 1.55 * way, "", (0, 0))
    arrow(axis, 1.55 * way, 2.5 * way, NORMAL, "n", 2.75 * way)
    arrow(axis, (0, 0), 1.55 * np.array([-0.94, -0.34]), A, lw=1.2)
    axis.text(-3.1, -1.75, of_a, color=A, ha="left", va="center", size=9.5)
    axis.plot([-2.3, -1.05], [-1.55, -0.42], color=A, lw=0.8)
    arrow(axis, away, away + 0.95 * np.array([0.25, -0.97]), B, lw=1.2)
    axis.text(2.35, -1.85, of_b, color=B, ha="center", va="center", size=9.5)
    axis.plot([1.75, 0.62], [-1.75, -0.42], color=B, lw=0.8)
    axis.text(0, -2.25, note, ha="center", va="center", size=9.5)
    axis.text(-2.45, 1.9, "first body a", color=A, ha="center", size=9.5)
    save(figure, f"gap_{name}")


def sphere_in_socket() -> None:
    """A sphere in a hollow sphere."""
    _eccentric("sphere_in_socket", "radius", "radius - clearance", "p", "d = |p| - clearance")


def pin_in_bearing() -> None:
    """A pin in a bearing, seen along the axis."""
    _eccentric("pin_in_bearing", "radius + clearance", "radius of the pin", "e", "z of a points out of the page")


def pin_in_slot() -> None:
    """A pin between two walls of a slot."""
    figure, axis = _frame()
    _ground(axis, 1.05, 1.9)
    _ground(axis, -1.9, -1.05)
    axis.add_patch(Circle((0.8, 0.3), 0.62, fc=SECOND, ec=INK, lw=1.2))
    axis.plot([-3, 3], [0, 0], color=GREY, lw=1, ls="-.")
    _marker(axis, (-1.6, 0), A, "a", (-1.9, -0.3))
    _marker(axis, (0.8, 0.3), B, "b", (1.05, 0.1))
    arrow(axis, (-1.6, 0), (0.8, 0.3), INK, "p", (-0.5, 0.38), lw=1.2)
    arrow(axis, (-1.6, 0), (-1.6, 0.9), A, "e", (-1.9, 0.8))
    arrow(axis, (-1.6, 0), (-2.7, 0), A, lw=1.2)
    axis.text(-2.5, 0.3, "axis", color=A, ha="center", va="center")
    measure(axis, (0.8, 0.92), (0.8, 1.05), "", (0, 0))
    arrow(axis, (2.2, 0.0), (2.2, 1.0), NORMAL, "n, face 1", (2.2, -0.3), lw=1.6)
    arrow(axis, (-0.6, -0.3), (-0.6, -1.0), NORMAL, "n, face 2", (0.25, -0.65), lw=1.6)
    _names(axis, (0, 1.5), (1.9, -1.5))
    axis.texts[-1].set_text("clearance: to either wall\nfrom the middle")
    axis.texts[-1].set_position((0.0, -1.48))
    save(figure, "gap_pin_in_slot")


def slider_in_guide() -> None:
    """A block with four corners between two walls."""
    figure, axis = _frame()
    _ground(axis, 1.3, 2.0)
    _ground(axis, -2.0, -1.3)
    turn = np.radians(7.0)
    way, up = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    corners = {n: 1.9 * s * way + 0.95 * t * up for n, s, t in ((1, -1, 1), (2, 1, 1), (3, -1, -1), (4, 1, -1))}
    axis.add_patch(Polygon([corners[k] for k in (1, 2, 4, 3)], fc=SECOND, ec=INK, lw=1.2))
    for number, place in corners.items():
        axis.plot(*place, marker="o", color=RED, ms=6, zorder=9)
        axis.text(*(place * (0.83, 0.7)), str(number), color=RED, ha="center", va="center", weight="bold")
    axis.plot([-3, 3], [0, 0], color=GREY, lw=1, ls="-.")
    _marker(axis, (0, 0), B, "b", (0.25, -0.3))
    measure(axis, (0, 0), 1.9 * way, "half_length", (1.0, 0.42), B)
    measure(axis, (0, 0), 0.95 * up, "half_width", (-0.95, 0.5), B)
    arrow(axis, (2.5, 0.0), (2.5, 1.25), NORMAL, "n of 1, 2", (2.35, -0.25))
    _names(axis, (-1.9, 1.65), (1.7, 1.65))
    axis.texts[-1].set_text("")
    save(figure, "gap_slider_in_guide")


def two_sided_stop() -> None:
    """A body between two stops."""
    figure, axis = _frame((-3.4, 3.4), (-1.7, 1.6))
    for left, right in ((-3.2, -2.3), (2.3, 3.2)):
        axis.add_patch(Rectangle((left, -1.2), right - left, 2.4, fc=FIRST, ec=INK, lw=1.2))
    axis.add_patch(Rectangle((-0.35, -0.55), 1.5, 1.1, fc=SECOND, ec=INK, lw=1.2))
    _marker(axis, (0, 0), A, "a", (-0.05, -0.85))
    _marker(axis, (0.4, 0.0), B, "b", (0.62, -0.25))
    arrow(axis, (0, 0), (0.4, 0), INK, lw=1.2)
    axis.text(0.2, 0.27, "p", ha="center", va="center")
    measure(axis, (1.15, 0.75), (2.3, 0.75), "clearance - p . e", (1.4, 1.15))
    arrow(axis, (2.3, -0.2), (3.1, -0.2), NORMAL, "n, face 1", (2.75, -1.45))
    arrow(axis, (-2.3, -0.2), (-3.1, -0.2), NORMAL, "n, face 2", (-2.75, -1.45))
    arrow(axis, (-1.9, -1.45), (-0.7, -1.45), A, "e", (-0.4, -1.45))
    save(figure, "gap_two_sided_stop")


def ball_in_groove() -> None:
    """A ball in a gothic groove, in the section across the track."""
    figure, axis = _frame((-3.2, 3.2), (-2.5, 2.2))
    alpha, radius, q = np.radians(40.0), 1.5, 0.55
    left = {}
    for side in (1, -1):
        centre = -q * np.array([side * np.sin(alpha), -np.cos(alpha)])
        turn = np.radians(np.linspace(-90, 12, 80))
        arc = np.column_stack([side * (radius + q) * np.cos(turn), (radius + q) * np.sin(turn)]) + centre
        left[side] = arc[(side * arc[:, 0] > 0)]
    ground = np.vstack(
        [left[1], [(3.1, left[1][-1][1]), (3.1, -2.4), (-3.1, -2.4), (-3.1, left[-1][-1][1])], left[-1][::-1]]
    )
    axis.add_patch(Polygon(ground, fc=FIRST, ec=INK, lw=1.2))
    axis.add_patch(Circle((0, 0.06), radius - 0.05, fc=SECOND, ec=INK, lw=1.2))
    _marker(axis, (0, 0.06), B, "b", (0.25, 0.3))
    axis.plot([0, 0], [-2.4, 2.0], color=GREY, lw=1, ls="-.")
    for side, name in ((1, "flank 1"), (-1, "flank 2")):
        way = np.array([side * np.sin(alpha), -np.cos(alpha)])
        axis.plot(*np.transpose([(0, 0.06), radius * way]), color=INK, lw=0.9)
        arrow(axis, radius * way, (radius + 0.85) * way, NORMAL, "n", (radius + 1.0) * way + (0.12 * side, 0))
        axis.text(2.35 * side, -0.1, name, ha="center", va="center", color=A, size=9.5)
    axis.add_patch(Arc((0, 0.06), 1.5, 1.5, theta1=270, theta2=270 + np.degrees(alpha), color=INK, lw=1.2))
    axis.text(-1.0, -2.2, "contact_angle", ha="right", va="center", size=9.5)
    axis.plot([-0.95, 0.2], [-2.1, -0.68], color=INK, lw=0.8, zorder=8)
    arrow(axis, (0, 0.06), (-1.02, 1.08), B, lw=1.2)
    axis.text(-0.15, 1.05, "ball_radius", ha="left", va="center", color=B, size=9.5)
    axis.text(-2.0, 1.75, "track's plane: dash-dotted", ha="center", va="center", color=GREY, size=9)
    save(figure, "gap_ball_in_groove")


def ball_between_planes() -> None:
    """A ball in a window of the cage."""
    figure, axis = _frame()
    _ground(axis, 1.35, 2.0)
    _ground(axis, -2.0, -1.35)
    axis.add_patch(Circle((0.9, 0.12), 1.1, fc=SECOND, ec=INK, lw=1.2))
    axis.plot([-3, 3], [0, 0], color=GREY, lw=1, ls="-.")
    _marker(axis, (-1.7, 0), A, "a", (-2.0, -0.3))
    _marker(axis, (0.9, 0.12), B, "b", (1.15, 0.4))
    arrow(axis, (-1.7, 0), (0.9, 0.12), INK, "p", (-0.6, 0.35), lw=1.2)
    arrow(axis, (-1.7, 0), (-1.7, 1.1), A, "e", (-2.0, 1.0))
    arrow(axis, (0.9, 0.12), (0.35, -0.83), B, lw=1.2)
    axis.text(-0.75, -0.85, "ball_radius", color=B, ha="center", va="center", size=9.5)
    measure(axis, (2.4, 1.22), (2.4, 1.35), "", (0, 0))
    axis.plot([0.9, 2.6], [1.22, 1.22], color=GREY, lw=0.8, ls=":")
    axis.text(2.45, 0.95, "-d", color=RED, ha="center", va="center")
    arrow(axis, (0.9, 1.35), (0.9, 1.95), NORMAL, "n", (1.2, 1.75))
    _names(axis, (-1.6, 1.67), (0, -1.67))
    axis.texts[-1].set_text("clearance: to either plane from the middle")
    save(figure, "gap_ball_between_planes")


def _long(axis: Any, middle: Any, angle: float, half: float, radius: float, fill: str, capsule: bool = True) -> None:
    """A capsule or a cylinder from its side."""
    way = np.array([np.cos(angle), np.sin(angle)])
    across = radius * np.array([-way[1], way[0]])
    corners = [middle + s * half * way + t * across for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    if capsule:
        for s in (-1, 1):
            axis.add_patch(Circle(middle + s * half * way, radius, fc=fill, ec=INK, lw=1.2))
    axis.add_patch(Polygon(corners, fc=fill, ec=fill if capsule else INK, lw=1.2))
    if capsule:
        for k in (0, 2):
            axis.plot(*np.array(corners[k : k + 2]).T, color=INK, lw=1.2)
    ends = np.array([middle - half * way, middle + half * way])
    axis.plot(*ends.T, color=GREY, lw=1.0, ls="-.")


def edges() -> None:
    """A capsule and a cylinder on a plane, two capsules, a sphere on a box, a sphere on a wedge."""
    figure, axis = canvas(11.5, 2.6, (-1.4, 15.6), (-2.0, 1.8))
    for left, fill in ((-1.2, FIRST), (2.2, FIRST)):
        axis.add_patch(Rectangle((left, -1.6), 3.0, 0.7, fc=fill, ec=INK, lw=1.2))
    _long(axis, np.array([0.3, 0.0]), 0.45, 0.85, 0.5, SECOND)
    _long(axis, np.array([3.7, 0.05]), 0.45, 0.95, 0.5, SECOND, capsule=False)
    low = np.array([0.3, 0.0]) - 0.85 * np.array([np.cos(0.45), np.sin(0.45)]) - [0.0, 0.5]
    rim = (
        np.array([3.7, 0.05])
        - 0.95 * np.array([np.cos(0.45), np.sin(0.45)])
        + 0.5 * np.array([np.sin(0.45), -np.cos(0.45)])
    )
    _long(axis, np.array([7.0, -0.5]), 0.1, 1.0, 0.45, FIRST)
    _long(axis, np.array([7.3, 0.55]), -0.5, 0.8, 0.4, SECOND)
    axis.add_patch(Rectangle((9.2, -1.6), 2.0, 1.5, fc=FIRST, ec=INK, lw=1.2))
    corner, away = np.array([11.2, -0.1]), np.array([np.sin(0.7), np.cos(0.7)])
    axis.add_patch(Circle(corner + 0.62 * away, 0.7, fc=SECOND, ec=INK, lw=1.2))
    edge = np.array([13.9, -0.2])
    axis.add_patch(Polygon([edge, edge + [-1.0, -1.4], edge + [1.0, -1.4]], fc=FIRST, ec=INK, lw=1.2))
    face = np.array([1.4, 1.0]) / np.hypot(1.4, 1.0)
    axis.add_patch(Circle(edge + 0.45 * np.array([1.0, -1.4]) / 1.72 + 0.62 * face, 0.7, fc=SECOND, ec=INK, lw=1.2))
    for point, normal in (
        (low, (0, -1)), (rim, (0, -1)), (np.array([7.75, 0.0]), (-0.15, -1)), (corner, -away),
        (edge + 0.45 * np.array([1.0, -1.4]) / 1.72, -face),
    ):  # fmt: skip
        arrow(axis, point, point + 0.6 * np.array(normal) / np.linalg.norm(normal), NORMAL)
        axis.plot(*point, marker="o", color=NORMAL, ms=4, zorder=9)
    for x, text in ((0.3, "capsule"), (3.7, "cylinder"), (7.1, "capsules"), (10.6, "box"), (13.9, "wedge")):
        axis.text(x, -1.9, text, ha="center", va="center")
    axis.text(-1.2, 1.6, "n", color=NORMAL, weight="bold", ha="center", va="center")
    save(figure, "gap_edges")


def draw() -> None:
    """All but two boxes; those with edges in one."""
    for one in (
        point_on_plane, sphere_on_plane, box_on_plane, sphere_on_sphere, sphere_in_socket, pin_in_bearing, pin_in_slot,
        slider_in_guide, two_sided_stop, ball_in_groove, ball_between_planes, edges,
    ):  # fmt: skip
        one()
