"""Units at the edges: texts such as "12.5 um" and headers such as "Force [kN]" become SI numbers here.

What a unit may look like is in ``unittext``. Pint is imported on first use, so importing the package stays light;
numbers, and units that most files are written in, need no Pint at all.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from bcfj_jax.core.errors import InputError, clip
from bcfj_jax.io.unittext import LONGEST, UnitText, parse, registry, symbols

if TYPE_CHECKING:
    import pint

_NUMBER = re.compile(r"\s*([-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|inf))\s*(.*?)\s*", re.ASCII)
_COLUMN = re.compile(r"\s*(.*?)\s*\[\s*([^\[\]]*?)\s*\]\s*")
_ROUND = re.compile(r"(.*?[^\s/])\s*/?\s*\(\s*([^()]*|[^()]*\([^()]*\)[^()]*?)\s*\)")
_OTHER_BRACKETS = re.compile(r"(.*?[^\s/])\s*(?:\{\s*([^{}]*?)\s*\}|<\s*([^<>]*?)\s*>)")
# V behind a word; behind a letter it is a direction.
_VOLTS = re.compile(r"((?:.*[\W_])?[A-Za-z]{3,}[\W_\d]*?)_V")
# A unit that something follows: "Force (N) Run #1".
_INSIDE = re.compile(r"(.*?[^\s/])\s*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s+([^\s()\[\]][^()\[\]]*)")
# A header whose name and unit are not parted by brackets.
_BEHIND_SLASH = re.compile(r"(.*?\S)\s*/\s*(\S.*)")
_LAST_WORD = re.compile(r"(.*?[^\s,_/])(?:\s*,\s*|\s+in\s+|[\s_]+)([^\s_]+)")
# "speed_mm_s" and "acc_m_s2": a slash is no letter of names in programs.
_PER_SECOND = re.compile(r"(.*?[^\s_])_(mm|cm|m|ft)_?(?:p|per_|(?<=_))s(?:\^?(2))?")
# "Force (A)" and "F/B" name a sensor, not a unit.
_LETTERS = tuple("ABCDEFGHLMQRSTXYZ")
# Units that no header ends in by chance.
_PLAIN = (
    "ns", "us", "µs", "ms", "mN", "kN", "MN", "nm", "um", "µm", "mm", "cm", "m/s", "mm/s", "m/s^2", "m/s²", "m/s2",
    "с", "мс", "мкс", "Н", "кН", "мм", "м/с", "м/с²",  # noqa: RUF001
    "msec", "usec", "sec", "daN", "lbf", "lbs", "lb", "kg", "kgf", "gf", "kip", "klbf", "ft/s", "mV", "pC", "kHz", "Hz",
    "px", "counts", "mps",
)  # fmt: skip
# Units that stand as a name of their own.
_ALONE = (
    "ms", "millis", "msec", "us", "micros", "usec", "µs", "sec", "Volt", "Volts", "mV", "kN", "lbf", "Newton", "Newtons",
)  # fmt: skip
_IN = re.compile(r"(?:(.*?\S)\s+)?in\s+(\S+)")
_RATE = re.compile(r"(?:[munkµ]?m|cm|km|rad|deg|°|k?N)\s*/\s*(?:s|h|min|s\^?2|s²)")
_COMMAS = re.compile(r"\s*([-+]?\d[\d.]*,[\d.,]*\d)(?![\d.,])(.*)", re.DOTALL)
# Units that are often written in the wrong case.
_CASED = (
    "kN", "N", "mN", "MN", "ms", "s", "mm", "m", "kg", "g", "Pa", "kPa", "MPa", "GPa", "Hz", "kHz", "J", "rad/s", "rpm",
)  # fmt: skip
# What a header in capitals means; elsewhere case matters.
_CAPITALS = {
    "KN": "kN", "MM": "mm", "MS": "ms", "HZ": "Hz", "KHZ": "kHz", "mS": "ms", "gF": "gf", "kG": "kgf", "mps": "m/s",
}  # fmt: skip
_CASELESS = ("sec", "msec", "usec", "lbf", "kgf")  # Words mean one unit in any case.
_STIFFNESS = "N/m^n"
_PREFIXES = {-12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
# Units whose name may be preceded by a prefix without changing its meaning.
_PREFIXABLE = ("m", "s", "N", "Pa", "J", "W", "Hz", "N m", "N s", "m/s", "s/m")
# What most files are written in needs no Pint, whose import takes as long as that of JAX: (unit, SI unit) and the factor.
_COMMON = {(prefix + unit, unit): float(f"1e{power}") for unit in _PREFIXABLE for power, prefix in _PREFIXES.items()} | {
    ("g", "kg"): 1e-3, ("kg", "kg"): 1.0, ("kg/m^3", "kg/m^3"): 1.0, ("m/s^2", "m/s^2"): 1.0, ("%", "1"): 0.01,
    ("deg", "rad"): math.pi / 180.0, ("rad", "rad"): 1.0, ("rad/s", "rad/s"): 1.0, ("r/min", "rad/s"): math.pi / 30.0,
}  # fmt: skip
# Units of these convert to no other of them, so that a column of forces is known to be no clock without Pint.
_APART = frozenset(("m", "s", "N", "Pa", "kg", "m/s"))
# Accelerations in multiples of 9.80665 m/s^2, as headers write them; elsewhere g is a gram and G a gauss.
GRAVITIES = {"g": 9.80665, "G": 9.80665, "gn": 9.80665, "g_n": 9.80665, "g's": 9.80665, "gs": 9.80665, "mg": 9.80665e-3}
_IN_GRAVITIES = re.compile(
    rf"(.*?[^\s,_/(])(?:\s*\(\s*|\s*,\s*|\s+in\s+|[\s_]+)({'|'.join(sorted(GRAVITIES, reverse=True))})\s*\)?"
)
# An axis is that of an accelerometer's logger, "Ch1 X".
_ACCELERATION = re.compile(
    r"(?i).*(?:acc(?:$|[^a-z]|el)|beschl|(?:^|[^a-z])a[xyz]?$)|(?:.*[ _])?(?:axis[ _-]?)?[xyz](?:[ _-]?axis)?$"
)
# Numbers of a picture and of a converter, and strains, which a sensitivity makes a quantity.
COUNTS = {
    **dict.fromkeys(("px", "pixel", "pixels"), "px"),
    **dict.fromkeys(("count", "counts", "digits", "LSB"), "counts"),
    **dict.fromkeys(("µm/m", "μm/m", "um/m", "µε", "με", "ue", "µstrain", "ustrain", "microstrain"), "ue"),
}
# Masses in which forces are stated by their weight, and its unit.
WEIGHTS = {"kg": "kgf", "g": "gf", "lb": "lbf", "lbs": "lbf"}
_EXAMPLES = {
    "1": 'a plain number such as 0.9 or "90 %"',
    "m": 'a length such as "1.2 mm"',
    "s": 'a time such as "60 us"',
    "kg": 'a mass such as "16.7 g"',
    "N": 'a force such as "1.5 kN"',
    "N m": 'a torque such as "1.8 kN m"',
    "m/s": 'a speed such as "1.5 m/s"',
    "m/s^2": 'an acceleration such as "9.81 m/s^2" or "12 g"',
    "s/m": 'a damping such as "0.11 s/m"',
    "N s/m": 'a viscous coefficient such as "50 N s/m"',
    "Pa": 'a pressure or modulus such as "207 GPa"',
    "kg/m^3": 'a density such as "7850 kg/m^3"',
    "rad": 'an angle such as "8 deg"',
    "rad/s": 'a rotational speed such as "100 r/min"',
    "N s": 'an impulse such as "0.2 N s"',
    "J": 'an energy such as "3 mJ"',
}


def _unit(text: str, where: str, given: str, remedy: str) -> pint.Unit:
    try:
        return parse(text)
    except UnitText as error:
        raise InputError(where, f"'{clip(given)}' {error}", _cased(text) or f"give {remedy}") from None


def _cased(text: str) -> str:
    right = {known.lower(): known for known in _CASED}.get(text.strip().lower())
    return f"write {right}; case matters, as in mN and MN" if right else ""


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


def scale_of(unit_text: str, si_unit: str, where: str, *, exponent: float | None = None, given: str = "") -> float:
    """Factor that takes numbers in a unit to SI: ("kN", "N") -> 1000; refuses one with an offset (degC). See ``quantity``.

    ``given``: the text that the unit stands in, for the message.
    """
    if si_unit == "m/s^2" and unit_text in GRAVITIES:
        return GRAVITIES[unit_text]
    common = _COMMON.get((unit_text, si_unit))
    if common is None and si_unit in _APART and any((unit_text, other) in _COMMON for other in _APART):
        raise _other_dimension(si_unit, where, given or unit_text)
    return _by_pint(unit_text, si_unit, where, exponent, given or unit_text) if common is None else common


def _other_dimension(si_unit: str, where: str, given: str) -> InputError:
    found = (
        "has a unit, and a plain number is wanted" if si_unit == "1" else f"is not in a unit that converts to {si_unit}"
    )
    return InputError(where, f"'{clip(given)}' {found}", f"give {_remedy(si_unit)}")


def _by_pint(unit_text: str, si_unit: str, where: str, exponent: float | None, given: str) -> float:
    if si_unit == _STIFFNESS:
        return _stiffness_factor(unit_text, where, exponent, given)
    remedy = _remedy(si_unit)
    target = _unit(si_unit, f"{where} unit", si_unit, 'its quantity a unit such as "N/m"')
    unit, given = _unit(unit_text, where, given, remedy), clip(given)

    def refused(why: str) -> InputError:
        return InputError(where, f"'{given}' {why}", f"give {remedy}")

    if unit.dimensionality != target.dimensionality:
        raise _other_dimension(si_unit, where, given)
    if si_unit in ("rad/s", "Hz"):
        unit = _turning(unit_text, unit, si_unit, where, given)
    offset, factor = _line(unit, target)
    if offset != 0.0:
        raise refused("is in a unit with an offset")
    if not (math.isfinite(factor) and factor > 0.0):
        raise refused("is in a unit of no finite size")
    return _snapped(factor)


# A table has one unit and up to 100 000 rows.
@functools.lru_cache(512)
def _line(unit: pint.Unit, target: pint.Unit) -> tuple[float, float]:
    """What 0 and 1 of a unit are in another."""
    quantity = registry().Quantity
    try:
        zero, one = (float(quantity(x, unit).to(target).magnitude) for x in (0.0, 1.0))
    except Exception:
        return 1.0, 1.0
    return zero, one


def _turning(unit_text: str, unit: pint.Unit, si_unit: str, where: str, given: str) -> pint.Unit:
    """Turns and cycles, which Pint takes for the same as radians: 1/min is a revolution a minute; Hz is no speed."""
    angle = "radian" in dict(registry().Quantity(1.0, unit).to_base_units().unit_items())
    if si_unit == "Hz" and angle:
        raise InputError(where, f"'{given}' is a rotational speed, not a frequency", 'give cycles, as in "50 Hz"')
    if si_unit == "Hz" or angle:
        return unit
    named = symbols(unit_text)
    if any("hertz" in str(parse(name)) for name in named):
        raise InputError(where, f"'{given}' counts cycles, not radians", 'give "100 r/s", "6000 rpm" or "628 rad/s"')
    return unit * parse("revolution") if named == ["min"] or named == ["min-1"] else unit


def _stiffness_factor(unit_text: str, where: str, exponent: float | None, given: str) -> float:
    remedy = f'a stiffness such as "1e10 N/m^{1.5 if exponent is None else exponent:g}"'
    unit = _unit(unit_text, where, given, remedy)
    dimensions: dict[str, Any] = dict(unit.dimensionality)
    found = 1.0 - float(dimensions.pop("[length]", 0))
    if dimensions != {"[mass]": 1, "[time]": -2} or found <= 0:
        raise InputError(where, f"'{given}' is not in a unit of force over length to the exponent", f"give {remedy}")
    if exponent is not None and abs(found - exponent) > 1e-9:
        said = f"'{given}' is in force over length^{found:g}, but the contact's exponent is {exponent:g}"
        why = "the unit of K in F = K d^n is N/m^n, so K cannot be converted to another exponent"
        raise InputError(where, said, f"{why}; give {remedy} or set exponent = {found:g}")
    size = float(registry().Quantity(1.0, unit).to_base_units().magnitude)
    if not (math.isfinite(size) and size > 0.0):
        raise InputError(where, f"'{clip(given)}' is in a unit of no finite size", f"give {remedy}")
    return _snapped(size)


def quantity(value: object, unit: str, where: str, *, exponent: float | None = None) -> float:
    """A number (SI already) or a text with its unit, in SI; refuses what is none of the right dimension.

    Args:
        value: 1.2e-3 or "1.2 mm".
        unit: the SI unit wanted; "1" is dimensionless, "N/m^n" a contact stiffness.
        where: place, for the message, as ``InputError``.
        exponent: n of a stiffness, with which its unit must agree; None: the unit's own is taken.
    """
    remedy = f"give {_remedy(unit)}" if unit != _STIFFNESS else 'give a stiffness such as "1e10 N/m^1.5"'
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return _number(value, where, remedy)
    if not isinstance(value, str):
        raise InputError(where, f"{clip(value)} is not a number", remedy)
    _short(value, where, remedy)
    if comma := _COMMAS.fullmatch(value):
        found, right = _without_commas(comma[1])
        texts = " or ".join(f'"{number}{comma[2]}"' for number in right)
        raise InputError(where, f"'{value}' has {found}", f"write {texts}: decimals have a point, thousands no mark")
    match = _NUMBER.fullmatch(value)
    if match is None:
        raise InputError(where, f"'{value}' is not a number with a unit", remedy)
    number, text = float(match[1]), match[2]
    if math.isinf(number) and "inf" not in match[1]:
        raise InputError(where, f"'{value}' is too large for a number of 64 bits", remedy)
    if text:
        return _times(number, scale_of(text, unit, where, exponent=exponent, given=value))
    # The unit of a stiffness goes with the exponent; without one it is SI, as a bare number is.
    if unit not in (_STIFFNESS, "1"):
        raise InputError(where, f"'{value}' has no unit", f"{remedy}, or a bare number without quotes for {unit}")
    return number


def _without_commas(number: str) -> tuple[str, list[str]]:
    """What the commas of a number are, and how to write it: "0,5", "1,000.5", "1.000,5", or either for "1,000"."""
    whole, mark, decimals = number.rpartition("," if number.rfind(",") > number.rfind(".") else ".")
    pointed = re.sub("[.,]", "", whole) + "." + decimals
    plain = re.sub("[.,]", "", number)
    if mark == ".":
        return "commas between thousands", [pointed]
    if number.count(",") > 1:
        return "commas between thousands", [plain]
    thousands = "." not in whole and len(decimals) == 3 and whole.strip("+-0")
    return "a decimal comma", [pointed, plain] if thousands and len(whole.strip("+-")) <= 3 else [pointed]


def _number(value: float, where: str, remedy: str) -> float:
    try:
        number = float(value)
    except OverflowError:
        raise InputError(where, f"{clip(value)} is too large for a number of 64 bits", remedy) from None
    if math.isnan(number):
        raise InputError(where, "nan is not a number", remedy)
    return number


def _short(value: str, where: str, remedy: str) -> None:
    if len(value) > LONGEST:
        raise InputError(where, f"a text of {len(value)} characters, '{clip(value, 40)}'", remedy)


# Normal quantile of 95 %, both sides.
_NORMAL = 1.959964


def toleranced(value: object, unit: str, where: str, *, exponent: float | None = None) -> tuple[float, float | None]:
    """A value and how well it is known with 95 %, both SI: "0.55 kg +- 2 %", "12 mm +- 0.1 mm"; None where nothing is said.

    A certificate's coverage factor may follow: "1 +- 0.5 %, k = 2" is "1 +- 0.49 %".
    """
    if isinstance(value, str):
        _short(value, where, f"give {_remedy(unit)}")
    if not isinstance(value, str) or not (found := re.fullmatch(r"(.*?)\s*(?:\+-|\+/-|±)\s*(.*)", value)):
        return quantity(value, unit, where, exponent=exponent), None
    number = quantity(found[1], unit, where, exponent=exponent)
    factor = re.fullmatch(r"(.*?)\s*[,(]\s*k\s*=\s*(\d+\.?\d*)\s*\)?", found[2])
    text, covered = (
        (factor[1], _NORMAL / float(factor[2]) if float(factor[2]) > 0.0 else math.inf) if factor else (found[2], 1.0)
    )
    share = text.endswith("%")
    tolerance = quantity(text, "1" if share else unit, where, exponent=None if share else exponent)
    tolerance *= covered * (abs(number) if share else 1.0)
    if not (math.isfinite(tolerance) and tolerance >= 0.0):
        raise InputError(where, f"a tolerance of '{found[2]}'", 'give one above 0, as in "+- 2 %"')
    return number, tolerance


def coherent(unit: str, where: str) -> str:
    """A unit in which values are kept as they are, SI without prefix or factor, or "1"; of another the right one is named."""
    if unit in ("1", _STIFFNESS):
        return unit
    right = "an SI unit such as m, N/m or rad/s"
    made = _unit(unit, where, unit, right)
    try:
        found = registry().Quantity(1.0, made).to_base_units()
    except Exception:
        raise InputError(where, f"'{unit}' is not an SI unit", f"give {right}") from None
    if abs(found.magnitude - 1.0) > 1e-12:
        plain = f"{found.units:~C}".replace("**", "^") or "1"
        near = plain if plain in _EXAMPLES else next((known for known in _EXAMPLES if alike(known, plain)), plain)
        raise InputError(where, f"'{unit}' is not an SI unit", f"values are kept in SI: give {near}")
    return unit


def alike(first: str, second: str) -> bool:
    """Whether two coherent units measure the same: rad/s and 1/s do, N and N m do not."""
    if _STIFFNESS in (first, second):
        return first == second
    sizes = (parse(unit).dimensionality for unit in (first, second))
    return next(sizes) == next(sizes)


@functools.lru_cache(4096)
def column(header: str) -> tuple[str, str | None]:
    """Name and unit text of a table's column; None where the header states no unit.

    "force [kN]", "Force (kN)", "F / kN", "Kraft in kN", "force, kN" and "force_kN" all state one. Brackets of the
    square kind are believed; all else is a unit only where it is known as one.
    """
    plain = header.strip()
    if len(plain) > LONGEST:
        return plain, None
    match = _COLUMN.fullmatch(plain)
    if match and not match[2].isdigit():  # "Y[0]" is a name.
        return match[1], _written(match[2])
    if plain in _ALONE:
        return plain, plain
    if _NUMBER.fullmatch(plain):  # "50 mm" is a size: of what is in the column nothing is said.
        return plain, None
    if match := _VOLTS.fullmatch(plain):
        return match[1], "V"
    if (match := _INSIDE.fullmatch(plain)) and match[2] not in (*_LETTERS, "") and known(match[2]):
        return f"{match[1]} {match[3]}", match[2]
    if (match := _OTHER_BRACKETS.fullmatch(plain)) and known(match[2] or match[3] or ""):
        return match[1], match[2] or match[3] or ""
    if match := _PER_SECOND.fullmatch(plain):
        return match[1], f"{match[2]}/s{'^2' if match[3] else ''}"
    if (match := _LAST_WORD.fullmatch(plain)) and match[2] in _PLAIN:
        return match[1], _written(match[2])
    if (match := _IN.fullmatch(plain)) and known(match[2]):
        return match[1] or plain, match[2]
    if (match := _IN_GRAVITIES.fullmatch(plain)) and accelerates(match[1]):
        return match[1], match[2]
    for pattern in (_ROUND, _BEHIND_SLASH):
        match = None if _RATE.fullmatch(plain) else pattern.fullmatch(plain)
        unit = _written(match[2]) if match and not match[2].isdigit() else "A"
        if match and (unit not in (*_LETTERS, "t") or (unit == "G" and pattern is _ROUND)) and known(unit):
            return match[1], unit
    return plain, None


def _written(unit: str) -> str:
    """A unit in the case in which it is known: "mSec" is msec, and "kG" a kilogram's weight, as Polish instruments write it."""
    return unit.lower() if unit.lower() in _CASELESS else _CAPITALS.get(unit, unit)


def accelerates(name: str) -> bool:
    """Whether a column's name is that of an acceleration, whose g is 9.80665 m/s^2 and no gram."""
    return bool(_ACCELERATION.match(name.strip()))


def known(text: str) -> bool:
    """Whether a text is a unit, a sign for none such as "-" included."""
    try:
        parse(text)
    except UnitText:
        return text in COUNTS
    return True


def same(first: str, second: str) -> bool:
    """Whether two texts are one unit, as "millis" and "ms" are."""
    return first == second or (
        known(first) and known(second) and not {first, second} & COUNTS.keys() and parse(first) == parse(second)
    )


def engineering(values: Iterable[float], unit: str = "m") -> tuple[float, str]:
    """Scale and prefix that bring the largest magnitude to 1 .. 1000: [0.0, 4.0e-5] (seconds) -> (1e6, "u"); else (1.0, "")."""
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
    if unit in ("", "1"):
        return f"{value:.{digits}g}"
    if unit == "kg":
        return f"{value * 1e3:.{digits}g} g" if 0 < abs(value) < 1 else f"{value:.{digits}g} kg"
    scale, prefix = engineering([value], unit)
    return f"{value * scale:.{digits}g} {prefix}{unit}"
