"""Contacts that begin and end within a step: found on the step's own interpolant, so that no step passes over one.

An error estimate knows the field at a step's stages alone: bodies that meet and part between two stages do not meet. Every
step that the error control would keep is therefore looked at. Of each face the model tells the penetration, its rate and how
fast the bodies move past each other (``mechanism.model.Proximity``) at both ends. Nothing is hidden where

- the surfaces are farther apart than the bodies move in the step, or
- the bodies move by a small share of what the penetration's course bends over, so that it is the cubic through both
  ends, and that cubic does not touch in between.

Else the step is gone through in strides, each of which the cubic describes as a look in its middle confirms, halved until it
does. A step in which a contact begins and ends, ends and begins, or is deeper by far than both ends know, is taken
again: to where the contact begins, or, where it is closed at the start, to where it is deepest. What happens from there
on the error estimate sees. The strides are those of a safe ray march (Hart, The Visual Computer 12 (1996) 527) where surfaces are
far from each other.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import AbstractModel, Proximity
from bcfj_jax.solve.landing import crossed_at

# Speeds within a step are taken to be up to this multiple of the greater one at its ends.
_FASTER = 1.25
# Share of the length over which a penetration's course bends that bodies may move between two looks.
_SHARE = 0.3
# The cubic's error over that length times the fourth power of the share: d''''/384 of a distance between two points.
_BAND = 0.01
# A contact is hidden where it is so many times deeper than at both ends.
_DEEPER = 4.0
# A stride is good where the look in its middle differs by this share of how far the surfaces are from touching.
_AGREES = 0.1
# A step is taken again for hidden contacts so many times at most, so that rounding cannot hold it.
_TRIES = 50
# A step that is taken again is no shorter than this share of it, and not taken again where time's rounding shows.
_LEAST, _ROUNDING = 1e-6, 1e-13
# A blind solver's step that differs by this share of the natural sizes from Simpson's rule is none.
_WILD = 0.1
# The shortest stride, a share of the step, and the most looks at one step: a longer step is taken again.
_SHORTEST, _MOST = 1e-7, 4000

Sight = Callable[[Array], Proximity]


class _March(NamedTuple):
    """Where the march through a step is; (C,) of each face.

    Attributes:
        at, stride: shares of the step gone through, and tried next; ``looks`` so far.
        here: what is seen at ``at``.
        inside: whether the face touches there; ``changes``: how often it has begun or ended to touch.
        first: share at which it first did; ``top``, ``deepest``: greatest penetration [m] and its share.
    """

    at: Array
    stride: Array
    looks: Array
    here: Proximity
    inside: Array
    changes: Array
    first: Array
    top: Array
    deepest: Array


def hidden(before: Proximity, after: Proximity, h: Array, near: Array, sight: Sight, good: Any, blind: bool) -> Array:
    """Share of a step at which it has to end so that no contact is hidden in it; 1 where none is.

    Args:
        before, after: what is seen at both ends.
        h: the step's length [s].
        near: penetration that counts as none [m].
        sight: what is seen at a share of the step, on its interpolant.
        good: whether the step will be kept; else nothing is looked for.
        blind: whether the error estimate ignores the field at the step's end: then no step may end within a contact
            that begins in it.
    """
    fixed = jax.lax.stop_gradient
    before, after, h, near = fixed((before, after, h, near))
    inside = before.depth > jnp.where(before.rate > 0, -near, near)
    clear = _clear(before, after, h, near)
    if blind:
        clear = clear & (inside | (after.depth <= 4.0 * near))
    wanted = good & ~jnp.all(clear | ~jnp.isfinite(after.depth))
    # A loop, though short, costs what it carries: a step that hides nothing has none.
    return jax.lax.cond(
        wanted, lambda: _marched(before, after, inside, wanted, h, near, sight, blind), lambda: jnp.ones_like(h)
    )


def _marched(
    before: Proximity, after: Proximity, inside: Array, wanted: Array, h: Array, near: Array, sight: Sight, blind: bool
) -> Array:
    """``hidden`` of a step that has to be gone through; ``inside``: which faces touch at its start."""
    fixed, zero = jax.lax.stop_gradient, jnp.zeros_like(before.depth)
    begin = _March(
        jnp.where(wanted, 0.0, 1.0), jnp.ones(()), jnp.asarray(0), before, inside, jnp.zeros(zero.shape, int),
        zero + jnp.inf, zero - jnp.inf, zero,
    )  # fmt: skip

    def further(m: _March) -> _March:
        middle, end = fixed(sight(m.at + 0.5 * m.stride)), fixed(sight(m.at + m.stride))
        described = _described(m.here, middle, end, m.stride * h, near) | (m.stride <= _SHORTEST)
        gone = _gone(_gone(m, m.here, middle, m.at, h, near), middle, end, m.at + 0.5 * m.stride, h, near)
        at = m.at + m.stride
        kept = gone._replace(at=at, stride=jnp.minimum(2.0 * m.stride, 1.0 - at), here=end)
        taken = jax.tree.map(lambda x, y: jnp.where(described, x, y), kept, m._replace(stride=0.5 * m.stride))
        return taken._replace(looks=m.looks + 2)

    m = jax.lax.while_loop(lambda m: (m.at < 1.0) & (m.looks < _MOST), further, begin)
    unseen = (m.changes > 1) | (m.top > _DEEPER * _known(before, after, near))
    if blind:
        landed = jnp.abs(after.depth - 2.0 * near) <= 2.0 * near
        unseen = unseen | ((m.changes > 0) & ~inside & ~landed)
    share = jnp.where(inside & (m.changes < 2), m.deepest, jnp.minimum(m.first, m.deepest))
    share = jnp.min(jnp.where(unseen & wanted, share, 1.0), initial=1.0)
    # A step of more looks than are allowed ends where they ended.
    return jnp.where(m.at < 1.0, jnp.minimum(share, jnp.maximum(m.at, _SHORTEST)), share)


def _clear(a: Proximity, b: Proximity, h: Array, near: Array) -> Array:
    """Faces (C,) of which both ends of a step tell that nothing is hidden in it."""
    moved = _moved(h, a, b)
    share = jnp.maximum(h * _FASTER * jnp.maximum(a.turn, b.turn), jnp.where(moved > 0, moved / _over(a, b), 0.0))
    small = share <= _SHARE
    band = _BAND * moved * jnp.where(small, share, 0.0) ** 3
    # A cubic leaves its chord by at most 4/27 of what its slopes at both ends differ from the chord's; 0.15 is no less.
    chord = b.depth - a.depth
    band = band + 0.15 * (jnp.abs(h * a.rate - chord) + jnp.abs(h * b.rate - chord))
    top, bottom = jnp.maximum(a.depth, b.depth), jnp.minimum(a.depth, b.depth)
    parts = (a.depth > near) & (b.depth > near) & (bottom - band < -near)
    return _apart(a, b, moved) | (small & (top + band <= _DEEPER * _known(a, b, near)) & ~parts)


def _known(a: Proximity, b: Proximity, near: Array) -> Array:
    """Penetrations (C,) of which both ends of a step know [m]: of surfaces that part at its end a damped law may not."""
    return jnp.maximum(jnp.maximum(a.depth, jnp.where(b.rate >= 0, b.depth, 0.0)), near)


def _moved(h: Array, *seen: Proximity) -> Array:
    """How far the bodies of each face may move past each other in a time (C,) [m]."""
    return h * _FASTER * functools.reduce(jnp.maximum, [s.speed for s in seen])


def _over(a: Proximity, b: Proximity) -> Array:
    """Motion over which the penetrations' course bends (C,) [m]: farther where the surfaces are apart."""
    return jnp.minimum(a.bends, b.bends) + jnp.maximum(jnp.minimum(-a.depth, -b.depth), 0.0)


def _apart(a: Proximity, b: Proximity, moved: Array) -> Array:
    """Faces (C,) that are farther apart than the bodies move."""
    return (a.depth < 0) & (b.depth < 0) & (-(a.depth + b.depth) > moved)


def _turns(a: Proximity, b: Proximity, h: Array) -> tuple[list[Array], list[Array]]:
    """Shares of the time h at which the Hermite cubic of the penetration turns, at most 1, and its values there [m] (C,)."""
    x, y, p, q = a.depth, b.depth, h * a.rate, h * b.rate
    second, third = 3.0 * (y - x) - 2.0 * p - q, 2.0 * (x - y) + p + q
    # Roots of p + 2 second s + 3 third s^2, by the form that loses no digits.
    root = jnp.sqrt(jnp.maximum(second**2 - 3.0 * third * p, 0.0))
    sum_of = -(second + jnp.where(second >= 0, root, -root))
    ratio = lambda a, b: jnp.where(b == 0, 0.0, a / jnp.where(b == 0, 1.0, b))  # noqa: E731
    shares = [jnp.clip(s, 0.0, 1.0) for s in (ratio(sum_of, 3.0 * third), ratio(p, sum_of))]
    return shares, [x + s * (p + s * (second + s * third)) for s in shares]


def _extremes(a: Proximity, b: Proximity, h: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Greatest and least penetration [m] of the Hermite cubic, each with its share of the time h before it (C,)."""
    shares, values = _turns(a, b, h)
    shares = jnp.stack([*shares, jnp.zeros_like(a.depth), jnp.ones_like(a.depth)])
    values = jnp.stack([*values, a.depth, b.depth])

    def best(i: Array) -> tuple[Array, Array]:
        return jnp.take_along_axis(shares, i[None], 0)[0], jnp.take_along_axis(values, i[None], 0)[0]

    return best(jnp.argmax(values, axis=0)), best(jnp.argmin(values, axis=0))


def _described(a: Proximity, m: Proximity, b: Proximity, h: Array, near: Array) -> Array:
    """Whether the cubic through both ends of a stride of length h [s] describes what its middle sees, of every face."""
    middle = 0.5 * (a.depth + b.depth) + h * (a.rate - b.rate) / 8.0
    slope = h * m.rate - 1.5 * (b.depth - a.depth) + 0.25 * h * (a.rate + b.rate)
    off = jnp.abs(m.depth - middle) + jnp.abs(slope) / 8.0
    (high, top), (low, bottom) = _extremes(a, b, h)
    within = lambda s: (s > 0) & (s < 1)  # noqa: E731
    sizes = jnp.maximum(jnp.abs(a.depth), jnp.abs(b.depth))
    sizes = jnp.where(within(high), jnp.minimum(sizes, jnp.abs(top)), sizes)
    sizes = jnp.where(within(low), jnp.minimum(sizes, jnp.abs(bottom)), sizes)
    turned = h * jnp.max(jnp.stack([a.turn, m.turn, b.turn]), axis=0)
    good = (off <= jnp.maximum(0.5 * near, _AGREES * sizes)) & (turned <= 5.0)
    lost = ~jnp.isfinite(m.depth)
    return jnp.all(good | lost | _apart(a, b, _moved(h, a, m, b)))


def _gone(m: _March, a: Proximity, b: Proximity, at: Array, h: Array, near: Array) -> _March:
    """After half a stride, from the share ``at`` on: which faces have begun and ended to touch, and how deep they were."""
    long = 0.5 * m.stride
    (high, top), (_, bottom) = _extremes(a, b, long * h)
    out, into = m.inside & (bottom < -2.0 * near), ~m.inside & (top > 2.0 * near)
    changed = out | into
    back = changed & jnp.where(m.inside, b.depth > near, b.depth < -near)
    crossed = at + long * crossed_at(a, b, m.inside, long * h, -2.0 * near)
    return m._replace(
        inside=m.inside ^ changed ^ back,
        changes=m.changes + changed + back,
        first=jnp.where(changed & (m.changes == 0), crossed, m.first),
        top=jnp.maximum(m.top, top),
        deepest=jnp.where(top > m.top, at + long * high, m.deepest),
    )


class Seeker(dfx.AbstractAdaptiveSolver):
    """A solver that tells its step control, beside the error, where its step has to end (``hidden``): (error, share).

    Attributes:
        solver: whose steps are looked at; ``tolerance``: (n,) the step control's absolute one; ``scales``: its natural sizes.
        norm: the step control's, of errors over the tolerance.
        near: penetration that counts as none [m].
        blind: whether the solver's error ignores forces at a step's end (``hidden``), and its interpolant is not used.
    """

    solver: dfx.AbstractAdaptiveSolver
    tolerance: Array
    scales: Array
    near: Array
    norm: Callable[[Array], Array] = eqx.field(static=True)
    blind: bool = eqx.field(static=True, default=False)

    @property
    def term_structure(self):
        """The solver's."""
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        """The solver's."""
        return self.solver.interpolation_cls

    def order(self, terms):
        """The solver's."""
        return self.solver.order(terms)

    def error_order(self, terms):
        """The solver's."""
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        """The solver's memory, and what is seen at the start."""
        # One array, which costs less to carry than five.
        return self.solver.init(terms, t0, t1, y0, args), jnp.stack(self._look(t0, y0, args))

    def func(self, terms, t0, y0, args):
        """The solver's."""
        return self.solver.func(terms, t0, y0, args)

    def _look(self, t: Any, y: Array, args: Any) -> Proximity:
        # With tangents beside the state there are rows of both, and args may be (args, their changes).
        model, prepared = args[0] if isinstance(args[0], tuple) else args
        return seen(model, *jax.lax.stop_gradient((t, y[0] if y.ndim == 2 else y, prepared)))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """The solver's step, and where it has to end."""
        memory, before = solver_state
        error: Any
        y1, error, dense, memory, result = self.solver.step(terms, t0, t1, y0, args, memory, made_jump)
        between = self.interpolation_cls(t0=t0, t1=t1, **dense)
        if self.blind:
            # A stage within a contact that neither the new state nor its error weighs would bend the solver's interpolant.
            slope = lambda t, y: (t1 - t0) * self.solver.func(terms, t, y, args)  # noqa: E731
            k0, k1, middle = slope(t0, y0), slope(t1, y1), 0.5 * (t0 + t1)
            between = dfx.ThirdOrderHermitePolynomialInterpolation(t0=t0, t1=t1, y0=y0, y1=y1, k0=k0, k1=k1)
            simpson = y0 + (k0 + 4.0 * slope(middle, between.evaluate(middle)) + k1) / 6.0
            wild = self.norm((y1 - simpson) / self.scales) > _WILD
            error = jnp.where(wild, jnp.inf, error)
        after = self._look(t1, y1, args)
        good = self.norm(jax.lax.stop_gradient(error) / self.tolerance) <= 1.0
        share = hidden(
            Proximity(*before), after, jnp.asarray(t1 - t0), self.near,
            lambda s: self._look(t0 + s * (t1 - t0), between.evaluate(t0 + s * (t1 - t0)), args), good, self.blind,
        )  # fmt: skip
        return y1, (error, share), dense, (memory, jnp.stack(after)), result


def hidden_in(model: AbstractModel, prepared: Any, near: Array) -> Callable[..., Array]:
    """``hidden`` of a model's steps as ``bdf.Limits`` takes it: (begin, end, state before, read, good) -> share."""

    def find(begin: Array, end: Array, before: Array, read: Callable[[Array], Array], good: Array) -> Array:
        look = lambda t, y: seen(model, *jax.lax.stop_gradient((t, y, prepared)))  # noqa: E731
        sight = lambda s: look(begin + s * (end - begin), read(begin + s * (end - begin)))  # noqa: E731
        return hidden(look(begin, before), look(end, read(end)), end - begin, near, sight, good, False)

    return find


@eqx.filter_jit  # Traced once for all of its places.
def seen(model: AbstractModel, t: Any, y: Array, prepared: Any) -> Proximity:
    """What a model that can be looked at shows in a state."""
    return model.proximity(t, y, prepared)


class Limited(dfx.AbstractStepSizeController):
    """A step control whose steps are no longer than ``longest`` [s], and which fails where they would be below ``shortest``."""

    inner: dfx.AbstractStepSizeController
    longest: Array
    shortest: Array

    def wrap(self, direction):
        """Forwards only."""
        return Limited(self.inner.wrap(direction), self.longest, self.shortest)

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """The inner control's, if it is not too long."""
        first, inner = self.inner.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return jnp.minimum(first, t0 + self.longest), inner

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The inner control's decision, within the limits."""
        keep, start, end, jump, inner, result = self.inner.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )
        lost = ~keep & (end - start < self.shortest)
        result = dfx.RESULTS.where(lost, dfx.RESULTS.dt_min_reached, result)
        return keep, start, jnp.minimum(end, start + self.longest), jump, inner, result


class Breaking(dfx.AbstractStepSizeController):
    """A step control whose steps end just before breaks and begin just behind them, so that no stage is on either side.

    A step that a break cut short says nothing of the length of the next: that is at least the length before the cut.
    ``breaks``: (B,) sorted times [s]; infinite for none.
    """

    inner: dfx.AbstractStepSizeController
    breaks: Array

    def wrap(self, direction):
        """Forwards only."""
        return Breaking(self.inner.wrap(direction), self.breaks)

    def _before(self, t: Array, end: Any) -> Array:
        """The end of a step from t, at the next break if that is nearer."""
        t, breaks = jax.lax.stop_gradient((t, self.breaks))
        k = jnp.searchsorted(breaks, t, side="right")
        there = jnp.where(k < breaks.size, breaks[jnp.minimum(k, breaks.size - 1)], jnp.inf)
        return jnp.minimum(end, jnp.maximum(jnp.nextafter(there, -jnp.inf), jnp.nextafter(t, jnp.inf)))

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """The inner control's first step, up to a break."""
        first, inner = self.inner.init(terms, t0, t1, y0, dt0, args, func, error_order)
        start = jnp.asarray(t0, dtype=jnp.float64)
        return self._before(start, first), (inner, first - start)

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The inner control's decision, with the next step up to a break, from behind the one that was reached."""
        before, free = controller_state
        keep, start, end, jump, inner, result = self.inner.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, before
        )
        fixed = jax.lax.stop_gradient
        cut = keep & (fixed(t1 - t0) < fixed(free) * (1.0 - 1e-9))
        result = dfx.RESULTS.where(cut, dfx.RESULTS.successful, result)
        behind = jnp.nextafter(jnp.nextafter(fixed(start), jnp.inf), jnp.inf)
        k = jnp.searchsorted(self.breaks, start, side="right")
        next_break = self.breaks[jnp.minimum(k, self.breaks.size - 1)]
        reached = keep & (next_break > start) & (next_break < behind)
        length = jnp.where(cut, jnp.maximum(end - start, free), end - start)
        start = jnp.where(reached, behind, start)
        return keep, start, self._before(start, start + length), jump | reached, (inner, length), result


class Seeking(dfx.AbstractStepSizeController):
    """The step control of a ``Seeker``: the inner one's decision, and a step that hides a contact is taken again."""

    inner: dfx.AbstractStepSizeController

    def wrap(self, direction):
        """Forwards only."""
        return Seeking(self.inner.wrap(direction))

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """The inner control's."""
        first, inner = self.inner.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return first, (inner, jnp.asarray(0))

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The inner control's decision on the error; of a step that it keeps and that hides a contact, a shorter one."""
        both: Any = y_error
        (error, share), (before, tries) = both, controller_state
        keep, start, end, jump, state, result = self.inner.adapt_step_size(
            t0, t1, y0, y1_candidate, args, error, error_order, before
        )
        part = jnp.maximum(share, _LEAST) * (t1 - t0)
        again = keep & (share < 1.0) & (tries < _TRIES) & (part > _ROUNDING * jnp.abs(t0))
        tries = jnp.where(again, tries + 1, jnp.where(keep, 0, tries))
        state = jax.tree.map(lambda old, new: jnp.where(again, old, new), before, state), tries
        end = jnp.where(again, t0 + part, end)
        return keep & ~again, jnp.where(again, t0, start), end, jump & ~again, state, result
