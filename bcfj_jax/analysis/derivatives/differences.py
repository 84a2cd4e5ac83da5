"""Central differences held against derivatives, with what the differences themselves are worth, and the certificate of both.

*Of histories*, by runs without any derivative. A step changes the forces by about a share h of themselves: parameter k moves
by h s_k,

    s_k = min(|p_k|, ||F||/||dF/dp_k||),    h = 0.3 e^(1/3),

e the force error of the histories, so that their noise e/h and the truncation h^2 are alike. A second step a quarter
as long is the one compared; where it agrees neither at once nor within twice a small noise, the longer one is run too and
gives the error of the differences, and what exceeds it and the noise is the derivative's. Where a run of the shorter step
fails, the comparison ends there; where it fails early, the difference is infinite: nothing was checked. One random direction
of all parameters comes first, then each parameter alone where that one disagrees, the strongest first, since the budget may end.

*Of features*, by runs with other parameters. Solves at several tolerances share the rule by which tangents pass a touch: what
is wrong there is wrong at every tolerance alike, and a bound from them does not see it. Differences of forces see it where it
changes the spike of a moving impact, beside which a wrong impulse is small. So

    f(p + h d) - f(p)  against  h (df/dp) d,    d a random direction of all parameters, h = ``_STEP`` of each;

where the two differ by more than the bounds allow, f(p + h d) - f(p - h d) against 2 h (df/dp) d; and where these do too, for
each parameter alone, with a second step a quarter as long, whose difference from the first is the differences' own error.
f(p) is of a solve that was made for the bounds, so that most results take one run more. The program is that of the
derivatives: nothing is compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives import certificate as verdicts
from bcfj_jax.analysis.derivatives.bounds import SAFETY, Budget, Climb, target
from bcfj_jax.analysis.derivatives.certificate import NAN, Certificate, Comparison, Seen, compare, norm
from bcfj_jax.analysis.derivatives.jacobian import forces
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.core.progress import stage
from bcfj_jax.io.stop import OutOfTime
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import MAX_STEPS, Plan, plan
from bcfj_jax.xla.threads import together

Function = Callable[[np.ndarray], np.ndarray]
_SEED = 4
# Share of the samples that a comparison needs, and what is found where there is something; own error beyond which it is none.
_LEAST, _VAGUE = 0.1, 0.5
# Noise, as a share of the derivative, within which the shorter step alone is believed: a joint's two steps are as much apart.
# Twice the noise is, since runs are up to 1.6 times as wrong as they are asked to be (a joint's at 1e-5).
_CLEAR, _TWICE = 0.05, 2.0
# Pitches of steady motion over which central differences are taken.
_PITCHES = 2
# Share of a parameter that features' runs move it by, and relative difference that is looked into.
_STEP, _SEEN = 1e-3, 1e-3
_TOGETHER = "central differences along one random direction of all parameters"


def scales(times: np.ndarray, values: np.ndarray, force: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """s_k (P,), in each parameter's unit; 0 for a parameter at 0, whose other side may not exist."""
    size, slope = norm(times, force), norm(times, derivative)
    with np.errstate(divide="ignore", over="ignore"):
        reach = np.where((slope > 0) & np.isfinite(slope), size / np.where(slope > 0, slope, 1.0), np.inf)
    return np.minimum(np.abs(values), reach)


def direction(count: int) -> np.ndarray:
    """A direction of all parameters, the same at every run: of each a random share, 1/3 to 1, of either sign.

    Not +1 or -1 each: clearance and speed that grow alike leave the time of a touch where it is, and hide a jump there.
    """
    rng = np.random.default_rng(_SEED)
    return rng.choice([-1.0, 1.0], count) * rng.uniform(1.0 / 3.0, 1.0, count)


class Beside(NamedTuple):
    """Runs that a derivative is held against: times (T,) [s], a function of values (P,) that gives forces (T, M) without
    derivatives, where (P,), the error e of the forces, and the width of the moving average [s].
    """

    times: np.ndarray
    forces: Function
    values: np.ndarray
    error: float
    width: float


def against(runs: Beside, step: np.ndarray, derivative: np.ndarray, what: str = "", enough: float = 0.0) -> Comparison:
    """The derivative (T, M) along a direction ``step`` (P,), scaled by ``scales``, held against central differences.

    ``what``: in words; ``enough``: pointwise difference of the shorter step at which the longer one is not run; nor is it within
    twice a noise of 5 % at most.
    """
    times, forces, values, error, width = runs
    h = 0.3 * error ** (1.0 / 3.0)

    def pair(h: float) -> list[np.ndarray]:
        return together(lambda: forces(values + h * step), lambda: forces(values - h * step))

    above, below = pair(0.25 * h)
    whole = len(times)
    sound = np.isfinite(above).all(axis=-1) & np.isfinite(below).all(axis=-1)
    count = whole if sound.all() else int(np.argmin(sound))
    if _LEAST * whole <= count < whole:
        # One of the two failed: what came before is compared.
        times, derivative, above, below = times[:count], derivative[:count], above[:count], below[:count]
    near = (above - below) / (0.5 * h)
    noise = error * float(np.sqrt(np.mean(np.sum(above * above, axis=-1)))) / (0.25 * h)
    found = compare(f"{what}, relative steps of {0.25 * h:.2g}", times, derivative, near, noise, width)
    found = found._replace(until=float(times[-1]) if count < whole else NAN)
    size = max(float(norm(times, derivative)), float(norm(times, near)), 1e-300)
    noisy = noise * float(np.sqrt(max(times[-1] - times[0], 0.0) or 1.0)) / size

    def beyond(found: float, own: float) -> float:
        """What exceeds the differences' own error and noise; where the longer step's run failed no error is known."""
        known = own if np.isfinite(own) else 0.0
        return max(0.0, found - known - noisy) if np.isfinite(found) else found

    if found.pointwise.relative <= enough:
        return found
    if noisy <= _CLEAR and found.pointwise.relative <= _TWICE * noisy:
        return found.with_relative(lambda x, _: beyond(x, (_TWICE - 1.0) * noisy))
    far = np.subtract(*pair(h))[: len(times)] / (2.0 * h)
    own = compare("", times, far, near, noise, width)
    left = found._replace(what=f"{what}, relative steps of {h:.2g} and {0.25 * h:.2g}").with_relative(beyond, own)
    # Differences that disagree with each other by half check nothing, unless even that does not explain what they find.
    return left._replace(vague=bool(own.pointwise.relative + noisy > _VAGUE and left.pointwise.relative < _LEAST))


def witnessed(
    features: Function, here: np.ndarray, values: np.ndarray, slopes: np.ndarray, bounds: np.ndarray
) -> np.ndarray:
    """Bounds (F, P) of features' derivatives ``slopes`` (F, P), larger where their differences find more.

    ``features`` gives (F,) at values (P,) of the parameters, NaN where a run fails; ``here``: (F,) at ``values``, at the same
    tolerance. A parameter that is 0 is not moved; what is NaN keeps its bound.
    """
    step = np.abs(values)
    way = step * direction(len(values))

    def along(way: np.ndarray, h: float) -> np.ndarray:
        return (features(values + h * way) - features(values - h * way)) / (2.0 * h)

    sizes = np.abs(slopes * way)
    with np.errstate(invalid="ignore"):
        allowed = np.sum(sizes * (np.nan_to_num(bounds, posinf=0.0) + _SEEN), axis=1)
        # Where a bound is infinite nothing is trusted that might be looked into.
        known = np.isfinite(np.where(sizes > 0, bounds, 0.0)).all(axis=1)
        doubtful = np.zeros(len(here), bool)
        further = features(values + _STEP * way)
        for back, over in ((lambda: here, _STEP), (lambda: features(values - _STEP * way), 2.0 * _STEP)):
            doubtful = known & (np.abs((further - back()) / over - slopes @ way) > allowed)
            if not doubtful.any():
                return bounds
    found = bounds.copy()
    for k in np.flatnonzero(step):
        alone = np.where(np.arange(len(values)) == k, step, 0.0)
        far, near = along(alone, _STEP), along(alone, 0.25 * _STEP)
        excess = np.maximum(np.abs(near - slopes @ alone) - np.abs(near - far), 0.0)
        share = SAFETY * excess / np.maximum(np.maximum(np.abs(slopes @ alone), np.abs(near)), 1e-300)
        found[:, k] = np.where(doubtful & np.isfinite(share), np.fmax(found[:, k], share), found[:, k])
    return found


class Differing(NamedTuple):
    """What central differences of histories found: of all parameters together, None for not made; of each ``alone``, by number.

    Of each (P,) in words: ``also``, the comparison that it passed with the others; ``unchecked``, why it was not compared; or "".
    """

    both: Comparison | None
    alone: Mapping[int, Comparison]
    also: Sequence[str]
    unchecked: Sequence[str]


def unasked(problem: Problem) -> Differing:
    """No central differences."""
    nothing = [""] * len(problem.names)
    return Differing(None, {}, nothing, nothing)


def beside(problem: Problem, climbed: Climb, histories: Sequence[Comparison], each: bool, spend: Budget) -> Differing:
    """Compare R with central differences of histories; of ``each`` parameter alone, whatever all together show, or where that
    disagrees. ``histories``: what bounds them; ``spend``: time for it.
    """
    values, last, names = problem.values, climbed.last, problem.names
    if not last.good or problem.chaotic(last, histories):
        return unasked(problem)
    fine = finer(problem.scene, problem.error * last.tolerance / climbed.levels[0].tolerance)
    # Values alone, by the program of ``simulate``.
    how = Plan(plan(problem.scene, fine).tolerance, _budget(last.steps))
    short, every = _shortened(problem)
    count = len(short)
    slopes = verdicts.flat(last.derivative.force)[:, :count]
    size = last.value.force.reshape(len(problem.times), -1)[:count]
    step = np.array([scales(short, p, size, d) for p, d in zip(values, slopes, strict=True)])

    def run(at: np.ndarray) -> np.ndarray:
        return forces(problem.scene, problem.moved(at), every, how).reshape(len(every), -1)[:count]

    runs = Beside(short, run, values, fine, problem.width)

    def along(what: str, way: np.ndarray, enough: float) -> Comparison:
        slope = np.tensordot(way, slopes, 1)
        with stage(f"comparing with {what}"):
            compared = spend.on(lambda: against(runs, way, slope, what, enough))
        early = count < len(problem.times) and not np.isfinite(compared.until)
        return compared._replace(what=f"{compared.what}, until {short[-1]:.4g} s") if early else compared

    both, also, unchecked = None, [""] * len(names), [""] * len(names)
    if not each and np.any(step):
        way = step * direction(len(names))
        # What the levels know of needs no second witness.
        sizes = np.abs(way) * norm(short, slopes) / max(float(norm(short, np.tensordot(way, slopes, 1))), 1e-300)
        stated = [(c.pointwise.relative, c.average.relative) for c in histories]
        known = np.maximum(np.nan_to_num(sizes @ np.array(stated), nan=np.inf), _SEEN)
        try:
            both = along(_TOGETHER, way, known[0])
        except OutOfTime:
            unchecked = [f"central differences do not check it: {spend.over}" if s else "" for s in step]
        if both is not None:
            each = bool(both.pointwise.relative > known[0] or both.average.relative > known[1]) and not both.vague
            if np.isfinite(both.until) and not each:
                late = f"central differences check nothing after {both.until:.4g} s: a run beside this one failed there"
                unchecked = [late] * len(names)
            # A parameter at 0 was not moved.
            also = [both.what if s and not each and not both.vague else "" for s in step]
    strength, alone = problem.influences(last), {}
    for k in sorted(np.flatnonzero(step).tolist() if each else (), key=lambda k: -strength[k]):
        unit = np.where(np.arange(len(names)) == k, step, 0.0)
        try:
            found = along("central differences", unit, max(_SEEN, histories[k].pointwise.relative))
            alone[k] = found.with_relative(lambda x, _: SAFETY * x)
        except OutOfTime:
            late = f"central differences do not check it alone: {spend.over}"
            unchecked[k] = verdicts.joined(unchecked[k], late)
    return Differing(both, alone, also, unchecked)


def certified(
    problem: Problem, climbed: Climb, histories: Sequence[Comparison], features: np.ndarray, found: Differing
) -> Certificate:
    """The certificate, from what bounds histories and features (F, P), and from central differences."""
    last, both = climbed.last, found.both
    grown, strength, table = problem.growths(last), problem.influences(last), problem.by_name(features)
    end, vague = NAN if last.good else last.end, both is not None and both.vague
    checks = {}
    for k, name in enumerate(problem.names):
        comparisons = [histories[k], *([found.alone[k]] if k in found.alone else [])]
        unchecked = verdicts.joined(climbed.unchecked, found.unchecked[k])
        seen = Seen(table[name], grown[k], float(strength[k]), end, found.also[k], unchecked, vague)
        checks[name] = verdicts.check(comparisons, seen)
    way = None if both is None or vague else {k: getattr(both, k).relative for k in ("pointwise", "average")}
    tolerances, steps = (tuple(getattr(r, key) for r in climbed.levels) for key in ("tolerance", "steps"))
    worst, limit = verdicts.worst_verdict(checks), target(problem.error)
    return Certificate(worst, checks, problem.width, limit, tolerances, steps, way, last.tolerance)


def _shortened(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Times that differences are taken over, and as many times as there were, so that one program serves both.

    What repeats itself after a pitch is compared until a few pitches after the start is forgotten.
    """
    scene, times = problem.scene, problem.times
    if not scene.recurs(problem.params):
        return times, times
    end = scene.settled_from(problem.params) + _PITCHES * scene.period(problem.params)[1]
    end = min(end, problem.fold.end) if problem.fold else end
    count = int(np.searchsorted(times, end, side="right"))
    if not 2 <= count < len(times):
        return times, times
    apart = 1e-9 * (times[count] - times[count - 1]) * np.arange(1, len(times) - count + 1) / len(times)
    return times[:count], np.concatenate([times[:count], times[count - 1] + apart])


def finer(scene: AbstractModel, error: float) -> float:
    """Error of the forces that differences are taken of: their noise is amplified by 1/h."""
    return max(min(error, 1e-5 if scene.traits.stiff else 1e-7), 1e-9)


def _budget(steps: int) -> int:
    """Four times the steps of the derivatives, or more; few different numbers, since each is a program of its own."""
    allowed = MAX_STEPS
    while allowed < 4 * steps:
        allowed *= 10
    return allowed
