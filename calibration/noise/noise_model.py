"""The noise that residuals show: deviations by channel and correlation times, by restricted maximum likelihood (REML).

With weighted residuals r, their Jacobian J and the projection M = 1 - J (J^T J)^-1 J^T, a channel's deviation obeys
sigma^2 = |M r|^2 / (n - leverage) over its own samples: with one channel, cost over degrees of freedom. A correlation
time minimises the restricted likelihood, the deviations following. Noise that grows with the reading is taken at the
model's reading, so that what was measured does not weigh itself. Records whose errors scatter differently by more than a
factor of three have their deviations in that ratio. So have rows of a body in flight and those after its first contact: a
first state that is free moves the former, and no coordinate of the law does. What the law misses would else move that
state. A deviation that is no larger than the integrator's error (``integration.Limit``) is not noise that was seen.
Nothing here searches: the model is linear about a point.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.optimize import minimize_scalar

from calibration.forward.integration import Limit
from calibration.forward.model import Model, evaluation
from calibration.noise.scatter import scatter
from calibration.problem import NUISANCES, Channel, Experiment

# Beyond so many deviations a sample is no noise to a robust loss.
OUTLYING = 4.0
_LEAST_CORRELATION = 0.02
# Deviations of records that differ by more are not one; errors of which less is scatter show a miss, not the noise.
_APART, _WHITE = 3.0, 0.2
# A coordinate moves a row that has more than this share of its largest slope; fewer rows of flight, less their first states,
# do not tell their deviation, nor is it a smaller share of the others'.
_MOVES, _FEW, _LEAST = 1e-6, 8, 1e-2


class Estimate(NamedTuple):
    """What was found of the noise."""

    # sigma, correlation: deviation, SI, and time [s], by channel whose noise, or correlation, is estimated.
    sigma: dict[str, float]
    correlation: dict[str, float]
    # For each of these numbers, the derivative (P, P) of the information matrix by its logarithm, and the variance of
    # that.
    moved: list[tuple[np.ndarray, float]]
    # Channels whose residuals are no larger than the integrator's error, which stands for their noise.
    integrator: tuple[str, ...] = ()


class _Series(NamedTuple):
    """Samples of one experiment and channel: places, errors (n,), SI, their Jacobian (n, P), base deviations."""

    place: tuple[int, int]
    channel: Channel
    samples: np.ndarray
    gaps: np.ndarray
    error: np.ndarray
    jacobian: np.ndarray
    deviation: np.ndarray


class _Rows(NamedTuple):
    """White residuals, their Jacobian, which series each row is of, and the sum of the deviations' logarithms."""

    residual: np.ndarray
    jacobian: np.ndarray
    owner: np.ndarray
    log_volume: float


def known(experiments: tuple[Experiment, ...]) -> bool:
    """Whether no noise is estimated or depends on the model's reading."""
    channels = [c for e in experiments for c in e.channels]
    return not any(c.sigma is None or c.relative or c.jitter or c.correlation is None for c in channels)


def estimate(
    model: Model, experiments: tuple[Experiment, ...], point: np.ndarray, limits: dict[str, Limit] | None = None
) -> tuple[Model, Estimate]:
    """The noise about a point, and the model with weights and memory that follow from it.

    Args:
        limits: of the channels, below which a deviation is the integrator's; none where not given.
    """
    limits = limits or {}
    series, rest = _series(model, experiments, point)
    sigma = {s.channel.observes: 0.0 for s in series if s.channel.sigma is None}
    for name in sigma:
        own = np.concatenate([s.error for s in series if s.channel.sigma is None and s.channel.observes == name])
        sigma[name] = 1.4826 * float(np.median(np.abs(own))) if model.loss != "linear" else float(np.std(own))
        sigma[name] = max(sigma[name], 1e-12 * float(np.max(np.abs(own), initial=1.0)), 1e-300)
    times = {s.channel.observes: 0.0 for s in series if s.channel.correlation is None}
    robust = model.loss != "linear"
    for name in times:
        own = [s for s in series if s.channel.observes == name and s.channel.correlation is None]
        shortest, longest = min(np.min(s.gaps) for s in own), max(np.sum(s.gaps) for s in own)

        def criterion(log_time: float, name: str = name) -> float:
            tried = {**times, name: float(np.exp(log_time))}
            return _restricted(_converged(series, rest, sigma, tried, robust, limits)[1])

        bounds = float(np.log(0.2 * shortest)), float(np.log(longest))
        found = minimize_scalar(criterion, bounds=bounds, method="bounded", options={"xatol": 1e-4})
        memory = np.exp(-shortest / np.exp(found.x))
        times[name] = float(np.exp(found.x)) if memory > _LEAST_CORRELATION else 0.0
    sigma, rows = _converged(series, rest, sigma, times, robust, limits)
    integrator = tuple(name for name in sigma if name in limits and sigma[name] == limits[name].sigma)
    seen = {name: value for name, value in sigma.items() if name not in integrator}
    result = Estimate(sigma, times, _moved(series, rows, seen, sigma, times, rest), integrator)
    return _reweighed(model, series, sigma, times), result


def _series(
    model: Model, experiments: tuple[Experiment, ...], point: np.ndarray
) -> tuple[list[_Series], tuple[np.ndarray, np.ndarray]]:
    """Series of plain errors, and the weighted residuals of features with their Jacobian."""
    d = model.data
    plain = eqx.tree_at(
        lambda m: (m.data.weights, m.data.memory), model, (np.where(d.weights > 0, 1.0, 0.0), np.zeros_like(d.memory))
    )
    errors, jacobian, read = (part[0] for part in evaluation(plain)(np.asarray(point)[None]))
    shape = read.shape
    shaped, slopes = errors[: read.size].reshape(shape), jacobian[: read.size].reshape(*shape, -1)
    found = []
    for i, experiment in enumerate(experiments):
        for channel in experiment.channels:
            j = model.channels.index(channel.observes)
            own = np.flatnonzero(np.isfinite(channel.values))
            gaps = np.diff(experiment.times[own])
            at = read[i, j, own], experiment.times[own]
            deviation = np.ones(own.size) if channel.sigma is None else channel.deviation(*at)
            found.append(_Series((i, j), channel, own, gaps, shaped[i, j, own], slopes[i, j, own], deviation))
    for name in {s.channel.observes for s in found if s.channel.sigma is None}:
        mine = [k for k, s in enumerate(found) if s.channel.sigma is None and s.channel.observes == name]
        flying = [_flying(model, found[k].jacobian) for k in mine]
        share = _in_flight([found[k] for k in mine], flying)
        for k, rows, ratio in zip(mine, flying, _ratios([found[k].error for k in mine]), strict=True):
            found[k] = found[k]._replace(deviation=found[k].deviation * np.where(rows, ratio * share, ratio))
    return found, (errors[read.size :], jacobian[read.size :])


def _flying(model: Model, jacobian: np.ndarray) -> np.ndarray:
    """Rows (n,) before the first that a shared coordinate moves, of those that a record's own first state does."""
    size = np.abs(jacobian)
    moved = size > _MOVES * size.max(axis=0, initial=0.0)
    shared = np.array([axis.experiment is None for axis in model.coordinates], dtype=bool)
    state = np.array([axis.experiment is not None and axis.name not in NUISANCES for axis in model.coordinates], bool)
    before = ~np.logical_or.accumulate(moved[:, shared].any(axis=1))
    return before & moved[:, state].any(axis=1)


def _in_flight(series: list[_Series], flying: list[np.ndarray]) -> float:
    """Deviation of a channel in flight, about the first states that suit the flights best, over that of the other rows; 1
    where they do not clearly differ.
    """
    left, freedom = 0.0, 0
    for s, rows in zip(series, flying, strict=True):
        basis, singular, _ = np.linalg.svd(s.jacobian[rows], full_matrices=False)
        basis = basis[:, singular > 1e-10 * singular.max(initial=0.0)]
        rest = s.error[rows] - basis @ (basis.T @ s.error[rows])
        left, freedom = left + float(rest @ rest), freedom + rest.size - basis.shape[1]
    others = np.concatenate([s.error[~rows] for s, rows in zip(series, flying, strict=True)])
    if freedom < _FEW or not others.size:
        return 1.0
    share = float(np.sqrt(left / freedom / max(np.mean(others**2), 1e-300)))
    return max(share, _LEAST) if share * _APART < 1.0 else 1.0


def _ratios(errors: list[np.ndarray]) -> np.ndarray:
    """Deviations of records over their geometric mean, where they clearly differ and are what errors are made of; else 1."""
    each, size = np.array([scatter(e) for e in errors]), np.array([float(np.std(e)) for e in errors])
    if np.any(each <= _WHITE * size) or not np.all(each > 0) or each.max() < _APART * each.min():
        return np.ones(each.size)
    return each / np.exp(np.mean(np.log(each)))


def _deviation(s: _Series, sigma: dict[str, float]) -> np.ndarray:
    return s.deviation * (sigma[s.channel.observes] if s.channel.sigma is None else 1.0)


def _memory(s: _Series, times: dict[str, float]) -> np.ndarray:
    """Correlation of each sample with the one before; 0 for the first."""
    own = times[s.channel.observes] if s.channel.correlation is None else s.channel.correlation
    return np.concatenate([[0.0], np.exp(-s.gaps / own) if own else 0.0 * s.gaps])


def _rows(series: list[_Series], rest: tuple, sigma: dict[str, float], times: dict[str, float], robust: bool) -> _Rows:
    parts = []
    for k, s in enumerate(series):
        deviation, memory = _deviation(s, sigma), _memory(s, times)
        shrink = np.sqrt(1.0 - memory**2)
        r, j = s.error / deviation, s.jacobian / deviation[:, None]
        r = (r - memory * np.roll(r, 1)) / shrink
        j = (j - memory[:, None] * np.roll(j, 1, axis=0)) / shrink[:, None]
        keep = np.abs(r) < OUTLYING if robust else np.ones(r.size, dtype=bool)
        parts.append((r[keep], j[keep], np.full(int(keep.sum()), k), np.sum(np.log(deviation * shrink)[keep])))
    parts.append((*rest, np.full(rest[0].size, -1), 0.0))
    residual, jacobian, owner, volume = zip(*parts, strict=True)
    return _Rows(np.concatenate(residual), np.concatenate(jacobian), np.concatenate(owner), float(sum(volume)))


def _projected(rows: _Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M r, the leverage of each row and the singular values of J that are not rounding."""
    left, singular, _ = np.linalg.svd(rows.jacobian, full_matrices=False)
    kept = singular > 1e-10 * singular[0] if singular.size else np.zeros(0, dtype=bool)
    basis = left[:, kept]
    return rows.residual - basis @ (basis.T @ rows.residual), np.sum(basis**2, axis=1), singular[kept]


def _converged(
    series: list[_Series],
    rest: tuple,
    sigma: dict[str, float],
    times: dict[str, float],
    robust: bool,
    limits: dict[str, Limit],
) -> tuple[dict[str, float], _Rows]:
    """Deviations at the fixed point sigma^2 = |M r|^2/(n - leverage) or at their limits, and the rows there."""
    sigma = dict(sigma)
    rows = _rows(series, rest, sigma, times, robust)
    for _ in range(100):
        if not sigma:
            break
        r, leverage, _ = _projected(rows)
        change = 0.0
        for name, own in _owners(series, rows, sigma):
            freedom = max(np.sum(1.0 - leverage[own]), 1e-9)
            found = sigma[name] * float(np.sqrt(max(np.sum(r[own] ** 2) / freedom, 1e-30)))
            if name in limits and found <= limits[name].below:
                found = limits[name].sigma
            change = max(change, abs(found / sigma[name] - 1.0))
            sigma[name] = found
        rows = _rows(series, rest, sigma, times, robust)
        if change < 1e-9:
            break
    return sigma, rows


def _owners(series: list[_Series], rows: _Rows, names: dict[str, float]) -> Iterator[tuple[str, np.ndarray]]:
    """Rows of each channel whose deviation is estimated."""
    for name in names:
        own = [k for k, s in enumerate(series) if s.channel.sigma is None and s.channel.observes == name]
        yield name, np.isin(rows.owner, own)


def _restricted(rows: _Rows) -> float:
    """Negative logarithm of the restricted likelihood."""
    r, _, singular = _projected(rows)
    return rows.log_volume + 0.5 * float(r @ r) + float(np.sum(np.log(singular)))


def _moved(
    series: list[_Series],
    rows: _Rows,
    seen: dict[str, float],
    sigma: dict[str, float],
    times: dict[str, float],
    rest: tuple,
) -> list[tuple[np.ndarray, float]]:
    _, leverage, _ = _projected(rows)
    moved = []
    for _, own in _owners(series, rows, seen):
        jacobian = rows.jacobian[own]
        moved.append((-2.0 * jacobian.T @ jacobian, 0.5 / max(np.sum(1.0 - leverage[own]), 1.0)))
    for name, time in times.items():
        if not time:
            continue
        own = [k for k, s in enumerate(series) if s.channel.correlation is None and s.channel.observes == name]
        inside = np.isin(rows.owner, own)
        gap = float(np.median(np.concatenate([series[k].gaps for k in own])))
        memory = np.exp(-gap / time)
        informations = []
        # An estimated deviation follows so that the innovation's stays: the two are all but independent then.
        free = series[own[0]].channel.sigma is None
        for step in (-0.05, 0.05):
            tried = _rows(series, rest, sigma, {**times, name: time * np.exp(step)}, robust=False)
            part = tried.jacobian[np.isin(tried.owner, own)]
            later = np.exp(-gap / (time * np.exp(step)))
            informations.append(part.T @ part * ((1.0 - later**2) / (1.0 - memory**2) if free else 1.0))
        freedom = max(np.sum(1.0 - leverage[inside]), 1.0)
        # var(phi) = (1 - phi^2)/n of an autoregression, phi = exp(-gap/time); its deviation, where known, says more of it.
        variance = (1.0 - memory**2) / freedom / (memory * np.log(memory)) ** 2
        variance *= 1.0 if free else (1.0 - memory**2) / (1.0 + memory**2)
        moved.append(((informations[1] - informations[0]) / 0.1, float(variance)))
    return moved


def _reweighed(model: Model, series: list[_Series], sigma: dict[str, float], times: dict[str, float]) -> Model:
    weights, memory = np.array(model.data.weights), np.array(model.data.memory)
    for s in series:
        weights[(*s.place, s.samples)] = 1.0 / _deviation(s, sigma)
        memory[(*s.place, s.samples)] = _memory(s, times)
    return eqx.tree_at(lambda m: (m.data.weights, m.data.memory), model, (weights, memory))
