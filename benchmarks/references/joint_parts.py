"""The joint from the parts of which every mechanism is made: its kinds of contact between four kinds of bodies.

Its equations of motion are the joint's own (``system``), which stay because they run faster: docs/joint.md. A test holds
the two to each other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.gaps import (
    AbstractGap,
    BallBetweenPlanes,
    BallInGroove,
    Coefficients,
    Face,
    Frame,
    SphereInSocket,
)
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.vectors import ZERO
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import AbstractLoad, Force, JointSpring, Torque
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.programmes import Programme
from bcfj_jax.mechanism.sizes import Params, Size
from bcfj_jax.models.joint.constants import coefficients
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.scene import OF_A_BALL, WINDOW_END, Joint, JointContact


def as_mechanism(joint: Joint) -> Mechanism:
    """A dynamic joint of generic parts, with the joint's parameters and defaults.

    The state has places, velocities and bristles of the same bodies in another order; the head's place is in axes that
    lean by the joint angle, and the cage has a quaternion. A prescribed seat and a fixed cage are driven and have none.
    A parameter that only the joint's checks read (the sphere radii of a joint without pilots) is not in the mechanism; of
    stiffnesses from geometry the shared ``effective_modulus`` alone is.

    Raises:
        InputError: for pilots that are bands, whose edge bears all round: no gap of faces has that.
    """
    if joint.banded:
        found = "bands: an edge that bears all round is no gap of faces"
        raise InputError("as_mechanism", found, "give bands = false, or run the scene 'joint' itself")
    only = {"seat_radius": "seat_cage", "head_radius": "head_cage"}
    if joint.programmes.stick_slip:
        found = "a torque that sticks and slips"
        raise InputError("as_mechanism", found, "give a load of your own: its function knows the head's spin")
    given = {name: value for name, value in joint.defaults if name not in only or joint.has(only[name])}
    return Mechanism(
        "joint",
        (_seat(joint), _head(joint), _cage(joint), _balls(joint)),
        tuple(_contact(joint, contact) for contact in joint.contacts),
        _loads(joint),
        own=[*([CATALOGUE["head_radius"]] if joint.has("head_cage") else []), *_unread(joint)],
        given=given,
        end=3.0,
        samples=joint.samples,
    )


def _unread(joint: Joint) -> list[Quantity]:
    """What stiffnesses from geometry and clearances of single balls are made of, and no part reads."""
    names = ["effective_modulus"] if any(contact.geometric for contact in joint.contacts) else []
    if joint.unequal:
        names += [*joint.each_ball, *(f"clearance_{x.name}" for x in joint.contacts if x.name in OF_A_BALL)]
    return [joint.quantities[name] for name in names]


def _seat(joint: Joint) -> Body:
    """It turns about z: driven, or free with a drive that is a spring (``_loads``)."""
    if joint.drive == "prescribed":
        return Body("seat", "hinge", mass=_none, inertia=_none, drive=_drive(joint))
    return Body("seat", "hinge", mass=_none, inertia="seat_inertia", start={"speed": _start_speed(joint)})


def _start_speed(joint: Joint) -> Size:
    """Speed of seat and head at time 0."""
    return "drive_speed" if joint.programmes.drive is None else joint.programmes.start_speed


def _drive(joint: Joint) -> Drive:
    """The seat's drive over time."""
    return joint.programmes.drive or Drive("constant", speed="drive_speed")


def _head(joint: Joint) -> Body:
    """It turns about its axis, and shifts where it is free."""
    held = "bearing" if joint.head == "free" else "hinge"
    tilt = ("y", "joint_angle")
    return Body("head", held, tilt=tilt, mass="head_mass", inertia="head_inertia", start={"speed": _start_speed(joint)})


def _cage(joint: Joint) -> Body:
    """A free spherical shell whose z axis starts on the bisector; or driven about it."""
    if joint.cage == "fixed":
        drive = Drive("constant", speed="drive_speed")
        return Body("cage", "hinge", tilt=("y", _half), mass=_none, inertia=_none, drive=drive)
    start: dict[str, Size] = {name: _Of(joint, _of_cage, (name,)) for name in ("q0", "q2", "wx", "wz")}
    return Body("cage", "free", mass="cage_mass", inertia="cage_inertia", start=start)


def _balls(joint: Joint) -> Body:
    """Particles, or solid spheres that turn."""
    first, n = 3 * joint.balls + joint.coupling, joint.balls
    start: dict[str, Size] = {key: _Of(joint, _of_balls, (0, 3, k)) for k, key in enumerate("xyz")}
    rates = ("vx", "vy", "vz", "wx", "wy", "wz")[: joint.twist]
    start |= {key: _Of(joint, _of_balls, (first, joint.twist, k)) for k, key in enumerate(rates)}
    held = "sphere" if joint.spin else "particle"
    return Body("ball", held, mass="ball_mass", inertia=_solid, start=start, members=n)


def _at_centre(faces: tuple[Face, ...]) -> tuple[Face, ...]:
    """The plain joint's balls are particles: forces act, and slip is that of the race or cage, at their centres."""
    return tuple(face._replace(lever=ZERO) for face in faces)


class _GrooveOfParticle(BallInGroove):
    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        return _at_centre(super().faces(a, b, c))


class _WindowOfParticle(BallBetweenPlanes):
    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        return _at_centre(super().faces(a, b, c))


def _contact(joint: Joint, contact: JointContact) -> Contact:
    """One kind of contact; the force that is read acts on the second body."""
    name, tracks = contact.name, {"tracks": joint.balls, "section": joint.track}
    window, groove = (BallBetweenPlanes, BallInGroove) if joint.spin else (_WindowOfParticle, _GrooveOfParticle)
    gaps: dict[str, AbstractGap] = {
        "seat_cage": SphereInSocket(axis_of="b"),
        "head_cage": SphereInSocket(axis_of="a"),
        "cage_ball": window(),
        WINDOW_END: window(axis="y", windows=joint.balls),
        "seat_ball": groove(side="outer", **tracks),
        "head_ball": groove(side="inner", **tracks),
    }
    between = {"head_cage": ("cage", "head"), WINDOW_END: ("cage", "ball")}
    sizes: dict[str, Size] = {key: key for key in gaps[name].needs if key != "clearance"}
    # The hollow sphere: the seat's, and the cage's around the head.
    if "radius" in sizes:
        sizes["radius"] = "seat_radius" if name == "seat_cage" else _hollow
    if joint.unequal and name in OF_A_BALL:
        sizes["clearance"] = _Of(joint, Joint.clearance, (name,))
    # What the joint's own geometry gives.
    sizes |= {key: _Of(joint, _derived, (name, key)) for key in contact.derived if key not in sizes}
    return Contact(
        name, between.get(name) or tuple(name.split("_")), gaps[name], contact.law, contact.friction,
        smoothing=joint.smoothing, values=sizes, approach="parameter",
    )  # fmt: skip


def _loads(joint: Joint) -> tuple[AbstractLoad, ...]:
    """Torque and axial load on the head, against its axis; the drive of a seat that has inertia."""
    torque = Torque("load_torque", "head", "-z", **_over_time(joint.programmes.torque), follows=True)
    axial = Force("axial_load", "head", "-z", **_over_time(joint.programmes.axial or _CONSTANT), follows=True)
    if joint.drive == "prescribed":
        return torque, axial
    drive = _drive(joint)
    spring = JointSpring("drive", "seat", stiffness="drive_stiffness", damping="drive_damping", drive=drive)
    return torque, axial, spring


_CONSTANT = Programme("axial_load")


def _over_time(programme: Programme) -> dict[str, Any]:
    """A programme as a load's own fields."""
    return {field.name: getattr(programme, field.name) for field in dataclasses.fields(programme)}


class _Of(eqx.Module):
    """A size of a part that the joint computes: ``what`` (joint, parameters, *which); a module, as programs are found by it."""

    joint: Joint
    what: Callable[..., Array] = eqx.field(static=True)
    which: tuple[Any, ...] = eqx.field(static=True)

    def __call__(self, p: Params) -> Array:
        return self.what(self.joint, p, *self.which)


def _of_balls(joint: Joint, p: Params, first: int, width: int, column: int) -> Array:
    """A coordinate or velocity of all balls at time 0 (balls,): a column of ``kinematic.nominal``."""
    part = nominal(joint, p, jnp.zeros(()))[first:][: width * joint.balls]
    return part.reshape(-1, width)[:, column]


def _of_cage(joint: Joint, p: Params, name: str) -> Array:
    """A component of the cage's attitude, z on the bisector, or of its angular velocity about it at time 0."""
    quarter = 0.5 * _half(p)
    if name.startswith("q"):
        return jnp.cos(quarter) if name == "q0" else jnp.sin(quarter)
    return joint.programmes.start_speed(p) * (jnp.sin(_half(p)) if name == "wx" else jnp.cos(_half(p)))


def _derived(joint: Joint, p: Params, contact: str, name: str) -> Array:
    """A coefficient of a contact that is no parameter."""
    return coefficients(joint, p, contact)[name]


def _none(p: Params) -> float:
    """Inertia of what turns as it is driven, and mass of what stays in its place."""
    del p
    return 0.0


def _half(p: Params) -> Array:
    """Lean of the bisector [rad]."""
    return 0.5 * p["joint_angle"]


def _solid(p: Params) -> Array:
    """Inertia of a ball [kg m^2]."""
    return 0.4 * p["ball_mass"] * p["ball_radius"] ** 2


def _hollow(p: Params) -> Array:
    """Radius of the cage's hollow sphere [m]."""
    return p["head_radius"] + p["clearance_head_cage"]
