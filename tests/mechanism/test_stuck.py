"""Starts at rest that friction holds: on a slope, against a wall, in a groove, in a hinge; in closed form, with derivatives."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, InputError, Mechanism, gaps
from bcfj_jax.contact.friction import FRICTION
from bcfj_jax.mechanism import statics
from bcfj_jax.mechanism.bodies import GROUND
from bcfj_jax.mechanism.loads import Force, Gravity, JointFriction

G = 9.81
RUBS = {"friction_static": 0.5, "friction_dynamic": 0.4, "friction_speed": 1e-3, "gravity": G}
GIVEN = RUBS | {"stiffness": 1e8, "exponent": 1.0, "damping": 0.1}


def slope(angle=0.3, friction="coulomb", start=0.3, height=0.0, **more):
    """A block of 2 kg on a plane that falls along x."""
    given = {k: v for k, v in (GIVEN | more).items() if k != "friction_static" or friction != "coulomb"}
    block = Body("block", "particle", mass=2.0, start={"x": start} | ({"z": height} if height else {}))
    floor = Contact("floor", (GROUND, "block"), gaps.PointOnPlane("z"), "memory_free", friction=friction)
    down = Gravity((np.sin(angle), 0.0, -np.cos(angle)))
    return Mechanism("slope", [block], [floor], [down], given=given, start="static", end=0.01)


def test_the_coefficient_rises_up_to_its_crest():
    """Of Coulomb's law everywhere; of Brown and McPhee's and STEP's to the transition speed; bristles to break-away."""
    c = {**RUBS, "friction_memory": 1e-3, "friction_viscous": 0.0, "bristle_stiffness": 1e5, "bristle_damping": 0.0}
    assert float(FRICTION["coulomb"].coefficient(FRICTION["coulomb"].crest(c), c)) == pytest.approx(0.4, rel=1e-9)
    assert float(FRICTION["step"].crest(c)) == pytest.approx(1e-3, rel=2e-3)
    speeds = np.linspace(1e-5, 5e-3, 20001)
    for name in ("brown_mcphee", "memory", "step"):
        law = FRICTION[name]
        most = np.max(np.asarray(law.coefficient(jnp.asarray(speeds), c)))
        assert float(law.coefficient(law.crest(c), c)) == pytest.approx(most, rel=1e-5), name
    mobility, share = FRICTION["lugre"].holding(jnp.asarray(1.0), c, 1e-3)
    assert float(mobility * share) == pytest.approx(0.5, rel=1e-8)


@pytest.mark.slow
def test_a_block_rests_on_a_slope_and_creeps_by_its_law():
    """m g sin a = N mu_d v/sqrt(v^2 + v_t^2): v = v_t r/sqrt(1 - r^2), r = tan a/mu_d, and dv/dmu_d; the place follows its start.

    While it sinks in by 0.19 um it slides by less.
    """
    scene = slope()
    params = scene.parameters()
    state, slope_ = jax.jit(lambda p: (scene.initial_state(p), jax.jacfwd(scene.initial_state)(p)))(params)
    r = np.tan(0.3) / 0.4
    speed = 1e-3 * r / np.sqrt(1.0 - r * r)
    depth = 2.0 * G * np.cos(0.3) / 1e8
    np.testing.assert_allclose(state[:3], [0.3, 0.0, -depth], atol=5e-8)
    np.testing.assert_allclose(state[3:], [speed, 0.0, 0.0], rtol=1e-7, atol=1e-12)
    assert float(slope_["friction_dynamic"][3]) == pytest.approx(-speed / 0.4 / (1.0 - r * r), rel=1e-6)
    assert float(slope_["block.mass"][2]) == pytest.approx(-depth / 2.0, rel=1e-6)
    assert float(slope_["block.mass"][3]) == pytest.approx(0.0, abs=1e-9)
    assert float(slope_["block.x"][0]) == pytest.approx(1.0, rel=1e-9)
    field = jax.jit(scene.vector_field)(jnp.zeros(()), state, params)
    assert np.abs(np.asarray(field[3:])).max() < 1e-6 * G


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.3, -0.2])
def test_a_block_on_two_corners_slides_and_does_not_turn(angle):
    """Corners bear m g (cos a -+ sin a)/2; both creep at the speed of one, though a turn would let them slip as fast."""
    block = Body("block", "planar", mass=2.0, inertia=5e-3, start={"y": 0.05})
    corners = [
        Contact(f"corner_{k}", (GROUND, "block"), gaps.PointOnPlane("y"), "memory_free", friction="coulomb",
                at=((0, 0, 0), (x, -0.05, 0)))
        for k, x in enumerate((-0.05, 0.05))
    ]  # fmt: skip
    given = {k: v for k, v in GIVEN.items() if k != "friction_static"}
    down = Gravity((np.sin(angle), -np.cos(angle), 0.0))
    scene = Mechanism("slope", [block], corners, [down], given=given, start="static", end=0.01)
    params = scene.parameters()
    state = jax.jit(scene.initial_state)(params)
    r = np.tan(angle) / 0.4
    np.testing.assert_allclose(state[3:], [1e-3 * r / np.sqrt(1.0 - r * r), 0.0, 0.0], rtol=1e-6, atol=1e-9)
    run = bj.simulate(scene, params, np.linspace(0.0, 0.01, 6), accuracy=1e-5)
    for k, sign in enumerate((-1.0, 1.0)):
        bears = G * (np.cos(angle) + sign * np.sin(angle))
        np.testing.assert_allclose(run.force[f"corner_{k}"][:, 0], bears, rtol=1e-4)


@pytest.mark.parametrize("more", [{}, {"friction": "lugre", "bristle_stiffness": 1e5, "bristle_damping": 0.0}])
def test_a_block_above_a_slope_comes_down_under_its_place(more):
    """It falls along its weight, in axes of the plane by h tan a: dx/dh = tan a, and dx/dx = 1."""
    scene = slope(height=2e-3, **more)
    params = scene.parameters()
    state, slope_ = jax.jit(lambda p: (scene.initial_state(p), jax.jacfwd(scene.initial_state)(p)))(params)
    depth = 2.0 * G * np.cos(0.3) / 1e8
    np.testing.assert_allclose(state[:3], [0.3 + 2e-3 * np.tan(0.3), 0.0, -depth], atol=4e-6)
    np.testing.assert_allclose(slope_["block.z"][:3], [np.tan(0.3), 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(slope_["block.x"][:3], [1.0, 0.0, 0.0], atol=1e-6)


def test_a_slope_too_steep_names_what_would_hold():
    scene = slope(0.6)
    with pytest.raises(InputError, match=r"nothing stops 'block' \(vx\).*friction of 0.684 at 'floor' \(it has 0.4\)"):
        statics.check(scene, scene.parameters(), "scene")


@pytest.mark.slow
def test_bristles_bear_and_stay_at_rest():
    """LuGre: z = tan a/sigma_0, no velocity, and a run in which nothing moves."""
    scene = slope(friction="lugre", bristle_stiffness=1e5, bristle_damping=0.0)
    params = scene.parameters()
    scene.check(params)
    state = np.asarray(jax.jit(scene.initial_state)(params))
    bend = np.tan(0.3) / 1e5
    np.testing.assert_allclose(state[3:], [0.0, 0.0, 0.0, bend, 0.0, 0.0], rtol=1e-7, atol=1e-12)
    assert state[0] == pytest.approx(0.3 + bend, abs=5e-8)
    run = bj.simulate(scene, params, np.linspace(0.0, 0.01, 6), read=["block.velocity.x"])
    np.testing.assert_allclose(run.force["floor"][:, 1], -2.0 * G * np.sin(0.3), rtol=1e-6)
    assert np.abs(run.readings["block.velocity.x"]).max() < 1e-9


@pytest.mark.slow
def test_a_wall_holds_by_preload_and_a_groove_by_its_sides():
    """A block pushed against a wall: m g = P r mu_d. One in a groove of 90 degrees, pushed along it: both sides bear half."""
    block = Body("block", "particle", mass=2.0)
    given = {k: v for k, v in GIVEN.items() if k != "friction_static"}

    def touch(name, axis):
        return Contact(name, (GROUND, "block"), gaps.PointOnPlane(axis), "memory_free", friction="coulomb")

    push = Force("push", "block", "-x", "preload")
    own = [(bj.Quantity("preload", "N", "push on the wall"), 100.0)]
    loads = [Gravity("-z"), push]
    wall = Mechanism("wall", [block], [touch("wall", "x")], loads, own=own, given=given, start="static")
    speed = lambda load: wall.initial_state(wall.parameters() | {"preload": load})[5]  # noqa: E731
    value, slope_ = jax.jit(lambda load: jax.jvp(speed, (load,), (jnp.ones(()),)))(jnp.asarray(100.0))
    r = 2.0 * G / (100.0 * 0.4)
    assert float(value) == pytest.approx(-1e-3 * r / np.sqrt(1.0 - r * r), rel=1e-7)
    assert float(slope_) == pytest.approx(1e-3 * r / (1.0 - r * r) ** 1.5 / 100.0, rel=1e-6)
    sides = [touch("left", (1.0, 0.0, 1.0)), touch("right", (-1.0, 0.0, 1.0))]
    loads = [Gravity("-z"), Force("push", "block", "y", 5.0)]
    groove = Mechanism("groove", [block], sides, loads, given=given | {"damping": 0.0}, start="static")
    params = groove.parameters()
    state = jax.jit(groove.initial_state)(params)
    pull, seen = np.zeros(3), jax.jit(groove.observe)(jnp.zeros(()), state, params)
    for name, x in (("left", 1.0), ("right", -1.0)):
        force, normal = np.asarray(seen[name].world), np.array([x, 0.0, 1.0]) / np.sqrt(2.0)
        pull += force
        assert np.linalg.norm(force - normal * (force @ normal)) < 0.4 * (force @ normal)
    np.testing.assert_allclose(pull, [0.0, -5.0, 2.0 * G], rtol=1e-7, atol=1e-7)
    assert float(jnp.abs(seen["left"].world[1] - seen["right"].world[1])) < 1e-7


@pytest.mark.slow
def test_a_hinge_with_dry_friction_stays_within_its_band():
    """m g L cos q of 2 N m below the breakaway of 3: held where it is placed; bristles turn by 2/sigma_0 more."""
    for more in ({}, {"friction": "lugre", "bristle_stiffness": 3e3}):
        bar = Body("bar", "hinge", center=(0.1, 0, 0), mass=2.0, inertia=0.01, start={"angle": 0.2})
        rub = JointFriction("rub", "bar", sliding=3.0, speed=1e-3, **more)
        scene = Mechanism("bar", [bar], loads=[Gravity(), rub], start="static")
        state = np.asarray(jax.jit(scene.initial_state)(scene.parameters()))
        if not more:
            r = 0.2 * G * np.cos(0.2) / 3.0
            assert state[1] == pytest.approx(-1e-3 * r / np.sqrt(1.0 - r * r), rel=1e-6)
        else:
            assert state[2] * 3e3 == pytest.approx(-0.2 * G * np.cos(state[0]), rel=1e-9)
            assert state[0] - 0.2 == pytest.approx(state[2], abs=1e-9)
    rub = JointFriction("rub", "bar", sliding=1.0, speed=1e-3)
    weak = Mechanism("bar", [bar], loads=[Gravity(), rub], start="static")
    state = np.asarray(jax.jit(weak.initial_state)(weak.parameters()))
    # It sinks to the edge of its band: there the torque is the sliding torque, below the pin.
    assert 0.2 * G * np.cos(state[0]) == pytest.approx(1.0, rel=1e-6)
    assert state[0] < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_creep_balances_every_force(seed):
    """On two or three faces at random angles, with laws of their own, what a run begins with accelerates nothing."""
    draw = np.random.default_rng(seed)
    laws, body = ["coulomb", "brown_mcphee", None], Body("block", "particle", mass=2.0)
    turned = np.sort(draw.uniform(-1.0, 1.0, 2 + seed % 2)) + np.linspace(-0.7, 0.7, 2 + seed % 2)
    sides = [
        Contact(f"side_{k}", (GROUND, "block"), gaps.PointOnPlane((np.sin(a), 0.0, np.cos(a))), "memory_free",
                friction=laws[(k + seed) % (2 if k else 3)])
        for k, a in enumerate(turned)
    ]  # fmt: skip
    loads = [Gravity("-z"), Force("push", "block", "y", draw.uniform(-3.0, 3.0))]
    scene = Mechanism("groove", [body], sides, loads, given=GIVEN, start="static")
    params = scene.parameters()
    scene.check(params)
    state = jax.jit(scene.initial_state)(params)
    field = np.asarray(jax.jit(scene.vector_field)(jnp.zeros(()), state, params))
    assert np.abs(field[3:]).max() < 1e-5 * G


@pytest.mark.slow
def test_a_ladder_leans_as_its_two_contacts_creep():
    """Forces and moments balance at 50 degrees, where tan a = (1 - mu^2)/(2 mu) asks for 46.4; at 40 nothing holds it."""

    def ladder(degrees):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        start = {"x": c, "y": s, "angle": -np.radians(degrees)}
        body = Body("ladder", "planar", mass=10.0, inertia=10.0 / 3.0, start=start)
        ends = [
            Contact(name, (GROUND, "ladder"), gaps.PointOnPlane(axis), "memory_free", friction="coulomb",
                    at=((0, 0, 0), (x, 0, 0)))
            for name, axis, x in (("foot", "y", 1.0), ("top", "x", -1.0))
        ]  # fmt: skip
        given = {k: v for k, v in GIVEN.items() if k != "friction_static"} | {"stiffness": 1e7}
        return Mechanism("ladder", [body], ends, [Gravity("-y")], given=given, start="static")

    scene = ladder(50.0)
    params = scene.parameters()
    state = jax.jit(scene.initial_state)(params)
    seen = jax.jit(scene.observe)(jnp.zeros(()), state, params)
    foot, top = (np.asarray(seen[name].world) for name in ("foot", "top"))
    np.testing.assert_allclose(foot + top, [0.0, 10.0 * G, 0.0], atol=1e-5)
    arms = [np.asarray(x) * [np.cos(state[2]), np.sin(state[2])] for x in (1.0, -1.0)]
    moments = [arm[0] * force[1] - arm[1] * force[0] for arm, force in zip(arms, (foot, top), strict=True)]
    assert sum(moments) == pytest.approx(0.0, abs=1e-5)
    with pytest.raises(InputError, match=r"nothing stops 'ladder'.*friction of 0.5"):
        statics.check(ladder(40.0), ladder(40.0).parameters(), "scene")
