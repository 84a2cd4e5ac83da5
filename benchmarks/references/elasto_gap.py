"""Modelica's ElastoGap: a body on a spring and a damper between two stops; physics.md, end of section 1.2.

Between two flanges with s_rel = s_b - s_a, contact where s_rel < s_rel0:
    f_c = -c |s_rel - s_rel0|^n,  f_d = d v_rel limited to [f_c, -f_c],  f = f_c + f_d,  else f = 0.
f > 0 pulls the flanges together; 2 f_c <= f <= 0, so the stop never pulls. The law is not smooth: d v_rel is limited
at first touch, where the stop presses with 2 |f_c|, and again while it parts, where it presses with nothing.

The body of mass m stands at s [m], positive to the right, with velocity v. The lower stop has its flange_a on the wall
and presses the body right where s < ``lower``, with depth p = lower - s; the upper one presses it left where
s > ``upper``, p = s - upper. With the depth's rate p' > 0 while approaching, a stop presses with
P = c p^n + clip(d p', -c p^n, c p^n), and
    m v' = P_lower - P_upper - k (s - s_0) - b v + F_0 + F_1 sin(Omega t).
The energy put in by the drive (of the constant force F_0 too) and lost to dampers are integrated beside.

``python -m benchmarks.references.elasto_gap`` checks closed forms of n = 1 and the balance of energy.
"""

from __future__ import annotations

import dataclasses
import math
import sys

import numpy as np
from scipy.linalg import expm

from benchmarks.references.laws import hertz
from benchmarks.references.solving import Motion, check, compiled, root, run


@dataclasses.dataclass(frozen=True)
class ElastoGap:
    """Body, stops, spring and drive. The defaults are ``mass2`` of Modelica.Mechanics.Translational.Examples.ElastoGap.

    There two gaps with s_rel0 = 1.5 m hang between walls at -2 and 2 m, and the body starts at rest at s = 2 m.
    """

    mass: float = 1.0  # m [kg]
    stiffness: float = 10.0  # c [N/m^n]
    damping: float = 1.5  # d [N s/m]
    exponent: float = 1.0  # n >= 1
    lower: float = -0.5  # the body presses the lower stop below it [m]; -inf: no such stop
    upper: float = 0.5  # and the upper stop above it [m]; inf: no such stop
    spring: float = 0.0  # k [N/m]
    spring_rest: float = 0.0  # s_0 [m]
    damper: float = 0.0  # b [N s/m]
    force: float = 0.0  # F_0 [N]
    drive: float = 0.0  # F_1 [N]
    frequency: float = 0.0  # Omega [rad/s]
    start: tuple[float, float] = (2.0, 0.0)  # s [m], v [m/s]


def _press(depth: float, rate: float, c: float, d: float, n: float) -> tuple[float, float]:
    # Whole force of a stop and its part by damping.
    if depth <= 0.0:
        return 0.0, 0.0
    elastic = c * depth**n
    damped = min(max(d * rate, -elastic), elastic)
    return elastic + damped, damped


def _field(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    low, low_damped = _press(p[4] - y[0], -y[1], p[1], p[2], p[3])
    high, high_damped = _press(y[0] - p[5], y[1], p[1], p[2], p[3])
    put_in = p[9] + p[10] * math.sin(p[11] * t)
    total = low - high - p[6] * (y[0] - p[7]) - p[8] * y[1] + put_in
    loss = (high_damped - low_damped) * y[1] + p[8] * y[1] * y[1]
    return np.array([y[1], total / p[0], put_in * y[1], loss])


def _pack(g: ElastoGap) -> np.ndarray:
    stops = [g.stiffness, g.damping, g.exponent, g.lower, g.upper]
    return np.array([g.mass, *stops, g.spring, g.spring_rest, g.damper, g.force, g.drive, g.frequency], float)


def simulate(
    g: ElastoGap, times: np.ndarray, rtol: float = 1e-13, method: str = "DOP853", max_step: float = np.inf
) -> Motion:
    """Motion at ``times`` [s], shape (T,), from ``start`` at times[0]: states s [m], v [m/s].
    A touch shorter than ``max_step`` [s] may be missed.
    """
    times = np.asarray(times, float)
    start = np.array([*g.start, 0.0, 0.0])
    y = run(compiled(_field, (_press,)), start, times, _pack(g), method=method, rtol=rtol, max_step=max_step).states
    return Motion(times, y[:, :2], y[:, 2], y[:, 3])


def stop_forces(g: ElastoGap, states: np.ndarray) -> np.ndarray:
    """Forces of the lower and the upper stop on the body, along +s [N], shape (T, 2): the first >= 0, the second <= 0."""
    law = g.stiffness, g.damping, g.exponent
    return np.array([[_press(g.lower - s, -v, *law)[0], -_press(s - g.upper, v, *law)[0]] for s, v in states])


def flange_force(s_rel: float, v_rel: float, s_rel0: float, stiffness: float, damping: float, exponent: float) -> float:
    """The component's f [N] itself, as Modelica writes it: <= 0, and 0 where s_rel >= s_rel0."""
    if s_rel >= s_rel0:
        return 0.0
    elastic = -stiffness * abs(s_rel - s_rel0) ** exponent
    return elastic + min(max(damping * v_rel, elastic), -elastic)


def energy(g: ElastoGap, states: np.ndarray) -> np.ndarray:
    """Kinetic energy, that of the spring and of the stops' elastic part [J], shape (T,)."""
    s, v = np.asarray(states).T
    depth = np.maximum(0.0, np.maximum(g.lower - s, s - g.upper))
    elastic = g.stiffness * depth ** (g.exponent + 1.0) / (g.exponent + 1.0)
    return 0.5 * g.mass * v**2 + 0.5 * g.spring * (s - g.spring_rest) ** 2 + elastic


def restitution(mass: float, stiffness: float, damping: float) -> float:
    """Speed after over speed before a free body meets one stop with n = 1: the same for every speed.

    While d p' > c p the stop has the stiffness 2 c, until tan(w t) = d w/c with w = sqrt(2 c/m); then it is a spring
    beside a damper, until c p + d p' = 0; from then on it presses no more.
    """
    w = math.sqrt(2.0 * stiffness / mass)
    turn = math.atan(damping * w / stiffness)
    state = np.array([math.sin(turn) / w, math.cos(turn)])
    matrix = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])

    def pressing(t: float) -> float:
        depth, rate = expm(matrix * t) @ state
        return stiffness * depth + damping * rate

    # The force falls to 0 for the first time within half a period; overdamped, within some damper times.
    late = step = 0.05 / w
    while pressing(late) > 0.0:
        late += step
    end = root(pressing, late - step, late)
    return float(-(expm(matrix * end) @ state)[1])


def free_period(g: ElastoGap, speed: float) -> float:
    """Period of the undamped body that flies between its two stops at ``speed`` [s]; no spring, no drive."""
    contact = hertz(g.mass, speed, g.stiffness, g.exponent)[2]
    return 2.0 * (g.upper - g.lower) / speed + 2.0 * contact


def main() -> bool:
    """Check closed forms and the balance of energy of free and driven motion."""
    held = True
    for n in (1.0, 1.5):
        bare = ElastoGap(stiffness=1e3, damping=0.0, exponent=n, start=(0.0, 2.0))
        period = free_period(bare, 2.0)
        motion = simulate(bare, np.linspace(0.0, 3.0 * period, 61))
        held &= check(f"period without damping, n = {n}: state after 3", motion.states[-1], (0.0, 2.0), 2e-9)
        total = energy(bare, motion.states)
        held &= check(f"energy without damping, n = {n}", total / total[0], 1.0, 1e-10)
    for damping in (1.0, 10.0, 40.0, 200.0):
        stop = ElastoGap(stiffness=1e3, damping=damping, upper=math.inf, start=(-0.4, -2.0))
        speed = simulate(stop, np.array([0.0, 1.2]), max_step=5e-3).states[-1, 1]
        expected = restitution(1.0, 1e3, damping)
        held &= check(f"restitution at d = {damping}: {expected:.9f}", speed / 2.0, expected, 1e-9)
    sample = [(-0.51, v) for v in (-2.0, -0.05, 0.05, 2.0)]
    g = ElastoGap()
    as_written = [-flange_force(s + 2.0, v, 1.5, g.stiffness, g.damping, 1.0) for s, v in sample]
    held &= check(
        "force of the lower stop as Modelica writes it [N]", stop_forces(g, np.array(sample))[:, 0], as_written, 1e-14
    )
    held &= check("and limited: 2 c p, 0 [N]", [as_written[0], as_written[3]], [0.2, 0.0], 1e-14)
    cases = {
        "Modelica's example": g,
        "driven, spring, two stops": ElastoGap(
            1.0, 1e4, 20.0, 1.5, -1e-3, 1e-3, 400.0, 0.0, 0.5, -1.0, 30.0, 60.0, (0.0, 0.0)
        ),
    }
    for name, case in cases.items():
        times = np.linspace(0.0, 5.0 if case is g else 1.0, 201)
        motion = simulate(case, times, max_step=1e-3)
        rest = energy(case, motion.states) - motion.work + motion.loss
        held &= check(f"balance of energy, {name}", rest, rest[0], 1e-10)
        other = simulate(case, times, 1e-12, "LSODA", 1e-3)
        held &= check(f"LSODA, {name}", other.states, motion.states, 1e-8)
        print(f"     last state {motion.states[-1]}")
    return bool(held)


if __name__ == "__main__":
    sys.exit(not main())
