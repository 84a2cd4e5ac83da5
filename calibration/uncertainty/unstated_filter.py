"""Whether a record tells a low-pass that nobody stated from the law: amplifiers and recorders smooth what they store.

The fit is repeated with low-passes of several kinds, each with its cut-off held at ever lower frequencies and all other
coordinates free; where a filter does little, by one step from the plain fit. With S the sum of squares there and S_min the
least of all, the plain fit among them, a cut-off is not excluded where

    m ln(S / S_min) < 5.99,    m = n (1 - c) / (1 + c),

(95 % of chi-square for two numbers: the cut-off, and which filter), n samples whose residuals at the best fit correlate by c
from one to the next. With all deviations stated, S - S_min takes that place where it is less. What the estimates are at
those cut-offs is one more kind of interval, "filter": the hull of z(f) +- h(f) sqrt(1 - D(f)/5.99), z the estimates, h their
half widths and D the left side above. Where the plain fit itself is excluded by more than 10, a filter is there, or a law that
looks like one: the record does not say which.

The filter works on the predictions of the compiled model, sampled as finely as a contact needs, without its delay, which
the record's clock holds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from scipy.interpolate import interp1d
from scipy.signal import lfilter

from bcfj_jax.io.units import format_si
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series, neighbours
from calibration.filters import Filter
from calibration.forward.model import Model, evaluation
from calibration.problem import Experiment
from calibration.search.refinement import trust_region
from calibration.uncertainty.estimates import Ends, in_si, moving

# Filters that stand for all of order 1 to 8.
FILTERS = (
    Filter("butterworth", 2, True), Filter("butterworth", 4, True), Filter("butterworth", 1, True),
    Filter("butterworth", 8, True), Filter("butterworth", 2), Filter("butterworth", 1), Filter("butterworth", 4),
    Filter("butterworth", 8), Filter("bessel", 4),
)  # fmt: skip
# Cut-offs over a contact's duration, and between two of them so many points.
_FASTEST, _SLOWEST, _RATIO, _BETWEEN = 45.0, 0.2, 2.0**0.5, 4
# Samples that a contact needs, and where the search for slower filters ends.
_SAMPLES, _HOPELESS = 100, 60.0
# Samples of all records together up to which they are made finer; beyond them every second filter stands for all.
_MOST = 6000
ALLOWED, DECISIVE = 5.99, 10.0
# Sum of squares, in deviations of the noise, by which a step may move the predictions that tells the fit with a filter.
_LITTLE = 0.3
# Name of the kind of interval.
KIND = "filter"
# A contact says at least so much of a filter, however residuals correlate.
_FEWEST = 12.0


class Tried(NamedTuple):
    """A fit with one filter, or with none: its cut-off [Hz], unit-box point (P,), sum of squares, residuals and Jacobian."""

    filter: Filter | None
    cutoff: float
    point: np.ndarray
    square: float
    residuals: np.ndarray
    jacobian: np.ndarray


class Read(NamedTuple):
    """What a point (P,) reads without a filter: readings and their derivatives (E, C, T, 1 + P) at every clock."""

    point: np.ndarray
    rows: list[np.ndarray]


class Ambiguity(NamedTuple):
    """What unstated filters make of a fit: the best fit, and D of that without a filter."""

    best: Tried
    plain: float
    # low, high: (K,) ends of the hull, of each coordinate on its scale and, last, of the logarithm of the reference
    # force; infinite where the slowest filter of all is not excluded.
    low: np.ndarray
    high: np.ndarray
    slowest: Tried | None  # of the filters that are not excluded the one with the lowest cut-off; None where all are

    @property
    def decisive(self) -> bool:
        """Whether the record excludes the fit without a filter."""
        return self.plain >= DECISIVE

    def ends(self, k: int, ci95: Ends, log: bool, limits: Any = (-np.inf, np.inf)) -> Ends:
        """Hull of estimate k with the interval that it has, within limits of its coordinate, SI."""
        low, high = np.log(ci95) if log else ci95
        return in_si(min(low, self.low[k]), max(high, self.high[k]), log, limits)


class _Sampled:
    """Predictions of a model and their derivatives, filtered: residuals and Jacobian as the model weighs them."""

    def __init__(self, model: Model, experiments: tuple[Experiment, ...], duration: float) -> None:
        d = model.data
        self.model, self.counts = model, [e.times.size for e in experiments]
        steps = [float(np.median(np.diff(e.times))) for e in experiments if e.times.size > 1]
        wanted = int(np.ceil(_SAMPLES * max(steps) / duration))
        self.parts = max(1, min(wanted, _MOST // sum(self.counts)))
        self.filters = FILTERS if sum(self.counts) <= _MOST else FILTERS[::2]
        self.weights, self.values = np.asarray(d.weights), np.asarray(d.values)
        plain = np.zeros_like(self.values), np.ones_like(self.weights), np.zeros_like(d.memory)
        bare = eqx.tree_at(lambda m: (m.data.values, m.data.weights, m.data.memory), model, plain)
        times = np.asarray(d.times)
        between = np.zeros_like(times)
        for i, count in enumerate(self.counts):
            own = np.diff(times[i, :count])
            between[i, : count - 1], between[i, count - 1] = own, np.median(own)
        self.clocks = [times + between * k / self.parts for k in range(self.parts)]
        # Asked some hundred times: which program each needs is found once.
        self.evaluations = [evaluation(eqx.tree_at(lambda m: m.data.times, bare, clock)) for clock in self.clocks]

    def read(self, point: np.ndarray) -> Read:
        """Readings and their derivatives at a point, at every clock, without a filter."""
        size, rows = self.weights.size, []
        for evaluated in self.evaluations:
            found = evaluated(point[None])
            both = np.concatenate([found.residuals[0][:size, None], found.jacobians[0][:size]], axis=1)
            rows.append(both.reshape(*self.weights.shape, point.size + 1))
        return Read(point, rows)

    def passed(self, rows: list[np.ndarray], passed: Filter, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N,) and their Jacobian (N, P) of what was ``read``; not finite where the simulation failed."""
        size, count, channels = self.weights.size, rows[0].shape[-1], self.weights.shape[1]
        if not all(np.isfinite(row).all() for row in rows):
            return np.full(size, np.nan), np.zeros((size, count - 1))
        read = np.zeros((*self.weights.shape, count))
        for i, own in enumerate(self.counts):
            clock = np.stack([c[i, :own] for c in self.clocks], axis=1).ravel()
            values = np.stack([row[i, :, :own] for row in rows], axis=2).reshape(channels, own * self.parts, -1)
            read[i, :, :own] = _passed(clock, values, self.clocks[0][i, :own], passed, cutoff)
        read[..., 0] -= self.values
        white = np.stack([self.model.data.white(read[..., k]).ravel() for k in range(count)], axis=1)
        return white[:, 0], white[:, 1:]

    def fitted(self, near: Read, passed: Filter, cutoff: float) -> tuple[Tried, Read]:
        """The least squares with a filter, and what is read nearby: by one step from ``near`` where that tells it, else by
        more from there on; the clock is not bound, for its bounds know no filter.
        """
        clock = np.array([axis.name == "time_offset" for axis in self.model.coordinates])

        def stepped(read: Read, residuals: np.ndarray, jacobian: np.ndarray) -> Tried | None:
            """The fit by one step from here, where what the step leaves out, of second order in it, is little."""
            step = -np.linalg.lstsq(jacobian, residuals, rcond=1e-12)[0]
            left, point = residuals + jacobian @ step, read.point + step
            if np.all(clock | ((point > 0.0) & (point < 1.0))) and np.sum((jacobian @ step) ** 2) < _LITTLE:
                return Tried(passed, cutoff, point, float(left @ left), left, jacobian)
            return None

        if found := stepped(near, *self.passed(near.rows, passed, cutoff)):
            return found, near
        read = near

        def evaluate(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            nonlocal read
            read = read if np.array_equal(u, read.point) else self.read(u)
            return self.passed(read.rows, passed, cutoff)

        begin, bounds = near.point, (np.where(clock, -np.inf, 0.0), np.where(clock, np.inf, 1.0))
        for rough in (100.0, 1.0):  # Where the first ends, one more step mostly does little.
            begin = np.where(clock, begin, np.clip(begin, 1e-9, 1.0 - 1e-9))
            end = trust_region(evaluate, begin, bounds, ftol=1e-5 * rough, xtol=1e-6 * rough, max_nfev=15)
            begin = end.point
            if np.array_equal(begin, read.point) and (found := stepped(read, end.residuals, end.jacobian)):
                return found, read
        square = float(end.residuals @ end.residuals)
        return Tried(passed, cutoff, end.point, square, end.residuals, end.jacobian), read


def _passed(clock: np.ndarray, values: np.ndarray, times: np.ndarray, passed: Filter, cutoff: float) -> np.ndarray:
    """Values (C, N, M) at a clock (N,) behind a filter without its delay, at times (T,): (C, T, M); at rest outside."""
    step, beyond = float(np.median(np.diff(clock))), min(2.0 / cutoff, float(clock[-1] - clock[0]))
    even = np.arange(clock[0] - beyond, clock[-1] + beyond + step, step)
    signal = _once(_at(even, clock, values), passed, cutoff, step)
    if passed.zero_phase:
        signal = _once(signal[:, ::-1], passed, cutoff, step)[:, ::-1]
    return _at(times + passed.delay / cutoff, even, signal)


def _at(times: np.ndarray, clock: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (C, N, M) at other times, linear between those of the clock and constant outside."""
    ends = values[:, 0], values[:, -1]
    return interp1d(clock, values, axis=1, bounds_error=False, fill_value=ends, assume_sorted=True)(times)  # pyright: ignore[reportArgumentType]


def _once(values: np.ndarray, passed: Filter, cutoff: float, step: float) -> np.ndarray:
    """One pass over even samples (C, N, M), exact for an input that is linear between them."""
    moved, found = values - values[:, :1], np.zeros(values.shape)
    for rate, weight in zip(*passed.terms, strict=True):
        if weight:
            angle = 2.0 * np.pi * cutoff * rate * step
            keep = np.exp(-angle)
            mean = -np.expm1(-angle) / angle
            found += (weight * lfilter([1.0 - mean, mean - keep], [1.0, -keep], moved, axis=1)).real
    return found + values[:, :1]


def ambiguity(at: Optimum, halves: np.ndarray) -> Ambiguity | None:
    """What filters leave open of an optimum; None where the model has no contact.

    Args:
        halves: (K,) half widths of the intervals there, as of ``Ambiguity.low``.
    """
    series, end = at.series, at.end
    longest = [s.longest for s in series if np.isfinite(s.longest) and s.longest > 0.0]
    if not longest:
        return None
    plain = Tried(None, np.inf, end.point, float(end.residuals @ end.residuals), end.residuals, end.jacobian)
    chains = _chains(_Sampled(at.model, at.experiments, max(longest)), plain, series, max(longest))
    best = min((one for chain in chains for one in chain), key=lambda one: one.square)
    low, high = np.full(halves.size, np.inf), np.full(halves.size, -np.inf)
    allowed, own = list[Tried](), _scaled(at, plain)[1]
    for chain in chains:
        places, deviations = map(np.stack, zip(*(_scaled(at, one) for one in chain), strict=True))
        excess = np.array([_excess(one, best, series) for one in chain])
        # Between two cut-offs as on a straight line.
        steps = np.linspace(0.0, len(chain) - 1.0, (len(chain) - 1) * _BETWEEN + 1)
        between = lambda y, steps=steps: interp1d(np.arange(y.shape[0]), y, axis=0)(steps)  # noqa: E731
        over = between(excess)
        kept = over < ALLOWED
        reach = halves * (between(deviations) / own) * np.sqrt(1.0 - np.minimum(over, ALLOWED) / ALLOWED)[:, None]
        low = np.min([low, *(between(places) - reach)[kept]], axis=0)
        high = np.max([high, *(between(places) + reach)[kept]], axis=0)
        allowed += [one for one, over in zip(chain[1:], excess[1:], strict=True) if over < ALLOWED]
        if excess[-1] < ALLOWED:
            low, high = np.full(halves.size, -np.inf), np.full(halves.size, np.inf)
    slowest = min(allowed, key=lambda one: one.cutoff, default=None)
    return Ambiguity(best, _excess(plain, best, series), low, high, slowest)


def _chains(sampled: _Sampled, plain: Tried, series: list[Series], duration: float) -> list[list[Tried]]:
    """Of each filter the plain fit, and fits at ever lower cut-offs, as far down as they may explain the record."""
    count = int(np.log(_FASTEST / _SLOWEST) / np.log(_RATIO)) + 1
    chains, best, unfiltered = [], plain, sampled.read(plain.point)
    for passed in sampled.filters:
        chain, near = [plain], unfiltered
        for cutoff in _FASTEST / duration / _RATIO ** np.arange(count):
            found, near = sampled.fitted(near, passed, float(cutoff))
            chain.append(found)
            best = min(best, found, key=lambda one: one.square)
            if _excess(found, best, series) > _HOPELESS:
                break
        chains.append(chain)
    return chains


def _excess(one: Tried, best: Tried, series: list[Series]) -> float:
    """D of one fit against the best."""
    rows = [s.rows for s in series]
    kept, samples = min(max(neighbours(best.residuals, rows), 0.0), 0.999), sum(r.size for r in rows)
    count = max(samples * (1.0 - kept) / (1.0 + kept), min(_FEWEST, samples))
    by_size = count * float(np.log(max(one.square, 1e-300) / max(best.square, 1e-300)))
    return by_size if any(s.estimated for s in series) else min(by_size, one.square - best.square)


def _scaled(at: Optimum, one: Tried) -> tuple[np.ndarray, np.ndarray]:
    """Estimates (K,) on their scales, and their deviations for residuals of variance 1."""
    how = moving(replace(at, end=replace(at.end, point=one.point)))
    size = np.linalg.norm(one.jacobian, axis=0)
    size = np.where(size > 0, size, 1.0)
    return how.z, np.linalg.norm(how.slopes / size @ np.linalg.pinv(one.jacobian / size, rcond=1e-6), axis=1)


REMEDY = (
    'What helps: state the low-pass of amplifier and recorder, filter = { kind = "butterworth", order = 2, zero_phase = false, '
    'cutoff = "1 kHz" }, or filter = "none" where there is none; or record with a wider one, and faster'
)


def _named(one: Tried) -> str:
    return f"a {one.filter} at {format_si(one.cutoff, 'Hz', 2)}"


def said(found: Ambiguity) -> tuple[str, str]:
    """In words what the record says, and on what condition estimates hold: the filter that explains it better than none, or the
    slowest that does so as well, and none.
    """
    if found.decisive:
        best = _named(found.best)
        better = f"a law that looks like one: {best} explains it decisively better than the law alone"
        return f"the record shows a filter, or {better}", f"the record passed a low-pass like {best}"
    slow = _named(found.slowest) if found.slowest else "a filter"
    text = f"the record does not distinguish a filter from the law: {slow} explains it as well as none"
    return text, "the record passed no low-pass"
