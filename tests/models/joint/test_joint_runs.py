"""Runs of the joint: how they fail, batches, derivatives."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import GROOVES, LITTLE, plain_joint

from bcfj_jax import InputError
from bcfj_jax.solve import simulation

BUDGET = 200
# Impacts multiply a difference by ten within some 200 us: longer runs would compare rounding.
SHORT = np.linspace(0.0, 1e-3, 5)


@functools.cache
def little():
    scene = plain_joint(**LITTLE)
    return scene, scene.parameters(load_ramp=1e-3, load_torque=200.0)


def simulated(params, times=SHORT):
    return simulation.simulate(little()[0], params, times, max_steps=BUDGET)


@pytest.mark.full
def test_failures_say_why_and_when():
    _, params = little()
    good = simulated(params)
    assert good.status == "ok" and good.reason == "" and np.isnan(good.failure_time)
    assert set(good.force) == set(GROOVES) and good.force["seat_ball"].shape == (5, 3, 3)
    assert good.force["seat_ball"].max() > 100.0
    assert good.stats["accepted"] > 0
    # Times and parameters are no part of the program: none of these compiles again.
    long = simulated(params, np.linspace(0.0, 1.0, 5))
    assert long.status == "failed" and f"the step budget of {BUDGET} steps was spent" in long.reason
    assert 0 < long.failure_time < 1.0 and long.stats["accepted"] + long.stats["rejected"] == BUDGET
    assert np.all(np.isnan(long.force["seat_ball"][-1])) and np.all(np.isfinite(long.force["seat_ball"][0]))
    assert long.stats["compile_s"] < 0.1
    # Nor does an accuracy from which on derivatives need another method: values do not.
    tight = simulation.simulate(little()[0], params, SHORT, accuracy="reference", max_steps=BUDGET)
    assert tight.stats["tolerance"] < good.stats["tolerance"] and tight.stats["compile_s"] < 0.1
    for name in ("stiffness", "ball_mass", "load_torque", "joint_angle"):
        with pytest.raises(InputError, match=f"{name} = nan"):
            simulated({**params, name: jnp.asarray(jnp.nan)})


@pytest.mark.slow
def test_a_batch_equals_its_members_and_is_traced_once():
    scene, params = little()
    how = simulation.plan(scene, "balanced", BUDGET)
    traces = []

    def forces(clearance):
        traces.append(clearance)
        return simulation.force_history(scene, {**params, "clearance_seat_ball": clearance}, SHORT, accuracy=how)

    clearances = np.array([5e-6, 1e-5, 4e-5])
    batch = jax.jit(jax.vmap(forces))
    together = jax.device_get(batch(clearances))
    for i, clearance in enumerate(clearances):
        alone = simulated({**params, "clearance_seat_ball": jnp.asarray(clearance)})
        for name, force in alone.force.items():
            assert np.allclose(together[name][i], force, rtol=1e-6, atol=1e-6 * abs(force).max())
    again = batch(clearances[::-1].copy())
    assert np.allclose(again["seat_ball"][::-1], together["seat_ball"], rtol=1e-12)
    assert len(traces) == 1


@pytest.mark.full
def test_a_batch_of_durations_has_derivatives():
    """Traced only: what a run's end decides must not be closed over where directions are gathered."""
    scene, params = little()

    def forces(stiffness, times):
        values = {**params, "stiffness": stiffness}
        return simulation.force_history(scene, values, times, accuracy="fast", mode="forward")["seat_ball"]

    def moved(stiffness, change, times):
        return jax.jvp(lambda k: forces(k, times), (stiffness,), (change,))[1]

    times = jnp.asarray(SHORT) * jnp.array([[1.0], [2.0]])
    found = jax.eval_shape(jax.vmap(moved), jnp.full(2, 3e10), jnp.ones(2), times)
    assert found.shape == (2, 5, scene.balls, 3)
