"""A solver around another one, such as one that looks at every contact in each step; a step control around another one."""

from __future__ import annotations

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp

from bcfj_jax.solve.extremes import added, after, begun, look, opened

# Where a step is looked at, as shares of it.
_LOOKS = (0.5, 1.0)


class AbstractWrapped(dfx.AbstractAdaptiveSolver):
    """What a solver that wraps another one takes over from it: all but its memory and its steps."""

    solver: dfx.AbstractAdaptiveSolver

    @property
    def term_structure(self):
        """The solver's."""
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        """The solver's."""
        return self.solver.interpolation_cls

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)


class AbstractControl(dfx.AbstractStepSizeController):
    """What a step control that has another one inside takes over from it."""

    inner: dfx.AbstractStepSizeController

    def wrap(self, direction):
        """Forwards only."""
        return eqx.tree_at(lambda control: control.inner, self, self.inner.wrap(direction))


class Watched(AbstractWrapped):
    """A solver whose memory holds ``Extremes`` of the contacts and ``Totals`` of the accounts, at accepted steps alone.

    The arguments of its field are (model, what it has prepared).
    """

    def init(self, terms, t0, t1, y0, args):
        seen = look(t0, y0, args)
        return self.solver.init(terms, t0, t1, y0, args), seen, (begun(t0, seen[0]), opened(t0, seen[1]))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """The solver's step, and what was seen in it."""
        memory, before, (contacts, accounts) = solver_state
        y1, error, dense, memory, result = self.solver.step(terms, t0, t1, y0, args, memory, made_jump)
        between = self.interpolation_cls(t0=t0, t1=t1, **dense)
        times = t0 + (t1 - t0) * jnp.asarray(_LOOKS)
        states = jnp.stack([between.evaluate(times[0]), y1])
        seen = jax.vmap(lambda t, y: look(t, y, args))(times, states)
        middle, end = (jax.tree.map(lambda x, i=i: x[i], seen) for i in (0, 1))
        contacts = after(contacts, t0, t1, before[0], middle[0], end[0])
        accounts = added(accounts, t0, t1, before[1], middle[1], end[1])
        return y1, error, dense, (memory, end, (contacts, accounts)), result
