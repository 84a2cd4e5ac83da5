"""From an optimum with assumed weights to one whose weights are those of the noise that it shows itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calibration.forward.integration import Limit, limits
from calibration.forward.model import Model, residuals_and_jacobian
from calibration.noise import noise_model
from calibration.noise.noise_model import Estimate
from calibration.problem import Experiment
from calibration.search.refinement import End, finish

_ROUNDS, _SETTLED = 12, 1e-3
# A start that ends lower than the one of the noise estimate by this much gives a new estimate.
_LOWER = 0.1
# Unit-box coordinates that differ by less are one optimum, approached to different depths.
_BESIDE = 1e-3


def settle(
    model: Model, experiments: tuple[Experiment, ...], ends: tuple[End, ...], accuracy: float
) -> tuple[Model, tuple[End, ...], Estimate]:
    """Estimate the noise at the best end and fit with it, in turn, until neither changes; then bring the others along.

    Returns:
        The model with settled weights, the ends on it, best first, and the noise.
    """
    if noise_model.known(experiments):
        return model, ends, Estimate({}, {}, [])
    renewed = ends
    known = limits(model, ends[0].point, accuracy)
    settled, found, best = _settled(model, experiments, ends[0], known)
    for _ in range(2):
        factor = _factor(model, settled)
        renewed = _ordered(settled, list(_all_moved(settled, ends, factor)))
        if renewed[0].cost > best.cost - _LOWER:
            break
        settled, found, best = _settled(model, experiments, renewed[0], known)
    return settled, renewed, found


def _settled(
    model: Model, experiments: tuple[Experiment, ...], end: End, known: dict[str, Limit]
) -> tuple[Model, Estimate, End]:
    found = Estimate({}, {}, [])
    for _ in range(_ROUNDS):
        new, found = noise_model.estimate(model, experiments, end.point, known)
        factor = _factor(model, new)
        change = _change(model, new)
        end = _moved(new, end, factor)
        model = new
        if factor is not None or change < _SETTLED:
            break
    return model, found, end


def _ordered(model: Model, ends: list[End]) -> tuple[End, ...]:
    """Best first, and the best refined: on another model it may be one that the search left as it was."""
    best, *others = sorted(ends, key=lambda e: (bool(e.failure), e.cost))
    if not best.residuals.size:
        best = finish(model, best.start, np.clip(best.point, 1e-9, 1.0 - 1e-9))
    return best, *others


def _all_moved(model: Model, ends: tuple[End, ...], factor: float | None) -> Iterator[End]:
    """Every end on the model; those that the search left beside a refined one go where that goes."""
    done: list[tuple[End, End]] = []
    for end in ends:
        beside = (new for old, new in done if np.abs(old.point - end.point).max() < _BESIDE)
        near = next(beside, None) if end.converged and not end.residuals.size else None
        if end.failure:
            yield end
        elif near is not None:
            yield replace(end, point=near.point, cost=near.cost)
        else:
            new = _moved(model, end, factor)
            done += [(end, new)] if end.residuals.size else []
            yield new


def _change(old: Model, new: Model) -> float:
    """Largest relative change of a weight, or change of a memory."""
    seen = np.asarray(old.data.weights) > 0
    ratio = np.asarray(new.data.weights)[seen] / np.asarray(old.data.weights)[seen]
    memory = np.abs(np.asarray(new.data.memory) - np.asarray(old.data.memory))
    return max(float(np.max(np.abs(ratio - 1.0), initial=0.0)), float(np.max(memory, initial=0.0)))


def _factor(old: Model, new: Model) -> float | None:
    """The one number that all residuals are multiplied with from one model to the other, if there is one."""
    seen = np.asarray(old.data.weights) > 0
    ratio = np.asarray(new.data.weights)[seen] / np.asarray(old.data.weights)[seen]
    same = ratio.size and np.ptp(ratio) < 1e-12 * ratio[0] and np.array_equal(old.data.memory, new.data.memory)
    return float(ratio[0]) if same and not new.observed_features and new.loss == "linear" else None


def _moved(model: Model, end: End, factor: float | None) -> End:
    """An end on a model with other weights: a common factor moves no optimum."""
    if factor is not None:
        residuals, jacobian = factor * end.residuals, factor * end.jacobian
        return replace(end, residuals=residuals, jacobian=jacobian, cost=factor**2 * end.cost)
    if end.residuals.size:
        return finish(model, end.start, np.clip(end.point, 1e-9, 1.0 - 1e-9))
    return replace(end, cost=float(model.cost(residuals_and_jacobian(model, end.point)[0])))
