"""Many runs in one loop: each is the run it would be alone, whatever runs beside it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import plain_joint

from bcfj_jax import scenes, simulate
from bcfj_jax.core.status import OK, STEPS
from bcfj_jax.solve.plan import Plan, Points, plan
from bcfj_jax.solve.work_queue import equilibria, integrate_queue

SCENE = scenes.impact()
COUNT, GRID = 24, jnp.linspace(0.0, 1.0, 201)


def queue(low: float = 1e5, high: float = 1e9) -> tuple[dict, jax.Array]:
    params = {name: jnp.full(COUNT, value) for name, value in SCENE.parameters().items()}
    params["stiffness"] = jnp.geomspace(low, high, COUNT)
    return params, jax.vmap(SCENE.horizon)(params)


@pytest.fixture(scope="module")
def solve():
    return jax.jit(
        lambda params, ends, how, count: integrate_queue(SCENE, Points(params, ends, GRID), how, count, 5),
    )


@pytest.mark.full
def test_each_run_is_the_run_it_is_alone(solve):
    params, ends = queue()
    how = plan(SCENE, "balanced")
    together, _ = solve(params, ends, how, COUNT)
    for i in (0, 7, COUNT - 1):
        alone = simulate(SCENE, {name: leaf[i] for name, leaf in params.items()}, GRID * ends[i])
        assert (together.accepted[i], together.rejected[i]) == (alone.stats["accepted"], alone.stats["rejected"])
        size = np.abs(alone.trajectory).max(axis=0)
        np.testing.assert_allclose(together.states[i] / size, alone.trajectory / size, atol=1e-10)


@pytest.mark.full
def test_a_run_is_the_same_to_the_last_bit_wherever_it_stands_in_the_queue(solve):
    params, ends = queue()
    how = plan(SCENE, "balanced")
    order = np.random.default_rng(0).permutation(COUNT)
    first, _ = solve(params, ends, how, COUNT)
    second, _ = solve({name: leaf[order] for name, leaf in params.items()}, ends[order], how, COUNT)
    np.testing.assert_array_equal(np.asarray(first.states)[order], second.states)


@pytest.mark.full
def test_a_shorter_queue_needs_no_other_program(solve):
    params, ends = queue()
    found, _ = solve(params, ends, plan(SCENE, "balanced"), COUNT - 3)
    assert np.all(found.code[: COUNT - 3] == OK)
    assert np.all(found.code[COUNT - 3 :] != OK) and np.all(np.isnan(found.states[COUNT - 3 :]))


@pytest.mark.full
def test_a_run_that_fails_harms_no_other(solve):
    params, ends = queue()
    whole, _ = solve(params, ends, plan(SCENE, "balanced"), COUNT)
    bad = {**params, "mass": params["mass"].at[9].set(jnp.nan)}
    how = Plan(plan(SCENE, "balanced").tolerance, 60)
    found, _ = jax.jit(lambda p, e: integrate_queue(SCENE, Points(p, e, GRID), how, COUNT, 5))(bad, ends)
    others = np.setdiff1d(np.arange(COUNT), [9])
    assert np.all(np.asarray(found.code)[others] == OK)
    np.testing.assert_array_equal(np.asarray(found.states)[others], np.asarray(whole.states)[others])
    assert found.code[9] != OK and np.isnan(found.states[9]).any()


@pytest.mark.slow
def test_places_are_busy_when_runs_cost_up_to_ten_times_as_much_as_others():
    scene = scenes.bounce()
    params = {name: jnp.full(64, value) for name, value in scene.parameters().items()}
    ends = jnp.linspace(3.0, 0.3, 64)
    run = jax.jit(lambda p, e: integrate_queue(scene, Points(p, e, jnp.linspace(0.0, 1.0, 101)), plan(scene), 64, 8))
    found, rounds = run(params, ends)
    steps = np.asarray(found.accepted + found.rejected)
    assert steps.max() > 8 * steps.min()
    assert steps.sum() / (int(rounds) * 8) > 0.7


@pytest.mark.slow
def test_a_run_that_spends_its_steps_says_when():
    how = Plan(plan(SCENE, "reference").tolerance, 12)
    params, ends = queue()
    found, _ = jax.jit(lambda p, e: integrate_queue(SCENE, Points(p, e, GRID), how, COUNT, 5))(params, ends)
    assert np.all(found.code == STEPS)
    assert np.all((found.end > 0) & (found.end < ends))
    seen = np.isfinite(found.states).all(axis=2)
    assert np.all(seen == (np.asarray(ends)[:, None] * np.asarray(GRID) <= np.asarray(found.end)[:, None]))


@pytest.mark.slow
def test_equilibria_are_those_that_are_sought_alone():
    scene = plain_joint(fidelity="quasistatic")
    clearances = jnp.array([2e-5, 2.2e-5, 5e-5, 1e-5])
    params = {name: jnp.full(4, value) for name, value in scene.parameters().items()}
    params["clearance_cage_ball"] = clearances
    grid = jnp.linspace(0.0, 1.0, 5)
    found = jax.jit(lambda p, e: equilibria(scene, Points(p, e, grid)))(params, jnp.full(4, 1.3))
    assert np.all(found.code == OK)
    for i in range(4):
        alone = simulate(scene, {name: leaf[i] for name, leaf in params.items()}, 1.3 * grid)
        place = slice(0, scene.moving // 2)
        # Both are Newton's method to 1e-10 m; the play that springs alone decide is as good as these.
        np.testing.assert_allclose(found.states[i][:, place], alone.trajectory[:, place], atol=2e-9)
