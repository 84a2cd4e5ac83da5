"""The verb ``sensitivity``: histories, their derivatives, those of features, and what they are worth."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from bcfj_jax.analysis.derivatives import certificate as verdicts
from bcfj_jax.analysis.derivatives.bounds import (
    Budget,
    Climb,
    bounded,
    climb,
    feature_bounds,
    first_plan,
    luckless,
    safer,
    target,
)
from bcfj_jax.analysis.derivatives.certificate import Certificate, Check, Comparison
from bcfj_jax.analysis.derivatives.contact_events import BOUNDING, TIGHTER, check_followed, filled
from bcfj_jax.analysis.derivatives.differences import against, scales
from bcfj_jax.analysis.derivatives.differences import direction as random_direction
from bcfj_jax.analysis.derivatives.jacobian import Histories, Level, forces, level
from bcfj_jax.analysis.derivatives.measures import measure, sampling
from bcfj_jax.analysis.derivatives.names import Feature, complete, default_features, event
from bcfj_jax.analysis.derivatives.names import feature as named
from bcfj_jax.analysis.derivatives.norms import norm
from bcfj_jax.analysis.derivatives.reverse import Gradient, gradient, reversed_certificate, reversible
from bcfj_jax.analysis.derivatives.steady import Steady, prepared
from bcfj_jax.analysis.derivatives.steady import steady as of_steady
from bcfj_jax.analysis.derivatives.witnesses import witnessed
from bcfj_jax.core import presented
from bcfj_jax.core.errors import InputError, nearest, quoted, texts
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import Quantity, increasing, scalar, whole
from bcfj_jax.core.status import OK, reason
from bcfj_jax.core.threads import ahead
from bcfj_jax.io.stop import OutOfTime
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.solve.plan import MAX_STEPS, Plan, check_bits, force_error, plan
from bcfj_jax.solve.simulation import compiled

MODES = ("auto", "forward", "reverse")
DIFFERENCES = ("direction", "each", "none")
_MANY = 50
_AVERAGE = Quantity("average", "s", "width of the moving average", 0.0, open_low=True)
_BUDGET = Quantity("budget", "s", "time for far tighter solves and central differences", 0.0)
# In reverse mode, by whether the model is stiff: ratio of the tolerances that a bound is from (Tsit5, BDF).
_BACKWARD = {False: 64.0, True: 8.0}
# Pitches of steady motion over which central differences are taken.
_PITCHES = 4
# Difference from central differences that is looked into.
_SEEN = 1e-3
# Features that do not hang on where samples are, and samples in a turn that they need.
_INTEGRATED, _TURN = ("mean", "impulse", "contact_fraction"), 100


class Sensitivity(NamedTuple):
    """Derivatives of a run, as NumPy arrays.

    Attributes:
        times: (T,) [s].
        wrt: names of the parameters.
        force: per contact (T, 3) or (T, k, 3) [N], from the same solve as the derivatives.
        derivative: per parameter and contact the same shape [N per SI unit]; empty in reverse mode.
        features: value by name, in ``derivatives.names.UNITS``.
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

    _view = "bcfj_jax.analysis.derivatives.view"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot


def sensitivity(
    scene: AbstractModel,
    params: Params,
    times: Float[ArrayLike, " T"],
    wrt: Sequence[str],
    *,
    accuracy: str | float = "balanced",
    features: Sequence[str] = (),
    average: float = 5e-3,
    mode: Literal["auto", "forward", "reverse"] = "auto",
    certify: bool = True,
    differences: Literal["direction", "each", "none"] = "direction",
    levels: int = 6,
    max_steps: int = MAX_STEPS,
    steady: bool = False,
    budget: float | None = None,
    tell: Callable[[Sensitivity], None] | None = None,
) -> Sensitivity:
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
        tell: receives the result before central differences are taken.

    Raises:
        InputError: for names that are not known, with the nearest, and for times and options that are not right.
    """
    check_bits()
    t = increasing(times)
    params = inputs.parameters(as_model(scene), params, traced=False)
    scene.check(params)
    scene = scene.suited(params, float(t[-1]))
    full, names = complete(scene, params, wrt)
    asked = texts("features", features, 'name features, such as "contact.peak"')
    scene = observing(scene, asked)
    contacts = scene.members
    if not contacts:
        remedy = "name features of readings, such as a body's: <body>.place.x.largest"
        raise InputError("features", f"scene '{scene.kind}' has no contact to take features of", remedy)
    wanted = [named(name, contacts) for name in asked] or default_features(contacts)
    if any(event(f.kind) for f in wanted):
        check_followed(scene)
    for what, value, known in (("mode", mode, MODES), ("differences", differences, DIFFERENCES)):
        if value not in known:
            raise InputError(what, f"no {what} {quoted(value)}", nearest(value, known))
    average = scalar("certificate", _AVERAGE, average)
    levels = whole("levels", levels, most=100)
    budget = None if budget is None else scalar("certificate", _BUDGET, budget)
    how = plan(scene, accuracy, max_steps)
    if mode == "reverse" or (mode == "auto" and len(names) > _MANY):
        able = reversible(wanted)
        # The others are a certificate's.
        how = first_plan(scene, how, force_error(accuracy)) if certify else how
        ratios = _BACKWARD[scene.traits.stiff] ** -np.arange(3 if certify else 1)
        plans = [Plan(how.tolerance * x, max_steps, how.tangents) for x in ratios]
        solved = [gradient(scene, full, t, names, each, able, contacts) for each in plans]
        return _reverse(t, names, _values(full, names), able, contacts, solved, max_steps)
    error = force_error(accuracy)
    # Compiled beside the first solves.
    if steady and scene.recurs(full) and t[-1] >= scene.settled_from(full):
        ahead(partial(prepared, scene, full, names, max_steps))
    if certify and differences != "none" and budget != 0.0:
        ahead(partial(compiled, scene, full, t, plan(scene, _fine(scene, error), MAX_STEPS)))
    spend, values = Budget(budget), _values(full, names)
    climbed = climb(scene, full, t, names, how, error, _width(t, average), levels if certify else 0, spend)
    last = climbed.last
    turning = scene.traits.turning
    numbers, slopes = measure(t, last.value, last.derivative, wanted, contacts, turning)
    # What is of single contacts comes from runs of its own.
    single = filled(scene, full, t[-1], names, how, wanted, numbers, slopes, TIGHTER)
    failed = last.code != OK
    found = Sensitivity(
        t,
        names,
        _by_contact(last.value.force, contacts),
        {name: _by_contact(last.derivative.force[k], contacts) for k, name in enumerate(names)},
        {f.name: float(x) for f, x in zip(wanted, numbers, strict=True)},
        {name: {f.name: float(slopes[i, k]) for i, f in enumerate(wanted)} for k, name in enumerate(names)},
        None,
        "failed" if failed else "ok",
        reason(last.code, max_steps),
        last.end if failed else float("nan"),
        {
            "accepted": last.accepted,
            "rejected": last.rejected,
            "tolerance": last.tolerance,
            "wall_s": sum(r.wall_s for r in climbed.levels),
            "compile_s": sum(r.compile_s for r in climbed.levels),
            "levels": len(climbed.levels),
        },
        values={name: float(full[name]) for name in names},
        reasons=single,
    )
    if steady and not failed:
        end = last.value.state[-1] * np.asarray(last.scale)
        found = found._replace(steady=of_steady(scene, full, end, float(t[-1]), names, wanted, max_steps))
    if not certify:
        return found
    histories = bounded(t, climbed, values, _width(t, average))
    agree, here = np.full(slopes.shape, np.inf), np.full(len(wanted), np.nan)
    if climbed.beside is not None:
        (here, between), (_, tight) = (
            measure(t, r.value, r.derivative, wanted, contacts, turning) for r in climbed.beside
        )
        for slope, share in zip((between, tight), BOUNDING[scene.traits.stiff], strict=True):
            filled(scene, full, t[-1], names, how, wanted, numbers.copy(), slope, TIGHTER * share)
        agree = feature_bounds([slopes, between, tight], numbers, values)
    agree = np.maximum(agree, luckless(climbed, histories))
    between_samples = sampling(t, last.value, last.derivative, wanted, contacts, values)
    agree = agree + between_samples
    found = found._replace(sampled=tuple(f.name for f, x in zip(wanted, between_samples, strict=True) if np.any(x)))
    if differences != "none" and climbed.beside is not None and scene.traits.history and not scene.traits.stiff:
        finer = Plan(np.asarray(climbed.beside[0].tolerance), max_steps, True)  # pyright: ignore[reportArgumentType]

        def features_at(at: np.ndarray) -> np.ndarray:
            new = {**full, **{n: np.asarray(x) for n, x in zip(names, at, strict=True)}}
            beside = level(scene, new, t, names, finer)
            moved = measure(t, beside.value, beside.derivative, wanted, contacts, turning)[0]
            return moved if beside.good else np.full(len(wanted), np.nan)

        with contextlib.suppress(OutOfTime):
            agree = spend.on(lambda: witnessed(features_at, here, values, slopes, agree))
    if found.steady is not None:
        agree = np.maximum(agree, _off_steady(scene, full, t, last, found.steady, wanted, names))
    table = {n: {f.name: float(agree[i, k]) for i, f in enumerate(wanted)} for k, n in enumerate(names)}
    judge = partial(_certificate, scene, full, t, names, climbed, histories, error, average, table)
    if tell is not None and differences != "none" and not failed:
        tell(found._replace(certificate=judge("none", spend)))
    return found._replace(certificate=judge(differences, spend))


def _off_steady(scene, params, times, last: Level, steady: Steady, wanted, names: tuple[str, ...]) -> np.ndarray:
    """How far the last turn's derivatives of what is integrated are from those of steady motion (F, P); 0 for others.

    Two tolerances can agree about a number that both miss: loose steps damp the swing of a free ball.
    """
    found = np.zeros((len(wanted), len(names)))
    late = times >= times[-1] - steady.turn * (1.0 + 1e-9)
    known = [i for i, f in enumerate(wanted) if f.kind in _INTEGRATED and f.name in steady.features]
    if steady.reason or not known or times[-1] - steady.turn < scene.settled_from(params) or np.sum(late) < _TURN:
        return found
    kept = [wanted[i] for i in known]
    value = Histories(*(x[late] for x in last.value[:3]), state=None)
    derivative = Histories(*(x[:, late] for x in last.derivative[:3]), state=None)
    numbers, slopes = measure(times[late], value, derivative, kept, scene.members, True)
    own = np.array([[steady.feature_derivatives[n][f.name] for n in names] for f in kept])
    found[known] = verdicts.apart(slopes, own, numbers, _values(params, names))
    return found


def _width(times: np.ndarray, average: float) -> float:
    return min(average, 0.1 * float(times[-1] - times[0]))


def _values(params: Params, names: Sequence[str]) -> np.ndarray:
    return np.array([float(params[name]) for name in names])


def _certificate(
    scene: AbstractModel,
    params: Params,
    times: np.ndarray,
    names: tuple[str, ...],
    climbed: Climb,
    histories: Sequence[Comparison],
    error: float,
    average: float,
    features: Mapping[str, Mapping[str, float]],
    differences: str,
    spend: Budget,
) -> Certificate:
    values, width, last = _values(params, names), _width(times, average), climbed.last
    found: list[list[Comparison]] = [[c] for c in histories]
    grown, strength = verdicts.growths(times, last, values), verdicts.influences(times, last, values)
    both, direction, also, unchecked = None, None, [""] * len(names), [climbed.unchecked] * len(names)
    lost = any(verdicts.chaotic(g, c[0]) for g, c in zip(grown, found, strict=True))
    if differences != "none" and last.good and not lost:
        fine = _fine(scene, error * last.tolerance / climbed.levels[0].tolerance)
        how = plan(scene, fine, last_budget(last.steps))
        short, every = _shortened(scene, params, times)
        count = len(short)
        slopes = verdicts.flat(last.derivative.force)[:, :count]
        size = last.value.force.reshape(len(times), -1)[:count]
        step = np.array([scales(short, p, size, d) for p, d in zip(values, slopes, strict=True)])

        def run(at: np.ndarray) -> np.ndarray:
            new = {**params, **{n: np.asarray(x) for n, x in zip(names, at, strict=True)}}
            return forces(scene, new, every, how).reshape(len(times), -1)[:count]

        def along(what: str, way: np.ndarray, enough: float) -> Comparison:
            slope = np.tensordot(way, slopes, 1)
            with stage(f"comparing with {what}"):
                compared = spend.on(lambda: against(what, short, run, values, way, slope, fine, width, enough))
            early = count < len(times) and not np.isfinite(compared.until)
            return compared._replace(what=f"{compared.what}, until {short[-1]:.4g} s") if early else compared

        each = differences == "each"
        way = step * random_direction(len(names))
        if not each and np.any(step):
            what = "central differences along one random direction of all parameters"
            # What the levels know of needs no second witness.
            sizes = np.abs(way) * norm(short, slopes) / max(float(norm(short, np.tensordot(way, slopes, 1))), 1e-300)
            stated = [(c.pointwise.relative, c.average.relative) for (c,) in found]
            known = np.maximum(np.nan_to_num(sizes @ np.array(stated), nan=np.inf), _SEEN)
            try:
                both = along(what, way, known[0])
            except OutOfTime:
                late = f"central differences do not check it: {spend.over}"
                unchecked = [verdicts.joined(x, late) if s else x for x, s in zip(unchecked, step, strict=True)]
        if both is not None:
            direction = {"pointwise": both.pointwise.relative, "average": both.average.relative}
            direction = None if both.vague else direction
            each = bool(both.pointwise.relative > known[0] or both.average.relative > known[1]) and not both.vague
            if np.isfinite(both.until) and not each:
                late = f"central differences check nothing after {both.until:.4g} s: a run beside this one failed there"
                unchecked = [verdicts.joined(x, late) for x in unchecked]
            # A parameter at 0 was not moved.
            also = [both.what if s and not each and not both.vague else "" for s in step]
        # The strongest first: the budget may end.
        for k in sorted(np.flatnonzero(step) if each else (), key=lambda k: -strength[k]):
            unit = np.where(np.arange(len(names)) == k, step, 0.0)
            try:
                alone = along("central differences", unit, max(_SEEN, found[k][0].pointwise.relative))
                found[k].append(safer(alone))
            except OutOfTime:
                unchecked[k] = verdicts.joined(unchecked[k], f"central differences do not check it alone: {spend.over}")
    end = last.end if last.code != OK else float("nan")
    checks: dict[str, Check] = {
        name: verdicts.check(
            found[k],
            features[name],
            grown[k],
            float(strength[k]),
            end,
            also[k],
            unchecked[k],
            both is not None and both.vague,
        )
        for k, name in enumerate(names)
    }
    return Certificate(
        verdicts.worst_verdict(checks), checks, width, target(error), tuple(r.tolerance for r in climbed.levels),
        tuple(r.steps for r in climbed.levels), direction, last.tolerance,
    )  # fmt: skip


def _shortened(scene: AbstractModel, params: Params, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times that differences are taken over, and as many times as there were, so that one program serves both.

    What repeats itself after a pitch is compared until a few pitches after the start is forgotten.
    """
    if not scene.recurs(params):
        return times, times
    end = scene.settled_from(params) + _PITCHES * scene.period(params)[1]
    count = int(np.searchsorted(times, end, side="right"))
    if not 2 <= count < len(times):
        return times, times
    apart = 1e-9 * (times[count] - times[count - 1]) * np.arange(1, len(times) - count + 1) / len(times)
    return times[:count], np.concatenate([times[:count], times[count - 1] + apart])


def _fine(scene: AbstractModel, error: float) -> float:
    """Error of the forces that differences are taken of: their noise is amplified by 1/h."""
    return max(min(error, 1e-5 if scene.traits.stiff else 1e-7), 1e-9)


def last_budget(steps: int) -> int:
    """Steps allowed to the forces that differences are taken of: ten times those of the derivatives, or more.

    Few different numbers, since each is a program of its own.
    """
    allowed = MAX_STEPS
    while allowed < 10 * steps:
        allowed *= 10
    return allowed


def _by_contact(force: np.ndarray, contacts: Mapping[str, int]) -> dict[str, np.ndarray]:
    """(T, C, 3) apart by contact, (T, 3) or (T, k, 3)."""
    apart, start = {}, 0
    for name, members in contacts.items():
        apart[name] = force[:, start : start + members] if members else force[:, start]
        start += members or 1
    return apart


def _reverse(
    times: np.ndarray,
    names: tuple[str, ...],
    values: np.ndarray,
    wanted: Sequence[Feature],
    contacts: Mapping[str, int],
    solved: Sequence[Gradient],
    max_steps: int,
) -> Sensitivity:
    """Features only; certified where tighter tolerances were solved beside the first, which is reported."""
    last = solved[0]
    slopes = {n: {f.name: float(last.slopes[i, k]) for i, f in enumerate(wanted)} for k, n in enumerate(names)}
    spent = {key: sum(s.stats[key] for s in solved) for key in ("wall_s", "compile_s")}
    failed = last.code != OK
    return Sensitivity(
        times, names, _by_contact(last.force, contacts), {},
        {f.name: float(x) for f, x in zip(wanted, last.numbers, strict=True)},
        slopes, reversed_certificate(names, values, wanted, solved) if len(solved) > 1 else None,
        "failed" if failed else "ok", reason(last.code, max_steps), last.end if failed else float("nan"),
        {**last.stats, **spent, "levels": len(solved)},
        values=dict(zip(names, map(float, values), strict=True)),
    )  # fmt: skip
