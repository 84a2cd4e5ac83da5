"""A model at many points: one after the other, or over the cores where a run is dear."""

from __future__ import annotations

import equinox as eqx
import numpy as np

from bcfj_jax.solve.plan import plan
from bcfj_jax.xla.threads import each
from calibration.forward.losses import straightened
from calibration.forward.model import Evaluated, Model, evaluation
from calibration.search.descent import Evaluate
from calibration.solver_budget import budget


def loosened(model: Model) -> Model:
    """A model integrated as loosely as will do on the way to an optimum."""
    loose = np.maximum(model.how.tolerance, plan(model.scene, budget(model).loose).tolerance)
    return eqx.tree_at(lambda m: m.how.tolerance, model, loose)


def evaluator(model: Model) -> Evaluate:
    """Residuals (B, N) and Jacobians (B, N, P) of points (B, P), equal points once.

    Of a robust loss they are such that the sum of their squares is the cost. Points of a large scene are taken as many
    at a time as there are cores.
    """
    at = evaluation(model)

    def over_the_cores(points: np.ndarray) -> Evaluated:
        found = each(lambda point: at(point[None]), points)
        return Evaluated(*(np.concatenate(part) for part in zip(*found, strict=True)))

    def evaluate(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        different, places = np.unique(points, axis=0, return_inverse=True)
        found = over_the_cores(different) if budget(model).apart else at(different)
        residuals, jacobians = straightened(model.loss, found.residuals, found.jacobians)
        return residuals[places.ravel()], jacobians[places.ravel()]

    return evaluate
