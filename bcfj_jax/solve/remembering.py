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

from bcfj_jax.mechanism.model import AbstractModel, Approaches
from bcfj_jax.solve.wrapped import AbstractWrapped
from bcfj_jax.xla import batched_jvp

# Newton steps to a touch within a step.
_NEWTON = 6

# The clock's rounding, relative; beside it the tolerated distance counts.
ROUNDING = 5e-15


def close(near: Any, t: Any, rate: Array) -> Array:
    """Distance from a surface within which a step ends on it [m]: no nearer than the clock's rounding lets a step end."""
    return jax.lax.stop_gradient(jnp.maximum(near, ROUNDING * jnp.abs(t * rate)))


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
    """Approach speeds in runs by BDF: states ``places`` that a touch within a step sets, and that do not change until the next.

    After it they have no differences. The arguments of the field are (model, what it has prepared).
    """

    places: tuple[int, ...] = eqx.field(static=True)

    def before(self, t: Array, y: Array, args: Any) -> Array:
        """Of each place, whether its surfaces are apart (k,), in the state (n,)."""
        model, prepared = args
        return model.approaches(t, y, prepared).depth < 0.0

    def set(self, end: Array, length: Array, read: Callable[[Array], Array], args: Any, changes: Any) -> Array:
        """What each place is (1 + k, m) after a touch in the step that ended at ``end`` [s]: its value, and its tangents.

        Speeds are those at the roots of the penetrations, whose shift is dt = -(dd/dp)/(dd/dt). ``read`` gives rows (1 + k, n)
        at a time within the step, at fixed times.
        """
        model = args[0]

        def seen(t: Array, y: Array, args: Any) -> Approaches:
            return model.approaches(t, y, args[1])

        def at(k: Array) -> Array:
            def moving(t: Array) -> tuple[Approaches, Approaches]:
                return jax.jvp(lambda t: seen(t, read(t)[0], args), (t,), (jnp.ones_like(t),))

            def closer(_: int, t: Array) -> Array:
                now, change = moving(t)
                return jnp.clip(
                    t - now.depth[k] / jnp.where(change.depth[k] > 0, change.depth[k], jnp.inf), end - length, end
                )

            touch = jax.lax.fori_loop(0, _NEWTON, closer, end - 0.5 * length)
            rows, (now, change) = read(touch), moving(touch)
            if rows.shape[0] == 1:
                return now.speed[k][None]
            function = lambda x: seen(touch, *x)  # noqa: E731
            _, by = batched_jvp.along(function, (rows[0], args), (rows[1:], changes))
            shift = -by.depth[:, k] / jnp.where(change.depth[k] > 0, change.depth[k], jnp.inf)
            return jnp.concatenate([now.speed[k][None], by.speed[:, k] + change.speed[k] * shift])

        return jax.vmap(at, out_axes=1)(jnp.arange(len(self.places)))


def at_touch(model: AbstractModel) -> AtTouch | None:
    """What a model's contacts remember of their approaches; None for nothing."""
    return AtTouch(model.remembered) if model.remembered else None
