"""SDIRK2: two stages, every one implicit, L-stable, order 2; made to be differentiated.

gamma = 1 - 1/sqrt(2) (Alexander 1977; stiffly accurate). Newton keeps its matrix while it converges quickly, over
both stages. Its solution is differentiated by the implicit function theorem: one solve with the matrix at the
solution, shared by all tangents; never through the iteration, the matrix's construction or the step control. A
tangent is then multiplied by (I - h gamma J)^-1 at every stage, which is bounded however large h J is; methods with
an explicit stage multiply by h J.
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
        contraction: Newton takes a new matrix where a change is larger than this share of the one before.
    """

    structure: AbstractStructure
    tolerance: Array
    newton: float = eqx.field(static=True, default=0.02)
    iterations: int = eqx.field(static=True, default=20)
    contraction: float = eqx.field(static=True, default=0.2)

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
        fixed = jax.lax.stop_gradient(eqx.filter(args, eqx.is_array))
        held = eqx.combine(fixed, eqx.filter(args, eqx.is_array, inverse=True))
        factors = self.structure.factor(t0, jax.lax.stop_gradient(y0), held, s)
        # Newton starts from extrapolated slopes; a stiff one at the start may be far off, so it is damped and limited.
        guess = y0 + self.structure.solve(factors, first)
        middle, good, factors = self._stage(t0 + s, y0, guess, s, args, factors)
        second = (middle - y0) / s
        base = y0 + h * (1.0 - GAMMA) * second
        turn = (second - first) * (1.0 - GAMMA) / GAMMA
        guess = base + s * (second + jnp.clip(turn, -jnp.abs(second), jnp.abs(second)))
        y1, also, factors = self._stage(t1, base, guess, s, args, factors)
        last = (y1 - base) / s
        bend = ((last - second) / (1.0 - GAMMA) - (second - first) / GAMMA) * 2.0
        error = self.structure.solve(factors, h * ERROR * jax.lax.stop_gradient(bend) / s)
        error = jnp.where(good & also, error, jnp.inf)
        return y1, error, dict(y0=y0, y1=y1, k0=h * first, k1=h * last), last, dfx.RESULTS.successful

    def _stage(self, t: Any, base: Array, guess: Array, s: Any, args: Any, factors: Any) -> tuple[Array, Array, Any]:
        """The y of  y = base + s f(t, y),  whether Newton got there, and the last matrix it used.

        Newton keeps its matrix while it converges quickly: contact springs appear within a step, and then it must not.
        """
        arrays, static = eqx.partition(args, eqx.is_array)
        structure = self.structure

        def residual(y, t, base, s, arrays):
            return (base - y) / s + structure.field(t, y, eqx.combine(arrays, static))

        def newton(t, base, guess, s, arrays, tolerance, factors):
            def step(carry):
                y, size, count, slow, factors = carry
                factors = jax.lax.cond(
                    slow,
                    lambda y, _: structure.factor(t, y, eqx.combine(arrays, static), s),
                    lambda _, f: f,
                    y,
                    factors,
                )
                change = structure.solve(factors, residual(y, t, base, s, arrays))
                new = jnp.sqrt(jnp.mean(jnp.square(change / tolerance)))
                return y + change, new, count + 1, ~(new < self.contraction * size), factors

            def more(carry):
                _, size, count, *_ = carry
                return (count == 0) | ((size > self.newton) & jnp.isfinite(size) & (count < self.iterations))

            start = (guess, jnp.asarray(jnp.inf), 0, jnp.asarray(False), factors)
            y, size, _, _, factors = jax.lax.while_loop(more, step, start)
            return y, size <= self.newton, factors

        @jax.custom_jvp
        def solve(t, base, guess, s, arrays, tolerance, factors):
            return newton(t, base, guess, s, arrays, tolerance, factors)

        @solve.defjvp  # pyright: ignore[reportArgumentType]
        def _(primals, tangents):
            t, base, _, s, arrays, *_ = primals
            y, good, kept = newton(*primals)
            t_dot, base_dot, _, s_dot, arrays_dot, *_ = tangents
            _, right = jax.jvp(
                lambda t, base, s, arrays: residual(y, t, base, s, arrays),
                (t, base, s, arrays),
                (t_dot, base_dot, s_dot, arrays_dot),
            )
            exact = structure.factor(t, y, eqx.combine(arrays, static), s)
            return (y, good, kept), (structure.solve(exact, right), _flat(good), jax.tree.map(_flat, kept))

        y, good, factors = solve(t, base, guess, s, arrays, self.tolerance, factors)
        return y, good, jax.lax.stop_gradient(factors)


def _flat(x: Array) -> Any:
    """The tangent of what is not differentiated."""
    return jnp.zeros_like(x) if jnp.issubdtype(x.dtype, jnp.inexact) else np.zeros(x.shape, jax.dtypes.float0)
