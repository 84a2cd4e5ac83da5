"""Explicit runs whose steps end where contacts begin and end, and what these contacts were.

The field of a mechanism has a kink where a contact begins and where it ends. A step across a kink has an error that
depends on the kink's place in the step: forces bear it, their derivatives do not (10 % after a bounce at ``balanced``).
Here a step that would cross is taken again so that it ends on the surface. The pieces between are smooth, so that state and
tangents converge with the solver's order. The force is 0 on the surface, the field is continuous, and tangents at fixed
times pass through without a jump (a law whose force jumps has another derivative: ``Reading`` of its begin says so). Where
contacts remember their approach speeds, steps also end where these are set (``solve.remembering``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.normal import GAP
from bcfj_jax.core.numerics import bisected
from bcfj_jax.mechanism.model import AbstractModel, Proximity
from bcfj_jax.solve.cubic import Cubic, hermite
from bcfj_jax.solve.wrapped import AbstractControl

# A step ends on the surface when it is this share of the tolerated error of a penetration from it.
NEAR = 1e-3
# A step is taken anew so many times at most, and ends beyond this share of the one that it replaces.
_TRIES, _LEAST = 8, 1e-4
# A step of so small a part of the flight or the contact so far is not taken anew.
_SHORT = 1e-9
# After a landing the next step is at least this share of the last free one.
_AFTER = 0.05
# A contact is left by steps of this share of what is left of it, down to this share of its length: of K d^n with n < 2 the
# tangents of a step that ends near the surface are wrong by the step's length to the power n.
_PART, _FINEST = 0.5, 3e-4
# A force that ends within a contact is left by Newton's steps of this share, down to this share of the greatest force.
_NEWTON, _ENDED = 0.999, 1e-7
# Pieces of a step in which its crossing is sought, and halvings of the piece.
PIECES, _HALVINGS = 16, 50


# The clock's rounding, relative; beside it the tolerated distance counts.
ROUNDING = 5e-15


def close(near: Any, t: Any, rate: Array) -> Array:
    """Distance from a surface within which a step ends on it [m]: no nearer than the clock's rounding lets a step end."""
    return jax.lax.stop_gradient(jnp.maximum(near, ROUNDING * jnp.abs(t * rate)))


class Instants(NamedTuple):
    """Of each of C channels the first K contacts: (C, K) times [s], NaN for what there was not."""

    # begin, end: when the penetration was 0; no begin of a contact that was closed at the start.
    begin: Array
    end: Array
    high: Array  # end of the step at which the normal force was greatest; in ``crossings`` about when
    count: Array  # (C,) contacts that began (or were closed at the start), also those beyond K
    # In ``crossings``, how far the summit of the force reaches to either side [s]; NaN for none.
    reach: Array | None = None
    # (C,) in ``crossings``, contacts and separations within one step, which are not among the others.
    missed: Array | None = None


class Look(NamedTuple):
    """Penetration, its rate and normal force of each channel (C,)."""

    depth: Array
    rate: Array
    force: Array


class Tops(NamedTuple):
    """Of each of C channels the ends of the steps at which its force was greatest, and least."""

    size: Array  # (2, C) of that force [N], and of the opposite of the least
    time: Array  # (2, C) [s]
    state: Array  # (2, C, n)
    # before, after: (2, C) lengths of the steps before and after these [s].
    before: Array
    after: Array


class _Memory(NamedTuple):
    """What the controller knows; of C channels, and behind them of the surfaces at which approach speeds are set."""

    inner: Any  # the inner control's state
    before: Look  # the step's start
    inside: Array  # (C,) which channels touch
    found: Instants  # contacts so far
    tries: Array  # in a row to end on a surface
    free: Array  # length of the step that first crossed it [s]
    since: Array  # (C,) from when on they do or do not [s]
    # high, top: (C,) when the force was greatest in this contact [s], and its size [N].
    high: Array
    top: Array
    tops: Tops | None  # of the whole run, None where nobody asks


@partial(jax.jit, static_argnums=0)  # Traced once for all of its places, and for each derivative of them.
def look(model: AbstractModel, t: Any, y: Array, prepared: Any) -> Look:
    """Every channel in one state, in the order of ``derivatives.jacobian.channel_names``."""
    seen = model.observe(t, y, prepared)
    rows = [
        [jnp.ravel(x) for x in (r.penetration, r.rate, r.force[..., 0])]
        for r in (seen[contact.name] for contact in model.contacts)
    ]
    return Look(*(jnp.concatenate(part) for part in zip(*rows, strict=True))) if rows else Look(*[jnp.zeros(0)] * 3)


def bending(model: AbstractModel) -> tuple[int, ...]:
    """Channels whose force has a corner where their penetration turns."""
    return _channels(model, lambda contact: getattr(contact.law, "bends", False))


def bristled(model: AbstractModel) -> tuple[int, ...]:
    """Channels whose friction has bristles, which begin to bend at a gap of ``normal.GAP``."""
    return _channels(model, lambda contact: contact.friction is not None and contact.friction.bristles)


def jumping(model: AbstractModel) -> tuple[int, ...]:
    """Channels of ``felt`` whose force may begin with a jump: of laws that say so, and where loads begin."""
    contacts = sum(max(1, count) for count in model.members.values())
    jumps = _channels(model, lambda contact: getattr(contact.law, "jumps", False))
    return (*jumps, *range(contacts, contacts + model.corners))


def _channels(model: AbstractModel, which: Callable[[Any], bool]) -> tuple[int, ...]:
    counts = [max(1, model.members[contact.name]) for contact in model.contacts]
    every = [which(contact) for contact, count in zip(model.contacts, counts, strict=True) for _ in range(count)]
    return tuple(i for i, is_one in enumerate(every) if is_one)


def felt(model: AbstractModel, t: Any, y: Array, prepared: Any) -> Look:
    """Every channel, and where loads begin to act."""
    found = look(model, t, y, prepared)
    if not model.corners:
        return found
    return Look(*(jnp.concatenate(pair) for pair in zip(found, model.onsets(t, y, prepared), strict=True)))


def surfaces(model: AbstractModel, t: Any, y: Array, prepared: Any) -> Look:
    """``felt``; then, which bear no force, the surfaces at which approach speeds are set, where bristles begin to bend, and those
    of ``bending``.

    The depth of the last is the speed of departure [m/s]; its rate [m/s^2] goes by the field.
    """
    found = [felt(model, t, y, prepared)]
    none = lambda x: jnp.zeros_like(x)  # noqa: E731
    if model.remembered:
        more = model.approaches(t, y, prepared)
        found.append(Look(more.depth, more.rate, none(more.depth)))
    if bending_from := bristled(model):
        wide = [
            model.coefficient(prepared, c.name, "smoothing") if getattr(c, "smoothing", False) else jnp.zeros(())
            for c in model.contacts
            for _ in range(max(1, model.members[c.name]))
        ]
        near, at = found[0], jnp.asarray(bending_from)
        found.append(Look((near.depth + jnp.stack(wide) + GAP)[at], near.rate[at], none(near.force[at])))
    if corners := bending(model):
        along = (jnp.ones_like(jnp.asarray(t)), model.vector_field(t, y, prepared))
        speed, change = jax.jvp(lambda t, y: -look(model, t, y, prepared).rate, (jnp.asarray(t), y), along)
        at = jnp.asarray(corners)
        found.append(Look(speed[at], change[at], none(speed[at])))
    return Look(*(jnp.concatenate(part) for part in zip(*found, strict=True)))


class Landing(AbstractControl):
    """A step control that also ends steps on surfaces, and notes when contacts begin and end.

    The arguments of the field are (model, what it has prepared). ``near``: a step ends on a surface within it, [m] or [m/s].
    ``size`` is the number of states that the model reads; others may stand behind them. ``since`` [s]: from when on greatest
    forces are sought, which carry derivatives; None for none.
    """

    near: Array
    most: int = eqx.field(static=True)
    size: int = eqx.field(static=True)
    since: Array | None = None

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        first, inner = self.inner.init(terms, t0, t1, y0, dt0, args, func, error_order)
        model, prepared = args
        start = y0[: self.size]
        seen = surfaces(model, t0, start, prepared)
        inside, found = opening(seen, self.most)
        top = jnp.where(inside, jnp.abs(seen.force), -jnp.inf)
        none = jnp.zeros(seen.depth.shape)
        tops = None
        if self.since is not None:
            size = jnp.where(t0 >= self.since, _both(seen.force), -jnp.inf)
            none_yet = jnp.zeros(size.shape)
            states = jnp.broadcast_to(start, (*size.shape, start.size))
            tops = Tops(jax.lax.stop_gradient(size), none_yet, states, none_yet, none_yet)
        return first, _Memory(inner, seen, inside, found, jnp.asarray(0), jnp.asarray(0.0), none, none, top, tops)

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The inner control's decision; of a step that crosses, and is kept or meets a jump, another one to the surface."""
        memory = controller_state
        keep, start, end, jump, inner, result = self.inner.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, memory.inner
        )
        (model, prepared), after = args, y1_candidate[: self.size]
        now, dt = surfaces(model, t1, after, prepared), t1 - t0
        fixed = jax.lax.stop_gradient
        reach = close(self.near, t1, now.rate)
        near, heading = jnp.abs(now.depth) <= reach, jnp.where(memory.inside, -now.rate, now.rate) > 0
        beyond = jnp.where(memory.inside, -now.depth, now.depth) > 0
        # A step across a jump is rejected until it is as short as rounding: the way to the surface is known before.
        crossing = (keep | np.isin(np.arange(beyond.size), jumping(model))) & beyond & ~near
        share = jax.lax.cond(
            jnp.any(crossing),
            lambda: jnp.min(jnp.where(crossing, crossed_at(memory.before, now, memory.inside, dt, 0.5 * reach), 1.0)),
            lambda: jnp.ones_like(dt),
        )
        # A step so short is on the surface, whatever the rounding of the penetration lets it show.
        short = fixed(dt) <= _SHORT * jnp.max(jnp.where(crossing, fixed(t1) - memory.since, 0.0))
        again = jnp.any(crossing) & (memory.tries < _TRIES) & (share < 1.0) & ~short
        ending, early = self._ending(memory, now, (t0, y0[: self.size]), args, dt, keep & ~again)
        again = again | early
        turned, kept = keep & ~again & (beyond | (near & heading)), keep & ~again
        landed = jnp.any(turned)
        inside, free = memory.inside ^ turned, jnp.where(again, jnp.maximum(memory.free, fixed(dt)), memory.free)
        since, size = jnp.where(turned, fixed(t1), memory.since), jnp.abs(now.force)
        higher = kept & inside & (turned | (size > memory.top))
        # To the surface; of a contact that ends, by ever shorter steps.
        surface = jnp.maximum(share, _LEAST) * dt
        # A turn is no end of a contact, nor is where a bristle or a load begins.
        ends = np.arange(turned.size) < turned.size - len(bending(model)) - len(bristled(model))
        finest = jnp.min(jnp.where(memory.inside & crossing & ends, _FINEST * (fixed(t0) - memory.since), jnp.inf))
        surface = jnp.where(surface > finest, _PART * surface, surface)
        surface = jnp.where(early, ending, surface)
        # A step that only ends a flight says nothing of the length of the next.
        length = fixed(end - start)
        length = jnp.where(landed, jnp.maximum(length, _AFTER * free), length)
        leaving = kept & inside & ~turned & (now.rate < 0) & ~near & ends
        ahead = -now.depth / jnp.where(leaving, now.rate, -1.0)
        ahead = jnp.maximum(_PART * ahead, _FINEST * (fixed(t1) - memory.since))
        length = jnp.minimum(length, jnp.min(jnp.where(leaving, ahead, jnp.inf)))
        start, end = jnp.where(again, t0, start), jnp.where(again, t0 + surface, start + length)
        inner = jax.tree.map(lambda a, b: jnp.where(landed, a, b), restarted(inner), inner)
        known = _Memory(
            jax.tree.map(lambda a, b: jnp.where(again, a, b), memory.inner, inner),
            Look(*(jnp.where(kept, a, b) for a, b in zip(now, memory.before, strict=True))),
            inside,
            jax.lax.cond(
                landed, lambda: noted(memory.found, fixed(t1), turned, memory.inside, memory.high), lambda: memory.found
            ),
            jnp.where(again, memory.tries + 1, jnp.where(keep, 0, memory.tries)),
            jnp.where(landed, 0.0, free),
            since,
            jnp.where(higher, fixed(t1), memory.high),
            jnp.where(higher, fixed(size), jnp.where(inside, memory.top, -jnp.inf)),
            self._topped(memory.tops, kept, _both(now.force), t0, t1, after),
        )
        return kept, start, end, jump, known, result

    def _ending(
        self, memory: _Memory, now: Look, begin: tuple[Any, Array], args: Any, dt: Any, kept: Array
    ) -> tuple[Array, Array]:
        """How far from a step's start a force ends within its contact [s], and whether the step is to end there.

        A force F that is cut off at 0 has a corner there. A step ahead of it goes to where F + F' h is 0, which moves with the
        parameters: from its end on F does not depend on them.
        """
        model, prepared = args
        never = jnp.zeros_like(dt), jnp.zeros((), bool)
        if not model.corners and not any(getattr(getattr(c, "law", None), "ends", False) for c in model.contacts):
            return never
        size, fixed = jnp.abs(memory.before.force), jax.lax.stop_gradient
        over = kept & (now.force == 0) & (now.depth > 0) & (size > _ENDED * memory.top) & (memory.tries < _TRIES)

        def root() -> Array:
            t, y, given = fixed((jnp.asarray(begin[0]), begin[1], prepared))
            force = lambda t, y: jnp.abs(felt(model, t, y, given).force)  # noqa: E731
            slope = jax.jvp(force, (t, y), (jnp.ones_like(t), model.vector_field(t, y, given)))[1]
            slope = jnp.concatenate([slope, jnp.zeros(size.size - slope.size)])
            falls = slope < 0
            length = jnp.where(falls, _NEWTON * size / jnp.where(falls, -fixed(slope), 1.0), 0.5 * dt)
            return jnp.min(jnp.where(over, jnp.maximum(length, _LEAST * dt), jnp.inf))

        found = jax.lax.cond(jnp.any(over), root, lambda: jnp.full_like(dt, jnp.inf))
        early = found < fixed(dt)
        return jnp.where(early, found, dt), early

    def _topped(self, tops: Tops | None, kept: Array, size: Array, begin: Any, end: Any, y: Array) -> Tops | None:
        """With the end of a step that is kept, where a force (2, C) [N] is greater there."""
        if tops is None:
            return None
        better, fixed = kept & (size > tops.size) & (end >= self.since), jax.lax.stop_gradient
        next_one = kept & ~better & (tops.time == begin)
        return Tops(
            jnp.where(better, fixed(size), tops.size), jnp.where(better, end, tops.time),
            jnp.where(better[..., None], y, tops.state), jnp.where(better, fixed(end - begin), tops.before),
            jnp.where(better, 0.0, jnp.where(next_one, fixed(end - begin), tops.after)),
        )  # fmt: skip


def _both(force: Array) -> Array:
    """Forces (C,) and their opposites (2, C): the least is the opposite's greatest."""
    return jnp.stack([force, -force])


def restarted(control: tuple) -> tuple:
    """A step control's memory, wrapped or not, without the errors of earlier steps, as it starts.

    The error of a step that only reaches a surface is rounding: the steps after it would depend on how a program rounds.
    """
    first, *rest = control
    return (restarted(first), *rest) if isinstance(first, tuple) else (*map(jnp.ones_like, control[:2]), *control[2:])


def course(before: Look | Proximity, now: Look | Proximity, dt: Any) -> Cubic:
    """The penetrations (C,) in a step [m]."""
    return hermite((before.depth, now.depth), (before.rate, now.rate), dt)


@jax.jit  # As ``look``.
def crossed_at(before: Look, now: Look, inside: Array, dt: Any, short: Any) -> Array:
    """Share of a step at which the Hermite cubic of the penetration is ``short`` of crossing 0 [m] (C,).

    A stage beyond would have the field of the other side, which may be another by a jump.
    """
    found, sign, fixed = course(before, now, dt), jnp.where(inside, -1.0, 1.0), jax.lax.stop_gradient

    def outward(s: Array) -> Array:
        return sign * found.at(s) + short

    def crossed(s: Array) -> Array:
        return fixed(outward(s)) > 0

    ends = jnp.arange(1, PIECES + 1) / PIECES
    first = jnp.argmax(jax.vmap(crossed, 0, 1)(ends[:, None] * jnp.ones_like(sign)), axis=1)
    bracket = first / PIECES, (first + 1.0) / PIECES

    low, high = bisected(crossed, bracket, _HALVINGS)
    root = 0.5 * (low + high)
    # Of a root that moves with the parameters: the last step of Newton's method.
    slope = fixed(sign * found.slope_at(root))
    return root - jnp.where(slope == 0, 0.0, outward(root) / jnp.where(slope == 0, 1.0, slope))


def opening(seen: Look, most: int) -> tuple[Array, Instants]:
    """Which channels touch at the start, and room for the first ``most`` contacts of each."""
    inside = (seen.depth > 0) | ((seen.depth == 0) & (seen.rate > 0) & (seen.force > 0))
    empty = jnp.full((*seen.depth.shape, most), jnp.nan)
    return inside, Instants(empty, empty, empty, jnp.where(inside, 1, 0))


def noted(found: Instants, at: Any, turned: Array, inside: Array, high: Array) -> Instants:
    """The contacts with those that began or ended at instants [s]; ``inside`` and ``high`` are as before."""
    begun, ended = turned & ~inside, turned & inside
    count = found.count + begun
    begin, end = put(found.begin, begun, count, at), put(found.end, ended, count, at)
    return Instants(begin, end, put(found.high, ended, count, high), count)


def put(table: Array, where: Array, count: Array, values: Any) -> Array:
    """A table (C, K) with values in each channel's last contact; what has no place is dropped."""
    most = table.shape[1]
    place = jnp.where(where & (count > 0), count - 1, most)
    return table.at[jnp.arange(count.size), place].set(values, mode="drop")


def contacts(last: _Memory, channels: int) -> Instants:
    """What a run's memory at its end knows of its contacts; of one that is still closed when its force was greatest so far."""
    last = jax.lax.stop_gradient(last)
    found = last.found._replace(high=put(last.found.high, last.inside, last.found.count, last.high))
    return jax.tree.map(lambda x: x[:channels], found)
