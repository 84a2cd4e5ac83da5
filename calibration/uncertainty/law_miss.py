"""Covariances of the estimates that hold where the law misses the contact, or runs differ, beside that of the noise.

Least squares over residuals r with the Jacobian J: an estimate moves by d = -(J^T J)^-1 J^T e for an error e of the
prediction. Its covariance is (J^T J)^-1 J^T S J (J^T J)^-1 with S that of e:

- *discrepancy*: e = noise + what the law misses, a Gaussian process over the phase of a contact, the same in every
  contact and proportional to its peak (Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001). Its size and its length
  maximise the restricted likelihood of the residuals, the noise being the one that is most likely without it. The process is
  at most twice as large as the residuals in contact, and no longer than a third of a contact: what is more is a coefficient.
- *robust*: clustered by run, S from each run's own residuals (Liang and Zeger, Biometrika 73, 1986), times
  G/(G - 1), Student's with G - 1 degrees of freedom. Of fewer runs the moving-block bootstrap within them
  (Kuensch, Ann. Statist. 17, 1989), in the closed form that it has for sums.
- *runs*: of the scatter of single runs' estimates, each a Gauss-Newton step from the common one. The estimate of one
  more run scatters about the common one by sqrt(G + 1) times as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from calibration.diagnostics.fit_tests import WORST_CONDITION, Spread
from calibration.diagnostics.residual_tests import Series
from calibration.forward.runs import stretches

# Cosines over a contact's phase, and lengths of the process as shares of a contact.
_COSINES, _LENGTHS = 24, (0.03, 0.06, 0.12, 0.2, 0.33)
# Fewer samples in contact show no shape.
_FEW = 6
# A process must raise the logarithm of the likelihood by so much, as by chance in one case of twenty.
_SEEN = 1.92
# Bounds of the logarithm of the noise, which is about 1, and the logarithm of a process that is none.
_NOISE, _NOTHING = (-3.0, 3.0), -40.0
# A process is at most so many times as large as the residuals in contact, which the coefficients have taken a part of.
_MOST = 2.0
# The kind of interval that is of one more run by itself, and no interval of the estimate.
NEXT_RUN = "next run"
# Fewer runs, or blocks, say nothing of their scatter.
FEWEST_RUNS = 3
# Lags in a row without correlation that end a block (Politis and White, Econometric Reviews 23, 2004).
_QUIET = 5
# Condition from which on a run does not determine every coordinate by itself.
_WORST = 1e7


class Discrepancy(NamedTuple):
    """What the law misses: the spread of the estimate, the size of the miss as a share of a contact's peak, and its length."""

    spread: Spread
    share: float
    length: float


def _inverse(jacobian: np.ndarray) -> np.ndarray:
    """J^+ (P, N) of a Jacobian (N, P), whose columns of coordinates that are held are 0; then (J^T J)^-1 = J^+ J^+T."""
    return np.linalg.pinv(jacobian, rcond=1.0 / WORST_CONDITION)


def discrepancy(
    series: Sequence[Series], residuals: np.ndarray, jacobian: np.ndarray, noise: Spread
) -> Discrepancy | None:
    """The Gaussian process over the phase, of white residuals (N,) and Jacobian (N, P); None where no contact is resolved."""
    if noise.covariance is None:
        return None
    basis, inside = _cosines(series, residuals.size)
    if inside < _FEW or not np.any(residuals[basis[:, 0] != 0.0]):
        return None
    way = _inverse(jacobian)
    inverse, beside = way @ way.T, basis - jacobian @ (way @ basis)
    gram, push, square = beside.T @ beside, beside.T @ residuals, float(residuals @ residuals)
    count = int(np.count_nonzero(np.abs(jacobian).any(axis=1) | (residuals != 0)))
    freedom = max(count - int(np.count_nonzero(np.diag(inverse))), 1)

    def cost(noise: float, size: float, power: np.ndarray) -> float:
        return _restricted(gram, push, square, freedom, np.exp(2.0 * noise), np.exp(2.0 * size) * power)

    # Without a process, and with one of each length.
    nothing = _power(_LENGTHS[0])
    alone: Any = minimize_scalar(lambda x: cost(x, _NOTHING, nothing), bounds=_NOISE, method="bounded")
    best = (float(alone.fun) - _SEEN, 0.0, _LENGTHS[0])
    # No larger than what is seen: what coefficients could take up altogether would else have no bound.
    peaks = np.sum(basis[:, 0] ** 2)
    most = float(np.log(_MOST * np.sqrt(np.sum(residuals[basis[:, 0] != 0.0] ** 2) / peaks)))
    for length in _LENGTHS:
        power = _power(length)
        found: Any = minimize_scalar(
            lambda x, power=power: cost(alone.x, x, power),
            bounds=(most - 8.0, most), method="bounded", options={"xatol": 1e-3},
        )  # fmt: skip
        if found.fun < best[0]:
            best = (float(found.fun), float(np.exp(found.x)), length)
    _, share, length = best
    variance, own = share**2 * _power(length), float(np.exp(2.0 * alone.x))
    plain, missed = own * inverse, (way @ basis * variance) @ (way @ basis).T
    changes = [(plain, 2.0 / freedom)]
    if share > 0.0:
        # As many numbers of the process as the data show say how well its size is known.
        seen = np.maximum(np.linalg.eigvalsh(np.sqrt(variance)[:, None] * gram * np.sqrt(variance)), 0.0)
        changes.append((missed, 2.0 / max(float(np.sum(seen / (seen + own))), 1.0)))
    return Discrepancy(noise._replace(covariance=plain + missed, moved=tuple(changes)), share, length)


def _cosines(series: Sequence[Series], size: int) -> tuple[np.ndarray, int]:
    """Cosines (N, K) of the phase of each contact, times its peak in deviations; and how many samples lie in contact.

    Freed of the noise's memory, as the residuals are.
    """
    basis, inside = np.zeros((size, _COSINES)), 0
    for s in series:
        own = np.zeros((s.rows.size, _COSINES))
        for first, last in stretches(s.touching):
            if last - first < 3:
                continue
            clock, peak = s.clock[first:last], float(np.max(np.abs(s.values[first:last])))
            phase = (clock - clock[0]) / (clock[-1] - clock[0])
            own[first:last] = peak * np.cos(np.pi * np.arange(_COSINES) * phase[:, None])
            inside += last - first
        if own.any():
            basis[s.rows] = s.white(own)
    return basis, inside


def _power(length: float) -> np.ndarray:
    """Variances of the cosines for a squared-exponential covariance of this length, 1 on average over the phase."""
    density = np.exp(-0.5 * (length * np.pi * np.arange(_COSINES)) ** 2)
    # The square of the constant is 1 on average, that of a cosine a half: they have the same share of the spectrum.
    density[0] *= 0.5
    return density / (density[0] + 0.5 * np.sum(density[1:]))


def _restricted(
    gram: np.ndarray, push: np.ndarray, square: float, freedom: int, noise: float, power: np.ndarray
) -> float:
    """Negative logarithm of the restricted likelihood of S = noise 1 + B power B^T, but for a constant.

    Of least-squares residuals r, whose J^T r is 0: ``square`` r^T r, ``gram`` B'^T B' and ``push`` B'^T r of the part B' of
    the cosines that no coordinate explains. Then |S| |J^T S^-1 J| is noise^freedom |H| |J^T J| and r^T P r is
    (r^T r - b^T H^-1 b/noise)/noise with H = 1 + power^1/2 B'^T B' power^1/2/noise and b = power^1/2 B'^T r.
    """
    root = np.sqrt(power)
    inner, pulled = np.eye(power.size) + root[:, None] * gram * root / noise, root * push
    form = (square - pulled @ np.linalg.solve(inner, pulled) / noise) / noise
    return 0.5 * float(freedom * np.log(noise) + np.linalg.slogdet(inner)[1] + form)


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


def in_blocks(series: Sequence[Series], residuals: np.ndarray, jacobian: np.ndarray, noise: Spread) -> Spread | None:
    """Spread by blocks of successive samples, which keep what correlates together; None of fewer than three blocks.

    The variance of a sum under the moving-block bootstrap of blocks of b among N samples is N/b times that of the
    N - b + 1 blocks' sums.
    """
    if noise.covariance is None:
        return None
    way = _inverse(jacobian)
    scores = [residuals[s.rows, None] * way.T[s.rows] for s in series if s.rows.size > 3 * _QUIET]
    if not scores:
        return None
    length = max(1, round(max(block_length(column) for score in scores for column in score.T)))
    count = sum(len(score) for score in scores) / length
    if count < FEWEST_RUNS:
        return None
    covariance = np.zeros((len(way), len(way)))
    for score in scores:
        sums = np.array([score[k : k + length].sum(axis=0) for k in range(len(score) - length + 1)])
        away = sums - length * score.mean(axis=0)
        covariance += len(score) / length * away.T @ away / len(sums)
    return noise._replace(covariance=covariance * count / (count - 1.0), moved=(), student=count - 1.0)


def block_length(values: np.ndarray) -> float:
    """Best length of the blocks of a circular bootstrap of a series (N,), by its correlation.

    Politis and White, Econometric Reviews 23 (2004), with the correction of Patton, Politis and White (28, 2009).
    """
    count = values.size
    away = values - values.mean()
    longest = int(np.ceil(np.sqrt(count))) + _QUIET
    power = np.correlate(away, away, "full")[count - 1 : count + longest] / count
    if not power[0] > 0.0:
        return 1.0
    seen = np.abs(power[1:] / power[0]) > 2.0 * np.sqrt(np.log10(count) / count)
    quiet = (k for k in range(len(seen) - _QUIET + 1) if not seen[k : k + _QUIET].any())
    reach = min(2 * (next(quiet, longest) + 1), longest)
    lags = np.arange(1, reach + 1)
    taper = np.clip(2.0 * (1.0 - lags / reach), 0.0, 1.0)
    slope = 2.0 * float(np.sum(taper * lags * power[lags]))
    long_run = float(power[0] + 2.0 * np.sum(taper * power[lags]))
    best = (2.0 * slope**2 / (4.0 / 3.0 * long_run**2)) ** (1.0 / 3.0) * count ** (1.0 / 3.0)
    return float(min(best, np.ceil(min(3.0 * np.sqrt(count), count / 3.0))))
