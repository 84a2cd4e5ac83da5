"""Whether residuals look like the noise they are said to be: their size, their order in time, their outliers.

Order is tested in contact and apart separately: long quiet flights must not hide a contact whose shape is wrong, and
contact is where the model makes its claim.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import special
from scipy.integrate import quad
from scipy.sparse import csr_array

from bcfj_jax.core.quantities import percent, rounded
from calibration.diagnostics.fit_tests import LEVEL, Test, basis_of
from calibration.noise.noise_model import OUTLYING
from calibration.problem import ADEQUATE

# Undeclared correlation of the noise makes intervals too narrow before it can be seen for certain.
CORRELATION_LEVEL = 1e-2
# Rows up to which the distribution of a correlation is computed exactly.
_FEW = 300
# Share of samples that a robust loss may leave aside, and share of a contact that noise may remember.
MOST_OUTLIERS, LONGEST_MEMORY = 0.1, 0.2
# Share of the stated noise below which residuals show no more than that it was stated too large.
_OVERSTATED = 0.5
_NONE = np.zeros(0)


class Series(NamedTuple):
    """White residuals of one record and channel in time order."""

    # rows, touching: (n,) places among all residuals of the fit, and whether each sample is in contact; of a fit that
    # is not of contacts (runs.of_contacts) all are.
    rows: np.ndarray
    touching: np.ndarray
    share: float  # what one deviation is as a share of the record's peak
    # Duration of the longest contact [s], infinite where there is none, half a wave of a fit that is not of contacts.
    longest: float = np.inf
    memory: float = 0.0  # correlation time of the noise [s]
    # declared, estimated: whether the noise was said to be correlated, and its deviation comes from these residuals.
    declared: bool = False
    estimated: bool = False
    integrator: bool = False  # whether they are no larger than the integrator's error: their order then says nothing
    # clock, values, weights: (n,) times [s], readings and their inverse deviations, SI.
    clock: np.ndarray = _NONE
    values: np.ndarray = _NONE
    weights: np.ndarray = _NONE

    def white(self, errors: np.ndarray) -> np.ndarray:
        """Errors (n, ...) of the readings [SI] as the residuals have them: in deviations, freed of the noise's memory."""
        weighed = (errors.T * self.weights).T
        if not self.memory:
            return weighed
        kept = np.r_[0.0, np.exp(-np.diff(self.clock) / self.memory)]
        return ((weighed.T - kept * np.roll(weighed, 1, axis=0).T) / np.sqrt(1.0 - kept**2)).T


def residual_tests(series: list[Series], residuals: np.ndarray, jacobian: np.ndarray, robust: bool) -> list[Test]:
    """All tests of the residuals (N,) of a fit with their Jacobian (N, P).

    Args:
        residuals, jacobian: at the optimum, white and of variance 1.
        robust: whether outliers were allowed for: they are then counted, and tested no further.
    """
    tests = []
    inside = np.abs(residuals) < OUTLYING if robust else np.ones(residuals.size, dtype=bool)
    tested = np.concatenate([s.rows for s in series]) if series else np.zeros(0, dtype=int)
    others = np.setdiff1d(np.flatnonzero((residuals != 0) | (np.abs(jacobian).max(axis=1) > 0)), tested)
    basis, stated = basis_of(jacobian), [s.rows for s in series if not s.estimated]
    if stated or others.size:
        tests.append(_size_test(residuals, basis, np.concatenate([*stated, others]), inside))
    if not series:
        return tests
    heard = [s for s in series if not s.integrator and not overstated(s, residuals)]
    kept = [s._replace(rows=s.rows[inside[s.rows]], touching=s.touching[inside[s.rows]]) for s in heard]
    everywhere = all(s.touching.all() for s in series)
    for place, touching in (("in contact", True), ("apart", False))[: 1 if everywhere else 2]:
        found = [_runs_test(touching, kept, residuals), _correlation_test(touching, kept, residuals, basis)]
        tests += [
            t if everywhere else t._replace(name=f"{t.name} {place}", reason=f"{place}, {t.reason}") for t in found
        ]
    if any(s.declared for s in heard):
        tests.append(_memory_test(heard))
    if robust:
        share = 1.0 - float(np.mean(inside[tested]))
        reason = f"{share:.0%} of the samples are outliers: not a few accidents, but something that the model misses"
        tests.append(Test("few outliers", share, MOST_OUTLIERS, share <= MOST_OUTLIERS, reason))
        return tests
    worst, limit = float(np.max(np.abs(residuals[tested]))), -float(special.ndtri(LEVEL / (2 * tested.size)))
    reason = f"a residual is {worst:.3g} sigma: the model misses an event, or a sample is wrong"
    return [*tests, Test("no outlier", worst, limit, worst < limit, reason)]


def overstated(s: Series, residuals: np.ndarray) -> bool:
    """Whether the stated noise is more than twice what the residuals are, and these are a small part of the peak.

    Their order is no misfit of the law then. Large residuals in contact are one, however large the noise is said to be.
    """
    if s.estimated or not s.rows.size:
        return False
    squares = residuals[s.rows] ** 2
    every, inside = float(np.mean(squares)), float(np.mean(squares[s.touching])) if s.touching.any() else 0.0
    return every < _OVERSTATED**2 and max(every, inside) * s.share**2 <= ADEQUATE**2


def neighbours(residuals: np.ndarray, series: Sequence[np.ndarray]) -> float:
    """Correlation of successive residuals, all series' rows together; 0 of none."""
    pairs = sum(float(residuals[rows[1:]] @ residuals[rows[:-1]]) for rows in series)
    size = sum(float(residuals[rows] @ residuals[rows]) for rows in series)
    return pairs / size if size > 0.0 else 0.0


def _size_test(residuals: np.ndarray, basis: np.ndarray, rows: np.ndarray, inside: np.ndarray) -> Test:
    """Whether residuals whose deviation is stated are as large as that."""
    rows = rows[inside[rows]]
    freedom = max(rows.size - float(np.sum(basis[rows] ** 2)), 1.0)
    square = float(np.sum(residuals[rows] ** 2))
    p, reason = float(special.chdtrc(freedom, square)), f"{np.sqrt(square / freedom):.3g} times the stated noise"
    return Test("residual size", p, LEVEL, p > LEVEL, f"residuals are {reason}")


def _runs_test(touching: bool, series: list[Series], residuals: np.ndarray) -> Test:
    """One-sided test for too few changes of sign, pooled over records: binomial(n - 1, 1/2) for white residuals.

    Unlike the test of Wald and Wolfowitz it is not conditional on the number of signs, so that residuals all of one
    sign fail it; but where their size was fitted to them, their median is taken for zero.
    """
    changes, chances, share = 0, 0, 0.0
    for s in series:
        own = residuals[s.rows[s.touching == touching]]
        if not own.size:
            continue
        share = max(share, float(np.sqrt(np.mean(own**2))) * s.share)
        own = own - np.median(own) if s.estimated else own
        signs = own[own != 0] > 0
        changes += int(np.count_nonzero(np.diff(signs)))
        chances += max(signs.size - 1, 0)
    p = float(special.bdtr(changes, chances, 0.5)) if chances else 1.0
    reason = f"residuals change their sign {changes} times; without a pattern they would {chances // 2} times or so"
    reason += f": the model misses a shape ({percent(share, 2)} of the peak, rms)"
    return Test("order of residuals", p, LEVEL / 2, p > LEVEL / 2, reason)


def _correlation_test(touching: bool, series: list[Series], residuals: np.ndarray, basis: np.ndarray) -> Test:
    """One-sided test of the correlation of successive residuals, or of the next three where the first is modelled."""
    firsts, seconds, rows = ([np.zeros(0, dtype=int)] for _ in range(3))
    for s in series:
        mine = s.touching == touching
        rows.append(s.rows[mine])
        for lag in (2, 3, 4) if s.declared else (1,):
            both = mine[lag:] & mine[: s.rows.size - lag]
            firsts.append(s.rows[: s.rows.size - lag][both])
            seconds.append(s.rows[lag:][both])
    a, b, inside = (np.concatenate(parts) for parts in (firsts, seconds, rows))
    correlation, p = correlation_of(residuals, basis, a, b, inside)
    again = " beyond what its correlation time explains" if any(s.declared for s in series) else ""
    reason = f"residuals of successive samples correlate by {min(correlation, 1.0):.2f}{again}"
    reason += ": the sensor has a memory, or the law misses a shape"
    return Test("correlation of residuals", p, CORRELATION_LEVEL / 2, p > CORRELATION_LEVEL / 2, reason)


def correlation_of(
    residuals: np.ndarray, basis: np.ndarray, first: np.ndarray, second: np.ndarray, rows: np.ndarray
) -> tuple[float, float]:
    """Correlation of pairs of residuals, sum r_a r_b / sum r^2, freed of what the fit does to it; and its p-value.

    A fit leaves residuals M e of white noise e, M = 1 - Q Q^T, whose successive samples correlate by themselves. The
    chance that the ratio is above the c seen is that of e^T M G M e > 0, G = A - c B with A the pairs and B the rows:
    Imhof's integral over the eigenvalues of M G M (Biometrika 48, 1961), which are those of S^1/2 G S^1/2 among the
    rows, S = 1 - Q_r Q_r^T. Of many rows the form is matched by its first three moments (a chi-square, shifted and
    scaled) instead.

    Args:
        basis: (N, P) Q, orthonormal columns that span the Jacobian.
        first, second: (K,) rows of each pair.
        rows: those that pairs are of.
    """
    power = float(np.sum(residuals[rows] ** 2))
    if first.size < 5 or power == 0.0:
        return 0.0, 1.0
    seen = float(np.sum(residuals[first] * residuals[second])) / power

    size = residuals.size
    half = np.full(first.size, 0.5)
    pairs = csr_array((np.r_[half, half], (np.r_[first, second], np.r_[second, first])), shape=(size, size))
    among = csr_array((np.ones(rows.size), (rows, rows)), shape=(size, size))

    def moments(c: float) -> tuple[float, float, float]:
        """Traces of (M G)^k, G = A - c B: G is a band and Q is thin."""
        g = pairs - c * among
        square = g @ g
        one, two = g @ basis, square @ basis
        x, y = basis.T @ one, basis.T @ two
        return (
            float(g.trace() - np.trace(x)),
            float(square.trace() - 2.0 * np.trace(y) + np.trace(x @ x)),
            float((square * g).sum() - 3.0 * np.trace(one.T @ two) + 3.0 * np.trace(x @ y) - np.trace(x @ x @ x)),
        )

    if rows.size <= _FEW:
        form = csr_array(pairs - seen * among)[rows][:, rows].toarray()
        values, vectors = np.linalg.eigh(np.eye(rows.size) - basis[rows] @ basis[rows].T)
        root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        p = _positive(np.linalg.eigvalsh(root @ form @ root))
    else:
        p = _matched(*moments(seen))
    # The ratio that white noise would leave on average is where the form's mean is 0.
    expected = moments(0.0)[0] / max(rows.size - float(np.sum(basis[rows] ** 2)), 1.0)
    return seen - expected, p


def _positive(weights: np.ndarray) -> float:
    """Chance that sum of w z^2 over independent standard normals z is above 0."""
    weights = weights / np.linalg.norm(weights)

    def integrand(u: float) -> float:
        angle, size = 0.5 * np.sum(np.arctan(weights * u)), 0.25 * np.sum(np.log1p((weights * u) ** 2))
        return float(np.sin(angle) * np.exp(-size) / u)

    return float(np.clip(0.5 + quad(integrand, 0.0, np.inf, epsabs=1e-8, limit=200)[0] / np.pi, 0.0, 1.0))


def _matched(first: float, second: float, third: float) -> float:
    """The same chance from the traces of the form's first three powers."""
    deviation = np.sqrt(2.0 * second)
    skew, away = 8.0 * third / deviation**3, -first / deviation
    if abs(skew) < 1e-3:
        return float(special.ndtr(-away))
    freedom = 8.0 / skew**2
    shifted = freedom + np.sign(skew) * away * np.sqrt(2.0 * freedom)
    return float((special.chdtrc if skew > 0 else special.chdtr)(freedom, max(shifted, 0.0)))


def _memory_test(series: list[Series]) -> Test:
    """Whether the noise forgets faster than a contact lasts: a slow error looks like a wrong shape."""
    worst = max((s.memory / s.longest for s in series if s.declared), default=0.0)
    reason = f"residuals keep their sign for {rounded(worst)} times as long as a contact lasts"
    reason += ": a shape that the model misses does so"
    return Test("memory of the noise", worst, LONGEST_MEMORY, worst <= LONGEST_MEMORY, reason)
