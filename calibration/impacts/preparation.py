"""From readings to samples that may be fitted: clock checked, saturation masked, resampled, cut; all of it said.

Nothing is ever interpolated over a gap: a cell without a number, a masked sample or a jump in time parts the record
into stretches, and each stretch is prepared for itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.errors import Faults
from bcfj_jax.data.clock import evened
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import unit_of
from calibration.impacts import inspection
from calibration.impacts.events import contacts, quantity, rest, rise, steady, told, turning, wrong

# A contact of more than so many samples is averaged down to at least as many, where the record has more than so many.
_ENOUGH, _MANY = 250, 3000
# How far about a contact, by its duration, everything is kept of a record that has too many samples still.
_NEAR = 1.5
# The low-pass against aliasing: order of each of its two passes, its edge as a share of the new rate, and how many
# samples its passes need at the ends.
_ORDER, _EDGE, _PAD = 8, 0.4, 30
# Samples of a block that is kept or left out.
_BLOCK = 32


@dataclass(frozen=True)
class Recipe:
    """What is asked of a record, SI. None: nothing of the kind."""

    resample: float | None = None  # rate [Hz] to bring it down to
    # Magnitude at and beyond which the sensor cannot read, by channel.
    saturation: Mapping[str, float] = field(default_factory=dict)
    align: bool = False  # whether time 0 becomes the first sample above rest by a tenth of the first channel's peak
    window: tuple[float, float] | None = None  # times [s] to keep, after aligning
    impact: bool = False  # whether the record holds a whole impact, which begins and ends apart
    offset: bool = False  # whether the reading where there is nothing to read is unknown
    exact: bool = False  # whether the sensor's zero is 0, though the record rests elsewhere
    thin: str = ""  # "mean" or "every": how a record with more samples than its contacts need is thinned (``_thinned``)


@dataclass(frozen=True)
class Reading:
    """A channel: ``raw`` (N,), SI, on the record's clock, which of it is ``masked``, and the ``values`` (T,) kept."""

    raw: np.ndarray
    masked: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Prepared:
    """A record, and what was understood of it."""

    name: str
    source: str
    clock: np.ndarray  # (N,) time of every row [s], aligned
    gaps: tuple[tuple[float, float], ...]  # pairs of times [s] between which nothing was sampled
    times: np.ndarray  # (T,) of the samples kept [s]
    readings: dict[str, Reading]  # by what each observes
    first_contact: float | None  # what alignment took from the clock [s], or None
    window: tuple[float, float] | None
    notes: tuple[str, ...]
    averaged: int = 1  # so many successive samples are one


def prepare(name: str, part: Record, time: str, observe: dict[str, str], recipe: Recipe, where: str) -> Prepared:
    """One record out of its table.

    Args:
        time: header of the clock's column.
        observe: header of a column, "-" before it to flip its sign, by the reading it is of.
    """
    faults, raw, clock, rounded = Faults(), {}, np.zeros(part.lines.size), ""
    with faults:
        clock, rounded = evened(part.numbers(time, "s", f"{where} time", blank=False))
        inspection.check_clock(clock, part, time)
    for o, header in observe.items():
        with faults:
            raw[o] = signed(part, header, unit_of(o), where)
    saturated = {o: np.abs(values) >= recipe.saturation.get(o, np.inf) for o, values in raw.items()}
    # Infinity, of a sample beyond what an instrument can show, says no more than that.
    raw = {o: np.where(np.isinf(values), np.nan, values) for o, values in raw.items()}
    lone = {o: wrong(o, clock, values) & ~saturated[o] for o, values in raw.items()}
    masked = {o: saturated[o] | lone[o] for o in raw}
    places = {o: f"{part.span}, column '{header.removeprefix('-').strip()}'" for o, header in observe.items()}
    for o, values in raw.items():
        with faults:
            inspection.check_channel(o, values, masked[o], _zero(values, recipe), places[o])
    faults.refuse(part.name)
    first = next(iter(raw), "")
    begun = _first_contact(clock, first, np.where(lone[first], np.nan, raw[first]), where) if recipe.align else None
    clock = clock - (begun or 0.0)
    breaks = inspection.jumps(clock)
    notes = [inspection.clock_note(clock), *filter(None, [rounded])]
    if breaks.size:
        longest = format_si(float(np.diff(clock).max()), "s", 3)
        gaps, them = (
            (f"{breaks.size} gaps in time, the longest of", "them") if breaks.size > 1 else ("a gap in time of", "it")
        )
        notes.append(f"{gaps} {longest}; nothing is interpolated over {them}")
    for o, values in raw.items():
        notes += inspection.channel_notes(o, values, saturated[o]) + _wrong_notes(o, values[lone[o]], clock[lone[o]])
    times, values, averaged = clock, {o: np.where(masked[o], np.nan, v) for o, v in raw.items()}, 1
    if recipe.resample is not None:
        times, values, said = _resampled(clock, breaks, values, recipe.resample, where)
        notes += said
    keep = _inside(times, recipe.window, name, where)
    times, values = times[keep], {o: v[keep] for o, v in values.items()}
    if recipe.thin and recipe.resample is None:
        times, values, averaged, said = _thinned(times, values, recipe.thin == "mean")
        notes += said
    for o, kept in values.items():
        if recipe.impact and o.endswith(".normal"):
            cut = recipe.window is not None
            notes += [
                f"{o}: {said}" for said in inspection.check_contact(times, kept, _zero(kept, recipe), cut, places[o])
            ]
    readings = {o: Reading(raw[o], masked[o], values[o]) for o in raw}
    gaps = tuple((float(clock[k]), float(clock[k + 1])) for k in breaks)
    return Prepared(name, part.span, clock, gaps, times, readings, begun, recipe.window, tuple(notes), averaged)


def signed(part: Record, header: str, unit: str, where: str) -> np.ndarray:
    """A column in SI, with "-" before its header of the other sign."""
    sign = -1.0 if header.startswith("-") else 1.0
    return sign * part.numbers(header.removeprefix("-").strip(), unit, f"{where} observe", blank=True)


def _wrong_notes(observes: str, values: np.ndarray, clock: np.ndarray) -> list[str]:
    if not values.size:
        return []
    first = f"{format_si(float(values[0]), unit_of(observes), 3)} at {format_si(float(clock[0]), 's', 3)}"
    many = f"{values.size} wrong samples are" if values.size > 1 else "1 wrong sample is"
    return [f"{observes}: {many} left out, far from rest and alone: {first}{', ...' if values.size > 1 else ''}"]


def _first_contact(clock: np.ndarray, observes: str, values: np.ndarray, where: str) -> float:
    """Time of the first sample above rest by a tenth of the peak, or by the noise where that is more.

    Neither a wrong sample nor the noise is one (``events.steady``). Only a normal force has a sign that it must have.
    """
    seen = np.isfinite(values)
    clock, values = clock[seen], values[seen]
    position, values = values, rise(observes, clock, values) if values.size > 2 else values
    far = quantity(observes) == "place" and values.size > 2
    least = 0.0
    if quantity(observes) in ("normal", "pulse") and values.size > 2:
        values, least, width = steady(values)
        if width > 1 and (loud := contacts(observes, clock, position)):
            return loud[0].begin
    peak = values[turning(clock, position)] if far else np.max(values, initial=0.0)
    if not peak > 0:
        if not observes.endswith(".normal"):
            raise InputError(f"{where} observe", f"'{observes}' reads 0 throughout", "choose another column")
        raise InputError(f"{where} observe", "the force is never positive", 'flip its sign with "-" before the column')
    return float(clock[np.flatnonzero(values > max(inspection.TOUCHING * peak, min(least, 0.5 * peak)))[0]])


def _zero(values: np.ndarray, recipe: Recipe) -> float:
    """The reading where there is nothing to read: the level of rest, or where none is seen and it is unknown, the median."""
    level = None if recipe.exact and not recipe.offset else rest(values)
    if level is None and recipe.offset and np.isfinite(values).any():
        level = float(np.nanmedian(values))
    return level or 0.0


def _inside(times: np.ndarray, window: tuple[float, float] | None, name: str, where: str) -> np.ndarray:
    if window is None:
        return np.ones(times.size, dtype=bool)
    keep = (times >= window[0]) & (times <= window[1])
    if np.count_nonzero(keep) < 3:
        found = f"{np.count_nonzero(keep)} samples of {name} lie in the window"
        raise InputError(f"{where} window", found, "widen the window")
    return keep


def _thinned(
    clock: np.ndarray, channels: dict[str, np.ndarray], averaged: bool
) -> tuple[np.ndarray, dict[str, np.ndarray], int, list[str]]:
    """A record brought down to the samples that its contacts need: means of m successive samples, or every m-th; m, and notes.

    A mean of white noise has its deviation over sqrt(m), so that nothing of what the record says of the noise is lost; what a
    mean does to a contact of _ENOUGH samples is below 1e-5 of its peak. Far from contacts whole blocks are left out.
    """
    events = told(clock, channels)[1]
    if clock.size <= _MANY or not events:
        return clock, channels, 1, []
    step = float(np.median(np.diff(clock)))
    size = int(min(e.duration for e in events) / step / _ENOUGH)
    size = max(min(size, clock.size // _MANY + 1), 1)
    whole = clock.size // size * size
    blocks = clock[:whole].reshape(-1, size)
    if averaged:
        own = np.ptp(blocks, axis=1) < 1.5 * step * size
        times = blocks.mean(axis=1)
        found = {o: np.where(own, v[:whole].reshape(-1, size).mean(axis=1), np.nan) for o, v in channels.items()}
    else:
        times, found = blocks[:, 0], {o: v[:whole:size] for o, v in channels.items()}
    near = np.zeros(times.size, dtype=bool)
    for e in events:
        near |= (times > e.begin - _NEAR * e.duration) & (times < e.end + _NEAR * e.duration)
    far = np.flatnonzero(~near)
    every = max(1, -(-2 * far.size // _MANY))
    near[far[(far // _BLOCK) % every == 0]] = True
    if size == 1 and every == 1:
        return clock, channels, 1, []
    note = f"{clock.size} samples thinned to {int(near.sum())}"
    note += f", {'means of' if averaged else 'one of'} {size} successive ones" if size > 1 else ""
    note += f"; of what is far from contacts one part in {every} is kept" if every > 1 else ""
    note += "; resample = RATE says otherwise"
    return times[near], {o: v[near] for o, v in found.items()}, size if averaged else 1, [note]


def _resampled(
    clock: np.ndarray, breaks: np.ndarray, channels: dict[str, np.ndarray], rate: float, where: str
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Every channel at an even lower rate, stretch by stretch: low-passed forwards and backwards, then sampled; and notes.

    ``breaks``: rows after which the clock jumps.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    step = float(np.median(np.diff(clock)))
    if rate * step > 1.0:
        found = f"{format_si(rate, 'Hz')} is above the {format_si(1.0 / step, 'Hz')} of the record"
        raise InputError(f"{where} resample", found, "a higher rate adds samples but no information; give a lower one")
    times = clock[0] + np.arange(int((clock[-1] - clock[0]) * rate + 1e-9) + 1) / rate
    sections = butter(_ORDER, min(2.0 * _EDGE * rate * step, 0.99), output="sos")
    piece = np.searchsorted(breaks, np.arange(clock.size))
    lower, lost = {}, 0
    for observes, values in channels.items():
        lower[observes] = np.full(times.size, np.nan)
        seen = np.flatnonzero(np.isfinite(values))
        ends = np.flatnonzero((np.diff(seen) > 1) | (np.diff(piece[seen]) > 0))
        for stretch in np.split(seen, ends + 1):
            if stretch.size <= _PAD:
                lost += stretch.size
                continue
            own = clock[stretch]
            even = np.linspace(own[0], own[-1], max(stretch.size, round((own[-1] - own[0]) / step) + 1))
            smooth = sosfiltfilt(sections, CubicSpline(own, values[stretch])(even), padlen=_PAD)
            inside = (times >= own[0] - 1e-9 * step) & (times <= own[-1] + 1e-9 * step)
            lower[observes][inside] = CubicSpline(even, smooth)(times[inside])
    # Where no channel has a value there is no sample.
    keep = np.isfinite(np.stack(list(lower.values()))).any(axis=0)
    if not keep.any():
        found = f"no stretch without a gap is longer than {_PAD} samples"
        raise InputError(f"{where} resample", found, "take resample out, or give a longer record")
    notes = [f"resampled from {format_si(1.0 / step, 'Hz')} to {format_si(rate, 'Hz')}, {int(keep.sum())} samples"]
    notes += [f"{lost} samples dropped in stretches too short to filter"] if lost else []
    return times[keep], {o: v[keep] for o, v in lower.items()}, notes
