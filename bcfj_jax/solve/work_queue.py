"""Many runs of one model at once, none waiting for another.

``vmap`` of an adaptive solve goes on until its slowest run ends. Here a batch has a fixed number of places, each in
its own run at its own time; a place whose run ends takes the next run from the queue within the same compiled loop, so
that places stand idle only at the very end. Solver and step control are those of ``integrate``; a run's steps do not
depend on the runs beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.status import NOT_FINITE, OK, SOLVER, STEPS
from bcfj_jax.mechanism.model import AbstractModel, Params, Solution
from bcfj_jax.solve.integrate import Problem, controller, problem, seeker
from bcfj_jax.solve.plan import Plan, Points
from bcfj_jax.solve.tangents import beside
from bcfj_jax.xla import backend
from bcfj_jax.xla.batched_jvp import changes

# Numbers that a place reads from a step in one round, and samples at least; for more the step is taken again.
_READ, _FEWEST = 128, 8
_GOING_ON = -1


class _Place(NamedTuple):
    """One place: the number of its run (that of all runs for none), the run's problem, and how far it is.

    ``broken``: whether its next step begins behind a break.
    """

    run: Array
    arrays: Any
    end: Array
    time: Array
    goal: Any
    broken: Array
    state: Array
    memory: Any
    control: Any
    sample: Array
    accepted: Array
    rejected: Array


class _Outcome(NamedTuple):
    """How the runs ended, (N,)."""

    code: Array
    end: Array
    accepted: Array
    rejected: Array


class _Queue(NamedTuple):
    """N runs and how they are solved: what ``integrate_queue`` takes, and what of the runs' problems is no array."""

    model: AbstractModel
    points: Points
    how: Plan
    count: Array
    places: int
    wrt: Sequence[str]
    static: Any = None
    shape: tuple[int, ...] = ()

    @property
    def total(self) -> int:
        """N."""
        return self.points.ends.size

    @property
    def read(self) -> int:
        """Samples that a place reads from a step in one round."""
        return max(_FEWEST, _READ // math.prod(self.shape))

    def known(self) -> _Queue:
        """With what of the first run's problem is no array, which is all runs' alike, and the shape of its state."""
        shapes = eqx.filter_eval_shape(self.pose, self.points.one(0), self.points.ends[0])
        static = eqx.partition(shapes, lambda x: isinstance(x, jax.ShapeDtypeStruct))[1]
        return self._replace(static=static, shape=shapes.start.shape)

    def pose(self, params: Params, end: Array) -> Problem:
        """A run's problem."""
        model, wrt = self.model, self.wrt
        posed = problem(model, params, end, self.how, bool(wrt))
        if not wrt:
            return posed

        def at(shares: Array) -> tuple:
            moved = {**params, **shifted(params, wrt, shares)}
            return model.prepare(moved), model.initial_state(moved)

        by_args, by_start = changes(at, jnp.zeros(len(wrt)))
        by_start = jnp.zeros((len(wrt), posed.start.size)) if by_start is None else by_start
        return beside(posed, (model, by_args), jnp.concatenate([posed.start[None], by_start]))

    def due(self, end: Array, sample: Array) -> Array:
        """Time of a sample [s]; infinity for those that are no more."""
        rows = self.points.grid.size
        return jnp.where(sample < rows, end * self.points.grid[jnp.minimum(sample, rows - 1)], jnp.inf)

    def load(self, run: Array) -> _Place:
        """A place at the beginning of a run."""
        at = jnp.minimum(run, self.total - 1)
        posed = self.pose(self.points.one(at), self.points.ends[at])
        terms, solver, zero, none = dfx.ODETerm(posed.field), seeker(posed, self.how), jnp.zeros(()), jnp.zeros((), int)  # pyright: ignore[reportArgumentType]
        goal, control = controller(posed, self.how).init(
            terms, zero, posed.first_step, posed.start, posed.first_step, posed.args, solver.func,
            solver.error_order(terms),
        )  # fmt: skip
        memory = solver.init(terms, zero, goal, posed.start, posed.args)
        arrays, broken = eqx.filter(posed, eqx.is_array), jnp.zeros((), bool)
        return _Place(
            run, arrays, self.points.ends[at], zero, goal, broken, posed.start, memory, control, none, none, none
        )

    def advance(self, place: _Place) -> tuple[_Place, Array, Array]:
        """A place after one step, the states of the samples in it, and how its run ended."""
        posed, how, read = eqx.combine(place.arrays, self.static), self.how, self.read
        terms, solver = dfx.ODETerm(posed.field), seeker(posed, how)
        goal = jnp.where(place.goal > place.end * (1.0 - 1e-14), place.end, place.goal)
        found, error, dense, memory, _ = solver.step(
            terms, place.time, goal, place.state, posed.args, place.memory, place.broken
        )
        keep, start, after, broken, control, fine = controller(posed, how).adapt_step_size(
            place.time, goal, place.state, found, posed.args, error, solver.error_order(terms), place.control
        )
        times = self.due(place.end, place.sample + jnp.arange(read))
        here = keep & (times <= goal)
        between = solver.interpolation_cls(t0=place.time, t1=goal, **dense)
        values = jax.vmap(between.evaluate)(jnp.where(here, times, goal))
        again = keep & (self.due(place.end, place.sample + read) <= goal)
        done = keep & ~again
        attempts = place.accepted + place.rejected + ~again
        spent = jnp.where(attempts >= how.max_steps, STEPS, _GOING_ON)
        code = jnp.where(fine == dfx.RESULTS.successful, spent, SOLVER)
        code = jnp.where(done & (goal >= place.end), OK, code)

        def chosen(which: Any, new: Any, old: Any) -> Any:
            return jax.tree.map(lambda x, y: jnp.where(which, x, y), new, old)

        moved = place._replace(
            time=jnp.where(done, start, place.time), goal=jnp.where(again, place.goal, after),
            broken=jnp.where(again, place.broken, broken), state=chosen(done, found, place.state),
            memory=chosen(done, memory, place.memory), control=chosen(again, place.control, control),
            sample=place.sample + jnp.sum(here), accepted=place.accepted + done, rejected=place.rejected + ~keep,
        )  # fmt: skip
        return moved, values, code

    def filled(self, runs: Array) -> _Place:
        """Places at the beginning of runs; of none beyond the count."""
        return jax.vmap(self.load)(jnp.where(runs < self.count, runs, self.total))

    def written(self, states: Array, before: _Place, values: Array) -> Array:
        """All states with the samples of a round; rows written too far are written again."""
        if not backend.on_cpu():
            # One kernel for all places. What places without a run would write is dropped: thousands that write to one
            # row wait for each other.
            run = jnp.where(before.run < self.total, before.run, self.total + 1)
            at = run[:, None], before.sample[:, None] + jnp.arange(self.read)
            return states.at[at].set(values, mode="drop")
        # One by one, in place: a scatter would copy all states in every round.
        for i in range(self.places):
            at = (before.run[i], before.sample[i], *[0] * len(self.shape))
            states = jax.lax.dynamic_update_slice(states, values[i][None], at)
        return states

    def round(self, carry: tuple) -> tuple:
        """A step of every place; those whose runs have ended take the next ones."""
        waiting, before, outcome, states, rounds = carry
        after, values, code = jax.vmap(self.advance)(before)
        states = self.written(states, before, values)
        ended = code != _GOING_ON

        def hand_over(now: tuple) -> tuple:
            waiting, place, outcome = now
            at = jnp.where(ended, place.run, self.total)
            news = _Outcome(code, place.time, place.accepted, place.rejected)
            outcome = jax.tree.map(lambda x, new: x.at[at].set(new, mode="drop"), outcome, news)
            if self.places >= self.total:
                # No run waits. What goes on in a place without one is not read.
                return waiting, place._replace(run=jnp.where(ended, self.total, place.run)), outcome
            fresh = self.filled(waiting + jnp.cumsum(ended) - 1)
            place = jax.tree.map(lambda x, y: jnp.where(ended.reshape(-1, *[1] * (x.ndim - 1)), x, y), fresh, place)
            return waiting + jnp.sum(ended), place, outcome

        now = jax.lax.cond(jnp.any(ended), hand_over, lambda now: now, (waiting, after, outcome))
        return *now, states, rounds + 1

    def solved(self) -> tuple[_Outcome, Array, Array]:
        """How the runs ended, their states (N + 1, T + ``read``, ...), and the number of rounds."""
        total, none = self.total, jnp.zeros(self.total, int)
        outcome = _Outcome(none + NOT_FINITE, jnp.zeros(total), none, none)
        # ``read`` rows beyond the last sample, which the last step's writing may reach.
        states = jnp.full((total + 1, self.points.grid.size + self.read, *self.shape), jnp.nan)
        carry = (jnp.asarray(self.places), self.filled(jnp.arange(self.places)), outcome, states, jnp.asarray(0))
        return jax.lax.while_loop(lambda carry: jnp.any(carry[1].run < total), self.round, carry)[2:]


def integrate_queue(
    model: AbstractModel, points: Points, how: Plan, count: Array | int, places: int, wrt: Sequence[str] = ()
) -> tuple[Solution, Array]:
    """Solve the first ``count`` of N runs. Pure; not to be differentiated.

    Args:
        model: one with a history.
        points: N runs, sampled at ``ends * grid``; the grid increases from 0 to 1.
        how: as ``integrate``; its budget of steps is each run's own.
        count: may be traced, so that a shorter queue needs no other program.
        places: runs under way at one time.
        wrt: names of parameters whose tangents go beside the state, by shares of their sizes (``sizes``). They have no
            say in the steps, whatever ``how`` says.

    Returns:
        As ``integrate``, with a leading axis (N,), and how many rounds all places went through. Runs beyond ``count``
        are NaN. With ``wrt`` of k names the states are rows (N, T, 1 + k, n), the state and its tangents.
    """
    queue, (_, ends, grid) = _Queue(model, points, how, jnp.asarray(count), places, wrt).known(), points
    total, rows = ends.size, grid.size
    outcome, states, rounds = queue.solved()
    # Beyond the last sample that was reached stands what was written too far.
    reached = ends[:, None] * grid <= jnp.where(outcome.code == OK, jnp.inf, outcome.end)[:, None]
    states = jnp.where(reached.reshape(total, rows, *[1] * len(queue.shape)), states[:-1, :rows], jnp.nan)
    finite = jnp.all(jnp.isfinite(states[:, :, 0] if wrt else states), axis=(1, 2))
    code = jnp.where((outcome.code == OK) & ~finite, NOT_FINITE, outcome.code)
    return Solution(states, code, outcome.end, outcome.accepted, outcome.rejected), rounds


def sizes(params: Params, names: Sequence[str]) -> Array:
    """What a share of each parameter is a share of: its size, or 1 of its unit at 0."""
    values = jnp.stack([jnp.asarray(params[name], float) for name in names])
    return jnp.where(values == 0.0, 1.0, jnp.abs(values))


def shifted(params: Params, names: Sequence[str], shares: Array) -> dict[str, Array]:
    """The named parameters, moved by shares (P,) of their sizes."""
    moved = jax.lax.stop_gradient(sizes(params, names)) * shares
    return {name: params[name] + moved[k] for k, name in enumerate(names)}


def equilibria(model: AbstractModel, points: Points) -> Solution:
    """N runs of a model without a history, as ``integrate_queue`` gives them. Pure.

    On a CPU each is searched for from the one before it, on an accelerator all side by side.
    """
    params, ends, grid = points

    def one(near: Any, run: tuple) -> tuple:
        values, end = run
        solution, near = model.instants(values, end * grid, near)
        return near, solution

    near = jax.tree.map(jnp.asarray, model.origin(grid.size))
    if not (jax.tree.leaves(near) and backend.on_cpu()):
        # Closed forms have nothing to search for; an accelerator searches all runs side by side.
        return jax.vmap(lambda values, end: model.instants(values, end * grid, near)[0])(dict(params), ends)
    return jax.lax.scan(one, near, (dict(params), ends))[1]
