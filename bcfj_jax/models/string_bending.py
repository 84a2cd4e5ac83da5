"""Bending of a string's segments, each a beam between two joints that hold it by no moment in the plane of the hole's bend.

A segment of radius d and length L that is straight passes a hole of radius R and clearance C where L <= 4 sqrt(C (R + d)).
A longer one touches the outside of the bend with its ends and the inside with its middle, and is bent there by

    w = L^2/(8 (R + d)) - 2 C,    P = 48 E I w/L^3 h,    slope of an end = 3 w/L r,    M = P L/4 m/h = 12 E I w/L^2 m

The wall pushes the middle by P and the ends by P/2 each. Axial force F softens the beam (Timoshenko and Gere, Theory of
Elastic Stability, 1961, 1.4 and 1.7). With u^2 = F L^2/(4 E I) and D = 3 (sin u - u cos u)/u^3

    h = cos u/D,    r = (sin(u/2)/(u/2))^2/D,    m = (sin u/u)/D

all 1 without axial force. P is 0 at Euler's force, u = pi/2, where the segment bends of itself.

Across that plane the joints hold both ends by the same moment M_T = T tan(beta/2): the segment takes the shape of an S, and

    slope of an end = M_T L/(6 E I) D/(sin u/u),    deflection at its quarters = M_T L^2/(64 E I) (sin(u/4)/(u/4))^2/cos(u/2)

The middle presses as at a point while its curvature, 12 w/L^2, is below that of the hole, 1/R; beyond it would wrap.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism.model import Params

BENDING: dict[str, tuple[float, str]] = {
    "segment_strength": (758e6, "API Spec 7-1: yield of drill collars, 110 ksi"),
}
# Terms of the series below: exact to rounding up to twice Euler's force and far into tension.
_TERMS = range(16)


def _series(x: Array, terms: list[float]) -> Array:
    """Sum of terms x^k."""
    return jnp.polyval(jnp.asarray(terms[::-1]), x)


def _cosine(x: Array) -> Array:
    """cos u of x = u^2, a cosh where x is negative."""
    return _series(x, [(-1.0) ** k / math.factorial(2 * k) for k in _TERMS])


def _sinc(x: Array) -> Array:
    """sin u/u of x = u^2."""
    return _series(x, [(-1.0) ** k / math.factorial(2 * k + 1) for k in _TERMS])


def _d(x: Array) -> Array:
    """3 (sin u - u cos u)/u^3 of x = u^2."""
    return _series(x, [3.0 * (-1.0) ** k * (2 * k + 2) / math.factorial(2 * k + 3) for k in _TERMS])


class Bent(NamedTuple):
    """Of segments that the hole bends, each of the shape of the axial force."""

    bow: Array  # w, how far the middle is bent [m]
    push: Array  # P, of the wall on the middle [N]
    slope: Array  # of an end towards the hole's curve [rad]
    moment: Array  # in the middle [N m]


def rigidity(p: Params) -> Array:
    """E I of a segment [N m^2], I = pi/4 (d^4 - b^4)."""
    return p["segment_modulus"] * (0.25 * math.pi) * (p["segment_radius"] ** 4 - p["segment_bore"] ** 4)


def _softening(p: Params, axial: Array) -> Array:
    """u^2 = F L^2/(4 E I)."""
    return axial * p["segment_length"] ** 2 / (4.0 * rigidity(p))


def bent(p: Params, axial: Array) -> Bent:
    """What the hole does to segments that do not pass straight, at their axial force [N] (module docstring)."""
    length, x = p["segment_length"], _softening(p, axial)
    bow = jnp.maximum(length**2 / (8.0 * (p["hole_radius"] + p["segment_radius"])) - 2.0 * p["hole_clearance"], 0.0)
    stiff = rigidity(p) * bow / length**2
    return Bent(
        bow + 0.0 * axial,
        48.0 * stiff / length * jnp.maximum(_cosine(x), 0.0) / _d(x),
        3.0 * bow / length * _sinc(0.25 * x) ** 2 / _d(x),
        12.0 * stiff * _sinc(x) / _d(x),
    )


def swayed(p: Params, axial: Array, moment: Array) -> tuple[Array, Array]:
    """Slope of the ends [rad] and deflection at the quarters [m] of segments held by a moment [N m] at both ends."""
    length, x = p["segment_length"], _softening(p, axial)
    share = moment * length / rigidity(p)
    quarters = share * length / 64.0 * _sinc(x / 16.0) ** 2 / _cosine(0.25 * x)
    return share / 6.0 * _d(x) / _sinc(x), quarters


def check_length(v: dict[str, float], bending: bool, where: str) -> None:
    """Refuse segments that do not pass, straight or bent as far as neither yields nor wraps, with the length that would do."""
    radius, wide, length = v["hole_radius"] + v["segment_radius"], v["hole_clearance"], v["segment_length"]
    strength = v.get("segment_strength", BENDING["segment_strength"][0])
    yields = strength / (v["segment_modulus"] * v["segment_radius"])
    # L^2/(8 (R + d)) - 2 C <= K L^2/12 of the greatest curvature K that a segment may have: C of at least L^2 times
    straight = 1.0 / (16.0 * radius)
    bends = straight - min(yields, 1.0 / v["hole_radius"]) / 24.0
    needs = bends if bending else straight
    if wide >= needs * length**2:
        return
    limit = "" if not bending else " and yields" if yields < 1.0 / v["hole_radius"] else " and wraps around the wall"
    found = f"{length:g} m does not pass the bend{limit}"
    shorter = f"at most {math.sqrt(wide / needs):.4g} m, or " if wide > 0.0 else ""
    remedy = f"give {shorter}a hole_clearance of at least {length**2 * needs:.4g} m"
    if not bending and bends > 0.0 and wide > 0.0:
        remedy += f", or bending = true, which passes {math.sqrt(wide / bends):.4g} m"
    raise InputError(f"{where} segment_length", found, remedy)
