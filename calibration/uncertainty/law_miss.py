"""Intervals of the estimates that hold where the law misses the contact, or runs differ, beside that of the noise.

Least squares over residuals r with the Jacobian J: an estimate moves by d = -(J^T J)^-1 J^T e for an error e of the
prediction. Its covariance is (J^T J)^-1 J^T S J (J^T J)^-1 with S that of e:

- *discrepancy*: e = noise + what the law misses, a Gaussian process over the phase of a contact, the same in every contact and
  proportional to its peak (Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001). How large it is, and of which of few lengths,
  says the evidence of ``uncertainty.sets``.
- *robust*: clustered by run, S from each run's own residuals (Liang and Zeger, Biometrika 73, 1986), times G/(G - 1),
  Student's with G - 1 degrees of freedom. Of fewer runs from neighbouring samples (Newey and West, Econometrica 55, 1987), as
  many lags as a memory of the first order asks for (Andrews, Econometrica 59, 1991).
- *runs*: of the scatter of single runs' estimates, each a Gauss-Newton step from the common one. The estimate of one
  more run scatters about the common one by sqrt(G + 1) times as much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.interpolate import interp1d

from calibration.diagnostics.fit_tests import WORST_CONDITION, Spread
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.forward.runs import stretches
from calibration.uncertainty.estimates import Ends, ends_of
from calibration.uncertainty.sets import QUANTILE, SCALES, Error, Linear, mixture

# Phases at which a process is known, its lengths as shares of a contact (what is longer is a coefficient), and the share of
# its variance that is left out.
_GRID, _LENGTHS, _LITTLE = np.linspace(0.0, 1.0, 101), (0.03, 0.06, 0.12, 0.2, 0.33), 1e-4
# Chance that a law misses a shape: one must then raise the likelihood seven times to be seen, as by chance in one case of twenty.
_ACTS = 0.7
# Coefficients have taken up as much of a shape as residuals show, at most.
_LARGE = 2.0 / max(SCALES)
# Fewer samples in contact show no shape, and fewer of a record no memory.
_FEW, _SHORT = 6, 15
# The kind of interval that is of one more run by itself, and no interval of the estimate.
NEXT_RUN = "next run"
# Fewer runs, or stretches that know nothing of each other, say nothing of their scatter.
FEWEST_RUNS = 3
# Condition from which on a run does not determine every coordinate by itself.
_WORST = 1e7


def misses(at: Optimum) -> dict[str, Mapping[str, Ends | None]]:
    """Intervals by kind and name; none of a robust loss, or where the integrator's error stands for the noise."""
    model, best, spread = at.model, at.end, at.spread
    if spread.covariance is None or model.loss != "linear" or at.noise.integrator:
        return {}
    found, shape = {}, model.data.weights.shape
    if all(axis.experiment is None for axis in model.coordinates):
        runs = np.repeat(np.arange(shape[0]), int(np.prod(shape[1:])))
        found = clustered(runs, best.residuals[: runs.size], best.jacobian[: runs.size], spread)
    given = (at.series, best.residuals, best.jacobian, spread)
    found = {"robust": neighbouring(*given), **found, "discrepancy": discrepancy(*given)}
    return {kind: ends_of(replace(at, spread=own)) for kind, own in found.items() if own}


def discrepancy(series: Sequence[Series], residuals: np.ndarray, jacobian: np.ndarray, noise: Spread) -> Spread | None:
    """Spread with a shape that the law misses, as large as residuals show; None where no contact is resolved."""
    errors, free = shapes(series, residuals), np.any(jacobian, axis=0)
    if noise.covariance is None or not errors:
        return None
    found = mixture(Linear(-residuals, jacobian[:, free], np.eye(int(free.sum())), 0.0, noise.freedom), errors)
    way, best = _inverse(jacobian), found.members[np.argmax(found.log)]
    plain, missed = found.variance * way @ way.T, np.zeros((len(way), len(way)))
    changes = [(plain, 2.0 / noise.freedom)]
    if best.any():  # Else most probably there is none.
        for error, size in zip(errors, found.weights @ found.members**2, strict=True):
            missed += size * (way @ error.prior[0]) @ (way @ error.prior[0]).T
        # As many numbers as the data show say how well its size is known.
        columns = np.max(best) * errors[int(np.argmax(best))].prior[0]
        seen = np.linalg.svd(columns - jacobian @ (way @ columns), compute_uv=False) ** 2
        changes.append((missed, 2.0 / max(float(np.sum(seen / (seen + found.variance))), 1.0)))
    return noise._replace(covariance=plain + missed, moved=tuple(changes))


def shapes(series: Sequence[Series], residuals: np.ndarray) -> list[Error]:
    """Processes of each length, which exclude each other; at most twice as large as the residuals (N,) in contact."""
    phases, peaks = _phases(series, residuals.size)
    touching = np.isfinite(phases)
    size = float(np.linalg.norm(residuals[touching]))
    if np.count_nonzero(touching) < _FEW or not size:
        return []
    weighed = peaks.copy()
    for s in series:
        weighed[s.rows] *= s.weights
    most, found = QUANTILE * _LARGE * size / float(np.linalg.norm(weighed)), []
    for length in _LENGTHS:
        basis = np.nan_to_num(interp1d(_GRID, _modes(length), axis=0)(phases)) * peaks[:, None]
        for s in series:
            basis[s.rows] = s.white(basis[s.rows])
        found.append(Error(f"{length:.0%}", "of the peak", most, basis, "shape", chance=_ACTS))
    return found


@cache
def _modes(length: float) -> np.ndarray:
    """(G, K) over a grid of phases, whose product with itself is the squared-exponential covariance of this length."""
    values, vectors = np.linalg.eigh(np.exp(-0.5 * ((_GRID[:, None] - _GRID) / length) ** 2))
    kept = values > _LITTLE * values[-1]
    return vectors[:, kept] * np.sqrt(values[kept])


def _phases(series: Sequence[Series], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each residual (N,) the phase of its contact, NaN in none, and the contact's peak, in SI as ``Series.values``."""
    phases, peaks = np.full(size, np.nan), np.zeros(size)
    for s in series:
        for first, last in stretches(s.touching):
            if last - first > 2:
                clock, rows = s.clock[first:last], s.rows[first:last]
                phases[rows] = (clock - clock[0]) / (clock[-1] - clock[0])
                peaks[rows] = np.max(np.abs(s.values[first:last]))
    return phases, peaks


def _inverse(jacobian: np.ndarray) -> np.ndarray:
    """J^+ (P, N) of a Jacobian (N, P), whose columns of coordinates that are held are 0; then (J^T J)^-1 = J^+ J^+T."""
    return np.linalg.pinv(jacobian, rcond=1.0 / WORST_CONDITION)


def clustered(runs: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray, noise: Spread) -> dict[str, Spread]:
    """Spreads "robust" and "runs" of G >= 3 runs, ``runs`` (N,) being the run of each residual; else none.

    A run that does not determine every coordinate by itself leaves out the second.
    """
    names = np.unique(runs)
    if noise.covariance is None or len(names) < FEWEST_RUNS:
        return {}
    count = len(names)
    scores = np.stack([jacobian[runs == g].T @ residuals[runs == g] for g in names])
    meat = scores.T @ scores * count / (count - 1)
    way = _inverse(jacobian)
    whole = way @ way.T
    found = {"robust": noise._replace(covariance=whole @ meat @ whole, moved=(), student=count - 1.0)}
    fits = [np.linalg.lstsq(jacobian[runs == g], residuals[runs == g], rcond=1.0 / _WORST) for g in names]
    if min(rank for _, _, rank, _ in fits) < np.count_nonzero(np.diag(whole)):
        return found
    scatter = np.cov(np.stack([step for step, *_ in fits]).T).reshape(whole.shape) / count
    runs_differ = noise._replace(covariance=scatter, moved=(), student=count - 1.0)
    return found | {"runs": runs_differ, NEXT_RUN: runs_differ._replace(covariance=(count + 1) * scatter)}


def neighbouring(series: Sequence[Series], residuals: np.ndarray, jacobian: np.ndarray, noise: Spread) -> Spread | None:
    """Spread by samples and their neighbours, with Bartlett's weights 1 - k/L; None of fewer than three times L samples."""
    way = _inverse(jacobian)
    scores = [residuals[s.rows, None] * way.T[s.rows] for s in series if s.rows.size > _SHORT]
    if noise.covariance is None or not scores:
        return None
    count, length = sum(len(x) for x in scores), max(map(_length, scores))
    if count < FEWEST_RUNS * length:
        return None
    covariance = np.zeros((len(way), len(way)))
    for x in scores:
        lags = [(1.0 - k / length) * x[k:].T @ x[: len(x) - k] for k in range(min(length, len(x)))]
        covariance += lags[0] + sum(lag + lag.T for lag in lags[1:])
    free = count / length - 1.0
    return noise._replace(covariance=covariance * (free + 1.0) / free, moved=(), student=free)


def _length(scores: np.ndarray) -> int:
    """Andrews' L of scores (N, P): 1.1447 (4 c^2 N/(1 - c^2)^2)^1/3 for the largest correlation c of neighbours."""
    away = scores - scores.mean(axis=0)
    size = np.maximum(np.sum(away**2, axis=0), 1e-300)
    kept = min(float(np.max(np.abs(np.sum(away[1:] * away[:-1], axis=0) / size))), 0.97)
    return 1 + int(1.1447 * (4.0 * kept**2 * len(scores) / (1.0 - kept**2) ** 2) ** (1.0 / 3.0))
