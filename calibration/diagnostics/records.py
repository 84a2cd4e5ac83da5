"""Experiments beside what a point of the search space predicts for them: records, residual series, held-out errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bcfj_jax.mechanism.channels import unit_of
from calibration.diagnostics import fit_tests
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.forward import integration
from calibration.forward.model import Model, build, predictions, residuals_and_jacobian
from calibration.forward.runs import Contact, of_contacts, together
from calibration.noise.noise_model import OUTLYING, Estimate
from calibration.problem import Experiment, Problem, size, units_of
from calibration.search.refinement import trust_region

# Share of a record's peak from which on a force is said to act.
_ACTING = 0.05


@dataclass(frozen=True)
class Record:
    """One experiment beside its prediction: times (T,), per channel data, prediction (T,) and sigma, SI.

    ``params`` are the scene's parameters and the nuisances that the prediction was made with.
    """

    name: str
    held_out: bool
    times: np.ndarray
    data: dict[str, np.ndarray]
    prediction: dict[str, np.ndarray]
    sigma: dict[str, float]
    params: dict[str, float]


def hold_out(problem: Problem, at: Optimum) -> tuple[dict[str, dict[str, float]], list[Record], fit_tests.Test]:
    """Predict held-out records: shared parameters as fitted, each record's own nuisances fitted to it.

    The test allows for the uncertainty C of the shared parameters: with own nuisances projected out, residuals r have the
    covariance 1 + K C K^T, K their Jacobian, and r^T (1 + K C K^T)^-1 r = |r|^2 - (K^T r)^T (C^-1 + K^T K)^-1 K^T r.

    Returns:
        Errors by record and channel as fractions of the peak, the rms of a force over the samples where it acts; the records;
        and the test.
    """
    model, best, quality = at.model, at.end, at.spread
    held = tuple(with_noise(e, at.noise) for e in problem.experiments if e.hold_out)
    other = build(problem, held).at_depth(model.log_depth)
    shared = sum(s.experiment is None for s in model.coordinates)
    names = np.array([s.name for s in model.coordinates])
    own = np.array([np.mean(best.point[names == s.name]) for s in other.coordinates[shared:]])
    point = _own_fitted(other, np.concatenate([best.point[:shared], own]), shared)
    records = records_of(other, held, point, True)
    report = {}
    for record in records:
        for channel, data in record.data.items():
            error, peak = record.prediction[channel] - data, size(channel, data)
            rated = _rated(channel, data, record.prediction[channel], peak)
            report[f"{record.name} {channel}"] = {
                "max_error_of_peak": float(np.nanmax(np.abs(error)) / peak),
                "rms_error_of_peak": float(np.sqrt(np.nanmean(error[rated] ** 2)) / peak),
            }
    residuals, jacobian = residuals_and_jacobian(other, point)
    if other.loss != "linear":  # outliers were allowed for
        residuals, jacobian = (np.where(np.abs(residuals) < OUTLYING, a.T, 0.0).T for a in (residuals, jacobian))
    basis = np.linalg.qr(jacobian[:, shared:])[0]
    free, through = (a - basis @ (basis.T @ a) for a in (residuals, jacobian[:, :shared]))
    square = float(free @ free)
    if quality.covariance is not None and shared:
        push = through.T @ free
        doubt = np.linalg.inv(quality.covariance[:shared, :shared]) + through.T @ through
        square -= float(push @ np.linalg.solve(doubt, push))
    freedom = sum(e.samples for e in held) - len(other.coordinates) + shared
    return report, records, fit_tests.held_out_test(square, freedom, quality)


def _rated(channel: str, data: np.ndarray, predicted: np.ndarray, peak: float) -> np.ndarray:
    """Samples (T,) that an error is rated by: of a force where it or its prediction is over a share of the peak."""
    acting = np.fmax(np.abs(data), np.abs(predicted)) > _ACTING * peak
    return acting if unit_of(channel) == "N" and acting.any() else np.isfinite(data)


def with_noise(experiment: Experiment, noise: Estimate) -> Experiment:
    """A record with the noise estimated from others, where its own is not stated."""
    channels = []
    for c in experiment.channels:
        sigma = noise.sigma[c.observes] if c.sigma is None else c.sigma
        correlation = noise.correlation.get(c.observes, 0.0) if c.correlation is None else c.correlation
        channels.append(replace(c, sigma=sigma, correlation=correlation))
    return replace(experiment, channels=tuple(channels))


def _own_fitted(model: Model, point: np.ndarray, shared: int) -> np.ndarray:
    """The point with the coordinates beyond the shared ones fitted to the data."""
    if shared == point.size:
        return point

    def evaluate(own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals, jacobian = residuals_and_jacobian(model, np.concatenate([point[:shared], own]))
        return residuals, jacobian[:, shared:]

    found = trust_region(evaluate, np.clip(point[shared:], 1e-6, 1 - 1e-6), loss=model.loss)
    return np.concatenate([point[:shared], found.point])


def records_of(model: Model, experiments: tuple[Experiment, ...], point: np.ndarray, held_out: bool) -> list[Record]:
    """Every experiment beside the prediction made at a point."""
    predicted, values = predictions(model, point), model.values(point).tolist()
    weights = np.asarray(model.data.weights)
    records = []
    for i, experiment in enumerate(experiments):
        count = experiment.times.size
        own = {c.observes: (model.channels.index(c.observes), c.values) for c in experiment.channels}
        params = {name: float(v[i]) for known in (model.data.chain, model.data.fixed) for name, v in known.items()}
        params |= {s.name: v for s, v in zip(model.coordinates, values, strict=True) if s.experiment in (None, i)}
        data = {name: values for name, (_, values) in own.items()}
        prediction = {name: predicted[i, j, :count] for name, (j, _) in own.items()}
        kept = {name: weights[i, j][weights[i, j] > 0] for name, (j, _) in own.items()}
        sigma = {name: float(np.sqrt(np.mean(w**-2.0))) for name, w in kept.items()}
        records.append(Record(experiment.name, held_out, experiment.times, data, prediction, sigma, params))
    return records


def series_of(at: Optimum, seen: list[Contact], errors: np.ndarray, accuracy: float) -> list[Series]:
    """Residuals by record and channel: their places, and whether the model's contact touches at each of them.

    Of a fit that is not of contacts every sample counts as one in contact.

    Args:
        errors: (N,) the integrator's part in the residuals.
    """
    model, noise, residuals, everywhere = at.model, at.noise, at.end.residuals, not of_contacts(at.model)
    weights, values, shape = np.asarray(model.data.weights), np.asarray(model.data.values), model.data.weights.shape
    series = []
    for i, experiment in enumerate(at.experiments):
        for channel in experiment.channels:
            j = model.channels.index(channel.observes)
            own = np.flatnonzero(weights[i, j] > 0)
            clock, contacts = np.asarray(model.data.times)[i, own], [c for c in seen if c.experiment == i]
            touching, longest = np.full(own.size, everywhere), np.inf
            if everywhere:
                longest = _half_a_wave(experiment.times, channel.values)
            # A body feels every contact.
            elif felt := [c for c in contacts if c.name == channel.observes.partition(".")[0]] or contacts:
                mine = together(felt)
                touching = np.interp(clock - mine.offset, mine.times, mine.touching.astype(float), left=0.0) >= 0.5
                longest = float(mine.durations.max()) if mine.durations.size else np.inf
            memory = noise.correlation.get(channel.observes) if channel.correlation is None else channel.correlation
            peak = size(channel.observes, values[i, j, own])
            rows = np.ravel_multi_index((np.full(own.size, i), np.full(own.size, j), own), shape)
            # A flight before contact has a deviation of its own.
            least = float(weights[i, j, own[int(np.argmax(touching)) :]].max()) if own.size else 0.0
            share = 1.0 / (least * peak) if peak > 0 else 0.0
            solvers = channel.observes in noise.integrator
            solvers = solvers or integration.own(residuals[rows], errors[rows], accuracy, 1.0 / share if share else 0.0)
            series.append(Series(
                rows, touching, share, longest, memory=float(memory or 0.0), declared=channel.correlation != 0.0,
                estimated=channel.sigma is None, integrator=solvers, clock=clock, values=values[i, j, own],
                weights=weights[i, j, own],
            ))  # fmt: skip
    return series


def _half_a_wave(times: np.ndarray, values: np.ndarray) -> float:
    """What takes the place of a contact's duration where none has a part: pi rms(f)/rms(f'), half the period of a wave [s]."""
    seen = np.isfinite(values)
    if np.count_nonzero(seen) < 3:
        return np.inf
    steep = float(np.sqrt(np.mean(np.gradient(values[seen], times[seen]) ** 2)))
    wave = np.pi * float(np.sqrt(np.mean(values[seen] ** 2))) / steep if steep > 0.0 else np.inf
    return min(wave, float(np.ptp(times[seen])))


def features_of(
    model: Model, experiments: tuple[Experiment, ...], residuals: np.ndarray
) -> dict[str, dict[str, float]]:
    """Every feature as measured and as fitted (SI), from the fit's residuals (N,)."""
    own = residuals[model.data.values.size :].reshape(model.data.features.shape)
    every = [(e.name, seen, float(own[i, k])) for i, e in enumerate(experiments) for k, seen in enumerate(e.features)]
    return {
        f"{name} {seen.feature}": {"measured": seen.value, "fitted": seen.value + x * seen.sigma, "sigma": seen.sigma}
        for name, seen, x in every
    }


def rms(records: list[Record]) -> dict[str, float]:
    """Root mean square of prediction less data by SI unit, over all samples; none where features alone were fitted."""
    seen = [(c, r.prediction[c] - r.data[c]) for r in records for c in r.data]
    return {
        unit: float(np.sqrt(np.nanmean(np.concatenate([e for c, e in seen if c in names]) ** 2)))
        for unit, names in units_of(c for c, _ in seen).items()
    }


def rms_of_peak(records: list[Record]) -> float:
    """Root mean square of prediction less data as a share of each history's peak; 0 where there is none."""
    shares = [(r.prediction[c] - r.data[c]) / size(c, r.data[c]) for r in records for c in r.data]
    return float(np.sqrt(np.nanmean(np.concatenate(shares) ** 2))) if shares else 0.0
