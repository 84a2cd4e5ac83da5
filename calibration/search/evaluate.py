"""A model at many points: all in one batch, or point by point over the cores where a run is dear."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from bcfj_jax.solve.plan import plan
from calibration.forward.losses import straightened
from calibration.forward.model import Model, batch, residuals_and_jacobian
from calibration.search.descent import Evaluate
from calibration.solver_budget import budget


def loosened(model: Model) -> Model:
    """A model integrated as loosely as will do on the way to an optimum."""
    loose = jnp.maximum(model.how.tolerance, plan(model.scene, budget(model.scene).loose).tolerance)
    return eqx.tree_at(lambda m: m.how.tolerance, model, loose)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def evaluator(model: Model, log_depth: float) -> Evaluate:
    """Residuals and Jacobians of several points, as NumPy arrays.

    A batch goes through one program, where all points wait for the one with most steps. Of a joint's motion, steps cost
    in proportion to the points: points are then taken one by one, as many at a time as there are cores, and equal ones
    once.
    """
    depth = jnp.asarray(log_depth)

    def together(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals, jacobians = batch(model, jnp.asarray(points), depth)
        return np.asarray(residuals), np.asarray(jacobians)

    def alone(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = straightened(model.loss, *residuals_and_jacobian(model, jnp.asarray(point), depth))
        return np.asarray(found[0]), np.asarray(found[1])

    compiled = False

    def apart(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal compiled
        different, places = np.unique(points, axis=0, return_inverse=True)
        # The very first point alone: were there a program to compile, every thread would.
        found = [] if compiled else [alone(different[0])]
        compiled = True
        with ThreadPoolExecutor(cores()) as pool:
            found += pool.map(alone, different[len(found) :])
        residuals, jacobians = (np.stack(part)[places.ravel()] for part in zip(*found, strict=True))
        return residuals, jacobians

    return apart if budget(model.scene).apart else together
