"""A picture of what was understood of the data: samples kept and left out, gaps, first contact and window."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.io.page import Picture, counted
from bcfj_jax.io.plots import COLOURS, Margins, engineering, label, panels, plain
from bcfj_jax.mechanism.channels import quantity_of
from calibration.forward.runs import stretches
from calibration.impacts.inspection import TOUCHING
from calibration.impacts.preparation import Prepared

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def data(records: list[Prepared], path: Path) -> Picture | None:
    """Every channel of every record on a panel of its own; no picture of none."""
    shown = [(record, observes) for record in records for observes in record.readings]
    if not shown:
        return None
    with panels(len(shown), 2, path, 6.3, 2.8, Margins()) as axes:
        for axis, (record, observes) in zip(axes, shown, strict=True):
            _panel(axis, record, observes)
    kept = sum(int(np.isfinite(record.readings[observes].values).sum()) for record, observes in shown)
    shows = f"{counted(len(shown), 'channel')}, as read: {kept} samples kept, with what was left out, gaps and windows."
    return Picture(path.name, "The data as they were understood", shows)


def reading_label(observes: str, prefix: str) -> str:
    """Text for the axis of a reading, in its unit."""
    name, unit = quantity_of(observes)
    return label("force" if unit == "N" else name, unit, prefix)


def _panel(axis: Axes, record: Prepared, observes: str) -> None:
    reading = record.readings[observes]
    time_scale, time_prefix = engineering(record.clock)
    scale, prefix = engineering(reading.raw)
    clock, raw = record.clock * time_scale, reading.raw * scale
    kept = np.isfinite(reading.values)
    out = np.isfinite(reading.raw) & ~np.isin(record.clock, record.times[kept]) & ~reading.masked
    resampled = not np.isin(record.times, record.clock).all()
    if resampled:
        axis.plot(clock[~reading.masked], raw[~reading.masked], ".", ms=2, color="#b8b8b8", label="as read")
    elif out.any():
        axis.plot(clock[out], raw[out], ".", ms=3, color="#b8b8b8", label=f"left out ({int(out.sum())})")
    name = f"kept ({int(kept.sum())})"
    axis.plot(record.times[kept] * time_scale, reading.values[kept] * scale, ".", ms=4, color=COLOURS[0], label=name)
    if reading.masked.any():
        name = f"saturated ({int(reading.masked.sum())})"
        axis.plot(clock[reading.masked], raw[reading.masked], "x", ms=4, color=COLOURS[1], label=name)
    for number, (first, last) in enumerate(_gaps(record, observes)):
        # A label that begins with "_" is not in the legend.
        name = "nothing measured" if number == 0 else "_"
        axis.axvspan(first * time_scale, last * time_scale, color=COLOURS[4], alpha=0.25, lw=0, label=name)
    if record.first_contact is not None:
        axis.axvline(
            0.0, color=COLOURS[2], lw=1, ls="--", label=f"first contact ({TOUCHING:.0%} of the peak) is time 0"
        )
    if record.window is not None:
        for edge in record.window:
            axis.axvline(edge * time_scale, color=COLOURS[3], lw=1, ls=":")
        axis.plot([], [], color=COLOURS[3], lw=1, ls=":", label="window")
        first, last = record.window
        around = 0.5 * (last - first)
        axis.set_xlim(
            max(first - around, record.clock[0]) * time_scale, min(last + around, record.clock[-1]) * time_scale
        )
    axis.set_title(f"{plain(record.name)}: {observes}")
    axis.set_xlabel(label("time", "s", time_prefix))
    axis.set_ylabel(reading_label(observes, prefix))
    axis.legend(loc="best", fontsize=8, frameon=True, edgecolor="none", framealpha=0.8)


def _gaps(record: Prepared, observes: str) -> list[tuple[float, float]]:
    """Where the clock jumps, and stretches of rows without a number, between their neighbours."""
    blank = np.isnan(record.readings[observes].raw)
    last = record.clock.size - 1
    blanks = [(max(a - 1, 0), min(b, last)) for a, b in stretches(blank)]
    return [*record.gaps, *((float(record.clock[a]), float(record.clock[b])) for a, b in blanks)]
