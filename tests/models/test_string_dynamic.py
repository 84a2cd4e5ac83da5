"""The string of joints in full motion: its linear algebra, balances, the joint, steady turning, and what is refused."""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import QUICK

import bcfj_jax as bj
from bcfj_jax.models.joint import energy, system
from bcfj_jax.models.string import loads, torsional_stiffness
from bcfj_jax.models.string_motion import inertias

# The least joint: three particles without friction in windows without ends.
LEAST: Any = {
    "geometry": bj.scenes.JointGeometry(balls=3, spin=False), "materials": bj.scenes.JointMaterials(friction=False),
    "cage": bj.scenes.JointCage(window_ends=False, bands=False),
}  # fmt: skip


def made(count, groups, drive=None, rock=None, more=None, bit="none"):
    """The scene, its parameters and what it prepares."""
    groups = groups | {"drive": bj.scenes.JointDrive(**drive or {}), "loads": bj.scenes.JointLoads(**rock or {})}
    scene: Any = bj.scenes.string(n=count, motion="torsional", fidelity="dynamic", bit_friction=bit, **groups)
    params = scene.parameters(more or {})
    return scene, params, jax.jit(scene.prepare, compiler_options=QUICK)(params)


def noisy(scene, params, seed):
    """A state some 30 um and 0.3 m/s off the start; the cages' axes are unit vectors, a prescribed seat turns as told."""
    rng, joint = np.random.default_rng(seed), scene.joint
    places = 3 * joint.balls + joint.coupling
    y = np.array(jax.jit(scene.initial_state, compiler_options=QUICK)(params)).reshape(scene.count, -1)
    y[:, :places] += 3e-5 * rng.normal(size=(scene.count, places))
    y[:, places : joint.moving] += 0.3 * rng.normal(size=(scene.count, joint.moving - places))
    axis = y[:, 3 * joint.balls :][:, joint.slices["cage_turn"]]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    if not scene.flexible:
        y[0, scene.ends[1][0]] = float(params["drive_speed"])
    return jnp.asarray(y.ravel())


@functools.cache
def looked(count, plain, drive, rock, bit):
    """Everything of a noisy state that the tests below compare, compiled once."""
    scene, params, held = made(
        count, LEAST if plain else {}, {"drive": drive}, {"stick_slip": True} if rock else {}, bit=bit
    )
    t, places = jnp.asarray(0.03), 3 * scene.joint.balls + scene.joint.coupling
    size = np.where(np.arange(scene.joint.states) < places, 1.0, 1e4)
    size[scene.joint.moving :] *= 1e-9
    right = jnp.asarray(np.random.default_rng(1).normal(size=(count, size.size)) * size).ravel()

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(y, scale):
        stored = lambda y: sum(scene.flows(t, y, held).stored.values())  # noqa: E731
        rates, jacobian = scene.vector_field(t, y, held), jax.jacfwd(lambda y: scene.vector_field(t, y, held))(y)
        chain = scene.structure()
        factors = chain.factor(t, y, (scene, held), scale)
        solved = chain.solve(factors, right), chain.solve_transposed(factors, right)
        change = chain.time_derivative(t, y, (scene, held))
        rate = jax.jvp(stored, (y,), (rates,))[1]
        return solved, jacobian, rates, change, rate, scene.flows(t, y, held), scene.motions(t, y, held)

    return scene, params, held, right, look


CASES = [
    pytest.param(2, True, "flexible", True, "none", marks=pytest.mark.full),
    pytest.param(1, True, "prescribed", False, "brown_mcphee", marks=pytest.mark.slow),
    pytest.param(3, False, "prescribed", False, "none", marks=pytest.mark.slow),
    pytest.param(4, False, "flexible", False, "coulomb", marks=pytest.mark.slow),
]
EACH = pytest.mark.parametrize(("count", "plain", "drive", "rock", "bit"), CASES)


@EACH
def test_its_linear_algebra_is_the_dense_one(count, plain, drive, rock, bit):
    scene, params, _, right, look = looked(count, plain, drive, rock, bit)
    y, size = noisy(scene, params, 0), scene.joint.states
    for scale in (2e-5, 1e-3):
        (found, back), jacobian = look(y, scale)[:2]
        matrix = np.eye(y.size) / scale - jacobian
        for ours, theirs in ((found, np.linalg.solve(matrix, right)), (back, np.linalg.solve(matrix.T, right))):
            # Rounding: of the matrix that NumPy solves conditions are up to 1e17.
            rest = np.abs(np.asarray(ours) - theirs).reshape(count, size).max(0)
            assert (rest <= 1e-7 * np.abs(theirs).reshape(count, size).max(0).clip(1e-3 * np.abs(theirs).max())).all()
    if count > 2:
        # Only neighbours meet.
        blocks = np.asarray(jacobian).reshape(count, size, count, size)
        assert not blocks[0, :, 2:].any() and not blocks[2:, :, 0].any()


@EACH
def test_power_balances_at_every_instant(count, plain, drive, rock, bit):
    scene, params, held, _, look = looked(count, plain, drive, rock, bit)
    for seed in range(4):
        y = noisy(scene, params, seed)
        rate, (given, taken, _) = look(y, 2e-5)[4:6]
        # The stretch of a flexible drive moves with the drive, too.
        lag = scene._springs(jnp.asarray(0.03), y, held)[2][0]
        rate = float(rate) + float(held["drive_speed"] * held["coupling"][0] * lag)
        size = sum(abs(float(x)) for x in (*given.values(), *taken.values())) + abs(rate)
        assert abs(rate - float(sum(given.values()) - sum(taken.values()))) < 1e-9 * size
        assert taken["wall"] >= 0.0 and taken["friction"] >= 0.0


@EACH
def test_momentum_balances_along_the_string(count, plain, drive, rock, bit):
    # Every segment with the seat below it and the head above it: contacts, wall and bit turn it, no spring between.
    scene, params, held, _, look = looked(count, plain, drive, rock, bit)
    y = noisy(scene, params, 5)
    rates, moved = (look(y, 2e-5)[k] for k in (2, 6))
    told, speeds = scene.joints(params), scene.turns(rates)[1]
    contact = jax.vmap(lambda y, c: moments(scene.joint, c, y))(y.reshape(count, -1), held["joints"])
    rub = np.asarray(scene.rubbed(jnp.asarray(0.03), scene.turns(y)[1][:, 1], held))
    seat, head = (np.asarray(told[name]) for name in ("seat_inertia", "head_inertia"))
    for i in range(count):
        turned = head[i] * speeds[i, 1] + (seat[i + 1] * speeds[i + 1, 0] if i + 1 < count else 0.0)
        pushed = contact[i, 1] + rub[i] + (contact[i + 1, 0] if i + 1 < count else 0.0)
        assert abs(float(turned - pushed)) < 1e-9 * float(np.abs(contact).max())
    # What is read as a joint's torque turns its seat.
    first = 1 if drive == "prescribed" else 0
    assert np.allclose(
        moved["joint"].drive[first:],
        (seat * speeds[:, 0] - contact[:, 0])[first:],
        rtol=1e-9,
        atol=1e-9 * np.abs(contact).max(),
    )
    if first:
        assert float(moved["joint"].drive[0]) == pytest.approx(-float(contact[0, 0]), rel=1e-12)
    assert np.allclose(moved["lump"].spin_rate[:, 2], speeds[:, 1])


def moments(joint, c, y):
    """Of the contacts on seat and head about their axes [N m]."""
    exerted = system.on_parts(joint, c, system.view(joint, c, y))
    return jnp.stack(
        [sum(x.moment for x in exerted[name].values()) @ c.axes[i] for i, name in enumerate(("seat", "head"))]
    )


@pytest.mark.full
def test_its_derivative_by_time_is_that_of_loads_and_drive():
    rock = {"fluctuating": ["torque", "axial"]}
    scene, params, held = made(2, LEAST, {"drive_profile": "smooth"}, rock, {"drive_ramp": 0.1})
    y, h = noisy(scene, params, 0), 1e-6

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(t):
        return scene.vector_field(t, y, held), scene.structure().time_derivative(t, y, (scene, held))

    found = np.asarray(look(0.02)[1])
    differences = np.asarray(look(0.02 + h)[0] - look(0.02 - h)[0]) / (2.0 * h)
    assert np.allclose(found, differences, rtol=1e-4, atol=1e-4 * np.abs(found).max())
    # Axial force on both heads, the wall's torque, the bit's, and the drive of the first seat.
    spots = scene.coordinates()
    changing = {spots[f"joint[{i}].head.{axis}"][1] for i in (1, 2) for axis in "xz"}
    assert set(np.flatnonzero(found)) == changing | {
        spots[name][1] for name in ("lump[1]", "lump[2]", "joint[1].seat_turn")
    }


def test_its_inertia_is_that_of_the_string_and_of_its_seats():
    scene, params, held = made(4, LEAST)
    told = scene.joints(params)
    whole = float(told["head_inertia"].sum() + told["seat_inertia"][1:].sum())
    right = float(inertias(params, 4).sum()) + 3 * float(params["seat_inertia"])
    assert whole == pytest.approx(right, rel=1e-12)
    assert np.allclose(held["coupling"], [0.0] + 3 * [float(torsional_stiffness(params))], rtol=1e-12)
    found = loads(params, 4)
    assert np.allclose(scene.axial(jnp.asarray(1.0), held), found.axial, rtol=1e-12)


@pytest.mark.slow
def test_a_weight_over_time_is_handed_down_at_once():
    rock = {"axial_profile": "table", "axial_table": [[0.0, 0.1], [0.0, 20e3]]}
    scene, params, held = made(3, LEAST, {}, rock)
    right = loads({**params, "weight_on_bit": jnp.asarray(5e3)}, 3).axial
    assert np.allclose(scene.axial(jnp.asarray(0.025), held), right, rtol=1e-12)


@pytest.mark.slow
def test_joints_of_the_same_load_may_be_swapped():
    # Without the wall's friction all joints have the same load: two that change places change the field's rows alone.
    scene, params, held = made(3, LEAST, more={"wall_friction": 0.0, "bit_torque": 0.0, "bit_inertia": 0.0})
    rates = jax.jit(lambda y: scene.vector_field(0.0, y, held), compiler_options=QUICK)
    y = np.array(noisy(scene, params, 3)).reshape(3, -1)
    ends = np.concatenate(scene.ends)
    # Seats and heads without play between segments: only what is within the joints differs.
    y[:, ends] = np.array(scene.initial_state(params)).reshape(3, -1)[:, ends]
    swapped, inside = y[[0, 2, 1]], np.setdiff1d(np.arange(y.shape[1]), ends)
    ours, theirs = (np.asarray(rates(jnp.asarray(x.ravel()))).reshape(3, -1)[:, inside] for x in (y, swapped))
    assert np.allclose(ours[[0, 2, 1]], theirs, rtol=1e-9, atol=1e-9 * np.abs(ours).max())


def alone(params, **more):
    """The joint that a string of one is."""
    angle = 2.0 * math.asin(0.5 * float(params["segment_length"]) / float(params["hole_radius"]))
    inertia = float(inertias(params, 1)[0])
    return {"joint_angle": angle, "load_torque": 1800.0, "axial_load": 20e3, "head_inertia": inertia} | more


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["prescribed", "flexible"])
def test_one_joint_is_the_joint(drive):
    drive = bj.scenes.JointDrive(drive=drive)
    scene = bj.scenes.string(n=1, motion="torsional", fidelity="dynamic", drive=drive)
    params, times = scene.parameters(), np.linspace(0.0, 0.2, 401)
    joint = bj.scenes.joint(drive=drive)
    right = bj.simulate(joint, joint.parameters(alone(params)), times, accuracy=1e-3)
    run = bj.simulate(scene, params, times, accuracy=1e-3)
    assert run.status == right.status == "ok"
    # From where the accuracy is promised.
    late = times > 0.1
    for name, force in right.force.items():
        ours, theirs = run.force[name][late], force[late]
        assert np.sqrt(np.mean((ours - theirs) ** 2, 0)).max() <= 1e-3 * max(np.abs(theirs).max(), 1.0), name


@pytest.mark.full
def test_the_field_of_one_joint_is_the_joints():
    scene, params, held = made(1, LEAST, more={"wall_friction": 0.0})
    joint = bj.scenes.joint(**LEAST)
    told = joint.parameters(alone(params))

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(t, y):
        return scene.vector_field(t, y, held), joint.vector_field(t, y, joint.prepare(told))

    for seed, t in ((0, 0.01), (1, 0.3)):
        ours, theirs = look(jnp.asarray(t), noisy(scene, params, seed))
        assert np.allclose(ours, theirs, rtol=1e-12, atol=1e-12 * float(jnp.abs(theirs).max()))


@pytest.mark.slow
def test_torque_and_power_close_along_a_string_that_turns():
    """Over a ball's pitch in which the motion repeats itself: torque and power of every joint, to 0.1 %."""
    scene, params, held = made(3, {})
    joint = scene.joint
    pitch = 2.0 * math.pi / (6.0 * float(params["drive_speed"]))
    times = np.linspace(0.0, 4.0 * pitch, 4001)
    run = bj.simulate(scene, params, times, accuracy=1e-3, read=["joint_1.torque", "joint_3.torque", "top.torque"])
    assert run.status == "ok"
    late = slice(3000, None)

    def look(t, y):
        c = loaded(scene, t, held)
        power = jax.vmap(lambda y, c: energy.power(joint, c, t, y))(y.reshape(3, -1), c)
        stored = jax.vmap(lambda y, c: energy.stored(joint, c, t, y))(y.reshape(3, -1), c)
        speed = scene.turns(y)[1]
        flows = scene.flows(t, y, held)
        return scene.torque(t, y, held), speed, power.axial + power.lost, stored.total, flows

    each = jax.jit(lambda *x: jax.lax.map(lambda x: look(*x), x, batch_size=100), compiler_options=QUICK)
    found = each(jnp.asarray(times[late]), jnp.asarray(run.trajectory)[late])
    torque, speed, lost, stored, (given, taken, kept) = jax.tree.map(np.asarray, found)
    span = times[late]
    mean = lambda x: np.trapezoid(x, span, axis=0) / (span[-1] - span[0])  # noqa: E731
    # Torque: the statics', and what friction within the joints below takes more.
    statics = loads(params, 3)
    assert (mean(torque) > np.asarray(statics.torque) * (1.0 - 1e-3)).all()
    assert (mean(torque) < np.asarray(statics.torque) * 1.2).all()
    # Power of the string as a whole.
    net = mean(sum(given.values())) - mean(sum(taken.values()))
    whole: Any = sum(kept.values())
    change = (whole[-1] - whole[0]) / (span[-1] - span[0])
    assert abs(net - change) < 1e-3 * mean(given["drive"])
    # And of each joint with the torque that it hands on.
    below = np.append(torque[:, 1:], 0.0 * torque[:, :1], 1)
    rub = np.asarray(jax.vmap(lambda t, s: scene.rubbed(t, s, held))(jnp.asarray(span), jnp.asarray(speed[..., 1])))
    net = mean(torque * speed[..., 0] - (below - rub) * speed[..., 1] - lost)
    change = (stored[-1] - stored[0]) / (span[-1] - span[0])
    assert np.abs(net - change).max() < 1e-3 * mean(torque * speed[..., 0]).max()


def loaded(scene, t, held):
    """The joints' constants with their axial force."""
    return eqx.tree_at(lambda c: c.programmes["axial_load"], held["joints"], scene.axial(t, held))


@pytest.mark.slow
def test_derivatives_of_forces_are_differences():
    # Friction keeps the balls' first impacts from parting neighbouring runs.
    rough = {key: group for key, group in LEAST.items() if key != "materials"}
    scene, params, _ = made(2, rough)
    way = {"segment_modulus": 1.0, "bit_torque": 0.5, "wall_friction": -0.7, "seat_inertia": 1.0}
    params, times = params | {"load_ramp": jnp.asarray(0.005)}, np.linspace(0.0, 0.01, 41)

    @jax.jit
    def read(share):
        def force(share):
            told = {name: x * (1.0 + share * way.get(name, 0.0)) for name, x in params.items()}
            return bj.force_history(scene, told, times, accuracy=1e-5)["seat_ball"][..., 0]

        return jax.jvp(force, (share,), (jnp.ones(()),))

    slope, step = np.asarray(read(0.0)[1]), 1e-3
    differences = np.asarray(read(step)[0] - read(-step)[0]) / (2.0 * step)
    assert np.abs(slope - differences).max() < 1e-2 * np.abs(differences).max()


def test_what_is_refused_before_the_run():
    with pytest.raises(bj.InputError, match=r"exchange no dynamics.*give motion = 'torsional'"):
        bj.scenes.string(fidelity="dynamic")
    with pytest.raises(bj.InputError, match="'lugre' beside joints in motion"):
        bj.scenes.string(motion="torsional", fidelity="dynamic", bit_friction="lugre")
    with pytest.raises(bj.InputError, match="no level 'auto'"):
        bj.scenes.string(motion="torsional", fidelity="auto")
    scene, params, _ = made(3, LEAST)
    scene.check(params)
    for name, value, said in (
        ("hole_radius", 0.3, "give at least"), ("bit_torque", 1e5, "give at most"), ("weight_on_bit", 1e9, "weight_on_bit"),
        ("segment_bore", 0.06, "less than segment_radius"), ("clearance_seat_ball", -1e-5, "clearance"),
    ):  # fmt: skip
        with pytest.raises(bj.InputError, match=said):
            scene.check({**params, name: jnp.asarray(value)})
    with pytest.raises(bj.InputError, match="seat_inertia"):
        scene.parameters(seat_inertia=-1.0)
