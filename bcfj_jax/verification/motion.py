"""Checks by simulation: impacts, rows of spheres, mechanisms and the joint, as a user runs them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bcfj_jax.models import scenes
from bcfj_jax.solve.simulation import simulate
from bcfj_jax.verification import oracles
from bcfj_jax.verification.check import Check, check, of_largest, relative, worst

_FINE = 1e-7  # force error asked for, of the peak
_SAMPLES = 1001
_UNIT = {"stiffness": 1e9, "mass": 0.1, "approach_speed": 1.0}


class _Struck(NamedTuple):
    """What one impact delivers, SI."""

    restitution: float
    duration: float
    penetration: float
    peak: float
    impulse: float


def _top(values: np.ndarray) -> float:
    """Maximum of a smooth curve from equally spaced samples, by the parabola through the highest three."""
    i = int(np.argmax(values[1:-1])) + 1
    a, b, c = values[i - 1 : i + 2]
    return float(b - (a - c) ** 2 / (8.0 * (a - 2.0 * b + c)))


def _strike(law: str, end: float, values: Mapping[str, float]) -> _Struck:
    """Run ``impact`` until ``end`` [s], which is after the contact."""
    scene = scenes.impact(law, smoothing=False)
    params = scene.parameters(values)
    times = np.linspace(0.0, end, _SAMPLES)
    run = simulate(scene, params, times, accuracy=_FINE)
    if run.status != "ok" or run.trajectory is None:
        raise RuntimeError(run.reason)
    force, (place, speed) = run.force["contact"][:, 0], run.trajectory[-1, :2]
    if force[-1] != 0.0:
        raise RuntimeError("the body is still in contact at the end")
    # After the contact the body moves at constant speed: extrapolate back to the surface.
    return _Struck(
        -speed / float(params["approach_speed"]), times[-1] - place / speed, _top(run.trajectory[:, 0]), _top(force),
        float(np.trapezoid(force, times)),
    )  # fmt: skip


def _undamped(exponent: float, stiffness: float, mass: float, approach_speed: float) -> _Struck:
    """Hertz's closed form in plain Python, any exponent."""
    n = exponent
    depth = ((n + 1) * mass * approach_speed**2 / (2 * stiffness)) ** (1 / (n + 1))
    shape = 2 * math.sqrt(math.pi) * math.gamma(1 + 1 / (n + 1)) / math.gamma(0.5 + 1 / (n + 1))
    return _Struck(1.0, shape * depth / approach_speed, depth, stiffness * depth**n, 2 * mass * approach_speed)


@check("elastic impact, n = 1, 1.5, 2.5: e, duration, depth, peak, impulse", "Hertz 1881, closed form", 1e-5)
def hertz_impact() -> float:
    """All five numbers of three exponents."""
    each = [_UNIT | {"exponent": n, "stiffness": 10.0 ** (3 + 4 * n)} for n in (1.0, 1.5, 2.5)]
    expected = [_undamped(**values) for values in each]
    return worst(
        relative(_strike("hertz", 1.3 * known.duration, values), known)
        for values, known in zip(each, expected, strict=True)
    )


@check("two glass spheres, sphere on wall: peak force", "Chung and Ooi 2011, digitised force histories", 2e-3)
def chung_ooi_peak() -> float:
    """The published peaks are read from a curve: good to 0.1 %."""
    found = []
    for case in oracles.CHUNG_OOI:
        end = 1.3 * case.closed[3]
        values = {"stiffness": case.closed[0], "exponent": 1.5, "mass": case.mass, "approach_speed": case.speed}
        found.append(_strike("hertz", end, values).peak)
    return relative(found, [case.published_peak for case in oracles.CHUNG_OOI])


@check("restitution of an impact by 11 laws, e = 0.3 and 0.8", "laws as published; table by DOP853", 2e-5)
def restitution_by_motion() -> float:
    """The simulated law delivers what the relation says."""
    end = 2.5 * _undamped(1.5, **_UNIT).duration

    def delivered(law: str, asked: str) -> float:
        return _strike(law, end, _UNIT | {"exponent": 1.5, "restitution": float(asked)}).restitution

    return worst(
        relative(delivered(law, row[0]), float(row[column]))
        for column, law in enumerate(oracles.RESTITUTION_LAWS, 2)
        for row in oracles.RESTITUTION
        if row[0] in (".30", ".80")
    )


@check("impact with exact restitution 0.95 to 0.3: depth, peak, duration", "first integral; by DOP853", 1e-5)
def damped_impact() -> float:
    """Over those of the undamped impact."""
    still, apart = _undamped(1.5, **_UNIT), []
    for e, depth, peak, _, duration in oracles.DAMPED_RATIOS:
        hit = _strike("exact", 2.0 * still.duration, _UNIT | {"exponent": 1.5, "restitution": float(e)})
        found = (hit.penetration / still.penetration, hit.peak / still.peak, hit.duration / still.duration)
        apart.append(relative((hit.restitution, *found), [float(x) for x in (e, depth, peak, duration)]))
    return worst(apart)


@check("Hunt and Crossley's law: one restitution for n = 1, 1.5, 2.2", "Lambert W function; by DOP853", 1e-6)
def hunt_crossley() -> float:
    """chi = a v0 = 0.8."""
    apart = []
    for exponent in (1.0, 1.5, 2.2):
        values = _UNIT | {"exponent": exponent, "stiffness": 10.0 ** (3 + 4 * exponent)}
        found = _strike("memory_free", 2.0 * _undamped(**values).duration, {**values, "damping": 0.8})
        apart.append(relative(found.restitution, oracles.HUNT_CROSSLEY))
    return worst(apart)


@check("ADAMS IMPACT, 7 impacts: e, duration, depth, peak", "MSC ADAMS function IMPACT, by DOP853", 2e-5)
def adams_impact() -> float:
    """Restitution down to 0.04, where the damper makes the peak."""
    apart = []
    for mass, speed, dashpot, *printed, exponent in oracles.ADAMS_IMPACT:
        n, expected = float(exponent), [float(x) for x in printed]
        values = {"stiffness": 1e5 * 1e3**n, "exponent": n, "dashpot": 1e3 * float(dashpot), "damping_depth": 1e-4}
        values |= {"mass": float(mass), "approach_speed": float(speed)}
        apart.append(relative(_strike("adams_impact", 1.3 * expected[1], values)[:4], expected))
    return worst(apart)


@check("linear spring and dashpot, damping ratio 0.1 to 1.2: restitution", "Schwager and Poeschel 2007", 1e-5)
def kelvin_voigt() -> float:
    """The contact pushes only and ends where the force ends."""
    apart = []
    for ratio, pushing, _ in oracles.KELVIN_VOIGT:
        values = {"stiffness": 1e6, "mass": 1.0, "approach_speed": 1.0, "dashpot": 2e3 * ratio}
        apart.append(relative(_strike("kelvin_voigt", 2e-2, values).restitution, float(pushing)))
    return worst(apart)


@check("row of 5 spheres: final velocities", "siconos ChainOfBalls without gravity, by DOP853", 1e-6)
def chain() -> float:
    """Over the first sphere's speed of 1 m/s."""
    scene = scenes.chain(5)
    params = scene.parameters(exponent=1.5)
    run = simulate(scene, params, np.linspace(0.0, 2.0 * float(scene.horizon(params)), 3), accuracy=_FINE)
    assert run.trajectory is not None
    return of_largest(run.trajectory[-1, 5:], oracles.CHAIN[5, 1.5])


@check("slider-crank without clearance: motion of slider and rod", "closed form of the kinematics", 1e-9)
def slider_crank() -> float:
    """sin(phi) = -(r/L) sin(theta), x = r cos(theta) + L cos(phi), and two derivatives."""
    scene = scenes.slider_crank(ideal=True)
    params = scene.parameters()
    times = np.linspace(0.0, float(scene.horizon(params)), 101)
    names = ("slider.place.x", "slider.velocity.x", "slider.acceleration.x", "rod.place.x", "rod.place.y")
    run = simulate(scene, params, times, read=names)
    r, length, speed = (float(params[name]) for name in ("crank_length", "rod_length", "crank_speed"))
    sine, cosine = np.sin(speed * times), np.cos(speed * times)
    sin_rod = -r / length * sine
    cos_rod = np.sqrt(1.0 - sin_rod**2)
    rate = -r * speed * cosine / (length * cos_rod)
    quicker = (r * speed**2 * sine / length + rate**2 * sin_rod) / cos_rod
    expected = (
        r * cosine + length * cos_rod,
        -r * speed * sine - length * rate * sin_rod,
        -r * speed**2 * cosine - length * (quicker * sin_rod + rate**2 * cos_rod),
        r * cosine + 0.5 * length * cos_rod,
        r * sine + 0.5 * length * sin_rod,
    )
    return worst(of_largest(run.readings[name], value) for name, value in zip(names, expected, strict=True))


@check("slider with clearance in flight: crank and rod", "Flores, Leine and Glocker 2010, by DOP853", 1e-8)
def slider_guide() -> float:
    """Angles and speeds at 1 and 2 ms, before the first touch."""
    scene = scenes.slider_guide()
    times = np.array([0.0, *(row[0] for row in oracles.SLIDER_GUIDE)])
    run = simulate(scene, scene.parameters(), times, accuracy=1e-9)
    assert run.trajectory is not None
    angles, rates = np.cumsum(run.trajectory[1:, :2], axis=1), np.cumsum(run.trajectory[1:, 3:5], axis=1)
    found = np.hstack([angles / [2.0 * np.pi, 1.0], rates])
    return relative(found, np.array(oracles.SLIDER_GUIDE)[:, 1:])


@check("sphere on plane, oblique: gross sliding and rolling", "rigid sphere with Coulomb friction, closed form", 1e-5)
def oblique_impact() -> float:
    """e_t = 1 - mu (1 + e)/tan(angle) at 60 degrees; 5/7 at 5 degrees with much friction."""
    scene, apart = scenes.oblique_impact(friction="coulomb"), []
    for degrees, friction, width in ((60.0, 0.092, 1e-3), (5.0, 0.3, 1e-5)):
        angle = math.radians(degrees)
        params = scene.parameters(impact_angle=angle, friction_dynamic=friction, friction_speed=width, smoothing=0.0)
        run = simulate(scene, params, np.linspace(0.0, float(scene.horizon(params)), 3), accuracy=1e-4)
        assert run.trajectory is not None
        along = run.trajectory[-1, 3] / (float(params["approach_speed"]) * math.sin(angle))
        sliding = 1.0 - friction * (1.0 + float(params["restitution"])) / math.tan(angle)
        apart.append(relative(along, sliding if degrees == 60.0 else 5.0 / 7.0))
    return worst(apart)


def _at_rest(angle: float, deflection: float) -> tuple[np.ndarray, np.ndarray]:
    """Groove and window forces [N] of six balls, in equilibrium on linear contacts too stiff to change the geometry."""
    options = {"law": "hertz", "friction": False, "smoothing": False, "head": "fixed", "fidelity": "quasistatic"}
    scene = scenes.make("joint", **options, **oracles.JOINT_OPTIONS)
    names = [contact.name for contact in scene.contacts]
    values = {f"{name}.stiffness": 1e14 if name in ("seat_cage", "head_cage") else 1e12 for name in names}
    values |= {f"clearance_{name}": 0.0 for name in names} | {"exponent": 1.0, "load_ramp": 1e-6}
    values |= {"contact_angle": math.radians(angle), "joint_angle": math.radians(deflection)}
    params = scene.parameters(values, offset=oracles.JOINT_OFFSET, pitch_radius=oracles.JOINT_PITCH_RADIUS)
    turn = 2.0 * math.pi / float(params["drive_speed"])
    run = simulate(scene, params, np.array([0.0, turn]))
    if run.status != "ok":
        raise RuntimeError(run.reason)
    return run.force["seat_ball"][-1, :, 0], run.force["cage_ball"][-1, :, 0]


@check("joint at rest, undeflected, 4 contact angles: grooves, windows", "statics of a Rzeppa joint, closed form", 1e-3)
def joint_undeflected() -> float:
    """N = T/(6 Rp sin a), F_c = 2 Q cot(a) e/Rc."""
    apart = []
    for angle, groove, window, _ in oracles.JOINT_UNDEFLECTED:
        grooves, windows = _at_rest(angle, 0.0)
        apart += [relative(grooves, np.full(6, groove)), relative(windows, np.full(6, window))]
    return worst(apart)


@check("joint at rest, deflected by 10 degrees: grooves, windows", "independent statics solve in NumPy", 5e-3)
def joint_deflected() -> float:
    """The table counts azimuths against the sense in which the seat turns."""
    mirror = -np.arange(6) % 6
    grooves, windows = _at_rest(40.0, 10.0)
    pairs = ((grooves, oracles.JOINT_DEFLECTED_GROOVES), (windows, oracles.JOINT_DEFLECTED_WINDOWS))
    return worst(relative(found, np.array(known)[mirror]) for found, known in pairs)


@check("joint in motion, 1.5 s: forces of all 26 contacts", "CVODES on equations for CasADi, own code", 1e-3)
def joint_in_motion() -> float:
    """Normal forces beside the largest of their contact; asked for at 0.1 %."""
    scene = scenes.make("joint", **oracles.JOINT_OPTIONS)
    run = simulate(scene, scene.parameters(), np.array([0.0, oracles.JOINT_MOVING_AT]), accuracy=1e-3)
    found = {name: np.atleast_1d(run.force[name][-1, ..., 0]) for name in oracles.JOINT_MOVING}
    return worst(of_largest(found[name], expected) for name, expected in oracles.JOINT_MOVING.items())


CHECKS: tuple[Check, ...] = (
    hertz_impact, chung_ooi_peak, restitution_by_motion, damped_impact, hunt_crossley, adams_impact, kelvin_voigt,
    chain, slider_crank, slider_guide, oblique_impact, joint_undeflected, joint_deflected, joint_in_motion,
)  # fmt: skip
