"""Runs of stiff models that note when contacts begin and end, and where their forces are greatest.

BDF's steps do not end on contacts, as those of explicit runs do (``solve.landing``); they pass over them, and the step control
of state and tangents shortens them there. Every accepted step is looked at: where a channel's penetration changes its sign
from the step's begin to its end, the root of the step's own polynomial is an instant. The tangents at fixed times, read
there, give the instant's derivative by the implicit function theorem (``derivatives.trains``).

A contact, or a separation, that begins and ends within one step is not seen so. It is counted where the Hermite cubic of its
penetration crosses 0 by more than the tolerated error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import AbstractModel, Params, Solution
from bcfj_jax.solve import bdf, integrate
from bcfj_jax.solve.landing import PIECES, Instants, Look, course, crossed_at, look, noted, opening, put
from bcfj_jax.solve.plan import Plan
from bcfj_jax.solve.remembering import at_touch
from bcfj_jax.xla.batched_jvp import together

# Newton steps from the cubic's root to that of the step's polynomial.
_NEWTON = 4
# A summit reaches as far as a parabola through it falls by this share.
_FALL = 0.05


class _Memory(NamedTuple):
    """What a watch knows."""

    times: Array  # (2,) of the last two looks [s]
    past: Array  # (C,) size of the force at the first of them [N]; ``before``: all of the second
    before: Look
    inside: Array  # (C,) which channels touch
    found: Instants  # contacts so far; ``reaches``: (C, K) of their summits [s]
    reaches: Array
    missed: Array  # (C,) crossings and returns within a step
    # top, high, reach: (C,) greatest force of this contact [N], when [s], and half of its summit's width [s].
    top: Array
    high: Array
    reach: Array
    fresh: Array  # (C,) whether it was at the last look


class Watch(bdf.AbstractWatch):
    """Notes the first ``most`` contacts of every channel until ``end`` [s]; ``near`` [m] is a penetration's error."""

    model: AbstractModel
    prepared: Any
    end: Array
    near: Array
    most: int

    def begin(self, start: Array) -> _Memory:
        """What touches at the start."""
        seen = look(self.model, jnp.zeros(()), start, self.prepared)
        (inside, found), zero = opening(seen, self.most), jnp.zeros(seen.depth.shape)
        size = jnp.abs(seen.force)
        top = jnp.where(inside, size, -jnp.inf)
        return _Memory(
            jnp.zeros(2), size, seen, inside, found, found.high, jnp.zeros_like(found.count), top, zero, zero * jnp.nan,
            jnp.zeros_like(inside),
        )  # fmt: skip

    def after(self, seen: _Memory, end: Array, length: Array, read: Callable[[Array], Array]) -> _Memory:
        """With the crossings and summits of one step."""
        m, sight = seen, lambda t: look(self.model, t, read(t), self.prepared)
        now = sight(end)
        size = jnp.abs(now.force)
        beyond = jnp.where(m.inside, -now.depth, now.depth) > 0
        shares = jax.lax.cond(
            jnp.any(beyond), lambda: self._roots(m, now, end, length, sight), lambda: jnp.ones_like(size)
        )
        at = end - length * (1.0 - shares)
        turned = beyond & (at <= self.end)
        high, reach = _summit(m, end, size)
        m = m._replace(high=jnp.where(m.fresh, high, m.high), reach=jnp.where(m.fresh, reach, m.reach))
        missed = self._missed(m, now, length) & ~beyond
        found, reaches = jax.lax.cond(jnp.any(turned), lambda: _noted(at, m, turned), lambda: (m.found, m.reaches))
        inside = m.inside ^ turned
        top = jnp.where(inside & m.inside, m.top, -jnp.inf)
        fresh = inside & (size > top)
        return _Memory(
            jnp.stack([m.times[1], end]), jnp.abs(m.before.force), now, inside, found, reaches,
            m.missed + missed, jnp.where(fresh, size, top), jnp.where(fresh, jnp.minimum(end, self.end), m.high),
            jnp.where(fresh, jnp.nan, m.reach), fresh,
        )  # fmt: skip

    def _roots(self, m: _Memory, now: Look, end: Array, length: Array, sight: Callable[[Array], Look]) -> Array:
        """Shares of the step (C,) at which the polynomial's penetrations are 0."""

        def closer(_: int, shares: Array) -> Array:
            there = jax.vmap(sight)(end - length * (1.0 - shares))
            depth, rate = jnp.diagonal(there.depth), length * jnp.diagonal(there.rate)
            return jnp.clip(shares - depth / jnp.where(rate == 0, jnp.inf, rate), 0.0, 1.0)

        return jax.lax.fori_loop(0, _NEWTON, closer, crossed_at(m.before, now, m.inside, length, 0.0))

    def _missed(self, m: _Memory, now: Look, length: Array) -> Array:
        """Channels (C,) that cross and come back within the step."""
        way = jnp.where(m.inside, -1.0, 1.0) * course(m.before, now, length).at(jnp.arange(1, PIECES)[:, None] / PIECES)
        return jnp.any(way > self.near, axis=0)


def _summit(m: _Memory, end: Array, size: Array) -> tuple[Array, Array]:
    """Top of the parabola through three looks [s], and how far from it the force falls by ``_FALL`` [s]; NaN for none."""
    (t0, t1), f0, f1 = m.times, m.past, jnp.abs(m.before.force)
    first, last = (f1 - f0) / (t1 - t0), (size - f1) / (end - t1)
    bend = 2.0 * (last - first) / (end - t0)
    slope = (last * (t1 - t0) + first * (end - t1)) / (end - t0)
    good = (t1 > t0) & (f0 <= f1) & (size <= f1) & (bend < 0)
    safe = jnp.where(good, bend, -1.0)
    return jnp.where(good, t1 - slope / safe, t1), jnp.where(good, jnp.sqrt(-2.0 * _FALL * f1 / safe), jnp.nan)


def _noted(at: Array, m: _Memory, turned: Array) -> tuple[Instants, Array]:
    """The contacts with those that began or ended at instants (C,) [s], and their reaches."""
    found = noted(m.found, at, turned, m.inside, m.high)
    return found, put(m.reaches, turned & m.inside, found.count, m.reach)


def solved(
    model: AbstractModel, params: Params, times: Array, how: Plan, most: int
) -> tuple[Solution, Array, Instants]:
    """States at ``times``, the rates (T, n) of the polynomials that they are read from, the first contacts a channel.

    Pure; ``jvp`` and ``jacfwd`` go through ``params`` to the states alone. With derivatives their tangents count in the
    steps; states and contacts are then those of these steps. Of a stiff model, always by BDF; times (T,) [s] do not decrease.
    """
    posed = integrate.problem(model, params, times[-1], how, True)

    def run(x: tuple, by_args: Any, by_start: Array) -> tuple[Array, tuple]:
        prepared, start, times, *fixed = x
        made, solver = integrate.posed_at(posed, (prepared, start, *fixed))
        changes = None if by_args is None else (model, by_args)
        watch = Watch(model, prepared, times[-1], solver.tolerance[0], most)
        steps = bdf.Steps(how.max_steps, watch=watch, limits=integrate.limits(made, solver), memory=at_touch(model))
        rows = jnp.concatenate([start[None], by_start])
        found = bdf.solve(integrate.of_rows(made, solver, changes, rows), times, steps)
        m, (rows, *rest) = found.seen, integrate.ended(found, times, how)
        instants = m.found._replace(
            high=put(m.found.high, m.inside, m.found.count, m.high),
            reach=put(m.reaches, m.inside, m.found.count, m.reach),
            missed=m.missed,
        )
        return rows, (tuple(rest), found.rates, instants)

    def value(x: tuple) -> tuple[Array, tuple]:
        rows, aside = run(x, None, jnp.zeros((0, x[1].size)))
        return rows[:, 0], aside

    def ahead(x: tuple, changes: tuple) -> tuple[tuple[Array, tuple], Array]:
        by_args, by_start, *_ = changes
        count = jax.tree.leaves(changes)[0].shape[0]
        rows, aside = run(x, by_args, jnp.zeros((count, x[1].size)) if by_start is None else by_start)
        return (rows[:, 0], aside), jnp.moveaxis(rows[:, 1:], 1, 0)

    times = jax.lax.stop_gradient(times)
    x = (*posed.args[1:], posed.start, times, *integrate.fixed_in(posed, how.tolerance))
    states, (rest, rates, instants) = together(value, ahead)(x)
    return Solution(states, *rest), rates, instants
