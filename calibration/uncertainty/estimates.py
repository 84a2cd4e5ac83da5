"""Estimates with their intervals: values, reference force, what is determined and what is at a bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

# Name of the reference force among what is estimated.
REFERENCE = "reference force"
# In half-widths of an interval.
_NEAR = 0.1
# More numbers that each run has of its own, such as first states, are not shown one by one; fit.json has each.
_MANY_OWN = 24
Ends = tuple[float, float]


def one_by_one(names: Sequence[str]) -> list[str]:
    """Which estimates are shown one by one: all, or those that runs share, where each run has many of its own."""
    shared = [name for name in names if not name.endswith("]")]
    return shared if len(names) - len(shared) > _MANY_OWN else list(names)


@dataclass(frozen=True)
class Parameter:
    """One estimate."""

    # SI; of one with the interval to quote the expectation over errors that may act (``uncertainty.quote``).
    value: float
    unit: str
    # The headline, a 95 % interval: of ``intervals`` the widest that applies, or None where the data do not determine
    # it, or the search failed.
    ci95: Ends | None
    identifiable: bool  # whether the data determine it to better than a factor of two
    # "lower", "upper" or "": at which of its bounds it is; of one that the quantity has by nature, as 1 of an exponent,
    # "": an interval on one side says it.
    at_bound: str
    kind: str = "fitted"  # how it was found: "fitted", or "derived" from the reference force and exponent
    # What the interval of the noise comes from, or would: "covariance", "profile" or "posterior".
    interval_kind: str = "covariance"
    # 95 % intervals by kind: "noise", if law and sensor are exact, and those of ``law_miss``.
    intervals: dict[str, Ends | None] = field(default_factory=dict)
    headline: str = ""  # the kind that ci95 is, "" for none
    with_budget: Ends | None = None  # ci95, for one release more
    least_squares: float = np.nan  # the value where residuals are least; the same where none else is given

    def __post_init__(self) -> None:
        if np.isnan(self.least_squares):
            object.__setattr__(self, "least_squares", self.value)


@dataclass(frozen=True)
class Reference(Parameter):
    """The power law where the data are: its force at a penetration [m]."""

    penetration: float = 0.0

    @property
    def force(self) -> float:
        """[N]."""
        return self.value

    @property
    def noise(self) -> Ends | None:
        """The interval of the noise alone."""
        return self.intervals.get("noise")


def briefly(parameters: Mapping[str, Parameter]) -> dict[str, dict[str, Any]]:
    """Estimates with their intervals, and the kind that each is, for a file."""
    known = parameters.items()
    return {n: {"value": p.value, "unit": p.unit, "ci95": p.ci95, "headline": p.headline or None} for n, p in known}


class Estimates(NamedTuple):
    """Estimates by name, last the reference force where there is one, and their tests."""

    parameters: dict[str, Parameter]
    tests: list[fit_tests.Test]


class Moving(NamedTuple):
    """What is estimated, on the scales of its coordinates; the logarithm of the reference force is the last."""

    names: tuple[str, ...]
    z: np.ndarray  # (K,) coordinates
    slopes: np.ndarray  # (K, P) how they move with the unit box
    log: tuple[bool, ...]
    limits: np.ndarray  # (K, 2) of an interval


def moving(at: Optimum) -> Moving:
    """The estimates of an optimum."""
    model, (lower, width) = at.model, at.model.box
    names, (z, slopes), log = at.labels, placed(model, at.end), tuple(axis.log for axis in model.coordinates)
    limits = [(axis.lower, axis.upper) for axis in model.coordinates]
    if model.referenced:
        k = model.pair()[0]
        names, log, limits = (*names, REFERENCE), (*log, True), [*limits, (-np.inf, np.inf)]
        z, slopes = np.append(z, lower[k] + at.end.point[k] * width[k]), np.vstack([slopes, np.diag(width)[k]])
    return Moving(names, z, slopes, log, np.array(limits))


def placed(model: Model, best: End) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (P,) on their scales, and how they move with the unit box (P, P).

    A stiffness that is searched as a reference force goes from ln F_ref to ln K = ln F_ref - n ln d_ref.
    """
    lower, width = model.box
    slopes, z = np.diag(width), lower + best.point * width
    if model.referenced:
        (k, n), values = model.pair(), model.values(best.point)
        z[k] -= values[n] * model.log_depth
        slopes[k, n] = -model.log_depth * (values[n] if model.coordinates[n].log else 1.0) * width[n]
    return z, slopes


def in_si(low: float, high: float, log: bool, limits: Any = (-np.inf, np.inf)) -> Ends:
    """Ends of an interval of a coordinate, within its limits, as values."""
    low, high = np.clip((low, high), *limits)
    return (float(np.exp(low)), float(np.exp(high))) if log else (float(low), float(high))


def estimates(at: Optimum) -> Estimates:
    """Values, intervals, identifiability and bounds of every coordinate, and the tests of the latter three."""
    model, spread, how = at.model, at.spread, moving(at)
    values, ends, parameters, tests = model.values(at.end.point).tolist(), ends_of(at), {}, []
    least = least_of(model)
    for i, (axis, label, value) in enumerate(zip(model.coordinates, at.labels, values, strict=True)):
        z, half = how.z[i], spread.half_width(how.slopes[i])
        known = bool(half < fit_tests.widest(axis))
        # Of many decades the lowest are no thousandth of the range.
        margin = 1e-3 * (min(axis.upper - axis.lower, value) if axis.decades else axis.upper - axis.lower)
        low = z < axis.lower + margin and not least[i] > axis.lower - margin
        at_bound = "lower" if low else "upper" if z > axis.upper - margin else ""
        kind = "derived" if model.referenced and i == model.pair()[0] else "fitted"
        unit, own = quantity_of(model, axis).unit, ends[label] if known else None
        parameters[label] = Parameter(value, unit, own, known, at_bound, kind)
        inside = f"{label} is at its {at_bound} bound"
        tests.append(fit_tests.determined_test(label, half, axis))
        tests.append(fit_tests.Test(f"{label} inside its bounds", 0, 0, not at_bound, inside))
    if all(t.passed for t in tests):  # Else no interval is given, and the ends of most lie where nothing simulates.
        asked = [axis.experiment is None or budget(model).bends for axis in model.coordinates]
        for label, slope, own in zip(at.labels, how.slopes, asked, strict=False):
            if own and spread.half_width(slope) > 0.0:  # Else it is held where it is.
                tests.append(fit_tests.curvature_test(label, _curvature(at, how, slope)))
    tests.append(fit_tests.rank_test(spread))
    if not all(t.passed for t in tests if t.name.endswith("determined")):
        names = [at.labels[k] for k in np.argsort(-np.abs(spread.weakest))[:2]]
        reason = f"the weakest direction of the data is in {' and '.join(names)}"
        reason += f"; what would separate them: {separation(names)}" if len(names) > 1 else ""
        tests.append(fit_tests.Test("weak direction", spread.condition, 0, False, reason))
    if model.referenced:
        own, (force, depth) = ends[REFERENCE], np.exp([how.z[-1], model.log_depth]).tolist()
        by_kind = {"noise": own}
        parameters[REFERENCE] = Reference(force, "N", own, own is not None, "", intervals=by_kind, penetration=depth)
    return Estimates(parameters, tests)


def ends_of(at: Optimum) -> dict[str, Ends | None]:
    """Intervals by name: of coordinates however wide, of the reference force where it is determined."""
    how, found = moving(at), {}
    values = at.model.values(at.end.point).tolist()
    for k, (name, z, slope, log) in enumerate(zip(how.names, how.z, how.slopes, how.log, strict=True)):
        half, reach, widest = at.spread.half_width(slope), 1.0, np.log(fit_tests.WIDEST_FACTOR)
        if name != REFERENCE:
            axis, widest = at.model.coordinates[k], np.inf
            reach = _reach(axis, quantity_of(at.model, axis), values[k], half)
        found[name] = in_si(z - reach * half, z + half, log, how.limits[k]) if half < widest else None
    return found


def _reach(axis: Coordinate, quantity: Quantity, value: float, half: float) -> float:
    """How much of a half width lies below an estimate: none where the quantity cannot be, as of a clearance that is closed."""
    return 1.0 if axis.log or not 0.0 < half < np.inf else min(1.0, (value - quantity.low) / half)


def quantity_of(model: Model, axis: Coordinate) -> Quantity:
    """What a coordinate is of: a parameter of the scene, or a nuisance."""
    return {**model.scene.quantities, **nuisances(model.channels)}[axis.name]


def least_of(model: Model) -> np.ndarray:
    """(P,) what each coordinate's quantity is at least, on the coordinate's scale."""
    lowest = np.array([quantity_of(model, axis).low for axis in model.coordinates])
    with np.errstate(divide="ignore"):
        return np.where([axis.log for axis in model.coordinates], np.log(np.maximum(lowest, 0.0)), lowest)


def _curvature(at: Optimum, how: Moving, slope: np.ndarray) -> float:
    """Rise of the cost at the ends of an interval, the other parameters following, over the quadratic rise.

    An end is nearer where a quantity could not be, as an exponent below 1; one that is no way off has no information.
    """
    assert at.spread.covariance is not None
    along, model, best = at.spread.covariance @ slope, at.model, at.end
    whole = at.spread.quantile_of(slope) * along / np.sqrt(slope @ along)
    least = least_of(model)
    room, moves = how.z[: least.size] - least, how.slopes[: least.size] @ whole
    ends = [
        sign * min([1.0, *(max(far, 0.0) / -move for far, move in zip(room, sign * moves, strict=True) if move < 0.0)])
        for sign in (-1.0, 1.0)
    ]
    shares = np.array([end for end in ends if abs(end) > _NEAR])
    if not shares.size:
        return 1.0
    expected, steps = at.spread.rise_allowed(slope) * shares**2, shares[:, None] * whole
    residuals, jacobians = evaluator(model)(best.point + steps)
    base, _ = straightened(model.loss, best.residuals, best.jacobian)
    if at.noise.integrator or budget(model).rough:
        # From slopes, for the integration's own error makes the cost rough: that at the optimum, which is expected, and
        # the end's, of a cost of third order. Of what the predictions change by: the residuals at the optimum are all
        # noise, and times the Jacobian's own error as large as the rise.
        parts = zip(residuals, jacobians, steps, expected, strict=True)
        rises = [(rise + 2.0 * float((r - base) @ (j @ s))) / 3.0 for r, j, s, rise in parts]
    elif shares.size == 1:  # At a quantity's least the cost has a slope, which is no curvature.
        rises = [float(np.sum(np.square(residuals[0] - base)))]
    else:
        rises = [float(np.sum(np.square(r))) - best.cost for r in residuals]
    ratios = np.array(rises) / expected
    return max(ratios, key=lambda r: abs(np.log(max(r, 1e-300))) if np.isfinite(r) else np.inf)
