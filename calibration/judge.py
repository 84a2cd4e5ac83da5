"""What may be believed of an optimum. Every test has a level; a verdict is their conjunction.

All tests read the weighted residuals of the best end, its Jacobian in unit-box coordinates, and the other
ends. Nothing here simulates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import stats

from calibration.search import End

LEVEL = 1e-3  # of each residual test: a right model is called wrong once in a thousand
AGREEING_STARTS = 3
# Two optima whose costs differ by less than this many sigma squared cannot be told apart by the data.
RIVAL_COST = 9.0
# A parameter known to worse than this factor (log scale) or share of its range (linear) is not determined.
WIDEST_FACTOR, WIDEST_SHARE = 2.0, 0.5


class Test(NamedTuple):
    """One test: its name, its statistic, its p-value or margin, whether it passed, and a sentence if not."""

    name: str
    value: float
    threshold: float
    passed: bool
    reason: str


class Series(NamedTuple):
    """Weighted residuals of one record and channel in time order, whether each sample is in contact, and what
    one unit of them is as a share of the record's peak.
    """

    weighted: np.ndarray
    touching: np.ndarray
    share: float


class Spread(NamedTuple):
    """Covariance of the unit-box coordinates, its weak direction, and the noise scale it used."""

    covariance: np.ndarray | None
    quantile: float
    scale: float
    freedom: int
    weakest: np.ndarray
    condition: float


def spread(end: End, samples: int, estimated: bool) -> Spread:
    """Covariance s^2 (J^T J)^-1 with s^2 = 1 for stated noise, else cost / degrees of freedom.

    The quantile of the 95 % interval is Student's for estimated noise and the normal one otherwise.
    """
    freedom = samples - end.jacobian.shape[1]
    scale = end.cost / freedom if estimated else 1.0
    quantile = float(stats.t.ppf(0.975, freedom) if estimated else stats.norm.ppf(0.975))
    _, singular, directions = np.linalg.svd(end.jacobian, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf
    covariance = None
    if condition < 1e10:
        covariance = scale * (directions.T / singular**2) @ directions
    return Spread(covariance, quantile, float(scale), freedom, directions[-1], condition)


def agreement(ends: tuple[End, ...], scale: float, covariance: np.ndarray | None) -> list[Test]:
    """Whether independent starts ended in one optimum, and whether a rival explains the data as well."""
    good = [end for end in ends if not end.failure]
    best = good[0]
    sigma = np.sqrt(np.diag(covariance)) if covariance is not None else np.full(best.point.size, 1e-3)
    # By cost: along a direction that the data leave free, starts that found the optimum lie apart.
    same = [e.cost - best.cost < 0.1 * scale for e in good]
    close = [e for e in good if e.converged and e.cost - best.cost < RIVAL_COST * scale]
    rivals = [e for e in close if np.any(np.abs(e.point - best.point) > 4.0 * sigma)]
    count = int(sum(same))
    return [
        Test(
            "agreement of starts", count, AGREEING_STARTS, count >= AGREEING_STARTS and best.converged,
            f"only {count} of {len(ends)} starts reached the best optimum; {AGREEING_STARTS} must"
            if best.converged else "the best start stopped before it converged",
        ),
        Test(
            "no rival optimum", len(rivals), 0, not rivals,
            f"{len(rivals)} starts ended elsewhere with a cost that the data cannot tell from the best",
        ),
    ]  # fmt: skip


def residual_tests(series: list[Series], parameters: int, estimated: bool) -> list[Test]:
    """Whether the residuals look like the noise: size (stated noise only), order in time, outliers.

    The order is tested in contact and apart separately: long quiet flights must not hide a contact whose
    shape is wrong, and contact is where the model makes its claim.

    Args:
        series: residuals of each record and channel.
        parameters: number of fitted parameters.
        estimated: whether the noise's size comes from these residuals.
    """
    together = np.concatenate([s.weighted for s in series])
    freedom = together.size - parameters
    chi2 = float(np.sum(together**2))
    sigma = float(np.sqrt(chi2 / freedom)) if estimated else 1.0
    tests = []
    if not estimated:
        p = float(stats.chi2.sf(chi2, freedom))
        reason = f"residuals are {np.sqrt(chi2 / freedom):.3g} times the stated noise"
        tests.append(Test("residual size", p, LEVEL, p > LEVEL, reason))
    for place, inside in (("in contact", True), ("apart", False)):
        parts = [s.weighted[s.touching == inside] for s in series]
        p = _changes_p([part - np.median(part) if estimated and part.size else part for part in parts])
        share = max(
            (float(np.sqrt(np.mean(part**2))) * s.share for part, s in zip(parts, series, strict=True) if part.size),
            default=0.0,
        )
        reason = (
            f"{place}, residuals of one sign follow each other: the model misses a shape ({share:.2g} of the peak, rms)"
        )
        tests.append(Test(f"order of residuals {place}", p, LEVEL / 2, p > LEVEL / 2, reason))
    worst = float(np.max(np.abs(together)) / sigma) if sigma > 0 else 0.0
    limit = float(stats.norm.isf(LEVEL / (2 * together.size)))
    tests.append(
        Test("no outlier", worst, limit, worst < limit, f"a residual is {worst:.3g} sigma: the model misses an event")
    )
    return tests


def _changes_p(series: list[np.ndarray]) -> float:
    """One-sided test for too few changes of sign, pooled over records: binomial(n - 1, 1/2) for white residuals.

    Unlike the runs test it is not conditional on the number of signs, so residuals all of one sign fail it.
    """
    changes = chances = 0
    for s in series:
        signs = s[s != 0] > 0
        changes += int(np.count_nonzero(np.diff(signs)))
        chances += max(signs.size - 1, 0)
    return float(stats.binom.cdf(changes, chances, 0.5)) if chances else 1.0


def held_out_test(cost: float, freedom: int, scale: float, freedom_in: int, estimated: bool) -> Test:
    """Whether held-out residuals are no larger than the noise: chi-square for stated noise, else F with the fit's.

    The uncertainty of the fitted parameters in the prediction is not allowed for, so the true level is up to
    twice ``LEVEL`` where the held-out data are no fewer than the fitted.

    Args:
        cost: sum of squared weighted held-out residuals.
        freedom: their number less the nuisances fitted to them.
        scale: noise variance of the fit in units of the weights (1 for stated noise).
        freedom_in: degrees of freedom of the fit.
        estimated: whether ``scale`` was estimated.
    """
    ratio = cost / max(freedom, 1) / scale if scale > 0 else np.inf
    p = float(stats.f.sf(ratio, freedom, freedom_in) if estimated else stats.chi2.sf(cost, freedom))
    reason = f"held-out residuals are {np.sqrt(ratio):.3g} times the noise"
    return Test("held-out prediction", p, LEVEL, p > LEVEL, reason)


def curvature_test(label: str, ratio: float) -> Test:
    """Whether the cost rises as the covariance says at an interval's ends: ratio of true to quadratic rise."""
    return Test(
        f"interval of {label}", ratio, 2.0, 0.5 < ratio < 2.0,
        f"the cost at the ends of the interval of {label} is {ratio:.3g} times what the covariance predicts",
    )  # fmt: skip


def order(verdicts: set[str]) -> str:
    """The verdict that wins: a fit that did not converge says nothing of the model, and so on."""
    for verdict in ("not_converged", "misfit", "not_identified"):
        if verdict in verdicts:
            return verdict
    return "identified"
