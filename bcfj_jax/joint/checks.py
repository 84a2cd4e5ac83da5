"""What cannot be built, said before anything runs: the dimensions of a joint against each other.

Every check is a necessary condition: what it refuses does not assemble, does not reach or does not swing. Each
needs certain keys and is skipped where one is missing. Ball centres are those without clearance, at the given
deflection, over a whole revolution. The formulas are those of ``joint.geometry``, in plain numbers: a refusal
costs no compilation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from bcfj_jax.errors import InputError

# Lengths that are equal but for rounding touch; they do not interfere.
_ROUNDING = 1e-9


class Fault(NamedTuple):
    """What a check found: the key to look at, what is wrong, what would be right."""

    key: str
    found: str
    remedy: str


class _Range(NamedTuple):
    """Open or half-open range of one key by itself."""

    low: float
    high: float
    closed: bool
    unit: str
    remedy: str

    def holds(self, value: float) -> bool:
        above = value >= self.low if self.closed else value > self.low
        return above and value < self.high


_LENGTH = _Range(0.0, math.inf, False, "m", "give a length > 0")
_PLAY = _Range(0.0, math.inf, True, "m", "give a clearance >= 0: parts that overlap do not assemble")
_ARC = _Range(0.0, math.inf, False, "rad", "give an angle > 0")
_RANGES = {
    **dict.fromkeys(("seat_radius", "head_radius", "ball_radius", "pitch_radius", "track_radius"), _LENGTH),
    **dict.fromkeys(("window_length", "bend_radius", "body_radius", "body_length", "seat_mouth"), _LENGTH),
    **dict.fromkeys(("seat_track_angle", "head_track_angle"), _ARC),
    "offset": _Range(-math.inf, math.inf, False, "m", "give a finite length"),
    "hole_clearance": _PLAY,
    "clearance_cage_ball": _PLAY._replace(remedy="a window smaller than the ball does not take it: give one >= 0"),
    "contact_angle": _Range(0.0, 0.5 * math.pi, False, "rad", "give an angle between 0 and 90 deg, without the ends"),
    "conformity": _Range(0.5, math.inf, False, "", "a groove must be wider than the ball: give a ratio > 0.5"),
    "joint_angle": _Range(0.0, 0.5 * math.pi, True, "rad", "the axes must not reach 90 deg: give 0 to below 90 deg"),
    "balls": _Range(1.0, math.inf, True, "", "give a whole number >= 1"),
}


def _shown(value: float, unit: str = "m") -> str:
    """A value as a message quotes it; angles in degrees too."""
    if unit == "rad":
        return f"{value:.6g} rad ({math.degrees(value):.5g} deg)"
    return f"{value:.6g} {unit}".rstrip()


def _in_range(key: str, value: float) -> Fault | None:
    """Each value by itself; every clearance, whatever it is called, must not be negative."""
    limits = _RANGES.get(key, _PLAY if key.startswith("clearance_") else None)
    if limits is None or (limits.holds(value) and (key != "balls" or value == int(value))):
        return None
    return Fault(key, f"{_shown(value, limits.unit)} is out of range", limits.remedy)


def _centred(offset: float, track_radius: float) -> Fault | None:
    """A track's circle must reach around O: with |e| >= Rc it crosses the axis and no pitch radius is left."""
    if abs(offset) < track_radius:
        return None
    found = f"{_shown(offset)} is not less than the track radius, track_radius = {_shown(track_radius)}"
    return Fault("offset", found, "give a smaller offset: the track circle must pass around the joint's centre")


def _one_pitch(pitch_radius: float, offset: float, track_radius: float) -> Fault | None:
    """Rp^2 = Rc^2 - e^2: three values given of which two are free."""
    right = math.hypot(pitch_radius, offset)
    if math.isclose(track_radius, right, rel_tol=1e-6):
        return None
    found = f"{_shown(track_radius)} does not go with pitch_radius = {_shown(pitch_radius)} and offset"
    return Fault("track_radius", found, f"leave it out, or give sqrt(Rp^2 + e^2) = {_shown(right)}")


def _enclosed(seat_radius: float, head_radius: float) -> Fault | None:
    """The seat's hollow sphere surrounds the head."""
    if seat_radius > head_radius:
        return None
    found = f"{_shown(seat_radius)} does not enclose the head, head_radius = {_shown(head_radius)}"
    return Fault("seat_radius", found, "give a seat larger than the head, with the cage between them")


def _cage_wall(seat_radius: float, head_radius: float, outside: float, inside: float) -> Fault | None:
    """The cage fills what the seat, the head and the two clearances leave; that must be a wall."""
    wall = (seat_radius - outside) - (head_radius + inside)
    if wall > 0.0:
        return None
    found = f"{_shown(outside)} and clearance_head_cage = {_shown(inside)} leave the cage a wall of {_shown(wall)}"
    return Fault("clearance_seat_cage", found, "give smaller clearances, a larger seat_radius or a smaller head_radius")


def _bridges(seat_radius: float, head_radius: float, ball_radius: float) -> Fault | None:
    """A ball no thicker than the space between the spheres sits in one track only."""
    gap = seat_radius - head_radius
    if 2.0 * ball_radius > gap:
        return None
    found = f"{_shown(ball_radius)} does not reach both tracks across the {_shown(gap)} between seat and head"
    return Fault("ball_radius", found, f"give more than {_shown(0.5 * gap)}")


def _distances(pitch_radius: float, offset: float, joint_angle: float) -> tuple[float, float]:
    """Least and greatest |P| [m] over a revolution, at the latitudes -+beta/2."""
    rise = abs(offset) * math.sin(0.5 * joint_angle)
    level = math.hypot(pitch_radius, rise)
    return level - rise, level + rise


def _reaches_seat(seat_radius: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """At its least distance from O a ball still stands out of the seat's sphere, into the seat's track."""
    short = seat_radius - ball_radius - _distances(pitch, offset, angle)[0]
    if short < 0.0:
        return None
    found = f"{_shown(pitch)} keeps a ball {_shown(short)} short of the seat's track beyond {_shown(seat_radius)}"
    return Fault(
        "pitch_radius",
        found,
        f"give about {_shown(pitch + short)} or more, a larger ball_radius or a smaller joint_angle",
    )


def _reaches_head(head_radius: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """At its greatest distance from O a ball still stands into the head's sphere, into the head's track."""
    short = _distances(pitch, offset, angle)[1] - ball_radius - head_radius
    if short < 0.0:
        return None
    found = f"{_shown(pitch)} keeps a ball {_shown(short)} short of the head's track within {_shown(head_radius)}"
    return Fault(
        "pitch_radius",
        found,
        f"give about {_shown(pitch - short)} or less, a larger ball_radius or a smaller joint_angle",
    )


def _apart(balls: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """Neighbouring balls do not touch.

    They are closest where they stand evenly about the azimuth of the least |P|, at phi = -+pi/z: that far apart
    along y only. At no deflection this is the chord 2 Rp sin(pi/z).
    """
    if balls < 2.0:
        return None
    h = math.cos(math.pi / balls) * math.tan(0.5 * angle)
    rise = abs(offset) * h / math.hypot(1.0, h)
    chord = 2.0 * (math.hypot(pitch, rise) - rise) / math.hypot(1.0, h) * math.sin(math.pi / balls)
    if chord > 2.0 * ball_radius:
        return None
    found = f"{balls:g} balls of ball_radius = {_shown(ball_radius)} overlap, centres {_shown(chord)} apart"
    return Fault("balls", found, "give fewer or smaller balls, or a larger pitch_radius")


def _cage_webs(balls: float, window_length: float, head_radius: float, inside: float) -> Fault | None:
    """Between parallel-sided windows a web is left down to the cage's inner sphere, Rci.

    The sides of two neighbours meet at the radius (L/2)/sin(pi/z), which must lie inside Rci.
    """
    limit = 2.0 * (head_radius + inside) * math.sin(math.pi / balls)
    if balls < 2.0 or window_length < limit:
        return None
    found = f"{_shown(window_length)} leaves no web of the cage between {balls:g} windows"
    return Fault("window_length", found, f"give less than 2 Rci sin(pi/z) = {_shown(limit)}, or fewer balls")


def _window_length(window_length: float, ball_radius: float, pitch_radius: float, joint_angle: float) -> Fault | None:
    """A deflected joint moves a ball by -+q |P| along its window, q = tan^2(beta/4), hence 2 r + 2 q Rp.

    To first order in the offset; |P| > Rp on the farther side asks for some micrometres more.
    """
    limit = 2.0 * (ball_radius + pitch_radius * math.tan(0.25 * joint_angle) ** 2)
    if window_length >= limit * (1.0 - _ROUNDING):
        return None
    found = f"{_shown(window_length)} is too short for the ball and its travel of -+tan^2(beta/4) Rp"
    return Fault("window_length", found, f"give at least {_shown(limit)}, or a smaller joint_angle")


def _on_window(
    seat_radius: float, outside: float, ball_radius: float, pitch: float, offset: float, angle: float
) -> Fault | None:
    """The ball's poles, where the window's faces hold it, are at sqrt(|P|^2 + r^2) from O: within the cage."""
    pole = math.hypot(_distances(pitch, offset, angle)[1], ball_radius)
    cage = seat_radius - outside
    if pole < cage:
        return None
    found = f"{_shown(pitch)} takes a ball out of its window: poles {_shown(pole)} out, the cage {_shown(cage)}"
    return Fault("pitch_radius", found, f"give about {_shown(pitch + cage - pole)} or less, or a larger seat_radius")


def _track_travel(pitch_radius: float, offset: float, joint_angle: float) -> float:
    """Half the arc [rad] of a track that a ball needs, about the track's own centre, from the plane normal to its axis.

    Seen from O the ball swings by -+beta/2. In the triangle O, O_o, P the angle at P is
    eps = asin((e/Rc) cos(beta/2)), so that from O_o it swings between -beta/2 - eps and beta/2 - eps. On the head
    it is the mirror image. eps is also half the angle of the funnel between the tracks, psi = asin(e/Rc) at home:
    with e > 0 and beta < 180 deg it never closes.
    """
    ratio = abs(offset) / math.hypot(pitch_radius, offset)
    return 0.5 * joint_angle + math.asin(ratio * math.cos(0.5 * joint_angle))


def _on_track(key: str) -> Callable[[float, float, float, float], Fault | None]:
    """The check that the ball stays on the seat's or the head's track."""

    def check(track_angle: float, pitch_radius: float, offset: float, joint_angle: float) -> Fault | None:
        need = _track_travel(pitch_radius, offset, joint_angle)
        if track_angle >= need * (1.0 - _ROUNDING):
            return None
        found = f"{_shown(track_angle, 'rad')} ends before the ball at joint_angle = {_shown(joint_angle, 'rad')}"
        return Fault(key, found, f"give at least {_shown(need, 'rad')}, or a smaller joint_angle")

    return check


def _in_mouth(
    mouth: float, ball_radius: float, pitch: float, offset: float, alpha: float, angle: float
) -> Fault | None:
    """The balls bear on the seat inside its mouth, a plane normal to the seat's axis at this distance from O.

    A contact is at P + r n, along the axis P_z + r cos(alpha) (P_z - e)/Rc, with P_z from -|P| sin(beta/2) at the
    least |P| to +|P| sin(beta/2) at the greatest. On which side the mouth is, nothing here says: both must do.
    """
    down, up = (distance * math.sin(0.5 * angle) for distance in _distances(pitch, offset, angle))
    lever = ball_radius * math.cos(alpha) / math.hypot(pitch, offset)
    need = max(down + lever * (down + abs(offset)), up + lever * (up - abs(offset)))
    if mouth > need:
        return None
    found = f"{_shown(mouth)} is passed by the balls' contacts at joint_angle = {_shown(angle, 'rad')}"
    return Fault("seat_mouth", found, f"give more than {_shown(need)}, or a smaller joint_angle")


def _body_fits(bend_radius: float, hole_clearance: float, body_radius: float, body_length: float) -> Fault | None:
    """A straight body passes a bent hole up to the length 4 sqrt(C (R + d)), see ``geometry.flexible_length``."""
    if bend_radius <= body_radius + hole_clearance:
        found = f"{_shown(bend_radius)} is not more than the hole's own radius"
        return Fault("bend_radius", found, f"give more than {_shown(body_radius + hole_clearance)}")
    limit = 4.0 * math.sqrt(hole_clearance * (bend_radius + body_radius))
    if body_length <= limit * (1.0 + _ROUNDING):
        return None
    found = f"{_shown(body_length)} does not pass the bent hole"
    return Fault("body_length", found, f"give at most 4 sqrt(C (R + d)) = {_shown(limit)}, or more hole_clearance")


_BALL = ("ball_radius", "pitch_radius", "offset", "joint_angle")
_TRAVEL = ("pitch_radius", "offset", "joint_angle")
# The keys a check needs, in the order of its arguments, and the check: the plainest fault is found first.
_CHECKS: tuple[tuple[tuple[str, ...], Callable[..., Fault | None]], ...] = (
    (("offset", "track_radius"), _centred),
    (("pitch_radius", "offset", "track_radius"), _one_pitch),
    (("seat_radius", "head_radius"), _enclosed),
    (("seat_radius", "head_radius", "clearance_seat_cage", "clearance_head_cage"), _cage_wall),
    (("seat_radius", "head_radius", "ball_radius"), _bridges),
    (("seat_radius", *_BALL), _reaches_seat),
    (("head_radius", *_BALL), _reaches_head),
    (("seat_radius", "clearance_seat_cage", *_BALL), _on_window),
    (("balls", *_BALL), _apart),
    (("balls", "window_length", "head_radius", "clearance_head_cage"), _cage_webs),
    (("window_length", "ball_radius", "pitch_radius", "joint_angle"), _window_length),
    (("seat_track_angle", *_TRAVEL), _on_track("seat_track_angle")),
    (("head_track_angle", *_TRAVEL), _on_track("head_track_angle")),
    (("seat_mouth", "ball_radius", "pitch_radius", "offset", "contact_angle", "joint_angle"), _in_mouth),
    (("bend_radius", "hole_clearance", "body_radius", "body_length"), _body_fits),
)


def check_geometry(values: Mapping[str, float], where: str = "scene 'joint'") -> None:
    """Refuse dimensions that do not make a joint.

    Args:
        values: keys of the joint, SI and radians, concrete numbers. Read are the keys of ``_RANGES`` and of
            ``_CHECKS`` and any that begins with ``clearance_``; others are left alone, and missing ones skip
            the checks that need them.
        where: what the message begins with; the key follows it.

    Raises:
        InputError: naming the key, its value and what would be right.
    """
    given = {key: float(value) for key, value in values.items() if key in _RANGES or key.startswith("clearance_")}
    alone = (_in_range(key, value) for key, value in given.items())
    together = (check(*(given[k] for k in keys)) for keys, check in _CHECKS if all(k in given for k in keys))
    # Lazily, ranges first: no check sees a value that is no length or no angle.
    for faults in (alone, together):
        for fault in faults:
            if fault is not None:
                raise InputError(f"{where} {fault.key}", fault.found, fault.remedy)
