"""Readings by name: what an instrument on a contact or on a body would show.

    <contact>.normal | axial | tangential        force in the contact's own frame [N]
    <contact>.penetration | rate | slip          [m], [m/s], [m/s]
    <contact>.wear_rate | pressure | load_share  what wear, greatest Hertz pressure and life are taken of (``materials``)
    <contact>.side                               on which side a contact that pushes both ways pushes: 1, -1, or 0
    <contact>.force.x | y | z                    whole force on the second body, world axes [N]
    <body>.place | velocity | acceleration.x|y|z of the centre of mass, world axes [m, m/s, m/s^2]
    <body>.spin | spin_rate.x|y|z                [rad/s, rad/s^2], world axes
    <body>.attitude.q0|q1|q2|q3                  the body's axes in the world, a unit quaternion, scalar first and not negative
    <body>.angle                                 [rad], of a body with one axis
    <body>.torque | drive | power                what its drive exerts [N m or N], and its power [W]
    <body>.reaction | moment.x|y|z               what its joint does to it [N]; about the body's origin [N m]; world axes
    <load>.force | moment.x|y|z                  on its body, world axes [N]; about the point it acts at [N m]
    <load>.pull | length                         between two points: towards each other [N]; their distance [m]
    <load>.torque | drive                        of a load on a joint's coordinate [N m or N]
    <load>.power                                 [W]
    <body>.position | velocity | speed | x | ... coordinates of its joint and their rates, as in a body's start

"door.reaction.x in joint" is in the axes of the joint: its parent's, turned by its tilt. A joint's reaction is all that goes
through it, its drive and the loads on its coordinate among them. Of a part with members "seat_ball_2" is the second. A
vector can be resolved in the axes of a body, as in "journal.force.x in rod": the same force looks constant in one frame and
turns once a revolution in another. Every reading is a pure function of the state: it can be plotted, differentiated, made a
feature and fitted to.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.numerics import power
from bcfj_jax.core.rotations import quaternion
from bcfj_jax.mechanism import materials
from bcfj_jax.mechanism.bodies import QUATERNION, RATES, SPINS
from bcfj_jax.mechanism.bodies import unit_of as unit_of_start
from bcfj_jax.mechanism.model import AbstractModel, BodyMotion, Effort, Params, Reading

_OWN = {"normal": 0, "axial": 1, "tangential": 2}
_SCALARS = {"penetration": "m", "rate": "m/s", "slip": "m/s", "side": "1"}
# Of the materials of a contact; and the features that are of them, by kind.
_OF_LIFE = {"wear_rate": "m^3/s", "pressure": "Pa", "load_share": "1"}
READ_BY = {"wear_volume": "wear_rate", "peak_pressure": "pressure", "rolling_life": "load_share"}
_VECTORS = {"place": "m", "velocity": "m/s", "acceleration": "m/s^2", "spin": "rad/s", "spin_rate": "rad/s^2"}
_DRIVEN = {"torque": "N m", "drive": "N"}
# What ``efforts`` have: vectors of joints, vectors of loads, numbers.
_REACTIONS, _LOADS = {"reaction": "N", "moment": "N m"}, {"force": "N", "moment": "N m"}
_EFFORTS = {"power": "W", "pull": "N", "length": "m"}
_BORNE = {*_REACTIONS, *_EFFORTS}
# In place of a body: the axes of the joint that a reaction is of.
JOINT = "joint"
ATTITUDE = "attitude"
# The names that a body's start has.
_JOINT = {key: unit_of_start(key) for key in (*RATES, *RATES.values(), *SPINS, *QUATERNION)}


class Channel(NamedTuple):
    """One reading: the part it is of, what of it, which component, in whose axes ("" is the world), of which member.

    A member counts from 1; 0 is all of them, or a part without members.
    """

    part: str
    what: str
    axis: str = ""
    frame: str = ""
    member: int = 0

    @property
    def name(self) -> str:
        """As users write it."""
        part = f"{self.part}_{self.member}" if self.member else self.part
        text = f"{part}.{self.what}" + (f".{self.axis}" if self.axis else "")
        return f"{text} in {self.frame}" if self.frame else text

    @property
    def unit(self) -> str:
        """SI."""
        return unit_of(self.name)


_PATTERN = re.compile(
    rf"\w+\.(?:{'|'.join([*_OWN, *_SCALARS, *_OF_LIFE, *_DRIVEN, *_JOINT, *_EFFORTS])}"
    rf"|(?:{'|'.join([*_VECTORS, *_REACTIONS, *_LOADS])})\.[xyz]"
    rf"|{ATTITUDE}\.q[0-3])(?: in \w+)?"
)


def is_reading(name: str) -> bool:
    """Whether a text is written as a reading, of whatever model."""
    return _PATTERN.fullmatch(name) is not None


def unit_of(name: str) -> str:
    """SI unit of a reading by its name, of whatever model."""
    return quantity_of(name)[1]


def quantity_of(name: str) -> tuple[str, str]:
    """What an axis calls a reading, and its SI unit, by its name: ("spin rate", "rad/s^2")."""
    what = name.partition(" in ")[0].split(".")[1] if "." in name else ""
    unit = {**_SCALARS, **_OF_LIFE, **_VECTORS, **_DRIVEN, **_JOINT, **_REACTIONS, **_EFFORTS, ATTITUDE: "1"}.get(what)
    return (what.replace("_", " "), unit) if unit else ("force", "N")


def channel(name: str, model: AbstractModel, frame: str = "", where: str = "reading") -> Channel:
    """A reading by name.

    Args:
        name: as in the module docstring; " in BODY" may follow.
        model: whose.
        frame: the body in whose axes a vector is resolved, beside the name.
        where: place, for the message.

    Raises:
        InputError: for a contact, a body or a quantity that is not there, with the nearest that is.
    """
    text, _, beside = name.partition(" in ")
    frame = beside.strip() or frame
    part, _, rest = text.strip().partition(".")
    what, _, axis = rest.partition(".")
    contacts, bodies, member = model.members, model.body_names, 0
    stem, _, number = part.rpartition("_")
    if part not in contacts and part not in bodies and stem in (*contacts, *bodies) and number.isdigit():
        count = {**model.body_members, **contacts}.get(stem, 0)
        if not 1 <= int(number) <= count:
            raise InputError(where, f"'{stem}' has no member {number}", f"it has {count}" if count else f"write {stem}")
        part, member = stem, int(number)
    if part in contacts:
        known = [*_OWN, *_SCALARS, *_OF_LIFE, *(f"force.{k}" for k in "xyz")]
    elif part in bodies:
        turned = [f"{ATTITUDE}.{q}" for q in QUATERNION]
        known = [*(f"{v}.{k}" for v in (*_VECTORS, *_REACTIONS) for k in "xyz"), *turned, *_DRIVEN, "power", *_JOINT]
    elif part in model.load_names:
        known = [*(f"{v}.{k}" for v in _LOADS for k in "xyz"), *_DRIVEN, *_EFFORTS]
    else:
        known = [*(n for c, k in contacts.items() for n in (c, *(f"{c}_{i + 1}" for i in range(k)))), *bodies]
        known += model.load_names
        raise InputError(where, f"no contact '{part}' and no body or load of that name", nearest(part, known))
    if rest not in known:
        raise InputError(where, f"'{part}' has no reading '{rest}'", nearest(rest, known))
    if frame and not axis:
        raise InputError(where, f"'{text}' has no components to resolve in '{frame}'", "leave the frame out")
    joint = frame == JOINT and part in bodies and what in _REACTIONS
    if frame and frame not in bodies and not joint:
        raise InputError(where, f"no body '{frame}' to resolve '{text}' in", nearest(frame, bodies))
    return Channel(part, what, axis, frame, member)


def shares(channels: Sequence[Channel], model: AbstractModel, params: Params) -> dict[str, Array]:
    """By reading what of materials it multiplies (``materials.share``); empty where none is of life."""
    return {c.name: materials.share(model, params, c.part, c.what) for c in channels if c.what in _OF_LIFE}


class Seen(NamedTuple):
    """What a model shows in one state: ``observe``, ``motions``, ``efforts``, as far as readings ask; and ``shares``."""

    contacts: Mapping[str, Reading]
    bodies: Mapping[str, BodyMotion] = {}
    shares: Mapping[str, Array] = {}
    efforts: Mapping[str, Effort] = {}


def looked(
    channels: Sequence[Channel], model: AbstractModel, contacts: Mapping[str, Reading], shares: Mapping[str, Array]
) -> Callable[[Array, Array, Any], dict[str, Array]]:
    """(t, y, prepared) -> values of readings, by what contacts show there."""
    moving, bearing = needs_bodies(channels, model), any(_bears(c, model) for c in channels)

    def values(t: Array, y: Array, prepared: Any) -> dict[str, Array]:
        bodies = model.motions(t, y, prepared) if moving else {}
        return read(channels, Seen(contacts, bodies, shares, model.efforts(t, y, prepared) if bearing else {}))

    return values


def read(channels: Sequence[Channel], seen: Seen) -> dict[str, Array]:
    """Values of readings, by name, (...,) or (..., k) over members."""
    return {c.name: _member(c, _value(c, seen)) for c in channels}


def _member(c: Channel, value: Array) -> Array:
    return value[..., c.member - 1] if c.member else value


def _value(c: Channel, seen: Seen) -> Array:
    contacts, bodies, shares, efforts = seen
    if c.part in efforts and (c.part not in bodies or c.what in _BORNE):
        return _borne(c, efforts[c.part], bodies)
    if c.part in contacts:
        found = contacts[c.part]
        if c.what in _OF_LIFE:
            size = jnp.abs(found.force[..., 0])
            if c.what == "wear_rate":
                return shares[c.name] * size * _there(c._replace(what="slip"), found.slip)
            if c.what == "pressure":
                share, exponent, least = shares[c.name]
                return jnp.maximum(share * power(size, exponent), least * size)
            return shares[c.name] * size
        if c.what in _OWN:
            return found.force[..., _OWN[c.what]]
        if c.what == "side":
            return jnp.sign(found.force[..., 0])
        return _component(c, found.world, bodies) if c.axis else _there(c, getattr(found, c.what))
    motion = bodies[c.part]
    if c.what in _DRIVEN:
        return _there(c, motion.drive)
    if c.what == ATTITUDE:
        return quaternion(_relative(c, _axes(c.part, motion), bodies))[..., QUATERNION.index(c.axis)]
    if c.axis:
        return _component(c, getattr(motion, c.what), bodies)
    if motion.joint and c.what in _JOINT and c.what not in motion.joint:
        raise InputError("reading", f"the joint of '{c.part}' has no {c.what}", nearest(c.what, motion.joint))
    return _there(c, motion.joint.get(c.what, motion.angle if c.what == "angle" else None))


def _borne(c: Channel, effort: Effort, bodies: Mapping[str, BodyMotion]) -> Array:
    """Of a joint or a load."""
    if not c.axis:
        return _there(c, effort.drive if c.what in _DRIVEN else getattr(effort, c.what))
    vector = _there(c, getattr(effort, c.what))
    if c.frame == JOINT and JOINT not in bodies:
        return jnp.sum(vector * _there(c, effort.axes)[..., :, "xyz".index(c.axis)], -1)
    return _component(c, vector, bodies)


def _there(c: Channel, value: Any) -> Array:
    if value is None:
        raise InputError("reading", f"'{c.part}' has no {c.what}", "read another quantity of it, or another part")
    return value


def _axes(name: str, motion: BodyMotion) -> Array:
    if motion.axes is None and motion.spin is not None:
        remedy = "give it joint = 'free', or use the axes of another body"
        raise InputError("reading", f"the rotation of '{name}' is not computed", remedy)
    return jnp.eye(3) if motion.axes is None else motion.axes


def _relative(c: Channel, axes: Array, bodies: Mapping[str, BodyMotion]) -> Array:
    return jnp.swapaxes(_axes(c.frame, bodies[c.frame]), -1, -2) @ axes if c.frame else axes


def _component(c: Channel, vector: Any, bodies: Mapping[str, BodyMotion]) -> Array:
    vector, k = _there(c, vector), "xyz".index(c.axis)
    if not c.frame:
        return vector[..., k]
    axes = _axes(c.frame, bodies[c.frame])
    way = axes[..., :, k]
    # A frame without members beside a vector with them.
    way = way[..., None, :] if way.ndim < vector.ndim else way
    return jnp.sum(vector * way, -1)


def histories(
    model: AbstractModel, params: Params, times: Array, states: Array, channels: Sequence[Channel]
) -> dict[str, Array]:
    """Values of readings (T,), or (T, k) over members, in states (T, n) at times (T,) [s]; NaN where a state is."""
    prepared, of_life = model.prepare(params), shares(channels, model, params)

    def one(t: Array, y: Array) -> dict[str, Array]:
        found = looked(channels, model, model.observe(t, y, prepared), of_life)(t, y, prepared)
        # What is prescribed does not know of a failed state.
        lost = jnp.any(jnp.isnan(y))
        return {name: jnp.where(lost, jnp.nan, value) for name, value in found.items()}

    return jax.vmap(one)(jnp.maximum(times, 0.0), states)


def needs_bodies(channels: Sequence[Channel], model: AbstractModel) -> bool:
    """Whether any of them asks how bodies move."""
    contacts = {c.name for c in model.contacts}
    return any(c.frame or (c.part not in contacts and not _bears(c, model)) for c in channels)


def _bears(c: Channel, model: AbstractModel) -> bool:
    """Whether a reading is of what joints and loads do."""
    return c.what in _BORNE or (c.part in model.load_names and c.part not in model.body_names)
