"""Errors of the contact law that no residual may show, as what they change of the readings.

A second contact behind a share of the greatest depth, and a force that relaxes (``contact.normal.Imperfect``). The motion
follows them: the change is that of a run with a little of each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
from jax import Array

from bcfj_jax.contact.normal import IMPERFECT
from bcfj_jax.core.programs import program
from calibration.forward.model import Model, divided, whole
from calibration.solver_budget import budget

# Depths of the stop as shares of the greatest, half-width of its corner as a share of its depth.
_DEPTHS, _WIDTH = (0.25, 0.5, 0.75), 0.05
# Times of relaxation as shares of a contact.
_TIMES = (0.1, 0.5)
# The step of the difference, of the peak.
_STEP = 1e-3


def signatures(
    model: Model, point: np.ndarray, log_depth: float, deepest: float, peak: float, duration: float
) -> dict[str, dict[str, np.ndarray]]:
    """Changes of the residuals (N,) by kind of error and name, a unit being one as large as the peak force.

    None for a rough cost, and where the model has no contact or has such an error already. Of each kind there is one at
    most in a contact.

    Args:
        model, point, log_depth: of the optimum.
        deepest: greatest depth of its contacts [m].
        peak: greatest contact force [N].
        duration: of its longest contact [s].
    """
    wrong = with_errors(model)
    if wrong is None or not (deepest > 0.0 and peak > 0.0 and 0.0 < duration < np.inf):
        return {}

    def seen(
        stiffness: float = 0.0, place: float = deepest, relaxing: float = 0.0, time: float = duration
    ) -> np.ndarray:
        return _residuals(_set(wrong, (stiffness, place, _WIDTH * place, relaxing, time)), point, log_depth)

    plain, stops, relaxations = seen(), {}, {}
    for share in _DEPTHS:
        place = share * deepest
        stops[f"second contact behind {share:.0%} of the depth"] = seen(_STEP * peak / (deepest - place), place)
    for share in _TIMES:
        relaxations[f"relaxation within {share:.0%} of a contact"] = seen(relaxing=_STEP, time=share * duration)
    kinds = {"second contact": stops, "relaxation": relaxations}
    changes = {kind: {name: (r - plain) / _STEP for name, r in found.items()} for kind, found in kinds.items()}
    return {kind: {n: x for n, x in found.items() if np.isfinite(x).all()} for kind, found in changes.items()}


def with_errors(model: Model) -> Model | None:
    """The model with both errors in each contact, none of any size; None where there are none to be."""
    scene = None if budget(model.scene).rough else model.scene.imperfect()
    return None if scene is None else _set(replace(model, scene=scene), (0.0, 1.0, 0.05, 0.0, 1.0))


def get_ready(model: Model) -> None:
    """Compile what ``signatures`` needs."""
    if (wrong := with_errors(model)) is not None:
        _program(wrong, np.zeros(len(model.coordinates)), 0.0)


def _set(model: Model, values: tuple[float, ...]) -> Model:
    count = len(model.data.times)
    more = {name: np.full(count, value) for name, value in zip(IMPERFECT, values, strict=True)}
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
