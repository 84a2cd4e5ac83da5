"""A mass on a surface a second time: SciPy (DOP853, Radau where a law is stiff) with NumPy's own laws.

In units of the impact, from the onset of each contact to its end; flights are closed forms. Shares nothing with the
package but the names of parameters.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import gamma

from benchmarks.references import laws

GRAVITY = 9.81
# Contacts of a bounce that are followed, and instants of each.
CONTACTS, SAMPLES = 3, 301


class Case(NamedTuple):
    """Numbers of a mass on a surface in NumPy: law by name, p its parameters, w the onset's half-width."""

    law: str
    p: dict[str, float]

    @property
    def n(self) -> float:
        """Exponent."""
        return self.p.get("exponent", 1.0)

    @property
    def w(self) -> float:
        """Half-width of the onset [m]."""
        return self.p["smoothing"]

    def onset(self, d: float) -> tuple[float, float]:
        """Smoothed depth [m] and its slope."""
        return laws.onset(d, self.w) if self.w > 0 else (max(d, 0.0), float(d > 0))

    def damping(self, approach: float) -> float:
        """a of f(d) (1 + a d')."""
        if self.law == "memory_free":
            return self.p["damping"]
        if self.law not in ("exact", "flores"):
            return 0.0
        e = max(self.p["restitution"], 1e-3)
        if self.law == "flores":
            return 1.6 * (1 - e) / e / max(approach, 1e-9)
        if 1 - e < 1e-6:
            return 1.5 * (1 - e) / max(approach, 1e-9)
        low, high = max(1e-9, 0.5 * (1 - e)), (1 + 1e-12) / e
        chi: Any = brentq(lambda c: c * e - 1 + (1 + c) * np.exp(-c * (1 + e)), low, high, xtol=1e-15)
        return float(chi) / max(approach, 1e-9)

    def force(self, d: float, rate: float, a: float) -> float:
        """Normal force [N]; a from ``damping``."""
        r, slope = self.onset(d)
        if r <= 0:
            return 0.0
        elastic = self.p["stiffness"] * r**self.n
        if self.law == "kelvin_voigt":
            return slope * max(0.0, elastic + self.p["dashpot"] * rate)
        if self.law == "adams_impact":
            s = min(r / self.p["damping_depth"], 1.0)
            return slope * max(0.0, elastic + self.p["dashpot"] * s * s * (3 - 2 * s) * rate)
        return slope * elastic * max(0.0, 1 + a * rate)

    def depth(self, d: float, speed: float) -> float:
        """Depth at which all energy is stored [m]."""
        k, n = self.p["stiffness"], self.n
        energy = 0.5 * self.p["mass"] * speed**2 + k * self.onset(d)[0] ** (n + 1) / (n + 1)
        return ((n + 1) * energy / k) ** (1 / (n + 1))


class Touch(NamedTuple):
    """One contact: start and natural time [s], its force (times), end and state there; instants that resolve it."""

    start: float
    unit: float
    force: Any
    end: float
    place: float
    rate: float
    instants: np.ndarray


def contact(case: Case, start: float, d: float, rate: float, approach: float, gravity: float) -> Touch | None:
    """From depth d [m] and rate [m/s] until the surfaces part, or five natural durations."""
    mass, a = case.p["mass"], case.damping(approach)
    # What is let go on the surface has no speed, and sags.
    depth = max(case.depth(d, rate), (mass * gravity / case.p["stiffness"]) ** (1 / case.n))
    speed = np.sqrt(2 * case.p["stiffness"] * depth ** (case.n + 1) / (case.n + 1) / mass)
    unit, q = depth / speed, 1 / (case.n + 1)
    duration = 2 * np.sqrt(np.pi) * gamma(1 + q) / gamma(0.5 + q) + 4 * case.w / depth

    def motion(_: float, y: Any) -> tuple[float, float]:
        pull = case.force(y[0] * depth, y[1] * speed, a) / mass
        return y[1], (gravity - pull) * unit / speed

    def apart(_: float, y: Any) -> float:
        return y[0] + case.w / depth

    apart.terminal, apart.direction = True, -1
    loss = a * speed + (case.p.get("dashpot", 0.0) * unit / mass)
    begin = (d / depth if d > -case.w else -case.w / depth * (1 - 1e-13) + 1e-18, rate / speed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = solve_ivp(
            motion, (0.0, 2 * duration), begin, "Radau" if loss > 30 else "DOP853",
            rtol=1e-9 if loss > 30 else 1e-11, atol=1e-13, events=apart, dense_output=True,
        )  # fmt: skip
    if not run.success:
        return None

    def force(t: np.ndarray) -> np.ndarray:
        x = (t - start) / unit
        # The last instant is one of them, on either side of rounding.
        inside = (x >= 0) & (x <= run.t[-1] * (1 + 1e-9))
        y = run.sol(np.clip(x, 0, run.t[-1]))
        found = [case.force(u * depth, v * speed, a) for u, v in y.T]
        return np.where(inside, found, 0.0)

    steps = np.interp(np.linspace(0, run.t.size - 1, SAMPLES), np.arange(run.t.size), run.t)
    end, place, rate = start + run.t[-1] * unit, run.y[0, -1] * depth, run.y[1, -1] * speed
    return Touch(start, unit, force, end, place, rate, start + steps * unit)


def touches(kind: str, case: Case) -> list[Touch]:
    """The first contacts of a case; empty where there is none."""
    p = case.p
    if kind == "impact":
        gap, speed = p["clearance_contact"], p["approach_speed"]
        if speed <= 0 and (gap > case.w or case.onset(-gap)[0] <= 0):
            return []
        free = max(gap - case.w, 0.0)
        one = contact(case, free / speed if free else 0.0, -min(gap, case.w), speed, speed, 0.0)
        return [one] if one else []
    height, found = p["drop_height"], []
    sag = (p["mass"] * GRAVITY / p["stiffness"]) ** (1 / case.n)
    free = max(height - case.w, 0.0)
    now, d, rate = np.sqrt(2 * free / GRAVITY), -min(height, case.w), np.sqrt(2 * GRAVITY * free)
    # What is remembered at the start is forgotten in the first fall.
    fall = np.sqrt(2 * GRAVITY * height)
    left = np.exp(-20 * GRAVITY * now / fall) if fall > 0 else 1.0
    first = fall + (np.sqrt(2 * GRAVITY * (height + sag)) - fall) * left
    for _ in range(CONTACTS):
        # A whole flight forgets the last touch.
        known = np.sqrt(rate**2 + 2 * GRAVITY * case.w) if found else first
        one = contact(case, float(now), d, rate, known, GRAVITY)
        if one is None:
            return []
        found.append(one)
        # What does not part, or flies less than ten contacts, is not a bounce any more.
        flight = -2 * one.rate / GRAVITY
        inside = one.place > -case.w + 1e-6 * case.depth(d, rate)
        if inside or flight < 10 * (one.end - one.start):
            break
        now, d, rate = one.end + flight, -case.w, -one.rate
    return found


def force(found: list[Touch], times: np.ndarray) -> np.ndarray:
    """Normal force of all contacts [N] at the times (T,)."""
    return sum((one.force(times) for one in found), np.zeros(times.size))


def slope(kind: str, case: Case, name: str, times: np.ndarray, found: list[Touch]) -> np.ndarray | None:
    """Derivative of the force by the logarithm of a parameter (T,), by central differences; None if a contact is lost.

    The step moves the last touch by a thousandth of its contact: more would skip what happens there, less is rounding.
    """
    last = found[-1]
    step = min(1e-5, 1e-3 * (last.end - last.start) / max(last.end, 1e-300))
    ends = []
    for sign in (1.0, -1.0):
        moved = case._replace(p=case.p | {name: case.p[name] * (1 + sign * step)})
        touched = touches(kind, moved)[: len(found)]
        if len(touched) < len(found):
            return None
        ends.append(force(touched, times))
    return (ends[0] - ends[1]) / (2 * step)
