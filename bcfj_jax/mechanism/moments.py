"""What a model tells of one instant, and a run of its touches and summits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jax import Array


class Continuous(NamedTuple):
    """Of each of C channels, whatever the samples: of its greatest force and its least, and integrals of its size."""

    # time, state: (2, C) [s] and (2, C, n) of the ends of the steps at which it was greatest, and least.
    time: Array
    state: Array
    # before, after: (2, C) lengths of the steps before and after these [s].
    before: Array
    after: Array
    # impulse, work: (C,) integrals of the size by the time [N s] and by the penetration [J]; a reading keeps its sign.
    impulse: Array
    work: Array


class Approaches(NamedTuple):
    """Of k remembered approach speeds (k,): the penetration beyond which each stays [m], its rate [m/s], the speed [m/s]."""

    depth: Array
    rate: Array
    speed: Array


class Reading(NamedTuple):
    """What one contact does at one instant (or at each of T instants)."""

    # (..., 3) normal, axial, tangential force [N]; a contact with members has (..., k, 3), and (..., k) below.
    force: Array
    penetration: Array  # (...,) overlap of the undeformed surfaces [m]; negative is the gap
    rate: Array  # (...,) rate of the penetration [m/s], positive while approaching
    slip: Array | None = None  # (...,) sliding speed [m/s]; None in models that only approach
    # (..., 3) the whole force on the second body in world axes [N]; None where a model has no world axes.
    world: Array | None = None


class Proximity(NamedTuple):
    """How near the surfaces of every face are in one state, and how their bodies move past each other; (C,) each."""

    depth: Array  # penetration [m], of a regularised contact from where its force begins; negative is the gap
    rate: Array  # rate of the penetration [m/s]
    speed: Array  # of the relative motion that the penetration depends on [m/s]: at least its rate
    turn: Array  # rate of the rotation that it depends on, over the angle in which its course bends [1/s]
    # Relative motion [m] over which the penetration's course bends; infinite between planes, 0 where not known.
    bends: Array


class BodyMotion(NamedTuple):
    """Where a body is and how it moves, in world axes; a body with members has (k, ...)."""

    # place, velocity, acceleration: (..., 3) of its centre of mass [m, m/s, m/s^2].
    place: Array
    velocity: Array
    acceleration: Array
    axes: Array | None = None  # (..., 3, 3) its axes as columns; None for a body that does not turn
    # spin, spin_rate: (..., 3) angular velocity and its rate [rad/s, rad/s^2]; None likewise.
    spin: Array | None = None
    spin_rate: Array | None = None
    angle: Array | None = None  # (...,) turn of a body that has one axis [rad]; None for the rest
    drive: Array | None = None  # (...,) force or torque of its drive [N, N m]; None for a body without one
    # (...,) coordinates of its joint and their rates, by the names that a start has for them.
    joint: Mapping[str, Array] = {}


class Effort(NamedTuple):
    """What a joint or a load does, in world axes; None where it has none; of a body with members (k, ...)."""

    # reaction, moment: (..., 3) what a joint does to its body: force [N], and moment about the body's origin [N m],
    # those of its drive and of the loads on its coordinate among them. Of a load moment is about the first point that
    # it acts on.
    reaction: Array | None = None
    moment: Array | None = None
    force: Array | None = None  # (..., 3) of a load on its body [N]
    axes: Array | None = None  # (..., 3, 3) axes of a joint as columns: its parent's, turned by ``tilt``
    power: Array | None = None  # (...,) of a joint's drive, or of a load [W]
    drive: Array | None = None  # (...,) of a load on a coordinate [N, N m]
    # pull, length: (...,) of a load between two points: force towards each other [N], and distance [m].
    pull: Array | None = None
    length: Array | None = None


# Numbers of materials: (contact, name, value), "" for every contact.
Life = tuple[tuple[str, str, float], ...]


class Bodies(NamedTuple):
    """Lengths of the bodies at a contact; None where they are not known."""

    size: float | None = None  # least length of the bodies at the contact, a radius or half a side [m]
    # Relative radius, 1/R = 1/R_1 + 1/R_2, of bodies that touch at a point of two equal curvatures [m].
    radius: float | None = None
    misread: str = ""  # what a penetration says against how the gap was written; "" for nothing
    mass: float | None = None  # largest mass of the bodies at the contact [kg]


class Pose(NamedTuple):
    """Where a body is drawn: (..., 3) its origin [m], (..., 3, 3) its axes as columns; a body with members has (k, ...)."""

    place: Array
    axes: Array


class Arrow(NamedTuple):
    """The force of a contact as it is drawn: (..., 3) where it acts [m], (..., 3) the force on ``body`` [N], world axes."""

    point: Array
    force: Array


class Scenery(NamedTuple):
    """What moves in a drawing, in one state."""

    poses: dict[str, Pose]  # by body
    # By body, where it would be if every contact just closed without play or penetration; what a viewer exaggerates is
    # the difference.
    ideal: dict[str, Pose]
    arrows: dict[str, Arrow]  # by contact; a contact with members has (k, 3)
    # By contact, (3,) marker of its second body in the axes of the first, from the marker of the first [m]; by body
    # that slides, (3,) its place in the axes of its parent, from the joint's place.
    offsets: dict[str, Array]


class Flows(NamedTuple):
    """The energy balance in one state."""

    given: dict[str, Array]  # by source, power into the system [W]
    taken: dict[str, Array]  # by sink, power out of it [W]: loads, friction, damping
    stored: dict[str, Array]  # by store, energy [J]


class Chain(NamedTuple):
    """Links in a row and what they bear, for a picture."""

    link: str  # what one is called; links are counted from 1
    corners: np.ndarray  # (n + 2, 2) both ends and the links between them [m]
    pushes: np.ndarray  # (n, 2) forces on the links [N], and what they are
    pushed: str
    loads: dict[str, tuple[str, np.ndarray]]  # by name unit and values (n,)
    walls: np.ndarray  # (2, m, 2) both sides of what the row lies in [m]


class Account(NamedTuple):
    """A quantity in one state that changes at a known rate, () or of a body's members (k,)."""

    value: Array  # momentum [N s], angular momentum [N m s] or energy [J]
    rate: Array  # its rate by forces, torques and powers [N, N m, W]
    size: Array  # sum of the sizes of the rate's terms, in the same unit


class Orbit(NamedTuple):
    """How far the centre of a contact's inner body is from that of its outer one, across the contact's axis."""

    # x, y: (T,) [m].
    x: np.ndarray
    y: np.ndarray
    clearance: float  # radius of the circle within which the bodies do not touch [m]
    what: str  # the two bodies in words, "cage in seat"
    axes: tuple[str, str] = ("x", "y")  # what x and y are called on a picture
    along: np.ndarray | None = None  # (T,) the same along the axis [m]; None where the bodies cannot move there


class Coarser(NamedTuple):
    """A cheaper model of the same thing: its name, the options of the scene file that give it, what it leaves out."""

    name: str
    options: dict[str, Any]
    physics: str


class Choice(NamedTuple):
    """Which level of a model was chosen for a run (``AbstractModel.choose``)."""

    fidelity: str  # name of the level
    budget: float  # force error allowed, a fraction of the peak
    # Estimated error of every level that was looked at, cheapest first; infinite or NaN where the level has no answer.
    errors: dict[str, float]
    reason: str  # the choice in words


class Variant(NamedTuple):
    """Another choice for the same thing, none of them the truth: its name, changes to a scene file by section, words."""

    name: str
    change: dict[str, dict[str, Any]]
    physics: str
