"""The certificate: how far derivatives are apart, what each was compared with, and what it is good for. NumPy.

The derivative of histories by a parameter is (T, M): times, channels and components together. Norms are L2 over time and M,

    ||D||^2 = sum_i w_i sum_m D_im^2,      w_i the trapezoidal weight of sample i.

Two comparisons. *Levels*: the same derivative by far tighter solves, which bound its error (``bounds``).
*Differences*: central differences of force histories that were computed without any derivative, by the solver meant
for values; along one random direction of all parameters first, one by one where that one disagrees. Differences
have errors of their own, which a second step a quarter as long measures, and only what exceeds these counts.

| verdict | when |
|---|---|
| ``trusted`` | the pointwise error is at most 3 % |
| ``averaged only`` | that of the moving average is at most 10 % |
| ``not differentiable here`` | larger errors, or chaotic motion: tangents grow by more than 1e6 and levels disagree |

A feature's derivative has its own verdict, by the bound of that number's error: at most 3 %, at most 10 %, more. It may
be good where the history's is not. Where no far tighter solve was made, or a run beside fails, or the budget ends, the
verdict is that of the comparisons that were made, and ``unchecked`` says what was not. Where tighter solves do not agree
better than looser ones, nothing bounds an error above 3 %, and the remark says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

TRUSTED, AVERAGED, NOT = "trusted", "averaged only", "not differentiable here"
POINTWISE, BROKEN = 0.03, 0.10
# What central differences find beyond the bound of a history, above which nothing is known of its features.
KINKED = 0.01
# A parameter below this share of the largest influence does not ask for another level.
INFLUENCE = 0.01
# Elasticity below which a feature's derivative counts as that much: 0.01 % per 1 %.
LEAST = 0.01
CHAOTIC_GROWTH = 1e6
INF, NAN = float("inf"), float("nan")
VAGUE = "central differences do not check it: they disagree with each other by half of themselves"
# Of a history whose levels disagree; a feature's number may still agree.
_LOOSE = "it depends on the tolerance"
_OPEN = f"{_LOOSE}, and its error cannot be bounded, since tighter solves do not agree better"
_WINDOWS = 20
# Of a state's tangent per 100 % of a parameter, in units of the states' natural sizes; a metre of travel has some 1e5 of them.
_ROUNDING = 1e-9


def flat(derivative: np.ndarray) -> np.ndarray:
    """(P, T, C, 3) -> (P, T, 3 C)."""
    return derivative.reshape(*derivative.shape[:2], -1)


def weights(times: np.ndarray) -> np.ndarray:
    """Trapezoidal weights (T,) [s]; one sample alone weighs 1."""
    gaps = np.diff(times)
    return 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps)) if len(times) > 1 else np.ones(len(times))


def averaged(times: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    """Moving average (..., T, M) over [t - width/2, t + width/2], cut at the ends, linear between samples."""
    if len(times) < 2 or width <= 0.0:
        return values
    gaps = np.diff(times)[:, None]
    pieces = 0.5 * gaps * (values[..., 1:, :] + values[..., :-1, :])
    total = np.concatenate([np.zeros_like(values[..., :1, :]), np.cumsum(pieces, axis=-2)], axis=-2)
    low, high = (np.clip(times + way * width, times[0], times[-1]) for way in (-0.5, 0.5))

    def integral(at: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
        s = ((at - times[k]) / np.diff(times)[k])[:, None]
        first, second = values[..., k, :], values[..., k + 1, :]
        return total[..., k, :] + gaps[k] * s * (first + 0.5 * s * (second - first))

    return (integral(high) - integral(low)) / (high - low)[:, None]


def norm(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """||D|| over time and the last axis, (...,); without overflow."""
    size = np.max(np.abs(values), axis=(-2, -1), initial=0.0)
    safe = np.where((size > 0) & np.isfinite(size), size, 1.0)
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = values / safe[..., None, None]
        return safe * np.sqrt(np.einsum("...tm,t->...", scaled * scaled, weights(times)))


class Difference(NamedTuple):
    """One derivative (T, M) against another: relative L2, half of it by when [s], from when on above 10 % [s]."""

    relative: float
    where: float
    broken: float


def difference(times: np.ndarray, found: np.ndarray, other: np.ndarray, floor: float, limit: float) -> Difference:
    """How far ``found`` (T, M) is from ``other``, of one parameter, relative to the larger of the two.

    The running ratio's denominator is at least ``floor`` [N per unit] times sqrt(horizon), so that what is nearly nothing at the
    start breaks nothing down. The derivative has broken down where the ratio stays above ``limit`` to the end.
    """
    w = weights(times)
    # Not Python's max, which loses a NaN that comes second.
    size = float(np.max([np.max(np.abs(x), initial=0.0) for x in (found, other)]))
    if not np.isfinite(size):
        bad = ~(np.isfinite(found) & np.isfinite(other)).all(axis=-1)
        first = float(times[int(np.argmax(bad))])
        return Difference(INF, first, first)
    if size == 0.0:
        return Difference(0.0, NAN, NAN)
    a, b = found / size, other / size
    wrong = np.cumsum(w * np.sum((a - b) ** 2, axis=-1))
    right = np.maximum(np.cumsum(w * np.sum(a * a, axis=-1)), np.cumsum(w * np.sum(b * b, axis=-1)))
    if wrong[-1] == 0.0:
        return Difference(0.0, NAN, NAN)
    least = min(1e-6 * right[-1], (floor / size) ** 2 * w.sum())
    running = np.sqrt(wrong / np.maximum(right, max(least, 1e-300)))
    where = float(times[int(np.searchsorted(wrong, 0.5 * wrong[-1]))])
    good = np.flatnonzero(running <= limit)
    broken = NAN if running[-1] <= limit else float(times[good[-1] + 1 if good.size else 0])
    return Difference(float(np.sqrt(wrong[-1] / right[-1])), where, broken)


class Comparison(NamedTuple):
    """What was found for one parameter in one comparison; until when [s] it could be made, NaN for the whole horizon.

    ``unbounded``: of levels, whether they show no limit; ``vague``: of central differences, whether their own error is
    half of them or more, so that they check nothing.
    """

    what: str
    pointwise: Difference
    average: Difference
    until: float = NAN
    unbounded: bool = False
    vague: bool = False

    def with_relative(self, new: Callable[[float, float], float], other: Comparison | None = None) -> Comparison:
        """With other relative differences: a function of its own and of those of another comparison."""
        pairs = zip(self[1:3], (other or self)[1:3], strict=True)
        pointwise, average = (mine._replace(relative=new(mine.relative, its.relative)) for mine, its in pairs)
        return self._replace(pointwise=pointwise, average=average)


def compare(what: str, times: np.ndarray, a: np.ndarray, b: np.ndarray, smallest: float, width: float) -> Comparison:
    """Two derivatives (T, M) of one parameter."""
    with np.errstate(over="ignore", invalid="ignore"):
        means = averaged(times, a, width), averaged(times, b, width)
    return Comparison(what, difference(times, a, b, smallest, BROKEN), difference(times, *means, smallest, BROKEN))


class Growth(NamedTuple):
    """Of a tangent of the state: its norm's end over its beginning [-], and the exponent [1/s] that fits it."""

    factor: float
    exponent: float


def growth(times: np.ndarray, state: np.ndarray) -> Growth:
    """Growth of a state's tangent (T, n) per 100 % of its parameter, in units of the states' natural sizes.

    The norm's greatest in each of up to 20 windows of the horizon; the exponent is the least-squares slope of its
    logarithm, over the windows that are more than rounding without their first tenth, in which tangents grow from
    nothing: the largest Lyapunov exponent of the direction this parameter excites, over this horizon.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.max(np.abs(state), axis=-1)
    if not np.isfinite(size).all():
        return Growth(INF, NAN)
    parts = np.array_split(np.arange(len(times)), min(_WINDOWS, len(times)))
    peaks, middle = (np.array([f(x[part]) for part in parts]) for f, x in ((np.max, size), (np.mean, times)))
    alive = np.flatnonzero(peaks > _ROUNDING)
    alive = alive[max(1, len(alive) // 10) :]
    if len(times) < 4 or alive.size < 3:
        return Growth(1.0, NAN)
    logs = np.log(peaks[alive])
    slope = float(np.polyfit(middle[alive], logs, 1)[0])
    return Growth(float(np.exp(min(logs[-3:].max() - logs[0], 700.0))), slope)


def chaotic(grown: Growth, found: Comparison) -> bool:
    """Whether a derivative means nothing: it grows without bound and depends on the tolerance."""
    return grown.factor > CHAOTIC_GROWTH and not grown.exponent <= 0 and not found.average.relative <= POINTWISE


def apart(first: np.ndarray, second: np.ndarray, numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Relative difference of features' derivatives (F, P); 0 where both are 0, NaN where one is unknown.

    A derivative below 0.01 % of the feature (F,) per 1 % of the parameter's value (P,) counts as that much.
    """
    least = LEAST * np.abs(numbers)[:, None] / np.maximum(np.abs(values), 1e-30) * (values != 0)
    size = np.maximum(np.maximum(np.abs(first), np.abs(second)), least)
    return np.where(size > 0, np.abs(first - second) / np.where(size > 0, size, 1.0), size)


def of_feature(apart: float) -> str:
    """Verdict of one feature's derivative, from its relative error at most."""
    return TRUSTED if apart <= POINTWISE else AVERAGED if apart <= BROKEN else NOT


class Check(NamedTuple):
    """One parameter's part of a certificate."""

    verdict: str  # ``trusted``, ``averaged only`` or ``not differentiable here``
    remark: str  # why, in words; "" where the figures say it
    compared_with: tuple[str, ...]  # in words, each comparison
    # pointwise, average: relative L2 errors over the horizon at most, the worst of the comparisons.
    pointwise: float
    average: float
    features: dict[str, float]  # relative error of each feature's derivative at most
    growth: float  # of the state's tangent over the horizon [-]
    exponent: float  # of that growth [1/s]
    influence: float  # ||p dF/dp|| over that of the strongest parameter [-]
    where: float  # time by which half of the pointwise difference has come about [s]
    breakdown: float  # time after which the averages' running difference exceeds 10 % [s]; NaN: it does not at the end
    feature_verdicts: dict[str, str] = {}  # of each feature's derivative
    unchecked: str = ""  # what far tighter solves or central differences did not check, and why, in a sentence; or ""

    @property
    def lost(self) -> bool:
        """Whether no number of this parameter means anything: a run that failed, chaos, a kink or a jump."""
        return self.verdict == NOT and not self.remark.startswith(_LOOSE)


class Certificate(NamedTuple):
    """How good the derivatives are."""

    verdict: str  # the worst of the parameters'
    parameters: dict[str, Check]  # a ``Check`` by name
    average: float  # width of the moving average [s]
    target: float  # bound of the averages' relative error that ended the tightening, where it was reached
    # tolerances, steps: of every level, loosest first.
    tolerances: tuple[float, ...]
    steps: tuple[int, ...]
    # Pointwise and average difference from central differences along one random direction of all parameters, less the
    # differences' own error; None: not taken, or it checks nothing.
    direction: dict[str, float] | None
    reported: float = NAN  # tolerance of the level whose derivatives are reported; tighter ones bound their error


class Seen(NamedTuple):
    """What is known of a parameter beside the comparisons of its histories."""

    # features, grown, influence: as Check has them.
    features: Mapping[str, float]
    grown: Growth
    influence: float
    end: float  # of a run that failed [s], or NaN
    also: str = ""  # a comparison of all parameters together, which they passed
    unchecked: str = ""  # what was not compared, and why
    vague: bool = False  # whether central differences of all parameters together were


def check(comparisons: Sequence[Comparison], seen: Seen) -> Check:
    """One parameter's verdict; of its comparisons that of the levels comes first."""
    comparisons, unchecked, vague = _that_count(comparisons, seen)
    levels, worst = comparisons[0], max(comparisons, key=lambda c: c.average.relative)
    pointwise = max(c.pointwise.relative for c in comparisons)
    # What differences alone find, a kink or a jump, no tolerance shows in the features, which may miss it by more.
    kinked = max((c.pointwise.relative - levels.pointwise.relative for c in comparisons[1:]), default=0.0)
    least = INF if kinked > KINKED else 5.0 * max(kinked, 0.0)
    features = {name: float(np.maximum(x, least)) for name, x in seen.features.items()}
    numbers, grown = {name: of_feature(x) for name, x in features.items()}, seen.grown
    verdict, remark, breakdown = NOT, "", worst.average.broken
    if np.isfinite(seen.end):
        remark, breakdown = "the run failed", seen.end
    elif chaotic(grown, levels):
        rate = f"about {grown.exponent:.3g} per second" if np.isfinite(grown.exponent) else "beyond all numbers"
        remark = f"chaotic: the largest Lyapunov exponent is {rate}"
    elif vague and grown.factor > CHAOTIC_GROWTH:
        remark = "tangents grow by more than a million, and no central difference confirms them"
    elif pointwise <= POINTWISE:
        verdict, remark, breakdown = TRUSTED, "no influence" if seen.influence == 0.0 else "", NAN
    elif worst.average.relative <= BROKEN and not levels.unbounded:
        verdict, breakdown = AVERAGED, NAN
    elif worst is not levels and levels.average.relative <= POINTWISE:
        # Before two tolerances agree, differences can only tell that the derivative is not solved yet.
        remark = "central differences find another derivative: the force has a kink or a jump here"
        remark += "; where a contact begins or ends at one of the times, take other times"
    elif grown.factor > CHAOTIC_GROWTH:
        remark = "tangents grow by more than a million"
    else:
        remark = f"{_OPEN if levels.unbounded else _LOOSE}: give a tighter accuracy or a larger smoothing"
        remark += "; its influence is weak" if seen.influence < INFLUENCE else ""
    compared = (*(c.what for c in comparisons), *([seen.also] if seen.also else []))
    found = Check(
        verdict, remark, compared, pointwise, worst.average.relative, features, grown.factor, grown.exponent,
        float(seen.influence), worst.pointwise.where, breakdown, numbers, unchecked,
    )  # fmt: skip
    return found._replace(feature_verdicts=dict.fromkeys(numbers, NOT)) if found.lost else found


def _that_count(comparisons: Sequence[Comparison], seen: Seen) -> tuple[list[Comparison], str, bool]:
    """Comparisons that check something, what was not checked, and whether central differences were too vague to."""
    # A run beside that failed says nothing of this one.
    failed = [c for c in comparisons[1:] if not np.isfinite(c.average.relative)]
    vague = seen.vague or any(c.vague for c in comparisons[1:])
    counting = [c for c in comparisons if not c.vague and c not in failed]
    nothing, beside = "central differences check nothing", "a run beside this one failed"
    unchecked = joined(seen.unchecked, f"{nothing}: {beside}" if failed else "", VAGUE if vague else "")
    early = [c.until for c in counting if np.isfinite(c.until)]
    if early and "central differences" not in unchecked:
        unchecked = joined(unchecked, f"{nothing} after {min(early):.4g} s: {beside} there")
    return counting, unchecked, vague


def joined(*said: str) -> str:
    """Reasons in a sentence."""
    return "; ".join(filter(None, said))


def worst_verdict(checks: Mapping[str, Check]) -> str:
    """The least of several verdicts."""
    return max((c.verdict for c in checks.values()), key=[TRUSTED, AVERAGED, NOT].index)
