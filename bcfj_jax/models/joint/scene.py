"""The scene ``joint``: which bodies, contacts and laws are in it, and the layout of its state.

What an option takes out is not in the program: no friction law, no friction operation; a fixed cage, no cage state.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.laws import AbstractFriction, AbstractLaw
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.mechanism.arrays import own_quantities
from bcfj_jax.mechanism.model import AbstractModel, Life, Params
from bcfj_jax.models.joint.defaults import DEFAULTS, SMOOTHING_OF_SPHERES
from bcfj_jax.models.joint.programmes import Programmes

CONTACTS = ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball", "cage_window_end")
# Contact of a ball with either end of its window, around a free cage.
WINDOW_END = CONTACTS[5]
USUAL = CONTACTS[:5]
GROOVES = ("seat_ball", "head_ball")
PILOTS = ("seat_cage", "head_cage")
# The bodies that balls touch, in the order of ``body_maps``.
BODIES = ("seat", "head", "cage")
# Which sphere is in which: (outer, inner).
GUIDES = {"seat_cage": ("seat", "cage"), "head_cage": ("cage", "head")}
OF_A_BALL = ("cage_ball", "seat_ball", "head_ball", "cage_window_end")
# The body on which the first surface of a contact is, and with which its bristles turn.
OUTER = {"seat_ball": "seat", "head_ball": "head", "cage_ball": "cage", "cage_window_end": "cage"}
OUTER |= {name: outer for name, (outer, _) in GUIDES.items()}
FLAT = ("cage_ball", "cage_window_end")
FIDELITIES = ("kinematic", "quasistatic", "dynamic")
# In place of one of them: ``bcfj_jax.models.joint.fidelity`` chooses.
AUTO = "auto"
TRACKS = ("gothic", "circular")
CAGES = HEADS = ("free", "fixed")
DRIVES = ("prescribed", "flexible")
# Options without which the joint is the simplest that turns: balls are particles, windows have no ends, pilots are spheres.
PLAIN: dict[str, Any] = {"spin": False, "window_ends": False, "bands": False}
# Where a contact's stiffness is from.
STIFFNESSES = GIVEN, GEOMETRY = ("given", "geometry")


class JointContact(eqx.Module):
    """One kind of contact: its name, its normal-force law, its friction law or None.

    ``geometric``: its stiffness is that of its geometry (``constants.stiffness``), and no parameter.
    """

    name: str = eqx.field(static=True)
    law: AbstractLaw
    friction: AbstractFriction | None
    geometric: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if self.law.states:
            found = f"the law {type(self.law).__name__} has a state; contacts of the joint cannot keep one"
            raise InputError(f"scene 'joint' {self.name}", found, "give a law without a state, such as memory_free")
        if not self.geometric:
            return
        # What reads an effective modulus has its stiffness from geometry as it is.
        if "effective_modulus" in self.needs:
            object.__setattr__(self, "geometric", False)
        elif not {"stiffness", "exponent"} <= set(self.needs):
            found = f"{self.name}: its elastic part is no power law, which the formulas of Hertz are"
            remedy = f'give stiffnesses = {{ {self.name} = "given" }}, or elastics = {{ {self.name} = "power" }}'
            raise InputError("scene 'joint' stiffness", found, remedy)

    @property
    def needs(self) -> tuple[str, ...]:
        """Coefficients its laws read."""
        return (*self.law.needs, *(self.friction.needs if self.friction else ()))

    @property
    def derived(self) -> tuple[str, ...]:
        """Coefficients that the joint's geometry gives (``coefficients``). A flat window has no radius difference."""
        radii = ("radius",) if self.name in FLAT else ("radius", "radius_difference")
        wanted, needs = (*radii, "stiffness", "exponent") if self.geometric else radii, self.needs
        return tuple(name for name in wanted if name in needs)

    @property
    def own(self) -> tuple[str, ...]:
        """Coefficients that are parameters: the others that it needs, and what a geometric stiffness is made of."""
        more = ("effective_modulus",) if self.geometric else ()
        return tuple(dict.fromkeys(name for name in (*self.needs, *more) if name not in self.derived))


class Flat(NamedTuple):
    """Parts of a flat state or its rate: n balls of k velocities, b coupling coordinates, friction's states and azimuth."""

    place: Array  # (n, 3)
    at: Array  # (b,) of the coupling
    twist: Array  # (n, k)
    rate: Array  # (b,)
    others: Array  # the rest

    def whole(self) -> Array:
        """The flat state."""
        return jnp.concatenate([x.ravel() for x in self if x.size])


class Joint(AbstractModel):
    """Static structure of the ball-cage flexible joint; ``model.JointModel`` is the whole model.

    Attributes:
        contacts: those in the program.
        balls: their number, evenly spaced; a track in either race for each.
        track: "gothic" (two flanks at the contact angle) or "circular" (one, of ball radius plus clearance).
        spin: whether balls turn (and so roll).
        unequal: whether each ball has sizes of its own (``clearance``).
        cage: "free", or "fixed" at the centre, its axis on the bisector, turning at the drive's speed.
        bands: whether pilots bear between two latitudes of the cage alone (``bands``), or all round.
        head: "free" to shift, or "fixed" at the centre; it always turns about its own axis.
        drive: "prescribed" speed, or "flexible": a seat with inertia behind a spring and a damper.
        smoothing: whether contacts are regularised.
        fidelity: "dynamic", "quasistatic" or "kinematic"; "auto" for a scene that ``simulate`` alone can run.
        programmes: what of drive and loads is not constant.

    Where a field is left out it is the plain joint's; ``model.joint`` gives every one.
    """

    contacts: tuple[JointContact, ...]
    balls: int = eqx.field(static=True, default=6)
    track: str = eqx.field(static=True, default="gothic")
    spin: bool = eqx.field(static=True, default=False)
    unequal: bool = eqx.field(static=True, default=False)
    cage: str = eqx.field(static=True, default="free")
    bands: bool = eqx.field(static=True, default=False)
    head: str = eqx.field(static=True, default="free")
    drive: str = eqx.field(static=True, default="prescribed")
    smoothing: bool = eqx.field(static=True, default=True)
    fidelity: str = eqx.field(static=True, default="dynamic")
    programmes: Programmes = Programmes()
    kind: str = eqx.field(static=True, default="joint")
    samples: int = eqx.field(static=True, default=3001)
    longest_step: float | None = eqx.field(static=True, default=None)
    life: Life = eqx.field(static=True, default=())  # pyright: ignore[reportIncompatibleMethodOverride]

    def __check_init__(self):
        stated = {x.name: x.friction for x in self.contacts if x.friction and (x.friction.bristles or x.friction.lags)}
        if len({friction.lags for friction in stated.values()}) > 1:
            found = ", ".join(f"{name} {type(friction).__name__}" for name, friction in stated.items())
            remedy = "give bristles or friction that lags, not both in one joint"
            raise InputError("scene 'joint' friction", found, remedy)

    # Parameters.

    @property
    def defaults(self) -> tuple[tuple[str, float], ...]:
        """Default values of the parameters the scene has."""
        known = {name: DEFAULTS.get(name, (None,))[0] for name in self.quantities} | dict.fromkeys(self.each_ball, 0.0)
        known |= {"smoothing": SMOOTHING_OF_SPHERES} if self.smoothing and not self.banded else {}
        known |= dict(self.programmes.greatest)
        return tuple((name, value) for name, value in known.items() if value is not None)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Shared coefficients, each contact's own, clearances, bodies, drive and loads."""
        return dict(_quantities(self))

    def _listed(self) -> dict[str, Quantity]:
        reads = {x.name: (*x.own, *(("smoothing",) if self.smoothing else ())) for x in self.contacts}
        names = list(dict.fromkeys(name for read in reads.values() for name in read))
        names += [f"{contact}.{name}" for contact, read in reads.items() for name in read]
        names += ["drive_speed", "load_torque", *(name for name in self.programmes.names if name == "load_ramp")]
        names += ["axial_load", "joint_angle", *(name for name in self.programmes.names if name != "load_ramp")]
        names += ["seat_radius", "head_radius", "ball_radius", "pitch_radius", "offset"]
        names += ["contact_angle", "conformity"] if self.track == "gothic" else []
        names += [f"clearance_{contact.name}" for contact in self.contacts]
        names += [*self.each_ball, "ball_mass", "head_mass", "head_inertia"]
        names += ["pilot_band"] if self.banded else []
        names += ["cage_mass", "cage_inertia"] if self.cage == "free" else []
        names += ["seat_inertia", "drive_stiffness", "drive_damping"] if self.drive == "flexible" else []
        parts = [part for contact in self.contacts for part in (contact.law, contact.friction)]
        theirs = {name: quantity for part in parts for name, quantity in own_quantities(part).items()}
        return {name: _quantity(name, theirs) for name in names}

    @property
    def each_ball(self) -> list[str]:
        """Parameters of single balls."""
        if not self.unequal:
            return []
        pairs = [ball_sizes(self.balls, contact.name) for contact in self.contacts if contact.name in OF_A_BALL]
        return [*pairs[0][0], *(name for _, extra in pairs for name in extra)]

    def clearance(self, params: Params, name: str) -> Array:
        """Clearance of every ball in one of its contacts, (balls,) [m] of unequal balls, else a scalar.

        Ball i, counted from 1 as in ``seat_ball_2``, has in a contact of its own the clearance

            clearance_<contact> + <contact>_<i>.extra_clearance - ball_<i>.oversize

        which may be negative: such a ball is pressed in. The oversize d counts in full in grooves, whose flanks are where
        they were, and at both planes of a window. Masses, levers and stiffnesses remain those of ``ball_radius``: of
        d/ball_radius.
        """
        shared = params[f"clearance_{name}"]
        if not self.unequal:
            return shared
        oversize, extra = (jnp.stack([params[key] for key in keys]) for keys in ball_sizes(self.balls, name))
        return shared + extra - oversize

    def horizon(self, params: Params) -> Array:
        """The paper's 3 s."""
        del params
        return jnp.asarray(3.0)

    # What is in it.

    @property
    def pitches(self) -> int:
        """Pitches of a ball in which steady motion repeats itself; of unequal balls those of a turn."""
        return self.balls if self.unequal else 1

    @property
    def in_motion(self) -> bool:
        """Whether its history is one of motion: each instant hangs on those before it."""
        return self.fidelity in ("dynamic", AUTO)

    @property
    def driven(self) -> bool:
        """Whether the seat's speed is prescribed and not constant; its turn is the last of the coupling coordinates."""
        return self.drive == "prescribed" and self.programmes.drive is not None

    def has(self, name: str) -> bool:
        """Whether a contact is in the program."""
        return any(contact.name == name for contact in self.contacts)

    def contact(self, name: str) -> JointContact:
        """A contact by name."""
        return next(contact for contact in self.contacts if contact.name == name)

    @property
    def azimuths(self) -> np.ndarray:
        """Azimuths (balls,) of the tracks about their race's axis at turn 0 [rad]."""
        return 2.0 * np.pi * np.arange(self.balls) / self.balls

    @property
    def window_ends(self) -> bool:
        """Whether its windows end."""
        return self.has(WINDOW_END)

    @property
    def pilots(self) -> tuple[str, ...]:
        """The sphere-in-sphere contacts."""
        return tuple(name for name in PILOTS if self.has(name))

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Of each pilot the body in whose axes it is seen and the other, on which its force acts: ``GUIDES``.

        Bands are seen from the cage, whose they are.
        """
        found = [GUIDES[name] for name in self.pilots]
        return [("cage", first if second == "cage" else second) for first, second in found] if self.banded else found

    @property
    def banded(self) -> bool:
        """Whether it has pilots that are bands."""
        return self.bands and bool(self.pilots)

    # The flat state.

    @property
    def twist(self) -> int:
        """Velocities of one ball: 3, or 6 with spin."""
        return 6 if self.spin else 3

    @property
    def slices(self) -> Mapping[str, slice | None]:
        """Where each part of the coupling coordinates is, in order; None for what the scene fixes."""
        head, cage = (3 if held == "free" else 0 for held in (self.head, self.cage))
        sizes = {"head": head, "head_turn": 1, "cage": cage, "cage_turn": cage, "seat_turn": 1}
        ends = np.cumsum([*sizes.values()]).tolist()
        return {
            name: slice(end - size, end) if size else None
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        }

    def coupled(self, parts: Mapping[str, Array], axis: int = -1) -> Array:
        """Coupling coordinates from parts by name, of which those that the scene fixes are left out."""
        return jnp.concatenate([parts[name] for name, piece in self.slices.items() if piece is not None], axis)

    @property
    def coupling(self) -> int:
        """Number of coupling coordinates."""
        return sum(piece.stop - piece.start for piece in self.slices.values() if piece is not None)

    @property
    def bristles(self) -> Mapping[str, int]:
        """Faces of each contact whose friction has a state: of one ball's, and of a pilot; a band has no bristles."""
        if self.fidelity != "dynamic":
            return {}
        faces = {"cage_ball": 2, WINDOW_END: 2}
        faces |= {"seat_ball": 2, "head_ball": 2} if self.track == "gothic" else {}
        frictions = {contact.name: contact.friction for contact in self.contacts if contact.friction}
        rough = {name for name, friction in frictions.items() if friction.bristles or friction.lags}
        names = (*GROOVES, "cage_ball", WINDOW_END, *(() if self.bands and self.width == 3 else PILOTS))
        return {name: faces.get(name, 1) for name in names if name in rough}

    @property
    def width(self) -> int:
        """Numbers of a face's friction state: 3 of bristles, 1 of friction that lags."""
        return 1 if any(contact.friction and contact.friction.lags for contact in self.contacts) else 3

    @property
    def moving(self) -> int:
        """Length of the flat state without friction's states and the cage's azimuth."""
        return (3 + self.twist) * self.balls + 2 * self.coupling

    @property
    def states(self) -> int:
        """Length of the flat state."""
        members = {name: self.balls if name in OF_A_BALL else 1 for name in self.bristles}
        kept = self.width * sum(members[name] * faces for name, faces in self.bristles.items())
        return self.moving + kept + self.has(WINDOW_END)

    @property
    def azimuth(self) -> int | None:
        """Where the cage's azimuth stands in the flat state: last; None without window ends, which alone read it."""
        return self.states - 1 if self.has(WINDOW_END) else None

    def parted(self, y: Array) -> Flat:
        """The parts of a flat state."""
        n, b, k = self.balls, self.coupling, self.twist
        ends = np.cumsum([3 * n, b, k * n, b]).tolist()
        place, at, twist, rate, others = (y[i:j] for i, j in zip([0, *ends], [*ends, y.shape[0]], strict=True))
        return Flat(place.reshape(n, 3), at, twist.reshape(n, k), rate, others)


@functools.lru_cache(maxsize=64)
def _quantities(scene: Joint) -> dict[str, Quantity]:
    """``Joint.quantities``, kept: they are asked for anew for each of a hundred parameters of every run."""
    return scene._listed()


def ball_sizes(balls: int, contact: str) -> tuple[list[str], list[str]]:
    """Names of every ball's oversize, and of its extra clearance in a contact."""
    each = range(1, balls + 1)
    return [f"ball_{i}.oversize" for i in each], [f"{contact}_{i}.extra_clearance" for i in each]


def _quantity(name: str, theirs: Mapping[str, Quantity]) -> Quantity:
    """What a parameter is; ``theirs``: coefficients that laws of the user's own have beside the known ones."""
    contact, _, own = name.rpartition(".")
    quantity = theirs.get(own) or CATALOGUE.get(own) or Quantity(own, "1", f"coefficient {own}")
    if not contact:
        return quantity
    return quantity._replace(name=name, meaning=f"{quantity.meaning}; of {contact} alone")


def split(scene: Joint, y: Array) -> dict[str, Array]:
    """Friction's states in a flat state by contact, (balls, faces, width), of a pilot (1, width); local to a face.

    They are bristles, three numbers a face, or the slip speed of late of friction that lags, one (``Joint.width``); the name
    is "bristles" for either. The balls' come first, ball by ball, contact by contact in the order of ``Joint.bristles``, face
    by face; then the pilots'.
    """
    each, first, found = scene.width, scene.moving, {}
    faces = {name: count for name, count in scene.bristles.items() if name not in PILOTS}
    width = each * sum(faces.values())
    balls, column = y[first : first + scene.balls * width].reshape(scene.balls, width), 0
    for name, count in faces.items():
        found[name] = balls[:, column : column + each * count].reshape(scene.balls, count, each)
        column += each * count
    first += balls.size
    for name in scene.bristles:
        if name in PILOTS:
            found[name] = y[first : first + each].reshape(1, each)
            first += each
    return found


def flat(parts: Mapping[str, Array]) -> Array:
    """The inverse of ``split``, for parts in the order of ``Joint.bristles``."""
    balls = [x.reshape(x.shape[0], -1) for name, x in parts.items() if name not in PILOTS]
    pilots = [x.ravel() for name, x in parts.items() if name in PILOTS]
    return jnp.concatenate([*([jnp.concatenate(balls, 1).ravel()] if balls else []), *pilots])


def beside(parts: Mapping[str, Array], names: tuple[str, ...]) -> Array | None:
    """Friction's states of contacts side by side, (..., contact, face, width), 0 where there are none; None if nowhere."""
    some = [parts[name] for name in names if name in parts]
    if not some:
        return None
    return jnp.stack([parts.get(name, jnp.zeros_like(some[0])) for name in names], -3)
