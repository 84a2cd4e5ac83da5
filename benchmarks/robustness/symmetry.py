"""Does it matter which body is written first, or on which side of a mirror a machine stands? It must not.

Machines have contacts of several gaps, friction laws and normal laws between bodies of every kind: driven, turning, sliding,
free, and a base that holds them all. Each is run three times over its first contacts: as it is; with the two bodies of every
contact exchanged and its gap with them (``Exchanged``); and as its image in a mirror. Places, masses and speeds are drawn;
few programs are compiled. Runge and Kutta's method of order 4 with a fixed step integrates all alike, so that what differs is
the equations of motion. Compared are all forces, and slips, over the largest.

    python -m benchmarks.robustness.symmetry [--draws N]     symmetry.json
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact import gaps
from bcfj_jax.contact.friction import FRICTION
from bcfj_jax.contact.gaps import AbstractGap, Coefficients, Face, Frame
from bcfj_jax.core.vectors import Vector, add, negative, subtract
from bcfj_jax.mechanism.bodies import GROUND, Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from benchmarks.common import options, save

LIMIT = 1e-9
SIZES = {
    "radius": 0.05, "radius_a": 0.05, "radius_b": 0.04, "half_length": 0.004, "half_width": 0.003, "half_height": 0.002,
    "clearance": 0.01, "ball_radius": 0.008, "pitch_radius": 0.0355, "offset": 0.0045, "contact_angle": 0.7, "conformity": 0.53,
    "cam_radius": 0.03, "throw": 0.005, "half_length_a": 0.03, "half_length_b": 0.02, "half_angle": 0.6,
    "half_width_a": 0.025, "half_height_a": 0.02, "half_width_b": 0.015, "half_height_b": 0.01, "rounding": 0.004,
}  # fmt: skip
SHARED = {
    "stiffness": 1e7, "exponent": 1.5, "damping": 0.05, "restitution": 0.7, "smoothing": 1e-5, "friction_static": 0.3,
    "friction_dynamic": 0.2, "friction_speed": 3.0, "bristle_stiffness": 3e3, "bristle_damping": 0.1,
    "friction_memory": 1e-3, "friction_viscous": 0.02, "relaxation": 0.4, "relaxation_time": 1e-3,
}  # fmt: skip
# No friction, and every friction law; normal laws without and with a state. An approach speed that is remembered settles at
# rates that no fixed step can follow, and so does friction of a small ``friction_speed`` at the end of a long arm.
RUBS = (None, *FRICTION)
LAWS = ("memory_free", "hertz", "standard_linear_solid")
# (first, second) of every contact: of what holds them all, the ground or a base that is turned, and of each other.
PAIRS = (
    ("base", "wheel"), ("wheel", "slider"), ("slider", "ball"), ("ball", "rocker"), ("rocker", "slider"),
    ("wheel", "ball"), ("slider", "base"),
)  # fmt: skip


def cam(r: Array, c: Coefficients) -> Array:
    """Overlap of a point with a round cam whose centre is off its axis, on y."""
    return c["cam_radius"] - jnp.hypot(r[0], r[1] - c["throw"])


GAPS: dict[str, AbstractGap] = {
    "point_on_plane": gaps.PointOnPlane("-y", clearance=True),
    "sphere_on_plane": gaps.SphereOnPlane((0.6, 0.8, 0.0)),
    "sphere_on_sphere": gaps.SphereOnSphere(),
    "sphere_in_socket": gaps.SphereInSocket(),
    "pin_in_bearing": gaps.PinInBearing(),
    "pin_with_ends": gaps.PinInBearing(ends=True),
    "pin_in_slot": gaps.PinInSlot("y"),
    "slider_in_guide": gaps.SliderInGuide("x"),
    "two_sided_stop": gaps.TwoSidedStop("x"),
    "ball_between_planes": gaps.BallBetweenPlanes("x"),
    "ball_in_groove": gaps.BallInGroove(),
    "ball_in_round_groove": gaps.BallInGroove(side="inner", section="circular"),
    "from_depth": gaps.from_depth(cam, ("cam_radius", "throw")),
    "box_on_plane": gaps.BoxOnPlane("-y", clearance=True),
    "capsule_on_plane": gaps.CapsuleOnPlane("-y", clearance=True),
    "cylinder_on_plane": gaps.CylinderOnPlane("-y", clearance=True),
    "capsule_on_capsule": gaps.CapsuleOnCapsule(),
    "sphere_on_box": gaps.SphereOnBox(),
    "sphere_on_wedge": gaps.SphereOnWedge(),
    "box_on_box": gaps.BoxOnBox(),
}
# Where each member is in the mirror: corners at the back are at the front.
_EDGES = [0, 1, 2, 3, 6, 7, 4, 5, 10, 11, 8, 9]
FACING = {
    "slider_in_guide": [1, 0, 3, 2],
    "box_on_plane": [4, 5, 6, 7, 0, 1, 2, 3],
    "box_on_box": [
        4,
        5,
        6,
        7,
        0,
        1,
        2,
        3,
        12,
        13,
        14,
        15,
        8,
        9,
        10,
        11,
        *(16 + 12 * i + k for i in _EDGES for k in _EDGES),
    ],
}
PLANAR = ("point_on_plane", "sphere_on_sphere", "pin_in_bearing", "pin_in_slot", "slider_in_guide", "from_depth")


class Exchanged(AbstractGap):
    """A gap with its bodies exchanged: what the other has on its first body is here on the second."""

    gap: AbstractGap

    @property
    def needs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The other's."""
        return self.gap.needs

    @property
    def members(self) -> int:
        """The other's."""
        return self.gap.members

    @property
    def signed(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The other's."""
        return self.gap.signed

    def faces(self, a: Frame, b: Frame, c: Coefficients) -> tuple[Face, ...]:
        """The same points in space."""
        moved = subtract(a.place, b.place)
        return tuple(
            face._replace(normal=negative(face.normal), lever=add(moved, face.lever))
            for face in self.gap.faces(b, a, c)
        )

    def carried(self, a: Vector, b: Vector) -> Vector:
        """The other's."""
        return self.gap.carried(b, a)

    def axial(self, a: Frame, b: Frame, c: Coefficients) -> Vector:
        """The other's, backwards: so is the force."""
        return negative(self.gap.axial(b, a, c))


def image(gap: AbstractGap) -> AbstractGap:
    """A gap of markers whose x axes are reflected: what points along x points backwards.

    Walls of slots and guides lie across z x axis, which is backwards itself.
    """
    if isinstance(gap, gaps.FromDepth):
        return gaps.from_depth(_reflected(gap.function), gap.reads)
    if not hasattr(gap, "axis"):
        return gap
    sign = -1.0 if isinstance(gap, (gaps.PinInSlot, gaps.SliderInGuide)) else 1.0
    way: Any = gap.axis  # pyright: ignore[reportAttributeAccessIssue]
    return dataclasses.replace(gap, axis=tuple(sign * x for x in reflected(way)))  # pyright: ignore[reportCallIssue]


@functools.cache
def _reflected(function: Any) -> Any:
    return lambda r, c: function(r * jnp.array(MIRROR), c)


MIRROR = (-1.0, 1.0, 1.0)


def reflected(v: Any) -> tuple[float, float, float]:
    """Image of a vector."""
    x, y, z = (float(m * x) + 0.0 for m, x in zip(MIRROR, v, strict=True))
    return x, y, z


# --- machines


# By joint: coordinates, then velocities, whose images have the other sign.
_BACKWARDS = {
    "fixed": (), "slide": (), "hinge": ("angle", "speed"), "planar": ("x", "angle", "vx", "speed"),
    "free": ("x", "q2", "q3", "vx", "wy", "wz"),
}  # fmt: skip


def rotation(axis: Any, angle: float) -> np.ndarray:
    """Matrix of a rotation (Euler and Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


def attitude(q: Any) -> np.ndarray:
    """Matrix of a quaternion of length 1 and more, scalar first."""
    scalar, vector = q[0], np.array(q[1:])
    return rotation(vector, 2.0 * np.arctan2(np.linalg.norm(vector), scalar)) if np.any(vector) else np.eye(3)


def bodies(rng: np.random.Generator, still: np.random.Generator, planar: bool, turned: float) -> list[Body]:
    """A base that is turned, and what moves on it: numbers by ``rng``, directions of axes by ``still``."""
    flat = np.array([1.0, 1.0, 0.0 if planar else 1.0])
    three = lambda rng, size: tuple((size * flat * rng.normal(size=3)).tolist())  # noqa: E731
    own: Any = lambda: {"mass": float(rng.uniform(0.5, 2.0)), "inertia": float(rng.uniform(2e-3, 8e-3))}  # noqa: E731
    axis = lambda: "z" if planar else three(still, 1.0)  # noqa: E731
    lean = ("z" if planar else three(still, 1.0), turned)
    free = "planar" if planar else "free"
    ball = {
        k: float(0.2 * rng.normal()) for k in (("x", "y", "angle") if planar else ("x", "y", "z", "q1", "q2", "q3"))
    }
    rates = ("vx", "vy") if planar else ("vx", "vy", "vz")
    spins = ("speed",) if planar else ("wx", "wy", "wz")
    ball |= {k: float(0.5 * rng.normal()) for k in rates} | {k: float(5.0 * rng.normal()) for k in spins}
    if not planar:
        ball["q0"] = 1.0
    hinged = {"angle": float(rng.normal()), "speed": float(5.0 * rng.normal())}
    slid = {"position": float(0.1 * rng.normal()), "velocity": float(0.5 * rng.normal())}
    drive = Drive("constant", speed=float(8.0 * rng.normal()), start=float(rng.normal()))
    return [
        Body("base", "fixed", at=three(rng, 0.3), tilt=lean, **own()),
        Body("wheel", "hinge", "base", three(rng, 0.3), axis(), drive=drive, **own()),
        Body("rocker", "hinge", "base", three(rng, 0.3), axis(), center=three(rng, 0.05), start=hinged, **own()),
        Body("slider", "slide", "base", three(rng, 0.3), "x" if planar else three(still, 1.0), start=slid, **own()),
        Body("ball", free, "base", three(rng, 0.3), center=three(rng, 0.02), start=ball, **own()),
    ]


def poses(made: Sequence[Any]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Axes as columns, and place, of every body at the start."""
    found = {GROUND: (np.eye(3), np.zeros(3))}
    for b in made:
        turn, place = found[b.parent]
        place, start = place + turn @ np.array(b.at), dict(b.start)
        if b.tilt is not None:
            turn = turn @ rotation(_way(b.tilt[0]), b.tilt[1])
        way = _way(b.axis)
        if b.joint == "slide":
            place = place + turn @ way * start["position"]
        elif b.joint == "hinge":
            turn = turn @ rotation(way, b.drive.start if b.drive else start["angle"])
        elif b.joint != "fixed":
            place = place + turn @ np.array([start.get(k, 0.0) for k in "xyz"])
            turn = turn @ (
                rotation(way, start["angle"]) if b.joint == "planar" else attitude([start[f"q{k}"] for k in range(4)])
            )
        found[b.name] = turn, place
    return found


def _way(axis: Any) -> np.ndarray:
    return np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else np.asarray(axis) / np.linalg.norm(axis)


def apart(name: str, depth: float, turned: np.ndarray, planar: bool, rng: np.random.Generator) -> np.ndarray:
    """From the first marker to the second, in the first body's axes, for a penetration [m].

    ``turned``: the second body's axes in the first's, as columns.
    """
    flat = np.array([1.0, 1.0, 0.0 if planar else 1.0])
    p, way, play = 0.02 * flat * rng.normal(size=3), flat * rng.normal(size=3), SIZES["clearance"] + depth
    way, around = way / np.linalg.norm(way), way[:2] / np.linalg.norm(way[:2])
    if name == "sphere_on_plane":
        e = np.array([0.6, 0.8, 0.0])
        return p + (SIZES["radius"] - depth - p @ e) * e
    if name == "sphere_on_sphere":
        return (SIZES["radius_a"] + SIZES["radius_b"] - depth) * way
    if name == "sphere_in_socket":
        return play * way
    if name == "pin_in_bearing":
        return np.array([*(play * around), p[2]])
    if name == "pin_with_ends":
        return np.array([*(play * around - SIZES["half_length"] * turned[:2, 2]), p[2]])
    if name == "from_depth":
        return np.array([*((SIZES["cam_radius"] - depth) * around + [0.0, SIZES["throw"]]), p[2]])
    if name == "box_on_plane":
        reach = np.abs(turned[1]) @ [SIZES[f"half_{k}"] for k in ("length", "width", "height")]
        return np.array([p[0], play - reach, p[2]])
    if name in ("capsule_on_plane", "cylinder_on_plane"):
        tall, long = turned[1, 2], SIZES["half_length"] * abs(turned[1, 2])
        wide = SIZES["radius"] * (np.sqrt(1.0 - tall**2) if name == "cylinder_on_plane" else 1.0)
        return np.array([p[0], play - long - wide, p[2]])
    if name == "capsule_on_capsule":
        # Between points of their segments, across both, or off their ends.
        side, reach = np.cross([0.0, 0.0, 1.0], turned[:, 2]), SIZES["radius_a"] + SIZES["radius_b"] - depth
        side = side / np.linalg.norm(side) if np.any(side) else np.array([1.0, 0.0, 0.0])
        return np.array([0.0, 0.0, 0.01]) - 0.005 * turned[:, 2] + reach * side
    if name == "sphere_on_box":
        half = np.array([SIZES[f"half_{k}"] for k in ("length", "width", "height")])
        return half * np.sign(way) + (SIZES["radius"] - depth) * way
    if name == "box_on_box":
        # The lowest corner of b over a's face, a little beside its middle.
        inner = np.array([SIZES[f"half_{k}_b"] for k in ("length", "width", "height")]) - SIZES["rounding"]
        low = -np.sign(turned[1]) * inner
        return np.array([0.004, SIZES["half_width_a"] + SIZES["rounding"] - depth, -0.003]) - turned @ low
    if name == "sphere_on_wedge":
        out, aside = np.sin(SIZES["half_angle"]), np.cos(SIZES["half_angle"])
        along, normal = np.array([out, -aside, 0.0]), np.array([aside, out, 0.0])
        return abs(p[0]) * along + (SIZES["radius"] - depth) * normal + np.array([0.0, 0.0, p[2]])
    if name == "slider_in_guide":
        # So small a block that it meets one wall, however it is turned.
        long, wide = SIZES["half_length"], SIZES["half_width"]
        corners = turned @ np.array([[-long, long], [wide, wide], [0.0, 0.0]])
        return np.array([p[0], wide + play - corners[1].max(), p[2]])
    if "groove" in name:
        outer, gothic = name == "ball_in_groove", name == "ball_in_groove"
        centre, turn = np.array([0.0, 0.0, SIZES["offset"] * (1 if outer else -1)]), rng.uniform(-0.5, 0.5)
        angle = SIZES["contact_angle"] if gothic else rng.uniform(0.0, 6.0)
        radial = np.array([np.cos(turn), 0.0, np.sin(turn)])
        reach = np.hypot(SIZES["pitch_radius"], SIZES["offset"]) + play * np.cos(angle)
        return centre + reach * radial + np.array([0.0, play * np.sin(angle), 0.0])
    p[1 if name == "point_on_plane" else 0] = play if name == "point_on_plane" or rng.random() < 0.5 else -play
    return p


def machine(
    names: Sequence[str],
    planar: bool = False,
    seed: int = 0,
    exchanged: bool = False,
    mirrored: bool = False,
    turned: float = 0.0,
    depth: tuple[float, float] = (-2e-5, 1e-4),
    roll: int = 0,
) -> Mechanism:
    """A machine of so many contacts, between bodies of every kind; the friction of each is another law.

    Args:
        names: of the gaps in ``GAPS``; planar: whether all moves in the plane of x and y.
        seed: of its numbers; directions of axes are the same for all.
        exchanged, mirrored: whether bodies of every contact are exchanged, and whether it is the image of itself.
        turned: by how much the whole is turned [rad].
        depth: least and greatest penetration at the start [m].
        roll: friction laws, normal laws and pairs of bodies are dealt out from this one on.
    """
    rng, still = np.random.default_rng(seed), np.random.default_rng(7)
    made, contacts = bodies(rng, still, planar, turned), []
    # Markers do not know how the whole is turned.
    straight = poses([dataclasses.replace(made[0], tilt=(made[0].tilt[0], 0.0)), *made[1:]])  # pyright: ignore
    for k, name in enumerate(names):
        pair, gap = PAIRS[(2 * k + roll) % len(PAIRS)], GAPS[name]
        values = {key: SIZES[key] for key in gap.needs}
        (axes, place), (other, origin) = (straight[b] for b in pair)
        ours = 0.05 * np.array([1.0, 1.0, 0.0 if planar else 1.0]) * rng.normal(size=3)
        way = apart(name, rng.uniform(*depth), axes.T @ other, planar, rng)
        theirs = axes.T @ (origin + other @ ours - place) - way
        if planar:
            theirs[2] = 0.0
        at, own = [tuple(theirs.tolist()), tuple(ours.tolist())], image(gap) if mirrored else gap
        if mirrored:
            at = [reflected(x) for x in at]
        if exchanged:
            pair, at, own = pair[::-1], at[::-1], Exchanged(own)
        law, rub = LAWS[(k + roll) % len(LAWS)], RUBS[(k + roll) % len(RUBS)]
        contacts.append(Contact(f"c{k}", pair, own, law, rub, at=(at[0], at[1]), values=values))
    if mirrored:
        made = [_image(b) for b in made]
    read = {key for c in contacts for key in c.reads}
    return Mechanism("machine", made, contacts, given={k: x for k, x in SHARED.items() if k in read}, end=1e-3)


def _image(b: Any) -> Body:
    back = _BACKWARDS[b.joint]
    start = {key: -x if key in back else x for key, x in b.start}
    tilt = None if b.tilt is None else (reflected(_way(b.tilt[0])), -b.tilt[1])
    drive = b.drive
    if drive is not None:
        drive = dataclasses.replace(drive, speed=-drive.speed, start=-drive.start)
    axis = b.axis if isinstance(b.axis, str) and b.axis == "z" else reflected(_way(b.axis))
    return dataclasses.replace(
        b, at=reflected(b.at), center=reflected(b.center), axis=axis, tilt=tilt, start=tuple(start.items()), drive=drive
    )


# --- runs


class Seen(NamedTuple):
    """What contacts do, members side by side: (..., n, 3) force on the second body [N], (..., n) normal force [N], slip [m/s]."""

    force: Array
    normal: Array
    slip: Array


def seen(scene: Mechanism, t: Any, y: Array, p: Any) -> Seen:
    """One instant."""
    now = scene.observe(t, y, p).values()
    return Seen(
        jnp.concatenate([jnp.reshape(jnp.asarray(r.world), (-1, 3)) for r in now]),
        jnp.concatenate([jnp.ravel(r.force[..., 0]) for r in now]),
        jnp.concatenate([jnp.ravel(jnp.zeros_like(r.rate) if r.slip is None else r.slip) for r in now]),
    )


@functools.partial(jax.jit, static_argnums=(0, 2, 3))
def runs(scene: Mechanism, params: Any, end: float, steps: int) -> Seen:
    """(draws, steps, ...) of runs from the start, by Runge and Kutta's method of order 4."""

    def one(p: Any) -> Seen:
        h = end / steps

        def step(y: Array, t: Array) -> tuple[Array, Seen]:
            def stage(carry: tuple[Array, Array], share: Array) -> tuple[tuple[Array, Array], None]:
                gained, slope = carry
                reach, weight = share
                slope = scene.vector_field(t + reach * h, y + reach * h * slope, p)
                return (gained + weight * h * slope, slope), None

            shares = jnp.array([[0.0, 1 / 6], [0.5, 1 / 3], [0.5, 1 / 3], [1.0, 1 / 6]])
            (gained, _), _ = jax.lax.scan(stage, (jnp.zeros_like(y), jnp.zeros_like(y)), shares)
            return y + gained, seen(scene, t, y, p)

        return jax.lax.scan(step, scene.initial_state(p), h * jnp.arange(steps))[1]

    return jax.vmap(one)(params)


def drawn(
    names: Sequence[str], planar: bool, seeds: Sequence[int], **ways: Any
) -> tuple[Mechanism, dict[str, np.ndarray]]:
    """A machine, and parameters (draws,) of all draws: numbers differ, the structure does not."""
    each = [machine(names, planar, seed, **ways) for seed in seeds]
    known = [dict(one.defaults) for one in each]
    return each[0], {key: np.array([values[key] for values in known]) for key in known[0]}


def order(names: Sequence[str]) -> np.ndarray:
    """Where each member is in the image."""
    found: list[int] = []
    for name in names:
        members = FACING.get(name, range(GAPS[name].members or 1))
        found += [len(found) + k for k in members]
    return np.array(found)


def unlike(names: Sequence[str], ours: Seen, theirs: Seen, way: str) -> np.ndarray:
    """(draws,) greatest difference of forces, and of slips, over the largest of each draw."""
    force, normal, slip = (np.asarray(x) for x in theirs)
    if way == "exchanged":
        force = -force
    if way == "mirrored":
        where = order(names)
        force, normal, slip = force[..., where, :] * np.array(MIRROR), normal[..., where], slip[..., where]
    worst = np.zeros(len(force))
    for mine, other in zip(map(np.asarray, ours), (force, normal, slip), strict=True):
        axes = tuple(range(1, mine.ndim))
        apart = np.max(np.abs(mine - other), axis=axes) / np.maximum(np.max(np.abs(mine), axis=axes), 1e-300)
        worst = np.maximum(worst, np.where(np.isfinite(apart), apart, np.inf))
    return worst


def compared(
    names: Sequence[str], planar: bool, seeds: Sequence[int], end: float = 1.5e-3, steps: int = 600, roll: int = 0
) -> dict[str, np.ndarray]:
    """A machine beside itself exchanged and mirrored: by way the greatest difference of each draw; peak forces [N]."""
    ours = jax.device_get(runs(*drawn(names, planar, seeds, roll=roll), end, steps))
    found = {"peaks": np.max(np.abs(ours.normal), axis=(1, 2))}
    for way in WAYS:
        theirs = jax.device_get(runs(*drawn(names, planar, seeds, roll=roll, **{way: True}), end, steps))
        found[way] = unlike(names, ours, theirs, way)
    return found


WAYS = ("exchanged", "mirrored")
# Gaps of one machine.
_TOGETHER = 4


def structures() -> list[tuple[tuple[str, ...], bool]]:
    """Gaps of every machine, and whether it is planar: each gap at least once."""
    found = []
    for planar, every in ((False, tuple(GAPS)), (True, PLANAR)):
        around = every + every
        found += [(around[i : i + _TOGETHER], planar) for i in range(0, len(every), _TOGETHER)]
    return found


def main() -> None:
    """Run all, print and keep."""
    given, chosen = options(__doc__, draws=1000), structures()
    each, begin, rows = -(-given.draws // len(chosen)), time.perf_counter(), []
    for k, (names, planar) in enumerate(chosen):
        found = compared(names, planar, range(each), roll=3 * k)
        worst = {way: float(found[way].max()) for way in WAYS}
        beyond = {way: int(np.sum(found[way] > LIMIT)) for way in WAYS}
        pressed = int(np.sum(found["peaks"] > 1.0))
        row = {"gaps": names, "planar": planar, "machines": each, "touch": pressed, "worst": worst, "beyond": beyond}
        rows.append(row)
        print(row, flush=True)
    total = sum(row["machines"] for row in rows)
    beyond = sum(n for row in rows for n in row["beyond"].values())
    print(f"{total} machines, {beyond} beyond {LIMIT:g}, {time.perf_counter() - begin:.0f} s")
    save("symmetry", {"limit": LIMIT, "machines": total, "beyond": beyond, "structures": rows})


if __name__ == "__main__":
    main()
