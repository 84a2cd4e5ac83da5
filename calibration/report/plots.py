"""Pictures of a fit: data over prediction with a residual strip, force against penetration, where starts ended."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax import Run
from bcfj_jax.analysis.simulation.pictures import loops, sides
from bcfj_jax.io.page import Picture, counted
from bcfj_jax.io.plots import COLOURS, Margins, engineering, label, plain, sheet
from calibration.diagnostics.records import Record
from calibration.fit import Fit
from calibration.forward.runs import SAMPLES, ran
from calibration.impacts.plot import reading_label
from calibration.problem import Problem, offsets_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def records(fit: Fit, problem: Problem | None, path: Path) -> Picture | None:
    """Every record: data over the history of least squares, and below it the residuals in standard deviations.

    The problem is read for records that hold features alone. No picture where features alone were fitted.
    """
    panels = [(record, channel) for record in fit.records for channel in record.data]
    if not panels:
        return None
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    runs = {record.name: _run(fit, problem, record) for record in fit.records if record.data}
    with sheet(path, 2 * rows, columns, width=6.0 * columns + 1.0, height=2.4, margins=Margins(0.9)) as axes:
        grid = np.array(axes).reshape(2 * rows, columns)
        for axis in axes:
            axis.set_visible(False)
        for k, (record, channel) in enumerate(panels):
            row, column = divmod(k, columns)
            _panel(grid[2 * row, column], grid[2 * row + 1, column], record, channel, runs[record.name])
    held = sum(record.held_out for record, _ in panels)
    strips = np.concatenate([(r.data[c] - r.prediction[c]) / r.sigma[c] for r, c in panels])
    inside = float(np.mean(np.abs(strips[np.isfinite(strips)]) <= 2.0))
    shows = (
        f"{counted(len(panels), 'record')}{f', {held} of them held out' if held else ''}: data, the curve of "
        "least squares, from which values to quote may differ, and below each the residuals in standard deviations; "
        f"{100 * inside:.0f} % of them are within two."
    )
    return Picture(path.name, "Data and fit", shows)


def _run(fit: Fit, problem: Problem | None, record: Record) -> Run:
    """The model alone, densely sampled, with a record's own parameters; the clock is the model's."""
    span = record.times - record.params["time_offset"]
    if not span.size and problem:  # features alone, of a run that starts with the model's clock
        span = next(np.array([0.0, e.span or 0.0]) for e in problem.experiments if e.name == record.name)
    times = np.linspace(min(0.0, span[0]), max(span[-1], span[0] + 1e-9), SAMPLES)
    return ran(fit.optimum.model, record.params, times, record.data)


def _panel(upper: Axes, lower: Axes, record: Record, channel: str, run: Run) -> None:
    time_scale, time_prefix = engineering(record.times)
    data, own = record.data[channel], record.params
    scale, prefix = engineering(data)
    for axis in (upper, lower):
        axis.set_visible(True)
    name, colour = ("prediction", COLOURS[1]) if record.held_out else ("least squares", COLOURS[0])
    offset = sum(own.get(name, 0.0) for name in offsets_of(channel, run.readings))
    curve = own["gain"] * run.readings[channel] + offset
    # The curve lies over the data, and is light enough in a dense record to leave them to be seen.
    upper.plot(record.times * time_scale, data * scale, "o", ms=4, color=COLOURS[5], label="data")
    upper.plot((run.times + own["time_offset"]) * time_scale, curve * scale, color=colour, lw=1.6, label=name)
    # Its table speaks of the size of a contact's force; the record has its sign.
    force = run.force.get(channel.removesuffix(".normal"))
    title = f"{plain(record.name)}: {channel}{'' if force is None else sides(force[..., 0])}"
    upper.set(title=title + (" (held out)" if record.held_out else ""), ylabel=reading_label(channel, prefix))
    upper.legend(loc="upper right")
    strip = (data - record.prediction[channel]) / record.sigma[channel]
    lower.axhspan(-2, 2, color="#e8eef6", lw=0)
    lower.vlines(record.times * time_scale, 0.0, strip, color=COLOURS[5], lw=1)
    lower.plot(record.times * time_scale, strip, "o", ms=3, color=COLOURS[5])
    lower.set_xlabel(label("time", "s", time_prefix))
    lower.set_ylabel(f"data - {name}\n[standard deviations]", fontsize=8)
    lower.sharex(upper)


def force_penetration(fit: Fit, problem: Problem | None, path: Path) -> Picture | None:
    """The loop of the first fitted experiment at the fitted values, with the energy it dissipates.

    No picture of a scene without contacts.
    """
    if not fit.optimum.model.scene.members:
        return None
    return loops(_run(fit, problem, fit.records[0]), path)


def starts(fit: Fit, path: Path) -> Picture:
    """Waterfall: the cost at which each start ended, best first."""
    costs = np.array([row["chi2"] for row in fit.starts], dtype=float)
    good = np.isfinite(costs)
    above = costs[good] - costs[good].min()
    with sheet(path, margins=Margins(1.05)) as (axis,):
        # Differences below a millionth of a sigma squared are the optimiser's own tolerance.
        axis.semilogy(np.flatnonzero(good) + 1, np.maximum(above, 1e-6), "o")
        for k in np.flatnonzero(~good):
            axis.axvline(float(k + 1), color=COLOURS[1], lw=1, ls=":")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set(
            title=f"{int(good.sum())} of {costs.size} starts ended, best first (dotted: failed)", xlabel="start",
            ylabel="cost above the best\n[weighted squares, at least 1e-6]", xlim=(0.5, costs.size + 0.5),
            ylim=(5e-7, max(1.0, 2.0 * float(np.nanmax(costs) - np.nanmin(costs)))),
        )  # fmt: skip
    best, failed = int(np.count_nonzero(above <= 1e-3)), int((~good).sum())
    shows = f"Cost at which each of {costs.size} starts of the search ended, best first: {best} reach the best, "
    return Picture(path.name, "Where the search ended", f"{shows}{failed} failed.")
