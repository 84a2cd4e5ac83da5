"""What else a run can show, by what its model has: members around an axis, clearance circles, states, orders.

As in ``pictures`` every function draws one PNG and gives its ``Picture``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.quantities import percent
from bcfj_jax.io.outputs import channels
from bcfj_jax.io.page import Picture, brief, span
from bcfj_jax.io.plots import COLOURS, Margins, engineering, label, over_time, panels, sheet
from bcfj_jax.mechanism.model import Chain, Orbit
from bcfj_jax.mechanism.readings import STATES
from bcfj_jax.solve.simulation import Run

# Shades of ``STATES``: they differ in lightness, too.
_SHADES = ("#ffffff", "#e3c36a", "#4f9bc9", "#7d2c00", "#bfe3d0")
# ``STATES`` by how much they are to be seen, where a column shows one of several: sliding before creeping before stuck.
_RANKED = np.array([0, 1, 4, 2, 3])
_COLUMNS, _RANGE = 1200, 1e-4


class Turning(NamedTuple):
    """A drive that turns: time of one turn, and of the pitch in which members pass, both [s]."""

    turn: float
    pitch: float

    @property
    def passes(self) -> float:
        """Passages of members in a turn."""
        return self.turn / self.pitch


def last_turn(run: Run, turning: Turning | None) -> np.ndarray:
    """Which samples (T,) belong to the last whole turn; all of a run that is shorter, or where nothing turns."""
    if turning is None:
        return np.ones(len(run.times), bool)
    return run.times >= run.times[-1] - turning.turn * (1.0 + 1e-9)


def around(run: Run, path: Path, turning: Turning | None) -> Picture:
    """Loads of the members about their axis, one panel a contact: the last turn, the peaks, and one instant."""
    with_members = {name: np.abs(force[..., 0]) for name, force in run.force.items() if force.ndim == 3}
    part = last_turn(run, turning)
    times, said = run.times[part], []
    with panels(len(with_members), 3, path, 3.4, 3.7, Margins(0.1, 0.1, 0.45, 0.35)) as axes:
        for axis, (name, size) in zip(axes, with_members.items(), strict=True):
            count, late = size.shape[1], size[part]
            top = float(np.nanmax(size, initial=0.0)) or 1.0
            scale, prefix = engineering([top])
            start = 2.0 * np.pi * np.arange(count) / count
            _spokes(axis, start, top * scale, f"{prefix}N")
            angle = start + (2.0 * np.pi * times[:, None] / turning.turn if turning else np.zeros((times.size, 1)))
            if turning:
                line = _polar(angle[:, 0], late[:, 0] * scale)
                axis.plot(*line, color=COLOURS[0], linewidth=1.4, label="one member, one turn")
            highest = late.max(axis=0)
            where = angle[late.argmax(axis=0), np.arange(count)]
            axis.plot(*_polar(where, highest * scale), "o", color=COLOURS[1], markersize=5, label="peak of each")
            k = int(np.argmax(late.max(axis=1)))
            x, y = _polar(angle[k], late[k] * scale)
            axis.plot(np.append(x, x[0]), np.append(y, y[0]), "s-", color=COLOURS[2], markersize=3.5, linewidth=0.9,
                      label=f"all at {brief(float(times[k]), 's')}")  # fmt: skip
            axis.set_title(name)
            axis.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, 0.03), ncols=3, columnspacing=0.8,
                        handlelength=1.2)  # fmt: skip
            carrying = int(np.count_nonzero(late[k] > 0.05 * late[k].max()))
            carried = f"{carrying} of {count} members carry more than a twentieth of it"
            said.append(f"{name}: at most {brief(float(highest.max()), 'N')}, when {carried}")
    when = "over the last turn" if turning else "over the run"
    shows = f"Normal force of the members {when}, by angle. {'; '.join(said)}."
    return Picture(path.name, "Loads around the axis", shows)


def _polar(angle: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return radius * np.cos(angle), radius * np.sin(angle)


def _spokes(axis, start: np.ndarray, top: float, unit: str) -> None:
    """Circles at round forces and a spoke for each member, on plain axes: polar ones take several times as long."""
    from matplotlib.collections import LineCollection

    step = _round(top / 3.0)
    turn = np.linspace(0.0, 2.0 * np.pi, 91)
    radii = np.arange(step, 1.02 * top + step, step)
    radii = radii[radii <= 1.27 * top]
    rings = [np.column_stack(_polar(turn, np.full(91, r))) for r in radii]
    spokes = [np.array([[0.0, 0.0], [1.08 * top * math.cos(a), 1.08 * top * math.sin(a)]]) for a in start]
    axis.add_collection(LineCollection([*rings, *spokes], colors="#cfcfcf", linewidths=0.7, zorder=0), autolim=False)
    for k, a in enumerate(start):
        axis.text(1.17 * top * math.cos(a), 1.17 * top * math.sin(a), str(k + 1), ha="center", va="center", fontsize=8)
    for r in radii[radii <= 1.02 * top]:
        place = _polar(np.asarray(np.pi / len(start)), np.asarray(r))
        axis.text(*place, f"{r:g}", fontsize=7, color="#4d4d4d", ha="center", va="center")
    axis.text(0.01, 0.99, f"[{unit}]".replace("u", "µ"), transform=axis.transAxes, fontsize=8, va="top")
    axis.set(xlim=(-1.28 * top, 1.28 * top), ylim=(-1.28 * top, 1.28 * top), aspect="equal")
    axis.set_axis_off()
    axis.title.set_visible(True)


def _round(value: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten from above."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value * (1.0 - 1e-9))


def orbits(run: Run, found: Mapping[str, Orbit], path: Path, turning: Turning | None) -> Picture:
    """The path of each inner centre in its clearance circle, one panel a contact; the last turn on top."""
    said, part = [], last_turn(run, turning)
    with panels(len(found), 3, path, 4.3, 4.6, Margins(0.75, 0.2, 0.85, 0.4)) as axes:
        for axis, (name, orbit) in zip(axes, found.items(), strict=True):
            size = np.hypot(orbit.x, orbit.y)
            reach = max(float(np.nanmax(size, initial=0.0)), orbit.clearance) or 1.0
            scale, prefix = engineering([reach])
            turn = np.linspace(0.0, 2.0 * np.pi, 181)
            circle = _polar(turn, np.full(181, orbit.clearance * scale))
            axis.fill(*circle, color="#e6edf3", zorder=0)
            axis.plot(*circle, color=COLOURS[5], linewidth=1.0, label=f"clearance, {brief(orbit.clearance, 'm')}")
            axis.plot(orbit.x * scale, orbit.y * scale, color=COLOURS[0], linewidth=0.7, alpha=0.55, label="whole run")
            if not part.all():
                last = (orbit.x[part] * scale, orbit.y[part] * scale)
                axis.plot(*last, color=COLOURS[1], linewidth=1.5, label="last turn")
            axis.plot(orbit.x[:1] * scale, orbit.y[:1] * scale, "o", color=COLOURS[5], markersize=4, label="start")
            names = dict(zip(("xlabel", "ylabel"), (label(one, "m", prefix) for one in orbit.axes), strict=True))
            edge = (-1.12 * reach * scale, 1.12 * reach * scale)
            axis.set(title=f"{name}: {orbit.what}", xlim=edge, ylim=edge, aspect="equal", **names)
            if axis is axes[0]:
                axis.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=4, borderpad=0.0)
            most, clearance = float(np.nanmax(size, initial=0.0)), brief(orbit.clearance, "m")
            past = f", {brief(most - orbit.clearance, 'm')} past the circle" if most > orbit.clearance else ""
            along = "" if orbit.along is None else brief(float(np.nanmax(np.abs(orbit.along))), "m")
            aside = f" (and {along} along the axis)" if along else ""
            said.append(f"{orbit.what}: at most {brief(most, 'm')} from the middle{aside}, clearance {clearance}{past}")
    shows = f"Path of the inner body's centre in its clearance circle. {'; '.join(said)}."
    return Picture(path.name, "Path in the clearance circle", shows)


def chain(found: Chain, path: Path) -> Picture:
    """The row of links in its place with the forces on it, and beside it what each link bears."""
    from matplotlib.ticker import MaxNLocator

    said, each = [], np.arange(1, len(found.pushes) + 1)
    with panels(1 + len(found.loads), 2, path, 4.3, 3.6) as (place, *axes):
        x, y = found.corners.T
        for wall in found.walls:
            place.plot(*wall.T, "-", color=COLOURS[5], linewidth=0.8)
        place.plot(x, y, "-", color=COLOURS[5], linewidth=2.0)
        place.plot(x[1:-1], y[1:-1], "o", color=COLOURS[0], markersize=4)
        most = float(np.hypot(*found.pushes.T).max(initial=0.0))
        if most > 0.0:
            reach = 0.25 * max(np.ptp(x), np.ptp(y)) / most
            arrows = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "color": COLOURS[1], "width": 5e-3}
            place.quiver(x[1:-1], y[1:-1], *(reach * found.pushes.T), **arrows)
        place.set(title=f"{found.pushed}, at most {brief(most, 'N')}", xlabel="x [m]", ylabel="z [m]", aspect="equal")
        place.margins(0.25)
        for axis, (name, (unit, values)) in zip(axes, found.loads.items(), strict=True):
            scale, prefix = engineering(values, unit)
            axis.plot(each, values * scale, "o-", color=COLOURS[0], markersize=4)
            axis.set(title=name, xlabel=f"{found.link}, from the drive", ylabel=label(name, unit, prefix))
            axis.ticklabel_format(useOffset=False)
            # From 0, so that what hardly changes along the row is seen as such.
            axis.set_ylim(min(0.0, 1.1 * values.min() * scale), max(0.0, 1.1 * values.max() * scale) or None)
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
            highest = int(np.argmax(np.abs(values)))
            said.append(f"{name} {span(values, unit)}, highest at {found.link} {highest + 1}")
    return Picture(path.name, f"Loads by {found.link}", f"From the drive on. {'; '.join(said)}.")


def states(run: Run, path: Path, turning: Turning | None) -> Picture:
    """Apart, touching, stuck, creeping or sliding, a row a contact and member, against time; the last turn where one turns."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    rows = channels(run.state)
    part = last_turn(run, turning)
    codes = np.stack([state[part] for state in rows.values()])
    times = run.times[part]
    # A picture has fewer columns than a run has samples: the most telling state of each, so that no contact is lost.
    each = -(-codes.shape[1] // _COLUMNS)
    padded = np.pad(codes, ((0, 0), (0, -codes.shape[1] % each)), mode="edge")
    ranks = np.where(padded >= 0, np.argsort(_RANKED)[padded], -1).reshape(len(rows), -1, each).max(axis=2)
    shown = np.where(ranks >= 0, _RANKED[ranks], -1)
    kinds = sorted({int(code) for code in np.unique(codes) if code >= 0})
    height, margins = 0.9 + 0.17 * max(len(rows), 4), Margins(left=1.15, above=0.4)
    with sheet(path, height=height, margins=margins) as (axis,):
        scale = over_time(axis, times)
        ends = (times[0] * scale, times[-1] * scale, len(rows) - 0.5, -0.5)
        look: dict[str, Any] = {"cmap": ListedColormap(_SHADES), "vmin": -0.5, "vmax": len(STATES) - 0.5}
        axis.imshow(np.ma.masked_less(shown, 0), aspect="auto", extent=ends, interpolation="nearest", **look)
        axis.set_yticks(range(len(rows)), list(rows), fontsize=7)
        axis.grid(False)
        edge = {"edgecolor": "#4a4a4a", "linewidth": 0.5}
        patches = [Patch(facecolor=_SHADES[code], label=STATES[code], **edge) for code in kinds]
        axis.legend(handles=patches, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, fontsize=8, borderpad=0.2)
    said = []
    for name, state in run.state.items():
        now = state[part]
        known = now >= 0
        total = max(int(np.count_nonzero(known)), 1)
        shares = [(STATES[c], np.count_nonzero(now[known] == c) / total) for c in kinds]
        said.append(f"{name} {', '.join(f'{word} {percent(share, 2)}' for word, share in shares if share > 0)}")
    when = "over the run" if part.all() else "over the last turn"
    shows = f"State of each contact {when}, shares of the samples: {'; '.join(said)}."
    return Picture(path.name, "State of each contact", shows)


def orders(run: Run, path: Path, turning: Turning) -> Picture | None:
    """Amplitudes of the normal forces by order of the shaft, of the last whole turns, with passages of members; None for a run of
    less than a turn after its first third.
    """
    end, turns = run.times[-1], math.floor(2.0 / 3.0 * (run.times[-1] - run.times[0]) / turning.turn + 1e-9)
    if turns < 1:
        return None
    whole, several = turns * turning.turn, turning.passes > 1.5
    count = max(256, 2 * int(np.count_nonzero(run.times >= end - whole) // 2))
    even = end - whole + whole * np.arange(count) / count
    most = min(4.0 * turning.passes + 2.0 if several else 20.0, count / 2 / turns)
    highest, said = 0.0, []
    with sheet(path, height=3.4, margins=Margins(above=0.55)) as (axis,):
        scale, prefix = engineering([float(np.nanmax(np.abs(force[..., 0]))) for force in run.force.values()])
        for number, (name, history) in enumerate(run.force.items()):
            members = history.ndim == 3
            channel, normal = (f"{name}_1", history[:, 0, 0]) if members else (name, history[:, 0])
            amplitude = 2.0 * np.abs(np.fft.rfft(np.interp(even, run.times, normal)))[1:] / count * scale
            step = np.arange(1, amplitude.size + 1)
            order = step / turns
            near, colour = order <= most, COLOURS[number % len(COLOURS)]
            # Whole orders only: what lies between them has no place in a motion that repeats itself each turn.
            shown = np.flatnonzero(near & (step % turns == 0))
            place = order[shown] + 0.13 * (number - 0.5 * (len(run.force) - 1))
            axis.vlines(place, 1e-300, amplitude[shown], color=colour, linewidth=1.0)
            axis.plot(place, amplitude[shown], "o", color=colour, markersize=2.8, label=channel)
            strongest = int(np.argmax(amplitude[near]))
            top = float(amplitude[strongest])
            highest = max(highest, top)
            said.append(f"{channel} {brief(top / scale, 'N')} at order {order[strongest]:.3g}")
        for k in range(1, int(most / turning.passes) + 1) if several else ():
            axis.axvline(k * turning.passes, color=COLOURS[5], linewidth=0.8, linestyle=":")
            above = {"transform": axis.get_xaxis_transform(), "fontsize": 7.5, "ha": "center"}
            axis.text(k * turning.passes, 1.01, f"{k} x pass", **above)
        axis.set(
            yscale="log", ylim=(max(_RANGE * highest, 1e-300), 2.0 * highest or 1.0), xlim=(0.0, most),
            xlabel="order of the shaft [1/turn]", ylabel=label("amplitude", "N", prefix),
        )  # fmt: skip
        # By default powers of ten are formulas, which take some 10 ms each.
        axis.yaxis.set_major_formatter("{x:g}")
        axis.legend(fontsize=8, ncols=min(len(said), 5), loc="lower left", bbox_to_anchor=(0.0, 1.05), borderpad=0.0)
    passing = f"members pass at orders {turning.passes:g}, {2 * turning.passes:g} and so on; " if several else ""
    shows = f"Amplitude of the normal force by order of the shaft, over the last {turns} turns; {passing}strongest: "
    return Picture(path.name, "Order spectrum", f"{shows}{'; '.join(said)}.")
