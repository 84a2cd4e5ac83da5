"""Experiments beside what a point of the search space predicts for them: records, residual series, held-out errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from calibration import judge
from calibration.model import Model, build, make_slots, predictions
from calibration.problem import Experiment, Problem
from calibration.search import End, finish


@dataclass(frozen=True)
class Record:
    """One experiment beside its prediction: times (T,), per channel data, prediction (T,) and sigma [N].

    ``params`` are the scene's parameters and the nuisances that the prediction was made with.
    """

    name: str
    held_out: bool
    times: np.ndarray
    data: dict[str, np.ndarray]
    prediction: dict[str, np.ndarray]
    sigma: dict[str, float]
    params: dict[str, float]


def hold_out(
    problem: Problem, model: Model, best: End, log_depth: float
) -> tuple[dict[str, dict[str, float]], list[Record], float, int]:
    """Predict held-out records: shared parameters as fitted, each record's own nuisances fitted to it.

    Returns:
        Errors by record and channel as fractions of the peak, the records, the sum of squared weighted residuals
        and their degrees of freedom.
    """
    held = tuple(e for e in problem.experiments if e.hold_out)
    values = [float(v) for v in model.values(jnp.asarray(best.point), jnp.asarray(log_depth))]
    shared = {s.name: v for s, v in zip(model.slots, values, strict=True) if s.experiment is None}
    own = tuple(f for f in problem.free if f.per_experiment)
    other = build(replace(problem, free=own or problem.free, params={**problem.params, **shared}), held)
    if own:
        slots = make_slots(replace(problem, free=own), len(held))
        mean = {f.name: np.mean([v for s, v in zip(model.slots, values, strict=True) if s.name == f.name]) for f in own}
        start = other.point(np.array([mean[s.name] for s in slots]), 0.0)
        end = finish(other, start, np.clip(start, 1e-6, 1 - 1e-6), 0.0)
        point, residuals = end.point, end.residuals
    else:
        other = Model(other.scene, (), other.channels, other.data, other.how)
        point, residuals = np.zeros(0), np.asarray(other.residuals(jnp.zeros(0), jnp.asarray(0.0)))
    records = records_of(other, held, point, 0.0, True)
    report = {}
    for record in records:
        for channel, data in record.data.items():
            error, peak = record.prediction[channel] - data, np.nanmax(np.abs(data))
            report[f"{record.name} {channel}"] = {
                "max_error_of_peak": float(np.nanmax(np.abs(error)) / peak),
                "rms_error_of_peak": float(np.sqrt(np.nanmean(error**2)) / peak),
            }
    samples = int(np.count_nonzero(np.asarray(other.data.weights)))
    return report, records, float(np.sum(residuals**2)), samples - point.size


def records_of(
    model: Model, experiments: tuple[Experiment, ...], point: np.ndarray, log_depth: float, held_out: bool
) -> list[Record]:
    """Every experiment beside the prediction made at a point."""
    predicted = np.asarray(predictions(model, jnp.asarray(point), jnp.asarray(log_depth)))
    values = [float(v) for v in model.values(jnp.asarray(point), jnp.asarray(log_depth))]
    weights = np.asarray(model.data.weights)
    records = []
    for i, experiment in enumerate(experiments):
        count = experiment.times.size
        own = {c.observes: (model.channels.index(c.observes), c.values) for c in experiment.channels}
        params = {"time_offset": 0.0, "force_offset": 0.0, "gain": 1.0}
        params |= {name: float(v[i]) for name, v in model.data.fixed.items()}
        params |= {s.name: v for s, v in zip(model.slots, values, strict=True) if s.experiment in (None, i)}
        records.append(
            Record(
                name=experiment.name,
                held_out=held_out,
                times=experiment.times,
                data={name: values for name, (_, values) in own.items()},
                prediction={name: predicted[i, j, :count] for name, (j, _) in own.items()},
                sigma={name: 1.0 / float(weights[i, j].max()) for name, (j, _) in own.items()},
                params=params,
            )
        )
    return records


def series_of(model: Model, best: End, predicted: np.ndarray) -> list[judge.Series]:
    """Residuals by record and channel; in contact is where the model's force exceeds 2 % of its peak."""
    weights = np.asarray(model.data.weights)
    shaped = best.residuals.reshape(weights.shape)
    series = []
    for i, j in np.argwhere((weights > 0).any(axis=2)):
        seen = weights[i, j] > 0
        force = np.abs(predicted[i, j] - predicted[i, j].min())[seen]
        touching = force > 0.02 * force.max()
        series.append(judge.Series(shaped[i, j][seen], touching, 1.0 / float(weights[i, j].max() * force.max())))
    return series


def rms(records: list[Record]) -> float:
    """Root mean square of prediction less data [N], over all samples."""
    errors = [r.prediction[c] - r.data[c] for r in records for c in r.data]
    return float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))
