"""The cross-shaft joint: closed form without clearance; with it an independent integration, balances, symmetry."""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bcfj_jax import scenes, simulate
from bcfj_jax.solve.simulation import reading_history

SINGLE, DOUBLE = scenes.hooke(), scenes.hooke(double=True)
# The load rises at once, so that a short run has all of it.
QUICK = {"load_ramp": 4e-3, "load_torque": 900.0}
END = 8e-3
ANGLE = math.radians(23.0)


@functools.cache
def led(double, angle=ANGLE):
    """Motions over two turns of the joint without clearance, the input's turn, and parameters."""
    scene = scenes.hooke(double=double, ideal=True)
    params = scene.parameters(joint_angle=angle)
    times = jnp.linspace(0.0, 1.3, 401)
    found = jax.jit(jax.vmap(lambda t: scene.motions(t, jnp.zeros(0), params)))(times)
    return found, np.asarray(params["drive_speed"] * times), params


@pytest.mark.parametrize("angle", [0.0, ANGLE, math.radians(60.0)])
def test_closed_form_of_angle_and_speed_ratio(angle):
    found, turn, params = led(False, angle)
    output = np.asarray(found["output"].angle)
    exact = np.unwrap(np.arctan2(np.sin(turn), np.cos(angle) * np.cos(turn)))
    assert np.abs(output - exact).max() < 1e-9
    ratio = np.linalg.norm(found["output"].spin, axis=1) / float(params["drive_speed"])
    assert np.abs(ratio - np.cos(angle) / (1.0 - np.sin(angle) ** 2 * np.cos(turn) ** 2)).max() < 1e-9
    # The cross is in both yokes: its second pin lies along the bores of the output.
    assert np.abs(np.asarray(found["cross_arm"].axes - found["output_yoke"].axes)[..., 2]).max() < 1e-12
    # Torque is handed on by the speed ratio; the rest of the input's torque speeds bodies up.
    speed, change = ratio * float(params["drive_speed"]), np.asarray(found["output"].spin_rate)
    way = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    raised = np.clip(turn / float(params["drive_speed"]) / 0.05, 0.0, 1.0)
    load = 1800.0 * raised**3 * (10.0 - 15.0 * raised + 6.0 * raised**2) + 1.1e-3 * change @ way
    assert np.allclose(np.asarray(found["input"].drive), ratio * load, atol=2e-2)
    assert np.abs(np.asarray(found["output"].drive)).max() < 1e-9 and speed.min() > 0.0


def test_the_double_joint_turns_evenly():
    found, turn, params = led(True)
    assert np.abs(np.asarray(found["output"].angle) - turn).max() < 1e-9
    assert np.abs(np.linalg.norm(found["output"].spin, axis=1) / float(params["drive_speed"]) - 1.0).max() < 1e-9
    half = 0.5 * float(params["joint_angle"])
    shaft = np.unwrap(np.arctan2(np.sin(turn), np.cos(half) * np.cos(turn)))
    assert np.abs(np.asarray(found["shaft"].angle) - shaft).max() < 1e-9
    for arm in ("cross_arm", "far_cross_arm"):
        assert np.abs(np.asarray(found[arm].axes - found["shaft_yoke"].axes)[..., 2]).max() < 1e-12
    assert np.abs(np.asarray(found["far_cross"].place - found["output"].place)).max() < 1e-15


# --- an independent integration of the single joint with clearance


def _pins(t, y, p):
    """Forces (4, 3) on the pins' ends, their points, and normal forces: of the input's pin, then of the output's."""
    b, bs, x, v, q, w = y[0], y[1], y[2:5], y[5:8], y[8:12] / np.linalg.norm(y[8:12]), y[12:15]
    s, i, j, k = q
    along_z = np.array([2 * (i * k + s * j), 2 * (j * k - s * i), 1 - 2 * (i * i + j * j)])
    along_y = np.array([2 * (i * j - s * k), 1 - 2 * (i * i + k * k), 2 * (j * k + s * i)])
    a, d = p["drive_speed"] * t, p["joint_angle"]
    bores = (
        (np.array([0.0, -np.sin(a), np.cos(a)]), np.array([p["drive_speed"], 0.0, 0.0]), along_z),
        (
            np.array([np.sin(b) * np.sin(d), np.cos(b), np.sin(b) * np.cos(d)]),
            bs * np.array([np.cos(d), 0.0, -np.sin(d)]),
            along_y,
        ),
    )
    forces, points, normals, clearance = [], [], [], (p["clearance_input_pins"], p["clearance_output_pins"])
    for (axis, spin, pin), gap in zip(bores, clearance, strict=True):
        for sign in (1.0, -1.0):
            place = x + sign * p["half_length"] * pin
            off = place - axis * (axis @ place)
            size = np.sqrt(off @ off + 1e-24)
            normal, depth = off / size, size - gap
            point = place + p["radius"] * normal
            velocity = v + np.cross(w, point - x) - np.cross(spin, point)
            rate = normal @ velocity
            pressed = max(0.0, p["stiffness"] * max(depth, 0.0) ** 1.5 * (1.0 + p["damping"] * rate))
            slide = velocity - rate * normal
            r = np.sqrt(slide @ slide) / p["friction_speed"] + 1e-30
            mu = p["friction_dynamic"] * np.tanh(4 * r)
            mu += (p["friction_static"] - p["friction_dynamic"]) * r / (0.25 * r * r + 0.75) ** 2
            forces.append(-pressed * (normal + mu / (r * p["friction_speed"]) * slide))
            points.append(point)
            normals.append(pressed)
    return np.array(forces), np.array(points), np.array(normals)


def _rates(t, y, p):
    forces, points, _ = _pins(t, y, p)
    x, q, w = y[2:5], y[8:12], y[12:15]
    s, i, j, k = q / np.linalg.norm(q)
    turn = np.array([
        [1 - 2 * (j * j + k * k), 2 * (i * j - s * k), 2 * (i * k + s * j)],
        [2 * (i * j + s * k), 1 - 2 * (i * i + k * k), 2 * (j * k - s * i)],
        [2 * (i * k - s * j), 2 * (j * k + s * i), 1 - 2 * (i * i + j * j)],
    ])  # fmt: skip
    # Two steel bars of 0.119 kg along z and y; output of 1e-3 with a yoke of 1e-4 kg m^2.
    inertia = turn @ np.diag([1.18e-4, 6.28e-5, 6.28e-5]) @ turn.T
    moment = np.cross(points - x, forces).sum(0) - np.cross(w, inertia @ w)
    s = min(t / p["load_ramp"], 1.0)
    load = p["load_torque"] * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    way = np.array([np.cos(p["joint_angle"]), 0.0, -np.sin(p["joint_angle"])])
    given = -np.cross(points[2:], forces[2:]).sum(0) @ way - load
    a, b, c = w
    spin = 0.5 * np.array([[0, -a, -b, -c], [a, 0, -c, b], [b, c, 0, -a], [c, -b, a, 0]]) @ q
    return np.concatenate([
        [y[1], given / 1.1e-3], y[5:8], forces.sum(0) / 0.238, spin, np.linalg.solve(inertia, moment)
    ])  # fmt: skip


@functools.cache
def reference():
    """Parameters, times, states (T, 15) and normal forces (T, 4) by a tight integration in NumPy and SciPy."""
    p = {name: float(x) for name, x in SINGLE.parameters(QUICK).items()}
    d, speed = p["joint_angle"], p["drive_speed"]
    y = np.zeros(15)
    y[1], y[8], y[12:15] = speed / np.cos(d), 1.0, [speed, 0.0, -speed * np.tan(d)]
    times = np.linspace(0.0, END, 801)
    run = solve_ivp(lambda t, y: _rates(t, y, p), (0.0, END), y, "DOP853", times, rtol=1e-9, atol=1e-12)
    assert run.success
    return p, times, run.y.T, np.array([_pins(t, y, p)[2] for t, y in zip(times, run.y.T, strict=True)])


@pytest.mark.slow
def test_forces_and_motion_are_those_of_an_independent_integration():
    _, times, states, normals = reference()
    run = simulate(SINGLE, SINGLE.parameters(QUICK), times, accuracy=1e-3)
    assert run.status == "ok"
    ours = np.concatenate([run.force[name][..., 0] for name in ("input_pins", "output_pins")], axis=1)
    peak = normals.max()
    assert peak > 15e3
    assert np.sqrt(np.mean((ours - normals) ** 2)) < 1e-3 * peak
    place = SINGLE.coordinates()["output"][0]
    assert run.trajectory is not None
    assert np.abs(run.trajectory[:, place] - states[:, 0]).max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SINGLE, DOUBLE], ids=["single", "double"])
def test_power_balance(scene):
    params = scene.parameters(QUICK)
    run = simulate(scene, params, np.linspace(0.0, END, 8001), accuracy=1e-3)
    flows = jax.jit(jax.vmap(lambda t, y: scene.flows(t, y, params)))(
        jnp.asarray(run.times), jnp.asarray(run.trajectory)
    )
    work = {name: np.trapezoid(np.asarray(x), run.times) for name, x in (flows.given | flows.taken).items()}
    given, taken = (sum(work[name] for name in side) for side in (flows.given, flows.taken))
    stored = np.asarray(sum(flows.stored.values()))
    assert work["input drive"] > 20.0 and work["friction"] > 0.0
    assert abs(stored[-1] - stored[0] - float(given - taken)) < 1e-3 * work["input drive"]


@pytest.mark.slow
def test_turning_the_other_way_is_the_mirror_image():
    """Across the plane of the shafts: the pin along y swaps its ends, the input's does not."""
    params = SINGLE.parameters(QUICK)
    other = SINGLE.parameters(QUICK | {"drive_speed": -params["drive_speed"], "load_torque": -params["load_torque"]})
    state = np.asarray(SINGLE.initial_state(params))
    # The cross's place and attitude, the output's angle; speeds: the cross is off its middle, pins touch both bores.
    state = state + 1e-5 * np.random.default_rng(3).normal(size=state.size) * np.array([1.0] * 8 + [100.0] * 7)
    state[:3] = [8e-6, 9e-6, 5e-6]
    odd = np.array([1, -1, 1, 1, -1, 1, -1, -1, 1, -1, 1, -1, 1, -1, -1])
    assert (SINGLE.coordinates()["cross.x"], SINGLE.coordinates()["output"]) == ((0, 8), (7, 14))
    pair = ((state, params), (state * odd, other))
    rates = [np.asarray(SINGLE.vector_field(jnp.asarray(1e-4), jnp.asarray(y), p)) for y, p in pair]
    assert np.abs(rates[1] * odd - rates[0]).max() < 1e-9 * np.abs(rates[0]).max()
    here, there = (SINGLE.observe(jnp.asarray(0.0), jnp.asarray(y), p) for y, p in pair)
    for name, ends in (("input_pins", [0, 1]), ("output_pins", [1, 0])):
        assert np.allclose(here[name].penetration, np.asarray(there[name].penetration)[ends], atol=1e-15)
        assert np.asarray(here[name].force)[:, 0].max() > 0.0


VARIED = ("load_torque", "joint_angle", "stiffness")


def turned(given):
    """How much more than the drive the output has turned [rad], for values of parameters."""
    params, times = SINGLE.parameters(QUICK) | given, np.linspace(0.0, 6e-3, 601)
    found = reading_history(SINGLE, params, times, ["output.angle"], accuracy=1e-4)["output.angle"]
    return found[-1] - params["drive_speed"] * times[-1]


@functools.cache
def along():
    """Its derivative along a direction: one program for all parameters."""
    return jax.jit(lambda values, way: jax.jvp(turned, (values,), (way,))[1])


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIED)
def test_derivatives_are_those_of_differences(name):
    params = SINGLE.parameters(QUICK)
    values, value = {key: params[key] for key in VARIED}, params[name]
    slope = along()(values, {key: jnp.where(key == name, 1.0, 0.0) for key in VARIED})
    step = 1e-2 * value
    found = (turned({name: value + step}) - turned({name: value - step})) / (2.0 * step)
    assert float(slope) == pytest.approx(float(found), rel=2e-2)
