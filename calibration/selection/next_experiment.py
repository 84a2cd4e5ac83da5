"""The next experiment: which candidate would shrink which interval most, before anyone makes it.

At the fitted values an experiment adds J^T J to the Fisher information of the data there are, with J the forward-mode
Jacobian of its readings over their noise, here white (linear theory: Atkinson, Donev and Tobias 2007). Parameters of
its own, such as a clock, are unknown in it too and are eliminated. A parameter's bounds count as what is known of it
without data: a uniform density, of deviation 1/sqrt(12) of their width. So a parameter that no data determine has a
finite interval, from which a candidate may shrink it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from bcfj_jax import InputError, check_value, nearest
from bcfj_jax.core.quantities import increasing
from calibration.fit import Fit
from calibration.forward.model import Model, build, predictions, residuals_and_jacobian
from calibration.noise import noise_model
from calibration.problem import Channel, Experiment, Problem
from calibration.selection.narrowed import Half, narrowed

_UNIFORM = 12.0  # information of a uniform density on [0, 1]


@dataclass(frozen=True)
class Candidate:
    """An experiment that might be made.

    Attributes:
        times: (T,) [s] at which it would be read.
        noise: deviation, SI, by channel ("contact.normal"), or as a share of its predicted peak where ``share``.
        fixed: scene parameters (and nuisances) that make it: known, or where every experiment has its own to be found,
            the value it would have.
        share: whether ``noise`` is a share of the peak.
        runs: how many of them.
        instrument: what would be known of the sensors, as in a calibration file; without times and noise nothing else.
    """

    name: str
    times: np.ndarray
    noise: dict[str, float]
    fixed: dict[str, float] = field(default_factory=dict)
    share: bool = False
    runs: int = 1
    instrument: dict[str, Any] = field(default_factory=dict)

    @property
    def made(self) -> bool:
        """Whether it is an experiment, not knowledge alone."""
        return bool(self.noise) or not self.instrument


class Gain(NamedTuple):
    """What a candidate would bring, for the parameters that all experiments share."""

    name: str
    # D-optimality, the information gained [nats]: half the logarithm of the ratio of the determinants of the
    # covariances before and after.
    information: float
    variance_left: float  # A-optimality, the mean over parameters of the variance after over that before
    shrink: dict[str, float]  # width of each parameter's interval after over that before, by name; by the noise alone
    failure: str = ""
    quoted: dict[str, Half] = {}  # half widths of the interval to quote, now and then (``narrowed``)

    @property
    def best(self) -> str:
        """The parameter whose interval it shrinks most."""
        return min(self.shrink, key=lambda name: self.shrink[name]) if self.shrink else ""


def next_experiment(problem: Problem, fit: Fit, candidates: Sequence[Candidate]) -> list[Gain]:
    """Candidates ranked by the information they would add to a fit (D-optimality), best first.

    Args:
        fit: its outcome; only the values count.

    Raises:
        InputError: for no candidate, an unknown parameter, channel or value, or no parameter that experiments share.
    """
    gains = predicted(problem, {name: p.value for name, p in fit.parameters.items()}, candidates)
    by_name = {c.name: c for c in candidates}
    return [gain if gain.failure else gain._replace(quoted=_quoted(problem, fit, by_name[gain.name])) for gain in gains]


def _known(problem: Problem, candidate: Candidate) -> dict[str, float]:
    """What a candidate sets, but for what every experiment has to itself."""
    each = {f.name for f in problem.free if f.per_experiment}
    return {name: value for name, value in candidate.fixed.items() if name not in each}


def _quoted(problem: Problem, fit: Fit, candidate: Candidate) -> dict[str, Half]:
    known = _known(problem, candidate)
    if known.keys() & {f.name for f in problem.free}:
        return {}
    planned = _planned(problem, candidate, known) if candidate.made else None
    return narrowed(problem, fit, planned, candidate.runs, candidate.instrument)


def predicted(problem: Problem, values: Mapping[str, float], candidates: Sequence[Candidate]) -> list[Gain]:
    """As ``next_experiment``, at values [SI] by the names that a fit gives its parameters."""
    if not candidates:
        raise InputError("candidates", "none", "give one or more experiments that might be made")
    fitted = problem.fitted
    model = build(problem, fitted)
    own = np.array([values[axis.label(fitted)] for axis in model.coordinates])
    point = model.point(own)
    if not noise_model.known(fitted):
        model, _ = noise_model.estimate(model, fitted, point)
    shared = [i for i, axis in enumerate(model.coordinates) if axis.experiment is None]
    if not shared:
        raise InputError(problem.where, "no parameter is shared by the experiments", "free one without each = true")
    slopes = residuals_and_jacobian(model, point)[1]
    # Covariance of what is shared, the others unknown, with the information of the bounds.
    before = np.linalg.inv(slopes.T @ slopes + _UNIFORM * np.eye(point.size))[np.ix_(shared, shared)]
    names = [model.coordinates[i].name for i in shared]
    gains = [_gain(problem, model, own, c, before, names) for c in candidates]
    return sorted(gains, key=lambda gain: -gain.information if not gain.failure else np.inf)


def table(gains: Sequence[Gain]) -> list[list[str]]:
    """The ranking, a row a candidate: for a terminal or a report."""
    names = next((list(gain.shrink) for gain in gains if gain.shrink), [])
    rows = [["candidate", "information [nats]", "mean variance left", *(f"interval of {name}" for name in names)]]
    for gain in gains:
        cells = [gain.failure, *([""] * (1 + len(names)))]
        if not gain.failure:
            widths = [f"{gain.shrink[name]:.0%}" + (" *" if name == gain.best else "") for name in names]
            cells = [f"{gain.information:.3g}", f"{gain.variance_left:.0%}", *widths]
        rows.append([gain.name, *cells])
    return rows


def said(gains: Sequence[Gain]) -> list[str]:
    """What each candidate would make of the intervals to quote, in a sentence each."""
    told = [
        (g.name, [f"{name} {half.said}" for name, half in g.quoted.items() if half.said]) for g in gains if g.quoted
    ]
    return [f"{name}: {', '.join(parts) or 'no change'}" for name, parts in told]


def as_json(gains: Sequence[Gain]) -> list[dict[str, object]]:
    """``next_experiment`` of fit.json: ranked, best first."""
    return [
        {
            "name": gain.name,
            "information_nats": None if gain.failure else gain.information,
            "mean_variance_left": None if gain.failure else gain.variance_left,
            "interval_left": gain.shrink,
            "shrinks_most": gain.best or None,
            "failure": gain.failure or None,
            "quoted": {name: half._asdict() for name, half in gain.quoted.items()},
        }
        for gain in gains
    ]


def _gain(
    problem: Problem, model: Model, values: np.ndarray, candidate: Candidate, before: np.ndarray, names: list[str]
) -> Gain:
    # Of a parameter that every experiment has to itself the candidate's is unknown, about the value it would have.
    known = _known(problem, candidate)
    free = tuple(f for f in problem.free if f.name not in known)
    if not candidate.made or all(f.per_experiment for f in free):
        return Gain(candidate.name, 0.0, 1.0, dict.fromkeys(names, 1.0))
    planned = _planned(problem, candidate, known)
    other = build(replace(problem, free=free), (planned,))
    pairs = [(axis.name, value) for axis, value in zip(model.coordinates, values, strict=True)]
    usual = {name: float(np.mean([v for n, v in pairs if n == name])) for name, _ in pairs}
    if any("time_offset" in e.bounds for e in problem.experiments):  # Of clocks of their own there is no usual one.
        usual["time_offset"] = 0.0
    nominal = {**usual, **candidate.fixed}
    point = other.point(np.array([nominal[axis.name] for axis in other.coordinates]))
    if candidate.share:
        other = _absolute(other, planned, point)
    residuals, jacobian = residuals_and_jacobian(other, point)
    if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
        return Gain(candidate.name, float("nan"), float("nan"), {}, "its simulation fails")
    mine = [k for k, axis in enumerate(other.coordinates) if axis.experiment is None]
    theirs = [k for k, axis in enumerate(other.coordinates) if axis.experiment is not None]
    slopes, own = jacobian[:, mine], jacobian[:, theirs]
    seen = slopes.T @ slopes
    seen -= slopes.T @ own @ np.linalg.solve(own.T @ own + _UNIFORM * np.eye(len(theirs)), own.T @ slopes)
    seen *= candidate.runs
    # Before J^T J + 12, with the candidate more: both at the same coordinates, whose boxes are the problem's.
    after = np.linalg.inv(before)
    places = [names.index(other.coordinates[k].name) for k in mine]
    after[np.ix_(places, places)] += seen
    left = np.linalg.inv(after)
    ratios = np.diag(left) / np.diag(before)
    information = 0.5 * float(np.linalg.slogdet(before)[1] - np.linalg.slogdet(left)[1])
    shrink = {name: float(np.sqrt(ratio)) for name, ratio in zip(names, ratios, strict=True)}
    return Gain(candidate.name, information, float(np.mean(ratios)), shrink)


def _planned(problem: Problem, candidate: Candidate, known: dict[str, float]) -> Experiment:
    """The candidate as an experiment without readings of its own, refused as a problem refuses experiments."""
    where = f"{problem.where}: candidate '{candidate.name}'"
    quantities = problem.quantities
    for name, value in candidate.fixed.items():
        if name not in quantities:
            raise InputError(where, f"no parameter '{name}'", nearest(name, quantities))
        check_value(where, quantities[name], value)
    if not candidate.noise or not all(0 < sigma < np.inf for sigma in candidate.noise.values()):
        raise InputError(where, f"noise {candidate.noise}", "give every channel that it would read a deviation above 0")
    times = increasing(candidate.times)
    channels = tuple(Channel(observes, np.zeros(times.size), sigma) for observes, sigma in candidate.noise.items())
    planned = Experiment(candidate.name, times, channels, fixed=known, source=where)
    free = tuple(f for f in problem.free if f.name not in known)
    replace(problem, free=free, experiments=(*problem.experiments, replace(planned, hold_out=True)))
    return planned


def _absolute(model: Model, planned: Experiment, point: np.ndarray) -> Model:
    """The model with noise that is a share of each channel's predicted peak."""
    read = predictions(model, point)[0]
    shares = np.array([channel.sigma for channel in planned.channels], dtype=float)
    sigma = shares * np.maximum(np.max(np.abs(read), axis=1), 1e-300)
    weights = np.broadcast_to(1.0 / sigma[None, :, None], model.data.weights.shape)
    return eqx.tree_at(lambda m: m.data.weights, model, weights)
