"""Planar slider-crank with a clearance joint between rod and slider: physics.md B6 (Flores and Ambrosio 2004).

World axes: x along the slider's guide, y up, angles counter-clockwise. The crank pin A = r (cos theta, sin theta)
turns at constant speed, theta = theta_0 + omega t. The rod hinges on it without play; u = (cos phi, sin phi) points
along the rod, its centre of mass is at A + (L/2) u and its other end, the journal, at P = A + L u. The slider S =
(x, 0) moves without friction on its guide, does not turn, and carries the bearing.

Clearance vector e = P - S, clearance c = R_B - R_J, penetration d = |e| - c (negative while free), normal n = e/|e|,
tangent t = (-n_y, n_x), d' = e' . n. Slip of the journal on the bearing: v = e' . t + R_J phi'.
Force on the SLIDER: N n + N mu(v) t; on the journal the opposite, with the moment -R_J N mu(v) on the rod. N is the
normal law of ``laws.normal``: K d^n (1 + a d') without memory, or Lankarani-Nikravesh, whose a = 3 (1 - e^2)/(4 v0)
keeps the approach speed v0 >= ``least_approach`` of the instant of touch. The bearing never pulls (N >= 0). With
``onset`` = w > 0 the law acts on r(d) and its force is multiplied by r'(d).

Motion, with m and I of the rod and F = -N n - N mu t the force on the journal:
    m_s x'' = N n_x + N mu t_x
    (I + m L^2/4) phi'' = -m (L/2) A'' . u_perp + L F . u_perp - R_J N mu - m g (L/2) cos phi
The work W of the crank pin on the rod and the loss D to damping and friction are integrated beside them, so that
energy - W + D is constant, for any law.

``python -m benchmarks.references.slider_crank`` checks the closed form, the balance and the agreement of methods.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Any, NamedTuple

import numpy as np

from benchmarks.references.laws import (
    FRICTION,
    HELPERS,
    exact_chi,
    friction,
    lankarani_nikravesh,
    normal,
    reduced_modulus,
    stored,
)
from benchmarks.references.solving import check, compiled, run


@dataclasses.dataclass(frozen=True)
class SliderCrank:
    """Mechanism and laws; the defaults are B6 with the memory-free law that gives e = 0.9 at 1 m/s."""

    crank: float = 0.05  # r [m]
    rod: float = 0.12  # L [m]
    rod_mass: float = 0.21  # kg
    rod_inertia: float = 2.5e-4  # about the centre of mass [kg m^2]
    slider_mass: float = 0.14  # kg
    bearing_radius: float = 0.010  # R_B [m]
    journal_radius: float = 0.0095  # R_J [m]
    speed: float = 5000.0 * 2.0 * math.pi / 60.0  # omega [rad/s]
    start_angle: float = 0.0  # theta_0 [rad]
    gravity: float = 0.0  # along -y [m/s^2]
    # K [N/m^n]: Lankarani-Nikravesh, (4/3) E* sqrt(R_B R_J/(R_B - R_J)) of steel, 6.61e10 N/m^1.5
    stiffness: float = 4.0 / 3.0 * reduced_modulus(207e9, 0.3, 207e9, 0.3) * math.sqrt(0.01 * 0.0095 / 0.0005)
    exponent: float = 1.5
    law: str = "hunt_crossley"  # or "lankarani_nikravesh"
    damping: float = exact_chi(0.9) / 1.0  # a [s/m], of hunt_crossley
    restitution: float = 0.9  # of lankarani_nikravesh
    least_approach: float = 1e-3  # floor of the latched v0 [m/s]
    onset: float = 0.0  # w [m]; less than the clearance
    friction: str = "none"  # or "brown_mcphee", "coulomb", "step"
    friction_static: float = 0.0
    friction_dynamic: float = 0.0
    friction_speed: float = 0.1  # v_t [m/s]
    friction_fast: float = 1.0  # of "step" [m/s]

    @property
    def clearance(self) -> float:
        """R_B - R_J [m]."""
        return self.bearing_radius - self.journal_radius

    @property
    def period(self) -> float:
        """Time of one revolution [s]."""
        return 2.0 * math.pi / self.speed


class Ideal(NamedTuple):
    """Motion of the mechanism without clearance, each of the shape of the times."""

    angle: np.ndarray
    """Of the rod, phi [rad]."""
    angle_rate: np.ndarray
    """phi' [rad/s]."""
    angle_acceleration: np.ndarray
    """phi'' [rad/s^2]."""
    position: np.ndarray
    """Of the slider [m]."""
    velocity: np.ndarray
    """[m/s]."""
    acceleration: np.ndarray
    """[m/s^2]."""


class Motion(NamedTuple):
    """Motion with clearance at T times."""

    times: np.ndarray
    """[s], shape (T,)."""
    states: np.ndarray
    """phi [rad], x [m], phi' [rad/s], x' [m/s]; shape (T, 4)."""
    work: np.ndarray
    """Of the crank pin on the rod, W [J], shape (T,)."""
    loss: np.ndarray
    """To damping and friction, D [J], shape (T,)."""
    approach: np.ndarray
    """Approach speed latched at the last touch before each time, 0 before the first [m/s], shape (T,)."""
    touches: np.ndarray
    """Times of first touch [s] and approach speeds then [m/s], shape (touches, 2)."""


class Readings(NamedTuple):
    """What a sensor would read, at T times."""

    slider_acceleration: np.ndarray
    """[m/s^2], shape (T,)."""
    rod_acceleration: np.ndarray
    """phi'' [rad/s^2], shape (T,)."""
    force: np.ndarray
    """Of the journal on the slider, world axes [N], shape (T, 2)."""
    normal: np.ndarray
    """N >= 0 [N], shape (T,)."""
    penetration: np.ndarray
    """d [m], negative while free, shape (T,)."""
    clearance_vector: np.ndarray
    """e = P - S [m], shape (T, 2)."""
    pin_force: np.ndarray
    """Of the crank on the rod, world axes [N], shape (T, 2)."""
    torque: np.ndarray
    """That drives the crank, without that of the crank's own weight [N m], shape (T,)."""
    energy: np.ndarray
    """Kinetic of rod and slider, elastic, and the rod's weight [J], shape (T,)."""


def ideal(p: SliderCrank, times: np.ndarray) -> Ideal:
    """Closed form without clearance: sin(phi) = -(r/L) sin(theta), x = r cos(theta) + L cos(phi)."""
    theta = p.start_angle + p.speed * np.asarray(times, float)
    sine, cosine = np.sin(theta), np.cos(theta)
    sin_phi = -p.crank / p.rod * sine
    cos_phi = np.sqrt(1.0 - sin_phi**2)
    rate = -p.crank * p.speed * cosine / (p.rod * cos_phi)
    acceleration = (p.crank * p.speed**2 * sine / p.rod + rate**2 * sin_phi) / cos_phi
    return Ideal(
        np.arcsin(sin_phi),
        rate,
        acceleration,
        p.crank * cosine + p.rod * cos_phi,
        -p.crank * p.speed * sine - p.rod * rate * sin_phi,
        -p.crank * p.speed**2 * cosine - p.rod * (acceleration * sin_phi + rate**2 * cos_phi),
    )


def _pack(p: SliderCrank, approach: float) -> np.ndarray:
    if not 0.0 <= p.onset < p.clearance:
        raise ValueError("the onset must be at least 0 and less than the clearance")
    laws = {"hunt_crossley": p.damping, "lankarani_nikravesh": 0.0}
    damping = laws[p.law]
    if p.law == "lankarani_nikravesh":
        damping = lankarani_nikravesh(p.restitution) / max(approach, p.least_approach)
    mechanism = [p.crank, p.rod, p.rod_mass, p.rod_inertia, p.slider_mass, p.clearance, p.journal_radius]
    contact = [p.stiffness, p.exponent, damping, p.onset]
    rubbing = [FRICTION[p.friction], p.friction_static, p.friction_dynamic, p.friction_speed, p.friction_fast]
    return np.array([*mechanism, p.speed, p.start_angle, p.gravity, *contact, *rubbing], float)


def _field(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    return _all(t, y, p)[:6]


def _all(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    # phi', x', phi'', x'', W', D'; then N, the force on the slider, d, e, the pin force, d'.
    crank, rod, mass, inertia, slider, clearance, journal = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    speed, gravity = p[7], p[9]
    theta = p[8] + speed * t
    a_x, a_y = crank * math.cos(theta), crank * math.sin(theta)
    u_x, u_y = math.cos(y[0]), math.sin(y[0])
    e_x, e_y = a_x + rod * u_x - y[1], a_y + rod * u_y
    de_x, de_y = -speed * a_y - rod * y[2] * u_y - y[3], speed * a_x + rod * y[2] * u_x
    size = math.sqrt(e_x * e_x + e_y * e_y)
    d = size - clearance
    f_x = f_y = force = moment = lost = rate = 0.0
    if d > -p[13]:
        n_x, n_y = e_x / size, e_y / size
        rate = de_x * n_x + de_y * n_y
        force, elastic = normal(d, rate, p[10], p[11], p[12], p[13])
        slip = de_y * n_x - de_x * n_y + journal * y[2]
        drag = force * friction(int(p[14]), slip, p[15], p[16], p[17], p[18])
        f_x, f_y = force * n_x - drag * n_y, force * n_y + drag * n_x
        moment = -journal * drag
        lost = (force - elastic) * rate + drag * slip
    b_x, b_y = -speed * speed * a_x, -speed * speed * a_y
    # Along u_perp = (-u_y, u_x).
    turning = -0.5 * mass * rod * (b_y * u_x - b_x * u_y) - rod * (f_y * u_x - f_x * u_y) + moment
    turning -= 0.5 * mass * gravity * rod * u_x
    spin = turning / (inertia + 0.25 * mass * rod * rod)
    g_x = b_x - 0.5 * rod * (spin * u_y + y[2] * y[2] * u_x)
    g_y = b_y + 0.5 * rod * (spin * u_x - y[2] * y[2] * u_y)
    pin_x, pin_y = mass * g_x + f_x, mass * (g_y + gravity) + f_y
    work = speed * (a_x * pin_y - a_y * pin_x)
    return np.array([y[2], y[3], spin, f_x / slider, work, lost, force, f_x, f_y, d, e_x, e_y, pin_x, pin_y, rate])


def _depth(p: SliderCrank, t: float, y: np.ndarray) -> tuple[float, float]:
    """How far the journal is inside the reach of the law, d + w [m], and d' [m/s]."""
    theta = p.start_angle + p.speed * t
    e_x = p.crank * math.cos(theta) + p.rod * math.cos(y[0]) - y[1]
    e_y = p.crank * math.sin(theta) + p.rod * math.sin(y[0])
    de_x = -p.crank * p.speed * math.sin(theta) - p.rod * y[2] * math.sin(y[0]) - y[3]
    de_y = p.crank * p.speed * math.cos(theta) + p.rod * y[2] * math.cos(y[0])
    size = math.hypot(e_x, e_y)
    return size - p.clearance + p.onset, (e_x * de_x + e_y * de_y) / max(size, 1e-300)


def simulate(
    p: SliderCrank,
    times: np.ndarray,
    rtol: float = 1e-12,
    method: str = "DOP853",
    start: np.ndarray | None = None,
    max_step: float | None = None,
) -> Motion:
    """Motion at ``times`` [s], rising, shape (T,).

    Free flight and contact are integrated one after the other, each touch and parting found as an event, so that no
    step straddles the kink. A touch shorter than ``max_step`` [s], by default 1/1000 revolution, may be missed.
    ``start`` is the state at times[0], shape (4,); by default that of the ideal mechanism, the journal centred.
    """
    times = np.asarray(times, float)
    if start is None:
        at = ideal(p, times[0])
        start = np.array([at.angle, at.position, at.angle_rate, at.velocity])
    field = compiled(_field, (*HELPERS, _all))
    step = p.period / 1000.0 if max_step is None else max_step
    speed = p.crank * p.speed
    scale = 0.5 * p.slider_mass * speed**2
    scales = np.array([p.clearance / p.rod, p.clearance, speed / p.rod, speed, scale, scale])
    state, now, latched = np.concatenate([start, [0.0, 0.0]]), float(times[0]), 0.0
    inside = _depth(p, now, state)[0] > 0.0
    states, approach, touches = [state], [latched], []
    while now < times[-1]:
        ahead = times[times > now]

        def event(t: float, y: np.ndarray, sign: float = 1.0 if inside else -1.0) -> float:
            return sign * _depth(p, t, y)[0]

        solved = run(
            field,
            state,
            np.concatenate([[now], ahead]),
            _pack(p, latched),
            method=method,
            rtol=rtol,
            scales=scales,
            max_step=step,
            event=event,
        )
        states.extend(solved.states[1:])
        approach.extend([latched] * (len(solved.states) - 1))
        now, state = solved.time, solved.state
        if solved.stopped:
            inside = not inside
            if inside:
                latched = _depth(p, now, state)[1]
                touches.append((now, latched))
    made = np.array(states)
    return Motion(times, made[:, :4], made[:, 4], made[:, 5], np.array(approach), np.reshape(touches, (-1, 2)))


def readings(p: SliderCrank, motion: Motion) -> Readings:
    """Accelerations, forces and energy of a motion."""
    rows, energy = [], []
    for t, y, latched in zip(motion.times, motion.states, motion.approach, strict=True):
        row = _all(t, y, _pack(p, latched))
        theta = p.start_angle + p.speed * t
        v_x = -p.crank * p.speed * math.sin(theta) - 0.5 * p.rod * y[2] * math.sin(y[0])
        v_y = p.crank * p.speed * math.cos(theta) + 0.5 * p.rod * y[2] * math.cos(y[0])
        kinetic = p.rod_mass * (v_x**2 + v_y**2) + p.rod_inertia * y[2] ** 2 + p.slider_mass * y[3] ** 2
        height = p.crank * math.sin(theta) + 0.5 * p.rod * math.sin(y[0])
        elastic = stored(row[9], p.stiffness, p.exponent, p.onset)
        rows.append(row)
        energy.append(0.5 * kinetic + elastic + p.rod_mass * p.gravity * height)
    r = np.array(rows)
    return Readings(
        r[:, 3], r[:, 2], r[:, 7:9], r[:, 6], r[:, 9], r[:, 10:12], r[:, 12:14], r[:, 4] / p.speed, np.array(energy)
    )


def balance(p: SliderCrank, motion: Motion, read: Readings | None = None) -> float:
    """Greatest |energy - its start - W + D| over the greatest energy; 0 for an exact solution."""
    read = readings(p, motion) if read is None else read
    rest = read.energy - read.energy[0] - motion.work + motion.loss
    return float(np.max(np.abs(rest)) / np.max(read.energy))


def main() -> bool:
    """Check the closed form, the balance of energy, the agreement of methods, and the size of the peaks."""
    plain = SliderCrank()
    times = np.linspace(0.0, plain.period, 201)
    exact, h = ideal(plain, times), 1e-6 * plain.period
    before, after = ideal(plain, times - h), ideal(plain, times + h)
    held = check(
        "ideal velocity, of r omega", (after.position - before.position) / (2 * h) / 26.2, exact.velocity / 26.2, 1e-8
    )
    slope = (after.velocity - before.velocity) / (2 * h)
    held &= check("ideal acceleration, of r omega^2", slope / 13708, exact.acceleration / 13708, 1e-8)
    half = np.linspace(0.0, 0.5 * plain.period, 101)
    rubbing: dict[str, Any] = {"friction_static": 0.12, "friction_dynamic": 0.08, "friction_speed": 0.1}
    cases = {
        "elastic": dataclasses.replace(plain, damping=0.0),
        "Hunt-Crossley": plain,
        "Lankarani-Nikravesh": dataclasses.replace(plain, law="lankarani_nikravesh"),
        "onset 2 um, Brown-McPhee, gravity": dataclasses.replace(
            plain, onset=2e-6, friction="brown_mcphee", gravity=9.81, **rubbing
        ),
        "STEP friction": dataclasses.replace(plain, friction="step", **rubbing),
    }
    for name, case in cases.items():
        motion = simulate(case, half)
        read = readings(case, motion)
        held &= check(f"balance of energy, {name}", balance(case, motion, read), 0.0, 1e-10)
        peak = np.max(np.abs(read.slider_acceleration)) / np.max(np.abs(ideal(case, half).acceleration))
        print(f"     {len(motion.touches)} touches, first {motion.touches[0]}, peak acceleration / ideal {peak:.2f}")
    smooth = cases["onset 2 um, Brown-McPhee, gravity"]
    tight = simulate(smooth, half).states
    unit = np.array([smooth.clearance / smooth.rod, smooth.clearance, 26.2 / smooth.rod, 26.2])
    for method, rtol, allowed in (("DOP853", 1e-10, 1e-4), ("LSODA", 1e-12, 1e-4), ("Radau", 1e-9, 1e-2)):
        other = simulate(smooth, half, rtol, method).states
        held &= check(
            f"{method} at {rtol:.0e} against DOP853 at 1e-12, of clearance", other / unit, tight / unit, allowed
        )
    return bool(held)


if __name__ == "__main__":
    sys.exit(not main())
