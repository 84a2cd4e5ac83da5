"""Errors of the contact law that no residual may show, as what they change of the readings: a second contact behind each.

An elastic stop behind a share of the greatest depth adds a force to the law (``contact.normal.Backed``), and the motion
follows: the change is that of a run with a little of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
from jax import Array

from bcfj_jax.core.programs import program
from calibration.forward.model import Model, divided, whole
from calibration.solver_budget import budget

# Depths of the stop as shares of the greatest, half-width of its corner as a share of its depth.
_DEPTHS, _WIDTH = (0.3, 0.7), 0.05
# The stop's force at the greatest depth, of the peak: the step of the difference.
_STEP = 1e-3
_NAMES = ("bottoming_stiffness", "bottoming_penetration", "bottoming_width")


def signatures(model: Model, point: np.ndarray, log_depth: float, deepest: float, peak: float) -> dict[str, np.ndarray]:
    """Changes of the residuals (N,) by name, a unit being a stop that adds the peak force at the greatest depth.

    None for a rough cost, and where the model has no contact or has such a stop already.

    Args:
        model, point, log_depth: of the optimum.
        deepest: greatest depth of its contacts [m].
        peak: greatest contact force [N].
    """
    backed = with_stop(model)
    if backed is None or not (deepest > 0.0 and peak > 0.0):
        return {}
    plain, found = _residuals(_set(backed, 0.0, deepest), point, log_depth), {}
    for share in _DEPTHS:
        place = share * deepest
        stiffness = _STEP * peak / (deepest - place)
        seen = _residuals(_set(backed, stiffness, place), point, log_depth)
        if np.isfinite(seen).all() and np.isfinite(plain).all():
            found[f"second contact behind {share:.0%} of the depth"] = (seen - plain) / _STEP
    return found


def with_stop(model: Model) -> Model | None:
    """The model with a stop behind each contact; None where there is none to be."""
    scene = None if budget(model.scene).rough else model.scene.backed()
    return None if scene is None else _set(replace(model, scene=scene), 0.0, 1.0)


def get_ready(model: Model) -> None:
    """Compile what ``signatures`` needs."""
    if (backed := with_stop(model)) is not None:
        _program(backed, np.zeros(len(model.coordinates)), 0.0)


def _set(model: Model, stiffness: float, depth: float) -> Model:
    count = len(model.data.times)
    values = (stiffness, depth, _WIDTH * depth)
    more = {name: np.full(count, value) for name, value in zip(_NAMES, values, strict=True)}
    return eqx.tree_at(lambda m: m.data.fixed, model, {**model.data.fixed, **more})


def _program(model: Model, point: np.ndarray, log_depth: float) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    frame, numbers = divided(model)
    arguments = (numbers, np.asarray(point, dtype=float), float(log_depth))
    return program("calibration residuals", _run, (frame,), arguments)[0], arguments


def _residuals(model: Model, point: np.ndarray, log_depth: float) -> np.ndarray:
    run, arguments = _program(model, point, log_depth)
    return np.asarray(run(*arguments))


def _run(frame: Model, numbers: Any, point: Array, log_depth: Array) -> Array:
    return whole(frame, numbers).residuals(point, log_depth)
