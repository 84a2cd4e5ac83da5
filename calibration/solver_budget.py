"""How a scene's runs are spent on the way to an optimum: those of a mass that bounces, and the joint's.

A bounce costs in proportion to the lanes of a batch and its cost is smooth. A joint's run takes a good part of a
second, its program minutes to compile, and its integration makes the cost rough.
"""

from __future__ import annotations

from typing import NamedTuple

from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.models.joint.scene import Joint


class Effort(NamedTuple):
    """What the search and its judge may spend on runs of one kind of scene.

    Attributes:
        accuracy: force error of runs, where the problem says nothing.
        loose: the same on the way to an optimum.
        steps: attempted steps of a run until it has failed.
        tighter: so many times as tight is the run that tells the integrator's error.
        rough: whether that error is what the cost's last digits are made of, so that its slopes must tell, and no
            profile is drawn unless it is asked for.
        apart: whether points are run one by one, as many at a time as there are cores; else a batch in one program.
            Contacts of such a scene come when its drive brings them: starts need no first-order descent to meet them.
        asked: points of the design that are asked what all data tell of a coordinate.
        kept: starts that are not given up, however far off.
        descend: steps of a batched descent on one leg.
        roughly, tolerance: what that may leave to gain, in units of cost / residuals, on the way and at the end. The
            judge distinguishes 0.1; of a rough cost no more can be had, and the trust region goes on anyway.
        step, gain: of the trust region, the shortest step and the least gain as a share of the cost.
        elsewhere: unit-box distance of ends that are not one.
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


# Errors a tenth of the finest that a record is taken to be known to (``integration``); loosely as fine as that.
_MASS = Effort(
    accuracy=1e-6, loose=1e-5, steps=20_000, tighter=100.0, rough=False, apart=False, asked=64, kept=6,
    descend=40, roughly=1.0, tolerance=1e-2, step=1e-8, gain=1e-9, elsewhere=1e-3,
)  # fmt: skip
# It takes some thousand steps a revolution, and its error goes with the tolerance as their number does.
_JOINT = Effort(
    accuracy=1e-3, loose="balanced", steps=8_000, tighter=4.0, rough=True, apart=True, asked=4, kept=4,
    descend=12, roughly=10.0, tolerance=1.0, step=1e-4, gain=1e-6, elsewhere=1e-2,
)  # fmt: skip


def effort(scene: AbstractModel) -> Effort:
    """What a scene's runs are worth."""
    if not isinstance(scene, Joint):
        return _MASS
    # Without inertia it is solved, not integrated: as exact as may be.
    return _JOINT if scene.fidelity == "dynamic" else _JOINT._replace(accuracy=_MASS.accuracy, rough=False)
