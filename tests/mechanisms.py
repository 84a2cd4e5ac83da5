"""Random mechanisms: bodies on joints of every kind, contacts that touch, loads; and their kinematics, written anew."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from bcfj_jax.contact import gaps
from bcfj_jax.mechanism.bodies import GROUND, Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Bush, Coupling, Force, Gravity, JointFriction, JointSpring, Spring, Torque
from bcfj_jax.mechanism.mechanism import Mechanism

JOINTS = ("slide", "hinge", "planar", "bearing", "particle", "spherical", "free", "sphere", "fixed")
GAPS: dict[str, Any] = {
    "sphere_on_plane": gaps.SphereOnPlane((0.6, 0.0, 0.8)),
    "point_on_plane": gaps.PointOnPlane("-y", clearance=True),
    "box_on_plane": gaps.BoxOnPlane("-y", clearance=True),
    "sphere_on_sphere": gaps.SphereOnSphere(),
    "sphere_in_socket": gaps.SphereInSocket(),
    "pin_in_bearing": gaps.PinInBearing(),
    "pin_with_ends": gaps.PinInBearing(ends=True),
    "pin_in_slot": gaps.PinInSlot("y"),
    "slider_in_guide": gaps.SliderInGuide("x"),
    "two_sided_stop": gaps.TwoSidedStop("x"),
    "capsule_on_plane": gaps.CapsuleOnPlane("-y", clearance=True),
    "cylinder_on_plane": gaps.CylinderOnPlane("-y", clearance=True),
    "capsule_on_capsule": gaps.CapsuleOnCapsule(),
    "sphere_on_box": gaps.SphereOnBox(),
    "sphere_on_wedge": gaps.SphereOnWedge(),
    "pin_in_pads": gaps.PinInBearing(pads=4),
    "points_on_box": gaps.SphereOnBox(points=((0.02, 0.0, 0.0), (-0.02, 0.01, 0.0), (0.0, 0.0, 0.03))),
    "rods_on_edges": gaps.CapsuleOnCapsule(edges_a=(0.05, 0.04, 0.03), edges_b=((0.0, 0.0, -0.05, 0.01, 0.0, 0.05),)),
}
# Whose second body has directions.
_LONG = (
    "pin_with_ends",
    "slider_in_guide",
    "box_on_plane",
    "capsule_on_plane",
    "cylinder_on_plane",
    "capsule_on_capsule",
    "points_on_box",
    "rods_on_edges",
)
_SIZES = {
    "radius": 0.05, "radius_a": 0.05, "radius_b": 0.04, "half_length": 0.03, "half_width": 0.02, "half_height": 0.025,
    "clearance": 0.01, "half_length_a": 0.05, "half_length_b": 0.03, "half_angle": 0.6,
}  # fmt: skip
SHARED = {
    "stiffness": 1e4, "exponent": 1.5, "damping": 0.3, "restitution": 0.7, "dashpot": 5.0, "smoothing": 1e-3,
    "friction_static": 0.3, "friction_dynamic": 0.2, "friction_speed": 0.3, "bristle_stiffness": 300.0,
    "bristle_damping": 1.0, "gravity": 9.81, "relaxation": 0.4, "relaxation_time": 0.1, "yield_penetration": 2e-3,
    "rolling_length": 5e-3, "drilling_length": 3e-3, "spin_speed": 0.5,
}  # fmt: skip

LAWS = (
    "memory_free", "hertz", "kelvin_voigt", "elasto_gap", "exact", "standard_linear_solid", "walton_braun", "thornton",
)  # fmt: skip


def swing(t, p):
    del p
    return 0.3 * jnp.sin(2.0 * t + 0.4)


DRIVES = (
    Drive("function", function=swing), Drive("constant", speed=1.3, start=0.2), Drive("ramp", speed=0.7, over=0.8),
    Drive("table", table=((0.0, 0.3, 0.6, 1.0), (0.0, 0.1, -0.2, 0.3))),
)  # fmt: skip


def moments(rng: np.random.Generator) -> tuple[float, ...]:
    """Principal moments of inertia that a body can have: of three point masses on each axis."""
    x, y, z = rng.uniform(0.005, 0.025, 3).tolist()
    return y + z, z + x, x + y


def body(i: int, joint: str, parents: list[str], rng: np.random.Generator) -> Body:
    """A random body; a sphere is the end of its branch, for its attitude is not known."""
    three = lambda size: tuple((size * rng.normal(size=3)).tolist())  # noqa: E731
    alone = joint in ("slide", "hinge")
    axis = three(1.0) if alone and rng.random() < 0.5 else str(rng.choice(["x", "y", "z"]))
    drive = DRIVES[rng.integers(len(DRIVES))] if alone and rng.random() < 0.3 else None
    inertia = float(rng.uniform(0.01, 0.05))
    made = Body(
        f"b{i}", joint, parents[rng.integers(len(parents))], three(0.3), axis,
        tilt=(three(1.0), float(rng.normal())) if rng.random() < 0.5 else None,
        center=(0.0, 0.0, 0.0) if joint == "sphere" else three(0.1), mass=float(rng.uniform(0.5, 2.0)),
        inertia=inertia if joint == "sphere" or rng.random() < 0.5 else moments(rng), drive=drive,
    )  # fmt: skip
    start = {key: float(0.3 * rng.normal()) for key in (*made.coordinates, *made.rates)}
    if "q0" in start:
        start["q0"] = 1.0
    return Body(
        made.name, joint, made.parent, made.at, axis, made.tilt, made.center, made.mass, made.inertia, start, drive
    )


def loads(bodies: list[Body], rng: np.random.Generator) -> list[Any]:
    """Gravity and one of each other load, on bodies drawn by chance."""
    pick = lambda: str(rng.choice([b.name for b in bodies]))  # noqa: E731
    three = lambda size: tuple((size * rng.normal(size=3)).tolist())  # noqa: E731
    pair = lambda: (GROUND, pick())  # noqa: E731
    found: list[Any] = [
        Gravity(three(1.0)), Force("push", pick(), three(1.0), 3.0, three(0.1), ramp=1.0),
        Force("thrust", pick(), three(1.0), 2.0, three(0.1), follows=True), Torque("twist", pick(), three(1.0), 0.5),
        Spring("spring", pair(), 50.0, 2.0, 0.1, (three(0.5), three(0.1))),
        Bush("bush", pair(), 40.0, 1.0, 0.2, (three(0.5), three(0.1))),
    ]  # fmt: skip
    single = [b.name for b in bodies if len(b.rates) == 1]
    return found + ([JointSpring("coil", single[0], 5.0, 0.3, 0.2)] if single else [])


def newest(bodies: list[Body], rng: np.random.Generator) -> list[Body]:
    """A cross without mass and what hangs on it, a universal joint, and a screw's two joints, which ``couplings`` tie."""
    start = lambda *names: {name: float(0.3 * rng.normal()) for name in names}  # noqa: E731
    turned = (tuple(rng.normal(size=3).tolist()), float(rng.normal()))
    parent = str(rng.choice([GROUND, *(b.name for b in bodies if b.joint != "sphere")]))
    both = start("first", "second", "first_speed", "second_speed")
    return [
        Body("cross", "hinge", parent, axis="x", tilt=turned, mass=0, start=start("angle", "speed")),
        Body("shaft", "hinge", "cross", axis="y", center=(0.1, 0.02, 0.0), mass=0.8, inertia=moments(rng),
             start=start("angle", "speed")),
        Body("yoke", "universal", center=(0.0, 0.05, 0.1), mass=1.1, inertia=(0.02, 0.03, 0.025, 1e-3, -2e-3, 1e-3), start=both),
        Body("screw", "hinge", "yoke", axis="x", mass=0.4, inertia=moments(rng), start=start("angle", "speed")),
        Body("nut", "slide", axis="y", mass=0.6, start=start("position", "velocity")),
    ]  # fmt: skip


def couplings(rng: np.random.Generator) -> list[Any]:
    """Loads of the bodies of ``newest``: couplings, tables, one-sided springs, a bush along and about its axes, dry friction."""
    three = lambda size: tuple((size * rng.normal(size=3)).tolist())  # noqa: E731
    table = ((-0.5, -0.1, 0.2, 0.6), (-20.0, -3.0, 4.0, 30.0))
    return [
        Coupling("thread", ("screw", "nut"), 0.3, 80.0, 1.0, backlash=0.05),
        Coupling("gears", ("shaft", "cross"), -1.7, 9.0, 0.2),
        Spring("cable", ("nut", "yoke"), 60.0, 3.0, 0.2, (three(0.3), three(0.3)), side="pull"),
        Spring("bump", ("ground", "yoke"), at=(three(0.3), three(0.3)), free_length=2.0, table=table, side="push"),
        Spring("progressive", ("ground", "shaft"), at=(three(0.3), three(0.3)), free_length=0.2, damping=1.0, table=table),
        Bush("mount", ("shaft", "yoke"), (40.0, 30.0, 0.0), (1.0, 0.5, 0.2), (0.1, 0.2, 0.0), (three(0.3), three(0.1)),
             (3.0, 2.0, 1.0)),
        JointSpring("stop", "nut", 90.0, 4.0, 0.1, side="push"), JointFriction("seal", "screw", 0.4, 0.3),
    ]  # fmt: skip


def apart(gap: str, depth: float, turned: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """From the first marker to the second, in the first body's axes, for a penetration [m].

    ``turned``: the second body's axes in the first's, as columns.
    """
    p, way, play = 0.02 * rng.normal(size=3), rng.normal(size=3), _SIZES["clearance"] + depth
    if gap == "sphere_on_plane":
        e = np.array([0.6, 0.0, 0.8])
        return p + (_SIZES["radius"] - depth - p @ e) * e
    if gap in ("sphere_on_sphere", "sphere_in_socket"):
        reach = play if gap == "sphere_in_socket" else _SIZES["radius_a"] + _SIZES["radius_b"] - depth
        return reach * way / np.linalg.norm(way)
    if gap in ("capsule_on_plane", "cylinder_on_plane"):
        long, wide = abs(turned[1, 2]), np.sqrt(1.0 - turned[1, 2] ** 2) if gap == "cylinder_on_plane" else 1.0
        return np.array([p[0], play - _SIZES["half_length"] * long - _SIZES["radius"] * wide, p[2]])
    if gap == "capsule_on_capsule":
        side = np.cross([0.0, 0.0, 1.0], turned[:, 2])
        side = side if np.any(side) else np.array([1.0, 0.0, 0.0])
        return (_SIZES["radius_a"] + _SIZES["radius_b"] - depth) * side / np.linalg.norm(side) + [0.0, 0.0, 0.01]
    if gap == "sphere_on_box":
        half = np.array([_SIZES[f"half_{k}"] for k in ("length", "width", "height")])
        return half * np.sign(way) + (_SIZES["radius"] - depth) * way / np.linalg.norm(way)
    if gap == "points_on_box":
        # The second point of b is over a's middle.
        return np.array([0.0, 0.0, _SIZES["half_height"] + _SIZES["radius"] - depth]) - turned @ [-0.02, 0.01, 0.0]
    if gap == "rods_on_edges":
        # Over the edge of a along x, at +y and +z.
        side = np.cross([1.0, 0.0, 0.0], turned @ [0.01, 0.0, 0.1])
        side *= np.sign(side[1] + side[2]) * (_SIZES["radius_a"] + _SIZES["radius_b"] - depth) / np.linalg.norm(side)
        return side + [0.0, 0.04, 0.03] - turned @ [5e-3, 0.0, 0.0]
    if gap == "sphere_on_wedge":
        return np.array([0.01, _SIZES["radius"] - depth, p[2]])
    if gap in ("pin_in_bearing", "pin_with_ends", "pin_in_pads"):
        return np.array([*(play * way[:2] / np.linalg.norm(way[:2])), p[2]])
    if gap == "box_on_plane":
        reach = np.abs(turned[1]) @ [_SIZES[f"half_{k}"] for k in ("length", "width", "height")]
        return np.array([p[0], play - reach, p[2]])
    if gap == "slider_in_guide":
        corners = turned @ np.array([[-0.03, 0.03], [0.02, 0.02], [0.0, 0.0]])
        return np.array([p[0], 0.02 + play - corners[1].max(), p[2]])
    p[1 if gap == "point_on_plane" else 0] = play
    return p


def contact(
    i: int, gap: str, bodies: list[Body], parts: Any, rng: np.random.Generator, rolling: bool = False
) -> Contact | None:
    """A random contact that touches, of a law and friction drawn by chance; None where no body fits."""
    round_ = [b.name for b in bodies if b.joint == "sphere"]
    names = [GROUND, *(b.name for b in bodies if b.name not in round_)]
    # A sphere's marker is its centre; what has directions is on the other body.
    others = [*names[1:], *(round_ if gap not in _LONG else [])]
    if not others:
        return None
    second = str(rng.choice(others))
    first = str(rng.choice([name for name in names if name != second]))
    law = str(rng.choice(LAWS))
    friction = [None, "brown_mcphee", "coulomb", "step", "lugre"][rng.integers(5)]
    values = {name: _SIZES[name] for name in GAPS[gap].needs}
    if gap == "pin_in_pads":
        values["clearance"] = -5e-3
    ours = np.zeros(3) if second in round_ else 0.1 * rng.normal(size=3)
    (axes, place), (other, origin) = (
        (np.array(parts[name].axes, float).T, np.array(parts[name].place, float)) for name in (first, second)
    )
    way = apart(gap, rng.uniform(2e-3, 2e-2), axes.T @ other, rng)
    theirs = axes.T @ (origin + other @ ours - place) - way
    return Contact(
        f"c{i}", (first, second), GAPS[gap], law, friction, smoothing=bool(rng.random() < 0.5),
        at=(tuple(theirs.tolist()), tuple(ours.tolist())), values=values, rolling=rolling and bool(rng.random() < 0.7),
    )  # fmt: skip


def mechanism(
    joints: list[str], touching: list[str], seed: int, loaded: bool = True, more: bool = False
) -> tuple[Mechanism, dict]:
    """A random mechanism whose contacts are some 10 mm deep at its start, and its parameters; ``more``: with ``newest``."""
    rng, bodies = np.random.default_rng(seed), []
    for i, joint in enumerate(joints):
        parents = [GROUND, *(b.name for b in bodies if b.joint != "sphere")]
        bodies.append(body(i, joint, parents, rng))
    bodies += newest(bodies, rng) if more else []
    bare = Mechanism("bare", bodies)
    known = bare.parameters()
    parts = bare.instant(jnp.zeros(()), bare.initial_state(known), known).bodies.parts
    drawn = [contact(i, gap, bodies, parts, rng, more) for i, gap in enumerate(touching)]
    contacts = [c for c in drawn if c is not None]
    acting = loads(bodies, rng) if loaded else []
    made = Mechanism("random", bodies, contacts, acting + (couplings(rng) if more else []), end=0.5, samples=501)
    return made, made.parameters({name: x for name, x in SHARED.items() if name in made.quantities})


# Kinematics, independent of the package: matrices, and a rotation vector on top of each attitude.


def _skew(v):
    return jnp.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _turn(axis, angle):
    """Rotation matrix about a unit vector (Euler and Rodrigues)."""
    k = _skew(axis)
    return jnp.eye(3) + jnp.sin(angle) * k + (1.0 - jnp.cos(angle)) * (k @ k)


def _small(v):
    """Rotation by a vector, to its third order."""
    k = _skew(v)
    return jnp.eye(3) + k + k @ k / 2.0 + k @ k @ k / 6.0


def _unit(axis):
    if isinstance(axis, str):
        return jnp.eye(3)["xyz".index(axis)]
    return jnp.asarray(axis) / np.linalg.norm(axis)


def _attitude(q):
    w, x, y, z = np.asarray(q) / np.linalg.norm(q)
    half = _skew(jnp.array([x, y, z]))
    return jnp.eye(3) + 2.0 * w * half + 2.0 * half @ half


def poses(bodies: tuple[Body, ...], x, t, params) -> dict[str, tuple[Any, Any]]:
    """Rotation matrix and origin by body, of displacements x (n,), one a velocity; small ones of attitudes."""
    found, at = {GROUND: (jnp.eye(3), jnp.zeros(3))}, 0
    letters = {"x": "yzx", "y": "zxy", "z": "xyz"}
    for b in bodies:
        turn, place = found[b.parent]
        place = place + turn @ jnp.asarray(b.at)
        if b.tilt is not None:
            turn = turn @ _turn(_unit(b.tilt[0]), b.tilt[1])
        own = [x[at + k] for k in range(len(b.rates))]
        at += len(own)
        if b.joint in ("slide", "hinge"):
            way = b.drive.position(t, b.name, params) if b.drive else own[0]
            if b.joint == "slide":
                place = place + turn @ _unit(b.axis) * way
            else:
                turn = turn @ _turn(_unit(b.axis), way)
        elif b.joint != "fixed":
            ways = [_unit(letter) for letter in letters[b.axis]]
            slides = {"planar": 2, "bearing": 3, "particle": 3, "free": 3, "sphere": 3}.get(b.joint, 0)
            for k in range(slides):
                place = place + turn @ ways[k] * own[k]
            if b.joint in ("planar", "bearing"):
                turn = turn @ _turn(ways[2], own[slides])
            elif b.joint != "particle":
                start = dict(b.start)
                first = _attitude([start[f"q{k}"] for k in range(4)]) if b.joint != "sphere" else jnp.eye(3)
                turn = turn @ _small(jnp.stack(own[slides:])) @ first
        found[b.name] = (turn, place)
    return found
