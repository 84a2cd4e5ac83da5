"""``design``: the verb. Free parameters, bounds and tolerances in, a checked optimum out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from bcfj_jax.analysis.derivatives.certificate import NOT
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.analysis.derivatives.sensitivity import sensitivity
from bcfj_jax.analysis.derivatives.steady import check_recurs, shares
from bcfj_jax.analysis.designs import result as ended
from bcfj_jax.analysis.designs.confirm import confirm, independent, robust, robustness
from bcfj_jax.analysis.designs.descent import Path, descend, starts
from bcfj_jax.analysis.designs.evaluate import Evaluator
from bcfj_jax.analysis.designs.objective import Combine
from bcfj_jax.analysis.designs.objective import objective as objective_of
from bcfj_jax.analysis.designs.refine import ARRIVED, Kink, Refined, minimax, refine
from bcfj_jax.analysis.designs.result import Design, Slice
from bcfj_jax.analysis.designs.space import Free, Search, SearchKeys, space
from bcfj_jax.analysis.features import KINDS, NAMED, OF_TURN
from bcfj_jax.core.errors import InputError, texts
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import increasing
from bcfj_jax.core.settings import taking
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, of_numbers
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.solve.plan import plan

# Values this near, over the best one, agree; and places, over the ranges.
_AGREE, _NEAR = 1e-4, 1e-2
# Points of a slice, on either side of the optimum together.
_SLICE = 25
# What does not ask how long a turn lasts.
_OF_A_TURN = tuple(name for name in OF_TURN if KINDS[name].turn == "same")


@taking(Search)
def design(
    scene: AbstractModel, params: Params, times: Float[ArrayLike, " T"], objective: str | Mapping[str, float] | Combine,
    free: Mapping[str, Free | Sequence[Any]], tell: Callable[[Design], None] | None = None,
    **options: Unpack[SearchKeys],
) -> Design:  # fmt: skip
    """Make a feature least, or most, over free parameters within bounds, and say what the optimum is worth.

    Starts (the given design, and points of a scrambled Sobol design) descend by L-BFGS-B in one compiled batch; the
    best is refined by Newton's method on the gradient to 1e-6 of every range; an independent run confirms the gain.
    Runs compile once per scene, number of times, names and starts; another objective compiles nothing.

    Args:
        scene: any model but an open one (fidelity "auto"). A dynamic joint is chaotic over long times: take "quasistatic", or a
            mean over a short time.
        params: the design before, and all that is not free, SI.
        times: (T,) [s]; even ones, where a peak is wanted to 1e-6.
        objective: a feature ("seat_cage.peak", "contact.peak_penetration", "cage_ball.largest" for the greatest
            |F|), weights by feature for their sum, or a function of a dict of ``features``.
        free: by name ``Free`` or (lower, upper, tolerance, relative, scale); texts such as "20 um" are converted.
        tell: receives the best descent's end ("not checked yet"), then the optimum checked by runs ("not complete yet").
        options: by name, those of ``space.Search``: features, sense, kappa, distribution, samples, starts, norms,
            iterations, accuracy, max_steps, confirm, certify, slices, seed, steady.

    Raises:
        InputError: for names, bounds, tolerances and options that are not right.
    """
    search = Search(**options).checked()
    t, params = increasing(times, 2), inputs.parameters(of_numbers(scene), params, traced=False)
    plain, search = posed((scene, params, t), objective, free, search)
    box, goal = plain.space, robust(plain, search.kappa)
    given = np.array([float(plain.params[name]) for name in box.names])
    before = plain.at(given[None])
    with stage(f"searching from {search.starts} starts"):
        begin = starts(goal, box.unit(given), search.starts, search.seed)
        ways = descend(goal, begin, search.norms or (), search.iterations)
    best = min(ways, key=lambda way: way.goal if np.isfinite(way.goal) else np.inf)
    nothing, unknown = dict.fromkeys(box.names, float("nan")), float("nan")
    found = Design(
        ended.FAILED, f"no start has a value: {plain.spent.why()}", plain.objective.name, search.sense, plain.objective.unit,
        nothing, box.named(given), {}, float(before.true[0]), unknown, unknown, nothing, unknown, unknown, tuple(ways),
        0, 0, None, None, None, None, {}, {}, {}, box,
    )  # fmt: skip
    if np.isfinite(best.goal):
        told, found = tell or (lambda _: None), _searched(found, plain, best)
        told(found)
        with stage("refining the best"):
            refined, kink = _optimum(plain, goal, best, search)
        found = _assessed(found, plain, search, refined, kink is not None, told)
        if found.robustness and not before.reasons[0]:
            found = found._replace(robustness_before=robustness(plain, box.unit(given), before, search, False))
        if search.slices:
            found = found._replace(slices=_slices(plain, refined.point))
        status, reason = _verdict(found, plain, refined.arrived, kink, (before.reasons[0], search.kappa))
        found = found._replace(status=status, reason=reason)
    stats = {name: getattr(plain.spent, name) for name in ("batches", "points", "wall_s", "compile_s")}
    return found._replace(failures=dict(plain.spent.failures), stats=stats | {"lanes": plain.batch})


def posed(
    given: tuple[AbstractModel, Params, np.ndarray], asked: str | Mapping[str, float] | Combine, free: Mapping[str, Any],
    search: Search,
) -> tuple[Evaluator, Search]:  # fmt: skip
    """The objective of a model, its parameters and times over the unit box, and the options that it leaves; checked."""
    scene, params, t = given
    if scene.traits.open:
        found = f"'{scene.title}' leaves the choice of the model open"
        raise InputError(f"scene '{scene.kind}' fidelity", found, "give one by name")
    names: Any = search.features if callable(asked) else [asked] if isinstance(asked, str) else asked
    names = list(names) if isinstance(names, Mapping) else names
    scene = observing(scene, texts("objective", names, 'name features, such as "contact.peak"'))
    wanted = objective_of(asked, search.features, scene.members)._replace(sign=search.sign)
    box = space(scene, params, free)
    full = complete(scene, params, box.names)[0]
    scene.check(full)
    if search.norms is None:
        # The largest of several members is another's from place to place.
        search = replace(search, norms=(40.0,) if any(scene.members.values()) and wanted.peaked else ())
    end = None
    if search.steady:
        check_recurs(scene, full)
        for feature in wanted.features:
            if feature.kind not in _OF_A_TURN:
                remedy = f"take {', '.join(_OF_A_TURN)}"
                raise InputError(f"feature '{feature.name}'", "is no objective of steady motion", remedy)
        end, t, search = float(t[-1]), shares(scene, full), replace(search, certify=False)
    how = plan(scene, search.accuracy, search.max_steps)
    return Evaluator(scene, full, t, how, box, wanted, search.starts, steady=end), search


def _optimum(plain: Evaluator, goal: Any, best: Path, search: Search) -> tuple[Refined, Kink | None]:
    """The last digits of the best descent's end, and the kink that it lies in, if it lies in one."""
    refined = refine(goal, best.end)
    if refined.values.reasons[0] or refined.values.goal[0] > best.goal + 1e-9 * abs(best.goal):
        refined = refined._replace(point=best.end, values=goal(best.end[None], np.inf), arrived=False)
    if refined.arrived or search.kappa or search.sign < 0.0:
        return refined, None
    kink = minimax(plain, refined.point, search.seed)
    if kink is None or not kink.value <= plain(refined.point[None]).true[0]:
        return refined, None
    active = np.where(kink.point <= ARRIVED, -1, np.where(kink.point >= 1.0 - ARRIVED, 1, 0))
    values = goal(kink.point[None], np.inf)
    return Refined(kink.point, values, active, kink.step, np.nan, kink.arrived), kink


def _searched(found: Design, plain: Evaluator, best: Path) -> Design:
    """With the best descent's end, and how many others came to it."""
    same = [way for way in found.starts if abs(way.goal - best.goal) <= _AGREE * abs(best.goal)]
    near = sum(bool(np.all(np.abs(way.end - best.end) <= _NEAR)) for way in same)
    left = "not checked yet: refinement and independent runs come next"
    found = found._replace(status=ended.UNCHECKED, reason=left, agree=len(same), near=near)
    return _placed(found, plain, best.end, best.value)


def _placed(found: Design, plain: Evaluator, point: np.ndarray, after: float) -> Design:
    """With the free parameters' values at a point (P,) of the unit box, and the objective there."""
    named, gain = plain.space.named(plain.space.values(point)), plain.objective.sign * (found.before - after)
    return found._replace(values=named, after=after, gain=gain)


def _assessed(
    found: Design, plain: Evaluator, search: Search, refined: Refined, kinked: bool, tell: Callable[[Design], None]
) -> Design:
    """With what the optimum is worth, by an independent run, of which is told; by its certificate and over its tolerances."""
    box, sign, scene = plain.space, plain.objective.sign, plain.scene
    here, at = plain(refined.point[None]), box.values(refined.point)
    found = _placed(found, plain, refined.point, float(here.true[0]))
    better = {**plain.params, **dict(zip(box.names, at, strict=True))}
    checked = None
    if search.confirm is not None:
        end = plain.steady
        designs = [
            (one, plain.times if end is None else end - scene.period(one)[0] * (1.0 - plain.times))
            for one in (plain.params, better)
        ]
        with stage("checking by independent runs"):
            by = independent(scene, search.confirm, search.accuracy)
            checked = confirm(scene, by, designs, plain.objective, found.gain)
    sides = {-1: "lower", 1: "upper"}
    found = found._replace(
        at_bound={n: sides[int(a)] for n, a in zip(box.names, refined.active, strict=True) if a},
        gradient=box.named(sign * refined.values.slope[0] / box.slope(at)), step=refined.step,
        curvature=refined.curvature, confirmation=checked,
    )  # fmt: skip
    left = "not complete yet: the gradient's certificate, tolerances and the objective about the optimum come next"
    tell(found._replace(status=ended.INCOMPLETE, reason=left))
    # Equilibria have no tolerance to hold against another, and no chaos.
    if search.certify and scene.traits.history:
        names = [f.name for f in plain.objective.features if f.kind in NAMED]
        how: dict[str, Any] = {"accuracy": search.accuracy, "max_steps": search.max_steps, "features": names}
        found = found._replace(certificate=sensitivity(scene, better, plain.times, box.names, **how).certificate)
    return found._replace(robustness=robustness(plain, refined.point, here, search, kinked))


def _slices(plain: Evaluator, point: np.ndarray) -> dict[str, Slice]:
    lines = np.tile(point, (point.size, _SLICE + 1, 1))
    for k, x in enumerate(point):
        lines[k, :, k] = np.sort(np.append(np.linspace(0.0, 1.0, _SLICE), x))
    points = lines.reshape(-1, point.size)
    values = plain.space.values(points).reshape(len(point), _SLICE + 1, -1)
    with stage("the objective about the optimum"):
        true = plain(points).true.reshape(len(point), -1)
    return {name: Slice(values[k, :, k], true[k]) for k, name in enumerate(plain.space.names)}


def _verdict(
    found: Design, plain: Evaluator, arrived: bool, kink: Kink | None, before: tuple[str, float]
) -> tuple[str, str]:
    """The worst of what is wrong, and everything in words; ``before``: why the given design has no value, and kappa."""
    words, wrong, (unborn, kappa) = [], [], before
    checked, certificate, ways = found.confirmation, found.certificate, found.starts
    if unborn:
        words.append(f"the given design has no value ({unborn}): the gain is unknown")
    elif not found.gain > 0.0 and not kappa:
        wrong.append(ended.NO_GAIN)
        words.append("no design within the bounds is better than the given one")
    if checked is not None and not checked.confirmed and not unborn and found.gain > 0.0:
        wrong.append(ended.NOT_CONFIRMED)
        seen = checked.reason or f"it sees {100.0 * checked.share:.3g} % of the gain"
        words.append(f"not confirmed by the {checked.how}: {seen}")
    elif checked is not None and checked.confirmed:
        words.append(f"confirmed by the {checked.how}, which sees {100.0 * checked.share:.4g} % of the gain")
    if certificate is not None and certificate.verdict == NOT:
        bad = [f"{name} ({one.remark})" for name, one in certificate.parameters.items() if one.verdict == NOT]
        wrong.append(ended.NOT_TRUSTED)
        words.append(f"the gradient is not to be trusted by {', '.join(bad)}")
    if not arrived:
        wrong.append(ended.ROUGH)
        words.append("no optimum in the sense of derivatives: a kink, a flat place, or too few iterations")
    if kink is not None:
        words.append(f"samples equally high there: {kink.equal}; residual of Clarke's condition {kink.residual:.1e}")
    if found.at_bound:
        words.append(", ".join(f"{name} at its {side} bound" for name, side in found.at_bound.items()))
    if found.agree < 2 and len(ways) > 1:
        wrong.append(ended.ALONE)
    words.append(
        f"{found.agree} of {len(ways)} descents end at the best one's value, {found.near} of them at its place"
    )
    if failed := sum(plain.spent.failures.values()):
        words.append(f"{failed} of {plain.spent.points} points have no value: {plain.spent.why()}")
    order = [ended.NOT_CONFIRMED, ended.NOT_TRUSTED, ended.ROUGH, ended.ALONE, ended.NO_GAIN]
    return min(wrong, key=order.index) if wrong else ended.OK, "; ".join(words)
