"""What happens in the steps of a run, and not in the samples that it is read at: contact forces, impulses, balances.

At the middle and the end of every accepted step each contact and each account of the model (``AbstractModel.accounts``) is
evaluated (``wrapped``). A parabola through the two and the step's beginning gives the greatest force between them, Simpson's
rule the impulse and the work, a cubic the instant of touch. An impact that the step control resolves is thereby seen,
however coarse the samples are. Without diffrax, which a kept program does not need.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.mechanism.model import AbstractModel, Account, Params
from bcfj_jax.solve.cubic import hermite

# Newton's steps to the root of a cubic, from that of its secant.
_NEWTON = 5


class Extremes(NamedTuple):
    """Of one contact, () or of its members (k,), from time 0 to the end of the run."""

    peak: Array  # greatest size of the normal force [N]
    # peak_time, least_time: when they were [s].
    peak_time: Array
    least: Array  # least normal force [N], below 0 where a contact pushes back
    least_time: Array
    onset: Array  # when the surfaces first touched [s]; infinite where they have not
    # first, latest: when they first and last began to touch after time 0 [s]; infinite likewise.
    first: Array
    latest: Array
    end: Array  # when they last parted [s]; infinite where they touch at the end of the run, or never did
    count: Array  # number of contacts
    touching: Array  # time in contact [s]
    impulse: Array  # integral of the size of the normal force
    coarse: Array  # by how much Simpson's and the trapezium rule differ [N s]
    work: Array  # integral of the size of the normal force over the penetration [J]
    deepest: Array  # greatest penetration [m]; negative is the least gap


class Totals(NamedTuple):
    """Of one account, () or of a body's members (k,), over a run."""

    # first, last: its values at the beginning and at the end.
    first: Array
    last: Array
    integral: Array  # of its rate over the time
    size: Array  # of the sum of the sizes of the rate's terms
    miss: Array  # greatest size of what the value has changed by since the beginning, less the integral until then
    coarse: Array  # bound of the quadrature's error: the difference of two rules
    greatest: Array  # greatest size of the rate
    when: Array  # it was [s]


class Look(NamedTuple):
    """Normal force [N], penetration [m] and its rate [m/s] of all contacts, members apart, (N,)."""

    force: Array
    penetration: Array
    rate: Array


Args = tuple[AbstractModel, Any]


def _apart(t: Any, y: Array, args: Args) -> tuple[list[Look], dict[str, Account]]:
    model, prepared = args
    readings = model.read(t, y, prepared)
    return [Look(r.force[..., 0], r.penetration, r.rate) for r in readings], model.accounts(t, y, prepared)


@eqx.filter_jit  # Traced once for all of its places.
def look(t: Any, y: Array, args: Args) -> tuple[Look, Account]:
    """All contacts and all accounts in one state, each as one array; ``args`` are (model, what it has prepared)."""
    contacts, accounts = _apart(t, y, args)

    def flat(parts: list[Any]) -> list[Array]:
        return [jnp.concatenate([jnp.zeros(0), *(jnp.ravel(part[k]) for part in parts)]) for k in range(3)]

    return Look(*flat(contacts)), Account(*flat([accounts[name] for name in sorted(accounts)]))


def named(t: Any, y: Array, args: Args, found: tuple[Extremes, Totals]) -> tuple[list[Extremes], dict[str, Array]]:
    """What was found of contacts, in the order of the model's ``alike``, and of accounts, by name and as rows of ``Totals``."""
    contacts, accounts = jax.eval_shape(lambda: _apart(t, y, args))

    def apart(whole: Any, parts: list[Any]) -> list[Any]:
        ends = np.cumsum([math.prod(part[0].shape) for part in parts])
        each = zip(ends, parts, strict=True)
        return [
            jax.tree.map(
                lambda x, n=n, shape=one[0].shape: x[..., n - math.prod(shape) : n].reshape(*x.shape[:-1], *shape),
                whole,
            )
            for n, one in each
        ]

    rows = apart(jnp.stack(found[1]), [accounts[name] for name in sorted(accounts)])
    return apart(found[0], contacts), dict(zip(sorted(accounts), rows, strict=True))


def begun(t: Any, look: Look) -> Extremes:
    """What is known of contacts at the start."""
    at, none, zero = (jnp.full_like(look.force, x) for x in (t, jnp.inf, 0.0))
    pressed = look.penetration > 0
    return Extremes(
        jnp.abs(look.force), at, look.force, at, jnp.where(pressed, at, none), none, none, none, jnp.where(pressed, 1.0, zero),
        zero, zero, zero, zero, look.penetration,
    )  # fmt: skip


def crest(first: Array, middle: Array, last: Array) -> tuple[Array, Array]:
    """Top of the parabola through values at 0, 1/2 and 1 where the middle one is greatest, else the greatest; its place.

    Only above 0: a contact that is apart has no crest.
    """
    bend = first - 2.0 * middle + last
    inside = (middle >= first) & (middle >= last) & (middle > 0) & (bend < 0)
    bend = jnp.where(inside, bend, -1.0)
    share = 0.5 - 0.25 * (last - first) / bend
    value = middle - 0.125 * (last - first) ** 2 / bend
    end = jnp.where(last >= first, last, first)
    return jnp.where(inside, value, jnp.maximum(middle, end)), jnp.where(
        inside, share, jnp.where(middle > end, 0.5, jnp.where(last >= first, 1.0, 0.0))
    )


def simpson(width: Any, first: Array, middle: Array, last: Array) -> tuple[Array, Array]:
    """Integral of a parabola through values at 0, 1/2 and 1 of a width, and how far the trapezium rule is from it."""
    return width / 6.0 * (first + 4.0 * middle + last), width / 12.0 * jnp.abs(first - 2.0 * middle + last)


def _root(width: Any, a: Look, b: Look) -> Array:
    """Share of a width at which the cubic of two penetrations and their rates is 0, where they differ in sign."""
    course, rise = hermite((a.penetration, b.penetration), (a.rate, b.rate), width), b.penetration - a.penetration
    share = jnp.clip(-a.penetration / jnp.where(rise == 0, 1.0, rise), 0.0, 1.0)
    for _ in range(_NEWTON):
        slope = course.slope_at(share)
        step = jnp.where(slope * rise > 0, course.at(share) / jnp.where(slope == 0, 1.0, slope), 0.0)
        share = jnp.clip(share - step, 0.0, 1.0)
    return share


def _touched(known: Extremes, t: Any, width: Any, a: Look, b: Look) -> Extremes:
    """Begins and ends of contacts between two looks that are a width apart."""
    inside = a.penetration > 0, b.penetration > 0
    begins, ends = ~inside[0] & inside[1], inside[0] & ~inside[1]
    share = _root(width, a, b)
    at = t + width * share
    pressed = jnp.where(begins, 1.0 - share, jnp.where(ends, share, jnp.where(inside[1], 1.0, 0.0)))
    return known._replace(
        onset=jnp.where(begins & (known.onset == jnp.inf), at, known.onset),
        first=jnp.where(begins & (known.first == jnp.inf), at, known.first),
        latest=jnp.where(begins, at, known.latest),
        end=jnp.where(begins, jnp.inf, jnp.where(ends, at, known.end)),
        count=known.count + begins,
        touching=known.touching + width * pressed,
    )


def after(known: Extremes, t0: Any, t1: Any, before: Look, middle: Look, end: Look) -> Extremes:
    """What is known of contacts after a step."""
    top, high = crest(before.force, middle.force, end.force)
    bottom, low = crest(-before.force, -middle.force, -end.force)
    width = t1 - t0
    lower = -bottom < known.least
    # On whichever side the contact pushes.
    top, high = jnp.maximum(top, bottom), jnp.where(top >= bottom, high, low)
    higher = top > known.peak
    deepest, _ = crest(before.penetration, middle.penetration, end.penetration)
    sizes = [jnp.abs(look.force) for look in (before, middle, end)]
    pushed, coarse = simpson(width, *sizes)
    worked, _ = simpson(width, *(size * look.rate for size, look in zip(sizes, (before, middle, end), strict=True)))
    known = _touched(known, t0, 0.5 * width, before, middle)
    return _touched(known, t0 + 0.5 * width, 0.5 * width, middle, end)._replace(
        peak=jnp.where(higher, top, known.peak),
        peak_time=jnp.where(higher, t0 + width * high, known.peak_time),
        least=jnp.where(lower, -bottom, known.least),
        least_time=jnp.where(lower, t0 + width * low, known.least_time),
        impulse=known.impulse + pushed,
        coarse=known.coarse + coarse,
        work=known.work + worked,
        deepest=jnp.maximum(known.deepest, deepest),
    )


def opened(t: Any, at: Account) -> Totals:
    """What is known of accounts at the start."""
    zero = jnp.zeros_like(at.rate)
    return Totals(at.value, at.value, zero, zero, zero, zero, jnp.abs(at.rate), jnp.full_like(at.rate, t))


def added(known: Totals, t0: Any, t1: Any, before: Account, middle: Account, end: Account) -> Totals:
    """What is known of accounts after a step."""
    done, coarse = simpson(t1 - t0, before.rate, middle.rate, end.rate)
    size, _ = simpson(t1 - t0, before.size, middle.size, end.size)
    top, place = crest(*(jnp.abs(x.rate) for x in (before, middle, end)))
    higher = top > known.greatest
    done = known.integral + done
    return Totals(
        known.first, end.value, done, known.size + size, jnp.maximum(known.miss, jnp.abs(end.value - known.first - done)),
        known.coarse + coarse, jnp.where(higher, top, known.greatest), jnp.where(higher, t0 + (t1 - t0) * place, known.when),
    )  # fmt: skip


def sampled(model: AbstractModel, params: Params, times: Array, states: Array) -> dict[str, Totals]:
    """The accounts of states (T, n) at times (T,), by the trapezium rule between the samples.

    ``coarse`` is what rates and sizes change by from sample to sample, times the intervals: the rule misses no more where
    they do not turn between two samples.
    """
    prepared, times = model.prepare(params), jnp.maximum(times, 0.0)
    found = jax.vmap(lambda t, y: model.accounts(t, y, prepared))(times, states)

    def changes(values: Array) -> Array:
        return jnp.abs(jnp.diff(values, axis=0))

    def summed(at: Account) -> Totals:
        rate, zero = jnp.abs(at.rate), jnp.zeros_like(at.rate[:1])
        gaps = jnp.diff(times).reshape(-1, *(1 for _ in rate.shape[1:]))
        done, size = (
            jnp.concatenate([zero, jnp.cumsum(0.5 * gaps * (x[1:] + x[:-1]), axis=0)]) for x in (at.rate, at.size)
        )
        return Totals(
            at.value[0], at.value[-1], done[-1], size[-1], jnp.max(jnp.abs(at.value - at.value[0] - done), axis=0),
            jnp.sum(gaps * jnp.maximum(changes(at.rate), changes(at.size)), axis=0), jnp.max(rate, axis=0),
            times[jnp.argmax(rate, axis=0)],
        )  # fmt: skip

    return {name: summed(at) for name, at in found.items()}
