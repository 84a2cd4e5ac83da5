"""The transpose of BDF's own steps: reverse derivatives of the solution that ``bdf`` has found.

With weights of order q and of the last length, a step is  p = sum D_i,  b = p - sum gamma_i D_i / alpha,
y = b + c f(t, y),  e = y - p,  and D'_i = sum_(j >= i) D_j + e. Of cotangents D' its transpose is

    l = E^-T sum_(i <= q + 1) D'_i,   dp += (df/dp)^T l,   D_j = sum_(i <= j) D'_i + (1 - gamma_j / alpha) l / c - sum D'_i,

E = I/c - J(t, y) at the converged y: no iteration, no error control, and one solve and one vjp of the field a step for
any number of parameters. Outputs between steps and changes of length are fixed matrices of D, transposed. It is the
transpose of what ``bdf`` does to tangents along the same steps, up to rounding (Griewank and Walther, Evaluating
Derivatives, SIAM 2008, chapter 3, for transposition).

States come from the record: those of the last segment are kept, those of the segments before are solved again along
their own steps, from the differences at their beginning. So memory grows with the budget of steps by 17 bytes a step
and by what one segment in ``SEGMENT`` steps begins with. Solved again, states are the same within Newton's tolerance, a
fiftieth of the steps'; where a ball swings freely, a difference of rounding becomes that.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.solve.bdf import ALPHA, GAMMA, ORDERS, ROWS, Record, between, predicted, rescaled, rescaling, updated
from bcfj_jax.solve.sdirk import Sdirk, Stage, newton

# States kept of runs whose tangents are not in the step control, and of those where they are, which take ten times the steps.
SEGMENT = {False: 8192, True: 65536}
# Steps whose matrices and vjps are computed together.
BLOCK = 16
_EDGE = np.arange(ORDERS + 1)


class _Back(NamedTuple):
    """The way back: the run's solver, arguments (those that move, and those that do not), record, outputs and cotangents."""

    solver: Sdirk
    moving: Any
    fixed: Any
    record: Record
    count: Array
    times: Array
    cotangents: Array

    @property
    def args(self) -> Any:
        """Of the field."""
        return eqx.combine(self.moving, self.fixed)

    @property
    def size(self) -> int:
        """Steps of a segment."""
        return self.record.states.shape[0]

    def slopes(self, moving: Any, t: Array, y: Array) -> Array:
        """The field at several instants, as a function of the arguments that move."""
        field = self.solver.structure.field
        return jax.vmap(lambda t, y: field(t, y, eqx.combine(moving, self.fixed)))(t, y)

    def again(self, j: Array) -> Array:
        """States (S, n) of a whole segment, within Newton's tolerance; NaN where Newton fails."""
        record, alpha, args = self.record, jnp.asarray(ALPHA), self.args

        def step(i: Array, carry: tuple) -> tuple:
            d, states = carry
            k = j * self.size + i
            t, h, order = record.ends[k + 1], record.lengths[k + 1], record.orders[k + 1]
            before, length = record.ends[k], record.lengths[k]
            # The matrix that the run had: the one at the state before, and its own in the first step.
            factors = self.solver.structure.factor(before, d[0], args, length / alpha[record.orders[k]])
            d = rescaled(d, order, h / length)
            ahead, base = predicted(d, order)
            stage = Stage(t, base, h / alpha[order], args)
            y, good, _ = newton(self.solver, stage, ahead, factors, k == 0)
            y = jnp.where(good, y, jnp.nan)
            return updated(d, order, y - ahead), states.at[i].set(y)

        start = jnp.zeros((ROWS, record.states.shape[1])).at[: ORDERS + 1].set(record.starts[j])
        return jax.lax.fori_loop(0, self.size, step, (start, jnp.zeros_like(record.states)))[1]

    def step(self, carry: tuple, row: tuple) -> tuple:
        """One step, last first; what is no step gives a zero."""
        d, out = carry
        t, h, order, before, h_before, factors, real = row
        times, alpha, gamma = self.times, jnp.asarray(ALPHA), jnp.asarray(GAMMA)

        def read(carry: tuple) -> tuple:
            d, out = carry
            weights = between(times[out - 1], t, h, order)
            return d + weights[:, None] * self.cotangents[out - 1], out - 1

        def due(carry: tuple) -> Array:
            _, out = carry
            return (out > 0) & (times[jnp.maximum(out - 1, 0)] > before)

        def pull(d: Array, out: Array) -> tuple:
            d, out = jax.lax.while_loop(due, read, (d, out))
            used = (order >= _EDGE)[:, None]
            bend = jnp.sum(jnp.where(_EDGE[:, None] <= order + 1, d, 0.0), axis=0)
            found = self.solver.structure.solve_transposed(factors, bend)
            share = (1.0 - gamma / alpha[order])[:, None] * (found * alpha[order] / h)
            d = jnp.where(used, jnp.cumsum(d, axis=0) + share - bend, 0.0)
            return rescaling(order, h / h_before) @ d, out, found

        d, out, found = jax.lax.cond(real, pull, lambda d, out: (d, out, jnp.zeros_like(d[0])), d, out)
        return (d, out), found

    def blocks(self, carry: tuple, j: Array, states: Array) -> tuple:
        """The steps of a segment, as many at a time as have their matrices made together."""
        record, block, factor, args = self.record, min(BLOCK, self.size), self.solver.structure.factor, self.args

        def one(carry: tuple) -> tuple:
            left, d, out, by = carry
            at = left - block + jnp.arange(block)
            # A block may be longer than what is left: its first steps are none.
            i = jnp.maximum(at, 0)
            k = j * self.size + i
            t, h, order, y = record.ends[k + 1], record.lengths[k + 1], record.orders[k + 1], states[i]
            factors = jax.vmap(lambda t, y, c: factor(t, y, args, c))(t, y, h / jnp.asarray(ALPHA)[order])
            rows = (t, h, order, record.ends[k], record.lengths[k], factors, at >= 0)
            (d, out), found = jax.lax.scan(self.step, (d, out), rows, reverse=True)
            push = jax.vjp(lambda moving: self.slopes(moving, t, y), self.moving)[1](found)[0]
            return left - block, d, out, jax.tree.map(jnp.add, by, push)

        left = jnp.minimum(self.count - j * self.size, self.size)
        return jax.lax.while_loop(lambda carry: carry[0] > 0, one, (left, *carry))[1:]

    def segment(self, carry: tuple) -> tuple:
        """The last segment that is left."""
        j, *rest = carry
        record, states = self.record, self.record.states
        if record.starts.shape[0] > 1:
            last = self.count // self.size
            states = jax.lax.cond(j == last, lambda: record.states, lambda: self.again(j))
        return j - 1, *self.blocks(tuple(rest), j, states)


def pulled(
    solver: Sdirk, args: Any, record: Record, count: Array, times: Array, cotangents: Array
) -> tuple[Any, Array]:
    """Cotangents of the arguments, those of their leaves that are no floats None, and of the start (n,).

    Args:
        solver: the one that made the record; args: of its field.
        count: steps accepted.
        times, cotangents: (T,) and (T, n) of the states at these times; all is NaN where the run did not reach one that counts.
    """
    moving, fixed = eqx.partition(args, eqx.is_inexact_array)
    way = _Back(solver, moving, fixed, record, count, times, cotangents)
    reached = jnp.sum(times <= record.ends[count])
    none = jnp.zeros((ORDERS + 1, cotangents.shape[1])), reached, jax.tree.map(jnp.zeros_like, moving)
    _, d, out, by = jax.lax.while_loop(lambda carry: carry[0] >= 0, way.segment, (count // way.size, *none))
    # Outputs at the start, or before; a state that was not reached has no derivative.
    index = jnp.arange(times.size)[:, None]
    start = d[0] + jnp.sum(jnp.where(index < out, cotangents, 0.0), axis=0)
    lost = jnp.any((index >= reached) & (cotangents != 0.0))
    return jax.tree.map(lambda x: jnp.where(lost, jnp.nan, x), (by, start))
