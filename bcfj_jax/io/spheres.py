"""Two spheres by size and material, in place of the stiffness, exponent and mass that follow from them."""

from __future__ import annotations

import math
from typing import Any

from jax import Array

from bcfj_jax.contact import stiffness
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.programs import ask
from bcfj_jax.io.tables import Table
from bcfj_jax.io.units import quantity

Pair = tuple[Any, Any]


def _stiffness(modulus: Pair, poisson: Pair, radius: Pair) -> Array:
    return stiffness.sphere_sphere(stiffness.effective_modulus(modulus[0], poisson[0], modulus[1], poisson[1]), *radius)


class Spheres(Table):
    """``[scene.spheres]``: one value a body; a plane is a sphere of infinite radius, and infinitely heavy.

    Attributes:
        radius: > 0 [m], ``inf`` for a plane.
        youngs_modulus: > 0 [Pa], ``inf`` for a rigid body.
        poisson: Poisson's ratios [-], -1 < nu <= 0.5.
        density: > 0 [kg/m^3]; that of a plane does not matter.
    """

    radius: list[Any]
    youngs_modulus: list[Any]
    poisson: list[Any]
    density: list[Any]

    def derived(self, where: str) -> dict[str, float]:
        """Stiffness (4/3) E* sqrt(R), exponent 1.5 and effective mass m1 m2/(m1 + m2) of a Hertz contact.

        Raises:
            InputError: for values out of range, two planes, or two rigid bodies.
        """
        radius = self._pair("radius", "m", where, 0.0, math.inf)
        modulus = self._pair("youngs_modulus", "Pa", where, 0.0, math.inf)
        poisson = self._pair("poisson", "1", where, -1.0, 0.5)
        density = self._pair("density", "kg/m^3", where, 0.0, math.inf)
        for name, pair in (("radius", radius), ("youngs_modulus", modulus)):
            if all(math.isinf(value) for value in pair):
                raise InputError(f"{where} {name}", "both are infinite", "one of the two bodies must have a finite one")
        masses = [4.0 / 3.0 * math.pi * r**3 * rho for r, rho in zip(radius, density, strict=True)]
        heavy = [m for m in masses if math.isfinite(m)]
        if not heavy:
            raise InputError(f"{where} density", "no body has a finite mass", "give at least one a finite density")
        return {
            "stiffness": float(ask("two spheres", _stiffness, (), (modulus, poisson, radius))),
            "exponent": 1.5,
            "mass": 1.0 / sum(1.0 / m for m in heavy),
        }

    def _pair(self, name: str, unit: str, where: str, low: float, high: float) -> Pair:
        place = f"{where} {name}"
        given = getattr(self, name)
        if len(given) != 2:
            raise InputError(place, f"{given} has {len(given)} values", "give a list of two, one a body")
        pair = (quantity(given[0], unit, place), quantity(given[1], unit, place))
        for value in pair:
            # A NaN lies in no range.
            if not low < value <= high:
                bound = "" if math.isinf(high) else f" and <= {high:g}"
                raise InputError(place, f"{value:g} is out of range", f"give values > {low:g}{bound}")
        return pair
