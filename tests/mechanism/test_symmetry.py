"""Which body of a contact is first does not matter, nor a mirror, nor a turn; forces act where the surfaces touch."""

from __future__ import annotations

import functools
import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from by_numpy import by_numpy

from bcfj_jax.contact import gaps
from bcfj_jax.contact.friction import FRICTION
from bcfj_jax.mechanism.bodies import GROUND, Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Gravity
from bcfj_jax.mechanism.mechanism import Mechanism
from benchmarks.robustness.symmetry import (
    FACING,
    GAPS,
    LIMIT,
    MIRROR,
    RUBS,
    SIZES,
    WAYS,
    compared,
    machine,
    order,
    rotation,
    seen,
    structures,
)

M = np.array(MIRROR)


WHOLE = range(len(structures()))


def machines(ci=WHOLE):
    """Every gap with every friction law; of the machines in ``ci`` one law each in CI's tier."""

    def tier(k, roll):
        return pytest.mark.full if roll == k and k in ci else pytest.mark.slow

    cases = [
        pytest.param(names, planar, roll, marks=tier(k, roll), id=f"{names[0]}-{planar}-{roll}")
        for k, (names, planar) in enumerate(structures())
        for roll in range(len(RUBS))
    ]
    return pytest.mark.parametrize(("names", "planar", "roll"), cases)


# Exchange concerns each gap's lever arms; a mirror and a turn, what all of them share: one machine in the plane, one in space.
# Machine 3 takes ten seconds to compile.
EVERY, SOME = machines((0, 1, 2, 4, 5)), machines((0, 5))
TOLERANCE = 1e-11


@functools.partial(by_numpy, static=True)
def looked(scene, t, y, p):
    """Contacts, motions, and powers and energies of one state."""
    flows = scene.flows(t, y, p)
    powers = [flows.given["wheel drive"], *flows.taken.values(), flows.stored["elastic"]]
    return seen(scene, t, y, p), scene.motions(t, y, p), jnp.stack(powers)


def state(scene, way=""):
    """A state in which all contacts press or slide, and what contacts remember is drawn by name: vectors have images."""
    params = {name: np.asarray(x, float) for name, x in scene.defaults}
    y = np.array(by_numpy(lambda p: scene.initial_state(p))(params))
    at = sum(k or 1 for *_, k in (*scene._placed, *scene._free))
    rng = np.random.default_rng(3)
    for c in scene.contacts:
        members = scene.members[c.name] or 1
        for _ in range(c.faces if c.memory else 0):
            bristle = 1e-4 * rng.normal(size=(3, members))
            if way == "exchanged":
                bristle = -bristle
            if way == "mirrored":
                where = next((FACING[n] for n in FACING if isinstance(c.gap, gaps.GAPS[n])), range(members))
                bristle = M[:, None] * bristle[:, where]
            for name in c.memory:
                if name.startswith("bristle"):
                    y[at : at + members] = bristle["xyz".index(name[-1])]
                elif name == "late":
                    y[at : at + members] = 0.2
                at += members
    return np.zeros(()), y, params


@functools.cache
def found(names, planar, roll, way="", turned=0.0):
    ways = {way: True} if way else {}
    scene = machine(names, planar, 5, turned=turned, depth=(5e-5, 2e-4), roll=roll, **ways)
    return scene, *looked(scene, *state(scene, way))


def near(ours, theirs, tolerance=TOLERANCE):
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    assert np.all(np.isfinite(ours))
    assert np.max(np.abs(ours - theirs)) <= tolerance * np.max(np.abs(ours))


def test_every_friction_and_gap_is_in_the_machines():
    assert set(RUBS) == {None, *FRICTION}
    assert {type(gap) for gap in GAPS.values()} >= {x for x in gaps.GAPS.values() if isinstance(x, type)}
    assert {name for names, _ in structures() for name in names} == set(GAPS)


@EVERY
def test_bodies_exchanged_are_the_same_machine(names, planar, roll):
    scene, one, moved, powers = found(names, planar, roll)
    _, two, moved_too, powers_too = found(names, planar, roll, "exchanged")
    assert np.sum(one.normal > 1.0) >= len(scene.contacts) - 1  # they press; a law that has lost much may let go
    near(one.force, -two.force)
    near(one.normal, two.normal)
    near(one.slip, two.slip)
    near(powers, powers_too)
    near(moved["wheel"].drive, moved_too["wheel"].drive)
    for body in ("rocker", "slider", "ball"):
        near(moved[body].acceleration, moved_too[body].acceleration)
        if body != "slider":
            near(moved[body].spin_rate, moved_too[body].spin_rate)


@SOME
def test_a_mirror_shows_the_same_machine(names, planar, roll):
    _, one, moved, powers = found(names, planar, roll)
    _, two, moved_too, powers_too = found(names, planar, roll, "mirrored")
    where = order(names)
    near(one.force, two.force[where] * M)
    near(one.normal, two.normal[where])
    near(one.slip, two.slip[where])
    near(powers, powers_too)
    near(moved["wheel"].drive, -moved_too["wheel"].drive)
    for body in ("rocker", "slider", "ball"):
        near(moved[body].acceleration, moved_too[body].acceleration * M)
        if body != "slider":
            # An axial vector: its parts along the mirror change their sign.
            near(moved[body].spin_rate, -moved_too[body].spin_rate * M)


@SOME
def test_a_machine_that_is_turned_as_a_whole(names, planar, roll):
    scene, one, moved, _ = found(names, planar, roll)
    turned, two, moved_too, _ = found(names, planar, roll, "", 1.1)
    axis = turned.body("base").tilt[0]
    q = rotation(np.eye(3)[2] if axis == "z" else axis, 1.1)
    # Bristles are drawn in the world's axes and do not turn with the machine: their contacts are left out.
    keep = np.array([not c.bristles for c in scene.contacts for _ in range(scene.members[c.name] or 1)])
    near(one.force[keep] @ q.T, two.force[keep], 1e-10)
    near(one.slip[keep], two.slip[keep], 1e-10)
    near(moved["ball"].velocity @ q.T, moved_too["ball"].velocity)


# --- by statics: where surfaces touch, in NumPy


def touches(name, p, a, b):
    """(normal, point from b's marker) of each member, world; p leads from a's marker to b's; a, b axes as columns."""
    local, s = a.T @ p, SIZES
    if name == "point_on_plane":
        return [(a @ [0.0, 1.0, 0.0], np.zeros(3))]
    if name == "sphere_on_plane":
        down = -a @ [0.6, 0.8, 0.0]
        return [(down, s["radius"] * down)]
    if name == "sphere_on_sphere":
        # As deep in the one as in the other.
        n, d = -p / np.linalg.norm(p), s["radius_a"] + s["radius_b"] - np.linalg.norm(p)
        return [(n, (s["radius_b"] - 0.5 * d) * n)]
    if name == "sphere_in_socket":
        n = p / np.linalg.norm(p)
        return [(n, s["radius"] * n - p)]
    if name in ("pin_in_bearing", "pin_with_ends"):
        ends = [k * s["half_length"] * b[:, 2] for k in (1, -1)] if name == "pin_with_ends" else [np.zeros(3)]
        found = []
        for end in ends:
            across = a.T @ (p + end) * [1.0, 1.0, 0.0]
            n = a @ (across / np.linalg.norm(across))
            found.append((n, end + s["radius"] * n))
        return found
    if name in ("pin_in_slot", "two_sided_stop", "ball_between_planes"):
        n = np.sign(local[0]) * a[:, 0]
        return [(n, {"pin_in_slot": s["radius"], "ball_between_planes": s["ball_radius"]}.get(name, 0.0) * n)]
    if name == "box_on_plane":
        size = [s["half_length"], s["half_width"], s["half_height"]]
        return [(a[:, 1], b @ (np.array(k) * size)) for k in itertools.product((-1, 1), repeat=3)]
    if name == "capsule_on_plane":
        return [(a[:, 1], k * s["half_length"] * b[:, 2] + s["radius"] * a[:, 1]) for k in (1, -1)]
    if name == "cylinder_on_plane":
        low = a[:, 1] - b[:, 2] * (a[:, 1] @ b[:, 2])
        low = s["radius"] * low / np.linalg.norm(low)
        return [(a[:, 1], k * s["half_length"] * b[:, 2] + low) for k in (1, -1)]
    if name == "capsule_on_capsule":
        across = np.cross(a[:, 2], b[:, 2])
        if np.linalg.norm(across) < 1e-9:  # In the middle of where parallel ones lie beside each other.
            far = p @ a[:, 2]
            ends = np.clip(
                [far - s["half_length_b"], far + s["half_length_b"]], *np.array([-1, 1]) * s["half_length_a"]
            )
            along = np.array([np.mean(ends), (np.mean(ends) - far) * np.sign(a[:, 2] @ b[:, 2])])
        else:  # Where both segments are crossed by what is across them.
            along = np.linalg.solve(np.stack([a[:, 2], -b[:, 2], across], axis=1), p)
        r = p + along[1] * b[:, 2] - along[0] * a[:, 2]
        n, d = -r / np.linalg.norm(r), s["radius_a"] + s["radius_b"] - np.linalg.norm(r)
        return [(n, along[1] * b[:, 2] + (s["radius_b"] - 0.5 * d) * n)]
    if name == "sphere_on_box":
        half = np.array([s["half_length"], s["half_width"], s["half_height"]])
        out = local - np.clip(local, -half, half)
        n = -a @ out / np.linalg.norm(out)
        return [(n, s["radius"] * n)]
    if name == "box_on_box":
        return list(_boxes(p, a, b))
    if name == "sphere_on_wedge":
        n = -a @ [np.sign(local[0]) * np.cos(s["half_angle"]), np.sin(s["half_angle"]), 0.0]
        return [(n, s["radius"] * n)]
    if name == "slider_in_guide":
        corners = [
            b @ [i * s["half_length"], j * s["half_width"], 0.0] for i, j in ((-1, 1), (1, 1), (-1, -1), (1, -1))
        ]
        return [(k * a[:, 1], corner) for k, corner in zip((1, 1, -1, -1), corners, strict=True)]
    if name == "from_depth":
        away = local * [1.0, 1.0, 0.0] - [0.0, s["throw"], 0.0]
        return [(-a @ away / np.linalg.norm(away), np.zeros(3))]
    outer = name == "ball_in_groove"
    off = local - [0.0, 0.0, s["offset"] * (1 if outer else -1)]
    radial = off * [1.0, 0.0, 1.0] / np.hypot(off[0], off[2])
    section = np.array([off[1], off @ radial - np.hypot(s["pitch_radius"], s["offset"])])
    if outer:
        flank = s["ball_radius"] * (2.0 * s["conformity"] - 1.0)
        section = section + flank * np.array([np.sin(s["contact_angle"]), np.cos(s["contact_angle"])])
    section = section / np.linalg.norm(section)
    n = a @ (section[0] * np.array([0.0, 1.0, 0.0]) + section[1] * radial)
    return [(n, s["ball_radius"] * n)]


def _boxes(p, a, b):
    """Of every corner and pair of edges: nearest points by clipping, or of two segments the nearest of all that may be."""
    inner = [
        np.array([SIZES[f"half_{x}_{k}"] for x in ("length", "width", "height")]) - SIZES["rounding"] for k in "ab"
    ]
    signs = np.array(list(itertools.product((-1, 1), repeat=3)))
    pairs = [(a @ np.clip(a.T @ (p + x), -inner[0], inner[0]), p + x) for x in signs * inner[1] @ b.T]
    pairs += [(x, p + b @ np.clip(b.T @ (x - p), -inner[1], inner[1])) for x in signs * inner[0] @ a.T]

    def edges(axes, half, place):
        for i in range(3):
            for k in itertools.product((1, -1), repeat=2):
                yield place + axes @ (half * np.insert(k, i, 0)), (half[i] - SIZES["rounding"]) * axes[:, i]

    for here, one in edges(a, inner[0], 0.0):
        for there, other in edges(b, inner[1], p):
            on = lambda x, middle, way: np.clip((x - middle) @ way / (way @ way), -1, 1)  # noqa: E731
            both = [(on(there + t * other, here, one), t) for t in (-1, 1)] + [
                (s, on(here + s * one, there, other)) for s in (-1, 1)
            ]
            s, t = np.linalg.lstsq(np.stack([one, -other], 1), there - here, rcond=None)[0]
            both += [(s, t)] if max(abs(s), abs(t)) <= 1 else []
            pairs.append(
                min(((here + s * one, there + t * other) for s, t in both), key=lambda x: np.linalg.norm(x[1] - x[0]))
            )
    for ours, theirs in pairs:
        yield (ours - theirs) / np.linalg.norm(ours - theirs), 0.5 * (ours + theirs) - p


@EVERY
def test_forces_act_where_the_surfaces_touch(names, planar, roll):
    """Slip is that of the material there; torques and accelerations are those of equal and opposite forces there."""
    scene, one, moved, powers = found(names, planar, roll)
    pull = {b.name: np.zeros(3) for b in scene.bodies} | {GROUND: np.zeros(3)}
    twist, at, given = {name: x.copy() for name, x in pull.items()}, 0, 0.0
    for c, name in zip(scene.contacts, names, strict=True):
        members = scene.members[c.name] or 1
        (first, second), marks = c.between, c.at
        ends = ((first, marks[0]), (second, marks[1]))
        (pa, a, va, wa), (pb, b, vb, wb) = (_marker(scene, moved, body, m) for body, m in ends)
        for k, (n, lever) in enumerate(touches(name, pb - pa, a, b)):
            force, normal, slip = one.force[at + k], one.normal[at + k], one.slip[at + k]
            point = pb + lever
            velocity = vb + np.cross(wb, lever) - va - np.cross(wa, point - pa)
            slide = velocity - n * (n @ velocity)
            if c.friction is None:
                near(-abs(normal) * n, force, 1e-9) if normal else None
            else:
                assert slip == pytest.approx(np.linalg.norm(slide), rel=1e-9, abs=1e-12)
            assert -force @ n == pytest.approx(abs(normal), rel=1e-9, abs=1e-9 * np.max(one.normal))
            given += force @ slide
            for body, push in ((first, -force), (second, force)):
                pull[body] = pull[body] + push
                twist[body] = twist[body] + np.cross(point, push)
        at += members
    # What friction takes, and what a contact without friction does not.
    assert powers[1] == pytest.approx(-given, rel=1e-9)
    # Their bodies move as these forces alone say.
    hub = moved["wheel"].place
    spindle = _axis(scene, moved, "wheel")
    assert moved["wheel"].drive == pytest.approx(-spindle @ (twist["wheel"] - np.cross(hub, pull["wheel"])), rel=1e-9)
    rocker, hinge = scene.body("rocker"), _origin(scene, moved, "rocker")
    pin = _axis(scene, moved, "rocker")
    arm = moved["rocker"].place - hinge
    inertia = rocker.inertia + rocker.mass * (arm @ arm - (pin @ arm) ** 2)
    wanted = pin @ (twist["rocker"] - np.cross(hinge, pull["rocker"]))
    assert inertia * (pin @ moved["rocker"].spin_rate) == pytest.approx(wanted, rel=1e-9)
    along = _axis(scene, moved, "slider")
    assert scene.body("slider").mass * (along @ moved["slider"].acceleration) == pytest.approx(
        along @ pull["slider"], rel=1e-9
    )
    ball = scene.body("ball")
    near(pull["ball"] * (M * M if not planar else [1.0, 1.0, 0.0]), ball.mass * moved["ball"].acceleration, 1e-9)
    near((twist["ball"] - np.cross(moved["ball"].place, pull["ball"])) * ([1, 1, 1] if not planar else [0, 0, 1]),
         ball.inertia * moved["ball"].spin_rate, 1e-9)  # fmt: skip


def _origin(scene, moved, body):
    return moved[body].place - _turn(moved, body) @ np.array(scene.body(body).center)


def _turn(moved, body):
    """Axes of a body; one that does not turn has the base's, which are the world's."""
    return np.eye(3) if moved[body].axes is None else moved[body].axes


def _marker(scene, moved, body, mark):
    axes, spin = _turn(moved, body), np.zeros(3) if moved[body].spin is None else moved[body].spin
    place = _origin(scene, moved, body) + axes @ np.array(mark)
    return place, axes, moved[body].velocity + np.cross(spin, place - moved[body].place), spin


def _axis(scene, moved, body):
    way = scene.body(body).axis
    way = np.eye(3)["xyz".index(way)] if isinstance(way, str) else np.asarray(way) / np.linalg.norm(way)
    return _turn(moved, body) @ way


# --- a closed form, and runs


@pytest.mark.slow
@pytest.mark.parametrize("pin_on_wheel", [True, False])
def test_a_wheel_that_turns_on_its_pin_is_braked_alike_whoever_holds_the_pin(pin_on_wheel):
    """It climbs by the angle of friction q, tan q = mu, where its weight W is borne; the torque is -W r sin q.

    r leads from the wheel's middle to where the surfaces touch: the pin's radius, or the bearing's with the penetration.
    """
    weight, inertia, radius, play, mu, spin = 2.0 * 9.81, 0.01, 0.02, 1e-4, 0.3, 50.0
    between = ("ground", "wheel") if pin_on_wheel else ("wheel", "ground")
    c = Contact("journal", between, gaps.PinInBearing(), "hertz", "coulomb", smoothing=False)
    wheel = Body("wheel", "planar", mass=2.0, inertia=inertia)
    scene = Mechanism("wheel", [wheel], [c], [Gravity("-y")])
    q = np.arctan(mu)
    depth = (weight * np.cos(q) / 1e9) ** (1 / 1.5)
    # Towards where it hangs: a pin lies beside the bottom of its bearing, a bearing hangs with its top beside the pin.
    reach = play + depth
    lever = radius if pin_on_wheel else radius + reach
    slip = spin * lever
    speed = 1e-6 * slip  # the regularisation's share is gone
    values = {"stiffness": 1e9, "exponent": 1.5, "radius": radius, "friction_dynamic": mu, "friction_speed": speed}
    p = {name: np.asarray(x) for name, x in scene.parameters(values, clearance_journal=play, gravity=9.81).items()}
    best = None
    for side in (1.0, -1.0):
        y = np.array([side * reach * np.sin(q), -reach * np.cos(q), 0.0, 0.0, 0.0, spin])
        slope = np.asarray(by_numpy(lambda t, y, p: scene.vector_field(t, y, p))(np.zeros(()), y, p))
        if best is None or abs(slope[3]) < abs(best[3]):
            best = slope
    assert np.max(np.abs(best[3:5])) < 1e-6 * 9.81
    assert inertia * best[5] == pytest.approx(-weight * lever * np.sin(q), rel=1e-6)


@pytest.mark.slow
def test_runs_over_the_first_contact_are_alike():
    got = compared(("sphere_on_sphere", "pin_in_bearing"), True, range(4))
    assert np.all(got["peaks"] > 1.0)
    for way in WAYS:
        assert np.max(got[way]) <= LIMIT
