"""From a problem to a fit: search, covariance, tests, verdict. No interval is given that is not stood behind."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from bcfj_jax import InputError
from calibration import judge
from calibration.model import Model, build, predictions, residuals_and_jacobian
from calibration.problem import NUISANCES, Experiment, Problem
from calibration.records import Record, hold_out, records_of, rms, series_of
from calibration.search import End, Screen, Search, screen, search

# A free parameter must be able to move some residual by this many sigma over its whole range.
_LEAST_REACH = 1e-2


class AllStartsFailed(RuntimeError):
    """No start's simulation succeeded; the command line exits 3."""


@dataclass(frozen=True)
class Parameter:
    """One estimate.

    Attributes:
        value: SI.
        ci95: 95 % interval, or None where no honest one exists.
        identifiable: whether the data determine it to better than a factor of two.
        at_bound: "lower", "upper" or "".
        kind: how it was found: "fitted", or "derived" from the reference force and exponent.
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    identifiable: bool
    at_bound: str
    kind: str = "fitted"


@dataclass(frozen=True)
class Reference:
    """The power law where the data are: F_ref at d_ref, with the interval of F_ref (None as in Parameter)."""

    penetration: float
    force: float
    ci95: tuple[float, float] | None


@dataclass(frozen=True)
class Fit:
    """Outcome of a calibration; ``verdict`` first."""

    verdict: str
    reasons: list[str]
    parameters: dict[str, Parameter]
    reference: Reference | None
    tests: list[judge.Test]
    starts: list[dict[str, Any]]
    residual: dict[str, Any]
    held_out: dict[str, dict[str, float]] | None
    correlation: np.ndarray | None
    labels: tuple[str, ...]
    records: list[Record]
    values: dict[str, float]
    seed: int

    def force_at(self, penetration: float) -> float:
        """Elastic force [N] of the fitted power law at a penetration [m]."""
        return self.values["stiffness"] * penetration ** self.values["exponent"]


def fit(problem: Problem, *, seed: int = 0, starts: int = 12) -> Fit:
    """Calibrate: find the optimum from several starts and say what may be believed of it.

    Args:
        problem: what to fit, from ``Problem(...)`` or ``load``.
        seed: of the start design; the same seed gives the same fit.
        starts: how many starts descend, at least 4.

    Raises:
        InputError: for a free parameter that moves no residual.
        AllStartsFailed: if no start's simulation succeeds.
    """
    if starts < 4:
        raise InputError("starts", f"{starts}", "use at least 4: agreement of fewer proves nothing")
    fitted = tuple(e for e in problem.experiments if not e.hold_out)
    model = build(problem, fitted)
    labels = tuple(slot.label(fitted) for slot in model.slots)
    given = [_given_start(problem, model)] if any(f.start is not None for f in problem.free) else []
    screened = screen(model, starts, seed)
    if not np.isfinite(screened.costs).any():
        raise AllStartsFailed(f"none of {len(screened.costs)} starting points simulates")
    _refuse_idle(problem, labels, screened)
    found = search(model, screened, given, starts)
    if found.ends[0].failure:
        raise AllStartsFailed(f"all {len(found.ends)} starts failed: {found.ends[0].failure}")
    return _judge(problem, model, fitted, labels, found, seed)


def _given_start(problem: Problem, model: Model) -> np.ndarray:
    by_name = {f.name: f for f in problem.free}
    middle = {f.name: np.sqrt(f.lower * f.upper) if f.log else 0.5 * (f.lower + f.upper) for f in problem.free}
    chosen = [by_name[s.name].start for s in model.slots]
    return np.array([middle[s.name] if c is None else c for s, c in zip(model.slots, chosen, strict=True)])


def _refuse_idle(problem: Problem, labels: tuple[str, ...], screened: Screen) -> None:
    for label, reach in zip(labels, screened.reach, strict=True):
        if reach < _LEAST_REACH:
            raise InputError(
                f"{problem.where}: [free.{label}]",
                f"'{label}' moves no residual by more than {reach:.1g} of the noise over its whole range",
                "fix it in the scene, or add data that depend on it",
            )


def _judge(
    problem: Problem, model: Model, fitted: tuple[Experiment, ...], labels: tuple[str, ...], found: Search, seed: int
) -> Fit:
    best = found.ends[0]
    depth = jnp.asarray(found.log_depth)
    records = records_of(model, fitted, best.point, found.log_depth, False)
    estimated = any(c.sigma is None for e in fitted for c in e.channels)
    seen = np.asarray(model.data.weights) > 0
    samples = int(seen.sum())
    spread = judge.spread(best, samples, estimated)
    series = series_of(model, best, np.asarray(predictions(model, jnp.asarray(best.point), depth)))
    tests = judge.agreement(found.ends, spread.scale, spread.covariance)
    # A rival that fits as well is another answer, not a failed search.
    kinds = ("not_converged", "not_identified")
    verdicts = {kind for t, kind in zip(tests, kinds, strict=True) if not t.passed}
    quality = judge.residual_tests(series, best.point.size, estimated)
    held_out, held_records = None, []
    if any(e.hold_out for e in problem.experiments):
        held_out, held_records, cost, freedom = hold_out(problem, model, best, found.log_depth)
        quality.append(judge.held_out_test(cost, freedom, spread.scale, spread.freedom, estimated))
    verdicts |= {"misfit" for t in quality if not t.passed}
    parameters, reference, identification = _estimates(model, labels, best, found.log_depth, spread)
    verdicts |= {"not_identified" for t in identification if not t.passed}
    tests += quality + identification
    verdict = judge.order(verdicts)
    if verdict != "identified":
        parameters = {name: replace(p, ci95=None) for name, p in parameters.items()}
        reference = reference and replace(reference, ci95=None)
    values = {name: float(v[0]) for name, v in model.data.fixed.items()}
    values |= {
        s.name: parameters[name].value for s, name in zip(model.slots, labels, strict=True) if s.experiment is None
    }
    sigma = np.sqrt(np.diag(spread.covariance)) if spread.covariance is not None else None
    return Fit(
        verdict=verdict,
        reasons=[t.reason for t in tests if not t.passed],
        parameters=parameters,
        reference=reference,
        tests=tests,
        starts=[_start_row(model, labels, end, found.log_depth) for end in found.ends],
        residual={
            "chi2": best.cost,
            "degrees_of_freedom": spread.freedom,
            "reduced_chi2": best.cost / spread.freedom,
            "samples": samples,
            "rms_force": rms(records),
            "noise": "estimated" if estimated else "stated",
        },
        held_out=held_out,
        correlation=None if sigma is None else spread.covariance / np.outer(sigma, sigma),
        labels=labels,
        records=records + held_records,
        values=values,
        seed=seed,
    )


def _start_row(model: Model, labels: tuple[str, ...], end: End, log_depth: float) -> dict[str, Any]:
    depth = jnp.asarray(log_depth)
    begin, finish_ = (model.values(jnp.asarray(u), depth) for u in (end.start, end.point))
    return {
        "chi2": end.cost if not end.failure else float("nan"),
        "converged": end.converged,
        "failure": end.failure,
        "from": {name: float(v) for name, v in zip(labels, begin, strict=True)},
        "to": {name: float(v) for name, v in zip(labels, finish_, strict=True)},
    }


def _estimates(
    model: Model, labels: tuple[str, ...], best: End, log_depth: float, spread: judge.Spread
) -> tuple[dict[str, Parameter], Reference | None, list[judge.Test]]:
    """Values, intervals, identifiability and bounds of every coordinate, and the tests of the latter three."""
    depth = jnp.asarray(log_depth)
    values = [float(v) for v in model.values(jnp.asarray(best.point), depth)]
    lower, width = (np.asarray(a) for a in model.box(depth))
    parameters: dict[str, Parameter] = {}
    tests: list[judge.Test] = []
    z = lower + best.point * width
    cov = None if spread.covariance is None else spread.covariance * np.outer(width, width)
    reference = None
    pair = model.pair() if model.referenced else None
    if pair:
        z, cov = _with_stiffness(z, cov, pair, values[pair[1]], model.slots[pair[1]].log, log_depth)
    for i, (slot, label) in enumerate(zip(model.slots, labels, strict=True)):
        sigma = np.inf if cov is None else float(np.sqrt(cov[i, i]))
        half = spread.quantile * sigma
        widest = np.log(judge.WIDEST_FACTOR) if slot.log else judge.WIDEST_SHARE * (slot.upper - slot.lower)
        identifiable = bool(half < widest)
        edges = (z[i] - half, z[i] + half)
        interval = tuple(float(np.exp(e)) if slot.log else float(e) for e in edges) if identifiable else None
        margin = 1e-3 * (slot.upper - slot.lower)
        at_bound = "lower" if z[i] < slot.lower + margin else "upper" if z[i] > slot.upper - margin else ""
        unit = {**model.scene.quantities, **NUISANCES}[slot.name].unit
        kind = "derived" if pair and i == pair[0] else "fitted"
        parameters[label] = Parameter(values[i], unit, interval, identifiable, at_bound, kind)  # type: ignore[arg-type]
        reason = f"the data do not determine {label}: they allow a factor or share beyond the limit"
        tests.append(judge.Test(f"{label} determined", half, widest, identifiable, reason))
        tests.append(
            judge.Test(f"{label} inside its bounds", 0, 0, not at_bound, f"{label} is at its {at_bound} bound")
        )
        if identifiable and not at_bound and spread.covariance is not None:
            slope = np.eye(len(values))[i]
            if pair and i == pair[0]:  # the coordinate is F_ref's, the interval K's
                n = pair[1]
                exponent = values[n] if model.slots[n].log else 1.0
                slope[n] = -log_depth * exponent * width[n] / width[i]
            tests.append(judge.curvature_test(label, _curvature(model, best, depth, spread, slope)))
    if not all(t.passed for t in tests if t.name.endswith("determined")):
        order = np.argsort(-np.abs(spread.weakest))[:2]
        names = " and ".join(labels[k] for k in order)
        tests.append(
            judge.Test("weak direction", spread.condition, 0, False, f"the weakest direction of the data is in {names}")
        )
    if pair:
        reference = _reference(model, best, spread, log_depth, pair, lower, width)
    return parameters, reference, tests


def _with_stiffness(
    z: np.ndarray,
    cov: np.ndarray | None,
    pair: tuple[int, int],
    exponent: float,
    exponent_is_log: bool,
    log_depth: float,
) -> tuple[np.ndarray, np.ndarray | None]:
    """From the coordinate ln F_ref to ln K = ln F_ref - n ln d_ref, and the covariance that follows."""
    k, n = pair
    change = np.eye(z.size)
    change[k, n] = -log_depth * (exponent if exponent_is_log else 1.0)
    z = z.copy()
    z[k] -= exponent * log_depth
    return z, None if cov is None else change @ cov @ change.T


def _reference(
    model: Model,
    best: End,
    spread: judge.Spread,
    log_depth: float,
    pair: tuple[int, int],
    lower: np.ndarray,
    width: np.ndarray,
) -> Reference:
    k, _ = pair
    centre = lower[k] + best.point[k] * width[k]
    interval = None
    if spread.covariance is not None:
        half = spread.quantile * float(np.sqrt(spread.covariance[k, k])) * width[k]
        if half < np.log(judge.WIDEST_FACTOR):
            interval = (float(np.exp(centre - half)), float(np.exp(centre + half)))
    return Reference(float(np.exp(log_depth)), float(np.exp(centre)), interval)


def _curvature(model: Model, best: End, depth, spread: judge.Spread, slope: np.ndarray) -> float:
    """Rise of the cost at both ends of an interval, the other parameters following, over the quadratic rise.

    The interval is that of the combination of coordinates with this slope, up to a factor.
    """
    assert spread.covariance is not None
    along = spread.covariance @ slope
    step = spread.quantile * along / np.sqrt(slope @ along)
    rises = []
    for sign in (-1.0, 1.0):
        residuals, _ = residuals_and_jacobian(model, jnp.asarray(best.point + sign * step), depth)
        rises.append(float(jnp.sum(jnp.square(residuals))) - best.cost)
    expected = spread.quantile**2 * spread.scale
    worst = max(rises, key=lambda r: abs(np.log(max(r, 1e-300) / expected)) if np.isfinite(r) else np.inf)
    return worst / expected
