"""A parameter between two bounds, and its values by shares of the way between them: what studies vary and designs search."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.errors import InputError, one_of
from bcfj_jax.core.quantities import scalar
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params

SCALES = ("linear", "log", "normal")
# Half of a normal scale's width, in standard deviations, and what of the distribution lies beyond either bound.
_SIGMAS = 3.0
_OUT = 0.5 * math.erfc(_SIGMAS / math.sqrt(2.0))


class Axis(NamedTuple):
    """A parameter with its bounds [SI] and their scale; in a study also how many values a grid takes, or its values.

    On the scale "normal" equal shares are equal probabilities of a normal distribution between the bounds, which are
    three standard deviations off its mean and cut it off: a tolerance.
    """

    name: str
    lower: float
    upper: float
    scale: str = "linear"
    steps: int = 0
    values: tuple[float, ...] | None = None

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares 0 to 1 of the way from the lower bound to the upper one; a bound is met to the last bit."""
        if self.scale == "log":
            found = self.lower * (self.upper / self.lower) ** share
        else:
            found = self.lower + (self.upper - self.lower) * self._even(share)
        return np.where(share == 0.0, self.lower, np.where(share == 1.0, self.upper, found))

    def _even(self, share: np.ndarray) -> np.ndarray:
        if self.scale != "normal":
            return share
        from scipy.special import ndtri

        return 0.5 + 0.5 * ndtri(_OUT + (1.0 - 2.0 * _OUT) * share) / _SIGMAS

    def share(self, value: Any, xp: Any = np) -> Any:
        """The inverse of ``at``, beyond 0 to 1 for values beyond the bounds; ``xp``: NumPy or JAX's."""
        if self.upper == self.lower:
            return xp.zeros_like(value)
        if self.scale == "log":
            return xp.log(value / self.lower) / np.log(self.upper / self.lower)
        share = (value - self.lower) / (self.upper - self.lower)
        if self.scale != "normal":
            return share
        if xp is np:
            from scipy.special import ndtr
        else:
            from jax.scipy.special import ndtr
        return (ndtr(_SIGMAS * (2.0 * share - 1.0)) - _OUT) / (1.0 - 2.0 * _OUT)

    def steepness(self, value: np.ndarray) -> np.ndarray:
        """Derivative of values by their shares."""
        if self.scale == "log":
            return value * np.log(self.upper / self.lower)
        width = np.full_like(value, self.upper - self.lower)
        if self.scale != "normal":
            return width
        z = _SIGMAS * (2.0 * (value - self.lower) / width - 1.0)
        return width * (1.0 - 2.0 * _OUT) * np.sqrt(2.0 * np.pi) * np.exp(0.5 * z * z) / (2.0 * _SIGMAS)

    def grid(self) -> np.ndarray:
        """Its values in a grid or a list."""
        return self.at(np.linspace(0.0, 1.0, self.steps)) if self.values is None else np.array(self.values)


def bounded(
    where: str, scene: AbstractModel, params: Params, axis: Axis, scales: tuple[str, ...] = SCALES
) -> Axis:  # fmt: skip
    """An axis whose bounds may be texts with a unit, checked and in SI; ``where``: its place in a file or a call.

    ``params``: of the scene, since a stiffness' unit depends on the exponent. ``InputError`` for an unknown scale, bounds that
    are no range or leave the parameter's own, and a logarithmic one that reaches 0.
    """
    one_of(f"{where} scale", "scale", axis.scale, scales)
    quantity, power = scene.quantities[axis.name], inputs.exponent(scene, axis.name, params)
    lower, upper = (scalar(f"{where} {end}", quantity, getattr(axis, end), power) for end in ("lower", "upper"))
    if not lower < upper:
        raise InputError(where, f"lower = {lower:g} is not below upper = {upper:g}", "give lower < upper")
    if axis.scale == "log" and lower <= 0.0:
        raise InputError(f"{where} lower", f"{lower:g} on a log scale", "give a lower bound > 0")
    return axis._replace(lower=lower, upper=upper)
