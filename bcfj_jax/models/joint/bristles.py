"""Friction's states at the end of the flat state; each face's are local to it.

They are bristles, three numbers a face, or the slip speed of late of friction that lags, one (``Joint.width``); the name is
"bristles" for either.

The state's last part has the balls' first, ball by ball, contact by contact in the order of ``Joint.bristles``, face
by face; then the pilots'. A contact without bristles has none there; beside one that has, its are zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from bcfj_jax.models.joint.scene import PILOTS, Joint


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
