"""Largest Lyapunov exponent of a scene, by the tangent of its own equations beside its own state.

Why the tangent and not two runs: two runs of an adaptive solver take different steps, so that their distance is never
below the tolerance, which at a force error of 1e-4 is 1e-3 of a ball's penetration; that is too near to the size of the
play itself. The tangent takes the state's own steps and one matrix serves both (``solvers.tangents``): SDIRK2 on the
arrowhead for the joint, bounded however stiff friction is, and Tsit5 for ``impact`` and ``bounce``. Contact
forces are continuous, so a tangent needs no jump where a contact begins (no saltation matrix); that of a law whose
damping begins at once, ``kelvin_voigt`` without smoothing, would, and is not right here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Unpack, cast

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.nonlinear.exponents import Counting, Exponent, counts, from_growth
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import Quantity, scalar
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import OK, reason
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model
from bcfj_jax.solve.integrate import Problem, code_of, controller, integrate, problem, seeker
from bcfj_jax.solve.plan import Plan, Solving, SolvingKeys, plan
from bcfj_jax.solve.sdirk import Sdirk
from bcfj_jax.solve.tangents import SdirkTangents

_TIMES = (
    Quantity("interval", "s", "time after which the tangent is shortened", 0.0, open_low=True),
    Quantity("settle", "s", "time until the start is forgotten", 0.0),
)


class FollowingKeys(SolvingKeys, total=False):
    """``Following`` as keywords."""

    batches: int
    seed: int


@dataclass(frozen=True)
class Following(Solving):
    """Settings of ``scene_exponent``."""

    accuracy: str | float = 1e-5
    batches: int = 10
    seed: int = 0


@taking(Following)
def scene_exponent(
    scene: AbstractModel, params: Params, intervals: int, *, interval: float | None = None, settle: float | None = None,
    **settings: Unpack[FollowingKeys],
) -> Exponent:  # fmt: skip
    """Largest Lyapunov exponent of a scene [1/s], along the motion that its start settles to.

    A joint's is that of its stroboscopic map: what would only shift its phase or leave its manifold is taken out of the
    tangent, as both are exactly neutral: turn and speed of a ``prescribed`` seat, and the length of the cage's axis. A
    joint that repeats itself then has a negative exponent. Lengths of tangents are rms in units of the error control.

    Args:
        scene, params, accuracy, max_steps: as ``simulate``; the tangent's own error is not controlled
            in a joint, and at 1e-4 one that rattles was seen to have six times its exponent.
        intervals: N, after each of which the tangent is brought back to length 1.
        interval: [s]; of a joint by default a ball's pitch, 2 pi/(balls |drive_speed|). Tangents of
            ``impact`` and ``bounce`` should not shrink by more than some 1e4 in it, for their error is held absolutely;
            each interval costs a restart of the solver.
        settle: time before the first interval [s], not counted; of a joint by default 5 revolutions. The load must
            have risen by then. A tenth of the intervals more turn the tangent before counting begins.
        batches: for the standard error.
        seed: of the tangent's first direction.

    Returns:
        The exponent; NaN, with a reason, where the motion could not be solved.

    Raises:
        InputError: for a scene without a drive and no interval and settle given, for a joint that has no dynamics,
            for times that are not positive, and as ``simulate``.
    """
    params = inputs.parameters(as_model(scene), params, traced=False)
    asked = Following(**settings)
    intervals, _, batches, seed = counts(intervals, Counting(batches=asked.batches, seed=asked.seed))
    if scene.traits.turning and (interval is None or settle is None):
        turn, pitch = scene.period(params)
        interval = pitch if interval is None else interval
        settle = 5.0 * turn if settle is None else settle
    if interval is None or settle is None:
        raise InputError(f"scene '{scene.kind}'", "has no period of its own", "give interval and settle")
    interval, settle = (scalar("exponent", q, x) for q, x in zip(_TIMES, (interval, settle), strict=True))
    # One interval more, at least, passes without being counted.
    settled = scene.settled_from(params)
    if settle + interval < settled:
        found = f"{settle:g} s, but the load rises for {settled - interval:g} s"
        raise InputError("settle", found, "give a longer settle")
    scene.check(params)
    how = plan(scene, asked.accuracy, asked.max_steps)
    turning = -(-intervals // 10)
    spans = jnp.asarray(settle), jnp.asarray(interval)
    plain = Plan(how.tolerance, how.max_steps)
    growth, codes = jax.device_get(_growth(scene, turning + intervals, seed, dict(params), spans, plain))
    bad = np.flatnonzero(codes != OK)
    why = reason(int(codes[bad[0]]), how.max_steps) if bad.size else ""
    return from_growth(growth[turning:] if not why else np.full(intervals, np.nan), interval, batches, why)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _growth(
    scene: AbstractModel, count: int, seed: int, params: Params, spans: tuple[Array, Array], how: Plan
) -> tuple[Array, Array]:
    """Logarithms of growth and status codes of every interval; the first code is the settling's where that failed."""
    settle, interval = spans
    settled = integrate(scene, params, jnp.stack([0.5 * settle, settle]), how, "forward")
    posed = problem(scene, params, settle + count * interval, how, True)
    both = _beside(scene, posed)
    start = jnp.where(settle > 0.0, settled.states[-1], posed.start)

    def unit(state: Array, tangent: Array) -> tuple[Array, Array]:
        tangent = scene.neutral(state, tangent)
        size = jnp.sqrt(jnp.mean(jnp.square(tangent / posed.scales)))
        return tangent / jnp.where(size > 0.0, size, 1.0), size

    def once(rows: Array, k: Array) -> tuple[Array, tuple[Array, Array]]:
        found, code = advance(both, how, rows, settle + k * interval, settle + (k + 1) * interval)
        tangent, size = unit(found[0], found[1])
        return jnp.stack([found[0], tangent]), (jnp.log(size), code)

    first, _ = unit(start, posed.scales * jax.random.normal(jax.random.key(seed), start.shape))
    growth, codes = jax.lax.scan(once, jnp.stack([start, first]), jnp.arange(count))[1]
    begun = jnp.where((settle > 0.0) & (settled.code != OK), settled.code, codes[0])
    return growth, codes.at[0].set(begun)


def _beside(scene: AbstractModel, posed: Problem) -> Problem:
    """The problem of rows (2, n): a state, and its tangent, without a change of parameters."""
    if scene.traits.stiff:
        return posed._replace(
            field=lambda t, rows, args: rows.at[0].set(posed.field(t, rows[0], args[0])),
            args=(posed.args, None),
            solver=SdirkTangents(cast(Sdirk, posed.solver)),
            # The state is never at rest, and its steps resolve what moves; errors of tangents are not controlled.
            norm=lambda errors: posed.norm(errors[0]),
        )

    def field(t: Any, rows: Array, args: Any) -> Array:
        return jnp.stack(jax.jvp(lambda y: posed.field(t, y, args), (rows[0],), (rows[1],)))

    # Both rows in the control: a body at rest has no error, and its tangent still swings.
    return posed._replace(field=field, norm=lambda errors: jnp.maximum(posed.norm(errors[0]), posed.norm(errors[1])))


def advance(both: Problem, how: Plan, rows: Array, begin: Array, end: Array) -> tuple[Array, Array]:
    """Rows, or a state alone, carried from one time to another [s]; with a status code (``core.status``)."""
    solution = dfx.diffeqsolve(
        dfx.ODETerm(both.field),  # pyright: ignore[reportArgumentType]
        seeker(both, how), t0=begin, t1=end, dt0=jnp.minimum(both.first_step, end - begin), y0=rows, args=both.args,
        saveat=dfx.SaveAt(t1=True), stepsize_controller=controller(both, how), adjoint=dfx.ForwardMode(),
        max_steps=how.max_steps, throw=False,
    )  # fmt: skip
    assert solution.ys is not None
    found = solution.ys[0]
    return found, code_of(solution.result, found)
