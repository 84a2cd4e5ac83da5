"""A record at an even lower rate, free of aliases, with nothing put where nothing was measured."""

from __future__ import annotations

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.io.units import format_si

# The low-pass against aliasing: order of each of its two passes, its edge as a share of the new rate, and how many
# samples its passes need at the ends.
_ORDER, _EDGE, _PAD = 8, 0.4, 30


def resampled(
    clock: np.ndarray, jumps: np.ndarray, channels: dict[str, np.ndarray], rate: float, where: str
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Every channel at an even lower rate, stretch by stretch: low-passed forwards and backwards, then sampled.

    Args:
        clock: (N,) [s].
        jumps: rows after which it jumps.
        channels: (N,) each, NaN where nothing was measured.
        rate: wanted [Hz].
        where: the experiment, for messages.

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
