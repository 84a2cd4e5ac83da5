"""From a problem to a fit: check, search, noise, tests, three answers, intervals by what they allow for, verdict."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core import limits, presented
from bcfj_jax.core.errors import quoted
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import whole
from bcfj_jax.core.settings import taking
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.page import brief
from bcfj_jax.mechanism.channels import unit_of
from bcfj_jax.xla.programs import beside, make
from bcfj_jax.xla.threads import ahead
from calibration.diagnostics import answers, fit_tests, influence, misfit_location
from calibration.diagnostics.answers import Answer, clearance_tests, contacts_met, whole_contact_test
from calibration.diagnostics.optimum import Optimum, start_rows
from calibration.diagnostics.records import Record, features_of, hold_out, records_of, rms, rms_of_peak, series_of
from calibration.diagnostics.residual_tests import overstated, residual_tests
from calibration.diagnostics.scales import untold
from calibration.diagnostics.solver_error import corrected
from calibration.forward import integration
from calibration.forward.coordinates import Coordinate
from calibration.forward.model import Model, build, evaluation
from calibration.forward.runs import Contact, commonest_failure, contacts, failure
from calibration.noise.averaging import averaged, stepped
from calibration.noise.estimation import settle
from calibration.problem import NUISANCES, Problem
from calibration.search.evaluate import evaluator, loosened
from calibration.search.refinement import End
from calibration.search.starts import Screen, by_cost, referred, screen, search
from calibration.solver_budget import budget
from calibration.uncertainty import intervals, quote, systematic, unstated_filter
from calibration.uncertainty.estimates import REFERENCE, estimates, moving, quantity_of
from calibration.uncertainty.estimates import Parameter as Parameter
from calibration.uncertainty.estimates import Reference as Reference
from calibration.uncertainty.intervals import BOUND, Evidence, check_kind, half, headlined, revised
from calibration.uncertainty.law_miss import misses
from calibration.uncertainty.quote import Quoted

log = logging.getLogger("calibration")

# How far a fit has come that is told of before it is complete.
UNTESTED, NARROW, COMPLETE = "not tested yet", "errors that residuals do not show not allowed for yet", "complete"
_UNKNOWN = Answer(UNTESTED, [])
# Estimates that are held one after the other until what is left has an interval.
_HELD = 3
# Failed points of a design that are asked why.
_ASKED = 16


class AllStartsFailed(RuntimeError):
    """No start's simulation succeeded; the command line exits 3."""


class Estimated:
    """Estimates by name, and the reference force where there is one."""

    parameters: dict[str, Parameter]
    reference: Reference | None

    @property
    def every(self) -> dict[str, Parameter]:
        """All of them, the force last."""
        return {**self.parameters, **({REFERENCE: self.reference} if self.reference else {})}


def _estimating(every: dict[str, Parameter]) -> dict[str, Any]:
    """``every`` as the fields of ``Estimated``."""
    return {"parameters": {n: p for n, p in every.items() if n != REFERENCE}, "reference": every.get(REFERENCE)}


@dataclass(frozen=True)
class Conditional(Estimated):
    """What a fit says on a condition that its record leaves open: "if ``condition``", with the intervals that hold then."""

    condition: str
    parameters: dict[str, Parameter]
    reference: Reference | None


@dataclass(frozen=True, repr=False)
class Fit(Estimated):
    """Outcome of a calibration; ``verdict`` first, then the answers behind it (``diagnostics.answers``).

    ``noise`` is what was estimated of it: by channel its "sigma" (SI) and "correlation" [s]. ``check`` is what could be said
    before the solve. ``systematic``: errors that may act, what each costs, and uncertainties; None where no estimate is
    determined or no channel is read. ``conditional``: the intervals of a fit that gives none since it hangs on what the
    record does not show. ``stage``: how far it has come; "complete" but for what ``tell`` of ``fit`` receives.
    """

    verdict: str
    parameters: dict[str, Parameter]
    starts: list[dict[str, Any]]
    residual: dict[str, Any]
    labels: tuple[str, ...]
    records: list[Record]
    values: dict[str, float]
    seed: int
    noise: dict[str, dict[str, float]]
    check: dict[str, Any]
    optimum: Optimum
    reasons: list[str] = field(default_factory=list)
    search: Answer = _UNKNOWN
    data: Answer = _UNKNOWN
    law: Answer = _UNKNOWN
    reference: Reference | None = None
    tests: list[fit_tests.Test] = field(default_factory=list)
    held_out: dict[str, dict[str, float]] | None = None
    correlation: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)
    systematic: Quoted | None = None
    evidence: Evidence = field(default_factory=Evidence)
    conditional: Conditional | None = None
    stage: str = COMPLETE

    _view = "calibration.report.view"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot

    def force_at(self, penetration: float) -> float:
        """Elastic force [N] of the fitted power law at a penetration [m]."""
        return self.values["stiffness"] * penetration ** self.values["exponent"]


class FittingKeys(TypedDict, total=False):
    """``Fitting`` as keywords."""

    seed: int
    starts: int
    journal: Journal | None
    intervals: str
    systematic: bool
    tell: Callable[[Fit], None] | None


@dataclass(frozen=True)
class Fitting:
    """Settings of ``fit``."""

    seed: int = 0
    starts: int = 12
    journal: Journal | None = None
    intervals: str = "covariance"
    systematic: bool = True
    tell: Callable[[Fit], None] | None = None


@taking(Fitting)
def fit(problem: Problem, **settings: Unpack[FittingKeys]) -> Fit:
    """Calibrate: find the optimum from several starts and say what may be believed of it.

    Args:
        problem: what to fit, from ``Problem(...)`` or ``load``.
        seed: of the start design; the same seed gives the same fit.
        starts: how many starts descend, at least 4.
        journal: where finished starts are kept, and taken from.
        intervals: of the noise: "covariance" (a profile where the cost does not rise as that says), "profile" or "posterior";
            "bound" quotes every error at its limit.
        systematic: whether errors of sensor, law and fixed values are allowed for.
        tell: called with the best fit before it is tested ("not tested yet": values alone), and with the tested one before
            those errors are looked at.

    Raises:
        InputError: for a free parameter that moves no residual, and data that no model explains.
        AllStartsFailed: if no start's simulation succeeds.
        Interrupted: on Ctrl-C.
    """
    wanted = Fitting(**settings)
    starts, seed, tell = _counted(problem, wanted.starts), whole("seed", wanted.seed, least=0), wanted.tell
    check_kind(wanted.intervals)
    influence.refuse_data(problem)
    for doubt in problem.doubts:
        log.info("before the fit: %s", doubt.text)
    model = build(problem, problem.fitted)
    # What looks at one run by itself: its program, not the run.
    beside(partial(make, partial(contacts, model, np.full(len(model.coordinates), 0.5))))
    ahead(partial(evaluation, model))
    given, screened = _given_start(problem, model), screen(model, starts, seed)
    if not np.isfinite(screened.costs).any():
        why = commonest_failure(model, screened.design[:_ASKED])
        raise AllStartsFailed(f"none of {len(screened.costs)} starting points simulates: {why}")
    checked = _checked(problem, model, screened, given)
    problem, model, ends, said = search(problem, model, screened, given, starts, wanted.journal)
    fitted = problem.fitted
    ends = tuple(replace(end, failure=failure(model, end.point)) if end.failure else end for end in ends)
    if ends[0].failure:
        why = commonest_failure(model, np.array([end.point for end in ends[:_ASKED]]))
        raise AllStartsFailed(f"all {len(ends)} starts failed: {why}")
    model, ends, noise = settle(model, fitted, ends, problem.accuracy)
    spread = fit_tests.spread(ends[0], sum(e.samples for e in fitted), noise.moved, model.loss)
    at, asked = Optimum(model, fitted, ends[0], noise, spread), _Asked(seed, wanted.intervals, checked, said)
    if tell:
        tell(_untested(at, ends, asked))
    with stage("testing the fit"):
        assessed = _assess(problem, at, ends, asked)
    if not wanted.systematic:
        return _doubted(problem, assessed)
    if tell:
        tell(replace(assessed, stage=NARROW))
    return with_errors(problem, assessed, wanted.intervals == BOUND)


def _untested(at: Optimum, ends: tuple[End, ...], asked: _Asked) -> Fit:
    """The best end's values and residuals, of which nothing is known yet."""
    axes = zip(at.labels, at.model.coordinates, at.model.values(at.end.point).tolist(), strict=True)
    parameters = {n: Parameter(x, quantity_of(at.model, axis).unit, None, True, "") for n, axis, x in axes}
    records = records_of(at.model, at.experiments, at.end.point, False)
    return Fit(UNTESTED, parameters, **_shown(at, ends, asked, parameters, records), records=records, stage=UNTESTED)


def _shown(
    at: Optimum, ends: tuple[End, ...], asked: _Asked, parameters: dict[str, Parameter], records: list[Record]
) -> dict[str, Any]:
    """What a fit holds of its optimum, whatever is believed of it; ``records`` are the fitted ones."""
    found: dict[str, Any] = {"labels": at.labels, "optimum": at, "seed": asked.seed, "check": asked.checked}
    values, noise = {name: float(v[0]) for name, v in at.model.data.fixed.items()}, {}
    axes = zip(at.model.coordinates, at.labels, strict=True)
    values |= {axis.name: parameters[name].value for axis, name in axes if axis.experiment is None}
    for kind, numbers in (("sigma", at.noise.sigma), ("correlation", at.noise.correlation)):
        for channel, number in numbers.items():
            noise.setdefault(channel, {})[kind] = number
    return found | {
        "starts": start_rows(at, ends), "residual": _residual(at, records), "values": values, "noise": noise
    }  # fmt: skip


def _counted(problem: Problem, starts: int) -> int:
    """The number of starts, and whether there is a problem at all; checked."""
    if not isinstance(problem, Problem):
        remedy = 'give a calibration.Problem, or calibration.load("problem.toml")'
        raise InputError("calibration.fit", f"{quoted(problem)} is no problem", remedy)
    starts = whole("starts", starts, most=limits.STARTS)
    if starts < 4:
        raise InputError("starts", f"{starts}", "use at least 4: agreement of fewer proves nothing")
    return starts


def _doubted(problem: Problem, found: Fit) -> Fit:
    """A fit that gives no interval where the record contradicts what was given, or does not show it."""
    text = "; ".join(doubt.text for doubt in problem.doubts)
    if not text or text in found.reasons:
        return found
    conditions = [f"{d.name} is as it is given" if d.name else d.condition for d in problem.doubts]
    return _refused(found, text, " and ".join(dict.fromkeys(conditions)))


def with_errors(problem: Problem, found: Fit, bound: bool = False) -> Fit:
    """A fit with the interval to quote: filters that nobody stated (``uncertainty.unstated_filter``), and errors of which few
    act (``uncertainty.quote``); ``bound``: every error at its limit.

    Unchanged where no estimate is determined or no channel is read.
    """
    model = found.optimum.model
    if found.optimum.spread.covariance is None or not model.channels:
        return _doubted(problem, found)
    found = _with_filters(problem, found)
    at = found.optimum
    how, anew = moving(at), partial(systematic.every, problem)

    def widened(every: dict[str, Parameter], by: Quoted, whole: bool) -> dict[str, Any]:
        own = {name: (k, every[name]) for k, name in enumerate(how.names) if name in every}
        bent = {n: p.headline == "noise" and p.interval_kind != "covariance" for n, (_, p) in own.items()}
        kept = {n: bent[n] or p.headline == unstated_filter.KIND for n, (_, p) in own.items()}
        # Values of a law belong together: all move, or none.
        moved = whole and not (bound or any(bent.values()) or budget(model).rough)
        return _estimating({n: quote.with_errors(p, k, how, by, moved, kept[n]) for n, (k, p) in own.items()})

    with stage("errors that residuals do not show"):
        errors = anew(at)
        allowed = known = quote.quoted(at, errors, None, bound, anew)
        conditional = found.conditional
        if conditional:
            own = conditional.parameters
            free = np.array([bool(own[n].ci95) if n in own else True for n in at.labels])
            known = allowed if free.all() or not free.any() else quote.quoted(at, errors, free, bound, anew)
            # That of a filter that the record shows is another optimum, and stays.
            same = all(n in found.every and p.value == found.every[n].value for n, p in conditional.every.items())
            conditional = replace(conditional, **widened(conditional.every, known, same))
    every = widened(found.every, allowed, all(p.ci95 for p in found.every.values()))
    shared = (n for n, axis in zip(at.labels, model.coordinates, strict=True) if axis.experiment is None)
    values = {**found.values, **{name: every["parameters"][name].value for name in shared}}
    found = replace(found, systematic=known, conditional=conditional, values=values, **every)
    shown = (conditional or found).parameters
    said = [quote.BEYOND.format(known.beyond)] if known.beyond else []
    return _doubted(problem, replace(found, notes=[*found.notes, *said, *intervals.of_spanning(at, shown)]))


def _with_filters(problem: Problem, found: Fit) -> Fit:
    """A fit whose intervals allow for a filter that nobody stated, and whose verdict says where one hides the law."""
    at, model = found.optimum, found.optimum.model
    sensor = {axis.name for axis in model.coordinates} | model.data.chain.keys()
    asked = problem.filter == "unknown" and "time_offset" in {f.name for f in problem.free}
    if not asked or problem.loss != "linear" or budget(problem).rough or at.noise.integrator:
        return found
    # At a bound a filter may explain what the bound does.
    if found.search.answer != "converged" or any(p.at_bound for p in found.parameters.values()):
        return found
    if sensor & {"bandwidth", "resonance"} or model.data.features.size:
        return found
    how, every = moving(at), found.every
    # What filters leave open is of the noise; a shape that the law misses is another matter.
    known = [every[name].intervals.get("noise") if every[name].ci95 else None for name in how.names]
    halves = [
        half(ends, log) if ends else at.spread.half_width(slope)
        for ends, log, slope in zip(known, how.log, how.slopes, strict=True)
    ]
    with stage("filters"):
        open_ = unstated_filter.ambiguity(at, np.array(halves))
    if open_ is None:
        return found
    axes, values = dict(zip(at.labels, model.coordinates, strict=True)), model.values(open_.best.point).tolist()
    what, there = [], {}
    for k, (name, ends, log) in enumerate(zip(how.names, known, how.log, strict=True)):
        axis, p = axes.get(name), every[name]
        if open_.decisive:
            ends = (values[k], values[k]) if axis else None
        if ends is None or not (axis is None or _of_law(axis)):
            continue
        hull = open_.ends(k, ends, log, how.limits[k])
        new = " to ".join(brief(x, p.unit) for x in hull)
        if open_.decisive:
            there[name] = replace(p, value=values[k], least_squares=values[k], ci95=hull, headline=unstated_filter.KIND)
            what.append(f"{name} {new} in place of {brief(p.value, p.unit)}")
            continue
        if wide := axis is not None and half(hull, log) >= fit_tests.widest(axis):
            what.append(f"{name} anywhere from {new}")
        every[name] = p = replace(p, intervals={**p.intervals, unstated_filter.KIND: hull})
        if not wide and (axis is None or half(hull, log) > half(p.ci95, log)):
            every[name] = replace(p, ci95=hull, headline=unstated_filter.KIND)
    if not (what or open_.decisive):
        return replace(found, **_estimating(every))
    said, condition = unstated_filter.said(open_)
    text = f"{said}: {', '.join(what)}. {unstated_filter.REMEDY}"
    if open_.decisive:
        return replace(_refused(found, text, ""), conditional=Conditional(condition, there, None))
    return _refused(found, text, condition)


def _of_law(axis: Coordinate) -> bool:
    """Whether a coordinate is of the scene, and of all records."""
    return axis.name not in NUISANCES and axis.experiment is None


def _refused(found: Fit, text: str, condition: str) -> Fit:
    """A fit whose record does not tell the law from what else it may show: no interval is given but on a condition."""
    before = found.conditional or Conditional("", found.parameters, found.reference)
    conditional = replace(before, condition=" and ".join(filter(None, (before.condition, condition))))
    conditional = conditional if any(p.ci95 for p in before.parameters.values()) else None
    every = {n: _withheld(n, p) for n, p in found.every.items()}
    of_data = Answer("partly" if found.data.answer == "determined" else found.data.answer, [text, *found.data.because])
    verdict = answers.verdict(found.search, of_data, found.law)
    return replace(
        found, verdict=verdict, reasons=[text, *found.reasons], data=of_data, **_estimating(every),
        evidence=found.evidence.withheld(f"no profile is given: {verdict}"), conditional=conditional,
    )  # fmt: skip


def _withheld(name: str, p: Parameter) -> Parameter:
    return replace(p, ci95=None, headline="", intervals=p.intervals if name == REFERENCE else {})


def _checked(problem: Problem, model: Model, screened: Screen, given: list[np.ndarray]) -> dict[str, Any]:
    """The check at the start that was given, or at the best of the design."""
    values = given[0] if given else model.values(screened.design[int(np.nanargmin(screened.costs))])
    model = referred(model, by_cost(screened.design, screened.costs))
    labels = tuple(axis.label(problem.fitted) for axis in model.coordinates)
    told = influence.at_start(problem, model, labels, model.point(values), screened.reach)
    told["scales"] = untold(model, labels, model.point(values))
    for scale in told["scales"]:
        log.info("before the fit: %s. What helps: %s", scale["text"], scale["remedy"])
    return told


def _given_start(problem: Problem, model: Model) -> list[np.ndarray]:
    """Values to start from where any is given, those that are not in the middle of their bounds."""
    given = {f.name: f.start for f in problem.free if f.start is not None}

    def middle(axis: Coordinate) -> float:
        between = 0.5 * (axis.lower + axis.upper)
        return float(np.exp(between) if axis.log else np.sqrt(axis.lower * axis.upper) if axis.decades else between)

    return [np.array([given.get(axis.name, middle(axis)) for axis in model.coordinates])] if given else []


class _Seen(NamedTuple):
    """What is seen of an optimum: records, contacts, tests of the search, whether another optimum fits alike, and notes."""

    at: Optimum
    errors: np.ndarray
    records: list[Record]
    contacts: list[Contact]
    search: list[fit_tests.Test]
    rivals: fit_tests.Test
    notes: list[str]


def _looked_at(problem: Problem, at: Optimum, ends: tuple[End, ...]) -> _Seen:
    """The optimum with its residual series, as far as the solver's error lets it be known."""
    means, moved, loss = budget(at.model), at.noise.moved, at.model.loss
    if means.rough and at.spread.covariance is not None:
        # Loosely: a mean needs no more digits, and tight steps follow swings that the mean is to smooth.
        best = averaged(evaluator(loosened(at.model)), at.end, at.spread.covariance, means.rotations)
        best = stepped(evaluator(at.model), best) if loss == "linear" else best
        at = replace(at, end=best, spread=fit_tests.spread(best, at.samples, moved, loss))
    errors = integration.errors(at.model, at.end.point, at.end.residuals)
    # Starts ended as loosely as was asked for, and are compared as such.
    agreement, rivals = fit_tests.agreement((at.end, *ends[1:]), at.spread.covariance, errors, means.rough)
    model, best, errors, said = corrected(at.model, at.end, errors)
    at = replace(at, model=model, end=best, spread=fit_tests.spread(best, at.samples, moved, loss))
    records, seen = records_of(model, at.experiments, best.point, False), contacts(model, best.point)
    at = replace(at, series=series_of(at, seen, errors, problem.accuracy))
    tests = [agreement, fit_tests.integration_test(errors, best.jacobian), contacts_met(records)]
    return _Seen(at, errors, records, seen, tests, rivals, said)


def _law_of(problem: Problem, at: Optimum) -> tuple[Answer, list[fit_tests.Test], dict[str, Any] | None, list[Record]]:
    """What the residuals say of the law: the answer and its tests; errors of held-out records, and these."""
    residuals, held_out, records = at.end.residuals, None, []
    tests = residual_tests(at.series, residuals, at.end.jacobian, at.model.loss != "linear")
    if any(e.hold_out for e in problem.experiments):
        held_out, records, test = hold_out(problem, at)
        tests.append(test)
    missed, loud = answers.missed(at.series, residuals), answers.louder(at.series, residuals)
    what = answers.MODEL if all(s.touching.all() for s in at.series) else answers.LAW
    return answers.law(tests, missed, held_out, problem.adequate, loud, what), tests, held_out, records


class _Asked(NamedTuple):
    """What a fit is asked beside its problem, and what was said before the solve."""

    seed: int
    intervals: str
    checked: dict[str, Any]
    said: list[str]


def _assess(problem: Problem, at: Optimum, ends: tuple[End, ...], asked: _Asked) -> Fit:
    """What may be believed of an optimum."""
    seen = _looked_at(problem, at, ends)
    at, (law, of_law, held_out, others_seen) = seen.at, _law_of(problem, seen.at)
    model, residuals = at.model, at.end.residuals
    if at.series and all(overstated(s, residuals) for s in at.series) and not model.data.features.size:
        at = replace(at, spread=fit_tests.shown(at.spread, at.end))
    of_search, consistent = answers.search(seen.search), law.answer == "consistent"
    found, evidence = estimates(at), Evidence()
    others = clearance_tests(model, seen.contacts) + whole_contact_test(model, seen.contacts, _turns(seen))
    whole = all(t.passed for t in others)
    converged = of_search.answer == "converged" and seen.rivals.passed
    # Where the verdict stands already no profile can mend it, and where the law misses the noise's interval is not the
    # headline.
    if asked.intervals not in ("covariance", BOUND) or (converged and consistent and whole):
        found, evidence = revised(asked.intervals, at, found, asked.seed)
    # Where the law misses, the headline is of the miss: that the cost is no parabola over the noise's interval is a note.
    bent = [] if asked.intervals not in ("covariance", BOUND) or consistent else fit_tests.bent(found.tests)
    # A rival that fits as well is another answer, not a failed search.
    identification = [seen.rivals, *(t for t in found.tests if t not in bent), *others]
    of_data = answers.data(identification, {name: found.parameters[name].identifiable for name in at.labels})
    verdict = answers.verdict(of_search, of_data, law)
    exact = consistent and not any(s.declared or overstated(s, residuals) for s in at.series)
    wider = {} if exact else misses(at)
    # At a bound least squares says nothing of the spread, and where the law misses the noise alone says too little.
    given = converged and whole and not any(p.at_bound for p in found.parameters.values())
    found = headlined(at, wider, found, given and (consistent or bool(wider)))
    own, conditional = {name: found.parameters[name] for name in at.labels}, None
    # Without a whole contact, or a clearance that is crossed, no value means anything.
    if verdict == "not_identified" and whole and not any(p.ci95 for p in own.values()):
        conditional = _with_some_held(at, own, exact, seen.rivals.passed)
    if verdict not in ("identified", "adequate"):
        evidence = evidence.withheld(f"no profile is given: {verdict}")
    # The same as before the fit, now with the moves at the estimates.
    scales = untold(model, at.labels, at.end.point) if asked.checked.get("scales") else []
    said = [
        *asked.said,
        *seen.notes,
        *(f"{s['text']}. What helps: {s['remedy']}" for s in scales),
        *intervals.of_integrator(at.noise),
    ]
    said += intervals.of_bent(bent) + intervals.of_overstated(at.series, residuals)
    reasons = [*of_search.because, *law.because, *of_data.because]
    return Fit(
        verdict, **_estimating(found.parameters), **_shown(at, ends, asked, own, seen.records),
        reasons=reasons + ([] if consistent else misfit_location.reasons(seen.records)),
        search=of_search, data=of_data, law=law, tests=seen.search + of_law + identification,
        held_out=held_out, correlation=_correlation(at), records=seen.records + others_seen,
        notes=said, evidence=evidence, conditional=conditional,
    )  # fmt: skip


def _correlation(at: Optimum) -> np.ndarray | None:
    if at.spread.covariance is None:
        return None
    sigma = np.sqrt(np.diag(at.spread.covariance))
    return at.spread.covariance / np.outer(sigma, sigma)


def _residual(at: Optimum, records: list[Record]) -> dict[str, Any]:
    """``residual`` of ``fit.json``."""
    chi2 = float(np.sum(at.end.residuals**2))
    kinds = {"estimated" if c.sigma is None else "stated" for e in at.experiments for c in e.channels} or {"stated"}
    return {
        "chi2": chi2,
        "degrees_of_freedom": at.spread.freedom,
        "reduced_chi2": chi2 / at.spread.freedom,
        "samples": at.samples,
        "rms": rms(records),
        "rms_of_peak": rms_of_peak(records),
        "noise": kinds.pop() if len(kinds) == 1 else "partly estimated",
        "loss": at.model.loss,
        "features": features_of(at.model, at.experiments, at.end.residuals),
    }


def _with_some_held(at: Optimum, parameters: dict[str, Parameter], exact: bool, alone: bool) -> Conditional | None:
    """What a fit knows on the condition that some estimates are right: those at a bound, then the least determined.

    ``exact``: whether residuals are the noise; ``alone``: whether no other optimum fits alike.
    """
    labels, names = at.labels, np.array(at.labels)
    fixed = np.array([bool(parameters[name].at_bound) for name in labels])
    own = np.array([axis.name not in NUISANCES for axis in at.model.coordinates])
    for _ in range(_HELD):
        if fixed[own].all():
            break
        spread = fit_tests.spread(at.end, at.samples, at.noise.moved, at.model.loss, ~fixed)
        if spread.covariance is not None:
            held = replace(at, spread=spread, end=replace(at.end, jacobian=at.end.jacobian * ~fixed))
            wider = {} if exact else misses(held)
            if not (exact or wider):
                return None
            found = headlined(held, wider, estimates(held), True)
            for name in names[fixed]:
                found.parameters[name] = _withheld(name, found.parameters[name])
            if any(found.parameters[name].ci95 for name in names[own & ~fixed]):
                said = [f"{n} is {brief(parameters[n].value, parameters[n].unit)}" for n in names[fixed]]
                said += [] if alone else ["no other optimum is the right one"]
                return Conditional(" and ".join(said), **_estimating(found.parameters)) if said else None
        weakest = np.where(own & ~fixed, np.abs(spread.weakest), -1.0)
        fixed[int(np.argmax(weakest))] = True
    return None


def _turns(seen: _Seen) -> bool:
    """Whether a contact reaches its peak inside some record: the predicted force, or where none is read the contact."""
    names = {c.name for c in seen.contacts}
    every = [item for r in seen.records for item in r.prediction.items()]
    forces = [p for name, p in every if unit_of(name) == "N" and name.split(".")[0] in names]
    if not forces:
        return any(c.turned for c in seen.contacts)
    return any(int(np.argmax(np.abs(p))) < p.size - 1 for p in forces)
