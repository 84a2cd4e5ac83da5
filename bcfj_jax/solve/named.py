"""Solvers by name, for who wants another than ``integrate`` takes by itself; measured by ``bcfj tradeoff``."""

from __future__ import annotations

from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.mechanism.model import IMPLICIT_SOLVERS

# For models that are not stiff, with diffrax's names: explicit ones by their order, and one implicit.
NOT_STIFF = {"tsit5": "Tsit5", "bosh3": "Bosh3", "dopri5": "Dopri5", "dopri8": "Dopri8", "kvaerno5": "Kvaerno5"}
# For stiff models, all on the model's own structure: a Rosenbrock method, an SDIRK one and a multistep one.
STIFF = IMPLICIT_SOLVERS
# Those whose own derivatives are unbounded.
VALUES_ONLY = ("rodas3",)


def known(stiff: bool) -> tuple[str, ...]:
    """Solvers for models that are stiff or are not; the first is the one taken where none is named."""
    return STIFF if stiff else tuple(NOT_STIFF)


def check(solver: str | None, stiff: bool, where: str = "") -> None:
    """Refuse a solver that cannot solve a stiff model, or one that is not, with the nearest that can; None is always right."""
    names = known(stiff)
    if solver is not None and solver not in names:
        raise InputError(f"{where}solver", f"no solver '{solver}' for this kind of scene", nearest(solver, names))
