"""Options of the scene ``joint``, in groups. Every field has the name of its key in [scene] of a scene file.

What an option takes out is not in the program.
"""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from bcfj_jax.core.errors import InputError, nearest

Made = TypeVar("Made", bound=Callable[..., Any])


@dataclass(frozen=True)
class JointGeometry:
    """Bodies and tracks.

    Args:
        track: one of gothic, circular: two flanks at the contact angle, or one, of the ball's radius and clearance.
        spin: true lets the balls turn, and so roll; false makes each a particle at its centre. By default true where
            friction turns them, but not where it keeps a state (memory, frictional_lag, lugre): they then roll and slip
            by turns, in many times the steps.
        unequal: true gives each ball an oversize of its radius and each of its contacts an extra clearance, by default
            0: ball_2.oversize, seat_ball_2.extra_clearance and so on.
        head: one of free, fixed: at the centre; it turns about its own axis either way.
        balls: 3 or more, each in a track of its own.
    """

    track: str = "gothic"
    spin: bool | None = None
    unequal: bool = False
    head: str = "free"
    balls: int = 6


@dataclass(frozen=True)
class JointCage:
    """How the cage is held.

    Args:
        cage: one of free, fixed: to the bisecting plane, turning with the drive.
        window_ends: true gives a free cage's windows ends: the contact cage_window_end of every ball, and the cage's
            azimuth as a state. By default true where contacts are not listed. Without, friction lets the cage slip
            through its own windows.
        bands: true lets the cage's pilots, seat_cage and head_cage, bear up to the latitude pilot_band alone, where a cage
            ends, and on its edges; false makes them full spheres. By default true unless they have bristles (lugre), which
            a band has not.
    """

    cage: str = "free"
    window_ends: bool | None = None
    bands: bool | None = None


@dataclass(frozen=True)
class JointMaterials:
    """Contacts and their laws.

    Args:
        law, elastic, smoothing: as ``impact``, for every contact. A law stated by restitution takes the parameter
            ``approach_speed`` for all impacts, as the paper does.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
        laws, frictions: other normal-force and friction laws for single contacts, by name.
        elastics: other elastic parts for single contacts, by name, such as seat_cage = "liu_sphere". The radii of one
            that reads them are the joint's own, so that clearance moves it.
        stiffness: one of given, geometry. given: a parameter. geometry: of Hertz contacts of the joint's own radii,
            conformity and clearances, and of effective_modulus.
        stiffnesses: as stiffness for single contacts, by name, such as seat_cage = "geometry".
        contacts: those there are; by default all, but seat_cage and cage_window_end where the cage is fixed. Balls need
            both of theirs.
    """

    law: str = "memory_free"
    elastic: str | None = None
    smoothing: bool = True
    friction: bool | str = True
    laws: Mapping[str, str] | None = None
    frictions: Mapping[str, bool | str] | None = None
    elastics: Mapping[str, str] | None = None
    stiffness: str = "given"
    stiffnesses: Mapping[str, str] | None = None
    contacts: Sequence[str] | None = None


@dataclass(frozen=True)
class JointDrive:
    """What turns the seat.

    Args:
        drive: one of prescribed, flexible: adds seat_inertia, drive_stiffness and drive_damping.
        drive_profile: one of constant, smooth, step, linear, table. The speed rises from start_speed, 0 by default, to
            drive_speed over drive_ramp; step is the ADAMS STEP.
        drive_table: [[times], [speeds]] of the profile table, or a CSV file with two columns; drive_speed scales it.
    """

    drive: str = "prescribed"
    drive_profile: str = "constant"
    drive_table: list[list[Any]] | str | None = None


@dataclass(frozen=True)
class JointLoads:
    """What the head bears.

    Args:
        load_profile: one of smooth, step, linear, table. How the torque rises over load_ramp.
        load_table: [[times], [torques]] of the profile table, or a CSV file; load_torque scales it.
        axial_profile: one of constant, smooth, step, linear, table. The axial load, there from the start or raised over
            axial_ramp.
        axial_table: [[times], [forces]] of the profile table, or a CSV file; axial_load scales it.
        fluctuating: of torque, axial. Which loads swing about their size, by load_amplitude at load_frequency, and by
            axial_amplitude at axial_frequency.
        torque_reversal: true lets the torque change its sign, from reversal_time on, over reversal_ramp.
        stick_slip: true lets the torque fall with the head's speed as a bit's does: joint.programmes.falling.
    """

    load_profile: str = "smooth"
    load_table: list[list[Any]] | str | None = None
    axial_profile: str = "constant"
    axial_table: list[list[Any]] | str | None = None
    fluctuating: Sequence[str] | None = None
    torque_reversal: bool = False
    stick_slip: bool = False


@dataclass(frozen=True)
class JointOptions:
    """All options of a joint.

    Args:
        fidelity: one of kinematic, quasistatic, dynamic, auto. kinematic: closed-form load sharing. quasistatic:
            equilibrium at each instant, without friction. dynamic: motion. auto: the cheapest that keeps the accuracy
            asked for, and motion of the last pitch repeated where it repeats itself. A scene file that gives none:
            dynamic, and at the level fast auto.
    """

    materials: JointMaterials = field(default_factory=JointMaterials)
    geometry: JointGeometry = field(default_factory=JointGeometry)
    cage: JointCage = field(default_factory=JointCage)
    drive: JointDrive = field(default_factory=JointDrive)
    loads: JointLoads = field(default_factory=JointLoads)
    fidelity: str = "dynamic"


GROUPS: dict[str, type] = {
    "materials": JointMaterials, "geometry": JointGeometry, "cage": JointCage, "drive": JointDrive, "loads": JointLoads,
}  # fmt: skip
# By the key of a scene file the group that has it; of fidelity, which is in none, "".
PLACES = {key.name: name for name, group in GROUPS.items() for key in dataclasses.fields(group)} | {"fidelity": ""}


def with_keys(options: JointOptions, given: Mapping[str, Any], where: str) -> JointOptions:
    """Options with those that keys of a scene file give; InputError for a key that does not exist."""
    for key, value in given.items():
        if key not in PLACES:
            raise InputError(where, f"no option '{key}' = {value}", nearest(key, PLACES))
        if group := PLACES[key]:
            value, key = dataclasses.replace(getattr(options, group), **{key: value}), group
        options = dataclasses.replace(options, **{key: value})
    return options


def instead(given: Mapping[str, Any]) -> str:
    """What to write in place of single options as keywords."""
    parts = []
    for group, kind in GROUPS.items():
        fields = [f"{key}=..." for key in given if PLACES[key] == group]
        parts += [f"{group}=bj.scenes.{kind.__name__}({', '.join(fields)})"] if fields else []
    return f"options are in groups; give {', '.join(parts)}"


def keyed(options: type) -> Callable[[Made], Made]:
    """Give a function of keywords the signature and the words of the keys of a scene file: fields of options and groups."""
    hints = typing.get_type_hints(options)
    fields, words = [], [(inspect.getdoc(options) or "").partition("\nArgs:\n")[2]]
    for one in dataclasses.fields(options):
        group = hints[one.name]
        if group in GROUPS.values():
            types = typing.get_type_hints(group)
            fields += [(key.name, key.default, types[key.name]) for key in dataclasses.fields(group)]
            words.append((inspect.getdoc(group) or "").partition("\nArgs:\n")[2])
        else:
            fields.append((one.name, one.default, group))
    kind = inspect.Parameter.KEYWORD_ONLY
    parameters = [inspect.Parameter(name, kind, default=default, annotation=of) for name, default, of in fields]

    def decorated(function: Made) -> Made:
        function.__signature__ = inspect.Signature(parameters)
        function.__annotations__ = {one.name: one.annotation for one in parameters}
        function.__doc__ = f"{function.__doc__}\n\nArgs:\n" + "\n".join(words)
        return function

    return decorated
