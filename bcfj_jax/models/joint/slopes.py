"""What a contact's wrench and its friction's states change by: derivatives by relative place, relative twist and state.

Friction's states (``bristles``) are eliminated face by face. A face's row of  (I/s - J) x = r  is, with a body that turns
at W and is displaced by a rotation t (``contacts.act``),

    M dz = r + Z_p dp + Z_h dh - (a [z]x + [Z]x) t - [z]x dW,        M = (1/s + a) I - [W]x

where dp and dh are changes as the body sees them. So dz is known once the bodies are, and what a wrench changes by dz
goes into its slopes: an effective friction slope of the step. A slip speed of late does not turn: [.]x and t fall out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.models.joint.bands import act
from bcfj_jax.models.joint.system import Part


class Bond(NamedTuple):
    """The bristles z of each face, ``contacts.act``: Z = z' less W x z, and its derivatives.

    Or the slip speed of late w, Z = w', which does not turn with a body: then 1 in place of the last 3 of z.

    Attributes:
        bristles, bending: (..., f, 3) z [m] and Z [m/s].
        pull: (..., f, k, 3) derivative of the wrench by z.
        by_place, by_twist: (..., f, 3, 3) and (..., f, 3, k) derivatives of Z.
        decay: (..., f) a [1/s]; by z, the derivative of Z is -a.
    """

    bristles: Array
    bending: Array
    pull: Array
    by_place: Array
    by_twist: Array
    decay: Array


class Slopes(NamedTuple):
    """Wrench (..., k) of ``act``, its derivatives by place (..., k, 3) and by twist (..., k, k); its bristles'."""

    value: Array
    by_place: Array
    by_twist: Array
    bond: Bond | None = None


def slopes(part: Part) -> Slopes:
    """Derivatives of ``act`` for contacts by relative place and twist; k = 3 or 6.

    Contacts are independent: one tangent serves all of them at once.
    """
    laws, geometry, bristles = part.laws, part.geometry, part.bristles
    place, velocity, spin = part.motion
    parts = (place, velocity) if spin is None else (place, velocity, spin)

    def wrench(*parts: Array, bristles: Array | None = bristles) -> tuple[Array, Array | None]:
        touch = act(laws, geometry(parts[0]), parts[1], parts[2] if len(parts) > 2 else None, bristles)
        force = touch.force if touch.moment is None else jnp.concatenate([touch.force, touch.moment], -1)
        return force, touch.bending

    def along(way: Array) -> Any:
        tangents = tuple(jnp.broadcast_to(way[i], place.shape) for i in range(len(parts)))
        return jax.jvp(wrench, parts, tangents)

    ways = jnp.eye(3 * len(parts)).reshape(-1, len(parts), 3)
    (value, bending), (by, bent) = jax.vmap(along, out_axes=(None, -1))(ways)
    if bending is None or bristles is None:
        return Slopes(value, by[..., :3], by[..., 3:])
    shape = bristles.shape[-2:]

    def by_state(way: Array) -> Any:
        return jax.jvp(lambda z: wrench(*parts, bristles=z), (bristles,), (jnp.broadcast_to(way, bristles.shape),))[1]

    pull, felt = jax.vmap(by_state, out_axes=-1)(jnp.eye(shape[0] * shape[1]).reshape(-1, *shape))
    pull = jnp.moveaxis(pull.reshape(*pull.shape[:-1], *shape), -2, -3)
    decay = -jnp.stack([felt[..., i, 0, i * shape[1]] for i in range(shape[0])], -1)
    bond = Bond(bristles, bending, pull, bent[..., :3], bent[..., 3:], decay)
    return Slopes(value, by[..., :3], by[..., 3:], bond)


class Freed(NamedTuple):
    """A face's dz = inverse r + place dp + twist dh + turn t + spin dW, and ``Bond``'s pull; (..., f, 3 | k, .)."""

    inverse: Array
    place: Array
    twist: Array
    turn: Array
    spin: Array
    pull: Array


def free(bond: Bond, outer: Array, scale: Array) -> Freed:
    """Bristles in terms of everything else (module docstring).

    Args:
        bond: of the faces.
        outer: (..., 3) angular velocity W of the body they turn with [1/s].
        scale: s [s].
    """
    share = (scale / (1.0 + scale * bond.decay))[..., None, None]
    if bond.bristles.shape[-1] == 1:
        still = jnp.zeros((*bond.bristles.shape, 3))
        return Freed(share, share * bond.by_place, share * bond.by_twist, still, still, bond.pull)
    eye = jnp.eye(3)
    bristles, bending = bond.bristles[..., None, :], bond.bending[..., None, :]
    # (I - [w]x)^-1 = (I + [w]x + w w')/(1 + w.w), w = W/(1/s + a).
    w = share * outer[..., None, None, :]
    inverse = share * (eye + jnp.cross(eye, w) + w.swapaxes(-1, -2) * w) / (1.0 + jnp.sum(w * w, -1, keepdims=True))
    spin = -jnp.cross(inverse, bristles)
    turn = bond.decay[..., None, None] * spin - jnp.cross(inverse, bending)
    return Freed(inverse, inverse @ bond.by_place, inverse @ bond.by_twist, turn, spin, bond.pull)


def effective(found: Slopes, freed: Freed) -> tuple[Slopes, Array, Array]:
    """Slopes with the bristles' part, and what a wrench changes by t and dW besides, (..., k, 3) both."""
    assert found.bond is not None
    if found.bond.bristles.shape[-1] == 1:
        # Column times row: elementwise, as tiny products of matrices are slow.
        place, twist = (jnp.sum(freed.pull * x, -3) for x in (freed.place, freed.twist))
        still = jnp.zeros_like(place)
        return Slopes(found.value, found.by_place + place, found.by_twist + twist), still, still
    turn = freed.turn + jnp.cross(jnp.eye(3), found.bond.bristles[..., None, :])
    place, twist, turn, spin = (jnp.sum(freed.pull @ x, -3) for x in (freed.place, freed.twist, turn, freed.spin))
    return Slopes(found.value, found.by_place + place, found.by_twist + twist), turn, spin
