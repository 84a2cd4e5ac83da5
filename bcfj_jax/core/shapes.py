"""Shapes to be drawn: meshes of triangles in the axes of a body, in metres. NumPy alone; nothing here is computed with.

Clearances are micrometres where bodies are centimetres. A point therefore has a ``slack`` beside its place: how far it
moves away from what it may touch for each unit of exaggeration above 1. At s times exaggeration a point is drawn at
place + (s - 1) slack, so that a clearance c is drawn as s c.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

# Neighbouring pieces of an outline that bend by more than this have an edge between them [rad].
_CREASE = 0.7
# Materials by name; the colours are the viewer's.
TONES = ("ground", "body", "other", "ball", "clear", "groove")


class Mesh(NamedTuple):
    """Triangles."""

    points: np.ndarray  # (n, 3) [m]
    normals: np.ndarray  # (n, 3) outward unit vectors
    triangles: np.ndarray  # (m, 3) indices of points, anticlockwise seen from outside
    slack: np.ndarray | None = None  # (n, 3) [m] (see the top of the file); None for a mesh that only moves

    def moved(self, place: Any = (0.0, 0.0, 0.0), axes: Any = None) -> Mesh:
        """The mesh at another place [m], its own axes along the columns of ``axes`` (3, 3)."""
        turn = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
        slack = None if self.slack is None else self.slack @ turn.T
        return Mesh(self.points @ turn.T + np.asarray(place, float), self.normals @ turn.T, self.triangles, slack)


class Shape(NamedTuple):
    """A mesh on a body, of one of ``TONES``, in the axes of the body from its place in ``Scenery``.

    "ground" does not move; a body with members carries a mesh for each.
    """

    body: str
    mesh: Mesh
    tone: str = "body"


class Drawing(NamedTuple):
    """What a model looks like; no shapes: it cannot be drawn. ``eye``: the direction from where to look at it.

    ``notes``: what a viewer must know, in sentences: what is not to scale, what is not in the model.
    """

    shapes: tuple[Shape, ...] = ()
    eye: tuple[float, float, float] = (0.25, 0.28, 1.0)
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    notes: tuple[str, ...] = ()


def frame(z: Any, x: Any = None) -> np.ndarray:
    """(3, 3) axes as columns whose z axis is along ``z``, and whose x axis is along ``x`` as nearly as may be."""
    z = np.asarray(z, float) / np.linalg.norm(z)
    near = np.eye(3)[int(np.argmin(np.abs(z)))] if x is None else np.asarray(x, float)
    near = near - (near @ z) * z
    first = near / np.linalg.norm(near)
    return np.stack([first, np.cross(z, first), z], axis=1)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several."""
    first = np.cumsum([0, *(len(m.points) for m in meshes)])
    some = any(m.slack is not None for m in meshes)
    slack = [m.slack if m.slack is not None else np.zeros_like(m.points) for m in meshes]
    return Mesh(
        np.concatenate([m.points for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.triangles + k for m, k in zip(meshes, first[:-1], strict=True)]),
        np.concatenate(slack) if some else None,
    )


def revolved(outline: Any, slack: Any = None, begin: float = 0.0, end: float = 2.0 * np.pi, pieces: int = 40) -> Mesh:
    """An outline (k, 2) of (radius, height) [m] turned about the z axis from ``begin`` to ``end`` [rad], outside to the right.

    ``slack``: (k, 2) likewise; ``pieces``: of a full turn.
    """
    outline = np.asarray(outline, float)
    way = np.diff(outline, axis=0)
    size = np.linalg.norm(way, axis=1)
    keep = size > 0
    side = np.stack([way[:, 1], -way[:, 0]], axis=1)[keep] / size[keep, None]
    ends = np.stack([np.arange(len(way)), np.arange(1, len(way) + 1)], axis=1)[keep]
    # Both ends of each piece, with the piece's normal, or the mean of two where the outline bends little.
    normal = np.stack([side, side], axis=1)
    bend = np.arccos(np.clip(np.sum(side[:-1] * side[1:], axis=1), -1.0, 1.0))
    for k in np.flatnonzero((bend < _CREASE) & (ends[:-1, 1] == ends[1:, 0])):
        mean = side[k] + side[k + 1]
        normal[k, 1] = normal[k + 1, 0] = mean / np.linalg.norm(mean)
    count = max(2, round(pieces * abs(end - begin) / (2.0 * np.pi)) + 1)
    angle = np.linspace(begin, end, count)
    turn = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def swung(pairs: np.ndarray) -> np.ndarray:
        flat = np.broadcast_to(pairs[:, :, None, :], (*pairs.shape[:2], count, 2))
        return np.concatenate([flat[..., :1] * turn, flat[..., 1:]], axis=-1).reshape(-1, 3)

    a = np.arange(2 * len(ends) * count).reshape(len(ends), 2, count)
    low, high = a[:, 0], a[:, 1]
    corners = [low[:, :-1], low[:, 1:], high[:, 1:]], [low[:, :-1], high[:, 1:], high[:, :-1]]
    triangles = np.concatenate([np.stack(c, axis=-1).reshape(-1, 3) for c in corners])
    spread = None if slack is None else swung(np.asarray(slack, float)[ends])
    return facing(Mesh(swung(outline[ends]), swung(normal), triangles, spread))


def facing(mesh: Mesh) -> Mesh:
    """With every triangle anticlockwise seen from the side of its normals, and none without area."""
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    seen = np.sum(area * mesh.normals[mesh.triangles].sum(axis=1), axis=1)
    turned = np.where((seen < 0)[:, None], mesh.triangles[:, ::-1], mesh.triangles)
    whole = np.linalg.norm(area, axis=1)
    return mesh._replace(triangles=turned[whole > 1e-9 * max(float(whole.max(initial=0.0)), 1e-300)])


def ball(radius: float, pieces: int = 28) -> Mesh:
    """A sphere about the origin."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, pieces // 2 + 1)
    return revolved(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), pieces=pieces)


def cylinder(radius: float, half: float, hole: float = 0.0, slack: float = 0.0, pieces: int = 40) -> Mesh:
    """A cylinder along z, ``half`` to either side, with a hole; ``slack`` widens hole and outside alike."""
    outline = [(hole, -half), (radius, -half), (radius, half), (hole, half)]
    if hole:
        outline.append((hole, -half))
    return revolved(outline, [(slack, 0.0)] * len(outline) if slack else None, pieces=pieces)


def rod(start: Any, end: Any, radius: float) -> Mesh:
    """A round bar from one point to another."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    along = end - start
    size = float(np.linalg.norm(along))
    if not size > 0:
        return ball(radius, 16)
    return cylinder(radius, 0.5 * size, pieces=20).moved(0.5 * (start + end), frame(along))


def box(half: Any) -> Mesh:
    """A block about the origin, its edges along the axes, ``half`` (3,) [m] to either side."""
    points, normals, triangles = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
            face = np.insert(corner, axis, sign, axis=1) * np.asarray(half, float)
            triangles += [[4 * len(points) + i for i in t] for t in ((0, 1, 2), (0, 2, 3))]
            points.append(face)
            normals.append(np.tile(sign * np.eye(3)[axis], (4, 1)))
    return facing(Mesh(np.concatenate(points), np.concatenate(normals), np.array(triangles)))


def with_slack(mesh: Mesh, slack: Any) -> Mesh:
    """A mesh all of whose points move away alike, by ``slack`` (3,) [m]."""
    return mesh._replace(slack=np.broadcast_to(np.asarray(slack, float), mesh.points.shape).copy())


def level(grid: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Pieces (k, 2, 3) [m] of the line on which a function is 0, by its values (n, m) at the points (n, m, 3) of a grid: linear
    in either triangle of a cell.
    """
    n, m = values.shape
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = (x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    corners = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    points, at = grid.reshape(-1, 3)[corners], values.ravel()[corners]
    next_points, next_at = np.roll(points, -1, axis=1), np.roll(at, -1, axis=1)
    crossed = ((at > 0) != (next_at > 0)) & np.isfinite(at) & np.isfinite(next_at)
    share = at / np.where(crossed, at - next_at, 1.0)
    both = crossed.sum(axis=1) == 2
    where = points + share[..., None] * (next_points - points)
    return where[both][crossed[both]].reshape(-1, 2, 3)


def wall(lines: np.ndarray, outward: np.ndarray, half: np.ndarray) -> Mesh:
    """A wall through pieces of a line (k, 2, 3) [m], whose outside is along (k, 3); ``half`` (3,) of its width [m]."""
    first, second = lines[:, 0], lines[:, 1]
    points = np.stack([first - half, second - half, second + half, first + half], axis=1).reshape(-1, 3)
    side = np.cross(second - first, half)
    size = np.linalg.norm(side, axis=1, keepdims=True)
    side = side / np.where(size > 0, size, 1.0) * np.sign(np.sum(side * outward, axis=1, keepdims=True))
    corner = 4 * np.arange(len(lines))[:, None]
    triangles = np.concatenate([corner + [0, 1, 2], corner + [0, 2, 3]])
    return facing(Mesh(points, np.repeat(side, 4, axis=0), triangles))
