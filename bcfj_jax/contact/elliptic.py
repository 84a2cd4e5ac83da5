"""Complete elliptic integrals by the arithmetic-geometric mean, exact to rounding and differentiable."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

# The mean converges quadratically: one step before and seven in the loop reach rounding for 1e-6 <= kc <= 1e6.
_STEPS = 7


def associate_integrals(complementary_modulus: ArrayLike) -> tuple[Array, Array]:
    """B and D, the integrals of cos^2 and sin^2 over sqrt(1 - m sin^2) from 0 to pi/2, m = 1 - kc^2.

    They give the integrals of the first and second kind as F = B + D and E = B + kc^2 D, and keep what
    those lose to cancellation at m = 0:  F - E = m D,  E - (1 - m) F = m B,  B = D = pi/4 there. With
    the mean of (1, kc):  F = pi / (2 agm),  D = F (1/2 + S),  B = F (1/2 - S),  S = sum 2^(n-1) c_n^2 / m,
    c_n the half differences (Abramowitz and Stegun 17.6, rewritten so that nothing is divided by m).

    Args:
        complementary_modulus: kc > 0 [-], any shape; within 1e-6 .. 1e6 (m < 0 above 1). NaN where kc < 0.

    Returns:
        B and D [-], of that shape, smooth through kc = 1. Raises nothing.
    """
    kc = jnp.asarray(complementary_modulus, dtype=float)
    mean, geometric = 0.5 * (1.0 + kc), jnp.sqrt(kc)
    difference = 0.5 * (1.0 - kc)
    ratio = 0.5 / (1.0 + kc)  # difference / m, carried along in place of the division

    def halve(_, carry):
        mean, geometric, difference, ratio, total, weight = carry
        following, weight = 0.5 * (mean + geometric), 2.0 * weight
        ratio = difference * ratio / (4.0 * following)
        difference = difference**2 / (4.0 * following)
        total = total + weight * difference * ratio
        return following, jnp.sqrt(mean * geometric), difference, ratio, total, weight

    # A loop, not unrolled: the Hessian of a contact compiles in half the time.
    start = (mean, geometric, difference, ratio, difference * ratio, jnp.ones_like(kc))
    mean, _, _, _, total, _ = jax.lax.fori_loop(0, _STEPS, halve, start)
    first = 0.5 * jnp.pi / mean
    return first * (0.5 - total), first * (0.5 + total)
