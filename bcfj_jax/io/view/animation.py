"""From a run to an animation: shapes, poses over time, force arrows, and how much play is exaggerated.

A body is drawn at  ideal + s (true - ideal): ``ideal`` is its pose with every contact just closed (``mechanism.model.
Scenery``), and s the exaggeration. At s = 1 that is the true pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from bcfj_jax.core import rotations
from bcfj_jax.core.shapes import Drawing, Mesh, joined
from bcfj_jax.mechanism.model import AbstractModel, Params, Scenery
from bcfj_jax.solve.simulation import Run
from bcfj_jax.xla.programs import QUICK, program

# Frames of an animation, and the least that are worth one; frames from which the size of a scene is taken.
FRAMES, _FEWEST, _SIZED = 300, 40, 24
# What the motion may take in a report [bytes], and what a body's and a force's frame do.
_BYTES, _BODY, _FORCE = 250e3, 26, 12
# Share of the scene's size at which play is plain to see, and which the largest displacement is exaggerated to.
_SEEN, _WANTED = 0.012, 0.03
# Rotation that an exaggerated body may have against its ideal pose [rad].
_TURN = 0.5
# A force below this share of the largest is not drawn; length of the longest arrow over the size of the scene.
LEAST, ARROW = 5e-3, 0.22
# Directions in which the extent of a mesh is taken.
_WAYS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)


class Track(NamedTuple):
    """A body, or one of its members, over F frames."""

    name: str  # as "ball 2"
    place: np.ndarray  # (F, 3) [m], of the ideal pose, as the next
    quaternion: np.ndarray  # (F, 4), scalar first
    shift: np.ndarray  # (F, 3) true place less ideal [m]
    turn: np.ndarray  # (F, 3) rotation vector from the ideal to the true axes [rad], world


class Force(NamedTuple):
    """The force of a contact, or of a member: (F, 3) point from the place of its body ``track`` [m], (F, 3) force [N]."""

    contact: str
    member: int
    track: int
    lever: np.ndarray
    force: np.ndarray


class Animation(NamedTuple):
    """All that is drawn."""

    title: str  # what it is of
    parts: list[tuple[int, Mesh, str]]  # (track, mesh, tone); track -1 is the ground
    tracks: list[Track]  # over F frames, as the forces and the times [s]
    forces: list[Force]
    times: np.ndarray
    samples: int  # of the run that the frames were taken from
    centre: np.ndarray  # (3,) middle of the scene [m]
    half: np.ndarray  # (3,) half of its extent to the right, upwards and towards the eye [m]
    eye: tuple[float, float, float]  # from where to look
    up: tuple[float, float, float]
    exaggeration: float  # of displacements by default; 1 where play is seen as it is
    most: float  # and at most
    notes: list[str]  # what a viewer must know, in sentences

    @property
    def size(self) -> float:
        """Greatest length of the scene [m]."""
        return 2.0 * float(self.half.max())

    @property
    def peak(self) -> float:
        """Largest force [N]."""
        return max((float(np.linalg.norm(f.force, axis=1).max()) for f in self.forces), default=0.0)


def chosen_frames(run: Run, count: int = FRAMES) -> np.ndarray:
    """Samples that are shown, up to a failure: of each of ``count`` equal spells the one with the greatest force."""
    assert run.trajectory is not None
    good = np.flatnonzero(np.isfinite(run.trajectory).all(axis=1))
    last = int(good[-1]) + 1 if good.size else 0
    if last <= count:
        return np.arange(last)
    active = np.zeros(last)
    for force in run.force.values():
        size = np.linalg.norm(force[:last], axis=-1).reshape(last, -1).max(axis=1)
        active = np.maximum(active, size / max(float(np.nanmax(size, initial=0.0)), 1e-300))
    active = np.where(active > 0.01, active, 0.0)
    edges = np.linspace(0, last, count + 1).astype(int)
    found = np.array([a + int(np.argmax(active[a:b])) for a, b in pairwise(edges)])
    return np.unique(np.concatenate([[0], found[1:-1], [last - 1]]))


def _scenery(model: AbstractModel, params: Params, times: Array, states: Array) -> Scenery:
    return jax.vmap(lambda t, y: model.scenery(t, y, params))(times, states)


def animation(model: AbstractModel, params: Params, run: Run, title: str = "", count: int = FRAMES) -> Animation | None:
    """The animation of a run with its trajectory, of ``count`` frames at most.

    None for a model that cannot be drawn, a run that ended at once, and hundreds of bodies.
    """
    numbers: Any = {name: np.asarray(value, float) for name, value in params.items()}
    model = model.level(run.choice.fidelity) if run.choice else model
    if run.trajectory is None or not model.drawing(numbers, 1.0).shapes:
        return None
    bodies = sum(model.body_members.get(name, 0) or 1 for name in model.body_names)
    forces = sum(members or 1 for members in model.members.values())
    count = min(count, int(_BYTES / (_BODY * bodies + _FORCE * forces + 1)))
    picked = chosen_frames(run, count)
    if picked.size < 2 or count < min(_FEWEST, len(run.times)):
        return None
    # As many as were asked for, so that one program serves every run.
    full = np.concatenate([picked, np.full(max(0, min(count, len(run.times)) - picked.size), picked[-1])])
    arguments = (dict(params), np.maximum(run.times[full], 0.0), run.trajectory[full])
    found = program("scenery", _scenery, (model,), arguments, QUICK)[0](*arguments)
    found = jax.tree.map(lambda x: np.asarray(x)[: picked.size], found)
    tracks, index = _tracks(model, found)
    arrows = _forces(model, found, index)
    travel = {name: (x.min(axis=0), x.max(axis=0)) for name, x in found.offsets.items()}
    # By what has a size, and by what moves.
    size = 2.0 * float(_bounds(_parts(model.drawing(numbers, 1e-9, travel), index), tracks, np.eye(3))[1].max())
    drawing = model.drawing(numbers, size, travel)
    parts = _parts(drawing, index)
    centre, half = _bounds(parts, tracks, home(drawing.eye, drawing.up), arrows)
    exaggeration, most = _exaggeration(tracks, size)
    samples = int(np.isfinite(run.trajectory).all(axis=1).sum())
    return Animation(
        title or model.title, parts, tracks, arrows, run.times[picked], samples, centre, half, drawing.eye, drawing.up,
        exaggeration, most, list(drawing.notes),
    )  # fmt: skip


def _tracks(model: AbstractModel, found: Any) -> tuple[list[Track], dict[str, list[int]]]:
    """Tracks, and by body the indices of its own."""
    tracks: list[Track] = []
    index: dict[str, list[int]] = {"ground": [-1]}
    # JAX gives dictionaries back in the order of their keys.
    for name in [*model.body_names, *(n for n in found.poses if n not in model.body_names)]:
        true, ideal = found.poses[name], found.ideal[name]
        members = model.body_members.get(name, 0) if true.place.ndim > 2 else 0
        index[name] = list(range(len(tracks), len(tracks) + (members or 1)))
        for k in range(members or 1):
            place, axes, at, to = (x[:, k] if members else x for x in (true.place, true.axes, ideal.place, ideal.axes))
            turn = rotations.vector(np.einsum("fij,fkj->fik", axes, to))
            tracks.append(Track(f"{name} {k + 1}" if members else name, at, quaternion(to), place - at, turn))
    return tracks, index


def _forces(model: AbstractModel, found: Any, index: dict[str, list[int]]) -> list[Force]:
    forces, carriers = [], model.carriers()
    for contact in (c.name for c in model.contacts if c.name in found.arrows):
        arrow, carrier = found.arrows[contact], carriers[contact]
        members = arrow.force.shape[1] if arrow.force.ndim > 2 else 0
        for k in range(members or 1):
            point, force = (x[:, k] if members else x for x in (arrow.point, arrow.force))
            track = index[carrier][k if len(index[carrier]) > 1 else 0]
            place = found.poses[carrier].place if track >= 0 else np.zeros_like(point)
            lever = point - (place[:, k] if place.ndim > 2 else place)
            forces.append(Force(contact, k + 1 if members else 0, track, lever, force))
    return forces


def _parts(drawing: Drawing, index: dict[str, list[int]]) -> list[tuple[int, Mesh, str]]:
    """Meshes of one body and one tone joined; the same mesh for each member."""
    groups: dict[tuple[str, str], list[Mesh]] = {}
    for shape in drawing.shapes:
        groups.setdefault((shape.body, shape.tone), []).append(shape.mesh)
    whole = {key: joined(meshes) for key, meshes in groups.items()}
    return [(track, mesh, tone) for (body, tone), mesh in whole.items() for track in index[body]]


def home(eye: tuple[float, float, float], up: tuple[float, float, float]) -> np.ndarray:
    """(3, 3) columns: to the right, upwards and towards the eye."""
    way = np.asarray(eye, float) / np.linalg.norm(eye)
    right = np.cross(up, way)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(way, right), way], axis=1)


def _bounds(
    parts: list[tuple[int, Mesh, str]], tracks: list[Track], axes: np.ndarray, forces: Sequence[Force] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Middle, in world axes, and half edges of the box along ``axes`` that holds the scene and its arrows at some frames."""
    corners, drawn = [], poses(tracks)
    for track, mesh, _ in parts:
        # Extreme points of a mesh stand for it.
        extreme = mesh.points[np.unique(np.argmax(mesh.points @ _WAYS.T, axis=0))]
        place, turn = drawn[track]
        for k in np.unique(np.linspace(0, len(place) - 1, _SIZED).astype(int)):
            corners.append(extreme @ turn[k].T + place[k])
    points = np.concatenate(corners)
    size = float(np.ptp(points, axis=0).max())
    for force in forces:
        lengths = np.linalg.norm(force.force, axis=1)
        k = int(np.argmax(lengths))
        at = force.lever[k] + drawn[force.track][0][k]
        tail = at - ARROW * size * force.force[k] / max(float(lengths[k]), 1e-300)
        points = np.concatenate([points, tail[None]])
    seen = points @ axes
    low, high = seen.min(axis=0), seen.max(axis=0)
    return axes @ (0.5 * (low + high)), 0.5 * (high - low)


def posed(track: Track, k: Any, exaggeration: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Place (3,) [m] and axes (3, 3) of a body as it is drawn at a frame; (F, 3) and (F, 3, 3) at a slice of frames."""
    ideal = rotations.matrix(track.quaternion[k])
    turn = rotations.turned_by(exaggeration * track.turn[k])
    return track.place[k] + exaggeration * track.shift[k], turn @ ideal


def poses(
    tracks: Sequence[Track], k: Any = slice(None), exaggeration: float = 1.0
) -> list[tuple[np.ndarray, np.ndarray]]:
    """``posed`` of every track and, at their end, of the ground: the track -1."""
    found = [posed(track, k, exaggeration) for track in tracks]
    place, axes = found[0] if found else (np.zeros((1, 3)), np.zeros((1, 3, 3)))
    return [*found, (np.zeros_like(place), np.broadcast_to(np.eye(3), axes.shape))]


def _exaggeration(tracks: list[Track], size: float) -> tuple[float, float]:
    """By how much play is drawn larger by default, and at most."""
    shift, turn = (
        max((float(np.linalg.norm(x, axis=1).max()) for x in each), default=0.0)
        for each in ([t.shift for t in tracks], [t.turn for t in tracks])
    )
    if not 0.0 < shift < _SEEN * size:
        return 1.0, 1.0
    most = min(20.0 * _WANTED * size / shift, _TURN / max(turn, 1e-12))
    return steps(min(_WANTED * size / shift, most))[-1], steps(most)[-1]


def steps(most: float) -> list[float]:
    """Exaggerations to choose from: 1, 2, 5, 10 ... up to the most."""
    powers = range(math.floor(math.log10(max(most, 1.0)) + 1e-12) + 1)
    return [d * 10.0**k for k in powers for d in (1.0, 2.0, 5.0) if d * 10.0**k <= max(most, 1.0) * (1.0 + 1e-9)]


def quaternion(axes: np.ndarray) -> np.ndarray:
    """(F, 4) of matrices (F, 3, 3), scalar first; neighbours in one half-space."""
    q = rotations.quaternion(axes, np)
    flips = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
    return q * np.cumprod(np.concatenate([[1.0], flips]))[:, None]
