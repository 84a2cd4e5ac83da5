"""What a deflection asks of the joint's dimensions: balls that reach, stay apart, stay on tracks and in the seat.

Necessary conditions, as ``checks`` says, which puts them to a joint's values; the deflection is every check's last
argument. Ball centres are those of physics sheet 5.2, without clearance, over a whole revolution, in plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple


class Fault(NamedTuple):
    """What a check found: the key to look at, what is wrong, what would be right."""

    key: str
    found: str
    remedy: str


def shown(value: float, unit: str = "m") -> str:
    """A value as a message quotes it; angles in degrees too."""
    if unit == "rad":
        return f"{value:.6g} rad ({math.degrees(value):.5g} deg)"
    return f"{value:.6g} {unit}".rstrip()


def distances(pitch_radius: float, offset: float, joint_angle: float) -> tuple[float, float]:
    """Least and greatest |P| [m] over a revolution, at the latitudes -+beta/2."""
    rise = abs(offset) * math.sin(0.5 * joint_angle)
    level = math.hypot(pitch_radius, rise)
    return level - rise, level + rise


def reaches_seat(seat_radius: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """At its least distance from O a ball still stands out of the seat's sphere, into the seat's track."""
    short = seat_radius - ball_radius - distances(pitch, offset, angle)[0]
    if short < 0.0:
        return None
    found = (
        f"{shown(pitch)} leaves a ball {shown(short)} away from the seat's track, which begins at {shown(seat_radius)}"
    )
    return Fault("pitch_radius", found, f"give about {shown(pitch + short)} or more, or a larger ball_radius")


def reaches_head(head_radius: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """At its greatest distance from O a ball still stands into the head's sphere, into the head's track."""
    short = distances(pitch, offset, angle)[1] - ball_radius - head_radius
    if short < 0.0:
        return None
    found = (
        f"{shown(pitch)} leaves a ball {shown(short)} away from the head's track, which ends at {shown(head_radius)}"
    )
    return Fault("pitch_radius", found, f"give about {shown(pitch - short)} or less, or a larger ball_radius")


def apart(balls: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
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
    found = f"{balls:g} balls of ball_radius = {shown(ball_radius)} overlap: their centres are {shown(chord)} apart"
    return Fault("balls", found, "give fewer or smaller balls, or a larger pitch_radius")


def on_window(
    seat_radius: float, outside: float, ball_radius: float, pitch: float, offset: float, angle: float
) -> Fault | None:
    """The ball's poles, where the window's faces hold it, are at sqrt(|P|^2 + r^2) from O: within the cage."""
    pole = math.hypot(distances(pitch, offset, angle)[1], ball_radius)
    cage = seat_radius - outside
    if pole < cage:
        return None
    found = (
        f"{shown(pitch)} moves a ball out of its window: its poles are at {shown(pole)}, the cage ends at {shown(cage)}"
    )
    return Fault("pitch_radius", found, f"give about {shown(pitch + cage - pole)} or less, or a larger seat_radius")


def webs(seat_radius: float, end: float, balls: float, ball_radius: float) -> Fault | None:
    """Something is left of the cage between windows: their ends, ball_radius + clearance off their middles, meet inside."""
    most = seat_radius * math.sin(math.pi / balls) - ball_radius
    if end < most:
        return None
    found = f"{shown(end)} leaves nothing of the cage between {balls:g} windows"
    return Fault("clearance_cage_window_end", found, f"give less than {shown(most)}, or fewer balls")


@lru_cache(maxsize=64)  # Points of a study mostly share what it depends on.
def swing(balls: float, pitch: float, offset: float, angle: float) -> float:
    """Clearance [m] that balls need on either side of them in the windows of a cage that swings along as best it can.

    In the plane of centres a ball at phi of the seat is  s = |P| sin(phi) cos(phi) (1/cos(beta/2) - 1)  from the place that
    is evenly spaced, P by ``geometry.ball_centre``. The cage takes the mean of the greatest and the least s of a moment.
    """
    if balls < 2.0:
        return 0.0
    reach, steps = math.hypot(pitch, offset), 90
    need = 0.0
    for k in range(steps):
        found = []
        for ball in range(int(balls)):
            phi = 2.0 * math.pi * (k / (steps * balls) + ball / balls)
            h = -math.cos(phi) * math.tan(0.5 * angle)
            out = (h * offset + math.sqrt((1.0 + h * h) * reach**2 - offset**2)) / (1.0 + h * h)
            found.append(out * math.sin(phi) * math.cos(phi) * (1.0 / math.cos(0.5 * angle) - 1.0))
        need = max(need, 0.5 * (max(found) - min(found)))
    return need


def swings(end: float, balls: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """Deflected balls swing to and fro around the cage, twice a turn, and their windows must let them."""
    del ball_radius
    need = swing(balls, pitch, offset, angle)
    if end >= need:
        return None
    found = f"{shown(end)} is less than the {shown(need)} by which balls swing at joint_angle = {shown(angle, 'rad')}"
    return Fault("clearance_cage_window_end", found, f"give {shown(need)} or more")


def contact_height(ball_radius: float, pitch: float, offset: float, alpha: float, angle: float) -> tuple[float, float]:
    """How far along the seat's axis contacts on it come from O, away from and towards its tracks' centre [m].

    A contact is at P + r n, along the axis P_z + r cos(alpha) (P_z - e)/Rc, with P_z from -|P| sin(beta/2) at the
    least |P| to +|P| sin(beta/2) at the greatest.
    """
    down, up = (distance * math.sin(0.5 * angle) for distance in distances(pitch, offset, angle))
    lever = ball_radius * math.cos(alpha) / math.hypot(pitch, offset)
    return down + lever * (down + abs(offset)), up + lever * (up - abs(offset))


def mouth_open(
    seat_radius: float, ball_radius: float, pitch: float, offset: float, alpha: float, angle: float
) -> Fault | None:
    """Some mouth lets the head's shaft, however thin, swing to beta and still holds every ball.

    In the seat's sphere a mouth m from O has the edge at acos(m/Rso) from the axis: beta reaches it unless
    m < Rso cos(beta). The balls' contacts ask for an m beyond theirs, on the side that asks for less.
    """
    need, limit = min(contact_height(ball_radius, pitch, offset, alpha, angle)), seat_radius * math.cos(angle)
    if need < limit:
        return None
    found = f"{shown(angle, 'rad')} turns the head's shaft into the seat. The seat's mouth must be beyond the balls' contacts"
    found += f", {shown(need)} from the centre, and within seat_radius cos(joint_angle) = {shown(limit)}"
    return Fault("joint_angle", found, "give a larger seat_radius")


def centres_in_mouth(seat_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """``mouth_open`` of the balls' centres, where no contact angle says where they bear."""
    return mouth_open(seat_radius, 0.0, pitch, offset, 0.0, angle)


def largest(check: Callable[..., Fault | None], values: Sequence[float]) -> float | None:
    """Greatest deflection [rad], the last of the values, that passes a check; None where none does."""
    *others, high = values
    if check(*others, 0.0) is not None:
        return None
    low = 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if check(*others, middle) is None else (low, middle)
    # As many digits as a message shows, downwards.
    return math.floor(low * 1e4) / 1e4
