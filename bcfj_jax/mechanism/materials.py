"""What bodies are made of, as far as wear, pressure and life read it: numbers with their sources.

A model keeps its own numbers in ``life``; the rest is ``STEEL``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.mechanism.model import AbstractModel, Life, Params

# Of a hardened bearing steel that slides on itself, lubricated at the boundary: numbers and where they are from.
_STEEL: dict[str, tuple[float, str]] = {
    # k of V = k N s/H [-]
    "wear_coefficient": (
        1e-6, "GUESS, of 1e-7 to 1e-5: lubricated steel (Rabinowicz 1995, Friction and Wear of Materials)"
    ),
    "hardness": (7.0e9, "60 HRC, about 700 HV (ISO 18265)"),  # H [Pa]
    "effective_modulus": (113.0e9, "steel on steel: 207 GPa, 0.29 (paper)"),  # E* [Pa]
    # C [N]
    "load_rating": (30e3, "GUESS: some Lundberg-Palmgren rating of a 16 mm ball in a groove of conformity 0.52"),
    "yield_stress": (1.7e9, "GUESS: some 0.2 % proof stress of 100Cr6 at 60 HRC"),  # of uniaxial tension [Pa]
    "fatigue_stress": (0.7e9, "GUESS"),  # stress range at ``fatigue_cycles`` [Pa]
    "fatigue_cycles": (2e6, "GUESS: knee of the line"),
    "fatigue_exponent": (5.0, "GUESS: 5 of unnotched steel, 3 of welds (EN 1993-1-9)"),  # m of N = N0 (S0/S)^m
}  # fmt: skip
STEEL = {name: value for name, (value, _) in _STEEL.items()}
SOURCES = {name: source for name, (_, source) in _STEEL.items()}
# What [life] may give, with its unit.
GIVEN = {
    "wear_coefficient": "1", "hardness": "Pa", "effective_modulus": "Pa", "load_rating": "N",
    "contact_length": "m",  # of a pin in its bearing; by default twice the pin's radius
}  # fmt: skip


def with_materials(model: Any, given: Mapping[str, Any], where: str = "life") -> Any:
    """A mechanism or joint of other materials: numbers by name (``GIVEN``, SI), or tables of them by contact.

    Raises:
        InputError: for a name or a contact that is not known, a number that is not positive, and a model that reads none.
    """
    if not any(field.name == "life" for field in dataclasses.fields(model)):
        raise InputError(where, f"scene '{model.kind}' reads no materials", "give a mechanism, the joint or the string")
    return dataclasses.replace(model, life=_checked(model, given, where))


def _checked(model: AbstractModel, given: Mapping[str, Any], where: str) -> Life:
    found = []
    for key, value in given.items():
        each = {key: value} if key in GIVEN else value
        if (key not in GIVEN and key not in model.members) or not isinstance(each, Mapping):
            known = [*GIVEN, *model.members]
            raise InputError(f"{where} {key}", "no number of a material, and no contact", nearest(key, known))
        for name, number in each.items():
            place = f"{where} {name}" if key in GIVEN else f"{where}.{key} {name}"
            if name not in GIVEN:
                raise InputError(place, f"no number '{name}' of a material", nearest(name, GIVEN))
            if not (isinstance(number, (int, float)) and math.isfinite(number) and number > 0.0):
                raise InputError(place, f"{number!r}", f"give a number > 0 [{GIVEN[name]}]")
            found.append(("" if key in GIVEN else key, name, float(number)))
    return tuple(found)


def listed(life: Life) -> dict[str, Any]:
    """As ``with_materials`` takes them."""
    found: dict[str, Any] = {}
    for part, name, value in life:
        (found.setdefault(part, {}) if part else found)[name] = value
    return found


def material(model: AbstractModel, contact: str) -> dict[str, float]:
    """The numbers of a contact: its own, else the model's, else those of steel."""
    life: Any = model.life
    own = {name: value for part, name, value in life if not part}
    return STEEL | own | {name: value for part, name, value in life if part == contact}


def share(model: AbstractModel, params: Params, contact: str, what: str) -> Array:
    """What a reading of life reads: k/H [1/Pa] of wear, 1/C [1/N] of ``load_share``, ``unit_pressure`` of ``pressure``."""
    read = material(model, contact)
    if what == "wear_rate":
        return jnp.asarray(read["wear_coefficient"] / read["hardness"])
    if what == "load_share":
        return jnp.asarray(1.0 / read["load_rating"])
    found = model.unit_pressure(params, contact, read)
    if found is None:
        lack = (
            "its surfaces touch neither at a point nor along a line, or nobody said their radii: Hertz has none for it"
        )
        raise InputError(f"contact '{contact}' pressure", lack, "take peak, and a formula of bj.stiffness")
    return found
