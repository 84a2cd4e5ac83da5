"""A frame of an animation as a picture, without a graphics card: triangles from far to near, drawn by Pillow.

Used for the still picture of a report and for movies. The camera is that of ``viewer.js``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bcfj_jax.core import shapes
from bcfj_jax.io.view.animation import ARROW, LEAST, Animation, home, poses

if TYPE_CHECKING:
    from PIL.Image import Image

# Red, green, blue and opacity of the tones of ``core.shapes``.
TONES = {
    "ground": (0.52, 0.55, 0.58, 1.0), "body": (0.46, 0.62, 0.80, 1.0), "other": (0.80, 0.72, 0.55, 1.0),
    "ball": (0.74, 0.77, 0.80, 1.0), "clear": (0.45, 0.58, 0.72, 0.2), "groove": (0.66, 0.72, 0.79, 1.0),
}  # fmt: skip
# From small to large forces: the upper part of Matplotlib's "inferno", darker with every step.
COLOURS = ((0.98, 0.71, 0.10), (0.92, 0.41, 0.15), (0.74, 0.22, 0.33), (0.48, 0.11, 0.43), (0.21, 0.04, 0.38))
# Tangent of half the angle of view.
LENS = 0.27


class Camera(NamedTuple):
    """Right, up and backward unit vectors, and the eye's place [m]."""

    right: np.ndarray
    over: np.ndarray
    way: np.ndarray
    eye: np.ndarray


def camera(of: Animation, aspect: float) -> Camera:
    """The viewer's first camera, for a picture of this width over height."""
    right, over, way = home(of.eye, of.up).T
    wide, tall, deep = of.half
    far = 1.04 * max(wide / aspect, tall) / LENS + 0.7 * deep
    return Camera(right, over, way, of.centre + far * way)


def shade(share: float) -> np.ndarray:
    """Colour of a force by its share of the largest, in the legend's order."""
    at = min(max(share, 0.0), 1.0) * (len(COLOURS) - 1)
    k = min(int(at), len(COLOURS) - 2)
    return (1.0 - (at - k)) * np.array(COLOURS[k]) + (at - k) * np.array(COLOURS[k + 1])


def arrow_share(size: float, peak: float) -> float:
    """Length and place in the legend of a force over those of the largest: the square root of their ratio."""
    return float(np.sqrt(size / peak)) if peak > 0 else 0.0


def paint(of: Animation, k: int, size: tuple[int, int], exaggeration: float | None = None) -> Image:
    """Frame k in ``size`` (width, height) [pixels]."""
    from PIL import Image, ImageDraw

    factor = of.exaggeration if exaggeration is None else exaggeration
    fine = (2 * size[0], 2 * size[1])
    seen = camera(of, size[0] / size[1])
    drawn = poses(of.tracks, k, factor)
    lit = []
    for track, mesh, tone in of.parts:
        place, axes = drawn[track]
        own = mesh.points if mesh.slack is None else mesh.points + (factor - 1.0) * mesh.slack
        lit.append(_lit(own @ axes.T + place, mesh, axes, seen, np.array(TONES[tone])))
    for place, mesh, colour in _arrows(of, k, drawn):
        lit.append(_lit(mesh.points + place, mesh, np.eye(3), seen, np.array([*colour, 1.0]), flat=0.55))
    points, colour = (np.concatenate(each) for each in zip(*lit, strict=True))
    relative = points - seen.eye
    depth = -relative @ seen.way
    scale = 0.5 * fine[1] / (LENS * depth)
    x = 0.5 * fine[0] + scale * (relative @ seen.right)
    y = 0.5 * fine[1] - scale * (relative @ seen.over)
    order = np.argsort(-depth.mean(axis=1), kind="stable")
    image = Image.new("RGB", fine, "white")
    pen = ImageDraw.Draw(image, "RGBA")
    flat = np.stack([x, y], axis=-1)[order].reshape(len(order), 6).tolist()
    bytes_ = np.round(255.0 * np.clip(colour[order], 0.0, 1.0)).astype(int).tolist()
    for corner, fill in zip(flat, bytes_, strict=True):
        pen.polygon(corner, fill=tuple(fill))
    return image.resize(size, Image.Resampling.BOX)


def _lit(
    points: np.ndarray, mesh: shapes.Mesh, axes: np.ndarray, seen: Camera, colour: np.ndarray, flat: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (m, 3, 3) and colours (m, 4) of the triangles; of a solid mesh those that face the eye."""
    corners = points[mesh.triangles]
    normals = mesh.normals[mesh.triangles].mean(axis=1) @ axes.T
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    facing = np.sum(normals * (seen.eye - corners[:, 0]), axis=1)
    keep = facing > 0 if colour[3] == 1.0 else np.full(len(facing), True)
    corners, normals = corners[keep], np.where(facing[keep, None] < 0, -normals[keep], normals[keep])
    light = seen.way + 0.55 * seen.over - 0.45 * seen.right
    light = light / np.linalg.norm(light)
    half = (light + seen.way) / np.linalg.norm(light + seen.way)
    share = 0.42 + 0.62 * np.maximum(normals @ light, 0.0)
    shine = 0.22 * np.maximum(normals @ half, 0.0) ** 28
    bright = (1.0 - flat) * share + flat
    rgb = colour[:3] * bright[:, None] + (1.0 - flat) * shine[:, None]
    return corners, np.column_stack([rgb, np.full(len(rgb), colour[3])])


def _arrows(of: Animation, k: int, drawn: list[Any]) -> list[tuple[np.ndarray, shapes.Mesh, np.ndarray]]:
    """Place, mesh and colour of every arrow of a frame."""
    found, longest = [], ARROW * of.size
    for force in of.forces:
        size = float(np.linalg.norm(force.force[k]))
        if not size >= LEAST * of.peak or size == 0.0:
            continue
        share = arrow_share(size, of.peak)
        way = force.force[k] / size
        point = force.lever[k] + drawn[force.track][0]
        mesh = arrow(share * longest, longest).moved((0.0, 0.0, 0.0), shapes.frame(way))
        found.append((point, mesh, shade(share)))
    return found


def arrow(long: float, longest: float) -> shapes.Mesh:
    """An arrow along z whose point is at the origin, ``long`` [m]; its thickness goes by the longest one."""
    head, radius = min(0.3 * longest, 0.6 * long), 0.026 * longest
    outline = [(0.0, -long), (radius, -long), (radius, -head), (2.7 * radius, -head), (0.0, 0.0)]
    return shapes.revolved(outline, pieces=12)
