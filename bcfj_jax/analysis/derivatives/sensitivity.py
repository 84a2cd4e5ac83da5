"""The verb ``sensitivity``: histories, their derivatives, those of features, and what they are worth."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple, Unpack

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from bcfj_jax.analysis.derivatives.bounds import Budget, Climb, bounded, climb, feature_bounds, first_plan, luckless
from bcfj_jax.analysis.derivatives.certificate import NAN, Certificate, Comparison, apart, norm
from bcfj_jax.analysis.derivatives.contact_events import BOUNDING, TIGHTER, check_followed, filled
from bcfj_jax.analysis.derivatives.differences import beside, certified, unasked, witnessed
from bcfj_jax.analysis.derivatives.gradient import gradient, reversed_certificate, reversible
from bcfj_jax.analysis.derivatives.jacobian import Histories, Level
from bcfj_jax.analysis.derivatives.measures import measure, sampling
from bcfj_jax.analysis.derivatives.names import complete, default_features, event
from bcfj_jax.analysis.derivatives.names import feature as named
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.repeating import settled
from bcfj_jax.analysis.derivatives.steady import Steady, first_of_steady, prepared
from bcfj_jax.analysis.derivatives.steady import steady as steady_of
from bcfj_jax.core import presented
from bcfj_jax.core.errors import InputError, one_of, quoted, texts
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import Quantity, scalar, whole
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import reason
from bcfj_jax.io.stop import OutOfTime
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.solve.plan import Plan, Solving, SolvingKeys, force_error, plan
from bcfj_jax.solve.simulation import compiled, ready
from bcfj_jax.xla.threads import ahead, together

MODES = ("auto", "forward", "reverse")
DIFFERENCES = ("direction", "each", "none")
KNOBS = ("smoothing", "friction_speed")
_MANY = 50
_AVERAGE = Quantity("average", "s", "width of the moving average", 0.0, open_low=True)
_BUDGET = Quantity("budget", "s", "time for far tighter solves and central differences", 0.0)
# In reverse mode, by whether the model is stiff: ratio of the tolerances that a bound is from (Tsit5, BDF).
_BACKWARD = {False: 64.0, True: 8.0}
# Features that do not hang on where samples are, and samples in a turn that they need.
_INTEGRATED, _TURN = ("mean", "impulse", "contact_fraction"), 100


class Sensitivity(NamedTuple):
    """Derivatives of a run, as NumPy arrays.

    Attributes:
        times: (T,) [s].
        wrt: names of the parameters.
        force: per contact (T, 3) or (T, k, 3) [N], from the same solve as the derivatives.
        derivative: per parameter and contact the same shape [N per SI unit]; empty in reverse mode.
        features: value by name, in ``analysis.features.KINDS``.
        feature_derivatives: per parameter and feature, per SI unit.
        certificate: how good they are; None where it was not asked for.
        status, reason, failure_time: as ``Run``.
        stats: steps, tolerance, wall_s and compile_s of all solves with derivatives, levels.
        steady: of the motion that the run settles to, where that was asked for and the model knows its pitch.
        values: of the parameters of ``wrt`` [SI], at which the derivatives are taken.
        reasons: by name, why a feature of a single contact is NaN.
        sampled: names of features that are known from samples alone, whose bounds count what lies between samples.
    """

    times: Float[np.ndarray, " T"]
    wrt: tuple[str, ...]
    force: dict[str, Float[np.ndarray, "T ... 3"]]
    derivative: dict[str, dict[str, Float[np.ndarray, "T ... 3"]]]
    features: dict[str, float]
    feature_derivatives: dict[str, dict[str, float]]
    certificate: Certificate | None
    status: str
    reason: str
    failure_time: float
    stats: dict[str, float]
    steady: Steady | None = None
    values: dict[str, float] = {}
    reasons: dict[str, str] = {}
    sampled: tuple[str, ...] = ()

    _view = "bcfj_jax.analysis.derivatives.table"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot


class BoundingKeys(SolvingKeys, total=False):
    """``Bounding`` as keywords."""

    average: float
    levels: int


class DerivingKeys(BoundingKeys, total=False):
    """``Deriving`` as keywords."""

    features: Sequence[str]
    mode: Literal["auto", "forward", "reverse"]
    certify: bool
    differences: Literal["direction", "each", "none"]
    steady: bool
    budget: float | None
    tell: Callable[[Sensitivity], None] | None


@dataclass(frozen=True)
class Bounding(Solving):
    """Settings of solves that bound each other's derivatives."""

    average: float = 5e-3
    levels: int = 6


@dataclass(frozen=True)
class Deriving(Bounding):
    """Settings of ``sensitivity``."""

    features: Sequence[str] = ()
    mode: Literal["auto", "forward", "reverse"] = "auto"
    certify: bool = True
    differences: Literal["direction", "each", "none"] = "direction"
    steady: bool = False
    budget: float | None = None
    tell: Callable[[Sensitivity], None] | None = None

    def checked(self) -> Deriving:
        """With numbers in SI units and of their ranges; ``InputError`` for others."""
        one_of("mode", "mode", self.mode, MODES)
        one_of("differences", "differences", self.differences, DIFFERENCES)
        average = scalar("certificate", _AVERAGE, self.average)
        budget = None if self.budget is None else scalar("certificate", _BUDGET, self.budget)
        return replace(self, average=average, levels=whole("levels", self.levels, most=100), budget=budget)


@taking(Deriving)
def sensitivity(
    scene: AbstractModel, params: Params, times: Float[ArrayLike, " T"], wrt: Sequence[str],
    **settings: Unpack[DerivingKeys],
) -> Sensitivity:  # fmt: skip
    """Derivatives of force histories and features by named parameters, with a certificate.

    One compiled program per scene, number of times and ``wrt``; other values, times and accuracies reuse it. With a
    certificate derivatives are bounded by far tighter solves (``derivatives.bounds``), and the tolerance is tightened
    until the bound of the averaged derivatives of every parameter with more than 1 % of the largest influence is
    within ``3 force_error`` (1 % to 10 %; 3 % at ``balanced``). Those of a stiff model are then BDF's.

    Args:
        scene, params, times, accuracy, max_steps: as ``simulate``.
        wrt: names of parameters; a contact's own (``seat_ball.stiffness``) starts from the shared value.
        features: names as ``seat_ball.peak``, ``seat_ball_2.mean``, ``seat_ball:head_ball.delay``; by default every
            feature of every contact. Of a single contact: ``contact.begin_3`` (``contact_events``). A reading's feature
            is ``slider.acceleration.x.peak`` (``mechanism.channels``).
        average: width of the certificate's moving average [s], at most a tenth of the horizon.
        mode: "forward" for histories and features; "reverse" for features alone, without periods and delays, by a
            program compiled per times and features too; "auto": reverse from 51 parameters.
        certify: whether to certify.
        differences: central differences along one random direction, and of "each" parameter where that disagrees;
            of each always; or none.
        levels: most tightenings; fewer than two leave no solve that bounds the error.
        steady: whether to differentiate the steady motion too (``derivatives.steady``), of a model that knows a pitch.
        budget: seconds for far tighter solves and central differences, compiling included: none is begun that is not
            expected to end within, and one that does not is left behind, in a thread that may compute on; None: no end.
        tell: receives what is known so far: of steady motion alone, where a short run shows it, with no verdicts; derivatives
            that nothing was compared with (no certificate); those with bounds, before central differences are taken.

    Raises:
        InputError: for names that are not known, with the nearest, and for times and options that are not right.
    """
    asked = Deriving(**settings).checked()
    problem = posed(scene, params, times, wrt, asked)
    scene, full = problem.scene, problem.params
    how = plan(scene, asked.accuracy, asked.max_steps)
    if asked.mode == "reverse" or (asked.mode == "auto" and len(problem.names) > _MANY):
        return _reverse(problem._replace(wanted=reversible(problem.wanted)), how, asked.certify)
    # Compiled beside the first solves.
    if asked.steady and scene.recurs(full):
        ahead(partial(prepared, problem))
    elif asked.certify and asked.differences != "none" and asked.budget != 0.0:
        ahead(partial(compiled, scene, full, problem.times, Plan(how.tolerance)))
    return _forward(problem, how, asked)


def posed(scene: AbstractModel, params: Params, times: ArrayLike, wrt: Sequence[str], asked: Deriving) -> Problem:
    """What is differentiated, checked."""
    scene, params, t = ready(scene, params, times)
    full, names = complete(scene, params, wrt)
    features = texts("features", asked.features, 'name features, such as "contact.peak"')
    scene = observing(scene, features)
    contacts = scene.members
    if not contacts:
        remedy = "name features of readings, such as a body's: <body>.place.x.largest"
        raise InputError("features", f"scene '{scene.kind}' has no contact to take features of", remedy)
    wanted = [named(name, contacts) for name in features] or default_features(contacts)
    if any(event(f.kind) for f in wanted):
        check_followed(scene)
    width = min(asked.average, 0.1 * float(t[-1] - t[0]))
    return Problem(scene, full, t, names, wanted, force_error(asked.accuracy), width, asked.max_steps)


class _First:
    """What is told before anything is bounded: derivatives of steady motion, then those of the run's first solve.

    ``turned``: steady motion at the looser tolerance, and what gives the whole; None where no short run shows it.
    """

    def __init__(self, how: Plan, late: tuple[np.ndarray, float] | None, tell: Callable[[Sensitivity], None] | None):
        self.how, self.late, self.tell = how, late, tell or (lambda found: None)
        self.turned: tuple[Steady, Callable[[], Steady]] | None = None
        self.known: tuple[Level, Sensitivity] | None = None

    @property
    def steady(self) -> Steady | None:
        return self.turned[0] if self.turned and not self.turned[0].reason else None

    def of_steady(self, problem: Problem) -> None:
        self.turned = first_of_steady(problem, *self.late) if self.late else None
        if self.steady:
            spent = {"wall_s": self.steady.wall_s, "compile_s": self.steady.compile_s, "levels": 0}
            empty, values = {name: {} for name in problem.names}, problem.named(problem.values)
            nothing = Sensitivity(problem.times, problem.names, {}, {}, {}, empty, None, "ok", "", NAN, spent)
            self.tell(nothing._replace(steady=self.steady, values=values))

    def of_run(self, problem: Problem, level: Level) -> None:
        if level.good:
            self.tell(self.of(problem, level))

    def of(self, problem: Problem, level: Level) -> Sensitivity:
        """Histories and features with their derivatives, as one solve has them; computed once."""
        if self.known is None or self.known[0] is not level:
            numbers, slopes = problem.measure(level)
            # What is of single contacts comes from runs of its own.
            single = filled(problem, self.how, numbers, slopes, TIGHTER)
            self.known = level, _result(problem, [level], numbers, slopes)._replace(reasons=single)
        return self.known[1]._replace(steady=self.steady)


def _forward(problem: Problem, how: Plan, asked: Deriving) -> Sensitivity:
    """The run's derivatives, then their bounds, then central differences and steady motion; each is told of."""
    levels, differences, steady = asked.levels if asked.certify else 0, asked.differences, asked.steady
    spend, scene, t = Budget(asked.budget), problem.scene, problem.times
    with stage("running until the motion repeats itself"):
        short = settled(scene, problem.params, t, problem.names, how)
    first = _First(how, short[1:] if short else None, asked.tell)

    def climbed_of(problem: Problem, before: Callable[[], None] = lambda: None) -> Climb:
        told = partial(first.of_run, problem) if levels else lambda level: None
        return climb(problem, how, levels, spend, told, before)

    # A short run stands for the whole.
    problem = problem._replace(fold=short[0]) if short else problem
    if steady and levels and short:
        # Compiled before the second solve begins beside it.
        prepared(problem)
        climbed = climbed_of(problem, partial(first.of_steady, problem))
    else:
        climbed = climbed_of(problem)
    if problem.fold and not climbed.repeats(problem):
        # Derivatives forget their start later than the motion does.
        problem = problem._replace(fold=None)
        climbed = climbed_of(problem)
    last = climbed.last
    found = first.of(problem, last)
    found = found._replace(stats=found.stats | _spent(climbed.levels))

    def orbit() -> Steady | None:
        if not steady or not last.good:
            return None
        if first.turned:
            return first.turned[1]()
        late = short[1:] if short else (last.value.state[-1] * np.asarray(last.scale), float(t[-1]))
        return steady_of(problem, *late)

    if not levels:
        return found._replace(steady=orbit())
    histories = bounded(problem, climbed)
    slopes, agree, starred = _stated(problem, how, climbed, found, histories)
    found = found._replace(sampled=starred)
    if differences != "none" and climbed.beside is not None and scene.traits.history and not scene.traits.stiff:
        with contextlib.suppress(OutOfTime):
            agree = spend.on(partial(_witnessed, problem, climbed.beside[0], slopes, agree))
    judge = partial(certified, problem, climbed, histories)
    if last.good and differences != "none":
        first.tell(found._replace(certificate=judge(agree, unasked(problem))))

    def compared() -> Any:
        alone = differences == "each"
        return unasked(problem) if differences == "none" else beside(problem, climbed, histories, alone, spend)

    others, turn = together(compared, orbit)
    if turn is not None:
        agree = np.maximum(agree, _off_steady(problem, last, turn))
    return found._replace(steady=turn, certificate=judge(agree, others))


def _stated(
    problem: Problem, how: Plan, climbed: Climb, found: Sensitivity, histories: Sequence[Comparison]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Derivatives (F, P) of features and their bounds (F, P) from the solves; names of those known from samples alone."""
    last, scene, values = climbed.last, problem.scene, problem.values
    slopes = np.array([[found.feature_derivatives[n][f.name] for n in problem.names] for f in problem.wanted])
    agree = np.full(slopes.shape, np.inf)
    if climbed.beside is not None:
        numbers, _ = problem.measure(last)
        (_, between), (_, tight) = map(problem.measure, climbed.beside)
        for slope, share in zip((between, tight), BOUNDING[scene.traits.stiff], strict=True):
            filled(problem, how, numbers, slope, TIGHTER * share)
        agree = feature_bounds([slopes, between, tight], numbers, values)
    samples = sampling(problem.times, last.value, last.derivative, problem.wanted, scene.members, values)
    starred = tuple(f.name for f, x in zip(problem.wanted, samples, strict=True) if np.any(x))
    return slopes, np.maximum(agree, luckless(climbed, histories)) + samples, starred


def _result(problem: Problem, levels: Sequence[Level], numbers: np.ndarray, slopes: np.ndarray) -> Sensitivity:
    """What the first of several solves gives, with features (F,) and their derivatives (F, P)."""
    one, names = levels[0], problem.names

    def apart(force: np.ndarray) -> dict[str, np.ndarray]:
        """(T, C, 3) by contact, (T, 3) or (T, k, 3)."""
        found, start = {}, 0
        for name, members in problem.scene.members.items():
            found[name] = force[:, start : start + members] if members else force[:, start]
            start += members or 1
        return found

    return Sensitivity(
        problem.times, names, apart(one.value.force),
        {name: apart(one.derivative.force[k]) for k, name in enumerate(names)} if one.derivative else {},
        {f.name: float(x) for f, x in zip(problem.wanted, numbers, strict=True)}, problem.by_name(slopes), None,
        "ok" if one.good else "failed", reason(one.code, problem.max_steps), NAN if one.good else one.end,
        {"accepted": one.accepted, "rejected": one.rejected, "tolerance": one.tolerance, **_spent(levels)},
        values=problem.named(problem.values),
    )  # fmt: skip


def _spent(levels: Sequence[Level]) -> dict[str, float]:
    return {**{key: sum(getattr(r, key) for r in levels) for key in ("wall_s", "compile_s")}, "levels": len(levels)}


def _witnessed(problem: Problem, between: Level, slopes: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Bounds (F, P) beside differences of the features themselves, of runs at C's tolerance."""
    how = Plan(np.asarray(between.tolerance), problem.max_steps, True)  # pyright: ignore[reportArgumentType]
    here, _ = problem.measure(between)

    def features_at(at: np.ndarray) -> np.ndarray:
        moved = problem._replace(params=problem.moved(at))
        solved = moved.solve(how)
        return moved.measure(solved)[0] if solved.good else np.full(len(here), np.nan)

    return witnessed(features_at, here, problem.values, slopes, bounds)


def _off_steady(problem: Problem, last: Level, steady: Steady) -> np.ndarray:
    """How far the last turn's derivatives of what is integrated are from those of steady motion (F, P); 0 for others.

    Two tolerances can agree about a number that both miss: loose steps damp the swing of a free ball.
    """
    times, names, wanted = problem.times, problem.names, problem.wanted
    found = np.zeros((len(wanted), len(names)))
    late = times >= times[-1] - steady.turn * (1.0 + 1e-9)
    known = [i for i, f in enumerate(wanted) if f.kind in _INTEGRATED and f.name in steady.features]
    settled_from = problem.scene.settled_from(problem.params)
    if steady.reason or not known or times[-1] - steady.turn < settled_from or np.sum(late) < _TURN:
        return found
    kept = [wanted[i] for i in known]
    value = Histories(*(x[late] for x in last.value[:3]), state=None)
    derivative = Histories(*(x[:, late] for x in last.derivative[:3]), state=None)
    numbers, slopes = measure(times[late], value, derivative, kept, problem.scene.members, True)
    own = np.array([[steady.feature_derivatives[n][f.name] for n in names] for f in kept])
    found[known] = apart(slopes, own, numbers, problem.values)
    return found


def _reverse(problem: Problem, how: Plan, certify: bool) -> Sensitivity:
    """Features only; certified where tighter tolerances are solved beside the first, which is reported."""
    # The others are a certificate's.
    how = first_plan(problem.scene, how, problem.error) if certify else how
    ratios = _BACKWARD[problem.scene.traits.stiff] ** -np.arange(3 if certify else 1)
    solved = [gradient(problem, Plan(how.tolerance * x, problem.max_steps, how.tangents)) for x in ratios]
    levels, numbers, slopes = zip(*solved, strict=True)
    found = _result(problem, levels, numbers[0], slopes[0])
    return found._replace(certificate=reversed_certificate(problem, levels, numbers[0], slopes)) if certify else found


class Step(NamedTuple):
    """One width of a ladder."""

    value: float  # of the knob [m or m/s]
    bias: float  # relative L2 difference of all forces from those at the sharpest width [-]
    peak_bias: float  # largest relative difference of a contact's greatest force from the sharpest [-]
    size: dict[str, float]  # ||dF/dp|| per parameter [N s^(1/2) per SI unit]
    # pointwise, average, verdict: of the certificate, per parameter.
    pointwise: dict[str, float]
    average: dict[str, float]
    verdict: dict[str, str]
    steps: int  # attempted steps of the last solve
    status: str  # "ok" or "failed"


@taking(Bounding)
def smoothing_ladder(
    scene: AbstractModel, params: Params, times: ArrayLike, wrt: Sequence[str], values: Sequence[float], *,
    knob: Literal["smoothing", "friction_speed"] = "smoothing", **settings: Unpack[BoundingKeys],
) -> list[Step]:  # fmt: skip
    """Derivatives and their certificates at several widths, the sharpest first.

    A wider regularisation of contact, or of friction, makes derivatives cheaper and better behaved, and biases the force: take
    the sharpest width whose certificate is good enough. Certificates are those of tolerances alone.

    Args:
        scene, params, times, wrt, accuracy, average, levels, max_steps: as ``sensitivity``.
        values: widths [m] or [m/s], in any order; shared by all contacts that have none of their own.
        knob: what is widened.

    Raises:
        InputError: as ``sensitivity``; and for a knob the scene does not have, or a width out of range.
    """
    params = inputs.parameters(as_model(scene), params, traced=False)
    one_of("knob", "knob", knob, KNOBS)
    if knob not in scene.quantities:
        raise InputError("knob", f"scene '{scene.kind}' with these options has no {knob}", "switch it on in the scene")
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InputError("values", quoted(values), f"give a list of values of {knob}")
    widths = [scalar("values", scene.quantities[knob], value) for value in values]
    if not widths:
        raise InputError("values", "no width", f"give values of {knob}")
    found: list[tuple[float, Sensitivity]] = []
    for value in sorted(widths):
        at = {**params, knob: jnp.asarray(value)}
        found.append((value, sensitivity(scene, at, times, wrt, mode="forward", differences="none", **settings)))
    return [_step(value, each, found[0][1]) for value, each in found]


def _step(value: float, found: Sensitivity, sharpest: Sensitivity) -> Step:
    assert found.certificate is not None
    t, checks = found.times, found.certificate.parameters

    def size(force: dict[str, np.ndarray]) -> float:
        return float(norm(t, np.concatenate([f.reshape(len(f), -1) for f in force.values()], axis=1)))

    off, own = size({name: f - sharpest.force[name] for name, f in found.force.items()}), size(sharpest.force)
    tops, sharp = (np.array([np.max(np.abs(f)) for f in x.force.values()]) for x in (found, sharpest))
    return Step(
        value, off / own if own > 0 else NAN, float(np.max(np.abs(tops - sharp) / np.where(sharp > 0, sharp, 1.0))),
        {name: size(found.derivative[name]) for name in found.wrt},
        {name: check.pointwise for name, check in checks.items()}, {name: check.average for name, check in checks.items()},
        {name: check.verdict for name, check in checks.items()},
        int(found.stats["accepted"] + found.stats["rejected"]), found.status,
    )  # fmt: skip
