"""Walks along a constrained optimum: one quantity held, all other coordinates following, until the cost has risen.

A walk is a generator that asks for residuals at one point at a time, so all walks go on together in one compiled
batch and none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import NamedTuple, TypeVar

import numpy as np

# Residuals (B, N) and Jacobians (B, N, P) at unit-box points (B, P).
Residuals = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

# Points a side before the threshold, where the cost is quadratic.
_POINTS = 4
# A cost is at its constrained optimum when it can fall by less than this share of the threshold. A step that gains
# nothing ends the solve too once it promises less than the second, for there the integrator's own error rules.
_CONVERGED, _STALLED = 1e-6, 2e-3
_TRIES, _SCOUT_TRIES, _MOST_POINTS = 40, 6, 60
# The furthest that extrapolation along a profile may carry another coordinate.
_LEAP = 0.2
# A cost lower than the best by this share of the threshold is another optimum, not the integrator's error.
_BETTER = 0.01


class Target(NamedTuple):
    """What a profile holds fixed: c = u[index] - shift(u), where ``shift`` does not depend on u[index].

    Attributes:
        low, high: ends of the range of c.
        shift: from a unit-box point to the shift and its slope (P,).
        physical: from c to the parameter's value, SI.
    """

    name: str
    index: int
    low: float
    high: float
    shift: Callable[[np.ndarray], tuple[float, np.ndarray]]
    physical: Callable[[float], float]
    log: bool


class Point(NamedTuple):
    """A constrained point: c, unit-box coordinates, cost, residuals (N,), Jacobian (N, P)."""

    c: float
    place: np.ndarray
    cost: float
    residuals: np.ndarray
    jacobian: np.ndarray


class Side(NamedTuple):
    """One walk.

    Attributes:
        trail: its points, from the best outwards.
        end: c at the threshold; None: it was not met, or not only once.
        why: there is no end, in words; "" if there is.
        other: whether that is because of another region that is as good or better.
        slope: of the root of the rise at the best, by the Jacobian there.
    """

    trail: list[Point]
    end: float | None
    slope: float
    why: str = ""
    other: bool = False


T = TypeVar("T")
# Asks for residuals (N,) and Jacobian (N, P) at a point (P,), and ends with a T.
Asks = Generator[np.ndarray, tuple[np.ndarray, np.ndarray], T]


def together(walks: list[Asks[Side]], residuals: Residuals, batch: int) -> list[Side]:
    """Step all walks; every call has the same number of points, so that a compiled function serves them all."""
    asked = {k: next(walk) for k, walk in enumerate(walks)}
    sides: dict[int, Side] = {}
    while asked:
        todo = list(asked)
        for first in range(0, len(todo), batch):
            block = todo[first : first + batch]
            points = np.stack([asked[k] for k in block] + [asked[block[0]]] * (batch - len(block)))
            found, jacobians = residuals(points)
            for k, r, jacobian in zip(block, found, jacobians, strict=False):
                try:
                    asked[k] = walks[k].send((r, jacobian))
                except StopIteration as stop:
                    sides[k] = stop.value
        asked = {k: point for k, point in asked.items() if k not in sides}
    return [sides[k] for k in range(len(walks))]


def walk(target: Target, sign: float, place: np.ndarray, threshold: float, scouts: int) -> Asks[Side]:
    """From the optimum outwards to the threshold or the end of the range.

    Raises:
        ValueError: if the residuals are not finite at the optimum itself.
    """
    limit = target.high if sign > 0 else target.low
    goal, reach = np.sqrt(threshold), target.high - target.low
    best = yield from _look(target, place[target.index] - target.shift(place)[0], place)
    if best is None:
        raise ValueError("the simulation fails at the optimum itself")
    # The root of the rise is linear in c where the cost is quadratic, and its first slope follows from the Jacobian.
    tangent, held = _tangent(target, best), best.jacobian[:, target.index]
    first = float(np.linalg.norm(held + tangent @ np.linalg.lstsq(tangent, -held)[0]))
    step = least = min(goal / _POINTS / first, reach / 8) if first > 0 else reach / 8
    trail, at = [best], best
    while len(trail) < _MOST_POINTS:
        if sign * (limit - at.c) <= 0:
            return Side(trail, None, first, "it reaches its bound")
        c = at.c + sign * step if step < sign * (limit - at.c) else limit
        found, settled = yield from _relax(target, c, _warm(target, at, c), threshold, _TRIES)
        if found is not None and found.cost < best.cost - _BETTER * threshold:
            return Side([*trail, found], None, first, f"a better optimum lies near {target.physical(c):.4g}", True)
        if found is None or not settled:
            step /= 4
            if step < 1e-3 * least:
                return Side(trail, None, first, _lost(target, at))
            continue
        root = _root(found, best)
        if root >= goal * (1 - 1e-9):
            pinned, end = yield from _pin(target, at, found, best, threshold)
            if end is None:
                return Side(trail, None, first, _lost(target, at))
            trail.append(pinned)
            other = yield from _scout(target, found, limit, best.cost + threshold, threshold, scouts)
            if other is not None:
                return Side(trail, None, first, f"the data fit as well near {target.physical(other):.4g}", True)
            return Side(trail, end, first)
        slope = sign * float(found.residuals @ found.jacobian[:, target.index]) / max(root, 1e-12)
        wanted = min(goal / _POINTS, goal - root) / slope if slope > 0 else np.inf
        trail.append(found)
        at, step = found, float(np.clip(wanted, step / 4, min(3 * step, reach / 8)))
    return Side(trail, None, first, f"it is not bounded after {_MOST_POINTS} steps")


def _lost(target: Target, at: Point) -> str:
    return f"no simulation succeeds, or no optimum is found, beyond {target.physical(at.c):.4g}"


def _root(at: Point, best: Point) -> float:
    return float(np.sqrt(max(at.cost - best.cost, 0.0)))


def _pin(
    target: Target, inside: Point, outside: Point, best: Point, threshold: float
) -> Asks[tuple[Point, float | None]]:
    """Newton on the root of the rise between two points: the last point found, and c at the threshold or None."""
    goal, at = np.sqrt(threshold), outside
    for _ in range(_TRIES):
        root = _root(at, best)
        inside, outside = (at, outside) if root < goal else (inside, at)
        # The cost's slope along the profile is its partial derivative: the others are at their optimum.
        slope = float(at.residuals @ at.jacobian[:, target.index]) / max(root, 1e-12)
        newton = at.c + (goal - root) / slope if slope != 0 else np.nan
        if abs(root - goal) < 1e-3 * goal and np.isfinite(newton):
            return at, float(np.clip(newton, target.low, target.high))
        low, high = sorted((inside.c, outside.c))
        c = newton if low < newton < high else 0.5 * (low + high)
        near = min((inside, outside), key=lambda p: abs(p.c - c))
        found, settled = yield from _relax(target, c, _warm(target, near, c), threshold, _TRIES)
        if found is None or not settled:
            break
        at = found
    return at, None


def _scout(target: Target, at: Point, limit: float, ceiling: float, threshold: float, count: int) -> Asks[float | None]:
    """The first of some values beyond an end at which the cost is below the ceiling again; None: nowhere."""
    place = at.place
    for c in np.linspace(at.c, limit, count + 1)[1:]:
        found, _ = yield from _relax(target, c, place, threshold, _SCOUT_TRIES)
        if found is not None:
            place = found.place
            if found.cost < ceiling:
                return float(c)
    return None


def _relax(
    target: Target, c: float, place: np.ndarray, threshold: float, tries: int
) -> Asks[tuple[Point | None, bool]]:
    """Levenberg-Marquardt on the other coordinates inside their box: the point (None: failed), and if it settled."""
    at = yield from _look(target, c, place)
    if at is None:
        return None, False
    damping, sizes = 0.0, np.zeros(place.size)
    for _ in range(tries):
        tangent = _tangent(target, at)
        downhill = tangent.T @ at.residuals
        tangent[:, ((at.place <= 0) & (downhill > 0)) | ((at.place >= 1) & (downhill < 0))] = 0.0
        # As in MINPACK the scale never shrinks: where a column vanishes, its coordinate must not run away.
        sizes = np.maximum(sizes, np.linalg.norm(tangent, axis=0))
        step, promised = _step(tangent, at.residuals, sizes, 0.0)
        if promised < _CONVERGED * threshold:
            return at, True
        bound = promised
        if damping:
            step, promised = _step(tangent, at.residuals, sizes, damping)
        trial = yield from _look(target, c, np.clip(at.place + step, 0.0, 1.0))
        if trial is not None and trial.cost < at.cost:
            gained = at.cost - trial.cost
            at, damping = trial, damping / 10 if damping > 1e-3 else 0.0
            if max(gained, promised) < _CONVERGED * threshold:
                return at, True
        elif bound < _STALLED * threshold:
            return at, True
        else:
            damping = max(10 * damping, 1e-3)
    return at, False


def _step(tangent: np.ndarray, residuals: np.ndarray, sizes: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """Damped Gauss-Newton step (P,), and by how much it would lower the cost of the linearised residuals."""
    matrix, right = tangent, -residuals
    if damping:
        matrix = np.vstack([tangent, np.diag(np.sqrt(damping) * sizes)])
        right = np.concatenate([right, np.zeros(sizes.size)])
    step = np.linalg.lstsq(matrix, right)[0]
    change = tangent @ step
    return step, float(-change @ (2 * residuals + change))


def _look(target: Target, c: float, place: np.ndarray) -> Asks[Point | None]:
    """Residuals at a point whose held coordinate follows from c; None where the simulation fails."""
    place = place.copy()
    place[target.index] = c + target.shift(place)[0]
    residuals, jacobian = yield place
    if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
        return None
    return Point(float(c), place, float(residuals @ residuals), residuals, jacobian)


def _tangent(target: Target, at: Point) -> np.ndarray:
    """Jacobian (N, P) of the other coordinates with c held; the held one's column is 0."""
    tangent = at.jacobian + np.outer(at.jacobian[:, target.index], target.shift(at.place)[1])
    tangent[:, target.index] = 0.0
    return tangent


def _warm(target: Target, at: Point, c: float) -> np.ndarray:
    """Where the others go, to first order, as c moves on."""
    tangent = _tangent(target, at)
    rate = np.linalg.lstsq(tangent, -at.jacobian[:, target.index])[0]
    move = (c - at.c) * rate
    # A coordinate that hardly matters here would be thrown to its bound.
    return np.clip(at.place + move * min(1.0, _LEAP / max(np.abs(move).max(), _LEAP)), 0.0, 1.0)
