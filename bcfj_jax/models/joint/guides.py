"""Which sphere is in which, and how the bodies that balls touch move by the coupling's velocities."""

from __future__ import annotations

import jax.numpy as jnp
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
