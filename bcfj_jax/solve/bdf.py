"""Backward differentiation of order 1 to 5 of a state and of its tangents, both in the step control.

The numerical differentiation formulas of Shampine and Reichelt (SIAM J. Sci. Comput. 18, 1997) with quasi-constant
steps: what is kept is the backward differences D of the state at steps of one length, (rows, 1 + k, n), and a change
of step interpolates them. With c = h / alpha a step solves

    y = base + c f(t, y),    E dy = dbase / c + (df/dp) dp,    E = I/c - J(t, y),

so tangents cost one matrix a step, exact at the converged state, and Newton's of the next step is that one. Tangents
are those of the discrete solution; steps and orders, which depend on parameters too, are not differentiated.
All of a step but that solve is linear in D with coefficients of its length and order alone: a ``Record`` of these and
of the states is what ``adjoint`` needs to go through the same steps backwards.

Why beside SDIRK2: to better than a percent, tangents of the joint ask for small errors of their own, and order 2 pays
for that with steps (benchmarks/models/joint_derivatives.py).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.solve.remembering import AtTouch
from bcfj_jax.solve.sdirk import Sdirk, Stage, newton
from bcfj_jax.solve.tangents import along
from bcfj_jax.xla.kept import each, once

ORDERS = 5
ROWS = ORDERS + 3
# Shampine and Reichelt's kappa; none at order 1, whose first difference of tangents is not known at the start.
_KAPPA = np.array([0.0, 0.0, -1.0 / 9.0, -0.0823, -0.0415, 0.0])
GAMMA = np.concatenate([[0.0], np.cumsum(1.0 / np.arange(1, ORDERS + 1))])
ALPHA = (1.0 - _KAPPA) * GAMMA
# Leading error over the difference of order + 1; the last is of no order that is used.
_ERROR = np.concatenate([_KAPPA * GAMMA + 1.0 / np.arange(1, ORDERS + 2), [1.0]])
_SAFETY, _GROWTH, _SHRINK = 0.8, 10.0, 0.2
_EDGE = np.arange(ORDERS + 1)


class Record(NamedTuple):
    """Accepted steps, N at most, in segments of S: all that their transposition needs."""

    # ends, lengths: (1 + N,) when each step ended, and its length [s]; the first entries are 0 and the first length
    # tried.
    ends: Array
    lengths: Array
    orders: Array  # (1 + N,); the first entry is 1
    states: Array  # (S, n) after the steps of the last segment, which is empty where its number is a multiple of S
    starts: Array  # (1 + N // S, 1 + ORDERS, n) differences where each segment begins, in steps of the length before it


class Found(NamedTuple):
    """Rows (T, 1 + k, n) at the times asked for, NaN from where it stopped; how far it came; attempts."""

    rows: Array
    end: Array
    accepted: Array
    rejected: Array
    record: Record | None = None
    # (T, n) of the state's polynomial, and ``seen``, what its watch knows at the end; None without a watch.
    rates: Array | None = None
    seen: Any = None


class Limits(NamedTuple):
    """What ends steps beside their errors."""

    longest: Any  # of a step [s]; ``breaks``: (B,) sorted times at which steps end [s], or None
    breaks: Array | None = None
    # (begin, end, state before, read) -> share of a step at which it has to end (``seeking``), or None; ``read`` gives
    # the state (n,) at a time within the step.
    hidden: Callable[..., Array] | None = None


class AbstractWatch(eqx.Module):
    """What looks at every accepted step."""

    @abstractmethod
    def begin(self, start: Array) -> Any:
        """What is known at time 0, in the state (n,)."""

    @abstractmethod
    def after(self, seen: Any, end: Array, length: Array, read: Callable[[Array], Array]) -> Any:
        """What is known after a step that ended at ``end`` [s]; ``read`` gives the state (n,) at a time within it."""


class _State(NamedTuple):
    """D: (rows, 1 + k, n) differences; ``equal``: steps taken with this length and order."""

    t: Array
    h: Array
    order: Array
    equal: Array
    differences: Array
    factors: Any
    accepted: Array
    rejected: Array


def rescaling(order: Array, factor: Array) -> Array:
    """The matrix R of  D' = R^T D,  the first differences for steps ``factor`` times as long."""

    def steps(ratio: Any) -> Array:
        i, j = _EDGE[1:, None], _EDGE[None, 1:]
        body = jnp.concatenate([jnp.zeros((ORDERS, 1)), (i - 1 - ratio * j) / i], axis=1)
        return jnp.cumprod(jnp.concatenate([jnp.ones((1, ORDERS + 1)), body]), axis=0)

    inside = order >= _EDGE
    mask = inside[:, None] & inside[None, :]
    change = jnp.where(mask, steps(factor), 0.0) @ jnp.where(mask, steps(1.0), 0.0)
    return jnp.where(mask, change, jnp.eye(ORDERS + 1))


def rescaled(differences: Array, order: Array, factor: Array) -> Array:
    """Differences for steps ``factor`` times as long."""
    head = jnp.tensordot(rescaling(order, factor), differences[: ORDERS + 1], axes=((0,), (0,)))
    return differences.at[: ORDERS + 1].set(head)


def predicted(differences: Array, order: Array) -> tuple[Array, Array]:
    """Where the polynomial through the last states goes on to, and the base of the step's equation."""
    weights, kept = jnp.where(order >= _EDGE, 1.0, 0.0), differences[: ORDERS + 1]
    ahead = jnp.tensordot(weights, kept, axes=1)
    return ahead, ahead - jnp.tensordot(weights * GAMMA, kept, axes=1) / jnp.asarray(ALPHA)[order]


def updated(differences: Array, order: Array, bends: Array) -> Array:
    """Differences after a step that adds ``bends`` to the prediction."""
    d = differences
    d = d.at[order + 2].set(bends - d[order + 1]).at[order + 1].set(bends)
    index = jnp.arange(ROWS).reshape(-1, *[1] * (d.ndim - 1))
    summed = jnp.cumsum(jnp.where(index <= order + 1, d, 0.0)[::-1], axis=0)[::-1]
    return jnp.where(index <= order, summed, d)


def between(time: Array, end: Array, length: Array, order: Array) -> Array:
    """Weights (1 + ORDERS,) of the differences after a step in the state at a time within it."""
    x = (time - (end - length * _EDGE[:-1])) / (length * (1.0 + _EDGE[:-1]))
    return jnp.where(order >= _EDGE, jnp.concatenate([jnp.ones(1), jnp.cumprod(x)]), 0.0)


class Posed(NamedTuple):
    """What is integrated."""

    solver: Sdirk  # structure, tolerances and Newton's settings
    args: Any  # of the structure's field
    changes: Any  # of ``args``, k of each; None where nothing changes
    start: Array  # (1 + k, n) rows of the state and its tangents
    scales: Array  # (n,) natural sizes of the states; tangents' errors are absolute up to these, relative beyond
    first: Any  # length of the first step [s]
    shortest: Any  # of any


class Steps(NamedTuple):
    """How steps are taken, and what is noted of them."""

    budget: int  # of attempts
    orders: int = ORDERS  # the highest
    # Of a tangent, to which its error is relative; below 1 for a sum of tangents, whose parts are smaller.
    share: float = 1.0
    segment: int = 0  # how many states a record keeps, which lengthens no run; 0: no record
    watch: AbstractWatch | None = None  # what looks at every accepted step, which changes none
    limits: Limits | None = None  # of steps, beside their errors
    memory: AtTouch | None = None  # states that events set; not where a record is kept


class _Carry(NamedTuple):
    """Between steps: the state, the number of the next output, outputs so far, and what is noted."""

    state: _State
    out: Array
    rows: Array
    rates: Array | None
    record: Record | None
    seen: Any
    before: Any


def _tail(d: Array) -> Array:
    """The differences that a state is made of."""
    return d[: ORDERS + 1]


def _weights(s: _State, time: Array) -> Array:
    return between(time, s.t, s.h, s.order)


def _reading(s: _State) -> Callable[[Array], Array]:
    """The state (n,) at a time within the last step."""
    return lambda time: _weights(s, time) @ _tail(s.differences)[:, 0]


def _accepted(s: _State, bends: Array) -> _State:
    d = updated(s.differences, s.order, bends)
    return s._replace(t=s.t + s.h, differences=d, accepted=s.accepted + 1, equal=s.equal + 1)


def _stretched(s: _State, factor: Array) -> _State:
    """With steps ``factor`` times as long."""
    d = rescaled(s.differences, s.order, factor)
    return s._replace(h=s.h * factor, equal=jnp.asarray(0), differences=d)


class _Run(NamedTuple):
    """One run: what it does in a step."""

    posed: Posed
    times: Array
    how: Steps

    def norm(self, rows: Array, sizes: Array) -> Array:
        """Largest over rows of the root mean square in units of the tolerance; not finite counts as infinite."""
        each = jnp.sqrt(jnp.mean(jnp.square(rows / self.posed.solver.tolerance), axis=1)) / sizes
        worst = jnp.max(each)
        return jnp.where(jnp.isfinite(worst), worst, jnp.inf)

    def attempt(self, s: _State) -> tuple[Array, Array, Array, Any]:
        """What the step adds to the prediction, its error (at most 1 is good), the rows' sizes, the last matrix."""
        solver, args, changes, _, scales, *_ = self.posed
        constant = jnp.asarray(_ERROR)
        t, c = s.t + s.h, s.h / jnp.asarray(ALPHA)[s.order]
        ahead, base = predicted(s.differences, s.order)
        stage = Stage(t, base[0], c, args)
        y, good, matrix = newton(solver, stage, ahead[0], s.factors, s.accepted == 0, exact=True)
        bend = y - ahead[0]
        good = good & (constant[s.order] * self.norm(bend[None], jnp.ones(1)) <= 1.0)

        def tangents():
            push = along(solver, t, y, args, changes) if jax.tree.leaves(changes) else jnp.zeros_like(base[1:])
            found = each(lambda row: solver.structure.solve(matrix, row), base[1:] / c + push)
            return found - ahead[1:], matrix

        # A step that will be rejected needs none. Nor is its matrix kept, which may be one of a state that is not finite.
        bends, factors = once(good, tangents, (jnp.zeros_like(base[1:]), s.factors))
        bends = jnp.concatenate([bend[None], bends])
        # Absolute up to the states' own sizes, which move a force by its size; relative beyond.
        size = jnp.sqrt(jnp.mean(jnp.square((ahead + bends) / scales), axis=1))
        sizes = jnp.maximum(1.0, self.how.share * size).at[0].set(1.0)
        return bends, jnp.where(good, constant[s.order] * self.norm(bends, sizes), jnp.inf), sizes, factors

    def noted(self, record: Record | None, tried: _State, s: _State, bends: Array) -> Record | None:
        """With the step that was tried; the next one writes over it where it was rejected."""
        if record is None:
            return None
        k, good, segment = tried.accepted, s.accepted > tried.accepted, self.how.segment
        y, j = predicted(tried.differences, tried.order)[0][0] + bends[0], s.accepted // segment
        begins = good & (s.accepted % segment == 0)
        return Record(
            record.ends.at[k + 1].set(tried.t + tried.h), record.lengths.at[k + 1].set(tried.h),
            record.orders.at[k + 1].set(tried.order), record.states.at[k % segment].set(y),
            record.starts.at[j].set(jnp.where(begins, _tail(s.differences)[:, 0], record.starts[j])),
        )  # fmt: skip

    def adapted(self, s: _State, good: Array, share: Array, sizes: Array, part: Array) -> _State:
        """After a rejection a shorter step, or the ``part`` of one that hides a contact; after order + 1 equal steps the
        order that allows the longest.
        """
        order, d, constant = s.order, s.differences, jnp.asarray(_ERROR)
        lower = jnp.where(order > 1, constant[order - 1] * self.norm(d[order], sizes), jnp.inf)
        higher = jnp.where(order < self.how.orders, constant[order + 1] * self.norm(d[order + 2], sizes), jnp.inf)
        shares = jnp.maximum(jnp.stack([lower, share, higher]), 1e-12)
        factors = shares ** (-1.0 / (order + jnp.arange(3)))
        best = jnp.where(good, jnp.argmax(factors), 1)
        factor = jnp.where(jnp.isfinite(share), jnp.clip(_SAFETY * factors[best], _SHRINK, _GROWTH), 0.5)
        factor = jnp.where(part < 1.0, jnp.maximum(part, _SHRINK), factor)
        return _stretched(s._replace(order=order + best - 1), factor)

    def shortened(self, s: _State) -> _State:
        """With a step that ends at the next break, and is not too long."""
        limits = self.how.limits
        if limits is None:
            return s
        longest = limits.longest
        if limits.breaks is not None:
            k = jnp.searchsorted(limits.breaks, s.t + 2.0 * self.posed.shortest + 1e-14 * s.t, side="right")
            # The one that the last step has reached, to rounding, is behind.
            there = jnp.append(limits.breaks, jnp.inf)[k]
            longest = jnp.minimum(longest, there - s.t)
        factor = jnp.minimum(1.0, longest / s.h)
        return jax.lax.cond(factor < 1.0, lambda s: _stretched(s, factor), lambda s: s, s)

    def shown(self, tried: _State, bends: Array, hidden: Callable[..., Array]) -> Array:
        """Share of a step at which it has to end so that it hides no contact."""
        after = _accepted(tried, bends)
        return hidden(tried.t, after.t, tried.differences[0, 0], _reading(after))

    def due(self, carry: tuple) -> Array:
        """Whether the last step has reached the next output."""
        s, out, *_ = carry
        return (out < self.times.size) & (self.times[jnp.minimum(out, self.times.size - 1)] <= s.t)

    def write(self, carry: tuple) -> tuple:
        """Interpolate there."""
        s, out, found, rates = carry
        kept, time = _tail(s.differences), self.times[out]
        if rates is not None:
            steep = jax.jvp(lambda time: _weights(s, time), (time,), (jnp.ones(()),))[1]
            rates = rates.at[out].set(steep @ kept[:, 0])
        return s, out + 1, found.at[out].set(jnp.tensordot(_weights(s, time), kept, axes=1)), rates

    def written(self, carry: _Carry) -> _Carry:
        """With all outputs that the last step has reached."""
        state, out, rows, rates = jax.lax.while_loop(self.due, self.write, tuple(carry[:4]))
        return carry._replace(state=state, out=out, rows=rows, rates=rates)

    def remembered(self, s: _State, before: Array) -> tuple[_State, Array]:
        """After an accepted step: what its events set, and which are to come."""
        memory, (_, args, changes, *_) = self.how.memory, self.posed
        assert memory is not None
        kept = _tail(s.differences)
        apart = memory.before(s.t, kept[0, 0], args)
        turned = before.astype(int) - apart
        read = lambda time: jnp.tensordot(_weights(s, time), kept, axes=1)  # noqa: E731
        posed = self.posed.solver.structure.field, args, changes
        put = lambda d: memory.after(d, turned, (s.t, s.h), read, posed)  # noqa: E731
        return s._replace(differences=jax.lax.cond(jnp.any(turned), put, lambda d: d, s.differences)), apart

    def step(self, carry: _Carry) -> _Carry:
        """One attempt, and what is noted of it."""
        tried, watch = self.shortened(carry.state), self.how.watch
        bends, share, sizes, factors = self.attempt(tried)
        good, part = share <= 1.0, jnp.ones(())
        if self.how.limits is not None and self.how.limits.hidden is not None:
            part = self.shown(tried, bends, self.how.limits.hidden)
            good = good & (part >= 1.0)
        s = tried._replace(factors=factors, rejected=tried.rejected + ~good)
        s = jax.lax.cond(good, _accepted, lambda s, _: s, s, bends)
        carry = carry._replace(state=s, record=self.noted(carry.record, tried, s, bends))
        if watch is not None:
            look = lambda seen, s: watch.after(seen, s.t, s.h, _reading(s))  # noqa: E731
            carry = carry._replace(seen=jax.lax.cond(good, look, lambda seen, _: seen, carry.seen, s))
        carry = self.written(carry)
        s, before = carry.state, carry.before
        if self.how.memory is not None:
            s, before = jax.lax.cond(good, self.remembered, lambda *x: x, s, before)
        change = ~good | (s.equal > s.order)
        s = jax.lax.cond(change, self.adapted, lambda s, *_: s, s, good, share, sizes, part)
        return carry._replace(state=s, before=before)

    def going(self, carry: _Carry) -> Array:
        """Whether another step is to be tried."""
        s, budget = carry.state, self.how.budget
        return (carry.out < self.times.size) & (s.accepted + s.rejected < budget) & (s.h > self.posed.shortest)

    def begin(self) -> _Carry:
        """Before the first step."""
        (solver, args, _, start, _, first, _), how = self.posed, self.how
        h, zero, n = jnp.asarray(first, dtype=jnp.float64), jnp.asarray(0), start.shape[1]
        slope = solver.structure.field(jnp.zeros(()), start[0], args)
        differences = jnp.zeros((ROWS, *start.shape)).at[0].set(start).at[1, 0].set(h * slope)
        # Newton takes a matrix of its own in the first step.
        none = jax.tree.map(jnp.zeros_like, jax.eval_shape(solver.structure.factor, h, start[0], args, h))
        state = _State(jnp.zeros(()), h, jnp.asarray(1), zero, differences, none, zero, zero)
        record = rates = seen = before = None
        if how.segment:
            room = jnp.zeros(how.budget + 1)
            starts = jnp.zeros((1 + how.budget // how.segment, ORDERS + 1, n)).at[0].set(_tail(differences)[:, 0])
            orders, states = jnp.ones(room.size, jnp.int8), jnp.zeros((how.segment, n))
            record = Record(room, room.at[0].set(h), orders, states, starts)
        if how.watch is not None:
            rates, seen = jnp.full((self.times.size, n), jnp.nan), how.watch.begin(start[0])
        if how.memory is not None:
            before = how.memory.before(jnp.zeros(()), start[0], args)
        # A time before 0 or at it reads the start.
        rows = jnp.full((self.times.size, *start.shape), jnp.nan)
        return self.written(_Carry(state, zero, rows, rates, record, seen, before))


def solve(posed: Posed, times: Array, how: Steps) -> Found:
    """Integrate rows (1 + k, n), the state and its tangents, from time 0; interpolate at ``times`` (T,), increasing.

    Steps may pass the last of the times.
    """
    run = _Run(posed, times, how)
    s, _, rows, rates, record, seen, _ = jax.lax.while_loop(run.going, run.step, run.begin())
    return Found(rows, s.t, s.accepted, s.rejected, record, rates, seen)
