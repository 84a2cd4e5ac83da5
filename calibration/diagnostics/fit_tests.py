"""What may be believed of an optimum: covariance, agreement, and the verdict that tests make together. Nothing here
simulates.

Levels: size, outliers and held-out prediction 1e-3 each, order of signs 5e-4 and correlation 5e-3, each in contact and apart.
So at most 1.4 % of fits of a right model with right noise are called ``misfit``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from calibration.forward.coordinates import Coordinate
from calibration.forward.losses import influence
from calibration.search.refinement import End

LEVEL = 1e-3  # of a test of the residuals: a right model is called wrong once in a thousand
AGREEING_STARTS = 3
# Starts agree where their costs differ by less, in sigma squared; by the second where the integrator is no better.
ALIKE = (0.1, 3.0)
# The integrator may move an estimate by this share of its deviation: a 95 % interval then covers 92 %.
MOST_BLUR = 0.5
# Two optima whose costs differ by less than this many sigma squared are not distinguished by the data.
RIVAL_COST = 9.0
# A parameter known to worse than this factor (log scale) or share of its range (linear) is not determined.
WIDEST_FACTOR, WIDEST_SHARE = 2.0, 0.5
# A Jacobian with a larger ratio of singular values has lost a direction to rounding.
WORST_CONDITION = 1e10


def widest(axis: Coordinate) -> float:
    """Half width of an interval, in the parameter's coordinate, from which on it is not determined."""
    return float(np.log(WIDEST_FACTOR)) if axis.log else WIDEST_SHARE * (axis.upper - axis.lower)


class Test(NamedTuple):
    """One test: its name, its statistic, its p-value or margin, whether it passed, and a sentence if not."""

    name: str
    value: float
    threshold: float
    passed: bool
    reason: str


class Spread(NamedTuple):
    """Covariance (P, P) of the unit-box coordinates, None where the data leave a combination free, and how well it is known
    itself.
    """

    covariance: np.ndarray | None
    freedom: int  # samples less parameters
    # weakest, condition: direction that the data determine least, and largest over least singular value.
    weakest: np.ndarray
    condition: float
    # By estimated number of the noise, derivative (P, P) of the covariance by its logarithm and the variance of that.
    moved: tuple[tuple[np.ndarray, float], ...] = ()
    rise: float = 1.0  # of the cost by a step whose length is 1 in units of the covariance; 1 but for a robust loss
    student: float = np.inf  # degrees of freedom of the covariance itself, where it is not the noise's

    def quantile_of(self, slope: np.ndarray) -> float:
        """Quantile of a combination's 95 % interval: Student's, degrees of freedom by Satterthwaite.

        freedom = 2 v^2 / var(v), v the variance of the combination. The normal one where all noise is stated; with one
        estimated deviation, that of samples less parameters.
        """
        freedom, doubt = self.student, sum((slope @ change @ slope) ** 2 * own for change, own in self.moved)
        if self.covariance is not None and np.isinf(freedom) and doubt > 0:
            freedom = 2.0 * (slope @ self.covariance @ slope) ** 2 / doubt
        return float(special.stdtrit(freedom, 0.975))

    def rise_allowed(self, slope: np.ndarray) -> float:
        """Rise of the cost that bounds the 95 % interval of a combination of coordinates (P,).

        The square of its quantile: chi-square of 1 degree of freedom for stated noise, F(1, freedom) for estimated, whose
        deviation the weights know; a robust loss multiplies it.
        """
        return self.quantile_of(slope) ** 2 * self.rise

    def half_width(self, slope: np.ndarray) -> float:
        """Half of the 95 % interval of a combination of coordinates; infinite where the data leave it free."""
        if self.covariance is None:
            return float("inf")
        return self.quantile_of(slope) * float(np.sqrt(slope @ self.covariance @ slope))


def spread(
    end: End, samples: int, moved: list[tuple[np.ndarray, float]], loss: str, free: np.ndarray | None = None
) -> Spread:
    """Covariance (J^T J)^-1 of white residuals of variance 1, and of an M-estimator where the loss is robust.

    Then it is multiplied by k^2 [sum psi^2 / (n - p)] / mean(psi')^2, k = 1 + (p/n) var(psi')/mean(psi')^2
    (Huber 1981, 7.6). Coordinates that are not ``free`` (P,) stay where they are, without any covariance.
    """
    free = np.ones(end.jacobian.shape[1], bool) if free is None else free
    own, count = end.jacobian[:, free], int(np.count_nonzero(free))
    freedom = samples - count
    _, singular, directions = np.linalg.svd(own, full_matrices=False)
    directions = directions @ np.eye(free.size)[free]
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf
    if condition >= WORST_CONDITION:
        return Spread(None, freedom, directions[-1], condition)
    factor, mean = 1.0, 1.0
    if loss != "linear":
        psi, bend = (a[own.any(axis=1) | (end.residuals != 0)] for a in influence(loss, end.residuals))
        mean = max(float(np.mean(bend)), 1e-3)
        widened = 1.0 + count / samples * float(np.var(bend)) / mean**2
        factor = widened**2 * float(np.sum(psi**2)) / freedom / mean**2
    covariance = factor * (directions.T / singular**2) @ directions
    changes = tuple((-covariance @ change @ covariance / factor, variance) for change, variance in moved)
    return Spread(covariance, freedom, directions[-1], condition, changes, factor * mean)


def shown(stated: Spread, end: End) -> Spread:
    """The spread by the noise that residuals show, where they are far smaller than the noise that was stated."""
    if stated.covariance is None:
        return stated
    share = float(end.residuals @ end.residuals) / stated.freedom
    covariance = share * stated.covariance
    return stated._replace(covariance=covariance, moved=((covariance, 2.0 / stated.freedom),), rise=share * stated.rise)


def agreement(
    ends: tuple[End, ...], covariance: np.ndarray | None, errors: np.ndarray, rough: bool = False
) -> list[Test]:
    """Whether independent starts ended in one optimum, and whether a rival explains the data as well.

    A rough cost has many little minima within the uncertainty of the estimate. There, starts also agree whose costs the data
    cannot distinguish and whose points are as near as two draws of the estimate: (x - y)^T C^-1 (x - y) < P.

    Args:
        errors: (N,) the integrator's part in the best end's white residuals; costs |r|^2 are uncertain by some 2 |e|.
    """
    doubt = float(np.linalg.norm(errors))
    alike = float(np.clip(2.0 * doubt, *ALIKE)) if np.isfinite(doubt) else ALIKE[0]
    good = [end for end in ends if not end.failure]
    best = good[0]
    sigma = np.sqrt(np.diag(covariance)) if covariance is not None else np.full(best.point.size, 1e-3)
    # By cost: along a direction that the data leave free, starts that found the optimum lie apart.
    lowest = min(e.cost for e in good)
    same = [e.cost - lowest < alike for e in good]
    if rough and covariance is not None:
        inverse = np.linalg.inv(covariance)
        near = [(e.point - best.point) @ inverse @ (e.point - best.point) < best.point.size for e in good]
        same = [a or (b and e.cost - lowest < RIVAL_COST) for a, b, e in zip(same, near, good, strict=True)]
    close = [e for e in good if e.converged and e.cost - best.cost < RIVAL_COST]
    rivals = [e for e in close if np.any(np.abs(e.point - best.point) > 4.0 * sigma)]
    count, enough = int(sum(same)), AGREEING_STARTS
    reason = f"{count} of {len(ends)} starts reached the best optimum; at least {enough} are needed"
    if 2.0 * doubt > ALIKE[1]:
        reason += f"; the integrator leaves costs uncertain by {2.0 * doubt:.2g}: ask for a smaller accuracy"
    if not best.converged:
        reason = "the best start stopped before it converged"
    other = f"{len(rivals)} starts ended elsewhere with a cost that the data do not distinguish from the best"
    agreed = Test("agreement of starts", count, enough, count >= enough and best.converged, reason)
    return [agreed, Test("no rival optimum", len(rivals), 0, not rivals, other)]


def basis_of(jacobian: np.ndarray) -> np.ndarray:
    """(N, K) orthonormal columns that span those of a Jacobian (N, P)."""
    left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
    return left[:, singular * WORST_CONDITION > singular[0]]


def shift(errors: np.ndarray, jacobian: np.ndarray) -> float:
    """Most deviations that the integrator's error e moves any combination of coordinates by; NaN where e is not known.

    A covariance (J^T J)^-1 and a shift J^+ e: at most |Q^T e| deviations, Q an orthonormal basis of J's columns.
    """
    return float(np.linalg.norm(basis_of(jacobian).T @ errors))


def integration_test(errors: np.ndarray, jacobian: np.ndarray) -> Test:
    """Whether the integrator's error moves any combination of coordinates by little of its deviation (``shift``)."""
    moved = shift(errors, jacobian)
    reason = f"the integrator's error moves the estimates by {moved:.2g} of their deviation: ask for a smaller accuracy"
    if not np.isfinite(moved):
        reason = "a run at a tighter tolerance fails, so that the integrator's error is not known"
    return Test("error of the integrator", moved, MOST_BLUR, moved < MOST_BLUR, reason)


def rank_test(known: Spread) -> Test:
    """Whether every combination of the parameters moves the data, to numerical accuracy."""
    reason = "a combination of the parameters moves no residual at all"
    return Test("rank of the Jacobian", known.condition, WORST_CONDITION, known.covariance is not None, reason)


def held_out_test(square: float, freedom: int, quality: Spread) -> Test:
    """Whether held-out residuals are no larger than the noise and the parameters' uncertainty, by r^T (1 + J C J^T)^-1 r:
    chi-square, or F where the noise was estimated. ``freedom``: their number less the nuisances fitted to them.
    """
    square = max(square, 0.0)
    ratio = square / max(freedom, 1)
    p = float(special.fdtrc(freedom, quality.freedom, ratio) if quality.moved else special.chdtrc(freedom, square))
    reason = f"held-out residuals are {np.sqrt(ratio):.3g} times the noise"
    return Test("held-out prediction", p, LEVEL, p > LEVEL, reason)


def determined_test(label: str, half: float, axis: Coordinate, why: str = "") -> Test:
    """Whether half the length of an interval, on its scale, is below a factor of two or half of the range."""
    reason = why or f"the data do not determine {label}: they allow a factor or share beyond the limit"
    return Test(f"{label} determined", half, widest(axis), half < widest(axis), reason)


def curvature_test(label: str, ratio: float) -> Test:
    """Whether the cost rises as the covariance says at an interval's ends: ratio of true to quadratic rise."""
    reason = f"the cost at the ends of the interval of {label} is {ratio:.3g} times what the covariance predicts"
    if not np.isfinite(ratio):
        reason = f"the simulation fails at an end of the interval of {label}"
    return Test(f"interval of {label}", ratio, 2.0, 0.5 < ratio < 2.0, reason)


def bent(tests: Sequence[Test]) -> list[Test]:
    """Failed tests of the curvature whose simulations succeeded."""
    return [t for t in tests if t.name.startswith("interval of ") and not t.passed and np.isfinite(t.value)]
