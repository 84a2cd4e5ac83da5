"""What a design may change: free parameters with bounds and tolerances, and the unit box that they fill."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.axes import SCALES, Axis, bounded
from bcfj_jax.core.errors import InputError, nearest, quoted, texts
from bcfj_jax.core.quantities import Quantity, scalar
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params


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
    """The P free parameters: axes, half widths of tolerances (P,) [SI], which of these are relative, what each is."""

    axes: tuple[Axis, ...]
    tolerance: np.ndarray
    relative: np.ndarray
    quantities: tuple[Quantity, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(axis.name for axis in self.axes)

    def _each(self, what: str, x: np.ndarray) -> np.ndarray:
        return np.stack([getattr(axis, what)(x[..., k]) for k, axis in enumerate(self.axes)], axis=-1)

    def values(self, unit: np.ndarray) -> np.ndarray:
        """SI values (..., P) at points of the unit box."""
        return self._each("at", unit)

    def unit(self, values: np.ndarray) -> np.ndarray:
        """Coordinates (..., P) of SI values; outside of 0 to 1 for what lies beyond its bounds."""
        return self._each("share", values)

    def slope(self, values: np.ndarray) -> np.ndarray:
        """d(value)/d(coordinate) (..., P)."""
        return self._each("steepness", values)

    def halves(self, values: np.ndarray) -> np.ndarray:
        """Half widths of the tolerance box about nominal values [SI], (P,)."""
        return self.tolerance * np.where(self.relative, np.abs(values), 1.0)

    def legal(self, values: np.ndarray) -> str:
        """Which value lies outside of what its parameter may be at all; "" for none."""
        pairs = zip(self.quantities, values, strict=True)
        return next((f"{q.name} must be {q.range}" for q, x in pairs if not q.valid(float(x))), "")

    def named(self, values: Any) -> dict[str, float]:
        """One number a parameter, by its name."""
        return dict(zip(self.names, map(float, values), strict=True))


def space(scene: AbstractModel, params: Params, free: Mapping[str, Free | Sequence[Any]]) -> Space:
    """The free parameters, checked, each a ``Free`` or its fields in order: (lower, upper), (lower, upper, tolerance), ...

    ``params``: the others' values, as a stiffness' unit depends on the exponent. ``InputError`` for no parameter, an unknown
    one (with the nearest), a negative tolerance, and as ``axes.bounded``.
    """
    known, some = scene.quantities, f"name one or more of {', '.join(scene.quantities)}"
    if not isinstance(free, Mapping):
        raise InputError("free", quoted(free), 'give bounds by name: {"stiffness": (1e9, 1e11)}')
    if not free:
        raise InputError("free", "no parameter", some)
    texts("free", list(free), some)
    given = {scene.canonical(name): _fields(name, one) for name, one in free.items()}
    axes, tolerance = [], []
    for name, one in given.items():
        where = f"free '{name}'"
        if name not in known:
            raise InputError(where, f"scene '{scene.kind}' has no such parameter", nearest(name, known))
        axis: Any = Axis(name, one.lower, one.upper, one.scale)  # type: ignore[arg-type]
        axes.append(bounded(where, scene, params, axis, SCALES[:2]))
        half = Quantity("tolerance", "1" if one.relative else known[name].unit, "half width of a tolerance", 0.0)
        power = inputs.exponent(scene, name, params)
        tolerance.append(scalar(f"{where} tolerance", half, one.tolerance, power))
    relative = np.array([one.relative for one in given.values()])
    return Space(tuple(axes), np.array(tolerance), relative, tuple(known[name] for name in given))


def _fields(name: str, one: Any) -> Free:
    """What was given for one parameter, as ``Free``."""
    if isinstance(one, Free):
        return one
    if isinstance(one, str) or not isinstance(one, Sequence) or not 2 <= len(one) <= len(Free._fields):
        raise InputError(f"free '{name}'", quoted(one), f"give ({', '.join(Free._fields)}), the first two at least")
    return Free(*one)
