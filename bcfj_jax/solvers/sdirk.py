"""Two-stage, L-stable SDIRK of order 2, every stage implicit. Prototype."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.solvers.structure import AbstractStructure

GAMMA = 1.0 - 0.5**0.5


class Sdirk(dfx.AbstractAdaptiveSolver):
    structure: AbstractStructure
    scales: Array
    kappa: float = 0.05
    iterations: int = eqx.field(static=True, default=8)
    full: bool = eqx.field(static=True, default=False)

    term_structure: ClassVar = dfx.ODETerm
    interpolation_cls: ClassVar[Callable] = dfx.ThirdOrderHermitePolynomialInterpolation

    def order(self, terms):
        return 2

    def error_order(self, terms):
        return 3

    def init(self, terms, t0, t1, y0, args):
        return self.structure.field(t0, y0, args), jnp.zeros(4)

    def func(self, terms, t0, y0, args):
        return self.structure.field(t0, y0, args)

    def _stage(self, t, base, guess, s, args, factors):
        norm = lambda d: jnp.sqrt(jnp.mean(jnp.square(d / self.scales)))

        def step(carry):
            y, last, rate, count, _ , fac= carry
            fac_ = self.structure.factor(t, y, args, s) if self.full else fac
            r = (base - y) / s + self.structure.field(t, y, args)
            d = self.structure.solve(fac_, r)
            size = norm(d)
            rate = jnp.where(count > 0, size / last, 0.5)
            bad = ~jnp.isfinite(size) | ((count > 1) & (rate > 2.0))
            return y + d, size, rate, count + 1, bad, fac

        def more(carry):
            y, last, rate, count, bad, fac = carry
            est = last * jnp.where(count > 1, jnp.minimum(rate / jnp.maximum(1 - rate, 1e-3), 1.0), 1.0)
            return ~bad & (est > self.kappa) & (count < self.iterations)

        out = jax.lax.while_loop(more, step, (guess, jnp.inf, 1.0, 0, False, factors))
        bad = out[4] | more(out)
        return out[0], bad, out[3]

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        f0, stat = solver_state
        h = t1 - t0
        s = h * GAMMA
        factors = self.structure.factor(t0, y0, args, s)
        y1, bad1, n1 = self._stage(t0 + s, y0, y0 + s * f0, s, args, factors)
        f1 = (y1 - y0) / s
        base = y0 + h * (1 - GAMMA) * f1
        y2, bad2, n2 = self._stage(t1, base, base + s * (f1+(f1-f0)*(1-GAMMA)/GAMMA) , s, args, factors)
        f2 = (y2 - base) / s
        # third derivative by the second divided difference of f at 0, gamma, 1
        g = GAMMA
        second = ((f2 - f1) / (1 - g) - (f1 - f0) / g)
        const = abs(1/6 - (g*(1-g)+ g*1)*0.5 + 0 )  # placeholder
        est = h * 0.04 * 2* second
        est = self.structure.solve(factors, est / s)
        bad = bad1 | bad2
        est = jnp.where(bad, jnp.inf, est)
        stat = stat + jnp.array([n1, n2, bad1, bad2])
        return y2, est, dict(y0=y0, y1=y2, k0=h * f0, k1=h * f2), (f2, stat), dfx.RESULTS.successful
