"""Solvers by name, for who wants another than ``integrate`` takes by itself; measured by ``bcfj tradeoff``."""

from __future__ import annotations

from collections.abc import Callable

import diffrax as dfx

from bcfj_jax.core.errors import InputError, nearest

# For scenes of a few springs: explicit ones by their order, and one implicit.
SPRINGS: dict[str, Callable[[], dfx.AbstractAdaptiveSolver]] = {
    "tsit5": dfx.Tsit5,
    "bosh3": dfx.Bosh3,
    "dopri5": dfx.Dopri5,
    "dopri8": dfx.Dopri8,
    "kvaerno5": dfx.Kvaerno5,
}
# For the joint, all on its arrowhead: a Rosenbrock method, an SDIRK one and a multistep one.
ARROWHEAD = ("rodas3", "sdirk2", "bdf")
# Those whose own derivatives are unbounded.
VALUES_ONLY = ("rodas3",)


def check(solver: str | None, joint: bool, where: str = "") -> None:
    """Whether a joint, or else a scene of springs, can be solved by it; None is always right.

    Raises:
        InputError: for one that is not known, or cannot, with the nearest that can.
    """
    known = ARROWHEAD if joint else tuple(SPRINGS)
    if solver is not None and solver not in known:
        raise InputError(f"{where}solver", f"no solver '{solver}' for this kind of scene", nearest(solver, known))
