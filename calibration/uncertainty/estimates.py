"""Estimates with their intervals: values, reference force, what is determined and what is at a bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.diagnostics import fit_tests
from calibration.diagnostics.influence import separation
from calibration.forward.losses import straightened
from calibration.forward.model import Model
from calibration.problem import nuisances
from calibration.search.evaluate import evaluator
from calibration.search.refinement import End
from calibration.solver_budget import budget

# In half-widths of an interval.
_NEAR = 0.1


@dataclass(frozen=True)
class Parameter:
    """One estimate.

    Attributes:
        value: SI.
        ci95: 95 % interval, or None where no honest one exists.
        identifiable: whether the data determine it to better than a factor of two.
        at_bound: "lower", "upper" or "".
        kind: how it was found: "fitted", or "derived" from the reference force and exponent.
        interval_kind: what the interval comes from, or would: "covariance", "profile" or "posterior".
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    identifiable: bool
    at_bound: str
    kind: str = "fitted"
    interval_kind: str = "covariance"


@dataclass(frozen=True)
class Reference:
    """The power law where the data are: F_ref at d_ref, with the interval of F_ref (None as in Parameter)."""

    penetration: float
    force: float
    ci95: tuple[float, float] | None
    interval_kind: str = "covariance"


def estimates(
    model: Model, labels: tuple[str, ...], best: End, log_depth: float, spread: fit_tests.Spread, rough: bool = False
) -> tuple[dict[str, Parameter], Reference | None, list[fit_tests.Test]]:
    """Values, intervals, identifiability and bounds of every coordinate, and the tests of the latter three.

    ``rough``: whether the integrator's error is what the cost is made of; a joint's always counts.
    """
    values = model.values(best.point, log_depth).tolist()
    lower, width = model.box(log_depth)
    slopes = np.diag(width)
    z, pair, reference = lower + best.point * width, model.pair() if model.referenced else None, None
    if pair:
        k, n = pair
        reference = _reference(spread, log_depth, float(z[k]), slopes[k])
        # From the coordinate ln F_ref to ln K = ln F_ref - n ln d_ref.
        z[k] -= values[n] * log_depth
        slopes[k, n] = -log_depth * (values[n] if model.coordinates[n].log else 1.0) * width[n]
    parameters: dict[str, Parameter] = {}
    tests: list[fit_tests.Test] = []
    reaches: list[float] = []
    for i, (axis, label) in enumerate(zip(model.coordinates, labels, strict=True)):
        half = spread.half_width(slopes[i])
        widest = fit_tests.widest(axis)
        identifiable = bool(half < widest)
        quantity = {**model.scene.quantities, **nuisances(model.channels)}[axis.name]
        # No lower than the quantity can be: a clearance that may be closed.
        reach = 1.0 if axis.log or not identifiable else min(1.0, (values[i] - quantity.low) / half)
        reaches.append(reach)
        edges = (z[i] - reach * half, z[i] + half)
        interval = tuple(float(np.exp(e)) if axis.log else float(e) for e in edges) if identifiable else None
        # Of many decades the lowest are no thousandth of the range.
        margin = 1e-3 * (min(axis.upper - axis.lower, values[i]) if axis.decades else axis.upper - axis.lower)
        at_bound = "lower" if z[i] < axis.lower + margin else "upper" if z[i] > axis.upper - margin else ""
        kind = "derived" if pair and i == pair[0] else "fitted"
        parameters[label] = Parameter(values[i], quantity.unit, interval, identifiable, at_bound, kind)  # type: ignore[arg-type]
        reason = f"the data do not determine {label}: they allow a factor or share beyond the limit"
        tests.append(fit_tests.Test(f"{label} determined", half, widest, identifiable, reason))
        tests.append(
            fit_tests.Test(f"{label} inside its bounds", 0, 0, not at_bound, f"{label} is at its {at_bound} bound")
        )
    if all(t.passed for t in tests):  # Else no interval is given, and the ends of most lie where nothing simulates.
        for slope, label, reach in zip(slopes, labels, reaches, strict=True):
            ratio = _curvature(model, best, log_depth, spread, slope, (-reach, 1.0), rough)
            tests.append(fit_tests.curvature_test(label, ratio))
    tests.append(fit_tests.rank_test(spread))
    if not all(t.passed for t in tests if t.name.endswith("determined")):
        names = [labels[k] for k in np.argsort(-np.abs(spread.weakest))[:2]]
        reason = f"the weakest direction of the data is in {' and '.join(names)}"
        reason += f"; what would separate them: {separation(names)}" if len(names) > 1 else ""
        tests.append(fit_tests.Test("weak direction", spread.condition, 0, False, reason))
    return parameters, reference, tests


def _reference(spread: fit_tests.Spread, log_depth: float, centre: float, slope: np.ndarray) -> Reference:
    half = spread.half_width(slope)
    interval = (float(np.exp(centre - half)), float(np.exp(centre + half)))
    known = half < np.log(fit_tests.WIDEST_FACTOR)
    return Reference(float(np.exp(log_depth)), float(np.exp(centre)), interval if known else None)


def _curvature(
    model: Model,
    best: End,
    log_depth: float,
    spread: fit_tests.Spread,
    slope: np.ndarray,
    reaches: tuple[float, float],
    rough: bool,
) -> float:
    """Rise of the cost at the ends of an interval, the other parameters following, over the quadratic rise.

    ``reaches``: where those ends are, in half-widths; one that is no way off has no information.
    """
    assert spread.covariance is not None
    quantile, along = spread.quantile_of(slope), spread.covariance @ slope
    shares = np.array([r for r in reaches if abs(r) > _NEAR])
    expected = quantile**2 * spread.rise * shares**2
    steps = shares[:, None] * quantile * along / np.sqrt(slope @ along)
    ends = best.point + steps
    residuals, jacobians = evaluator(model, log_depth)(ends)
    if rough or budget(model.scene).rough:
        # From slopes, for the integration's own error makes the cost rough: that at the optimum, which is expected, and
        # the end's, of a cost of third order. Of what the predictions change by: the residuals at the optimum are all
        # noise, and times the Jacobian's own error as large as the rise.
        base, _ = straightened(model.loss, best.residuals, best.jacobian)
        parts = zip(residuals, jacobians, steps, expected, strict=True)
        rises = [(rise + 2.0 * float((r - base) @ (j @ s))) / 3.0 for r, j, s, rise in parts]
    else:
        rises = [float(np.sum(np.square(r))) - best.cost for r in residuals]
    ratios = np.array(rises) / expected
    return max(ratios, key=lambda r: abs(np.log(max(r, 1e-300))) if np.isfinite(r) else np.inf)
