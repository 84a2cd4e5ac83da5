"""Contacts of a mass on the exact law K d^n (1 + a d'), nothing smoothed, by SciPy's DOP853 up to the event that ends them.

Shares no code with the package. Contacts are integrated in their natural sizes: d = depth x, t = depth/speed s, where depth is
that of the undamped impact. Flights are closed forms.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp


class Contact(NamedTuple):
    """Begin and end [s], speeds there [m/s], and ``inside``: depth [m] and rate [m/s] at times between (2, T)."""

    law: Mapping[str, float]
    begin: float
    end: float
    approach: float
    rebound: float
    inside: Any

    def force(self, times: np.ndarray) -> np.ndarray:
        """Force [N] at times (T,) [s], 0 outside."""
        within = (times >= self.begin) & (times <= self.end)
        return np.where(within, power_law(self.law, *self.inside(np.clip(times, self.begin, self.end))), 0.0)

    def depth(self, times: np.ndarray) -> np.ndarray:
        """Depth [m] at times (T,) [s]; before and after it that of a free flight without gravity."""
        before, after = np.minimum(times - self.begin, 0.0), np.maximum(times - self.end, 0.0)
        depth = self.inside(np.clip(times, self.begin, self.end))[0]
        return depth + self.approach * before - self.rebound * after


def power_law(law: Mapping[str, float], depth: Any, rate: Any) -> Any:
    """K d^n (1 + a d') [N], which never pulls; of ``stiffness``, ``exponent`` and ``damping``."""
    k, n, a = (law[name] for name in ("stiffness", "exponent", "damping"))
    return k * np.maximum(depth, 0.0) ** n * np.maximum(1.0 + a * rate, 0.0)


class Stays(ArithmeticError):
    """The mass does not leave again: gravity presses it deeper than it bounces."""


def contact(law: Mapping[str, float], mass: float, speed: float, gravity: float = 0.0, begin: float = 0.0) -> Contact:
    """The contact of a mass [kg] that arrives with a speed [m/s] under gravity [m/s^2]."""
    n = law["exponent"]
    depth = (mass * speed**2 * (n + 1.0) / (2.0 * law["stiffness"])) ** (1.0 / (n + 1.0))
    unit, sizes = depth / speed, np.array([[depth], [speed]])

    def motion(_: float, s: np.ndarray) -> tuple[float, float]:
        return s[1], (gravity - power_law(law, depth * s[0], speed * s[1]) / mass) * unit / speed

    def apart(_: float, s: np.ndarray) -> float:
        return s[0] - 1e-12

    apart.terminal, apart.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    run: Any = solve_ivp(
        motion, (0.0, 1e3), (1e-11, 1.0), "DOP853", rtol=1e-12, atol=1e-15, events=apart, dense_output=True
    )
    if not run.t_events[0].size:
        raise Stays
    end, rebound = begin + unit * float(run.t_events[0][0]), -speed * float(run.y_events[0][0][1])
    return Contact(law, begin, end, speed, rebound, lambda times: sizes * run.sol((times - begin) / unit))


def bounces(law: Mapping[str, float], mass: float, height: float, gravity: float, count: int) -> list[Contact]:
    """The first contacts of a mass that is dropped from a height [m]; fewer where it comes to rest."""
    begin, speed = float(np.sqrt(2.0 * height / gravity)), float(np.sqrt(2.0 * gravity * height))
    found: list[Contact] = []
    with suppress(Stays):
        while len(found) < count:
            found.append(contact(law, mass, speed, gravity, begin))
            begin, speed = found[-1].end + 2.0 * found[-1].rebound / gravity, found[-1].rebound
    return found
