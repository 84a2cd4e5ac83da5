"""What else a run can show, by what its model has: members around an axis, clearance circles, states, orders.

Members give a polar plot of their loads, ``AbstractModel.orbits`` the path of a centre in its clearance circle, states of
several contacts or of friction a raster, and a drive that turns an order spectrum. As in ``pictures`` every function draws
one PNG and gives its ``Picture``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcfj_jax.io.outputs import channels
from bcfj_jax.io.page import Picture, brief, percent
from bcfj_jax.io.plots import COLOURS, Margins, engineering, figure, label, panels, save, style
from bcfj_jax.mechanism.model import Orbit
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


def last_turn(run: Run, turning: Turning) -> np.ndarray:
    """Which samples (T,) belong to the last whole turn; all of a run that is shorter."""
    return run.times >= run.times[-1] - turning.turn * (1.0 + 1e-9)


def around(run: Run, path: Path, turning: Turning | None) -> Picture:
    """Loads of the members about their axis, one panel a contact: the last turn, the peaks, and one instant."""
    with_members = {name: force[..., 0] for name, force in run.force.items() if force.ndim == 3}
    said = []
    with panels(len(with_members), 3, path, 3.4, 3.7, Margins(0.1, 0.1, 0.45, 0.35)) as axes:
        for axis, (name, force) in zip(axes, with_members.items(), strict=True):
            count = force.shape[1]
            size = np.abs(force)
            top = float(np.nanmax(size, initial=0.0)) or 1.0
            scale, prefix = engineering([top])
            start = 2.0 * np.pi * np.arange(count) / count
            _spokes(axis, start, top * scale, f"{prefix}N")
            part = last_turn(run, turning) if turning else np.ones(len(run.times), bool)
            late, times = size[part], run.times[part]
            if turning:
                angle = start + 2.0 * np.pi * times[:, None] / turning.turn
                axis.plot(
                    *_polar(angle[:, 0], late[:, 0] * scale),
                    color=COLOURS[0],
                    linewidth=1.4,
                    label="one member, one turn",
                )
            else:
                angle = np.broadcast_to(start, late.shape)
            highest = late.max(axis=0)
            at = late.argmax(axis=0)
            where = angle[at, np.arange(count)]
            axis.plot(*_polar(where, highest * scale), "o", color=COLOURS[1], markersize=5, label="peak of each")
            k = int(np.argmax(late.max(axis=1)))
            x, y = _polar(angle[k], late[k] * scale)
            axis.plot(np.append(x, x[0]), np.append(y, y[0]), "s-", color=COLOURS[2], markersize=3.5, linewidth=0.9,
                      label=f"all at {brief(float(times[k]), 's')}")  # fmt: skip
            axis.set_title(name)
            axis.legend(
                fontsize=7.5,
                loc="upper center",
                bbox_to_anchor=(0.5, 0.03),
                ncols=3,
                columnspacing=0.8,
                handlelength=1.2,
            )
            carrying = int(np.count_nonzero(late[k] > 0.05 * late[k].max()))
            said.append(
                f"{name}: at most {brief(float(highest.max()), 'N')}, when {carrying} of {count} members carry more than "
                f"a twentieth of it"
            )
    when = "over the last turn" if turning else "over the run"
    return Picture(
        path.name, "Loads around the axis", f"Normal force of the members {when}, by angle. {'; '.join(said)}."
    )


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
        axis.text(
            *_polar(np.asarray(np.pi / len(start)), np.asarray(r)),
            f"{r:g}",
            fontsize=7,
            color="#4d4d4d",
            ha="center",
            va="center",
        )
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
    said = []
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
            part = last_turn(run, turning) if turning else np.zeros(len(run.times), bool)
            if part.any() and not part.all():
                axis.plot(
                    orbit.x[part] * scale, orbit.y[part] * scale, color=COLOURS[1], linewidth=1.5, label="last turn"
                )
            axis.plot(orbit.x[:1] * scale, orbit.y[:1] * scale, "o", color=COLOURS[5], markersize=4, label="start")
            axis.set_title(f"{name}: {orbit.what}")
            most = 1.12 * reach * scale
            axis.set(xlim=(-most, most), ylim=(-most, most), aspect="equal")
            axis.set_xlabel(label(orbit.axes[0], "m", prefix))
            axis.set_ylabel(label(orbit.axes[1], "m", prefix))
            if axis is axes[0]:
                axis.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=4, borderpad=0.0)
            most = float(np.nanmax(size, initial=0.0))
            past = f", {brief(most - orbit.clearance, 'm')} past the circle" if most > orbit.clearance else ""
            aside = (
                f" (and {brief(float(np.nanmax(np.abs(orbit.along))), 'm')} along the axis)"
                if orbit.along is not None
                else ""
            )
            said.append(
                f"{orbit.what}: at most {brief(most, 'm')} from the middle{aside}, clearance {brief(orbit.clearance, 'm')}{past}"
            )
    shows = f"Path of the inner body's centre in its clearance circle. {'; '.join(said)}."
    return Picture(path.name, "Path in the clearance circle", shows)


def states(run: Run, path: Path, turning: Turning | None) -> Picture:
    """Apart, touching, stuck, creeping or sliding, a row a contact and member, against time; the last turn where one turns."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    rows = channels(run.state)
    part = last_turn(run, turning) if turning else np.ones(len(run.times), bool)
    codes = np.stack([state[part] for state in rows.values()])
    times = run.times[part]
    # A picture has fewer columns than a run has samples: the most telling state of each, so that no contact is lost.
    each = -(-codes.shape[1] // _COLUMNS)
    padded = np.pad(codes, ((0, 0), (0, -codes.shape[1] % each)), mode="edge")
    ranks = np.where(padded >= 0, np.argsort(_RANKED)[padded], -1).reshape(len(rows), -1, each).max(axis=2)
    shown = np.where(ranks >= 0, _RANKED[ranks], -1)
    scale, prefix = engineering(times)
    kinds = sorted({int(code) for code in np.unique(codes) if code >= 0})
    with style():
        drawing, (axis,) = figure(1, height=0.9 + 0.17 * max(len(rows), 4), margins=Margins(left=1.15, above=0.4))
        ends = (times[0] * scale, times[-1] * scale, len(rows) - 0.5, -0.5)
        field = np.ma.masked_less(shown, 0)
        axis.imshow(
            field,
            aspect="auto",
            extent=ends,
            cmap=ListedColormap(_SHADES),
            vmin=-0.5,
            vmax=len(STATES) - 0.5,
            interpolation="nearest",
        )
        axis.set_yticks(range(len(rows)), list(rows), fontsize=7)
        axis.grid(False)
        axis.set_xlabel(label("time", "s", prefix))
        patches = [
            Patch(facecolor=_SHADES[code], edgecolor="#4a4a4a", linewidth=0.5, label=STATES[code]) for code in kinds
        ]
        axis.legend(handles=patches, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, fontsize=8, borderpad=0.2)
        save(drawing, path)
    said = []
    for name, state in run.state.items():
        now = state[part]
        known = now >= 0
        total = max(int(np.count_nonzero(known)), 1)
        shares = [(STATES[c], np.count_nonzero(now[known] == c) / total) for c in kinds]
        said.append(f"{name} {', '.join(f'{word} {percent(share, 2)}' for word, share in shares if share > 0)}")
    when = "over the last turn" if turning and not part.all() else "over the run"
    return Picture(
        path.name, "State of each contact", f"State of each contact {when}, shares of the samples: {'; '.join(said)}."
    )


def orders(run: Run, path: Path, turning: Turning) -> Picture | None:
    """Amplitudes of the normal forces by order of the shaft, of the last whole turns; passages of members are marked.

    None for a run of less than a turn after its first third.
    """
    span = run.times[-1] - run.times[0]
    turns = math.floor(2.0 / 3.0 * span / turning.turn + 1e-9)
    if turns < 1:
        return None
    count = max(256, 2 * int(np.count_nonzero(run.times >= run.times[-1] - turns * turning.turn) // 2))
    even = run.times[-1] - turns * turning.turn + turns * turning.turn * np.arange(count) / count
    most = min(4.0 * turning.passes + 2.0 if turning.passes > 1.5 else 20.0, count / 2 / turns)
    said, passes = [], turning.passes > 1.5
    with style():
        drawing, (axis,) = figure(1, height=3.4, margins=Margins(above=0.55))
        highest, force_scale, prefix = (
            0.0,
            *engineering([p for f in run.force.values() for p in [float(np.nanmax(np.abs(f[..., 0])))]]),
        )
        for number, (name, history) in enumerate(run.force.items()):
            normal = history[:, 0, 0] if history.ndim == 3 else history[:, 0]
            wave = np.interp(even, run.times, normal)
            amplitude = 2.0 * np.abs(np.fft.rfft(wave))[1:] / count * force_scale
            order = np.arange(1, amplitude.size + 1) / turns
            near = order <= most
            channel = f"{name}_1" if history.ndim == 3 else name
            colour = COLOURS[number % len(COLOURS)]
            # Whole orders only: what lies between them has no place in a motion that repeats itself each turn.
            whole = np.flatnonzero(near & (np.arange(1, amplitude.size + 1) % turns == 0))
            place = order[whole] + 0.13 * (number - 0.5 * (len(run.force) - 1))
            axis.vlines(place, 1e-300, amplitude[whole], color=colour, linewidth=1.0)
            axis.plot(place, amplitude[whole], "o", color=colour, markersize=2.8, label=channel)
            strongest = int(np.argmax(amplitude[near]))
            highest = max(highest, float(amplitude[strongest]))
            said.append(
                f"{channel} {brief(float(amplitude[strongest] / force_scale), 'N')} at order {order[strongest]:.3g}"
            )
        for k in range(1, int(most / turning.passes) + 1) if turning.passes > 1.5 else ():
            axis.axvline(k * turning.passes, color=COLOURS[5], linewidth=0.8, linestyle=":")
            axis.text(
                k * turning.passes, 1.01, f"{k} x pass", transform=axis.get_xaxis_transform(), fontsize=7.5, ha="center"
            )
        axis.set_yscale("log")
        axis.set_ylim(max(_RANGE * highest, 1e-300), 2.0 * highest or 1.0)
        axis.set_xlim(0.0, most)
        axis.set_xlabel("order of the shaft [1/turn]")
        axis.set_ylabel(label("amplitude", "N", prefix))
        axis.legend(fontsize=8, ncols=min(len(said), 5), loc="lower left", bbox_to_anchor=(0.0, 1.05), borderpad=0.0)
        save(drawing, path)
    passing = f"members pass at orders {turning.passes:g}, {2 * turning.passes:g} and so on; " if passes else ""
    shows = f"Amplitude of the normal force by order of the shaft, over the last {turns} turns; {passing}strongest: "
    return Picture(path.name, "Order spectrum", f"{shows}{'; '.join(said)}.")
