"""Features of histories and their derivatives along the histories' tangents.

``vector`` is in JAX, for whatever differentiates through it. ``measure`` is the same in NumPy with derivatives by hand,
so that a finished run's features compile nothing. Both take the size of a contact's force first (``sizes``). A period's
derivative comes from what defines it: a root of the penetration, or the best correlation of a history with itself.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.polynomial.chebyshev import chebvander

from bcfj_jax.analysis import features
from bcfj_jax.analysis import histories as comparison
from bcfj_jax.analysis.derivatives import curves
from bcfj_jax.analysis.derivatives.certificate import apart
from bcfj_jax.analysis.derivatives.curves import COLUMNS, IMPULSE, LEAST, PEAK, WORK, quartic
from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names
from bcfj_jax.analysis.derivatives.names import Feature, event, members
from bcfj_jax.analysis.derivatives.starting import START, of_members, starting
from bcfj_jax.analysis.histories import correlations, crest_lags, shifts
from bcfj_jax.mechanism.channels import is_reading

_FEWEST = 11  # samples: a residual of order 9 over fewer is rounding
_FEW = 6  # samples: of fewer in a contact the loop of force against penetration is not known
# Columns of ``Histories.curve`` by features.
_INTEGRALS = {"mean": IMPULSE, "impulse": IMPULSE, "dissipated_work": WORK}


def sizes(found: Histories, contacts: Mapping[str, int], of: Histories | None = None) -> Histories:
    """Histories of contacts with the size of the normal force in its place; what is read in a contact's place keeps its sign.

    ``of``: the histories whose derivatives ``found`` are; without it ``found`` are values. Pure, in JAX or NumPy.
    """
    value = of or found
    xp = jnp if isinstance(value.force, Array) else np
    plain = np.array([is_reading(name) for name in channel_names(contacts)], dtype=bool)

    def turned(part: Any, values: Any) -> Any:
        return part * xp.where(plain | (values >= 0) | xp.isnan(values), 1.0, -1.0)

    normal = turned(found.force[..., 0], value.force[..., 0])
    force = xp.concatenate([normal[..., None], found.force[..., 1:]], axis=-1)
    curve = found.curve
    if curve is not None and value.curve is not None:
        # The greatest size is that of the least force where this is larger.
        lower = ~plain & xp.asarray(curves.top("largest", xp.moveaxis(value.curve, -1, 0), 0.0)[0] == LEAST)
        peak = xp.where(lower, -curve[..., LEAST], curve[..., PEAK])
        curve = xp.concatenate([peak[..., None], curve[..., PEAK + 1 :]], axis=-1)
    return found._replace(force=force, curve=curve)


def channel_features(times: np.ndarray, force: Array, depth: Array, curve: Array | None = None) -> dict[str, Array]:
    """Features of one channel, (T,) size of the normal force [N] and penetration [m], that JAX differentiates. Pure.

    ``curve``: (4,) what is known of the continuous curve (``Histories``).
    """
    unknown = jnp.asarray(jnp.nan)
    several = len(times) > 1
    curve = jnp.full(len(COLUMNS), jnp.nan) if curve is None else curve

    def integral(column: int, samples: Array) -> Array:
        return jnp.where(jnp.isfinite(curve[column]), curve[column], samples)

    def top(kind: str, values: Array) -> Array:
        column, there = curves.top(kind, *jax.lax.stop_gradient((curve, jnp.max(values))))
        return jnp.where(there, jnp.abs(curve[column]), quartic(times, values[:, None]))

    impulse = integral(IMPULSE, features.impulse(times, force)) if several else unknown
    work = features.dissipated_work(jnp.abs(force), depth)
    return {
        "peak": top("peak", force),
        "largest": top("largest", jnp.abs(force)),
        "mean": impulse / (times[-1] - times[0]) if several else unknown,
        "impulse": impulse,
        "dissipated_work": integral(WORK, work) if several else unknown,
        "residual_oscillation": features.residual_oscillation(times, force) if len(times) >= _FEWEST else unknown,
        "contact_fraction": features.contact_fraction(times, depth) if several else unknown,
        "ripple": features.ripple(times, force),
    }


def grouped(kind: str, values: Array) -> Array:
    """One number of the members' (k,): the largest peak, the mean of anything else. Pure."""
    return jnp.max(values) if kind in ("peak", "largest") else jnp.mean(values)


def vector(
    times: np.ndarray, found: Histories, wanted: Sequence[Feature], contacts: Mapping[str, int], periods: Mapping
) -> Array:
    """The wanted features (F,) of histories. Pure; ``times`` and ``periods`` are numbers.

    Args:
        times: (T,) [s].
        found: the histories.
        wanted, contacts: which features, and the members of each contact.
        periods: by channel, the period [s] within which a delay is sought; without one, or NaN: the whole history.
    """
    place, found = {name: i for i, name in enumerate(channel_names(contacts))}, sizes(found, contacts)
    normal = found.force[:, :, 0]
    curve = jnp.full((normal.shape[1], len(COLUMNS)), jnp.nan) if found.curve is None else found.curve
    each = jax.vmap(lambda f, d, c: channel_features(times, f, d, c), in_axes=(1, 1, 0))
    every = each(normal, found.penetration, curve)

    def one(feature: Feature) -> Array:
        if feature.kind in ("period", *START):
            return jnp.asarray(0.0)  # filled in by ``measure``
        if event(feature.kind):
            return jnp.asarray(jnp.nan)  # of no history: ``contact_events``
        if feature.kind == "delay":
            first, second = (members(c, contacts) for c in feature.contacts)
            pairs = list(zip(first, second, strict=True)) if len(first) == len(second) else [(first[0], second[0])]
            span = float(times[-1] - times[0])
            shifts = [
                comparison.delay(
                    times, normal[:, place[a]], normal[:, place[b]],
                    periods[a] if np.isfinite(periods.get(a, np.nan)) else span,
                )
                for a, b in pairs
            ]  # fmt: skip
            return jnp.mean(jnp.stack(shifts))
        index = np.array([place[m] for m in members(feature.contacts[0], contacts)])
        return grouped(feature.kind, every[feature.kind][index])

    return jnp.stack([one(feature) for feature in wanted])


def measure(
    times: np.ndarray,
    value: Histories,
    derivative: Histories,
    wanted: Sequence[Feature],
    contacts: Mapping[str, int],
    turning: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Features (F,) and their derivatives (F, P) from histories and theirs. NumPy: nothing is compiled.

    What is of a single contact (``names.event``) is in no history: NaN, filled in by ``contact_events.filled``.

    Args:
        times: (T,) [s].
        value, derivative: of a run.
        wanted, contacts: which features, and the members of each contact.
        turning: whether a period is that of the force history (of the last two thirds), as in a joint, or the mean
            interval between contacts.
    """
    names = channel_names(contacts)
    value, derivative = sizes(value, contacts), sizes(derivative, contacts, value)
    place = {name: i for i, name in enumerate(names)}
    needed = {
        m for f in wanted if f.kind in ("period", "delay", "settling") for c in f.contacts for m in members(c, contacts)
    }
    periods = {n: _period(times, value, derivative, i, turning) for i, n in enumerate(names) if n in needed}
    even = _Even(times)

    def one(feature: Feature) -> tuple[float, np.ndarray]:
        if event(feature.kind):
            return float("nan"), np.full(len(derivative.force), np.nan)
        if feature.kind == "delay":
            first, second = (members(c, contacts) for c in feature.contacts)
            pairs = list(zip(first, second, strict=True)) if len(first) == len(second) else [(first[0], second[0])]
            found = [_delay(even, value, derivative, place[a], place[b], periods[a][0]) for a, b in pairs]
            return _mean(found)
        own = members(feature.contacts[0], contacts)
        if feature.kind == "period":
            return _mean([periods[m] for m in own])
        if feature.kind in START:
            each = [
                starting(feature.kind, times, value.force[:, place[m], 0], derivative.force[:, :, place[m], 0], cycle)
                for m in own
                for cycle in (periods[m][0] if m in periods else float("nan"),)
            ]
            return of_members(feature.kind, each)
        found = [_along(feature.kind, times, value, derivative, place[m]) for m in own]
        if feature.kind in ("peak", "largest"):
            return found[int(np.argmax([x for x, _ in found]))]
        return _mean(found)

    with np.errstate(invalid="ignore", over="ignore"):
        found = [one(feature) for feature in wanted]
    slopes = np.array([d for _, d in found]).reshape(len(found), len(derivative.force))
    return np.array([x for x, _ in found]), slopes


def sampling(
    times: np.ndarray,
    value: Histories,
    derivative: Histories,
    wanted: Sequence[Feature],
    contacts: Mapping[str, int],
    values: np.ndarray,
) -> np.ndarray:
    """Relative errors (F, P) of features' derivatives that come from the samples, whatever the solver; 0 where unknown.

    None where a number is of the continuous curve (``Histories.curve``). Of peaks that of the crest (``curves.crest``). Of
    integrals what every second sample, even or odd, gives otherwise, which is three times the error of the trapezoidal
    rule where samples are many; of works infinite where fewer than ``_FEW`` samples bear more than a twentieth of the peak in
    a contact, on average. ``values`` (P,) are the parameters'.
    """
    found = np.zeros((len(wanted), len(values)))
    value, derivative = sizes(value, contacts), sizes(derivative, contacts, value)
    place = {name: i for i, name in enumerate(channel_names(contacts))}
    for i, f in enumerate(wanted):
        if f.kind in ("peak", "largest"):
            own = [_peak(f.kind, times, value, derivative, place[m]) for m in members(f.contacts[0], contacts)]
            number, by, error = own[int(np.argmax([x for x, *_ in own]))]
            known = np.isfinite(error)
            off = apart((by + np.where(known, error, 0.0))[None], by[None], np.array([number]), values)[0]
            found[i] = np.where(known, off, error)
    works = [i for i, f in enumerate(wanted) if f.kind in _INTEGRALS and not _continuous(f, value, place, contacts)]
    if not works or len(times) < 4:
        return found
    kept, last = [wanted[i] for i in works], len(times) - 1
    numbers, slopes = measure(times, value, derivative, kept, contacts, False)
    for first in (0, 1):
        every = np.unique(np.concatenate([[0], np.arange(first, last, 2), [last]]))
        thin = Histories(*(x[every] for x in value[:3]), state=None)
        thinner = Histories(*(x[:, every] for x in derivative[:3]), state=None)
        coarse = measure(times[every], thin, thinner, kept, contacts, False)[1]
        found[works] = np.maximum(found[works], apart(coarse, slopes, numbers, values))
    for i, slope in zip(works, slopes, strict=True):
        if wanted[i].kind != "dissipated_work":
            continue
        force = np.abs(value.force[:, [place[m] for m in members(wanted[i].contacts[0], contacts)], 0])
        bears = force > 0.05 * force.max(axis=0, initial=0.0)
        begins = np.count_nonzero(bears[1:] & ~bears[:-1], axis=0) + bears[0]
        if np.any((begins > 0) & (bears.sum(axis=0) < _FEW * begins)):
            found[i] = np.where(slope != 0.0, np.inf, 0.0)
    return found


def _continuous(feature: Feature, value: Histories, place: Mapping[str, int], contacts: Mapping[str, int]) -> bool:
    """Whether an integral is known of the continuous curve."""
    own = [place[m] for m in members(feature.contacts[0], contacts)]
    return value.curve is not None and bool(np.isfinite(value.curve[own, _INTEGRALS[feature.kind]]).all())


def _peak(
    kind: str, times: np.ndarray, value: Histories, derivative: Histories, channel: int
) -> tuple[float, np.ndarray, np.ndarray]:
    """A channel's peak, its derivatives (P,), and how far these may be off."""
    force, slope = value.force[:, channel, 0], derivative.force[:, :, channel, 0]
    if kind == "largest":
        force, slope = np.abs(force), np.sign(force) * slope
    if value.curve is not None:
        column, known = curves.top(kind, value.curve[channel], np.max(force))
        if known:
            top, by = value.curve[channel, column], derivative.curve[:, channel, column]
            return float(abs(top)), np.sign(top) * by, np.zeros(len(by))
    if not (np.isfinite(force).all() and np.isfinite(slope).all()):
        return float(np.max(force)), slope[:, int(np.argmax(force))], np.full(len(slope), np.nan)
    return curves.crest(times, force, slope)


def _mean(found: Sequence[tuple[float, np.ndarray]]) -> tuple[float, np.ndarray]:
    return float(np.mean([x for x, _ in found])), np.mean([d for _, d in found], axis=0)


def _along(
    kind: str, times: np.ndarray, value: Histories, derivative: Histories, channel: int
) -> tuple[float, np.ndarray]:
    """A feature of one channel, as ``channel_features``, and its derivative (P,)."""
    force, depth = value.force[:, channel, 0], value.penetration[:, channel]
    slope, change = derivative.force[:, :, channel, 0], derivative.penetration[:, :, channel]
    if kind in ("peak", "largest"):
        return _peak(kind, times, value, derivative, channel)[:2]
    if len(times) < (_FEWEST if kind == "residual_oscillation" else 2):
        return float("nan"), np.full(len(slope), np.nan)
    column = _INTEGRALS.get(kind)
    if column is not None and value.curve is not None and np.isfinite(value.curve[channel, column]):
        over = times[-1] - times[0] if kind == "mean" else 1.0
        return float(value.curve[channel, column] / over), derivative.curve[:, channel, column] / over
    if kind in ("mean", "impulse"):
        over = times[-1] - times[0] if kind == "mean" else 1.0
        return float(np.trapezoid(force, times) / over), np.trapezoid(slope, times, axis=1) / over
    if kind == "dissipated_work":
        work = np.trapezoid(slope, depth, axis=1)
        # By parts of the trapezoidal rule: the mean force of an interval times the change of its step.
        work += 0.5 * (force[1:] + force[:-1]) @ np.diff(change, axis=1).T
        return float(np.trapezoid(force, depth)), work
    if kind == "ripple":
        late = features.settled(times)
        high, low = late + int(np.argmax(force[late:])), late + int(np.argmin(force[late:]))
        return float(force[high] - force[low]), slope[:, high] - slope[:, low]
    if kind == "residual_oscillation":
        rest = _residual(times, np.vstack([force, slope]))
        high, low = int(np.argmax(rest[0])), int(np.argmin(rest[0]))
        swing = 0.5 * (rest[:, high] - rest[:, low])
        return float(swing[0]), swing[1:]
    assert kind == "contact_fraction"
    inside, pressed = np.maximum(depth, 0.0), (depth > 0.0) * change
    size = np.abs(depth[1:]) + np.abs(depth[:-1])
    safe, grown = np.where(size == 0.0, 1.0, size), np.sign(depth) * change
    share = (inside[1:] + inside[:-1]) / safe
    moved = (pressed[:, 1:] + pressed[:, :-1] - share * (grown[:, 1:] + grown[:, :-1])) / safe
    steps = np.diff(times) / (times[-1] - times[0])
    return float(share @ steps), moved @ steps


def _residual(times: np.ndarray, rows: np.ndarray, order: int = 9) -> np.ndarray:
    """What is left of rows (k, T) by ``features.no_clearance_fit`` over all times, a linear map."""
    basis = _smooth(times.tobytes(), order)
    return rows - (rows @ basis) @ basis.T


@functools.lru_cache(maxsize=8)
def _smooth(times: bytes, order: int) -> np.ndarray:
    """An orthonormal basis (T, order + 1) of polynomials at times; every feature of a run asks for the same."""
    t = np.frombuffer(times)
    tau = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    return np.linalg.qr(chebvander(tau, order))[0]


class _Even:
    """Even steps over the span of some times."""

    def __init__(self, times: np.ndarray):
        self.times, self.even = times, np.linspace(times[0], times[-1], len(times))
        self.span = float(times[-1] - times[0])
        self.step = self.span / max(len(times) - 1, 1)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values (..., T) at the even steps, linear between samples."""
        if np.allclose(self.times, self.even, rtol=0.0, atol=1e-9 * self.step):
            return values
        rows = values.reshape(-1, values.shape[-1])
        return np.stack([np.interp(self.even, self.times, row) for row in rows]).reshape(values.shape)


def _delay(even: _Even, value: Histories, derivative: Histories, first: int, second: int, period: float) -> tuple:
    """``histories.delay`` of two channels and its derivative (P,)."""
    period = period if np.isfinite(period) else even.span
    pair = [(even(value.force[:, k, 0]), even(derivative.force[:, :, k, 0])) for k in (first, second)]
    shift, slope = best_shift(*pair[0], *pair[1], int(np.floor(0.5 * period / even.step + 1e-9)))
    limit = 0.5 * period
    inside = abs(even.step * shift) <= limit
    return float(np.clip(even.step * shift, -limit, limit)), even.step * slope * inside


def best_shift(a: np.ndarray, da: np.ndarray, b: np.ndarray, db: np.ndarray, most: int) -> tuple[float, np.ndarray]:
    """Lag [samples] of the greatest correlation of b (T,) against a, and its derivative along da, db (P, T).

    The lag s is where the least-squares quartic c of the correlation coefficient r(k) over its crest has its top,
    c'(s) = 0, so that ds = -dc'(s)/c''(s); dr comes from the overlapping samples of both, x of a and y of b less their
    means: dr = (dx.y + x.dy)/(|x||y|) - r (x.dx/|x|^2 + y.dy/|y|^2).
    """
    unknown = float("nan"), np.full(len(da), np.nan)
    place, best = (float(x) for x in shifts(a, b, most))
    if not best > 0:
        return unknown
    match = correlations(a, b, most)
    lags = crest_lags(match, int(np.argmax(match)))
    middle, half = 0.5 * (lags[0] + lags[-1]), 0.5 * (lags[-1] - lags[0])
    u = (lags - middle) / half
    change = np.stack([_matched(a, da, b, db, int(lag) - most) for lag in lags], axis=1)
    basis = u[:, None] ** np.arange(5)
    weights = np.linalg.pinv(basis)
    c, dc = weights @ match[lags], change @ weights.T
    at = (place + most - middle) / half
    rise = dc @ np.array([0.0, 1.0, 2.0 * at, 3.0 * at**2, 4.0 * at**3])
    bend = c @ np.array([0.0, 0.0, 2.0, 6.0 * at, 12.0 * at**2])
    return place, -rise / bend * half


def _matched(a: np.ndarray, da: np.ndarray, b: np.ndarray, db: np.ndarray, lag: int) -> np.ndarray:
    """Derivative (P,) of the correlation coefficient at a lag."""
    first, second = slice(max(0, -lag), a.size - max(0, lag)), slice(max(0, lag), a.size - max(0, -lag))
    x, dx, y, dy = (z - z.mean(-1, keepdims=True) for z in (a[first], da[:, first], b[second], db[:, second]))
    square_x, square_y = x @ x, y @ y
    size = np.sqrt(square_x * square_y)
    match = x @ y / size
    return (dx @ y + dy @ x) / size - match * (dx @ x / square_x + dy @ y / square_y)


def _period(times, value: Histories, derivative: Histories, channel: int, turning: bool) -> tuple[float, np.ndarray]:
    force, slope = value.force[:, channel, 0], derivative.force[:, :, channel, 0]
    unknown = (float("nan"), np.full(len(slope), np.nan))
    if len(times) < 2 or not np.isfinite(force).all():
        return unknown
    if turning:
        return _repeat(times, force, slope) or unknown
    depth, rate = value.penetration[:, channel], value.rate[:, channel]
    starts = [start for start, _ in features.contact_times(times, depth, rate)][int(depth[0] > 0) :]
    if len(starts) < 2:
        return unknown
    ends = [
        _start_slope(times, depth, rate, derivative.penetration[:, :, channel], derivative.rate[:, :, channel], at)
        for at in (starts[0], starts[-1])
    ]
    return (starts[-1] - starts[0]) / (len(starts) - 1), (ends[1] - ends[0]) / (len(starts) - 1)


def _start_slope(times, depth, rate, depth_slope, rate_slope, at: float) -> np.ndarray:
    """d t*/d p of a root d(t*) = 0, -(dd/dp)/d', from the samples' Hermite cubics; NaN for one between samples."""
    k = int(np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2))
    if not depth[k] <= 0 <= depth[k + 1]:
        return np.full(len(depth_slope), np.nan)
    h = times[k + 1] - times[k]
    s = (at - times[k]) / h
    basis = np.array([(1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2 * h, s * s * (3 - 2 * s), s * s * (s - 1) * h])
    steep = np.array([6 * s * (s - 1) / h, (1 - s) * (1 - 3 * s), 6 * s * (1 - s) / h, s * (3 * s - 2)])
    speed = steep @ np.array([depth[k], rate[k], depth[k + 1], rate[k + 1]])
    change = np.stack([depth_slope[:, k], rate_slope[:, k], depth_slope[:, k + 1], rate_slope[:, k + 1]], axis=1)
    return -(change @ basis) / speed


def _repeat(times: np.ndarray, force: np.ndarray, slope: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Period of a history's last two thirds and its derivative.

    T = (k h + s)/m with s the delay of the history k samples later against itself, m the periods in 3/4 of the window.
    The derivative is good to about 1 %: the window holds no whole number of periods.
    """
    window = times >= times[0] + (times[-1] - times[0]) / 3.0
    t = times[window]
    if t.size < 16:
        return None
    period = comparison.period(t, force[window])
    if not np.isfinite(period):
        return None
    even = _Even(t)
    many = max(1, int(0.75 * even.span / period))
    later = round(many * period / even.step)
    if t.size - later < 8 or period < 8 * even.step:
        return period, np.full(len(slope), np.nan)
    width = min(period, 0.9 * float(even.even[-1 - later] - even.even[0]))
    x, dx = even(force[window]), even(slope[:, window])
    most = int(np.floor(0.5 * width / even.step + 1e-9))
    kept = t.size - later
    return period, best_shift(x[:kept], dx[:, :kept], x[later:], dx[:, later:], most)[1] * even.step / many
