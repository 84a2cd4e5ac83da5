"""Balls of a ball joint: in the grooves of a race, between the faces of their cage windows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps.base import (
    ROUND,
    AbstractFlat,
    AbstractGap,
    Bends,
    Coefficients,
    Drawn,
    Face,
    Frame,
    Look,
    counted,
    direction,
    one_of,
)
from bcfj_jax.contact.gaps.guides import between
from bcfj_jax.core import shapes
from bcfj_jax.core.numerics import smooth_step
from bcfj_jax.core.vectors import Vector, add, cross, dot, length, plus, scale, subtract, times, turned, unit


def sector(cosine: Any) -> Array:
    """1 where a flank faces its ball, 0 beyond the groove's middle; C1. Of the cosine of the normal against the way across."""
    return smooth_step(20.0 * cosine)


class BallBetweenPlanes(AbstractFlat):
    """A ball of b between two parallel planes of a, faces or ends of a cage window:  d = +-p . e - clearance,  n = +-e.

    p leads from a's marker, midway between the planes, to b's, the ball's centre. The point of contact is on the ball,
    ``ball_radius`` along n. First face: the plane on the side of +e. Exact for planes without edges: the faces of a window
    and its ends are two contacts. Source: physics sheet 5.3, row 3.

    Directions: normal is along e, and the reading is signed: positive while the ball pushes the plane at +e. Axial is
    outward from a's marker to the ball; tangential is across both: around the cage, or along its axis at a window's end.
    Coefficients: ``clearance`` [m], of a centred ball to either plane; ``ball_radius`` [m].

    Attributes:
        axis: e in a's axes: "x", "y", "z", "-x", "-y", "-z", or three numbers; of the first window where there are several.
        windows: number of windows around a's z axis, as many as b has members, and so the contact: e turns by a full
            turn over it from one to the next. 0 is one e for all members, and the bodies decide them. The ends of windows whose
            first is at x: axis "y".
    """

    needs: ClassVar[tuple[str, ...]] = ("clearance", "ball_radius")
    signed: ClassVar[bool] = True
    preloads: ClassVar[bool] = True
    axis: Any = eqx.field(static=True, default="z", converter=direction)
    windows: int = eqx.field(static=True, default=0, converter=lambda n: counted("windows", n))

    @property
    def members(self) -> int:
        return self.windows

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        x, y, z = self.axis
        if self.windows:
            angle = 2.0 * np.pi * np.arange(self.windows) / self.windows
            x, y = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
        return between(a, b, turned(a.axes, (x, y, z)), c["clearance"], c["ball_radius"])

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        return subtract(b.place, a.place)

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        return (), (shapes.ball(c["ball_radius"]),)


class BallInGroove(AbstractGap):
    """Balls of b in the grooves of a race a, tori of gothic or circular section.

    a's marker is the race's centre and its z axis the race's. Track i of ``tracks`` lies in the plane of that axis and
    (cos f, sin f, 0), f = 2 pi i/tracks, of a's axes. Its centre circle has the radius Rc = sqrt(pitch_radius^2 + offset^2)
    about +offset z (outer race) or -offset z (inner race). In the section through the ball, T is the ball's place across
    the track's plane and A outward of the centre circle; kappa is +1 for the outer race and -1 for the inner, and q is
    r_g - r, groove radius less ball radius, ball_radius (2 conformity - 1):

        circular    d = |(T, A)| - clearance
        gothic      d = |(T, A) - centre| - q - clearance,   centre = -q (s sin(angle), kappa cos(angle)),   s = +1, -1

    n is the unit vector from that centre to the ball, across the track. Lengths are sqrt(v . v + (1e-12 m)^2), so that a
    ball in the middle of a circular groove has no direction, and finite derivatives. The point of contact is on the ball,
    ``ball_radius`` along n. A gothic flank is there (gate 1) only on its own side of the groove's middle.
    Tracks have no ends. Valid while |T|, |A| << Rc and d << q. Source: physics sheet 5.2 and 5.3, rows 4 and 5.
    The ``clearance`` of a gothic section may be negative: at T = A = 0 both flanks then press by so much, and push the ball out
    of the groove, 2 F cos(angle) along A, against another race: a preloaded bearing.

    Directions: normal is the sum over both flanks. Axial is along the track; tangential is around the section.
    Coefficients: ``ball_radius``, ``pitch_radius``, ``offset`` [m]; ``clearance`` [m], normal to a flank; of a gothic
    section also ``contact_angle`` [rad], of the unloaded contact against the track's plane, and ``conformity``, groove
    radius over ball diameter.

    Attributes:
        tracks: number of tracks around the race, as many as b has members, and so the contact; 0 is one track, in the
            plane of a's x and z axes, and the bodies decide the members.
        side: "outer" or "inner" race.
        section: "gothic", two faces, or "circular", one face.
    """

    tracks: int = eqx.field(static=True, default=0, converter=lambda n: counted("tracks", n))
    side: str = eqx.field(static=True, default="outer")
    section: str = eqx.field(static=True, default="gothic")

    def __check_init__(self):
        one_of("side", self.side, ("outer", "inner"))
        one_of("section", self.section, ("gothic", "circular"))

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        sizes = ("clearance", "ball_radius", "pitch_radius", "offset")
        return sizes if self.section == "circular" else (*sizes, "contact_angle", "conformity")

    @property
    def preloads(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of a gothic section: a circular one has no direction in its middle."""
        return self.section == "gothic"

    @property
    def members(self) -> int:
        return self.tracks

    def _place(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Vector, Vector]:
        """From the track's centre to the ball's [m], and the unit normal of the track's plane."""
        kappa = 1.0 if self.side == "outer" else -1.0
        place = subtract(subtract(b.place, a.place), scale(kappa * c["offset"], a.axes[2]))
        if not self.tracks:
            return place, a.axes[1]
        angle = 2.0 * np.pi * np.arange(self.tracks) / self.tracks
        return place, subtract(scale(np.cos(angle), a.axes[1]), scale(np.sin(angle), a.axes[0]))

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        place, across = self._place(a, b, c)
        aside = dot(place, across)
        plane = subtract(place, scale(aside, across))
        distance = length(plane, ROUND)
        radial = scale(1.0 / distance, plane)
        outward = distance - jnp.sqrt(c["pitch_radius"] ** 2 + c["offset"] ** 2)
        if self.section == "circular":
            return (_torus((aside, outward), (across, radial), c["clearance"], c["ball_radius"], 0.0),)
        kappa = 1.0 if self.side == "outer" else -1.0
        flank = c["ball_radius"] * (2.0 * c["conformity"] - 1.0)
        sine, outward = flank * jnp.sin(c["contact_angle"]), outward + kappa * (flank * jnp.cos(c["contact_angle"]))
        tube = flank + c["clearance"]
        first, second = (
            _torus((plus(aside, sign * sine), outward), (across, radial), tube, c["ball_radius"], sign)
            for sign in (1.0, -1.0)
        )
        return first, second

    def bends(self, c: Coefficients) -> Bends:
        free = c["clearance"]
        if self.section == "gothic":
            free = free + c["ball_radius"] * (2.0 * c["conformity"] - 1.0)
        return Bends(free)

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        place, across = self._place(a, b, c)
        return unit(cross(place, across))

    def drawn(self, c: Mapping[str, float], look: Look) -> Drawn:
        outer = self.side == "outer"
        radius, lean = (
            float(np.hypot(c["pitch_radius"], c["offset"])),
            float(np.arctan2(c["offset"], c["pitch_radius"])),
        )
        lean = -lean if outer else lean
        flank = c["ball_radius"] * (2.0 * c["conformity"] - 1.0) if self.section == "gothic" else 0.0
        gothic = (flank, c["contact_angle"]) if self.section == "gothic" else None
        arc = groove(c["ball_radius"], radius, c["clearance"], self.side, gothic, (lean - 0.7, lean + 0.7))
        found = []
        for i in range(self.tracks or 1):
            cosine, sine = np.cos(2.0 * np.pi * i / (self.tracks or 1)), np.sin(2.0 * np.pi * i / (self.tracks or 1))
            turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
            found.append(arc.moved((0.0, 0.0, c["offset"] if outer else -c["offset"]), turn))
        return tuple(found), (shapes.ball(c["ball_radius"]),)


def groove(
    ball: float,
    radius: float,
    clearance: float,
    side: str,
    gothic: tuple[float, float] | None,
    span: tuple[float, float],
) -> shapes.Mesh:
    """The surface of a track, from its centre, in the plane of x and z; x is along the middle of the arc.

    ``gothic``: flank [m] and contact angle [rad], None of a circular section; ``span``: angles drawn, from x towards z [rad].
    """
    kappa = 1.0 if side == "outer" else -1.0
    turn = np.linspace(-1.2, 1.2, 11)
    flank, angle = gothic or (0.0, 0.0)
    way = np.stack([kappa * np.cos(turn), np.sin(turn)], axis=1)
    centre = -flank * np.stack([np.full_like(turn, kappa * np.cos(angle)), np.sign(turn) * np.sin(angle)], axis=1)
    section = centre + (ball + flank + clearance) * way
    outline, slack = section + [radius, 0.0], clearance * way
    # Its outside is the side of the ball.
    order = slice(None, None, -1) if side == "outer" else slice(None)
    mesh = shapes.revolved(outline[order], slack[order], *span, pieces=48)
    # Turned about y: x stays, the angle grows towards z.
    return mesh.moved(axes=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))


def _torus(place: tuple[Any, Any], axes: tuple[Vector, Vector], tube: Array, ball: Array, flank: float) -> Face:
    """A ball in a torus: its place in the section from the section's centre [m], by its axes; ``tube`` the play [m].

    ``flank`` is +1 or -1, the side of the groove that this is the flank of, or 0 for both.
    """
    (aside, outward), (across, radial) = place, axes
    distance = jnp.sqrt(aside * aside + outward * outward + ROUND**2)
    towards, up = aside / distance, outward / distance
    normal = add(scale(towards, across), scale(up, radial))
    gate = sector(times(flank, towards)) if flank else 1.0
    return Face(distance - tube, normal, scale(ball, normal), gate)
