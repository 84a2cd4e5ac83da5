"""``design``: the verb. Free parameters, bounds and tolerances in, a checked optimum out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from bcfj_jax.analysis.derivatives.certificate import NOT, Certificate
from bcfj_jax.analysis.derivatives.names import FEATURES, complete
from bcfj_jax.analysis.derivatives.sensitivity import sensitivity
from bcfj_jax.analysis.derivatives.steady import check_recurs, shares
from bcfj_jax.analysis.designs.confirm import Confirmation, confirm, independent, tighter
from bcfj_jax.analysis.designs.descent import Path, descend, starts
from bcfj_jax.analysis.designs.evaluate import Evaluator, Spent
from bcfj_jax.analysis.designs.minimax import Kink, minimax
from bcfj_jax.analysis.designs.newton import ARRIVED, Refined, refine
from bcfj_jax.analysis.designs.objective import Combine, Objective, objective
from bcfj_jax.analysis.designs.result import (
    ALONE,
    FAILED,
    NO_GAIN,
    NOT_CONFIRMED,
    NOT_TRUSTED,
    OK,
    ROUGH,
    Design,
    Slice,
)
from bcfj_jax.analysis.designs.space import Free, Space, space
from bcfj_jax.analysis.designs.tolerance import DISTRIBUTIONS, robust, robustness
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, nearest, quoted, texts
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import Quantity, increasing, number, real, scalar, whole
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, of_numbers
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.solve.plan import MAX_STEPS, plan

SENSES = {"minimise": 1.0, "maximise": -1.0}
# Values this near, over the best one, agree; and places, over the ranges.
_AGREE, _NEAR = 1e-4, 1e-2
# Points of a slice, on either side of the optimum together.
_SLICE = 25


def design(
    scene: AbstractModel,
    params: Params,
    times: Float[ArrayLike, " T"],
    objective: str | Mapping[str, float] | Combine,
    free: Mapping[str, Free | Sequence[Any]],
    *,
    features: Sequence[str] = (),
    sense: Literal["minimise", "maximise"] = "minimise",
    kappa: float = 0.0,
    distribution: Literal["normal", "uniform"] = "normal",
    samples: int = 64,
    starts: int = 8,
    norms: Sequence[float] | None = None,
    iterations: int = 60,
    accuracy: str | float = "reference",
    max_steps: int = MAX_STEPS,
    confirm: AbstractModel | Literal["auto"] | None = "auto",
    certify: bool = True,
    slices: bool = True,
    seed: int = 0,
    steady: bool = False,
) -> Design:
    """Make a feature least, or most, over free parameters within bounds, and say what the optimum is worth.

    Starts (the given design, and points of a scrambled Sobol design) descend by L-BFGS-B in one compiled batch; the
    best is refined by Newton's method on the gradient to 1e-6 of every range; an independent run confirms the gain.
    Runs compile once per scene, number of times, names and starts; another objective compiles in a second.

    Args:
        scene: any model but an open one (fidelity "auto"). A dynamic joint is chaotic over long times: take "quasistatic", or a
            mean over a short time.
        params: the design before, and all that is not free, SI.
        times: (T,) [s]; even ones, where a peak is wanted to 1e-6.
        objective: a feature ("seat_cage.peak", "contact.peak_penetration", "cage_ball.largest" for the greatest
            |F|), weights by feature for their sum, or a function of a dict of ``features``.
        free: by name ``Free`` or (lower, upper, tolerance, relative, scale); texts such as "20 um" are converted.
        features: names that a function reads.
        sense: "minimise" or "maximise".
        kappa: weight of the linear worst change over the tolerances in what is made least.
        distribution: of deviations, for the scatter: "normal" (three standard deviations to a half width) or "uniform".
        samples: runs for the tolerances' effect, of each kind.
        starts: how many, and how many batch the batch has.
        norms: increasing q > 1 of the norms that stand for peaks first; by default (40,) where contacts have members, none else.
        iterations: limit of L-BFGS-B, for each norm and start.
        accuracy, max_steps: as ``simulate``, of the optimiser's runs.
        confirm: the model that checks; by default the one that leaves nothing out; None for no check.
        certify: whether the gradient at the optimum gets its certificate; equilibria have none.
        slices: whether the objective along each parameter is taken, for the pictures.
        seed: of all Sobol designs.
        steady: whether the objective is of one turn of the steady motion to which a run until the last of ``times`` comes
            (``derivatives.steady``), of a model that knows a pitch. Where the motion does not repeat itself, a design has no
            value. Its derivatives hold to two tolerances, or there is no value; no certificate is made.

    Raises:
        InputError: for names, bounds, tolerances and options that are not right.
    """
    t = increasing(times, 2)
    params = inputs.parameters(of_numbers(scene), params, traced=False)
    kappa = scalar("kappa", _KAPPA, kappa)
    sign = _sign(sense, distribution, norms)
    samples, iterations = whole("samples", samples, most=limits.RUNS), whole("iterations", iterations, most=limits.RUNS)
    starts, seed = whole("starts", starts, most=limits.STARTS), whole("seed", seed, least=0)
    if scene.traits.open:
        raise InputError(
            f"scene '{scene.kind}' fidelity", f"'{scene.title}' leaves the choice of the model open", "give one by name"
        )
    asked = features if callable(objective) else [objective] if isinstance(objective, str) else objective
    asked = texts(
        "objective", list(asked) if isinstance(asked, Mapping) else asked, 'name features, such as "contact.peak"'
    )
    scene = observing(scene, asked)
    wanted, box = _objective(objective, features, scene.members), space(scene, params, free)
    full = complete(scene, params, box.names)[0]
    scene.check(full)
    if norms is None:
        # The largest of several members is another's from place to place.
        norms = (40.0,) if any(scene.members.values()) and wanted.peaked else ()
    how = plan(scene, accuracy, max_steps)
    end = float(t[-1]) if steady else None
    if steady:
        _steady(scene, full, wanted)
        t, certify = shares(scene, full), False
    plain = Evaluator(scene, full, t, how, box, wanted, sign, starts, Spent(), end)
    goal = robust(plain, kappa)
    given = np.array([float(full[name]) for name in box.names])
    before = plain.at(given[None])
    with stage(f"searching from {starts} starts"):
        ways = descend(goal, _starts(goal, box.unit(given), starts, seed), norms, iterations)
    order = np.argsort([way.goal for way in ways], kind="stable")
    best = ways[int(order[0])]
    if not np.isfinite(best.goal):
        return _failed(plain, wanted, sense, box, given, before.true[0], ways)
    with stage("refining the best"):
        refined = refine(goal, best.end)
    if refined.values.reasons[0] or refined.values.goal[0] > best.goal + 1e-9 * abs(best.goal):
        refined = refined._replace(point=best.end, values=goal(best.end[None], np.inf), arrived=False)
    kink = None
    if not refined.arrived and not kappa and sense == "minimise":
        kink = minimax(plain, refined.point, seed)
        if kink is not None and kink.value <= plain(refined.point[None]).true[0]:
            values = goal(kink.point[None], np.inf)
            active = np.where(kink.point <= ARRIVED, -1, np.where(kink.point >= 1.0 - ARRIVED, 1, 0))
            refined = Refined(kink.point, values, active, kink.step, np.nan, kink.arrived)
        else:
            kink = None
    here = plain(refined.point[None])
    at = box.values(refined.point)
    after, first = float(here.true[0]), float(before.true[0])
    gain = sign * (first - after)
    agree, near = _agreement(ways, best)
    designs = full, {**full, **dict(zip(box.names, at, strict=True))}
    with stage("checking by independent runs"):
        spans = tuple(t if end is None else end - scene.period(one)[0] * (1.0 - t) for one in designs)
        checked = _confirmed(scene, confirm, designs, spans, wanted, sign, gain, accuracy)
    certificate = _certified(scene, designs[1], t, box, wanted, accuracy, max_steps) if certify else None
    wide = robustness(plain, refined.point, here, distribution, samples, seed, kink is not None)
    wide_before = None
    if wide is not None and not before.reasons[0]:
        wide_before = robustness(plain, box.unit(given), before, distribution, samples, seed, False)
    cuts = _slices(plain, refined.point) if slices else {}
    status, reason = _verdict(
        refined, kink, checked, certificate, agree, near, ways, gain, kappa, plain, before.reasons[0]
    )
    sides = {-1: "lower", 1: "upper"}
    return Design(
        status, reason, wanted.name, sense, wanted.unit, _named(box, at), _named(box, given),
        {n: sides[int(a)] for n, a in zip(box.names, refined.active, strict=True) if a},
        first, after, gain, _named(box, sign * refined.values.slope[0] / box.slope(at)), refined.step,
        refined.curvature, tuple(ways), agree, near, checked, certificate, wide, wide_before, cuts,
        dict(plain.spent.failures), _stats(plain), box,
    )  # fmt: skip


_objective, _starts, _confirm = objective, starts, confirm

# What does not ask how long a turn lasts.
_OF_A_TURN = ("peak", "largest", "mean", "contact_fraction", "peak_penetration")
_KAPPA = Quantity("kappa", "1", "weight of the linear worst change", 0.0)
_NORM = Quantity("norms", "1", "exponent of a norm", 1.0, open_low=True)


def _sign(sense: str, distribution: str, norms: Any) -> float:
    """1 for least, -1 for most; options that are not right raise ``InputError``."""
    if not isinstance(sense, str) or sense not in SENSES:
        raise InputError("sense", f"no sense {quoted(sense)}", nearest(sense, SENSES))
    if distribution not in DISTRIBUTIONS:
        raise InputError(
            "distribution", f"no distribution {quoted(distribution)}", nearest(distribution, DISTRIBUTIONS)
        )
    for q in np.ravel(real("norms", "norms", [] if norms is None else norms)):
        number("norms", _NORM, q)
    return SENSES[sense]


def _named(box: Space, values: np.ndarray) -> dict[str, float]:
    return dict(zip(box.names, map(float, values), strict=True))


def _stats(plain: Evaluator) -> dict[str, float]:
    spent = plain.spent
    return {
        "batches": spent.batches, "points": spent.points, "wall_s": spent.wall_s, "compile_s": spent.compile_s,
        "lanes": plain.batch,
    }  # fmt: skip


def _agreement(ways: Sequence[Path], best: Path) -> tuple[int, int]:
    """Ends of descents beside the best one's, which the last digits may still better."""
    same = [way for way in ways if abs(way.goal - best.goal) <= _AGREE * abs(best.goal)]
    return len(same), sum(bool(np.all(np.abs(way.end - best.end) <= _NEAR)) for way in same)


def _steady(scene: AbstractModel, params: Params, wanted: Objective) -> None:
    """Refuse what has no steady motion."""
    check_recurs(scene, params)
    for feature in wanted.features:
        if feature.kind not in _OF_A_TURN:
            remedy = f"take {', '.join(_OF_A_TURN)}"
            raise InputError(f"feature '{feature.name}'", "is no objective of steady motion", remedy)


def _confirmed(
    scene: AbstractModel, checker: Any, designs: tuple, times: tuple, wanted: Objective, sign: float, gain: float,
    accuracy: str | float,
) -> Confirmation | None:  # fmt: skip
    if checker is None:
        return None
    checker = independent(scene)[0] if isinstance(checker, str) else checker
    solver = independent(checker)[1]
    return _confirm(scene, checker, solver, designs, times, wanted, sign, gain, tighter(accuracy))


def _certified(
    scene: AbstractModel, params: Params, times: np.ndarray, box: Space, wanted: Objective, accuracy: str | float,
    max_steps: int,
) -> Certificate | None:  # fmt: skip
    """Equilibria have no tolerance to hold against another, and no chaos."""
    if not scene.traits.history:
        return None
    names = [f.name for f in wanted.features if f.kind in FEATURES]
    found = sensitivity(scene, params, times, box.names, features=names, accuracy=accuracy, max_steps=max_steps)
    return found.certificate


def _slices(plain: Evaluator, point: np.ndarray) -> dict[str, Slice]:
    shares = np.linspace(0.0, 1.0, _SLICE)
    rows = []
    for k, x in enumerate(point):
        line = np.tile(point, (_SLICE + 1, 1))
        line[:, k] = np.sort(np.append(shares, x))
        rows.append(line)
    points = np.concatenate(rows)
    true = plain(points).true.reshape(len(point), -1)
    values = plain.space.values(points).reshape(len(point), _SLICE + 1, -1)
    return {name: Slice(values[k, :, k], true[k]) for k, name in enumerate(plain.space.names)}


def _verdict(
    refined: Refined, kink: Kink | None, checked: Confirmation | None, certificate: Certificate | None, agree: int,
    near: int, ways: Sequence[Path], gain: float, kappa: float, plain: Evaluator, unborn: str,
) -> tuple[str, str]:  # fmt: skip
    """The worst of what is wrong, and everything in words."""
    words, wrong = [], []
    if unborn:
        words.append(f"the given design has no value ({unborn}): the gain is unknown")
    elif not gain > 0.0 and not kappa:
        wrong.append(NO_GAIN)
        words.append("no design within the bounds is better than the given one")
    if checked is not None and not checked.confirmed and not unborn and gain > 0.0:
        wrong.append(NOT_CONFIRMED)
        seen = checked.reason or f"it sees {100.0 * checked.share:.3g} % of the gain"
        words.append(f"not confirmed by the {checked.how}: {seen}")
    elif checked is not None and checked.confirmed:
        words.append(f"confirmed by the {checked.how}, which sees {100.0 * checked.share:.4g} % of the gain")
    if certificate is not None and certificate.verdict == NOT:
        bad = [f"{name} ({one.remark})" for name, one in certificate.parameters.items() if one.verdict == NOT]
        wrong.append(NOT_TRUSTED)
        words.append(f"the gradient is not to be trusted by {', '.join(bad)}")
    if not refined.arrived:
        wrong.append(ROUGH)
        words.append("no optimum in the sense of derivatives: a kink, a flat place, or too few iterations")
    if kink is not None:
        words.append(f"samples equally high there: {kink.equal}; residual of Clarke's condition {kink.residual:.1e}")
    held = [(n, a) for n, a in zip(plain.space.names, refined.active, strict=True) if a]
    bounds = [f"{name} at its {'upper' if side > 0 else 'lower'} bound" for name, side in held]
    words += [", ".join(bounds)] if bounds else []
    if agree < 2 and len(ways) > 1:
        wrong.append(ALONE)
    words.append(f"{agree} of {len(ways)} descents end at the best one's value, {near} of them at its place")
    failed = sum(plain.spent.failures.values())
    if failed:
        most = ", ".join(f"{text} ({n})" for text, n in plain.spent.failures.most_common(3))
        words.append(f"{failed} of {plain.spent.points} points have no value: {most}")
    order = [NOT_CONFIRMED, NOT_TRUSTED, ROUGH, ALONE, NO_GAIN]
    return min(wrong, key=order.index) if wrong else OK, "; ".join(words)


def _failed(
    plain: Evaluator, wanted: Objective, sense: str, box: Space, given: np.ndarray, first: float, ways: list[Path]
) -> Design:
    """No start has a value."""
    nothing, most = dict.fromkeys(box.names, float("nan")), plain.spent.failures.most_common(3)
    why = ", ".join(f"{text} ({n})" for text, n in most)
    return Design(
        FAILED, f"no start has a value: {why}", wanted.name, sense, wanted.unit, nothing, _named(box, given), {},
        float(first), np.nan, np.nan, nothing, np.nan, np.nan, tuple(ways), 0, 0, None, None, None, None, {},
        dict(plain.spent.failures), _stats(plain), box,
    )  # fmt: skip
