"""The ball-cage joint: a section with its parts and contacts, and its frames under deflection. Sizes are the defaults."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patches import Arc, Circle, Polygon

from docs.drawings.base import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, arrow, canvas, measure, save

# Sizes in mm, of bcfj_jax/models/joint/defaults.py; only the clearances are drawn wider (WIDE).
SEAT, HEAD, BALL, PITCH, OFFSET, LEAN = 40.0, 31.0, 8.0, 35.5, 4.5, np.radians(23.0)
TRACK, WIDE = float(np.hypot(PITCH, OFFSET)), 0.9
SEAT_FILL, CAGE_FILL, HEAD_FILL, BALL_FILL = "#c9dcec", "#f6dfb4", "#cfe8dc", "#e9e9e9"


def _round(radius: float, first: float, last: float, height: float = 0.0) -> Any:
    """Points on a circle about (0, height), from one polar angle to another [degrees from +z, x > 0]."""
    angle = np.radians(np.linspace(first, last, 120))
    return np.column_stack([radius * np.sin(angle), height + radius * np.cos(angle)])


def _body(axis: Any, points: Any, fill: str) -> None:
    axis.add_patch(Polygon(points, closed=True, fc=fill, ec=INK, lw=1.2))


def _label(axis: Any, number: str, point: Any, place: Any) -> None:
    """A contact's number at its end of a line that leads to the place of contact."""
    axis.plot(*np.transpose([point, place]), color=RED, lw=1.1, zorder=8)
    axis.add_patch(Circle(point, 0.7, fc=RED, ec=RED, zorder=9))
    axis.add_patch(Circle(place, 2.6, fc="white", ec=RED, lw=1.6, zorder=9))
    axis.text(*place, number, ha="center", va="center", color=RED, weight="bold", zorder=10)


def section() -> None:
    """docs/images/joint_section.svg: left between two tracks, right through a ball; not deflected."""
    figure, axis = canvas(8.6, 7.0, (-74, 74), (-64, 56.5))
    left = np.array([-1.0, 1.0])
    rim = [(54, 16)]
    # Seat: left with its sphere, right with the track's bottom.
    for side, bore in ((left, _round(SEAT, 60, 165)), (1, _round(TRACK + BALL, 62, 165, OFFSET))):
        shell = np.vstack([bore, [(0, bore[-1][1])], [(0, -60), (14, -60), (14, -52)], _round(54, 165, 90), rim])
        _body(axis, shell * side, SEAT_FILL)
    # Head with its shaft: left with its sphere, right with the track's bottom.
    for side, ball in ((left, _round(HEAD, 24, 180)), (1, _round(TRACK - BALL, 24, 180, -OFFSET))):
        shaft = [(0, 54), (11, 54), (11, ball[0][1]), (ball[0][0], ball[0][1])]
        _body(axis, np.vstack([shaft, ball]) * side, HEAD_FILL)
    # Cage: whole on the left, on the right with the window in which the ball sits.
    thick = (HEAD + WIDE, SEAT - WIDE)
    inner, outer = (np.degrees(np.arccos((BALL + WIDE / 2) / radius)) for radius in thick)
    _body(axis, np.vstack([_round(thick[1], 52, 128), _round(thick[0], 128, 52)]) * left, CAGE_FILL)
    for side in (np.array([1.0, 1.0]), np.array([1.0, -1.0])):
        _body(axis, np.vstack([_round(thick[1], 52, outer), _round(thick[0], inner, 52)]) * side, CAGE_FILL)
    axis.add_patch(Circle((PITCH, 0), BALL, fc=BALL_FILL, ec=INK, lw=1.2, zorder=5))
    axis.plot([0, 0], [-62, 56], color=GREY, lw=1, ls="-.")
    axis.plot([PITCH], [0], marker="+", color=INK, ms=9, zorder=6)
    for number, point, place in (
        ("1", np.array([-(SEAT - WIDE / 2) * np.sin(1.9), (SEAT - WIDE / 2) * np.cos(1.9)]), (-60.5, -33)),
        ("2", np.array([-(HEAD + WIDE / 2) * np.sin(1.25), (HEAD + WIDE / 2) * np.cos(1.25)]), (-60, 33)),
        ("3", (PITCH, BALL + WIDE / 4), (36, 38)),
        ("4", (PITCH + BALL * 0.99, -OFFSET * BALL / TRACK), (64.5, -6)),
        ("5", (PITCH - BALL * 0.99, -OFFSET * BALL / TRACK), (20, -9)),
    ):
        _label(axis, number, point, place)
    for text, place in (("seat", (33, -35)), ("head", (-13, 4)), ("cage", (-35, 0)), ("ball", (PITCH, -3.2))):
        axis.text(*place, text, ha="center", va="center", weight="bold", zorder=7, size=10 if text == "ball" else 12)
    for text, place in (("section between\ntwo tracks", (-45, 49)), ("section through\na ball", (52, 49))):
        axis.text(*place, text, ha="center", va="center", color=GREY)
    notes = ("1 seat_cage", "2 head_cage", "3 cage_ball", "4 seat_ball", "5 head_ball")
    for k, note in enumerate(notes):
        axis.text(-73, -41 - 5.0 * k, note, color=RED, va="center")
    save(figure, "joint_section")


def frames() -> None:
    """docs/images/joint_frames.svg: axes, track centres and balls in the plane of deflection."""
    figure, axis = canvas(8.0, 6.6, (-58, 62), (-47, 55))
    head, middle = (np.array([np.sin(a), np.cos(a)]) for a in (LEAN, LEAN / 2))
    across = np.array([middle[1], -middle[0]])
    centres = (OFFSET * np.array([0.0, 1.0]), -OFFSET * head)
    for centre, colour in zip(centres, (BLUE, GREEN), strict=True):
        axis.add_patch(Circle(centre, TRACK, fill=False, ec=colour, lw=1.3, ls="--"))
        axis.plot(*centre, marker="o", color=colour, ms=6, zorder=6)
    for side in (1, -1):
        h = -side * np.tan(LEAN / 2)
        reach = (h * OFFSET + np.sqrt((1 + h * h) * TRACK**2 - OFFSET**2)) / (1 + h * h)
        place = reach * np.array([side, h])
        axis.add_patch(Circle(place, BALL, fc=BALL_FILL, ec=INK, lw=1.2, zorder=4))
        axis.plot(*place, marker="+", color=INK, ms=9, zorder=6)
        if side == 1:
            first = place
    axis.plot(*np.transpose([-52 * across, 54 * across]), color=PURPLE, lw=1.2, ls="-.")
    axis.text(-56, 22, "bisecting plane:\nall ball centres", color=PURPLE, va="center")
    axis.plot([-49, -49], [18, 10.5], color=PURPLE, lw=0.8)
    arrow(axis, (0, 0), (0, 50), BLUE, "z: seat's axis", (-14, 49))
    arrow(axis, (0, 0), 50 * head, GREEN, "head's axis", 50 * head + (11, 1))
    arrow(axis, (0, 0), 44 * middle, PURPLE, "cage's axis", 44 * middle + (3.5, 3.5))
    arrow(axis, (0, 0), (27, 0), INK, "x", (29, 1.5))
    axis.plot(0, 0, marker="o", color=INK, ms=6, zorder=7)
    axis.text(-3, -1.5, "O", ha="center", va="center", weight="bold")
    axis.add_patch(Arc((0, 0), 60, 60, theta1=90 - np.degrees(LEAN), theta2=90, color=INK, lw=1.2))
    axis.text(-14, 31, "joint_angle", ha="center", va="center")
    axis.plot([-6, 3], [31, 30], color=INK, lw=0.8)
    axis.text(-12.5, 6, "+offset", ha="center", va="center", color=BLUE)
    axis.text(-11, -6.5, "-offset", ha="center", va="center", color=GREEN)
    arrow(axis, centres[0], first, BLUE, lw=1.2)
    axis.text(44, 9, "track radius", ha="center", va="center", color=BLUE)
    axis.plot([36, 20], [7.5, -1.6], color=BLUE, lw=0.8)
    arrow(axis, centres[1], first, GREEN, lw=1.2)
    axis.text(20, -20, "track radius", ha="center", va="center", color=GREEN)
    axis.plot([19, 17], [-18, -6.2], color=GREEN, lw=0.8)
    axis.text(46, -18.8, "ball 1 at time 0", ha="center", va="center", size=10)
    axis.text(
        -56, -41, "dashed: circles of the ball centres,\nof the seat's tracks (blue) and the head's (green)", size=9.5
    )
    arrow(axis, 30 * head + (16, 6), 30 * head + (9, 3), ORANGE)
    axis.text(
        *(30 * head + (26, 8)), "load: torque about\n-head axis, axial load", ha="center", va="center", color="#9a6700"
    )
    measure(axis, (0, 0), PITCH * across, "pitch_radius", (4, -14.5), RED)
    axis.plot([5, 10], [-12.5, -2.4], color=RED, lw=0.8)
    save(figure, "joint_frames")


def components() -> None:
    """docs/images/joint_components.svg: what normal, axial and tangential mean at a groove and at a window."""
    figure, axis = canvas(8.6, 3.4, (-4.6, 14.6), (-3.6, 3.9))
    for centre, title in (((0.0, 0.0), "seat_ball, head_ball"), ((8.4, 0.0), "cage_ball")):
        axis.add_patch(Circle(centre, 1.6, fc=BALL_FILL, ec=INK, lw=1.3, zorder=3))
        axis.text(centre[0], 3.5, title, ha="center", weight="bold")
    axis.fill_between(np.linspace(-3.4, 3.4, 50), -3.2, -1.45 + 0.012 * np.linspace(-3.4, 3.4, 50) ** 2, fc=SEAT_FILL)
    axis.plot(np.linspace(-3.4, 3.4, 50), -1.45 + 0.012 * np.linspace(-3.4, 3.4, 50) ** 2, color=INK, lw=1.3)
    arrow(axis, (0, -1.5), (0, 1.1), RED, "normal: sum of both flanks", (0, 2.25))
    arrow(axis, (0, -1.5), (2.7, -1.5), BLUE, "axial:\nalong the track", (3.1, -0.5))
    axis.add_patch(Circle((0, -1.5), 0.24, fc="white", ec=GREEN, lw=1.4, zorder=8))
    axis.plot(0, -1.5, marker="o", color=GREEN, ms=4, zorder=9)
    axis.text(0, -2.35, "tangential: around the section\n(out of the page)", ha="center", va="center", color=GREEN)
    for low, high in ((1.75, 2.5), (-2.5, -1.75)):
        axis.fill_between([5.6, 11.2], low, high, fc=CAGE_FILL, ec=INK, lw=1.2)
    arrow(axis, (8.4, 0), (8.4, 1.6), RED, lw=2)
    axis.text(10.3, -0.6, "normal: along the\ncage's axis, signed", color=RED, ha="left", va="center")
    arrow(axis, (8.4, 1.68), (11.6, 1.68), BLUE, "axial: outward", (11.0, 1.1))
    axis.add_patch(Circle((8.4, 1.68), 0.24, fc="white", ec=GREEN, lw=1.4, zorder=8))
    axis.plot(8.4, 1.68, marker="o", color=GREEN, ms=4, zorder=9)
    axis.text(8.4, -3.1, "tangential: around the cage (out of the page)", ha="center", va="center", color=GREEN)
    axis.text(11.35, 2.1, "cage", ha="left", va="center", color=INK)
    save(figure, "joint_components")


def draw() -> None:
    """All three."""
    section()
    frames()
    components()
