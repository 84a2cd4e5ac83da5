"""The search for equilibrium: Newton's method at many instants in one batch.

A line search on the slope (forces are all that is known; their energy is not), and never up the energy: where both
pilots bear on an edge, the cage is held by next to nothing and may stand on a saddle. The batch works through the instants,
coarse ones first, so that the others start between solved neighbours; one that has converged is replaced by the next,
and none waits for the slowest. Neighbours under steady load are those of like phase: a turn by one ball's
pitch with the balls renumbered changes nothing, so one of them starts where another ended. It starts there and no
more: every instant is solved for itself.
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
# A Newton step shorter than this [m] is the last: its square over any penetration is below rounding.
_CLOSE = 1e-10
# A step is cut where the slope along it has turned and grown by this factor; down to the shortest fraction.
_TURNED, _SHORTEST = 3.0, 0.01
# Evaluations an instant may take, and how many of them from its neighbours' places; then it starts again from zero.
_TRIALS, _PATIENCE = 240, 100
# In the batch.
_SIZE = 16
# Every so many instants one starts from the zero-clearance position; a power of two.
_STRIDE = 64


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


def _queue(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Order of the instants, coarse ones first, and of each the solved neighbours to start from; -1 for none."""
    order = list(range(0, count, _STRIDE))
    left, right = np.full(count, -1), np.full(count, -1)
    half = _STRIDE // 2
    while half:
        for i in range(half, count, 2 * half):
            left[i], right[i] = i - half, i + half if i + half < count else i - half
            order.append(i)
        half //= 2
    return np.array(order), left, right


def _neighbourhood(problem: Problem, pitch: float, times: Array) -> tuple[Array, Array]:
    """The instants in an order in which neighbours are alike, and where on a line each of them is.

    Those under full load by phase, the part of a ball's pitch that the seat is into; others by time.
    """
    # A phase of 0 that rounding has made one of 1 is none.
    pitches = problem.seat / pitch + 1e-9
    size = jnp.abs(problem.torque)
    steady = size >= (1.0 - 1e-9) * jnp.max(size)
    place = jnp.where(steady, pitches - jnp.floor(pitches), times)
    rank = jnp.lexsort((place, steady))
    return rank, place[rank]


class _Batch(NamedTuple):
    """The batch: instants in work (T where idle), last accepted places, step from them, slope, fraction, evaluations."""

    index: Array
    base: Array
    step: Array
    slope: Array
    part: Array
    trials: Array


class _Results(NamedTuple):
    """Of T instants: places and rates (size, T), 0: not yet, 1: converged, 2: given up, and evaluations."""

    known: Array
    rates: Array
    state: Array
    spent: Array


class _Carry(NamedTuple):
    """Of the loop: the batch, where it is, how many of the queue are taken, results."""

    batch: _Batch
    x: Array
    taken: Array
    results: _Results


@dataclasses.dataclass(frozen=True)
class _Search:
    """What does not change in a search.

    Attributes:
        scene, problem, drift: as of ``search``; instants in their order.
        origin: where each starts (size, T); ``near``: whether that is a solution for other parameters.
        whole: whether all are in the batch from the start, each at its own place, and none takes another's: no queue, no
            order, no scatters.
        order, left, right: of ``_queue``; ``weight``: where each stands between its neighbours.
    """

    scene: Joint
    problem: Problem
    drift: Problem
    origin: Array
    near: bool
    whole: bool
    order: Array
    left: Array
    right: Array
    weight: Array

    @property
    def count(self) -> int:
        """Of instants."""
        return self.origin.shape[1]

    def split(self, x: Array) -> Places:
        """Places from flat ones."""
        n = self.scene.balls
        return Places(x[: 3 * n].reshape(3, n, -1), x[3 * n :])

    def begin(self, width: int) -> _Carry:
        """With a queue every place is idle in the first round: what it solves is thrown away."""
        size, count = self.origin.shape
        index, base = jnp.full(width, count), jnp.zeros((size, width))
        if self.whole:
            index, base = jnp.arange(count), self.origin
        none, many = jnp.zeros(width), jnp.zeros((size, count))
        batch = _Batch(index, base, jnp.zeros_like(base), none, none + 1.0, jnp.zeros(width, int))
        results = _Results(many, many, jnp.zeros(count, int), jnp.zeros(count, int))
        return _Carry(batch, base, jnp.asarray(count if self.whole else 0), results)

    def more(self, carry: _Carry) -> Array:
        """Whether an instant is in work; in the first round none is yet."""
        return jnp.any(carry.batch.index < self.count) | (carry.taken == 0)

    def step(self, carry: _Carry) -> _Carry:
        """One evaluation at every place of the batch; ended instants are replaced."""
        batch, x, taken, results = carry
        here, moving = self._instants(self.problem, batch.index), self._instants(self.drift, batch.index)
        out, matrix = balance(self.scene, here, self.split(x))
        step, back = solve(matrix, out, pull(self.scene, here, moving, matrix))
        out, step, trials = _flat(out), _flat(step), batch.trials + 1
        slope = jnp.sum(out * batch.step, 0)
        turned = (slope < -_TURNED * batch.slope) & (batch.slope > 0) & (batch.part > _SHORTEST)
        longest = jnp.max(jnp.abs(step), 0)
        good = ~turned & (longest < _CLOSE)
        ended = good | (trials >= _TRIALS) | ~jnp.isfinite(longest)
        cut = jnp.clip(batch.slope / (batch.slope - slope), 0.1, 0.7)
        # Where stiffness is negative along it, Newton's step leads up the energy, to the top of a hill: the other way.
        uphill = jnp.sum(out * step, 0) < 0
        down = jnp.where(uphill, -step, step)
        batch = _Batch(
            batch.index,
            jnp.where(turned, batch.base, x),
            jnp.where(turned, batch.step, down),
            jnp.where(turned, batch.slope, jnp.sum(out * down, 0)),
            jnp.where(turned, batch.part * cut, jnp.minimum(1.0, _REACH / longest)),
            trials,
        )
        stuck = trials == _PATIENCE
        if not self.near:
            stuck &= self.left[jnp.minimum(batch.index, self.count - 1)] >= 0
        nowhere = _Batch(*(jnp.zeros_like(part) for part in batch))._replace(index=batch.index, trials=trials)
        batch = jax.tree.map(lambda new, old: jnp.where(stuck, new, old), nowhere, batch)
        busy = batch.index < self.count
        rates = _flat(displaced(self.scene, here, moving, back))
        news = _Results(x - step, rates, jnp.where(good, 1, 2), trials)
        results = self._noted(ended & busy, batch.index, news, results)
        idle = ended | ~busy
        candidate, guess, taken = self._handed_out(idle, taken, results)
        none = jnp.zeros(idle.shape)
        fresh = _Batch(candidate, guess, jnp.zeros_like(x), none, none + 1.0, none.astype(int))
        batch = jax.tree.map(lambda new, old: jnp.where(idle, new, old), fresh, batch)
        return _Carry(batch, batch.base - batch.part * batch.step, taken, results)

    def _instants(self, p: Problem, index: Array) -> Problem:
        if self.whole:
            return p
        i = jnp.minimum(index, self.count - 1)
        return p._replace(ball=p.ball[:, :, i], seat=p.seat[i], torque=p.torque[i])

    def _renumbered(self, x: Array, i: Array, other: Array) -> Array:
        """Places of instant ``other`` for instant ``i``: of each ball, those of the ball that was nearest to it."""
        n, seat = self.scene.balls, self.problem.seat
        passed = jnp.round((seat[i] - seat[other]) * n / (2.0 * np.pi)).astype(int)
        which = (jnp.arange(n)[:, None] + passed) % n
        at = self.split(x)
        return _flat(at._replace(ball=jnp.take_along_axis(at.ball, which[None], 1)))

    def _noted(self, which: Array, index: Array, news: _Results, results: _Results) -> _Results:
        """Results of all instants, with those of the batch that have ended."""
        if self.whole:
            return jax.tree.map(lambda new, old: jnp.where(which, new, old), news, results)
        where = jnp.where(which, index, self.count)
        return jax.tree.map(lambda new, old: old.at[..., where].set(new, mode="drop"), news, results)

    def _handed_out(self, idle: Array, taken: Array, results: _Results) -> tuple[Array, Array, Array]:
        """What idle places get: instants, where these start from, and how many of the queue are taken then."""
        count, left, right, state = self.count, self.left, self.right, results.state
        if self.whole:
            return jnp.full(count, count), self.origin, taken
        # Idle places look at the next of the queue in turn; each instant waits for its own neighbours.
        nth = taken + jnp.cumsum(idle) - 1
        candidate = jnp.where(idle, self.order[jnp.minimum(nth, count)], count)
        i = jnp.minimum(candidate, count - 1)
        ready = (left[i] < 0) | ((state[left[i]] > 0) & (state[right[i]] > 0))
        # In order: what stands behind one that waits, waits.
        blocked = jnp.cumsum(idle & ~ready & (candidate < count)) > 0
        candidate = jnp.where(blocked, count, candidate)
        taken = taken + jnp.sum(idle & (candidate < count))
        # Between the neighbours; from one where the other failed; from the origin where there is none.
        first, last = ((left[i] >= 0) & (state[s[i]] == 1) for s in (left, right))
        share = jnp.where(first & last, self.weight[i], jnp.where(last, 1.0, 0.0))
        a, b = (
            jnp.where(k, self._renumbered(results.known[:, s[i]], i, s[i]), 0.0)
            for k, s in ((first, left), (last, right))
        )
        return candidate, jnp.where(left[i] < 0, self.origin[:, i], a + share * (b - a)), taken


def _flat(at: Places) -> Array:
    return jnp.concatenate([at.ball.reshape(-1, at.ball.shape[-1]), at.coupling])


def search(scene: Joint, problem: Problem, drift: Problem, times: Array, near: Places | None = None) -> Found:
    """Newton's method at every instant; from ``near``, a solution for other parameters, where there is one."""
    count = times.size
    width = min(_SIZE, count)
    whole = near is not None and width == count
    alone = np.arange(count), np.full(count, -1), np.full(count, -1)
    order, left, right = (jnp.asarray(x) for x in (_queue(count) if near is None else alone))
    order = jnp.concatenate([order, jnp.full(width, count)])
    rank, place = (slice(None), times) if whole else _neighbourhood(problem, 2.0 * np.pi / scene.balls, times)
    problem, drift = (
        p._replace(ball=p.ball[:, :, rank], seat=p.seat[rank], torque=p.torque[rank]) for p in (problem, drift)
    )
    span = place[right] - place[left]
    # Clipped: between an instant placed by its time and one by its phase it has no meaning.
    weight = jnp.clip(jnp.where(span > 0, (place - place[left]) / jnp.where(span > 0, span, 1.0), 0.5), 0.0, 1.0)
    start = _flat(jax.tree.map(jnp.asarray, origin(scene, count) if near is None else near))[:, rank]
    how = _Search(scene, problem, drift, start, near is not None, whole, order, left, right, weight)
    results = jax.lax.while_loop(how.more, how.step, how.begin(width)).results
    back = rank if isinstance(rank, slice) else jnp.argsort(rank)
    known, rates = (how.split(x[:, back]) for x in (results.known, results.rates))
    return Found(known, rates, results.state[back] == 1, results.spent[back])
