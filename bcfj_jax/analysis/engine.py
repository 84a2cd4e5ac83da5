"""From a scene file and values of its parameters to a plan, a run, derivatives, or why there are none.

What studies, designs and trade-offs ask of a point, each in its own batches.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

from bcfj_jax.analysis.derivatives.jacobian import Level, level
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import Plan, force_error, plan
from bcfj_jax.solve.simulation import Run, simulate

_TIGHTEST = 1e-9


def planned(given: SceneFile, safety: float = 1.0) -> Plan:
    """How a scene file is integrated, at so much of its tolerance."""
    how = plan(given.scene, given.accuracy, given.max_steps, given.solver)
    return eqx.tree_at(lambda h: h.tolerance, how, how.tolerance * safety)


def simulated(
    given: SceneFile, params: Mapping[str, Any] | None = None, times: np.ndarray | None = None, safety: float = 1.0,
    **more: Any,
) -> Run:  # fmt: skip
    """A run of a scene file, with parameters, times and ``more`` in place of its own, at so much of its force error."""
    accuracy = given.accuracy if safety == 1.0 else max(_TIGHTEST, force_error(given.accuracy) * safety)
    own: dict[str, Any] = {"accuracy": accuracy, "max_steps": given.max_steps, "solver": given.solver}
    params, times = given.params if params is None else params, given.times if times is None else times
    own |= {"resolved_peaks": given.resolved_peaks, **more}
    return simulate(given.scene, params, times, **own)


def differentiated(
    given: SceneFile, wrt: tuple[str, ...], params: Mapping[str, Any] | None = None, times: np.ndarray | None = None,
    safety: float = 1.0,
) -> Level:  # fmt: skip
    """As ``simulated``, with derivatives by parameters that all have a value."""
    values: Any = given.params if params is None else params
    return level(given.scene, values, given.times if times is None else times, wrt, planned(given, safety))


def columns(params: Params, names: tuple[str, ...], values: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of points (n, D) of the named ones: leaves (n,), of those that do not vary too."""
    fixed = {name: np.full(len(values), float(value)) for name, value in params.items()}
    return fixed | {name: values[:, k].astype(float) for k, name in enumerate(names)}


def refusal(scene: AbstractModel, params: Any) -> str:
    """Why a model cannot be built with these parameters; "" where it can."""
    try:
        scene.check(params)
    except InputError as error:
        return said(error)
    return ""


def said(error: InputError) -> str:
    """An error of a point in words."""
    return str(error).strip(": ")
