"""Tight integration of the references with SciPy's methods, of fields that numba compiles where it can be imported."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import DOP853, LSODA, Radau
from scipy.optimize import brentq

Field = Callable[[float, np.ndarray, np.ndarray], np.ndarray]
METHODS: dict[str, Any] = {"DOP853": DOP853, "LSODA": LSODA, "Radau": Radau}
MAX_STEPS = 5_000_000
_COMPILED: dict[Any, Any] = {}


class Solved(NamedTuple):
    """What ``run`` returns."""

    states: np.ndarray
    """States at the times up to the end, shape (<= T, n)."""
    time: float
    """End [s]: the last of the times, or where the event stopped it."""
    state: np.ndarray
    """State at the end, shape (n,)."""
    stopped: bool
    """Whether the event stopped it."""
    steps: int
    """Accepted steps."""


class Motion(NamedTuple):
    """Motion of a mechanism at T times [s]: states (T, n), work of what drives it and loss to damping and friction [J], (T,)."""

    times: np.ndarray
    states: np.ndarray
    work: np.ndarray
    loss: np.ndarray


def compiled(field: Field, helpers: Sequence[Callable] = ()) -> Field:
    """``field`` (t, y, p) compiled by numba, or as it is where numba cannot be imported.

    ``helpers`` are the plain functions that it calls by their global names. Compiling takes seconds, once a process.
    """
    if field not in _COMPILED:
        try:
            numba = importlib.import_module("numba")
            extending = importlib.import_module("numba.extending")
        except ImportError:
            return field
        for helper in helpers:
            if helper not in _COMPILED:
                _COMPILED[helper] = extending.register_jitable(helper)
        _COMPILED[field] = numba.njit(field)
    return _COMPILED[field]


def run(
    field: Field,
    start: np.ndarray,
    times: np.ndarray,
    parameters: np.ndarray,
    *,
    method: str = "DOP853",
    rtol: float = 1e-12,
    scales: np.ndarray | float = 1.0,
    max_step: float = np.inf,
    event: Callable[[float, np.ndarray], float] | None = None,
) -> Solved:
    """Integrate from times[0] to times[-1], or to the first zero of ``event``.

    A state at a requested time is not interpolated: it is the end of one more step of the method from the last accepted
    state, so that it errs no more than a step. (The dense output of Radau is a cubic.) LSODA interpolates with its own
    order.

    Args:
        field: y' = field(t, y, parameters), shape (n,).
        start: state at times[0], shape (n,).
        times: rising, shape (T,).
        method: DOP853, LSODA or Radau.
        scales: typical size of each state, shape (n,); the absolute tolerance is ``rtol`` times it.
        event: stops where it falls from above 0 to 0 or below, looked for at the ends of steps only.
    """
    times = np.asarray(times, float)
    end = float(times[-1])

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return field(t, y, parameters)

    options = {"rtol": rtol, "atol": rtol * np.broadcast_to(scales, np.shape(start)), "max_step": max_step}
    solver = METHODS[method](rate, float(times[0]), np.asarray(start, float), end, **options)
    states, taken, steps = [np.asarray(start, float)], 1, 0
    level = event(float(times[0]), solver.y) if event else 1.0
    while solver.status == "running":
        old_time, old_state, steps = solver.t, solver.y.copy(), steps + 1
        message = solver.step()
        if solver.status == "failed" or steps > MAX_STEPS:
            raise RuntimeError(f"{method} at t = {solver.t}: {message}")
        dense: Any = solver.dense_output() if method == "LSODA" else None

        def landed(t: float, old_time: float = old_time, old_state: np.ndarray = old_state, dense: Any = dense):
            if t in (old_time, solver.t):
                return old_state if t == old_time else solver.y.copy()
            if dense is not None:
                return dense(t)
            again = METHODS[method](rate, old_time, old_state, t, first_step=t - old_time, **options)
            while again.status == "running":
                again.step()
            return again.y

        reached, stopped = solver.t, False
        before, level = level, event(solver.t, solver.y) if event else 1.0
        if event and before > 0.0 >= level:
            reached = root(lambda t: event(t, landed(t)), old_time, solver.t)
            stopped = True
        while taken < times.size and times[taken] <= reached:
            states.append(landed(times[taken]))
            taken += 1
        if stopped:
            return Solved(np.array(states), reached, landed(reached), True, steps)
    return Solved(np.array(states), end, states[-1], False, steps)


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """A zero of ``function`` between two points where its signs differ, to the last digits."""
    find: Any = brentq
    return float(find(function, low, high, xtol=1e-18, rtol=1e-15))


def check(name: str, found: Any, expected: Any, tolerance: float) -> bool:
    """Print one comparison: the greatest absolute difference, and whether it is within ``tolerance``."""
    error = float(np.max(np.abs(np.asarray(found, float) - np.asarray(expected, float))))
    held = error <= tolerance
    print(f"{'ok  ' if held else 'FAIL'} {name}: error {error:.2e}, allowed {tolerance:.1e}")
    return held
