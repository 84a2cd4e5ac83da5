"""The keys that tables of a mechanism's file may hold, and the units of a load's numbers (``mechanismfile``).

Numbers are ``Any``: an SI number, a text with a unit, or the name of a quantity.
"""

from __future__ import annotations

from typing import Any

import pydantic

from bcfj_jax.core import limits
from bcfj_jax.io import tables
from bcfj_jax.mechanism.bodies import GROUND


class SceneTable(tables.Table):
    """[scene] of a mechanism."""

    kind: str
    law: str | None = None
    elastic: str | None = None
    friction: bool | str = False
    smoothing: bool = True


class DriveTable(tables.Table):
    """A body's drive, or that of a spring on a joint."""

    kind: str = "constant"
    speed: Any = None
    over: Any = None
    start: Any = None
    first: Any = None
    shape: str | None = None
    table: list[list[Any]] | None = None


class BodyTable(tables.Table):
    """[[body]]."""

    name: str
    joint: str = "free"
    parent: Any = GROUND
    at: list[Any] = [0, 0, 0]
    axis: str | list[float | int] = "z"
    tilt: list[Any] | None = None
    center: list[Any] = [0, 0, 0]
    mass: Any = None
    inertia: Any = None
    start: dict[str, Any] = {}
    drive: DriveTable | None = None
    members: int = pydantic.Field(default=0, ge=0, le=limits.MEMBERS)


class ContactTable(tables.Table):
    """[[contact]]."""

    name: str
    between: list[str]
    gap: str | dict[str, Any]
    at: list[list[Any]] = [[0, 0, 0], [0, 0, 0]]
    law: str | None = None
    elastic: str | None = None
    friction: bool | str | None = None
    smoothing: bool | None = None
    approach: str = "memory"
    values: dict[str, Any] = {}


class QuantityTable(tables.Table):
    """[quantity.NAME]."""

    unit: str
    lower: Any = None
    upper: Any = None
    default: Any = None
    meaning: str = ""


class ReadTable(tables.Table):
    """[[read]]."""

    of: str
    frame: str | None = None


class GravityTable(tables.Table):
    """[[load]] of kind "gravity"."""

    kind: str
    name: str = "gravity"
    direction: str | list[float | int] = "-y"


class ForceTable(tables.Table):
    """[[load]] of kind "force"."""

    kind: str
    name: str
    body: str
    direction: str | list[float | int] = "x"
    size: Any = None
    at: list[Any] = [0, 0, 0]
    ramp: Any = None
    table: list[list[Any]] | str | None = None
    follows: bool = False
    shape: str = "smooth"
    amplitude: Any = None
    frequency: Any = None
    reversal: Any = None
    reversal_ramp: Any = None


class TorqueTable(ForceTable):
    """[[load]] of kind "torque"."""

    against: str = GROUND


class SpringTable(tables.Table):
    """[[load]] of kind "spring"."""

    kind: str
    name: str
    between: list[str]
    at: list[list[Any]] = [[0, 0, 0], [0, 0, 0]]
    stiffness: Any = 0
    damping: Any = 0
    free_length: Any = 0


class BushTable(tables.Table):
    """[[load]] of kind "bush"."""

    kind: str
    name: str
    between: list[str]
    at: list[list[Any]] = [[0, 0, 0], [0, 0, 0]]
    stiffness: Any = 1e7
    damping: Any = 0
    turning_damping: Any = 0


class JointSpringTable(tables.Table):
    """[[load]] of kind "joint_spring"."""

    kind: str
    name: str
    body: str
    stiffness: Any = 0
    damping: Any = 0
    rest: Any = 0
    drive: DriveTable | None = None


class OwnTable(tables.Table):
    """[[load]] of a kind of the user's own."""

    kind: str
    name: str
    bodies: list[str] = []


LOAD_TABLES: dict[str, type[tables.Table]] = {
    "gravity": GravityTable,
    "force": ForceTable,
    "torque": TorqueTable,
    "spring": SpringTable,
    "bush": BushTable,
    "joint_spring": JointSpringTable,
}


def load_units(kind: str, turns: bool) -> dict[str, str]:
    """Units of a load's numbers; ``turns``: whether a joint's coordinate is an angle."""
    if kind in ("force", "torque"):
        unit = "N" if kind == "force" else "N m"
        times = {"ramp": "s", "reversal": "s", "reversal_ramp": "s"}
        return {"size": unit, "amplitude": unit, "frequency": "Hz", **times}
    if kind == "spring":
        return {"stiffness": "N/m", "damping": "N s/m", "free_length": "m"}
    if kind == "bush":
        return {"stiffness": "N/m", "damping": "N s/m", "turning_damping": "N m s/rad"}
    if kind == "joint_spring" and turns:
        return {"stiffness": "N m/rad", "damping": "N m s/rad", "rest": "rad"}
    return {"stiffness": "N/m", "damping": "N s/m", "rest": "m"} if kind == "joint_spring" else {}
