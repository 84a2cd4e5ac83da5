"""The joint's Jacobian by relative motion, and its factorisation as an arrowhead.

Balls touch only seat, head and cage, so with the places eliminated (they are integrals of the velocities) the matrix
I/s - J  is  one (twist x twist) block a ball, and coupling coordinates of head, cage and seat. Blocks are eliminated ball by
ball; what is left is one matrix of the coupling's size, whose inverse is kept.

``blocks`` has the derivatives. Bristles, local to a face, are eliminated before the balls.
"""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.blocks import Blocks, blocks
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.geometry import rate_by_axis, turning
from bcfj_jax.models.joint.programmes import torque_at
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.xla.kept import kept
from bcfj_jax.xla.small import inverse, inverse3, inverse6, product


class Heading(NamedTuple):
    """The cage's azimuth in a step."""

    # by_axis, by_spin: (3,) derivatives of its rate.
    by_axis: Array
    by_spin: Array
    # (3,) what a change of the axis alone turns the cage about it, less what it turns the azimuth's frame.
    carried: Array
    back: Array | None  # (3 F,) bristles by the azimuth; None without bristles


class Factors(NamedTuple):
    """What ``solve`` reads; s is the scale."""

    blocks: Blocks
    scale: Array
    ball_inverse: Array
    column: Array
    row: Array
    coupling_inverse: Array
    axis: Array
    spin: Array
    ball_inverse_mass: Array
    coupling_inverse_mass: Array
    heading: Heading | None


def _cayley(vector: Array, spin: Array, scale: Array) -> Array:
    """(I - s [w]x)^-1 x, in closed form: (x + s w x x + s^2 w (w . x)) / (1 + s^2 w . w)."""
    w = scale * spin
    return (vector + jnp.cross(w, vector) + w * (vector @ w)[..., None]) / (1.0 + w @ w)


@partial(jax.jit, static_argnums=0, inline=True)
def _field(scene: Joint, c: Constants, t: Array, y: Array) -> Array:
    return system.field(t, y, (scene, c))


@partial(jax.jit, static_argnums=0, inline=True)
def _blocks(scene: Joint, c: Constants, y: Array, scale: Any) -> Blocks:
    return blocks(scene, c, y, scale)


class Arrowhead(AbstractStructure):
    """The joint's field with its structure; ``args`` is (scene, constants).

    Solvers call these several times a step, and diffrax traces a step more than once: what is long to trace is
    traced once, under an inlined ``jit``.
    """

    alone: ClassVar[bool] = True

    def field(self, t: Any, y: Array, args: Any) -> Array:
        """``system.field``."""
        return _field(*args, t, y)

    def time_derivative(self, t: Any, y: Array, args: Any) -> Array:
        """Of load and drive, the only things that depend on time."""
        scene, c = args
        state = system.view(scene, c, y)

        def changes(t: Any) -> Array:
            found = system.applied(scene, c, t, state) * c.coupling_inverse_mass
            return found.at[-1].set(system.seat_rate(scene, c, t)) if scene.driven else found

        rate = jax.jvp(changes, (t,), (jnp.ones_like(t),))[1]
        still = [jnp.zeros(scene.states - scene.moving)] if scene.states > scene.moving else []
        return jnp.concatenate([jnp.zeros(scene.moving - scene.coupling), rate, *still])

    def factor(self, t: Any, y: Array, args: Any, scale: Any) -> Factors:
        """Blocks, the balls' inverses, the coupling's Schur complement inverted."""
        scene, c = args
        d = _blocks(scene, c, y, scale if scene.bristles else None)
        k = scene.twist
        state = system.view(scene, c, y)
        if scene.programmes.stick_slip:
            # Of the resisting torque by the head's speed [N m s/rad].
            resisting, at = partial(torque_at, scene.programmes, t, p=c.programmes), scene.slices["head_turn"]
            slope = jax.jvp(resisting, (state.head_spin,), (jnp.ones_like(state.head_spin),))[1]
            d = d._replace(coupling_rate=d.coupling_rate.at[at, at].add(-slope))
        lift = c.ball_inverse_mass[:, None]
        ball = jnp.eye(k) / scale - lift * (d.ball_rate.at[..., :3].add(scale * d.ball_place))
        column_place, coupling_place = d.column_place * scale, d.coupling_place * scale
        tilt, heading = scene.slices["cage_turn"], None
        if tilt is not None:
            if scene.azimuth is not None:
                by_axis, by_spin = rate_by_axis(state.cage_axis, state.cage_spin), turning(state.cage_axis)
                heading = Heading(by_axis, by_spin, -jnp.cross(by_spin, state.cage_axis), None)
            turn = self._turn(state.cage_axis, state.cage_spin, scale, heading)
            column_place = column_place.at[..., tilt].set(product(d.column_place[..., tilt], turn))
            coupling_place = coupling_place.at[:, tilt].set(product(d.coupling_place[:, tilt], turn))
            if d.bristles is not None:
                # The state has the axis b, whose change db is the rotation  b x db.
                tilts = slice(3 * scene.balls + tilt.start, 3 * scene.balls + tilt.stop)
                by_turn = d.bristles.back[:, tilts]
                by_tilt = by_turn @ jnp.cross(jnp.eye(3), state.cage_axis)
                if heading is not None:
                    back = by_turn @ state.cage_axis
                    heading = heading._replace(back=back)
                    by_tilt = by_tilt + back[:, None] * heading.carried
                d = d._replace(bristles=d.bristles._replace(back=d.bristles.back.at[:, tilts].set(by_tilt)))
        column = -lift * (d.column_rate + column_place)
        weight = c.coupling_inverse_mass[:, None]
        row = -weight * (d.row_rate.at[..., :3].add(scale * d.row_place))
        coupling = jnp.eye(scene.coupling) / scale - weight * (d.coupling_rate + coupling_place)
        ball_inverse = kept(inverse3(ball) if k == 3 else inverse6(kept(ball)))
        # Elementwise: XLA makes no kernel of a loop that calls its library, as it does for products of such matrices.
        column, row = kept(product(ball_inverse, kept(column)), row)
        schur = coupling - jnp.sum(row[..., None] * column[:, None], (0, 2))
        return Factors(
            d,
            scale,
            ball_inverse,
            column,
            row,
            inverse(schur),
            state.cage_axis,
            state.cage_spin,
            c.ball_inverse_mass,
            c.coupling_inverse_mass,
            heading,
        )

    @staticmethod
    def _turn(axis: Array, spin: Array, scale: Array, heading: Heading | None) -> Array:
        """Rotation of the cage per change of its angular velocity, (3, 3).

        Of its axis  -s [b]x (I - s [w]x)^-1 [b]x;  about the axis where there is an azimuth, whose rate the tilt changes too.
        """
        eye = jnp.eye(3)
        tilted = _cayley(-jnp.cross(axis, eye), spin, scale)
        turned = jnp.cross(axis, tilted)
        if heading is not None:
            about = tilted @ (scale * heading.by_axis + heading.carried) + heading.by_spin
            turned = turned + about[:, None] * axis
        return scale * jnp.swapaxes(turned, 0, 1)

    def solve(self, factors: Factors, right: Array) -> Array:
        """Places and bristles eliminated, balls eliminated, coupling solved, and back."""
        d, s, heading = factors.blocks, factors.scale, factors.heading
        n, k, b = d.ball_rate.shape[0], d.ball_rate.shape[1], d.coupling_rate.shape[0]
        place, at = right[: 3 * n].reshape(n, 3), right[3 * n : 3 * n + b]
        twist = right[3 * n + b : (3 + k) * n + b].reshape(n, k)
        rate = right[(3 + k) * n + b : (3 + k) * n + 2 * b]
        if d.bristles is not None:
            last = None if heading is None else -1
            held = right[(3 + k) * n + 2 * b : last].reshape(-1, d.bristles.inverse.shape[-1])
            own = jnp.einsum("fij,fj->fi", d.bristles.inverse, held).ravel()
            lifted = d.bristles.lift @ own
            twist = twist + factors.ball_inverse_mass * lifted[: n * k].reshape(n, k)
            rate = rate + factors.coupling_inverse_mass * lifted[n * k :]
        # Where the cage is free its turn stands before the seat's, which is last.
        tilted = b >= 8
        shift = s * at
        if tilted:
            tilt = slice(b - 4, b - 1)
            known = s * _cayley(at[tilt], factors.spin, s)
            rotated = jnp.cross(factors.axis, known)
            if heading is not None:
                about = known @ (s * heading.by_axis + heading.carried) + s * right[-1]
                rotated = rotated + about * factors.axis
            shift = shift.at[tilt].set(rotated)
        ball = twist + factors.ball_inverse_mass * (
            jnp.einsum("nkj,nj->nk", d.ball_place, s * place) + jnp.einsum("nkb,b->nk", d.column_place, shift)
        )
        coupling = rate + factors.coupling_inverse_mass * (
            jnp.einsum("nbj,nj->b", d.row_place, s * place) + d.coupling_place @ shift
        )
        ball = jnp.einsum("nkl,nl->nk", factors.ball_inverse, ball)
        rates = factors.coupling_inverse @ (coupling - jnp.einsum("nbk,nk->b", factors.row, ball))
        twists = ball - jnp.einsum("nkb,b->nk", factors.column, rates)
        places = s * (place + twists[:, :3])
        moved = s * (at + rates)
        if tilted:
            moved = moved.at[tilt].set(known - s * _cayley(jnp.cross(factors.axis, rates[tilt]), factors.spin, s))
        found = jnp.concatenate([places.ravel(), moved, twists.ravel(), rates])
        bristles = [] if d.bristles is None else [own + d.bristles.back @ found]
        if heading is None:
            return jnp.concatenate([found, *bristles]) if bristles else found
        azimuth = s * (right[-1] + heading.by_axis @ moved[tilt] + heading.by_spin @ rates[tilt])
        if heading.back is not None:
            bristles = [bent + heading.back * azimuth for bent in bristles]
        return jnp.concatenate([found, *bristles, azimuth[None]])
