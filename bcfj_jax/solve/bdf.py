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

from bcfj_jax.core.kept import once
from bcfj_jax.solve.sdirk import Sdirk, newton
from bcfj_jax.solve.tangents import along

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
    """Accepted steps, N at most, in segments of S: all that their transposition needs.

    Attributes:
        ends, lengths: (1 + N,) when each step ended, and its length [s]; the first entries are 0 and the first length tried.
        orders: (1 + N,); the first entry is 1.
        states: (S, n) after the steps of the last segment, which is empty where its number is a multiple of S.
        starts: (1 + N // S, 1 + ORDERS, n) differences where each segment begins, in steps of the length before it.
    """

    ends: Array
    lengths: Array
    orders: Array
    states: Array
    starts: Array


class Found(NamedTuple):
    """Rows (T, 1 + k, n) at the times asked for, NaN from where it stopped; how far it came; attempts.

    Attributes:
        rates: (T, n) of the state's polynomial, and ``seen``, what its watch knows at the end; None without a watch.
    """

    rows: Array
    end: Array
    accepted: Array
    rejected: Array
    record: Record | None = None
    rates: Array | None = None
    seen: Any = None


class Limits(NamedTuple):
    """What ends steps beside their errors.

    Attributes:
        longest: of a step [s]; ``breaks``: (B,) sorted times at which steps end [s], or None.
        hidden: (begin, end, state before, read) -> share of a step at which it has to end (``seeking``), or None;
            ``read`` gives the state (n,) at a time within the step.
    """

    longest: Any
    breaks: Array | None = None
    hidden: Callable[..., Array] | None = None


class AbstractWatch(eqx.Module):
    """What looks at every accepted step."""

    @abstractmethod
    def begin(self, start: Array) -> Any:
        """What is known at time 0, in the state (n,)."""

    @abstractmethod
    def after(self, seen: Any, end: Array, length: Array, read: Callable[[Array], Array]) -> Any:
        """What is known after a step that ended at ``end`` [s]; ``read`` gives the state (n,) at a time within it."""


class AbstractMemory(eqx.Module):
    """States that an event within a step sets, and that do not change until the next: after it they have no differences."""

    places: eqx.AbstractVar[tuple[int, ...]]

    @abstractmethod
    def before(self, t: Array, y: Array, args: Any) -> Array:
        """Of each place, whether its event is still to come (k,), in the state (n,)."""

    @abstractmethod
    def set(self, end: Array, length: Array, read: Callable[[Array], Array], args: Any, changes: Any) -> Array:
        """What each place is (1 + k, m) after an event in the step that ended at ``end`` [s]: its value, and its tangents.

        ``read`` gives rows (1 + k, n) at a time within the step, at fixed times.
        """


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


def solve(
    solver: Sdirk,
    args: Any,
    changes: Any,
    start: Array,
    scales: Array,
    times: Array,
    first: Any,
    shortest: Any,
    max_steps: int,
    orders: int = ORDERS,
    share: float = 1.0,
    segment: int = 0,
    watch: AbstractWatch | None = None,
    limits: Limits | None = None,
    memory: AbstractMemory | None = None,
) -> Found:
    """Integrate rows (1 + k, n), the state and its tangents, from time 0; interpolate at ``times`` (T,), increasing.

    Args:
        solver: structure, tolerances and Newton's settings.
        args: of the structure's field.
        changes: of ``args``, k of each; None where nothing changes.
        start: (1 + k, n).
        scales: (n,) natural sizes of the states; tangents' errors are absolute up to these, relative beyond.
        times: when to read; steps may pass the last one.
        first: length of the first step [s]; shortest: of any.
        max_steps: budget of attempts.
        orders: the highest order.
        share: of a tangent, to which its error is relative; below 1 for a sum of tangents, whose parts are smaller.
        segment: how many states a record keeps, which lengthens no run; 0: no record.
        watch: what looks at every accepted step, which changes none.
        limits: of steps, beside their errors.
        memory: states that events set; not where a record is kept.
    """
    structure, tolerance = solver.structure, solver.tolerance
    alpha, constant = jnp.asarray(ALPHA), jnp.asarray(_ERROR)

    def norm(rows: Array, sizes: Array) -> Array:
        """Largest over rows of the root mean square in units of the tolerance; not finite counts as infinite."""
        each = jnp.sqrt(jnp.mean(jnp.square(rows / tolerance), axis=1)) / sizes
        worst = jnp.max(each)
        return jnp.where(jnp.isfinite(worst), worst, jnp.inf)

    def attempt(s: _State) -> tuple[Array, Array, Array, Any]:
        """What the step adds to the prediction, its error (at most 1 is good), the rows' sizes, the last matrix."""
        t, c = s.t + s.h, s.h / alpha[s.order]
        ahead, base = predicted(s.differences, s.order)
        y, good, matrix = newton(solver, t, base[0], ahead[0], c, args, s.factors, s.accepted == 0, exact=True)
        bend = y - ahead[0]
        good = good & (constant[s.order] * norm(bend[None], jnp.ones(1)) <= 1.0)

        def tangents(_):
            none = jnp.zeros_like(base[1:])
            push = once(good, lambda: along(solver, t, y, args, changes), none) if jax.tree.leaves(changes) else none
            found = jax.vmap(structure.solve, (None, 0))(matrix, base[1:] / c + push)
            return found - ahead[1:], matrix

        # A step that will be rejected needs none. Nor is its matrix kept, which may be one of a state that is not finite.
        bends, factors = jax.lax.cond(good, tangents, lambda _: (jnp.zeros_like(base[1:]), s.factors), None)
        bends = jnp.concatenate([bend[None], bends])
        # Absolute up to the states' own sizes, which move a force by its size; relative beyond.
        size = jnp.sqrt(jnp.mean(jnp.square((ahead + bends) / scales), axis=1))
        sizes = jnp.maximum(1.0, share * size).at[0].set(1.0)
        return bends, jnp.where(good, constant[s.order] * norm(bends, sizes), jnp.inf), sizes, factors

    def accepted(s: _State, bends: Array) -> _State:
        d = updated(s.differences, s.order, bends)
        return s._replace(t=s.t + s.h, differences=d, accepted=s.accepted + 1, equal=s.equal + 1)

    def noted(record: Record | None, tried: _State, s: _State, bends: Array) -> Record | None:
        """With the step that was tried; the next one writes over it where it was rejected."""
        if record is None:
            return None
        k, good = tried.accepted, s.accepted > tried.accepted
        y, start, j = (
            predicted(tried.differences, tried.order)[0][0] + bends[0],
            s.differences[: ORDERS + 1, 0],
            s.accepted // segment,
        )
        begins = good & (s.accepted % segment == 0)
        return Record(
            record.ends.at[k + 1].set(tried.t + tried.h),
            record.lengths.at[k + 1].set(tried.h),
            record.orders.at[k + 1].set(tried.order),
            record.states.at[k % segment].set(y),
            record.starts.at[j].set(jnp.where(begins, start, record.starts[j])),
        )

    def adapted(s: _State, good: Array, share: Array, sizes: Array, part: Array) -> _State:
        """After a rejection a shorter step, or the ``part`` of one that hides a contact; after order + 1 equal steps the
        order that allows the longest.
        """
        order, d = s.order, s.differences
        lower = jnp.where(order > 1, constant[order - 1] * norm(d[order], sizes), jnp.inf)
        higher = jnp.where(order < orders, constant[order + 1] * norm(d[order + 2], sizes), jnp.inf)
        shares = jnp.maximum(jnp.stack([lower, share, higher]), 1e-12)
        factors = shares ** (-1.0 / (order + jnp.arange(3)))
        best = jnp.where(good, jnp.argmax(factors), 1)
        factor = jnp.where(jnp.isfinite(share), jnp.clip(_SAFETY * factors[best], _SHRINK, _GROWTH), 0.5)
        factor, order = jnp.where(part < 1.0, jnp.maximum(part, _SHRINK), factor), order + best - 1
        return s._replace(h=s.h * factor, order=order, equal=jnp.asarray(0), differences=rescaled(d, order, factor))

    def shortened(s: _State) -> _State:
        """With a step that ends at the next break, and is not too long."""
        assert limits is not None
        longest = limits.longest
        if limits.breaks is not None:
            k = jnp.searchsorted(limits.breaks, s.t + 2.0 * shortest + 1e-14 * s.t, side="right")
            # The one that the last step has reached, to rounding, is behind.
            there = jnp.append(limits.breaks, jnp.inf)[k]
            longest = jnp.minimum(longest, there - s.t)
        factor = jnp.minimum(1.0, longest / s.h)
        return jax.lax.cond(
            factor < 1.0,
            lambda s: s._replace(
                h=s.h * factor, equal=jnp.asarray(0), differences=rescaled(s.differences, s.order, factor)
            ),
            lambda s: s,
            s,
        )

    def due(carry: tuple) -> Array:
        s, out, *_ = carry
        return (out < times.size) & (times[jnp.minimum(out, times.size - 1)] <= s.t)

    def weighted(s: _State, time: Array) -> Array:
        return between(time, s.t, s.h, s.order)

    def write(carry: tuple) -> tuple:
        """Interpolate at the next output, which the last step has reached."""
        s, out, found, rates = carry
        kept = s.differences[: ORDERS + 1]
        if rates is not None:
            steep = jax.jvp(lambda time: weighted(s, time), (times[out],), (jnp.ones(()),))[1]
            rates = rates.at[out].set(steep @ kept[:, 0])
        return s, out + 1, found.at[out].set(jnp.tensordot(weighted(s, times[out]), kept, axes=1)), rates

    def looked(seen: Any, s: _State) -> Any:
        assert watch is not None
        return watch.after(seen, s.t, s.h, lambda time: weighted(s, time) @ s.differences[: ORDERS + 1, 0])

    def remembered(s: _State, before: Array) -> tuple[_State, Array]:
        """After an accepted step: what its events set, and which are to come."""
        assert memory is not None
        kept = s.differences[: ORDERS + 1]
        apart = memory.before(s.t, kept[0, 0], args)
        there, at = before & ~apart, jnp.asarray(memory.places)

        setting = memory.set

        def put(d: Array) -> Array:
            rows = setting(s.t, s.h, lambda time: jnp.tensordot(weighted(s, time), kept, axes=1), args, changes)
            fresh = jnp.zeros((ROWS, *rows.shape)).at[0].set(rows)
            return d.at[:, :, at].set(jnp.where(there, fresh, d[:, :, at]))

        return s._replace(differences=jax.lax.cond(jnp.any(there), put, lambda d: d, s.differences)), apart

    def step(carry: tuple) -> tuple:
        tried, out, found, rates, record, seen, before = carry
        tried = tried if limits is None else shortened(tried)
        bends, share, sizes, factors = attempt(tried)
        good, part = share <= 1.0, jnp.ones(())
        if limits is not None and limits.hidden is not None:
            after = accepted(tried, bends)
            read = lambda time: weighted(after, time) @ after.differences[: ORDERS + 1, 0]  # noqa: E731
            part = limits.hidden(tried.t, after.t, tried.differences[0, 0], read)
            good = good & (part >= 1.0)
        s = tried._replace(factors=factors, rejected=tried.rejected + ~good)
        s = jax.lax.cond(good, accepted, lambda s, _: s, s, bends)
        record = noted(record, tried, s, bends)
        if watch is not None:
            seen = jax.lax.cond(good, looked, lambda seen, _: seen, seen, s)
        s, out, found, rates = jax.lax.while_loop(due, write, (s, out, found, rates))
        if memory is not None:
            s, before = jax.lax.cond(good, remembered, lambda *x: x, s, before)
        change = ~good | (s.equal > s.order)
        s = jax.lax.cond(change, adapted, lambda s, *_: s, s, good, share, sizes, part)
        return s, out, found, rates, record, seen, before

    def going(carry: tuple) -> Array:
        s, out, *_ = carry
        return (out < times.size) & (s.accepted + s.rejected < max_steps) & (s.h > shortest)

    h, zero = jnp.asarray(first, dtype=jnp.float64), jnp.asarray(0)
    slope = structure.field(jnp.zeros(()), start[0], args)
    differences = jnp.zeros((ROWS, *start.shape)).at[0].set(start).at[1, 0].set(h * slope)
    # Newton takes a matrix of its own in the first step.
    none = jax.tree.map(jnp.zeros_like, jax.eval_shape(structure.factor, h, start[0], args, h))
    begin = _State(jnp.zeros(()), h, jnp.asarray(1), zero, differences, none, zero, zero)
    found = jnp.full((times.size, *start.shape), jnp.nan)
    record = None
    if segment:
        room, n = jnp.zeros(max_steps + 1), start.shape[1]
        starts = jnp.zeros((1 + max_steps // segment, ORDERS + 1, n)).at[0].set(differences[: ORDERS + 1, 0])
        record = Record(room, room.at[0].set(h), jnp.ones(room.size, jnp.int8), jnp.zeros((segment, n)), starts)
    # A time before 0 or at it reads the start.
    rates = None if watch is None else jnp.full((times.size, start.shape[1]), jnp.nan)
    seen = None if watch is None else watch.begin(start[0])
    ready = jax.lax.while_loop(due, write, (begin, zero, found, rates))
    before = None if memory is None else memory.before(jnp.zeros(()), start[0], args)
    s, _, found, rates, record, seen, _ = jax.lax.while_loop(going, step, (*ready, record, seen, before))
    return Found(found, s.t, s.accepted, s.rejected, record, rates, seen)
