"""Slider-crank whose slider has play in its guide: physics.md B4 (Flores, Leine and Glocker 2010).

World axes: x along the guide, y up; angles counter-clockwise. Crank angle theta_1, rod angle theta_2, slider angle
theta_3, all from +x; crank and rod have their centres of mass at mid-length, the slider its own at its pin
B = (l1 cos theta_1 + l2 cos theta_2, l1 sin theta_1 + l2 sin theta_2). No torque drives the crank.

M(q) q'' + h(q, q') = Q with
    M11 = J1 + (m1/4 + m2 + m3) l1^2, M12 = (m2/2 + m3) l1 l2 cos(theta_2 - theta_1), M22 = J2 + (m2/4 + m3) l2^2, M33 = J3,
    h1 = (m2/2 + m3) l1 l2 sin(theta_1 - theta_2) theta_2'^2 + (m1/2 + m2 + m3) g l1 cos theta_1,
    h2 = -(m2/2 + m3) l1 l2 sin(theta_1 - theta_2) theta_1'^2 + (m2/2 + m3) g l2 cos theta_2.
The slider is a rectangle of half-length a and half-width b; the walls stand at y = +-(b + c). Corners in its own axes
and gaps (positive while free), y_k the height of corner k:
    1 (-a, +b), 2 (+a, +b): g = b + c - y_k;   3 (-a, -b), 4 (+a, -b): g = b + c + y_k.
Compliant contact: d = -g, d' = -g'; the wall pushes corner k inwards with N = K d^n max(0, 1 + a_d d') and rubs it
along x with -N mu(v_k), v_k the corner's x velocity. Each corner is a contact of its own.

State: theta_1, theta_2, theta_3 [rad], their rates [rad/s], and the energy lost to damping and friction [J].
Source of the free motion's printed numbers: physics.md B4; of the geometry: there and siconos SliderCrank.
``python -m benchmarks.references.slider_guide`` checks them.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import NamedTuple

import numpy as np

from bcfj_jax.verification import oracles
from benchmarks.references.laws import FRICTION, HELPERS, exact_chi, friction, normal, stored
from benchmarks.references.solving import Motion, check, compiled, run

START = (0.0, 0.0, 0.0, 150.0, -75.0, 0.0)


@dataclasses.dataclass(frozen=True)
class SliderGuide:
    """Mechanism and laws. The mechanism is B4; the stiffness of the walls is ours, B4 has rigid ones."""

    crank: float = 0.153  # l1 [m]
    rod: float = 0.306  # l2 [m]
    half_length: float = 0.05  # a [m]
    half_width: float = 0.025  # b [m]
    clearance: float = 0.001  # c [m]
    masses: tuple[float, float, float] = (0.038, 0.038, 0.076)  # crank, rod, slider [kg]
    inertias: tuple[float, float, float] = (7.4e-5, 5.9e-4, 2.7e-6)  # kg m^2
    gravity: float = 9.81  # m/s^2
    stiffness: float = 1e9  # K of one corner [N/m^n]
    exponent: float = 1.5
    damping: float = 0.0  # a_d [s/m]
    onset: float = 0.0  # w of ``laws.onset`` [m]
    friction: str = "none"  # or "coulomb" (regularised), "brown_mcphee", "step"
    friction_static: float = 0.01
    friction_dynamic: float = 0.01
    friction_speed: float = 0.01  # m/s
    friction_fast: float = 1.0  # m/s


class Readings(NamedTuple):
    """Contact of the four corners at T times."""

    gaps: np.ndarray
    """Positive while free [m], shape (T, 4)."""
    normal: np.ndarray
    """N of each corner [N], shape (T, 4)."""
    friction: np.ndarray
    """Along x on the slider [N], shape (T, 4)."""
    energy: np.ndarray
    """Kinetic, weight, elastic [J], shape (T,)."""


def _pack(p: SliderGuide) -> np.ndarray:
    geometry = [p.crank, p.rod, p.half_length, p.half_width, p.clearance, *p.masses, *p.inertias, p.gravity]
    contact = [p.stiffness, p.exponent, p.damping, p.onset]
    rubbing = [FRICTION[p.friction], p.friction_static, p.friction_dynamic, p.friction_speed, p.friction_fast]
    return np.array([*geometry, *contact, *rubbing], float)


def _corner(k: int, y: np.ndarray, p: np.ndarray) -> tuple[float, float, float, float, float, float]:
    # Gap and its rate, x velocity, lever (x, y) about the pin, sign of the wall.
    out_x = -p[2] if k % 2 == 0 else p[2]
    side = 1.0 if k < 2 else -1.0
    s3, c3 = math.sin(y[2]), math.cos(y[2])
    r_x, r_y = out_x * c3 - side * p[3] * s3, out_x * s3 + side * p[3] * c3
    high = p[0] * math.sin(y[0]) + p[1] * math.sin(y[1]) + r_y
    v_x = -p[0] * math.sin(y[0]) * y[3] - p[1] * math.sin(y[1]) * y[4] - r_y * y[5]
    v_y = p[0] * math.cos(y[0]) * y[3] + p[1] * math.cos(y[1]) * y[4] + r_x * y[5]
    return p[3] + p[4] - side * high, -side * v_y, v_x, r_x, r_y, side


def _field(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    l1, l2, m1, m2, m3 = p[0], p[1], p[5], p[6], p[7]
    s1, c1, s2, c2 = math.sin(y[0]), math.cos(y[0]), math.sin(y[1]), math.cos(y[1])
    coupling = (0.5 * m2 + m3) * l1 * l2
    twist = coupling * math.sin(y[0] - y[1])
    q1 = -twist * y[4] * y[4] - (0.5 * m1 + m2 + m3) * p[11] * l1 * c1
    q2 = twist * y[3] * y[3] - (0.5 * m2 + m3) * p[11] * l2 * c2
    q3 = lost = 0.0
    for k in range(4):
        gap, opening, v_x, r_x, r_y, side = _corner(k, y, p)
        force, elastic = normal(-gap, -opening, p[12], p[13], p[14], p[15])
        if force > 0.0 or elastic > 0.0:
            f_x = -force * friction(int(p[16]), v_x, p[17], p[18], p[19], p[20])
            f_y = -side * force
            q1 += l1 * (c1 * f_y - s1 * f_x)
            q2 += l2 * (c2 * f_y - s2 * f_x)
            q3 += r_x * f_y - r_y * f_x
            lost += (elastic - force) * opening - f_x * v_x
    m11 = p[8] + (0.25 * m1 + m2 + m3) * l1 * l1
    m22 = p[9] + (0.25 * m2 + m3) * l2 * l2
    m12 = coupling * math.cos(y[1] - y[0])
    det = m11 * m22 - m12 * m12
    return np.array([y[3], y[4], y[5], (m22 * q1 - m12 * q2) / det, (m11 * q2 - m12 * q1) / det, q3 / p[10], lost])


def _integrate(
    p: SliderGuide, times: np.ndarray, start: np.ndarray, rtol: float, method: str, touch: bool, max_step: float
):
    packed = _pack(p)
    # Energy, and the rates that take it: some 10 J and 100 rad/s.
    scales = np.array([0.01, 0.01, 0.01, 100.0, 100.0, 100.0, 10.0])
    first = np.concatenate([start, [0.0]])
    return run(
        compiled(_field, (*HELPERS, _corner)),
        first,
        times,
        packed,
        method=method,
        rtol=rtol,
        scales=scales,
        max_step=max_step,
        event=(lambda t, y: float(np.min(gaps(p, y[None, :6])))) if touch else None,
    )


def simulate(
    p: SliderGuide,
    times: np.ndarray,
    rtol: float = 1e-12,
    method: str = "DOP853",
    start: np.ndarray | tuple[float, ...] = START,
    max_step: float = 2e-5,
) -> Motion:
    """Motion with compliant corners at ``times`` [s], shape (T,), from ``start`` (6,) at times[0]; nothing drives it.

    A touch shorter than ``max_step`` [s] may be missed.
    """
    times = np.asarray(times, float)
    states = _integrate(p, times, np.asarray(start, float), rtol, method, False, max_step).states
    return Motion(times, states[:, :6], np.zeros(times.size), states[:, 6])


def free(p: SliderGuide, times: np.ndarray, rtol: float = 1e-13, method: str = "DOP853") -> np.ndarray:
    """States (T, 6) of the motion from ``START`` without any contact, as if the walls were not there."""
    apart = dataclasses.replace(p, stiffness=0.0)
    return _integrate(apart, np.asarray(times, float), np.asarray(START), rtol, method, False, np.inf).states[:, :6]


def first_touch(p: SliderGuide, rtol: float = 1e-13, method: str = "DOP853") -> tuple[float, np.ndarray]:
    """Time [s] at which a corner first meets a wall, from ``START``, and the state (6,) then."""
    solved = _integrate(
        dataclasses.replace(p, stiffness=0.0), np.array([0.0, 0.1]), np.asarray(START), rtol, method, True, 1e-4
    )
    return solved.time, solved.state[:6]


def gaps(p: SliderGuide, states: np.ndarray) -> np.ndarray:
    """Gaps of the four corners [m], shape (T, 4), of states (T, 6)."""
    packed = _pack(p)
    return np.array([[_corner(k, y, packed)[0] for k in range(4)] for y in states])


def readings(p: SliderGuide, states: np.ndarray) -> Readings:
    """Contact of the corners and energy, of states (T, 6)."""
    packed = _pack(p)
    gap, pushed, rubbed = np.zeros((3, len(states), 4))
    for i, y in enumerate(states):
        for k in range(4):
            gap[i, k], opening, v_x, *_ = _corner(k, y, packed)
            pushed[i, k] = normal(-gap[i, k], -opening, *packed[12:16])[0]
            rubbed[i, k] = -pushed[i, k] * friction(int(packed[16]), v_x, *packed[17:])
    return Readings(gap, pushed, rubbed, energy(p, states))


def mass_matrix(p: SliderGuide, q: np.ndarray) -> np.ndarray:
    """M(q) [kg m^2], shape (3, 3), of the angles (3,)."""
    (m1, m2, m3), (j1, j2, j3) = p.masses, p.inertias
    coupling = (0.5 * m2 + m3) * p.crank * p.rod * math.cos(q[1] - q[0])
    m11, m22 = j1 + (0.25 * m1 + m2 + m3) * p.crank**2, j2 + (0.25 * m2 + m3) * p.rod**2
    return np.array([[m11, coupling, 0.0], [coupling, m22, 0.0], [0.0, 0.0, j3]])


def energy(p: SliderGuide, states: np.ndarray) -> np.ndarray:
    """Kinetic, weight and elastic energy [J], shape (T,), of states (T, 6)."""
    (m1, m2, m3), found = p.masses, []
    for y, gap in zip(states, gaps(p, states), strict=True):
        kinetic = 0.5 * y[3:] @ mass_matrix(p, y) @ y[3:]
        high = (0.5 * m1 + m2 + m3) * p.crank * math.sin(y[0]) + (0.5 * m2 + m3) * p.rod * math.sin(y[1])
        elastic = sum(stored(-g, p.stiffness, p.exponent, p.onset) for g in gap)
        found.append(kinetic + p.gravity * high + elastic)
    return np.array(found)


def rigid_impact(
    p: SliderGuide, state: np.ndarray, corners: tuple[int, ...], restitution: float
) -> tuple[np.ndarray, np.ndarray]:
    """Newton's impact of corners (0 to 3) at once, without friction.

    Returns the rates after it [rad/s], shape (3,), and the impulses [N s], one for each corner. Two corners of a slider
    that stands square and does not turn share the impulse.
    """
    packed, rows = _pack(p), []
    for k in corners:
        *_, r_x, _, side = _corner(k, state, packed)
        rows.append(-side * np.array([p.crank * math.cos(state[0]), p.rod * math.cos(state[1]), r_x]))
    w = np.array(rows)
    inverse = np.linalg.inv(mass_matrix(p, state))
    impulses = np.linalg.solve(w @ inverse @ w.T, -(1.0 + restitution) * w @ state[3:])
    return state[3:] + inverse @ w.T @ impulses, impulses


def main() -> bool:
    """Compare the free motion with the printed numbers, and the compliant impact with the rigid one."""
    p = SliderGuide()
    found = free(p, np.array([0.0, *(row[0] for row in oracles.SLIDER_GUIDE)]))[1:]
    turned = found[:, [0, 1, 3, 4]] / np.array([2.0 * math.pi, 1.0, 1.0, 1.0])
    wanted = np.array(oracles.SLIDER_GUIDE)[:, 1:]
    held = check("theta_1 [rev], theta_2 at 1 and 2 ms", turned[:, :2], wanted[:, :2], 6e-11)
    held &= check("rates at 1 and 2 ms [rad/s]", turned[:, 2:], wanted[:, 2:], 6e-8)
    touch, at = first_touch(p)
    held &= check("first touch [s]", touch, oracles.SLIDER_GUIDE_TOUCH, 6e-10)
    held &= check("corners 1 and 2 touch [m]", gaps(p, at[None])[0, :2], 0.0, 1e-15)
    approach = -(p.crank * math.cos(at[0]) * at[3] + p.rod * math.cos(at[1]) * at[4])
    print(f"     first touch {touch * 1e3:.9f} ms, approach {-approach:.6f} m/s, energy {energy(p, at[None])[0]:.6f} J")
    soft = dataclasses.replace(p, damping=exact_chi(0.4) / abs(approach))
    after, impulses = rigid_impact(p, at, (0, 1), 0.4)
    print(
        f"     rigid impact with e = 0.4: rates {after}, impulses {impulses} N s (siconos .05634, .05578 with friction)"
    )
    for stiffness, allowed in ((1e9, 3e-2), (1e12, 2e-3)):
        stiff = dataclasses.replace(soft, stiffness=stiffness)
        leave = _leave(stiff, touch, at)
        held &= check(
            f"rates after the compliant impact, K = {stiffness:.0e}, of 150 rad/s", leave / 150, after / 150, allowed
        )
    times = np.linspace(0.0, 8e-3, 161)
    cases = {
        "free": dataclasses.replace(p, stiffness=0.0),
        "elastic": p,
        "damped": soft,
        "damped, onset 2 um": dataclasses.replace(soft, onset=2e-6),
        "damped, Coulomb 0.01": dataclasses.replace(soft, friction="coulomb"),
        "damped, Brown-McPhee": dataclasses.replace(soft, friction="brown_mcphee", friction_static=0.02),
    }
    for name, case in cases.items():
        motion = simulate(case, times)
        total = energy(case, motion.states) + motion.loss
        held &= check(f"balance of energy, {name}", total / total[0], 1.0, 1e-9)
        if name == "damped, Coulomb 0.01":
            print(f"     state at 8 ms {motion.states[-1]}, lost {motion.loss[-1]:.6f} J")
    return bool(held)


def _leave(p: SliderGuide, touch: float, state: np.ndarray) -> np.ndarray:
    """Rates (3,) at the instant the first impact ends."""
    packed = _pack(p)

    def pressing(t: float, y: np.ndarray) -> float:
        # Past the middle of the impact the depth falls to 0.
        gap, opening, *_ = _corner(0, y, packed)
        return 1.0 if opening < 0.0 else -gap

    scales = np.array([0.01, 0.01, 0.01, 100.0, 100.0, 100.0, 10.0])
    times, start = np.array([touch, touch + 2e-3]), np.concatenate([state, [0.0]])
    field = compiled(_field, (*HELPERS, _corner))
    return run(field, start, times, packed, scales=scales, max_step=1e-6, event=pressing).state[3:6]


if __name__ == "__main__":
    sys.exit(not main())
