"""What a design may change: free parameters with bounds and tolerances, and the unit box that they fill."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.errors import InputError, nearest, quoted, texts
from bcfj_jax.core.quantities import Quantity, scalar
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params

SCALES = ("linear", "log")


class Free(NamedTuple):
    """One free parameter. Numbers are SI; texts such as "20 um" are converted.

    Attributes:
        lower, upper: bounds of the nominal value.
        tolerance: half width of what manufacture makes of a nominal value, in the parameter's unit.
        relative: whether that is a fraction of the nominal value instead.
        scale: "linear", or "log" for what spans decades (stiffnesses, dashpots).
    """

    lower: float | str
    upper: float | str
    tolerance: float | str = 0.0
    relative: bool = False
    scale: str = "linear"


class Space(NamedTuple):
    """The free parameters as arrays (P,), SI: names, bounds, tolerances, which of these are relative, which axes are
    logarithmic; and what each parameter is.
    """

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    tolerance: np.ndarray
    relative: np.ndarray
    log: np.ndarray
    quantities: tuple[Quantity, ...]

    def values(self, unit: np.ndarray) -> np.ndarray:
        """SI values (..., P) at points of the unit box; a bound is met to the last bit."""
        low, high = self._ends()
        x = low + (high - low) * unit
        x = np.where(self.log, np.exp(np.where(self.log, x, 0.0)), x)
        return np.where(unit == 0.0, self.lower, np.where(unit == 1.0, self.upper, x))

    def unit(self, values: np.ndarray) -> np.ndarray:
        """Coordinates (..., P) of SI values; outside of 0 to 1 for what lies beyond its bounds."""
        low, high = self._ends()
        return (np.where(self.log, np.log(np.where(self.log, values, 1.0)), values) - low) / (high - low)

    def slope(self, values: np.ndarray) -> np.ndarray:
        """d(value)/d(coordinate) (..., P)."""
        low, high = self._ends()
        return (high - low) * np.where(self.log, values, 1.0)

    def halves(self, values: np.ndarray) -> np.ndarray:
        """Half widths of the tolerance box about nominal values [SI], (P,)."""
        return self.tolerance * np.where(self.relative, np.abs(values), 1.0)

    def legal(self, values: np.ndarray) -> str:
        """Which value lies outside of what its parameter may be at all; "" for none."""
        pairs = zip(self.quantities, values, strict=True)
        return next((f"{q.name} must be {q.range}" for q, x in pairs if not q.valid(float(x))), "")

    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        safe = [np.where(self.log, x, 1.0) for x in (self.lower, self.upper)]
        return tuple(  # type: ignore[return-value]
            np.where(self.log, np.log(s), x) for s, x in zip(safe, (self.lower, self.upper), strict=True)
        )


def space(scene: AbstractModel, params: Params, free: Mapping[str, Free | Sequence[Any]]) -> Space:
    """The free parameters, checked.

    Args:
        scene: whose parameters they are.
        params: the others' values: a stiffness' unit depends on the exponent.
        free: by name a ``Free``, or its fields in order: (lower, upper), (lower, upper, tolerance), ...

    Raises:
        InputError: for no parameter, an unknown one (with the nearest), bounds that are no range or leave the
            parameter's own, a negative tolerance, an unknown scale and a logarithmic one that reaches 0.
    """
    if not isinstance(free, Mapping):
        raise InputError("free", quoted(free), 'give bounds by name: {"stiffness": (1e9, 1e11)}')
    if not free:
        raise InputError("free", "no parameter", f"name one or more of {', '.join(scene.quantities)}")
    texts("free", list(free), f"name one or more of {', '.join(scene.quantities)}")
    free = {scene.canonical(name): one for name, one in free.items()}
    given = [_fields(name, one) for name, one in free.items()]
    rows = [_one(scene, params, name, one) for name, one in zip(free, given, strict=True)]
    lower, upper, tolerance = (np.array([row[k] for row in rows], dtype=float) for k in range(3))
    return Space(
        tuple(free), lower, upper, tolerance, np.array([g.relative for g in given]),
        np.array([g.scale == "log" for g in given]), tuple(scene.quantities[name] for name in free),
    )  # fmt: skip


def _fields(name: str, one: Any) -> Free:
    """What was given for one parameter, as ``Free``."""
    if isinstance(one, Free):
        return one
    if isinstance(one, str) or not isinstance(one, Sequence) or not 2 <= len(one) <= len(Free._fields):
        raise InputError(f"free '{name}'", quoted(one), f"give ({', '.join(Free._fields)}), the first two at least")
    return Free(*one)


def _one(scene: AbstractModel, params: Params, name: str, given: Free) -> tuple[float, float, float]:
    where, known = f"free '{name}'", scene.quantities
    if name not in known:
        raise InputError(where, f"scene '{scene.kind}' has no such parameter", nearest(name, known))
    if given.scale not in SCALES:
        raise InputError(f"{where} scale", f"no scale {quoted(given.scale)}", nearest(given.scale, SCALES))
    power = inputs.exponent(scene, name, params)
    lower, upper = (scalar(f"{where} {end}", known[name], getattr(given, end), power) for end in ("lower", "upper"))
    half = Quantity("tolerance", "1" if given.relative else known[name].unit, "half width of a tolerance", 0.0)
    tolerance = scalar(f"{where} tolerance", half, given.tolerance, power)
    if not lower < upper:
        raise InputError(where, f"lower = {lower:g} is not below upper = {upper:g}", "give lower < upper")
    if given.scale == "log" and lower <= 0.0:
        raise InputError(f"{where} lower", f"{lower:g} on a log scale", "give a lower bound > 0")
    return lower, upper, tolerance
