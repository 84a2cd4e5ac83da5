"""Greatest values: of the continuous curve where a run knows them, else between samples.

The derivative of a greatest value is the derivative at a fixed time, at the summit (envelope theorem; Danskin 1966). At the
highest sample it is another one: there the force's rate times the shift of the whole curve is added, which in an impact is a
hundred times as much. Between samples the summit is that of the polynomial through the five samples about the highest.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike

from bcfj_jax.core.dual import Dual, backend, either, still

# A sample that is higher than the summit by this share is of another one.
_HIGHER = 1e-3
# How far a crest may rise above its greatest sample, over the spread of its five: a parabola's rises by up to 1/24, a jump
# makes a polynomial that rises further.
_RISE = 0.06
# How far from the highest sample a summit may be, over the time between its neighbours.
_REACH = 0.6


class Curve(NamedTuple):
    """What a run knows of the continuous force of a channel (``derivatives.trains.of_curve``)."""

    # peak, least: greatest and least force [N]; impulse [N s]; work [J]. NaN where it is known from samples alone.
    peak: Any
    impulse: Any
    work: Any
    least: Any


UNKNOWN = Curve(*[np.nan] * 4)


def top(curve: Curve) -> Any:
    """Greatest size of a force that has two signs."""
    xp, peak, least = backend(*curve), still(curve.peak), still(curve.least)
    lower = -least > xp.where(peak > 0, peak, 0.0)
    return either(lower, lambda: -curve.least, lambda: curve.peak)


def summit(highest: Any, curve: Curve, size: bool = False) -> Any:
    """Summit of the continuous force, or of its ``size``; NaN where it is not known: none whose greatest sample is higher."""
    found = top(curve) if size else curve.peak
    return either(still(highest) <= (1.0 + _HIGHER) * still(found), lambda: found, lambda: np.nan)


def greatest(times: np.ndarray, values: Any, curve: Curve = UNKNOWN, size: bool = False) -> Any:
    """Greatest value of (T,) samples, between them, too; of the ``curve`` where that is known.

    ``size``: of a force of either sign, its greatest size.
    """
    values = backend(values).abs(values) if size else values
    found = summit(backend(values).max(still(values)), curve, size)
    return either(~backend(found).isnan(still(found)), lambda: found, lambda: crest(times, values))


def error(times: np.ndarray, values: Dual, curve: Curve = UNKNOWN, size: bool = False) -> np.ndarray:
    """How far the derivatives (P,) of ``greatest`` may be off, since it lies between samples; NaN where that is not known."""
    values = np.abs(values) if size else values
    known = not np.isnan(still(summit(np.max(values.value), curve, size)))
    if known or not (np.isfinite(values.value).all() and np.isfinite(values.slope).all()):
        return np.full(len(values.slope), 0.0 if known else np.nan)
    return crest_with_error(times, values.value, values.slope)[2]


def crest(times: ArrayLike, values: Any) -> Any:
    """Greatest value of a curve through samples (T,), or the greatest of several (T, k), at increasing times (T,).

    That of the polynomial through the five samples about the highest; the highest itself where it is the first or last, or
    the polynomial has no summit near it.
    """
    xp, t = backend(values), np.asarray(times)
    if values.ndim > 1:
        values = xp.take(values, xp.argmax(xp.max(still(values), axis=0)), axis=1)
    top = xp.argmax(still(values))
    if len(t) < 5:
        return values[top]
    near = xp.clip(top - 2, 0, len(t) - 5) + np.arange(5)
    high, _, good = _summit(t, values, near, top)
    spread = still(values)[near]
    good = good & (still(high) - still(values)[top] <= _RISE * (spread.max() - spread.min()))
    return either(good & (top > 0) & (top < len(t) - 1), lambda: high, lambda: values[top])


def crest_with_error(times: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """``crest`` of (T,) samples, its derivatives (P,) from the samples' (P, T), and how far these may be off.

    The error is taken to be twice the difference to the polynomial through the four samples that are nearest to the summit.
    Where there is no summit within the five samples, the number is the greatest sample: at an end of the samples its derivative
    is right, elsewhere its error is taken to be its difference to the neighbours'.
    """
    both, top, last = Dual(values, slopes), int(np.argmax(values)), len(times) - 1
    found, none = crest(times, both), np.zeros(len(slopes))
    if not 0 < top < last:
        return float(found.value), found.slope, none
    near = np.clip(top - 2, 0, max(last - 4, 0)) + np.arange(min(5, last + 1))
    high, place, _ = _summit(times, both, near, top)
    if last < 4 or float(high.value) != float(found.value):
        off = np.abs(slopes[:, [top - 1, top + 1]] - slopes[:, [top]]).max(1, initial=0)
        return float(found.value), found.slope, off
    nodes = (times[near] - times[top]) / (times[top + 1] - times[top - 1])
    four = near[np.sort(np.argsort(np.abs(nodes - place), kind="stable")[:4])]
    coarse, _, good = _summit(times, both, four, top)
    # Where there is no force at all the polynomial is not the curve.
    known = bool(good) and not np.any(values[near] == 0.0)
    return float(found.value), found.slope, 2.0 * np.abs(coarse.slope - found.slope) if known else none + np.inf


def _summit(times: np.ndarray, values: Any, near: Any, top: Any) -> tuple[Any, Any, Any]:
    """Height and place of the maximum near ``top`` of the polynomial through the samples ``near``, and whether it has one.

    The place counts in times between the highest sample's neighbours. Newton's method finds it, and one more step of it that
    is differentiated carries ds/dF = -(dp'/dF)/p''.
    """
    xp = backend(values, top)
    middle, count = xp.clip(top, 1, len(times) - 2), len(near)
    t = xp.asarray(times)
    nodes = (t[near] - t[top]) / (t[middle + 1] - t[middle - 1])
    base = still(values[top])
    c = xp.linalg.inv(nodes[:, None] ** np.arange(count)) @ (values[near] - base)

    def terms(c: Any, s: Any) -> tuple[Any, Any, Any]:
        """The polynomial and its two derivatives at s."""
        value, first, second = c[count - 1], 0.0, 0.0
        for k in range(count - 2, -1, -1):
            value, first, second = c[k] + s * value, value + s * first, 2.0 * first + s * second
        return value, first, second

    fixed, place, good = still(c), xp.zeros(()), True
    for _ in range(8):
        _, rise, bend = terms(fixed, place)
        good = good & (bend < 0.0)
        place = still(xp.clip(place - rise / xp.where(bend < 0.0, bend, -np.inf), -_REACH, _REACH))
    bend = terms(fixed, place)[2]
    good = good & (xp.abs(place) < _REACH) & (bend < 0.0)
    moved = place - terms(c, place)[1] / xp.where(good, bend, -np.inf)
    return terms(c, moved)[0] + base, place, good
