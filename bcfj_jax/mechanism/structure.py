"""What an implicit solver asks of a problem: to factor  I/s - J  and to solve with it.

J is the Jacobian of the field. A problem that knows its sparsity answers in its own way (the joint: an
arrowhead, ``joint.arrowhead``); ``Dense`` answers for any other.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array


class AbstractStructure(eqx.Module):
    """The linear algebra of one family of fields ``field(t, y, args) -> dy/dt`` over a flat state.

    ``alone``: on a CPU runs of a batch take their steps one after another, since those of one stay in its cache.
    """

    alone: ClassVar[bool] = False

    @abstractmethod
    def field(self, t: Any, y: Array, args: Any) -> Array:
        """Time derivative of the state."""

    @abstractmethod
    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> Any:
        """Everything that solving with  I/scale - J(t, y)  needs; J exact, or the order is lost."""

    @abstractmethod
    def solve(self, factors: Any, right: Array) -> Array:
        """The x of  (I/scale - J) x = right."""

    def solve_transposed(self, factors: Any, right: Array) -> Array:
        """The x of  (I/scale - J)^T x = right;  the transpose of ``solve``, which is linear, where there is no shorter way."""
        return jax.linear_transpose(lambda x: self.solve(factors, x), right)(right)[0]

    @abstractmethod
    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        """Partial derivative of the field with respect to time."""


class Dense(AbstractStructure):
    """Any field: Jacobian by forward differentiation, LU."""

    function: Any = eqx.field(static=True)

    def field(self, t: Any, y: Array, args: Any) -> Array:
        return self.function(t, y, args)

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> Any:
        jacobian = jax.jacfwd(lambda y: self.function(t, y, args))(y)
        return jax.scipy.linalg.lu_factor(jnp.eye(y.size) / scale - jacobian)

    def solve(self, factors: Any, right: Array) -> Array:
        return jax.scipy.linalg.lu_solve(factors, right)

    def solve_transposed(self, factors: Any, right: Array) -> Array:
        return jax.scipy.linalg.lu_solve(factors, right, trans=1)

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        return jax.jvp(lambda t: self.function(t, y, args), (t,), (jnp.ones_like(t),))[1]
