"""Sensors whose records are voltages, charges, counts or shares of a full scale: "2.3 mV/N", "4 pC/N", "100 mV/g", "100 N/V".

Several sensors are told apart by the names of their columns: "CH1 = 2.3 mV/N, CH2 = 100 mV/g". A WAV file has a full scale, as
in "500 N".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

from bcfj_jax.core.errors import InputError, clip
from bcfj_jax.data.columns import FULL_SCALE
from bcfj_jax.io.units import COUNTS, GRAVITIES, scale_of

_GIVE = 'say what it stands for: --sensitivity "10 mV/N" of init calibration, or sensitivity = "10 mV/N" under [[experiment]]'
_FULL = (
    'say what full scale is: --full-scale "500 N" of init calibration, or "10 V" with --sensitivity "10 mV/N"; '
    'or full_scale = "500 N" under [[experiment]]'
)
NEEDED = {
    "": _GIVE, FULL_SCALE: _FULL, **dict.fromkeys(("pC", "nC", "C"), _GIVE.replace("mV/N", "pC/N")),
    "mV/V": _GIVE.replace("10 mV/N", "2 mV/V/kN"), **dict.fromkeys(("mA", "A"), _GIVE.replace("10 mV/N", "16 mA/kN")),
    **{u: _GIVE.replace("10 mV/N", {"px": "20 px/mm", "ue": "0.5 ue/N"}.get(b, "85 counts/N")) for u, b in COUNTS.items()},
}  # fmt: skip
# Units of columns that are no quantity of a scene, and in which a sensitivity is written.
_BRIDGE = "mV/V"
_VOLTS = ("V", "Volt", "Volts", "volt", "volts", "mV", "uV", "µV", "kV", "Vdc", "VDC", "mVolt", _BRIDGE)
ELECTRICAL = {
    **dict.fromkeys(_VOLTS, "mV"), **dict.fromkeys(("pC", "nC", "C"), "pC"), **dict.fromkeys(("mA", "A"), "mA"),
    FULL_SCALE: FULL_SCALE, **COUNTS,
}  # fmt: skip
_BASES = {"mV": "V", "pC": "C", "mA": "A", "px": "px", "counts": "counts", "ue": "ue"}
_ALIKE = {"Vdc": "V", "VDC": "V", "Volts": "V", "volts": "V", "Volt": "V", "volt": "V", "mVolt": "mV"}
# What a sensor may read, in SI.
_READ = ("N", "m/s^2", "m/s", "m", "N m")
_ONE = re.compile(r"(?:(?P<name>[^=]+?)\s*=\s*)?(?P<number>[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)\s*(?P<unit>\S.*?)\s*")
_RIGHT_FULL = 'give one such as "500 N" or "100 g", or "10 V" and the sensitivity'
_RIGHT = 'give one such as "2.3 mV/N", "4 pC/N", "100 mV/g" or "100 N/V"'


class Factor(NamedTuple):
    """What one unit of a column is in SI: the factor, the SI unit, and the text it is from."""

    factor: float
    si_unit: str
    text: str


@dataclass(frozen=True)
class Sensitivities:
    """Sensitivities by column, "" for all others, and of a full scale; each as it was stated."""

    stated: str = ""
    full_scale: str = ""
    where: str = ""

    def of(self, name: str, unit: str | None) -> Factor | None:
        """The factor of a column of a unit; None where none is stated or the unit is no sensor's."""
        full = unit == FULL_SCALE
        text, where = (self.full_scale, "full_scale") if full else (self.stated, "sensitivity")
        if not text or unit is None or unit not in ELECTRICAL:
            return None
        other, where = None, f"{self.where} {where}"
        for one in re.split(r"[,;]\s*(?=\D)", text):
            found = _ONE.fullmatch(one.strip())
            if not found:
                raise InputError(where, f"'{clip(one)}' is none", _RIGHT_FULL if full else _RIGHT)
            if found["name"] in (None, name):
                number, named = float(found["number"]), bool(found["name"])
                if full and (volts := _scale(_ALIKE.get(found["unit"], found["unit"]), "V")) and self.stated:
                    behind = self.of(name, "V")  # Of a converter: what stands before it is a sensor.
                    made = behind and behind._replace(factor=number * volts * behind.factor)
                elif full:
                    made = _full(number, found["unit"], where)
                else:
                    made = _factor(number, found["unit"], unit, where, named)
                if named:
                    return made
                other = made or other
        return other


def _full(number: float, text: str, where: str) -> Factor:
    for si_unit in _READ if number else ():
        if (scale := _scale(text, si_unit)) is not None:
            return Factor(number * scale, si_unit, f"{number:g} {text}")
    raise InputError(where, f"'{number:g} {clip(text)}' is no full scale", _RIGHT_FULL)


def _scale(unit: str, si_unit: str) -> float | None:
    """The factor to SI, with g as gravity; None for another quantity."""
    bare = unit.strip("() ")
    if si_unit in COUNTS or bare in COUNTS:
        return 1.0 if COUNTS.get(bare) == si_unit else None
    if si_unit == "m/s^2" and bare in GRAVITIES:
        return GRAVITIES[bare]
    if bare in GRAVITIES:
        return None
    try:
        return scale_of(bare, si_unit, "sensitivity")
    except InputError:
        return None


def _factor(number: float, text: str, unit: str, where: str, named: bool) -> Factor | None:
    """What one ``unit`` of a column is, of a sensitivity of ``number`` ``text``: in volts per newton, or newtons per volt.

    None of one that is not ``named`` and of another kind of sensor. mV/V of a bridge are taken as the mV of both.
    """
    said = text
    if unit == _BRIDGE:
        unit, text = "mV", text.replace(f"({_BRIDGE})", "mV").replace(_BRIDGE, "mV")
    above, _, below = re.sub(r"\(?[µμu]m/m\)?", "ue", text).partition("/")
    unit = "counts" if COUNTS.get(above.strip()) == "counts" else unit  # Whoever says so knows better than the file.
    base = _BASES.get(ELECTRICAL[unit], "V")
    for electric, other, inverse in ((above, below, True), (below, above, False)):
        volts = _scale(_ALIKE.get(electric.strip(), electric), base)
        if volts is None or not other or not number:
            continue
        for si_unit in _READ:
            if (scale := _scale(other, si_unit)) is not None:
                size = 1.0 if base in COUNTS else scale_of(_ALIKE.get(unit, unit), base, where)
                factor = scale / (number * volts) if inverse else number * scale / volts
                return Factor(factor * size, si_unit, f"{number:g} {said}")
    others = {_scale(part.strip(), b) for part in (above, below) for b in _BASES.values() if b != base}
    if not named and number and others != {None}:
        return None
    raise InputError(where, f"'{number:g} {clip(said)}' is no sensitivity of a column in {unit}", _RIGHT)


NONE = Sensitivities()
