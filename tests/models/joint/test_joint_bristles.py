"""Bristles of the friction law LuGre in the joint: steady slip, spring, gap, energy, a run."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import GROOVES, QUICK, constants, noisy, plain_joint
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from bcfj_jax.analysis import energy_balance
from bcfj_jax.models.joint import energy, system
from bcfj_jax.models.joint.constants import laws_of
from bcfj_jax.models.joint.contacts import RELAX, act, windows
from bcfj_jax.models.joint.scene import flat, split

ROUGH = plain_joint(friction="lugre")
# 30 um into the upper face of a window, at whose middle the cage's axis is z.
PLACE, AXIS = np.array([0.03, 0.0, 4e-5]), np.array([0.0, 0.0, 1.0])


@functools.cache
def touching(friction: str):
    """The upper face's force, its normal force and its bristle's rate, by (height, velocity, deflection)."""
    scene = plain_joint(friction=friction)
    params = scene.parameters({"smoothing": 1e-6})
    laws = laws_of(scene, params, "cage_ball")

    @jax.jit
    def look(height, velocity, bristle):
        at = windows(
            params["clearance_cage_ball"], params["ball_radius"], jnp.asarray(PLACE) + height * AXIS, jnp.asarray(AXIS)
        )
        bent = jnp.stack([bristle, jnp.zeros(3)]) if friction == "lugre" else None
        touch = act(laws, at, velocity, None, bent)
        bending = jnp.zeros(3) if touch.bending is None else touch.bending[0]
        return touch.drag, touch.normal[0], bending

    return look, laws


def settled(laws, slip: np.ndarray) -> np.ndarray:
    """Deflection of steady slip."""
    return slip / float(laws.bond(jnp.asarray(slip @ slip))[0])


@pytest.mark.parametrize("speed", [0.05, 0.3, 2.0])
def test_steady_slip_has_the_force_without_bristles(speed):
    look, laws = touching("lugre")
    slip = speed * np.array([0.6, -0.8, 0.0])
    drag, normal, bending = look(0.0, slip, settled(laws, slip))
    assert float(normal) > 10.0
    assert np.allclose(drag, -normal * laws.mobility(jnp.asarray(speed**2)) * slip, rtol=3e-6, atol=1e-12)
    assert np.allclose(bending, 0.0, atol=1e-9 * speed)
    # The part of a bristle out of the plane does nothing.
    lifted = look(0.0, slip, settled(laws, slip) + 1e-6 * AXIS)
    assert np.allclose(lifted[0], drag, rtol=1e-12, atol=1e-12)


def test_below_break_away_a_contact_is_a_spring_that_does_not_creep():
    normal, mass = float(touching("lugre")[0](0.0, np.zeros(3), np.zeros(3))[1]), 1e-3
    load = 0.4 * 0.12 * normal
    ends = {}
    for name in ("lugre", "brown_mcphee"):
        look, _ = touching(name)

        def rates(t, y, look=look):
            # The load is raised slowly, so that the bristle's damping has little to settle.
            drag, _, bending = look(0.0, np.array([y[1], 0.0, 0.0]), np.array([y[2], 0.0, 0.0]))
            return [y[1], (load * min(1.0, t / 0.02) + float(drag[0])) / mass, float(bending[0])]

        run = solve_ivp(rates, (0.0, 0.1), np.zeros(3), method="LSODA", rtol=1e-7, atol=1e-13)
        assert run.success
        ends[name] = run.y[:, -1]
    spring = normal * 1e5
    assert ends["lugre"][0] == pytest.approx(load / spring, rel=0.4)  # bent, and slid a little before break-away
    assert spring * ends["lugre"][2] == pytest.approx(load, rel=1e-4)
    assert abs(ends["lugre"][1]) < 1e-7 and ends["brown_mcphee"][1] > 1e-3
    # A small deflection's force is exactly that of the spring N sigma0.
    drag, *_ = touching("lugre")[0](0.0, np.zeros(3), np.array([1e-7, 0.0, 0.0]))
    assert np.allclose(drag, [-spring * 1e-7, 0.0, 0.0], rtol=1e-6)


def test_nothing_is_remembered_in_a_gap():
    look, _ = touching("lugre")
    bent = np.array([1e-6, 5e-7, 0.0])
    drag, normal, bending = look(-4e-5, np.array([0.3, 0.0, 0.1]), bent)
    assert float(normal) == 0.0 and not np.any(drag)
    assert np.allclose(bending, -bent / RELAX, rtol=1e-12)


def test_layout_and_what_has_no_bristles():
    some = plain_joint(frictions={"head_ball": "lugre", "head_cage": "lugre"})
    assert some.bristles == {"head_ball": 2, "head_cage": 1} and some.states == some.moving + 3 * (6 * 2 + 1)
    y = np.arange(float(some.states))
    assert np.array_equal(flat(split(some, jnp.asarray(y))), y[some.moving :])
    assert ROUGH.states == ROUGH.moving + 3 * (6 * 6 + 2)
    plain = plain_joint()
    assert plain.states == plain.moving and not plain.bristles
    assert not plain_joint(friction="lugre", fidelity="quasistatic").bristles


@pytest.mark.full
def test_power_is_the_rate_of_what_is_stored():
    params = ROUGH.parameters()
    c = constants(ROUGH, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def read(y):
        t, drift = jnp.asarray(0.05), system.field(jnp.asarray(0.05), y, (ROUGH, c))
        rate = jax.jvp(lambda t, y: energy.stored(ROUGH, c, t, y), (t, y), (jnp.ones(()), drift))[1]
        return energy.power(ROUGH, c, t, y), rate

    for seed in range(5):
        y = noisy(ROUGH, params, seed)
        y[ROUGH.moving :] = 1e-6 * np.random.default_rng(seed).normal(size=y.size - ROUGH.moving)
        flow, rate = read(y)
        size = sum(abs(x) for x in flow) + sum(abs(x) for x in rate)
        assert float(flow.friction) != 0.0 and abs(float(flow.net - rate.total)) < 1e-9 * float(size)


@pytest.mark.slow
def test_a_joint_runs_on_bristles():
    scene = plain_joint(friction="lugre", contacts=("cage_ball", *GROOVES))
    params, times = scene.parameters({"load_ramp": 2e-3}), np.linspace(0.0, 4e-3, 21)
    run = bj.simulate(scene, params, times)
    assert run.trajectory is not None and np.all(np.isfinite(run.trajectory))
    bent = np.abs(run.trajectory[-1, scene.moving :])
    assert 1e-8 < bent.max() < 1e-5
    # What is left is the quadrature's, of bristles that settle within some 10 us: it goes as the square of the panel.
    closed = energy_balance.balance(scene, params, times, step=5e-6)
    assert closed.closure < 1e-3
