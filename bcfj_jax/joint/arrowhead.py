"""The joint's Jacobian by relative motion, and its factorisation as an arrowhead.

Balls touch only seat, head and cage, so with the places eliminated (they are integrals of the velocities) the matrix
I/s - J  is  one (twist x twist) block a ball, bordered by head, cage and seat. Blocks are eliminated ball by
ball; what is left is one matrix of the border's size, whose inverse is kept.

The local derivatives, by relative place and relative twist, are those of ``contacts.slopes``. The chain to the
coordinates, for a wrench W on a ball from a body with arm r, relative twist h and angular velocity w:

    ball place p:      A = K - C_v [w]x            body place:    -A
    ball twist:        C                           body twist:    -C B,  B = (I, -[r]x; 0, I)
    body rotation:     G = K [r]x + C [h]x - [W]x  (the body's axes turn; the ball does not)

and the body feels  -B' W,  whose arm also moves with p. K = dW/dplace, C = dW/dtwist, all in world axes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.joint import system
from bcfj_jax.joint.constants import Constants
from bcfj_jax.joint.contacts import grooves, pilots, slopes, windows
from bcfj_jax.joint.scene import Joint
from bcfj_jax.solvers.small import inverse, inverse3, inverse6
from bcfj_jax.solvers.structure import AbstractStructure


class Blocks(NamedTuple):
    """Derivative of contact wrenches and border forces; n balls, k twists, b border coordinates.

    ``place`` by displacement, ``rate`` by velocity: of ball i by itself (n, k, 3 | k), of ball i by the border
    (n, k, b), of the border by ball i (n, b, 3 | k), of the border by itself (b, b). The cage's turn is a
    rotation vector here.
    """

    ball_place: Array
    ball_rate: Array
    column_place: Array
    column_rate: Array
    row_place: Array
    row_rate: Array
    border_place: Array
    border_rate: Array


class Factors(NamedTuple):
    """What ``solve`` reads; s is the scale."""

    blocks: Blocks
    scale: Array
    ball_inverse: Array
    column: Array
    row: Array
    border_inverse: Array
    axis: Array
    spin: Array
    c: Constants


class _Body(NamedTuple):
    """A body's part of the blocks, its columns in the order place, turn."""

    ball_place: Array
    ball_rate: Array
    column_place: Array
    column_rate: Array
    row_place: Array
    row_rate: Array
    border_place: Array
    border_rate: Array


def _chain(
    value: Array, by_place: Array, by_twist: Array, motion: system.Motion, spin: Array, moves: bool, turn: Array
) -> _Body:
    """The chain of the module's docstring for one body; ``turn`` (3, m): the rotations it is capable of."""
    k = value.shape[-1]
    at_ball = by_place - jnp.cross(by_twist[..., :3], spin)
    arm = motion.arm[:, None, :]
    force = value[:, None, :3]
    frame = jnp.cross(by_place, arm) + jnp.cross(by_twist[..., :3], motion.velocity[:, None, :])
    turning = -jnp.cross(jnp.eye(3), force)
    lever = -jnp.cross(jnp.eye(3), arm)
    if motion.spin is not None:
        frame = frame + jnp.cross(by_twist[..., 3:], motion.spin[:, None, :])
        turning = jnp.concatenate([turning, -jnp.cross(jnp.eye(3), value[:, None, 3:])], -2)
        lever = jnp.concatenate([lever, jnp.broadcast_to(jnp.eye(3), lever.shape)], -2)
    columns, twists = [(frame + turning) @ turn], [lever @ turn]
    # The arm of the moment moves with the ball and with the body's own place: [f]x, projected on the turns.
    arm_moves = jnp.swapaxes(turn, 0, 1) @ jnp.cross(jnp.eye(3), force)
    shift = [arm_moves]
    if moves:
        columns.insert(0, -at_ball)
        twists.insert(0, jnp.broadcast_to(jnp.eye(k, 3), (value.shape[0], k, 3)))
        shift.insert(0, jnp.zeros((value.shape[0], 3, 3)))
    column_place, twists, shift = (jnp.concatenate(x, axis) for x, axis in ((columns, -1), (twists, -1), (shift, -2)))
    back = -jnp.swapaxes(twists, -1, -2)
    column_rate = -by_twist @ twists
    border_place = jnp.sum(back @ column_place, 0)
    if moves:
        border_place = border_place.at[:, :3].add(-jnp.sum(shift, 0))
    return _Body(
        at_ball,
        by_twist,
        column_place,
        column_rate,
        back @ at_ball + shift,
        back @ by_twist,
        border_place,
        jnp.sum(back @ column_rate, 0),
    )


def _border_alone(scene: Joint, c: Constants, state: system.State, t: Array) -> tuple[Array, Array]:
    """Derivatives of pilot and drive forces by border displacement and border rate.

    Spheres have no axes, so only the centres' distance p and the relative twist count:  dv = ... - w_outer x dp.
    """
    b = scene.border
    place, rate = jnp.zeros((b, b)), jnp.zeros((b, b))
    if c.pilot_skin is not None:
        motion, spin = system.guided(scene, c, state)
        at = pilots(c.pilot_clearance, c.pilot_hollow, motion.arm)
        value, by_place, by_twist = slopes(c.pilot_skin, at, motion.velocity, motion.spin)
        maps = system.guide_maps(scene, c, motion.arm)
        moves = system.centre_maps(scene)
        back = jnp.swapaxes(maps, -1, -2)
        pushed = (by_place - jnp.cross(by_twist[..., :3], spin[:, None, :])) @ moves
        place = place + jnp.sum(back @ pushed, 0)
        rate = rate + jnp.sum(back @ by_twist @ maps, 0)
        # The outer body's moment is -p x f, and p moves.
        for index, name in enumerate(scene.pilots):
            arm = jnp.cross(jnp.eye(3), value[index, :3]) @ moves[index]
            if name == "seat_cage":
                place = place.at[_slot(scene, "seat_turn")].add((c.axes[0] @ arm)[None])
            elif scene.cage == "free":
                place = place.at[_slot(scene, "cage_turn")].add(arm)
    if scene.drive == "flexible":
        seat = _slot(scene, "seat_turn")
        place, rate = place.at[seat, seat].add(-c.drive_stiffness), rate.at[seat, seat].add(-c.drive_damping)
    return place, rate


def blocks(scene: Joint, c: Constants, t: Array, y: Array) -> Blocks:
    """All derivatives of contact wrenches and border forces in one state."""
    state = system.view(scene, c, y)
    n, b, k = scene.balls, scene.border, scene.twist
    motion, across, spins = system.races(c, state)
    at = grooves(c.groove, motion.arm - c.groove.offset[:, None] * c.axes, across)
    value, by_place, by_twist = slopes(c.groove_skin, at, motion.velocity, motion.spin)
    bodies: list[tuple[list[str], _Body]] = []
    for index, (names, moves) in enumerate(((["seat_turn"], False), (["head", "head_turn"], scene.head == "free"))):
        side = jax.tree.map(lambda x, i=index: x[:, i], motion)
        turn = c.axes[index][:, None]
        body = _chain(value[:, index], by_place[:, index], by_twist[:, index], side, spins[index], moves, turn)
        bodies.append((names if moves or len(names) == 1 else names[1:], body))
    if c.window_skin is not None:
        motion = system.relative(state, state.cage_place, state.cage_velocity, state.cage_spin)
        at = windows(c.window_clearance, c.groove.ball, motion.arm, state.cage_axis)
        local = slopes(c.window_skin, at, motion.velocity, motion.spin)
        body = _chain(*local, motion, state.cage_spin, True, jnp.eye(3))
        bodies.append((["cage", "cage_turn"] if scene.cage == "free" else [], body))
    column_place, column_rate = jnp.zeros((n, k, b)), jnp.zeros((n, k, b))
    row_place, row_rate = jnp.zeros((n, b, 3)), jnp.zeros((n, b, k))
    border_place, border_rate = _border_alone(scene, c, state, t)
    for names, body in bodies:
        if not names:
            continue
        at = slice(_slot(scene, names[0]).start, _slot(scene, names[-1]).stop)
        column_place = column_place.at[..., at].set(body.column_place)
        column_rate = column_rate.at[..., at].set(body.column_rate)
        row_place = row_place.at[:, at].set(body.row_place)
        row_rate = row_rate.at[:, at].set(body.row_rate)
        border_place = border_place.at[at, at].add(body.border_place)
        border_rate = border_rate.at[at, at].add(body.border_rate)
    return Blocks(
        sum(body.ball_place for _, body in bodies),
        sum(body.ball_rate for _, body in bodies),
        column_place,
        column_rate,
        row_place,
        row_rate,
        border_place,
        border_rate,
    )


def _slot(scene: Joint, name: str) -> slice:
    slot = scene.slots[name]
    assert slot is not None
    return slot


def _cayley(vector: Array, spin: Array, scale: Array) -> Array:
    """(I - s [w]x)^-1 x, in closed form: (x + s w x x + s^2 w (w . x)) / (1 + s^2 w . w)."""
    w = scale * spin
    return (vector + jnp.cross(w, vector) + w * (vector @ w)[..., None]) / (1.0 + w @ w)


class Arrowhead(AbstractStructure):
    """The joint's field with its structure; ``args`` is (scene, constants)."""

    def field(self, t: Array, y: Array, args: Any) -> Array:
        """``system.field``."""
        return system.field(t, y, args)

    def time_derivative(self, t: Array, y: Array, args: Any) -> Array:
        """Of load and drive, the only things that depend on time."""
        scene, c = args
        state = system.view(scene, c, y)
        rate = jax.jvp(lambda t: system.applied(scene, c, t, state), (t,), (jnp.ones_like(t),))[1]
        return jnp.concatenate([jnp.zeros(scene.states - scene.border), rate * c.border_lightness])

    def factor(self, t: Array, y: Array, args: Any, scale: Array) -> Factors:
        """Blocks, the balls' inverses, the border's Schur complement inverted."""
        scene, c = args
        d = blocks(scene, c, t, y)
        k = scene.twist
        state = system.view(scene, c, y)
        lift = c.ball_lightness[:, None]
        ball = jnp.eye(k) / scale - lift * (d.ball_rate.at[..., :3].add(scale * d.ball_place))
        column_place, border_place = d.column_place * scale, d.border_place * scale
        tilt = scene.slots["cage_turn"]
        if tilt is not None:
            turn = self._turn(state.cage_axis, state.cage_spin, scale)
            column_place = column_place.at[..., tilt].set(d.column_place[..., tilt] @ turn)
            border_place = border_place.at[:, tilt].set(d.border_place[:, tilt] @ turn)
        column = -lift * (d.column_rate + column_place)
        weight = c.border_lightness[:, None]
        row = -weight * (d.row_rate.at[..., :3].add(scale * d.row_place))
        border = jnp.eye(scene.border) / scale - weight * (d.border_rate + border_place)
        ball_inverse = inverse3(ball) if k == 3 else inverse6(ball)
        column = ball_inverse @ column
        schur = border - jnp.sum(row @ column, 0)
        return Factors(d, scale, ball_inverse, column, row, inverse(schur), state.cage_axis, state.cage_spin, c)

    @staticmethod
    def _turn(axis: Array, spin: Array, scale: Array) -> Array:
        """Rotation of the cage's axis per change of its angular velocity, (3, 3): -s [b]x (I - s [w]x)^-1 [b]x."""
        eye = jnp.eye(3)
        tilted = _cayley(-jnp.cross(axis, eye), spin, scale)
        return scale * jnp.swapaxes(jnp.cross(axis, tilted), 0, 1)

    def solve(self, factors: Factors, right: Array) -> Array:
        """Places eliminated, balls eliminated, border solved, and back."""
        d, s, c = factors.blocks, factors.scale, factors.c
        n, k, b = d.ball_rate.shape[0], d.ball_rate.shape[1], d.border_rate.shape[0]
        place, at = right[: 3 * n].reshape(n, 3), right[3 * n : 3 * n + b]
        twist, rate = right[3 * n + b : (3 + k) * n + b].reshape(n, k), right[(3 + k) * n + b :]
        tilted = b >= 9 or b == 8
        shift = s * at
        if tilted:
            tilt = slice(b - 4, b - 1)
            known = s * _cayley(at[tilt], factors.spin, s)
            shift = shift.at[tilt].set(jnp.cross(factors.axis, known))
        ball = twist + c.ball_lightness * (
            jnp.einsum("nkj,nj->nk", d.ball_place, s * place) + jnp.einsum("nkb,b->nk", d.column_place, shift)
        )
        border = rate + c.border_lightness * (
            jnp.einsum("nbj,nj->b", d.row_place, s * place) + d.border_place @ shift
        )
        ball = jnp.einsum("nkl,nl->nk", factors.ball_inverse, ball)
        rates = factors.border_inverse @ (border - jnp.einsum("nbk,nk->b", factors.row, ball))
        twists = ball - jnp.einsum("nkb,b->nk", factors.column, rates)
        places = s * (place + twists[:, :3])
        moved = s * (at + rates)
        if tilted:
            moved = moved.at[tilt].set(
                known - s * _cayley(jnp.cross(factors.axis, rates[tilt]), factors.spin, s)
            )
        return jnp.concatenate([places.ravel(), moved, twists.ravel(), rates])
