"""What cannot be built, said before anything runs: the dimensions of a joint against each other.

Every check is a necessary condition: what it refuses does not assemble, does not reach or does not swing. Each
needs certain keys and is skipped where one is missing. Ball centres are those without clearance, at the given
deflection, over a whole revolution. The formulas are those of ``joint.geometry``, in plain numbers: a refusal
costs no compilation.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import deflection
from bcfj_jax.models.joint.deflection import Fault, shown
from bcfj_jax.models.joint.scene import GROOVES, PILOTS, Joint


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
_PLAY = _Range(0.0, math.inf, True, "m", "give a clearance >= 0: parts that overlap cannot be assembled")
_RANGES = {
    **dict.fromkeys(("seat_radius", "head_radius", "ball_radius", "pitch_radius"), _LENGTH),
    "offset": _Range(-math.inf, math.inf, False, "m", "give a finite length"),
    "clearance_cage_ball": _PLAY._replace(remedy="give a clearance >= 0: a ball does not fit into a smaller window"),
    "contact_angle": _Range(0.0, 0.5 * math.pi, False, "rad", "give an angle above 0 and below 90 deg"),
    "conformity": _Range(0.5, math.inf, False, "", "give a ratio > 0.5: a groove is wider than the ball"),
    "pilot_band": _Range(0.0, 0.5 * math.pi, False, "rad", "give an angle above 0 and below 90 deg"),
    "joint_angle": _Range(0.0, 0.5 * math.pi, True, "rad", "give 0 or more and less than 90 deg"),
    "balls": _Range(1.0, math.inf, True, "", "give a whole number >= 1"),
}


def _in_range(key: str, value: float) -> Fault | None:
    """Each value by itself; every clearance, whatever it is called, must not be negative."""
    limits = _RANGES.get(key, _PLAY if key.startswith("clearance_") else None)
    if limits is None or (limits.holds(value) and (key != "balls" or value == int(value))):
        return None
    return Fault(key, f"{shown(value, limits.unit)} is out of range", limits.remedy)


def _enclosed(seat_radius: float, head_radius: float) -> Fault | None:
    """The seat's hollow sphere surrounds the head."""
    if seat_radius > head_radius:
        return None
    found = f"{shown(seat_radius)} does not enclose the head, head_radius = {shown(head_radius)}"
    return Fault("seat_radius", found, "give a seat larger than the head, with the cage between them")


def _cage_wall(seat_radius: float, head_radius: float, outside: float, inside: float) -> Fault | None:
    """The cage fills what the seat, the head and the two clearances leave; that must be a wall."""
    wall = (seat_radius - outside) - (head_radius + inside)
    if wall > 0.0:
        return None
    found = f"{shown(outside)} and clearance_head_cage = {shown(inside)} leave the cage a wall of {shown(wall)}"
    return Fault("clearance_seat_cage", found, "give smaller clearances, a larger seat_radius or a smaller head_radius")


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
    return Fault("pilot_band", found, f"give more than {shown(math.asin(min(need, 1.0)), 'rad')}")


_BALL = ("ball_radius", "pitch_radius", "offset", "joint_angle")
# The keys a check needs, in the order of its arguments, and the check: the plainest fault is found first.
_CHECKS: tuple[tuple[tuple[str, ...], Callable[..., Fault | None]], ...] = (
    (("seat_radius", "head_radius"), _enclosed),
    (("seat_radius", "head_radius", "clearance_seat_cage", "clearance_head_cage"), _cage_wall),
    (("seat_radius", "head_radius", "ball_radius"), _bridges),
    (("seat_radius", *_BALL), deflection.reaches_seat),
    (("head_radius", *_BALL), deflection.reaches_head),
    (("seat_radius", "clearance_seat_cage", *_BALL), deflection.on_window),
    (("pilot_band", "seat_radius", "clearance_cage_ball", "ball_radius"), _beside_windows),
    (("balls", *_BALL), deflection.apart),
    (("seat_radius", "ball_radius", "pitch_radius", "offset", "contact_angle", "joint_angle"), deflection.mouth_open),
    (("seat_radius", "pitch_radius", "offset", "joint_angle"), deflection.centres_in_mouth),
    (("seat_radius", "clearance_cage_window_end", "balls", "ball_radius"), deflection.webs),
    (("clearance_cage_window_end", "balls", *_BALL), deflection.swings),
)


def _single(value: Any) -> bool:
    """Whether a value is one number. NaN is none: a run with it fails and says so."""
    return not is_traced(value) and np.ndim(value) == 0 and not np.isnan(value)


def check_joint(scene: Joint, params: Params, where: str = "scene 'joint'") -> None:
    """Refuse a joint that does not assemble, or that its fidelity has no answer for.

    Args:
        scene: the joint.
        params: its parameters, SI. Those that are batched or traced are not looked at.
        where: what the message begins with.

    Raises:
        InputError: naming the key, its value and what would be right.
    """
    for contact in scene.contacts:
        for name in contact.own:
            # Of a law of the user's own: every other coefficient has a default.
            if name not in params and f"{contact.name}.{name}" not in params:
                found = f"the parameter '{name}' has no value; it is read by {contact.name}"
                raise InputError(where, found, f"give {name}, or {contact.name}.{name}")
    values = {name: float(value) for name, value in params.items() if _single(value)}
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
    """Which of N joints ``check_joint`` must look at one by one, (N,): it finds no fault with the others.

    Only checks that read what differs among them are made again for each.

    Args:
        scene: the joint.
        params: leaves (N,).
    """
    columns = {name: np.asarray(leaf).tolist() for name, leaf in params.items()}
    values = {name: column[0] for name, column in columns.items()}
    found = np.ones(len(next(iter(columns.values()))), bool)
    try:
        check_joint(scene, values)  # pyright: ignore[reportArgumentType]
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
    """Refuse dimensions that do not make a joint.

    Args:
        values: keys of the joint, SI and radians, concrete numbers. Read are the keys of ``_RANGES`` and of
            ``_CHECKS`` and any that begins with ``clearance_``; others are left alone, and missing ones skip
            the checks that need them.
        where: what the message begins with; the key follows it.
        moved: keys in which they differ from dimensions that passed: what reads none of them passes again.

    Raises:
        InputError: naming the key, its value and what would be right.
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
            best = deflection.largest(check, arguments) if keys[-1] == "joint_angle" else None
            less = "" if best is None else f", or a joint_angle of at most {shown(best, 'rad')}"
            raise InputError(f"{where} {fault.key}", fault.found, fault.remedy + less)
