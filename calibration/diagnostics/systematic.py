"""What the residual tests cannot have seen: how far each estimate moves for errors of the sensor and of what was held fixed.

An error of the prediction with the signature s (one unit of it, in deviations of the noise) moves the estimates by
-(J^T J)^-1 J^T s a unit. Of an error of the sensor only the part of s beside J shows in the residuals. Fitted together with
the coefficients its amplitude is a = s'.r / |s'|^2 +- 1/|s'|, s' = s - J (J^T J)^-1 J^T s: the largest that the residuals
let pass is |a| + 1.96/|s'|. It is cut at what is called large for such a sensor: where the residuals let pass more, they
say nothing. An error of a fixed value shows in no residual that a coefficient can take up; its line is for 1 %.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.residual_tests import Series
from calibration.forward.model import Model, evaluation
from calibration.search.refinement import End

# Errors of a sensor: name, unit, and the amplitude from which on a sensor is called broken.
_SENSOR = {
    "bend of the gain": ("of the peak, at the peak", 0.05),
    "lag": ("of a contact's duration", 0.1),
    "resonance (1/w^2)": ("of a contact's duration squared", 0.01),
    "drift": ("of the peak, over the record", 0.05),
}
# Step of a fixed value, as a share, and the share that its line is for.
_STEP, _SHARE = 1e-4, 0.01
# A fixed value that moves no estimate by more than this share for 1 % is not named.
_NAMED = 1e-4
_QUANTILE = 1.959964


class Budget(NamedTuple):
    """One line: the error, its amplitude and unit, and what each estimate moves by, in its coordinate.

    That is a share of itself where the coordinate is logarithmic (``relative``), else in SI.
    """

    error: str
    amplitude: float
    unit: str
    moves: dict[str, float]


def budget_of(
    model: Model, labels: tuple[str, ...], best: End, log_depth: float, spread: Spread, series: list[Series],
    slopes: np.ndarray,
) -> list[Budget]:  # fmt: skip
    """Every line that applies.

    Args:
        model, labels, best, log_depth, spread: of the optimum.
        series: of its residuals.
        slopes: (P, P) of the coordinates by the unit box (``estimates.placed``).
    """
    if spread.covariance is None or not model.channels:
        return []
    at = evaluation(model)(np.asarray(best.point)[None], log_depth)
    covariance, jacobian = spread.covariance, best.jacobian
    basis = np.linalg.qr(jacobian)[0]

    def moves(signature: np.ndarray, amplitude: float) -> dict[str, float]:
        step = slopes @ (covariance @ (jacobian.T @ signature)) * amplitude
        return {label: float(abs(x)) for label, x in zip(labels, step, strict=True)}

    found = []
    free = {axis.name for axis in model.coordinates}
    for name, signature in _signatures(model, at.readings[0], series).items():
        unit, most = _SENSOR[name]
        beside = signature - basis @ (basis.T @ signature)
        size = float(np.linalg.norm(beside))
        seen = (abs(float(beside @ best.residuals)) / size + _QUANTILE) / size if size > 0.0 else np.inf
        if not np.any(signature) or (name == "lag" and "bandwidth" in free):
            continue
        amplitude = min(seen, most)
        found.append(Budget(name, amplitude, unit, moves(signature, amplitude)))
    for name, value in model.data.fixed.items():
        own = np.asarray(value, dtype=float)
        if name in free or not np.any(own):
            continue
        moved = eqx.tree_at(lambda m, name=name: m.data.fixed[name], model, own * (1.0 + _STEP))
        residuals = evaluation(moved)(np.asarray(best.point)[None], log_depth).residuals[0]
        signature = (residuals - at.residuals[0]) / _STEP
        if np.isfinite(signature).all():
            line = Budget(name, _SHARE, "of itself", moves(signature, _SHARE))
            if max(line.moves[label] / _size(model, label, labels, best, log_depth) for label in labels) > _NAMED:
                found.append(line)
    return found


def _size(model: Model, label: str, labels: tuple[str, ...], best: End, log_depth: float) -> float:
    """What a move of a coordinate is a share of: 1 of a logarithm."""
    k = labels.index(label)
    if model.coordinates[k].log:
        return 1.0
    return max(abs(float(model.values(best.point, log_depth)[k])), 1e-300)


def total(lines: list[Budget], label: str) -> float:
    """All errors of the sensor together, as if they were independent: root of the sum of squares."""
    return float(np.sqrt(sum(line.moves[label] ** 2 for line in lines if line.error in _SENSOR)))


def _signatures(model: Model, readings: np.ndarray, series: list[Series]) -> dict[str, np.ndarray]:
    """Errors of the sensor (N,) in deviations of the noise, a unit of each, freed of the noise's memory."""
    size = model.data.values.size + model.data.features.size
    found = {name: np.zeros(size) for name in _SENSOR}
    flat = readings.reshape(-1)
    for s in series:
        if s.rows.size < 4 or not s.touching.any():
            continue
        seen, clock = flat[s.rows], s.clock
        peak = float(np.max(np.abs(seen)))
        first = np.gradient(seen, clock)
        duration = s.longest if np.isfinite(s.longest) and s.longest > 0.0 else float(np.ptp(clock))
        errors = {
            "bend of the gain": seen * np.abs(seen) / max(peak, 1e-300),
            "lag": -duration * first,
            "resonance (1/w^2)": -(duration**2) * np.gradient(first, clock),
            "drift": peak * (clock - clock.mean()) / max(float(np.ptp(clock)), 1e-300),
        }
        kept = np.r_[0.0, np.exp(-np.diff(clock) / s.memory)] if s.memory else np.zeros(clock.size)
        for name, error in errors.items():
            weighed = error * s.weights
            found[name][s.rows] = (weighed - kept * np.roll(weighed, 1)) / np.sqrt(1.0 - kept**2)
    return found
