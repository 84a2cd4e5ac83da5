"""What one contact's history amounts to: a number each, from times, normal force, penetration and its rate.

The features are ``peak``, ``mean``, ``impulse``, ``period``, ``dissipated_work``, ``residual_oscillation``,
``contact_fraction`` and ``ripple``, and of a pair ``delay``; ``period`` and ``delay`` are those of ``histories``, which
says what a window is and which errors those that take one raise.

A normal force that is read has a sign where a contact pushes both ways; a feature is of its size |F|, and ``side`` says
which way it is where it is greatest: ``summary``, ``of_steps`` and ``derivatives.measures`` take the size before all else.

All but ``period``, ``unseen``, ``contact_times`` and what counts these are pure and differentiable and take arrays of shape
(T,); ``vmap`` them over members and batches. They see samples only: what happens between two samples is not in them, but in
``of_steps``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.polynomial.chebyshev import chebvander

from bcfj_jax.analysis.histories import Window, samples
from bcfj_jax.analysis.histories import delay as delay
from bcfj_jax.analysis.histories import period as period
from bcfj_jax.analysis.histories import within as within
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import power

UNITS = {
    "peak": "N",
    "mean": "N",
    "period": "s",
    "impulse": "N s",
    "dissipated_work": "J",
    "contact_fraction": "1",
    "contact_count": "1",
    "contact_start": "s",
    "contact_end": "s",
    "peak_penetration": "m",
    "side": "1",
}


class NoClearanceFit(NamedTuple):
    """Smooth course of a force in a window: times [s], Chebyshev coefficients, fitted force and residual [N]."""

    times: np.ndarray
    coefficients: Array
    fitted: Array
    residual: Array


class Oscillation(NamedTuple):
    """Residual of a no-clearance fit: max|r|, rms and (max r - min r)/2 [N], and rms/mean|fit| [-]."""

    largest: Array
    rms: Array
    amplitude: Array
    relative: Array


def _numpy(*values: ArrayLike) -> Any:
    """NumPy for arrays of the host, on which nothing is compiled; ``jax.numpy`` for traced ones."""
    return jnp if any(isinstance(x, Array) for x in values) else np


def peak(values: ArrayLike) -> Array:
    """Greatest sample of a force, max F [N], or of a penetration, max d [m]."""
    return _numpy(values).max(values)


def side(greatest: float, least: float) -> float:
    """On which side a contact pushes hardest, from its greatest and least normal force: 1, -1, or 0 without a force."""
    return float(np.sign(greatest if greatest >= -least else least))


def impulse(times: ArrayLike, force: ArrayLike) -> Array:
    """Impulse, the integral of F dt by the trapezoidal rule [N s]."""
    return _numpy(times, force).trapezoid(force, times)


def settled(times: np.ndarray) -> int:
    """Index of the first sample of the last two thirds of the span of (T,) known times."""
    t = np.asarray(times)
    return int(np.searchsorted(t, t[0] + (t[-1] - t[0]) / 3.0))


def ripple(times: np.ndarray, force: ArrayLike) -> Array:
    """Greatest less least force, max F - min F, over the last two thirds of the span of (T,) known times [N]."""
    late = jnp.asarray(force)[settled(times) :]
    return jnp.max(late) - jnp.min(late)


def mean(times: ArrayLike, force: ArrayLike) -> Array:
    """Time average of the force, (integral of F dt)/(t_end - t_0) [N], time apart included."""
    t = _numpy(times).asarray(times)
    return impulse(t, force) / (t[-1] - t[0])


def dissipated_work(force: ArrayLike, penetration: ArrayLike) -> Array:
    """Work kept by the contact, the integral of F dd along the history by the trapezoidal rule [J].

    It is the area of the loop of force against penetration when the history starts and ends apart;
    else it still holds the elastic energy stored at the end.
    """
    return _numpy(force, penetration).trapezoid(force, penetration)


def contact_fraction(times: ArrayLike, penetration: ArrayLike) -> Array:
    """Share of the time with d > 0, d linear between samples [-]."""
    xp = _numpy(times, penetration)
    t, d = xp.asarray(times), xp.asarray(penetration)
    inside = xp.maximum(d, 0.0)
    size = xp.abs(d[1:]) + xp.abs(d[:-1])
    share = (inside[1:] + inside[:-1]) / xp.where(size == 0, 1.0, size)
    return xp.sum(share * xp.diff(t)) / (t[-1] - t[0])


def onset_time(times: ArrayLike, force: ArrayLike, share: float = 0.5, level: float | None = None) -> float:
    """When a force first reaches a share of a level [s], linear between samples; infinite where it never does.

    The paper's delay of .04 s between the points 5 and 4 (.042 and .082 s, its sections 4.1.5 and 4.2.1) is a difference of
    such onsets and no lag of correlated histories. NumPy, not traced.

    Args:
        times, force: (T,) [s], [N]; of either sign, its size counts.
        share: of the level.
        level: [N]; by default the greatest size in the last third of the history, where a start is over.
    """
    t, f = np.asarray(times, dtype=float), np.abs(np.asarray(force, dtype=float))
    settled = t >= t[0] + 2.0 * (t[-1] - t[0]) / 3.0
    limit = share * (float(np.max(f[settled])) if level is None else abs(level))
    if not limit > 0.0:
        return float("inf")
    above = np.flatnonzero(f >= limit)
    if not above.size:
        return float("inf")
    k = int(above[0])
    return float(t[0] if k == 0 else t[k - 1] + (limit - f[k - 1]) / (f[k] - f[k - 1]) * (t[k] - t[k - 1]))


def transfer_loss(force_in: ArrayLike, force_out: ArrayLike) -> Array:
    """Share of the peak force that is not passed on, (max F_in - max F_out)/max F_in [-]; NaN where max F_in <= 0.

    Both are histories [N], of any lengths: resultants, or normal forces that press (> 0). Negative where more comes
    out than goes in. Raises nothing.
    """
    top, out = peak(force_in), peak(force_out)
    return jnp.where(top > 0, (top - out) / jnp.where(top > 0, top, 1.0), jnp.nan)


def no_clearance_fit(times: ArrayLike, force: ArrayLike, window: Window, order: int = 9) -> NoClearanceFit:
    """Course that a force would have without clearance: least-squares polynomial over a window.

        fit(t) = sum_k c_k T_k(tau),   k = 0..order,   tau = 2 (t - start)/(end - start) - 1,   r = F - fit,

    T_k Chebyshev's polynomials: condition number 3.5 at order 9, against 2e12 in powers of t over 1.18 s to 1.82 s.
    Samples weigh alike. The window should span one period of a normal force, two of an axial one.

    Raises:
        InputError: see ``histories``; or an order < 0, or fewer than order + 1 samples in the window.
    """
    if order < 0 or order != int(order):
        raise InputError("order", f"{order}", "give a whole number, 0 or more")
    t, (f,) = samples(times, window, force)
    if t.size < order + 1:
        raise InputError(
            "window", f"{t.size} samples for order {order}", f"take a wider window, of at least {order + 1} samples"
        )
    start, end = window or (t[0], t[-1])
    basis, triangle = map(jnp.asarray, np.linalg.qr(chebvander(2.0 * (t - start) / (end - start) - 1.0, int(order))))
    along = basis.T @ f
    fitted = basis @ along
    return NoClearanceFit(t, jax.scipy.linalg.solve_triangular(triangle, along), fitted, f - fitted)


def residual_oscillation(times: ArrayLike, force: ArrayLike, window: Window = None, order: int = 9) -> Array:
    """What the clearance adds to a force in a window: amplitude (max r - min r)/2 of ``oscillation`` [N].

    The paper's "maximum amplitude" of a residual.
    """
    return oscillation(times, force, window, order).amplitude


def oscillation(times: ArrayLike, force: ArrayLike, window: Window, order: int = 9) -> Oscillation:
    """Size of the residual r of ``no_clearance_fit``, in four ways.

    max|r| [N], rms = sqrt(mean r^2) [N], (max r - min r)/2 [N], rms/mean|fit| [-] (NaN without load); means over
    samples. The derivative of rms is 0 where r = 0.

    Raises:
        InputError: as ``no_clearance_fit``.
    """
    fit = no_clearance_fit(times, force, window, order)
    r = fit.residual
    square = jnp.mean(r * r)
    # ``power`` takes NaN for apart.
    rms = jnp.where(jnp.isnan(square), jnp.nan, power(square, 0.5))
    amplitude = 0.5 * (jnp.max(r) - jnp.min(r))
    return Oscillation(jnp.max(jnp.abs(r)), rms, amplitude, rms / jnp.mean(jnp.abs(fit.fitted)))


def unseen(penetration: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Indices k of contacts that began and ended between the samples k and k + 1.

    Found by the rate: it turns from approach to departure, apart at both samples, in a jump (more than ten
    times the median change of the rate over a sample), as no load but a contact does.
    """
    jump = np.abs(np.diff(rate))
    turned = (rate[:-1] > 0) & (rate[1:] < 0) & (penetration[:-1] <= 0) & (penetration[1:] <= 0)
    finite = jump[np.isfinite(jump)]
    return np.flatnonzero(turned & (jump > 10.0 * np.median(finite))) if finite.size else np.empty(0, dtype=int)


def contact_times(times: ArrayLike, penetration: ArrayLike, rate: ArrayLike) -> list[tuple[float, float]]:
    """Start and end of each contact, d > 0 between them [s]; NaN for an end after the last sample.

    Roots of the cubic Hermite interpolant of d and d' in the samples' interval. A contact between two
    samples (``unseen``) starts and ends where the neighbours' straight flights meet the surface. NumPy, not traced.
    """
    t, d, v = (np.asarray(x, dtype=float) for x in (times, penetration, rate))
    found = [(float(t[0]), True)] if d[0] > 0 else []
    found += [(_root(t, d, v, k), True) for k in np.flatnonzero((d[:-1] <= 0) & (d[1:] > 0))]
    found += [(_root(t, d, v, k), False) for k in np.flatnonzero((d[:-1] > 0) & (d[1:] <= 0))]
    for k in unseen(d, v):
        start, end = np.clip((t[k] - d[k] / v[k], t[k + 1] - d[k + 1] / v[k + 1]), t[k], t[k + 1])
        # Gravity and the contact's own length make the two cross by less than they mean.
        found += [(float(start), True), (float(max(start, end)), False)]
    # At one instant an end sorts after its start.
    found.sort(key=lambda event: (event[0], not event[1]))
    starts = [time for time, starting in found if starting]
    ends = [time for time, starting in found if not starting]
    return [(start, ends[i] if i < len(ends) else float("nan")) for i, start in enumerate(starts)]


def _root(t: np.ndarray, d: np.ndarray, v: np.ndarray, k: np.integer) -> float:
    """Root of the Hermite cubic between samples k and k + 1, which differ in sign, by bisection."""
    if d[k] == 0.0:
        return float(t[k])
    h = t[k + 1] - t[k]
    a, b, p, q = d[k], d[k + 1], h * v[k], h * v[k + 1]
    low, high, upward = 0.0, 1.0, b > a
    for _ in range(60):
        s = 0.5 * (low + high)
        value = a + s * (p + s * (3 * (b - a) - 2 * p - q + s * (2 * (a - b) + p + q)))
        low, high = (s, high) if (value <= 0) == upward else (low, s)
    return float(t[k] + h * 0.5 * (low + high))


def contact_interval(times: ArrayLike, penetration: ArrayLike, rate: ArrayLike) -> float:
    """Mean interval between the starts of contacts, (t_last - t_first)/(count - 1) [s]; NaN for fewer than 2."""
    starts = [start for start, _ in contact_times(times, penetration, rate)]
    # What is pressed at the first sample began before it.
    starts = starts[1:] if np.asarray(penetration)[0] > 0 else starts
    return (starts[-1] - starts[0]) / (len(starts) - 1) if len(starts) > 1 else float("nan")


def of_steps(end: float, steps: Mapping[str, float]) -> dict[str, float]:
    """``summary`` of what was found in the solver's steps from time 0 to ``end`` [s]: ``solve.extremes.Extremes`` as numbers."""
    # What is pressed at time 0 began before it.
    begun = steps["count"] - (steps["onset"] != steps["first"])
    parted = np.isfinite(steps["end"])
    return {
        "peak": steps["peak"],
        "mean": steps["impulse"] / end if end > 0.0 else steps["peak"],
        "period": (steps["latest"] - steps["first"]) / (begun - 1.0) if begun > 1.0 else float("nan"),
        "impulse": steps["impulse"],
        "dissipated_work": steps["work"],
        "contact_fraction": steps["touching"] / end if end > 0.0 else float(steps["deepest"] > 0.0),
        "contact_count": steps["count"],
        "contact_start": steps["onset"] if steps["count"] else float("nan"),
        "contact_end": steps["end"] if parted else float("nan"),
        "peak_penetration": steps["deepest"],
        "side": side(steps["peak"] if steps["least"] != -steps["peak"] else 0.0, steps["least"]),
    }


def summary(times: ArrayLike, force: ArrayLike, penetration: ArrayLike, rate: ArrayLike) -> dict[str, float]:
    """The features that ``UNITS`` names, of one contact, in these units, from its samples.

    The surfaces touch ``contact_count`` times: first from ``contact_start`` on, last until ``contact_end``, which is NaN
    where they still touch at the end of the history. The period is ``contact_interval``.
    """
    contacts, signed = contact_times(times, penetration, rate), _numpy(force).asarray(force)
    force = _numpy(force).abs(signed)
    start, end = (contacts[0][0], contacts[-1][1]) if contacts else (float("nan"), float("nan"))
    return {
        "peak": float(peak(force)),
        "mean": float(mean(times, force)),
        "period": contact_interval(times, penetration, rate),
        "impulse": float(impulse(times, force)),
        "dissipated_work": float(dissipated_work(force, penetration)),
        "contact_fraction": float(contact_fraction(times, penetration)),
        "contact_count": float(len(contacts)),
        "contact_start": start,
        "contact_end": end,
        "peak_penetration": float(peak(penetration)),
        "side": side(float(peak(signed)), -float(peak(-signed))),
    }
