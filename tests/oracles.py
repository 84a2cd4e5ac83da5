"""Independent oracles: one mass driven against one wall by a force law, integrated by SciPy's DOP853."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from typing import NamedTuple

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

# Smallest penetration at which a law counts as touching: an impact starts just inside, so that a law
# that jumps at first touch is seen on its contact side.
_JUST_INSIDE = 1e-30


def agrees(value: float, printed: str, slack: float = 0.01) -> bool:
    """Whether a value rounds to the printed digits; ``slack`` in units of the last one, for the doubly rounded."""
    unit = 10.0 ** Decimal(printed).as_tuple().exponent
    return abs(float(value) - float(printed)) <= (0.5 + slack) * unit


def within(expected, relative: float):
    """Equal to a relative tolerance alone: pytest's 1e-12 of absolute slack is much for a metre's millionth."""
    return pytest.approx(expected, rel=relative, abs=0.0)


def close(found, expected, relative):
    """Derivatives over relative changes, equal to a tolerance in units of each column's largest entry.

    A column below 1 % of the largest of all counts as 1 %: smoothing changes next to nothing, by design,
    and what it does change is below the accuracy of the run.
    """
    found, expected = np.asarray(found), np.asarray(expected)
    size = np.maximum(np.abs(expected).max(axis=0), 1e-2 * np.abs(expected).max())
    assert np.all(np.abs(found - expected) <= relative * size), (np.abs(found - expected) / size).max()


class Impact(NamedTuple):
    """What one impact delivers, SI."""

    restitution: float
    duration: float
    penetration: float
    peak: float


def impact(force: Callable[[float, float], float], mass: float, speed: float, onset: float = 0.0) -> Impact:
    """Strike a wall: mass * d'' = -force(d, d') from d = -onset with d' = speed until d is back there.

    Args:
        force: force(d, d') on floats; called with numbers only.
        mass: effective mass.
        speed: approach speed > 0.
        onset: distance before d = 0 at which the force begins.
    """

    def motion(_, state):
        return state[1], -force(state[0], state[1]) / mass

    def separated(_, state):
        return state[0] + onset

    def deepest(_, state):
        return state[1]

    separated.terminal, separated.direction = True, -1
    run = solve_ivp(
        motion, (0.0, np.inf), (_JUST_INSIDE - onset, speed), method="DOP853", rtol=1e-12, atol=(1e-18, 1e-14 * speed),
        events=(separated, deepest), dense_output=True,
    )  # fmt: skip
    end, turn = run.t_events[0][0], run.t_events[1][0]

    def pull(t: float) -> float:
        return -float(force(*run.sol(t)))

    # Every law here peaks once, before the greatest penetration or at it.
    grid = np.linspace(0.0, turn, 65)
    best = int(np.argmin([pull(t) for t in grid]))
    bracket = (grid[max(best - 1, 0)], grid[min(best + 1, 64)])
    peak = -minimize_scalar(pull, bounds=bracket, method="bounded", options={"xatol": 1e-9 * turn}).fun
    return Impact(-run.y_events[0][0][1] / speed, end, run.y_events[1][0][0], peak)


def compiled(law, coefficients) -> Callable[[float, float], float]:
    """The force of a law of the package as a function of two numbers."""
    force = jax.jit(law.force)
    return lambda penetration, rate: float(force(penetration, rate, coefficients))


def strike(law, coefficients, mass: float, speed: float) -> Impact:
    """``impact`` under a law of the package."""
    return impact(compiled(law, coefficients), mass, speed)


def family(chi: float, exponent: float, stiffness: float = 1.0, speed: float = 1.0) -> Callable[[float, float], float]:
    """K d^n (1 + chi d'/v0) in plain Python, for the tests that must not lean on the package."""
    return lambda d, rate: stiffness * max(d, 0.0) ** exponent * max(1.0 + chi * rate / speed, 0.0)
