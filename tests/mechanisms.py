"""Random mechanisms: bodies on joints of every kind, contacts that touch, loads; and their kinematics, written anew."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from bcfj_jax.contact import gaps
from bcfj_jax.mechanism.bodies import GROUND, Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Bush, Force, Gravity, JointSpring, Spring, Torque
from bcfj_jax.mechanism.mechanism import Mechanism

JOINTS = ("slide", "hinge", "planar", "bearing", "particle", "spherical", "free", "sphere", "fixed")
# Gaps with a size that is chosen so that they touch, its name, and how the penetration grows with it.
GAPS: dict[str, tuple[Any, str, float]] = {
    "sphere_on_plane": (gaps.SphereOnPlane((0.6, 0.0, 0.8)), "{}.radius", 1.0),
    "point_on_plane": (gaps.PointOnPlane("-y", clearance=True), "clearance_{}", -1.0),
    "sphere_on_sphere": (gaps.SphereOnSphere(), "{}.radius_a", 1.0),
    "sphere_in_socket": (gaps.SphereInSocket(), "clearance_{}", -1.0),
    "pin_in_bearing": (gaps.PinInBearing(), "clearance_{}", -1.0),
    "pin_with_ends": (gaps.PinInBearing(ends=True), "clearance_{}", -1.0),
    "pin_in_slot": (gaps.PinInSlot("y"), "clearance_{}", -1.0),
    "slider_in_guide": (gaps.SliderInGuide("x"), "clearance_{}", -1.0),
    "two_sided_stop": (gaps.TwoSidedStop("x"), "clearance_{}", -1.0),
}
_SIZES = {"radius": 0.05, "radius_a": 0.05, "radius_b": 0.04, "half_length": 0.03, "half_width": 0.02}
SHARED = {
    "stiffness": 1e4, "exponent": 1.5, "damping": 0.3, "restitution": 0.7, "dashpot": 5.0, "smoothing": 1e-3,
    "friction_static": 0.3, "friction_dynamic": 0.2, "friction_speed": 0.3, "bristle_stiffness": 300.0,
    "bristle_damping": 1.0, "gravity": 9.81,
}  # fmt: skip


def swing(t, p):
    del p
    return 0.3 * jnp.sin(2.0 * t + 0.4)


DRIVES = (
    Drive("function", function=swing), Drive("constant", speed=1.3, start=0.2), Drive("ramp", speed=0.7, over=0.8),
    Drive("table", table=((0.0, 0.3, 0.6, 1.0), (0.0, 0.1, -0.2, 0.3))),
)  # fmt: skip


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
        inertia=inertia if joint == "sphere" or rng.random() < 0.5 else tuple(rng.uniform(0.01, 0.05, 3).tolist()), drive=drive,
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


def contact(i: int, gap: str, bodies: list[Body], rng: np.random.Generator) -> Contact:
    """A random contact of a body with the ground or another body, with a law and friction drawn by chance."""
    names = [GROUND, *(b.name for b in bodies)]
    first, second = (str(x) for x in rng.choice(names, 2, replace=False))
    between = (second, first) if second == GROUND else (first, second)
    law = str(rng.choice(["memory_free", "hertz", "kelvin_voigt", "elasto_gap", "exact"]))
    friction = [None, "brown_mcphee", "coulomb", "step", "lugre"][rng.integers(5)]
    made = GAPS[gap][0]
    values = {name: _SIZES[name] for name in made.needs if name != "clearance"}
    places = tuple(tuple((0.1 * rng.normal(size=3)).tolist()) for _ in range(2))
    return Contact(f"c{i}", between, made, law, friction, smoothing=bool(rng.random() < 0.5), at=places, values=values)


def mechanism(joints: list[str], touching: list[str], seed: int, loaded: bool = True) -> tuple[Mechanism, dict]:
    """A random mechanism whose contacts touch at its start, and its parameters."""
    rng, bodies = np.random.default_rng(seed), []
    for i, joint in enumerate(joints):
        parents = [GROUND, *(b.name for b in bodies if b.joint != "sphere")]
        bodies.append(body(i, joint, parents, rng))
    contacts = [contact(i, gap, bodies, rng) for i, gap in enumerate(touching)]
    made = Mechanism("random", bodies, contacts, loads(bodies, rng) if loaded else (), end=0.5, samples=501)
    params = made.parameters({name: x for name, x in SHARED.items() if name in made.quantities})
    return made, touched(made, params, touching, rng)


def touched(made: Mechanism, params: dict, touching: list[str], rng: np.random.Generator) -> dict:
    """Parameters with which every contact is some 10 mm deep at time 0."""
    sizes = {
        c.name: (GAPS[gap][1].format(c.name), GAPS[gap][2]) for c, gap in zip(made.contacts, touching, strict=True)
    }
    params = params | {name: jnp.asarray(1.0) for name, _ in sizes.values()}
    faces = made.instant(jnp.zeros(()), made.initial_state(params), params, laws=False).faces
    for contact, (name, way) in sizes.items():
        deepest = max(float(np.max(np.asarray(face.depth))) for face, _ in faces[contact])
        params[name] = jnp.asarray(1.0 + way * (rng.uniform(2e-3, 2e-2) - deepest))
    return params


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
