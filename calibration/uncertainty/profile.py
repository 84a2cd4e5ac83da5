"""Profile likelihood: how far one parameter may move, all others following, before the data object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.optimum import Optimum
from calibration.forward.model import Model
from calibration.search.evaluate import evaluator
from calibration.uncertainty.walk import Residuals, Side, Target, together, walk

# A fall of the cost, on the way outwards, by this share of the threshold is a second minimum.
_DIP = 0.05


@dataclass(frozen=True)
class Profile:
    """How the smallest cost depends on one parameter.

    Attributes:
        values: (K,) of the parameter, SI, increasing.
        rises: (K,) cost above the best [weighted squares].
        best: the estimate, SI.
        threshold: the rise that bounds the 95 % interval.
        ends: where the threshold is met below and above the estimate; None where it is not.
        quadratic: where the covariance puts those ends.
        shape: "bounded", "one-sided", "flat" or "multimodal".
        notes: in words, why an end is missing, and bounds of other parameters that an end rests on.
    """

    name: str
    values: np.ndarray
    rises: np.ndarray
    best: float
    threshold: float
    ends: tuple[float | None, float | None]
    quadratic: tuple[float, float]
    shape: str
    log: bool
    notes: tuple[str, ...]

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval where both ends exist, else None."""
        low, high = self.ends
        return None if low is None or high is None else (low, high)


def of_optimum(at: Optimum, only: Sequence[str] | None = None, batch: int | None = None) -> dict[str, Profile]:
    """Profiles of a problem's parameters around its optimum, by label.

    With a reference force, "reference_force" is its profile and "stiffness" that of K = F_ref / d_ref^n, for which
    K is held and F_ref follows n.

    Args:
        only: labels wanted; by default all.
        batch: points evaluated together; by default one a walk.
    """
    targets = [t for t in _targets(at.model, at.labels) if only is None or t.name in only]
    place, allowed = np.asarray(at.end.point, float), rise_allowed(at.spread)
    asked = [(t, allowed(np.eye(place.size)[t.index] - t.shift(place)[1])) for t in targets]
    found = profiles(evaluator(at.model), asked, place, labels=at.labels, batch=batch)
    return {p.name: p for p in found}


def rise_allowed(quality: Spread) -> Callable[[np.ndarray], float]:
    """Rise of the cost that bounds the 95 % interval of a combination of coordinates (P,).

    The square of the covariance interval's quantile: chi-square of 1 degree of freedom for stated noise, F(1, freedom)
    for estimated, whose deviation the weights know; a robust loss multiplies it.
    """

    def allowed(slope: np.ndarray) -> float:
        quantile = quality.quantile if quality.covariance is None else quality.quantile_of(slope)
        return quantile**2 * quality.rise

    return allowed


def _targets(model: Model, labels: Sequence[str]) -> list[Target]:
    lower, width = model.box
    pair = model.pair() if model.referenced else None
    targets = []
    for i, (axis, label) in enumerate(zip(model.coordinates, labels, strict=True)):
        name = "reference_force" if pair and i == pair[0] else label
        targets.append(coordinate(name, i, lower=lower[i], width=width[i], log=axis.log))
    if pair:
        (k, n), depth = pair, model.log_depth
        exponent_is_log = model.coordinates[n].log

        def shift(u: np.ndarray) -> tuple[float, np.ndarray]:
            z = lower[n] + u[n] * width[n]
            exponent = np.exp(z) if exponent_is_log else z
            rate = exponent * width[n] if exponent_is_log else width[n]
            return exponent * depth / width[k], np.eye(u.size)[n] * rate * depth / width[k]

        # The box of F_ref is wider than that of K: K keeps its own.
        low, high = ((b - lower[k]) / width[k] for b in (model.coordinates[k].lower, model.coordinates[k].upper))
        plain = coordinate(labels[k], k, lower=lower[k], width=width[k], log=True)
        targets.insert(k, plain._replace(low=low, high=high, shift=shift))
    return targets


def coordinate(name: str, index: int, *, lower: float = 0.0, width: float = 1.0, log: bool = False) -> Target:
    """One coordinate of the unit box, whose parameter is lower + width u, or the exponential of that."""
    physical = (lambda c: float(np.exp(lower + width * c))) if log else (lambda c: float(lower + width * c))
    return Target(name, index, 0.0, 1.0, lambda u: (0.0, np.zeros(u.size)), physical, log)


def profiles(
    residuals: Residuals, asked: Sequence[tuple[Target, float]], place: np.ndarray, *, labels: Sequence[str],
    batch: int | None = None, scouts: int = 3,
) -> tuple[Profile, ...]:  # fmt: skip
    """Profile likelihood of every target around an optimum.

    Args:
        residuals: batched residual function on the unit box; NaN where a simulation fails.
        asked: what to hold fixed, each with the rise of the sum of squares that bounds its interval.
        batch: points in a call of ``residuals``; by default one a walk.
        scouts: looks beyond an interval's end, evenly up to the range's, for another region as good.
    """
    walks = [walk(target, sign, place, threshold, scouts) for target, threshold in asked for sign in (-1.0, 1.0)]
    sides = together(walks, residuals, batch or len(walks))
    pairs = zip(asked, sides[::2], sides[1::2], strict=True)
    return tuple(_profile(target, below, above, rise, labels) for (target, rise), below, above in pairs)


def _profile(target: Target, below: Side, above: Side, threshold: float, labels: Sequence[str]) -> Profile:
    """Both walks as one curve, its shape in a word, and what there is to say of its ends."""
    trail = [*below.trail[:0:-1], *above.trail]
    best = above.trail[0]
    rises = np.array([p.cost for p in trail]) - best.cost
    with np.errstate(divide="ignore", over="ignore"):
        half = np.sqrt(threshold) / np.float64(above.slope)
        quadratic = (target.physical(best.c - half), target.physical(best.c + half))
    notes = [f"{where} {target.name}: {side.why}" for where, side in (("below", below), ("above", above)) if side.why]
    for where, side in (("lower", below), ("upper", above)):
        place = side.trail[-1].place
        resting = [n for i, (n, u) in enumerate(zip(labels, place, strict=True)) if not 0 < u < 1 and i != target.index]
        if side.end is not None and resting:
            notes.append(f"the {where} end of {target.name} rests on the bound of {' and '.join(resting)}")
    return Profile(
        name=target.name,
        values=np.array([target.physical(p.c) for p in trail]),
        rises=rises,
        best=target.physical(best.c),
        threshold=threshold,
        ends=(_physical(target, below.end), _physical(target, above.end)),
        quadratic=quadratic,
        shape=_shape(below, above, rises, threshold),
        log=target.log,
        notes=tuple(notes),
    )


def _physical(target: Target, end: float | None) -> float | None:
    return None if end is None else target.physical(end)


def _shape(below: Side, above: Side, rises: np.ndarray, threshold: float) -> str:
    falls = [
        -np.diff(side).min(initial=0.0) for side in (rises[: len(below.trail)][::-1], rises[len(below.trail) - 1 :])
    ]
    if below.other or above.other or max(falls) > _DIP * threshold:
        return "multimodal"
    return ("flat", "one-sided", "bounded")[(below.end is not None) + (above.end is not None)]
