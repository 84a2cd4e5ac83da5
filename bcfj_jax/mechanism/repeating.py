"""A run that repeats itself from pitch to pitch, as a short one: what comes later is read a whole number of pitches earlier.

``AbstractModel.recurs``, ``pitch`` and ``turned`` say whether a model does, after which time, and which member does then
what another did. NumPy, on the host.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Instants that fall together are this far apart, as a share of the run, so that they still increase.
_APART = 1e-12


class Folded(NamedTuple):
    """A run of T times as one of M = T + 2 C, whatever is folded: one program serves both."""

    times: np.ndarray  # (M,) increasing [s], at which to solve
    index: np.ndarray  # (T,) which of them answers each time wanted; pitches (T,): how many pitches earlier it is
    pitches: np.ndarray
    # before, last: (C,) the same phases of the last pitch but one and the last.
    before: np.ndarray
    last: np.ndarray


def folded(times: np.ndarray, pitch: float, end: float, back: np.ndarray, whole: bool = False) -> Folded:
    """The short run until ``end`` that stands for a long one.

    Args:
        times: (T,) of the long run [s].
        pitch: after which it repeats itself [s].
        end: of the short run [s].
        back: (C,) phases that are compared, in seconds before the end, falling to 0.
        whole: leaves all times in place.
    """
    late = np.zeros(times.size) if whole else np.maximum(0.0, np.ceil((times - end) / pitch))
    every = np.concatenate([times - late * pitch, end - back - pitch, end - back])
    order = np.argsort(every, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    # Each at least a little after the one before it.
    ranks = _APART * max(end, float(times[-1] - times[0])) * np.arange(order.size)
    rising = np.maximum.accumulate(every[order] - ranks) + ranks
    index, first, second = np.split(place, [times.size, times.size + back.size])
    return Folded(rising, index, late.astype(int), first, second)
