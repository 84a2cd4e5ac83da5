"""Profile likelihood: how far one parameter may move, all others following, before the data object."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from bcfj_jax.xla.threads import each
from calibration.diagnostics.optimum import Optimum
from calibration.search.descent import Evaluate
from calibration.search.evaluate import evaluator
from calibration.search.refinement import trust_region
from calibration.solver_budget import budget
from calibration.uncertainty.estimates import least_of, moving

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


class Asked(NamedTuple):
    """What to profile: a coordinate u of the unit box, whose parameter is lower + width u, or the exponential of that."""

    name: str
    index: int
    threshold: float  # rise of the sum of squares that bounds its interval
    residuals: Evaluate  # and Jacobians of points of the unit box (B, P), NaN where a simulation fails
    place: np.ndarray  # (P,) the optimum
    lower: float = 0.0
    width: float = 1.0
    log: bool = False
    ends: bool = False  # whether its quantity ends at the lower bound by nature, as an exponent at 1

    def physical(self, u: float) -> float:
        """The parameter's value, SI."""
        z = float(self.lower + self.width * u)
        return float(np.exp(z)) if self.log else z


@dataclass(frozen=True)
class Profile:
    """How the smallest cost depends on one parameter."""

    name: str
    values: np.ndarray  # (K,) of the parameter, SI, increasing
    rises: np.ndarray  # (K,) cost above the best [weighted squares]
    best: float  # the estimate, SI
    threshold: float  # the rise that bounds the 95 % interval
    # Where the threshold is met below and above the estimate; None where it is not.
    ends: tuple[float | None, float | None]
    quadratic: tuple[float, float]  # where the covariance puts those ends
    shape: str  # "bounded", "one-sided", "flat" or "multimodal"
    log: bool
    notes: tuple[str, ...]  # in words, why an end is missing, and bounds of other parameters that an end rests on

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
            place = np.asarray(at.end.point, float) if one is model else one.point(model.values(at.end.point))
            scale = lower, width, one.coordinates[k].log, bool(least_of(one)[k] >= lower)
            asked.append(Asked(name, k, at.spread.rise_allowed(slopes[name]), evaluator(one), place, *scale))
    return {p.name: p for p in profiles(asked, labels=at.labels, at_once=budget(model).apart)}


def profiles(
    asked: Sequence[Asked], *, labels: Sequence[str], at_once: bool = False, scouts: int = 3
) -> tuple[Profile, ...]:
    """Profile likelihood of everything that is asked for; ``at_once``: as many as there are cores.

    ``scouts``: looks beyond an interval's end, evenly up to the range's, for another region as good.
    """

    def both(one: Asked) -> Profile:
        best, slope = _best(one)
        return _profile(one, slope, [_side(one, best, slope, scouts, sign) for sign in (-1.0, 1.0)], labels)

    return tuple((each if at_once else map)(both, asked))


class _Point(NamedTuple):
    """A constrained optimum: c, unit-box coordinates, cost, and the root of its rise above the best."""

    c: float
    place: np.ndarray
    cost: float
    root: float = 0.0


class _Side(NamedTuple):
    """One side of a profile: points from the best outwards, c at the threshold or why there is none, and whether another region
    is as good or better.
    """

    trail: list[_Point]
    end: float | None
    why: str = ""
    other: bool = False


class _Lost(ArithmeticError):
    """No constrained optimum is found."""


def _best(one: Asked) -> tuple[_Point, float]:
    """The optimum, and the slope there of the root of the rise, which is linear in c where the cost is quadratic."""
    residuals, jacobian = (a[0] for a in one.residuals(one.place[None]))
    if not np.isfinite(residuals).all():
        raise ValueError("the simulation fails at the optimum itself")
    others, held = np.delete(jacobian, one.index, axis=1), jacobian[:, one.index]
    slope = float(np.linalg.norm(held - others @ np.linalg.lstsq(others, held)[0]))
    return _Point(one.place[one.index], one.place, float(residuals @ residuals)), slope


def _side(one: Asked, best: _Point, slope: float, scouts: int, sign: float) -> _Side:
    """Along constrained optima from the best to the threshold or the end of the range."""
    goal, limit = float(np.sqrt(one.threshold)), float(sign > 0)
    step = least = min(goal / _POINTS / slope, _LONGEST) if slope > 0 else _LONGEST
    trail = [best]
    while len(trail) < _MOST_POINTS:
        at = trail[-1]
        if sign * (limit - at.c) <= 0:
            return _Side(trail, at.c) if one.ends and sign < 0 else _Side(trail, None, "it reaches its bound")
        c = at.c + sign * step if step < sign * (limit - at.c) else limit
        try:
            found = _relaxed(one, best, c, _ahead(trail, c))
        except _Lost:
            step /= 4
            if step < 1e-3 * least:
                return _lost(one, trail)
            continue
        if found.cost < best.cost - _BETTER * one.threshold:
            return _Side([*trail, found], None, f"a better optimum lies near {one.physical(c):.4g}", True)
        if found.root >= goal * (1 - 1e-9):
            return _ended(one, trail, found, scouts, limit)
        trail.append(found)
        rise = (found.root - at.root) / abs(c - at.c)
        wanted = min(goal / _POINTS, goal - found.root) / rise if rise > 0 else np.inf
        step = float(np.clip(wanted, step / 4, min(3 * step, _LONGEST)))
    return _Side(trail, None, f"it is not bounded after {_MOST_POINTS} steps")


def _ended(one: Asked, trail: list[_Point], outside: _Point, scouts: int, limit: float) -> _Side:
    """The side whose threshold lies between the last point of its trail and one outside, and what lies beyond."""
    best, known = trail[0], {p.c: p for p in (trail[-1], outside)}

    def beyond(c: float) -> float:
        if c not in known:
            known[c] = _relaxed(one, best, c, min(known.values(), key=lambda p: abs(p.c - c)).place)
        return known[c].root - float(np.sqrt(one.threshold))

    try:
        precise, inside = 1e-7 * abs(outside.c - trail[-1].c), trail[-1].c
        end = float(brentq(beyond, inside, outside.c, xtol=precise)) if beyond(outside.c) > 0.0 else outside.c  # pyright: ignore[reportArgumentType]
    except _Lost:
        return _lost(one, trail)
    pinned = found = min(known.values(), key=lambda p: abs(p.c - end))
    for c in np.linspace(pinned.c, limit, scouts + 1)[1:].tolist():
        with suppress(_Lost):
            found = _relaxed(one, best, c, found.place, _SCOUT_TRIES)
            if found.cost < best.cost + one.threshold:
                return _Side([*trail, pinned], None, f"the data fit as well near {one.physical(c):.4g}", True)
    return _Side([*trail, pinned], end)


def _lost(one: Asked, trail: list[_Point]) -> _Side:
    where = f"{one.physical(trail[-1].c):.4g}"
    return _Side(trail, None, f"no simulation succeeds, or no optimum is found, beyond {where}")


def _relaxed(one: Asked, best: _Point, c: float, place: np.ndarray, tries: int = _TRIES) -> _Point:
    """The least squares over the other coordinates.

    Raises:
        _Lost: where nothing simulates, or none is found in all tries.
    """

    def evaluate(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals, jacobian = (a[0] for a in one.residuals(np.insert(rest, one.index, c)[None]))
        return residuals, np.delete(jacobian, one.index, axis=1)

    precise = dict.fromkeys(("xtol", "ftol", "gtol"), _PRECISE)
    begin = np.clip(np.delete(place, one.index), 0.0, 1.0)
    found = trust_region(evaluate, begin, method="dogbox", max_nfev=tries, **precise)
    if found.failed or not (found.converged or tries == _SCOUT_TRIES):
        raise _Lost
    cost = float(found.residuals @ found.residuals)
    return _Point(c, np.insert(found.point, one.index, c), cost, float(np.sqrt(max(cost - best.cost, 0.0))))


def _ahead(trail: list[_Point], c: float) -> np.ndarray:
    """Where the other coordinates go on the line through the last two points."""
    at, before = trail[-1], trail[max(len(trail) - 2, 0)]
    move = (at.place - before.place) * (c - at.c) / (at.c - before.c or 1.0)
    return np.clip(at.place + move * min(1.0, _LEAP / max(np.abs(move).max(), _LEAP)), 0.0, 1.0)


def _profile(one: Asked, slope: float, sides: Sequence[_Side], labels: Sequence[str]) -> Profile:
    """Both sides as one curve, its shape in a word, and what there is to say of its ends."""
    below, above = sides
    trail, best = [*below.trail[:0:-1], *above.trail], above.trail[0]
    rises = np.array([p.cost for p in trail]) - best.cost
    with np.errstate(divide="ignore", over="ignore"):
        half = np.sqrt(one.threshold) / np.float64(slope)
        quadratic = (one.physical(best.c - half), one.physical(best.c + half))
    notes = [f"{where} {one.name}: {s.why}" for where, s in zip(("below", "above"), sides, strict=True) if s.why]
    for where, side in zip(("lower", "upper"), sides, strict=True):
        place = side.trail[-1].place
        resting = [n for i, (n, u) in enumerate(zip(labels, place, strict=True)) if not 0 < u < 1 and i != one.index]
        if side.end is not None and resting:
            notes.append(f"the {where} end of {one.name} rests on the bound of {' and '.join(resting)}")
    low, high = (None if side.end is None else one.physical(side.end) for side in sides)
    values = np.array([one.physical(p.c) for p in trail])
    return Profile(
        one.name, values, rises, one.physical(best.c), one.threshold, (low, high), quadratic,
        _shape(below, above, rises, one.threshold), one.log, tuple(notes),
    )  # fmt: skip


def _shape(below: _Side, above: _Side, rises: np.ndarray, threshold: float) -> str:
    sides = rises[: len(below.trail)][::-1], rises[len(below.trail) - 1 :]
    falls = [-np.diff(side).min(initial=0.0) for side in sides]
    if below.other or above.other or max(falls) > _DIP * threshold:
        return "multimodal"
    return ("flat", "one-sided", "bounded")[(below.end is not None) + (above.end is not None)]
