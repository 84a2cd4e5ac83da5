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
from bcfj_jax.joint.contacts import dot, grooves, pilots, slopes, windows
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


class _Part(NamedTuple):
    """What places or turns of a body add: columns (n, k, m) by place and rate, rows (n, m, 3 | k),  -B' (n, m, k)."""

    column_place: Array
    column_rate: Array
    row_place: Array
    row_rate: Array
    back: Array


BODIES = (("head", "head_turn"), ("cage", "cage_turn"), ("seat_turn",))


def _turning(
    value: Array, by_place: Array, at_ball: Array, by_twist: Array, motion: system.Motion, axes: Array
) -> tuple[_Part, _Part]:
    """Turns of seat and head about their axes a:  G a,  -C B a,  -(B a)' A + (a x f)',  -(B a)' C."""
    swept = jnp.cross(axes, motion.arm)
    twist, frame, carried = swept, jnp.cross(axes, motion.velocity), jnp.cross(axes, value[..., :3])
    if motion.spin is not None:
        twist = jnp.concatenate([swept, jnp.broadcast_to(axes, swept.shape)], -1)
        frame = jnp.concatenate([frame, jnp.cross(axes, motion.spin)], -1)
        carried = jnp.concatenate([carried, jnp.cross(axes, value[..., 3:])], -1)
    column_place = carried - dot(by_place, swept[..., None, :]) - dot(by_twist, frame[..., None, :])
    row_place = jnp.cross(axes, value[..., :3]) - jnp.sum(twist[..., :, None] * at_ball, -2)
    row_rate = -jnp.sum(twist[..., :, None] * by_twist, -2)
    column_rate = -dot(by_twist, twist[..., None, :])
    columns, rows = (column_place, column_rate), (row_place, row_rate, -twist)
    seat, head = (_Part(*(x[:, i, :, None] for x in columns), *(x[:, i, None] for x in rows)) for i in (0, 1))
    return seat, head


def _shifted(at_ball: Array, by_twist: Array) -> _Part:
    """A body's own place: minus what the balls' places do."""
    n, k = at_ball.shape[:2]
    back = -jnp.broadcast_to(jnp.eye(3, k), (n, 3, k))
    return _Part(-at_ball, -by_twist[..., :3], -at_ball[:, :3], -by_twist[:, :3], back)


def _nothing(n: int, k: int) -> _Part:
    """A cage that touches no ball."""
    return _Part(jnp.zeros((n, k, 3)), jnp.zeros((n, k, 3)), jnp.zeros((n, 3, 3)), *[jnp.zeros((n, 3, k))] * 2)


def _corner(parts: dict[str, _Part], names: list[str]) -> tuple[Array, Array] | None:
    """A body's own block: its turn through the wrenches, its place as minus all the balls' places."""
    if not names:
        return None
    row_place, row_rate, back = (jnp.concatenate([parts[x][i] for x in names], 1) for i in (2, 3, 4))
    turn = parts[names[-1]]
    place, rate = jnp.sum(back @ turn.column_place, 0), jnp.sum(back @ turn.column_rate, 0)
    if len(names) == 1:
        return place, rate
    shift_place, shift_rate = -jnp.sum(row_place, 0), -jnp.sum(row_rate[..., :3], 0)
    return jnp.concatenate([shift_place, place], -1), jnp.concatenate([shift_rate, rate], -1)


def _tilting(value: Array, by_place: Array, at_ball: Array, by_twist: Array, motion: system.Motion) -> _Part:
    """Rotations of the cage about any axis; shapes (n, k, 3) for columns, (n, 3, k) for rows."""
    eye = jnp.eye(3)
    arm, force = motion.arm[:, None, :], value[:, None, :3]
    frame = jnp.cross(by_place, arm) + jnp.cross(by_twist[..., :3], motion.velocity[:, None, :])
    carried, lever = jnp.cross(force, eye), jnp.cross(arm, eye)
    if motion.spin is not None:
        frame = frame + jnp.cross(by_twist[..., 3:], motion.spin[:, None, :])
        carried = jnp.concatenate([carried, jnp.cross(value[:, None, 3:], eye)], -2)
        lever = jnp.concatenate([lever, jnp.broadcast_to(eye, lever.shape)], -2)
    back = -jnp.swapaxes(lever, -1, -2)
    moved = jnp.cross(eye, force)
    return _Part(frame + carried, -by_twist @ lever, back @ at_ball + moved, back @ by_twist, back)


def _alone(scene: Joint, c: Constants, state: system.State) -> tuple[Array, Array]:
    """Derivatives of pilot and drive forces by border displacement and border rate, (b, b).

    Spheres have no axes, so only the distance p of the centres and the relative twist count, and
    dv = ... - w_outer x dp; the forces' map moves with p too.
    """
    b = scene.border
    place, rate = jnp.zeros((b, b)), jnp.zeros((b, b))
    if c.pilot_skin is not None:
        motion, spin = system.guided(scene, c, state)
        at = pilots(c.pilot_clearance, c.pilot_hollow, motion.arm)
        value, by_place, by_twist = slopes(c.pilot_skin, at, motion.velocity, motion.spin)
        back = jnp.swapaxes(system.guide_maps(c, motion.arm), -1, -2)
        moved = back @ (by_place - jnp.cross(by_twist[..., :3], spin[:, None, :]))
        moved = moved + jnp.einsum("pikb,pk->pbi", c.guides.lever, value)
        place = jnp.einsum("pbi,pic->bc", moved, c.guides.moves)
        rate = jnp.sum(back @ by_twist @ jnp.swapaxes(back, -1, -2), 0)
    if scene.drive == "flexible":
        seat = _slot(scene, "seat_turn")
        place, rate = place.at[seat, seat].add(-c.drive_stiffness), rate.at[seat, seat].add(-c.drive_damping)
    return place, rate


def blocks(scene: Joint, c: Constants, y: Array) -> Blocks:
    """All derivatives of contact wrenches and border forces in one state."""
    state = system.view(scene, c, y)
    n, k = scene.balls, scene.twist
    motion, across, spins = system.races(c, state)
    at = grooves(c.groove, motion.arm - c.groove.offset[:, None] * c.axes, across)
    value, by_place, by_twist = slopes(c.groove_skin, at, motion.velocity, motion.spin)
    at_ball = by_place - jnp.cross(by_twist[..., :3], spins[:, None, :])
    seat, head = _turning(value, by_place, at_ball, by_twist, motion, c.axes)
    ball_place, ball_rate = jnp.sum(at_ball, 1), jnp.sum(by_twist, 1)

    # Columns and rows of each part of the border that the balls feel; a body's own place is minus all balls' places.
    parts: dict[str, _Part] = {
        "head": _shifted(at_ball[:, 1], by_twist[:, 1]),
        "head_turn": head,
        "seat_turn": seat,
    }
    if c.window_skin is not None:
        motion = system.relative(state, state.cage_place, state.cage_velocity, state.cage_spin)
        at = windows(c.window_clearance, c.groove.ball, motion.arm, state.cage_axis)
        value, by_place, by_twist = slopes(c.window_skin, at, motion.velocity, motion.spin)
        at_ball = by_place - jnp.cross(by_twist[..., :3], state.cage_spin)
        ball_place, ball_rate = ball_place + at_ball, ball_rate + by_twist
        parts["cage"] = _shifted(at_ball, by_twist)
        parts["cage_turn"] = _tilting(value, by_place, at_ball, by_twist, motion)
    else:
        parts |= {"cage": _nothing(n, k), "cage_turn": _nothing(n, k)}
    names = [name for name, slot in scene.slots.items() if slot is not None]
    column_place, column_rate = (jnp.concatenate([parts[x][i] for x in names], -1) for i in (0, 1))
    row_place, row_rate = (jnp.concatenate([parts[x][i] for x in names], -2) for i in (2, 3))
    place, rate = _alone(scene, c, state)
    corners = [_corner(parts, [x for x in body if x in names]) for body in BODIES]
    return Blocks(
        ball_place,
        ball_rate,
        column_place,
        column_rate,
        row_place,
        row_rate,
        place + jax.scipy.linalg.block_diag(*(corner[0] for corner in corners if corner is not None)),
        rate + jax.scipy.linalg.block_diag(*(corner[1] for corner in corners if corner is not None)),
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

    def field(self, t: Any, y: Array, args: Any) -> Array:
        """``system.field``."""
        return system.field(t, y, args)

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        """Of load and drive, the only things that depend on time."""
        scene, c = args
        state = system.view(scene, c, y)
        rate = jax.jvp(lambda t: system.applied(scene, c, t, state), (t,), (jnp.ones_like(t),))[1]
        return jnp.concatenate([jnp.zeros(scene.states - scene.border), rate * c.border_lightness])

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> Factors:
        """Blocks, the balls' inverses, the border's Schur complement inverted."""
        scene, c = args
        d = blocks(scene, c, y)
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
        # Where the cage is free its turn stands before the seat's, which is last.
        tilted = b >= 8
        shift = s * at
        if tilted:
            tilt = slice(b - 4, b - 1)
            known = s * _cayley(at[tilt], factors.spin, s)
            shift = shift.at[tilt].set(jnp.cross(factors.axis, known))
        ball = twist + c.ball_lightness * (
            jnp.einsum("nkj,nj->nk", d.ball_place, s * place) + jnp.einsum("nkb,b->nk", d.column_place, shift)
        )
        border = rate + c.border_lightness * (jnp.einsum("nbj,nj->b", d.row_place, s * place) + d.border_place @ shift)
        ball = jnp.einsum("nkl,nl->nk", factors.ball_inverse, ball)
        rates = factors.border_inverse @ (border - jnp.einsum("nbk,nk->b", factors.row, ball))
        twists = ball - jnp.einsum("nkb,b->nk", factors.column, rates)
        places = s * (place + twists[:, :3])
        moved = s * (at + rates)
        if tilted:
            moved = moved.at[tilt].set(known - s * _cayley(jnp.cross(factors.axis, rates[tilt]), factors.spin, s))
        return jnp.concatenate([places.ravel(), moved, twists.ravel(), rates])
