"""Drive and loads of the joint over time: which programmes there are, their parameters, and what they are at an instant.

| option | what it switches in | parameters |
|---|---|---|
| drive_profile | a speed that rises from ``start_speed`` (0: from rest) to ``drive_speed`` | start_speed, drive_ramp |
| load_profile, axial_profile | the shape in which torque and axial load rise | load_ramp, axial_ramp |
| a profile "table" | values over time; drive_speed, load_torque, axial_load is the greatest of them, and scales them | |
| fluctuating | torque, axial load or both swing about their size | load_amplitude, load_frequency; axial_... |
| torque_reversal | the torque changes its sign | reversal_time, reversal_ramp |
| stick_slip | the torque falls with the head's speed, as a bit's does (``falling``) | stick_ratio, stick_speed, stick_width |

Without any the torque rises smoothly, axial load and speed are constant, and nothing of this is compiled.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.quantities import CATALOGUE
from bcfj_jax.core.upward import upward
from bcfj_jax.mechanism.bodies import Drive
from bcfj_jax.mechanism.model import Params
from bcfj_jax.mechanism.programmes import SHAPES, Programme, Table, checked_table
from bcfj_jax.models.joint.options import JointDrive, JointLoads

# A torque that rises over ``load_ramp``, C2.
RISE = Programme("load_torque", "load_ramp")
_RISES = (*SHAPES, "table")
PROFILES = {"drive_profile": ("constant", *_RISES), "load_profile": _RISES, "axial_profile": ("constant", *_RISES)}
FLUCTUATING = ("torque", "axial")
_STICK_SLIP = ("stick_ratio", "stick_speed", "stick_width")


class Programmes(eqx.Module):
    """What is not constant."""

    # torque, axial, drive: over time; None for a constant axial load, and for a constant speed.
    torque: Programme = RISE
    axial: Programme | None = None
    drive: Drive | None = None
    stick_slip: bool = eqx.field(static=True, default=False)  # whether the torque falls with the head's speed
    # By the parameter that scales a table, the greatest of its values, which is the parameter's default.
    greatest: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())

    @property
    def usual(self) -> bool:
        """Whether nothing but the torque's usual rise is over time."""
        return self == Programmes()

    @property
    def lasting(self) -> bool:
        """Whether the load never comes to rest, so that motion need not repeat."""
        return self.stick_slip or any(x is not None and x.amplitude is not None for x in (self.torque, self.axial))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters beside drive_speed, load_torque and axial_load, which every joint has."""
        parts = [part for part in (self.torque, self.axial) if part is not None and part.table is None]
        found: list[Any] = [
            name for x in parts for name in (x.ramp, x.amplitude, x.frequency, x.reversal, x.reversal_ramp)
        ]
        if self.drive is not None and self.drive.kind == "ramp":
            found += [self.drive.first, self.drive.over]
        return (*(name for name in found if name is not None), *(_STICK_SLIP if self.stick_slip else ()))

    def start_speed(self, p: Params) -> Array:
        """Speed of the seat at time 0 [rad/s]."""
        return p["drive_speed"] if self.drive is None else jnp.asarray(self.drive.motion(jnp.zeros(()), "seat", p)[1])

    def risen(self, p: Params) -> float:
        """When drive and loads have come to what they stay at, or swing about [s]: after their last kink."""
        kinks = [x for part in (self.torque, self.axial, self.drive) if part for x in part.kinks("", p) or ()]
        return max((float(np.max(x)) for x in kinks), default=0.0)

    def largest_torque(self, p: Params, end: ArrayLike) -> Array:
        """Greatest size of the torque until ``end`` [N m]."""
        part, size = self.torque, jnp.abs(p["load_torque"])
        if part.table is not None:
            return size
        size = size + (0.0 if part.amplitude is None else jnp.abs(p["load_amplitude"]))
        size = size * SHAPES[part.shape](end / p["load_ramp"])
        return size * jnp.maximum(1.0, p["stick_ratio"]) if self.stick_slip else size

    def largest_axial(self, p: Params) -> Array:
        """Greatest size of the axial load [N]."""
        size = jnp.abs(p["axial_load"])
        swings = self.axial is not None and self.axial.amplitude is not None
        return size + jnp.abs(p["axial_amplitude"]) if swings else size


def falling(speed: Array, p: Params) -> Array:
    """Share of the torque that a bit takes at a speed w of the head in the drive's sense [rad/s]; 1 where it is fast.

    tanh(w/stick_width) (1 + (stick_ratio - 1)/(1 + (w/stick_speed)^2))
    """
    peak = (p["stick_ratio"] - 1.0) / (1.0 + (speed / p["stick_speed"]) ** 2)
    return jnp.tanh(speed / p["stick_width"]) * (1.0 + peak)


def torque_at(programmes: Programmes, t: Array, head_spin: Array, p: Params) -> Array:
    """Resisting torque on the head [N m] at a time, and at a speed where the bit sticks and slips."""
    torque = programmes.torque(t, "load_torque", p)
    if not programmes.stick_slip:
        return torque
    return torque * falling(head_spin * jnp.sign(p["drive_speed"]), p)


def axial_at(programmes: Programmes, t: Array, p: Params) -> Array:
    """Axial load on the head [N] at a time."""
    return p["axial_load"] if programmes.axial is None else programmes.axial(t, "axial_load", p)


def drive_at(programmes: Programmes, t: Array, p: Params) -> tuple[Array, Array, Array]:
    """Turn [rad], speed and its rate of a drive over time."""
    assert programmes.drive is not None
    return programmes.drive.motion(t, "seat", p)


def made(where: str, drive: JointDrive, loads: JointLoads) -> Programmes:
    """Programmes from options; InputError for what is not known, and what does not go together."""
    groups = {"drive": (drive, "drive_speed"), "load": (loads, "load_torque"), "axial": (loads, "axial_load")}
    found = {load: _table(where, load, *of) for load, of in groups.items()}
    tables = {load: table for load, (table, _) in found.items()}
    greatest = {groups[load][1]: top for load, (_, top) in found.items() if top is not None}
    swings = [loads.fluctuating] if isinstance(loads.fluctuating, str) else list(loads.fluctuating or ())
    for name in swings:
        if name not in FLUCTUATING:
            raise InputError(f"{where} fluctuating", f"no load {quoted(name)}", nearest(str(name), FLUCTUATING))
    if tables["load"] and ("torque" in swings or loads.torque_reversal):
        raise InputError(f"{where} load_profile", "a table that fluctuates or reverses", "put that into the table")
    if tables["axial"] and "axial" in swings:
        raise InputError(f"{where} axial_profile", "a table that fluctuates", "put that into the table")
    swing = ("load_amplitude", "load_frequency") if "torque" in swings else (None, None)
    back = ("reversal_time", "reversal_ramp") if loads.torque_reversal else (None, None)
    torque = Programme("load_torque", "load_ramp", loads.load_profile, None, *swing, *back)
    if tables["load"]:
        torque = Programme("load_torque", table=tables["load"])
    axial = motion = None
    if tables["axial"]:
        axial = Programme("axial_load", table=tables["axial"])
    elif loads.axial_profile != "constant" or "axial" in swings:
        ramp, shape = ("axial_ramp", loads.axial_profile) if loads.axial_profile != "constant" else (None, "smooth")
        swing = ("axial_amplitude", "axial_frequency") if "axial" in swings else ()
        axial = Programme("axial_load", ramp, shape, None, *swing)
    if tables["drive"]:
        motion = Drive("speeds", speed="drive_speed", table=tables["drive"])
    elif drive.drive_profile != "constant":
        motion = Drive("ramp", speed="drive_speed", over="drive_ramp", shape=drive.drive_profile, first="start_speed")
    return Programmes(torque, axial, motion, bool(loads.stick_slip), tuple(sorted(greatest.items())))


def _table(where: str, load: str, group: JointDrive | JointLoads, scaled: str) -> tuple[Table | None, float | None]:
    """A profile's table as shares of its greatest value, and that value with its sign; None, None for another profile."""
    name, key = f"{load}_profile", f"{load}_table"
    profile, table = getattr(group, name), getattr(group, key)
    if profile not in PROFILES[name]:
        raise InputError(f"{where} {name}", f"no profile {quoted(profile)}", nearest(str(profile), PROFILES[name]))
    if profile != "table":
        if table is None:
            return None, None
        found = f"a table beside {name} = '{profile}'"
        raise InputError(f"{where} {key}", found, f"say {name} = 'table', or leave the table out")
    if table is None:
        raise InputError(f"{where} {key}", "is missing", "give [[times], [values]], or the name of a CSV file")
    if isinstance(table, str):
        table = upward("programme")(table, CATALOGUE[scaled].unit, f"{where} {key}")
    times, given = checked_table(f"{where} {key}", table)
    values = np.asarray(given)
    top = float(values[np.argmax(np.abs(values))])
    return (times, tuple((values / top).tolist() if top else values.tolist())), top
