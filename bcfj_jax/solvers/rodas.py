"""RODAS: a stiffly accurate, L-stable Rosenbrock method of order 4 with an embedded one of order 3.

Hairer and Wanner, Solving Ordinary Differential Equations II, section VI.4 (rodas.f, method 1). One Jacobian and
one factorisation a step, six fields and solves, no iteration: in a batch no lane waits for another's Newton.
For values only: differentiated, it carries the Jacobian's own derivative and its tangents are unbounded at
loose tolerance; derivatives go through ``solvers.sdirk``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.solvers.structure import AbstractStructure

GAMMA = 0.25
TIMES = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
TIME_WEIGHTS = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
STAGES = (
    (),
    (1.544,),
    (0.9466785280815826, 0.2557011698983284),
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
)
COUPLING = (
    (),
    (-5.6688,),
    (-2.430093356833875, -0.2063599157091915),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
    (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
)
DENSE = np.array(
    (
        (10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662, 0.0),
        (-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872, 0.0),
    )
)


class RodasInterpolation(dfx.AbstractLocalInterpolation):
    """The method's own continuous extension, of order 3 (Hairer and Wanner, VI.4)."""

    t0: Any
    t1: Any
    y0: Array
    y1: Array
    dense: Array

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> Array:
        """State at ``t0``, or the increment from ``t0`` to ``t1``."""
        del left
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        width = self.t1 - self.t0
        theta = (t0 - self.t0) / jnp.where(width == 0, 1.0, width)
        bend = self.dense[0] + theta * self.dense[1]
        return (1 - theta) * self.y0 + theta * (self.y1 + (1 - theta) * bend)


class Rodas(dfx.AbstractAdaptiveSolver):
    """RODAS for a flat state, with the linear algebra of ``structure``."""

    structure: AbstractStructure
    timed: bool = eqx.field(static=True, default=True)

    term_structure: ClassVar = dfx.ODETerm
    interpolation_cls: ClassVar[Callable[..., RodasInterpolation]] = RodasInterpolation

    def order(self, terms):
        """4."""
        return 4

    def error_order(self, terms):
        """The embedded method's error is of order 3 + 1."""
        return 4

    def init(self, terms, t0, t1, y0, args):
        """No memory between steps."""
        return None

    def func(self, terms, t0, y0, args):
        """The field."""
        return self.structure.field(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step; the last stage is the error estimate."""
        del terms, solver_state, made_jump
        h = t1 - t0
        structure = self.structure
        factors = structure.factor(t0, y0, args, h * GAMMA)
        drift = h * structure.time_derivative(t0, y0, args) if self.timed else None
        stages: list[Array] = []
        y = y0
        for i in range(6):
            y = _combine(y0, STAGES[i], stages)
            right = structure.field(t0 + TIMES[i] * h, y, args)
            right = _combine(right, tuple(c / h for c in COUPLING[i]), stages)
            if drift is not None and TIME_WEIGHTS[i]:
                right = right + TIME_WEIGHTS[i] * drift
            stages.append(structure.solve(factors, right))
        y1 = y + stages[5]
        dense = jnp.stack([_combine(0.0, tuple(row[:5]), stages[:5]) for row in DENSE])
        return y1, stages[5], dict(y0=y0, y1=y1, dense=dense), None, dfx.RESULTS.successful


def _combine(start: Any, weights: tuple, vectors: list[Array]) -> Array:
    total = start
    for weight, vector in zip(weights, vectors, strict=True):
        total = total + weight * vector
    return total
