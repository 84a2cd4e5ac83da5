"""Dry friction in an ideal joint, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

import bcfj_jax as bj
from bcfj_jax import Body, Mechanism
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism.bodies import Drive
from bcfj_jax.solve.simulation import reading_history

TORQUE, INERTIA, SPEED = 3.0, 0.2, 30.0


def wheel(friction="coulomb", **more):
    brake = bj.loads.JointFriction("brake", "wheel", sliding=TORQUE, speed=1e-3, friction=friction, **more)
    body = Body("wheel", "hinge", mass=1.0, inertia=INERTIA, start={"speed": SPEED})
    return Mechanism("wheel", [body], loads=[brake], end=3.0)


@pytest.mark.parametrize("friction", tiers.ci(["coulomb", "step", "brown_mcphee"], "coulomb"))
def test_a_wheel_stops_after_j_w_over_t(friction):
    scene, times = wheel(friction), np.linspace(0.0, 3.0, 61)
    run = bj.simulate(scene, scene.parameters(), times, read=["wheel.speed", "wheel.angle"])
    slows = np.maximum(SPEED - TORQUE / INERTIA * times, 0.0)
    assert np.allclose(run.readings["wheel.speed"], slows, atol=5e-3)
    assert run.readings["wheel.angle"][-1] == pytest.approx(INERTIA * SPEED**2 / (2 * TORQUE), rel=1e-4)


def test_a_mass_on_a_spring_loses_2_f_over_k_each_half_swing():
    force, stiffness, mass, start = 2.0, 800.0, 0.5, 0.03
    loads = [
        bj.loads.JointSpring("spring", "mass", stiffness=stiffness),
        bj.loads.JointFriction("guide", "mass", sliding=force, speed=1e-5),
    ]
    body = Body("mass", "slide", mass=mass, start={"position": start})
    half = np.pi * np.sqrt(mass / stiffness)
    scene = Mechanism("slide", [body], loads=loads, end=5 * half)
    run = bj.simulate(scene, scene.parameters(), half * np.arange(6), read=["mass.position"])
    turns = [(-1) ** k * (start - 2 * k * force / stiffness) for k in range(6)]
    assert np.allclose(run.readings["mass.position"], turns, atol=2e-3 * start)


def test_a_mass_at_rest_inside_the_cone_stays():
    load = bj.loads.JointFriction("guide", "mass", sliding=2.0, speed=1e-5)
    push = bj.loads.Force("push", "mass", "z", 1.5)
    scene = Mechanism("slide", [Body("mass", "slide", mass=0.5)], loads=[load, push])
    run = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 1.0, 5), read=["mass.position"])
    # Coulomb's smoothed law creeps at v_t q/sqrt(F^2 - q^2).
    assert run.readings["mass.position"][-1] == pytest.approx(1e-5 * 1.5 / np.sqrt(2.0**2 - 1.5**2), rel=1e-2)


def test_its_power_is_friction_in_the_balance():
    scene = wheel()
    flows = scene.flows(0.0, scene.initial_state(scene.parameters()), scene.parameters())
    given, taken, _ = flows
    assert not given
    assert float(taken["friction"]) == pytest.approx(TORQUE * SPEED, rel=1e-6)
    # Of several like wheels it is that of all.
    body = Body("wheel", "hinge", mass=1.0, inertia=INERTIA, start={"speed": SPEED}, members=3)
    several = Mechanism("wheels", [body], loads=scene.loads, end=3.0)
    _, taken, _ = several.flows(0.0, several.initial_state(several.parameters()), several.parameters())
    assert float(taken["friction"]) == pytest.approx(3 * TORQUE * SPEED, rel=1e-6)


def test_the_derivative_of_the_stopping_angle_by_the_torque():
    scene, times = wheel(), np.linspace(0.0, 3.0, 7)
    p = scene.parameters()
    angle = lambda torque: reading_history(scene, {**p, "brake.sliding": torque}, times, ["wheel.angle"])  # noqa: E731
    found = jax.jacfwd(lambda torque: angle(torque)["wheel.angle"])(p["brake.sliding"])
    slope = float(found[-1])
    assert slope == pytest.approx(-INERTIA * SPEED**2 / (2 * TORQUE**2), rel=1e-3)


@pytest.mark.parametrize("friction", ["coulomb", "step", "brown_mcphee"])
def test_every_law_opposes_the_motion_and_is_odd(friction):
    load = bj.loads.JointFriction("f", "b", sliding=3.0, speed=0.1, breakaway=4.0, friction=friction)
    p = {"f.sliding": 3.0, "f.speed": 0.1, "f.breakaway": 4.0}
    on = lambda w: load.on_coordinate(0.0, 0.0, w, p)  # noqa: E731
    for w in (0.0, 1e-3, 0.07, 0.2, 5.0):
        assert float(on(w)) * w <= 0.0
        assert float(on(-w)) == -float(on(w))
        assert abs(float(on(w))) <= 4.0 + 1e-9
        assert np.isfinite(float(jax.grad(on)(w)))
    assert float(jax.grad(on)(0.0)) < 0.0


def test_what_has_a_state_is_refused():
    for name in ("lugre", "memory", "frictional_lag"):
        with pytest.raises(bj.InputError, match="give coulomb, step or brown_mcphee"):
            wheel(name)


def test_break_away_below_sliding_is_refused():
    scene = wheel("brown_mcphee", breakaway=2.0)
    with pytest.raises(bj.InputError, match="breakaway"):
        bj.simulate(scene, scene.parameters(), np.linspace(0, 1, 3))


def test_a_file_has_it_too(tmp_path):
    path = tmp_path / "wheel.toml"
    path.write_text(
        '[scene]\nkind = "mechanism"\n[[body]]\nname = "wheel"\njoint = "hinge"\nmass = "1 kg"\ninertia = 0.2\n'
        'start = { speed = 30 }\n[[load]]\nkind = "joint_friction"\nname = "brake"\nbody = "wheel"\n'
        'sliding = "3 N m"\nspeed = "0.001 rad/s"\n[time]\nend = "3 s"\nsamples = 7\n'
    )
    file = scenefile.load(str(path))
    run = bj.simulate(file.scene, file.params, file.times, read=["wheel.speed"])
    assert run.readings["wheel.speed"][1] == pytest.approx(30.0 - 15.0 * 0.5, rel=1e-4)
    assert file.scene.quantities["brake.sliding"].unit == "N m"


def test_a_joint_that_is_driven_costs_its_drive_the_friction():
    """F w/sqrt(w^2 + v^2) against the motion: the drive's torque, its power, and what friction takes, with derivatives."""
    speed, fade = 4.0, 3.0
    brake = bj.loads.JointFriction("brake", "wheel", sliding=TORQUE, speed=fade)
    body = Body("wheel", "hinge", mass=0, drive=Drive("constant", speed=speed))
    scene = Mechanism("wheel", [body], loads=[brake], end=1.0)
    params, t, held = scene.parameters(), jnp.zeros(()), TORQUE * speed / np.hypot(speed, fade)
    y = scene.initial_state(params)
    motion = scene.motions(t, y, params)["wheel"]
    assert float(motion.drive) == pytest.approx(held, rel=1e-12)
    flows = scene.flows(t, y, params)
    assert float(flows.given["wheel drive"]) == pytest.approx(held * speed, rel=1e-12)
    assert float(flows.taken["friction"]) == pytest.approx(held * speed, rel=1e-12)
    slope = jax.grad(lambda p: scene.efforts(t, y, p)["brake"].drive)(params)
    assert float(slope["brake.sliding"]) == pytest.approx(-held / TORQUE, rel=1e-12)
    assert float(slope["brake.speed"]) == pytest.approx(TORQUE * speed * fade / np.hypot(speed, fade) ** 3, rel=1e-12)
    run = bj.simulate(scene, params, np.linspace(0.0, 1.0, 5), read=["wheel.torque", "brake.torque"])
    np.testing.assert_allclose(run.readings["wheel.torque"], held, rtol=1e-12)
    np.testing.assert_allclose(run.readings["brake.torque"], -held, rtol=1e-12)
