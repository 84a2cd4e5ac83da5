"""The joint in equilibrium at every instant: massless parts, no friction, no damping.

At time t the seat stands at drive_speed t, the head bears its load, and every contact bears  laws.normal(d, 0).
Unknown are the balls' places and, as far as the scene frees them, the head's place and turn, the cage's place and tilt.
Clearances leave play, in which nothing decides where a part floats: weak springs to the zero-clearance position
(``kinematic.nominal``) do, see ``GROUND``. Without friction nothing turns the cage about its own axis: its azimuth is the
seat's angle, about which balls swing evenly in their windows, and the windows' ends bear nothing.

``batched_newton`` searches; derivatives are those of the implicit function.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.batched_newton import Found, displaced, pull, search
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.equilibrium_residual import Places, Problem, balance, slices_of, solve, tilted_axis
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.observe import observe
from bcfj_jax.models.joint.programmes import torque_at
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.xla.kept import kept

# Stiffness of the grounding springs, in ball loads T/(z Rp) + |axial load| per metre (and 1e-3 N/m, so that no load
# is no singular matrix): a play of 100 um takes 1e-6 of a ball's load.
GROUND = 1e-2


class QuasistaticSolution(NamedTuple):
    """Equilibrium at each of T instants."""

    # (T, scene.states) as ``system`` reads them; NaN where not converged. Velocities are the equilibrium's own rates of
    # change; a ball spins as the cage does.
    states: Array
    converged: Array  # (T,) whether Newton's method did
    iterations: Array  # (T,) evaluations of the forces it took
    places: Places  # displacements from the zero-clearance position, 0 where not converged; without derivatives


@partial(jax.jit, static_argnums=(0, 4))
def quasistatic(
    scene: Joint, params: Params, times: Array, near: Places | None = None, rates: bool = True
) -> QuasistaticSolution:
    """Equilibrium at each time (T,) [s], in any order. Compiled once a scene and number of times.

    Differentiable in ``params`` and ``times``, forward and reverse, to any order, by the implicit function theorem;
    ``vmap`` over ``params`` works. A kink (a contact that just touches) has the derivative of one side. Friction, damping,
    masses and drive compliance are not read. Without ``rates`` velocities are 0, and the program is half as large where it is
    differentiated. ``near`` is as ``quasistatic_places`` has it.
    """
    times = jnp.asarray(times, dtype=float)
    found = quasistatic_places(scene, params, times, near)
    if rates:
        problem, drift = _moving_problem(scene, params, times)
        at = _equilibrium(scene)(problem, found.places)
        moved = _rates_of(scene)(problem, drift, at, found.rates)
        value, rate = kept(*jax.jvp(partial(flat_places, scene), (problem, at), (drift, moved)))
        states = _with_rates(scene, problem.c, value, rate)
    else:
        problem = posed(scene, params, times)
        states = still(scene, flat_places(scene, problem, _equilibrium(scene)(problem, found.places)))
    states = jnp.where(found.converged[:, None], states, jnp.nan)
    return QuasistaticSolution(states, found.converged, found.iterations, found.places)


@partial(jax.jit, static_argnums=0)
def quasistatic_places(scene: Joint, params: Params, times: Array, near: Places | None = None) -> Found:
    """The search for equilibrium and nothing else; without derivatives.

    ``near``: places at the same times in equilibrium under other parameters, from which to start.
    """
    params, times = jax.lax.stop_gradient((params, jnp.asarray(times, dtype=float)))
    found = search(scene, *_moving_problem(scene, params, times), times, near)
    # From zero where the search failed: a NaN would spoil the others' derivatives in reverse mode.
    places, rates = jax.tree.map(lambda x: jnp.where(found.converged, x, 0.0), (found.places, found.rates))
    return jax.lax.stop_gradient(Found(places, rates, found.converged, found.iterations))


@partial(jax.jit, static_argnums=0)
def quasistatic_forces(scene: Joint, params: Params, times: Array, found: Found | None = None) -> dict[str, Array]:
    """Normal force of every contact at each time [N], (T, balls) or (T,), as ``observe`` has it; NaN where none.

    Differentiable as ``quasistatic`` is, in a program a fraction as large: there are no velocities in it. ``found``:
    ``quasistatic_places`` of the same, where it is at hand: a search need not be compiled with derivatives.
    """
    times = jnp.asarray(times, dtype=float)
    found = quasistatic_places(scene, params, times) if found is None else found
    problem = posed(scene, params, times)
    at = _equilibrium(scene)(problem, jax.lax.stop_gradient(found.places))
    readings = jax.vmap(lambda y: observe(scene, problem.c, y))(still(scene, flat_places(scene, problem, at)))
    force = {name: reading.force[..., 0].T for name, reading in readings.items()}
    return {name: jnp.where(found.converged, x, jnp.nan).T for name, x in force.items()}


def posed(scene: Joint, params: Params, times: Array) -> Problem:
    """What equilibrium depends on at each time."""
    p, n = params, scene.balls
    c, seat = constants(scene, params), p["drive_speed"] * times
    places = jax.vmap(lambda angle: nominal(scene, params, angle)[: 3 * n])(seat)
    torque = jax.vmap(lambda t: torque_at(scene.programmes, t, jnp.zeros(()), c.programmes))(times)
    spring = GROUND * (jnp.abs(p["load_torque"]) / (n * p["pitch_radius"]) + jnp.abs(p["axial_load"])) + 1e-3
    return Problem(c, jnp.transpose(places.reshape(-1, n, 3), (2, 1, 0)), seat, torque, spring, p["pitch_radius"])


def flat_places(scene: Joint, problem: Problem, at: Places) -> Array:
    """Places of the flat state (T, 3 n + coupling), from displacements."""
    parts, seat = {name: at.coupling[piece] for name, piece in slices_of(scene).items()}, problem.seat
    parts |= {"head_turn": seat + parts["turn"] / problem.lever, "seat_turn": seat[None]}
    if "tilt" in parts:
        parts["cage_turn"] = jax.vmap(partial(tilted_axis, problem.c), 1, 1)(parts["tilt"] / problem.lever)[0]
    ball = jnp.transpose(problem.ball + at.ball, (2, 1, 0)).reshape(seat.size, -1)
    return jnp.concatenate([ball, scene.coupled(parts, 0).T], 1)


def still(scene: Joint, value: Array) -> Array:
    """Flat states (T, scene.states) that begin with the places of ``flat_places``; no velocities but given ones."""
    states = jnp.pad(value, ((0, 0), (0, scene.states - value.shape[1])))
    if scene.azimuth is None:
        return states
    # The seat's turn is the last of the places.
    return states.at[:, scene.azimuth].set(value[:, 3 * scene.balls + scene.coupling - 1])


def _moving_problem(scene: Joint, params: Params, times: Array) -> tuple[Problem, Problem]:
    """The problem and its rate."""
    return jax.jvp(lambda t: posed(scene, params, t), (times,), (jnp.ones_like(times),))


def _rates_of(scene: Joint) -> Any:
    """Rates of the displacements in equilibrium as a function of all they depend on, given what they are."""

    def closed(problem: Problem, drift: Problem, at: Places) -> Places:
        _, matrix = balance(scene, problem, at)
        return displaced(scene, problem, drift, *solve(matrix, pull(scene, problem, drift, matrix)))

    @jax.custom_jvp
    def rates(problem: Problem, drift: Problem, at: Places, known: Places) -> Places:
        del problem, drift, at
        return known

    @rates.defjvp
    def rule(primals: Any, tangents: Any) -> tuple[Places, Places]:
        return rates(*primals), jax.jvp(closed, primals[:3], tangents[:3])[1]

    return rates


def _with_rates(scene: Joint, c: Any, value: Array, rate: Array) -> Array:
    """Flat states from places and their rates; the cage turns about its axis at the drive's speed."""
    n, count = scene.balls, value.shape[0]
    tilt = scene.slices["cage_turn"]
    spin = jnp.broadcast_to(c.programmes["drive_speed"] * c.bisector, (count, 3))
    if tilt is not None:
        at = slice(3 * n + tilt.start, 3 * n + tilt.stop)
        axis = value[:, at]
        spin = jnp.cross(axis, rate[:, at]) + c.programmes["drive_speed"] * axis
        rate = rate.at[:, at].set(spin)
    balls = rate[:, : 3 * n].reshape(count, n, 3)
    if scene.spin:
        balls = jnp.concatenate([balls, jnp.broadcast_to(spin[:, None], (count, n, 3))], -1)
    moving = jnp.concatenate([value, balls.reshape(count, -1), rate[:, 3 * n :]], 1)
    return still(scene, moving)


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
        return here, jax.tree.map(jnp.negative, *solve(matrix, out))

    return at
