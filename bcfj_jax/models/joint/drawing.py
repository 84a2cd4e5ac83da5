"""What the joint looks like, and what moves in it. Sizes that the model does not have (shafts, widths) follow the balls.

Without window ends the cage of the model has no azimuth: its windows are drawn where the balls are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps.balls import groove
from bcfj_jax.core import shapes
from bcfj_jax.core.shapes import Drawing, Mesh, Shape
from bcfj_jax.mechanism.model import Arrow, Params, Pose, Reading, Scenery
from bcfj_jax.models.joint.constants import Constants, constants
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.scene import OF_A_BALL, WINDOW_END, Joint
from bcfj_jax.models.joint.system import State, cage_frame, shaft_frames, view

# Bodies that carry the arrow of a contact: the second, on which the force acts.
CARRIERS = {"seat_cage": "cage", "head_cage": "head"}
# Half of the arc of a track that is drawn [rad]; latitudes between which the seat is drawn [rad].
_ARC, _SEAT = 0.5, (-0.62, 0.5)
_NOTES = (
    "Shafts, widths and the ends of tracks are not in the model: they are drawn by the size of the balls.",
    "Bodies are drawn undeformed: they overlap by their penetration.",
)
_NO_AZIMUTH = "The model's cage has no azimuth: its windows are drawn where the balls are."


def drawing(scene: Joint, params: Params, size: float = 1.0, travel: Any = None) -> Drawing:
    """``AbstractModel.drawing`` of a joint, which has sizes of its own."""
    del size, travel
    p = {name: float(value) for name, value in params.items()}
    ball, pitch = p["ball_radius"], p["pitch_radius"]
    seat, head = p.get("seat_radius", pitch + 0.55 * ball), p.get("head_radius", pitch - 0.55 * ball)
    found = [Shape("ball", shapes.ball(ball), "ball")]
    for name, side, tone in (("seat", "outer", "clear"), ("head", "inner", "body")):
        sphere = seat if name == "seat" else head
        for turn in scene.azimuths:
            found.append(Shape(name, _track(scene, p, side).moved(axes=_about_z(turn)), "groove"))
        for mesh in _lands(sphere, p, scene.balls, p.get("clearance_seat_cage", 0.0) if name == "seat" else 0.0):
            found.append(Shape(name, mesh, tone))
    found += [Shape("seat", _cup(seat, ball), "clear"), Shape("head", _shaft(head, ball), "body")]
    if scene.has("cage_ball"):
        found += [Shape("cage", mesh, "other") for mesh in _cage(scene, p, seat, head)]
    notes = _NOTES if scene.azimuth is not None else (*_NOTES, _NO_AZIMUTH)
    return Drawing(tuple(found), (0.25, -1.0, 0.45), (-0.2, 0.0, 1.0), notes)


def _about_z(turn: float) -> np.ndarray:
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _track(scene: Joint, p: Mapping[str, float], side: str) -> Mesh:
    radius, sign = float(np.hypot(p["pitch_radius"], p["offset"])), 1.0 if side == "outer" else -1.0
    lean = -sign * float(np.arctan2(p["offset"], p["pitch_radius"]))
    flank = p["ball_radius"] * (2.0 * p.get("conformity", 0.5) - 1.0)
    gothic = (flank, p["contact_angle"]) if scene.track == "gothic" else None
    clearance = p["clearance_seat_ball" if side == "outer" else "clearance_head_ball"]
    arc = groove(p["ball_radius"], radius, clearance, side, gothic, (lean - _ARC, lean + _ARC))
    return arc.moved((0.0, 0.0, sign * p["offset"]))


def _lands(sphere: float, p: Mapping[str, float], balls: int, slack: float) -> list[Mesh]:
    """The sphere between the tracks."""
    ball, pitch = p["ball_radius"], p["pitch_radius"]
    half = np.sqrt(max(ball**2 - (sphere - pitch) ** 2, (0.3 * ball) ** 2)) / sphere
    outer = sphere > pitch
    angle = np.linspace(*_SEAT, 12)[:: -1 if outer else 1]
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    step = 2.0 * np.pi / balls
    return [
        shapes.revolved(sphere * ring, slack * ring if outer else None, k * step + half, (k + 1) * step - half)
        for k in range(balls)
    ]


def _cup(seat: float, ball: float) -> Mesh:
    """The seat behind its sphere: a bell, and a shaft against the axis."""
    out, low = seat + 1.1 * ball, seat * np.sin(_SEAT[0])
    outline = [
        (0.55 * seat, low - 6.0 * ball), (0.55 * seat, low - 1.6 * ball), (0.97 * out, low - 0.4 * ball),
        (out, low + 0.4 * ball), (out, seat * np.sin(_SEAT[1])),
    ]  # fmt: skip
    return shapes.revolved(outline)


def _shaft(head: float, ball: float) -> Mesh:
    """The head's core below the tracks, and its shaft along the axis."""
    core = head - 0.62 * ball
    neck = 0.5 * head
    angle = np.linspace(-0.5 * np.pi, np.arccos(neck / core), 14)
    outline = [*zip(core * np.cos(angle), core * np.sin(angle), strict=True), (neck, 2.2 * head), (0.0, 2.2 * head)]
    return shapes.revolved(outline)


def _cage(scene: Joint, p: Mapping[str, float], seat: float, head: float) -> list[Mesh]:
    """A spherical ring: two bands across the axis, the webs between the windows."""
    ball, pitch = p["ball_radius"], p["pitch_radius"]
    play = {name: p.get(f"clearance_{name}", 0.0) for name in ("seat_cage", "head_cage", "cage_ball")}
    inner, outer = head + play["head_cage"], seat - play["seat_cage"]
    window, wide = ball + play["cage_ball"], 1.75 * ball
    if scene.banded:
        wide = max(pitch * float(np.sin(p["pilot_band"])), 1.1 * window)

    def ring(low: float, high: float, slack: tuple[float, float], begin: float = 0.0, end: float = 2.0 * np.pi) -> Mesh:
        height, share = np.linspace(low, high, 6), np.linspace(*slack, 6)
        up = np.stack([np.sqrt(outer**2 - height**2), height], axis=1)
        down = np.stack([np.sqrt(inner**2 - height**2), height], axis=1)[::-1]
        # The hollow sphere widens by its clearance, a window's face by its own.
        wider = np.stack([play["head_cage"] * down[:, 0] / inner, share[::-1]], axis=1)
        spread = np.concatenate([np.stack([0.0 * share, share], axis=1), wider])
        outline = np.concatenate([up, down])
        closed = [np.concatenate([x, x[:1]]) for x in (outline, spread)]
        return shapes.revolved(*closed, begin=begin, end=end, pieces=54)

    end = ball + p["clearance_cage_window_end"] if scene.has(WINDOW_END) else 1.22 * ball
    c, half = play["cage_ball"], float(np.arcsin(min(0.95, end / pitch)))
    step = 2.0 * np.pi / scene.balls
    found = [ring(window, wide, (c, c)), ring(-wide, -window, (-c, -c))]
    for k in range(scene.balls):
        begin, end = k * step + half, (k + 1) * step - half
        found += [
            ring(-window, window, (-c, c), begin, end),
            _side(inner, outer, window, begin),
            _side(inner, outer, window, end),
        ]
    return found


def _side(inner: float, outer: float, window: float, angle: float) -> Mesh:
    """The end of a window, a plane through the axis; seen from either side."""
    height = np.linspace(-window, window, 6)
    radii = [np.sqrt(r * r - height * height) for r in (inner, outer)]
    ring = np.array([np.cos(angle), np.sin(angle)])
    points = np.concatenate([np.column_stack([r[:, None] * ring, height]) for r in radii])
    a = np.arange(5)
    triangles = np.concatenate([np.stack([a, a + 1, a + 6], 1), np.stack([a + 1, a + 7, a + 6], 1)])
    way = np.array([-ring[1], ring[0], 0.0])
    both = np.concatenate([np.tile(way, (12, 1)), np.tile(-way, (12, 1))])
    return shapes.facing(Mesh(np.tile(points, (2, 1)), both, np.concatenate([triangles, triangles + 12])))


def carriers(scene: Joint) -> dict[str, str]:
    """``AbstractModel.carriers``."""
    return {c.name: CARRIERS.get(c.name, "ball") for c in scene.contacts}


def scenery(scene: Joint, readings: Mapping[str, Reading], y: Array, params: Params) -> Scenery:
    """``AbstractModel.scenery``; arrows where the readings have a direction."""
    c = constants(scene, params)
    state = view(scene, c, y)
    ideal = view(scene, c, nominal(scene, params, state.seat_turn))
    poses = _poses(scene, c, state)
    radius = {"seat_cage": params.get("seat_radius"), "head_cage": params.get("head_radius")}
    arrows = {}
    for contact in scene.contacts:
        force = readings[contact.name].world
        if force is None:
            continue
        size = jnp.sqrt(jnp.sum(force * force, -1, keepdims=True))
        way = jnp.where(size > 0, force / jnp.where(size > 0, size, 1.0), 0.0)
        # The line of the force meets the surface there.
        lever: Any = params["ball_radius"] if contact.name in OF_A_BALL else radius[contact.name]
        centre = poses[CARRIERS.get(contact.name, "ball")].place
        arrows[contact.name] = Arrow(centre - lever * way, force)
    return Scenery(poses, _poses(scene, c, ideal), arrows, {})


def _poses(scene: Joint, c: Constants, state: State) -> dict[str, Pose]:
    seat, head = shaft_frames(c, state)
    found = {"seat": Pose(jnp.zeros(3), seat), "head": Pose(state.head_place, head)}
    found["ball"] = Pose(state.ball_place, jnp.broadcast_to(jnp.eye(3), (scene.balls, 3, 3)))
    if state.cage_azimuth is not None:
        return found | {"cage": Pose(state.cage_place, cage_frame(state))}
    axis = state.cage_axis
    first = c.radial[0] - (c.radial[0] @ axis) * axis
    first = first / jnp.sqrt(first @ first)
    second = jnp.cross(axis, first)
    arm = state.ball_place - state.cage_place
    # The mean of what the balls say of the first window's azimuth.
    azimuth = jnp.arctan2(arm @ second, arm @ first) - scene.azimuths
    cosine, sine = jnp.mean(jnp.cos(azimuth)), jnp.mean(jnp.sin(azimuth))
    size = jnp.sqrt(cosine * cosine + sine * sine)
    x = (cosine * first + sine * second) / size
    found["cage"] = Pose(state.cage_place, jnp.stack([x, jnp.cross(axis, x), axis], -1))
    return found
