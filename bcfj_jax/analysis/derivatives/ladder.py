"""How derivatives and forces change with the width of what is smoothed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, Unpack

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from bcfj_jax.analysis.derivatives.certificate import norm
from bcfj_jax.analysis.derivatives.sensitivity import Bounding, BoundingKeys, Sensitivity, sensitivity
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.quantities import scalar
from bcfj_jax.core.settings import taking
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model

KNOBS = ("smoothing", "friction_speed")


class Step(NamedTuple):
    """One width of a ladder.

    Attributes:
        value: of the knob [m or m/s].
        bias: relative L2 difference of all forces from those at the sharpest width [-].
        peak_bias: largest relative difference of a contact's greatest force from the sharpest [-].
        size: ||dF/dp|| per parameter [N s^(1/2) per SI unit].
        pointwise, average, verdict: of the certificate, per parameter.
        steps: attempted steps of the last solve.
        status: "ok" or "failed".
    """

    value: float
    bias: float
    peak_bias: float
    size: dict[str, float]
    pointwise: dict[str, float]
    average: dict[str, float]
    verdict: dict[str, str]
    steps: int
    status: str


@taking(Bounding)
def smoothing_ladder(
    scene: AbstractModel,
    params: Params,
    times: ArrayLike,
    wrt: Sequence[str],
    values: Sequence[float],
    *,
    knob: Literal["smoothing", "friction_speed"] = "smoothing",
    **settings: Unpack[BoundingKeys],
) -> list[Step]:
    """Derivatives and their certificates at several widths, the sharpest first.

    A wider regularisation of contact, or of friction, makes derivatives cheaper and better behaved, and biases the force: take
    the sharpest width whose certificate is good enough. Certificates are those of tolerances alone.

    Args:
        scene, params, times, wrt, accuracy, average, levels, max_steps: as ``sensitivity``.
        values: widths [m] or [m/s], in any order; shared by all contacts that have none of their own.
        knob: what is widened.

    Raises:
        InputError: as ``sensitivity``; and for a knob the scene does not have, or a width out of range.
    """
    params = inputs.parameters(as_model(scene), params, traced=False)
    if knob not in KNOBS:
        raise InputError("knob", f"no knob {quoted(knob)}", nearest(knob, KNOBS))
    if knob not in scene.quantities:
        raise InputError("knob", f"scene '{scene.kind}' with these options has no {knob}", "switch it on in the scene")
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InputError("values", quoted(values), f"give a list of values of {knob}")
    widths = [scalar("values", scene.quantities[knob], value) for value in values]
    if not widths:
        raise InputError("values", "no width", f"give values of {knob}")
    found: list[tuple[float, Sensitivity]] = []
    for value in sorted(widths):
        at = {**params, knob: jnp.asarray(value)}
        found.append((value, sensitivity(scene, at, times, wrt, mode="forward", differences="none", **settings)))
    return [_step(value, each, found[0][1]) for value, each in found]


def _step(value: float, found: Sensitivity, sharpest: Sensitivity) -> Step:
    assert found.certificate is not None
    t, checks = found.times, found.certificate.parameters
    forces, sharp = _flat(found.force), _flat(sharpest.force)
    tops, sharp_tops = (np.array([np.max(np.abs(f)) for f in x.force.values()]) for x in (found, sharpest))
    own = float(norm(t, sharp))
    return Step(
        value,
        float(norm(t, forces - sharp)) / own if own > 0 else float("nan"),
        float(np.max(np.abs(tops - sharp_tops) / np.where(sharp_tops > 0, sharp_tops, 1.0))),
        {name: float(norm(t, _flat(found.derivative[name]))) for name in found.wrt},
        {name: check.pointwise for name, check in checks.items()},
        {name: check.average for name, check in checks.items()},
        {name: check.verdict for name, check in checks.items()},
        int(found.stats["accepted"] + found.stats["rejected"]),
        found.status,
    )


def _flat(force: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate([f.reshape(len(f), -1) for f in force.values()], axis=1)
