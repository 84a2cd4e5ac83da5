"""What the flights of a drop say of its contacts' loss, whatever the law: v = g t/2 at both ends of a flight of length t.

The restitution of the contact between two flights is e = t_2/t_1. Over several contacts it says how the loss goes with the
speed, 1 - e = c v^b: b is near 1 of a force K d^n (1 + a d'), and 0 of laws whose coefficient is a restitution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.core.quantities import GRAVITY
from bcfj_jax.io.units import format_si
from calibration.impacts.events import Event

# Flights from which on a loss can be told to grow with the speed or not; a loss within so many deviations is none.
_FEWEST, _SEEN = 4, 3.0
# Exponents further apart than this, and twice the deviation, contradict each other.
_APART = 0.4
# A contact by the law lasts no longer, in times in which the approach speed crosses the elastic penetration.
_LONGEST = 30.0
# Of a contact between two flights: samples beside it that show its rest, over so many durations, and the least that are
# enough; its window in durations on either side; flights are longer than so many.
_BESIDE, _ENOUGH, _AROUND, _APART_BY = 10.0, 4, 1.0, 4.0
# What a law has to read, and no more, for its loss to be foretold.
_READ = {"stiffness", "exponent", "damping"}


class Loss(NamedTuple):
    """Restitutions (k,) of the contacts between flights, speeds (k,) before them [m/s], the exponent b and its deviation."""

    kept: np.ndarray
    speeds: np.ndarray
    exponent: float
    deviation: float


class Passage(NamedTuple):
    """A contact between two flights: what is known of it without a law, SI."""

    begin: float
    speed: float  # before it, v = g t/2 of a flight of the length t
    kept: float  # restitution, by the flights before and after
    impulse: float
    # Impulse over change of speed: 2 J/(g (t_1 + t_2)), t from the middle of a contact to that of the next, which holds
    # the weight's impulse, too.
    mass: float
    duration: float
    peak: float
    # clock, force: (k,) its window, the clock from half a sample before begin on, the force above its rest.
    clock: np.ndarray
    force: np.ndarray


def passages(clock: np.ndarray, force: np.ndarray, events: Sequence[Event], gravity: float = GRAVITY) -> list[Passage]:
    """Every contact between two flights that are several times as long as it; the rest is a line through what is beside it.

    No low-pass with a gain of 1 at rest changes speed, restitution, impulse and mass: it delays every contact alike.
    """
    seen = np.isfinite(force)
    clock, force = clock[seen], force[seen]
    found = []
    for before, e, after in zip(events, events[1:], events[2:], strict=False):
        around = _AROUND * e.duration
        middles = [0.5 * (one.begin + one.end) for one in (before, e, after)]
        first, second = np.diff(middles)
        if min(first, second) < _APART_BY * e.duration:
            continue
        flying = (clock > before.end + 2.0 * around) & (clock < e.begin - around)
        flying |= (clock > e.end + 2.0 * around) & (clock < after.begin - around)
        beside = flying & (np.abs(clock - middles[1]) < _BESIDE * e.duration)
        inside = (clock > e.begin - around) & (clock < e.end + around)
        if min(np.count_nonzero(beside & (clock < e.begin)), np.count_nonzero(beside & (clock > e.end))) < _ENOUGH:
            continue
        own = clock - (e.begin - 0.5 * e.step)
        read = force - np.polyval(np.polyfit(own[beside], force[beside], 1), own)
        impulse = float(np.trapezoid(read[inside], own[inside]))
        flights, mass = np.array([first, second]) - e.duration, 2.0 * impulse / (gravity * (first + second))
        speed, kept, peak = 0.5 * gravity * flights[0], flights[1] / flights[0], float(read[inside].max())
        found.append(Passage(e.begin, speed, kept, impulse, mass, e.duration, peak, own[inside], read[inside]))
    return found


def loss(events: Sequence[Event]) -> Loss | None:
    """By least squares over ln(1 - e) and ln v, weighted by what instants known to half a sample leave of 1 - e.

    None from fewer than four flights, and where nothing is lost.
    """
    flights = np.diff([0.5 * (one.begin + one.end) for one in events])
    if flights.size < _FEWEST or np.any(flights <= 0.0):
        return None
    kept, speeds = flights[1:] / flights[:-1], 0.5 * GRAVITY * flights[:-1]
    doubt = 0.5 * float(np.median([one.step for one in events])) * np.sqrt(2.0) / flights[:-1]
    if np.any(1.0 - kept < _SEEN * doubt):
        return None
    weight = ((1.0 - kept) / doubt) ** 2
    way = np.log(speeds)
    way = way - np.average(way, weights=weight)
    square = float(np.sum(weight * way**2))
    return Loss(kept, speeds, float(np.sum(weight * way * np.log(1.0 - kept)) / square), square**-0.5)


def restitutions(law: AbstractLaw, c: Mapping[str, float], mass: float, speeds: np.ndarray) -> np.ndarray:
    """Of contacts (k,) by a law that reads penetration and rate alone, K d^n at rest: m d'' = -F, from d' = v to d = 0."""
    constants = {key: jnp.asarray(value) for key, value in c.items()}

    def slope(_: float, y: np.ndarray) -> list[float]:
        force = law.force(jnp.maximum(y[0], 0.0), jnp.asarray(y[1]), constants)
        return [y[1], -float(force) / mass]

    def parted(_: float, y: np.ndarray) -> float:
        return y[0]

    parted.terminal, parted.direction = True, -1.0  # pyright: ignore[reportFunctionMemberAccess]
    left = []
    for v in speeds:
        n = c["exponent"]
        crossed = (0.5 * (n + 1.0) * mass * v**2 / c["stiffness"]) ** (1.0 / (n + 1.0)) / v
        ends = (0.0, _LONGEST * crossed)
        found = solve_ivp(slope, ends, [0.0, v], events=parted, rtol=1e-6, atol=1e-6 * crossed * v, max_step=crossed)
        left.append(-found.y[1, -1] / v if found.status == 1 else np.nan)
    return np.array(left)


def contradicted(name: str, events: Sequence[Event], law: AbstractLaw | None, c: Mapping[str, float]) -> str:
    """Why a law loses energy with the speed otherwise than a drop's flights do; "" where it does not, or nothing is known.

    ``c``: coefficients to be expected, and ``mass``.
    """
    seen = loss(events)
    if seen is None or law is None or {*law.needs} != _READ:
        return ""
    if not all(c.get(key, 0.0) > 0.0 for key in (*_READ, "mass")):
        return ""
    ends = np.array([seen.speeds.min(), seen.speeds.max()])
    lost = 1.0 - restitutions(law, c, c["mass"], ends)
    if not np.all(lost > 0.0):
        return ""
    own = float(np.log(lost[1] / lost[0]) / np.log(ends[1] / ends[0]))
    if abs(own - seen.exponent) < _APART + 2.0 * seen.deviation:
        return ""
    first, last = (f"{seen.kept[k]:.3g} at {format_si(seen.speeds[k], 'm/s', 3)}" for k in (0, -1))
    return (
        f"{name}: loss depends on speed otherwise: by the flights between contacts a restitution is {first} and {last}, so that "
        f"1 - e grows as the speed^{seen.exponent:.2g}; by the law as speed^{own:.2g}. Free restitution in place of damping "
        "takes a law that loses the same share at every speed"
    )
