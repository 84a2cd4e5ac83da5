"""Starts at rest: sag, touch and preload in closed form, with derivatives; what finds no rest is told."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, InputError, Mechanism, gaps
from bcfj_jax.mechanism import statics
from bcfj_jax.mechanism.bodies import GROUND, Drive
from bcfj_jax.mechanism.loads import Force, Gravity, JointSpring, Spring

G = 9.81
LAW = {"stiffness": 1e9, "exponent": 1.5, "damping": 0.3, "smoothing": 0.0}


def ball(height=0.03, joint="free", **more):
    body = Body("ball", joint, mass=0.5, inertia=1e-4, start={"z": height, "x": 0.2})
    floor = Contact("floor", (GROUND, "ball"), gaps.SphereOnPlane("z"), "memory_free", **more)
    return Mechanism("ball", [body], [floor], [Gravity("-z")], given=LAW | {"radius": 0.02}, start="static", end=1e-2)


@pytest.mark.slow
def test_a_ball_rests_on_a_compliant_plane():
    """k d^n = m g from 10 mm above; the derivatives of d, and the place along the floor, which is what it was."""
    scene = ball()
    params = scene.parameters()
    scene.check(params)
    depth = (0.5 * G / 1e9) ** (1.0 / 1.5)
    y = jax.jit(scene.initial_state)(params)
    assert 0.02 - float(y[2]) == pytest.approx(depth, rel=1e-9)
    assert float(y[0]) == pytest.approx(0.2, abs=1e-12)
    assert np.all(np.asarray(y[7:13]) == 0.0)
    slope = jax.jit(jax.jacfwd(lambda p: scene.initial_state(p)[:3]))(params)
    assert float(slope["stiffness"][2]) == pytest.approx(depth / 1.5 / 1e9, rel=1e-6)
    assert float(slope["ball.mass"][2]) == pytest.approx(-depth / 1.5 / 0.5, rel=1e-6)
    assert float(slope["radius"][2]) == pytest.approx(1.0, rel=1e-9)
    assert float(slope["ball.x"][0]) == pytest.approx(1.0, rel=1e-9)
    assert float(slope["ball.z"][2]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.full
def test_a_sphere_rests_with_derivatives():
    """What turns it is no coordinate: no place of the start moves with it."""
    scene = ball(0.01999, "sphere")
    params, depth = scene.parameters(), (0.5 * G / 1e9) ** (1.0 / 1.5)
    found = jax.jit(lambda k, x: scene.initial_state({**params, "stiffness": k, "ball.x": x})[:3])
    places, slope = jax.jvp(found, (1e9, 0.2), (1e9, 1.0))
    np.testing.assert_allclose(places, [0.2, 0.0, 0.02 - depth], rtol=1e-9)
    np.testing.assert_allclose(slope, [1.0, 0.0, depth / 1.5], rtol=1e-6)


@pytest.mark.slow
def test_a_run_from_rest_stays_there():
    scene = ball()
    run = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 1e-2, 21), read=["ball.velocity.z"])
    assert run.status == "ok"
    np.testing.assert_allclose(run.force["floor"][:, 0], 0.5 * G, rtol=1e-5)
    assert np.abs(run.readings["ball.velocity.z"]).max() < 1e-7


def chain(n=4):
    links = [
        Body(f"link{i}", "hinge", f"link{i - 1}" if i else GROUND, at=(0.1, 0, 0) if i else (0, 0, 0), center=(0.05, 0, 0),
             mass=0.2, inertia=1e-4, start={"angle": 0.3}) for i in range(n)
    ]  # fmt: skip
    return Mechanism("chain", links, loads=[Gravity()], start="static")


@pytest.mark.slow
def test_a_hanging_chain_hangs_straight():
    free = chain()
    y = np.asarray(free.initial_state(free.parameters()))
    np.testing.assert_allclose(np.cumsum(y[:4]), -np.pi / 2, atol=1e-7)


@pytest.mark.full
def test_a_pendulum_between_spring_and_weight_with_derivatives():
    """k q = -m g L cos q by bisection; dq/dk = -q/(k - m g L sin q)."""
    bar = Body("bar", "hinge", center=(0.4, 0, 0), mass=2.0, inertia=0.01)
    scene = Mechanism("bar", [bar], loads=[Gravity(), JointSpring("coil", "bar", 15.0)], start="static")
    params, low, high = scene.parameters(), -1.5, 0.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 15.0 * middle + 0.8 * G * np.cos(middle) < 0.0 else (low, middle)
    place = lambda k: scene.initial_state({**params, "coil.stiffness": k})[0]  # noqa: E731
    assert float(place(15.0)) == pytest.approx(low, rel=1e-9)
    curve = 15.0 - 0.8 * G * np.sin(low)
    slope = -low / curve
    assert float(jax.jit(jax.grad(place))(15.0)) == pytest.approx(slope, rel=1e-7)
    second = -slope / curve + low / curve**2 * (1.0 - 0.8 * G * np.cos(low) * slope)
    assert float(jax.jit(jax.jacfwd(jax.grad(place)))(15.0)) == pytest.approx(second, rel=1e-5)


@pytest.mark.slow
def test_a_runs_derivatives_go_through_its_start():
    """d(reaction)/dk over a run that begins at rest and is then pushed, by JAX against central differences."""
    bar = Body("bar", "hinge", center=(0.4, 0, 0), mass=2.0, inertia=0.01)
    push = Force("push", "bar", "y", 3.0, at=(0.8, 0, 0), ramp=0.1)
    scene = Mechanism("bar", [bar], loads=[Gravity(), JointSpring("coil", "bar", 15.0), push], start="static")
    params, times, name = scene.parameters(), np.linspace(0.0, 0.3, 16), "bar.reaction.y"

    def force(k):
        return bj.reading_history(scene, {**params, "coil.stiffness": k}, times, [name], accuracy=1e-5)[name]

    value, slope = jax.jvp(force, (jnp.asarray(15.0),), (jnp.ones(()),))
    near = (force(jnp.asarray(15.01)) - force(jnp.asarray(14.99))) / 0.02
    assert float(value[0]) == pytest.approx(2.0 * G, rel=1e-9)
    np.testing.assert_allclose(slope, near, atol=1e-5 * np.abs(near).max())


def test_drives_hold_their_places():
    """A mass on a spring from a driven slide, which moves fast at time 0: at rest relative to where the slide is then."""
    base = Body("base", "slide", axis="y", mass=1.0, drive=Drive("constant", speed=3.0, start=0.5))
    mass = Body("mass", "slide", axis="y", mass=2.0, start={"velocity": 0.7})
    spring = Spring("spring", ("base", "mass"), 400.0, 5.0, 0.1)
    scene = Mechanism("lift", [base, mass], loads=[Gravity(), spring], start="static")
    y = np.asarray(scene.initial_state(scene.parameters()))
    np.testing.assert_allclose(y, [0.5 - 0.1 - 2.0 * G / 400.0, 0.7], rtol=1e-9)


@pytest.mark.parametrize(
    ("scene", "told"),
    [
        (Mechanism("bead", [Body("bead", "slide", axis="x", mass=1.0)], loads=[Gravity(), Force("push", "bead", "x", 2.0)],
                   start="static"), r"no equilibrium: nothing stops 'bead' \(velocity\); 2 N"),
        (Mechanism("top", [Body("bar", "hinge", center=(0.0, 0.4, 0), mass=2.0, inertia=0.01)], loads=[Gravity()],
                   start="static"), r"unstable: 'bar' \(speed\)"),
    ],
)  # fmt: skip
def test_what_has_no_rest_is_told(scene, told):
    with pytest.raises(InputError, match=told):
        bj.simulate(scene, scene.parameters(), np.linspace(0.0, 0.1, 3))
    assert statics.rest(scene, scene.parameters()).known.force.shape == (1,)


def test_a_start_that_is_none_is_refused():
    given = Mechanism(
        "given", [Body("cam", "hinge", mass=1.0, inertia=1.0, drive=Drive("constant", speed=1.0))], start="static"
    )
    given.check(given.parameters())
    assert given.initial_state(given.parameters()).shape == (0,)
    with pytest.raises(InputError, match="give 'static'"):
        Mechanism("bead", [Body("bead", "slide", mass=1.0)], start="rest")
    assert jnp.isnan(Mechanism("bead", [Body("bead", "slide", axis="y", mass=1.0)], loads=[Gravity()], start="static")
                     .initial_state({"bead.mass": jnp.ones(()), "gravity": jnp.asarray(G)})[0])  # fmt: skip


@pytest.mark.slow
def test_balls_side_by_side_rest_and_bear_as_each_alone():
    """Five that are alike are one row of the equations: each presses by its own weight, with six numbers of inertia, rolling."""
    masses = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    tilted = (2e-4, 3e-4, 4e-4, 2e-5, 1e-5, -1e-5)
    balls = [
        Body(f"ball_{k}", "free", mass=mass, inertia=tilted, start={"z": 0.0205, "x": 0.1 * k})
        for k, mass in enumerate(masses)
    ]
    floors = [
        Contact(f"floor_{k}", (GROUND, f"ball_{k}"), gaps.SphereOnPlane("z"), "memory_free", rolling=True)
        for k in range(5)
    ]
    given = LAW | {"radius": 0.02, "rolling_length": 1e-4, "drilling_length": 1e-4, "spin_speed": 0.1}
    pushes = [Force("push", "ball_3", "x", 2.0)]
    falling = Mechanism("balls", balls, floors, [Gravity("-z"), *pushes], given=given)
    scene = Mechanism("balls", balls, floors, [Gravity("-z")], given=given, start="static")
    assert len(scene.rows) == 1
    y = np.asarray(jax.jit(scene.initial_state)(scene.parameters()))
    assert 0.02 - y[2:35:7] == pytest.approx((masses * G / 1e9) ** (1.0 / 1.5), rel=1e-8)
    params = falling.parameters()
    efforts, moves = jax.jit(lambda y: (falling.efforts(0.0, y, params), falling.motions(0.0, y, params)))(y)
    assert float(efforts["push"].force[0]) == pytest.approx(2.0)
    for k, mass in enumerate(masses):
        assert float(moves[f"ball_{k}"].acceleration[0]) == pytest.approx(2.0 / mass if k == 3 else 0.0, abs=1e-9)
        # A free joint bears nothing.
        assert np.abs(np.asarray(efforts[f"ball_{k}"].reaction)).max() < 1e-8 * mass * G
