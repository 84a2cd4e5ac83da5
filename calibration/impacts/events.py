"""Contacts in a record, found by events: where readings of any kind leave what they do without contact.

A force or an acceleration rises above its rest; a velocity leaves its first level; a position leaves its first straight
line. Nothing is assumed of the sampling: times are the record's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from bcfj_jax.core.quantities import GRAVITY
from calibration.forward.runs import stretches
from calibration.noise.scatter import scatter

# Samples from which on a level of rest is looked for, and the fewest that are one.
_FEW, _LEVEL = 6, 3
# A share of a record's range: a level of rest is narrower, and the record begins there.
_NARROW = 0.1
# A contact begins above so many deviations of the rest, or this share of the peak, and ends below half of that.
_SIGMAS, _SHARE = 6.0, 0.05
# Noise above this share of the peak is smoothed; a sample stands alone whose neighbours have less than this share of it.
_LOUD, _ALONE = 0.04, 0.3
# Samples above half of the peak of a contact that no single sample can be.
_RESOLVED = 4
# Of several contacts the least peak that is fitted, over the largest.
_FAINT = 0.1
# A share of the readings that is rounding alone.
_ROUNDING = 1e-13
# Of a velocity or a position: the share of its largest departure that is contact.
_DEPARTED = 0.1
# Of places: times [s] over which a fall, of low bounces the second, and a push are told, the share of a record that is a fall,
# how near gravity it is, and by how much more of these stretches bend one way than the other.
_FLIGHTS, _PUSHED, _FALLEN, _NEAR, _ONE_WAY = (0.08, 0.02), 0.02, 0.3, 0.15, 0.6
# Stretches of a record by which an even pull is told, how near to it most are, and the push back over it of a body that bounces.
_PARTS, _CLOSE, _MOST, _BACK = 20.0, 0.2, 0.5, 3.0


class Event(NamedTuple):
    """One contact in a record: first and last sample in it, their times [s], the largest rise, and the usual step [s].

    ``before`` is the time of the last sample before it, or a step earlier where there is none. ``loose`` [s]: how wrong its
    ends may be for noise that was smoothed.
    """

    first: int
    last: int
    before: float
    begin: float
    end: float
    peak: float
    step: float
    loose: float = 0.0

    @property
    def duration(self) -> float:
        """About how long it lasts [s]: half a step more on either side."""
        return self.end - self.begin + self.step


def quantity(observes: str) -> str:
    """What a channel is a reading of: "normal", "velocity", "place", or "pulse" of what contacts make pulse."""
    what = observes.partition(" in ")[0].split(".")[1:2]
    known = {"normal": "normal", "velocity": "velocity", "rate": "velocity", "place": "place", "angle": "place"}
    return known.get(what[0] if what else "", "pulse")


def rest(values: np.ndarray) -> float | None:
    """The reading at rest: the middle of the quarter of the samples that lie closest together.

    None where the record does not begin there and stay for some samples, as one that is all contact, or an oscillating force.
    """
    seen = values[np.isfinite(values)]
    span, count = float(np.ptp(seen)) if seen.size else 0.0, max(seen.size // 4, _LEVEL)
    if not span or seen.size < _FEW:
        return None
    ordered = np.sort(seen)
    widths = ordered[count - 1 :] - ordered[: seen.size - count + 1]
    first = int(np.argmin(widths))
    level = float(np.median(ordered[first : first + count]))
    begins = bool(np.all(np.abs(seen[:_LEVEL] - level) < _NARROW * span))
    return level if begins and widths[first] < _NARROW * span else None


def rise(observes: str, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """How far readings (T,) without gaps are from what they are without contact, in their own unit."""
    kind = quantity(observes)
    if kind == "normal":
        return values - (rest(values) or 0.0)
    if kind == "pulse":
        return np.abs(values - (rest(values) or 0.0))
    if (thrown := pushes(kind, times, values)) is not None:
        return thrown
    few = max(3, values.size // 20)
    if kind == "velocity":
        return np.abs(values - np.median(values[:few]))
    # A straight line through the first half of the way to where the position turns, or through its first samples.
    count = min(max(few, turning(times, values) // 2), values.size)
    slope, level = np.polyfit(times[:count], values[:count], 1)
    return np.abs(values - (slope * times + level))


def falls(times: np.ndarray, values: np.ndarray, units: Iterable[float] = (1.0, 1e-3, 1e-2)) -> float:
    """The unit [m] in which places (T,) fall by gravity much of the time, negative where down is positive; 0 where none do.

    Parabolas through successive stretches have the second derivative -g in free flight, and 0 at rest.
    """
    for span in _FLIGHTS:
        bends = bent(times, values, span) / GRAVITY
        for unit in units:
            near = bends[np.abs(np.abs(bends) * unit - 1.0) < _NEAR]
            if near.size > max(_FALLEN * bends.size, 2) and abs(np.sign(near).sum()) > _ONE_WAY * near.size:
                return -float(np.sign(near.sum())) * unit
    return 0.0


def bent(times: np.ndarray, values: np.ndarray, span: float) -> np.ndarray:
    """Second derivatives (k,) of readings (T,) by parabolas through successive stretches of a length [s]."""
    seen = np.isfinite(values)
    clock, places = times[seen], values[seen]
    step = float(np.median(np.diff(clock))) if clock.size > _FEW else 0.0
    count = max(_FEW, round(span / step)) if step > 0.0 else clock.size + 1
    starts = range(0, clock.size - count + 1, max(count // 2, clock.size // 400))
    return 2.0 * np.array([np.polyfit(clock[k : k + count] - clock[k], places[k : k + count], 2)[0] for k in starts])


def even_pull(clock: np.ndarray, readings: dict[str, np.ndarray]) -> float:
    """The even acceleration [m/s^2] of a body that is thrown back against it, as of a cart on a slope; 0 of gravity and others.

    clock (N,) [s], readings (N,) by unit, of which the place or else the velocity tells it.
    """
    unit = "m" if "m" in readings else "m/s"
    seen = np.flatnonzero(np.isfinite(readings.get(unit, np.zeros(0))))
    if seen.size < 2 * _PARTS:
        return 0.0
    times, values = clock[seen], readings[unit][seen]
    bends = bent(times, _places(unit == "m", times, values), float(np.ptp(times)) / _PARTS)
    pull = float(np.median(bends))
    most = np.mean(np.abs(bends - pull) < _CLOSE * abs(pull)) > _MOST and abs(abs(pull) / GRAVITY - 1.0) > _CLOSE
    return abs(pull) if most and (-np.sign(pull) * bends).max() > _BACK * abs(pull) else 0.0


def _places(are: bool, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Readings (T,) that are places, else what velocities sum up to."""
    return values if are else np.r_[0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(times))]


def pushes(kind: str, times: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """By how much more than twice its weight a body that falls is pushed (T,) [m/s^2]; None of one that does not fall.

    In flight nothing pushes it, at rest its weight. ``kind``: of the readings (T,), "place" or "velocity".
    """
    if kind not in ("place", "velocity") or times.size < _FEW:
        return None
    places = _places(kind == "place", times, values)
    if not (up := falls(times, places, (1.0,))):
        return None
    whole = (times[-1] - times[0]) / float(np.median(np.diff(times)))
    even, step = np.linspace(times[0], times[-1], round(min(whole, 4.0 * times.size)) + 1, retstep=True)
    count = min(max(5, round(_PUSHED / step) // 2 * 2 + 1), (even.size - 1) // 2 * 2 + 1)
    bends = np.asarray(savgol_filter(np.interp(even, times, places), count, 2, 2, float(step)))
    thrown = np.maximum(up * np.interp(times, even, bends) - GRAVITY, 0.0)
    # What the noise of places alone bends is no push.
    noise = scatter(places) * float(np.linalg.norm(savgol_coeffs(count, 2, 2, float(step))))
    return np.where(thrown > min(_SIGMAS * noise, 0.5 * float(thrown.max())), thrown, 0.0)


def turning(times: np.ndarray, values: np.ndarray) -> int:
    """The sample (of T) at which a position has gone farthest the way that it went at first."""
    few = min(max(4, values.size // 10), values.size)
    way = np.polyfit(times[:few], values[:few], 1)[0]
    return int(np.argmax(np.sign(way) * values))


def contacts(observes: str, times: np.ndarray, values: np.ndarray) -> list[Event]:
    """Every contact that a channel (T,), NaN where nothing was read, shows; of a velocity, or places that do not fall, one."""
    unit = {"place": "m", "velocity": "m/s"}.get(quantity(observes), "")
    if pull := even_pull(times, {unit: values}):  # On a clock that goes so much slower it falls by gravity.
        pace, own = np.sqrt(pull / GRAVITY), ("before", "begin", "end", "step", "loose")
        found = contacts(observes, pace * times, values)
        return [e._replace(**{k: getattr(e, k) / pace for k in own}) for e in found]
    seen = np.flatnonzero(np.isfinite(values))
    if seen.size < _LEVEL:
        return []
    clock, rises = times[seen], rise(observes, times[seen], values[seen])
    peak, step = float(rises.max()), float(np.median(np.diff(clock)))
    if not peak > _ROUNDING * float(np.abs(values[seen]).max()):
        return []

    def event(first: int, last: int, peak: float, loose: float = 0.0) -> Event:
        before = float(clock[first - 1]) if first else float(clock[0]) - step
        ends = float(clock[first]), float(clock[last])
        return Event(int(seen[first]), int(seen[last]), before, *ends, peak, step, loose)

    thrown = pushes(quantity(observes), clock, values[seen]) is not None
    if quantity(observes) in ("velocity", "place") and not thrown:
        # A position leaves its line further and further: what counts is how far it has when it turns.
        peak = float(rises[turning(clock, values[seen])]) if quantity(observes) == "place" else peak
        first = int(np.flatnonzero(rises > _DEPARTED * peak)[0])
        high = np.flatnonzero(rises[first:] > (1.0 - _DEPARTED) * peak)[0]
        return [event(first, first + int(high), peak)]
    rises, high, width = steady(rises)
    found, above = [], np.flatnonzero(rises > 0.5 * high)
    # One low sample between two high ones is noise, not a flight.
    for rows in np.split(above, np.flatnonzero(np.diff(above) > width + 1) + 1):
        begun = rows[rises[rows] > high]
        if begun.size:
            first, last = int(begun[0]), int(rows[-1])
            ends = (first, last) if width == 1 else _grown(rises, first, last, high)
            loose = 0.5 * _PUSHED if thrown else (width - 1) * step
            found.append(event(*ends, float(rises[first : last + 1].max()), loose))
    return found


def apart(clock: np.ndarray, events: list[Event]) -> list[tuple[int, np.ndarray]]:
    """Which rows (N,) are about each contact, with its number from 0: as far as midway to its neighbours.

    Those whose peak is below _FAINT of the largest are left out: they hold too little to be fitted beside it.
    """
    largest = max((e.peak for e in events), default=0.0)
    cuts = [-np.inf, *(0.5 * (a.end + b.begin) for a, b in pairwise(events)), np.inf]
    rows = [(clock > cuts[k]) & (clock <= cuts[k + 1]) for k in range(len(events))]
    return [(k, rows[k]) for k, e in enumerate(events) if e.peak >= _FAINT * largest]


def steady(rises: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Rises (T,) in which neither one wrong sample nor the noise is a contact, what is above both, and the mean's width.

    A wrong sample (``alone``) is replaced by its neighbours. Where the noise is above _LOUD of the peak, the rises are a
    running mean, a quarter as wide as the one whose peak is highest above the noise.
    """
    noise, lone = scatter(rises), alone(rises)
    rises = rises.copy()
    # Two wrong samples may be neighbours, as a spike and its echo are.
    rises[lone] = np.interp(np.flatnonzero(lone), np.flatnonzero(~lone), rises[~lone])
    peak, width = float(rises.max()), 1
    if _SIGMAS * noise > 0.5 * peak or noise > _LOUD * peak:
        widths = np.unique(np.round(np.geomspace(1, max(rises.size // 4, 1), 24)).astype(int)) // 2 * 2 + 1
        best = max(widths, key=lambda w: float(_mean(rises, w).max()) * np.sqrt(w))
        width = int(best) // 4 // 2 * 2 + 1
        rises, noise = _mean(rises, width), noise / np.sqrt(width)
        peak = float(rises.max())
    quiet = rises[rises < _SHARE * peak]
    still = 1.4826 * float(np.median(np.abs(quiet - np.median(quiet)))) if quiet.size >= _LEVEL else 0.0
    return rises, max(_SHARE * peak, min(_SIGMAS * max(noise, still), 0.5 * peak)), width


def _grown(rises: np.ndarray, first: int, last: int, high: float) -> tuple[int, int]:
    """Samples at which a contact that is above the noise from ``first`` to ``last`` begins and ends, along its flanks."""
    inside = rises[first : last + 1]
    upper = 0.5 * (high + float(inside.max()))
    above = np.flatnonzero(inside >= upper)
    rise_, fall = int(above[0]), inside.size - 1 - int(above[-1])
    before, after = (round(level / (upper - level) * n) for level, n in ((high, rise_), (0.5 * high, fall)))
    return max(first - before, 0), min(last + after, rises.size - 1)


def alone(rises: np.ndarray) -> np.ndarray:
    """Which of the rises (T,) are wrong samples: they stand alone before all contacts or above them, or pull half as much.

    Only where a contact has samples enough that one by itself is none.
    """
    if rises.size < 2 * _FEW:
        return np.zeros(rises.size, dtype=bool)
    noise = scatter(rises)

    def lone(x: np.ndarray) -> np.ndarray:
        around = np.maximum(x[:-2], x[2:])
        found = (x[1:-1] > 2.0 * _SIGMAS * noise) & (around < np.maximum(_ALONE * x[1:-1], _SIGMAS * noise))
        return np.r_[False, found, False]

    wrong = lone(rises)
    others = np.where(wrong, 0.0, rises)
    peak = float(others.max())
    high = stretches(others > 0.5 * peak)
    if max((end - begin for begin, end in high), default=0) < _RESOLVED or peak < 2.0 * _SIGMAS * noise:
        return np.zeros(rises.size, dtype=bool)
    first = high[0][0]
    return (wrong & ((np.arange(rises.size) < first) | (rises > peak))) | (lone(-rises) & (rises < -0.5 * peak))


def wrong(observes: str, clock: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Which readings (N,), NaN where nothing was read, are wrong samples (``alone``); none of a velocity or a position."""
    found, seen = np.zeros(values.size, dtype=bool), np.flatnonzero(np.isfinite(values))
    if quantity(observes) in ("normal", "pulse") and seen.size > 2:
        found[seen[alone(rise(observes, clock[seen], values[seen]))]] = True
    return found


def _mean(rises: np.ndarray, width: int) -> np.ndarray:
    """Running mean (T,) over an odd number of samples, of fewer at the ends."""
    ones = np.ones(width)
    return np.convolve(rises, ones, "same") / np.convolve(np.ones(rises.size), ones, "same")


def telling(observed: Iterable[str]) -> list[str]:
    """Channels in the order in which they tell a contact: a normal force, what pulses, a velocity, a position."""
    return sorted(observed, key=lambda o: ("normal", "pulse", "velocity", "place").index(quantity(o)))


def told(times: np.ndarray, channels: Mapping[str, np.ndarray]) -> tuple[str, list[Event]]:
    """The contacts of the first channel that tells any, and its name; "" and none where none does."""
    found = ((o, contacts(o, times, channels[o])) for o in telling(channels))
    return next((seen for seen in found if seen[1]), ("", []))
