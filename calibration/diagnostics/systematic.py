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

import itertools
from collections.abc import Collection, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from bcfj_jax.core.quantities import GRAVITY
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.diagnostics.signatures import weight
from calibration.forward.losses import influence
from calibration.forward.model import Model, evaluation
from calibration.problem import OFFSETS
from calibration.search.refinement import End
from calibration.solver_budget import budget


class _Error(NamedTuple):
    """An error of a sensor: its unit, the amplitude that is called large, and the nuisance that fits it."""

    unit: str
    most: float
    nuisance: str


# Of itself.
GAIN = 0.01
# Its amplitude is 1/w^2.
_RESONANCE = "resonance"
_SENSOR = {
    "gain": _Error("of itself", GAIN, "gain"),
    "bend of the gain": _Error("of the peak, at the peak", 0.05, "gain_bend"),
    "lag": _Error("of a contact's duration", 0.1, "bandwidth"),
    _RESONANCE: _Error("of a contact's duration squared", 0.01, "resonance"),
    "drift": _Error("of the peak, over the record", 0.05, "drift"),
    "rest": _Error("of the peak", 0.02, "force_offset"),
    "clock": _Error("of the time between samples", 0.5, "time_offset"),
}
# Step of a fixed value as a share of its tolerance, which is this share of it where none is stated.
_STEP, _SHARE = 1e-2, 0.01
# A share of the peak that is called a large error of the law.
_LAW = 0.05
# Constants, which are known.
_KNOWN = ("gravity",)
# An error that moves no estimate by more than this share is not named.
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

    @property
    def limit(self) -> str:
        """The amplitude in words; of a resonance the frequency."""
        if self.error == _RESONANCE:
            return f"{1.0 / (2.0 * np.pi * np.sqrt(self.amplitude)):.2g} oscillations in a contact's duration"
        return f"{100 * self.amplitude:.2g} % {self.unit}"


class Budget(NamedTuple):
    """Every line, and all errors together.

    Attributes:
        corrections, deviations: (C, K) what would take the errors out of each estimate, on average, and the deviation
            about it, SI or as a share, of every combination of errors of which there is one at most.
    """

    lines: list[Line]
    names: tuple[str, ...]
    corrections: np.ndarray
    deviations: np.ndarray

    def widened(self, name: str, half: float) -> tuple[float, float]:
        """How far an interval of a half width reaches below and above the estimate, with the errors allowed for.

        It holds the estimate as it is and as corrected.
        """
        k = self.names.index(name)
        away = np.hypot(half, _QUANTILE * self.deviations[:, k])
        moved = self.corrections[:, k]
        return float(np.max(away - np.minimum(moved, 0.0))), float(np.max(away + np.maximum(moved, 0.0)))


class Error(NamedTuple):
    """One error: its signature (N,) in deviations of the noise, a unit of it, and the amplitude that is called large."""

    name: str
    unit: str
    most: float
    signature: np.ndarray


class Moving(NamedTuple):
    """What errors move: names, how each moves with the unit box (K, P), and what a move is a share of (K,)."""

    names: tuple[str, ...]
    slopes: np.ndarray
    sizes: np.ndarray


def budget_of(at: Optimum, errors: list[Error], moving: Moving, alone: Sequence[Collection[str]] = ()) -> Budget:
    """Every line, and all together.

    Args:
        at: the optimum, whose covariance is known.
        alone: groups of names of which there is one error at most; for each estimate those that move it most.
    """
    (names, slopes, sizes), best = moving, at.end
    psi, bend = influence(at.model.loss, best.residuals)
    # Least squares over these rows is a step of the robust loss.
    root = np.sqrt(np.maximum(bend, 1e-3))
    residuals = psi / root
    basis, triangle = np.linalg.qr(root[:, None] * best.jacobian)
    variance = max(1.0, float(residuals @ residuals) / max(at.spread.freedom, 1))
    lines: dict[str, Line] = {}
    columns: dict[str, np.ndarray] = {}
    for error in errors:
        signature = root * error.signature
        beside = signature - basis @ (basis.T @ signature)
        length = float(np.linalg.norm(beside))
        seen = abs(float(beside @ residuals)) / length + _QUANTILE * np.sqrt(variance) if length > 0 else np.inf
        amplitude = min(seen / max(length, 1e-300), error.most)
        moves = amplitude * np.abs(slopes @ np.linalg.solve(triangle, basis.T @ signature))
        if np.max(moves / sizes) > _NAMED:
            lines[error.name] = Line(error.name, amplitude, error.unit, dict(zip(names, moves.tolist(), strict=True)))
            columns[error.name] = signature * (error.most / _QUANTILE)
    corrections, deviations = [np.zeros(len(names))], [np.zeros(len(names))]
    common = [name for name in lines if not any(name in group for group in alone)]
    groups = [own for group in alone if (own := [name for name in lines if name in group])]
    for one_of_each in itertools.product(*groups):
        chosen = [*common, *one_of_each]
        if not chosen:
            continue
        signatures = np.stack([columns[name] for name in chosen], axis=1)
        beside = signatures - basis @ (basis.T @ signatures)
        narrowed = np.linalg.inv(beside.T @ beside / variance + np.eye(len(chosen)))
        way = slopes @ np.linalg.solve(triangle, basis.T @ signatures)
        corrections.append(way @ narrowed @ (beside.T @ residuals) / variance)
        deviations.append(np.sqrt(np.einsum("ij,jk,ik->i", way, narrowed, way)))
    return Budget(list(lines.values()), names, np.stack(corrections), np.stack(deviations))


def of_sensor(model: Model, readings: np.ndarray, series: list[Series], stated: frozenset[str]) -> list[Error]:
    """Errors of the sensor, but for what is fitted and what is ``stated`` of every record.

    Args:
        readings: (E, C, T) that the model predicts, SI.
        stated: names of nuisances.
    """
    taken = {axis.name for axis in model.coordinates} | stated
    taken |= {"force_offset"} if taken & set(OFFSETS.values()) else set()
    return [
        Error(name, _SENSOR[name].unit, _SENSOR[name].most, signature)
        for name, signature in _signatures(model, readings, series).items()
        if np.any(signature) and _SENSOR[name].nuisance not in taken
    ]


def of_fixed(model: Model, best: End, tolerances: dict[str, np.ndarray], stated: frozenset[str]) -> list[Error]:
    """Errors of scene parameters that were held fixed, and of nuisances that were ``stated``, by runs with a little of each.

    Of a rough cost only those with a stated tolerance: a motion of the joint costs seconds each.

    Args:
        tolerances: by name (E,), SI, where they were stated.
    """
    point, found = np.asarray(best.point)[None], []
    free = {axis.name for axis in model.coordinates}
    plain = evaluation(model)(point).residuals[0]
    every = [("fixed", name) for name in model.data.fixed] + [
        ("chain", name) for name in model.data.chain if name in stated
    ]
    for table, name in every:
        own, known = np.asarray(getattr(model.data, table)[name], dtype=float), tolerances.get(name)
        if name in free or name in _KNOWN or (known is None and budget(model.scene).rough):
            continue
        tolerance = _SHARE * np.abs(own) if known is None else known
        if not np.any(tolerance):
            continue
        moved = eqx.tree_at(lambda m, t=table, n=name: getattr(m.data, t)[n], model, own + _STEP * tolerance)
        change = (evaluation(moved)(point).residuals[0] - plain) / _STEP
        if np.isfinite(change).all():
            share = float(np.max(tolerance / np.where(own != 0.0, np.abs(own), np.inf)))
            unit, most = ("of itself", share) if share else ("of its tolerance", 1.0)
            found.append(Error(name, unit, most, change / most))
    return found


def of_weight(model: Model, best: End, series: list[Series]) -> list[Error]:
    """The weight of a body that strikes at a speed, of a scene that knows no gravity: as much of it as may act."""
    known = {axis.name for axis in model.coordinates} | model.data.fixed.keys()
    if "approach_speed" not in known or "gravity" in known or budget(model.scene).rough:
        return []
    return [Error("gravity", f"of {GRAVITY} m/s^2", 1.0, weight(model, series, best.point, GRAVITY))]


def of_law(signatures: dict[str, dict[str, np.ndarray]]) -> list[Error]:
    """Errors of the contact law (``law_errors.signatures``)."""
    every = [item for found in signatures.values() for item in found.items()]
    return [Error(name, "of the peak", _LAW, signature) for name, signature in every]


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
            _RESONANCE: -(duration**2) * np.gradient(first, clock),
            "drift": peak * (clock - clock.mean()) / max(float(np.ptp(clock)), 1e-300),
            "rest": np.full(clock.size, peak),
            "clock": -float(np.median(np.diff(clock))) * first,
        }
        for name, error in errors.items():
            found[name][s.rows] = s.white(error)
    return found
