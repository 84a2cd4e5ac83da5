"""A long record as a short table: filtered and thinned, with what either changes.

A table as a load or drive is a straight line between its rows, and a solver's steps end at each. Rows that lie on a straight
line to within an error, or carry what is above the frequencies that matter, cost steps and tell nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import Quantity, increasing, real, scalar

_ERROR = Quantity("error", "1", "largest change of a value by thinning", 0.0)
_BAND = Quantity("band", "Hz", "frequency above which is filtered out", 0.0, open_low=True)
# Of the Butterworth filter; forwards and backwards it is of twice that, and without delay.
_ORDER = 4
# Share of a step by which the clock of a record that is filtered may be uneven.
_UNEVEN = 1e-3


class Thinned(NamedTuple):
    """A table, and how far it is from the record."""

    times: np.ndarray  # (K,) [s], of the record's rows; values (K,)
    values: np.ndarray
    error: float  # largest difference of the straight lines from the filtered record
    filtered: float  # root mean square of what the filter took; 0 without one


def thinned(times: ArrayLike, values: ArrayLike, error: float, band: float | None = None) -> Thinned:
    """Some of a record's rows, between which straight lines stay within ``error`` of all.

    From each row the next is the last to which such a line leads; ``error`` has the unit of ``values`` (T,), and ``times`` (T,)
    [s] increase. ``band`` [Hz]: what is faster is taken out first, by a Butterworth filter of 4th order forwards and
    backwards, whose gain is 1/(1 + (tan(pi f h)/tan(pi band h))^8) at a step h and 1/2 at ``band``.

    Raises:
        InputError: for times that are fewer than two or do not increase, values that are not finite or of another number; for a
            band that an uneven clock, or a rate of less than twice it, does not have.
    """
    t, y = increasing(times, 2), real("thinned", "values", values)
    if t.shape != y.shape or not np.isfinite(y).all():
        raise InputError("thinned", f"{t.shape} times and {y.shape} values", "give as many finite values as times")
    steps = np.diff(t)
    allowed, whole = float(scalar("thinned", _ERROR, error)), y
    if band is not None:
        y = _slow(y, steps, float(scalar("thinned", _BAND, band)))
    rows = _rows(t, y, allowed)
    off = np.abs(np.interp(t, t[rows], y[rows]) - y)
    return Thinned(t[rows], y[rows], float(off.max()), float(np.sqrt(np.mean((y - whole) ** 2))))


def _slow(values: np.ndarray, steps: np.ndarray, band: float) -> np.ndarray:
    """Without what is faster than ``band`` [Hz]."""
    step = float(steps.mean())
    if np.abs(steps - step).max() > _UNEVEN * step:
        found = f"steps of {steps.min():g} to {steps.max():g} s"
        raise InputError("thinned band", found, "give a record of an even clock, or no band")
    if band >= 0.5 / step:
        found = f"{band:g} Hz of a record at {1.0 / step:g} Hz"
        raise InputError("thinned band", found, f"give less than half the rate, {0.5 / step:g} Hz, or no band")
    return signal.sosfiltfilt(signal.butter(_ORDER, band, fs=1.0 / step, output="sos"), values)


def _rows(t: np.ndarray, y: np.ndarray, error: float) -> np.ndarray:
    """Rows that stay. From each, slopes of lines that pass all rows since form a cone; the next is the last row inside it."""
    kept, ahead = [0], 8
    while kept[-1] < t.size - 1:
        at = kept[-1]
        part = slice(at + 1, at + 1 + ahead)
        far = t[part] - t[at]
        slope, wide = (y[part] - y[at]) / far, error / far
        low, high = np.maximum.accumulate(slope - wide), np.minimum.accumulate(slope + wide)
        empty = np.flatnonzero(low > high)
        if not empty.size and at + 1 + ahead < t.size:
            ahead *= 2
            continue
        end = empty[0] if empty.size else slope.size
        inside = (slope >= np.r_[-np.inf, low[:-1]]) & (slope <= np.r_[np.inf, high[:-1]])
        ahead = 2 + 2 * int(np.flatnonzero(inside[: end + 1])[-1])
        kept.append(at + ahead // 2)
    return np.array(kept)
