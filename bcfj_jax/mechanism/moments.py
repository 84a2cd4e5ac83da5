"""What a model tells of one instant, and a run of its touches and summits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jax import Array


class Continuous(NamedTuple):
    """Of each of C channels, whatever the samples: of its greatest force and its least, and integrals of its size.

    Attributes:
        time: (2, C) [s], state: (2, C, n) of the ends of the steps at which it was greatest, and least.
        before, after: (2, C) lengths of the steps before and after these [s].
        impulse, work: (C,) integrals of the size by the time [N s] and by the penetration [J]; a reading keeps its sign.
    """

    time: Array
    state: Array
    before: Array
    after: Array
    impulse: Array
    work: Array


class Approaches(NamedTuple):
    """Of k remembered approach speeds (k,): the penetration beyond which each stays [m], its rate [m/s], the speed [m/s]."""

    depth: Array
    rate: Array
    speed: Array


class Reading(NamedTuple):
    """What one contact does at one instant (or at each of T instants).

    Attributes:
        force: (..., 3) normal, axial, tangential force [N]; a contact with members has (..., k, 3), and (..., k) below.
        penetration: (...,) overlap of the undeformed surfaces [m]; negative is the gap.
        rate: (...,) rate of the penetration [m/s], positive while approaching.
        slip: (...,) sliding speed [m/s]; None in models that only approach.
        world: (..., 3) the whole force on the second body in world axes [N]; None where a model has no world axes.
    """

    force: Array
    penetration: Array
    rate: Array
    slip: Array | None = None
    world: Array | None = None


class Proximity(NamedTuple):
    """How near the surfaces of every face are in one state, and how their bodies move past each other; (C,) each.

    Attributes:
        depth: penetration [m], of a regularised contact from where its force begins; negative is the gap.
        rate: rate of the penetration [m/s].
        speed: of the relative motion that the penetration depends on [m/s]: at least its rate.
        turn: rate of the rotation that it depends on, over the angle in which its course bends [1/s].
        bends: relative motion [m] over which the penetration's course bends; infinite between planes, 0 where not known.
    """

    depth: Array
    rate: Array
    speed: Array
    turn: Array
    bends: Array


class BodyMotion(NamedTuple):
    """Where a body is and how it moves, in world axes; a body with members has (k, ...).

    Attributes:
        place, velocity, acceleration: (..., 3) of its centre of mass [m, m/s, m/s^2].
        axes: (..., 3, 3) its axes as columns; None for a body that does not turn.
        spin, spin_rate: (..., 3) angular velocity and its rate [rad/s, rad/s^2]; None likewise.
        angle: (...,) turn of a body that has one axis [rad]; None for the rest.
        drive: (...,) force or torque of its drive [N, N m]; None for a body without one.
        joint: (...,) coordinates of its joint and their rates, by the names that a start has for them.
    """

    place: Array
    velocity: Array
    acceleration: Array
    axes: Array | None = None
    spin: Array | None = None
    spin_rate: Array | None = None
    angle: Array | None = None
    drive: Array | None = None
    joint: Mapping[str, Array] = {}


class Effort(NamedTuple):
    """What a joint or a load does, in world axes; None where it has none; of a body with members (k, ...).

    Attributes:
        reaction, moment: (..., 3) what a joint does to its body: force [N], and moment about the body's origin [N m], those
            of its drive and of the loads on its coordinate among them. Of a load ``moment`` is about the first point that
            it acts on.
        force: (..., 3) of a load on its body [N].
        axes: (..., 3, 3) axes of a joint as columns: its parent's, turned by ``tilt``.
        power: (...,) of a joint's drive, or of a load [W].
        drive: (...,) of a load on a coordinate [N, N m].
        pull, length: (...,) of a load between two points: force towards each other [N], and distance [m].
    """

    reaction: Array | None = None
    moment: Array | None = None
    force: Array | None = None
    axes: Array | None = None
    power: Array | None = None
    drive: Array | None = None
    pull: Array | None = None
    length: Array | None = None


# Numbers of materials: (contact, name, value), "" for every contact.
Life = tuple[tuple[str, str, float], ...]


class Bodies(NamedTuple):
    """Lengths of the bodies at a contact; None where they are not known.

    Attributes:
        size: least length of the bodies at the contact, a radius or half a side [m].
        radius: relative radius, 1/R = 1/R_1 + 1/R_2, of bodies that touch at a point of two equal curvatures [m].
        misread: what a penetration says against how the gap was written; "" for nothing.
        mass: largest mass of the bodies at the contact [kg].
    """

    size: float | None = None
    radius: float | None = None
    misread: str = ""
    mass: float | None = None


class Pose(NamedTuple):
    """Where a body is drawn: (..., 3) its origin [m], (..., 3, 3) its axes as columns; a body with members has (k, ...)."""

    place: Array
    axes: Array


class Arrow(NamedTuple):
    """The force of a contact as it is drawn: (..., 3) where it acts [m], (..., 3) the force on ``body`` [N], world axes."""

    point: Array
    force: Array


class Scenery(NamedTuple):
    """What moves in a drawing, in one state.

    Attributes:
        poses: by body.
        ideal: by body, where it would be if every contact just closed without play or penetration; what a viewer
            exaggerates is the difference.
        arrows: by contact; a contact with members has (k, 3).
        offsets: by contact, (3,) marker of its second body in the axes of the first, from the marker of the first [m]; by
            body that slides, (3,) its place in the axes of its parent, from the joint's place.
    """

    poses: dict[str, Pose]
    ideal: dict[str, Pose]
    arrows: dict[str, Arrow]
    offsets: dict[str, Array]


class Flows(NamedTuple):
    """The energy balance in one state.

    Attributes:
        given: by source, power into the system [W].
        taken: by sink, power out of it [W]: loads, friction, damping.
        stored: by store, energy [J].
    """

    given: dict[str, Array]
    taken: dict[str, Array]
    stored: dict[str, Array]


class Chain(NamedTuple):
    """Links in a row and what they bear, for a picture.

    Attributes:
        link: what one is called; links are counted from 1.
        corners: (n + 2, 2) both ends and the links between them [m].
        pushes: (n, 2) forces on the links [N], and what they are.
        loads: by name unit and values (n,).
        walls: (2, m, 2) both sides of what the row lies in [m].
    """

    link: str
    corners: np.ndarray
    pushes: np.ndarray
    pushed: str
    loads: dict[str, tuple[str, np.ndarray]]
    walls: np.ndarray


class Account(NamedTuple):
    """A quantity in one state that changes at a known rate, () or of a body's members (k,).

    Attributes:
        value: momentum [N s], angular momentum [N m s] or energy [J].
        rate: its rate by forces, torques and powers [N, N m, W].
        size: sum of the sizes of the rate's terms, in the same unit.
    """

    value: Array
    rate: Array
    size: Array


class Orbit(NamedTuple):
    """How far the centre of a contact's inner body is from that of its outer one, across the contact's axis.

    Attributes:
        x, y: (T,) [m].
        clearance: radius of the circle within which the bodies do not touch [m].
        what: the two bodies in words, "cage in seat".
        axes: what x and y are called on a picture.
        along: (T,) the same along the axis [m]; None where the bodies cannot move there.
    """

    x: np.ndarray
    y: np.ndarray
    clearance: float
    what: str
    axes: tuple[str, str] = ("x", "y")
    along: np.ndarray | None = None


class Coarser(NamedTuple):
    """A cheaper model of the same thing: its name, the options of the scene file that give it, what it leaves out."""

    name: str
    options: dict[str, Any]
    physics: str


class Choice(NamedTuple):
    """Which level of a model was chosen for a run (``AbstractModel.choose``).

    Attributes:
        fidelity: name of the level.
        budget: force error allowed, a fraction of the peak.
        errors: estimated error of every level that was looked at, cheapest first; infinite or NaN where the level has
            no answer.
        reason: the choice in words.
    """

    fidelity: str
    budget: float
    errors: dict[str, float]
    reason: str


class Variant(NamedTuple):
    """Another choice for the same thing, none of them the truth: its name, changes to a scene file by section, words."""

    name: str
    change: dict[str, dict[str, Any]]
    physics: str
