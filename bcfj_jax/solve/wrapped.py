"""A solver around another one."""

from __future__ import annotations

import diffrax as dfx


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
        """The solver's."""
        return self.solver.order(terms)

    def error_order(self, terms):
        """The solver's."""
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        """The solver's."""
        return self.solver.func(terms, t0, y0, args)
