"""What a calibration is given through Python, checked once: numbers with their units, names, arrays, types.

Files give the same classes with numbers that are SI already; both pass here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    """A tuple of objects of one class.

    Raises:
        InputError: for anything else.
    """
    remedy = f"give a list of calibration.{kind.__name__}(...)"
    if isinstance(given, (kind, str, bytes, Mapping)) or not isinstance(given, Iterable):
        raise InputError(where, quoted(given), remedy)
    found = tuple(given)
    for one in found:
        if not isinstance(one, kind):
            raise InputError(where, quoted(one), remedy)
    return found


def numbers(where: str, given: Any, known: Mapping[str, Quantity], strict: bool = True) -> dict[str, float]:
    """A table of numbers by the names of known quantities; texts with a unit are converted.

    Args:
        where: place, for the message.
        given: the table.
        known: quantities by name.
        strict: whether values must lie in the quantities' ranges; tolerances need not.

    Raises:
        InputError: for what is no table, a name that is not known, and what is no number of its unit.
    """
    if not isinstance(given, Mapping):
        raise InputError(where, f"{quoted(given)} is no table", 'give values by name, as {"mass": 0.5}')
    found = {}
    for name, value in given.items():
        if not isinstance(name, str) or name not in known:
            raise InputError(where, f"no parameter {quoted(name)} = {quoted(value)}", nearest(name, known))
        quantity = known[name] if strict else known[name]._replace(low=0.0, high=np.inf, open_low=False)
        found[name] = scalar(where, quantity, value, None)
    return found
