"""What runs are worth on the way to an optimum: of a small or large scene, smooth or rough, of few unknowns or many."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from bcfj_jax.mechanism.model import AbstractModel

# Unknowns from which on they are many: an evaluation takes all records, with a tangent for each unknown of a record.
_MANY = 64


class Sought(Protocol):
    """What is searched for in which scene: a problem, or its model."""

    @property
    def scene(self) -> AbstractModel:
        """The scene."""
        ...

    @property
    def unknowns(self) -> int:
        """Numbers that are searched."""
        ...


class SolverBudget(NamedTuple):
    """What the search and its tests may spend on runs of one kind of problem."""

    accuracy: float  # force error of runs, where the problem says nothing
    loose: float | str  # on the way to an optimum
    steps: int  # attempted steps of a run until it has failed
    tighter: float  # so many times as tight is the run that gives the integrator's error
    # Whether that error is what the cost's last digits are made of: slopes decide, and no profile is drawn unasked.
    rough: bool
    apart: bool  # whether as many points are run at a time as there are cores; else one after the other
    drawn: int  # points of the design for each start
    asked: int  # points of the design at which the influence of a coordinate on all data is computed
    kept: int  # starts that are not given up, however far off
    descend: int  # steps of a batched descent on one leg
    # roughly, tolerance: what that may leave to gain, in units of cost / residuals, on the way and at the end.
    roughly: float
    tolerance: float
    # step, gain: of the trust region, the shortest step and the least gain as a share of the cost.
    step: float
    gain: float
    elsewhere: float  # unit-box distance of ends that are not one
    rotations: int  # cubature rules over which a rough scene's Jacobian is averaged
    bends: bool = True  # whether the cost is looked at along every unknown; else along those that all records share


# Simulate ten times finer than the assumed noise of a record (``forward.integration``); use that itself during the search.
_SMOOTH = SolverBudget(
    accuracy=1e-6, loose=1e-5, steps=20_000, tighter=100.0, rough=False, apart=False, drawn=8, asked=64, kept=6,
    descend=40, roughly=1.0, tolerance=1e-2, step=1e-8, gain=1e-9, elsewhere=1e-3, rotations=16,
)  # fmt: skip
# A joint takes some thousand steps a revolution, and its error goes with the tolerance as their number does.
_LARGE = SolverBudget(
    accuracy=1e-3, loose="balanced", steps=8_000, tighter=4.0, rough=True, apart=True, drawn=8, asked=4, kept=4,
    descend=12, roughly=10.0, tolerance=1.0, step=1e-4, gain=1e-6, elsewhere=1e-2, rotations=1,
)  # fmt: skip


# Many records with unknowns of their own, as tosses with their first states: an evaluation takes a second or more.
_MANY_OWN = _SMOOTH._replace(
    accuracy=1e-4, loose=1e-3, apart=True, drawn=2, asked=4, kept=4, descend=12, tolerance=0.1, step=1e-5, gain=1e-4,
    elsewhere=1e-2, bends=False,
)  # fmt: skip


def budget(sought: Sought) -> SolverBudget:
    """What a problem's runs are worth."""
    traits = sought.scene.traits
    if not (traits.large or traits.rough):
        return _MANY_OWN if sought.unknowns > _MANY else _SMOOTH
    # Without roughness runs are as exact as may be: a large model is then solved, not integrated.
    found = _LARGE if traits.rough else _LARGE._replace(accuracy=_SMOOTH.accuracy, rough=False)
    if traits.large:
        return found
    small = ("steps", "apart", "asked", "kept", "descend", "rotations")
    return found._replace(**{name: getattr(_SMOOTH, name) for name in small})
