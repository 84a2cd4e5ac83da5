"""The grammar of unit texts: "kN", "N·m", "m/s^2", "1/min", "N/(m s)" become a unit of Pint, or a sentence why not.

Pint only sees single symbols such as "kN". Products, powers and brackets are parsed here, within limits of length,
power and depth, so that no text takes long or reaches Pint's own expression parser.
"""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pint

LONGEST, _LARGEST_POWER, _MOST_SYMBOLS, _LONGEST_SYMBOL = 200, 12.0, 12, 40
DIMENSIONLESS = ("", "1", "-", "\u2013", "\u2014", "[-]")

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_SIGNS = str.maketrans({"μ": "µ", "·": "*", "⋅": "*", "∙": "*", "•": "*", "×": "*", "−": "-", "\u00a0": " ", "∕": "/"})  # noqa: RUF001
_POWER = r"[-+]?\d+(?:\.\d+)?(?:/\d+)?"
# A factor of a product: a symbol, 1 or a group in brackets, with its power.
_FACTOR = re.compile(
    rf"""\s*(?P<sign>[*/]?)\s*(?:
      (?P<symbol>°[CF]?|%|‰|(?!\d)[A-Za-zµΩ_è]+(?:_?\d+(?![\d.]))?(?:-\d(?!\d))?)
    | 1(?![\d.])
    | \((?P<group>[^()]*)\)
    )\s*(?P<power>(?:\^|\*\*)\s*(?:\(\s*{_POWER}\s*\)|{_POWER}))?\s*""",
    re.VERBOSE,
)
# Torques and impulses are written without a space. Pint reads "Nm" as a count per length of yarn.
_TORQUE = re.compile(r"([pnuµmkMGT]?N)(mm|cm|m|s)")
# What rigs and their software write, and Pint does not know or reads as something else.
_ALIASES = {
    "Sek": "s", "sek": "s", "Sekunden": "s", "seconds": "s", "mSek": "ms", "msek": "ms", "Std": "h", "kp": "kgf",
    "Newton": "N", "Newtons": "N", "newtons": "N", "Volt": "V", "Volts": "V", "volts": "V", "Sec": "s", "Secs": "s", "msec": "ms",
    "Seconds": "s", "Second": "s", "Sekunde": "s", "Meter": "m", "usec": "us",
    "SEC": "s", "MSEC": "ms", "USEC": "us", "LBF": "lbf", "LBS": "lb", "KGF": "kgf", "VOLTS": "V", "VOLT": "V",
    "Ohm": "ohm", "Grad": "deg", "U": "revolution", "Umdr": "revolution", "r": "revolution", "rev": "revolution",
}  # fmt: skip
# Units as words of other languages, in lower case, and what may stand before them.
_WORDS = dict.fromkeys(
    ("second", "seconde", "secondes", "segundo", "segundos", "secondo", "secondi", "sekunde", "sekunden", "sekunder"), "s"
) | {
    **dict.fromkeys(("meter", "metre", "metres", "mètre", "mètres", "metro", "metros", "metri"), "m"),
    **dict.fromkeys(("newton", "newtons"), "N"),
}  # fmt: skip
_PREFIXED = re.compile(r"(milli|mili|micro|mikro|centi|zenti|kilo)?(.+)")
_PREFIXES = {"milli": "m", "mili": "m", "micro": "µ", "mikro": "µ", "centi": "c", "zenti": "c", "kilo": "k", None: ""}
# Units in Cyrillic letters.
_CYRILLIC = (("сек", "s"), ("мк", "µ"), ("см", "cm"), ("Гц", "Hz"), ("кгс", "kgf"))
_LETTERS = str.maketrans({"с": "s", "м": "m", "к": "k", "Н": "N", "г": "g", "В": "V", "М": "M", "秒": "s"})  # noqa: RUF001
# An inch over 96 of a style sheet: of a picture it is no length.
_NONE = ("px",)


class UnitText(ValueError):
    """A text that is no unit; the message is a clause that follows the quoted text."""


@functools.cache
def registry() -> pint.UnitRegistry:
    """Pint's units, loaded once and on first use."""
    import pint

    return pint.UnitRegistry(cache_folder=None)


def parse(text: str) -> pint.Unit:
    """The unit that a text states; "", "1" and "-" are dimensionless. ``UnitText`` says why a text is none."""
    if len(text) > LONGEST:
        raise UnitText(f"is {len(text)} characters long, more than the {LONGEST} of the longest unit")
    text = text.strip()
    if text in DIMENSIONLESS:
        return registry().Unit("")
    return _product(_factors(_plain(text)))


def symbols(text: str) -> list[str]:
    """The symbols of a unit text, for a question about how it is written."""
    return [symbol for symbol, _ in _factors(_plain(text.strip()))] if text.strip() not in DIMENSIONLESS else []


def _plain(text: str) -> str:
    for written, meant in _CYRILLIC if re.search("[\u0400-\u04ff]", text) else ():
        text = text.replace(written, meant)
    text = re.sub(r"(?<=[A-Za-z])[.-](?=[A-Za-z])", "*", text.rstrip(".").translate(_LETTERS))  # N.m, N-m
    return re.sub(r"[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda m: "^" + m[0].translate(_SUPERSCRIPTS), text).translate(_SIGNS)


def _factors(text: str) -> list[tuple[str, float]]:
    """Symbols with their powers; a group in brackets has its own power, and no group inside."""
    factors: list[tuple[str, float]] = []
    at = 0
    if text.lstrip()[:1] in ("*", "/"):
        raise UnitText(f"is no unit: '{text.lstrip()[0]}' stands where a symbol must")
    while at < len(text):
        found = _FACTOR.match(text, at)
        group = found["group"] if found else None
        if found is None or (group is not None and not group.strip()):
            raise UnitText(_fault(text[at:]))
        if found["power"] and not (found["symbol"] or group or factors):
            raise UnitText("is no unit: a power stands where a symbol must")
        own = [(found["symbol"], 1.0)] if found["symbol"] else _factors(group) if group else []
        power = (-1.0 if found["sign"] == "/" else 1.0) * _power(found["power"] or "1")
        factors += [(symbol, each * power) for symbol, each in own]
        at = found.end()
    if len(factors) > _MOST_SYMBOLS:
        raise UnitText(f"has {len(factors)} symbols, more than {_MOST_SYMBOLS}")
    return factors


def _fault(rest: str) -> str:
    if re.match(r"\s*(\^|\*\*)", rest):
        return "is no unit: a power stands where a symbol must"
    rest = re.sub(r"^\s*[*/]?\s*", "", rest)
    if not rest:
        return "is no unit: it ends where a symbol must follow"
    if rest.startswith("("):
        nested = "(" in rest[1:].partition(")")[0]
        return (
            "has brackets inside brackets: write it as one product, as in N/(m s)" if nested else "has an open bracket"
        )
    if rest.startswith(")"):
        return "is no unit: its brackets do not match"
    return f"is no unit: '{rest[:20]}' cannot be read"


def _power(text: str) -> float:
    number = text.lstrip("^* ").strip("() ")
    above, _, below = number.partition("/")
    if len(number) > 12 or float(below or 1) == 0.0:
        raise UnitText(f"has a power of '{number[:20]}'")
    return float(above) / float(below or 1)


def _product(factors: list[tuple[str, float]]) -> pint.Unit:
    unit = registry().Unit("")
    for symbol, power in factors:
        found, more = _symbol(symbol)
        power *= more
        if abs(power) > _LARGEST_POWER:
            raise UnitText(f"has a power of {power:g}; at most {_LARGEST_POWER:g} is accepted")
        unit = unit * found ** (int(power) if power.is_integer() else power)
    return unit


@functools.lru_cache(512)
def _symbol(text: str) -> tuple[pint.Unit, float]:
    """A single symbol, and the power that stands in it, as in "s2" and "s-1"."""
    torque = _TORQUE.fullmatch(text)
    if torque:
        return registry().parse_units(torque[1]) * registry().parse_units(torque[2]), 1.0
    powered = re.fullmatch(r"(.*?[^\d_-])(-?\d)", text)
    for name, power in ((text, 1.0), (powered[1], float(powered[2])) if powered else ("", 1.0)):
        prefix, word = _PREFIXED.fullmatch(name.lower()).groups() if name else (None, "")  # pyright: ignore
        name = _PREFIXES[prefix] + _WORDS[word] if word in _WORDS else _ALIASES.get(name, name)
        if not name or len(name) > _LONGEST_SYMBOL or "-" in name or name in _NONE:
            continue
        try:
            return registry().parse_units(name), power
        except Exception:
            continue
    raise UnitText(f"has no unit that is known here ('{text[:_LONGEST_SYMBOL]}')")
