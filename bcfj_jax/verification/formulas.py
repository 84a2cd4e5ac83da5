"""Checks without motion: restitution, elastic stiffness, Hertz contact, against tables and SciPy's special functions."""

from __future__ import annotations

import numpy as np

from bcfj_jax.contact import restitution, stiffness
from bcfj_jax.verification import oracles
from bcfj_jax.verification.check import LAST_DIGIT, Check, check, last_digits, relative, worst


@check("restitution that 11 laws deliver, 11 values each", "laws as published; exact relation, table by DOP853", 0.51,
       LAST_DIGIT)  # fmt: skip
def restitution_laws() -> float:
    """The laws' damping factors through the exact relation, to the printed digits."""
    asked = np.array([float(row[0]) for row in oracles.RESTITUTION])
    columns = [restitution.exact(asked)]
    for law in oracles.RESTITUTION_LAWS:
        columns.append(restitution.delivered_restitution(restitution.FACTORS[law](asked)))
    return worst(
        last_digits(np.asarray(found), [row[k] for row in oracles.RESTITUTION]) for k, found in enumerate(columns, 1)
    )


@check("exact restitution relation, damping factor 1e-3 to 1e3", "Lambert W function (SciPy)", 1e-9)
def restitution_lambert() -> float:
    """e = [1 + W0(-(1 + chi) exp(-(1 + chi)))]/chi."""
    from scipy.special import lambertw

    # Below 0.05 the Lambert form itself loses digits near its branch point.
    chi = np.geomspace(0.05, 1e3, 200)
    expected = (1.0 + lambertw(-(1.0 + chi) * np.exp(-(1.0 + chi))).real) / chi
    return relative(restitution.delivered_restitution(chi), expected)


@check("duration of an undamped impact, 6 exponents", "closed form by gamma functions, printed table", 0.51, LAST_DIGIT)
def undamped_durations() -> float:
    """T0 v0/d0."""
    n = np.array(list(oracles.UNDAMPED_DURATIONS))
    unit = (1.0, n, 1.0, 1.0)
    found = restitution.undamped_duration(*unit) / restitution.undamped_penetration(*unit)
    return last_digits(np.asarray(found), oracles.UNDAMPED_DURATIONS.values())


@check("sphere in socket, ball on flat: stiffness", "Lankarani and Nikravesh 1990; Hertz 1881", 0.51, LAST_DIGIT)
def sphere_stiffness() -> float:
    """(4/3) E* sqrt(R)."""
    found = [stiffness.sphere_in_socket(oracles.STEEL, 0.04, 0.04 - gap) for gap, _ in oracles.SOCKETS]
    found.append(stiffness.sphere_plane(oracles.STEEL, 0.008))
    return last_digits(map(float, found), [*(text for _, text in oracles.SOCKETS), oracles.BALL_ON_FLAT])


@check("two spheres and sphere on wall: K, depth, peak, duration", "Chung and Ooi 2011, tests 1 and 2", 2e-5)
def chung_ooi_formulas() -> float:
    """The closed form of the benchmark, to five digits."""
    parts = (restitution.undamped_penetration, restitution.undamped_peak, restitution.undamped_duration)
    apart = []
    for case in oracles.CHUNG_OOI:
        k = float(stiffness.sphere_sphere(stiffness.effective_modulus(*case.material), *case.radii))
        apart.append(relative([k, *(float(part(k, 1.5, case.mass, case.speed)) for part in parts)], case.closed))
    return worst(apart)


@check("elliptic Hertz contact, curvature ratio 1.01 to 1e4", "Hamrock's equations, elliptic integrals by SciPy", 1e-9)
def elliptic_contact() -> float:
    """Stiffness and ellipticity by a bracketed root of the textbook equation."""
    from scipy.optimize import brentq
    from scipy.special import ellipe, ellipk

    ratios = (1.01, 1.5, 3.0, 10.0, 100.0, 1e4)
    found, expected = [], []
    for ratio in ratios:

        def residual(k: float, ratio: float = ratio) -> float:
            m = 1.0 - 1.0 / k**2
            return (k**2 * ellipe(m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - ratio

        k = float(brentq(residual, 1.0 + 1e-4, 1e3, xtol=1e-14, rtol=1e-14))  # pyright: ignore[reportArgumentType]
        m, radius = 1.0 - 1.0 / k**2, 0.01 / (1.0 + 1.0 / ratio)
        expected += [np.pi * k * 2.0 * oracles.STEEL * np.sqrt(radius * ellipe(m) / (4.5 * ellipk(m) ** 3)), k]
        here = stiffness.elliptic_contact(oracles.STEEL, 0.01, 0.01 * ratio)
        found += [float(here.stiffness), float(here.ellipticity)]
    return relative(found, expected)


@check("ball in groove: stiffness, depth and pressure of 6 races", "Hertz with Jones' curvatures", 0.55, LAST_DIGIT)
def groove_races() -> float:
    """The table was printed from fewer digits: hence the slack of 0.05."""
    apart = []
    for outer, conformity, printed in oracles.RACES:
        race = stiffness.ball_in_groove(oracles.STEEL, 0.008, 0.0358, np.pi / 4, conformity, outer)
        found = [race.ellipticity, race.stiffness]
        for load in (11951.1, 39840.0):
            found += [race.penetration(load) * 1e6, race.peak_pressure(load) * 1e-9]
        apart.append(last_digits(map(float, found), printed.split()))
    return worst(apart)


@check("cylinder in cylindrical hole: force by penetration", "Johnson 1985, inverted by Lambert W (SciPy)", 1e-10)
def johnson_cylinder() -> float:
    """F/(pi E* L) = d/(-W_-1(-e d/(4 dR)))."""
    from scipy.special import lambertw

    modulus, length, gap = oracles.STEEL, 0.03, 5e-5
    limit = float(stiffness.cylinder_limit(modulus, length, gap))
    forces = limit * np.array([1e-6, 1e-3, 0.1, 0.5, 0.9])
    spread = forces / (np.pi * modulus * length)
    depths = spread * (np.log(4.0 * gap / spread) - 1.0)
    expected = np.pi * modulus * length * depths / -lambertw(-np.e * depths / (4.0 * gap), -1).real
    return relative(stiffness.cylinder_force(depths, modulus, length, gap), expected)


CHECKS: tuple[Check, ...] = (
    restitution_laws, restitution_lambert, undamped_durations, sphere_stiffness, chung_ooi_formulas, elliptic_contact,
    groove_races, johnson_cylinder,
)  # fmt: skip
