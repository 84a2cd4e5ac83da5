"""The one place that decides solver, step control, output and failure handling.

Accuracy is stated as an error of the contact force in fractions of its peak; ``plan`` turns it into a
tolerance, ``integrate`` runs it. Which solver a model gets follows from its traits (docs/architecture.md).

Tsit5 and not Dopri8: Tsit5 evaluates the force at the end of a step and weighs it in the error estimate, so a
flight cannot end inside a surface unnoticed; Dopri8 does not, and was seen to fall through a bounce's
surface at tolerances of 1e-4 to 1e-6. Tangents through RODAS3 would carry the derivative of its Jacobian; those of a
prototype's Rosenbrock method reached 1e19 N.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.status import NOT_FINITE, OK, SOLVER, STEPS
from bcfj_jax.mechanism.channels import is_reading
from bcfj_jax.mechanism.model import AbstractModel, Continuous, Params, Solution, field
from bcfj_jax.solve import adjoint, bdf, named
from bcfj_jax.solve.extremes import named as by_name
from bcfj_jax.solve.landing import NEAR, Instants, Landing, bending, bristled, contacts, look
from bcfj_jax.solve.plan import Plan, Way
from bcfj_jax.solve.remembering import Remembering, at_touch, constant
from bcfj_jax.solve.rodas import Rodas
from bcfj_jax.solve.sdirk import Sdirk
from bcfj_jax.solve.seeking import Breaking, Limited, Seeker, Seeking, allowed_in
from bcfj_jax.solve.tangents import beside
from bcfj_jax.solve.wrapped import Watched
from bcfj_jax.xla.batched_jvp import lane_by_lane, still, together
from bcfj_jax.xla.diffrax_loop import shortened

_ADJOINTS = {"forward": dfx.ForwardMode(), "reverse": dfx.RecursiveCheckpointAdjoint()}

# Relative tolerance at rounding level, so that large positions do not cause rejections.
_ROUNDING = 4e-16
# Of explicit runs, a share of their length.
_ROUNDED = 1e-20
# Of stiff models, whose steps begin short and may be rejected many times: length [s] below which a run has failed.
_SHORTEST = 1e-15
# Share of a random direction's tangent to which its error is relative. At 0.01 a gradient by 100 parameters of a joint with
# window ends is 1.7 % off at a tolerance of 1e-4, at 0.001 0.22 %, in a third more steps (benchmarks/models/joint_gradient.py).
_LEAST = 0.001
# Of what is asked, the tolerance of stiff models' reverse runs (benchmarks/models/joint_gradient.py): of which parameters
# derivatives will be asked for is not known, and loose steps end at order 2.
_REVERSE = 0.1
# Force error at most of a stiff model's derivatives where approach speeds are remembered.
_REMEMBERED = 1e-4
# Share of a run that a step may take where no error weighs a contact's force (``AbstractModel.unweighed``).
_UNWEIGHED = 1e-3
# Proportional and integral gain of the step control.
_GAINS = {True: (0.4, 0.3), False: (0.2, 0.5)}


def _safe_norm(scaled_error: Array) -> Array:
    """RMS norm in which NaN counts as infinite: a plain norm makes the controller reject for ever."""
    norm = jnp.sqrt(jnp.mean(jnp.square(scaled_error)))
    return jnp.where(jnp.isfinite(norm), norm, jnp.inf)


class Problem(NamedTuple):
    """A model with its parameters as diffrax takes it.

    Attributes:
        args: (model, what it has prepared).
        gains: proportional and integral, of the step control.
        longest: length of a step at most [s]; ``breaks``: times (B,) at which steps end, sorted [s], or None.
        seeks: whether steps are looked at for contacts that they hide (``seeking``); ``unsure``: and between their ends.
    """

    field: Callable
    args: Any
    start: Array
    scales: Array
    first_step: Array
    shortest_step: Any
    gains: tuple[float, float]
    solver: dfx.AbstractSolver
    longest: Array
    breaks: Array | None
    seeks: bool
    unsure: bool
    stiff: bool
    norm: Callable[[Array], Array] = _safe_norm


def problem(model: AbstractModel, params: Params, end: Array, how: Plan, differentiable: bool) -> Problem:
    """A model with a history, to be solved until ``end`` [s]."""
    stiff, params = model.traits.stiff, model.completed(params)
    prepared, start = model.prepare(params), model.initial_state(params)
    scales = jax.lax.stop_gradient(model.error_scale(params, end))
    first = jnp.asarray(model.first_step(params, scales), dtype=jnp.float64)
    # Parameters that are not finite then fail in some twenty attempts, and no run of a batch waits for theirs.
    scales = jnp.where(jnp.isfinite(scales), scales, 1.0)
    first = jnp.where(jnp.isfinite(first), first, 1e-2 * jax.lax.stop_gradient(end))
    gains = _GAINS[stiff]
    longest = jnp.minimum(how.longest, jnp.inf if model.longest_step is None else model.longest_step)
    if model.unweighed:
        longest = jnp.minimum(longest, _UNWEIGHED * jax.lax.stop_gradient(end))
    limits = longest, model.breaks(params, end), model.shows_proximity, model.unsure, stiff
    if not stiff:
        solver = getattr(dfx, named.NOT_STIFF[how.solver or "tsit5"])()
        if isinstance(solver, dfx.AbstractImplicitSolver):
            # Of a step control of our own diffrax does not take over the tolerances.
            atol: Any = how.tolerance * scales
            finder = dfx.VeryChord(rtol=_ROUNDING, atol=atol, norm=_safe_norm)
            solver = eqx.tree_at(lambda s: s.root_finder, solver, finder)
        shortest = _ROUNDED * jnp.maximum(jax.lax.stop_gradient(end), first)
        return Problem(field, (model, prepared), start, scales, first, shortest, gains, solver, *limits)
    last = jax.lax.stop_gradient(end)
    first = jnp.where(last > 0, jnp.minimum(first, 1e-2 * last), first)
    structure, implicit = model.structure(), differentiable or how.solver in ("sdirk2", "bdf")
    solver = Sdirk(structure, how.tolerance * scales) if implicit else Rodas(structure)
    return Problem(structure.field, (model, prepared), start, scales, first, _SHORTEST, gains, solver, *limits)


def integrate(
    model: AbstractModel, params: Params, times: Array, how: Plan, mode: Way = "forward",
    differentiable: bool | Literal["whole"] = False,
) -> Solution:  # fmt: skip
    """Integrate from time 0 and return the states at ``times`` (a time before 0 reads the initial state).

    Pure: jit, vmap, and the derivatives of one ``mode`` go through; those of a stiff model only where
    ``differentiable`` asks for the solver that is meant for them. Never raises for a failed run: its states are NaN
    from there on and ``code`` says why. "whole" is differentiable, and asks for what is
    of the continuous curves of an explicit run as well (``Continuous``).

    Raises:
        InputError: for derivatives by a solver that has none, and for a model that is not chosen yet.
    """
    times, traits = jnp.maximum(times, 0.0), model.traits
    if traits.open:
        names = ", ".join(level.name for level in model.coarser())
        remedy = f"give one of {names}; only simulate can choose, and its run names the choice"
        raise InputError(
            f"scene '{model.kind}' fidelity", f"'{model.title}' leaves the choice of the model open", remedy
        )
    if not traits.history:
        return model.instants(params, times)[0]
    if differentiable and how.solver in named.VALUES_ONLY:
        raise InputError("solver", f"'{how.solver}' has no derivatives", "leave it out, or take sdirk2 or bdf")
    posed = problem(model, params, times[-1], how, bool(differentiable))
    if traits.stiff and differentiable:
        if mode == "forward":
            return _with_tangents(posed, times, how)
        if at_touch(model) is not None:
            return _by_directions(posed, times, how)
        return _with_adjoint(posed, _anywhere(model, params) if how.tangents else None, times, how)
    if traits.stiff and how.solver == "bdf" and not differentiable:
        assert isinstance(posed.solver, Sdirk)
        found = _by_bdf(posed, posed.solver, None, posed.start[None], times, how)
        return found._replace(states=found.states[:, 0])
    if differentiable and (model.contacts or model.corners):
        return _with_landing(posed, times, how, mode, differentiable == "whole" and bool(model.contacts))
    return _solved(posed, times, how, mode)


def landed(model: AbstractModel, params: Params, times: Array, how: Plan, most: int) -> tuple[Solution, Instants]:
    """States at ``times`` of a run that lands on its contacts (``landing``), and the first ``most`` contacts of a channel.

    Pure; ``jvp`` and ``jacfwd`` go through. Of a model that is not stiff and has a history; times (T,) [s] do not decrease, and
    the steps depend on their end alone.
    """
    return _landed(problem(model, params, times[-1], how, True), times, how, most, "forward")


def _landed(
    problem: Problem, times: Array, how: Plan, most: int, mode: Way, whole: bool = False
) -> tuple[Solution, Instants]:
    (model, _), near, size = problem.args, NEAR * how.tolerance * problem.scales[0], problem.start.size
    channels = sum(max(1, count) for count in model.members.values())
    if whole:
        problem = _with_integrals(problem, channels)
    if model.remembered:
        field = constant(problem.field, model.remembered)
        problem = problem._replace(field=field, solver=Remembering(looped(problem.solver, mode), near, size))
    corners = len(bending(model))
    if corners:
        # As much a share of the speed to expect as of the penetration (``first_step``).
        speeds = jnp.full(corners, 1e-2 / problem.first_step)
        others = channels + len(model.remembered) + model.corners + len(bristled(model))
        near = near * jnp.concatenate([jnp.ones(others), speeds])
    since = jax.lax.stop_gradient(times[0]) if whole else None
    control = controller(problem, how, lambda inner: Landing(inner, near, most, size, since))
    end, memory = _by_diffrax(problem, times, how, mode, control, memory=True)
    memory = memory if problem.breaks is None else memory[0]
    if whole:
        impulse, work = (end.states[-1] - end.states[0])[size:].reshape(2, channels)
        _, time, state, before, after = jax.tree.map(lambda x: x[:, :channels], memory.tops)
        end = end._replace(states=end.states[:, :size], whole=Continuous(time, state, before, after, impulse, work))
    return end, contacts(memory, channels)


def _with_integrals(problem: Problem, channels: int) -> Problem:
    """With the integrals of every channel's force by time and penetration behind the states; they have no say in the steps."""
    size, field, norm, model = problem.start.size, problem.field, problem.norm, problem.args[0]
    # A contact's integrals are of the force's size, those of a reading in a contact's place keep its sign.
    signed = np.array([is_reading(c.name) for c in model.contacts for _ in range(max(1, model.members[c.name]))])

    def more(t: Any, y: Array, args: tuple[AbstractModel, Any]) -> Array:
        seen = look(args[0], t, y[:size], args[1])
        pushed = jnp.where(signed, seen.force, jnp.abs(seen.force))
        return jnp.concatenate([field(t, y[:size], args), pushed, pushed * seen.rate])

    start, scales = (
        jnp.concatenate([x, jnp.full(2 * channels, y)]) for x, y in ((problem.start, 0.0), (problem.scales, 1.0))
    )
    solver: Any = problem.solver
    if isinstance(solver, dfx.AbstractImplicitSolver):
        # Nor in the convergence of its stages.
        atol = jnp.concatenate([solver.root_finder.atol, jnp.full(2 * channels, jnp.inf)])
        solver = replace(solver, root_finder=replace(solver.root_finder, atol=atol, norm=lambda e: norm(e[:size])))
    return problem._replace(
        field=more, start=start, scales=scales, norm=lambda errors: norm(errors[:size]), solver=solver
    )


def _with_landing(problem: Problem, times: Array, how: Plan, mode: Way, whole: bool) -> Solution:
    """An explicit run that lands on its contacts where it is differentiated, and does not where only values are wanted."""
    if mode == "reverse":
        return _landed(problem, times, how, 1, mode, whole)[0]
    arrays, static = eqx.partition((problem, times, how), eqx.is_array)

    def landed(arrays: Any) -> Solution:
        problem, times, how = eqx.combine(arrays, static)
        return _landed(problem, times, how, 1, mode, whole)[0]

    @jax.custom_jvp
    def run(arrays: Any) -> Solution:
        problem, times, how = eqx.combine(arrays, static)
        found = _solved(problem, times, how, mode)
        return found._replace(whole=unknown(jax.eval_shape(landed, arrays).whole))

    run.defjvp(lambda primals, tangents: jax.jvp(landed, primals, tangents))
    return run(arrays)


def unknown(shapes: Any) -> Any:
    """NaN of given shapes."""
    return jax.tree.map(lambda x: jnp.full(x.shape, jnp.nan), shapes)


def seeker(problem: Problem, how: Plan) -> Any:
    """The problem's solver, which looks for contacts within each step where the model shows them (``seeking``)."""
    solver: Any = Watched(problem.solver) if how.extremes else problem.solver  # pyright: ignore[reportArgumentType]
    if not problem.seeks:
        return solver
    near = (how.tolerance * problem.scales)[0]
    # Dopri8 weighs no force at the end of a step in its error.
    blind = isinstance(problem.solver, dfx.Dopri8)
    return Seeker(solver, problem.scales, near, problem.norm, problem.unsure, blind)


def limits(problem: Problem, solver: Sdirk) -> bdf.Limits:
    """What ends steps of BDF beside their errors."""
    model, prepared = problem.args
    find = allowed_in(model, prepared, solver.tolerance[0]) if problem.seeks else None
    return bdf.Limits(problem.longest, problem.breaks, find)


def controller(problem: Problem, how: Plan, landing: Callable[[Any], Any] | None = None) -> Any:
    """How steps are chosen: by their errors, for no hidden contact, to end on contacts by ``landing``, and to end at breaks.

    Breaks stay where they are as a landing moves with the parameters, so that they have the last word.
    """
    control: dfx.AbstractStepSizeController = _by_errors(problem, how)
    control = control if problem.stiff else Limited(control, problem.longest, problem.shortest_step)
    control = Seeking(control) if problem.seeks else control
    control = control if landing is None else landing(control)
    return control if problem.breaks is None else Breaking(control, problem.breaks)


def _by_errors(problem: Problem, how: Plan) -> dfx.PIDController:
    return dfx.PIDController(
        rtol=_ROUNDING,
        atol=how.tolerance * problem.scales,
        pcoeff=problem.gains[0],
        icoeff=problem.gains[1],
        norm=problem.norm,
        dtmin=problem.shortest_step if problem.stiff else None,
        dtmax=problem.longest if problem.stiff else None,
        force_dtmin=False,
    )


def looped(solver: Any, mode: Way) -> Any:
    """A solver whose stages are a plain loop in forward mode, as diffrax makes it of one that nothing is wrapped around."""
    return replace(solver, scan_kind="lax") if mode == "forward" and hasattr(solver, "scan_kind") else solver


def _solved(problem: Problem, times: Array, how: Plan, mode: Way) -> Solution:
    return _by_diffrax(problem, times, how, mode, controller(problem, how))[0]


def _by_diffrax(
    problem: Problem, times: Array, how: Plan, mode: Way, control: dfx.AbstractStepSizeController, memory: bool = False
) -> tuple[Solution, Any]:
    """What diffrax finds with a step control, and, where its ``memory`` is asked for, what the control knows at the end."""
    problem = problem._replace(solver=looped(problem.solver, mode))
    kept = dfx.SaveAt(
        subs=(dfx.SubSaveAt(ts=times), dfx.SubSaveAt(t1=True)), solver_state=how.extremes, controller_state=memory
    )
    with shortened():
        solution = dfx.diffeqsolve(
            dfx.ODETerm(problem.field),  # pyright: ignore[reportArgumentType]
            seeker(problem, how),
            t0=0.0,
            t1=jnp.where(times[-1] > 0.0, times[-1], problem.first_step),
            dt0=problem.first_step,
            y0=problem.start,
            args=problem.args,
            saveat=kept,
            stepsize_controller=control,
            adjoint=_ADJOINTS[mode],
            max_steps=how.max_steps,
            throw=False,
        )
    assert solution.ys is not None
    assert solution.ts is not None
    states, _ = solution.ys
    states = jnp.where(jnp.isfinite(states), states, jnp.nan)
    accepted, rejected = (solution.stats[f"num_{name}_steps"] for name in ("accepted", "rejected"))
    known: Any = solution.solver_state
    extremes = totals = None
    if how.extremes and known is not None:
        extremes, totals = by_name(times[0], problem.start, problem.args, (known[0] if problem.seeks else known)[-1])
    ended = Solution(states, code_of(solution.result, states), solution.ts[1][0], accepted, rejected, extremes, totals)
    return ended, solution.controller_state


def code_of(result: dfx.RESULTS, states: Array) -> Array:
    """The code of a diffrax run that ended so, with these states."""
    good = jnp.where(jnp.all(jnp.isfinite(states)), OK, NOT_FINITE)
    stopped = jnp.where(result == dfx.RESULTS.max_steps_reached, STEPS, SOLVER)
    return jnp.where(result == dfx.RESULTS.successful, good, stopped)


def _by_bdf(problem: Problem, solver: Sdirk, changes: tuple | None, start: Array, times: Array, how: Plan) -> Solution:
    """Rows (T, 1 + k, n) of state and tangents, both in the step control.

    Runs of a batch are solved one after the other: together they would make a matrix in every round for each of them,
    and go through all that a rejected step, a change of order and an output take, whether they need it or not.
    """
    arrays, static = eqx.partition((problem, solver, changes, start, times, how), eqx.is_array)

    def run(arrays: Any, _: tuple) -> Solution:
        problem, solver, changes, start, times, how = eqx.combine(arrays, static)
        steps = bdf.Steps(how.max_steps, limits=limits(problem, solver), memory=at_touch(problem.args[0]))
        found = bdf.solve(of_rows(problem, solver, changes, start), times, steps)
        return ended(found, times, how)

    return lane_by_lane(run)(arrays, ())


def of_rows(problem: Problem, solver: Sdirk, changes: tuple | None, start: Array) -> bdf.Posed:
    """The problem of a stiff model, with k changes of its arguments, as BDF takes it from rows (1 + k, n)."""
    return bdf.Posed(solver, problem.args, changes, start, problem.scales, problem.first_step, problem.shortest_step)


def ended(found: bdf.Found, times: Array, how: Plan) -> Solution:
    """What BDF found, and how it ended."""
    stopped = jnp.where(found.accepted + found.rejected < how.max_steps, SOLVER, STEPS)
    complete = jnp.where(jnp.all(jnp.isfinite(found.rows)), OK, NOT_FINITE)
    code = jnp.where(found.end < times[-1], stopped, complete)
    return Solution(found.rows, code, jnp.minimum(found.end, times[-1]), found.accepted, found.rejected)


def posed_at(problem: Problem, x: tuple) -> tuple[Problem, Sdirk]:
    """The problem of a stiff model with arrays in place of its own, and its solver."""
    c, start, scales, first, longest, breaks, tolerance = x
    assert isinstance(problem.solver, Sdirk)
    solver = Sdirk(problem.solver.structure, tolerance * scales)
    made = problem._replace(
        args=(problem.args[0], c), start=start, scales=scales, first_step=first, longest=longest, breaks=breaks,
        solver=solver,
    )  # fmt: skip
    return made, solver


def fixed_in(problem: Problem, tolerance: Array) -> tuple:
    """Arrays of a problem that are not differentiated, in the order of ``posed_at``."""
    return problem.scales, problem.first_step, problem.longest, problem.breaks, tolerance


def _anywhere(model: AbstractModel, params: Params) -> tuple[Any, Array]:
    """Tangents of what is prepared and of the start, along one fixed random direction of all parameters.

    Each by its own size; one that is 0 has none. What is not known beforehand, of which parameters reverse derivatives
    will be asked for, is thereby in the step control.
    """
    shares = np.random.default_rng(0).normal(size=len(params))
    way = {name: jnp.abs(params[name]) * share for name, share in zip(sorted(params), shares, strict=True)}
    ahead = jax.jvp(lambda p: (model.prepare(p), model.initial_state(p)), (dict(params),), (way,))[1]
    by_args, by_start = jax.tree.map(lambda d: None if d.dtype == jax.dtypes.float0 else d[None], ahead)
    return jax.lax.stop_gradient((by_args, by_start))


def _with_adjoint(problem: Problem, ahead: tuple[Any, Array] | None, times: Array, how: Plan) -> Solution:
    """A run whose reverse derivatives are those of its own steps (``solve.adjoint``); ``ahead`` counts in their control.

    Without, orders end at 2: loose steps must damp (``solve.plan``), and orders above 2 are not A-stable. The tolerance
    is ``_REVERSE`` of what is asked.
    """
    model, _ = problem.args

    def run(x: tuple, aside: tuple) -> tuple[Solution, Any]:
        (c, start, times), (fixed, ahead) = x, aside
        made, solver = posed_at(problem, (c, start, *fixed))
        by_args, by_start = (None, jnp.zeros((0, start.size))) if ahead is None else ahead
        rows = jnp.concatenate([start[None], by_start])
        plain = ahead is None
        steps = bdf.Steps(
            how.max_steps, 2 if plain else bdf.ORDERS, _LEAST, min(adjoint.SEGMENT[not plain], how.max_steps),
            limits=limits(made, solver),
        )  # fmt: skip
        found = bdf.solve(of_rows(made, solver, None if plain else (model, by_args), rows), times, steps)
        solution = ended(found, times, how)
        return solution._replace(states=solution.states[:, 0]), found.record

    def back(x: tuple, aside: tuple, record: Any, solution: Solution, cotangents: Array) -> tuple:
        (c, start, times), (fixed, _) = x, aside
        made, solver = posed_at(problem, (c, start, *fixed))
        (_, by_args), by_start = adjoint.pulled(solver, made.args, record, solution.accepted, times, cotangents)
        slopes = jax.vmap(lambda t, y: made.field(t, y, made.args))(times, solution.states)
        return by_args, by_start, jnp.sum(cotangents * slopes, axis=1)

    @jax.custom_vjp
    def solution(x: tuple, aside: tuple) -> Solution:
        return recorded(x, aside)[0]

    def forth(x: tuple, aside: tuple) -> tuple[Solution, tuple]:
        found, record = recorded(x, aside)
        return found, (x, aside, record, found)

    def transposed(kept: tuple, cotangents: Solution) -> tuple:
        x, aside, *_ = kept
        by_args, *rest = backward(*kept, cotangents.states)
        return (eqx.combine(by_args, jax.tree.map(still, x[0])), *rest), jax.tree.map(still, aside)

    recorded, backward = lane_by_lane(run), lane_by_lane(back)
    solution.defvjp(forth, transposed)
    fixed = fixed_in(problem, _REVERSE * how.tolerance)
    return solution((problem.args[1], problem.start, times), (fixed, ahead))


def _by_directions(problem: Problem, times: Array, how: Plan) -> Solution:
    """Reverse derivatives by forward tangents in all directions: what is set at a touch has no place in a record of steps."""
    (model, prepared), start = problem.args, problem.start
    how = replace(how, tolerance=jnp.minimum(how.tolerance, model.tolerance(_REMEMBERED)))
    moving, fixed = eqx.partition((prepared, start), eqx.is_inexact_array)
    flat, restored = jax.flatten_util.ravel_pytree(moving)

    arrays, static = eqx.partition((problem, times, how, fixed), eqx.is_array)

    def states(flat: Array, arrays: Any) -> tuple[Array, Solution]:
        problem, times, how, fixed = eqx.combine(arrays, static)
        prepared, start = eqx.combine(restored(flat), fixed)
        found = _with_tangents(problem._replace(args=(model, prepared), start=start), times, how)
        return found.states, found

    @jax.custom_vjp
    def solution(flat: Array, arrays: Any) -> Solution:
        return states(flat, arrays)[1]

    def forth(flat: Array, arrays: Any) -> tuple[Solution, tuple]:
        # By shares: where the tangents' error is controlled, what is small is an effect of 100 %.
        sizes = jnp.where(flat == 0.0, 1.0, jnp.abs(flat))
        slopes, found = jax.jacfwd(lambda x: states(flat + sizes * x, arrays), has_aux=True)(jnp.zeros_like(flat))
        return found, (slopes / sizes, arrays)

    def back(kept: tuple, cotangents: Solution) -> tuple:
        slopes, arrays = kept
        return jnp.tensordot(cotangents.states, slopes, axes=2), jax.tree.map(still, arrays)

    solution.defvjp(forth, back)
    return solution(flat, jax.lax.stop_gradient(arrays))


def _with_tangents(problem: Problem, times: Array, how: Plan) -> Solution:
    """A run whose forward tangents are solved beside it (``solve.tangents``)."""
    model, _ = problem.args
    # What is remembered of a touch has its derivative from BDF alone, whose tangents are good at tight tolerances.
    controlled = how.tangents or at_touch(model) is not None
    if not how.tangents and controlled:
        how = replace(how, tolerance=jnp.minimum(how.tolerance, model.tolerance(_REMEMBERED)))

    def of(x: tuple) -> tuple[Problem, Sdirk, Array, Plan]:
        c, start, times, *fixed = x
        return *posed_at(problem, (c, start, *fixed)), times, Plan(fixed[-1], how.max_steps)

    def value(x: tuple) -> tuple[Array, tuple]:
        made, _, times, how = of(x)
        states, *rest = _solved(made, times, how, "forward")
        return states, tuple(rest)

    def ahead(x: tuple, changes: tuple) -> tuple[tuple[Array, tuple], Array]:
        made, solver, times, how = of(x)
        by_args, by_start, by_times, *_ = changes
        count = jax.tree.leaves(changes)[0].shape[0]
        by_start = jnp.zeros((count, made.start.size)) if by_start is None else by_start
        start = jnp.concatenate([made.start[None], by_start])
        if controlled:
            found, *rest = _by_bdf(made, solver, (model, by_args), start, times, how)
        else:
            found, *rest = _solved(beside(made, (model, by_args), start), times, how, "forward")
        states, moved = found[:, 0], jnp.moveaxis(found[:, 1:], 1, 0)
        if by_times is not None:
            moved = moved + by_times[:, :, None] * jax.vmap(lambda t, y: made.field(t, y, made.args))(times, states)
        return (states, tuple(rest)), moved

    x = (*problem.args[1:], problem.start, times, *fixed_in(problem, how.tolerance))
    states, rest = together(value, ahead)(x)
    return Solution(states, *rest)
