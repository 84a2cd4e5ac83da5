"""Largest Lyapunov exponent of any map or flow, after Benettin, Galgani, Giorgilli and Strelcyn, Meccanica 15, 1980.

A tangent w is carried along the orbit and brought back to length 1 after every step:

    w <- DP(y) w,   g_k = ln|w|,   w <- w/|w|,      lambda = <g>/interval.

DP(y) w is one ``jax.jvp`` of a map, or of a flow's field all along, so no separation has to be chosen.
``two_trajectories`` is the older way, two orbits at a small finite distance, for steps that have no derivative and as a
check.

Of a scene the tangent of its own equations is solved beside its own state. Two runs of an adaptive solver take different
steps, so that their distance is never below the tolerance, which at a force error of 1e-4 is 1e-3 of a ball's penetration;
that is too near to the size of the play itself. The tangent takes the state's own steps and one matrix serves both
(``solve.tangents``): SDIRK2 on the arrowhead for the joint, bounded however stiff friction is, and Tsit5 for ``impact`` and
``bounce``. Contact forces are continuous, so a tangent needs no jump where a contact begins (no saltation matrix); that of a
law or load whose damping begins at once, ``kelvin_voigt`` without smoothing or a damped stop, would, and is not right here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypedDict, Unpack, cast

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import Quantity, scalar, whole
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import OK, reason
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model
from bcfj_jax.solve.integrate import Problem, code_of, controller, integrate, problem, seeker
from bcfj_jax.solve.plan import Plan, Solving, SolvingKeys, plan
from bcfj_jax.solve.sdirk import Sdirk
from bcfj_jax.solve.tangents import SdirkTangents
from bcfj_jax.xla.diffrax_loop import shortened

_TIMES = (
    Quantity("interval", "s", "time after which the tangent is shortened", 0.0, open_low=True),
    Quantity("settle", "s", "time until the start is forgotten", 0.0),
)
Step = Callable[[Any], Any]
Field = Callable[[Array, Array], Array]


class Exponent(NamedTuple):
    """A largest Lyapunov exponent and how it came about.

    Attributes:
        value: [1/s], or per iteration where the interval is 1; NaN where the orbit failed.
        standard_error: of the value, by batch means; NaN for fewer than 2 batches.
        history: (N,) the estimate after each step, to be looked at for convergence.
        growth: (N,) logarithm of the tangent's growth in each step.
        interval: duration of a step [s], or 1.
        reason: why the orbit failed; "" for a good one.
    """

    value: float
    standard_error: float
    history: np.ndarray
    growth: np.ndarray
    interval: float
    reason: str = ""


def from_growth(growth: np.ndarray, interval: float, batches: int, reason: str = "") -> Exponent:
    """The exponent of logarithmic growths (N,) in steps of so long.

    Standard error by batch means (Law and Kelton, Simulation modeling and analysis, 9.5.3): growths of neighbouring
    steps are correlated, means of long batches hardly; s(means)/sqrt(batches).
    """
    mean = np.cumsum(growth) / np.arange(1, growth.size + 1) / interval
    size = growth.size // batches if batches else 0
    error = float("nan")
    if batches > 1 and size > 0 and np.isfinite(growth).all():
        # The first few are left out where the number does not divide.
        means = growth[growth.size - batches * size :].reshape(batches, size).mean(axis=1) / interval
        error = float(np.std(means, ddof=1) / np.sqrt(batches))
    return Exponent(float(mean[-1]), error, mean, growth, interval, reason)


class CountingKeys(TypedDict, total=False):
    """``Counting`` as keywords."""

    transients: int
    batches: int
    seed: int


@dataclass(frozen=True)
class Counting:
    """Settings of the mean that an exponent is: ``map_exponent`` explains them."""

    transients: int = 0
    batches: int = 20
    seed: int = 0


def counts(iterations: int, asked: Counting) -> tuple[int, int, int, int]:
    """The numbers that make a mean, as ``int``; ``InputError`` for no iterations, or more batches than iterations."""
    iterations = whole("iterations", iterations, most=limits.SAMPLES)
    transients = whole("transients", asked.transients, least=0, most=limits.SAMPLES)
    batches = whole("batches", asked.batches, least=0)
    if batches > iterations:
        raise InputError("batches", f"{batches} of {iterations} iterations", "give no more batches than iterations")
    return iterations, transients, batches, whole("seed", asked.seed, least=0)


@taking(Counting)
def map_exponent(
    step: Step, state: Any, iterations: int, *, interval: float = 1.0, **settings: Unpack[CountingKeys]
) -> Exponent:
    """Largest Lyapunov exponent of a differentiable map by its tangent.

    Args:
        step: state -> state, traceable and differentiable by ``jax.jvp``; any pytree of floats.
        state: where the orbit begins.
        iterations: so many count.
        transients: iterations before these, for orbit and tangent alike: the tangent turns to the direction that
            grows most while the orbit comes to its attractor.
        interval: time that a step stands for [s]; 1 gives the exponent per iteration.
        batches: for the standard error.
        seed: of the tangent's first direction.

    Returns:
        The exponent; -inf for a superstable orbit, whose tangent vanishes.

    Raises:
        InputError: ``counts``.
    """
    iterations, transients, batches, seed = counts(iterations, Counting(**settings))
    flat, start = _flat(step, state)
    growth = _renormalised(lambda y, w: jax.jvp(flat, (y,), (w,)), start, transients + iterations, seed)
    return from_growth(growth[transients:], interval, batches)


@taking(Counting)
def flow_exponent(
    field: Field, state: Any, intervals: int, *, interval: float, tolerance: float = 1e-7, max_steps: int = 100_000,
    **settings: Unpack[CountingKeys],
) -> Exponent:  # fmt: skip
    """Largest Lyapunov exponent [1/s] of a flow, state and tangent solved side by side by Tsit5.

        y' = f(t, y),   w' = (df/dy) w,

    with both in the error control: where the orbit comes to rest only the tangent says how long a step may be.

    Args:
        field: (t, y) -> dy/dt of an array; where it depends on time, for t from 0 to the interval, with a period that
            divides it.
        state: (n,) where the orbit begins.
        intervals: so many count; the tangent is brought back to length 1 after each; transients: so many before these.
        interval: [s].
        tolerance: local error per step, relative and absolute.
        max_steps: in an interval; beyond it the exponent is NaN.
        batches, seed: as ``map_exponent``.

    Raises:
        InputError: ``counts``.
    """
    intervals, transients, batches, seed = counts(intervals, Counting(**settings))

    def both(t: Array, rows: Array) -> Array:
        return jnp.stack(jax.jvp(lambda y: field(t, y), (rows[0],), (rows[1],)))

    step = flow_step(both, interval, tolerance, max_steps)

    def along(y: Array, w: Array) -> tuple[Array, Array]:
        found = step(jnp.stack([y, w]))
        return found[0], found[1]

    growth = _renormalised(along, jnp.asarray(state, float), transients + intervals, seed)[transients:]
    return from_growth(growth, interval, batches, "" if np.isfinite(growth).all() else "the flow could not be solved")


def _flat(step: Step, state: Any) -> tuple[Callable[[Array], Array], Array]:
    """A map of pytrees as one of arrays (n,), and where it begins."""
    start, rebuild = ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, float), state))
    return lambda y: ravel_pytree(step(rebuild(y)))[0], start


def _grown(once: Callable, carry: tuple, iterations: int) -> np.ndarray:
    """Logarithms of the growth in each step."""
    return np.asarray(jax.jit(lambda carry: jax.lax.scan(once, carry, None, iterations)[1])(carry))


def _renormalised(along: Callable[[Array, Array], Any], start: Array, iterations: int, seed: int) -> np.ndarray:
    """Logarithms of a tangent's growth over each step."""

    def once(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        y, w = along(*carry)
        size = jnp.linalg.norm(w)
        return (y, w / jnp.where(size > 0.0, size, 1.0)), jnp.log(size)

    w = jax.random.normal(jax.random.key(seed), start.shape)
    return _grown(once, (start, w / jnp.linalg.norm(w)), iterations)


@taking(Counting)
def two_trajectories(
    step: Step, state: Any, iterations: int, *, separation: float = 1e-7, scales: Any = 1.0, interval: float = 1.0,
    **settings: Unpack[CountingKeys],
) -> Exponent:  # fmt: skip
    """Largest Lyapunov exponent from two orbits, brought back to a separation after every step.

    Needs no derivative. The separation must be far above what the step itself gets wrong between two neighbours (an
    adaptive solver chooses other steps for each: its tolerance) and far below the attractor's size.

    Args:
        separation: rms distance of the two, in units of the scales.
        scales: size of each state, an array like the flattened state or one number; 0 for what both have in common,
            such as a time or the phase of a drive.
        step, state, iterations, transients, interval, batches, seed: as ``map_exponent``.

    Raises:
        InputError: ``counts``, or a separation that is not positive.
    """
    iterations, transients, batches, seed = counts(iterations, Counting(**settings))
    if not separation > 0.0:
        raise InputError("separation", f"{separation:g}", "give more than 0")
    flat, start = _flat(step, state)
    unit = jnp.broadcast_to(jnp.asarray(scales, float), start.shape)
    known = unit > 0.0

    def rms(w: Array) -> Array:
        return jnp.sqrt(jnp.sum(jnp.square(jnp.where(known, w / jnp.where(known, unit, 1.0), 0.0))) / jnp.sum(known))

    def once(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        y, apart = carry
        y, other = jax.lax.map(flat, jnp.stack([y, y + apart]))
        size = rms(other - y)
        # Two orbits that rounding has made one grow no more.
        again = jnp.where(known, other - y, 0.0) * (separation / jnp.where(size > 0.0, size, 1.0))
        return (y, again), jnp.log(size / separation)

    w = jax.random.normal(jax.random.key(seed), start.shape) * unit
    growth = _grown(once, (start, w * (separation / rms(w))), transients + iterations)
    return from_growth(growth[transients:], interval, batches)


def flow_step(field: Field, interval: float, tolerance: float = 1e-7, max_steps: int = 100_000) -> Step:
    """The map of a flow over an interval, y(0) -> y(interval), by Tsit5; for ``two_trajectories`` and diagrams.

    Derivatives go forward through it, but their own error is not controlled: for a tangent take ``flow_exponent``, which
    says what the arguments are. What cannot be solved is NaN.
    """
    max_steps = whole("max_steps", max_steps)

    def step(y: Array) -> Array:
        solution = dfx.diffeqsolve(
            dfx.ODETerm(lambda t, y, _: field(t, y)),  # pyright: ignore[reportArgumentType]
            dfx.Tsit5(), t0=0.0, t1=interval, dt0=None, y0=y, saveat=dfx.SaveAt(t1=True), adjoint=dfx.ForwardMode(),
            stepsize_controller=dfx.PIDController(rtol=tolerance, atol=tolerance), max_steps=max_steps, throw=False,
        )  # fmt: skip
        assert solution.ys is not None
        return jnp.where(solution.result == dfx.RESULTS.successful, solution.ys[0], jnp.nan)

    return step


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
    with shortened():
        solution = dfx.diffeqsolve(
            dfx.ODETerm(both.field),  # pyright: ignore[reportArgumentType]
            seeker(both, how), t0=begin, t1=end, dt0=jnp.minimum(both.first_step, end - begin), y0=rows, args=both.args,
            saveat=dfx.SaveAt(t1=True), stepsize_controller=controller(both, how), adjoint=dfx.ForwardMode(),
            max_steps=how.max_steps, throw=False,
        )  # fmt: skip
    assert solution.ys is not None
    found = solution.ys[0]
    return found, code_of(solution.result, found)
