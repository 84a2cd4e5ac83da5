"""The public verbs: ``force_history`` (pure, differentiable) and ``simulate`` (a run with its story)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from bcfj_jax.core import presented
from bcfj_jax.core.errors import InputError, quoted, texts
from bcfj_jax.core.quantities import increasing, instants, scalar
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import NO_FORCE, OK, reason
from bcfj_jax.mechanism import channels, inputs
from bcfj_jax.mechanism.channels import Channel, channel
from bcfj_jax.mechanism.model import AbstractModel, Choice, Params, Reading, Solution, as_model
from bcfj_jax.mechanism.readings import contact_states
from bcfj_jax.solve.extremes import Totals
from bcfj_jax.solve.measured_error import Accuracy, measured
from bcfj_jax.solve.plan import LONGEST, LOOKS, Plan, Solving, SolvingKeys, Way, check_bits, force_error, plan
from bcfj_jax.xla.forward_reverse import forward_and_reverse, reverse_only
from bcfj_jax.xla.kept import kept
from bcfj_jax.xla.programs import make_room, program
from bcfj_jax.xla.threads import together

Mode = Literal["auto", "forward", "reverse"]


class Run(NamedTuple):
    """A finished simulation, as NumPy arrays; ``to_pandas()``, ``to_xarray()`` and ``plot()`` show them.

    Attributes:
        times: (T,) [s].
        force: per contact (T, 3): normal, axial, tangential force [N].
            Contacts that have k members (balls): (T, k, 3) here and (T, k) below.
        penetration, rate: per contact (T,): overlap [m] (negative: gap) and its rate [m/s].
        slip: per contact (T,): sliding speed [m/s]; empty for models that only approach.
        status: "ok", "failed", or "doubtful" where ``measure_error`` found that the run may have missed an event, or where
            a contact met another approach speed than it remembers (``mechanism.stepping``); a failed run is NaN from the
            failure on.
        reason, failure_time: why and from when on [s] it failed or is doubtful; "" and NaN for a good run.
        stats: steps accepted and rejected, tolerance, wall and compile seconds.
        state: per contact (T,): codes of ``readings.contact_state`` that count ``readings.STATES`` (apart, touching,
            creeping, sliding, stuck), -1 where the run failed; empty for a run that ``simulate`` did not make.
        trajectory: (T, n) the flat states themselves, as the model reads them; None likewise.
        choice: the level at which an ``open`` model was run, and why; None for every other model.
        accuracy: the error that was measured, where ``measure_error`` asked for it; None without.
        readings: by name (T,), or (T, k) over members, what ``read`` asked for (``mechanism.channels``).
        extremes: per contact peaks, impulse, work, number and times of contacts, found in the solver's steps
            (``solve.extremes.Extremes``), where ``resolved_peaks`` asked for them.
        totals: likewise by account of the model what must balance (``solve.extremes.Totals``).
    """

    times: Float[np.ndarray, " T"]
    force: dict[str, Float[np.ndarray, "T ... 3"]]
    penetration: dict[str, Float[np.ndarray, "T ..."]]
    rate: dict[str, Float[np.ndarray, "T ..."]]
    slip: dict[str, Float[np.ndarray, "T ..."]]
    status: str
    reason: str
    failure_time: float
    stats: dict[str, float]
    state: dict[str, Int[np.ndarray, "T ..."]] = {}
    trajectory: Float[np.ndarray, "T n"] | None = None
    choice: Choice | None = None
    accuracy: Accuracy | None = None
    readings: dict[str, Float[np.ndarray, "T ..."]] = {}
    extremes: dict[str, Any] = {}
    totals: dict[str, Any] = {}

    _view = "bcfj_jax.analysis.simulation.view"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot


def outcome(
    scene: AbstractModel, params: Params, times: Array, how: Plan, mode: Way, differentiable: bool = False
) -> tuple[Solution, dict[str, Reading]]:
    """States at the times as ``integrate`` gives them, and what every contact reads in them; arguments are its own."""
    from bcfj_jax.solve.integrate import integrate  # With diffrax, which a kept program does not need.

    params = scene.completed(params)
    solution = integrate(scene, params, times, how, mode, differentiable)
    return solution, readings(scene, params, times, solution.states)


def readings(model: AbstractModel, params: Params, times: Array, states: Array) -> dict[str, Reading]:
    """What every contact reads in states (T, n) at times (T,)."""
    # XLA would compute contacts that are alike anew for each of them.
    found = [
        jax.tree.map(kept, x) if len(names) > 1 else x
        for names, x in zip(model.alike, read(model, params, times, states), strict=True)
    ]
    return model.by_contact(found, axis=1)


def read(model: AbstractModel, params: Params, times: Array, states: Array) -> list[Reading]:
    """Likewise in the order of ``alike``, contacts that are alike side by side (T, k)."""
    prepared = model.prepare(params)
    return jax.vmap(lambda t, y: model.read(t, y, prepared))(jnp.maximum(times, 0.0), states)


# Compiled as one, and traced once a model, also where the caller compiles nothing.
@partial(jax.jit, static_argnums=(0, 1, 5))
def _forces(
    mode: Way, scene: AbstractModel, params: Params, times: Array, how: Plan, differentiable: bool
) -> dict[str, Array]:
    _, readings = outcome(scene, params, times, how, mode, differentiable)
    return {name: reading.force for name, reading in readings.items()}


def force_history(
    scene: AbstractModel,
    params: Params,
    times: Float[ArrayLike, " T"],
    *,
    accuracy: str | ArrayLike | Plan = "balanced",
    mode: Mode = "auto",
) -> dict[str, Float[Array, "T ... 3"]]:
    """Contact-force histories as a pure function of parameters and times.

    jit, vmap, pmap, shard_map, jvp, grad and second derivatives (hessian) go through. Step-size control is never
    differentiated. A run that is differentiated ends steps where contacts begin and end, and is as accurate as asked,
    derivatives too. A failed run is NaN from the failure on; so is then every loss built on it. A parameter out of its
    range raises ``InputError``, and under jit and vmap, where nothing can be raised, makes all of the run NaN.

    Args:
        scene: static structure.
        params: the scene's parameters, SI, from ``scene.parameters``.
        times: (T,) increasing [s]; the run starts at 0, and a time before 0 reads the initial state.
        accuracy: level, force error as a fraction of the peak, which may be traced, or a ``Plan`` (``bj.Plan``), whose
            tolerance may be.
        mode: "forward" (jvp, jacfwd: fastest for some 50 parameters; gradients and second derivatives are made of
            tangents), "reverse" (vjp, grad, no other; of a stiff model by BDF's own steps), or "auto": both, for one
            forward run more.

    Returns:
        Per contact (T, 3) [N], or (T, k, 3) where the contact has k members: normal, axial, tangential.
    """
    x, factor = _given(scene, params, times, accuracy)
    found = _differentiable(mode, lambda way, differentiable: lambda x: _forces(way, scene, *x, differentiable), x)
    return {name: force * factor for name, force in found.items()}


def _differentiable(mode: Mode, ways: Callable[[Way, bool], Callable[[Any], Any]], x: Any) -> Any:
    """``ways(way, differentiable)(x)`` of the way that a mode asks for, and an ``InputError`` for other derivatives."""
    if mode not in ("auto", "forward", "reverse"):
        raise InputError("mode", f"no mode {quoted(mode)}", "use auto, forward or reverse")
    # Among the devices of a shard_map or pmap, JAX has to be kept from looking into the steps.
    if mode == "reverse" and not jax.sharding.get_abstract_mesh().manual_axes:
        return ways("reverse", True)(reverse_only(x))
    back = None if mode == "forward" else ways("reverse", True)
    return forward_and_reverse(ways("forward", True), back, ways("forward", mode == "forward"))(x)


def reading_history(
    scene: AbstractModel,
    params: Params,
    times: Float[ArrayLike, " T"],
    read: Sequence[str],
    *,
    accuracy: str | ArrayLike | Plan = "balanced",
    mode: Literal["forward", "reverse"] = "forward",
) -> dict[str, Float[Array, "T ..."]]:
    """Histories of any readings (``mechanism.channels``) as a pure function of parameters and times.

    Args:
        scene, params, times, accuracy: as ``force_history``.
        read: names such as "slider.acceleration.x" or "journal.force.x in rod".
        mode: "forward" (jvp, jacfwd) or "reverse" (vjp, grad).

    Returns:
        By name (T,), or (T, k) over members, SI.

    Raises:
        InputError: for a reading that the model has not, with the nearest that it has.
    """
    x, factor = _given(scene, params, times, accuracy)
    wanted = _channels(scene, read)
    if mode == "auto":
        raise InputError("mode", "'auto' is of force_history alone", "use forward or reverse")
    found = _differentiable(mode, lambda way, _: lambda x: _histories(way, scene, *x, wanted), x)
    return {name: value * factor for name, value in found.items()}


@partial(jax.jit, static_argnums=(0, 1, 5))
def _histories(
    mode: Way, scene: AbstractModel, params: Params, times: Array, how: Plan, wanted: tuple[Channel, ...]
) -> dict[str, Array]:
    from bcfj_jax.solve.integrate import integrate

    params = scene.completed(params)
    return channels.histories(scene, params, times, integrate(scene, params, times, how, mode, True).states, wanted)


def _given(
    scene: AbstractModel, params: Params, times: ArrayLike, accuracy: str | ArrayLike | Plan
) -> tuple[tuple[dict[str, Array], Array, Plan], ArrayLike]:
    """What a pure function was given, checked where it is concrete, and what it is multiplied by (``inputs.poison``)."""
    make_room()
    how = accuracy if isinstance(accuracy, Plan) else plan(as_model(scene), accuracy)
    found = inputs.parameters(as_model(scene), params)
    factor = inputs.poison(scene, found)
    return ({name: jnp.asarray(value) * factor for name, value in found.items()}, instants(times), how), factor


def _channels(scene: AbstractModel, read: Sequence[str]) -> tuple[Channel, ...]:
    return tuple(channel(name, scene) for name in texts("read", read, 'name readings, such as "contact.normal"'))


def _run(
    scene: AbstractModel, wanted: tuple[Channel, ...], params: Params, times: Array, how: Plan
) -> tuple[Solution, list[Reading], dict[str, Array]]:
    from bcfj_jax.solve.integrate import integrate  # With diffrax, which a kept program does not need.

    solution = integrate(scene, params, times, how, "forward")
    found = read(scene, params, times, solution.states)
    more = channels.histories(scene, params, times, solution.states, wanted) if wanted else {}
    return solution, found, more


class RunningKeys(SolvingKeys, total=False):
    """``Running`` as keywords."""

    solver: str | None
    measure_error: bool
    read: Sequence[str]
    resolved_peaks: bool
    longest_step: float | str | None


@dataclass(frozen=True)
class Running(Solving):
    """Settings of ``simulate``."""

    solver: str | None = None
    measure_error: bool = False
    read: Sequence[str] = ()
    resolved_peaks: bool = False
    longest_step: float | str | None = None


@taking(Running)
def simulate(
    scene: AbstractModel, params: Params, times: Float[ArrayLike, " T"], **settings: Unpack[RunningKeys]
) -> Run:
    """Simulate a model and say how it went.

    Compiles once per model and number of times; new parameter values, times and accuracies reuse it.

    Args:
        scene: the model; params, times, accuracy: as ``force_history``.
        max_steps: budget of attempted steps; beyond it the run fails with that reason.
        solver: a name of ``solve.named`` in place of the model's own.
        measure_error: run the same program again at a tenth of the tolerance, with no step longer than 1/200 of the run,
            and report how far the two runs are apart (``Run.accuracy``). Not of a model without a history, which takes
            no steps. Of a model without contacts it is the error of the readings.
        read: names of readings to keep beside the contacts' (``mechanism.channels``), such as "slider.acceleration.x".
        resolved_peaks: look at every contact in every step of the solver, so that peaks and impulses do not depend on the
            times asked for (``Run.extremes``), and sum up what must balance (``Run.totals``). Not of a model without a
            history, which takes no steps, and not by the solver bdf.
        longest_step: that the solver may take, [s] or a text such as "1 ms"; by default as long as its errors allow.

    Raises:
        InputError: for times that are not finite and increasing, an unknown accuracy or solver, a budget below 1, and
            a model that its own ``check`` refuses.
    """
    asked = Running(**settings)
    scene, params, values = ready(scene, params, times, asked.solver)
    tolerance = plan(scene, asked.accuracy, asked.max_steps, asked.solver).tolerance
    if scene.traits.open:
        run = lambda level, at: simulate(level, params, at, **settings)  # noqa: E731
        return scene.choose(params, values, force_error(asked.accuracy), run)
    # Values alone: one program, whether or not derivatives would need their own error controlled.
    wanted = _channels(scene, asked.read)
    looked = asked.resolved_peaks and scene.traits.history
    if looked and asked.solver == "bdf":
        raise InputError("resolved_peaks", "with the solver 'bdf'", "leave the solver out, or take rodas3 or sdirk2")
    longest = np.inf if asked.longest_step is None else scalar("simulate", LONGEST, asked.longest_step)
    # What the run steps over, the one that checks it must not step over likewise.
    other = np.minimum(longest, max(float(values[-1]), 0.0) / LOOKS or np.inf)
    plans = (tolerance, longest), (0.1 * tolerance, other)
    as_asked, tenth = (
        Plan(t, asked.max_steps, solver=asked.solver, extremes=looked, longest=np.asarray(x)) for t, x in plans
    )
    if not (asked.measure_error and scene.traits.history):
        run = timed(scene, params, values, as_asked, wanted)
        return _doubtful(run, *scene.misremembered(params, run))
    run, finer = together(*(partial(timed, scene, params, values, how, wanted) for how in (as_asked, tenth)))
    found = measured(
        force_error(asked.accuracy), scene.settled_from(params), values, _compared(run), _compared(finer),
        (run.rate, finer.rate), tolerance=run.stats["tolerance"], wall_s=finer.stats["wall_s"],
    )  # fmt: skip
    run = _doubtful(_doubtful(run, *found.doubt), *scene.misremembered(params, run))
    return run._replace(accuracy=found)


def ready(
    scene: AbstractModel, params: Params, times: ArrayLike, solver: str | None = None
) -> tuple[AbstractModel, Params, np.ndarray]:
    """What a verb is given, checked: the model as it suits the run, its parameters, times (T,) [s]."""
    check_bits()
    values = increasing(times)
    params = inputs.parameters(as_model(scene), params, traced=False)
    scene.check(params)
    return scene.suited(params, float(values[-1]), solver), params, values


def _doubtful(run: Run, why: str, since: float) -> Run:
    """A run that is good but for a reason, from a time on [s]; "" for none."""
    good = run.status != "ok" or not why
    return run if good else run._replace(status="doubtful", reason=why, failure_time=since)


def _compared(run: Run) -> dict[str, np.ndarray]:
    """What an error is measured of: contact forces; readings of a model without contacts."""
    return run.force or {name: x[..., None] * [1.0, 0.0, 0.0] for name, x in run.readings.items()}


def compiled(
    scene: AbstractModel, params: Params, values: np.ndarray, how: Plan, wanted: tuple[Channel, ...] = ()
) -> tuple[Callable[..., Any], float]:
    """The program of a run, and the seconds [s] that getting it took."""
    return program("simulate", _run, (scene, wanted), (dict(params), np.asarray(values), how))


def timed(scene: AbstractModel, params: Params, values: np.ndarray, how: Plan, wanted: tuple[Channel, ...] = ()) -> Run:
    """A run as planned, at times (T,) [s], with the seconds it took; nothing is checked."""
    params = scene.completed(params)
    run_it, compile_s = compiled(scene, params, values, how, wanted)
    begin = time.perf_counter()
    solution, found, more = run_it(dict(params), np.asarray(values), how)
    walls = {"wall_s": time.perf_counter() - begin, "compile_s": compile_s}
    readings = scene.by_contact(found, axis=1)
    run = story(scene, values, solution, readings, how, walls)
    values_read = {c.name: np.asarray(more[c.name]) for c in wanted}
    states = contact_states(scene, params, readings)
    extremes = scene.by_contact(jax.tree.map(np.asarray, solution.extremes)) if solution.extremes else {}
    run = run._replace(totals={name: Totals(*rows) for name, rows in (solution.totals or {}).items()})
    return run._replace(state=states, trajectory=np.asarray(solution.states), readings=values_read, extremes=extremes)


def story(
    scene: AbstractModel,
    times: np.ndarray,
    solution: Solution,
    readings: dict[str, Reading],
    how: Plan,
    walls: dict[str, float],
) -> Run:
    """A run from what the program gave back, fetched to the host."""
    code, end = _finite(solution, readings, times)
    failed = code != OK
    # JAX gives dictionaries back in the order of their keys.
    readings = {contact.name: readings[contact.name] for contact in scene.contacts}
    return Run(
        times=times,
        force={name: np.asarray(r.force) for name, r in readings.items()},
        penetration={name: np.asarray(r.penetration) for name, r in readings.items()},
        rate={name: np.asarray(r.rate) for name, r in readings.items()},
        slip={name: np.asarray(r.slip) for name, r in readings.items() if r.slip is not None},
        status="failed" if failed else "ok",
        reason=reason(code, how.max_steps),
        failure_time=end if failed else float("nan"),
        stats={
            "accepted": int(solution.accepted),
            "rejected": int(solution.rejected),
            "tolerance": float(how.tolerance),
            **walls,
        },
    )


def _finite(solution: Solution, readings: dict[str, Reading], times: np.ndarray) -> tuple[int, float]:
    """Status code and end [s] of a run; a good one has finite forces at every time."""
    code, end = int(solution.code), float(solution.end)
    if code == OK:
        lost = np.zeros(len(times), bool)
        for reading in readings.values():
            lost |= ~np.isfinite(np.asarray(reading.force).reshape(len(times), -1)).all(axis=1)
        if lost.any():
            return NO_FORCE, float(times[np.argmax(lost)])
    return code, end
