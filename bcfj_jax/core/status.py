"""How a run can end: a code, and what it says in words."""

from __future__ import annotations

OK, STEPS, NOT_FINITE, SOLVER, UNBALANCED, STEEP, NO_FORCE = range(7)
_REASONS = {
    STEPS: "the step budget of {max_steps} steps was spent",
    NOT_FINITE: "the state stopped being finite",
    SOLVER: "the solver could not go on: forces that are not finite, or that jump",
    UNBALANCED: "no equilibrium was found",
    STEEP: "the derivatives stopped being finite",
    NO_FORCE: "a contact force stopped being finite",
}


def reason(code: int, max_steps: int) -> str:
    """A failure code in words; empty when there is none."""
    return _REASONS.get(int(code), "").format(max_steps=max_steps)
