"""Errors of the contact law that no residual may show, as what they change of the readings.

A second contact behind a share of the greatest depth, and a force that relaxes (``contact.normal.Imperfect``). The motion
follows them: the change is that of a run with a little of each.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import numpy as np

from bcfj_jax.contact.normal import IMPERFECT
from calibration.forward import runs
from calibration.forward.model import Model
from calibration.solver_budget import budget

# Depths of the stop as shares of the greatest: so close that runs of several speeds find one like theirs. Half-width of its
# corner as a share of its depth.
_DEPTHS, _WIDTH = (0.2, 0.35, 0.5, 0.65, 0.8), 0.05
# Times of relaxation as shares of a contact.
_TIMES = (0.1, 0.5)
# The step of the difference, of the peak.
_STEP = 1e-3


def signatures(
    model: Model, point: np.ndarray, deepest: float, peak: float, duration: float
) -> dict[str, dict[str, np.ndarray]]:
    """Changes of the residuals (N,) by kind of error and name, a unit being one as large as the peak force.

    None for a rough cost, and where the model has no contact or has such an error already. ``deepest`` [m], ``peak`` [N] and
    ``duration`` [s] are the greatest of its contacts.
    """
    wrong = with_errors(model)
    if wrong is None or not (deepest > 0.0 and peak > 0.0 and 0.0 < duration < np.inf):
        return {}

    records = runs.clocks(model, point)

    def seen(
        stiffness: float = 0.0, place: float = deepest, relaxing: float = 0.0, time: float = duration
    ) -> np.ndarray:
        values = (stiffness, place, _WIDTH * place, relaxing, time)
        return _read(wrong, records, dict(zip(IMPERFECT, values, strict=True)))

    plain, places = seen(), [share * deepest for share in _DEPTHS]
    kinds = {
        "second contact": {
            f"second contact behind {share:.0%} of the depth": seen(_STEP * peak / (deepest - place), place)
            for share, place in zip(_DEPTHS, places, strict=True)
        },
        "relaxation": {
            f"relaxation within {share:.0%} of a contact": seen(relaxing=_STEP, time=share * duration)
            for share in _TIMES
        },
    }
    none = np.zeros(model.data.features.size)

    def white(read: np.ndarray) -> np.ndarray:
        return np.concatenate([model.data.white((read - plain) / _STEP).ravel(), none])

    changes = {kind: {n: white(read) for n, read in found.items()} for kind, found in kinds.items()}
    return {kind: {n: x for n, x in found.items() if np.isfinite(x).all()} for kind, found in changes.items()}


def with_errors(model: Model) -> Model | None:
    """The model with both errors in each contact; None where there are none to be."""
    scene = None if budget(model).rough else model.scene.imperfect()
    if scene is None:
        return None
    more = {name: np.zeros(len(model.data.times)) for name in IMPERFECT}
    return eqx.tree_at(lambda m: m.data.fixed, replace(model, scene=scene), {**model.data.fixed, **more})


def get_ready(model: Model) -> None:
    """Compile what ``signatures`` needs: a run of its own, the same for records of any length."""
    if (wrong := with_errors(model)) is not None:
        runs.get_ready(wrong)


def _read(model: Model, records: list[tuple[dict[str, float], np.ndarray]], values: dict[str, float]) -> np.ndarray:
    """What each channel reads at the times of the records, (E, C, T), but for what the sensor's memory makes of it."""
    read = np.zeros(model.data.values.shape)
    for i, (params, times) in enumerate(records):
        found = runs.ran(model, params | values, times).readings
        clock = np.asarray(model.data.times)[i] - params["time_offset"]
        for j, name in enumerate(model.channels):
            read[i, j] = params["gain"] * np.interp(clock, times, np.asarray(found[name]))
    return read
