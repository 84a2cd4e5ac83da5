"""Scalar contact laws of the references: floats in, floats out, ``math`` alone, so that numba can compile them.

d is the penetration [m], positive inside; d' its rate [m/s], positive while approaching. Sources: physics.md, sections
1.1 (one family of normal laws), 2 (friction), 3 (restitution). ``python -m benchmarks.references.laws`` compares
restitution with the table of section 3 and the two forms of the onset with each other.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from benchmarks.references.solving import check, root

FRICTION = {"none": 0, "brown_mcphee": 1, "coulomb": 2, "step": 3}


def onset(d: float, width: float) -> tuple[float, float]:
    """Smoothed penetration r(d) [m] and its slope r'(d) [-].

    r = 2 w (5/2 s^4 - 3 s^5 + s^6), r' = s^3 (10 - 15 s + 6 s^2), s = (d + w)/(2 w) clipped to [0, 1]; r = d for
    d >= w, r = 0 for d <= -w. Width 0 is max(d, 0).
    """
    if d >= width:
        return d, 1.0
    if d <= -width:
        return 0.0, 0.0
    s = (d + width) / (2.0 * width)
    return 2.0 * width * s**4 * (2.5 - 3.0 * s + s * s), s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def normal(
    d: float, rate: float, stiffness: float, exponent: float, damping: float, width: float
) -> tuple[float, float]:
    """Normal force [N], and its elastic part: r'(d) K r^n max(0, 1 + a d'), and r'(d) K r^n.

    Stiffness K [N/m^n], damping a [s/m]: the Hunt-Crossley law without memory. A law with the latched approach speed v0
    has a = chi/v0.
    """
    if d <= -width or (width == 0.0 and d <= 0.0):
        return 0.0, 0.0
    r, slope = onset(d, width)
    elastic = slope * stiffness * r**exponent
    return elastic * max(0.0, 1.0 + damping * rate), elastic


def stored(d: float, stiffness: float, exponent: float, width: float) -> float:
    """Energy of the elastic part [J]: K r^(n + 1)/(n + 1)."""
    return stiffness * onset(d, width)[0] ** (exponent + 1.0) / (exponent + 1.0)


def friction(kind: int, v: float, static: float, dynamic: float, speed: float, fast: float) -> float:
    """Signed coefficient of friction mu(v) [-] of the slip v [m/s]; the force on the sliding body is -mu(v) F_n.

    1, Brown-McPhee 2016: mu_d tanh(4 r) + (mu_s - mu_d) r/(r^2/4 + 3/4)^2, r = v/``speed``.
    2, regularised Coulomb: mu_d tanh(v/``speed``).
    3, the STEP law of ADAMS: from -mu_s to mu_s within ``speed``, to mu_d at ``fast``.
    """
    if kind == 1:
        r = v / speed
        return dynamic * math.tanh(4.0 * r) + (static - dynamic) * r / (0.25 * r * r + 0.75) ** 2
    if kind == 2:
        return dynamic * math.tanh(v / speed)
    if kind == 3:
        size = abs(v)
        if size < speed:
            s = (v + speed) / (2.0 * speed)
            return static * (2.0 * s * s * (3.0 - 2.0 * s) - 1.0)
        s = min((size - speed) / (fast - speed), 1.0)
        return math.copysign(static + (dynamic - static) * s * s * (3.0 - 2.0 * s), v)
    return 0.0


HELPERS = (onset, normal, friction)


def _residual(chi: float, e: float) -> float:
    return chi * (1.0 + e) - math.log1p(chi) + math.log1p(-chi * e)


def restitution(chi: float) -> float:
    """Delivered restitution of F = K d^n (1 + chi d'/v0): the root e in (0, 1] of chi (1 + e) = ln((1 + chi)/(1 - chi e))."""
    if chi < 1e-3:
        return 1.0 - chi * (2 / 3 - chi * (4 / 9 - chi * (44 / 135 - chi * 104 / 405)))
    # At fixed chi the residual falls from e = 0 on.
    return root(lambda e: _residual(chi, e), 0.0, min(1.0, (1.0 - 1e-15) / chi))


def exact_chi(e: float) -> float:
    """The chi that delivers the restitution 0 < e < 1 for any n, K, m and v0; table of physics.md, section 3."""
    return root(lambda chi: _residual(chi, e), 0.5 * (1.0 - e), (1.0 - 1e-15) / e)


def lankarani_nikravesh(e: float) -> float:
    """chi = 3 (1 - e^2)/4."""
    return 0.75 * (1.0 - e * e)


def reduced_modulus(young_1: float, poisson_1: float, young_2: float, poisson_2: float) -> float:
    """E* [Pa]: 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2."""
    return 1.0 / ((1.0 - poisson_1**2) / young_1 + (1.0 - poisson_2**2) / young_2)


def hertz(mass: float, speed: float, stiffness: float, exponent: float = 1.5) -> tuple[float, float, float]:
    """Undamped impact: greatest penetration [m], greatest force [N], time of contact [s]."""
    n = exponent + 1.0
    depth = (n * mass * speed**2 / (2.0 * stiffness)) ** (1.0 / n)
    shape = 2.0 * math.sqrt(math.pi) * math.gamma(1.0 + 1.0 / n) / math.gamma(0.5 + 1.0 / n)
    return depth, stiffness * depth**exponent, shape * depth / speed


def normal_on(d: np.ndarray, rate: np.ndarray, *law: float) -> np.ndarray:
    """``normal`` of arrays [N], any shape, given K, n, a and the width of the onset."""
    d, rate = np.broadcast_arrays(d, rate)
    return np.reshape([normal(float(a), float(b), *law)[0] for a, b in zip(d.flat, rate.flat, strict=True)], d.shape)


def main() -> bool:
    """Compare with printed numbers of physics.md, section 3, and check the onset's slope."""
    e = [0.1, 0.3, 0.5, 0.7, 0.9, 0.99]
    held = check(
        "exact chi", [exact_chi(x) for x in e], [9.998159, 3.087082, 1.432751, 0.634828, 0.166482, 0.015151], 6e-7
    )
    delivered = [restitution(lankarani_nikravesh(x)) for x in e]
    held &= check(
        "e delivered by Lankarani-Nikravesh", delivered, [0.66527, 0.68422, 0.72524, 0.79597, 0.91318, 0.99015], 6e-6
    )
    held &= check("undamped impact, K = m = v0 = 1", hertz(1.0, 1.0, 1.0), (1.0933621, 1.1432626, 3.2180655), 6e-8)
    depths, h = np.linspace(-1.1, 1.1, 23), 1e-6
    slopes = [(onset(d + h, 1.0)[0] - onset(d - h, 1.0)[0]) / (2.0 * h) for d in depths]
    held &= check("slope of the onset", [onset(d, 1.0)[1] for d in depths], slopes, 1e-9)
    held &= check("onset meets d at w", onset(1.0 - 1e-9, 1.0), (1.0 - 1e-9, 1.0), 1e-15)
    return bool(held)


if __name__ == "__main__":
    sys.exit(not main())
