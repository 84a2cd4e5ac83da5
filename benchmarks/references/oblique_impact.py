"""A solid sphere meets a plane at an angle: physics.md B16 (Kharaz, Gorham and Salman 2001) and section 2.

The plane lies below the sphere. d is the penetration [m] and d' > 0 the approach; v [m/s] is the velocity of the centre
along the plane; the spin w [rad/s] is positive where it rolls the sphere towards +v. Slip of the sphere's contact point:
u = v - R w. With the inertia (2/5) m R^2, the normal force N of ``laws.normal`` and the friction T on the sphere
along +v,
    m d'' = -N,   m v' = T,   (2/5) m R^2 w' = -R T,   hence u' = (7/2) T/m.
The angle of impact theta is from the normal: d' = V cos(theta), v = V sin(theta). Gravity is left out.

Friction T by ``friction``:
    none, coulomb (mu_d tanh(u/v_t)), brown_mcphee, step:  T = -mu(u) N of ``laws.friction``;
    lugre:  z' = u - |u| z/g(u), g = [mu_d + (mu_s - mu_d) exp(-(u/v_t)^2)]/sigma_0, T = -N (sigma_0 z + sigma_1 z'),
        the LuGre law as a coefficient: a bristle whose stiffness sigma_0 N [N/m] follows the load;
    spring: the same z' with g = mu_d N/k_t, k_t = ratio * n K r^(n-1) r'(d)^2 [N/m]: T = -k_t z within +-mu_d N. The tangential
        stiffness is that of the contact, ``ratio`` times the normal one; Mindlin's ratio is 4 G*/E*. The force changes
        with k_t at constant z, so that a contact that unloads loses no elastic energy to slip but hides some: the
        energy balance does not hold for it.

Closed forms, e_n the normal restitution, w_0 the spin before: ``gross_sliding`` and ``sticking``.
``python -m benchmarks.references.oblique_impact`` checks them; ``benchmarks.models.oblique_impact``
puts Kharaz's measurements beside.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import NamedTuple

import numpy as np

from benchmarks.references.laws import (
    FRICTION,
    HELPERS,
    exact_chi,
    friction,
    hertz,
    normal,
    onset,
    reduced_modulus,
    restitution,
    stored,
)
from benchmarks.references.solving import check, compiled, run

# Measured by Kharaz, Gorham and Salman (2001), digitised: angle of impact from the normal [deg], and tangential
# restitution [-] or spin after [rad/s].
KHARAZ = {
    "restitution": np.array([
        (2.03, 0.7938), (3.93, 0.7450), (9.63, 0.6728), (20.08, 0.5964), (30.22, 0.6883), (39.30, 0.7719),
        (49.55, 0.8469), (59.84, 0.9019),
    ]),
    "spin": np.array([
        (6.00, 135.6), (10.98, 264.5), (21.19, 577.0), (31.09, 612.6), (39.03, 595.5), (50.22, 452.9), (60.25, 381.3),
    ]),
}  # fmt: skip
BRISTLES = {"lugre": 4, "spring": 5}


@dataclasses.dataclass(frozen=True)
class Impact:
    """Sphere, plane and laws; the defaults are Kharaz's: aluminium oxide on glass, e_n = 0.98, mu = 0.092."""

    radius: float = 2.5e-3  # R [m]
    mass: float = 4000.0 * 4.0 / 3.0 * math.pi * 2.5e-3**3  # kg
    stiffness: float = 4.0 / 3.0 * reduced_modulus(380e9, 0.23, 70e9, 0.25) * 2.5e-3**0.5  # K [N/m^n]
    exponent: float = 1.5
    speed: float = 3.9  # V [m/s]
    angle: float = math.radians(30.0)  # theta [rad]
    spin: float = 0.0  # w_0 [rad/s]
    restitution: float | None = 0.98  # e_n, from which ``damping`` follows at each approach speed; None: use damping
    damping: float = 0.0  # a of the memory-free law [s/m]
    onset: float = 0.0  # w of ``laws.onset`` [m]
    friction: str = "coulomb"
    friction_static: float = 0.092
    friction_dynamic: float = 0.092
    friction_speed: float = 1e-3  # v_t [m/s]
    friction_fast: float = 1.0  # of "step" [m/s]
    bristle_stiffness: float = 1e6  # sigma_0, of lugre [1/m]
    bristle_damping: float = 0.0  # sigma_1, of lugre [s/m]
    stiffness_ratio: float = 0.8  # k_t over the normal stiffness, of spring

    @property
    def approach(self) -> float:
        """d' at touch [m/s]."""
        return self.speed * math.cos(self.angle)

    @property
    def law_damping(self) -> float:
        """a [s/m]."""
        return self.damping if self.restitution is None else exact_chi(self.restitution) / self.approach


class Rebound(NamedTuple):
    """What the impact leaves."""

    normal_restitution: float
    """Departure over approach speed [-]."""
    tangential_restitution: float
    """v after over v before, of the centre [-]; NaN at normal incidence."""
    spin: float
    """w after [rad/s]."""
    slip: float
    """u after [m/s]."""
    tangential_velocity: float
    """v after [m/s]."""
    duration: float
    """Time in contact [s]."""
    loss: float
    """Kinetic energy before minus after [J]."""


class History(NamedTuple):
    """Course of the impact at T times."""

    times: np.ndarray
    """From first touch [s], shape (T,)."""
    states: np.ndarray
    """d [m], d', v [m/s], w [rad/s], bristle z [m]; shape (T, 5)."""
    normal: np.ndarray
    """N [N], shape (T,)."""
    tangential: np.ndarray
    """T on the sphere along +v [N], shape (T,)."""
    slip: np.ndarray
    """u [m/s], shape (T,)."""
    loss: np.ndarray
    """Energy lost to damping and friction [J], shape (T,); meant for friction without bristles."""


def _pack(p: Impact) -> np.ndarray:
    kind = (FRICTION | BRISTLES)[p.friction]
    contact = [p.mass, p.radius, p.stiffness, p.exponent, p.law_damping, p.onset]
    rubbing = [kind, p.friction_static, p.friction_dynamic, p.friction_speed, p.friction_fast]
    # Below this length a spring is never taken to yield: it keeps 1/g finite at the first touch.
    least = 1e-9 * hertz(p.mass, p.approach, p.stiffness, p.exponent)[0]
    return np.array([*contact, *rubbing, p.bristle_stiffness, p.bristle_damping, p.stiffness_ratio, least], float)


def _loads(y: np.ndarray, p: np.ndarray) -> tuple[float, float, float, float]:
    # N, its elastic part, T, z'.
    force, elastic = normal(y[0], y[1], p[2], p[3], p[4], p[5])
    slip, kind = y[2] - p[1] * y[3], int(p[6])
    if kind == 4:
        g = (p[8] + (p[7] - p[8]) * math.exp(-((slip / p[9]) ** 2))) / p[11]
        rate = slip - abs(slip) * y[4] / g
        return force, elastic, -force * (p[11] * y[4] + p[12] * rate), rate
    if kind == 5:
        r, slope = onset(y[0], p[5])
        if r <= 0.0 or force <= 0.0:
            return force, elastic, 0.0, slip
        tangent = p[13] * p[2] * p[3] * r ** (p[3] - 1.0) * slope * slope
        limit = p[8] * force
        rate = slip - abs(slip) * y[4] / max(limit / tangent, p[14])
        return force, elastic, -min(max(tangent * y[4], -limit), limit), rate
    return force, elastic, -force * friction(kind, slip, p[7], p[8], p[9], p[10]), 0.0


def _field(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    force, elastic, tangential, rate = _loads(y, p)
    loss = (force - elastic) * y[1] - tangential * (y[2] - p[1] * y[3])
    spin = -2.5 * tangential / (p[0] * p[1])
    return np.array([y[1], -force / p[0], tangential / p[0], spin, rate, loss])


def _solve(p: Impact, times: np.ndarray | None, rtol: float, method: str):
    depth, _, duration = hertz(p.mass, p.approach, p.stiffness, p.exponent)
    unit = 0.5 * p.mass * p.speed**2
    scales = np.array([depth, p.speed, p.speed, p.speed / p.radius, 1e-2 * depth, unit])
    start = np.array([-p.onset, p.approach, p.speed * math.sin(p.angle), p.spin, 0.0, 0.0])

    def inside(t: float, y: np.ndarray) -> float:
        return 1.0 if y[1] > 0.0 else y[0] + p.onset

    until = np.array([0.0, 50.0 * duration + 4.0 * p.onset / p.approach]) if times is None else times
    field = compiled(_field, (*HELPERS, _loads))
    event = inside if times is None else None
    return run(
        field, start, until, _pack(p), method=method, rtol=rtol, scales=scales, max_step=0.01 * duration, event=event
    )


def rebound(p: Impact, rtol: float = 1e-12, method: str = "DOP853") -> Rebound:
    """Integrate from first touch until the sphere parts from the plane."""
    solved = _solve(p, None, rtol, method)
    if not solved.stopped:
        raise RuntimeError("the sphere does not leave the plane")
    _, rate, v, spin, *_ = solved.state.tolist()
    before = p.speed * math.sin(p.angle)
    inertia = 0.4 * p.mass * p.radius**2
    lost = 0.5 * p.mass * (p.speed**2 - rate**2 - v**2) + 0.5 * inertia * (p.spin**2 - spin**2)
    e_t = v / before if before else math.nan
    return Rebound(-rate / p.approach, e_t, spin, v - p.radius * spin, v, solved.time, lost)


def history(p: Impact, times: np.ndarray, rtol: float = 1e-12, method: str = "DOP853") -> History:
    """Course at ``times`` [s] from first touch, shape (T,); free flight after the contact is included."""
    packed = _pack(p)
    y = _solve(p, np.asarray(times, float), rtol, method).states
    loads = np.array([_loads(row, packed) for row in y])
    return History(np.asarray(times, float), y[:, :5], loads[:, 0], loads[:, 2], y[:, 2] - p.radius * y[:, 3], y[:, 5])


def energy(p: Impact, course: History) -> np.ndarray:
    """Kinetic, and elastic in the normal direction [J], shape (T,)."""
    d, rate, v, spin, _ = course.states.T
    kinetic = 0.5 * p.mass * (rate**2 + v**2 + 0.4 * (p.radius * spin) ** 2)
    return kinetic + np.array([stored(a, p.stiffness, p.exponent, p.onset) for a in d])


def gross_sliding(p: Impact) -> Rebound:
    """Closed form where the slip keeps its direction, for |u_0| >= (7/2) mu_d (1 + e_n) d'.

    v' = v - mu (1 + e_n) d' sgn(u_0) and w' = w_0 + (5/2) mu (1 + e_n) d' sgn(u_0)/R: e_t = 1 - mu (1 + e_n)/tan(theta)
    without spin before. The duration is not given (NaN).
    """
    e_n = _normal_restitution(p)
    before = p.speed * math.sin(p.angle)
    way = math.copysign(p.friction_dynamic * (1.0 + e_n) * p.approach, before - p.radius * p.spin)
    return _after(p, e_n, before - way, p.spin + 2.5 * way / p.radius)


def sticking(p: Impact) -> Rebound:
    """Closed form of the rigid sphere that ends rolling: v' = (5 v + 2 R w_0)/7, w' = v'/R; NaN duration.

    e_t = 5/7 without spin before. It holds for |u_0| <= (7/2) mu (1 + e_n) d'.
    """
    after = (5.0 * p.speed * math.sin(p.angle) + 2.0 * p.radius * p.spin) / 7.0
    return _after(p, _normal_restitution(p), after, after / p.radius)


def rolling_angle(p: Impact) -> float:
    """Angle of impact [rad] from which on the rigid sphere, without spin before, slides to the end."""
    return math.atan(3.5 * p.friction_dynamic * (1.0 + _normal_restitution(p)))


def rigid(p: Impact) -> Rebound:
    """The closed form that holds at the angle, without spin before."""
    return gross_sliding(p) if p.angle >= rolling_angle(p) else sticking(p)


def elastic_shear(p: Impact, times: np.ndarray) -> np.ndarray:
    """Slip u [m/s] of the law "spring" for n = 1 without damping or limit of friction: u_0 cos(sqrt(7/2 ratio K/m) t)."""
    slip = p.speed * math.sin(p.angle) - p.radius * p.spin
    return slip * np.cos(math.sqrt(3.5 * p.stiffness_ratio * p.stiffness / p.mass) * np.asarray(times))


def _normal_restitution(p: Impact) -> float:
    return restitution(p.law_damping * p.approach)


def _after(p: Impact, e_n: float, v: float, spin: float) -> Rebound:
    before = p.speed * math.sin(p.angle)
    kinetic = p.speed**2 + 0.4 * (p.radius * p.spin) ** 2
    kinetic -= (e_n * p.approach) ** 2 + v**2 + 0.4 * (p.radius * spin) ** 2
    e_t = v / before if before else math.nan
    return Rebound(e_n, e_t, spin, v - p.radius * spin, v, math.nan, 0.5 * p.mass * kinetic)


def mindlin_ratio(young_1: float, poisson_1: float, young_2: float, poisson_2: float) -> float:
    """Tangential over normal stiffness of a Hertz contact before slip, 4 G*/E*, 1/G* = sum of 2 (2 - nu)(1 + nu)/E."""
    shear = 1.0 / sum(2.0 * (2.0 - nu) * (1.0 + nu) / e for e, nu in ((young_1, poisson_1), (young_2, poisson_2)))
    return 4.0 * shear / reduced_modulus(young_1, poisson_1, young_2, poisson_2)


# Of Kharaz's pair of materials.
KHARAZ_MINDLIN = mindlin_ratio(380e9, 0.23, 70e9, 0.25)


def main() -> bool:
    """Check closed forms and the balance of energy."""
    p = Impact(angle=math.radians(60.0), friction_speed=1e-3)
    scale = np.array([1.0, 1.0, 1e3, 1.0, 1.0])
    held = True
    for spin in (0.0, 500.0, -500.0):
        case = dataclasses.replace(p, spin=spin)
        found, closed = rebound(case), gross_sliding(case)
        held &= check(f"gross sliding at 60 deg, spin {spin}", found[:5] / scale, closed[:5] / scale, 1e-9)
        held &= check("     loss [J]", found.loss, closed.loss, 1e-12)
    slow = dataclasses.replace(p, angle=math.radians(5.0), friction_speed=1e-5, friction_dynamic=0.3)
    found, closed = rebound(slow, 1e-9, "Radau"), sticking(slow)
    held &= check("sticking at 5 deg: e_t, spin", found[1:3] / scale[1:3], closed[1:3] / scale[1:3], 1e-4)
    print(f"     e_t {found.tangential_restitution:.7f}, 5/7 = {5 / 7:.7f}")
    bare = dataclasses.replace(p, restitution=None, friction="none")
    depth, peak, duration = hertz(bare.mass, bare.approach, bare.stiffness)
    found = rebound(bare)
    held &= check("elastic: e_n, e_t", found[:2], 1.0, 1e-10)
    held &= check("elastic: duration over Hertz's", found.duration / duration, 1.0, 1e-10)
    middle = history(bare, np.array([0.0, 0.5 * duration]))
    held &= check(
        "elastic: depth, force over Hertz's", [middle.states[1, 0] / depth, middle.normal[1] / peak], 1.0, 1e-9
    )
    for e in (0.9, 0.5, 0.1):
        found = rebound(dataclasses.replace(p, restitution=e, friction="none"))
        held &= check(f"e_n = {e} by the exact chi", found.normal_restitution, e, 1e-9)
    for kind, width in (("coulomb", 0.0), ("brown_mcphee", 2e-7), ("step", 0.0), ("lugre", 0.0)):
        case = dataclasses.replace(p, angle=0.3, friction=kind, friction_static=0.12, onset=width, friction_speed=0.02)
        course = history(case, np.linspace(0.0, 1.2 * duration, 61))
        total = energy(case, course) + course.loss
        held &= check(f"balance of energy, {kind}", total / total[0], 1.0, 2e-9)
    linear = dataclasses.replace(
        bare, friction="spring", friction_dynamic=1e12, exponent=1.0, stiffness=1e7, stiffness_ratio=0.8, spin=100.0
    )
    times = np.linspace(0.0, 0.98 * math.pi * math.sqrt(linear.mass / linear.stiffness), 30)
    shear = history(linear, times).slip, elastic_shear(linear, times)
    held &= check("spring without limit, n = 1: slip [m/s]", *shear, 1e-9)
    return bool(held)


if __name__ == "__main__":
    sys.exit(not main())
