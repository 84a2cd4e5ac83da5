"""Contact stiffness from geometry and material: pure, differentiable, SI, of any broadcast shape.

Formulas: physics sheet 1.4. All assume linear elasticity, a contact small against the bodies unless a
docstring says otherwise, and no friction. Nothing here raises: arguments may be traced, so a value
outside the range of a formula gives NaN or infinity, as documented.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.numerics import newton_root, power

# ISO 76: largest pressure of a ball's static load rating [Pa]; a lasting dent of 1e-4 of the ball's diameter.
ISO_76 = 4.2e9
# The mean converges quadratically: one step before and seven in the loop reach rounding for 1e-6 <= kc <= 1e6.
_STEPS = 7


def effective_modulus(modulus_1: ArrayLike, poisson_1: ArrayLike, modulus_2: ArrayLike, poisson_2: ArrayLike) -> Array:
    """E* of  1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2  (Hertz 1881).

    Args:
        modulus_1, modulus_2: Young's moduli [Pa] > 0; infinite for a rigid body (derivative 0), not both.
        poisson_1, poisson_2: Poisson's ratios [-], -1 < nu <= 0.5.

    Returns:
        E* [Pa].
    """
    compliance_1 = (1.0 - jnp.square(poisson_1)) / jnp.asarray(modulus_1, dtype=float)
    compliance_2 = (1.0 - jnp.square(poisson_2)) / jnp.asarray(modulus_2, dtype=float)
    return 1.0 / (compliance_1 + compliance_2)


def effective_radius(radius_1: ArrayLike, radius_2: ArrayLike) -> Array:
    """R of  1/R = 1/R1 + 1/R2.

    Args:
        radius_1, radius_2: radii [m]: > 0 convex, infinite for a plane (derivative 0), < 0 for a hollow.

    Returns:
        R [m]; negative or infinite where the bodies do not touch in a point.
    """
    return 1.0 / (1.0 / jnp.asarray(radius_1, dtype=float) + 1.0 / jnp.asarray(radius_2, dtype=float))


def sphere_sphere(effective_modulus: ArrayLike, radius_1: ArrayLike, radius_2: ArrayLike) -> Array:
    """K = (4/3) E* sqrt(R) of F = K d^1.5 between two spheres (Hertz 1881), R as ``effective_radius``.

    Args:
        effective_modulus: E* [Pa].
        radius_1, radius_2: radii [m], see ``effective_radius``. Valid for a contact radius sqrt(R d) << radii.

    Returns:
        K [N/m^1.5]; NaN for a negative effective radius.
    """
    return 4.0 / 3.0 * jnp.asarray(effective_modulus) * jnp.sqrt(effective_radius(radius_1, radius_2))


def sphere_plane(effective_modulus: ArrayLike, radius: ArrayLike) -> Array:
    """K = (4/3) E* sqrt(R) [N/m^1.5] of a sphere on a plane: ``sphere_sphere`` with the second radius infinite.

    Args:
        effective_modulus: E* [Pa].
        radius: R [m] > 0.
    """
    return sphere_sphere(effective_modulus, radius, jnp.inf)


def sphere_in_socket(effective_modulus: ArrayLike, socket_radius: ArrayLike, ball_radius: ArrayLike) -> Array:
    """K = (4/3) E* sqrt(Rs Rb / DR), DR = Rs - Rb, of F = K d^1.5 (Lankarani and Nikravesh 1990).

    Hertz for a ball in a hollow sphere. Valid for d << DR only (contact radius << Rb); beyond, see
    ``laws.elastic.LiuSphere``.

    Args:
        effective_modulus: E* [Pa].
        socket_radius: Rs [m].
        ball_radius: Rb [m], 0 < Rb < Rs.

    Returns:
        K [N/m^1.5]; infinite for Rb = Rs, NaN for Rb > Rs.
    """
    socket, ball = jnp.asarray(socket_radius, dtype=float), jnp.asarray(ball_radius, dtype=float)
    # Not 1/(1/Rb - 1/Rs): the difference of the radii themselves is exact for a small clearance.
    return 4.0 / 3.0 * jnp.asarray(effective_modulus) * jnp.sqrt(socket * ball / (socket - ball))


class LineContact(eqx.Module):
    """Two cylinders along each other, at a force F:  a = sqrt(4 F R/(pi E* L)),  p0 = 2 F/(pi L min(a, r)).

    Hertz's line contact (Johnson 1985, 4.43 to 4.45). A pin in its hole touches half of it at most: where Hertz's patch would
    be wider than the pin its radius r stands in its place, and p0 is that of a pressure that falls as the cosine around it.
    Hertz holds for a << r; from some r/3 on this is an estimate (Persson 1964).

    Attributes:
        effective_modulus: E* [Pa]; length: L [m].
        radius: R [m], 1/R = 1/r_1 + 1/r_2, a hole's r_2 negative.
        limit: r [m]; infinite for no limit.
    """

    effective_modulus: ArrayLike
    length: ArrayLike
    radius: ArrayLike
    limit: ArrayLike

    @property
    def unit_pressure(self) -> Array:
        """(3,) s, m, c of  p0 = max(s F^m, c F)."""
        share = jnp.sqrt(self.effective_modulus / (jnp.pi * jnp.asarray(self.radius) * self.length))
        return jnp.stack([share, 0.5, 2.0 / (jnp.pi * jnp.asarray(self.length) * self.limit)])

    def half_width(self, force: ArrayLike) -> Array:
        """Half of the patch's width [m], of any shape; of a pin at most its radius, along its circumference's chord."""
        squared = 4.0 * jnp.asarray(self.radius) / (jnp.pi * self.effective_modulus * self.length) * force
        return jnp.minimum(power(squared, 0.5), self.limit)

    def peak_pressure(self, force: ArrayLike) -> Array:
        """p0 [Pa], of any shape; 0 for no force."""
        share, exponent, least = self.unit_pressure
        return jnp.maximum(share * power(force, exponent), least * force)


def cylinder_limit(effective_modulus: ArrayLike, length: ArrayLike, radius_difference: ArrayLike) -> Array:
    """Force 4 pi E* L DR / e^2 [N] up to which Johnson's d(F) rises; the penetration there is 4 DR / e^2.

    Args:
        effective_modulus, length, radius_difference: as ``cylinder_penetration``.
    """
    return 4.0 * jnp.pi * jnp.exp(-2.0) * effective_modulus * length * radius_difference


def cylinder_penetration(
    force: ArrayLike, effective_modulus: ArrayLike, length: ArrayLike, radius_difference: ArrayLike
) -> Array:
    """Cylinder in a cylindrical hole:  d = F/(pi E* L) [ln(4 pi E* L DR / F) - 1]  (Johnson 1985).

    Physical for 0 < F < ``cylinder_limit``; above it the formula falls with the force and is still returned.

    Args:
        force: F [N], all of the contact's.
        effective_modulus: E* [Pa].
        length: L [m], of the contact.
        radius_difference: DR = hole - pin [m] > 0.

    Returns:
        d [m]; 0 for F <= 0.
    """
    force = jnp.asarray(force, dtype=float)
    pressing = force > 0
    per_length = jnp.where(pressing, force, 1.0) / (jnp.pi * effective_modulus * length)
    depth = per_length * (jnp.log(4.0 * jnp.asarray(radius_difference) / per_length) - 1.0)
    return jnp.where(pressing, depth, 0.0)


def cylinder_force(
    penetration: ArrayLike, effective_modulus: ArrayLike, length: ArrayLike, radius_difference: ArrayLike
) -> Array:
    """Inverse of ``cylinder_penetration`` on its rising branch, d <= 4 DR / e^2, differentiated implicitly.

    F = pi E* L d / v with v >= 1 the root of  v - ln v = 1 + ln(4 DR / (e^2 d)),  that is, -v is the lower
    branch W_-1(-e d / (4 DR)) of Lambert's function.

    Args:
        penetration: d [m].
        effective_modulus, length, radius_difference: as ``cylinder_penetration``.

    Returns:
        F [N]; exactly 0 with slope 0 for d <= 0; value and derivatives NaN for d > 4 DR / e^2, where no
        force belongs to d. The slope grows without bound towards that end and may be NaN at it.
    """
    penetration = jnp.asarray(penetration, dtype=float)
    depth = penetration * jnp.exp(2.0) / (4.0 * jnp.asarray(radius_difference))
    # The very end of the branch rounds to either side of 1.
    touching, beyond = depth > 0, depth > 1.0 + 1e-12
    excess = jnp.maximum(-jnp.log(jnp.where(touching & ~beyond, depth, 0.5)), 0.0)
    # 1 + sqrt(2 x) + x exceeds the root (Chatzigeorgiou 2013) and the residual is convex: Newton falls to it.
    start = 1.0 + jnp.sqrt(2.0 * excess) + excess
    v = newton_root(lambda v: v - jnp.log(v) - 1.0 - excess, start)
    force = jnp.pi * effective_modulus * length * penetration / v
    return jnp.where(touching, force, 0.0) * jnp.where(beyond, jnp.nan, 1.0)


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


class EllipticContact(eqx.Module):
    """Hertz contact over an ellipse of half-axes a and b: F = K d^1.5.

    Attributes:
        stiffness: K [N/m^1.5].
        ellipticity: k = a/b [-], a the half-axis in the plane of ``radius_y``; > 1 where radius_y > radius_x.
        effective_modulus: E* [Pa].
        scale: 6 k^2 E R / (2 pi E*) = a^3 / F [m^3/N].
    """

    stiffness: Array
    ellipticity: Array
    effective_modulus: Array
    scale: Array

    def penetration(self, load: ArrayLike) -> Array:
        """d = (F/K)^(2/3) [m] at a load F [N]; 0 for F <= 0."""
        return power(load / self.stiffness, 2.0 / 3.0)

    def half_axes(self, load: ArrayLike) -> tuple[Array, Array]:
        """a = (scale F)^(1/3) and b = a/k [m] at a load F [N]; 0 for F <= 0."""
        a = power(load * self.scale, 1.0 / 3.0)
        return a, a / self.ellipticity

    def peak_pressure(self, load: ArrayLike) -> Array:
        """p = 3 F / (2 pi a b) [Pa] at a load F [N]; 0 for F <= 0."""
        # F/(a b) = k F^(1/3) / scale^(2/3): no 0/0 for an idle contact.
        return 1.5 / jnp.pi * self.ellipticity * power(load, 1.0 / 3.0) / self.scale ** (2.0 / 3.0)


def elliptic_contact(effective_modulus: ArrayLike, radius_x: ArrayLike, radius_y: ArrayLike) -> EllipticContact:
    """Hertz contact of bodies with relative principal radii Rx and Ry, exact (no fitted ellipticity).

    k is the root of  Ry/Rx = (k^2 E - F)/(F - E),  F and E the complete elliptic integrals of m = 1 - 1/k^2
    (the fixed point of Hamrock and Anderson 1973), solved in ln k and differentiated implicitly. Then with
    1/R = 1/Rx + 1/Ry:  K = 2 pi k E* sqrt(R E / (4.5 F^3)).  In the form used here,
    Ry/Rx = k^2 B/D (``associate_integrals``), nothing degenerates at Rx = Ry, where k = 1 and
    K = (4/3) E* sqrt(Rx), and the order of the radii does not matter to K.

    Args:
        effective_modulus: E* [Pa].
        radius_x, radius_y: relative radii of curvature [m], both > 0 and finite, ratio within 1e-6 .. 1e6.
            A line contact (infinite ratio) has no such stiffness: see ``cylinder_penetration``.

    Returns:
        EllipticContact, of the broadcast shape; NaN for a negative radius.
    """
    modulus = jnp.asarray(effective_modulus, dtype=float)
    radius_x, radius_y = jnp.broadcast_arrays(jnp.asarray(radius_x, dtype=float), jnp.asarray(radius_y, dtype=float))
    log_ratio = jnp.log(radius_y) - jnp.log(radius_x)

    def mismatch(log_k: Array) -> Array:
        b, d = associate_integrals(jnp.exp(-log_k))
        return 2.0 * log_k + jnp.log(b / d) - log_ratio

    # Hamrock and Brewe's k = (Ry/Rx)^(2/pi) starts within 6 %, and the mismatch is nearly straight in ln k.
    log_k = newton_root(mismatch, 2.0 / jnp.pi * log_ratio)
    k, kc = jnp.exp(log_k), jnp.exp(-log_k)
    b, d = associate_integrals(kc)
    first, second = b + d, b + kc**2 * d
    radius = effective_radius(radius_x, radius_y)
    stiffness = 2.0 * jnp.pi * k * modulus * jnp.sqrt(radius * second / (4.5 * first**3))
    return EllipticContact(stiffness, k, modulus, 3.0 * k**2 * second * radius / (jnp.pi * modulus))


def groove_radii(
    ball_radius: ArrayLike, track_radius: ArrayLike, contact_angle: ArrayLike, conformity: ArrayLike, outer: ArrayLike
) -> tuple[Array, Array]:
    """Relative radii of a ball in the groove of a circular track, by curvatures after Jones.

    With g = r cos(alpha)/Rc:  1/Rx = (1/r)(1 -+ g/(1 +- g)), upper sign outer, that is Rx = r (1 +- g), along
    the track; 1/Ry = 1/r - 1/rg, that is Ry = 2 f r/(2 f - 1), across it.

    Args:
        ball_radius: r [m].
        track_radius: Rc [m], of the circle of ball centres; Rc > r cos(alpha).
        contact_angle: alpha [rad], of the contact normal against the plane's radial direction.
        conformity: f = rg/(2 r) [-], > 0.5; at 0.5 the ball fills the groove and Ry is infinite.
        outer: true for the track around the ball (seat), false for the one inside (head).

    Returns:
        Rx, Ry [m].
    """
    ball_radius = jnp.asarray(ball_radius, dtype=float)
    g = ball_radius * jnp.cos(contact_angle) / track_radius
    double = 2.0 * jnp.asarray(conformity, dtype=float)
    return ball_radius * (1.0 + jnp.where(outer, g, -g)), ball_radius * double / (double - 1.0)


def ball_in_groove(
    effective_modulus: ArrayLike,
    ball_radius: ArrayLike,
    track_radius: ArrayLike,
    contact_angle: ArrayLike,
    conformity: ArrayLike,
    outer: ArrayLike,
) -> EllipticContact:
    """Exact Hertz contact of a ball in a track: ``elliptic_contact`` on ``groove_radii``; arguments there."""
    return elliptic_contact(
        effective_modulus, *groove_radii(ball_radius, track_radius, contact_angle, conformity, outer)
    )
