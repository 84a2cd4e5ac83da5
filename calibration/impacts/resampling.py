"""A record at an even lower rate, free of aliases, with nothing put where nothing was measured."""

from __future__ import annotations

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.io.units import format_si
from calibration.impacts.events import Event

# A contact of more than so many samples is averaged down to at least as many, where the record has more than so many.
_ENOUGH, _MANY = 250, 3000
# How far about a contact, by its duration, everything is kept of a record that has too many samples still.
_NEAR = 1.5
# The low-pass against aliasing: order of each of its two passes, its edge as a share of the new rate, and how many
# samples its passes need at the ends.
_ORDER, _EDGE, _PAD = 8, 0.4, 30
# Samples of a block that is kept or left out.
_BLOCK = 32


def thinned(
    clock: np.ndarray, channels: dict[str, np.ndarray], events: list[Event], averaged: bool
) -> tuple[np.ndarray, dict[str, np.ndarray], int, list[str]]:
    """A record brought down to the samples that its contacts need: means of m successive samples, times too.

    A mean of white noise has its deviation over sqrt(m), so that nothing of what the record says of the noise is lost; what a
    mean does to a contact of _ENOUGH samples is below 1e-5 of its peak. Far from contacts whole blocks are left out.

    Args:
        channels: (N,) each, NaN where nothing was measured.
        averaged: whether means are taken; else every m-th sample, for noise that remembers itself.

    Returns:
        Times, channels, m, and notes; m is 1 where nothing was done.
    """
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
    kind = "means of" if averaged else "one of"
    notes = [f"{clock.size} samples thinned to {int(near.sum())}"]
    notes[0] += f", {kind} {size} successive ones" if size > 1 else ""
    notes[0] += f"; of what is far from contacts one part in {every} is kept" if every > 1 else ""
    notes[0] += "; resample = RATE says otherwise"
    return times[near], {o: v[near] for o, v in found.items()}, size if averaged else 1, notes


def resampled(
    clock: np.ndarray, jumps: np.ndarray, channels: dict[str, np.ndarray], rate: float, where: str
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Every channel at an even lower rate, stretch by stretch: low-passed forwards and backwards, then sampled.

    Args:
        clock: (N,) [s].
        jumps: rows after which it jumps.
        channels: (N,) each, NaN where nothing was measured.

    Returns:
        Times (T,), channels (T,) each, and notes.

    Raises:
        InputError: for a rate above the record's, or where no stretch is long enough to filter.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    step = float(np.median(np.diff(clock)))
    if rate * step > 1.0:
        found = f"{format_si(rate, 'Hz')} is above the {format_si(1.0 / step, 'Hz')} of the record"
        raise InputError(f"{where} resample", found, "a higher rate adds samples but no information; give a lower one")
    times = clock[0] + np.arange(int((clock[-1] - clock[0]) * rate + 1e-9) + 1) / rate
    sections = butter(_ORDER, min(2.0 * _EDGE * rate * step, 0.99), output="sos")
    piece = np.searchsorted(jumps, np.arange(clock.size))
    lower, lost = {}, 0
    for observes, values in channels.items():
        lower[observes] = np.full(times.size, np.nan)
        seen = np.flatnonzero(np.isfinite(values))
        breaks = np.flatnonzero((np.diff(seen) > 1) | (np.diff(piece[seen]) > 0))
        for stretch in np.split(seen, breaks + 1):
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
