"""What a calibration is given through Python, checked once: numbers with their units, names, arrays, types.

Files give the same classes with numbers that are SI already; both pass here.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.quantities import Quantity, real, scalar


def text(where: str, given: Any, remedy: str) -> str:
    """A name that is none is refused."""
    if not isinstance(given, str) or not given:
        raise InputError(where, f"{quoted(given)} is not a name", remedy)
    return given


def not_negative(where: str, name: str, unit: str, given: Any) -> float:
    """A number that is finite and 0 or more, or a text with its unit, in SI."""
    return scalar(where, Quantity(name, unit, name, low=0.0), given)


def plain(where: str, name: str, unit: str, given: Any) -> float:
    """A number, or a text with its unit, in SI; what it may be is checked where the place in a file is known."""
    if isinstance(given, str):
        return scalar(where, Quantity(name, unit, name), given)
    found = real(where, name, given)
    if found.ndim:
        raise InputError(where, f"{name} has shape {found.shape}", "give one number")
    return float(found)


def readings(where: str, given: Any) -> np.ndarray:
    """Readings (T,), NaN where there is no sample."""
    found = real(where, "values", given)
    if found.ndim != 1:
        raise InputError(where, f"values of shape {found.shape}", "give a 1-D array, a reading a time")
    if np.isinf(found).any():
        raise InputError(where, "a value is infinite", "give nan where there is no sample")
    return found


def fill(frozen: Any, values: Mapping[str, Any]) -> None:
    """Set fields of a frozen dataclass while it is made."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


def all_of(where: str, given: Any, kind: type) -> tuple[Any, ...]:
    """A tuple of objects of one class."""
    remedy = f"give a list of calibration.{kind.__name__}(...)"
    if isinstance(given, (kind, str, bytes, Mapping)) or not isinstance(given, Iterable):
        raise InputError(where, quoted(given), remedy)
    found = tuple(given)
    for one in found:
        if not isinstance(one, kind):
            raise InputError(where, quoted(one), remedy)
    return found


def path(where: str, given: Any) -> Path:
    """A path, as a text or a ``Path``."""
    if not isinstance(given, (str, os.PathLike)):
        raise InputError(where, f"{quoted(given)} is no path", "give the path of a file, as a text")
    return Path(given)


def table(where: str, given: Any) -> dict[str, Any]:
    """Values by name."""
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise InputError(where, f"{quoted(given)} is no table", 'give values by name, as {"mass": 0.5}')
    return dict(given)


def numbers(where: str, given: Any, known: Mapping[str, Quantity]) -> dict[str, float]:
    """A table of numbers by the names of known quantities; texts with a unit are converted."""
    found = table(where, given)
    for name, value in found.items():
        if name not in known:
            raise InputError(where, f"no parameter {quoted(name)} = {quoted(value)}", nearest(name, known))
        found[name] = scalar(where, known[name], value)
    return found


def tolerances(where: str, given: Any, known: Mapping[str, Quantity]) -> dict[str, float]:
    """How well values are known, 0 or more; a name that is not known may be another model's of the same data."""
    units = {name: known[name].unit if name in known else "1" for name in table(where, given)}
    return {name: not_negative(where, name, unit, given[name]) for name, unit in units.items()}


def pair(where: str, given: Any, quantity: Quantity) -> tuple[float, float]:
    """Two numbers of a quantity, the smaller first."""
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise InputError(where, f"{quoted(given)} is no pair", 'give [lower, upper], such as ["-1 ms", "2 ms"]')
    lower, upper = (scalar(where, quantity, value) for value in given)
    if not lower < upper:
        raise InputError(where, f"{lower:g} is not below {upper:g}", "swap the bounds")
    return lower, upper
