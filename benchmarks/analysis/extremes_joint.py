"""The joint a second time, for cases of the box: shared loads in closed form, equilibria by SciPy, motion by CVODES.

Forces of equilibria and of motion are those of ``joint_casadi_field``, which shares nothing with the package but names
and the layout of the state; of windows and pilots they are read again here. Roots are sought by SciPy (MINPACK's hybrid
method) from the package's own equilibrium, shaken: which of several equilibria it is, is not what is checked.
"""

# CasADi has no types, and is not installed where types are checked.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import root

from benchmarks.analysis.extremes_mass import Case
from benchmarks.references.joint_casadi import settings
from benchmarks.references.joint_casadi_field import expressions

Numbers = Mapping[str, float]
BALLS = 6
CONTACTS = ("seat_ball", "head_ball", "cage_ball", "seat_cage", "head_cage")
# Of the package's grounding springs: per metre of a ball's load, and the least [N/m] (docs of ``joint.quasistatic``).
GROUND, LEAST = 1e-2, 1e-3
# How well a reference must know itself.
KNOWN = 2e-3


def torque(p: Numbers, time: float) -> float:
    """Resisting torque at a time [N m]: raised by a quintic."""
    s = min(max(time / p["load_ramp"], 0.0), 1.0)
    return p["load_torque"] * (10 * s**3 - 15 * s**4 + 6 * s**5)


def centre(p: Numbers, azimuth: float) -> np.ndarray:
    """Where the tracks of both races cross: in the bisecting plane, at the azimuth, on the seat's circle."""
    half = 0.5 * p["joint_angle"]
    normal = np.array([np.sin(half), 0.0, np.cos(half)])
    way = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    way[2] = -(way @ normal) / normal[2]
    square = p["pitch_radius"] ** 2 + p["offset"] ** 2
    roots = np.roots(np.array([way @ way, -2 * way[2] * p["offset"], p["offset"] ** 2 - square]))
    return np.max(roots.real) * way


def shared(p: Numbers, time: float) -> dict[str, np.ndarray]:
    """Loads of ``fidelity = "kinematic"`` [N]: shares 1 - kappa sin(phi) carry the torque, the cage the rest."""
    alpha, half = p["contact_angle"], 0.5 * p["joint_angle"]
    radius = np.hypot(p["pitch_radius"], p["offset"])
    uneven = np.tan(alpha) * np.tan(half) * radius / p["offset"]
    turns = [2 * np.pi * k / BALLS + p["drive_speed"] * time for k in range(BALLS)]
    # The head resists: azimuths run the other way.
    share = np.array([max(0.0, 1.0 + uneven * np.sin(turn)) for turn in turns])
    normal = torque(p, time) * share / (np.sum(share) * p["pitch_radius"] * np.sin(alpha))
    cage = []
    plane = np.array([np.sin(half), 0.0, np.cos(half)])
    for turn, load in zip(turns, normal, strict=True):
        mirrored = -turn
        arm = (centre(p, mirrored) - np.array([0.0, 0.0, p["offset"]])) / radius
        push = np.sin(alpha) * np.array([-np.sin(mirrored), np.cos(mirrored), 0.0]) + np.cos(alpha) * arm
        # Both tracks push the ball, mirrored at the bisecting plane; the cage takes what is normal to it.
        cage.append(-2 * load * (push @ plane))
    pilot = np.array([0.5 * abs(sum(cage))])
    return {
        "seat_ball": normal,
        "head_ball": normal,
        "cage_ball": np.array(cage),
        "seat_cage": pilot,
        "head_cage": pilot,
    }


def law_case(p: Numbers, contact: str) -> Case:
    """The laws of a contact at rest, as those of a mass."""
    return Case("memory_free", {k: p.get(f"{contact}.{k}", p[k]) for k in ("stiffness", "exponent", "smoothing")})


def guided(p: Numbers, y: np.ndarray, rates: bool = False) -> dict[str, np.ndarray]:
    """Normal forces of windows (signed) and pilots [N] in a flat state; with damping where ``rates`` count."""
    half = y.size // 2
    places, speeds = y[: 3 * BALLS].reshape(BALLS, 3), y[half : half + 3 * BALLS].reshape(BALLS, 3)
    head, cage, axis = y[18:21], y[22:25], y[25:28] / np.linalg.norm(y[25:28])
    head_rate, cage_rate, spin = y[half + 18 : half + 21], y[half + 22 : half + 25], y[half + 25 : half + 28]

    def push(contact: str, depth: Any, rate: Any) -> float:
        return law_case(p, contact).force(float(depth), float(rate), p["damping"] if rates else 0.0)

    found = {"cage_ball": np.zeros(BALLS)}
    for k in range(BALLS):
        arm = places[k] - cage
        height, climb = arm @ axis, (speeds[k] - cage_rate - np.cross(spin, arm)) @ axis
        gap = p["clearance_cage_ball"]
        found["cage_ball"][k] = push("cage_ball", height - gap, climb) - push("cage_ball", -height - gap, -climb)
    for name, apart, rate in (("seat_cage", cage, cage_rate), ("head_cage", head - cage, head_rate - cage_rate)):
        distance = np.sqrt(apart @ apart + 1e-24)
        found[name] = np.array([push(name, distance - p[f"clearance_{name}"], rate @ apart / distance)])
    return found


def grooves(loads: np.ndarray) -> dict[str, np.ndarray]:
    """Normal forces of both tracks from the field's loads, flanks added."""
    both = loads.reshape(BALLS, 2, 2).sum(2)
    return {"seat_ball": both[:, 0], "head_ball": both[:, 1]}


class Equilibrium:
    """Balance of a joint without velocities, for SciPy: unknown are displacements from no clearance, 27 [m]."""

    def __init__(self, p: Numbers):
        self.p, lever, half = p, p["pitch_radius"], 0.5 * p["joint_angle"]
        e = expressions(p)
        u, start, seat, time = (
            ca.SX.sym(name, size) for name, size in (("u", 27), ("start", 18), ("seat", 1), ("t", 1))
        )
        axis, across = ca.DM([np.sin(half), 0, np.cos(half)]), ca.DM([0, 1, 0])
        ways = (ca.cross(across, axis), across)
        long = axis + u[25] / lever * ways[0] + u[26] / lever * ways[1]
        size = ca.sqrt(ca.sumsqr(long))
        leaned = long / size
        state = ca.vertcat(start + u[:18], u[18:21], seat + u[21] / lever, u[22:25], leaned, seat, ca.SX.zeros(29))
        spring = GROUND * (abs(p["load_torque"]) / (BALLS * lever) + abs(p["axial_load"])) + LEAST
        # The field's accelerations times inertias are forces.
        pull = e.rate[29:]
        moment = pull[25:28] * p["cage_inertia"]
        lean = [ca.dot(moment, ca.cross(leaned, way)) / size / lever for way in ways]
        forces = ca.vertcat(
            pull[:18] * p["ball_mass"], pull[18:21] * p["head_mass"], pull[21] * p["head_inertia"] / lever,
            pull[22:25] * p["cage_mass"], *lean,
        )  # fmt: skip
        forces, loads = ca.substitute([forces, e.loads], [e.y, e.t], [state, time])
        rest = forces - spring * u
        self.call = ca.Function("rest", [u, start, seat, time], [rest, ca.jacobian(rest, u), loads, state])

    def displacement(self, y: np.ndarray, time: float) -> np.ndarray:
        """Unknowns of a flat state."""
        p, half = self.p, 0.5 * self.p["joint_angle"]
        axis, across = np.array([np.sin(half), 0.0, np.cos(half)]), np.array([0.0, 1.0, 0.0])
        leaned = y[25:28] / (y[25:28] @ axis)
        angles = np.array([y[21] - p["drive_speed"] * time, leaned @ np.cross(across, axis), leaned @ across])
        turn, *tilt = angles * p["pitch_radius"]
        return np.concatenate([y[:18] - self.at(time)[0], y[18:21], [turn], y[22:25], tilt])

    def at(self, time: float) -> tuple[np.ndarray, float, float]:
        """Balls' places without clearance, the seat's angle, and the time."""
        seat = self.p["drive_speed"] * time
        return np.concatenate([centre(self.p, seat + 2 * np.pi * k / BALLS) for k in range(BALLS)]), seat, time

    def solved(self, near: np.ndarray, time: float) -> dict[str, np.ndarray] | None:
        """Normal forces of the equilibrium near ``near`` [N]; None unless it is one to 1e-9 of the largest."""
        unit, where = float(np.clip(np.max(np.abs(near)), 1e-9, 1e-4)), self.at(time)

        def parts(x: np.ndarray) -> list[np.ndarray]:
            return [np.asarray(value, dtype=float) for value in self.call(x * unit, *where)]

        shaken = near / unit + 1e-3 * np.random.default_rng(0).standard_normal(27)
        found = root(
            lambda x: parts(x)[0].ravel(), shaken, jac=lambda x: parts(x)[1] * unit, method="hybr",
            options={"xtol": 1e-14},
        )  # fmt: skip
        rest, _, loads, state = parts(found.x)
        if not np.max(np.abs(rest)) <= 1e-9 * max(np.max(np.abs(loads)), 1e-6):
            return None
        return grooves(loads.ravel()) | guided(self.p, state.ravel())


def balanced(p: Numbers, times: np.ndarray, states: np.ndarray) -> dict[str, np.ndarray] | None:
    """Normal forces of the equilibria near ``states`` (T, 58), by contact (T, k) [N]; None where one is not found."""
    problem, rows = Equilibrium(p), []
    for time, y in zip(times, states, strict=True):
        found = problem.solved(problem.displacement(y, float(time)), float(time))
        if found is None:
            return None
        rows.append(found)
    return {name: np.stack([row[name] for row in rows]) for name in CONTACTS}


def moved(options: Mapping[str, Any], p: Numbers, times: np.ndarray, tolerance: float) -> dict[str, np.ndarray] | None:
    """Normal forces of a dynamic joint by CVODES, by contact (T, k) [N]; None where it did not get through.

    Restitution is the memory-free law at the damping that delivers it at the approach speed; no friction is friction
    with a coefficient of 0.
    """
    p = dict(p)
    if options.get("law") == "exact":
        p["damping"] = Case("exact", p).damping(p["approach_speed"])
    p |= {} if "friction_static" in p else {"friction_static": 0.0, "friction_dynamic": 0.0, "friction_speed": 1.0}
    e = expressions(p)
    turning = np.isin(np.arange(29), [21, 25, 26, 27, 28])
    unit = np.where(turning, 1.0 / 0.0355, 1.0)
    scales = np.concatenate([5e-5 * unit, 0.1 * unit])
    rate = ca.substitute([e.rate / scales], [e.y], [e.y * scales])[0]
    problem = {"t": e.t, "x": e.y, "ode": rate}
    solver = ca.integrator("motion", "cvodes", problem, 0.0, [*map(float, times[1:])], settings(tolerance, 100_000))
    start = nominal(p) / scales
    try:
        later = np.asarray(solver(x0=start)["xf"]).T
    except RuntimeError:
        return None
    states = np.vstack([start, later]) * scales
    loads = ca.Function("loads", [e.y], [e.loads])
    rows = [grooves(np.asarray(loads(y), dtype=float).ravel()) | guided(p, y, True) for y in states]
    return {name: np.stack([row[name] for row in rows]) for name in CONTACTS}


def nominal(p: Numbers) -> np.ndarray:
    """The start of a motion: no clearance, no load, everything turning at the drive's speed."""
    half, speed, step = 0.5 * p["joint_angle"], p["drive_speed"], 1e-6
    axis = np.array([np.sin(half), 0.0, np.cos(half)])
    turns = [2 * np.pi * k / BALLS for k in range(BALLS)]
    places = [centre(p, turn) for turn in turns]
    rates = [(centre(p, turn + step) - centre(p, turn - step)) * speed / (2 * step) for turn in turns]
    none = np.zeros(3)
    at = [*places, none, [0.0], none, axis, [0.0]]
    return np.concatenate([*at, *rates, none, [speed], none, speed * axis, [speed]])


def apart(got: dict[str, np.ndarray], right: dict[str, np.ndarray]) -> float:
    """Worst contact's error: rms over time of its worst member, over its peak; of contacts that bear anything."""
    peaks = {name: np.max(np.abs(x)) for name, x in right.items()}
    # A millionth of the greatest load is no load.
    bearing = [name for name, peak in peaks.items() if peak > 1e-6 * max(peaks.values())]
    return max(float(np.max(np.sqrt(np.mean((got[n] - right[n]) ** 2, 0))) / peaks[n]) for n in bearing)


def stacked(rows: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Instants of forces by contact, one below the other."""
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def differences(
    make: Callable[[dict[str, float]], dict[str, np.ndarray] | None], p: dict[str, float], end: float
) -> Any:
    """Derivative of forces by contact along the numbers themselves; None where differences do not know it.

    By central differences that turn the seat by a thousandth at most; those of a tenth of the step must agree.
    """
    found = []
    for step in (s * min(1e-5, 1e-3 / max(p["drive_speed"] * end, 1.0)) for s in (1.0, 0.1)):
        ends = [make({name: value * (1 + sign * step) for name, value in p.items()}) for sign in (1, -1)]
        if ends[0] is None or ends[1] is None:
            return None
        found.append({name: (ends[0][name] - ends[1][name]) / (2 * step) for name in ends[0]})
    return found[0] if max(np.max(np.abs(x)) for x in found[0].values()) > 0 and apart(*found[::-1]) < KNOWN else None
