"""The keys that tables of a mechanism's file may hold, and the units of their numbers (``mechanismfile``).

Numbers are ``Any``: an SI number, a text with a unit, or the name of a quantity. A field's unit stands in its metadata.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import pydantic

from bcfj_jax.core import limits
from bcfj_jax.io import tables
from bcfj_jax.mechanism.bodies import GROUND


class In(NamedTuple):
    """Unit of a field; ``shape`` of its list: () for a number, (3,) for a place, (2, 3) for a place on either body."""

    unit: str
    shape: tuple[int, ...] = ()


Place = Annotated[list[Any], In("m", (3,))]
Places = Annotated[list[list[Any]], In("m", (2, 3))]
Length = Annotated[Any, In("m")]
Speed = Annotated[Any, In("m/s")]
Time = Annotated[Any, In("s")]
Force = Annotated[Any, In("N")]
Torque = Annotated[Any, In("N m")]
Stiffness = Annotated[Any, In("N/m")]
Damping = Annotated[Any, In("N s/m")]
# What stands in place of these units where a joint turns.
TURNED = {"m": "rad", "m/s": "rad/s", "N/m": "N m/rad", "N": "N m", "N s/m": "N m s/rad"}


class SceneTable(tables.Table):
    """[scene] of a mechanism."""

    kind: str
    law: str | None = None
    elastic: str | None = None
    friction: bool | str = False
    smoothing: bool = True
    start: str = ""


class DriveTable(tables.Table):
    """A body's drive, or that of a spring on a joint."""

    kind: str = "constant"
    speed: Speed = None
    over: Time = None
    start: Length = None
    first: Speed = None
    shape: str | None = None
    table: list[list[Any]] | None = None


class BodyTable(tables.Table):
    """[[body]]."""

    name: str
    joint: str = "free"
    parent: Any = GROUND
    at: Place = [0, 0, 0]
    axis: str | list[float | int] = "z"
    tilt: list[Any] | None = None
    center: Place = [0, 0, 0]
    mass: Annotated[Any, In("kg")] = None
    inertia: Annotated[Any, In("kg m^2", (3,))] = None
    start: dict[str, Any] = {}
    drive: DriveTable | None = None
    members: int = pydantic.Field(default=0, ge=0, le=limits.MEMBERS)


class ContactTable(tables.Table):
    """[[contact]]."""

    name: str
    between: list[str]
    gap: str | dict[str, Any]
    at: Places = [[0, 0, 0], [0, 0, 0]]
    law: str | None = None
    elastic: str | None = None
    friction: bool | str | None = None
    smoothing: bool | None = None
    approach: str = "memory"
    rolling: bool = False
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


class OwnTable(tables.Table):
    """[[load]] of a kind of the user's own."""

    kind: str
    name: str
    bodies: list[str] = []


def _load(kind: str, **fields: Any) -> type[tables.Table]:
    """[[load]] of a kind; of each key its type and its default, ``...`` for none."""
    return pydantic.create_model(f"{kind} load", __base__=tables.Table, kind=(str, ...), **fields)


_NAMED: dict[str, Any] = {"name": (str, ...)}
_BETWEEN: dict[str, Any] = {"between": (list[str], ...), "at": (Places, [[0, 0, 0], [0, 0, 0]])}
_FORCE: dict[str, Any] = _NAMED | {
    "body": (str, ...), "direction": (str | list[float | int], "x"), "size": (Force, None), "at": (Place, [0, 0, 0]),
    "ramp": (Time, None), "table": (list[list[Any]] | str | None, None), "follows": (bool, False), "shape": (str, "smooth"),
    "amplitude": (Force, None), "frequency": (Annotated[Any, In("Hz")], None), "reversal": (Time, None),
    "reversal_ramp": (Time, None),
}  # fmt: skip
_TORQUE: dict[str, Any] = _FORCE | {"size": (Torque, None), "amplitude": (Torque, None), "against": (str, GROUND)}
_BUSH: dict[str, Any] = {
    key: (Annotated[Any, In(unit, (3,))], default)
    for key, unit, default in (("stiffness", "N/m", 1e7), ("damping", "N s/m", 0), ("turning_damping", "N m s/rad", 0),
                               ("turning_stiffness", "N m/rad", 0))
}  # fmt: skip
_SPRING: dict[str, Any] = {
    "stiffness": (Stiffness, 0), "damping": (Damping, 0), "table": (list[list[Any]] | None, None), "side": (str, "both"),
}  # fmt: skip
LOAD_TABLES = {
    "gravity": _load("gravity", name=(str, "gravity"), direction=(str | list[float | int], "-y")),
    "force": _load("force", **_FORCE),
    "torque": _load("torque", **_TORQUE),
    "spring": _load("spring", **_NAMED, **_BETWEEN, **_SPRING, free_length=(Length, 0)),
    "bush": _load("bush", **_NAMED, **_BETWEEN, **_BUSH),
    "joint_spring": _load(
        "joint_spring", **_NAMED, body=(str, ...), **_SPRING, rest=(Length, 0), drive=(DriveTable | None, None)
    ),
    "joint_friction": _load(
        "joint_friction",
        **_NAMED,
        body=(str, ...),
        sliding=(Force, ...),
        speed=(Speed, ...),
        breakaway=(Force, None),
        friction=(str, "coulomb"),
        bristle_stiffness=(Stiffness, None),
        bristle_damping=(Damping, None),
    ),
    "coupling": _load(
        "coupling",
        **_NAMED,
        joints=(list[str], ...),
        ratio=(Any, ...),
        stiffness=(Any, ...),
        damping=(Any, 0),
        backlash=(Any, 0),
        rest=(Any, 0),
    ),
}
