"""What cannot be built, said before anything runs: the dimensions of a joint against each other.

Every check is a necessary condition: what it refuses does not assemble, does not reach or does not swing. Each
needs certain keys and is skipped where one is missing. Ball centres are those of physics sheet 5.2, without clearance, at
the given deflection, over a whole revolution. The formulas are those of ``joint.geometry``, in plain numbers: a refusal
costs no compilation.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.scene import GROOVES, PILOTS, Joint


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


_LENGTH = _Range(0.0, math.inf, False, "m", "give a length > 0")
_PLAY = _Range(0.0, math.inf, True, "m", "give a clearance >= 0: parts that overlap cannot be assembled")
_ANGLE = _Range(0.0, 0.5 * math.pi, False, "rad", "give an angle above 0 and below 90 deg")
_RANGES = {
    **dict.fromkeys(("seat_radius", "head_radius", "ball_radius", "pitch_radius"), _LENGTH),
    "offset": _Range(-math.inf, math.inf, False, "m", "give a finite length"),
    "clearance_cage_ball": _PLAY._replace(remedy="give a clearance >= 0: a ball does not fit into a smaller window"),
    "contact_angle": _ANGLE,
    "conformity": _Range(0.5, math.inf, False, "", "give a ratio > 0.5: a groove is wider than the ball"),
    "pilot_band": _ANGLE,
    "joint_angle": _ANGLE._replace(closed=True, remedy="give 0 or more and less than 90 deg"),
    "balls": _Range(1.0, math.inf, True, "", "give a whole number >= 1"),
}


def shown(value: float, unit: str = "m") -> str:
    """A value as a message quotes it; angles in degrees too."""
    if unit == "rad":
        return f"{value:.6g} rad ({math.degrees(value):.5g} deg)"
    return f"{value:.6g} {unit}".rstrip()


def _in_range(key: str, value: float) -> Fault | None:
    """Each value by itself; every clearance, whatever it is called, must not be negative."""
    limits = _RANGES.get(key, _PLAY if key.startswith("clearance_") else None)
    if limits is None:
        return None
    above = value >= limits.low if limits.closed else value > limits.low
    if above and value < limits.high and (key != "balls" or value == int(value)):
        return None
    return Fault(key, f"{shown(value, limits.unit)} is out of range", limits.remedy)


def _enclosed(seat_radius: float, head_radius: float) -> Fault | None:
    """The seat's hollow sphere surrounds the head."""
    if seat_radius > head_radius:
        return None
    found = f"{shown(seat_radius)} does not enclose the head, head_radius = {shown(head_radius)}"
    remedy = "give a seat larger than the head, with the cage between them"
    return Fault("seat_radius", found, remedy)


def _cage_wall(seat_radius: float, head_radius: float, outside: float, inside: float) -> Fault | None:
    """The cage fills what the seat, the head and the two clearances leave; that must be a wall."""
    wall = (seat_radius - outside) - (head_radius + inside)
    if wall > 0.0:
        return None
    found = f"{shown(outside)} and clearance_head_cage = {shown(inside)} leave the cage a wall of {shown(wall)}"
    remedy = "give smaller clearances, a larger seat_radius or a smaller head_radius"
    return Fault("clearance_seat_cage", found, remedy)


def _bridges(seat_radius: float, head_radius: float, ball_radius: float) -> Fault | None:
    """A ball no thicker than the space between the spheres sits in one track only."""
    gap = seat_radius - head_radius
    if 2.0 * ball_radius > gap:
        return None
    found = f"{shown(ball_radius)} does not reach both tracks across the {shown(gap)} between seat and head"
    return Fault("ball_radius", found, f"give more than {shown(0.5 * gap)}")


def _beside_windows(band: float, seat_radius: float, play: float, ball_radius: float) -> Fault | None:
    """A cage that ends nearer to the equator than its windows' faces is none."""
    need = (ball_radius + play) / seat_radius
    if math.sin(band) > need:
        return None
    found = f"{shown(band, 'rad')} ends the cage within its windows, whose faces are {shown(ball_radius + play)} off"
    remedy = f"give more than {shown(math.asin(min(need, 1.0)), 'rad')}"
    return Fault("pilot_band", found, remedy)


def distances(pitch_radius: float, offset: float, joint_angle: float) -> tuple[float, float]:
    """Least and greatest |P| [m] over a revolution, at the latitudes -+beta/2."""
    rise = abs(offset) * math.sin(0.5 * joint_angle)
    level = math.hypot(pitch_radius, rise)
    return level - rise, level + rise


def _reaches_seat(seat_radius: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """At its least distance from O a ball still stands out of the seat's sphere, into the seat's track."""
    short = seat_radius - ball_radius - distances(pitch, offset, angle)[0]
    if short < 0.0:
        return None
    away = f"{shown(short)} away from the seat's track, which begins at {shown(seat_radius)}"
    remedy = f"give about {shown(pitch + short)} or more, or a larger ball_radius"
    return Fault("pitch_radius", f"{shown(pitch)} leaves a ball {away}", remedy)


def _reaches_head(head_radius: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """At its greatest distance from O a ball still stands into the head's sphere, into the head's track."""
    short = distances(pitch, offset, angle)[1] - ball_radius - head_radius
    if short < 0.0:
        return None
    away = f"{shown(short)} away from the head's track, which ends at {shown(head_radius)}"
    remedy = f"give about {shown(pitch - short)} or less, or a larger ball_radius"
    return Fault("pitch_radius", f"{shown(pitch)} leaves a ball {away}", remedy)


def apart(balls: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """Neighbouring balls do not touch.

    They are closest where they stand evenly about the azimuth of the least |P|, at phi = -+pi/z: that far apart
    along y only. At no deflection this is the chord 2 Rp sin(pi/z).
    """
    h = math.cos(math.pi / balls) * math.tan(0.5 * angle)
    rise = abs(offset) * h / math.hypot(1.0, h)
    chord = 2.0 * (math.hypot(pitch, rise) - rise) / math.hypot(1.0, h) * math.sin(math.pi / balls)
    if balls < 2.0 or chord > 2.0 * ball_radius:
        return None
    found = f"{balls:g} balls of ball_radius = {shown(ball_radius)} overlap: their centres are {shown(chord)} apart"
    remedy = "give fewer or smaller balls, or a larger pitch_radius"
    return Fault("balls", found, remedy)


def _on_window(
    seat_radius: float, outside: float, ball_radius: float, pitch: float, offset: float, angle: float
) -> Fault | None:
    """The ball's poles, where the window's faces hold it, are at sqrt(|P|^2 + r^2) from O: within the cage."""
    pole, cage = math.hypot(distances(pitch, offset, angle)[1], ball_radius), seat_radius - outside
    if pole < cage:
        return None
    where = f"its poles are at {shown(pole)}, the cage ends at {shown(cage)}"
    remedy = f"give about {shown(pitch + cage - pole)} or less, or a larger seat_radius"
    found = f"{shown(pitch)} moves a ball out of its window: {where}"
    return Fault("pitch_radius", found, remedy)


def _webs(seat_radius: float, end: float, balls: float, ball_radius: float) -> Fault | None:
    """Something is left of the cage between windows: their ends, ball_radius + clearance off their middles, meet inside."""
    most = seat_radius * math.sin(math.pi / balls) - ball_radius
    if end < most:
        return None
    found = f"{shown(end)} leaves nothing of the cage between {balls:g} windows"
    remedy = f"give less than {shown(most)}, or fewer balls"
    return Fault("clearance_cage_window_end", found, remedy)


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


def _swings(end: float, balls: float, ball_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """Deflected balls swing to and fro around the cage, twice a turn, and their windows must let them."""
    del ball_radius
    need = swing(balls, pitch, offset, angle)
    if end >= need:
        return None
    found = f"{shown(end)} is less than the {shown(need)} by which balls swing at joint_angle = {shown(angle, 'rad')}"
    return Fault("clearance_cage_window_end", found, f"give {shown(need)} or more")


def mouth_open(
    seat_radius: float, ball_radius: float, pitch: float, offset: float, alpha: float, angle: float
) -> Fault | None:
    """Some mouth lets the head's shaft, however thin, swing to beta and still holds every ball.

    In the seat's sphere a mouth m from O has the edge at acos(m/Rso) from the axis: beta reaches it unless
    m < Rso cos(beta). The balls' contacts ask for an m beyond theirs, on the side that asks for less: a contact is at P + r n,
    along the axis  P_z + r cos(alpha) (P_z - e)/Rc,  with P_z from -|P| sin(beta/2) at the least |P| to +|P| sin(beta/2)
    at the greatest.
    """
    down, up = (distance * math.sin(0.5 * angle) for distance in distances(pitch, offset, angle))
    lever = ball_radius * math.cos(alpha) / math.hypot(pitch, offset)
    need = min(down + lever * (down + abs(offset)), up + lever * (up - abs(offset)))
    limit = seat_radius * math.cos(angle)
    if need < limit:
        return None
    found = f"{shown(angle, 'rad')} turns the head's shaft into the seat. The seat's mouth must be beyond the balls' contacts"
    found += f", {shown(need)} from the centre, and within seat_radius cos(joint_angle) = {shown(limit)}"
    return Fault("joint_angle", found, "give a larger seat_radius")


def _centres_in_mouth(seat_radius: float, pitch: float, offset: float, angle: float) -> Fault | None:
    """``mouth_open`` of the balls' centres, where no contact angle says where they bear."""
    return mouth_open(seat_radius, 0.0, pitch, offset, 0.0, angle)


_BALL = ("ball_radius", "pitch_radius", "offset", "joint_angle")
# The keys a check needs, in the order of its arguments, and the check: the plainest fault is found first.
_CHECKS: tuple[tuple[tuple[str, ...], Callable[..., Fault | None]], ...] = (
    (("seat_radius", "head_radius"), _enclosed),
    (("seat_radius", "head_radius", "clearance_seat_cage", "clearance_head_cage"), _cage_wall),
    (("seat_radius", "head_radius", "ball_radius"), _bridges),
    (("seat_radius", *_BALL), _reaches_seat),
    (("head_radius", *_BALL), _reaches_head),
    (("seat_radius", "clearance_seat_cage", *_BALL), _on_window),
    (("pilot_band", "seat_radius", "clearance_cage_ball", "ball_radius"), _beside_windows),
    (("balls", *_BALL), apart),
    (("seat_radius", "ball_radius", "pitch_radius", "offset", "contact_angle", "joint_angle"), mouth_open),
    (("seat_radius", "pitch_radius", "offset", "joint_angle"), _centres_in_mouth),
    (("seat_radius", "clearance_cage_window_end", "balls", "ball_radius"), _webs),
    (("clearance_cage_window_end", "balls", *_BALL), _swings),
)


def _largest(check: Callable[..., Fault | None], values: Sequence[float]) -> float | None:
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


def check_joint(scene: Joint, params: Params, where: str = "") -> None:
    """Refuse a joint that does not assemble, or that its fidelity has no answer for.

    Parameters that are batched or traced are not looked at, nor NaN: its run fails and says so.

    Raises:
        InputError: which begins with ``where`` and names the key, its value and what would be right.
    """
    where = where or "scene 'joint'"
    for contact in scene.contacts:
        for name in contact.own:
            # Of a law of the user's own: every other coefficient has a default.
            if name not in params and f"{contact.name}.{name}" not in params:
                found = f"the parameter '{name}' has no value; it is read by {contact.name}"
                raise InputError(where, found, f"give {name}, or {contact.name}.{name}")
    single = {name: x for name, x in params.items() if not is_traced(x) and np.ndim(x) == 0 and not np.isnan(x)}
    values = {name: float(value) for name, value in single.items()}
    _conformal(scene, values, where)
    check_geometry(values | {"balls": scene.balls}, where)
    if scene.fidelity == "kinematic" and scene.track == "gothic" and values.get("offset") == 0.0:
        remedy = "give an offset, or fidelity = 'quasistatic' or 'dynamic'"
        raise InputError(f"{where} offset", "0 m: there is no closed form for load sharing without an offset", remedy)


def _conformal(scene: Joint, values: Mapping[str, float], where: str) -> None:
    """Formulas for a sphere in a hollow need a radius difference: of pilots and circular tracks that is the clearance."""
    for contact in scene.contacts:
        name = f"clearance_{contact.name}"
        filled = contact.name in PILOTS or (contact.name in GROOVES and scene.track == "circular")
        if values.get(name) == 0.0 and filled and (contact.geometric or "radius_difference" in contact.derived):
            found = "0 m: without a difference of the radii the formulas for its stiffness have no value"
            remedy = f"give a clearance > 0, or a power law with a stiffness of its own to {contact.name}"
            raise InputError(f"{where} {name}", found, remedy)


def suspects(scene: Joint, params: Params) -> np.ndarray:
    """Which of N joints ``check_joint`` must look at one by one, (N,), of leaves (N,): it finds no fault with the others.

    Only checks that read what differs among them are made again for each.
    """
    columns = {name: np.asarray(leaf).tolist() for name, leaf in params.items()}
    values: dict[str, Any] = {name: column[0] for name, column in columns.items()}
    found = np.ones(len(next(iter(columns.values()))), bool)
    try:
        check_joint(scene, values)
    except InputError:
        return found
    moved = {name: column for name, column in columns.items() if any(x != column[0] for x in column)}
    values["balls"] = float(scene.balls)
    read = {key for keys, _ in _CHECKS if not moved.keys().isdisjoint(keys) for key in keys} | moved.keys()
    values = {name: value for name, value in values.items() if name in read}
    for k in range(found.size):
        values.update((name, column[k]) for name, column in moved.items())
        # Without a length here, formulas for stiffness or for load sharing may have no value.
        if any(values[name] == 0.0 for name in moved if name == "offset" or name.startswith("clearance_")):
            continue
        with contextlib.suppress(InputError):
            check_geometry(values, moved=moved)
            found[k] = False
    return found


def check_geometry(
    values: Mapping[str, float], where: str = "scene 'joint'", moved: Collection[str] | None = None
) -> None:
    """Refuse dimensions (SI and radians, concrete numbers) that do not make a joint.

    Read are the keys of ``_RANGES`` and of ``_CHECKS`` and any that begins with ``clearance_``; missing ones skip the checks that
    need them. ``moved``: keys in which they differ from dimensions that passed: what reads none of them passes again.

    Raises:
        InputError: as ``check_joint``.
    """
    given = {key: float(value) for key, value in values.items() if key in _RANGES or key.startswith("clearance_")}
    # Ranges first: no check sees a value that is no length or no angle.
    for key, value in given.items():
        if (moved is None or key in moved) and (fault := _in_range(key, value)):
            raise InputError(f"{where} {fault.key}", fault.found, fault.remedy)
    for keys, check in _CHECKS:
        again = moved is None or any(key in moved for key in keys)
        if not (again and all(key in given for key in keys)):
            continue
        arguments = [given[key] for key in keys]
        if fault := check(*arguments):
            best = _largest(check, arguments) if keys[-1] == "joint_angle" else None
            less = "" if best is None else f", or a joint_angle of at most {shown(best, 'rad')}"
            raise InputError(f"{where} {fault.key}", fault.found, fault.remedy + less)
