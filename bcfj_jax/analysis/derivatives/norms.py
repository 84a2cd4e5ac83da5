"""How far two derivatives are apart, in the norms a user will use, and how tangents grow. NumPy.

A derivative here is (P, T, M): parameters, times, channels and components together. Norms are L2 over time and M,

    ||D||^2 = sum_i w_i sum_m D_im^2,      w_i the trapezoidal weight of sample i.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

CHAOTIC_GROWTH = 1e6
_WINDOWS = 20
# Per 100 % of a parameter, in units of the states' natural sizes; a metre of travel has some 1e5 of them.
_ROUNDING = 1e-9


def weights(times: np.ndarray) -> np.ndarray:
    """Trapezoidal weights (T,) [s]; one sample alone weighs 1."""
    if len(times) < 2:
        return np.ones(len(times))
    gaps = np.diff(times)
    return 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps))


def averaged(times: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    """Moving average (..., T, M) over [t - width/2, t + width/2], cut at the ends, linear between samples."""
    if len(times) < 2 or width <= 0.0:
        return values
    gaps = np.diff(times)[:, None]
    pieces = 0.5 * gaps * (values[..., 1:, :] + values[..., :-1, :])
    total = np.concatenate([np.zeros_like(values[..., :1, :]), np.cumsum(pieces, axis=-2)], axis=-2)
    low = np.clip(times - 0.5 * width, times[0], times[-1])
    high = np.clip(times + 0.5 * width, times[0], times[-1])

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
    """How far ``found`` (T, M) is from ``other``, relative to the larger of the two.

    Args:
        times, found, other: of one parameter.
        floor: in N per unit; the running ratio's denominator is at least this times sqrt(horizon), so that what is
            nearly nothing at the start breaks nothing down.
        limit: the running ratio above which the derivative has broken down, if it stays above to the end.
    """
    w = weights(times)
    # Not Python's max, which loses a NaN that comes second.
    size = float(np.max([np.max(np.abs(x), initial=0.0) for x in (found, other)]))
    if not np.isfinite(size):
        bad = ~(np.isfinite(found) & np.isfinite(other)).all(axis=-1)
        first = float(times[int(np.argmax(bad))])
        return Difference(float("inf"), first, first)
    if size == 0.0:
        return Difference(0.0, float("nan"), float("nan"))
    a, b = found / size, other / size
    wrong = np.cumsum(w * np.sum((a - b) ** 2, axis=-1))
    right = np.maximum(np.cumsum(w * np.sum(a * a, axis=-1)), np.cumsum(w * np.sum(b * b, axis=-1)))
    relative = float(np.sqrt(wrong[-1] / right[-1]))
    if wrong[-1] == 0.0:
        return Difference(0.0, float("nan"), float("nan"))
    least = min(1e-6 * right[-1], (floor / size) ** 2 * w.sum())
    running = np.sqrt(wrong / np.maximum(right, max(least, 1e-300)))
    where = float(times[int(np.searchsorted(wrong, 0.5 * wrong[-1]))])
    if running[-1] <= limit:
        return Difference(relative, where, float("nan"))
    good = np.flatnonzero(running <= limit)
    return Difference(relative, where, float(times[good[-1] + 1 if good.size else 0]))


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
        return Growth(float("inf"), float("nan"))
    if len(times) < 4:
        return Growth(1.0, float("nan"))
    parts = np.array_split(np.arange(len(times)), min(_WINDOWS, len(times)))
    peaks = np.array([size[part].max() for part in parts])
    middle = np.array([times[part].mean() for part in parts])
    alive = np.flatnonzero(peaks > _ROUNDING)
    alive = alive[max(1, len(alive) // 10) :]
    if alive.size < 3:
        return Growth(1.0, float("nan"))
    logs = np.log(peaks[alive])
    slope = float(np.polyfit(middle[alive], logs, 1)[0])
    return Growth(float(np.exp(min(logs[-3:].max() - logs[0], 700.0))), slope)
