"""The search for equilibrium: Newton's method at many instants, some side by side.

A line search on the slope (forces are all that is known; their energy is not), and never up the energy: where both
pilots bear on an edge, the cage is held by next to nothing and may stand on a saddle. Lanes side by side each walk along a
stretch of neighbouring instants, and each instant starts where the one before it ended; none waits for another lane.
Neighbours under steady load are those of like phase: a turn by one ball's pitch with the balls renumbered changes nothing.
An instant starts there and no more: every one is solved for itself.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.models.joint.equilibrium_residual import Matrix, Places, Problem, balance, slices_of, solve
from bcfj_jax.models.joint.scene import Joint

# Longest step of any unknown [m], about the range over which a contact's stiffness is what it was.
_REACH = 5e-5
# A Newton step shorter than this [m] is the last, where the forces that are missing are less than the grounding's over this
# length [m], a ten-thousandth of the load: what the step leaves goes with the square of that share, however stiff contacts are.
_CLOSE, _BALANCED = 1e-10, 1e-2
# A step is cut where the slope along it has turned and grown by this factor; down to the shortest fraction.
_TURNED, _SHORTEST = 3.0, 0.01
# Evaluations an instant may take, and how many of them from its neighbours' places; then it starts again from zero.
_TRIALS, _PATIENCE = 240, 100
# Lanes.
_LANES = 16


class Found(NamedTuple):
    """T places of equilibrium, their rates, (T,) whether Newton's method converged, (T,) evaluations it took."""

    places: Places
    rates: Places
    converged: Array
    iterations: Array


def pull(scene: Joint, problem: Problem, drift: Problem, matrix: Matrix) -> Places:
    """Rate of the forces while balls and head stand still in space.

    The seat's tracks turn away under the balls, the load rises, and the grounding's springs move on.
    """
    swept = problem.spring * problem.lever * drift.seat
    coupling = (
        jnp.zeros((matrix.coupling.shape[0], swept.size))
        .at[slices_of(scene)["turn"]]
        .set(drift.torque / problem.lever - swept)
    )
    return Places(matrix.seat * drift.seat - problem.spring * drift.ball, coupling)


def displaced(scene: Joint, problem: Problem, drift: Problem, back: Places) -> Places:
    """Rates of the displacements from the solution for ``pull``."""
    coupling = (-back.coupling).at[slices_of(scene)["turn"]].add(-problem.lever * drift.seat)
    return Places(-back.ball - drift.ball, coupling)


def origin(scene: Joint, count: int) -> Places:
    """The zero-clearance position at so many instants: displacements of 0."""
    size = sum(piece.stop - piece.start for piece in slices_of(scene).values())
    return Places(np.zeros((3, scene.balls, count)), np.zeros((size, count)))  # pyright: ignore[reportArgumentType]


def _neighbourhood(problem: Problem, pitch: float, times: Array) -> Array:
    """The instants in an order in which neighbours are alike.

    Those under full load by phase, the part of a ball's pitch that the seat is into; others by time.
    """
    # A phase of 0 that rounding has made one of 1 is none.
    pitches = problem.seat / pitch + 1e-9
    size = jnp.abs(problem.torque)
    steady = size >= (1.0 - 1e-9) * jnp.max(size)
    place = jnp.where(steady, pitches - jnp.floor(pitches), times)
    return jnp.lexsort((place, steady))


class _Lanes(NamedTuple):
    """Lanes: instants in work (T where idle), places, last accepted ones, step from them, slope, fraction, evaluations."""

    index: Array
    x: Array
    base: Array
    step: Array
    slope: Array
    part: Array
    trials: Array


class _Results(NamedTuple):
    """Of T instants: places and rates (size, T), whether converged, and evaluations."""

    known: Array
    rates: Array
    converged: Array
    spent: Array


@dataclasses.dataclass(frozen=True)
class _Search:
    """What does not change in a search."""

    # scene, problem, drift: as of search; instants in their order.
    scene: Joint
    problem: Problem
    drift: Problem
    origin: Array  # where each starts (size, T); ``near``: whether that is a solution for other parameters
    near: bool
    # first, ends: of each lane the first instant, and the one behind the last.
    first: np.ndarray
    ends: np.ndarray

    @property
    def count(self) -> int:
        """Of instants."""
        return self.origin.shape[1]

    def split(self, x: Array) -> Places:
        """Places from flat ones."""
        n = self.scene.balls
        return Places(x[: 3 * n].reshape(3, n, -1), x[3 * n :])

    def started(self, index: Array, x: Array) -> _Lanes:
        """Lanes at the beginning of their instants."""
        none = jnp.zeros(index.shape)
        return _Lanes(index, x, x, jnp.zeros_like(x), none, none + 1.0, none.astype(int))

    def step(self, carry: tuple[_Lanes, _Results]) -> tuple[_Lanes, _Results]:
        """One evaluation in every lane; those whose instants have ended go on to the next."""
        lanes, results = carry
        x, trials, busy = lanes.x, lanes.trials + 1, lanes.index < self.count
        here, moving = self._instants(self.problem, lanes.index), self._instants(self.drift, lanes.index)
        out, matrix = balance(self.scene, here, self.split(x))
        step, back = solve(matrix, out, pull(self.scene, here, moving, matrix))
        out, step = _flat(out), _flat(step)
        slope = jnp.sum(out * lanes.step, 0)
        turned = (slope < -_TURNED * lanes.slope) & (lanes.slope > 0) & (lanes.part > _SHORTEST)
        longest = jnp.max(jnp.abs(step), 0)
        good = ~turned & (longest < _CLOSE) & (jnp.max(jnp.abs(out), 0) < _BALANCED * here.spring)
        ended = good | (trials >= _TRIALS) | ~jnp.isfinite(longest)
        # Where stiffness is negative along it, Newton's step leads up the energy, to the top of a hill: the other way.
        down = jnp.where(jnp.sum(out * step, 0) < 0, -step, step)
        cut = jnp.clip(lanes.slope / (lanes.slope - slope), 0.1, 0.7)
        base, way = jnp.where(turned, lanes.base, x), jnp.where(turned, lanes.step, down)
        part = jnp.where(turned, lanes.part * cut, jnp.minimum(1.0, _REACH / longest))
        rise = jnp.where(turned, lanes.slope, jnp.sum(out * down, 0))
        moved = _Lanes(lanes.index, base - part * way, base, way, rise, part, trials)
        found, rates = x - step, _flat(displaced(self.scene, here, moving, back))
        where = jnp.where(ended & busy, lanes.index, self.count)
        news = _Results(found, rates, good, trials)
        results = jax.tree.map(lambda old, new: old.at[..., where].set(new, mode="drop"), results, news)
        after = jnp.where(lanes.index + 1 < self.ends, lanes.index + 1, self.count)
        fresh = self.started(after, self._guess(after, jnp.where(good, found, 0.0)))
        stuck = self.started(lanes.index, jnp.zeros_like(x))._replace(trials=trials)

        # What began at zero begins there but once.
        led = self.near | (lanes.index != self.first) & results.converged[lanes.index - 1]

        def pick(new: Array, again: Array, old: Array) -> Array:
            return jnp.where(ended, new, jnp.where(led & (trials == _PATIENCE), again, old))

        return jax.tree.map(pick, fresh, stuck, moved), results

    def _instants(self, p: Problem, index: Array) -> Problem:
        if self.first.size == self.count:
            return p
        i = jnp.minimum(index, self.count - 1)
        return p._replace(ball=p.ball[:, :, i], seat=p.seat[i], torque=p.torque[i])

    def _guess(self, index: Array, found: Array) -> Array:
        """Where instants start: at what was found of the ones before, of each ball that of the ball that was nearest to it."""
        n, seat, i = self.scene.balls, self.problem.seat, jnp.minimum(index, self.count - 1)
        if self.near:
            return self.origin[:, i]
        passed = jnp.round((seat[i] - seat[i - 1]) * n / (2.0 * np.pi)).astype(int)
        at, which = self.split(found), (jnp.arange(n)[:, None] + passed) % n
        return _flat(at._replace(ball=jnp.take_along_axis(at.ball, which[None], 1)))


def _flat(at: Places) -> Array:
    return jnp.concatenate([at.ball.reshape(-1, at.ball.shape[-1]), at.coupling])


def search(scene: Joint, problem: Problem, drift: Problem, times: Array, near: Places | None = None) -> Found:
    """Newton's method at every instant; from ``near``, a solution for other parameters, where there is one."""
    count = times.size
    stretch = -(-count // _LANES)
    first = np.arange(0, count, stretch)
    rank = np.arange(count) if stretch == 1 else _neighbourhood(problem, 2.0 * np.pi / scene.balls, times)
    problem, drift = (
        p._replace(ball=p.ball[:, :, rank], seat=p.seat[rank], torque=p.torque[rank]) for p in (problem, drift)
    )
    start = _flat(jax.tree.map(jnp.asarray, origin(scene, count) if near is None else near))[:, rank]
    how = _Search(scene, problem, drift, start, near is not None, first, np.append(first[1:], count))
    many, none = jnp.zeros_like(start), jnp.zeros(count, int)
    begin = how.started(jnp.asarray(first), start[:, first]), _Results(many, many, none > 0, none)
    results = jax.lax.while_loop(lambda carry: jnp.any(carry[0].index < count), how.step, begin)[1]
    back = jnp.argsort(rank)
    known, rates = (how.split(x[:, back]) for x in (results.known, results.rates))
    return Found(known, rates, results.converged[back], results.spent[back])
