"""Dry friction in an ideal joint, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from bcfj_jax import Body, Mechanism
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism.bodies import Drive
from bcfj_jax.solve.simulation import reading_history
from calibration import Channel, Experiment, Free, Problem, fit

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


@pytest.mark.slow
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


def test_what_a_joint_does_not_keep_is_refused():
    for name in ("memory", "frictional_lag"):
        with pytest.raises(bj.InputError, match="give coulomb, step, brown_mcphee or lugre"):
            wheel(name)
    with pytest.raises(bj.InputError, match="bristle_stiffness: is missing"):
        wheel("lugre")
    with pytest.raises(bj.InputError, match="Coulomb has no bristles"):
        wheel(bristle_damping=1.0)


def pulled(end=12.0, members=0):
    """A mass on a bed with LuGre friction, pulled over a spring: Canudas de Wit et al. 1995, Table 1 and section V-B."""
    loads = [
        bj.loads.JointSpring("spring", "mass", stiffness=2.0, drive=bj.Drive("constant", speed=0.1)),
        bj.loads.JointSpring("oil", "mass", damping=0.4),
        bj.loads.JointFriction(
            "bed", "mass", sliding=1.0, breakaway=1.5, speed=1e-3, friction="lugre", bristle_stiffness=1e5,
            bristle_damping=np.sqrt(1e5),
        ),
    ]  # fmt: skip
    return Mechanism("pulled", [Body("mass", "slide", mass=1.0, members=members)], loads=loads, end=end)


def pulled_by_scipy(times, sliding=1.0, bristle_stiffness=1e5):
    def rates(t, y):
        x, v, z = y
        bent = v - abs(v) * bristle_stiffness * z / (sliding + (1.5 - sliding) * np.exp(-((v / 1e-3) ** 2)))
        return [v, 2.0 * (0.1 * t - x) - 0.4 * v - bristle_stiffness * z - np.sqrt(1e5) * bent, bent]

    return solve_ivp(rates, (0.0, times[-1]), [0.0] * 3, "LSODA", rtol=1e-11, atol=1e-14, t_eval=times).y


@pytest.mark.full
def test_bristles_stick_and_slip_as_scipy_has_it():
    scene, times = pulled(20.0), np.linspace(0.0, 20.0, 201)
    run = bj.simulate(scene, scene.parameters(), times, accuracy=1e-3, read=["mass.position", "mass.velocity"])
    assert run.status == "ok"
    position, speed, bristle = pulled_by_scipy(times)
    assert np.allclose(run.readings["mass.position"], position, atol=1e-6 * np.ptp(position))
    assert np.allclose(run.readings["mass.velocity"], speed, atol=1e-5 * np.ptp(speed))
    assert np.allclose(run.trajectory[:, 2], bristle, atol=1e-5 * np.abs(bristle).max())
    # It holds 1.5 N before the first slip, and creeps by no more than its bristles bend.
    first = np.flatnonzero(speed > 0.05)[0]
    assert 0.2 * times[first] == pytest.approx(1.5, rel=0.05) and position[first - 5] < 2.0 * 1.5 / 1e5 * 2.0


@pytest.mark.full
@pytest.mark.parametrize("name", tiers.ci(["sliding", "bristle_stiffness"], "sliding"))
def test_derivatives_of_a_slip_are_those_of_scipy(name):
    scene, times = pulled(), np.linspace(0.0, 12.0, 25)
    p = scene.parameters()
    value, step = float(p[f"bed.{name}"]), 1e-4
    read = lambda x: reading_history(scene, p | {f"bed.{name}": x}, times, ["mass.position"], accuracy=1e-4)  # noqa: E731
    slope = np.asarray(jax.jacfwd(lambda x: read(x)["mass.position"])(value))
    more, less = (pulled_by_scipy(times, **{name: value * (1.0 + s * step)})[0] for s in (1, -1))
    differences = (more - less) / (2.0 * step * value)
    assert np.allclose(slope, differences, atol=1e-3 * np.abs(differences).max())


@pytest.mark.slow
def test_the_friction_of_bristles_is_fitted_to_a_record_of_scipys():
    scene, times = pulled(), np.linspace(0.0, 12.0, 241)
    record = pulled_by_scipy(times)[0] + 1e-3 * np.random.default_rng(3).standard_normal(times.size)
    run = Experiment("pull", times, (Channel("mass.position", record, 1e-3),))
    free = (Free("bed.sliding", 0.5, 1.4), Free("bed.breakaway", 1.41, 2.0))
    found = fit(Problem(scene, scene.parameters({"bed.sliding": 0.8}), (run,), free), starts=4)
    for name, truth in (("bed.sliding", 1.0), ("bed.breakaway", 1.5)):
        assert found.parameters[name].value == pytest.approx(truth, rel=5e-3)


def test_bristles_of_several_members_bend_each_by_itself():
    scene, three = pulled(), pulled(members=3)
    p, y = scene.parameters(), np.array([[0.0, 0.1, 0.2], [1e-4, -2e-3, 0.3], [1e-5, -1e-5, 2e-6]])
    rates = np.asarray(three.vector_field(0.3, jnp.asarray(y.ravel()), three.parameters())).reshape(3, 3)
    for k in range(3):
        assert np.allclose(rates[:, k], scene.vector_field(0.3, jnp.asarray(y[:, k]), p), rtol=1e-12)
    assert three.initial_state(three.parameters()).shape == (9,)
    # At steady slip the bristle bends by g/sigma_0, and the bed resists with g.
    steady = jnp.asarray([0.0, 0.3, 1.0 / 1e5])
    assert abs(float(scene.vector_field(0.0, steady, p)[2])) < 1e-12
    assert float(scene.flows(0.0, steady, p).taken["friction"]) == pytest.approx(0.3, rel=1e-9)


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
