"""SDIRK2: two stages, every one implicit, L-stable, order 2; made to be differentiated.

gamma = 1 - 1/sqrt(2) (Alexander 1977; stiffly accurate). Newton with the matrix at each iterate, since contact
springs appear within a step. Its solution is differentiated by the implicit function theorem: one solve with the
matrix at the solution, shared by all tangents; never through the iteration, the matrix's construction or the step
control. A tangent is then multiplied by (I - h gamma J)^-1 at every stage, which is bounded however large h J is;
methods with an explicit stage multiply by h J.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.solvers.structure import AbstractStructure

GAMMA = 1.0 - 0.5**0.5
# Leading term of the local error over h^3 d3y/dt3, for a linear field: coefficient of z^3 in R(z) - exp(z).
ERROR = abs(3.0 * GAMMA**2 - 2.0 * GAMMA**3 - 1.0 / 6.0)


class Sdirk(dfx.AbstractAdaptiveSolver):
    """SDIRK2 for a flat state, with the linear algebra of ``structure``.

    Attributes:
        tolerance: the step control's absolute tolerance of each state; Newton stops at ``newton`` times it.
        iterations: of Newton, per stage; a stage that needs more rejects the step.
    """

    structure: AbstractStructure
    tolerance: Array
    newton: float = eqx.field(static=True, default=0.02)
    iterations: int = eqx.field(static=True, default=10)

    term_structure: ClassVar = dfx.ODETerm
    interpolation_cls: ClassVar[Callable[..., dfx.AbstractLocalInterpolation]] = (
        dfx.ThirdOrderHermitePolynomialInterpolation
    )

    def order(self, terms):
        """2."""
        return 2

    def error_order(self, terms):
        """The estimate is of the third derivative's term."""
        return 3

    def init(self, terms, t0, t1, y0, args):
        """The slope at the start; later the last stage's."""
        return self.structure.field(t0, y0, args)

    def func(self, terms, t0, y0, args):
        """The field."""
        return self.structure.field(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """Two stages; the error is the bend of three slopes, filtered by the stiff matrix."""
        del terms, made_jump
        first = solver_state
        h = t1 - t0
        s = h * GAMMA
        middle, good = self._stage(t0 + s, y0, y0 + s * first, s, args)
        second = (middle - y0) / s
        base = y0 + h * (1.0 - GAMMA) * second
        guess = base + s * (second + (second - first) * (1.0 - GAMMA) / GAMMA)
        y1, also = self._stage(t1, base, guess, s, args)
        last = (y1 - base) / s
        bend = ((last - second) / (1.0 - GAMMA) - (second - first) / GAMMA) * 2.0
        held, fixed, bend = jax.lax.stop_gradient((y1, eqx.filter(args, eqx.is_array), bend))
        factors = self.structure.factor(t1, held, eqx.combine(fixed, args), s)
        error = self.structure.solve(factors, h * ERROR * bend / s)
        error = jnp.where(good & also, error, jnp.inf)
        return y1, error, dict(y0=y0, y1=y1, k0=h * first, k1=h * last), last, dfx.RESULTS.successful

    def _stage(self, t: Any, base: Array, guess: Array, s: Any, args: Any) -> tuple[Array, Array]:
        """The y of  y = base + s f(t, y),  and whether Newton got there."""
        arrays, static = eqx.partition(args, eqx.is_array)
        structure = self.structure

        def residual(y, t, base, s, arrays):
            return (base - y) / s + structure.field(t, y, eqx.combine(arrays, static))

        def newton(t, base, guess, s, arrays, tolerance):
            def step(carry):
                y, _, count = carry
                factors = structure.factor(t, y, eqx.combine(arrays, static), s)
                change = structure.solve(factors, residual(y, t, base, s, arrays))
                size = jnp.sqrt(jnp.mean(jnp.square(change / tolerance)))
                return y + change, size, count + 1

            def more(carry):
                _, size, count = carry
                return (count == 0) | ((size > self.newton) & jnp.isfinite(size) & (count < self.iterations))

            y, size, _ = jax.lax.while_loop(more, step, (guess, jnp.asarray(jnp.inf), 0))
            return y, size <= self.newton

        @jax.custom_jvp
        def solve(t, base, guess, s, arrays, tolerance):
            return newton(t, base, guess, s, arrays, tolerance)

        @solve.defjvp  # pyright: ignore[reportArgumentType]
        def _(primals, tangents):
            t, base, _, s, arrays, _ = primals
            y, good = newton(*primals)
            t_dot, base_dot, _, s_dot, arrays_dot, _ = tangents
            _, right = jax.jvp(
                lambda t, base, s, arrays: residual(y, t, base, s, arrays),
                (t, base, s, arrays),
                (t_dot, base_dot, s_dot, arrays_dot),
            )
            factors = structure.factor(t, y, eqx.combine(arrays, static), s)
            return (y, good), (structure.solve(factors, right), np.zeros((), jax.dtypes.float0))

        return solve(t, base, guess, s, arrays, self.tolerance)
