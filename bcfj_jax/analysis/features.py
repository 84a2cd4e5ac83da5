"""Features of a contact: what its history amounts to, a number each. All of them are defined here, once.

``KINDS`` is the table: name, unit, meaning and definition of every feature, and which commands take it. A definition is a pure
function of what was seen of one channel (``Seen``), in arrays of NumPy, JAX or ``core.dual``, so that one definition gives the
value, JAX's derivatives, and those of a finished run. A feature is added by one row; every command then has it.
``derivatives.measures`` takes features of whole runs, ``derivatives.names`` reads their names, ``EVENTS`` are those of single
contacts.

Wear, pressure and life are of readings of a contact (``mechanism.channels.READ_BY``), which ``observing`` shows.

A normal force that is read has a sign where a contact pushes both ways; a feature is of its size |F|, and ``side`` says
which way it is where it is greatest: ``summary``, ``of_steps`` and ``derivatives.measures`` take the size before all else.

Functions of arrays of shape (T,) see samples only: what happens between two samples is not in them, but in ``of_steps``.
``period``, ``unseen``, ``contact_times`` and what counts these are NumPy; windows and what they raise: ``histories``.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.polynomial.chebyshev import chebvander

from bcfj_jax.analysis import crests
from bcfj_jax.analysis.crests import UNKNOWN, Curve
from bcfj_jax.analysis.histories import Window, samples, settled_period, settling_time
from bcfj_jax.analysis.histories import delay as delay
from bcfj_jax.analysis.histories import period as period
from bcfj_jax.analysis.histories import within as within
from bcfj_jax.core.dual import Dual, backend, either, still, unsloped
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import power
from bcfj_jax.mechanism.channels import READ_BY

# Share of its settled peak at which a contact's load has begun; and within which a settled force repeats itself.
BEGUN = SETTLED = 0.05


class NoClearanceFit(NamedTuple):
    """Smooth course of a force in a window: times [s], Chebyshev coefficients, fitted force and residual [N]."""

    times: np.ndarray
    coefficients: Any
    fitted: Any
    residual: Any


class Oscillation(NamedTuple):
    """Residual of a no-clearance fit: max|r|, rms and (max r - min r)/2 [N], and rms/mean|fit| [-]."""

    largest: Array
    rms: Array
    amplitude: Array
    relative: Array


def peak(values: Any) -> Any:
    """Greatest sample of a force, max F [N], or of a penetration, max d [m]."""
    return backend(values).max(values)


def side(greatest: float, least: float) -> float:
    """On which side a contact pushes hardest, from its greatest and least normal force: 1, -1, or 0 without a force."""
    return float(np.sign(greatest if greatest >= -least else least))


def impulse(times: ArrayLike, force: Any) -> Any:
    """Impulse, the integral of F dt by the trapezoidal rule [N s]."""
    return backend(times, force).trapezoid(force, times)


def settled(times: np.ndarray) -> int:
    """Index of the first sample of the last two thirds of the span of (T,) known times."""
    t = np.asarray(times)
    return int(np.searchsorted(t, t[0] + (t[-1] - t[0]) / 3.0))


def ripple(times: np.ndarray, force: Any) -> Any:
    """Greatest less least force, max F - min F, over the last two thirds of the span of (T,) known times [N]."""
    late, xp = force[settled(times) :], backend(force)
    return xp.max(late) - xp.min(late)


def mean(times: ArrayLike, force: Any) -> Any:
    """Time average of the force, (integral of F dt)/(t_end - t_0) [N], time apart included."""
    t = backend(times, force).asarray(times)
    return impulse(t, force) / (t[-1] - t[0])


def dissipated_work(force: Any, penetration: Any) -> Any:
    """Work kept by the contact, the integral of F dd along the history by the trapezoidal rule [J].

    It is the area of the loop of force against penetration when the history starts and ends apart;
    else it still holds the elastic energy stored at the end.
    """
    return backend(force, penetration).trapezoid(force, penetration)


def duration(times: ArrayLike, penetration: Any) -> Any:
    """Time with d > 0, d linear between samples [s]."""
    xp = backend(times, penetration)
    d = penetration if isinstance(penetration, Dual) else xp.asarray(penetration)
    inside, size = xp.maximum(d, 0.0), xp.abs(d)
    both = size[1:] + size[:-1]
    share = (inside[1:] + inside[:-1]) / xp.where(still(both) == 0, 1.0, both)
    return xp.sum(share * np.diff(times) if xp is np else share * jnp.diff(jnp.asarray(times)))


def contact_fraction(times: ArrayLike, penetration: Any) -> Any:
    """Share of the time with d > 0, d linear between samples [-]."""
    t = backend(times, penetration).asarray(times)
    return duration(t, penetration) / (t[-1] - t[0])


def onset_time(times: ArrayLike, force: Any, share: float = 0.5, level: float | None = None) -> Any:
    """When a force first reaches a share of a level [s], linear between samples; infinite where it never does.

    The paper's delay of .04 s between the points 5 and 4 (.042 and .082 s, its sections 4.1.5 and 4.2.1) is a difference of
    such onsets and no lag of correlated histories. Not traced; it moves by  dt = (share dP - dF)/F'  with the level P and the
    force F.

    Args:
        times, force: (T,) [s], [N]; of either sign, its size counts.
        share: of the level.
        level: [N]; by default the greatest size in the last third of the history, where a start is over.
    """
    t, f = np.asarray(times, dtype=float), np.abs(force)
    late = t >= t[0] + 2.0 * (t[-1] - t[0]) / 3.0
    limit = share * (np.max(f[late]) if level is None else abs(level))
    above = np.flatnonzero(still(f) >= still(limit)) if still(limit) > 0.0 else np.empty(0)
    if not above.size:
        return float("inf")
    k = int(above[0])
    return t[0] if k == 0 else t[k - 1] + (limit - f[k - 1]) / (f[k] - f[k - 1]) * (t[k] - t[k - 1])


def transfer_loss(force_in: ArrayLike, force_out: ArrayLike) -> Array:
    """Share of the peak force that is not passed on, (max F_in - max F_out)/max F_in [-]; NaN where max F_in <= 0.

    Both are histories [N], of any lengths: resultants, or normal forces that press (> 0). Negative where more comes
    out than goes in. Raises nothing.
    """
    top, out = peak(force_in), peak(force_out)
    return jnp.where(top > 0, (top - out) / jnp.where(top > 0, top, 1.0), jnp.nan)


def no_clearance_fit(times: ArrayLike, force: Any, window: Window, order: int = 9) -> NoClearanceFit:
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
    basis, inverse = _smooth(t.tobytes(), *map(float, window or (t[0], t[-1])), int(order))
    along = basis.T @ f
    fitted = basis @ along
    return NoClearanceFit(t, inverse @ along, fitted, f - fitted)


@functools.lru_cache(maxsize=4)
def _smooth(times: bytes, start: float, end: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal basis (T, order + 1) of smooth courses, and what makes Chebyshev's coefficients of its own."""
    basis, triangle = np.linalg.qr(chebvander(2.0 * (np.frombuffer(times) - start) / (end - start) - 1.0, order))
    return basis, np.linalg.inv(triangle)


def residual_oscillation(times: ArrayLike, force: Any, window: Window = None, order: int = 9) -> Any:
    """What the clearance adds to a force in a window: amplitude (max r - min r)/2 of ``oscillation`` [N].

    The paper's "maximum amplitude" of a residual.
    """
    r, xp = no_clearance_fit(times, force, window, order).residual, backend(force)
    return 0.5 * (xp.max(r) - xp.min(r))


def oscillation(times: ArrayLike, force: ArrayLike, window: Window, order: int = 9) -> Oscillation:
    """Size of the residual r of ``no_clearance_fit``, in four ways.

    max|r| [N], rms = sqrt(mean r^2) [N], (max r - min r)/2 [N], rms/mean|fit| [-] (NaN without load); means over
    samples. The derivative of rms is 0 where r = 0.

    Raises:
        InputError: as ``no_clearance_fit``.
    """
    fit, xp = no_clearance_fit(times, force, window, order), backend(force)
    r = fit.residual
    square = xp.mean(r * r)
    # ``power`` takes NaN for apart.
    rms = np.sqrt(square) if xp is np else jnp.where(jnp.isnan(square), jnp.nan, power(square, 0.5))
    amplitude = 0.5 * (xp.max(r) - xp.min(r))
    return Oscillation(xp.max(xp.abs(r)), rms, amplitude, rms / xp.mean(xp.abs(fit.fitted)))


def unseen(times: np.ndarray, penetration: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Indices k of contacts that began and ended between the samples k and k + 1.

    Found by the rate: it turns from approach to departure, apart at both samples, in a jump (more than ten
    times the median change of the rate over a sample), as no load but a contact does; and so fast that the surface is
    within reach at twice its rate: a body at rest turns by rounding.
    """
    jump = np.abs(np.diff(rate))
    turned = (rate[:-1] > 0) & (rate[1:] < 0) & (penetration[:-1] <= 0) & (penetration[1:] <= 0)
    twice = 2.0 * np.diff(times)
    turned &= (twice * rate[:-1] >= -penetration[:-1]) & (-twice * rate[1:] >= -penetration[1:])
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
    for k in unseen(t, d, v):
        start, end = np.clip((t[k] - d[k] / v[k], t[k + 1] - d[k + 1] / v[k + 1]), t[k], t[k + 1])
        # Gravity and the contact's own length make the two cross by less than they mean.
        found += [(float(start), True), (float(max(start, end)), False)]
    # At one instant an end sorts after its start.
    found.sort(key=lambda event: (event[0], not event[1]))
    starts = [time for time, starting in found if starting]
    ends = [time for time, starting in found if not starting]
    return [(start, ends[i] if i < len(ends) else float("nan")) for i, start in enumerate(starts)]


def _root(t: np.ndarray, d: Any, v: Any, k: Any) -> Any:
    """Root t* of the Hermite cubic between samples k and k + 1, which differ in sign, by bisection; dt* = -(dd)/d'."""
    h = t[k + 1] - t[k]
    a, b, p, q = d[k], d[k + 1], h * v[k], h * v[k + 1]

    def cubic(s: float, a: Any, b: Any, p: Any, q: Any) -> Any:
        return a + s * (p + s * (3 * (b - a) - 2 * p - q + s * (2 * (a - b) + p + q)))

    a0, b0, p0, q0 = fixed = [float(still(x)) for x in (a, b, p, q)]
    low, high, upward = 0.0, 0.0 if a0 == 0.0 else 1.0, b0 > a0
    for _ in range(60):
        s = 0.5 * (low + high)
        low, high = (s, high) if (cubic(s, *fixed) <= 0) == upward else (low, s)
    s = 0.5 * (low + high)
    at = float(t[k] + h * s)
    if not isinstance(d, Dual):
        return at
    steep = p0 + s * (2 * (3 * (b0 - a0) - 2 * p0 - q0) + s * 3 * (2 * (a0 - b0) + p0 + q0))
    return Dual(at, cubic(s, a, b, p, q).slope * (-h / steep))


def contact_interval(times: ArrayLike, penetration: Any, rate: Any) -> Any:
    """Mean interval between the starts of contacts, (t_last - t_first)/(count - 1) [s]; NaN for fewer than 2.

    Of duals with its slopes, as of ``start_at``.
    """
    t, depth = np.asarray(times), still(penetration)
    # What is pressed at the first sample began before it.
    starts = [start for start, _ in contact_times(times, depth, still(rate))][int(depth[0] > 0) :]
    if len(starts) < 2:
        return unsloped(float("nan"), penetration)
    first, last = (start_at(t, penetration, rate, at) for at in (starts[0], starts[-1]))
    return (last - first) / (len(starts) - 1)


def start_at(times: np.ndarray, penetration: Any, rate: Any, at: float) -> Any:
    """The start of a contact that ``contact_times`` has found [s], of duals with its slopes; NaN of one between two samples."""
    k = int(np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2))
    seen = still(penetration)[k] <= 0 <= still(penetration)[k + 1]
    return _root(times, penetration, rate, k) if seen else unsloped(at, penetration)


# --- the table


class Seen(NamedTuple):
    """What a feature is taken from: one channel of a run."""

    times: np.ndarray  # (T,) [s], known numbers
    force: Any  # (T,) size of a contact's normal force [N]; what is read in a contact's place keeps its sign
    # depth, rate: (T,) penetration [m] and its rate [m/s].
    depth: Any
    rate: Any = None
    curve: Curve = UNKNOWN  # what is known of the continuous force
    cycle: Any = math.nan  # period [s]; of kinds that need one
    other: Any = None  # of a pair, the force of the second
    # Whether a period is that of the force history (of the last two thirds), as in a joint, or the mean interval
    # between contacts.
    turning: bool = False


def _mean(values: Any) -> Any:
    return backend(values).mean(values)


class Kind(NamedTuple):
    """A feature of a contact. Every command reads what it asks here."""

    unit: str  # SI, with N for the unit of a reading
    meaning: str  # in words, for tables of features
    of: Callable[[Seen], Any]  # its definition
    fewest: int = 1  # samples below which it is NaN
    members: Callable[[Any], Any] = _mean  # one number of the members' (k,)
    rank: int = 0  # its place among the features that are taken where none is named; 0: only where it is named
    # The same from what was found in the solver's steps (``solve.extremes.Extremes`` as numbers) from 0 to an end [s];
    # what has it is in ``summary.json``.
    steps: Callable[[Mapping[str, float], float], float] | None = None
    host: bool = False  # whether JAX does not differentiate it: it is sought in a finished run
    cyclic: bool = False  # whether it needs the channel's period
    curve: str = ""  # what of the continuous curve it is (``Curve``), or ""
    # Whether a turn of steady motion has it. Where that takes no longer, it stays: "same"; or grows: "longer".
    turn: str = ""
    aside: bool = False  # whether the table of several contacts leaves it to the summary of each, to fit on a screen
    named: bool = True  # whether it goes by a name; what does not is in a summary only

    @property
    def per_second(self) -> bool:
        """Whether it grows with the duration of a run whose course is the same."""
        return self.unit.endswith("s") or self.turn == "longer"


def _least(values: Any) -> Any:
    return backend(values).min(values)


def _first(values: Any) -> Any:
    """Of members that are known."""
    known = np.isfinite(values)
    return np.min(values[known]) if known.any() else math.nan


def _last(values: Any) -> Any:
    return np.max(values) if np.isfinite(values).all() else math.nan


def _known(column: str, otherwise: Callable[[Seen], Any]) -> Callable[[Seen], Any]:
    """Of the continuous curve where it is known, else of samples."""

    def of(s: Seen) -> Any:
        found = getattr(s.curve, column)
        return either(backend(found).isfinite(still(found)), lambda: found, lambda: otherwise(s))

    return of


_impulse = _known("impulse", lambda s: impulse(s.times, s.force))


def _period(s: Seen) -> Any:
    return settled_period(s.times, s.force) if s.turning else contact_interval(s.times, s.depth, s.rate)


def _delay(s: Seen) -> Any:
    cycle, span = float(still(s.cycle)), float(s.times[-1] - s.times[0])
    cycle = cycle if math.isfinite(cycle) else span
    return delay(s.times, s.force, s.other, cycle) if cycle * (s.times.size - 1) >= 4.0 * span else math.nan


def _onset(s: Seen) -> Any:
    found = onset_time(s.times, s.force, BEGUN)
    return found if np.isfinite(still(found)) else math.nan


def _settling(s: Seen) -> Any:
    try:
        return unsloped(settling_time(s.times, still(s.force), float(still(s.cycle)), SETTLED), s.force)
    except InputError:
        return math.nan


def _rolling(s: Seen) -> Any:
    # Of a share of the load rating: (C/P)^3 with P the 3-mean of the load; without end where nothing is borne.
    borne = backend(s.times, s.force).trapezoid(s.force * s.force * s.force, s.times)
    loaded = still(borne) > 0.0
    return either(
        loaded, lambda: (s.times[-1] - s.times[0]) / either(loaded, lambda: borne, lambda: 1.0), lambda: math.inf
    )


def _touches(k: int) -> Callable[[Seen], float]:
    """Of all contacts their number (0), when the first begins (1), and when the last ends (2)."""

    def of(s: Seen) -> float:
        found = contact_times(s.times, s.depth, s.rate)
        return float(len(found)) if k == 0 else math.nan if not found else found[0][0] if k == 1 else found[-1][1]

    return of


def _interval(x: Mapping[str, float], end: float) -> float:
    # What is pressed at time 0 began before it.
    begun = x["count"] - (x["onset"] != x["first"])
    return (x["latest"] - x["first"]) / (begun - 1.0) if begun > 1.0 else math.nan


KINDS: dict[str, Kind] = {
    "peak": Kind(
        "N", "greatest force, of the continuous curve", lambda s: crests.greatest(s.times, s.force, s.curve), 1, peak,
        rank=1, steps=lambda x, end: x["peak"], curve="peak", turn="same",
    ),
    "largest": Kind(
        "N", "greatest size of a reading of either sign",
        lambda s: crests.greatest(s.times, s.force, s.curve, size=True), 1, peak, curve="peak", turn="same",
    ),
    "mean": Kind(
        "N", "time average of the force", lambda s: _impulse(s) / (s.times[-1] - s.times[0]), 2, rank=2,
        steps=lambda x, end: x["impulse"] / end if end > 0.0 else x["peak"], curve="impulse", turn="same",
    ),
    "period": Kind(
        "s", "of the force history, or interval of contacts", _period, 2, rank=4, steps=_interval, host=True, turn="longer",
    ),
    "impulse": Kind(
        "N s", "integral of the force over time", _impulse, 2, rank=3, steps=lambda x, end: x["impulse"], curve="impulse",
        turn="longer",
    ),
    "dissipated_work": Kind(
        "J", "integral of the force over the penetration", _known("work", lambda s: dissipated_work(s.force, s.depth)), 2,
        rank=5, steps=lambda x, end: x["work"], curve="work",
    ),
    "contact_fraction": Kind(
        "1", "share of the time in contact", lambda s: contact_fraction(s.times, s.depth), 2, rank=7,
        steps=lambda x, end: x["touching"] / end if end > 0.0 else float(x["deepest"] > 0.0), turn="same",
    ),
    "duration": Kind(
        "s", "time in contact", lambda s: duration(s.times, s.depth), 2, steps=lambda x, end: x["touching"], turn="longer",
        aside=True,
    ),
    "contact_count": Kind(
        "1", "number of contacts", _touches(0), steps=lambda x, end: x["count"], aside=True, named=False
    ),
    "contact_start": Kind(
        "s", "when the surfaces first touch", _touches(1), aside=True, named=False,
        steps=lambda x, end: x["onset"] if x["count"] else math.nan,
    ),
    "contact_end": Kind(
        "s", "when they last part; NaN where they still touch at the end", _touches(2), aside=True, named=False,
        steps=lambda x, end: x["end"] if math.isfinite(x["end"]) else math.nan,
    ),
    "peak_penetration": Kind(
        "m", "greatest penetration", lambda s: peak(s.depth), steps=lambda x, end: x["deepest"], turn="same",
        named=False,
    ),
    "residual_oscillation": Kind(
        # A residual of order 9 over fewer samples is rounding.
        "N", "what clearance adds to the force", lambda s: residual_oscillation(s.times, s.force), 11, rank=6
    ),
    "wear_volume": Kind(
        "m^3", "volume that is worn off, k/H times the integral of |N| |v| (Archard)", _impulse, 2, curve="impulse",
        turn="longer",
    ),
    "peak_pressure": Kind(
        "Pa", "greatest Hertz pressure", lambda s: crests.greatest(s.times, s.force, s.curve), 1, peak, curve="peak",
        turn="same",
    ),
    "rolling_life": Kind(
        "1", "L10 in millions of revolutions, (C/P)^3 (ISO 281); of members the least", _rolling, 2, _least, turn="same"
    ),
    "delay": Kind("s", "by which the second force comes later", _delay, 2, cyclic=True),
    "ripple": Kind("N", "greatest less least force of the last two thirds", lambda s: ripple(s.times, s.force)),
    "onset": Kind("s", "when the first member first has 5 % of its settled peak", _onset, 1, _first, host=True),
    "start_window": Kind("s", "when the last member first has", _onset, 1, _last, host=True),
    "settling": Kind(
        "s", "from when all members repeat themselves within 5 %", _settling, 1, _last, host=True, cyclic=True
    ),
}  # fmt: skip


class Event(NamedTuple):
    """A feature of one contact of a run, which goes by its number: ``contact.begin_3``."""

    unit: str  # SI
    meaning: str  # in words
    # It, of the numbers of contacts (``derivatives.trains.Train``); linear, so that it gives their derivatives, too.
    of: Callable[[Any], Any]
    needs: tuple[str, ...] = ()  # of "begin" and "end" what must lie within the run
    integral: bool = False  # whether it needs an even force
    summit: bool = False  # or one with a smooth peak
    late: bool = False  # whether it is a time of the record's clock
    members: Callable[[Any], Any] = _mean  # one number of the members'


_BOTH = ("begin", "end")
EVENTS: dict[str, Event] = {
    "begin": Event("s", "when the penetration is first 0", lambda t: t.begin, ("begin",), late=True),
    "peak_time": Event("s", "when the force is greatest", lambda t: t.peak_time, summit=True, late=True),
    "end": Event("s", "when the penetration is 0 again", lambda t: t.end, ("end",), late=True),
    "peak": Event("N", "greatest force", lambda t: t.peak, summit=True, members=peak),
    "impulse": Event("N s", "integral of the force from begin to end", lambda t: t.impulse, _BOTH, integral=True),
    "center": Event("s", "mean time, weighed by the force", lambda t: t.center, _BOTH, integral=True, late=True),
    "width": Event("s", "deviation of the time, weighed by the force", lambda t: t.width, _BOTH, integral=True),
    "duration": Event("s", "time from begin to end", lambda t: t.end - t.begin, _BOTH),
}
# Of every contact where none is named; of a reading in a contact's place.
DEFAULT = tuple(sorted((name for name, kind in KINDS.items() if kind.rank), key=lambda name: KINDS[name].rank))
NAMED = (*DEFAULT, *(name for name, kind in KINDS.items() if kind.named and not kind.rank))
OF_READING = ("largest", "mean")
PAIR = "delay"
OF_TURN = tuple(name for name, kind in KINDS.items() if kind.turn)
# Of a summary.
UNITS = {name: kind.unit for name, kind in KINDS.items() if kind.steps} | {"side": "1"}
# Of a summary of a scene whose materials are given.
OF_LIFE = {name: KINDS[name].unit for name in READ_BY}


def of_steps(end: float, steps: Mapping[str, float]) -> dict[str, float]:
    """``summary`` of what was found in the solver's steps from time 0 to ``end`` [s]: ``solve.extremes.Extremes`` as numbers."""
    found = {name: kind.steps(steps, end) for name, kind in KINDS.items() if kind.steps}
    return found | {"side": side(steps["peak"] if steps["least"] != -steps["peak"] else 0.0, steps["least"])}


def summary(
    times: ArrayLike, force: ArrayLike, penetration: ArrayLike, rate: ArrayLike, turning: bool = False
) -> dict[str, float]:
    """The features that ``UNITS`` names, of one contact, in these units, from its samples; the peak is the greatest of them.

    ``turning``: as of ``Seen``.
    """
    signed, depth, speed = (np.asarray(x, dtype=float) for x in (force, penetration, rate))
    seen = Seen(np.asarray(times), np.abs(signed), depth, speed, turning=turning)
    found = {name: float(kind.of(seen)) for name, kind in KINDS.items() if kind.steps}
    return found | {"peak": float(peak(seen.force)), "side": side(float(peak(signed)), -float(peak(-signed)))}
