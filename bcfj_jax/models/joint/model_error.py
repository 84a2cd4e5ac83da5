"""What the joint in equilibrium leaves out, estimated from its own solution: the error indicator of the static levels.

The motion without clearance says how everything slides, so that friction, damping and the balls' inertia can be
evaluated at each equilibrium that leaves them out. What they push is not balanced there. One step of Newton's method,
with the equilibrium's own matrix, moves the parts until it is,  dx = K^-1 f,  and with  dN = (dN/dx) dx  the normal
forces change by about what the dynamic model would change them. The cage turns about its own axis as fast as leaves it
no torque.

Of first order in friction: good where it is small, which is where a level without friction can be right, and large where
friction is. Not in it: what the take-up of the load sets swinging.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.equilibrium_residual import Places, Problem, balance, slices_of, solve, tilted_axis
from bcfj_jax.models.joint.kinematic import kinematic_readings, nominal
from bcfj_jax.models.joint.observe import observe
from bcfj_jax.models.joint.quasistatic import flat_places, posed, quasistatic_places, still
from bcfj_jax.models.joint.scene import Joint

# Newton steps for the cage's turn about its axis, which friction's slope makes quick.
_TURNS = 4


class Statics(NamedTuple):
    """Normal forces at T instants by contact, (T, balls) or (T,) [N]."""

    # kinematic, quasistatic: of the two levels that solve no motion.
    kinematic: dict[str, Array]
    quasistatic: dict[str, Array]
    left_out: dict[str, Array]  # what the quasistatic ones lack, to first order
    converged: Array  # (T,) whether there is an equilibrium


def generalised(scene: Joint, problem: Problem, at: Places, ball: Array, coupling: Array) -> Places:
    """Wrenches as ``system.on_bodies`` has them, (T, balls, twist) and (T, coupling), on the unknowns of ``balance``."""
    slices, where, lever = slices_of(scene), scene.slices, problem.lever
    parts = {"turn": coupling[:, where["head_turn"]].T / lever}
    if "head" in slices:
        parts["head"] = coupling[:, where["head"]].T
    if "cage" in slices:
        parts["cage"] = coupling[:, where["cage"]].T
        torque = coupling[:, where["cage_turn"]].T
        axis, ways = jax.vmap(partial(tilted_axis, problem.c), 1, (1, 2))(at.coupling[slices["tilt"]] / lever)
        parts["tilt"] = jnp.sum(torque[:, None] * jnp.cross(axis[:, None], ways, axis=0), 0) / lever
    return Places(jnp.transpose(ball[..., :3], (2, 1, 0)), jnp.concatenate([parts[name] for name in slices]))


def _wrench(scene: Joint, c: Any, y: Array) -> tuple[Array, Array]:
    state = system.view(scene, c, y)
    return system.on_bodies(scene, c, state, system.contact_forces(scene, c, state))


def _free_turn(scene: Joint, c: Any, y: Array) -> Array:
    """The state with the cage turning about its own axis so that nothing brakes or drives it."""
    piece = scene.slices["cage_turn"]
    if piece is None:
        return y
    first = (3 + scene.twist) * scene.balls + scene.coupling
    axis = system.view(scene, c, y).cage_axis

    def turned(extra: Array) -> Array:
        return y.at[first + piece.start : first + piece.stop].add(extra * axis)

    def torque(extra: Array) -> Array:
        return _wrench(scene, c, turned(extra))[1][piece] @ axis

    def step(_: Any, extra: Array) -> Array:
        value, slope = jax.jvp(torque, (extra,), (jnp.ones(()),))
        return extra - jnp.where(slope < 0.0, value / jnp.where(slope < 0.0, slope, -1.0), 0.0)

    return turned(jax.lax.fori_loop(0, _TURNS, step, jnp.zeros(())))


@partial(jax.jit, static_argnums=0)
def statics(scene: Joint, params: Params, times: Array) -> Statics:
    """Both static levels at the times (T,) [s], in any order, and what they leave out. Compiled once a scene and number of times.

    ``scene`` is of fidelity "quasistatic" (so that it has no bristles), with the laws of the dynamic one.
    """
    times = jnp.asarray(times, dtype=float)
    found = quasistatic_places(scene, params, times)
    problem, at = posed(scene, params, times), found.places
    value = flat_places(scene, problem, at)
    c, size = problem.c, value.shape[1]
    moves = (jnp.arange(scene.states) >= size) & (jnp.arange(scene.states) < scene.moving)

    def of(t: Array) -> Array:
        return nominal(scene, params, params["drive_speed"] * t)

    ideal, change = jax.vmap(lambda t: jax.jvp(of, (t,), (jnp.ones(()),)))(times)
    states = jnp.concatenate([value, ideal[:, size:]], 1)

    def lacking(y: Array, rate: Array) -> tuple[Array, Array]:
        rest, moving = (_wrench(scene, c, x) for x in (jnp.where(moves, 0.0, y), _free_turn(scene, c, y)))
        ball, coupling = (a - b for a, b in zip(moving, rest, strict=True))
        swing = rate[size : size + scene.twist * scene.balls].reshape(scene.balls, -1)[:, :3]
        return ball.at[:, :3].add(-swing / c.ball_inverse_mass[:3]), coupling

    pushed = generalised(scene, problem, at, *jax.vmap(lacking)(states, change))
    _, matrix = balance(scene, problem, at)
    (step,) = solve(matrix, pushed)

    def normals(places: Places) -> dict[str, Array]:
        rest = still(scene, flat_places(scene, problem, places))
        return {name: r.force[..., 0] for name, r in jax.vmap(lambda y: observe(scene, c, y))(rest).items()}

    here, change_of = jax.jvp(normals, (at,), (step,))
    ideal_readings = kinematic_readings(scene, params, times)
    sketched = {name: reading.force[..., 0] for name, reading in ideal_readings.items()}
    return Statics(sketched, here, change_of, found.converged)
