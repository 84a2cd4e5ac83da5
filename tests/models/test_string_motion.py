"""The string in motion: chain of textbooks, balances, SciPy's stick-slip, one joint, and what is refused."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.mechanism.model import field
from bcfj_jax.mechanism.structure import Dense
from bcfj_jax.models.string import loads, torsional_stiffness
from bcfj_jax.models.string_motion import inertias

OWN = 4e5  # A joint's stiffness [N m/rad], where the test gives it.


def moving(count=4, fidelity="kinematic", own=OWN, drive=None, rock=None, more=None, bit="none"):
    """The scene, its parameters and what it prepares, by a given stiffness of joints."""
    groups: Any = {"drive": bj.scenes.JointDrive(**drive or {}), "loads": bj.scenes.JointLoads(**rock or {})}
    scene: Any = bj.scenes.string(n=count, motion="torsional", fidelity=fidelity, bit_friction=bit, **groups)
    params = scene.parameters(more or {})
    return scene, params, scene.coupled(params, jnp.full(count, own))


def some_state(scene, params, seed=0):
    rng, n = np.random.default_rng(seed), scene.count
    speed = float(params["drive_speed"]) * rng.uniform(0.2, 1.5, n)
    bend = 1e-4 * rng.standard_normal(n) if scene._bit.bristles else []
    return jnp.asarray(np.concatenate([1e-3 * rng.standard_normal(n).cumsum(), speed, bend]))


@pytest.mark.parametrize("count", [1, 7])
def test_natural_frequencies_are_those_of_a_fixed_free_chain(count):
    # w_j = 2 sqrt(k/I) sin((2 j - 1) pi/(2 (2 n + 1))), Rao 2017; without damping, wall and bit.
    quiet = {"bit_torque": 0.0, "weight_on_bit": 0.0, "twist_relaxation": 0.0, "bit_inertia": 0.0, "wall_friction": 0.0}
    scene, params, held = moving(count, more=quiet)
    jacobian = jax.jit(jax.jacfwd(lambda y: scene.vector_field(0.0, y, held)))(scene.initial_state(params))
    found = np.linalg.eigvals(jacobian)
    k = 1.0 / (1.0 / OWN + 1.0 / float(torsional_stiffness(params)))
    wave = 2.0 * np.sqrt(k / float(inertias(params, count)[0]))
    right = wave * np.sin((2 * np.arange(1, count + 1) - 1) * np.pi / (2 * (2 * count + 1)))
    assert np.allclose(found.real, 0.0, atol=1e-6 * wave)
    assert np.allclose(np.sort(np.abs(found.imag))[::2], right, rtol=1e-9)


@pytest.mark.parametrize(("count", "bit"), [(1, "none"), (2, "none"), (8, "none"), (1, "lugre"), (5, "lugre")])
def test_its_linear_algebra_is_the_dense_one(count, bit):
    rock = {"stick_slip": True} if bit == "none" else {}
    scene, params, held = moving(count, drive={"drive": "flexible"}, rock=rock, bit=bit)
    y, t = some_state(scene, params), jnp.asarray(0.03)
    right = jnp.asarray(np.random.default_rng(1).random(y.size))

    @jax.jit
    def both(scale):
        found = [(x, x.factor(t, y, (scene, held), scale)) for x in (scene.structure(), Dense(field))]
        return [(x.solve(of, right), x.solve_transposed(of, right)) for x, of in found]

    for scale in (1e-5, 1e-2):
        for ours, theirs in zip(*both(scale), strict=True):
            assert np.allclose(ours, theirs, rtol=1e-9, atol=1e-9 * float(jnp.abs(theirs).max()))


@pytest.mark.slow
def test_a_run_reads_what_its_joints_bear():
    """By the stiffness that it finds of them: those of the same states at a stiffness given."""
    scene, params, _ = moving(1, bit="lugre")
    times = np.linspace(0.0, 0.02, 4)
    run = bj.simulate(scene, params, times)
    assert run.status == "ok", run.reason
    found = scene.completed(params)
    assert float(found["joint_stiffness"][0]) > 0.0 and scene.completed(found) is found
    read = scene.observe(jnp.asarray(times[-1]), jnp.asarray(run.trajectory[-1]), scene.prepare(found))
    for name, reading in read.items():
        np.testing.assert_allclose(run.force[name][-1], reading.force, rtol=1e-6, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("rock", [{}, {"stick_slip": True}, {"fluctuating": ["torque", "axial"]}, "lugre"])
def test_power_balances_at_every_instant(rock):
    given: Any = {"bit": rock} if rock == "lugre" else {"rock": rock}
    scene, params, held = moving(5, drive={"drive": "flexible"}, **given)
    y, t = some_state(scene, params), jnp.asarray(0.06)

    @jax.jit
    def balanced(y):
        stored = lambda y: sum(scene.flows(t, y, held).stored.values())  # noqa: E731
        rate = jax.jvp(stored, (y,), (scene.vector_field(t, y, held),))[1]
        return scene.flows(t, y, held), rate, scene.motions(t, y, held)["joint"]

    (given, taken, _), rate, top = balanced(y)
    # The stretch of the first spring moves with the drive, too.
    drive = float(held["drive_speed"] * held["coupling"][0] * top.angle[0])
    size = sum(abs(float(x)) for x in (*given.values(), *taken.values()))
    assert abs(float(rate) + drive - float(sum(given.values()) - sum(taken.values()))) < 1e-9 * size
    assert taken["wall"] > 0.0 and taken["damping"] >= 0.0


def test_torque_balances_along_the_string_in_steady_turning():
    # Equilibrium of the field itself: each lump takes what the wall takes, the last hands the bit its torque.
    scene, params, held = moving(6)
    found, n = loads(params, 6), 6
    speed = float(params["drive_speed"])
    slip = 1.0 / np.sqrt(1.0 + (float(params["wall_speed"] / params["segment_radius"]) / speed) ** 2)
    wall = np.append(np.asarray(found.around[1:]), 0.0)
    torque = wall[::-1].cumsum()[::-1] * slip + 1800.0
    t = jnp.asarray(0.1)
    angle = speed * t - np.cumsum(torque / np.asarray(held["coupling"]))
    y = jnp.concatenate([jnp.asarray(angle), jnp.full(n, speed)])
    rates, moved = jax.jit(lambda y: (scene.vector_field(t, y, held), scene.motions(t, y, held)))(y)
    assert np.allclose(rates[n:] * np.asarray(inertias(params, n)), 0.0, atol=1e-6 * 1800.0)
    assert np.allclose(moved["joint"].drive, found.torque, rtol=1e-3)
    assert float(moved["top"].drive) == pytest.approx(float(found.drive_torque), rel=1e-3)
    assert slip == pytest.approx(1.0, abs=1e-4)


def test_a_straight_string_without_load_turns_as_the_drive():
    scene, params, held = moving(4, more={"hole_radius": 1e9, "weight_on_bit": 0.0, "bit_torque": 0.0})
    y = scene.initial_state(params)
    rates, torque = jax.jit(lambda t: (scene.vector_field(t, y, held), scene.torque(t, y, held)))(jnp.zeros(()))
    assert np.allclose(rates[:4], params["drive_speed"])
    assert np.allclose(rates[4:], 0.0, atol=1e-12)
    assert np.allclose(torque, 0.0)


def test_what_is_refused():
    with pytest.raises(bj.InputError, match="without motion"):
        bj.scenes.string(loads=bj.scenes.JointLoads(stick_slip=True))
    with pytest.raises(bj.InputError, match="no motion 'lateral'"):
        bj.scenes.string(motion="lateral")
    with pytest.raises(bj.InputError, match="motion = 'torsional'"):
        bj.scenes.string(fidelity="dynamic")
    with pytest.raises(bj.InputError, match="no option 'cages'"):
        bj.scenes.string(cages=None)
    with pytest.raises(bj.InputError, match="no friction 'memory'"):
        bj.scenes.string(motion="torsional", bit_friction="memory")


@pytest.mark.parametrize(
    ("rock", "bit", "given", "most"),
    [
        ({"stick_slip": True}, "none", {"stick_ratio": 4.0, "bit_torque": 1500.0}, 1.0 / 4.0),
        ({}, "brown_mcphee", {"stick_ratio": 4.0, "bit_torque": 1500.0}, 1.0 / 4.0),
        ({"fluctuating": ["torque"]}, "none", {"load_amplitude": 4500.0, "bit_torque": 1500.0}, 1.0),
    ],
)
def test_a_bit_that_takes_more_than_the_drive_has_at_its_greatest_is_refused(rock, bit, given, most):
    loads_ = bj.scenes.JointLoads(**rock)
    scene: Any = bj.scenes.string(n=3, motion="torsional", fidelity="kinematic", bit_friction=bit, loads=loads_)
    with pytest.raises(bj.InputError, match="6000 N m at its greatest, takes") as refused:
        scene.check(scene.parameters(given))
    number = float(str(refused.value).split("give at most ")[1].split()[0])
    # The wall takes some of the drive's 6 kN m.
    wall = float(loads(scene.parameters(given), 3).around.sum())
    assert number == pytest.approx(1500.0 - wall * most, rel=1e-3)
    scene.check(scene.parameters(given | {"bit_torque": number - 1.0}))


def test_a_weight_over_time_rubs_at_the_wall_as_one_of_that_size():
    rock = {"axial_profile": "table", "axial_table": [[0.0, 0.1, 0.2], [0.0, 8e3, 20e3]]}
    scene, params, held = moving(4, rock=rock)
    assert float(params["weight_on_bit"]) == 20e3
    assert {0.0, 0.1, 0.2} <= set(np.asarray(scene.breaks(params, 1.0)).tolist())
    speed = jnp.full(4, 1e3)
    for t, size in ((0.05, 4e3), (0.15, 14e3)):
        right = loads({**params, "weight_on_bit": jnp.asarray(size)}, 4).around
        push = scene.torsion.loads[1].on_coordinate(jnp.asarray(t), None, speed, held)
        assert np.allclose(-push, [*right[1:], 0.0], rtol=1e-6)
        _, given, rubs = scene._top(jnp.asarray(t), jnp.concatenate([speed, speed]), held)
        assert float(rubs) == pytest.approx(float(right[0]), rel=1e-3) and float(given) != 0.0
    scene.check(params)
    swings = {"axial_profile": "constant", "fluctuating": ["axial"]}
    scene = moving(4, rock=swings)[0]
    with pytest.raises(bj.InputError, match="weight_on_bit"):
        scene.check(scene.parameters(axial_amplitude=1e9, wall_friction=0.0))
    with pytest.raises(bj.InputError, match=r"less weight_on_bit and axial_amplitude, .*, or a drive_torque"):
        scene.check(scene.parameters(axial_amplitude=1e7))
    # The number that it tells is the steady part of what just passes, at the top of the swing.
    for given in ({"wall_friction": 0.0}, {"drive_torque": 9000.0, "segment_modulus": 1e15}):
        many = given | {"axial_amplitude": 1e5, "weight_on_bit": 1e9}
        with pytest.raises(bj.InputError) as refused:
            scene.check(scene.parameters(many))
        number = float(str(refused.value).split("at most ")[1].split()[0])
        scene.check(scene.parameters(many | {"weight_on_bit": 0.999 * number}))
        with pytest.raises(bj.InputError):
            scene.check(scene.parameters(many | {"weight_on_bit": 1.001 * number}))


STICKY = {
    "drive_stiffness": 800.0, "drive_damping": 3.0, "bit_inertia": 6.0, "drive_speed": 6.0, "load_ramp": 0.5,
    "stick_ratio": 2.0, "stick_speed": 1.0, "stick_width": 0.05, "wall_friction": 0.0,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("bit", ["none", "lugre"])
def test_stick_slip_of_one_lump_is_scipys(bit):
    from scipy.integrate import solve_ivp

    scene = bj.scenes.string(
        n=1, motion="torsional", fidelity="kinematic", drive=bj.scenes.JointDrive(drive="flexible"),
        loads=bj.scenes.JointLoads(stick_slip=bit == "none"), bit_friction=bit,
    )  # fmt: skip
    # Stribeck's curve of ``lugre`` falls with the square of the speed within stick_width.
    given = STICKY if bit == "none" else {k: x for k, x in STICKY.items() if k != "stick_speed"} | {"stick_width": 1.0}
    params = scene.parameters(given)
    times = np.linspace(0.0, 12.0, 2401)
    run = bj.simulate(scene, params, times, accuracy=1e-3, read=["joint_1.torque", "lump_1.speed"])
    assert run.status == "ok"
    told = scene.whole(params, run)[0]["string"]
    assert told["torque_greatest"][0] == pytest.approx(run.readings["joint_1.torque"].max(), rel=1e-9)
    assert told["bit_speed"][1] == pytest.approx(run.readings["lump_1.speed"].max(), rel=1e-9)
    held = jax.jit(scene.prepare)(params)
    k, c, inertia = float(held["coupling"][0]), 3.0, float(inertias(params, 1)[0])

    def rates(t, y):
        s = min(t / 0.5, 1.0)
        rise = s**3 * (10.0 + s * (6.0 * s - 15.0))
        rock, bends = np.tanh(y[1] / 0.05) * (1.0 + 1.0 / (1.0 + y[1] ** 2)), 0.0
        if bit == "lugre":
            bends = y[1] - abs(y[1]) * 1e3 * y[2] / (1.0 + np.exp(-(y[1] ** 2)))
            rock = 1e3 * y[2] + 0.1 * bends
        return [y[1], (k * (6.0 * t - y[0]) + c * (6.0 - y[1]) - 1800.0 * rise * rock) / inertia, bends]

    right = solve_ivp(rates, (0.0, 12.0), [0.0, 6.0, 0.0], "LSODA", rtol=1e-9, atol=1e-10, t_eval=times)
    torque = k * (6.0 * times - right.y[0]) + c * (6.0 - right.y[1])
    ours, theirs = run.readings["lump_1.speed"], right.y[1]
    # It sticks for a good part of the time, and slips at more than twice the drive's speed.
    late = times > 4.0
    assert 0.1 < np.mean(theirs[late] < 0.1) < 0.9 and theirs.max() > 12.0
    # Amplitude and period of the limit cycle, then the whole history.
    assert ours[late].max() == pytest.approx(theirs[late].max(), rel=1e-3)
    assert np.ptp(run.readings["joint_1.torque"][late]) == pytest.approx(np.ptp(torque[late]), rel=1e-3)
    assert period(times, ours) == pytest.approx(period(times, theirs), rel=1e-3)
    assert np.abs(run.readings["joint_1.torque"] - torque).max() < 1e-2 * np.ptp(torque)


def period(times, speed):
    """Mean time between rises of the speed through 6 rad/s after 4 s."""
    at = np.flatnonzero((speed[:-1] < 6.0) & (speed[1:] >= 6.0) & (times[1:] > 4.0))
    exact = times[at] + (6.0 - speed[at]) / (speed[at + 1] - speed[at]) * (times[at + 1] - times[at])
    return float(np.diff(exact).mean())


@pytest.mark.slow
@pytest.mark.parametrize("weights", [None, [20e3, 10e3, 10e3]])
def test_joints_bear_what_a_joint_bears_under_torque_and_weight_of_the_instant(weights):
    rock = {"axial_profile": "table", "axial_table": [[0.0, 0.3, 0.6], weights]} if weights else {}
    scene = bj.scenes.string(n=1, motion="torsional", loads=bj.scenes.JointLoads(**rock))
    params = scene.parameters(wall_friction=0.0)
    times = np.linspace(0.0, 0.6, 13)
    run = bj.simulate(scene, params, times, read=["joint_1.torque"])
    assert run.readings["joint_1.torque"][-1] == pytest.approx(1800.0, rel=1e-3)
    weight = jnp.asarray(weights[-1] if weights else 20e3)
    found, joint = loads({**params, "weight_on_bit": weight}, 1), bj.scenes.joint(fidelity="quasistatic")
    told = {"joint_angle": found.bend[0], "load_torque": 1800.0, "axial_load": found.axial[0]}
    right = bj.simulate(joint, joint.parameters(told), times)
    for name, force in right.force.items():
        assert np.allclose(run.force[name][-3:], force[-3:], atol=2e-3 * max(1.0, np.abs(force).max())), name
        slips = run.slip[name][-3:], right.slip[name][-3:]
        assert np.allclose(*slips, atol=1e-2 * max(1e-3, np.abs(slips[1]).max())), name


@pytest.mark.slow
def test_derivatives_of_the_torque_are_differences():
    scene = bj.scenes.string(n=2, motion="torsional", fidelity="kinematic", loads=bj.scenes.JointLoads(stick_slip=True))
    params = scene.parameters()
    times = np.linspace(0.0, 0.2, 41)
    read = lambda p: bj.reading_history(scene, p, times, ["joint_1.torque"], accuracy=1e-7)["joint_1.torque"]  # noqa: E731
    size = float(jnp.ptp(read(params)))
    for name in ("stiffness", "bit_torque", "segment_modulus", "wall_friction"):
        value = float(params[name])
        way = {key: jnp.asarray(value if key == name else 0.0) for key in params}
        slope = np.asarray(jax.jvp(read, (params,), (way,))[1])
        step = 1e-4
        ends = (read(params | {name: jnp.asarray(value * (1.0 + s * step))}) for s in (1, -1))
        differences = np.asarray(next(ends) - next(ends)) / (2.0 * step)
        assert np.abs(slope - differences).max() < 1e-3 * max(np.abs(differences).max(), 1e-3 * size), name


@pytest.mark.parametrize("law", ["coulomb", "step", "brown_mcphee", "lugre"])
def test_the_bit_has_the_friction_of_ideal_joints(law):
    scene: Any = bj.scenes.string(n=2, motion="torsional", bit_friction=law)
    params = scene.parameters(stick_ratio=1.5, stick_width=0.2)
    told: Any = {"sliding": 1800.0, "breakaway": 2700.0, "speed": 0.2}
    told |= {"bristle_stiffness": 1800.0 * 1e3, "bristle_damping": 1800.0 * 0.1} if law == "lugre" else {}
    joint, bit = bj.loads.JointFriction("bit", "lump", friction=law, **told), scene.torsion.loads[2]
    known: Any = {f"bit.{key}": value for key, value in told.items()}
    for speed in (-3.0, 0.05, 0.2, 10.0):
        bend = [-7e-4] if law == "lugre" else []
        held, rates = [jnp.asarray([5e-4, x]) for x in bend], jnp.asarray([9.0, speed])
        push = bit.on_coordinate(jnp.asarray(1.0), None, rates, params, *held)
        assert float(push[0]) == 0.0
        assert float(push[1]) == pytest.approx(
            float(joint.on_coordinate(jnp.asarray(0.0), 0.0, speed, known, *bend)), rel=1e-12
        )
        if bend:
            right = [0.0, float(joint.bending(speed, bend[0], known))]
            assert np.allclose(bit.bending(rates, held[0], params), right, rtol=1e-12)


def test_a_table_drives_the_bit():
    rock = {"load_profile": "table", "load_table": [[0.0, 0.1, 0.2], [0.0, 900.0, 600.0]]}
    scene, params, held = moving(2, rock=rock)
    scene.check(params)
    assert float(params["bit_torque"]) == 900.0
    assert np.allclose(np.asarray(scene.breaks(params, 1.0))[:3], [0.0, 0.1, 0.2])
    y = scene.initial_state(params)
    push = scene.torsion.loads[2].on_coordinate(jnp.asarray(0.15), *jnp.split(y, 2), held)
    assert np.allclose(push, [0.0, -750.0])
    assert dataclasses.replace(scene) == scene
