"""Remembered approach speeds are set at the touch, exactly and with their derivatives, where derivatives are taken.

A contact whose law is stated by restitution remembers the speed of its approach. In a plain run the memory relaxes towards
that speed as the gap closes (``mechanism.contacts.Approach``): its value is right within the tolerance, but its rate there,
which the acceleration is, is below the tolerance, so that the derivative of the memory misses the acceleration times the
shift of the touch. In a run whose steps end on contacts (``solve.landing``) nothing needs to relax: the step that begins at
a touch has the speed of its own start as memory, a function of time and state that carries the derivatives of both. BDF's
steps pass over a touch: after such a step the memory and its tangents are set to what they are at the root of the step's
polynomial (``AtTouch``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.landing import close, felt, jumping
from bcfj_jax.solve.wrapped import AbstractWrapped
from bcfj_jax.xla import batched_jvp

# Newton steps to a touch within a step; states on either side are apart by this share of the step, or of the time until then.
_NEWTON, _ASIDE, _LATER = 6, 1e-6, 1e-12


def constant(field: Callable, places: tuple[int, ...]) -> Callable:
    """A field in which some states do not change between touches."""
    return lambda t, y, args: field(t, y, args).at[jnp.asarray(places)].set(0.0)


class Remembering(AbstractWrapped):
    """A solver that sets approach speeds in the state where a step begins at a touch.

    The arguments of its field are (model, what it has prepared). Its memory holds which of the surfaces were apart.
    ``size`` is the number of states that the model reads; others may stand behind them.
    """

    near: Array
    size: int = eqx.field(static=True)

    def _apart(self, t: Any, y: Array, args: tuple[AbstractModel, Any]) -> tuple[Array, Array]:
        """Which surfaces are apart (k,), and what is remembered of those that are not [m/s]."""
        model, prepared = args
        seen = model.approaches(t, y[: self.size], prepared)
        return seen.depth < -close(self.near, t, seen.rate), seen.speed

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args), self._apart(t0, y0, args)[0]

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """The solver's step, from a start that remembers how its touches came about."""
        memory, before = solver_state
        apart, speed = self._apart(t0, y0, args)
        touched, places = before & ~apart, jnp.asarray(args[0].remembered)
        y0 = y0.at[places].set(jnp.where(touched, speed, y0[places]))
        # The slope that the solver keeps from the last step is of the old memory.
        made_jump = made_jump | jnp.any(touched)
        y1, error, dense, memory, result = self.solver.step(terms, t0, t1, y0, args, memory, made_jump)
        return y1, error, dense, (memory, apart), result


class AtTouch(eqx.Module):
    """What touches within a step do to runs by BDF: they set approach speeds, and forces that begin with a jump move tangents.

    ``places`` are the states that are approach speeds, which do not change until the next touch and have no differences.
    ``jumps`` are channels of ``landing.felt``. Where the field jumps from f- to f+ at a time t, the tangents gain

        (f- - f+) dt,    dt = -(dd/dp)/(dd/dt),

    d being the penetration (Galan, Feehery and Barton, Appl. Numer. Math. 31 (1999) 17): no matrix of a step has that. The
    arguments of the field are (model, what it has prepared).
    """

    places: tuple[int, ...] = eqx.field(static=True)
    jumps: tuple[int, ...] = eqx.field(static=True)

    def _seen(self, t: Array, y: Array, args: Any) -> tuple[Array, Array]:
        """Of each place and each jump the penetration, and of each place its speed; in the state (n,)."""
        model, prepared = args
        depth = speed = jnp.zeros(0)
        if self.places:
            depth, _, speed = model.approaches(t, y, prepared)
        if self.jumps:
            depth = jnp.append(depth, felt(model, t, y, prepared).depth[jnp.asarray(self.jumps)])
        return depth, speed

    def before(self, t: Array, y: Array, args: Any) -> Array:
        """Of each place and each jump, whether its surfaces are apart, in the state (n,)."""
        return self._seen(t, y, args)[0] < 0.0

    def after(self, d: Array, turned: Array, step: tuple[Array, Array], read: Callable, posed: tuple) -> Array:
        """Differences (rows, 1 + k, n) after a ``step``, told by its end and length [s], in which surfaces met, or parted.

        ``turned``: 1 where they met, -1 where they parted, else 0. ``read`` gives rows (1 + k, n) at a time within the step, at
        fixed times; ``posed`` is (field, args, changes).
        """
        (end, length), (field, args, changes), count = step, posed, len(self.places)

        def at(k: Array) -> tuple[Array, Array]:
            def moving(t: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
                return jax.jvp(lambda t: self._seen(t, read(t)[0], args), (t,), (jnp.ones_like(t),))

            def steep(change: Array) -> Array:
                return jnp.where(change[k] * turned[k] > 0, change[k], jnp.inf)

            def closer(_: int, t: Array) -> Array:
                now, change = moving(t)
                return jnp.clip(t - now[0][k] / steep(change[0]), end - length, end)

            touch = jax.lax.fori_loop(0, _NEWTON, closer, end - 0.5 * length)
            rows, ((_, speed), (change, faster)) = read(touch), moving(touch)
            by, more = jnp.zeros((2, rows.shape[0] - 1, 0))
            if rows.shape[0] > 1:
                function = lambda x: self._seen(touch, *x)  # noqa: E731
                _, (by, more) = batched_jvp.along(function, (rows[0], args), (rows[1:], changes))
                by = -by[:, k] / steep(change)
            own = jnp.minimum(k, count - 1)
            speeds = jnp.append(speed[own], more[:, own] + faster[own] * by) if count else jnp.zeros(rows.shape[0])
            gained = jnp.zeros(rows.shape[1])
            if self.jumps:
                along = jax.jvp(lambda t: read(t)[0], (touch,), (jnp.ones_like(touch),))[1]
                aside = jnp.maximum(_ASIDE * length, _LATER * touch) * along
                gained = field(touch, rows[0] - aside, args) - field(touch, rows[0] + aside, args)
            return speeds, jnp.zeros_like(rows).at[1:].set(jnp.reshape(by, (-1, 1)) * gained)

        speeds, gained = jax.vmap(at)(jnp.arange(turned.size))
        if self.jumps:
            d = d.at[0].add(jnp.sum(jnp.where(turned[count:, None, None] != 0, gained[count:], 0.0), axis=0))
        if count:
            at_ = jnp.asarray(self.places)
            fresh = jnp.zeros((d.shape[0], *speeds[:count].T.shape)).at[0].set(speeds[:count].T)
            d = d.at[:, :, at_].set(jnp.where(turned[:count] > 0, fresh, d[:, :, at_]))
        return d


def at_touch(model: AbstractModel) -> AtTouch | None:
    """What touches do to a model's runs by BDF; None for nothing."""
    places, jumps = model.remembered, jumping(model)
    return AtTouch(places, jumps) if places or jumps else None
