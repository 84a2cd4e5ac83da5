"""What every parameter name means: its unit, its range and one sentence. Units are metadata, not magic."""

from __future__ import annotations

import math
from typing import NamedTuple


class Quantity(NamedTuple):
    """One parameter of a scene.

    ``unit`` is how the value is kept (SI); ``N/m^n`` stands for newtons over metres to the contact's
    exponent. The value must lie in [low, high], without ``low`` itself where ``open_low``.
    """

    name: str
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def valid(self, value: float) -> bool:
        """Whether a value lies in the range; NaN and infinities never do."""
        above = value > self.low if self.open_low else value >= self.low
        return math.isfinite(value) and above and value <= self.high

    @property
    def range(self) -> str:
        """The range in words."""
        low = "" if self.low == -math.inf else f"{'>' if self.open_low else '>='} {self.low:g}"
        high = "" if self.high == math.inf else f"<= {self.high:g}"
        return " and ".join(part for part in (low, high) if part) or "finite"


def _positive(name: str, unit: str, meaning: str) -> Quantity:
    return Quantity(name, unit, meaning, low=0.0, open_low=True)


def _not_negative(name: str, unit: str, meaning: str) -> Quantity:
    return Quantity(name, unit, meaning, low=0.0)


CATALOGUE: dict[str, Quantity] = {
    q.name: q
    for q in (
        # coefficients of the contact laws
        _positive("stiffness", "N/m^n", "contact stiffness K of F = K d^n"),
        Quantity("exponent", "1", "force exponent n of F = K d^n", 1.0, 3.0),
        _positive("reference_force", "N", "force at the reference penetration"),
        _positive("reference_penetration", "m", "penetration at which the reference force is stated"),
        _positive("effective_modulus", "Pa", "E*, 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2"),
        _positive("contact_length", "m", "length of the cylindrical contact"),
        _positive("radius", "m", "radius of the sphere"),
        _positive("radius_difference", "m", "hole radius less body radius"),
        _not_negative("damping", "s/m", "a of F = f(d) (1 + a d')"),
        Quantity("restitution", "1", "coefficient of restitution e the law is asked for", 0.0, 1.0),
        _not_negative("dashpot", "N s/m", "viscous coefficient c (Kelvin-Voigt), c_max (ADAMS IMPACT)"),
        _positive("damping_depth", "m", "penetration at which the ADAMS dashpot is fully in"),
        _not_negative("smoothing", "m", "half-width of the C2 onset of penetration; 0 is the sharp onset"),
        # bodies, motion, loads
        _positive("mass", "kg", "mass of the moving body (effective mass m1 m2/(m1 + m2) of two)"),
        _not_negative("approach_speed", "m/s", "speed towards the surface at time 0"),
        _not_negative("clearance_contact", "m", "gap between body and surface at time 0"),
        _not_negative("drop_height", "m", "height of the body's lowest point at time 0, at rest"),
        _not_negative("gravity", "m/s^2", "gravitational acceleration towards the surface"),
    )
}
