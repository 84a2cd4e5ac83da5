"""Pictures of a run: forces against time, and against penetration. Matplotlib is imported on first use.

Every function draws one PNG and gives the ``Picture`` of it, whose sentence holds the numbers that the drawing shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.io.page import Picture, brief, span
from bcfj_jax.io.plots import COLOURS, Margins, engineering, label, over_time, panels, sheet
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import Channel, quantity_of
from bcfj_jax.solve.simulation import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A contact of fewer samples is not resolved.
FEW_SAMPLES = 10
# A share of the peak force below which a contact does not carry, for what a loop shows.
_CARRIES = 0.005


class Peak(NamedTuple):
    """The highest force of a contact: size [N], time [s], the member's number from 1 (0 for a contact without), and the side: -1
    where a contact that pushes both ways bears on its negative side there, else 1.
    """

    force: float
    time: float
    member: int
    side: float = 1.0

    def __str__(self) -> str:
        return f"{brief(self.force, 'N')}{' on side -1' if self.side < 0 else ''} at {brief(self.time, 's')}"


def peaks(run: Run) -> dict[str, Peak]:
    """The highest normal force of every contact, of the solver's steps where they were looked at; NaN: nothing is known."""
    found = {}
    for name, history in run.force.items():
        values, times = np.abs(history[..., 0]).reshape(len(run.times), -1), run.times[:, None]
        if steps := run.extremes.get(name):
            values, times = (np.reshape(x, (1, -1)) for x in (steps.peak, steps.peak_time))
        known = np.where(np.isfinite(values), values, -np.inf)
        at, member = np.unravel_index(int(np.argmax(known)), known.shape)
        value, time = float(known[at, member]), np.broadcast_to(times, known.shape)[at, member]
        members = history.ndim == 3
        own = history[..., 0].reshape(len(run.times), -1)[:, member]
        side = -1.0 if -np.nanmin(own, initial=0.0) > np.nanmax(own, initial=0.0) else 1.0
        found[name] = Peak(
            value if np.isfinite(value) else math.nan, float(time), int(member) + 1 if members else 0, side
        )
    return found


def sides(normal: np.ndarray) -> str:
    """What the sign of a drawn normal force says: " (below 0: on side -1)"; "" of a contact that pushes one way."""
    return " (below 0: on side -1)" if np.nanmin(normal, initial=0.0) < 0.0 else ""


def _caption(run: Run) -> str:
    return "" if run.status == "ok" else f" (run failed at {brief(run.failure_time, 's')})"


def forces(run: Run, path: Path) -> Picture:
    """Normal force against time, one panel a contact; of members the first as a line, all as a band."""
    several = len(run.force) > 1
    with panels(len(run.force), 2, path, 6.0 if several else 7.0, 2.6 if several else 3.2, Margins()) as axes:
        for axis, (name, history) in zip(axes, run.force.items(), strict=True):
            normal = history[..., 0]
            scale, prefix = engineering(np.ravel(normal))
            times, first, members = run.times * over_time(axis, run.times), normal, ""
            if normal.ndim == 2:
                low, high = normal.min(axis=1) * scale, normal.max(axis=1) * scale
                axis.fill_between(times, low, high, color=COLOURS[0], alpha=0.22, linewidth=0)
                first, members = normal[:, 0], f" (line: {name}_1, band: all {normal.shape[1]})"
            axis.plot(times, first * scale, linewidth=1.2)
            axis.set_title(f"{name}: normal force{sides(normal)}{members}{_caption(run)}")
            axis.set_ylabel(label("force", "N", prefix))
            if not np.nanmin(normal, initial=0.0) < 0:
                axis.set_ylim(bottom=0.0)
    highest = "; ".join(f"{name} {p}" for name, p in peaks(run).items())
    return Picture(path.name, "Contact forces", f"Normal force against time. Highest: {highest}{_caption(run)}.")


def readings(run: Run, channels: Sequence[Channel], path: Path) -> Picture:
    """Each reading against time, one panel a reading, members on top of each other."""
    said = []
    with sheet(path, len(channels), margins=Margins()) as axes:
        for axis, one in zip(axes, channels, strict=True):
            values = run.readings[one.name]
            scale, prefix = engineering(np.ravel(values), one.unit)
            lines = axis.plot(run.times * over_time(axis, run.times), values * scale)
            axis.set(title=f"{one.name}{_caption(run)}", ylabel=label(*quantity_of(one.name), prefix))
            if len(lines) > 1:
                axis.legend(lines, [f"{one.part}_{k + 1}" for k in range(len(lines))], ncols=len(lines), fontsize=8)
            said.append(f"{one.name} {span(np.ravel(values), one.unit)}")
    return Picture(path.name, "Readings", f"Readings against time: {'; '.join(said)}.")


# Force against penetration.


class Loop(NamedTuple):
    """One loading cycle of a contact or member: |normal force| [N] and penetration [m] (n,) along it, the same of the whole run,
    and whether it begins and ends in the same state, so that the area is the energy it dissipates.
    """

    channel: str
    force: np.ndarray
    depth: np.ndarray
    before: np.ndarray
    deep: np.ndarray
    closed: bool


def loop(run: Run, name: str, peak: Peak, cycle: float = math.nan) -> Loop | None:
    """The loading cycle of a contact's highest force; None where the contact never carries a force.

    From apart to apart where the contact opens on both sides of its peak; else the last ``cycle`` [s] of the run; else all.
    """
    index = (slice(None), peak.member - 1) if peak.member else slice(None)
    force, depth = np.abs(run.force[name][..., 0][index]), run.penetration[name][index]
    channel = f"{name}_{peak.member}" if peak.member else name
    if not np.nanmax(force, initial=0.0) > 0.0:
        return None
    if math.isfinite(cycle) and 0.0 < cycle < run.times[-1] - run.times[0]:
        last = run.times >= run.times[-1] - cycle * (1.0 + 1e-9)
        first = int(np.argmax(last))
        # One cycle ends where it began: the sample before it closes the loop.
        return Loop(channel, force[first:], depth[first:], force, depth, True)
    top = int(np.nanargmax(force))
    idle = np.flatnonzero(~(force > _CARRIES * force[top]))
    before, after = idle[idle < top], idle[idle > top]
    # A run may begin at the very moment of touch.
    from_start = top and force[0] <= 0.05 * force[top]
    closed = bool(after.size and (before.size or from_start))
    part = slice(int(before[-1]) if before.size else 0, int(after[0]) + 1) if closed else slice(None)
    return Loop(channel, force[part], depth[part], force, depth, closed)


def loops(
    run: Run, path: Path, cycles: Mapping[str, float] | None = None, widths: Mapping[str, float] | None = None
) -> Picture:
    """Normal force against penetration over one loading cycle, one panel a contact; the area is the energy it takes.

    By contact: ``cycles``, periods of the load in steady motion [s]; ``widths`` of regularisation [m].
    """
    said, count = [], len(run.force)
    with panels(count, 3 if count > 4 else 2, path, 4.0 if count > 1 else 6.0, 3.6, Margins()) as axes:
        for axis, (name, peak) in zip(axes, peaks(run).items(), strict=True):
            one = loop(run, name, peak, (cycles or {}).get(name, math.nan))
            called = one.channel if one else name
            said.append(f"{called}: {_loop(axis, one, (widths or {}).get(name, 0.0))}")
            axis.set_title(f"{called}{_caption(run)}")
    cycle = "one loading cycle of each contact" if cycles else "from apart to apart about the highest force"
    shows = (
        f"Normal force against penetration: {cycle} in colour, arrows in the direction of time, the whole run in grey. "
        f"{'; '.join(said)}."
    )
    if any(force.ndim == 3 for force in run.force.values()):
        shows += " The penetration is that of a contact's deepest face: where two faces carry, the curve has a kink."
    return Picture(path.name, "Force against penetration", shows)


def _loop(axis: Axes, one: Loop | None, width: float) -> str:
    """Draw a loop; what it shows, in words."""
    if one is None:
        axis.text(0.5, 0.5, "no contact at any sample", transform=axis.transAxes, ha="center", va="center")
        return "no contact at any sample"
    from matplotlib.patches import Polygon

    force, depth = one.force, one.depth
    top = float(np.nanmax(force))
    bears = depth[force > _CARRIES * top]
    least, deepest = float(np.min(bears, initial=0.0)), float(np.max(bears))
    size = max(deepest, -least)
    depth_scale, depth_prefix = engineering([size])
    force_scale, force_prefix = engineering([top])
    x, y = depth * depth_scale, force * force_scale
    few = np.count_nonzero(force > _CARRIES * top) < FEW_SAMPLES
    # Flights are far longer than contacts are deep: the surface's own neighbourhood.
    near = one.deep >= least - 0.1 * size
    axis.plot(np.where(near, one.deep, np.nan) * depth_scale, one.before * force_scale, color="#b0b0b0", linewidth=0.8)
    axis.plot(x, y, marker="o" if few else "", linewidth=1.4)
    # An artist: the limits are set below, and matplotlib need not look for them.
    corners = np.column_stack([x, y])[np.isfinite(x) & np.isfinite(y)]
    axis.add_artist(Polygon(corners, color=COLOURS[0], alpha=0.2, linewidth=0))
    # A depth that does not change has a margin all the same.
    margin = 0.05 * (deepest - least or size) * depth_scale
    axis.set(
        xlim=(least * depth_scale - margin, deepest * depth_scale + margin),
        ylim=(0.0, 1.06 * max(top, float(np.nanmax(one.before))) * force_scale),
        xlabel=label("penetration", "m", depth_prefix), ylabel=label("force", "N", force_prefix),
    )  # fmt: skip
    if not few:
        _arrows(axis, x, y)
    taken = float(features.dissipated_work(force, depth))
    if few:
        text = "not resolved (too few samples)"
    elif one.closed:
        # What every second sample gives otherwise is the error of the sampling.
        every = np.unique(np.append(np.arange(0, len(force), 2), len(force) - 1))
        coarse = float(features.dissipated_work(force[every], depth[every]))
        text = _taken(taken, max(1e-5 * size * top, abs(taken - coarse)))
    else:
        text = f"work of the contact: {brief(taken, 'J')}; the cycle is not closed"
    axis.text(0.03, 0.97, text.partition(";")[0], transform=axis.transAxes, ha="left", va="top", fontsize=9)
    at_zero = _at_zero(one.before, one.deep)
    if width > 0.0 and at_zero > _CARRIES * top:
        axis.axvline(0.0, color=COLOURS[5], linewidth=0.9, linestyle=":")
        carried = f"{brief(at_zero, 'N')} at zero penetration"
        text += f", {carried} because contact begins {brief(width, 'm')} early (smoothing)"
        note = f"{carried}\n(smoothing {brief(width, 'm')})"
        axis.text(0.03, 0.87, note, transform=axis.transAxes, fontsize=8, va="top")
    return text


def _at_zero(force: np.ndarray, depth: np.ndarray) -> float:
    """Force where the surfaces just touch [N]: the largest at a crossing of zero penetration; 0 without one."""
    cross = np.flatnonzero(((depth[:-1] <= 0.0) != (depth[1:] <= 0.0)) & np.isfinite(force[:-1] + force[1:]))
    if not cross.size:
        return 0.0
    share = depth[cross] / (depth[cross] - depth[cross + 1])
    return float(np.max(force[cross] + share * (force[cross + 1] - force[cross])))


def _arrows(axis: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """The direction of time, once while the force rises and, lower, once while it falls."""
    top, low, step = int(np.nanargmax(y)), float(np.nanmin(y)), max(1, len(y) // 50)
    look = {"arrowstyle": "-|>,head_length=0.8,head_width=0.25", "color": COLOURS[1], "linewidth": 0.0}
    look |= {"shrinkA": 0, "shrinkB": 0, "mutation_scale": 14}
    for way, height in ((-1, 0.65), (1, 0.4)):
        under = np.flatnonzero(y[top::way] <= low + height * (y[top] - low))
        if under.size:
            middle = top + way * int(under[0])
            start, end = max(0, middle - step), min(len(y) - 1, middle + step)
            # A head alone: between two samples far apart a shaft would be a chord beside the curve.
            tip = x[middle] + 0.01 * (x[end] - x[start]), y[middle] + 0.01 * (y[end] - y[start])
            axis.annotate("", tip, (x[middle], y[middle]), arrowprops=look)


def _taken(work: float, noise: float) -> str:
    """The energy in words; a size below ``noise`` is the integration's error."""
    if not math.isfinite(work):
        return "dissipated work unknown, the run failed"
    if abs(work) < noise:
        return f"none dissipated (below {format_si(noise, 'J', 2).replace(' u', ' µ')})"
    if work < 0:
        return f"gives back {brief(-work, 'J')} in this cycle"
    return f"dissipated {brief(work, 'J')}"
