"""Gradients of features by many parameters, one backward solve a feature, and their certificate."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives import certificate as verdicts
from bcfj_jax.analysis.derivatives.bounds import feature_bounds
from bcfj_jax.analysis.derivatives.certificate import Certificate, Check
from bcfj_jax.analysis.derivatives.jacobian import histories
from bcfj_jax.analysis.derivatives.measures import vector
from bcfj_jax.analysis.derivatives.names import Feature, smooth
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.status import OK, STEEP
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan
from bcfj_jax.xla.programs import program


class Gradient(NamedTuple):
    """Features (F,), their derivatives (F, P), the forces (T, C, 3), how the run ended and what it cost."""

    tolerance: float
    numbers: np.ndarray
    slopes: np.ndarray
    force: np.ndarray
    code: int
    end: float
    stats: dict[str, float]


def reversible(wanted: Sequence[Feature]) -> list[Feature]:
    """Features that JAX differentiates backward.

    Raises:
        InputError: where there is none.
    """
    good = [f for f in wanted if smooth(f.kind)]
    if not good:
        found = ", ".join(f.name for f in wanted)
        raise InputError(
            "features",
            found,
            "periods, delays, times of a start and single contacts are differentiated with mode='forward'",
        )
    return good


def gradient(problem: Problem, how: Plan) -> Gradient:
    """Features and their derivatives by all of the names, per SI unit. Times are compiled in."""
    arguments: tuple[dict[str, Array], Plan] = (dict(problem.params), how)
    static = (problem.scene, problem.times.tobytes(), problem.names, tuple(problem.wanted))
    solve, compile_s = program("gradient", _gradient, static, arguments)
    begin = time.perf_counter()
    slopes, (numbers, force, (code, end, accepted, rejected)) = solve(*arguments)
    tolerance, wall = float(how.tolerance), time.perf_counter() - begin
    stats = {"accepted": int(accepted), "rejected": int(rejected), "tolerance": tolerance}
    stats |= {"wall_s": wall, "compile_s": compile_s}
    matrix = np.stack([slopes[name] for name in problem.names], axis=1)
    if code == OK and not np.isfinite(matrix[np.isfinite(numbers)]).all():
        code, end = STEEP, problem.times[-1]
    return Gradient(tolerance, numbers, matrix, force, int(code), float(end), stats)


def _gradient(
    scene: AbstractModel, times: bytes, wrt: tuple[str, ...], wanted: tuple[Feature, ...], params: dict, how: Plan
) -> Any:
    """Derivatives of the features by name, and (features, forces, how the run ended)."""
    t = np.frombuffer(times)

    def at(theta: dict):
        found, end = histories(scene, {**params, **theta}, jnp.asarray(t), how, "reverse")
        numbers = vector(t, found, wanted, scene.members, {})
        return numbers, (numbers, found.force, end)

    return jax.jacrev(at, has_aux=True)({name: params[name] for name in wrt})


def reversed_certificate(
    names: Sequence[str], values: np.ndarray, wanted: Sequence[Feature], solved: Sequence[Gradient]
) -> Certificate:
    """Bounds of gradients that were solved at three tolerances far apart; the values (P,) are the parameters'."""
    found = feature_bounds([s.slopes for s in solved], solved[0].numbers, values)
    loose, tight = solved[0].tolerance, solved[-1].tolerance
    what = f"the same derivatives of features at a tolerance of {loose:.3g} against {tight:.3g}"
    nan, worst = float("nan"), next((s for s in solved if s.code != OK), None)
    failed, broken = worst is not None, worst.end if worst else nan
    checks: dict[str, Check] = {}
    for k, name in enumerate(names):
        each = {f.name: float(found[i, k]) for i, f in enumerate(wanted)}
        verdict = verdicts.TRUSTED if float(np.max(found[:, k])) <= verdicts.POINTWISE else verdicts.NOT
        remark = "" if np.any(solved[0].slopes[:, k]) else "no influence"
        remark = "the run failed" if failed else remark
        checks[name] = Check(verdict, remark, (what,), nan, nan, each, nan, nan, nan, nan, broken)
    return Certificate(
        verdicts.worst_verdict(checks), checks, 0.0, verdicts.POINTWISE, tuple(s.tolerance for s in solved),
        tuple(int(s.stats["accepted"] + s.stats["rejected"]) for s in solved), None, loose,
    )  # fmt: skip
