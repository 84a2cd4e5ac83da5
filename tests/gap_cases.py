"""Gaps with options and sizes, placed at random, for the tests of gaps: their faces as NumPy arrays, and rates."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from by_numpy import by_numpy
from joints import unit

from bcfj_jax.contact.gaps import AbstractGap, Frame, make_gap
from bcfj_jax.core.vectors import array

R, C = 8e-3, 4e-5  # a ball and a clearance [m]
BALL = {"clearance": 13e-6, "ball_radius": R, "pitch_radius": 0.0355, "offset": 4.5e-3}
GOTHIC = {**BALL, "contact_angle": np.radians(40.0), "conformity": 0.52}
BOX = {"half_length": 0.05, "half_width": 0.03, "half_height": 0.02}
CAPSULE = {"radius": R, "half_length": 0.03}
CAPSULES = {"radius_a": 9e-3, "radius_b": R, "half_length_a": 0.05, "half_length_b": 0.03}
BOXES = {f"{name}_{k}": (1.5 if k == "a" else 1.0) * x for k in "ab" for name, x in BOX.items()} | {"rounding": 4e-3}
BLOCK = {"clearance": 1e-3, "half_length": 0.05, "half_width": 0.025}


class Case(NamedTuple):
    """A gap by name, its options and sizes, and where b's marker may be in a's axes: middle, spread [m]."""

    name: str
    options: dict[str, Any]
    sizes: dict[str, float]
    middle: Any
    spread: Any

    @property
    def gap(self) -> AbstractGap:
        return make_gap(self.name, **self.options)

    def place(self, rng: np.random.Generator) -> np.ndarray:
        """In a's axes: (3,), or (k, 3) for a gap of k tracks."""
        if self.name != "ball_in_groove":
            return np.asarray(self.middle) + self.spread * rng.normal(size=3)
        return np.squeeze([self.track(i) + self.spread * rng.normal(size=3) for i in range(self.gap.members or 1)])

    def track(self, i: int, turn: float = 0.7) -> np.ndarray:
        """A point of the centre circle of track i: physics sheet 5.2."""
        f = 2 * np.pi * i / max(self.gap.members, 1)
        e = self.sizes["offset"] * (1 if self.options.get("side", "outer") == "outer" else -1)
        out, up = np.array([np.cos(f), np.sin(f), 0.0]), np.array([0.0, 0.0, 1.0])
        return e * up + np.hypot(self.sizes["pitch_radius"], e) * (np.cos(turn) * out - np.sin(turn) * up)


def _grooves():
    for side in ("outer", "inner"):
        for section, sizes in (("gothic", GOTHIC), ("circular", BALL)):
            for tracks in (0, 6):
                options = {"side": side, "section": section, "tracks": tracks}
                yield f"groove-{side}-{section}-{tracks}", Case("ball_in_groove", options, sizes, None, 5e-5)


ZERO = np.zeros(3)
CASES = {
    "point": Case("point_on_plane", {}, {}, ZERO, 1e-3),
    "stop": Case("point_on_plane", {"axis": "-x", "clearance": True}, {"clearance": C}, ZERO, 1e-3),
    "sphere": Case("sphere_on_plane", {}, {"radius": R}, (0.1, 0.2, R), 1e-3),
    "slope": Case(
        "sphere_on_plane", {"axis": (0.6, 0.0, 0.8), "clearance": True}, {"radius": R, "clearance": C}, ZERO, R
    ),
    "box": Case("box_on_plane", {}, BOX, (0.1, 0.2, 0.04), 1e-2),
    "box-above": Case("box_on_plane", {"axis": "-y", "clearance": True}, {**BOX, "clearance": C}, ZERO, 1e-2),
    "spheres": Case("sphere_on_sphere", {}, {"radius_a": 0.02, "radius_b": R}, (0.01, 0.02, -0.02), 1e-3),
    "socket": Case("sphere_in_socket", {}, {"clearance": C, "radius": 0.04}, ZERO, C),
    "socket-of-b": Case("sphere_in_socket", {"axis_of": "b"}, {"clearance": C, "radius": 0.04}, ZERO, C),
    "bearing": Case("pin_in_bearing", {}, {"clearance": 5e-4, "radius": 9.5e-3}, (0, 0, 0.01), 5e-4),
    "ends": Case(
        "pin_in_bearing", {"ends": True}, {"clearance": 5e-4, "radius": 9.5e-3, "half_length": 0.02}, (0, 0, 0.01), 5e-4
    ),
    "slot": Case("pin_in_slot", {}, {"clearance": C, "radius": R}, (0.02, 0, 0.01), C),
    "slot-y": Case("pin_in_slot", {"axis": "y"}, {"clearance": C, "radius": R}, (0, 0.1, 0), C),
    "slot-oblique": Case("pin_in_slot", {"axis": (0.6, 0.8, 0)}, {"clearance": C, "radius": R}, ZERO, C),
    "slider": Case("slider_in_guide", {}, BLOCK, (0.4, 0, 0.01), 1e-3),
    "slider-y": Case("slider_in_guide", {"axis": [0.0, -1.0, 0.0]}, BLOCK, (0.4, 0, 0.01), 1e-3),
    "stops": Case("two_sided_stop", {"axis": "x"}, {"clearance": C}, ZERO, C),
    "window": Case("ball_between_planes", {}, {"clearance": C, "ball_radius": R}, (0.03, 0.01, 0), C),
    **dict(_grooves()),
    "pads": Case("pin_in_bearing", {"pads": 5}, {"clearance": -C, "radius": 9.5e-3}, (0, 0, 0.01), C),
    "pads-ends": Case(
        "pin_in_bearing", {"pads": 4, "ends": True}, {"clearance": -C, "radius": 9.5e-3, "half_length": 0.02}, ZERO, C
    ),
    "socket-pads": Case("sphere_in_socket", {"pads": True}, {"clearance": -C, "radius": 0.04}, ZERO, C),
    "capsule": Case("capsule_on_plane", {}, CAPSULE, (0.1, 0.2, 0.02), 1e-2),
    "capsule-above": Case(
        "capsule_on_plane", {"axis": "-y", "clearance": True}, {**CAPSULE, "clearance": C}, ZERO, 1e-2
    ),
    "cylinder": Case("cylinder_on_plane", {}, CAPSULE, (0.1, 0.2, 0.02), 1e-2),
    "cylinder-points": Case("cylinder_on_plane", {"axis": (0.6, 0.0, 0.8), "points": 5}, CAPSULE, ZERO, 1e-2),
    "capsules": Case("capsule_on_capsule", {}, CAPSULES, (0.01, 0.025, -0.02), 1e-3),
    "capsules-end": Case("capsule_on_capsule", {}, CAPSULES, (0.03, 0.0, 0.1), 1e-3),
    "on-face": Case("sphere_on_box", {}, {**BOX, "radius": R}, (0.02, 0.01, 0.027), 1e-3),
    "on-edge": Case("sphere_on_box", {}, {**BOX, "radius": R}, (0.055, 0.01, 0.024), 1e-3),
    "on-corner": Case("sphere_on_box", {}, {**BOX, "radius": R}, (0.054, 0.034, 0.024), 1e-3),
    "boxes": Case("box_on_box", {}, BOXES, (0.01, 0.02, 0.15), 1e-2),
    "wedge": Case("sphere_on_wedge", {}, {"half_angle": 0.6, "radius": R}, (0.02, -0.02, 0.1), 1e-3),
    "wedge-edge": Case("sphere_on_wedge", {"axis": "-x"}, {"half_angle": 0.6, "radius": R}, (-7e-3, 1e-3, 0.1), 1e-3),
}


def turned(angle: float, axis: np.ndarray) -> np.ndarray:
    """Rotation matrix by an angle about a unit axis (Rodrigues)."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def vector(x) -> tuple:
    """(..., 3) by components."""
    return tuple(jnp.asarray(x)[..., i] for i in range(3))


def frame(place, axes) -> Frame:
    """A frame from (..., 3) and a rotation matrix whose columns are the axes."""
    return Frame(vector(place), tuple(vector(np.asarray(axes)[:, i]) for i in range(3)))


def numbers(sizes: dict) -> dict:
    return {name: jnp.asarray(x, dtype=float) for name, x in sizes.items()}


def placed(case: Case, seed: int):
    """Matrices and places of a and b: b's axes some 10 degrees off a's, for a slider; at random for the rest."""
    rng = np.random.default_rng(seed)
    axes = turned(rng.uniform(0, 3), unit(rng))
    tilt = turned(0.1 * rng.normal() if "slider" in case.name else rng.uniform(0, 3), unit(rng))
    if "slider" in case.name:
        way = case.gap.axis
        tilt = tilt @ np.column_stack([way, np.cross([0, 0, 1], way), [0, 0, 1]])
    start = rng.normal(size=3)
    return axes, start, axes @ tilt, start + case.place(rng) @ axes.T


def stacked(gap: AbstractGap, a: Frame, b: Frame, c) -> tuple[jax.Array, ...]:
    """Depth (f, ...), normal and lever (f, ..., 3), gate (f, ...), of all faces."""
    faces = gap.faces(a, b, c)
    depth = jnp.stack([jnp.asarray(face.depth) for face in faces])
    shape = depth.shape[1:]
    wide = [[jnp.broadcast_to(array(v), (*shape, 3)) for v in (face.normal, face.lever)] for face in faces]
    normal, lever = (jnp.stack(x) for x in zip(*wide, strict=True))
    return depth, normal, lever, jnp.stack([jnp.broadcast_to(jnp.asarray(face.gate), shape) for face in faces])


found = by_numpy(stacked, static=True)


@functools.partial(by_numpy, static=True)
def rate(gap: AbstractGap, a: Frame, b: Frame, moves: tuple, c):
    """Penetrations, and their rates by differentiation, while the frames move at ``moves``."""
    return jax.jvp(lambda a, b: stacked(gap, a, b, c), (a, b), moves)


def look(case: Case, seed: int):
    """A case at random: a and b as matrices, and its faces as NumPy."""
    where = placed(case, seed)
    axes, start, other, place = where
    parts = found(case.gap, frame(start, axes), frame(place, other), numbers(case.sizes))
    return where, [np.asarray(x) for x in parts]
