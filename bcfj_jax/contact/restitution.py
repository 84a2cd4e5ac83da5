"""From a coefficient of restitution to a damping factor and back, and the impact's closed forms.

The laws of the family  F = K d^n (1 + chi d'/v0)  differ only in chi(e), the damping factor that is
meant to deliver the restitution e. What each one really delivers follows for any n, K, m, v0 from

    chi (1 + e) = ln[(1 + chi) / (1 - chi e)]                                             (*)

(first integral of m d'' = -F; physics sheet, section 3). Nothing here knows of a scene.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import gammaln
from jax.typing import ArrayLike

from bcfj_jax.core.numerics import newton_root, power

# Below this restitution every chi(e) that grows like 1/e would overflow; what is delivered is then at
# most this, that is, within 0.001 of what was asked for.
LOWEST_RESTITUTION = 1e-3

# e(chi) - 1 and chi(1 - e) about the elastic limit, by series reversion of (*). Eight terms reach
# rounding below 0.02, where the Newton iteration starts to lose digits to cancellation.
_E_SERIES = (-2 / 3, 4 / 9, -44 / 135, 104 / 405, -40 / 189, 7648 / 42525, -2848 / 18225, 31712 / 229635)  # fmt: skip
_CHI_SERIES = (3 / 2, 3 / 2, 27 / 20, 6 / 5, 759 / 700, 351 / 350, 6639 / 7000, 1599 / 1750)
_SERIES_LIMIT = 0.02


def _series(coefficients: tuple[float, ...], x: Array) -> Array:
    total = jnp.zeros_like(x)
    for c in reversed(coefficients):
        total = (total + c) * x
    return total


def _balance(chi: Array, e: Array) -> Array:
    """(*) without logarithms:  chi e - 1 + (1 + chi) exp(-chi (1 + e)); zero on the physical branch."""
    return chi * e - 1.0 + (1.0 + chi) * jnp.exp(-chi * (1.0 + e))


def delivered_restitution(chi: ArrayLike) -> Array:
    """Restitution e that a damping factor delivers; the root of (*), any n.

    Equal to [1 + W0(-(1 + chi) exp(-(1 + chi)))] / chi with the Lambert function. Valid for chi >= 0;
    differentiable there, the elastic limit included.

    Args:
        chi: damping factor [-], any shape.
    """
    chi = jnp.asarray(chi, dtype=float)
    near = chi < _SERIES_LIMIT
    safe = jnp.where(near, 1.0, chi)
    # e < 1/chi always, and the balance is convex in e: Newton falls monotonically from there.
    root = newton_root(lambda e: _balance(safe, e), jnp.minimum(1.0, 1.0 / safe))
    return jnp.where(near, 1.0 + _series(_E_SERIES, jnp.where(near, chi, 0.0)), root)


def exact(restitution: ArrayLike) -> Array:
    """chi(e) that delivers e exactly: the root of (*). Any n, 0.001 <= e <= 1.

    Args:
        restitution: e [-], any shape.
    """
    e = _floored(restitution)
    near = 1.0 - e < _SERIES_LIMIT
    safe = jnp.where(near, 0.5, e)
    # Zhang's fit is within 5 % everywhere it matters and never above the root's asymptote 1/e by much.
    start = 1.5 * (1.0 - safe) / safe**0.89
    root = newton_root(lambda chi: _balance(chi, safe), start)
    return jnp.where(near, _series(_CHI_SERIES, jnp.where(near, 1.0 - e, 0.0)), root)


def _floored(restitution: ArrayLike) -> Array:
    e = jnp.asarray(restitution, dtype=float)
    return jnp.where(e < LOWEST_RESTITUTION, LOWEST_RESTITUTION, e)


# By name chi(e) of the family; whose it is, and where it delivers the e that was asked for.
_CHI: dict[str, Callable[[Array], Array]] = {
    # Hunt and Crossley 1975; right in the limit e -> 1.
    "hunt_crossley": lambda e: 1.5 * (1.0 - e),
    # Herbert and McWhannell 1977; e >= about 0.9.
    "herbert_mcwhannell": lambda e: 6.0 * (1.0 - e) / ((2.0 * e - 1.0) ** 2 + 3.0),
    # Lee and Wang 1983; half the exact slope, so e is missed even at e -> 1.
    "lee_wang": lambda e: 0.75 * (1.0 - e),
    # Lankarani and Nikravesh 1990; e >= about 0.9 (delivers .796 for .7).
    "lankarani_nikravesh": lambda e: 0.75 * (1.0 - e**2),
    # Gonthier et al. 2004, first approximation; e within 4.4 % for e >= .1.
    "gonthier": lambda e: (1.0 - e * e) / e,
    # Zhiying and Qishao 2006; e within 4 % for e >= .4.
    "zhiying_qishao": lambda e: 0.75 * (1.0 - e * e) * jnp.exp(2.0 * (1.0 - e)),
    # Flores et al. 2011; e within 6 % for e >= .5, -31 % at .1.
    "flores": lambda e: 1.6 * (1.0 - e) / e,
    # Hu and Guo 2015; e within 2.5 % for e >= .5.
    "hu_guo": lambda e: 1.5 * (1.0 - e) / e,
    # Carvalho and Martins 2019; e within .3 % for e >= .4.
    "carvalho_martins": lambda e: 1.5 * (1.0 - e) * (11.0 - e) / (1.0 + 9.0 * e),
    # Zhang et al. 2020; e within 1.6 % for e >= .3, 5 % at .1.
    "zhang": lambda e: 1.5 * (1.0 - e) / e**0.89,
    # Safaeifar and Farshidianfar 2020; +7 % at .4 to .5, wrong slope at 1.
    "safaeifar_farshidianfar": lambda e: 1.25 * (1.0 - e) / e,
}


def _chi(name: str, restitution: ArrayLike) -> Array:
    return _CHI[name](_floored(restitution))


FACTORS: dict[str, Callable[[ArrayLike], Array]] = {"exact": exact, **{name: partial(_chi, name) for name in _CHI}}


def undamped_penetration(stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike) -> Array:
    """Greatest penetration of F = K d^n:  d0 = [(n + 1) m v0^2 / (2 K)]^(1/(n+1))  [m].

    Args:
        stiffness: K [N/m^n].
        exponent: n [-].
        mass: effective mass m1 m2 / (m1 + m2) [kg].
        speed: approach speed v0 [m/s].
    """
    n = jnp.asarray(exponent, dtype=float)
    return power((n + 1.0) * mass * jnp.square(speed) / (2.0 * jnp.asarray(stiffness)), 1.0 / (n + 1.0))


def undamped_peak(stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike) -> Array:
    """Peak force F0 = K d0^n [N] of an undamped impact. Arguments as ``undamped_penetration``."""
    return jnp.asarray(stiffness) * undamped_penetration(stiffness, exponent, mass, speed) ** exponent


def undamped_duration(stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike) -> Array:
    """Duration T0 = (d0/v0) 2 sqrt(pi) G(1 + 1/(n+1)) / G(1/2 + 1/(n+1)) [s], G the gamma function."""
    p = 1.0 / (jnp.asarray(exponent, dtype=float) + 1.0)
    ratio = jnp.exp(gammaln(1.0 + p) - gammaln(0.5 + p))
    d0 = undamped_penetration(stiffness, exponent, mass, speed)
    return 2.0 * jnp.sqrt(jnp.pi) * ratio * d0 / speed


def damped_penetration(
    chi: ArrayLike, stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike
) -> Array:
    """Greatest penetration of K d^n (1 + chi d'/v0):  d^(n+1) = ((n+1) m v0^2 / K)[1/chi - ln(1+chi)/chi^2].

    Args:
        chi: damping factor [-], > 0 (loses digits below about 1e-4; use the undamped form at 0).
        stiffness, exponent, mass, speed: as ``undamped_penetration``.
    """
    chi = jnp.asarray(chi, dtype=float)
    shape = 2.0 * (1.0 / chi - jnp.log1p(chi) / chi**2)
    d0 = undamped_penetration(stiffness, exponent, mass, speed)
    return d0 * shape ** (1.0 / (jnp.asarray(exponent) + 1.0))


def damped_peak(chi: ArrayLike, stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike) -> Array:
    """Peak force [N] of K d^n (1 + chi d'/v0).

    Solves (1 - u) - n u / (n + 1) = ln((1 + chi)/(1 + chi u)) / chi for the rate u = d'/v0 at the peak,
    then d^(n+1) = n m v0^2 u / (chi K) and F = K d^n (1 + chi u). Arguments as ``damped_penetration``.
    """
    chi, n = jnp.asarray(chi, dtype=float), jnp.asarray(exponent, dtype=float)
    chi, n = jnp.broadcast_arrays(chi, n)

    def balance(u: Array) -> Array:
        return (1.0 - u) - n * u / (n + 1.0) - (jnp.log1p(chi) - jnp.log1p(chi * u)) / chi

    u = newton_root(balance, jnp.zeros_like(chi))
    d = power(n * mass * jnp.square(speed) * u / (chi * stiffness), 1.0 / (n + 1.0))
    return jnp.asarray(stiffness) * d**n * (1.0 + chi * u)
