"""What joints, drives and loads do in one state: the forces by which pins, bolts and motors are sized.

A joint's reaction follows from Newton's and Euler's laws of what hangs on it (Kane and Levinson, Dynamics, 1985): with F and
T the contacts and loads on a body, T about its origin o, and c from o to its centre of mass,

    R = sum m a - F,        M = sum (c - o) x m a + I w' + w x I w - T + (o_k - o) x R_k

over the body and the joints k that it carries. Neither constraints nor multipliers are solved for. R is all that goes
through the joint: its drive and the loads on its coordinate, too. Along a free coordinate it is the sum of these, else 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.vectors import ZERO, Vector, add, cross, dot, length, scale, spread, stacked, subtract, times, turned
from bcfj_jax.mechanism import equations, sizes
from bcfj_jax.mechanism.bodies import GROUND, Part, rotated
from bcfj_jax.mechanism.dynamics import Dynamics, Instant
from bcfj_jax.mechanism.instruments import power
from bcfj_jax.mechanism.loads import AbstractLoad, CoordinateLoad
from bcfj_jax.mechanism.model import Effort, Params

_NOTHING = (ZERO, ZERO)


class _Wrenches(equations.Equations):
    """Forces on bodies, and their moments about the bodies' origins, in place of forces on velocities."""

    def __init__(self, parts: dict[str, Part], members: dict[str, int]) -> None:
        super().__init__(())
        self.names, self.each = {id(part): name for name, part in parts.items()}, members
        self.found: dict[str, tuple[Vector, Vector]] = {}

    def act(self, part: Part, arm: Vector, force: Vector, torque: Vector = ZERO) -> None:
        self.wrench(part, force, add(cross(arm, force), torque), arm)

    def wrench(self, part: Part, force: Vector, moment: Vector, arm: Vector) -> None:
        name = self.names[id(part)]
        one, other = self.found.get(name, _NOTHING)
        self.found[name] = add(one, self._of(name, force)), add(other, self._of(name, moment))

    def push(self, j: int, force: Any, of: tuple[int, int] | None = None) -> None:
        """It goes through a joint."""

    def _of(self, name: str, vector: Vector) -> Vector:
        x, y, z = (equations.total(x, self.each.get(name, 0)) for x in vector)
        return x, y, z


def efforts(m: Dynamics, t: Array, y: Array, p: Params) -> dict[str, Effort]:
    """``AbstractModel.efforts``."""
    m = replace(m, one_by_one=True)
    now = m.instant(t, y, p)
    gathered, count = m.assembled(t, now, p), len(m._free)
    rates = gathered.accelerations(count)
    loads = {load.name: _of_load(m, load, t, now, p) for load in m.loads}
    drives: dict[str, Array] = {}
    for k, b in enumerate(m._driven):
        assert b.drive is not None
        drives[b.name] = gathered.reaction(count + k, rates) * b.drive.motion(t, b.name, p)[1]
    joints = {}
    for name, (force, moment) in _reactions(m, t, now, rates, p).items():
        b = m.body(name)
        axes = now.bodies.parts[b.parent].axes
        if b.tilt is not None:
            axes = rotated(axes, sizes.axis(b.tilt[0], name), sizes.length(b.tilt[1], name, "tilt", p))
        joints[name] = Effort(
            stacked(force, b.members), stacked(moment, b.members), axes=jnp.stack([stacked(x, 0) for x in axes], -1),
            power=None if name not in drives else jnp.asarray(drives[name]),
        )  # fmt: skip
    return loads | joints


def _reactions(
    m: Dynamics, t: Array, now: Instant, rates: Sequence[Any], p: Params
) -> dict[str, tuple[Vector, Vector]]:
    """By body the force of its joint on it, and its moment about the body's origin; from the tips to the ground."""
    bodies = now.bodies
    acting = _Wrenches(dict(bodies.parts), {b.name: b.members for b in m.bodies})
    m._pressed(acting, now, p)
    for load in m.loads:
        m._loaded(acting, load, t, now, p)
    borne: dict[str, tuple[Vector, Vector]] = {}
    for b in reversed(m.ordered):
        part, arm, inertia = bodies.parts[b.name], bodies.center[b.name], m.inertia(b, p)
        gain, swirl = part.shifted(arm).gained(rates)
        push = scale(bodies.mass[b.name], gain)
        turn = cross(arm, push)
        if inertia is not None:
            spun = cross(part.spin, equations.inertial(inertia, part.axes, part.spin))
            turn = add(turn, equations.inertial(inertia, part.axes, swirl), spun)
        force, torque = acting.found.get(b.name, _NOTHING)
        hung = borne.get(b.name, _NOTHING)
        borne[b.name] = found = add(hung[0], subtract(push, force)), add(hung[1], subtract(turn, torque))
        if b.parent != GROUND:
            first, second = borne.get(b.parent, _NOTHING)
            away = subtract(part.place, bodies.parts[b.parent].place)
            borne[b.parent] = add(first, found[0]), add(second, found[1], cross(away, found[0]))
    return {b.name: borne[b.name] for b in m.ordered}


def _of_load(m: Dynamics, load: AbstractLoad, t: Array, now: Instant, p: Params) -> Effort:
    given = jnp.asarray(power(m, load, t, now, p))
    if isinstance(load, CoordinateLoad):
        return Effort(power=given, drive=jnp.asarray(m.sprung(load, t, now, p)[-1][1]))
    if not load.acts_on:
        return Effort(power=given)
    actions = [action for action in load.actions(t, now.bodies, p) if action.body == load.acts_on]
    k = 0 if load.acts_on == GROUND else m.body(load.acts_on).members
    force, moment = ZERO, ZERO
    for action in actions:
        arm = turned(now.bodies.parts[action.body].axes, subtract(action.at, actions[0].at))
        force, moment = add(force, action.force), add(moment, action.torque, cross(arm, action.force))
    found = Effort(force=stacked(force, k), moment=stacked(moment, k), power=given)
    if (apart := load.apart(now.bodies, p)) is None:
        return found
    far = length(apart)
    pull = times(-1.0, dot(force, apart)) / jnp.where(jnp.asarray(far) > 0.0, far, 1.0)
    return found._replace(pull=spread(pull, 0), length=spread(far, 0))
