"""A model whose runs begin in a given state at a given time, so that whatever solves a model goes on from there."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import AbstractModel, Approaches, Params
from bcfj_jax.mechanism.observed import Observed
from bcfj_jax.mechanism.structure import AbstractStructure

# Beside the parameters: the state (n,) and the time [s] at which a run begins.
START, BEGIN = "start of the run", "time of the start"


class _Later(AbstractStructure):
    """The structure of a model, at times counted from ``BEGIN``; ``args`` is (model, (prepared, begin))."""

    inner: AbstractStructure
    model: AbstractModel

    def field(self, t: Any, y: Array, args: Any) -> Array:
        prepared, begin = args[1]
        return self.inner.field(t + begin, y, (self.model, prepared))

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> Any:
        prepared, begin = args[1]
        return self.inner.factor(t + begin, y, (self.model, prepared), scale)

    def solve(self, factors: Any, right: Array) -> Array:
        return self.inner.solve(factors, right)

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        prepared, begin = args[1]
        return self.inner.time_derivative(t + begin, y, (self.model, prepared))


class Onward(Observed):
    """``inner`` from the state ``START`` at the time ``BEGIN``, both among the parameters; times count from there."""

    channels: tuple = eqx.field(static=True, default=())

    def prepare(self, params: Params) -> Any:
        """The model's, and the time of the start."""
        return self.inner.prepare(_own(params)), jnp.asarray(params[BEGIN])

    def initial_state(self, params: Params) -> Array:
        """The given one."""
        return jnp.asarray(params[START])

    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        """The model's, later."""
        return self.inner.vector_field(t + prepared[1], y, prepared[0])

    def approaches(self, t: Array, y: Array, prepared: Any) -> Approaches:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The model's, later."""
        return self.inner.approaches(t + prepared[1], y, prepared[0])

    def structure(self) -> AbstractStructure:
        """The model's, later."""
        return _Later(self.inner.structure(), self.inner)

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Any]:
        """The model's, later."""
        return self.inner.observe(t + prepared[1], y, prepared[0])


def _own(params: Params) -> Params:
    return {name: value for name, value in params.items() if name not in (START, BEGIN)}
