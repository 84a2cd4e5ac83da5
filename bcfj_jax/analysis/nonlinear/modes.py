"""What a contact with clearance is doing at large: free flight, an impact, or continuous contact.

The three modes of clearance joints (Flores and Ambrósio, Computers and Structures 82, 2004), distinguished by the surfaces'
overlap: free where there is none, an impact where the overlap lasts no longer than ``impact_time``, else continuous.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bcfj_jax.analysis.features import contact_times
from bcfj_jax.core.errors import InputError

UNKNOWN, FREE, IMPACT, CONTINUOUS = range(-1, 3)
MODES = ("free", "impact", "continuous")


def contact_modes(times: ArrayLike, penetration: ArrayLike, rate: ArrayLike, impact_time: float) -> np.ndarray:
    """Codes that count ``MODES`` of one contact's history, (T,); -1 where it is NaN.

    A contact that is cut off by either end of the history is continuous: how long it lasts is not known. One
    between two samples marks the sample before it.

    Args:
        times, penetration, rate: (T,) [s], [m] (negative: gap), [m/s], as in a ``Run``.
        impact_time: the longest contact that counts as an impact [s]; some times pi sqrt(m/k) of the pair.

    Raises:
        InputError: for an impact time that is not positive.
    """
    if not impact_time > 0.0:
        raise InputError("impact_time", f"{impact_time:g} s", "give more than 0")
    t, d, v = (np.asarray(x, dtype=float) for x in (times, penetration, rate))
    good = np.isfinite(d) & np.isfinite(v)
    found = np.full(t.shape, UNKNOWN, dtype=np.int8)
    # A failed run is NaN from somewhere on.
    stop = int(np.argmin(good)) if not good.all() else t.size
    found[:stop] = FREE
    if stop < 2:
        return found
    for start, end in contact_times(t[:stop], d[:stop], v[:stop]):
        first = max(int(np.searchsorted(t[:stop], start)), 0)
        last = stop if np.isnan(end) else int(np.searchsorted(t[:stop], end))
        whole = start > t[0] and not np.isnan(end)
        code = IMPACT if whole and end - start <= impact_time else CONTINUOUS
        if first == last:
            first = max(first - 1, 0)
        found[first:last] = code
    return found
