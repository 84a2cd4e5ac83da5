"""Pictures in the manner of the paper's figures 8 to 14: a force history a contact, and with and without clearance."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.io.page import Picture, brief
from bcfj_jax.io.plots import COLOURS, sheet
from bcfj_jax.reproduction.claims import claim
from bcfj_jax.reproduction.frames import FRAMES, ORDER, WINDOW_AXIAL, WINDOW_NORMAL, components, later
from bcfj_jax.reproduction.measures import resultant
from bcfj_jax.reproduction.record import Record
from bcfj_jax.solve.simulation import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILES = (
    "point_1_seat_cage.png", "point_2_head_cage.png", "point_3_cage_ball.png", "point_4_seat_ball.png",
    "point_5_head_ball.png", "no_clearance_fit.png", "small_clearances.png", "frames.png", "sudden_start.png",
)  # fmt: skip
# What a reader looks for first: the peaks of the paper's points 1 and 4.
LEADING = (FILES[0], FILES[3])
# The paper's claim of the peak at each of its points.
_POINTS = {"seat_cage": "Q20", "head_cage": "Q21", "cage_ball": "Q23", "seat_ball": "Q26", "head_ball": "Q27"}
_PARTS = ("normal", "axial", "tangential")
_WIDE, _THIN = 7.2, 0.9


def draw(
    folder: Path, runs: dict[str, Run], tight: Run | None, observed: Record | None = None, sudden: Run | None = None
) -> list[Picture]:
    """Write every picture there are runs for: the first of ``runs`` leads, ``tight`` has small clearances, ``observed`` is looked
    at from several frames, ``sudden`` is a sudden start, finely sampled.
    """
    written = []
    for point, (contact, name) in enumerate(zip(_POINTS, FILES, strict=False), 1):
        written.append((_guide if contact.endswith("cage") else _balls)(folder / name, runs, point, contact))
    first = next(iter(runs.values()))
    if first.times[-1] >= WINDOW_AXIAL[1]:
        written.append(_smooth(folder / FILES[5], first))
    if tight is not None:
        written.append(_tight(folder / FILES[6], first, tight))
    if observed is not None:
        written.append(_frames(folder / FILES[7], observed))
    if sudden is not None:
        written.append(_sudden(folder / FILES[8], sudden))
    return written


def _axis(axis: Axes, title: str, what: str, limits: tuple[float, float], unit: str = "s") -> None:
    axis.set(title=title, xlabel=f"time [{unit}]", ylabel=f"{what} [kN]", xlim=limits)


def _line(axis: Axes, times: np.ndarray, force: np.ndarray, **look: object) -> None:
    axis.plot(times, force / 1e3, **{"linewidth": _THIN, **look})  # pyright: ignore[reportArgumentType]


def _legend(axis: Axes, columns: int) -> None:
    axis.legend(ncols=columns, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.98))


def _paper(axis: Axes, id: str) -> None:
    for number, value in enumerate(claim(id).values):
        name = _printed(id) if number == 0 else None
        axis.axhline(value / 1e3, label=name, color="#222222", linewidth=1.0, linestyle="--")


def _printed(id: str) -> str:
    return f"paper, {id}: {claim(id).printed}"


def _tops(runs: Iterable[tuple[str, Run]], contact: str) -> str:
    return ", ".join(f"{n} {brief(float(np.max(np.abs(r.force[contact][..., 0]))), 'N')}" for n, r in runs)


def _size(run: Run, contact: str) -> np.ndarray:
    """What the paper shows of a contact: the normal force of pilots and windows, the resultant in grooves."""
    return resultant(run.force[contact]) if contact in ("seat_ball", "head_ball") else run.force[contact][..., 0]


def _frames(path: Path, record: Record) -> Picture:
    """The radial force of point 1 as each observer reads it, over two turns at most of the settled joint."""
    low, high = later(record.run.times)
    with sheet(path, len(FRAMES), width=_WIDE, height=1.5, colours=32) as axes:
        for axis, frame in zip(axes, FRAMES, strict=True):
            _line(axis, record.run.times, components(record, "seat_cage", frame)[:, 0])
            _axis(axis, FRAMES[frame], "x", (low, min(high, low + 1.2)))
    shows = (
        "The same force of the cage on the seat, as given, in the axes of six observers: sixfold a turn in the contact's own "
        "and in fixed axes, once a turn in axes that turn with a part."
    )
    return Picture(path.name, "Point 1 as different observers read it", shows)


def _sudden(path: Path, run: Run) -> Picture:
    with sheet(path, len(_POINTS), width=_WIDE, height=1.7, colours=64) as axes:
        for axis, (contact, id) in zip(axes, _POINTS.items(), strict=True):
            for member in _size(run, contact).reshape(len(run.times), -1).T:
                _line(axis, 1e3 * run.times, member)
            _axis(axis, f"{contact}, sudden start", "force", (0.0, 1.5), "ms")
            _paper(axis, id)
    shows = (
        "Forces of the first 1.5 ms after the torque is stepped on, read every microsecond; dashed: the paper's peaks."
    )
    return Picture(path.name, "Sudden start", shows)


def _guide(path: Path, runs: dict[str, Run], point: int, contact: str) -> Picture:
    """Three components of a sphere in a sphere, the runs on top of each other."""
    id = _POINTS[contact]
    with sheet(path, 3, width=_WIDE, height=1.9, colours=64) as axes:
        for part, axis in enumerate(axes):
            for name, run in runs.items():
                _line(axis, run.times, run.force[contact][:, part], label=name)
                title = f"Point {point}, {contact}: {_PARTS[part]}"
                _axis(axis, title, "force", (run.times[0], run.times[-1]))
            if part == 0:
                _paper(axis, id)
        _legend(axes[0], len(runs) + 1)
    tops = ", ".join(f"{name} {brief(float(np.max(run.force[contact][:, 0])), 'N')}" for name, run in runs.items())
    shows = (
        f"Normal, axial and tangential force of {contact} against time; highest normal force: {tops}; {_printed(id)}."
    )
    return Picture(path.name, f"Point {point}: {contact}", shows)


def _balls(path: Path, runs: dict[str, Run], point: int, contact: str) -> Picture:
    """Six balls on top of each other, a panel a run."""
    id, what = _POINTS[contact], "normal force" if contact == "cage_ball" else "resultant"
    low = claim(id).values[0]
    with sheet(path, len(runs), width=_WIDE, height=3.1, colours=64) as axes:
        for (name, run), axis in zip(runs.items(), axes, strict=True):
            for ball, values in enumerate(_size(run, contact).T, 1):
                _line(axis, run.times, values, label=f"ball {ball}")
            # Six lines on top of each other: what comes later repeats itself.
            _axis(axis, f"Point {point}, {contact}, {name}", what, (0.0, min(1.2, run.times[-1])))
            _paper(axis, id)
            axis.set_ylim(bottom=1.12 * low / 1e3 if low < 0 else 0.0)
        axes[-1].legend(ncols=7, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    highest = _tops(runs.items(), contact)
    shows = f"The {what} of each ball in {contact} against time; highest normal force: {highest}; {_printed(id)}."
    return Picture(path.name, f"Point {point}: {contact}", shows)


def _smooth(path: Path, run: Run) -> Picture:
    """Force of the cage on the seat, the polynomial "without clearance" over the paper's windows, and what is left."""
    with sheet(path, 4, width=_WIDE, height=2.3, colours=64) as axes:
        for part, window in enumerate((WINDOW_NORMAL, WINDOW_AXIAL)):
            force = run.force["seat_cage"][:, part]
            fit = features.no_clearance_fit(run.times, force, window, ORDER)
            at = features.within(run.times, window)
            above, below = axes[2 * part : 2 * part + 2]
            _line(above, run.times[at], force[at], label="model, with clearance")
            above.plot(fit.times, np.asarray(fit.fitted) / 1e3, label=f"polynomial of order {ORDER}")
            _axis(above, f"Point 1, seat_cage: {_PARTS[part]}, as given", "force", window)
            _line(below, np.asarray(fit.times), np.asarray(fit.residual), color=COLOURS[3])
            _axis(below, "what the polynomial leaves over", "force", window)
            _legend(above, 2)
    shows = (
        f"Force of the cage on the seat in the paper's windows, a polynomial of order {ORDER}, and what it leaves over."
    )
    return Picture(path.name, "With and without clearance", shows)


def _tight(path: Path, run: Run, tight: Run) -> Picture:
    """One turn with the clearances as given and with small ones, normal forces; ball 1 where there are six."""
    with sheet(path, len(run.force), width=_WIDE, height=2.2, colours=64) as axes:
        for axis, (name, forces) in zip(axes, run.force.items(), strict=True):
            for label, which in (("clearances as given", run), ("a tenth of them", tight)):
                force = which.force[name][..., 0]
                _line(axis, which.times, force if force.ndim == 1 else force[:, 0], label=label)
            title = name if forces.ndim == 2 else f"{name}, ball 1"
            _axis(axis, title, "normal force", (0.0, min(0.8, run.times[-1])))
        _legend(axes[0], 2)
    tops = _tops((("as given", run), ("a tenth", tight)), "seat_cage")
    shows = f"Normal forces with the clearances as given and with a tenth of them; highest of seat_cage: {tops}."
    return Picture(path.name, "Small clearances", shows)
