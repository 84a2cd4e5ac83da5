"""What can be said before the solve: data that cannot be fitted, parameters that move nothing, directions that trade."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.mechanism.channels import unit_of
from calibration.forward.model import Model, residuals_and_jacobian
from calibration.problem import Problem

# Where the noise is to be estimated, no sensor is taken to resolve less than this share of its largest reading.
_FINEST = 1e-4
# A combination of parameters that the data let vary by more than this share of a box is weak.
_WEAK = 0.25
# A parameter takes part in a direction with this share of its largest component.
_PART = 0.3
# A force that pulls this much further than it pushes has its sign the wrong way round.
_PULLS = 3.0

# What separates two parameters, by words in their names.
_APART = (
    (("stiffness", "exponent"), "impacts of different speeds, so that the penetrations differ"),
    (("reference_force", "exponent"), "impacts of different speeds, so that the penetrations differ"),
    (("bandwidth", "damping"), "the sensor's bandwidth from its data sheet, or a faster sensor"),
    (("bandwidth", "stiffness"), "the sensor's bandwidth from its data sheet, or a faster sensor"),
    (("bandwidth", "time_offset"), "a clock that the record shares with the motion"),
    (("resonance", "damping"), "the sensor's frequency as mounted, by a tap"),
    (("resonance", "time_offset"), "the sensor's frequency as mounted, by a tap"),
    (("gain_bend", "exponent"), "a sensor calibrated at several loads"),
    (("gain_bend", "stiffness"), "a sensor calibrated at several loads"),
    (("time_offset", "clearance"), "a clock that the record shares with the motion, or a second contact"),
    (("time_offset", "drop_height"), "a clock that the record shares with the motion, or a second contact"),
    (("clearance", "approach_speed"), "a measured speed, or runs of different speeds"),
    (("mass", "approach_speed"), "a weighed mass or a measured speed"),
    (("mass", "stiffness"), "a weighed mass"),
    (("gain", "stiffness"), "a calibrated sensor"),
    (("gain", "mass"), "a calibrated sensor, or a weighed mass"),
    (("stiffness", "approach_speed"), "a measured speed"),
    (("damping", "exponent"), "records of the whole rebound, and of different speeds"),
    (("stiffness", "clearance"), "a record with contact on both sides of the clearance, or with a flight in it"),
    (("friction", "damping"), "runs of different speeds"),
)
_ELSE = "fixing one of them, or an experiment of another speed, load or channel"


def refuse_data(problem: Problem) -> None:
    """Refuse records that no model can explain.

    Raises:
        InputError: for a channel that never changes, and for a normal force that pulls.
    """
    offset = any(f.name == "force_offset" for f in problem.free)
    for e in problem.experiments:
        for c in e.channels:
            where = f"{e.source or e.name}: {c.observes}"
            values = c.values[np.isfinite(c.values)]
            if values.size > 1 and np.ptp(values) == 0.0:
                found = f"all {values.size} readings are {values[0]:g} {unit_of(c.observes)}"
                raise InputError(where, found, "choose another channel, or widen the window to where it changes")
            if c.observes.endswith(".normal") and values.size:
                rest = float(np.median(values[: max(1, values.size // 20)])) if offset else 0.0
                push, pull = float(np.max(values)) - rest, rest - float(np.min(values))
                if pull > _PULLS * max(push, 0.0):
                    found = f"the force pulls: its readings go from {np.min(values):g} N to {np.max(values):g} N"
                    raise InputError(where, found, 'flip its sign with "-" before the column')


def at_start(
    problem: Problem, model: Model, labels: tuple[str, ...], point: np.ndarray, reach: np.ndarray
) -> dict[str, Any]:
    """What the data determine at a start (P,), for ``fit.json``: values, reach in deviations of the noise, singular values of
    the Jacobian, and weak directions in words, each with what would separate them. ``reach`` (P,) is what each coordinate
    moved over the design.

    Raises:
        InputError: naming a parameter that, over its whole range, moves the data by less than their noise.
    """
    jacobian = residuals_and_jacobian(model, point)[1]
    jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
    lengths = np.linalg.norm(jacobian, axis=0)
    # Where noise is to be estimated 1 % of the largest reading is assumed (``Channel.deviation``); it may be far less.
    estimated = any(c.sigma is None for e in problem.fitted for c in e.channels)
    for label, size in zip(labels, (0.01 / _FINEST if estimated else 1.0) * np.maximum(reach, lengths), strict=True):
        if size < 1.0:
            found = f"'{label}' moves no residual by more than {size:.1g} of the noise over its whole range"
            remedy = "fix it in the scene, or add data that depend on it"
            raise InputError(f"{problem.where}: [free.{label}]", found, remedy)
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    names = list(labels)
    if model.referenced:
        names[model.pair()[0]] = "reference_force"
    return {
        "at": dict(zip(labels, model.values(point).tolist(), strict=True)),
        "reach": dict(zip(names, lengths.tolist(), strict=True)),
        "singular_values": singular.tolist(),
        "weak": [weak_direction(names, v, s) for s, v in zip(singular, directions, strict=True) if s * _WEAK < 1.0],
    }


def weak_direction(names: list[str], direction: np.ndarray, singular: float) -> dict[str, Any]:
    """A direction of the box that the data hardly determine, in words: who trades against whom, and what separates them."""
    size = np.abs(direction)
    own = [names[k] for k in np.argsort(-size, kind="stable") if size[k] > _PART * size.max()]
    moved = f"from end to end of its range this moves the data by {singular:.2g} of the noise"
    if len(own) == 1:
        text = f"the data hardly depend on {own[0]} here: {moved}"
        remedy = f"fixing {own[0]}, or data that depend on it"
    else:
        text = f"{', '.join(own[:-1])} and {own[-1]} trade against each other here: {moved}"
        remedy = separation(own)
    return {"parameters": own, "noise": float(singular), "text": text, "remedy": remedy}


def separation(names: list[str]) -> str:
    """What would separate parameters that trade against each other."""
    pairs = list(permutations(names, 2))
    found = [remedy for (a, b), remedy in _APART if any(a in one and b in other for one, other in pairs)]
    return "; ".join(dict.fromkeys(found[:2])) or _ELSE
