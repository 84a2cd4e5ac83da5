"""Histories held against time and against each other: windows, periods, delays, settling.

A history is an array of shape (T,) over times of shape (T,) [s]. ``period`` and ``settling_time`` are
NumPy and give a float; ``delay`` and ``repeated`` are differentiable in the histories (arrays of JAX, or duals).

A window is a pair (start, end) [s], both ends included, None for all times. What takes one needs times that are
known numbers (close over them under ``jit`` or ``vmap``; the force may be traced) and raises ``InputError`` where they
are traced, fewer than two, not finite or do not increase, where a history has another length, and where the window has
no length, leaves the times or holds fewer than two samples. A history with NaN in it gives NaN.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.dual import Dual, backend, either, still, unsloped
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import is_traced, power
from bcfj_jax.core.quantities import increasing

Window = tuple[float, float] | None

# Shares of a correlation's greatest value: above the first a crest equals it, below the second a crest is over.
_EQUAL, _OVER = 0.9, 0.8


def within(times: ArrayLike, window: Window) -> slice:
    """Slice of the samples of a window, to restrict a feature that takes none: ``peak(force[within(...)])``.

    A sample counts as inside up to 1e-9 of the whole span past an end, so that 1.18 holds its own rounding.

    Raises:
        InputError: see the top of the file.
    """
    t = _known(times)
    if window is None:
        return slice(0, t.size)
    start, end, slack = float(window[0]), float(window[1]), 1e-9 * float(t[-1] - t[0])
    if not start < end:
        raise InputError("window", f"{start:g} s to {end:g} s", "give a start before the end")
    if start < t[0] - slack or end > t[-1] + slack:
        raise InputError("window", f"{start:g} s to {end:g} s", f"stay inside the history, {t[0]:g} s to {t[-1]:g} s")
    return slice(int(np.searchsorted(t, start - slack)), int(np.searchsorted(t, end + slack, side="right")))


def samples(times: ArrayLike, window: Window, *values: Any) -> tuple[np.ndarray, list[Any]]:
    """Times and histories of a window, checked: see the top of the file."""
    t = _known(times)
    arrays: list[Any] = [x if isinstance(x, (Array, Dual)) else np.asarray(x, dtype=float) for x in values]
    for x in arrays:
        if x.shape != t.shape:
            raise InputError("history", f"shape {x.shape} over times of shape {t.shape}", "give one sample a time")
    part = within(t, window)
    if part.stop - part.start < 2:
        raise InputError("window", f"{part.stop - part.start} samples", "take a wider window, of at least 2 samples")
    return t[part], [x[part] for x in arrays]


def _known(times: ArrayLike) -> np.ndarray:
    """The times as checked numbers."""
    if is_traced(times):
        raise InputError("times", "traced by JAX", "close over the times instead of passing them through jit or vmap")
    return increasing(times, 2)


def period(times: ArrayLike, values: ArrayLike, window: Window = None) -> float:
    """Time after which a history repeats itself, by autocorrelation [s].

    On N even steps, x less its mean, the normalised square difference at a lag of k steps (McLeod, Wyvill 2005) is

        n(k) = 1 - sum_j (x_j+k - x_j)^2 / sum_j (x_j+k^2 + x_j^2),      j + k < N,      n <= 1,

    and 1 at every period whatever the window's length. Past the first n <= 0 and up to 3/4 of the window, the first
    crest within 10 % of the greatest is the period; its last multiple m with such a crest places it, T = k_m/m, k_m
    between samples from a least-squares quartic. A window of less than about one and a half periods, a constant, and
    what repeats itself by less than half (n < 0.5: noise, one impact, a start-up that outweighs the rest: leave it out
    of the window) have none: NaN. So do lags whose overlap holds less than a quarter of its share of sum x^2. A history
    that nearly repeats itself sooner, with n within 10 % of the greatest, has that for its period.
    ``features.contact_interval`` counts starts of contacts instead.

    Raises:
        InputError: see the top of the file; or fewer than 8 samples in the window.
    """
    t, (x,) = samples(times, window, values)
    if t.size < 8:
        raise InputError("window", f"{t.size} samples", "a period needs 8 or more")
    return _repeat(t, np.asarray(x))


def settled_period(times: ArrayLike, values: Any) -> Any:
    """``period`` of the last two thirds [s]; NaN for 10 samples or fewer there. Of a dual with its slopes, good to about 1 %."""
    t = _known(times)
    late = t >= t[0] + (t[-1] - t[0]) / 3.0
    t, x = t[late], values[late]
    if t.size <= 10:
        return unsloped(math.nan, x)
    found = period(t, still(x))
    if not isinstance(x, Dual) or not math.isfinite(found):
        return unsloped(found, x)
    even, span = np.linspace(t[0], t[-1], t.size), t[-1] - t[0]
    if t.size < 16 or found * (t.size - 1) < 8 * span:
        return unsloped(found, x)
    xp = backend(x)
    moved = repeated(even, xp.interp(even, t, x), found, max(1, int(0.75 * span / found)))
    return Dual(found, moved.slope)


def repeated(times: np.ndarray, values: Any, about: float, many: int = 1) -> Any:
    """Period of a history at even times that is about so long [s], T = (k h + s)/many, differentiable; NaN where too little
    overlaps.

    With s the ``delay`` of the history k steps of h later, about ``many`` periods, against itself. The derivative is good to
    about 1 %: what overlaps holds no whole number of periods.
    """
    step = (times[-1] - times[0]) / (times.size - 1)
    later = max(1, round(many * about / step))
    kept = times.size - later
    if kept < 8:
        return unsloped(math.nan, values)
    early = times[:kept]
    width = min(about, 0.9 * float(early[-1] - early[0]))
    return (times[later] - times[0] + delay(early, values[:kept], values[later:], width)) / many


def delay(times: ArrayLike, first: Any, second: Any, period: float | None = None, window: Window = None) -> Any:
    """Shift of the second history against the first at their best correlation [s]; > 0 where the second comes later.

    argmax over |s| <= period/2 of the correlation coefficient (Pearson) of first(t) and second(t + s) over the times
    that both have, so that neither scale nor offset matters; between samples by a least-squares quartic over the crest.
    Without a period given, that of the first history is taken, or the window where it does not repeat itself.
    NaN where one is constant or nothing correlates.

    Raises:
        InputError: see the top of the file; or a period that is not > 0, shorter than 4 steps or longer than the
            window; or none where the first history is traced.
    """
    t, (a, b) = samples(times, window, first, second)
    if period is None:
        if is_traced(a):
            raise InputError("period", "none, of a history traced by JAX", "give the period")
        cycle = _repeat(t, np.asarray(still(a))) if t.size >= 8 else math.nan
        period = cycle if math.isfinite(cycle) else float(t[-1] - t[0])
    _check_period(t, period)
    even = np.linspace(t[0], t[-1], t.size)
    step = even[1] - even[0]
    most = int(np.floor(0.5 * period / step + 1e-9))
    if most < 2:
        raise InputError("period", f"{period:g} s in steps of {step:g} s", "give one of at least 4 steps")
    xp = backend(a, b)
    place, best = shifts(xp.interp(even, t, a), xp.interp(even, t, b), most)
    limited = xp.clip(step * place, -0.5 * period, 0.5 * period)
    return either(best > 0, lambda: limited, lambda: unsloped(math.nan, limited))


def settling_time(times: ArrayLike, force: ArrayLike, period: float, tolerance: float = 0.05) -> float:
    """Stabilisation: earliest sample from which the force repeats itself one period later, up to the end [s].

    Earliest t_j with |F(t_i + period) - F(t_i)| <= tolerance max|F| for every sample i >= j with t_i + period inside
    the history; max|F| over the last full period, F linear between samples. NaN where fewer than a full period is
    repeated so, t_j > t_end - 2 period: a few last samples that agree by chance are no steady state. Impacts a sample
    long never repeat to a few per cent: sample them finely.

    Raises:
        InputError: see the top of the file; or a tolerance or period not > 0, or a history shorter than two periods.
    """
    t, (f,) = samples(times, None, force)
    f = np.asarray(f)
    if not tolerance > 0:
        raise InputError("tolerance", f"{tolerance:g}", "give a share of the peak above 0")
    _check_period(t, period, 2)
    if not np.isfinite(f).all():
        return float("nan")
    slack = 1e-9 * (t[-1] - t[0])
    early = t + period <= t[-1] + slack
    # Over the last full period.
    peak = np.max(np.abs(f)[t >= t[-1] - period * (1 + 1e-9)])
    apart = np.abs(np.interp(t[early] + period, t, f) - f[early]) > tolerance * peak
    settled = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    return float(t[settled]) if t[settled] <= t[-1] - 2 * period + slack else float("nan")


# --- shared parts


def _check_period(t: np.ndarray, period: float, times: int = 1) -> None:
    """Raise where a period is none, or does not fit into the times."""
    span = float(t[-1] - t[0])
    if not (period > 0 and times * period <= span * (1 + 1e-9)):
        found = f"{period:g} s in a history of {span:g} s"
        raise InputError("period", found, f"give one above 0 and at most {span / times:g} s, or a longer history")


def _repeat(t: np.ndarray, values: np.ndarray) -> float:
    """See ``period``."""
    if not np.isfinite(values).all() or np.ptp(values) <= 1e-12 * np.max(np.abs(values)):
        return float("nan")
    even = np.linspace(t[0], t[-1], t.size)
    x = np.interp(even, t, values)
    x = x - np.mean(x)
    most = 3 * x.size // 4
    energy = np.concatenate([[0.0], np.cumsum(x * x)])
    k = np.arange(most + 1)
    pairs = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * x.size)) ** 2, 2 * x.size)[k]
    size = energy[x.size - k] + energy[-1] - energy[k]
    # What overlaps may be the quiet between two impacts, which repeats itself without saying so.
    varied = size > 0.5 * energy[-1] * (1 - k / x.size)
    n = np.where(varied, 2.0 * pairs / np.where(varied, size, 1.0), 0.0)
    first = int(np.argmax(n <= 0))
    best = float(np.max(n[first:]))
    if first == 0 or best < 0.5:
        return float("nan")
    rise = first + int(np.argmax(n[first:] >= _EQUAL * best))
    falls = np.flatnonzero(n[rise:] < _OVER * best)
    if not falls.size:
        return float("nan")
    top, multiple = rise + int(np.argmax(n[rise : rise + falls[0]])), 1
    base = top
    while True:
        # Where the next multiple's crest is expected, a tenth of a period either way, past this and inside the lags.
        guess, reach = top * (multiple + 1) / multiple, max(2, base // 10)
        low, high = max(round(guess) - reach, top + 1), round(guess) + reach + 1
        if high > n.size or np.max(n[low:high]) < _EQUAL * n[base]:
            break
        top, multiple = low + int(np.argmax(n[low:high])), multiple + 1
    crest = float(_crest(n, top)) if n.size > 4 else math.nan
    if not crest > 0.0:  # Too few samples to have one there.
        return float("nan")
    return float(even[1] - even[0]) * crest / multiple


def shifts(a: Any, b: Any, most: int) -> tuple[Any, Any]:
    """Lag [samples], up to ``most`` either way, of the greatest correlation coefficient, and that of the samples."""
    return (_traced_shift if backend(a, b) is jnp else _best_shift)(a, b, most)


def _best_shift(a: Any, b: Any, most: int) -> tuple[Any, Any]:
    match = correlations(a, b, most)
    top = backend(match).argmax(still(match))
    return _crest(match, top) - most, still(match)[top]


_traced_shift = jax.jit(_best_shift, static_argnums=2)


def correlations(a: Any, b: Any, most: int) -> Any:
    """Pearson's coefficient of a(t) and b(t + k) over the times both have, k = -most .. most; -1 where one is flat."""
    xp = backend(a, b)
    lags = np.arange(-most, most + 1)
    count, from_a, from_b = a.size - np.abs(lags), np.maximum(0, -lags), np.maximum(0, lags)

    def sums(values: Any, start: np.ndarray) -> Any:
        total = xp.concatenate([xp.zeros(1), xp.cumsum(values)])
        return total[start + count] - total[start]

    raw_a, raw_b = (xp.mean(still(x) * still(x)) for x in (a, b))
    a, b = a - xp.mean(a), b - xp.mean(b)
    # A power of 2 is the quickest.
    size = 1 << (2 * a.size - 1).bit_length()
    cross = xp.fft.irfft(xp.conj(xp.fft.rfft(a, size)) * xp.fft.rfft(b, size), size)[lags]
    sum_a, sum_b = sums(a, from_a), sums(b, from_b)
    spread_a, spread_b = sums(a * a, from_a) - sum_a * sum_a / count, sums(b * b, from_b) - sum_b * sum_b / count

    # Where one is all but flat, over the shared times or at all, the coefficient is rounding.
    def varies(spread: Any, x: Any, raw: Any) -> Any:
        return still(spread) > count * xp.maximum(0.01 * xp.mean(still(x) * still(x)), 1e-24 * raw)

    varied = varies(spread_a, a, raw_a) & varies(spread_b, b, raw_b)
    square = xp.where(varied, spread_a * spread_b, 1.0)
    scale = power(square, 0.5) if xp is jnp else np.sqrt(square)
    return xp.where(varied, (cross - sum_a * sum_b / count) / scale, -1.0)


def _crest(values: Any, top: Any) -> Any:
    """Place of a maximum between samples, counted in samples: crest of the least-squares quartic about ``top``.

    Over as many samples either side, two or more, as are within 10 % of the greatest without a gap. Where the quartic c has
    its crest s, c'(s) = 0, so that ds = -dc'(s)/c''(s).
    """
    xp, flat = backend(values), still(values)
    k = np.arange(values.size)
    low = flat < _EQUAL * flat[top]
    middle = xp.clip(top, 2, values.size - 3)
    left = middle - xp.max(xp.where(low & (k < top), k + 1, 0))
    right = xp.min(xp.where(low & (k > top), k - 1, values.size - 1)) - middle
    half = xp.maximum(2, xp.minimum(left, right))
    if xp is np:
        # Only the samples that count; how many there are is known.
        k = np.arange(middle - half, middle + half + 1)
        values = values[k]
    u = (k - middle) / half
    basis = xp.where((xp.abs(u) <= 1)[:, None], u[:, None] ** np.arange(5), 0.0)
    weights = np.linalg.pinv(basis) if xp is np else jnp.linalg.solve(basis.T @ basis, basis.T)
    c = weights @ values
    fixed = still(c)
    start = place = u[xp.argmax(xp.where(xp.abs(u) <= 1, basis @ fixed, -np.inf))]

    def slope(c: Any, place: Any) -> Any:
        return c[1] + place * (2 * c[2] + place * (3 * c[3] + place * 4 * c[4]))

    for _ in range(6):
        bend = 2 * fixed[2] + place * (6 * fixed[3] + place * 12 * fixed[4])
        step = slope(fixed, place) / xp.where(bend < 0, bend, -1.0)
        place = xp.clip(place - step, start - 1.0 / half, start + 1.0 / half)
    bend = 2 * fixed[2] + place * (6 * fixed[3] + place * 12 * fixed[4])
    moved = slope(c, place) / xp.where(bend < 0, bend, -1.0)
    return middle + half * (place - (moved - still(moved)))
