"""The sphere-in-sphere contacts as constant maps from coupling velocities to relative twists."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.models.joint.scene import Joint

# The bodies that balls touch, in the order of ``body_maps``.
BODIES = ("seat", "head", "cage")
# Which sphere is in which: (outer, inner).
GUIDES = {"seat_cage": ("seat", "cage"), "head_cage": ("cage", "head")}


def pairs(scene: Joint) -> list[tuple[str, str]]:
    """Of each pilot the body in whose axes it is seen and the other, on which its force acts: ``GUIDES``.

    Bands are seen from the cage, whose they are.
    """
    found = [GUIDES[name] for name in scene.pilots]
    return [("cage", first if second == "cage" else second) for first, second in found] if scene.banded else found


class Guides(NamedTuple):
    """Twist of an inner sphere relative to the outer one's material there:  (still + sum_i arm_i lever_i) u.

    "Inner" is the second body of ``pairs``, "outer" the first.

    Attributes:
        still: (pilots, 6, coupling); lever: (pilots, 3, 6, coupling); u the coupling's velocities, arm (pilots, 3) from the
            outer centre to the inner one.
        moves: (pilots, 3, coupling) how far the inner centre moves from the outer one, by coupling displacements.
    """

    still: Array
    lever: Array
    moves: Array


def guides(scene: Joint, axes: Array) -> Guides:
    """The maps of a scene whose seat and head turn about ``axes`` (2, 3)."""
    count, size = len(scene.pilots), scene.coupling
    still, lever = jnp.zeros((count, 6, size)), jnp.zeros((count, 3, 6, size))
    moves = np.zeros((count, 3, size))
    eye = jnp.eye(3)
    for index, pair in enumerate(pairs(scene)):
        for sign, body in zip((-1.0, 1.0), pair, strict=True):
            place, turn = scene.slices.get(body), scene.slices[f"{body}_turn"]
            if place is not None:
                moves[index, :, place] += sign * np.eye(3)
                still = still.at[index, :3, place].add(sign * eye)
            if turn is None:
                continue
            ways = eye if body == "cage" else axes[0 if body == "seat" else 1][:, None]
            still = still.at[index, 3:, turn].add(sign * ways)
            if sign < 0:
                # The outer body carries its material at the inner centre:  w x arm.
                swept = jnp.cross(ways.T[None], eye[:, None])
                lever = lever.at[index, :, :3, turn].add(sign * jnp.swapaxes(swept, 1, 2))
    return Guides(still, lever, jnp.asarray(moves))


def body_maps(scene: Joint, axes: Array) -> Array:
    """Velocity and angular velocity of ``BODIES`` by the coupling's velocities, (m, 6, coupling).

    The cage once more where windows have ends (``constants.BALLS``).
    """
    bodies = (*BODIES, "cage") if scene.has("cage_window_end") else BODIES
    maps = jnp.zeros((len(bodies), 6, scene.coupling))
    for index, body in enumerate(bodies):
        place, turn = scene.slices.get(body), scene.slices[f"{body}_turn"]
        if place is not None:
            maps = maps.at[index, :3, place].set(jnp.eye(3))
        if turn is not None:
            maps = maps.at[index, 3:, turn].set(jnp.eye(3) if body == "cage" else axes[index][:, None])
    return maps
