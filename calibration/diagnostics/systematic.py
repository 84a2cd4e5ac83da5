"""What the residual tests cannot have seen: how far each estimate moves for errors of the sensor and of what was held fixed.

An error of the prediction with the signature s (one unit of it, in deviations of the noise) moves the estimates by
-(J^T J)^-1 J^T s a unit. Only its part beside J shows in the residuals r. Of a single error, fitted together with
the coefficients, the amplitude is a = s'.r / |s'|^2 +- 1/|s'|, s' = s - J (J^T J)^-1 J^T s: the largest that the residuals
let pass is |a| + 1.96/|s'|. It is cut at what is called large for such a sensor, or at the tolerance of a fixed value:
where the residuals let pass more, they say nothing.

All together: every amplitude is normal with that limit as its 1.96 deviations. The residuals narrow their common
distribution (linear Gaussian, S the signatures by their deviations): mean -A S'^T r / v, covariance A = (S'^T S' / v + 1)^-1,
v the variance that residuals have. So errors that hide each other in the residuals are allowed for.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.residual_tests import Series
from calibration.forward.losses import influence
from calibration.forward.model import Model, evaluation
from calibration.search.refinement import End
from calibration.solver_budget import budget


class _Error(NamedTuple):
    """An error of a sensor: its unit, the amplitude that is called large, and the nuisance that fits it."""

    unit: str
    most: float
    nuisance: str


_SENSOR = {
    "gain": _Error("of itself", 0.01, "gain"),
    "bend of the gain": _Error("of the peak, at the peak", 0.05, "gain_bend"),
    "lag": _Error("of a contact's duration", 0.1, "bandwidth"),
    "resonance (1/w^2)": _Error("of a contact's duration squared", 0.01, "resonance"),
    "drift": _Error("of the peak, over the record", 0.05, "drift"),
    "rest": _Error("of the peak", 0.02, "force_offset"),
    "clock": _Error("of the time between samples", 0.5, "time_offset"),
}
# Step of a fixed value as a share of its tolerance, which is this share of it where none is stated.
_STEP, _SHARE = 1e-2, 0.01
# Constants, which are known.
_KNOWN = ("gravity",)
# A fixed value that moves no estimate by more than this share is not named.
_NAMED = 1e-4
_QUANTILE = 1.959964


class Line(NamedTuple):
    """One error, its amplitude and unit, and what each estimate moves by, in its coordinate.

    That is a share of itself where the coordinate is logarithmic, else in SI.
    """

    error: str
    amplitude: float
    unit: str
    moves: dict[str, float]


class Budget(NamedTuple):
    """Every line, and of all errors together the mean shift and the deviation (SI or as a share) of each estimate."""

    lines: list[Line]
    shifts: dict[str, float]
    deviations: dict[str, float]

    def widened(self, label: str, half: float) -> float:
        """Half of an interval with the errors allowed for."""
        return self.shifts[label] + float(np.hypot(half, _QUANTILE * self.deviations[label]))


def budget_of(
    model: Model, labels: tuple[str, ...], best: End, log_depth: float, spread: Spread, series: list[Series],
    slopes: np.ndarray, tolerances: dict[str, np.ndarray],
) -> Budget | None:  # fmt: skip
    """Every line that applies, and all together; None where no estimate is determined or no channel is read.

    Of a rough cost, of fixed values only those with a stated tolerance: a motion of the joint costs seconds each.

    Args:
        model, labels, best, log_depth, spread: of the optimum.
        series: of its residuals.
        slopes: (P, P) of the coordinates by the unit box (``estimates.placed``).
        tolerances: by name (E,), SI, of what was held fixed, where they were stated.
    """
    if spread.covariance is None or not model.channels:
        return None
    at = evaluation(model)(np.asarray(best.point)[None], log_depth)
    psi, bend = influence(model.loss, best.residuals)
    # Least squares over these rows is a step of the robust loss.
    root = np.sqrt(np.maximum(bend, 1e-3))
    jacobian, residuals = root[:, None] * best.jacobian, psi / root
    basis, triangle = np.linalg.qr(jacobian)
    freedom = spread.freedom
    variance = max(1.0, float(residuals @ residuals) / max(freedom, 1))
    found: list[tuple[str, str, float, np.ndarray]] = []
    free = {axis.name for axis in model.coordinates}
    for name, signature in _signatures(model, at.readings[0], series).items():
        if np.any(signature) and _SENSOR[name].nuisance not in free:
            found.append((name, _SENSOR[name].unit, _SENSOR[name].most, signature))
    for name, value in model.data.fixed.items():
        own = np.asarray(value, dtype=float)
        stated = tolerances.get(name)
        if name in free or name in _KNOWN or not np.any(own if stated is None else stated):
            continue
        if stated is None and budget(model.scene).rough:
            continue
        tolerance = _SHARE * own if stated is None else stated
        moved = eqx.tree_at(lambda m, name=name: m.data.fixed[name], model, own + _STEP * tolerance)
        seen = evaluation(moved)(np.asarray(best.point)[None], log_depth).residuals[0]
        share = np.abs(tolerance) / np.where(own != 0.0, np.abs(own), 1.0)
        signature = (seen - at.residuals[0]) / (_STEP * np.max(share))
        if np.isfinite(signature).all():
            found.append((name, "of itself", float(np.max(share)), signature))

    lines, columns = [], []
    for name, unit, most, plain in found:
        signature = root * plain
        beside = signature - basis @ (basis.T @ signature)
        size = float(np.linalg.norm(beside))
        let_pass = (
            (abs(float(beside @ residuals)) / size + _QUANTILE * np.sqrt(variance)) / size if size > 0 else np.inf
        )
        amplitude = min(let_pass, most)
        move = slopes @ np.linalg.solve(triangle, basis.T @ signature)
        moves = {label: float(abs(x)) * amplitude for label, x in zip(labels, move, strict=True)}
        if name not in _SENSOR:
            sizes = (_size(model, k, best, log_depth) for k in range(len(labels)))
            if max(moves[label] / size for label, size in zip(labels, sizes, strict=True)) < _NAMED:
                continue
        lines.append(Line(name, amplitude, unit, moves))
        columns.append(signature * (most / _QUANTILE))
    if not lines:
        return Budget([], dict.fromkeys(labels, 0.0), dict.fromkeys(labels, 0.0))
    signatures = np.stack(columns, axis=1)
    beside = signatures - basis @ (basis.T @ signatures)
    narrowed = np.linalg.inv(beside.T @ beside / variance + np.eye(len(lines)))
    mean = narrowed @ (beside.T @ residuals) / variance
    way = slopes @ np.linalg.solve(triangle, basis.T @ signatures)
    shifts, deviations = np.abs(way @ mean), np.sqrt(np.einsum("ij,jk,ik->i", way, narrowed, way))
    return Budget(
        lines, dict(zip(labels, shifts.tolist(), strict=True)), dict(zip(labels, deviations.tolist(), strict=True))
    )


def _size(model: Model, k: int, best: End, log_depth: float) -> float:
    """What a move of a coordinate is a share of: 1 of a logarithm."""
    if model.coordinates[k].log:
        return 1.0
    return max(abs(float(model.values(best.point, log_depth)[k])), 1e-300)


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
            "gain": seen,
            "bend of the gain": seen * np.abs(seen) / max(peak, 1e-300),
            "lag": -duration * first,
            "resonance (1/w^2)": -(duration**2) * np.gradient(first, clock),
            "drift": peak * (clock - clock.mean()) / max(float(np.ptp(clock)), 1e-300),
            "rest": np.full(clock.size, peak),
            "clock": -float(np.median(np.diff(clock))) * first,
        }
        kept = np.r_[0.0, np.exp(-np.diff(clock) / s.memory)] if s.memory else np.zeros(clock.size)
        for name, error in errors.items():
            weighed = error * s.weights
            found[name][s.rows] = (weighed - kept * np.roll(weighed, 1)) / np.sqrt(1.0 - kept**2)
    return found
