"""Friction's states at the end of the flat state, and their elimination: each face's are local to it.

They are bristles, three numbers a face, or the slip speed of late of friction that lags, one (``Joint.width``); the name is
"bristles" for either.

The state's last part has the balls' first, ball by ball, contact by contact in the order of ``Joint.bristles``, face
by face; then the pilots'. A contact without bristles has none there; beside one that has, its are zero.

A face's row of  (I/s - J) x = r  is, with a body that turns at W and is displaced by a rotation t (``contacts.act``),

    M dz = r + Z_p dp + Z_h dh - (a [z]x + [Z]x) t - [z]x dW,        M = (1/s + a) I - [W]x

where dp and dh are changes as the body sees them. So dz is known once the bodies are, and what a wrench changes by dz
goes into its slopes: an effective friction slope of the step. A slip speed of late does not turn: [.]x and t fall out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from bcfj_jax.models.joint.scene import PILOTS, Joint
from bcfj_jax.models.joint.slopes import Bond, Slopes


def split(scene: Joint, y: Array) -> dict[str, Array]:
    """Deflections in a flat state by contact: (balls, faces, 3), of a pilot (1, 3); or (balls, faces, 1), (1, 1)."""
    each = scene.width
    found, first = {}, scene.moving
    faces = {name: count for name, count in scene.bristles.items() if name not in PILOTS}
    width = each * sum(faces.values())
    balls, column = y[first : first + scene.balls * width].reshape(scene.balls, width), 0
    for name, count in faces.items():
        found[name] = balls[:, column : column + each * count].reshape(scene.balls, count, each)
        column += each * count
    first += balls.size
    for name in scene.bristles:
        if name in PILOTS:
            found[name] = y[first : first + each].reshape(1, each)
            first += each
    return found


def flat(parts: Mapping[str, Array]) -> Array:
    """The inverse of ``split``, for parts in the order of ``Joint.bristles``."""
    balls = [x.reshape(x.shape[0], -1) for name, x in parts.items() if name not in PILOTS]
    pilots = [x.ravel() for name, x in parts.items() if name in PILOTS]
    return jnp.concatenate([*([jnp.concatenate(balls, 1).ravel()] if balls else []), *pilots])


def beside(parts: Mapping[str, Array], names: tuple[str, ...]) -> Array | None:
    """Deflections of contacts side by side, (..., contact, face, 3), zero where there are none; None if nowhere."""
    some = [parts[name] for name in names if name in parts]
    if not some:
        return None
    return jnp.stack([parts.get(name, jnp.zeros_like(some[0])) for name in names], -3)


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
