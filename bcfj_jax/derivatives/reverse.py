"""Gradients of features by many parameters: one checkpointed backward solve a feature."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.derivatives.jacobian import compiled, histories
from bcfj_jax.derivatives.measures import vector
from bcfj_jax.derivatives.names import Feature
from bcfj_jax.integrate import Plan
from bcfj_jax.scene import AbstractScene, Params

_REVERSE = dfx.RecursiveCheckpointAdjoint()


class Gradient(NamedTuple):
    """Features (F,), their derivatives (F, P), the forces (T, C, 3), how the run ended and what it cost."""

    tolerance: float
    numbers: np.ndarray
    slopes: np.ndarray
    force: np.ndarray
    code: int
    end: float
    stats: dict[str, float]


def gradient(
    scene: AbstractScene,
    params: Params,
    times: np.ndarray,
    wrt: tuple[str, ...],
    how: Plan,
    wanted: Sequence[Feature],
    contacts: Mapping[str, int],
) -> Gradient:
    """Features and their derivatives by all of ``wrt``, per SI unit. Times are compiled in."""

    def jacobian(params: dict, how: Plan):
        def at(theta: dict):
            found, end = histories(scene, {**params, **theta}, jnp.asarray(times), how, _REVERSE)
            numbers = vector(times, found, wanted, contacts, {})
            return numbers, (numbers, found.force, end)

        return jax.jacrev(at, has_aux=True)({name: params[name] for name in wrt})

    arguments: tuple[dict[str, Array], Plan] = (dict(params), how)
    key = ("gradient", scene, times.tobytes(), wrt, tuple(wanted), how.max_steps, jax.tree.structure(arguments[0]))
    program, compile_s = compiled(key, jacobian, *arguments)
    begin = time.perf_counter()
    slopes, (numbers, force, (code, end, accepted, rejected)) = jax.device_get(program(*arguments))
    tolerance, wall = float(how.tolerance), time.perf_counter() - begin
    stats = {"accepted": int(accepted), "rejected": int(rejected), "tolerance": tolerance}
    stats |= {"wall_s": wall, "compile_s": compile_s}
    matrix = np.stack([slopes[name] for name in wrt], axis=1)
    return Gradient(tolerance, numbers, matrix, force, int(code), float(end), stats)
