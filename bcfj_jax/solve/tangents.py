"""SDIRK2 of a state and of its tangents beside it: forward derivatives without differentiating a loop.

The tangents are those of the discrete solution, by the implicit function theorem at every stage: with E = I/s - J at
the converged stage y of base b,

    E dy = db/s + (df/dp) dp,

all directions together, one matrix for all. The same steps and numbers as differentiating ``sdirk``, from a smaller
program: JAX differentiates no loop. Tangents have no say in the steps; in ``bdf`` they have.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.solve.sdirk import GAMMA, NODES, Sdirk, following, stages
from bcfj_jax.solve.wrapped import AbstractWrapped
from bcfj_jax.xla import batched_jvp
from bcfj_jax.xla.kept import each


class SdirkTangents(AbstractWrapped):
    """``Sdirk`` over rows (1 + k, n): the state, then its tangents.

    ``args`` is (args, their k changes); a change is None where nothing changes. Slopes are those at a step's start, later the
    last stage's; 0 for tangents, which do not read theirs.
    """

    solver: Sdirk

    def init(self, terms, t0, t1, y0, args):
        return self.func(terms, t0, y0, args)

    def func(self, terms, t0, y0, args):
        return jnp.zeros_like(y0).at[0].set(self.solver.structure.field(t0, y0[0], args[0]))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step; the error of tangents is 0."""
        rows, error, slopes, ends = _step(self, t0, t1, y0, args, solver_state)
        return rows, error, dict(y0=y0, y1=rows, k0=ends[0], k1=ends[1]), slopes, dfx.RESULTS.successful


def beside(posed: Any, changes: Any, start: Array) -> Any:
    """A problem (``integrate.Problem``) over rows (1 + k, n), the state and its k tangents, whose steps are the state's.

    An explicit method of the variational equation, dy' = (df/dy) dy + (df/dp) dp, gives the tangents of its own discrete
    solution (Hairer, Norsett, Wanner, Solving ODEs I, section I.14). ``changes``: of ``args``, None where nothing changes.
    """
    field = posed.field
    if isinstance(posed.solver, Sdirk):
        solver = SdirkTangents(posed.solver)
        moved = lambda t, rows, both: rows.at[0].set(field(t, rows[0], both[0]))  # noqa: E731
    else:
        solver, moved = posed.solver, lambda t, rows, both: _variational(field, t, rows, both)
    return posed._replace(
        field=moved, args=(posed.args, changes), start=start, solver=solver, norm=lambda errors: posed.norm(errors[0])
    )


def _variational(field: Callable, t: Any, rows: Array, both: Any) -> Array:
    args, changes = both
    slope, slopes = batched_jvp.along(lambda x: field(t, *x), (rows[0], args), (rows[1:], changes))
    return jnp.concatenate([slope[None], slopes])


def along(solver: Sdirk, t: Any, y: Array, args: Any, changes: Any) -> Array:
    """(df/dp) dp of every direction (k, n), or 0."""
    if not jax.tree.leaves(changes):
        return jnp.zeros(())
    return batched_jvp.along(lambda args: solver.structure.field(t, y, args), args, changes)[1]


@eqx.filter_jit
def _step(
    whole: SdirkTangents, t0: Any, t1: Any, rows: Array, both: Any, firsts: Array
) -> tuple[Array, Array, Array, Any]:
    """New rows, their errors, last slopes, and the slopes at both ends times the step."""
    args, changes = both
    solver = whole.solver
    structure, h = solver.structure, t1 - t0
    s = h * GAMMA
    states, slopes, error = stages(solver, t0, h, rows[0], args, firsts[0])

    def tangents():
        """Of both stages; what does not depend on the tangents themselves for both together."""

        def at(where):
            t, y = where
            return structure.factor(t, y, args, s), along(solver, t, y, args, changes)

        matrices, moved = each(at, (t0 + NODES * h, states))

        def stage(base, row):
            matrix, push = row
            found = each(lambda row: structure.solve(matrix, row), base / s + push)
            slope = (found - base) / s
            return following(h, base, slope), (found, slope)

        _, (found, slopes) = jax.lax.scan(stage, rows[1:], (matrices, moved))
        return found[1], slopes[1]

    # A step that will be rejected needs none.
    good = jnp.sqrt(jnp.mean(jnp.square(error / solver.tolerance))) <= 1.0
    ahead, last = jax.lax.cond(good, tangents, lambda: (rows[1:], rows[1:]))
    errors = jnp.concatenate([error[None], jnp.zeros_like(ahead)])
    lasts = jnp.concatenate([slopes[1:], last])
    return jnp.concatenate([states[1:], ahead]), errors, lasts, (h * firsts, h * lasts)
