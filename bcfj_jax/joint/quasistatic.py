"""The joint in equilibrium at every instant: massless parts, no friction, no damping.

At time t the seat stands at drive_speed t, the head bears its load, and every contact bears  skin.normal(d, 0).
Unknown are the balls' places and, as far as the scene frees them, the head's place and turn, the cage's place and tilt.
Clearances leave play, in which nothing decides where a part floats: weak springs to the zero-clearance position
(``start.nominal``) do, see ``GROUND``.

Newton's method with a line search on the slope (forces are all that is known; their energy is not). A pool of lanes
works through the instants, coarse ones first, so that the others start between solved neighbours; a lane that has
converged takes the next instant, and none waits for the slowest. Derivatives are those of the implicit function.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.joint import system
from bcfj_jax.joint.balance import Matrix, Places, Problem, balance, slots_of, solve, tilted_axis
from bcfj_jax.joint.constants import constants, skin_of
from bcfj_jax.joint.scene import Joint
from bcfj_jax.joint.start import nominal
from bcfj_jax.scene import Params

# Stiffness of the grounding springs, in ball loads T/(z Rp) + |axial load| per metre (and 1e-3 N/m, so that no load
# is no singular matrix): a play of 100 um takes 1e-6 of a ball's load.
GROUND = 1e-2
# Longest step of any unknown [m], about the range over which a contact's stiffness is what it was.
_REACH = 5e-5
# A Newton step shorter than this [m] is the last: its square over any penetration is below rounding.
_CLOSE = 1e-10
# A step is cut where the slope along it has turned and grown by this factor; down to the shortest fraction.
_TURNED, _SHORTEST = 3.0, 0.01
# Evaluations an instant may take, and lanes in the pool.
_TRIALS = 150
_LANES = 48
# Every so many instants one starts from the zero-clearance position; a power of two.
_STRIDE = 16


class QuasistaticSolution(NamedTuple):
    """Equilibrium at each of T instants.

    Attributes:
        states: (T, scene.states) as ``system`` reads them; NaN where not converged. Velocities are the equilibrium's
            own rates of change; a ball spins as the cage does.
        converged: (T,) whether Newton's method did.
        iterations: (T,) evaluations of the forces it took.
    """

    states: Array
    converged: Array
    iterations: Array


def quasistatic_states(scene: Joint, params: Params, times: Array) -> Array:
    """States of ``quasistatic`` alone, (T, scene.states)."""
    return quasistatic(scene, params, times).states


@partial(jax.jit, static_argnums=0)
def quasistatic(scene: Joint, params: Params, times: Array) -> QuasistaticSolution:
    """Equilibrium at each time. Compiled once a scene and number of times.

    Differentiable in ``params`` and ``times``, forward and reverse, to any order, by the implicit function theorem;
    ``vmap`` over ``params`` works. A kink (a contact that just touches) has the derivative of one side.

    Args:
        scene: any joint; its friction, damping, masses and drive compliance are not read.
        params: its parameters [SI].
        times: (T,) [s], in any order, fastest where neighbours are near; the load ramp is read at them.
    """
    times = jnp.asarray(times, dtype=float)
    fixed = jax.lax.stop_gradient((params, times))
    found, converged, iterations = _search(scene, _problem(scene, *fixed), fixed[1])
    # From zero where the search failed: a NaN would spoil the others' derivatives in reverse mode.
    found = jax.tree.map(lambda x: jax.lax.stop_gradient(jnp.where(converged, x, 0.0)), found)

    def state(params: Params, times: Array) -> Array:
        problem = _problem(scene, params, times)
        return _flat(scene, problem, _equilibrium(scene)(problem, found))

    # Places, and their rates; the velocities that ``state`` itself returns are spins that places do not tell.
    value, rate = jax.jvp(lambda t: state(params, t), (times,), (jnp.ones_like(times),))
    states = _with_rates(scene, constants(scene, params), value, rate)
    return QuasistaticSolution(jnp.where(converged[:, None], states, jnp.nan), converged, iterations)


def _problem(scene: Joint, params: Params, times: Array) -> Problem:
    p, n = params, scene.balls
    c = constants(scene, params)
    seat = p["drive_speed"] * times
    places = jax.vmap(lambda angle: nominal(scene, params, angle)[: 3 * n])(seat)
    return Problem(
        c,
        {contact.name: skin_of(scene, params, contact.name) for contact in scene.contacts},
        jnp.transpose(places.reshape(-1, n, 3), (2, 1, 0)),
        seat,
        jax.vmap(lambda t: system.load_torque(c, t))(times),
        GROUND * (jnp.abs(p["load_torque"]) / (n * p["pitch_radius"]) + jnp.abs(p["axial_load"])) + 1e-3,
        p["pitch_radius"],
    )


def _flat(scene: Joint, problem: Problem, at: Places) -> Array:
    """Places of the flat state (T, 3 n + border)."""
    slots, seat = slots_of(scene), problem.seat
    parts = {"head_turn": (seat + at.border[slots["turn"]][0] / problem.lever)[None], "seat_turn": seat[None]}
    if "head" in slots:
        parts["head"] = at.border[slots["head"]]
    if "cage" in slots:
        parts["cage"] = at.border[slots["cage"]]
        parts["cage_turn"] = tilted_axis(problem.c, at.border[slots["tilt"]] / problem.lever)[0]
    ball = jnp.transpose(problem.ball + at.ball, (2, 1, 0)).reshape(seat.size, -1)
    border = [parts[name] for name, slot in scene.slots.items() if slot is not None]
    return jnp.concatenate([ball, jnp.concatenate(border).T], 1)


def _with_rates(scene: Joint, c: Any, value: Array, rate: Array) -> Array:
    """Flat states from places and their rates; the cage turns about its axis at the drive's speed."""
    n, count = scene.balls, value.shape[0]
    tilt = scene.slots["cage_turn"]
    spin = jnp.broadcast_to(c.drive_speed * c.bisector, (count, 3))
    if tilt is not None:
        at = slice(3 * n + tilt.start, 3 * n + tilt.stop)
        axis = value[:, at]
        spin = jnp.cross(axis, rate[:, at]) + c.drive_speed * axis
        rate = rate.at[:, at].set(spin)
    balls = rate[:, : 3 * n].reshape(count, n, 3)
    if scene.spin:
        balls = jnp.concatenate([balls, jnp.broadcast_to(spin[:, None], (count, n, 3))], -1)
    return jnp.concatenate([value, balls.reshape(count, -1), rate[:, 3 * n :]], 1)


def _equilibrium(scene: Joint) -> Any:
    """The solution as a function of the problem, given where it is: the implicit function theorem and nothing else."""

    @jax.custom_jvp
    def at(problem: Problem, found: Places) -> Places:
        del problem
        return found

    @at.defjvp
    def rule(primals: Any, tangents: Any) -> tuple[Places, Places]:
        problem, found = primals
        # Not ``found``: so that the rule itself is differentiated right.
        here = at(problem, found)
        (_, matrix), (out, _) = jax.jvp(lambda p: balance(scene, p, here), (problem,), (tangents[0],))
        return here, jax.tree.map(jnp.negative, solve(matrix, out))

    return at


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


class _Lanes(NamedTuple):
    """The pool: instants in work (T where idle), last accepted places, step from them, slope, fraction, evaluations."""

    index: Array
    base: Array
    step: Array
    slope: Array
    part: Array
    trials: Array


def _search(scene: Joint, problem: Problem, times: Array) -> tuple[Places, Array, Array]:
    """Newton's method at every instant: places, whether converged, evaluations."""
    count, n = times.size, scene.balls
    size = 3 * n + sum(slot.stop - slot.start for slot in slots_of(scene).values())
    lanes = min(_LANES, count)
    order, left, right = (jnp.asarray(x) for x in _queue(count))
    order = jnp.concatenate([order, jnp.full(lanes, count)])
    span = times[right] - times[left]
    weight = jnp.where(span == 0, 0.5, (times - times[left]) / jnp.where(span == 0, 1.0, span))

    def split(x: Array) -> Places:
        return Places(x[: 3 * n].reshape(3, n, -1), x[3 * n :])

    def forces(index: Array, x: Array) -> tuple[Places, Matrix]:
        i = jnp.minimum(index, count - 1)
        here = problem._replace(ball=problem.ball[:, :, i], seat=problem.seat[i], torque=problem.torque[i])
        return balance(scene, here, split(x))

    def join(at: Places) -> Array:
        return jnp.concatenate([at.ball.reshape(3 * n, -1), at.border])

    def more(carry: Any) -> Array:
        return jnp.any(carry[0].index < count) | (carry[3] == 0)

    def body(carry: Any) -> Any:
        # Forces come over from the round before: in one round with the solution the compiler would compute them
        # again for every reader.
        pool, x, (out, matrix), taken, known, state, spent = carry
        out, step = join(out), join(solve(matrix, out))
        trials = pool.trials + 1
        slope = jnp.sum(out * pool.step, 0)
        turned = (slope < -_TURNED * pool.slope) & (pool.slope > 0) & (pool.part > _SHORTEST)
        longest = jnp.max(jnp.abs(step), 0)
        good = ~turned & (longest < _CLOSE)
        ended = good | (trials >= _TRIALS) | ~jnp.isfinite(longest)
        cut = jnp.clip(pool.slope / (pool.slope - slope), 0.1, 0.7)
        pool = _Lanes(
            pool.index,
            jnp.where(turned, pool.base, x),
            jnp.where(turned, pool.step, step),
            jnp.where(turned, pool.slope, jnp.sum(out * step, 0)),
            jnp.where(turned, pool.part * cut, jnp.minimum(1.0, _REACH / longest)),
            trials,
        )
        busy = pool.index < count
        where = jnp.where(ended & busy, pool.index, count)
        known = known.at[:, where].set(x - step, mode="drop")
        # 1: converged, 2: given up, 0: not yet.
        state = state.at[where].set(jnp.where(good, 1, 2), mode="drop")
        spent = spent.at[where].set(trials, mode="drop")
        # Idle lanes look at the next of the queue in turn; each waits for its own neighbours.
        idle = ended | ~busy
        nth = taken + jnp.cumsum(idle) - 1
        candidate = jnp.where(idle, order[jnp.minimum(nth, count)], count)
        i = jnp.minimum(candidate, count - 1)
        ready = (left[i] < 0) | ((state[left[i]] > 0) & (state[right[i]] > 0))
        # In order: what stands behind one that waits, waits.
        blocked = jnp.cumsum(idle & ~ready & (candidate < count)) > 0
        candidate = jnp.where(blocked, count, candidate)
        taken = taken + jnp.sum(idle & (candidate < count))
        # Between the neighbours; from one where the other failed; from zero where there is none.
        first, last = ((left[i] >= 0) & (state[s[i]] == 1) for s in (left, right))
        share = jnp.where(first & last, weight[i], jnp.where(last, 1.0, 0.0))
        a, b = (jnp.where(k, known[:, s[i]], 0.0) for k, s in ((first, left), (last, right)))
        guess = a + share * (b - a)
        fresh = _Lanes(candidate, guess, jnp.zeros_like(x), jnp.zeros(lanes), jnp.ones(lanes), jnp.zeros(lanes, int))
        pool = jax.tree.map(lambda new, old: jnp.where(idle, new, old), fresh, pool)
        x = pool.base - pool.part * pool.step
        return pool, x, forces(pool.index, x), taken, known, state, spent

    def empty(rows: int) -> Array:
        return jnp.zeros((rows, lanes))

    nobody = _Lanes(
        jnp.full(lanes, count), empty(size), empty(size), jnp.zeros(lanes), jnp.ones(lanes), jnp.zeros(lanes, int)
    )
    flat = jax.eval_shape(forces, nobody.index, nobody.base)
    # Every lane is idle in the first round: what it solves is thrown away.
    nothing = jax.tree.map(lambda s: jnp.ones(s.shape), flat)
    results = (jnp.zeros((size, count)), jnp.zeros(count, int), jnp.zeros(count, int))
    start = (nobody, nobody.base, nothing, jnp.asarray(0), *results)
    *_, known, state, spent = jax.lax.while_loop(more, body, start)
    return split(known), state == 1, spent
