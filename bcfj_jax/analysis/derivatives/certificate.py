"""The certificate: what each derivative was compared with, by how much it differs, and what it is good for.

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

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.jacobian import Level
from bcfj_jax.analysis.derivatives.norms import (
    CHAOTIC_GROWTH,
    Difference,
    Growth,
    averaged,
    difference,
    growth,
    norm,
)  # fmt: skip

TRUSTED, AVERAGED, NOT = "trusted", "averaged only", "not differentiable here"
POINTWISE, BROKEN = 0.03, 0.10
# What central differences find beyond the bound of a history, above which nothing is known of its features.
KINKED = 0.01
# A parameter below this share of the largest influence does not ask for another level.
INFLUENCE = 0.01
# Elasticity below which a feature's derivative counts as that much: 0.01 % per 1 %.
LEAST = 0.01
INF = float("inf")
# Of a history whose levels disagree; a feature's number may still agree.
_LOOSE = "it depends on the tolerance"
VAGUE = "central differences do not check it: they disagree with each other by half of themselves"
_OPEN = f"{_LOOSE}, and its error cannot be bounded, since tighter solves do not agree better"


class Check(NamedTuple):
    """One parameter's part of a certificate.

    Attributes:
        verdict: ``trusted``, ``averaged only`` or ``not differentiable here``.
        remark: why, in words; "" where the figures say it.
        compared_with: in words, each comparison.
        pointwise, average: relative L2 errors over the horizon at most, the worst of the comparisons.
        features: relative error of each feature's derivative at most.
        growth: of the state's tangent over the horizon [-]; exponent: of that growth [1/s].
        influence: ||p dF/dp|| over that of the strongest parameter [-].
        where: time by which half of the pointwise difference has come about [s].
        breakdown: time after which the averages' running difference exceeds 10 % [s]; NaN: it does not at the end.
        feature_verdicts: of each feature's derivative.
        unchecked: what far tighter solves or central differences did not check, and why, in a sentence; or "".
    """

    verdict: str
    remark: str
    compared_with: tuple[str, ...]
    pointwise: float
    average: float
    features: dict[str, float]
    growth: float
    exponent: float
    influence: float
    where: float
    breakdown: float
    feature_verdicts: dict[str, str] = {}
    unchecked: str = ""

    @property
    def lost(self) -> bool:
        """Whether no number of this parameter means anything: a run that failed, chaos, a kink or a jump."""
        return self.verdict == NOT and not self.remark.startswith(_LOOSE)


class Certificate(NamedTuple):
    """How good the derivatives are.

    Attributes:
        verdict: the worst of the parameters'.
        parameters: a ``Check`` by name.
        average: width of the moving average [s].
        target: bound of the averages' relative error that ended the tightening, where it was reached.
        tolerances, steps: of every level, loosest first.
        direction: pointwise and average difference from central differences along one random direction of all
            parameters, less the differences' own error; None: not taken, or it checks nothing.
        reported: tolerance of the level whose derivatives are reported; tighter ones bound their error.
    """

    verdict: str
    parameters: dict[str, Check]
    average: float
    target: float
    tolerances: tuple[float, ...]
    steps: tuple[int, ...]
    direction: dict[str, float] | None
    reported: float = float("nan")


class Comparison(NamedTuple):
    """What was found for one parameter in one comparison; until when [s] it could be made, NaN for the whole horizon.

    ``unbounded``: of levels, whether they show no limit; ``vague``: of central differences, whether their own error is
    half of them or more, so that they check nothing.
    """

    what: str
    pointwise: Difference
    average: Difference
    until: float = float("nan")
    unbounded: bool = False
    vague: bool = False


def flat(derivative: np.ndarray) -> np.ndarray:
    """(P, T, C, 3) -> (P, T, 3 C)."""
    return derivative.reshape(*derivative.shape[:2], -1)


def influences(times: np.ndarray, level: Level, values: np.ndarray) -> np.ndarray:
    """Each parameter's ||p dF/dp|| over the largest (P,); a parameter that is 0 counts by 1 unit."""
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = norm(times, flat(level.derivative.force)) * np.where(values == 0, 1.0, np.abs(values))
    largest = sizes.max(initial=0.0)
    return sizes / largest if largest > 0 else sizes


def between(times: np.ndarray, coarse: Level, fine: Level, values: np.ndarray, width: float) -> list[Comparison]:
    """Comparisons of two levels, one a parameter."""
    what = f"the same derivative at a tolerance of {coarse.tolerance:.3g} against {fine.tolerance:.3g}"
    smallest = 1e-3 * float(np.sqrt(np.mean(np.sum(fine.value.force**2, axis=(1, 2)))))
    first, second = flat(coarse.derivative.force), flat(fine.derivative.force)
    return [
        compare(what, times, a, b, smallest / max(abs(p), 1e-30), width)
        for a, b, p in zip(first, second, values, strict=True)
    ]


def compare(what: str, times: np.ndarray, a: np.ndarray, b: np.ndarray, smallest: float, width: float) -> Comparison:
    """Two derivatives (T, M) of one parameter."""
    with np.errstate(over="ignore", invalid="ignore"):
        means = averaged(times, a, width), averaged(times, b, width)
    return Comparison(what, difference(times, a, b, smallest, BROKEN), difference(times, *means, smallest, BROKEN))


def growths(times: np.ndarray, level: Level, values: np.ndarray) -> list[Growth]:
    """Growth of the state's tangent, one a parameter."""
    sizes = np.where(values == 0, 1.0, np.abs(values))
    return [growth(times, size * state) for size, state in zip(sizes, level.derivative.state, strict=True)]


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


class Seen(NamedTuple):
    """What is known of a parameter beside the comparisons of its histories.

    Attributes:
        features, grown, influence: as ``Check`` has them.
        end: of a run that failed [s], or NaN.
        also: a comparison of all parameters together, which they passed.
        unchecked: what was not compared, and why.
        vague: whether central differences of all parameters together were.
    """

    features: Mapping[str, float]
    grown: Growth
    influence: float
    end: float
    also: str = ""
    unchecked: str = ""
    vague: bool = False


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
        verdict, remark, breakdown = TRUSTED, "no influence" if seen.influence == 0.0 else "", float("nan")
    elif worst.average.relative <= BROKEN and not levels.unbounded:
        verdict, breakdown = AVERAGED, float("nan")
    elif worst is not levels and levels.average.relative <= POINTWISE:
        # Before two tolerances agree, differences can only tell that the derivative is not solved yet.
        remark = "central differences find another derivative: the force has a kink or a jump here"
    elif grown.factor > CHAOTIC_GROWTH:
        remark = "tangents grow by more than a million"
    else:
        remark = f"{_OPEN if levels.unbounded else _LOOSE}: give a tighter accuracy or a larger smoothing"
        remark += "; its influence is weak" if seen.influence < INFLUENCE else ""
    if verdict == NOT and not remark.startswith(_LOOSE):
        numbers = dict.fromkeys(numbers, NOT)
    return Check(
        verdict, remark, (*(c.what for c in comparisons), *([seen.also] if seen.also else [])), pointwise,
        worst.average.relative, features, grown.factor, grown.exponent, float(seen.influence), worst.pointwise.where,
        breakdown, numbers, unchecked,
    )  # fmt: skip


def _that_count(comparisons: Sequence[Comparison], seen: Seen) -> tuple[list[Comparison], str, bool]:
    """Comparisons that check something, what was not checked, and whether central differences were too vague to."""
    unchecked = seen.unchecked
    # A run beside that failed says nothing of this one.
    failed = [c for c in comparisons[1:] if not np.isfinite(c.average.relative)]
    if failed:
        unchecked = joined(unchecked, "central differences check nothing: a run beside this one failed")
    vague = seen.vague or any(c.vague for c in comparisons[1:])
    if vague:
        unchecked = joined(unchecked, VAGUE)
    counting = [c for c in comparisons if not c.vague and c not in failed]
    early = [c.until for c in counting if np.isfinite(c.until)]
    if early and "central differences" not in unchecked:
        late = f"central differences check nothing after {min(early):.4g} s: a run beside this one failed there"
        unchecked = joined(unchecked, late)
    return counting, unchecked, vague


def joined(said: str, more: str) -> str:
    """Two reasons in a sentence."""
    return "; ".join(filter(None, (said, more)))


def worst_verdict(checks: Mapping[str, Check]) -> str:
    """The least of several verdicts."""
    return max((c.verdict for c in checks.values()), key=[TRUSTED, AVERAGED, NOT].index)
