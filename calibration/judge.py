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
    near = [np.all(np.abs(e.point - best.point) < np.maximum(0.2 * sigma, 1e-6)) for e in good]
    same = [n and e.cost - best.cost < 0.1 * scale for n, e in zip(near, good, strict=True)]
    rivals = [
        e for e, s in zip(good, same, strict=True)
        if not s and e.cost - best.cost < RIVAL_COST * scale and np.any(np.abs(e.point - best.point) > 4.0 * sigma)
    ]  # fmt: skip
    count = int(sum(same))
    return [
        Test(
            "agreement of starts", count, AGREEING_STARTS, count >= AGREEING_STARTS and best.converged,
            f"only {count} of {len(ends)} starts reached the best optimum; {AGREEING_STARTS} must",
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
        p = _runs_p([part - np.median(part) if estimated and part.size else part for part in parts])
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


def _runs_p(series: list[np.ndarray]) -> float:
    """One-sided Wald-Wolfowitz test for too few runs of sign, pooled over records."""
    runs = expected = variance = 0.0
    for s in series:
        signs = s[s != 0] > 0
        plus, minus = int(signs.sum()), int((~signs).sum())
        n = plus + minus
        if n < 2:
            continue
        runs += 1 + np.count_nonzero(np.diff(signs))
        mean = 1 + 2.0 * plus * minus / n
        expected += mean
        variance += (mean - 1) * (mean - 2) / (n - 1)
    if variance <= 0:
        return 1.0 if runs >= expected else 0.0
    return float(stats.norm.cdf((runs - expected + 0.5) / np.sqrt(variance)))


def held_out_test(rms_in: float, freedom_in: int, rms_out: float, samples_out: int) -> Test:
    """Whether the weighted residuals of held-out records are no larger than those of the fit (F test)."""
    p = float(stats.f.sf((rms_out / rms_in) ** 2, samples_out, freedom_in)) if rms_in > 0 else 1.0
    return Test(
        "held-out prediction",
        p,
        LEVEL,
        p > LEVEL,
        f"held-out residuals are {rms_out / rms_in:.3g} times those of the fit",
    )


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
