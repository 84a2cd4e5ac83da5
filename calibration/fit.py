"""From a problem to a fit: check, search, noise, tests, three answers, intervals by what they allow for, verdict."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core import limits, presented
from bcfj_jax.core.errors import quoted
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import whole
from bcfj_jax.core.threads import ahead
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.page import brief
from bcfj_jax.mechanism.channels import unit_of
from calibration.diagnostics import answers, fit_tests, influence, law_errors, misfit_location, systematic
from calibration.diagnostics.answers import Answer, contacts_met
from calibration.diagnostics.clearance import clearance_tests, whole_contact_test
from calibration.diagnostics.records import Record, features_of, hold_out, records_of, rms, rms_of_peak, series_of
from calibration.diagnostics.residual_tests import Series, overstated, residual_tests
from calibration.diagnostics.scales import untold
from calibration.diagnostics.solver_error import corrected
from calibration.diagnostics.systematic import Budget
from calibration.forward import integration
from calibration.forward.model import Model, build, evaluation, predictions
from calibration.forward.runs import Contact, commonest_failure, contacts, failure
from calibration.noise.averaging import averaged, stepped
from calibration.noise.estimation import settle
from calibration.noise.noise_model import Estimate
from calibration.problem import NUISANCES, Experiment, Problem
from calibration.search.evaluate import evaluator, loosened
from calibration.search.refinement import End
from calibration.search.starts import Screen, batch_size, by_cost, reference_depth, screen, search
from calibration.solver_budget import budget
from calibration.uncertainty import notes, unstated_filter
from calibration.uncertainty.estimates import REFERENCE, estimates, placed, widened
from calibration.uncertainty.estimates import Parameter as Parameter
from calibration.uncertainty.estimates import Reference as Reference
from calibration.uncertainty.intervals import Evidence, check_kind, half, headlined, revised
from calibration.uncertainty.law_miss import clustered, discrepancy, in_blocks

log = logging.getLogger("calibration")

# Estimates that are held one after the other until what is left has an interval.
_HELD = 3
# Failed points of a design that are asked why.
_ASKED = 16


class AllStartsFailed(RuntimeError):
    """No start's simulation succeeded; the command line exits 3."""


@dataclass(frozen=True)
class Optimum:
    """Where a fit ended, for what goes on from there.

    Attributes:
        model: with the weights of the noise as it was found.
        end: the best end on it: unit-box point, white residuals and their Jacobian.
        log_depth: ln of the reference penetration [m].
        spread: covariance of the coordinates.
        noise: what was found of it.
        series: white residuals by record and channel.
    """

    model: Model
    end: End
    log_depth: float
    spread: fit_tests.Spread
    noise: Estimate
    series: list[Series] = field(default_factory=list)


@dataclass(frozen=True)
class Conditional:
    """What a fit says on a condition that its record leaves open: "if ``condition``", with the intervals that hold then."""

    condition: str
    parameters: dict[str, Parameter]
    reference: Reference | None


@dataclass(frozen=True, repr=False)
class Fit:
    """Outcome of a calibration; ``verdict`` first, then the answers behind it (``diagnostics.answers``).

    ``noise`` is what was estimated of it: by channel its "sigma" (SI) and "correlation" [s]. ``check`` is what could be
    said before the solve (``influence.at_start``). ``notes`` say what a reader must know though nothing failed.
    ``systematic``: errors that no residual shows, and what the estimates move by (``diagnostics.systematic``); None
    where no estimate is determined or no channel is read. ``conditional``: the intervals of a fit that gives none since it hangs
    on what the record does not show.
    """

    verdict: str
    reasons: list[str]
    search: Answer
    data: Answer
    law: Answer
    parameters: dict[str, Parameter]
    reference: Reference | None
    tests: list[fit_tests.Test]
    starts: list[dict[str, Any]]
    residual: dict[str, Any]
    held_out: dict[str, dict[str, float]] | None
    correlation: np.ndarray | None
    labels: tuple[str, ...]
    records: list[Record]
    values: dict[str, float]
    seed: int
    noise: dict[str, dict[str, float]]
    check: dict[str, Any]
    notes: list[str]
    optimum: Optimum
    systematic: Budget | None = None
    evidence: Evidence = field(default_factory=Evidence)
    conditional: Conditional | None = None

    _view = "calibration.report.view"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot

    def force_at(self, penetration: float) -> float:
        """Elastic force [N] of the fitted power law at a penetration [m]."""
        return self.values["stiffness"] * penetration ** self.values["exponent"]


def fit(
    problem: Problem,
    *,
    seed: int = 0,
    starts: int = 12,
    journal: Journal | None = None,
    intervals: str = "covariance",
    systematic: bool = True,
) -> Fit:
    """Calibrate: find the optimum from several starts and say what may be believed of it.

    Args:
        problem: what to fit, from ``Problem(...)`` or ``load``.
        seed: of the start design; the same seed gives the same fit.
        starts: how many starts descend, at least 4.
        journal: where finished starts are kept, and taken from.
        intervals: "covariance" (a profile where the cost does not rise as that says), "profile" or "posterior".
        systematic: whether errors of sensor, law and fixed values are allowed for (``with_budget``).

    Raises:
        InputError: for a free parameter that moves no residual, and data that no model explains.
        AllStartsFailed: if no start's simulation succeeds.
        Interrupted: on Ctrl-C.
    """
    if not isinstance(problem, Problem):
        remedy = 'give a calibration.Problem, or calibration.load("problem.toml")'
        raise InputError("calibration.fit", f"{quoted(problem)} is no problem", remedy)
    starts, seed = whole("starts", starts, most=limits.STARTS), whole("seed", seed, least=0)
    if starts < 4:
        raise InputError("starts", f"{starts}", "use at least 4: agreement of fewer proves nothing")
    check_kind(intervals)
    influence.refuse_data(problem)
    for doubt in problem.doubts:
        log.info("before the fit: %s", doubt.text)
    fitted = tuple(e for e in problem.experiments if not e.hold_out)
    model = build(problem, fitted)
    ahead(partial(evaluation, model))
    if systematic:
        ahead(partial(law_errors.get_ready, model))
    labels = tuple(axis.label(fitted) for axis in model.coordinates)
    given = [_given_start(problem, model)] if any(f.start is not None for f in problem.free) else []
    screened = screen(model, starts, seed)
    if not np.isfinite(screened.costs).any():
        why = commonest_failure(model, screened.design[:_ASKED], 0.0)
        raise AllStartsFailed(f"none of {len(screened.costs)} starting points simulates: {why}")
    checked = _checked(problem, model, labels, fitted, screened, given)
    found = search(model, screened, given, starts, journal)
    ends = tuple(
        replace(end, failure=failure(model, end.point, found.log_depth)) if end.failure else end for end in found.ends
    )
    if ends[0].failure:
        why = commonest_failure(model, np.array([end.point for end in ends[:_ASKED]]), found.log_depth)
        raise AllStartsFailed(f"all {len(ends)} starts failed: {why}")
    model, ends, noise = settle(model, fitted, ends, found.log_depth, problem.accuracy)
    assessed = _assess(problem, fitted, labels, model, ends, found.log_depth, noise, seed, checked, intervals)
    return with_budget(problem, assessed) if systematic else _doubted(problem, assessed)


def _doubted(problem: Problem, found: Fit) -> Fit:
    """A fit that gives no interval where the record contradicts what was given, or does not show it."""
    text = "; ".join(doubt.text for doubt in problem.doubts)
    if not text or text in found.reasons:
        return found
    conditions = [f"{d.name} is as it is given" if d.name else d.condition for d in problem.doubts]
    return _refused(found, text, " and ".join(dict.fromkeys(conditions)))


def with_budget(problem: Problem, found: Fit) -> Fit:
    """A fit with the errors that its residuals do not show: filters that nobody stated (``uncertainty.unstated_filter``),
    ``systematic``, and the intervals that allow for them.

    Unchanged where no estimate is determined or no channel is read.
    """
    model = found.optimum.model
    if found.optimum.spread.covariance is None or not model.channels:
        return _doubted(problem, found)
    found = _with_filters(problem, found)
    allowed = _systematic(problem, found)

    def wider(parameters: dict[str, Parameter]) -> dict[str, Parameter]:
        axes = dict(zip(found.labels, model.coordinates, strict=True))
        return {
            name: replace(p, with_budget=widened(axes[name], p, partial(allowed.widened, name)))
            for name, p in parameters.items()
        }

    reference = found.reference and found.reference.widened(partial(allowed.widened, REFERENCE))
    conditional = found.conditional
    if conditional:
        own = conditional.reference and conditional.reference.widened(partial(allowed.widened, REFERENCE))
        conditional = replace(conditional, parameters=wider(conditional.parameters), reference=own)
    parameters = wider(found.parameters)
    found = replace(
        found, systematic=allowed, parameters=parameters, reference=reference, conditional=conditional
    )  # fmt: skip
    return _doubted(problem, found)


def _with_filters(problem: Problem, found: Fit) -> Fit:
    """A fit whose intervals allow for a filter that nobody stated, and whose verdict says where one hides the law."""
    at, model = found.optimum, found.optimum.model
    sensor = {axis.name for axis in model.coordinates} | model.data.chain.keys()
    asked = problem.filter == "unknown" and "time_offset" in {f.name for f in problem.free}
    if not asked or problem.loss != "linear" or budget(problem.scene).rough or at.noise.integrator:
        return found
    # At a bound a filter may explain what the bound does.
    if any(p.at_bound for p in found.parameters.values()):
        return found
    if found.search.answer != "converged" or sensor & {"bandwidth", "resonance"} or model.data.features.size:
        return found
    fitted = tuple(e for e in problem.experiments if not e.hold_out)
    slopes = placed(model, at.end, at.log_depth)[1]
    shown = [found.parameters[name].ci95 for name in found.labels]
    halves = [
        half(ends, axis.log) if ends else at.spread.half_width(slope)
        for ends, axis, slope in zip(shown, model.coordinates, slopes, strict=True)
    ]
    reference = found.reference
    if reference:
        k = model.pair()[0]
        own = at.spread.half_width(np.diag(model.box(at.log_depth)[1])[k])
        halves.append(half(reference.ci95, True) if reference.ci95 else own)
    with stage("filters"):
        open_ = unstated_filter.ambiguity(model, fitted, at.series, at.end, at.log_depth, np.array(halves))
    if open_ is None:
        return found
    kept = [k for k, axis in enumerate(model.coordinates) if axis.name not in NUISANCES and axis.experiment is None]
    if open_.decisive:
        values, moved, there = model.values(open_.best.point, at.log_depth), [], {}
        for k in kept:
            name, p = found.labels[k], found.parameters[found.labels[k]]
            ends = open_.ends(k, (float(values[k]), float(values[k])), model.coordinates[k])
            there[name] = replace(p, value=float(values[k]), ci95=ends, headline=unstated_filter.KIND)
            moved.append(
                f"{name} {brief(ends[0], p.unit)} to {brief(ends[1], p.unit)} in place of {brief(p.value, p.unit)}"
            )
        text = f"{unstated_filter.seen(open_)}: {', '.join(moved)}. {unstated_filter.REMEDY}"
        return replace(_refused(found, text, ""), conditional=Conditional(unstated_filter.there(open_), there, None))
    parameters, wide = dict(found.parameters), []
    for k in kept:
        axis, name = model.coordinates[k], found.labels[k]
        p = parameters[name]
        if p.ci95 is None:
            continue
        ends = open_.ends(k, p.ci95, axis)
        parameters[name] = replace(p, intervals={**p.intervals, unstated_filter.KIND: ends})
        if half(ends, axis.log) >= fit_tests.widest(axis):
            wide.append(f"{name} anywhere from {brief(ends[0], p.unit)} to {brief(ends[1], p.unit)}")
        elif half(ends, axis.log) > half(p.ci95, axis.log):
            parameters[name] = replace(parameters[name], ci95=ends, headline=unstated_filter.KIND)
    if wide:
        text = f"{unstated_filter.hidden(open_)}: {', '.join(wide)}. {unstated_filter.REMEDY}"
        return _refused(found, text, unstated_filter.NONE)
    if reference and reference.ci95:
        reference = replace(reference, ci95=open_.ends(-1, reference.ci95))
    return replace(found, parameters=parameters, reference=reference)


def _refused(found: Fit, text: str, condition: str) -> Fit:
    """A fit whose record does not tell the law from what else it may show: no interval is given but on a condition."""
    before = found.conditional or Conditional("", found.parameters, found.reference)
    conditional = replace(before, condition=" and ".join(filter(None, (before.condition, condition))))
    conditional = conditional if any(p.ci95 for p in before.parameters.values()) else None
    parameters = {n: replace(p, ci95=None, headline="", intervals={}) for n, p in found.parameters.items()}
    reference = found.reference and replace(found.reference, ci95=None)
    of_data = Answer("partly" if found.data.answer == "determined" else found.data.answer, [text, *found.data.because])
    verdict = answers.verdict(found.search, of_data, found.law)
    return replace(
        found, verdict=verdict, reasons=[text, *found.reasons], data=of_data, parameters=parameters,
        reference=reference, evidence=found.evidence.withheld(f"no profile is given: {verdict}"), conditional=conditional,
    )  # fmt: skip


def _given_start(problem: Problem, model: Model) -> np.ndarray:
    by_name = {f.name: f for f in problem.free}
    middle = [np.exp(0.5 * (s.lower + s.upper)) if s.log else 0.5 * (s.lower + s.upper) for s in model.coordinates]
    middle = [np.sqrt(s.lower * s.upper) if s.decades else m for s, m in zip(model.coordinates, middle, strict=True)]
    chosen = [by_name[s.name].start for s in model.coordinates]
    return np.array([m if c is None else c for m, c in zip(middle, chosen, strict=True)])


def _checked(
    problem: Problem,
    model: Model,
    labels: tuple[str, ...],
    fitted: tuple[Experiment, ...],
    screened: Screen,
    given: list[np.ndarray],
) -> dict[str, Any]:
    """The check at the start that was given, or at the best of the design."""
    point, depth = screened.design[int(np.nanargmin(screened.costs))], 0.0
    if model.referenced:
        depth = reference_depth(model, by_cost(screened.design, screened.costs), 0.0)
        point = model.point(model.values(point, 0.0), depth)
    if given:
        point = model.point(given[0], depth)
    told = influence.at_start(problem, model, labels, point, depth, screened.reach, influence.noise_floor(fitted))
    told["scales"] = untold(model, labels, point, depth)
    for scale in told["scales"]:
        log.info("before the fit: %s. What helps: %s", scale["text"], scale["remedy"])
    return told


def _assess(
    problem: Problem,
    fitted: tuple[Experiment, ...],
    labels: tuple[str, ...],
    model: Model,
    ends: tuple[End, ...],
    log_depth: float,
    noise: Estimate,
    seed: int,
    checked: dict[str, Any],
    intervals: str,
) -> Fit:
    best = ends[0]
    samples = sum(e.samples for e in fitted)
    spread = fit_tests.spread(best, samples, noise.moved, model.loss)
    if budget(model.scene).rough and spread.covariance is not None:
        # Loosely: a mean needs no more digits, and tight steps follow swings that the mean is to smooth.
        rotations = budget(model.scene).rotations
        best = averaged(evaluator(loosened(model), log_depth), best, spread.covariance, rotations)
        best = stepped(evaluator(model, log_depth), best) if model.loss == "linear" else best
        spread = fit_tests.spread(best, samples, noise.moved, model.loss)
    errors = integration.errors(model, best.point, log_depth, best.residuals)
    # Starts ended as loosely as was asked for, and are compared as such.
    agreement, rivals = fit_tests.agreement((best, *ends[1:]), spread.covariance, errors, budget(model.scene).rough)
    model, best, errors, said = corrected(model, best, log_depth, errors)
    spread = fit_tests.spread(best, samples, noise.moved, model.loss)
    records = records_of(model, fitted, best.point, log_depth, False)
    seen = contacts(model, best.point, log_depth)
    converged = [agreement, fit_tests.integration_test(errors, best.jacobian), contacts_met(records)]
    series = series_of(model, fitted, seen, noise, best.residuals, errors, problem.accuracy)
    quality = residual_tests(series, best.residuals, best.jacobian, model.loss != "linear")
    held_out, held_records = None, []
    if any(e.hold_out for e in problem.experiments):
        held_out, held_records, test = hold_out(problem, model, best, log_depth, spread, noise)
        quality.append(test)
    if series and all(overstated(s, best.residuals) for s in series) and not model.data.features.size:
        spread = fit_tests.shown(spread, best)
    of_search = answers.search(converged)
    missed, loud = answers.missed(series, best.residuals), answers.louder(series, best.residuals)
    of_law = answers.law(quality, missed, held_out, problem.adequate, loud)
    parameters, reference, identification = estimates(model, labels, best, log_depth, spread, bool(noise.integrator))
    evidence = Evidence()
    others = clearance_tests(model, seen) + whole_contact_test(model, seen, _turns(records, seen))
    sound = of_search.answer == "converged" and of_law.answer == "consistent" and rivals.passed
    # Where the verdict stands already no profile can mend it, and where the law misses the noise's interval is not the
    # headline.
    if intervals != "covariance" or (sound and all(t.passed for t in others)):
        parameters, reference, identification, evidence = revised(
            intervals, model, labels, best.point, log_depth, spread, parameters, reference, identification,
            estimated=list(noise.sigma), batch=batch_size(len(ends)), seed=seed,
        )  # fmt: skip
    bent = [] if intervals != "covariance" or of_law.answer == "consistent" else fit_tests.bent(identification)
    # Where the law misses, the headline is of the miss: that the cost is no parabola over the noise's interval is a note.
    identification = [t for t in identification if t not in bent]
    # A rival that fits as well is another answer, not a failed search.
    identification = [rivals, *identification, *others]
    tests = converged + quality + identification
    of_data = answers.data(identification, {name: p.identifiable for name, p in parameters.items()})
    verdict = answers.verdict(of_search, of_data, of_law)
    exact = of_law.answer == "consistent" and not any(s.declared or overstated(s, best.residuals) for s in series)
    misses = {} if exact else _misses(model, series, best, spread)
    # At a bound least squares says nothing of the spread, and where the law misses the noise alone says too little.
    given = of_search.answer == "converged" and rivals.passed and all(t.passed for t in others)
    given = (
        given and not any(p.at_bound for p in parameters.values()) and (of_law.answer == "consistent" or bool(misses))
    )
    parameters, reference = headlined(model, labels, best, log_depth, misses, parameters, reference, given)
    conditional = None
    # Without a whole contact, or a clearance that is crossed, no value means anything.
    if verdict == "not_identified" and all(t.passed for t in others) and not any(p.ci95 for p in parameters.values()):
        conditional = _with_some_held(
            model, labels, best, log_depth, series, parameters, noise, samples, exact, rivals.passed
        )
    if verdict not in ("identified", "adequate"):
        evidence = evidence.withheld(f"no profile is given: {verdict}")
    # The same as before the fit, now with the moves at the estimates.
    scales = untold(model, labels, best.point, log_depth) if checked.get("scales") else []
    values = {name: float(v[0]) for name, v in model.data.fixed.items()}
    values |= {
        s.name: parameters[name].value
        for s, name in zip(model.coordinates, labels, strict=True)
        if s.experiment is None
    }
    sigma = np.sqrt(np.diag(spread.covariance)) if spread.covariance is not None else None
    return Fit(
        verdict=verdict,
        reasons=[*of_search.because, *of_law.because, *of_data.because]
        + (misfit_location.reasons(records) if of_law.answer != "consistent" else []),
        search=of_search,
        data=of_data,
        law=of_law,
        parameters=parameters,
        reference=reference,
        tests=tests,
        starts=_start_rows(model, labels, ends, log_depth),
        residual={
            "chi2": float(np.sum(best.residuals**2)),
            "degrees_of_freedom": spread.freedom,
            "reduced_chi2": float(np.sum(best.residuals**2)) / spread.freedom,
            "samples": samples,
            "rms": rms(records),
            "rms_of_peak": rms_of_peak(records),
            "noise": _noise_source(fitted),
            "loss": model.loss,
            "features": features_of(model, fitted, best.residuals),
        },
        held_out=held_out,
        correlation=None if sigma is None else spread.covariance / np.outer(sigma, sigma),
        labels=labels,
        records=records + held_records,
        values=values,
        seed=seed,
        noise=_by_channel(noise),
        check=checked,
        optimum=Optimum(model, best, log_depth, spread, noise, series),
        notes=said
        + [f"{s['text']}. What helps: {s['remedy']}" for s in scales]
        + notes.of_integrator(noise)
        + notes.wide(model, parameters)
        + notes.bent(bent)
        + notes.overstated_noise(series, best.residuals),
        evidence=evidence,
        conditional=conditional,
    )


def _with_some_held(
    model: Model, labels: tuple[str, ...], best: End, log_depth: float, series: list[Series],
    parameters: dict[str, Parameter], noise: Estimate, samples: int, exact: bool, alone: bool,
) -> Conditional | None:  # fmt: skip
    """What a fit knows on the condition that some estimates are right: those at a bound, then the least determined.

    Args:
        model, labels, best, log_depth, series: of the optimum.
        parameters: its estimates, none with an interval.
        noise, samples: what was found of it, from so many samples.
        exact: whether residuals are the noise.
        alone: whether no other optimum fits alike.
    """
    fixed = np.array([bool(parameters[name].at_bound) for name in labels])
    own = np.array([axis.name not in NUISANCES for axis in model.coordinates])
    for _ in range(_HELD):
        if fixed[own].all():
            break
        part, rest = fit_tests.held(best, fixed, samples, noise.moved, model.loss)
        spread = fit_tests.padded(part, fixed)
        if spread.covariance is not None:
            misses = {} if exact else _misses(model, series, rest, part)
            if not (exact or misses):
                return None
            kinds = {kind: fit_tests.padded(one, fixed) for kind, one in misses.items()}
            found, reference, _ = estimates(model, labels, best, log_depth, spread, bool(noise.integrator))
            found, reference = headlined(model, labels, best, log_depth, kinds, found, reference, True)
            for name in np.array(labels)[fixed]:
                found[name] = replace(found[name], ci95=None, headline="", intervals={})
            if any(found[name].ci95 for name in np.array(labels)[own & ~fixed]):
                said = [f"{n} is {brief(parameters[n].value, parameters[n].unit)}" for n in np.array(labels)[fixed]]
                said += [] if alone else ["no other optimum is the right one"]
                return Conditional(" and ".join(said), found, reference) if said else None
        weakest = np.where(own & ~fixed, np.abs(spread.weakest), -1.0)
        fixed[int(np.argmax(weakest))] = True
    return None


def _misses(model: Model, series: list[Series], best: End, spread: fit_tests.Spread) -> dict[str, fit_tests.Spread]:
    """Spreads by kind that allow for a law that misses, and for runs that differ; none of a robust loss or a rough cost."""
    if spread.covariance is None or model.loss != "linear" or budget(model.scene).rough:
        return {}
    shape = model.data.weights.shape
    runs = np.arange(best.residuals.size) // int(np.prod(shape[1:])) if shape[1] else np.zeros(best.residuals.size)
    readings = np.arange(best.residuals.size) < int(np.prod(shape))
    own = any(axis.experiment is not None for axis in model.coordinates)
    found = {} if own else clustered(runs[readings], best.residuals[readings], best.jacobian[readings], spread)
    if "robust" not in found and (within := in_blocks(series, best.residuals, best.jacobian, spread)):
        found["robust"] = within
    process = discrepancy(series, best.residuals, best.jacobian, spread)
    return found | ({"discrepancy": process.spread} if process else {})


def _systematic(problem: Problem, found: Fit) -> Budget:
    """The budget of errors."""
    best, log_depth, spread = found.optimum.end, found.optimum.log_depth, found.optimum.spread
    model, labels = found.optimum.model, found.labels
    fitted = tuple(e for e in problem.experiments if not e.hold_out)
    seen = contacts(model, best.point, log_depth)
    deepest, peak = (max((getattr(c, key) for c in seen), default=0.0) for key in ("deepest", "peak"))
    longest = max((float(c.durations.max(initial=0.0)) for c in seen), default=0.0)
    law = law_errors.signatures(model, best.point, log_depth, deepest, peak, longest)
    names = dict.fromkeys((*problem.tolerances, *(name for e in fitted for name in e.tolerances)))
    common = problem.tolerances
    tolerances = {
        n: np.array([e.tolerances.get(n, 0.0 if n in e.fixed else common.get(n, 0.0)) for e in fitted]) for n in names
    }
    stated = frozenset(n for n in model.data.chain if all(n in e.fixed for e in fitted))
    errors = [
        *systematic.of_sensor(model, predictions(model, best.point, log_depth), found.optimum.series, stated),
        *systematic.of_law(law),
        *systematic.of_fixed(model, best, log_depth, tolerances, stated),
        *systematic.of_weight(model, best, log_depth, found.optimum.series),
    ]
    slopes, values = placed(model, best, log_depth)[1], model.values(best.point, log_depth)
    sizes = [1.0 if axis.log else max(abs(v), 1e-300) for axis, v in zip(model.coordinates, values, strict=True)]
    if model.referenced:
        slopes = np.vstack([slopes, np.diag(model.box(log_depth)[1])[model.pair()[0]]])
        labels, sizes = (*labels, REFERENCE), [*sizes, 1.0]
    return systematic.budget_of(model, labels, best, spread, errors, slopes, np.array(sizes), list(law.values()))


def _turns(records: list[Record], seen: list[Contact]) -> bool:
    """Whether a contact reaches its peak inside some record: the predicted force, or where none is read the contact."""
    names = {c.name for c in seen}
    forces = [
        p for r in records for name, p in r.prediction.items() if unit_of(name) == "N" and name.split(".")[0] in names
    ]
    return any(int(np.argmax(np.abs(p))) < p.size - 1 for p in forces) if forces else any(c.turned for c in seen)


def _noise_source(fitted: tuple[Experiment, ...]) -> str:
    """Where the noise comes from."""
    kinds = {"estimated" if c.sigma is None else "stated" for e in fitted for c in e.channels} or {"stated"}
    return kinds.pop() if len(kinds) == 1 else "partly estimated"


def _by_channel(noise: Estimate) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for kind, numbers in (("sigma", noise.sigma), ("correlation", noise.correlation)):
        for channel, number in numbers.items():
            found.setdefault(channel, {})[kind] = number
    return found


def _start_rows(model: Model, labels: tuple[str, ...], ends: tuple[End, ...], log_depth: float) -> list[dict[str, Any]]:
    begin, finish = (model.values(np.array(u), log_depth) for u in ([e.start for e in ends], [e.point for e in ends]))
    return [
        {
            "chi2": end.cost if not end.failure else float("nan"),
            "converged": end.converged,
            "failure": end.failure,
            "from": dict(zip(labels, a.tolist(), strict=True)),
            "to": dict(zip(labels, b.tolist(), strict=True)),
        }
        for end, a, b in zip(ends, begin, finish, strict=True)
    ]
