"""Profile likelihood: how far one parameter may move, all others following, before the data object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from bcfj_jax.xla.threads import each
from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.optimum import Optimum
from calibration.search.descent import Evaluate
from calibration.search.evaluate import evaluator
from calibration.search.refinement import trust_region
from calibration.solver_budget import budget
from calibration.uncertainty.estimates import moving

# A fall of the cost, on the way outwards, by this share of the threshold is a second minimum.
_DIP = 0.05
# Points a side before the threshold, where the cost is quadratic, and the most that are tried.
_POINTS, _MOST_POINTS = 4, 60
# Evaluations of a constrained optimum, and of a look for another region; where the first ends.
_TRIES, _SCOUT_TRIES, _PRECISE = 40, 6, 1e-9
# The longest step; the furthest that extrapolation along a profile may carry another coordinate.
_LONGEST, _LEAP = 1.0 / 8.0, 0.2
# A cost lower than the best by this share of the threshold is another optimum, not the integrator's error.
_BETTER = 0.01


class Target(NamedTuple):
    """What a profile holds: a coordinate u of the unit box, whose parameter is lower + width u, or the exponential of that."""

    name: str
    index: int
    lower: float = 0.0
    width: float = 1.0
    log: bool = False

    def physical(self, u: float) -> float:
        """The parameter's value, SI."""
        z = float(self.lower + self.width * u)
        return float(np.exp(z)) if self.log else z


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


def of_optimum(at: Optimum, only: Sequence[str] | None = None) -> dict[str, Profile]:
    """Profiles of a problem's parameters around its optimum, by label; ``only``: of these, by default of all.

    With a reference force, "reference_force" is its profile, and "stiffness" that of the force at a depth of 1 m.
    """
    model, how = at.model, moving(at)
    every = [(name, k, model) for k, name in enumerate(at.labels)]
    if model.referenced:
        k = model.pair()[0]
        every[k : k + 1] = [(at.labels[k], k, model.at_depth(0.0)), ("reference_force", k, model)]
    slopes = {**dict(zip(how.names, how.slopes, strict=True)), "reference_force": how.slopes[-1]}
    asked = []
    for name, k, one in every:
        if only is None or name in only:
            lower, width = (x[k] for x in one.box)
            target = Target(name, k, lower, width, one.coordinates[k].log)
            place = np.asarray(at.end.point, float) if one is model else one.point(model.values(at.end.point))
            asked.append(Asked(target, rise_allowed(at.spread, slopes[name]), evaluator(one), place))
    return {p.name: p for p in profiles(asked, labels=at.labels, at_once=budget(model).apart)}


def rise_allowed(quality: Spread, slope: np.ndarray) -> float:
    """Rise of the cost that bounds the 95 % interval of a combination of coordinates (P,).

    The square of the covariance interval's quantile: chi-square of 1 degree of freedom for stated noise, F(1, freedom)
    for estimated, whose deviation the weights know; a robust loss multiplies it.
    """
    quantile = quality.quantile if quality.covariance is None else quality.quantile_of(slope)
    return quantile**2 * quality.rise


class Asked(NamedTuple):
    """What to profile: the rise of the sum of squares that bounds its interval; residuals of points of the unit box (B, P), NaN
    where a simulation fails; and the optimum (P,).
    """

    target: Target
    threshold: float
    residuals: Evaluate
    place: np.ndarray


def profiles(
    asked: Sequence[Asked], *, labels: Sequence[str], at_once: bool = False, scouts: int = 3
) -> tuple[Profile, ...]:
    """Profile likelihood of every target around an optimum; ``at_once``: as many as there are cores.

    ``scouts``: looks beyond an interval's end, evenly up to the range's, for another region as good.
    """

    def both(one: Asked) -> Profile:
        below, above = (_Walk(one, scouts).outwards(one.place, sign) for sign in (-1.0, 1.0))
        return _profile(one.target, below, above, one.threshold, labels)

    return tuple((each if at_once else map)(both, asked))


class _Point(NamedTuple):
    """A constrained optimum: c, unit-box coordinates, cost, and half the cost's slope along the profile."""

    c: float
    place: np.ndarray
    cost: float
    slope: float


class _Side(NamedTuple):
    """One side of a profile: points from the best outwards, c at the threshold or why there is none, whether another region
    is as good or better, and the slope of the root of the rise at the best.
    """

    trail: list[_Point]
    end: float | None
    slope: float
    why: str = ""
    other: bool = False

    def at(self, target: Target) -> float | None:
        """The parameter's value at its end."""
        return None if self.end is None else target.physical(self.end)


class _Lost(ArithmeticError):
    """No constrained optimum is found."""


class _Walk:
    """Along constrained optima: one quantity held, all other coordinates following, until the cost has risen."""

    def __init__(self, asked: Asked, scouts: int) -> None:
        self.target, self.threshold, self.residuals, _ = asked
        self.scouts = scouts

    def outwards(self, place: np.ndarray, sign: float) -> _Side:
        """From the optimum to the threshold or the end of the range."""
        target, goal, limit = self.target, np.sqrt(self.threshold), float(sign > 0)
        residuals, jacobian = (a[0] for a in self.residuals(place[None]))
        if not np.isfinite(residuals).all():
            raise ValueError("the simulation fails at the optimum itself")
        # The root of the rise is linear in c where the cost is quadratic, and its first slope follows from the Jacobian.
        others, held = np.delete(jacobian, target.index, axis=1), jacobian[:, target.index]
        first = float(np.linalg.norm(held - others @ np.linalg.lstsq(others, held)[0]))
        best = _Point(place[target.index], place, float(residuals @ residuals), 0.0)
        step = least = min(goal / _POINTS / first, _LONGEST) if first > 0 else _LONGEST
        trail = [best]
        while len(trail) < _MOST_POINTS:
            at = trail[-1]
            if sign * (limit - at.c) <= 0:
                return _Side(trail, None, first, "it reaches its bound")
            c = at.c + sign * step if step < sign * (limit - at.c) else limit
            found = self._relaxed(c, _ahead(trail, c))
            if found is None:
                step /= 4
                if step < 1e-3 * least:
                    return self._lost(trail, first)
                continue
            if found.cost < best.cost - _BETTER * self.threshold:
                why = f"a better optimum lies near {target.physical(c):.4g}"
                return _Side([*trail, found], None, first, why, True)
            root = _root(found, best)
            if root >= goal * (1 - 1e-9):
                return self._ended(trail, found, limit, first)
            slope = sign * found.slope / max(root, 1e-12)
            wanted = min(goal / _POINTS, goal - root) / slope if slope > 0 else np.inf
            trail.append(found)
            step = float(np.clip(wanted, step / 4, min(3 * step, _LONGEST)))
        return _Side(trail, None, first, f"it is not bounded after {_MOST_POINTS} steps")

    def _ended(self, trail: list[_Point], outside: _Point, limit: float, first: float) -> _Side:
        """The side whose threshold lies between the last point of its trail and one outside, and what lies beyond."""
        inside, best, goal = trail[-1], trail[0], float(np.sqrt(self.threshold))
        known: dict[float, Any] = {inside.c: inside, outside.c: outside}

        def beyond(c: float) -> float:
            if c not in known:
                near = min(known.values(), key=lambda p: abs(p.c - c))
                known[c] = self._relaxed(c, near.place)
                if known[c] is None:
                    raise _Lost
            return _root(known[c], best) - goal

        try:
            precise = 1e-7 * abs(outside.c - inside.c)
            end = float(brentq(beyond, inside.c, outside.c, xtol=precise)) if beyond(outside.c) > 0.0 else outside.c  # pyright: ignore[reportArgumentType]
        except _Lost:
            return self._lost(trail, first)
        pinned = min(known.values(), key=lambda p: abs(p.c - end))
        place = pinned.place
        for c in np.linspace(pinned.c, limit, self.scouts + 1)[1:]:
            found = self._relaxed(float(c), place, _SCOUT_TRIES)
            place = found.place if found else place
            if found and found.cost < best.cost + self.threshold:
                why = f"the data fit as well near {self.target.physical(float(c)):.4g}"
                return _Side([*trail, pinned], None, first, why, True)
        return _Side([*trail, pinned], end, first)

    def _lost(self, trail: list[_Point], first: float) -> _Side:
        where = self.target.physical(trail[-1].c)
        return _Side(trail, None, first, f"no simulation succeeds, or no optimum is found, beyond {where:.4g}")

    def _relaxed(self, c: float, place: np.ndarray, tries: int = _TRIES) -> _Point | None:
        """The least squares over the other coordinates; None where nothing simulates, or none is found in all tries."""
        index, held = self.target.index, dict[bytes, np.ndarray]()

        def evaluate(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            residuals, jacobian = (a[0] for a in self.residuals(np.insert(rest, index, c)[None]))
            held[rest.tobytes()] = jacobian[:, index]
            return residuals, np.delete(jacobian, index, axis=1)

        precise = dict.fromkeys(("xtol", "ftol", "gtol"), _PRECISE)
        begin = np.clip(np.delete(place, index), 0.0, 1.0)
        found = trust_region(evaluate, begin, method="dogbox", max_nfev=tries, **precise)
        if found.failed or not (found.converged or tries == _SCOUT_TRIES):
            return None
        slope = float(found.residuals @ held[found.point.tobytes()])
        return _Point(c, np.insert(found.point, index, c), float(found.residuals @ found.residuals), slope)


def _root(at: _Point, best: _Point) -> float:
    return float(np.sqrt(max(at.cost - best.cost, 0.0)))


def _ahead(trail: list[_Point], c: float) -> np.ndarray:
    """Where the other coordinates go on the line through the last two points."""
    at, before = trail[-1], trail[max(len(trail) - 2, 0)]
    move = (at.place - before.place) * (c - at.c) / (at.c - before.c or 1.0)
    return np.clip(at.place + move * min(1.0, _LEAP / max(np.abs(move).max(), _LEAP)), 0.0, 1.0)


def _profile(target: Target, below: _Side, above: _Side, threshold: float, labels: Sequence[str]) -> Profile:
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
        ends=(below.at(target), above.at(target)),
        quadratic=quadratic,
        shape=_shape(below, above, rises, threshold),
        log=target.log,
        notes=tuple(notes),
    )


def _shape(below: _Side, above: _Side, rises: np.ndarray, threshold: float) -> str:
    falls = [
        -np.diff(side).min(initial=0.0) for side in (rises[: len(below.trail)][::-1], rises[len(below.trail) - 1 :])
    ]
    if below.other or above.other or max(falls) > _DIP * threshold:
        return "multimodal"
    return ("flat", "one-sided", "bounded")[(below.end is not None) + (above.end is not None)]
