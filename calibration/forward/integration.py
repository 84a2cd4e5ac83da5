"""What the integrator's own error does to a fit: it is measured where the fit ended, by a run at a tighter tolerance.

Residuals that are no larger say nothing of noise or model, and the cost of a point is uncertain by as much.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from calibration.forward.model import Model, predictions, residuals_and_jacobian
from calibration.solver_budget import budget

# Residuals up to so many times the measured error may be the integrator's.
_MAY_BE = 3.0
# ... and then count as so many times its length: elsewhere it may be three times as large.
_COUNTS = 10.0
# No record is known better than to this share of its peak; below it costs are all rounding.
_FINEST = 1e-5


class Limit(NamedTuple):
    """Of one channel: deviations up to ``below`` are the integrator's and count as ``sigma``, SI.

    ``sigma`` is ten times the length of the error e over all samples. No combination of coordinates is then moved by
    more than a tenth of its deviation, however e lies: |Q^T e| <= |e|.
    """

    below: float
    sigma: float


def limits(model: Model, point: np.ndarray, accuracy: float) -> dict[str, Limit]:
    """Limits of all channels at a point, no less than ``accuracy`` as a share of the peak, or than 1e-5 of it."""
    read, weights = predictions(model, point), np.asarray(model.data.weights)
    error = _scale(model) * (read - predictions(tighter(model), point))
    found = {}
    for j, name in enumerate(model.channels):
        seen = weights[:, j] > 0
        own = error[:, j][seen]
        least = max(accuracy, _FINEST) * float(np.max(np.abs(read[:, j][seen]), initial=0.0))
        own = own if np.isfinite(own).all() else np.zeros(1)
        rms = float(np.sqrt(np.mean(own**2)))
        found[name] = Limit(max(least, _MAY_BE * rms), max(least, _COUNTS * float(np.linalg.norm(own))))
    return found


def errors(model: Model, point: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Error (N,) of white residuals at a point; NaN where the tighter run fails."""
    finer, _ = residuals_and_jacobian(tighter(model), point)
    return _scale(model) * (residuals - finer)


def own(residuals: np.ndarray, error: np.ndarray, accuracy: float, peak: float) -> bool:
    """Whether white residuals (n,) of one series are no larger than the integrator's error, or its limit's least; ``peak`` is
    of the series, in deviations of its noise.
    """
    least = max(accuracy, _FINEST) * peak
    size, doubt = (float(np.sqrt(np.mean(a**2))) for a in (residuals, error))
    return size <= max(least, _MAY_BE * doubt if np.isfinite(doubt) else 0.0)


def tighter(model: Model) -> Model:
    """The model at a tighter tolerance, which is traced: nothing is compiled for it."""
    return eqx.tree_at(lambda m: m.how.tolerance, model, model.how.tolerance / budget(model).tighter)


def _scale(model: Model) -> float:
    """From the difference of the two runs to the error of the first, if that goes with the tolerance."""
    return 1.0 / (1.0 - 1.0 / budget(model).tighter)
