"""What a string looks like: segments in their hole, each turned about its own axis. Joints are drawn as balls."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core import shapes
from bcfj_jax.core.shapes import Drawing, Shape
from bcfj_jax.mechanism.model import Params, Pose, Scenery

# Pieces of the hole's circle.
_ROUND = 40
_NOTES = (
    "Joints are drawn as balls of the segments' size; what is in them is seen in the scene joint.",
    "Stripes show how each segment turns; its twist is thousandths of a radian.",
)


def drawing(params: Params, count: int) -> Drawing:
    """``AbstractModel.drawing``: upper connection, a segment below each joint, the wall of the hole."""
    p = {name: float(np.asarray(params[name])) for name in ("segment_length", "segment_radius", "segment_bore")}
    length, radius, bore = p["segment_length"], p["segment_radius"], p["segment_bore"]
    thin = 0.8 * radius
    bar = shapes.cylinder(thin, 0.5 * length, bore).moved((0.0, 0.0, 0.5 * length))
    stripe = shapes.box((0.1 * radius, 0.08 * radius, 0.42 * length)).moved((thin, 0.0, 0.5 * length))
    found = [Shape(name, mesh, tone) for name in ("top", "lump") for mesh, tone in ((bar, "body"), (stripe, "other"))]
    found.append(Shape("lump", shapes.ball(radius), "ball"))
    bend, around = 2.0 * np.arcsin(0.5 * length / float(params["hole_radius"])), float(params["hole_radius"])
    turn, wide = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1), radius + float(params["hole_clearance"])
    # The far half of the wall, so that the string is seen: the middle of the bend is at (R, 0), its axis y.
    half = turn[: _ROUND // 2 + 1]
    outline = np.stack([around + wide * np.cos(half), wide * np.sin(half)], -1)
    wall = shapes.revolved(outline, begin=-0.5 * bend, end=(count + 0.5) * bend, pieces=round(2.0 * np.pi / bend) * 6)
    axes = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]).T
    # To the centre of the hole's curve, from the upper end of the upper connection [m].
    middle = around * np.array([np.cos(0.5 * bend), 0.0, -np.sin(0.5 * bend)])
    found.append(Shape("ground", wall.moved(middle, axes.T), "clear"))
    return Drawing(tuple(found), (0.1, -1.0, 0.2), (0.0, 0.0, 1.0), _NOTES)


def scenery(params: Params, bend: Array, turns: Array) -> Scenery:
    """Poses of the upper connection and the segments at their angles (n + 1,) [rad]; joints are at the segments' upper ends."""
    count = turns.size - 1
    k = jnp.arange(count + 1)
    corner = bend * (k - 0.5)
    around = params["hole_radius"]
    x, z = around * (1.0 - jnp.cos(corner)), -around * jnp.sin(corner)
    place = jnp.stack([x - x[0], jnp.zeros(count + 1), z - z[0]], -1)
    cosine, sine, none = jnp.cos(bend * k), jnp.sin(bend * k), jnp.zeros(count + 1)
    # Across the axis towards the middle of the curve, out of its plane, along the segment downwards.
    inward, out = jnp.stack([cosine, none, sine], -1), jnp.stack([none, none - 1.0, none], -1)
    down = jnp.stack([sine, none, -cosine], -1)
    c, s = jnp.cos(turns)[:, None], jnp.sin(turns)[:, None]
    axes = jnp.stack([c * inward + s * out, c * out - s * inward, down], -1)
    poses: Mapping[str, Pose] = {
        "top": Pose(place[0], axes[0]),
        "lump": Pose(place[1:], axes[1:]),
        "joint": Pose(place[1:], axes[1:]),
    }
    return Scenery(dict(poses), dict(poses), {}, {})
