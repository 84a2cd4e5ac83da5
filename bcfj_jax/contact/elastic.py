"""Elastic parts of a contact law: a penetration in, a force out, no memory and no rate.

A part names the coefficients it reads (``needs``); a contact's parameters are exactly those. To add
one: a subclass of ``AbstractElastic`` that gives ``needs`` and ``force``; and a line in ``ELASTIC``.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.part import Part
from bcfj_jax.core.numerics import positive, power, smooth_ramp

Coefficients = Mapping[str, Array]


class AbstractElastic(Part):
    """Force [N] against penetration [m]; 0 for no penetration, never negative."""

    example: ClassVar[str] = """
class Cubic(bj.laws.AbstractElastic):
    needs = ("stiffness",)
    def force(self, penetration, c):
        return c["stiffness"] * jnp.maximum(penetration, 0.0) ** 3
"""

    needs: ClassVar[tuple[str, ...]]

    @abstractmethod
    def force(self, penetration: Array, c: Coefficients) -> Array:
        """Elastic force [N], of the penetration's shape."""


class Power(AbstractElastic):
    """F = K d^n. Hertz 1881 for n = 1.5 (point contact of convex bodies, contact radius << radii).

    Coefficients: ``stiffness`` K [N/m^n], ``exponent`` n >= 1.
    """

    needs: ClassVar[tuple[str, ...]] = ("stiffness", "exponent")

    def force(self, penetration: Array, c: Coefficients) -> Array:
        return c["stiffness"] * power(penetration, c["exponent"])


class Reference(AbstractElastic):
    """F = F_ref (d / d_ref)^n, the power law stated where the data are; K = F_ref / d_ref^n.

    K and n of a fit correlate at +0.99; F_ref at a penetration inside the data and n hardly at all.
    Calibration fits this form. Modelica's ElastoGap uses the same triple.
    Coefficients: ``reference_force`` [N], ``reference_penetration`` [m] > 0, ``exponent`` n >= 1.
    """

    needs: ClassVar[tuple[str, ...]] = ("reference_force", "reference_penetration", "exponent")

    def force(self, penetration: Array, c: Coefficients) -> Array:
        ratio = penetration / c["reference_penetration"]
        return c["reference_force"] * power(ratio, c["exponent"])


class Linear(AbstractElastic):
    """F = K d. Coefficient: ``stiffness`` K [N/m]."""

    needs: ClassVar[tuple[str, ...]] = ("stiffness",)

    def force(self, penetration: Array, c: Coefficients) -> Array:
        return c["stiffness"] * positive(penetration)


BACKING = ("bottoming_stiffness", "bottoming_penetration", "bottoming_width")


def backing(penetration: Array, c: Coefficients) -> Array:
    """Elastic force [N] of the stop behind a layer, K_b r(d - d_b); its coefficients as ``TwoStage`` has them."""
    depth, _ = smooth_ramp(positive(penetration) - c["bottoming_penetration"], c["bottoming_width"])
    # A width above d_b would let the stop push before the layer is touched.
    return jnp.where(penetration > 0, c["bottoming_stiffness"] * depth, 0.0)


class TwoStage(AbstractElastic):
    """F = K d^n + K_b r(d - d_b): a soft layer, and from d_b on a stiffer backing beside it. The layer bottoms out.

    Mindlin 1945 ("Dynamics of package cushioning", Bell System Technical Journal 24, 353): his bilinear cushion,
    F = K d up to d_b and K d + K_b (d - d_b) beyond, is n = 1 and w -> 0. The corner is rounded: r is
    ``numerics.smooth_ramp`` of half-width w, so the force has three continuous derivatives there. It is the layer's
    alone below d_b - w and Mindlin's above d_b + w. With x = d - d_b and s = (x + w) / 2 w the energy stored is
    K d^(n+1) / (n+1) + K_b U:  U = 2 w^2 s^5 (1 - s + 2 s^2/7) within w of d_b,  U = x^2/2 + w^2/14 beyond.
    Coefficients: ``stiffness`` K [N/m^n], ``exponent`` n, ``bottoming_stiffness`` K_b [N/m], ``bottoming_penetration``
    d_b [m], ``bottoming_width`` w [m] < d_b (0 is the sharp corner).
    """

    needs: ClassVar[tuple[str, ...]] = ("stiffness", "exponent", *BACKING)

    def force(self, penetration: Array, c: Coefficients) -> Array:
        return c["stiffness"] * power(penetration, c["exponent"]) + backing(penetration, c)


class Liu(AbstractElastic):
    """Cylinder in a cylindrical hole, elastic foundation:  F = (1/2) pi E* L d sqrt(d / (2 (DR + d))).

    Liu et al. 2007 (physics sheet 1.4). From cos(eps) = DR/(DR + d): Hertz-shaped pressure of peak
    E* d / (2 R2) over the half-width 2 R2 sin(eps/2). Meant for small clearance and large load, where
    Hertz is not valid; tends to d^1.5 for d << DR and to d for d >> DR.
    Coefficients: ``effective_modulus`` E* [Pa], ``contact_length`` L [m], ``radius_difference`` DR [m] > 0.
    """

    needs: ClassVar[tuple[str, ...]] = ("effective_modulus", "contact_length", "radius_difference")

    def force(self, penetration: Array, c: Coefficients) -> Array:
        d = positive(penetration)
        arc = jnp.sqrt(2.0 * (c["radius_difference"] + d))
        return 0.5 * jnp.pi * c["effective_modulus"] * c["contact_length"] * power(penetration, 1.5) / arc


class LiuSphere(AbstractElastic):
    """Sphere in a spherical socket, elastic foundation:  F = (2/3) pi E* R d^2 / (DR + d).

    The spherical analogue of ``Liu`` (physics sheet 1.4: derived there, the journal form unverified).
    Coefficients: ``effective_modulus`` E* [Pa], ``radius`` R [m], ``radius_difference`` DR [m] > 0.
    """

    needs: ClassVar[tuple[str, ...]] = ("effective_modulus", "radius", "radius_difference")

    def force(self, penetration: Array, c: Coefficients) -> Array:
        d = positive(penetration)
        factor = 2.0 / 3.0 * jnp.pi * c["effective_modulus"] * c["radius"]
        return factor * d * d / (c["radius_difference"] + d)


def bai_zhao_stiffness(penetration: Array, modulus: Array, radius_difference: Array) -> Array:
    """Nonlinear stiffness coefficient  K_n = (1/8) pi E* sqrt(2 d (3 DR + 2 d)^2 / (DR + d)^3).

    Bai and Zhao 2012/2013 (form from memory of the field, physics sheet 1.4). It is exactly the slope
    dF/dd of ``Liu`` per unit length, hence a *tangent* stiffness.

    Args:
        penetration: d [m].
        modulus: E* [Pa].
        radius_difference: DR [m] > 0.

    Returns:
        K_n, in the unit of E* (N/m per metre of length).
    """
    d = positive(penetration)
    gap = radius_difference + d
    return jnp.pi / 8.0 * modulus * power(2.0 * penetration, 0.5) * (3.0 * radius_difference + 2.0 * d) / gap**1.5


class BaiZhao(Liu):
    """Bai-Zhao hybrid, energy-consistent:  F = L * integral of K_n over the penetration.

    K_n (``bai_zhao_stiffness``) is a tangent stiffness, so the force that stores the right energy is its
    integral, which is Liu's law; with the factor of Zhiying and Qishao as damping it is the hybrid model.
    Coefficients as ``Liu``.
    """


class BaiZhaoSecant(Liu):
    """F = L K_n(d) d: the tangent stiffness used as a secant. Units are right, the energy is not.

    1 to 1.5 times the energy-consistent force (1.25 at d = DR). Coefficients as ``Liu``.
    """

    def force(self, penetration: Array, c: Coefficients) -> Array:
        d = positive(penetration)
        slope = bai_zhao_stiffness(penetration, c["effective_modulus"], c["radius_difference"])
        return c["contact_length"] * slope * d


class BaiZhaoAsPrinted(AbstractElastic):
    """F = K_n(d) d^n evaluated in millimetres and newtons: DIMENSIONALLY INCONSISTENT, for comparison only.

    As papers print it, with n = 1.5: K_n is N/mm^2 and the product is no force. Its numbers hold only in
    the unit system they were computed in, taken here as mm and N (E* in MPa); in metres they would
    differ by 10^(3(2 - n)). No contact length enters. Use ``BaiZhao`` unless reproducing such a paper.
    Coefficients: ``effective_modulus`` E* [Pa], ``radius_difference`` DR [m], ``exponent`` n.
    """

    needs: ClassVar[tuple[str, ...]] = ("effective_modulus", "radius_difference", "exponent")

    def force(self, penetration: Array, c: Coefficients) -> Array:
        # E* in MPa = N/mm^2; K_n depends on lengths only through ratios, so metres serve inside it.
        slope = bai_zhao_stiffness(penetration, c["effective_modulus"], c["radius_difference"])
        return 1e-6 * slope * power(1e3 * penetration, c["exponent"])


ELASTIC: dict[str, AbstractElastic] = {
    "power": Power(),
    "reference": Reference(),
    "linear": Linear(),
    "two_stage": TwoStage(),
    "liu": Liu(),
    "liu_sphere": LiuSphere(),
    "bai_zhao": BaiZhao(),
    "bai_zhao_secant": BaiZhaoSecant(),
    "bai_zhao_as_printed": BaiZhaoAsPrinted(),
}
