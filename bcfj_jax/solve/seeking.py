"""Steps in which no contact begins and ends unseen: each is short enough that both its ends tell of all between them.

An error estimate knows the field at a step's stages alone: bodies that meet and part between two stages do not meet. Of each
face the model tells the penetration, its rate and how fast the bodies move past each other (``mechanism.model.Proximity``) at
both ends of every step. Nothing is hidden where

- the surfaces are farther apart than the bodies move in the step, or
- the bodies move no farther than what the penetration's course bends over, so that it is the cubic through both
  ends but for a known band, and that cubic neither touches in between nor is deeper by far than both ends know.

Any other step is taken again, shorter: to the earliest possible touch by the distance and the speed, as a safe ray march does
(Hart, The Visual Computer 12 (1996) 527), to that length, or to where the cubic begins to touch or is deepest. What
happens from there on the error estimate sees.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.numerics import bisected
from bcfj_jax.mechanism.model import AbstractModel, Proximity
from bcfj_jax.solve.cubic import Cubic, Extreme
from bcfj_jax.solve.landing import course
from bcfj_jax.solve.wrapped import AbstractControl, AbstractWrapped

# Speeds within a step are taken to be up to this multiple of the greater one at its ends.
_FASTER = 1.25
# Bodies may move by the length over which a penetration's course bends in a step, as much as ``_FASTER`` takes it to be.
_SHARE = _FASTER
# The cubic's error over that length times the fourth power of the share: d''''/384 of a distance between two points, 3/384 at
# most, a quarter more.
_BAND = 0.01
# A contact is hidden where it is so many times deeper than at both ends.
_DEEPER = 4.0
# Of a gap that does not say what bends it, the cubic is good where two looks, at shares of the step that no wave fits, differ
# from it by this share of how far the surfaces are from touching.
_INNER, _AGREES = (0.31, 0.5), 0.1
# A step is taken again for hidden contacts so many times at most, so that rounding cannot hold it.
_TRIES = 50
# A step that is taken again is no shorter than this share of it, and not taken again where time's rounding shows.
_LEAST, _ROUNDING = 1e-6, 1e-13
# A blind solver's step that differs by this share of the natural sizes from Simpson's rule is none.
_WILD = 0.1
# Halvings of a step that has to end at a touch of its cubic.
_HALVINGS = 45


def allowed(
    a: Proximity, b: Proximity, h: Array, near: Array, inner: tuple[Proximity, ...], blind: bool
) -> tuple[Array, Array]:
    """Share of a step at which it has to end so that no contact is hidden in it, 1 where none is; longest next step [s].

    Args:
        a, b: what is seen at both ends.
        h: the step's length [s].
        near: penetration that counts as none [m].
        inner: what is seen on the step's interpolant at ``_INNER``, where a gap does not say what bends it; else ().
        blind: whether the error estimate ignores the field at the step's end: then no step may end within a contact
            that begins in it.
    """
    a, b, h, near, inner = jax.lax.stop_gradient((a, b, h, near, inner))
    inside = a.depth > jnp.where(a.rate > 0, -near, near)
    moved = h * _FASTER * jnp.maximum(a.speed, b.speed)
    turned = h * _FASTER * jnp.maximum(a.turn, b.turn)
    gap = jnp.maximum(jnp.minimum(-a.depth, -b.depth), 0.0)
    apart = (gap > 0.0) & (-(a.depth + b.depth) > moved)
    # The course bends over more motion where the surfaces are apart.
    bends = jnp.minimum(a.bends, b.bends)
    bent = jnp.maximum(turned, _over(moved, bends + gap))
    small = bent <= _SHARE
    fit = _fit(a, h)
    if inner:
        small = jnp.where(bends > 0.0, small, _agrees(a, inner, b, h, near))
        fit = jnp.where(bends > 0.0, fit, 0.5)
    band = jnp.where(bends > 0.0, _BAND * moved * jnp.minimum(bent, _SHARE) ** 3, 0.0)
    cubic = course(a, b, h)
    high, low = cubic.extremes()
    # What both ends know; of surfaces that part at the end a damped law may not.
    known = jnp.maximum(jnp.maximum(a.depth, jnp.where(b.rate >= 0.0, b.depth, 0.0)), near)
    deeper = high.depth + _doubt(high, band, h * a.rate, h * b.rate) > _DEEPER * known
    parts = (a.depth > near) & (b.depth > near) & (low.depth - _doubt(low, band, -h * a.rate, -h * b.rate) < -near)
    if blind:
        deeper = deeper | (~inside & (b.depth > 4.0 * near))
    touches = ~inside & (high.depth > 2.0 * near)
    there = jnp.where(touches, _touch(cubic, high, 2.0 * near, blind), jnp.where(deeper, 0.95 * high.at, low.at))
    # Where the band alone says so, the cubic does not know where; and what is hardly shorter would be as long.
    unsure = jnp.where(touches, there if blind else 0.9, 0.5)
    there = jnp.where((there > 0.0) & (there < 0.95), there, unsure)
    share = jnp.where(small, jnp.where(deeper | parts, there, 1.0), jnp.minimum(fit, 0.9))
    share = jnp.min(jnp.where(apart | ~jnp.isfinite(b.depth), 1.0, share), initial=1.0)
    # A step towards surfaces that are far away, as long as errors allow, would be taken again.
    towards = (-b.depth > bends) & (b.rate > 0.0) & (bends > 0.0)
    return share, h * jnp.min(jnp.where(towards, _fit(b, h), jnp.inf), initial=jnp.inf)


def _fit(seen: Proximity, h: Array) -> Array:
    """Share of a step of length h [s] in which nothing can touch or the course is a cubic, whichever is longer (C,)."""
    moved, turned = h * _FASTER * seen.speed, h * _FASTER * seen.turn
    return jnp.maximum(-seen.depth / moved, 0.9 * _SHARE / jnp.maximum(turned, moved / seen.bends))


def _doubt(extreme: Extreme, band: Array, p: Array, q: Array) -> Array:
    """By how much a course may go beyond a cubic's extreme (C,) [m]; p, q: slopes at both ends, per step, outwards.

    The course leaves the cubic by 16 band s^2 (1 - s)^2 at most, and not at the ends: nowhere where that is less steep.
    """
    steep = jnp.where(extreme.at >= 1.0, q, jnp.where(extreme.at <= 0.0, -p, 0.0))
    return jnp.where(steep >= 8.0 * band, 0.0, band)


def _over(x: Array, y: Array) -> Array:
    """x / y where x is positive, else 0."""
    return jnp.where(x > 0.0, x / y, 0.0)


def _touch(cubic: Cubic, high: Extreme, level: Array, exact: bool) -> Array:
    """Share of a step before ``high`` at which the cubic of the penetration reaches a level [m], or just before that.

    The cubic is concave towards its top: one step of Newton from the chord's root ends before the touch.
    """
    if not exact:
        chord = high.at * _over(level - cubic.value, high.depth - cubic.value)
        return jnp.maximum(chord - _over(cubic.at(chord) - level, cubic.slope_at(chord)), 0.1 * chord)
    return bisected(lambda share: cubic.at(share) > level, (jnp.zeros_like(high.at), high.at), _HALVINGS)[1]


def _agrees(a: Proximity, inner: tuple[Proximity, ...], b: Proximity, h: Array, near: Array) -> Array:
    """Whether the cubic through both ends of a step of length h [s] describes what is seen at ``_INNER``, of each face."""
    cubic = course(a, b, h)
    sizes, good = jnp.maximum(jnp.abs(a.depth), jnp.abs(b.depth)), jnp.ones(a.depth.shape, bool)
    for turn in cubic.extremes():
        sizes = jnp.where((turn.at > 0.0) & (turn.at < 1.0), jnp.minimum(sizes, jnp.abs(turn.depth)), sizes)
    for s, m in zip(_INNER, inner, strict=True):
        off = jnp.abs(m.depth - cubic.at(s)) + jnp.abs(h * m.rate - cubic.slope_at(s)) / 8.0
        good = good & ((off <= jnp.maximum(0.5 * near, _AGREES * sizes)) | ~jnp.isfinite(m.depth))
    return good


class Seeker(AbstractWrapped):
    """A solver that tells its step control (error, share, longest): where its step has to end, how long the next may be.

    Both are ``allowed``'s.
    """

    scales: Array  # natural sizes (n,) of the states; ``norm``: the step control's, of what is relative to them
    near: Array  # penetration that counts as none [m]
    norm: Callable[[Array], Array] = eqx.field(static=True)
    unsure: bool = eqx.field(static=True)  # whether steps are looked at in between, too (``AbstractModel.unsure``)
    # Whether the solver's error ignores forces at a step's end (``allowed``), and its interpolant is not used.
    blind: bool = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        # One array, which costs less to carry than five.
        return self.solver.init(terms, t0, t1, y0, args), jnp.stack(_seen(t0, y0, args))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """The solver's step, and where it has to end."""
        memory, before = solver_state
        error: Any
        y1, error, dense, memory, result = self.solver.step(terms, t0, t1, y0, args, memory, made_jump)
        between = self.interpolation_cls(t0=t0, t1=t1, **dense)
        if self.blind:
            # A stage within a contact that neither the new state nor its error weighs would bend the solver's interpolant.
            slope = lambda t, y: (t1 - t0) * self.solver.func(terms, t, y, args)  # noqa: E731
            half, k0, k1 = 0.5 * (t0 + t1), slope(t0, y0), slope(t1, y1)
            between = dfx.ThirdOrderHermitePolynomialInterpolation(t0=t0, t1=t1, y0=y0, y1=y1, k0=k0, k1=k1)
            simpson = y0 + (k0 + 4.0 * slope(half, between.evaluate(half)) + k1) / 6.0
            error = jnp.where(self.norm((y1 - simpson) / self.scales) > _WILD, jnp.inf, error)
        inner = [t0 + s * (t1 - t0) for s in _INNER] if self.unsure else []
        inner, after = tuple(_seen(t, between.evaluate(t), args) for t in inner), _seen(t1, y1, args)
        limits = allowed(Proximity(*before), after, jnp.asarray(t1 - t0), self.near, inner, self.blind)
        return y1, (error, *limits), dense, (memory, jnp.stack(after)), result


def _seen(t: Any, y: Array, args: Any) -> Proximity:
    # With tangents beside the state there are rows of both, and args may be (args, their changes).
    model, prepared = args[0] if isinstance(args[0], tuple) else args
    return seen(model, *jax.lax.stop_gradient((t, y[0] if y.ndim == 2 else y, prepared)))


def allowed_in(model: AbstractModel, prepared: Any, near: Array) -> Callable[..., Array]:
    """``allowed`` of a model's steps as ``bdf.Limits`` takes it: (begin, end, state before, read) -> share."""

    def find(begin: Array, end: Array, before: Array, read: Callable[[Array], Array]) -> Array:
        look = lambda t, y: seen(model, *jax.lax.stop_gradient((t, y, prepared)))  # noqa: E731
        times = [begin + s * (end - begin) for s in _INNER] if model.unsure else []
        inner = tuple(look(t, read(t)) for t in times)
        return allowed(look(begin, before), look(end, read(end)), end - begin, near, inner, False)[0]

    return find


@eqx.filter_jit  # Traced once for all of its places.
def seen(model: AbstractModel, t: Any, y: Array, prepared: Any) -> Proximity:
    """What a model that can be looked at shows in a state."""
    return model.proximity(t, y, prepared)


class Limited(AbstractControl):
    """A step control whose steps are no longer than ``longest`` [s], and which fails where they would be below ``shortest``."""

    longest: Array
    shortest: Array

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
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


class Breaking(AbstractControl):
    """A step control whose steps end just before breaks and begin just behind them, so that no stage is on either side.

    A step that a break cut short says nothing of the length of the next: that is at least the length before the cut.
    ``breaks``: (B,) sorted times [s]; infinite for none.
    """

    breaks: Array

    def _before(self, t: Array, end: Any) -> Array:
        """The end of a step from t, at the next break if that is nearer."""
        t, breaks = jax.lax.stop_gradient((t, self.breaks))
        k = jnp.searchsorted(breaks, t, side="right")
        there = jnp.where(k < breaks.size, breaks[jnp.minimum(k, breaks.size - 1)], jnp.inf)
        return jnp.minimum(end, jnp.maximum(jnp.nextafter(there, -jnp.inf), jnp.nextafter(t, jnp.inf)))

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
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


class Seeking(AbstractControl):
    """The step control of a ``Seeker``: the inner one's decision, and a step that hides a contact is taken again."""

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        first, inner = self.inner.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return first, (inner, jnp.asarray(0))

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The inner control's decision on the error; of a step that it keeps and that hides a contact, a shorter one."""
        both: Any = y_error
        (error, share, longest), (before, tries) = both, controller_state
        keep, start, end, jump, state, result = self.inner.adapt_step_size(
            t0, t1, y0, y1_candidate, args, error, error_order, before
        )
        part = jnp.maximum(share, _LEAST) * (t1 - t0)
        again = keep & (share < 1.0) & (tries < _TRIES) & (part > _ROUNDING * jnp.abs(t0))
        tries = jnp.where(again, tries + 1, jnp.where(keep, 0, tries))
        state = jax.tree.map(lambda old, new: jnp.where(again, old, new), before, state), tries
        end = jnp.where(again, t0 + part, jnp.where(keep, jnp.minimum(end, start + longest), end))
        return keep & ~again, jnp.where(again, t0, start), end, jump & ~again, state, result
