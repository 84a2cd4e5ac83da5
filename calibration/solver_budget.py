"""What a scene's runs are worth on the way to an optimum, by its traits: small or large, smooth or rough."""

from __future__ import annotations

from typing import NamedTuple

from bcfj_jax.mechanism.model import AbstractModel


class SolverBudget(NamedTuple):
    """What the search and its tests may spend on runs of one kind of scene.

    Attributes:
        accuracy: force error of runs, where the problem says nothing; loose: on the way to an optimum.
        steps: attempted steps of a run until it has failed.
        tighter: so many times as tight is the run that gives the integrator's error.
        rough: whether that error is what the cost's last digits are made of: slopes decide, and no profile is drawn unasked.
        apart: whether as many points are run at a time as there are cores; else one after the other.
        asked: points of the design at which the influence of a coordinate on all data is computed.
        kept: starts that are not given up, however far off.
        descend: steps of a batched descent on one leg.
        roughly, tolerance: what that may leave to gain, in units of cost / residuals, on the way and at the end.
        step, gain: of the trust region, the shortest step and the least gain as a share of the cost.
        elsewhere: unit-box distance of ends that are not one.
        rotations: cubature rules over which a rough scene's Jacobian is averaged.
    """

    accuracy: float
    loose: float | str
    steps: int
    tighter: float
    rough: bool
    apart: bool
    asked: int
    kept: int
    descend: int
    roughly: float
    tolerance: float
    step: float
    gain: float
    elsewhere: float
    rotations: int


# Simulate ten times finer than the assumed noise of a record (``forward.integration``); use that itself during the search.
_SMOOTH = SolverBudget(
    accuracy=1e-6, loose=1e-5, steps=20_000, tighter=100.0, rough=False, apart=False, asked=64, kept=6,
    descend=40, roughly=1.0, tolerance=1e-2, step=1e-8, gain=1e-9, elsewhere=1e-3, rotations=16,
)  # fmt: skip
# A joint takes some thousand steps a revolution, and its error goes with the tolerance as their number does.
_LARGE = SolverBudget(
    accuracy=1e-3, loose="balanced", steps=8_000, tighter=4.0, rough=True, apart=True, asked=4, kept=4,
    descend=12, roughly=10.0, tolerance=1.0, step=1e-4, gain=1e-6, elsewhere=1e-2, rotations=1,
)  # fmt: skip


def budget(scene: AbstractModel) -> SolverBudget:
    """What a scene's runs are worth."""
    traits = scene.traits
    if not (traits.large or traits.rough):
        return _SMOOTH
    # Without roughness runs are as exact as may be: a large model is then solved, not integrated.
    found = _LARGE if traits.rough else _LARGE._replace(accuracy=_SMOOTH.accuracy, rough=False)
    if traits.large:
        return found
    small = ("steps", "apart", "asked", "kept", "descend", "rotations")
    return found._replace(**{name: getattr(_SMOOTH, name) for name in small})
