"""What columns of a record are: what their names say, their units, and what their numbers do."""

from __future__ import annotations

import re

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.data.clock import TIMES
from bcfj_jax.data.numbers import is_missing, is_number
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import GRAVITIES, WEIGHTS, accelerates, column, scale_of

# Readings by the unit of their column, as scenes of one body have them; and names by which a column without a unit is one.
KINDS = ("s", "N", "m/s^2", "m/s", "m")
NAMES = {
    "s": TIMES,
    "N": (
        "force", "load", "f", "fn", "f_n", "fz", "fx", "fy", "kraft", "normal", "normalkraft", "fuerza", "standardkraft",
        "prüfkraft", "effort", "forza", "loadcell", "last", "weight", "gewicht", "poids", "força", "forca", "siła", "síla",
        "kracht", "voima", "erő", "сила", "усилие", "нагрузка", "力", "荷重", "힘",
    ),
    "m/s^2": ("acceleration", "accel", "acc", "a", "az", "ax", "ay", "beschleunigung", "accélération",
        "aceleración", "ускорение"),
    "m/s": ("velocity", "speed", "v", "vel", "geschwindigkeit"),
    "m": ("position", "displacement", "x", "y", "z", "height", "place", "weg", "перемещение", "変位", "位移"),
}  # fmt: skip
_NEITHER = {"moment", "torque", "drehmoment", "moments", "max", "maximum", "count", "rate", "power"}
# Readings of the scenes, in the order in which they tell a contact; an acceleration along +x is negative in contact.
READ = {"N": "contact.normal", "m/s^2": "body.acceleration.x", "m/s": "body.velocity.x", "m": "body.place.x"}


def name_of(header: str) -> str:
    """The name of a column without its unit, in lower case."""
    return column(header)[0].lower().strip()


def named(header: str, unit: str) -> bool:
    """Whether a name is one of a reading of a unit: as a whole, or by one of its words of three letters and more."""
    name = name_of(header)
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column(header)[0]).lower()
    words = {w for w in re.split(r"[\W\d_]+", parted) if len(w) > 2}
    # "A" is a channel of an oscilloscope.
    whole = name in NAMES[unit] and column(header)[0].strip() != "A"
    return whole or bool(words & set(NAMES[unit]) and not words & _NEITHER)


def values_of(table: Record, header: str, unit: str) -> np.ndarray:
    """The readings of a column, SI; none where it cannot be read."""
    try:
        return table.numbers(header, unit, table.name, True)
    except InputError:
        return np.zeros(0)


def counts(table: Record, header: str) -> bool:
    """Whether a column counts the samples."""
    values = values_of(table, header, "1")
    return values.size > 1 and bool((np.diff(values) == 1.0).all())


def rises(table: Record, header: str) -> bool:
    """Whether a column increases throughout."""
    values = values_of(table, header, "1") if header else np.zeros(0)
    return values.size > 1 and bool((np.diff(values) > 0.0).all())


def is_numeric(cells: np.ndarray) -> bool:
    """Whether most cells of a column (N,) are numbers."""
    if cells.dtype.kind in "iuf":
        return True
    seen = [c for c in cells[:: max(1, cells.size // 500)].tolist() if not is_missing(c)]
    # A column of readings with some faults is one all the same, so that its faults can be named.
    return sum(map(is_number, seen)) > 0.5 * len(seen)


def read_unit(table: Record, header: str) -> str | None:
    """The SI unit of ``KINDS`` that a header's unit converts to, or that of its sensor's sensitivity."""
    name, text = column(header)[0], table.unit(header)
    if text in KINDS:
        return text
    if text in WEIGHTS and named(header, "N"):
        return "N"
    for unit in KINDS if text else ():
        if text in GRAVITIES and not (unit == "m/s^2" and accelerates(name)):
            continue
        try:
            scale_of(str(text), unit, header)
        except InputError:
            continue
        return unit
    return None
