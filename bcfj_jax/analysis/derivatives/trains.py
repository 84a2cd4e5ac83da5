"""When contacts begin, peak and end, their peaks and impulses, and their forces on a clock that moves with them. Pure.

Where impacts move in time the derivative of a force at a fixed time is a spike: the force's rate times the shift. Here both
are apart. With penetration d, normal force F and a parameter p, at the instants of one contact:

| what | definition | derivative |
|---|---|---|
| begin, end | d(t, p) = 0 | dt/dp = -(dd/dp)/(dd/dt) |
| time of the peak | dF/dt = 0 | dt/dp = -(d2F/dp dt)/(d2F/dt2) |
| peak | F there | dF/dp, since dF/dt = 0 |
| impulse J | integral of F from begin to end | integral of dF/dp, and F dt/dp at both ends |
| centre c, width w | integrals of t F/J, and of (t - c)^2 F/J, whose root is w | of their definitions |
| shape | F at a phase s = (t - begin)/(end - begin) | dF/dp + (dF/dt) dt/dp, with dt/dp = (1 - s) dbegin/dp + s dend/dp |

(The implicit function theorem; all partial derivatives by p are at fixed times.) A fixed phase and not a fixed time since the
begin: in its phase a contact is a contact for all parameters, while at a fixed time near its end it may be over, and the
derivative is then a spike there. Of a regularised contact d is the gap without regularisation.

The integral is Clenshaw and Curtis's rule on ``NODES`` points, whose every second one gives its error. Contacts of stiff models
last, and others begin and end in the meantime: there it has ``_FINER`` times as many.

A peak is sought along the field where steps are explicit. A stiff field magnifies what a state is off, so of a stiff model it
is the top of the polynomial of degree ``_DEGREE`` through the forces about it, by least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.crests import Curve
from bcfj_jax.mechanism.model import AbstractModel, Continuous, Params, Solution
from bcfj_jax.solve.plan import Plan

if TYPE_CHECKING:
    from bcfj_jax.solve.landing import Instants

NODES, _FINER = 33, 4
# Force error at which a stiff model's solves begin: BDF's tangents are not good at looser ones.
STIFF = 1e-4
# Points of a panel: a law that has a corner at the peak has another where its force ends, before the contact.
_PANEL = (NODES - 1) * _FINER + 1
# Newton steps to a peak, and Runge-Kutta steps along the motion in each.
_STEPS, _PIECES = 4, 2
# A peak whose tilt would change the force by this share over its reach is none.
TILTED = 1e-6
# Points about the summit of a stiff model's force, as shares of its reach; the polynomial through them; ever shorter reaches,
# since ripples may lie on a summit; the share of the way to begin and end that it may reach over; and the share of the
# forces' range that a good polynomial leaves.
SUMMIT, _DEGREE, SHORTER = np.cos(np.pi * (np.arange(13) + 0.5) / 13), 8, 0.25 ** np.arange(4)
_AWAY, LEAVES = 0.5, 1e-3
_FITTED = np.linalg.pinv(np.vander(SUMMIT, _DEGREE + 1))


class Marks(NamedTuple):
    """Where M contacts are, of any channels: (M,) channel's number; begin, end and about the peak [s], NaN for none.

    ``reach``: (M,) how far the summit reaches [s], of stiff models.
    """

    channel: Array
    begin: Array
    end: Array
    high: Array
    reach: Array


class Train(NamedTuple):
    """M contacts, or their derivatives by a parameter, per SI unit; NaN where a contact is none, or does not begin or end
    within the run.
    """

    # begin, peak_time, end: (M,) [s].
    begin: Any
    peak_time: Any
    end: Any
    # peak, impulse: (M,) of the normal force's size [N, N s].
    peak: Any
    impulse: Any
    # center, width: (M,) mean and deviation of the time, weighed by the force [s].
    center: Any
    width: Any
    force: Any  # (M, NODES) normal force's size at the phases ``PHASES`` [N]; its derivatives are on the moving clock
    pointwise: Any  # the same numbers, with the derivatives at fixed times
    unsure: Any  # (M,) difference of the impulse to that by half of the points, as a share of it
    bend: Any  # (M,) second derivative of the force at the peak [N/s^2]
    tilt: Any  # (M,) first derivative there [N/s]; not 0 at a peak that is none

    @property
    def duration(self) -> Any:
        """(M,) from begin to end [s]."""
        return self.end - self.begin


def _rule(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Clenshaw and Curtis's points and weights on [0, 1], both ends among them; ``count`` odd."""
    n = count - 1
    angle = np.pi * np.arange(count) / n
    k = np.arange(1, n // 2 + 1)
    factor = np.where(2 * k == n, 1.0, 2.0) / (4.0 * k**2 - 1.0)
    weights = (1.0 - np.cos(2.0 * np.outer(angle, k)) @ factor) * 2.0 / n
    weights[[0, -1]] *= 0.5
    return 0.5 * (1.0 - np.cos(angle)), 0.5 * weights


def _weights(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The rule's weights, and those of the rule on every second point."""
    coarse = np.zeros(count)
    coarse[::2] = _rule(count // 2 + 1)[1]
    return _rule(count)[1], coarse


def _panels(model: AbstractModel) -> int:
    """Panels of ``_PANEL`` points that integrals are taken over, beside the phases: two where a law has a corner at the peak."""
    from bcfj_jax.solve.landing import bending  # With diffrax, which a kept program needs not.

    return 0 if model.traits.stiff or not bending(model) else 2


PHASES = _rule(NODES)[0]


def flat(found: Instants, channels: Array | np.ndarray, numbers: Array | np.ndarray) -> Marks:
    """The contacts of given channels and numbers (M,), counted from 0; beyond what is known there is none."""

    def of(table: Array) -> Array:
        return jnp.asarray(table).at[channels, numbers].get(mode="fill", fill_value=jnp.nan)

    reach = found.begin if found.reach is None else found.reach
    return Marks(jnp.asarray(channels), of(found.begin), of(found.end), of(found.high), of(reach))


def planned(model: AbstractModel, how: Plan, tighter: float = 1.0, error: float = STIFF) -> Plan:
    """How runs are solved whose contacts are followed, at a share of the tolerance; a stiff model's for an ``error`` at most."""
    if not model.traits.stiff:
        return Plan(how.tolerance * tighter, how.max_steps)
    return Plan(jnp.minimum(how.tolerance, model.tolerance(error)) * tighter, how.max_steps)


def instants(model: AbstractModel, params: Params, end: Array, how: Plan, most: int) -> Instants:
    """The first ``most`` contacts of every channel in a run until ``end`` [s] as planned.

    Where ``jacfwd`` goes through a stiff model's run, they are those of the steps that its derivatives take.
    """
    from bcfj_jax.solve import crossings, integrate  # With diffrax, which a kept program needs not.

    # A stiff model's steps depend on whether derivatives go through.
    stiff = model.traits.stiff
    run, given = (crossings.solved, params) if stiff else (integrate.landed, jax.lax.stop_gradient(dict(params)))
    return jax.lax.stop_gradient(run(model, given, end[None], how, most)[-1])


def _run(
    model: AbstractModel, params: Params, times: Array, how: Plan, most: int
) -> tuple[Array, Array, Solution, Instants]:
    """States (T, n) at times of which the last is the run's end, their rates by time, and what was found."""
    from bcfj_jax.solve import crossings, integrate

    if model.traits.stiff:
        solution, rates, found = crossings.solved(model, params, times, how, most)
        return solution.states, rates, solution, found

    def run(times: Array) -> tuple[Array, tuple]:
        solution, found = integrate.landed(model, params, times, how, most)
        return solution.states, (solution, found)

    # The steps move with the parameters, and what is read between them is the solver's polynomial: its own rate belongs to it,
    # since a clock may move by a thousand contacts.
    ticking = jnp.ones_like(times).at[-1].set(0.0)
    states, rates, (solution, found) = jax.jvp(run, (times,), (ticking,), has_aux=True)
    return states, rates, solution, found


def train(
    model: AbstractModel, params: Params, marks: Marks, end: Array, how: Plan, most: int = 1
) -> tuple[Train, Solution, Instants]:
    """The contacts at their marks, which a run until ``end`` [s] as planned has found (``instants``), and what it finds.

    ``jvp`` and ``jacfwd`` go through ``params``; a mark only says where to look.
    """
    marks = Marks(marks.channel, *map(jax.lax.stop_gradient, marks[1:]))
    there = jnp.isfinite(marks.high)
    start = jnp.where(jnp.isfinite(marks.begin), marks.begin, 0.0)
    stop = jnp.where(jnp.isfinite(marks.end), marks.end, end)
    count = 1 + (NODES - 1) * (_FINER if model.traits.stiff else 1)
    grid = start[:, None] + (stop - start)[:, None] * _rule(count)[0]
    high = jnp.where(there, marks.high, end)
    reach, about = jnp.zeros_like(high), np.zeros(1)
    if model.traits.stiff:
        reach = jnp.minimum(marks.reach, _AWAY * jnp.minimum(high - start, stop - high))
        about = np.outer(SHORTER, SUMMIT).ravel()
    summit = high[:, None] + jnp.nan_to_num(reach)[:, None] * about
    if panels := _panels(model):
        # A law with a corner at the peak: the integrals go up to it and on from it.
        share = _rule(_PANEL)[0]
        parts = [left[:, None] + (right - left)[:, None] * share for left, right in ((start, high), (high, stop))]
        grid = jnp.concatenate([grid, *parts], axis=1)
    times = jnp.clip(jnp.concatenate([jnp.where(there[:, None], grid, end), summit], axis=1), 0.0, end)
    order = jnp.argsort(times.ravel())
    ordered, back = jnp.append(times.ravel()[order], end), jnp.argsort(order)
    states, rates, solution, found = _run(model, params, ordered, how, most)
    states, rates = (x[:-1][back].reshape(*times.shape, -1) for x in (states, rates))
    prepared = model.prepare(params)

    def one(mark: Marks, times: Array, states: Array, rates: Array, reach: Array) -> Train:
        return _Followed(model, prepared, mark, times, states, rates[: count + panels * _PANEL], reach).train()

    each = jax.vmap(one)(marks, times, states, rates, reach)
    begun, ended = jnp.isfinite(marks.begin), jnp.isfinite(marks.end)
    whole, nan = there & begun & ended, jnp.nan
    known = Train(
        begun, there, ended, there, whole, whole, whole, whole[:, None], whole[:, None], whole, there, there,
    )  # fmt: skip
    return Train(*(jnp.where(k, x, nan) for k, x in zip(known, each, strict=True))), solution, found


@dataclass(frozen=True, eq=False)
class _Followed:
    """One contact from its states at N times and about its peak (N + ..., n), and the rates (N, n) of the first.

    The first times are the phases'; those of the panels follow, where there are any (``_panels``).
    """

    model: AbstractModel
    prepared: Params
    mark: Marks
    times: Array
    states: Array
    rates: Array
    reach: Array

    def read(self, t: Array, y: Array) -> tuple[Array, Array, Array]:
        """Penetration, its rate and the force's size."""
        from bcfj_jax.solve.landing import look

        seen, at = look(self.model, t, y, self.prepared), self.mark.channel
        return seen.depth[at], seen.rate[at], jnp.abs(seen.force[at])

    def force(self, times: Array, states: Array) -> Array:
        """Its size at times (T,) in states (T, n)."""
        return jax.vmap(lambda t, y: self.read(t, y)[2])(times, states)

    def field(self, t: Array, y: Array) -> Array:
        """The model's."""
        return self.model.vector_field(t, y, self.prepared)

    def along(self, function: Callable[[Array, Array], Any], t: Array, y: Array) -> tuple[Any, Any]:
        """A function of time and state, and its derivative along the motion."""
        return jax.jvp(function, (t, y), (jnp.ones_like(t), self.field(t, y)))

    def crossed(self, k: int, mark: Array) -> Array:
        """How much later [s] than the k-th time the surfaces meet; 0 where the mark says that they do not."""
        depth, rate, _ = self.read(self.times[k], self.states[k])
        rate = jax.lax.stop_gradient(rate)
        # A surface that is touched without speed moves by anything.
        return jnp.where(jnp.isfinite(mark), -depth / jnp.where(rate == 0, jnp.nan, rate), 0.0)

    def summit(self, nodes: int, length: Array) -> tuple[Array, Array, Array, Array]:
        """When the force is greatest [s], how great, its bend and slope there; ``length``: of the contact [s]."""
        fixed = jax.lax.stop_gradient
        if self.model.traits.stiff:
            forces = self.force(self.times[nodes:], self.states[nodes:])
            return summit_of(forces.reshape(SHORTER.size, -1), self.mark.high, self.reach)[:4]

        @jax.jit  # Traced once for both of its places.
        def bent(t: Array, y: Array) -> tuple[Array, Array]:
            """First and second derivative of the force by time."""
            return self.along(lambda t, y: self.along(lambda t, y: self.read(t, y)[2], t, y)[1], t, y)

        at, near = self.times[nodes], self.states[nodes]
        shift = fixed(_to_peak(bent, self.field, at, fixed(near), fixed(length)))
        top = ahead(self.field, at, near, shift)
        slope, curve = bent(at + shift, top)
        curve = fixed(curve)
        later = at + shift - slope / jnp.where(curve == 0, jnp.nan, curve)
        return later, self.read(at + shift, top)[2], curve, slope

    def train(self) -> Train:
        """What is told of the contact."""
        fixed, panels, nodes = jax.lax.stop_gradient, _panels(self.model), self.rates.shape[0]
        count, states = nodes - panels * _PANEL, self.states[:nodes]
        first, last = self.crossed(0, self.mark.begin), self.crossed(count - 1, self.mark.end)
        shifts, grid = first + (last - first) * _rule(count)[0], self.times[:nodes]
        length = grid[count - 1] + last - (grid[0] + first)
        rules, lengths = [_weights(count)], [length]
        if panels:
            # The corner is where the penetration turns.
            share, middle = _rule(_PANEL)[0], count + _PANEL
            slow, change = self.along(lambda t, y: self.read(t, y)[1], grid[middle], states[middle])
            turn = -slow / jnp.where(change == 0, jnp.inf, fixed(change))
            rise, fall = first + (turn - first) * share, turn + (last - turn) * share
            lengths = [grid[middle] + turn - grid[0] - first, grid[count - 1] + last - grid[middle] - turn]
            shifts, rules = jnp.concatenate([shifts, rise, fall]), [_weights(_PANEL)] * 2
        # Shifts are rounding; the rate's own derivative is not known in the shortest steps.
        force = self.force(grid + shifts, states + shifts[:, None] * fixed(self.rates))
        clock = grid - fixed(grid[0]) + shifts
        inner = slice(count, None) if panels else slice(None)
        fine, coarse = (jnp.concatenate(list(map(jnp.multiply, part, lengths))) for part in zip(*rules, strict=True))
        impulse, rough = jnp.sum(fine * force[inner]), jnp.sum(coarse * force[inner])
        share = fine * force[inner] / impulse
        center = jnp.sum(share * clock[inner])
        width = jnp.sqrt(jnp.sum(share * jnp.square(clock[inner] - center)))
        shown = slice(None, count, (count - 1) // (NODES - 1))
        still = self.force(grid[shown], states[shown])
        later, peak, curve, slope = self.summit(nodes, length)
        unsure = jnp.abs(impulse - rough) / jnp.where(impulse == 0, jnp.nan, jnp.abs(impulse))
        return Train(
            grid[0] + first, later, grid[count - 1] + last, peak, impulse, grid[0] + center, width, force[shown], still,
            unsure, curve, slope,
        )  # fmt: skip


def summit_of(forces: Array, high: Array, reach: Array) -> tuple[Array, Array, Array, Array, Array]:
    """When the polynomial through forces at ``SUMMIT`` is greatest [s], how great, its bend and slope there, what it leaves.

    Of forces (R, N) at ever shorter reaches those of the longest that a polynomial describes.
    """
    fixed = jax.lax.stop_gradient
    left = jnp.max(jnp.abs(forces - forces @ _FITTED.T @ np.vander(SUMMIT, _DEGREE + 1).T), axis=1)
    left = left / jnp.maximum(jnp.ptp(forces, axis=1), 1e-300)
    k = fixed(jnp.where(jnp.any(left < LEAVES), jnp.argmax(left < LEAVES), jnp.argmin(left)))
    terms = _FITTED @ forces[k]
    reach = jnp.where(reach > 0, reach * jnp.asarray(SHORTER)[k], jnp.nan)
    steep = jnp.polyder(terms)
    bend, slope = fixed(jnp.polyder(steep)), fixed(steep)

    def closer(_: int, x: Array) -> Array:
        second = jnp.polyval(bend, x)
        step = jnp.where(second < 0, -jnp.polyval(slope, x) / jnp.where(second < 0, second, -1.0), 0.0)
        return jnp.clip(x + step, -1.0, 1.0)

    x = jax.lax.fori_loop(0, _STEPS, closer, jnp.zeros(()))
    first, second = jnp.polyval(steep, x), jnp.polyval(bend, x)
    later = high + reach * (x - first / jnp.where(second == 0, jnp.nan, second))
    return later, jnp.polyval(terms, x), second / reach**2, first / reach, left[k]


def _to_peak(bent, field, at: Array, near: Array, length: Array) -> Array:
    """From a time near it to where the force's rate is 0 [s], by Newton's method, no further than a part of the contact."""
    limit = 0.25 * length

    def closer(_: int, shift: Array) -> Array:
        y = ahead(field, at, near, shift)
        first, second = bent(at + shift, y)
        # Where the force bends upward, up the slope.
        step = jnp.where(second < 0, -first / jnp.where(second < 0, second, -1.0), jnp.sign(first) * 0.25 * limit)
        return jnp.clip(shift + step, -limit, limit)

    return jax.lax.fori_loop(0, _STEPS, closer, jnp.zeros_like(at))


def ahead(field, t: Array, y: Array, shift: Array) -> Array:
    """The state a little later [s], by Runge and Kutta's method of order 4."""
    h = shift / _PIECES
    # A loop over the stages has a quarter as much to compile as four written out.
    nodes, weights = np.array([0.0, 0.5, 0.5, 1.0]), np.array([1.0, 2.0, 2.0, 1.0]) / 6.0

    def piece(k: int, y: Array) -> Array:
        def stage(carry: tuple[Array, Array], row: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
            (slope, total), (node, weight) = carry, row
            slope = field(t + (k + node) * h, y + node * h * slope)
            return (slope, total + weight * slope), None

        none = jnp.zeros_like(y)
        return y + h * jax.lax.scan(stage, (none, none), (jnp.asarray(nodes), jnp.asarray(weights)))[0][1]

    return jax.lax.fori_loop(0, _PIECES, piece, y)


def of_curve(model: AbstractModel, params: Params, whole: Continuous, first: Array, last: Array) -> Array:
    """``crests.Curve`` of every channel (C, 4) between two times [s]: integrals of a run, and summits of its force.

    A summit is sought over the two steps of the solver about the greatest force at a step's end, as in ``crests``; NaN where
    the force is not smooth there, of the other sign, or beyond a time.
    """
    from bcfj_jax.solve.landing import bending, look  # With diffrax, which a kept program does not need.

    prepared, fixed, corners = model.prepare(params), jax.lax.stop_gradient, bending(model)

    def field(t: Array, y: Array) -> Array:
        return model.vector_field(t, y, prepared)

    def one(sign: Array, channel: Array, t: Array, y: Array, before: Array, after: Array) -> Array:
        # Neither of the two steps crosses a surface; the top's derivative is that at fixed times.
        middle, reach = fixed(t) + 0.5 * (after - before), 0.5 * (after + before)
        times = middle + reach * np.outer(SHORTER, SUMMIT).ravel()
        states = jax.vmap(lambda at: ahead(field, t, y, at - t))(times)
        forces = jax.vmap(lambda t, y: look(model, t, y, prepared).force[channel])(times, states)
        later, value, curve, slope, left = summit_of(sign * forces.reshape(SHORTER.size, -1), middle, reach)
        good = (curve < 0) & (jnp.abs(slope) * reach <= TILTED * value) & (left < LEAVES)
        if corners:
            # The step ends at the corner, where the force is greatest.
            force = lambda t, y: sign * look(model, t, y, prepared).force[channel]  # noqa: E731
            size, slope = jax.jvp(force, (t, y), (jnp.ones_like(t), field(t, y)))
            there = jnp.isin(channel, jnp.asarray(corners))
            later, value = jnp.where(there, t, later), jnp.where(there, size, value)
            good = jnp.where(there, jnp.abs(slope) * reach <= TILTED * size, good)
        return jnp.where(fixed(good & (later >= first) & (later <= last)), sign * value, jnp.nan)

    every = jax.vmap(jax.vmap(one, (None, 0, 0, 0, 0, 0)), (0, None, 0, 0, 0, 0))
    peak, least = every(jnp.array([1.0, -1.0]), jnp.arange(whole.impulse.size), *whole[:4])
    return jnp.stack(Curve(peak, whole.impulse, whole.work, least), axis=1)
