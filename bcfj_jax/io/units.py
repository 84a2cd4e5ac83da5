"""Units at the edges: texts such as "12.5 um" become SI numbers here, and only here is Pint used.

Pint is imported on first use, so importing the package stays light; numbers need no Pint at all.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from bcfj_jax.core.errors import InputError

if TYPE_CHECKING:
    import pint

_NUMBER = re.compile(r"\s*([-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|inf))\s*(.*?)\s*", re.ASCII)
_COLUMN = re.compile(r"\s*(.*?)\s*\[\s*([^\[\]]*?)\s*\]\s*")
_STIFFNESS = "N/m^n"
_PREFIXES = {-12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
# Units whose name may be preceded by a prefix without changing its meaning.
_PREFIXABLE = ("m", "s", "N", "Pa", "J", "W", "Hz", "N m", "N s", "m/s", "s/m")
_EXAMPLES = {
    "1": 'a plain number such as 0.9 or "90 %"',
    "m": 'a length such as "1.2 mm"',
    "s": 'a time such as "60 us"',
    "kg": 'a mass such as "16.7 g"',
    "N": 'a force such as "1.5 kN"',
    "N m": 'a torque such as "1.8 kN m"',
    "m/s": 'a speed such as "1.5 m/s"',
    "m/s^2": 'an acceleration such as "9.81 m/s^2"',
    "s/m": 'a damping such as "0.11 s/m"',
    "N s/m": 'a viscous coefficient such as "50 N s/m"',
    "Pa": 'a pressure or modulus such as "207 GPa"',
    "kg/m^3": 'a density such as "7850 kg/m^3"',
    "rad": 'an angle such as "8 deg"',
    "rad/s": 'a rotational speed such as "100 r/min"',
    "N s": 'an impulse such as "0.2 N s"',
    "J": 'an energy such as "3 mJ"',
}


@functools.cache
def _registry() -> pint.UnitRegistry:
    import pint

    registry = pint.UnitRegistry(cache_folder=None)
    registry.define("@alias revolution = r")
    return registry


def _unit(text: str, where: str, given: str, remedy: str) -> pint.Unit:
    try:
        return _registry().parse_units(text)
    except Exception as error:  # Pint raises whatever its tokenizer does; to the user all of it is one thing.
        raise InputError(where, f"'{given}' has no unit that is known here ('{text}')", f"give {remedy}") from error


def _remedy(unit: str) -> str:
    return _EXAMPLES.get(unit, f"a value in {unit}")


def _snapped(factor: float) -> float:
    """A power of ten without the rounding of the products it came from."""
    power = round(math.log10(factor))
    return float(f"1e{power}") if abs(factor / 10.0**power - 1.0) < 1e-12 else factor


def _times(value: float, factor: float) -> float:
    # 60 us is 6e-05 s, not 5.9999999999999995e-05 s: dividing by a whole power of ten rounds once.
    inverse = round(1.0 / factor) if factor < 1.0 else 0
    return value / inverse if inverse and float(f"{1 / inverse:.15g}") == factor else value * factor


def scale_of(unit_text: str, si_unit: str, where: str, *, exponent: float | None = None) -> float:
    """Factor that takes numbers in a unit to SI: ("kN", "N") -> 1000.

    Args:
        unit_text: the unit as the user wrote it; "" and "1" are dimensionless.
        si_unit: the unit it must become; "1" is dimensionless, "N/m^n" a contact stiffness.
        where: place, for the message.
        exponent: n of a stiffness, where it is known.

    Raises:
        InputError: for an unknown unit, a wrong dimension, and a unit with an offset (degC).
    """
    return _factor(unit_text, si_unit, where, exponent, unit_text)


def _factor(unit_text: str, si_unit: str, where: str, exponent: float | None, given: str) -> float:
    if si_unit == _STIFFNESS:
        return _stiffness_factor(unit_text, where, exponent, given)
    right = f"give {_remedy(si_unit)}"
    unit = _unit("" if unit_text == "1" else unit_text, where, given, _remedy(si_unit))
    target = _registry().parse_units("" if si_unit == "1" else si_unit)
    if unit.dimensionality != target.dimensionality:
        wrong = "has a unit" if si_unit == "1" else f"is not in a unit that converts to {si_unit}"
        raise InputError(where, f"'{given}' {wrong}", right)
    quantity = _registry().Quantity
    if quantity(0.0, unit).to(target).magnitude != 0.0:
        raise InputError(where, f"'{given}' is in a unit with an offset", right)
    return _snapped(float(quantity(1.0, unit).to(target).magnitude))


def _stiffness_factor(unit_text: str, where: str, exponent: float | None, given: str) -> float:
    shown = 1.5 if exponent is None else exponent
    remedy = f'a stiffness such as "1e10 N/m^{shown:g}"'
    unit = _unit(unit_text, where, given, remedy)
    dimensions: dict[str, Any] = dict(unit.dimensionality)
    found = 1.0 - float(dimensions.pop("[length]", 0))
    if dimensions != {"[mass]": 1, "[time]": -2} or found <= 0:
        raise InputError(where, f"'{given}' is not in a unit of force over length to the exponent", f"give {remedy}")
    if exponent is not None and abs(found - exponent) > 1e-9:
        raise InputError(
            where,
            f"'{given}' is in force over length^{found:g}, but the contact's exponent is {exponent:g}",
            f"K of F = K d^n is in N/m^n, so the same number in another unit is another contact; give {remedy} "
            f"or set exponent = {found:g}",
        )
    return _snapped(float(_registry().Quantity(1.0, unit).to_base_units().magnitude))


def quantity(value: object, unit: str, where: str, *, exponent: float | None = None) -> float:
    """A number (SI already) or a text with its unit, in SI.

    Args:
        value: 1.2e-3 or "1.2 mm".
        unit: the SI unit wanted; "1" is dimensionless, "N/m^n" a contact stiffness.
        where: place, for the message, as ``InputError``.
        exponent: n of a stiffness; its unit must then agree with it. None: the unit's own exponent is taken.

    Raises:
        InputError: for what is no number with a known unit of the right dimension.
    """
    remedy = f"give {_remedy(unit)}" if unit != _STIFFNESS else 'give a stiffness such as "1e10 N/m^1.5"'
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, str):
        raise InputError(where, f"{value!r} is not a number", remedy)
    match = _NUMBER.fullmatch(value)
    if match is None:
        raise InputError(where, f"'{value}' is not a number with a unit", remedy)
    number, text = float(match[1]), match[2]
    if not text and unit == _STIFFNESS:
        return number  # Its unit goes with the exponent; without one it is SI, as a bare number is.
    if not text and unit != "1":
        raise InputError(where, f"'{value}' has no unit", f"{remedy}, or a bare number without quotes for {unit}")
    return _times(number, _factor(text, unit, where, exponent, value)) if text else number


def toleranced(value: object, unit: str, where: str, *, exponent: float | None = None) -> tuple[float, float | None]:
    """A value and how well it is known, both SI: "0.55 kg +- 2 %", "12 mm +- 0.1 mm"; None where nothing is said.

    Args, Raises: as ``quantity``; and for a tolerance that is no share and no value of the same unit, or below 0.
    """
    if not isinstance(value, str) or not (found := re.fullmatch(r"(.*?)\s*(?:\+-|\+/-|±)\s*(.*)", value)):
        return quantity(value, unit, where, exponent=exponent), None
    number = quantity(found[1], unit, where, exponent=exponent)
    if found[2].endswith("%"):
        tolerance = abs(number) * quantity(found[2], "1", where)
    else:
        tolerance = quantity(found[2], unit, where, exponent=exponent)
    if not (math.isfinite(tolerance) and tolerance >= 0.0):
        raise InputError(where, f"a tolerance of '{found[2]}'", 'give one above 0, as in "+- 2 %"')
    return number, tolerance


def coherent(unit: str, where: str) -> str:
    """A unit in which values are kept as they are: SI without a prefix or a factor; "1" is dimensionless.

    Raises:
        InputError: for a unit that is not known, and for one such as "mm" with the one to give in its place.
    """
    if unit in ("1", _STIFFNESS):
        return unit
    found = _registry().Quantity(1.0, _unit(unit, where, unit, "an SI unit such as m, N/m or rad/s")).to_base_units()
    if abs(found.magnitude - 1.0) > 1e-12:
        plain = f"{found.units:~C}".replace("**", "^") or "1"
        near = (known for known in _EXAMPLES if alike(known, plain))
        right = plain if plain in _EXAMPLES else next(near, plain)
        raise InputError(where, f"'{unit}' is not an SI unit", f"values are kept in SI: give {right}")
    return unit


def alike(first: str, second: str) -> bool:
    """Whether two coherent units measure the same: rad/s and 1/s do, N and N m do not."""
    if _STIFFNESS in (first, second):
        return first == second
    sizes = (_registry().parse_units("" if unit == "1" else unit).dimensionality for unit in (first, second))
    return next(sizes) == next(sizes)


def column(header: str) -> tuple[str, str | None]:
    """Name and unit text of a table's column: "force [kN]" -> ("force", "kN"), "time" -> ("time", None)."""
    match = _COLUMN.fullmatch(header)
    return (match[1], match[2]) if match else (header.strip(), None)


def engineering(values: Iterable[float], unit: str = "m") -> tuple[float, str]:
    """Scale and prefix that bring the largest magnitude to 1 .. 1000: multiply by the scale, show the prefix.

    Example: [0.0, 4.0e-5] (seconds) -> (1e6, "u"); no finite value but 0, and a unit without prefixes -> (1.0, "").
    """
    if unit not in _PREFIXABLE:
        return 1.0, ""
    largest = max((abs(v) for v in map(float, values) if math.isfinite(v)), default=0.0)
    if largest == 0.0:
        return 1.0, ""
    # The margin shows 0.9999999 kN as 1 kN.
    power = min(max(3 * math.floor((math.log10(largest) + 1e-9) / 3), min(_PREFIXES)), max(_PREFIXES))
    return float(f"1e{-power}"), _PREFIXES[power]


def format_si(value: float | None, unit: str, digits: int = 6) -> str:
    """A value for people: (1.2345678e4, "N") -> "12.3457 kN"; "-" for None and NaN."""
    if value is None or math.isnan(value):
        return "-"
    if unit == "1":
        return f"{value:.{digits}g}"
    if unit == "kg":
        return f"{value * 1e3:.{digits}g} g" if 0 < abs(value) < 1 else f"{value:.{digits}g} kg"
    scale, prefix = engineering([value], unit)
    return f"{value * scale:.{digits}g} {prefix}{unit}"
