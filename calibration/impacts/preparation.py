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
from calibration.impacts.events import contacts, quantity, rest, rise, steady, telling, turning, wrong
from calibration.impacts.inspection import (
    TOUCHING,
    channel_notes,
    check_channel,
    check_clock,
    check_contact,
    clock_note,
    jumps,
)
from calibration.impacts.resampling import resampled, thinned


@dataclass(frozen=True)
class Recipe:
    """What is asked of a record, SI. None: nothing of the kind.

    Attributes:
        resample: rate [Hz] to bring it down to.
        saturation: magnitude at and beyond which the sensor cannot read, by channel.
        align: whether time 0 becomes the first sample above rest by a tenth of the first channel's peak.
        window: times [s] to keep, after aligning.
        impact: whether the record holds a whole impact, which begins and ends apart.
        offset: whether the reading where there is nothing to read is unknown.
        exact: whether the sensor's zero is 0, though the record rests elsewhere.
        thin: "mean" or "every": how a record with more samples than its contacts need is thinned (``resampling.thinned``).
    """

    resample: float | None = None
    saturation: Mapping[str, float] = field(default_factory=dict)
    align: bool = False
    window: tuple[float, float] | None = None
    impact: bool = False
    offset: bool = False
    exact: bool = False
    thin: str = ""


@dataclass(frozen=True)
class Reading:
    """A channel: ``raw`` (N,), SI, on the record's clock, which of it is ``masked``, and the ``values`` (T,) kept."""

    raw: np.ndarray
    masked: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Prepared:
    """A record, and what was understood of it.

    Attributes:
        clock: (N,) time of every row [s], aligned.
        gaps: pairs of times [s] between which nothing was sampled.
        times: (T,) of the samples kept [s].
        readings: by what each observes.
        first_contact: what alignment took from the clock [s], or None.
        averaged: so many successive samples are one.
    """

    name: str
    source: str
    clock: np.ndarray
    gaps: tuple[tuple[float, float], ...]
    times: np.ndarray
    readings: dict[str, Reading]
    first_contact: float | None
    window: tuple[float, float] | None
    notes: tuple[str, ...]
    averaged: int = 1


def prepare(name: str, part: Record, time: str, observe: dict[str, str], recipe: Recipe, where: str) -> Prepared:
    """One record out of its table.

    Args:
        time: header of the clock's column.
        observe: header of a column, "-" before it to flip its sign, by the reading it is of.

    Raises:
        InputError: for a clock that does not go forward, a column that is constant or of the wrong sign, an impact
            that is not whole, and whatever leaves nothing to fit.
    """
    faults, raw, clock, rounded = Faults(), {}, np.zeros(part.lines.size), ""
    with faults:
        clock, rounded = evened(part.numbers(time, "s", f"{where} time", blank=False))
        check_clock(clock, part, time)
    for observes, header in observe.items():
        with faults:
            raw[observes] = _signed(part, header, unit_of(observes), where)
    saturated = {o: np.abs(values) >= recipe.saturation.get(o, np.inf) for o, values in raw.items()}
    # Infinity, of a sample beyond what an instrument can show, says no more than that.
    raw = {o: np.where(np.isinf(values), np.nan, values) for o, values in raw.items()}
    lone = {o: wrong(o, clock, values) & ~saturated[o] for o, values in raw.items()}
    masked = {o: saturated[o] | lone[o] for o in raw}
    for o, values in raw.items():
        with faults:
            check_channel(o, values, masked[o], _zero(values, recipe), _place(part, observe[o]))
    faults.refuse(part.name)
    first = next(iter(raw), "")
    begun = _first_contact(clock, first, np.where(lone[first], np.nan, raw[first]), where) if recipe.align else None
    clock = clock - (begun or 0.0)
    breaks = jumps(clock)
    notes = [clock_note(clock), *filter(None, [rounded]), *_gap_notes(clock, breaks)]
    for o, values in raw.items():
        notes += channel_notes(o, values, saturated[o]) + _wrong_notes(o, values[lone[o]], clock[lone[o]])
    times, values = clock, {o: np.where(masked[o], np.nan, v) for o, v in raw.items()}
    if recipe.resample is not None:
        times, values, said = resampled(clock, breaks, values, recipe.resample, where)
        notes += said
    keep, averaged = _inside(times, recipe.window, name, where), 1
    times, values = times[keep], {o: v[keep] for o, v in values.items()}
    if recipe.thin and recipe.resample is None:
        events = next((e for o in telling(list(values)) if (e := contacts(o, times, values[o]))), [])
        times, values, averaged, said = thinned(times, values, events, recipe.thin == "mean")
        notes += said
    for o, kept in values.items():
        if recipe.impact and o.endswith(".normal"):
            cut, place = recipe.window is not None, _place(part, observe[o])
            notes += [f"{o}: {said}" for said in check_contact(times, kept, _zero(kept, recipe), cut, place)]
    readings = {o: Reading(raw[o], masked[o], values[o]) for o in raw}
    gaps = tuple((float(clock[k]), float(clock[k + 1])) for k in breaks)
    return Prepared(name, part.span, clock, gaps, times, readings, begun, recipe.window, tuple(notes), averaged)


def _gap_notes(clock: np.ndarray, breaks: np.ndarray) -> list[str]:
    if not breaks.size:
        return []
    longest = format_si(float(np.diff(clock).max()), "s", 3)
    gaps = f"{breaks.size} gaps in time, the longest of" if breaks.size > 1 else "a gap in time of"
    return [f"{gaps} {longest}; nothing is interpolated over {'them' if breaks.size > 1 else 'it'}"]


def _place(part: Record, header: str) -> str:
    return f"{part.span}, column '{header.removeprefix('-').strip()}'"


def _signed(part: Record, header: str, unit: str, where: str) -> np.ndarray:
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
    return float(clock[np.flatnonzero(values > max(TOUCHING * peak, min(least, 0.5 * peak)))[0]])


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
        raise InputError(
            f"{where} window", f"{np.count_nonzero(keep)} samples of {name} lie in the window", "widen the window"
        )
    return keep
