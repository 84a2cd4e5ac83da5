"""Derivatives of features through JAX itself: backward by many parameters, and twice along a direction."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from bcfj_jax.analysis.derivatives import certificate as verdicts
from bcfj_jax.analysis.derivatives.bounds import feature_bounds
from bcfj_jax.analysis.derivatives.certificate import NAN, Certificate, Check
from bcfj_jax.analysis.derivatives.jacobian import Histories, Level, histories
from bcfj_jax.analysis.derivatives.measures import vector as feature_vector
from bcfj_jax.analysis.derivatives.names import Feature, complete, smooth
from bcfj_jax.analysis.derivatives.names import feature as named
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.core.errors import InputError, texts
from bcfj_jax.core.quantities import increasing, real
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import OK, STEEP
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model
from bcfj_jax.solve.plan import Plan, Solving, SolvingKeys, plan
from bcfj_jax.xla.programs import program


def reversible(wanted: Sequence[Feature]) -> list[Feature]:
    """Features that JAX differentiates backward; ``InputError`` where there is none."""
    good = [f for f in wanted if smooth(f.kind)]
    if not good:
        right = "periods, delays, times of a start and single contacts are differentiated with mode='forward'"
        raise InputError("features", ", ".join(f.name for f in wanted), right)
    return good


def gradient(problem: Problem, how: Plan) -> tuple[Level, np.ndarray, np.ndarray]:
    """A solve, without derivatives of histories; features (F,) and their derivatives (F, P) by all of the names, per SI unit.

    One backward solve a feature. Times are compiled in.
    """
    arguments: tuple[dict[str, Array], Plan] = (dict(problem.params), how)
    static = (problem.scene, problem.times.tobytes(), problem.names, tuple(problem.wanted))
    solve, compile_s = program("gradient", _gradient, static, arguments)
    begin = time.perf_counter()
    slopes, (numbers, force, (code, end, accepted, rejected, *_)) = solve(*arguments)
    wall = time.perf_counter() - begin
    matrix = np.stack([slopes[name] for name in problem.names], axis=1)
    if code == OK and not np.isfinite(matrix[np.isfinite(numbers)]).all():
        code, end = STEEP, problem.times[-1]
    none: Any = None
    solved = Level(
        float(how.tolerance), Histories(force, None, None, None), none, int(code), float(end), int(accepted),
        int(rejected), wall, compile_s, None,
    )  # fmt: skip
    return solved, numbers, matrix


def _gradient(
    scene: AbstractModel, times: bytes, wrt: tuple[str, ...], wanted: tuple[Feature, ...], params: dict, how: Plan
) -> Any:
    """Derivatives of the features by name, and (features, forces, how the run ended)."""
    t = np.frombuffer(times)

    def at(theta: dict):
        found, end = histories(scene, {**params, **theta}, jnp.asarray(t), how, "reverse")
        numbers = feature_vector(t, found, wanted, scene.members, {})
        return numbers, (numbers, found.force, end)

    return jax.jacrev(at, has_aux=True)({name: params[name] for name in wrt})


def reversed_certificate(
    problem: Problem, solved: Sequence[Level], numbers: np.ndarray, slopes: Sequence[np.ndarray]
) -> Certificate:
    """Bounds of gradients (F, P) that were solved at three tolerances far apart, of features (F,)."""
    found, first = feature_bounds(slopes, numbers, problem.values), solved[0]
    far = f"{first.tolerance:.3g} against {solved[-1].tolerance:.3g}"
    what = f"the same derivatives of features at a tolerance of {far}"
    broken = next((s.end for s in solved if not s.good), NAN)
    checks, table = {}, problem.by_name(found)
    for k, name in enumerate(problem.names):
        verdict = verdicts.TRUSTED if float(np.max(found[:, k])) <= verdicts.POINTWISE else verdicts.NOT
        remark = "" if np.any(slopes[0][:, k]) else "no influence"
        remark = remark if all(s.good for s in solved) else "the run failed"
        checks[name] = Check(verdict, remark, (what,), NAN, NAN, table[name], NAN, NAN, NAN, NAN, broken)
    tolerances, steps = (tuple(getattr(s, key) for s in solved) for key in ("tolerance", "steps"))
    worst = verdicts.worst_verdict(checks)
    return Certificate(worst, checks, 0.0, verdicts.POINTWISE, tolerances, steps, None, first.tolerance)


@taking(Solving, accuracy="reference")
def hessian_vector(
    scene: AbstractModel, params: Params, times: Float[ArrayLike, " T"], feature: str, wrt: Sequence[str],
    vector: Float[ArrayLike, " P"], **settings: Unpack[SolvingKeys],
) -> Float[np.ndarray, " P"]:  # fmt: skip
    """Hessian of a feature times a vector, sum_j d2f/(dp_i dp_j) v_j, (P,) in SI units; forward over forward.

    A peak is the crest between samples (``analysis.crests``): a fixed sample would leave out that the peak's time moves, which
    first derivatives do not see and second ones do.

    Args:
        scene, params, times, wrt, accuracy, max_steps: as ``sensitivity``.
        feature: a name as there; no period and no delay.
        vector: v (P,), per parameter in its SI unit.

    Raises:
        InputError: for a stiff model, whose implicit solver is differentiated once only; for unknown names; and for a
            vector that does not have one finite number a parameter.
    """
    params = inputs.parameters(as_model(scene), params, traced=False)
    if scene.traits.stiff:
        found = "its equations are stiff: no second derivatives"
        raise InputError(f"scene '{scene.kind}'", found, "take a model without friction, such as impact or bounce")
    t = increasing(times)
    full, names = complete(scene, params, wrt)
    (one,) = texts("feature", [feature], 'name one feature, such as "contact.mean"')
    wanted = named(one, scene.members)
    if not smooth(wanted.kind):
        raise InputError(f"feature '{feature}'", "no second derivatives", "take peak, mean, impulse or another")
    v = real("vector", "vector", vector)
    if v.shape != (len(names),) or not np.isfinite(v).all():
        raise InputError("vector", f"shape {v.shape}", f"give {len(names)} finite number(s), one a parameter")
    arguments = (dict(full), plan(scene, **settings), v)
    static = (scene, t.tobytes(), names, wanted)
    return np.asarray(program("hessian", _product, static, arguments)[0](*arguments))


def _product(
    scene: AbstractModel, samples: bytes, names: tuple[str, ...], wanted: Feature, params: dict, how: Plan, v: Array
) -> Array:
    """The Hessian of a feature times ``v``."""
    t = np.frombuffer(samples)

    def scalar(theta: Array) -> Array:
        values = {**params, **{name: theta[k] for k, name in enumerate(names)}}
        found, _ = histories(scene, values, jnp.asarray(t), how)
        # The summit of the continuous curve has a first derivative alone; the crest between samples has two.
        found = found._replace(curve=None) if wanted.kind == "peak" else found
        return feature_vector(t, found, [wanted], scene.members, {})[0]

    theta = jnp.stack([params[name] for name in names])
    return jax.jacfwd(lambda x: jax.jvp(scalar, (x,), (v,))[1])(theta)
