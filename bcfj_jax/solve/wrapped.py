"""A solver around another one, and a step control around another one."""

from __future__ import annotations

import diffrax as dfx
import equinox as eqx


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
