"""Capsules, cylinders, boxes and wedges in motion and at rest: closed forms, in value and derivative."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

import bcfj_jax as bj
from bcfj_jax import Body, Contact, InputError, Mechanism, gaps
from bcfj_jax.contact.gaps.base import Frame
from bcfj_jax.mechanism.bodies import GROUND
from bcfj_jax.mechanism.loads import Bush, Force, Gravity

M, R, A, G, K = 2.0, 0.05, 0.1, 9.81, 1e7
ROUND, ACROSS = 0.5 * M * R * R, M * (3.0 * R * R + 4.0 * A * A) / 12.0
NUMBERS = {
    "stiffness": K, "exponent": 1.5, "damping": 0.0, "dashpot": 0.0, "smoothing": 0.0, "radius": R, "half_length": A,
    "gravity": G, "friction_static": 0.6, "friction_dynamic": 0.6, "friction_speed": 1e-3,
}  # fmt: skip


def scene(gap, start, loads=(), law="kelvin_voigt", friction: str | None = "coulomb", **more):
    """A cylinder along its z axis, whose attitude turns that into the world's y where the plane is z."""
    body = Body("log", "free", mass=M, inertia=(ACROSS, ACROSS, ROUND), start=start)
    made = Mechanism(
        "log", [body], [Contact("floor", (GROUND, "log"), gap, law, friction)], [Gravity("-z"), *loads], **more
    )
    return made, made.parameters({key: x for key, x in NUMBERS.items() if key in made.quantities})


# z along the world's y: a turn by -90 degrees about x.
LYING = {"q0": np.sqrt(0.5), "q1": -np.sqrt(0.5)}


@pytest.mark.full
@pytest.mark.parametrize("gap", tiers.ci([gaps.CylinderOnPlane, gaps.CapsuleOnPlane], gaps.CapsuleOnPlane))
def test_a_cylinder_rolls_down_a_slope(gap):
    """It goes s = g sin(b) t^2/(2 (1 + I/(m R^2))), and so does its derivative by b, while friction holds: tan b < 3 mu."""
    slope, end = 0.3, 0.2
    up = (-np.sin(slope), 0.0, np.cos(slope))
    sunk = R - M * G * np.cos(slope) / (2.0 * K)
    start = {**LYING, "x": up[0] * sunk, "z": up[2] * sunk}
    body = Body("log", "free", mass=M, inertia=(ACROSS, ACROSS, ROUND), start=start)
    made = Mechanism(
        "log", [body], [Contact("floor", (GROUND, "log"), gap(up), "kelvin_voigt", "coulomb")], [Gravity("-z")]
    )
    times = np.linspace(0.0, end, 5)
    run = bj.simulate(made, made.parameters({k: x for k, x in NUMBERS.items() if k in made.quantities}), times,
                      read=["log.place.x", "log.place.z", "log.spin.y"], accuracy=1e-4)  # fmt: skip
    gone = (run.readings["log.place.x"] - start["x"]) * np.cos(slope) + (
        run.readings["log.place.z"] - start["z"]
    ) * np.sin(slope)
    down = G * np.sin(slope) / 1.5
    # Coulomb's friction creeps at friction_speed N_t/(mu N).
    np.testing.assert_allclose(-gone, 0.5 * down * times**2, atol=2e-4)
    np.testing.assert_allclose(np.abs(run.readings["log.spin.y"]) * R, down * times, atol=1.5e-3)


@pytest.mark.slow
def test_a_cylinder_at_rest_bears_on_its_rims():
    """Two points of half the weight each; on points of its rim a standing one bears n of them, whatever its turn."""
    for gap, start, count, low in (
        (gaps.CylinderOnPlane("z"), LYING, 2, R), (gaps.CapsuleOnPlane("z"), LYING, 2, R),
        (gaps.CylinderOnPlane("z", points=8), {"q0": np.cos(0.2), "q3": np.sin(0.2)}, 8, A),
    ):  # fmt: skip
        made, p = scene(gap, {**start, "z": low - M * G / (count * K)})
        t, y = jnp.zeros(()), None
        y = made.initial_state(p)
        read = made.observe(t, y, p)["floor"].force[:, 0]
        assert np.allclose(read[read > 1e-9], M * G / count, rtol=1e-9) and np.sum(read > 1e-9) == count
        assert np.abs(made.vector_field(t, y, p)).max() < 1e-9
    with pytest.raises(InputError, match="2 points hold no rim"):
        gaps.CylinderOnPlane(points=2)


@pytest.mark.slow
def test_a_standing_cylinder_tips_over_its_rim():
    """Under a push F at the height h it is at rest while F h < m g R cos(pi/n), and leans on the edge of two points."""
    n, height = 6, 0.08
    lever = R * np.cos(np.pi / n)
    way = (np.cos(np.pi / n), np.sin(np.pi / n), 0.0)
    for tall in (0.9, 1.1):
        load = Force("push", "log", way, tall * M * G * lever / height, (0.0, 0.0, height - A))
        # It has no friction: what keeps it from sliding is a bush on the floor.
        foot = Bush("foot", (GROUND, "log"), (1e6, 1e6, 0.0), at=((0, 0, 0), (0, 0, -A)))
        made = scene(gaps.CylinderOnPlane("z", points=n), {"z": A}, [load, foot], friction=None)[0]
        made = replace(made, start="static")
        p = made.parameters({key: x for key, x in NUMBERS.items() if key in made.quantities})
        t, y = jnp.zeros(()), made.initial_state(p)
        upright = float(made.motions(t, y, p)["log"].axes[2, 2])
        if tall > 1.0:
            assert upright < 0.1
            continue
        assert upright > 1.0 - 1e-6
        bear = made.observe(t, y, p)["floor"].force[:, 0]
        assert float(np.sum(bear)) == pytest.approx(M * G, rel=1e-6)
        # The lower rim's points 1 and 2 are on the edge.
        assert float(np.sum(bear[n : n + 2])) > 0.9 * M * G


def two(start, law="hertz", **more):
    """Capsules a, still, along z, and b, free."""
    bodies = [
        Body("b", "free", mass=M, inertia=(0.01, 0.01, 0.002), start=start),
        Body("a", "free", mass=3.0, inertia=0.02),
    ]
    made = Mechanism("two", bodies, [Contact("c", ("a", "b"), gaps.CapsuleOnCapsule(), law, **more)])
    given = {"radius_a": 0.03, "radius_b": 0.02, "half_length_a": 0.1, "half_length_b": 0.06, "stiffness": 1e8, "exponent": 1.5,
             "smoothing": 0.0, "friction_dynamic": 0.3, "friction_static": 0.3, "friction_speed": 0.1}  # fmt: skip
    return made, made.parameters({key: x for key, x in given.items() if key in made.quantities})


@pytest.mark.parametrize(
    ("start", "depth", "point"),
    [
        ({"x": 0.049, "z": 0.02, **LYING}, 1e-3, (0.0295, 0.0, 0.02)),  # crossing
        ({"x": 0.049, "z": 0.02}, 1e-3, (0.0295, 0.0, 0.02)),  # parallel, b beside a
        tiers.slow(({"x": 0.049, "z": 0.1}, 1e-3, (0.0295, 0.0, 0.07))),  # parallel, in the middle of 0.04 to 0.1
        tiers.slow(({"z": 0.1 + 0.06 + 0.049}, 1e-3, (0.0, 0.0, 0.1295))),  # end on end
        ({"x": 0.0, "y": 0.06 + 0.049, "z": -0.03, **LYING}, 1e-3, (0.0, 0.0295, -0.03)),  # end on side
    ],
    ids=["cross", "beside", "shifted", "ends", "end"],
)
def test_capsules_touch_where_their_segments_are_nearest(start, depth, point):
    """Force K d^1.5 at the middle of the overlap, its derivatives, momentum of both, and moments about the point."""
    made, p = two(start)
    t, y = jnp.zeros(()), made.initial_state(p)
    force = lambda p: made.observe(t, y, p)["c"].force[0]  # noqa: E731
    assert float(force(p)) == pytest.approx(1e8 * depth**1.5, rel=1e-6)
    slopes = jax.jacfwd(force)(p)
    assert float(slopes["radius_a"]) == pytest.approx(1.5e8 * depth**0.5, rel=1e-6)
    assert float(slopes["radius_b"]) == pytest.approx(1.5e8 * depth**0.5, rel=1e-6)
    (face, touch), = made.faces_of(made.instant(t, y, p), "c")  # fmt: skip
    place = np.array([start.get(k, 0.0) for k in "xyz"])
    np.testing.assert_allclose(place + np.array(face.lever, float), point, atol=1e-7)  # of parallel ones by rounding
    moved = made.motions(t, y, p)
    np.testing.assert_allclose(M * moved["b"].acceleration + 3.0 * moved["a"].acceleration, 0.0, atol=1e-9 * 3e3)
    np.testing.assert_allclose(0.02 * moved["a"].spin_rate, np.cross(point, -np.array(touch.force, float)), atol=1e-3)


@pytest.mark.slow
def test_capsules_that_collide_keep_momentum_and_energy():
    """Two crossing capsules, turning: momenta are kept, and energy by a Hertz contact; what friction takes is booked."""
    start = {"x": 0.06, "z": 0.02, **LYING, "vx": -1.0, "vy": 0.3, "wz": 3.0, "wx": 1.0}
    for friction in (None, "coulomb"):
        made, p = two(start, friction=friction)
        times = np.linspace(0.0, 0.03, 301)
        run = bj.simulate(made, p, times, accuracy=1e-6)
        assert run.status == "ok" and run.force["c"][:, 0].max() > 100.0

        def kept(t, y, made=made, p=p):
            moved = made.motions(t, y, p)
            own = {"b": (M, jnp.array([0.01, 0.01, 0.002])), "a": (3.0, jnp.full(3, 0.02))}
            push, spun, energy = jnp.zeros(3), jnp.zeros(3), 0.0
            for name, (mass, inertia) in own.items():
                axes, one = moved[name].axes, moved[name]
                turn = axes @ (inertia * (axes.T @ one.spin))
                push, energy = (
                    push + mass * one.velocity,
                    energy + 0.5 * (mass * one.velocity @ one.velocity + one.spin @ turn),
                )
                spun = spun + turn + mass * jnp.cross(one.place, one.velocity)
            return jnp.concatenate([push, spun, energy[None]])

        found = np.array([kept(t, y) for t, y in zip(times[[0, -1]], run.trajectory[[0, -1]], strict=True)])
        np.testing.assert_allclose(found[1, :6], found[0, :6], atol=1e-6)
        change = found[1, 6] - found[0, 6]
        assert abs(change) < 1e-5 if friction is None else change < -1e-3


def test_a_sphere_on_the_edge_of_a_box_and_of_a_wedge_is_pushed_along_the_normal():
    """Beyond the face's edge the force turns with the line from the edge; both gaps are one at a right-angled edge."""
    for angle in (0.1, 0.7, 1.4):
        place = np.array([0.2, 0.1, 0.0]) + (R - 1e-4) * np.array([np.sin(angle), np.cos(angle), 0.0])
        pushes = []
        for gap, at in (
            (gaps.SphereOnBox(), (0.0, 0.0, 0.0)), (gaps.SphereOnWedge((np.sqrt(0.5), np.sqrt(0.5), 0.0)), (0.2, 0.1, 0.0)),
        ):  # fmt: skip
            ball = Body("ball", "sphere", mass=M, inertia=1e-3, start=dict(zip("xyz", place, strict=True)))
            made = Mechanism("edge", [ball], [Contact("c", (GROUND, "ball"), gap, "hertz", at=(at, (0, 0, 0)))])
            given = {**NUMBERS, "half_length": 0.2, "half_width": 0.1, "half_height": 0.3, "half_angle": 0.25 * np.pi}
            p = made.parameters({key: x for key, x in given.items() if key in made.quantities})
            pushes.append(made.motions(jnp.zeros(()), made.initial_state(p), p)["ball"].acceleration * M)
        want = K * 1e-4**1.5 * np.array([np.sin(angle), np.cos(angle), 0.0])
        np.testing.assert_allclose(pushes[0], want, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(pushes[1], want, rtol=1e-9, atol=1e-9)


RIM = [((R - 1e-3) * np.cos(x), (R - 1e-3) * np.sin(x), -(A - 1e-3)) for x in 2.0 * np.pi * np.arange(6) / 6]
CORNERS = [(x, y, z) for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (-0.01, 0.01)]


@pytest.mark.parametrize(
    ("points", "radius", "low", "bears"),
    [
        tiers.slow((RIM, 1e-3, A, 6)),
        (CORNERS, 1e-3, 0.011, 4),
        tiers.slow((((0.03, 0.0, 0.0), (-0.03, 0.0, 0.0)), 0.02, 0.02, 2)),
    ],
    ids=["flat end", "box", "capsule"],
)
def test_a_body_of_points_stands_on_a_box_and_not_beyond_its_edge(points, radius, low, bears):
    """Each point that is below bears m g/n, and dm of that; half beyond the edge, half of them bear and it tips."""
    gap, stiff, half = (
        gaps.SphereOnBox(points=points),
        1e6,
        {"half_length": 0.2, "half_width": 0.2, "half_height": 0.02},
    )

    def force(mass, x):
        start = {"x": x, "z": 0.02 + low - M * G / (bears * stiff)}
        body = Body("b", "free", mass=M, inertia=1e-3, start=start)
        made = Mechanism("t", [body], [Contact("c", (GROUND, "b"), gap, "kelvin_voigt")], [Gravity("-z")])
        given = {**NUMBERS, **half, "radius": radius, "stiffness": stiff}
        p = made.parameters({key: v for key, v in given.items() if key in made.quantities})
        y = made.initial_state(p).at[2].add(-(mass - M) * G / (bears * stiff))
        moved = made.motions(jnp.zeros(()), y, {**p, "b.mass": mass})["b"]
        return made.observe(jnp.zeros(()), y, p)["c"].force[:, 0], moved.acceleration, moved.spin_rate

    held, pulled, turned = force(M, 0.0)
    assert np.sum(np.asarray(held) > 0.0) == bears
    np.testing.assert_allclose(held[held > 0.0], M * G / bears, rtol=1e-9)
    np.testing.assert_allclose([*pulled, *turned], 0.0, atol=1e-8)
    slope = jax.jacfwd(lambda m: force(m, 0.0)[0])(jnp.asarray(M))
    np.testing.assert_allclose(slope[held > 0.0], G / bears, rtol=1e-9)
    # A little turned rims have no point on the edge itself.
    part, _, tips = force(M, 0.2001 + 1e-3)
    assert np.sum(np.asarray(part) > 0.5 * M * G / bears) == bears // 2 and float(tips[1]) > 1.0


def test_points_that_are_none_are_refused():
    for wrong in ([(0.0, 1.0)], "abc", [(0.0, 0.0, np.inf)]):
        with pytest.raises(InputError, match="list of points"):
            gaps.SphereOnBox(points=wrong)


@pytest.mark.slow
def test_a_ball_rolls_off_a_table():
    """On the table it stays, beyond the edge it falls; without friction its energy stays what it was."""
    ball = Body("ball", "sphere", mass=M, inertia=1e-3, start={"x": 0.15, "z": 0.02 + R - M * G / K, "vx": 1.0})
    made = Mechanism(
        "table", [ball], [Contact("c", (GROUND, "ball"), gaps.SphereOnBox(), "kelvin_voigt")], [Gravity("-z")]
    )
    given = {**NUMBERS, "half_length": 0.2, "half_width": 0.2, "half_height": 0.02}
    p = made.parameters({key: x for key, x in given.items() if key in made.quantities})
    times = np.linspace(0.0, 0.3, 31)
    run = bj.simulate(made, p, times, read=["ball.place.z", "ball.velocity.x", "ball.velocity.z"], accuracy=1e-6)
    r = run.readings
    energy = 0.5 * (r["ball.velocity.x"] ** 2 + r["ball.velocity.z"] ** 2) + G * r["ball.place.z"]
    np.testing.assert_allclose(r["ball.velocity.x"][times < 0.05], 1.0, rtol=1e-9)
    assert r["ball.place.z"][-1] < -0.02 and r["ball.velocity.x"][-1] > 1.0
    assert np.ptp(energy) < 1e-3 * energy[0]


BEAM = (0.1, 0.02, 0.02)


def edge_frames(x):
    """Frames of a still body a and of b at x (6,), a place and a rotation vector's first order about it."""
    angle = jnp.sqrt(x[3:] @ x[3:] + 1e-30)
    k = jnp.array([[0.0, -x[5], x[4]], [x[5], 0.0, -x[3]], [-x[4], x[3], 0.0]]) / angle
    turn = jnp.eye(3) + jnp.sin(angle) * k + (1.0 - jnp.cos(angle)) * k @ k
    axes = tuple(tuple(turn[:, j]) for j in range(3))
    return Frame((0.0, 0.0, 0.0), tuple(map(tuple, np.eye(3)))), Frame(tuple(x[:3]), axes)


def edge_depths(gap, x, c=None):
    return gap.faces(*edge_frames(x), {"radius_a": 1e-3, "radius_b": 2e-3, **(c or {})})[0].depth


def test_edges_that_cross_are_as_far_apart_as_their_lines():
    """d = r_a + r_b - |p . (u x v)|/|u x v| where two edges cross; its derivative by place and turn is that of the lines."""
    gap = gaps.CapsuleOnCapsule(edges_a=BEAM, edges_b=[[0.0, -0.05, 0.01, 0.0, 0.05, 0.0]])
    x = np.array([0.03, 0.021, 0.023, 0.3, 0.4, 0.2])

    def lines(x):
        frames = edge_frames(x)
        turn, end = jnp.stack([jnp.stack(axis) for axis in frames[1].axes], 1), jnp.array([0.0, -0.05, 0.01])
        along = turn @ jnp.array([0.0, 0.1, -0.01])
        across = jnp.cross(jnp.array([1.0, 0.0, 0.0]), along)
        p = x[:3] + turn @ end - jnp.array([0.0, 0.02, 0.02])
        return 3e-3 - jnp.abs(p @ across) / jnp.sqrt(across @ across)

    # The edge of a along x at +y and +z.
    at = next(i for i, e in enumerate(gap.edges_a) if e[0] * e[3] < 0.0 and e[1] > 0.0 and e[2] > 0.0)
    found = jax.jit(lambda x: (edge_depths(gap, x)[at], jax.jacfwd(lambda y: edge_depths(gap, y)[at])(x)))(x)
    wanted = lines(x), jax.jacfwd(lines)(x)
    assert float(found[0]) == pytest.approx(float(wanted[0]), abs=1e-9)
    np.testing.assert_allclose(found[1], wanted[1], atol=2e-6)


def test_parallel_edges_touch_in_the_middle_with_finite_derivatives():
    """d = r_a + r_b - h, d' = -1 by h and 0 by a turn about the middle; second derivatives are finite."""
    edge = [[-0.05, 0.0, 0.0, 0.05, 0.0, 0.0]]
    gap = gaps.CapsuleOnCapsule(edges_a=edge, edges_b=edge)
    x = np.array([0.0, 0.0, 2.5e-3, 0.0, 0.0, 0.0])
    depth = lambda x: edge_depths(gap, x)[0]  # noqa: E731
    value, slope, bend = jax.jit(lambda x: (depth(x), jax.jacfwd(depth)(x), jax.jacfwd(jax.jacrev(depth))(x)))(x)
    assert float(value) == pytest.approx(0.5e-3, rel=1e-9)
    np.testing.assert_allclose(slope, [0, 0, -1, 0, 0, 0], atol=1e-9)
    assert np.isfinite(bend).all()


def test_edges_that_are_none_are_refused():
    with pytest.raises(InputError, match="six numbers"):
        gaps.CapsuleOnCapsule(edges_b=[[0.0, 1.0]])


@pytest.mark.slow
def test_a_beam_rests_across_a_beam_on_four_edges():
    """Four crossings bear m g/4 each: it sinks by m g/(4 k), and so much over m by its mass; a linear law."""
    gap = gaps.CapsuleOnCapsule(edges_a=BEAM, edges_b=(0.02, 0.1, 0.02))
    upper = Body("upper", "free", mass=M, inertia=(0.01, 0.002, 0.01), start={"z": 0.043})
    given = {"stiffness": K, "exponent": 1.0, "damping": 0.0, "radius_a": 1e-3, "radius_b": 2e-3, "gravity": G}
    hit = Contact("c", (GROUND, "upper"), gap, "memory_free")
    made = Mechanism("beams", [upper], [hit], [Gravity("-z")], given=given, start="static")
    p = made.parameters()
    state, slope = jax.jit(lambda p: (made.initial_state(p), jax.jacfwd(made.initial_state)(p)["upper.mass"]))(p)
    sunk = M * G / (4.0 * K)
    assert float(state[2]) == pytest.approx(0.043 - sunk, abs=1e-10)
    assert float(slope[2]) == pytest.approx(-sunk / M, rel=1e-5)
    bear = np.asarray(made.observe(jnp.zeros(()), state, p)["c"].force)[:, 0]
    assert np.sum(bear > 1e-6) == 4
    np.testing.assert_allclose(bear[bear > 1e-6], M * G / 4.0, rtol=1e-6)


@pytest.mark.parametrize("joint", ["particle", "free"])
def test_both_ends_of_a_capsule_bear_on_a_body_with_and_without_axes(joint):
    """Ends that are equally deep, d, bear 2 K d^1.5, however little of the gap turns."""
    body = Body("b", joint, mass=2.0, **({} if joint == "particle" else {"inertia": 0.01}))
    given = {"radius": 0.02, "half_length": 0.1, "stiffness": 1e6, "exponent": 1.5, "smoothing": 0.0}
    made = Mechanism("m", [body], [Contact("c", ("ground", "b"), gaps.CapsuleOnPlane(axis="y"), "hertz")], given=given)
    params = made.parameters()
    state = made.initial_state(params).at[1].set(0.019)
    pushed = np.asarray(made.vector_field(jnp.zeros(()), state, params))
    assert pushed.max() == pytest.approx(2.0 * 1e6 * 1e-3**1.5 / 2.0, rel=1e-9)


LARGE, SMALL = (0.08, 0.07, 0.02), (0.05, 0.03, 0.01)


def boxes(start, ours=SMALL, theirs=LARGE, swapped=False):
    """A free box on one that is the ground's; ``swapped``: the ground's is the second."""
    body = Body("b", "free", mass=M, inertia=(2e-3, 3e-3, 4e-3), start=start)
    between, halves = (("b", GROUND), (ours, theirs)) if swapped else ((GROUND, "b"), (theirs, ours))
    made = Mechanism(
        "boxes", [body], [Contact("c", between, gaps.BoxOnBox(), "kelvin_voigt", "coulomb")], [Gravity("-z")]
    )
    sides = ("half_length", "half_width", "half_height")
    given = {
        f"{side}_{k}": x for k, half in zip("ab", halves, strict=True) for side, x in zip(sides, half, strict=True)
    }
    given |= {key: x for key, x in NUMBERS.items() if key in made.quantities}
    return made, made.parameters({**given, "rounding": 2e-3, "stiffness": 1e6})


def borne(made, p, y=None):
    y = made.initial_state(p) if y is None else y
    return y, made.observe(jnp.zeros(()), y, p)["c"]


@pytest.mark.parametrize("swapped", [False, tiers.slow(True)])
def test_a_small_box_stands_on_four_corners(swapped):
    """m g/4 each at the depth m g/(4 K), whichever box is the first; by its height -K each, by the other's half height K."""
    sunk = M * G / (4.0 * 1e6)
    made, p = boxes({"x": 0.01, "y": -0.02, "z": LARGE[2] + SMALL[2] - sunk}, swapped=swapped)
    y, read = borne(made, p)
    force = read.force[:, 0]
    corners = np.flatnonzero(force)
    assert corners.tolist() == ([8, 10, 12, 14] if swapped else [0, 2, 4, 6])
    np.testing.assert_allclose(force[corners], M * G / 4.0, rtol=1e-9)
    assert np.abs(made.vector_field(jnp.zeros(()), y, p)).max() < 1e-8
    for key, way in (("b.z", -1.0), (f"half_height_{'b' if swapped else 'a'}", 1.0), ("rounding", 0.0)):
        slope = jax.jacfwd(lambda x, k=key: borne(made, {**p, k: x})[1].force[:, 0])(jnp.asarray(p[key]))
        np.testing.assert_allclose(slope[corners], 1e6 * way, rtol=1e-9, atol=1e-3)


@pytest.mark.parametrize("turn", [1.0, np.pi / 2, np.pi])
def test_boxes_that_cross_bear_on_their_edges(turn):
    """Narrow boxes across each other, turned about z: on the crossings of their edges; flush on corners and edges besides."""
    sunk, long = 1e-5, (0.08, 0.02, 0.02)
    start = {"q0": np.cos(turn / 2), "q3": np.sin(turn / 2), "z": 0.04 - sunk}
    force = borne(*boxes(start, long, long))[1].force[:, 0]
    places = {1.0: 4, np.pi / 2: 4, np.pi: 12}[turn]
    assert np.sum(force > 0.0) == places
    np.testing.assert_allclose(force[force > 0.0], 1e6 * sunk, rtol=1e-5)
    assert np.all((np.flatnonzero(force) >= 16) | (turn == np.pi))


def test_a_box_leans_on_an_edge_and_a_rounding_too_large_is_refused():
    """A box that is tilted across the edge of another touches where its own edges cross that: twice, along its face's normal."""
    tilt, deep = 0.4, 1e-5
    # Its lower face holds the edge of the base along y: rounded edges are 2 e apart along the face's normal.
    edge = np.array([LARGE[0] - 2e-3, 0.0, LARGE[2] - 2e-3])
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    middle = edge + (4e-3 - deep + SMALL[2] - 2e-3) * normal + 5e-3 * np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    start = {"x": middle[0], "z": middle[2], "q0": np.cos(tilt / 2), "q2": np.sin(tilt / 2)}
    made, p = boxes(start)
    _, read = borne(made, p)
    pressed = np.flatnonzero(read.force[:, 0])
    assert len(pressed) == 2 and pressed.min() >= 16
    np.testing.assert_allclose(read.world[pressed], np.tile(1e6 * deep * normal, (2, 1)), rtol=1e-6, atol=1e-6)
    with pytest.raises(InputError, match=r"rounding 0.006 m is more than half of a half length of 0.01 m"):
        made.check({**p, "rounding": jnp.asarray(6e-3)})
