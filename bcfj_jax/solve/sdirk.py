"""SDIRK2: two stages, every one implicit, L-stable, order 2; made to be differentiated (``tangents``).

gamma = 1 - 1/sqrt(2) (Alexander 1977; stiffly accurate). Newton keeps its matrix while it converges quickly, over
both stages. A tangent is multiplied by (I - h gamma J)^-1 at every stage, which is bounded however large h J is;
methods with an explicit stage multiply by h J.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.xla.kept import once

GAMMA = 1.0 - 0.5**0.5
NODES = np.array([GAMMA, 1.0])
# Leading term of the local error over h^3 d3y/dt3, for a linear field: coefficient of z^3 in R(z) - exp(z).
ERROR = abs(3.0 * GAMMA**2 - 2.0 * GAMMA**3 - 1.0 / 6.0)
# Matrices that a batch makes at once where some of its runs ask for new ones.
_MATRICES = 8


class Sdirk(dfx.AbstractAdaptiveSolver):
    """SDIRK2 for a flat state, with the linear algebra of ``structure``."""

    structure: AbstractStructure
    tolerance: Array  # the step control's absolute tolerance of each state; Newton stops at ``newton`` times it
    newton: float = eqx.field(static=True, default=0.02)
    # Of Newton, per stage; a stage that needs more rejects the step.
    iterations: int = eqx.field(static=True, default=20)
    # Newton takes a new matrix where a change is larger than this share of the one before.
    contraction: float = eqx.field(static=True, default=0.2)

    term_structure: ClassVar = dfx.ODETerm
    interpolation_cls: ClassVar[Callable[..., dfx.AbstractLocalInterpolation]] = (
        dfx.ThirdOrderHermitePolynomialInterpolation
    )

    def order(self, terms):
        return 2

    def error_order(self, terms):
        return 3

    def init(self, terms, t0, t1, y0, args):
        """The slope at the start; later the last stage's."""
        return self.structure.field(t0, y0, args)

    def func(self, terms, t0, y0, args):
        return self.structure.field(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """Two stages; the error is the bend of three slopes, filtered by the stiff matrix."""
        y1, error, last, bend = _step(self, t0, t1, y0, args, solver_state)
        return y1, error, dict(y0=y0, y1=y1, k0=bend[0], k1=bend[1]), last, dfx.RESULTS.successful


@eqx.filter_jit  # Diffrax traces a step three times, and its tangents.
def _step(solver: Sdirk, t0: Any, t1: Any, y0: Array, args: Any, first: Array) -> tuple[Array, Array, Array, Any]:
    """New state, error, last slope, and the slopes at both ends times the step."""
    h = t1 - t0
    states, slopes, error = stages(solver, t0, h, y0, args, first)
    return states[1], error, slopes[1], (h * first, h * slopes[1])


def stages(solver: Sdirk, t0: Any, h: Any, y0: Array, args: Any, first: Array) -> tuple[Array, Array, Array]:
    """States and slopes (2, n) of both stages, and the error: the bend of three slopes, filtered by the stiff matrix."""
    structure, s = solver.structure, h * GAMMA
    factors = structure.factor(t0, y0, args, s)

    def stage(carry, when):
        """One stage, from its base, Newton's guess, the slope before it and the last matrix."""
        base, guess, before, factors, good = carry
        y, also, factors = newton(solver, Stage(t0 + when * h, base, s, args), guess, factors)
        slope = (y - base) / s
        ahead = following(h, base, slope)
        # A stiff slope at the start may be far off, so Newton's next guess turns by a damped and limited amount.
        turn = (slope - before) * (1.0 - GAMMA) / GAMMA
        guess = ahead + s * (slope + jnp.clip(turn, -jnp.abs(slope), jnp.abs(slope)))
        return (ahead, guess, slope, factors, good & also), (y, slope)

    # A loop has half as much to compile as two stages written out.
    begin = (y0, y0 + structure.solve(factors, first), first, factors, jnp.asarray(True))
    (*_, factors, good), (states, slopes) = jax.lax.scan(stage, begin, NODES)
    error = structure.solve(factors, h * ERROR * bend(first, slopes[0], slopes[1]) / s)
    return states, slopes, jnp.where(good, error, jnp.inf)


def following(h: Any, base: Array, slope: Array) -> Array:
    """Where the next stage starts from."""
    return base + h * (1.0 - GAMMA) * slope


def bend(first: Array, second: Array, last: Array) -> Array:
    """Second derivative of the slope times h^2, from the slopes at the start, the first stage and the end."""
    return ((last - second) / (1.0 - GAMMA) - (second - first) / GAMMA) * 2.0


class Stage(NamedTuple):
    """The equation  y = base + s f(t, y), args."""

    t: Any
    base: Array
    s: Any
    args: Any


def newton(
    solver: Sdirk, stage: Stage, guess: Array, factors: Any, renew: Any = False, exact: bool = False
) -> tuple[Array, Array, Any]:
    """The y of a stage, or else its base, whether Newton got there, and the last matrix it used.

    Newton keeps its matrix while it converges quickly: contact springs appear within a step, and then it must not.
    ``renew``: the matrix given is none. ``exact``: the matrix is that of the y found, where Newton got there. Under
    ``vmap`` all runs iterate until the last one has converged, and new matrices are made of those alone that ask.
    """
    arrays, static = eqx.partition((solver, stage.args), eqx.is_array)

    @custom_vmap
    def alone(where: tuple, *start: Any) -> tuple[Array, Array, Any]:
        return _newton(static, exact, where, start)

    @alone.def_vmap
    def _(size: int, batched: list, where: tuple, *start: Any) -> tuple:
        found = _newtons(static, exact, size, batched[0], where, _whole(size, batched[1:], start))
        return found, jax.tree.map(lambda _: True, found)

    return alone((jnp.asarray(stage.t), stage.base, jnp.asarray(stage.s), arrays), guess, factors, jnp.asarray(renew))


def _newton(static: Any, exact: bool, where: tuple, start: tuple) -> tuple[Array, Array, Any]:
    """``newton`` of one run; ``where``: time, base, scale, and the arrays of solver and arguments."""
    t, base, s, arrays = where
    guess, factors, renew = start
    solver, args = eqx.combine(arrays, static)

    def step(carry):
        y, size, count, slow, _, factors = carry
        there = size <= solver.newton
        factors = jax.lax.cond(
            slow | there, lambda y, _: solver.structure.factor(t, y, args, s), lambda _, f: f, y, factors
        )
        if exact:
            # A turn of its own, for the matrix alone: behind the loop it would be compiled once more.
            y, new = once(~there, lambda: _closer(static, where, y, factors), (y, size))
        else:
            y, new = _closer(static, where, y, factors)
        return y, new, count + 1, ~(new < solver.contraction * size), there, factors

    def more(carry):
        _, size, count, _, made, _ = carry
        there = size <= solver.newton
        return (count == 0) | (~there & jnp.isfinite(size) & (count < solver.iterations)) | (exact & there & ~made)

    start = (guess, jnp.asarray(jnp.inf), 0, renew, jnp.asarray(False), factors)
    y, size, *_, factors = jax.lax.while_loop(more, step, start)
    # Where it did not, y may be anything; the step is rejected.
    good = size <= solver.newton
    return jnp.where(good, y, base), good, factors


def _closer(static: Any, where: tuple, y: Array, factors: Any) -> tuple[Array, Array]:
    """One iteration of Newton's method, and the size of its change over the tolerance."""
    t, base, s, arrays = where
    solver, args = eqx.combine(arrays, static)
    change = solver.structure.solve(factors, (base - y) / s + solver.structure.field(t, y, args))
    return y + change, jnp.sqrt(jnp.mean(jnp.square(change / solver.tolerance)))


def _newtons(
    static: Any, exact: bool, count: int, batched: Any, where: tuple, start: tuple
) -> tuple[Array, Array, Any]:
    """``_newton`` of many runs: each iterates as it would alone, and gets a new matrix when it would alone.

    A matrix costs as much as ten iterations, and few runs need one at a time; a plain ``vmap`` makes one for every
    run in every iteration.
    """
    (guess, factors, renew), solver = start, eqx.combine(where[-1], static)[0]
    axes = jax.tree.map(lambda b: 0 if b else None, batched)
    few = min(count, _MATRICES) if jax.default_backend() == "cpu" else count

    def factored(where: tuple, y: Array) -> Any:
        t, _, s, arrays = where
        own, args = eqx.combine(arrays, static)
        return own.structure.factor(t, y, args, s)

    def some(carry: tuple) -> tuple:
        """New matrices of the first few runs that want one."""
        wanted, y, factors = carry
        at = jnp.argsort(~wanted, stable=True)[:few]
        here = jax.tree.map(lambda x, b: x[at] if b else x, where, batched)
        fresh = jax.vmap(factored, (axes, 0))(here, y[at])
        mine = wanted[at]

        def placed(old: Array, new: Array) -> Array:
            return old.at[at].set(jnp.where(_over(mine, new), new, old[at]))

        return wanted.at[at].set(False), y, jax.tree.map(placed, factors, fresh)

    def step(carry: tuple) -> tuple:
        y, size, number, slow, going, factors = carry
        wanted = (going & slow, y, factors)
        factors = jax.lax.while_loop(lambda carry: jnp.any(carry[0]), some, wanted)[-1]
        ahead, new = jax.vmap(lambda *x: _closer(static, *x), (axes, 0, 0))(where, y, factors)
        slow = ~(new < solver.contraction * size)
        y, size, number = jnp.where(going[:, None], ahead, y), jnp.where(going, new, size), number + 1
        going = going & (size > solver.newton) & jnp.isfinite(size) & (number < solver.iterations)
        return y, size, number, slow, going, factors

    every = jnp.ones(count, bool)
    start = (guess, jnp.full(count, jnp.inf), 0, renew, every, factors)
    y, size, *_, factors = jax.lax.while_loop(lambda carry: jnp.any(carry[4]), step, start)
    good = size <= solver.newton
    if exact:
        found = jax.vmap(factored, (axes, 0))(where, y)
        factors = jax.tree.map(lambda new, old: jnp.where(_over(good, new), new, old), found, factors)
    return jnp.where(good[:, None], y, where[1]), good, factors


def _over(lanes: Array, x: Array) -> Array:
    """One entry a lane, to broadcast over a lane's own axes."""
    return lanes.reshape(-1, *[1] * (x.ndim - 1))


def _whole(count: int, batched: Any, x: Any) -> Any:
    """Leaves with a leading axis of ``count``, also those that had none."""
    return jax.tree.map(
        lambda leaf, b: leaf if b else jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), tuple(x), tuple(batched)
    )
