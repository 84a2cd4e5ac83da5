"""White noise in a series of readings, whatever smooth signal it is on."""

from __future__ import annotations

import numpy as np

# Samples from which on differences say something.
_FEW = 12


def scatter(values: np.ndarray) -> float:
    """Deviation of white noise by third differences, in which a smooth signal leaves little; 0 of few samples.

    1.4826 median |x_i+3 - 3 x_i+2 + 3 x_i+1 - x_i| / sqrt(1 + 9 + 9 + 1): a few wrong samples do not move it.
    """
    if values.size < _FEW:
        return 0.0
    return 1.4826 * float(np.median(np.abs(np.diff(values, 3)))) / np.sqrt(20.0)
