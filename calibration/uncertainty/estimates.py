"""Estimates with their intervals: values, reference force, what is determined and what is at a bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.quantities import Quantity
from calibration.diagnostics import fit_tests
from calibration.diagnostics.influence import separation
from calibration.diagnostics.optimum import Optimum
from calibration.forward.coordinates import Coordinate
from calibration.forward.losses import straightened
from calibration.forward.model import Model
from calibration.problem import nuisances
from calibration.search.evaluate import evaluator
from calibration.search.refinement import End
from calibration.solver_budget import budget

# Name of the reference force among what errors move.
REFERENCE = "reference force"
# In half-widths of an interval.
_NEAR = 0.1


@dataclass(frozen=True)
class Parameter:
    """One estimate.

    Attributes:
        value: SI.
        ci95: the headline, a 95 % interval: of ``intervals`` the widest that applies, or None where the data do not
            determine it, or the search failed.
        identifiable: whether the data determine it to better than a factor of two.
        at_bound: "lower", "upper" or "".
        kind: how it was found: "fitted", or "derived" from the reference force and exponent.
        interval_kind: what the interval of the noise comes from, or would: "covariance", "profile" or "posterior".
        intervals: 95 % intervals by kind: "noise", if law and sensor are exact, and those of ``law_miss``.
        headline: the kind that ci95 is, "" for none.
        with_budget: ci95, for one release more.
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    identifiable: bool
    at_bound: str
    kind: str = "fitted"
    interval_kind: str = "covariance"
    intervals: dict[str, tuple[float, float] | None] = field(default_factory=dict)
    headline: str = ""
    with_budget: tuple[float, float] | None = None


def briefly(parameters: Mapping[str, Parameter]) -> dict[str, dict[str, Any]]:
    """Estimates with their intervals, for a file."""
    return {name: {"value": p.value, "unit": p.unit, "ci95": p.ci95} for name, p in parameters.items()}


@dataclass(frozen=True)
class Reference:
    """The power law where the data are: F_ref at d_ref, its interval (None as in Parameter), and that of noise alone."""

    penetration: float
    force: float
    ci95: tuple[float, float] | None
    interval_kind: str = "covariance"
    with_budget: tuple[float, float] | None = None
    noise: tuple[float, float] | None = None


class Estimates(NamedTuple):
    """Estimates by name, the reference force where there is one, and the tests of both."""

    parameters: dict[str, Parameter]
    reference: Reference | None
    tests: list[fit_tests.Test]


def estimates(at: Optimum) -> Estimates:
    """Values, intervals, identifiability and bounds of every coordinate, and the tests of the latter three."""
    model, spread = at.model, at.spread
    pair = model.pair() if model.referenced else None
    z, slopes = placed(model, at.end)
    parameters, tests, reaches = {}, [], []
    for i, (axis, label) in enumerate(zip(model.coordinates, at.labels, strict=True)):
        value, half, widest = float(model.values(at.end.point)[i]), spread.half_width(slopes[i]), fit_tests.widest(axis)
        known, quantity = bool(half < widest), _quantity(model, axis)
        edges, reach = _edges(axis, quantity, value, z[i], half)
        reaches.append(reach)
        # Of many decades the lowest are no thousandth of the range.
        margin = 1e-3 * (min(axis.upper - axis.lower, value) if axis.decades else axis.upper - axis.lower)
        at_bound = "lower" if z[i] < axis.lower + margin else "upper" if z[i] > axis.upper - margin else ""
        kind = "derived" if pair and i == pair[0] else "fitted"
        parameters[label] = Parameter(value, quantity.unit, edges if known else None, known, at_bound, kind)
        tests.append(fit_tests.determined_test(label, half, axis))
        inside = f"{label} is at its {at_bound} bound"
        tests.append(fit_tests.Test(f"{label} inside its bounds", 0, 0, not at_bound, inside))
    if all(t.passed for t in tests):  # Else no interval is given, and the ends of most lie where nothing simulates.
        for slope, label, reach in zip(slopes, at.labels, reaches, strict=True):
            if spread.half_width(slope) > 0.0:  # Else it is held where it is.
                tests.append(fit_tests.curvature_test(label, _curvature(at, slope, (-reach, 1.0))))
    tests.append(fit_tests.rank_test(spread))
    if not all(t.passed for t in tests if t.name.endswith("determined")):
        names = [at.labels[k] for k in np.argsort(-np.abs(spread.weakest))[:2]]
        reason = f"the weakest direction of the data is in {' and '.join(names)}"
        reason += f"; what would separate them: {separation(names)}" if len(names) > 1 else ""
        tests.append(fit_tests.Test("weak direction", spread.condition, 0, False, reason))
    return Estimates(parameters, _reference(at), tests)


def placed(model: Model, best: End) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (P,) on their scales, and how they move with the unit box (P, P).

    A stiffness that is searched as a reference force goes from ln F_ref to ln K = ln F_ref - n ln d_ref.
    """
    values = model.values(best.point)
    lower, width = model.box
    slopes, z, pair = np.diag(width), lower + best.point * width, model.pair() if model.referenced else None
    if pair:
        k, n = pair
        z[k] -= values[n] * model.log_depth
        slopes[k, n] = -model.log_depth * (values[n] if model.coordinates[n].log else 1.0) * width[n]
    return z, slopes


def _edges(
    axis: Coordinate, quantity: Quantity, value: float, z: float, half: float
) -> tuple[tuple[float, float], float]:
    """Ends of an interval of a half width on the search scale, SI, and how much of it lies below the estimate."""
    # No lower than the quantity can be: a clearance that may be closed.
    reach = 1.0 if axis.log or not 0.0 < half < np.inf else min(1.0, (value - quantity.low) / half)
    # Nor outside of the bounds that were given.
    low, high = np.clip((z - reach * half, z + half), axis.lower, axis.upper)
    return (float(np.exp(low)), float(np.exp(high))) if axis.log else (float(low), float(high)), reach


def ends_of(at: Optimum) -> tuple[dict[str, tuple[float, float] | None], tuple[float, float] | None]:
    """Intervals by name, however wide, and that of the reference force."""
    z, slopes = placed(at.model, at.end)
    found = {}
    for i, (axis, label, value) in enumerate(
        zip(at.model.coordinates, at.labels, at.model.values(at.end.point).tolist(), strict=True)
    ):
        half = at.spread.half_width(slopes[i])
        found[label] = _edges(axis, _quantity(at.model, axis), value, z[i], half)[0] if np.isfinite(half) else None
    reference = _reference(at)
    return found, reference and reference.ci95


def _quantity(model: Model, axis: Coordinate) -> Quantity:
    return {**model.scene.quantities, **nuisances(model.channels)}[axis.name]


def _reference(at: Optimum) -> Reference | None:
    """F_ref, a coordinate of its own, where stiffness and exponent are both searched."""
    model = at.model
    if not model.referenced:
        return None
    (lower, width), k = model.box, model.pair()[0]
    centre, half = float(lower[k] + at.end.point[k] * width[k]), at.spread.half_width(np.diag(width)[k])
    interval = (float(np.exp(centre - half)), float(np.exp(centre + half)))
    known = half < np.log(fit_tests.WIDEST_FACTOR)
    return Reference(
        float(np.exp(model.log_depth)),
        float(np.exp(centre)),
        interval if known else None,
        noise=interval if known else None,
    )


def _curvature(at: Optimum, slope: np.ndarray, reaches: tuple[float, float]) -> float:
    """Rise of the cost at the ends of an interval, the other parameters following, over the quadratic rise.

    ``reaches``: where those ends are, in half-widths; one that is no way off has no information.
    """
    assert at.spread.covariance is not None
    quantile, along, model, best = at.spread.quantile_of(slope), at.spread.covariance @ slope, at.model, at.end
    shares = np.array([r for r in reaches if abs(r) > _NEAR])
    expected = quantile**2 * at.spread.rise * shares**2
    steps = shares[:, None] * quantile * along / np.sqrt(slope @ along)
    residuals, jacobians = evaluator(model)(best.point + steps)
    if at.noise.integrator or budget(model.scene).rough:
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
