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

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.joint import system
from bcfj_jax.joint.constants import Constants
from bcfj_jax.joint.contacts import dot, pilots, slopes
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
    ball_lightness: Array
    border_lightness: Array


def _felt(arm: Array, wrench: Array) -> Array:
    """Wrenches on the balls (n, m, k, j) as seen from the bodies' centres (n, m, 6, j): (f, r x f + moment)."""
    force = wrench[..., :3, :]
    moment = jnp.cross(arm[..., None, :], jnp.swapaxes(force, -1, -2)).swapaxes(-1, -2)
    if wrench.shape[-2] == 6:
        moment = moment + wrench[..., 3:, :]
    return jnp.concatenate([force, moment], -2)


def _spread(scene: Joint, c: Constants, x: Array) -> Array:
    """From displacements and rotations of the bodies (..., m, j, 6) to border coordinates (..., j, border)."""
    seat, head = x[..., 0, :, :], x[..., 1, :, :]
    cage = x[..., 2, :, :] if x.shape[-3] == 3 else jnp.zeros_like(head)
    parts = {
        "head": head[..., :3],
        "head_turn": dot(head[..., 3:], c.axes[1])[..., None],
        "cage": cage[..., :3],
        "cage_turn": cage[..., 3:],
        "seat_turn": dot(seat[..., 3:], c.axes[0])[..., None],
    }
    return jnp.concatenate([parts[name] for name, slot in scene.slots.items() if slot is not None], -1)


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
    k = scene.twist
    around = system.around(scene, c, state)
    found = [slopes(skin, at, motion.velocity, motion.spin) for skin, at, motion in around.parts()]
    value, by_place, by_twist = (jnp.concatenate(x, 1) for x in zip(*found, strict=True))
    motion, eye = around.motion, jnp.eye(3)
    arm, velocity = motion.arm[..., None, :], motion.velocity[..., None, :]

    # By displacement and by rotation of the body, (n, m, k, 3) each: A, G by place, C_v and C B by rate.
    at_ball = by_place - jnp.cross(by_twist[..., :3], around.spins[:, None, :])
    turned = jnp.cross(by_place, arm) + jnp.cross(by_twist[..., :3], velocity)
    carried = jnp.cross(value[..., None, :3], eye)
    swung = jnp.cross(by_twist[..., :3], arm)
    if motion.spin is not None:
        turned = turned + jnp.cross(by_twist[..., 3:], motion.spin[..., None, :])
        carried = jnp.concatenate([carried, jnp.cross(value[..., None, 3:], eye)], -2)
        swung = swung - by_twist[..., 3:]
    turned = turned + carried
    columns = jnp.concatenate(
        [jnp.concatenate([-at_ball, turned], -1), jnp.concatenate([-by_twist[..., :3], swung], -1)], -2
    )

    # What the bodies feel of it, (n, m, 6, .); the arm, too, moves with the ball.
    felt = -_felt(motion.arm, jnp.concatenate([at_ball, by_twist, turned, swung], -1))
    lifted = jnp.cross(eye, value[..., None, :3])
    row_place = felt[..., :3] + jnp.concatenate([jnp.zeros_like(lifted), lifted], -2)
    row_rate, felt_turned, felt_swung = felt[..., 3 : 3 + k], felt[..., 3 + k : 6 + k], felt[..., 6 + k :]
    rows = jnp.swapaxes(jnp.concatenate([row_place, row_rate], -1), -1, -2)
    spread = _spread(scene, c, jnp.concatenate([columns, rows], -2))

    # A body's own block: its place is minus all the balls' places.
    own = jnp.concatenate([-row_place, felt_turned, -row_rate[..., :3], felt_swung], -1)
    own = jnp.sum(own, 0).reshape(*own.shape[1:3], 2, 6)
    maps = c.body_maps[: own.shape[0]]
    corner = jnp.einsum("mib,mipj,mjd->pbd", maps, own, maps)
    place, rate = _alone(scene, c, state)
    row = jnp.swapaxes(spread[:, 2 * k :], -1, -2)
    return Blocks(
        jnp.sum(at_ball, 1),
        jnp.sum(by_twist, 1),
        spread[:, :k],
        spread[:, k : 2 * k],
        row[..., :3],
        row[..., 3:],
        place + corner[0],
        rate + corner[1],
    )


def _slot(scene: Joint, name: str) -> slice:
    slot = scene.slots[name]
    assert slot is not None
    return slot


def _cayley(vector: Array, spin: Array, scale: Array) -> Array:
    """(I - s [w]x)^-1 x, in closed form: (x + s w x x + s^2 w (w . x)) / (1 + s^2 w . w)."""
    w = scale * spin
    return (vector + jnp.cross(w, vector) + w * (vector @ w)[..., None]) / (1.0 + w @ w)


@partial(jax.jit, static_argnums=0, inline=True)
def _field(scene: Joint, c: Constants, t: Array, y: Array) -> Array:
    return system.field(t, y, (scene, c))


@partial(jax.jit, static_argnums=0, inline=True)
def _blocks(scene: Joint, c: Constants, y: Array) -> Blocks:
    return blocks(scene, c, y)


class Arrowhead(AbstractStructure):
    """The joint's field with its structure; ``args`` is (scene, constants).

    Solvers call these several times a step, and diffrax traces a step more than once: what is long to trace is
    traced once, under an inlined ``jit``.
    """

    def field(self, t: Any, y: Array, args: Any) -> Array:
        """``system.field``."""
        return _field(*args, t, y)

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        """Of load and drive, the only things that depend on time."""
        scene, c = args
        state = system.view(scene, c, y)
        rate = jax.jvp(lambda t: system.applied(scene, c, t, state), (t,), (jnp.ones_like(t),))[1]
        return jnp.concatenate([jnp.zeros(scene.states - scene.border), rate * c.border_lightness])

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> Factors:
        """Blocks, the balls' inverses, the border's Schur complement inverted."""
        scene, c = args
        d = _blocks(scene, c, y)
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
        return Factors(
            d,
            scale,
            ball_inverse,
            column,
            row,
            inverse(schur),
            state.cage_axis,
            state.cage_spin,
            c.ball_lightness,
            c.border_lightness,
        )

    @staticmethod
    def _turn(axis: Array, spin: Array, scale: Array) -> Array:
        """Rotation of the cage's axis per change of its angular velocity, (3, 3): -s [b]x (I - s [w]x)^-1 [b]x."""
        eye = jnp.eye(3)
        tilted = _cayley(-jnp.cross(axis, eye), spin, scale)
        return scale * jnp.swapaxes(jnp.cross(axis, tilted), 0, 1)

    def solve(self, factors: Factors, right: Array) -> Array:
        """Places eliminated, balls eliminated, border solved, and back."""
        d, s = factors.blocks, factors.scale
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
        ball = twist + factors.ball_lightness * (
            jnp.einsum("nkj,nj->nk", d.ball_place, s * place) + jnp.einsum("nkb,b->nk", d.column_place, shift)
        )
        border = rate + factors.border_lightness * (
            jnp.einsum("nbj,nj->b", d.row_place, s * place) + d.border_place @ shift
        )
        ball = jnp.einsum("nkl,nl->nk", factors.ball_inverse, ball)
        rates = factors.border_inverse @ (border - jnp.einsum("nbk,nk->b", factors.row, ball))
        twists = ball - jnp.einsum("nkb,b->nk", factors.column, rates)
        places = s * (place + twists[:, :3])
        moved = s * (at + rates)
        if tilted:
            moved = moved.at[tilt].set(known - s * _cayley(jnp.cross(factors.axis, rates[tilt]), factors.spin, s))
        return jnp.concatenate([places.ravel(), moved, twists.ravel(), rates])
