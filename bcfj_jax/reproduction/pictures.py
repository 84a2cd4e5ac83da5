"""Pictures in the manner of the paper's figures 8 to 14: a force history a contact, and with and without clearance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.io import plots
from bcfj_jax.io.page import Picture, brief
from bcfj_jax.reproduction.claims import claim
from bcfj_jax.reproduction.frames import FRAMES, ORDER, WINDOW_AXIAL, WINDOW_NORMAL, components, later
from bcfj_jax.reproduction.measures import resultant
from bcfj_jax.reproduction.record import Record
from bcfj_jax.solve.simulation import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILES = (
    "point_1_seat_cage.png",
    "point_2_head_cage.png",
    "point_3_cage_ball.png",
    "point_4_seat_ball.png",
    "point_5_head_ball.png",
    "no_clearance_fit.png",
    "small_clearances.png",
    "frames.png",
    "sudden_start.png",
)
# What a reader looks for first: the peaks of the paper's points 1 and 4.
LEADING = (FILES[0], FILES[3])
_PARTS = ("normal", "axial", "tangential")
_WIDE = 7.2
_THIN = 0.9


def draw(
    folder: Path, runs: dict[str, Run], tight: Run | None, observed: Record | None = None, sudden: Run | None = None
) -> list[Picture]:
    """Write every picture there are runs for.

    Args:
        folder: to write to.
        runs: by name ("as given", "calibrated"), the first of them leading.
        tight: the run with small clearances.
        observed: what is looked at from several frames.
        sudden: a sudden start, finely sampled.
    """
    written = [
        _guide(folder / FILES[0], runs, 1, "seat_cage", "Q20"),
        _guide(folder / FILES[1], runs, 2, "head_cage", "Q21"),
    ]
    for name, point, contact, claims in (
        (FILES[2], 3, "cage_ball", "Q23"), (FILES[3], 4, "seat_ball", "Q26"), (FILES[4], 5, "head_ball", "Q27"),
    ):  # fmt: skip
        written.append(_balls(folder / name, runs, point, contact, claims))
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


def _frames(path: Path, record: Record) -> Picture:
    """The radial force of point 1 as each observer reads it."""
    with plots.style():
        drawing, axes = plots.figure(len(FRAMES), width=_WIDE, height=1.5)
        for axis, frame in zip(axes, FRAMES, strict=True):
            axis.plot(record.run.times, components(record, "seat_cage", frame)[:, 0] / 1e3, linewidth=_THIN)
            _axis(axis, record.run, FRAMES[frame], "x")
            axis.set_xlim(*_later(record.run))
        plots.save(drawing, path, 32)
    shows = (
        "The same force of the cage on the seat, as given, in the axes of six observers: sixfold a turn in the contact's own "
        "and in fixed axes, once a turn in axes that turn with a part."
    )
    return Picture(path.name, "Point 1 as different observers read it", shows)


def _later(run: Run) -> tuple[float, float]:
    """Two turns at most of the settled joint."""
    low, high = later(run.times)
    return low, min(high, low + 1.2)


def _sudden(path: Path, run: Run) -> Picture:
    """The first milliseconds of the sudden start."""
    panels = (
        ("seat_cage", ("Q20",)), ("head_cage", ("Q21",)), ("cage_ball", ("Q23",)), ("seat_ball", ("Q26",)),
        ("head_ball", ("Q27",)),
    )  # fmt: skip
    with plots.style():
        drawing, axes = plots.figure(len(panels), width=_WIDE, height=1.7)
        for axis, (contact, ids) in zip(axes, panels, strict=True):
            force = run.force[contact]
            values = force[..., 0] if contact in ("cage_ball", "seat_cage", "head_cage") else resultant(force)
            for member in values.reshape(len(run.times), -1).T:
                axis.plot(1e3 * run.times, member / 1e3, linewidth=_THIN)
            axis.set_title(f"{contact}, sudden start")
            axis.set_xlabel("time [ms]")
            axis.set_ylabel("force [kN]")
            axis.set_xlim(0.0, 1.5)
            for id in ids:
                _paper(axis, id)
        plots.save(drawing, path, 64)
    shows = (
        "Forces of the first 1.5 ms after the torque is stepped on, read every microsecond; dashed: the paper's peaks."
    )
    return Picture(path.name, "Sudden start", shows)


def _axis(axis: Axes, run: Run, title: str, what: str) -> None:
    axis.set_title(title)
    axis.set_xlabel("time [s]")
    axis.set_ylabel(f"{what} [kN]")
    axis.set_xlim(run.times[0], run.times[-1])


def _paper(axis: Axes, id: str) -> None:
    """The paper's peaks as dashed lines."""
    row = claim(id)
    for number, value in enumerate(row.values):
        name = f"paper, {id}: {row.printed}" if number == 0 else None
        axis.axhline(value / 1e3, label=name, color="#222222", linewidth=1.0, linestyle="--")


def _printed(id: str) -> str:
    """What the paper printed, in words."""
    return f"paper, {id}: {claim(id).printed}"


def _legend(axis: Axes, columns: int) -> None:
    axis.legend(ncols=columns, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2))


def _guide(path: Path, runs: dict[str, Run], point: int, contact: str, id: str) -> Picture:
    """Three components of a sphere in a sphere, the runs on top of each other."""
    with plots.style():
        drawing, axes = plots.figure(3, width=_WIDE, height=1.9)
        for part, axis in enumerate(axes):
            for name, run in runs.items():
                axis.plot(run.times, run.force[contact][:, part] / 1e3, label=name, linewidth=_THIN)
                _axis(axis, run, f"Point {point}, {contact}: {_PARTS[part]}", "force")
            if part == 0:
                _paper(axis, id)
        axes[0].legend(ncols=len(runs) + 1, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.98))
        plots.save(drawing, path, 64)
    tops = ", ".join(f"{name} {brief(float(np.max(run.force[contact][:, 0])), 'N')}" for name, run in runs.items())
    shows = (
        f"Normal, axial and tangential force of {contact} against time; highest normal force: {tops}; {_printed(id)}."
    )
    return Picture(path.name, f"Point {point}: {contact}", shows)


def _balls(path: Path, runs: dict[str, Run], point: int, contact: str, id: str) -> Picture:
    """Six balls on top of each other, a panel a run."""
    what = "normal force" if contact == "cage_ball" else "resultant"
    with plots.style():
        drawing, axes = plots.figure(len(runs), width=_WIDE, height=3.1)
        for (name, run), axis in zip(runs.items(), axes, strict=True):
            force = run.force[contact]
            values = force[..., 0] if contact == "cage_ball" else resultant(force)
            for ball in range(values.shape[1]):
                axis.plot(run.times, values[:, ball] / 1e3, label=f"ball {ball + 1}", linewidth=_THIN)
            _axis(axis, run, f"Point {point}, {contact}, {name}", what)
            _paper(axis, id)
            low = claim(id).values[0]
            axis.set_ylim(bottom=1.12 * low / 1e3 if low < 0 else 0.0)
            # Six lines on top of each other: what comes later repeats itself.
            axis.set_xlim(0.0, min(1.2, run.times[-1]))
        _legend(axes[-1], 7)
        plots.save(drawing, path, 64)
    tops = ", ".join(
        f"{name} {brief(float(np.max(np.abs(run.force[contact][..., 0]))), 'N')}" for name, run in runs.items()
    )
    shows = f"The {what} of each ball in {contact} against time; highest normal force: {tops}; {_printed(id)}."
    return Picture(path.name, f"Point {point}: {contact}", shows)


def _smooth(path: Path, run: Run) -> Picture:
    """Force of the cage on the seat, the polynomial "without clearance" over the paper's windows, and what is left."""
    with plots.style():
        drawing, axes = plots.figure(4, width=_WIDE, height=2.3)
        for row, (part, window) in enumerate(((0, WINDOW_NORMAL), (1, WINDOW_AXIAL))):
            force = run.force["seat_cage"][:, part]
            fit = features.no_clearance_fit(run.times, force, window, ORDER)
            at = features.within(run.times, window)
            above, below = axes[2 * row], axes[2 * row + 1]
            above.plot(run.times[at], force[at] / 1e3, label="model, with clearance", linewidth=_THIN)
            above.plot(fit.times, np.asarray(fit.fitted) / 1e3, label=f"polynomial of order {ORDER}")
            _axis(above, run, f"Point 1, seat_cage: {_PARTS[part]}, as given", "force")
            below.plot(fit.times, np.asarray(fit.residual) / 1e3, color=plots.COLOURS[3], linewidth=_THIN)
            _axis(below, run, "what the polynomial leaves over", "force")
            for axis in (above, below):
                axis.set_xlim(*window)
            above.legend(ncols=2, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.98))
        plots.save(drawing, path, 64)
    shows = (
        f"Force of the cage on the seat in the paper's windows, a polynomial of order {ORDER}, and what it leaves over."
    )
    return Picture(path.name, "With and without clearance", shows)


def _tight(path: Path, run: Run, tight: Run) -> Picture:
    """One turn with the clearances as given and with small ones, normal forces; ball 1 where there are six."""
    with plots.style():
        drawing, axes = plots.figure(len(run.force), width=_WIDE, height=2.2)
        for axis, name in zip(axes, run.force, strict=True):
            for label, which in (("clearances as given", run), ("a tenth of them", tight)):
                force = which.force[name][..., 0]
                axis.plot(which.times, (force if force.ndim == 1 else force[:, 0]) / 1e3, label=label, linewidth=_THIN)
            _axis(axis, run, name if run.force[name].ndim == 2 else f"{name}, ball 1", "normal force")
            axis.set_xlim(0.0, min(0.8, run.times[-1]))
        axes[0].legend(ncols=2, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.98))
        plots.save(drawing, path, 64)
    tops = [
        f"{name} {brief(float(np.max(np.abs(r.force['seat_cage'][:, 0]))), 'N')}"
        for name, r in (("as given", run), ("a tenth", tight))
    ]
    shows = (
        f"Normal forces with the clearances as given and with a tenth of them; highest of seat_cage: {', '.join(tops)}."
    )
    return Picture(path.name, "Small clearances", shows)
