"""RODAS3: a stiffly accurate, L-stable Rosenbrock method of order 3 with an embedded one of order 2.

Sandu, Verwer, Blom, Spee, Carmichael and Potra, Atmospheric Environment 31 (1997) 3459; gamma = 1/2. One Jacobian
and one factorisation a step, three fields, four solves, no iteration: in a batch no run waits for another's Newton.
The joint's steps are set by contacts that begin and end, not by the order: RODAS (order 4, six fields and solves) took
as many and cost half as much again.
For values only: differentiated, it carries the Jacobian's own derivative and its tangents are unbounded at
loose tolerance; derivatives go through ``solvers.sdirk``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap, sequential_vmap

from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.xla.backend import on_cpu
from bcfj_jax.xla.small import product

GAMMA = 0.5
# Stage i solves  (1/(h gamma) - J) k_i = f(t0 + c_i h, y0 + sum_j a_ij k_j) + sum_j C_ij k_j / h + g_i h f_t.
NODES = (0.0, 0.0, 1.0, 1.0)
PLACES = ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (2.0, 0.0, 1.0, 0.0))
COUPLINGS = ((0.0, 0.0, 0.0, 0.0), (4.0, 0.0, 0.0, 0.0), (1.0, -1.0, 0.0, 0.0), (1.0, -1.0, -8.0 / 3.0, 0.0))
DRIFTS = (0.5, 1.5, 0.0, 0.0)
# By the stages: the change of the state, its error, and the bend between.
_NEW = ((2.0, 0.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0), (3.0, -1.0, -1.0, -1.0))


class RodasInterpolation(dfx.AbstractLocalInterpolation):
    """Continuous extension of order 2 from the method's own stages:  y0 + x (y1 - y0) + x (1 - x) bend, x in [0, 1].

    With b(x) the stages' weights, order 2 asks  sum b = x  and  sum b_i beta_i = x^2/2; of the quadratics
    that end in the method's own weights, this is the one whose slope at the start uses the first two stages only.
    Hermite's cubic on the field at both ends would have order 3, and was 10 times worse: a stiff slope at the end
    is an error of the state times its eigenvalue.
    """

    t0: Any
    t1: Any
    y0: Array
    y1: Array
    bend: Array

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> Array:
        """State at ``t0``, or the increment from ``t0`` to ``t1``."""
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        width = self.t1 - self.t0
        x = (t0 - self.t0) / jnp.where(width == 0, 1.0, width)
        return self.y0 + x * (self.y1 - self.y0 + (1 - x) * self.bend)


class Rodas(dfx.AbstractAdaptiveSolver):
    """RODAS3 for a flat state, with the linear algebra of ``structure``."""

    structure: AbstractStructure

    term_structure: ClassVar = dfx.ODETerm
    interpolation_cls: ClassVar[Callable[..., RodasInterpolation]] = RodasInterpolation

    def order(self, terms):
        return 3

    def error_order(self, terms):
        return 3

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return self.structure.field(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step; the last stage is the error estimate. Stages are those of the form without products by J."""
        y1, error, bend = _step(self.structure, t0, t1, y0, args)
        return y1, error, dict(y0=y0, y1=y1, bend=bend), None, dfx.RESULTS.successful


@eqx.filter_jit  # Diffrax traces a step three times.
def _step(structure: AbstractStructure, t0: Any, t1: Any, y0: Array, args: Any) -> tuple[Array, Array, Array]:
    """New state, error, and the bend between; on a CPU runs of a batch step one after another where they are ``alone``."""
    if not structure.alone or not on_cpu():
        return _new(y0, product(jnp.asarray(_NEW), _stages(structure, t0, t1, y0, args)))
    arrays, static = eqx.partition(args, eqx.is_array)

    def stages(t0: Array, t1: Array, y0: Array, arrays: Any) -> Array:
        return _stages(structure, t0, t1, y0, eqx.combine(arrays, static))

    @custom_vmap
    def one(t0: Array, t1: Array, y0: Array, arrays: Any) -> tuple[Array, Array, Array]:
        # A product by XLA's library keeps the run from being one kernel. That would be 2.5 times as fast, and takes half as
        # long again to compile, which a single run does not win back.
        return _new(y0, jnp.asarray(_NEW) @ stages(t0, t1, y0, arrays))

    @one.def_vmap
    def _(size: int, batched: Any, *at: Any) -> tuple:
        del size
        each = sequential_vmap(
            lambda t0, t1, y0, arrays: _new(y0, product(jnp.asarray(_NEW), stages(t0, t1, y0, arrays)))
        )
        axes = jax.tree.map(lambda b: 0 if b else None, tuple(batched))
        return jax.vmap(each, axes)(*at), (True, True, True)

    return one(jnp.asarray(t0), jnp.asarray(t1), y0, arrays)


def _new(y0: Array, found: Array) -> tuple[Array, Array, Array]:
    return y0 + found[0], found[1], found[2]


def _stages(structure: AbstractStructure, t0: Any, t1: Any, y0: Array, args: Any) -> Array:
    h = t1 - t0
    factors = structure.factor(t0, y0, args, h * GAMMA)
    drift = h * structure.time_derivative(t0, y0, args)

    def stage(known, row):
        """The next stage, from the rows of the tables; stages not yet known are 0."""
        i, when, place, coupling, share = row
        stages, slope = known
        # Not batched with the runs, so this is a branch there, too.
        at = (t0 + when * h, y0 + place @ stages)
        slope = jax.lax.cond(i == 1, lambda t, y: slope, lambda t, y: structure.field(t, y, args), *at)
        found = structure.solve(factors, slope + coupling @ stages / h + share * drift)
        return (stages.at[i].set(found), slope), None

    # A loop has one field and one solve to compile, for three and four.
    tables = (jnp.arange(4), *(jnp.asarray(x) for x in (NODES, PLACES, COUPLINGS, DRIFTS)))
    (stages, _), _ = jax.lax.scan(stage, (jnp.zeros((4, y0.size)), jnp.zeros(y0.size)), tables)
    return stages
