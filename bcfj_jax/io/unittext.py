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
_TOKEN = re.compile(
    rf"""\s*(?:
      (?P<symbol>°[CF]?|%|‰|(?!\d)[A-Za-zµΩ_]+(?:_?\d+(?![\d.]))?(?:-\d(?!\d))?)
    | (?P<power>(?:\^|\*\*)\s*(?:\(\s*{_POWER}\s*\)|{_POWER}))
    | (?P<one>1(?![\d.]))
    | (?P<sign>[*/()])
    )\s*""",
    re.VERBOSE,
)
# Torques and impulses are written without a space. Pint reads "Nm" as a count per length of yarn.
_TORQUE = re.compile(r"([pnuµmkMGT]?N)(mm|cm|m|s)")
# What rigs and their software write, and Pint does not know or reads as something else.
_ALIASES = {
    "Sek": "s", "sek": "s", "Sekunden": "s", "seconds": "s", "mSek": "ms", "msek": "ms", "Std": "h", "kp": "kgf",
    "Ohm": "ohm", "Grad": "deg", "U": "revolution", "Umdr": "revolution", "r": "revolution", "rev": "revolution",
}  # fmt: skip


class UnitText(ValueError):
    """A text that is no unit; the message is a clause that follows the quoted text."""


@functools.cache
def registry() -> pint.UnitRegistry:
    """Pint's units, loaded once and on first use."""
    import pint

    return pint.UnitRegistry(cache_folder=None)


def parse(text: str) -> pint.Unit:
    """The unit that a text states; "", "1" and "-" are dimensionless.

    Raises:
        UnitText: for an unknown symbol, a text that is no product of powers, and one beyond the limits.
    """
    if len(text) > LONGEST:
        raise UnitText(f"is {len(text)} characters long, more than the {LONGEST} of the longest unit")
    text = text.strip()
    if text in DIMENSIONLESS:
        return registry().Unit("")
    return _product(_factors(_tokens(text)))


def symbols(text: str) -> list[str]:
    """The symbols of a unit text, for a question about how it is written.

    Raises:
        UnitText: as ``parse``.
    """
    return [symbol for symbol, _ in _factors(_tokens(text.strip()))] if text.strip() not in DIMENSIONLESS else []


def _tokens(text: str) -> list[tuple[str, str]]:
    plain = re.sub(r"[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda m: "^" + m[0].translate(_SUPERSCRIPTS), text).translate(_SIGNS)
    tokens, at = [], 0
    while at < len(plain):
        found = _TOKEN.match(plain, at)
        if found is None:
            raise UnitText(f"is no unit: '{plain[at : at + 20]}' cannot be read")
        tokens.append((str(found.lastgroup), found[str(found.lastgroup)]))
        at = found.end()
    return tokens


def _factors(tokens: list[tuple[str, str]]) -> list[tuple[str, float]]:
    """Symbols with their powers; a group in brackets has its own power, and no group inside."""
    factors: list[tuple[str, float]] = []
    group: int | None = None  # where in ``factors`` an open group begins
    outer, side, last, ready = 1.0, 1.0, (0, 0), False  # signs of the power; what a power acts on; an operand stands
    for kind, text in tokens:
        begin = len(factors)
        if kind == "symbol":
            factors.append((text, outer * side))
            side, last, ready = 1.0, (begin, begin + 1), True
        elif kind == "one":
            side, last, ready = 1.0, (begin, begin), True
        elif kind == "power":
            if not ready or last == (0, 0):
                raise UnitText("is no unit: a power stands where a symbol must")
            power = _power(text)
            factors[slice(*last)] = [(symbol, own * power) for symbol, own in factors[slice(*last)]]
            last = (0, 0)
        elif text == "(":
            if group is not None:
                raise UnitText("has brackets inside brackets: write it as one product, as in N/(m s)")
            group, outer, side, ready = begin, side, 1.0, False
        elif text == ")":
            if group is None or not ready:
                raise UnitText("is no unit: its brackets do not match")
            last, group, outer = (group, begin), None, 1.0
        else:
            if not ready:
                raise UnitText(f"is no unit: '{text}' stands where a symbol must")
            side, ready = (-1.0 if text == "/" else 1.0), False
    if group is not None or not ready:
        raise UnitText("is no unit: it ends where a symbol must follow" if group is None else "has an open bracket")
    if len(factors) > _MOST_SYMBOLS:
        raise UnitText(f"has {len(factors)} symbols, more than {_MOST_SYMBOLS}")
    return factors


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
        name = _ALIASES.get(name, name)
        if not name or len(name) > _LONGEST_SYMBOL or "-" in name:
            continue
        try:
            return registry().parse_units(name), power
        except Exception:
            continue
    raise UnitText(f"has no unit that is known here ('{text[:_LONGEST_SYMBOL]}')")
