"""What a certificate or data sheet says of a sensor: sizes that replace the default priors of its errors.

[instrument] of a calibration file is of all channels, a table in it of one, and ``instrument`` of an [[experiment]] of its
records alone. Sizes are limits of 95 %; a coverage factor may follow, "0.5 % of reading, k = 2". What is stated always acts,
in full (``uncertainty.systematic``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from bcfj_jax import InputError, nearest
from bcfj_jax.core.errors import quoted
from bcfj_jax.io.units import quantity, toleranced
from bcfj_jax.mechanism.channels import unit_of

# Units of what may be stated: "%" a share of the reading alone, "" that of the channel, or a share of peak or full scale.
KEYS = {
    "gain": "%", "nonlinearity": "", "zero": "", "drift": "", "resolution": "",
    "bandwidth": "Hz", "resonance": "Hz", "clock": "s",
}  # fmt: skip
_FULL = "full_scale"
_FULL_SCALE = ("full scale", "FS")
_OF = re.compile(r"(%)\s*of\s+(reading|peak|full scale|FS)\b")


class Limit(NamedTuple):
    """A size, SI, or as a share of the reading: of its peak, where an error does not grow with it."""

    value: float
    share: bool = False


def merged(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Statements of all records with those of one, which come first; tables of channels likewise."""
    both = dict(common)
    for key, value in own.items():
        inner = common.get(key)
        both[key] = {**inner, **value} if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return both


def stated(given: Mapping[str, Any], observes: str, known: Mapping[str, Any], where: str) -> dict[str, Limit]:
    """What is said of a channel, itself or with all; ``known``: by channel that is read.

    Raises:
        InputError: for what is no such property, channel, or size.
    """
    for key, value in given.items():
        if isinstance(value, Mapping) and key not in known:
            raise InputError(f"{where}.{key}", f"'{key}' is not observed", nearest(key, known))
    own = given.get(observes, {})
    said = {key: value for key, value in {**given, **own}.items() if not isinstance(value, Mapping)}
    full = said.pop(_FULL, None)
    scale = None if full is None else abs(quantity(full, unit_of(observes), f"{where}.{_FULL}"))
    return {
        key: value if isinstance(value, Limit) else _limit(key, value, observes, scale, where)
        for key, value in said.items()
    }


def _limit(key: str, text: object, observes: str, scale: float | None, where: str) -> Limit:
    place = f"{where}.{key}"
    if key not in KEYS:
        raise InputError(place, f"no property '{key}' of an instrument", nearest(key, (*KEYS, _FULL)))
    unit = KEYS[key] or unit_of(observes)
    if unit in ("Hz", "s"):
        value = quantity(text, unit, place)
        if not (value > 0.0 if unit == "Hz" else value >= 0.0):
            raise InputError(place, f"{key} = {quoted(text)}", f'give one above 0, such as "10 k{unit}"')
        return Limit(value)
    found = _OF.search(text) if isinstance(text, str) else None
    plain = _OF.sub("%", text) if isinstance(text, str) else f"{text}"
    share = "%" in plain
    if unit == "%" and (not share or (found and found[2] in _FULL_SCALE)):
        remedy = 'give a share of the reading, such as "0.5 % of reading, k = 2"'
        raise InputError(place, f"{key} = {quoted(text)}", remedy)
    size = toleranced(f"{1 if share else f'0 {unit}'} +- {plain}", "1" if share else unit, place)[1]
    if size is None:
        raise InputError(place, f"{key} = {quoted(text)}", 'give a size, such as "0.5 % of reading, k = 2"')
    if found and found[2] in _FULL_SCALE:
        if scale is None:
            raise InputError(place, f"{quoted(text)} of an unknown scale", f'add {_FULL} = "500 {unit}"')
        return Limit(size * scale)
    return Limit(size, share)
