"""Single pieces of a step, without a run: cubics, roots, what is noted at the start, ends of a step. Against NumPy."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_crossings import memory

import bcfj_jax as bj
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Proximity
from bcfj_jax.mechanism.structure import Dense
from bcfj_jax.solve import crossings, integrate, landing, seeking
from bcfj_jax.solve.crossings import Watch
from bcfj_jax.solve.cubic import Cubic
from bcfj_jax.solve.landing import Landing, Look
from bcfj_jax.solve.plan import plan
from bcfj_jax.solve.sdirk import Sdirk
from bcfj_jax.solve.seeking import Seeker


@pytest.mark.parametrize("third", [0.0, 1.0])
def test_extremes_of_a_cubic_are_those_of_many_points(third):
    value, slope, second, bend = np.random.default_rng(2).normal(size=(4, 300)) * [[1.0], [3.0], [5.0], [5.0 * third]]
    high, low = Cubic(*map(jnp.asarray, (value, slope, second, bend))).extremes()
    s = np.linspace(0.0, 1.0, 20001)[:, None]
    every = value + s * (slope + s * (second + s * bend))
    for found, best, at in (
        (high, every.max(axis=0), every.argmax(axis=0)),
        (low, every.min(axis=0), every.argmin(axis=0)),
    ):
        np.testing.assert_allclose(found.depth, best, atol=1e-6)
        np.testing.assert_allclose(found.at, s[at, 0], atol=2e-3)


@pytest.mark.parametrize(("end", "length"), [(1.0, 1.0), (7.3, 0.4)])
def test_roots_within_a_step_are_those_of_the_penetration(end, length):
    """Of one that is no cubic, so that the cubic's root is not enough."""
    first = end - length
    share = lambda t: (t - first) / length  # noqa: E731
    depth = lambda t: jnp.atleast_1d(jnp.expm1(3.0 * share(t)) - 2.0)  # noqa: E731
    rate = lambda t: jnp.atleast_1d(3.0 * jnp.exp(3.0 * share(t)) / length)  # noqa: E731
    sight = lambda t: Look(depth(t), rate(t), jnp.zeros(1))  # noqa: E731
    watch = Watch(None, None, jnp.asarray(9.0), jnp.asarray(1e-3), 2)  # pyright: ignore[reportArgumentType]
    seen = memory(float(depth(first)[0]), float(rate(first)[0]), 0.0)
    found = watch._roots(seen, sight(jnp.asarray(end)), jnp.asarray(end), jnp.asarray(length), sight)
    assert float(found[0]) == pytest.approx(np.log(3.0) / 3.0, rel=1e-9)


@pytest.mark.parametrize("since", [0.0, 0.5])
def test_a_force_is_greatest_at_the_start_from_when_on_it_is_sought(since, monkeypatch):
    seen = Look(jnp.array([1e-3, -1.0]), jnp.zeros(2), jnp.array([5.0, -3.0]))
    monkeypatch.setattr(landing, "surfaces", lambda *_: seen)
    inner: Any = SimpleNamespace(init=lambda *_: (0.1, None))
    control = Landing(inner, jnp.asarray(1e-9), 2, 3, jnp.asarray(since))
    first, kept = control.init(None, jnp.asarray(0.0), 1.0, jnp.zeros(5), None, (None, None), None, None)
    expected = np.array([[5.0, -3.0], [-5.0, 3.0]]) if since == 0.0 else np.full((2, 2), -np.inf)
    assert kept.tops is not None
    np.testing.assert_array_equal(kept.tops.size, expected)
    assert first == 0.1 and kept.tops.state.shape == (2, 2, 3)


class _Asked(Exception):
    pass


@pytest.mark.parametrize("times", [[0.0, 1e-3, 5e-3], [2e-3]])
def test_a_model_is_suited_to_the_whole_run(times, monkeypatch):
    def suited(*given):
        raise _Asked(given[2])

    monkeypatch.setattr(Mechanism, "suited", suited)
    scene = bj.scenes.impact()
    with pytest.raises(_Asked) as asked:
        bj.simulate(scene, scene.parameters(), times)
    assert asked.value.args[0] == times[-1]


@pytest.mark.parametrize(("begin", "good"), [(0.0, True), (1.7, True), (1.7, False)])
def test_a_state_that_the_slopes_do_not_lead_to_is_refused(begin, good, monkeypatch):
    """Simpson's rule is exact of y' = 3 t^2: the solver's new state passes where it is that integral."""
    monkeypatch.setattr(seeking, "seen", lambda *_: Proximity(*(jnp.ones(1) * x for x in (-1.0, 0.0, 0.0, 0.0, 1.0))))
    end, start = begin + 0.8, jnp.ones(2)
    after = start + end**3 - begin**3 + (0.0 if good else 0.3)
    solver: Any = SimpleNamespace(
        step=lambda *_: (after, jnp.zeros(2), dict(y0=start, y1=after), None, None),
        func=lambda _, t, y, args: 3.0 * t**2 * jnp.ones(2),
        interpolation_cls=dfx.LocalLinearInterpolation,
    )
    seeker = Seeker(solver, jnp.ones(2), jnp.asarray(1e-9), lambda x: jnp.max(jnp.abs(x)), False, True)
    times = jnp.asarray(begin), jnp.asarray(end)
    _, (error, *_), *_ = seeker.step(None, *times, start, (None, None), (None, jnp.ones((5, 1))), False)
    assert bool(np.all(np.isfinite(error))) is good


@pytest.mark.slow
def test_the_shortest_step_is_a_share_of_the_run_and_not_of_its_first_step():
    scene = bj.scenes.impact()
    how, end = plan(scene), jnp.asarray(2.0)
    soft, hard = (
        integrate.problem(scene, scene.parameters({"stiffness": k}), end, how, False) for k in (1e4, 1e12)
    )  # fmt: skip
    assert float(soft.first_step) > 2.0 * float(hard.first_step)
    assert float(soft.shortest_step) == float(hard.shortest_step) < 1e-15
    longer = integrate.problem(scene, scene.parameters(), 10.0 * end, how, False)
    assert float(longer.shortest_step) == pytest.approx(10.0 * float(soft.shortest_step), rel=1e-12)


def test_a_derivative_by_a_coefficient_alone_has_a_row_of_states():
    """Traced, not run: of a start that the coefficient does not move."""
    scene = bj.scenes.impact()
    params, times = scene.parameters(), jnp.linspace(0.0, 1e-3, 7)
    model = scene.suited(params, 1e-3, "bdf")
    how = plan(model, solver="bdf")

    def states(stiffness):
        return crossings.solved(model, {**params, "stiffness": stiffness}, times, how, 2)[0].states

    value, tangent = jax.eval_shape(lambda k: jax.jvp(states, (k,), (jnp.ones(()),)), params["stiffness"])
    assert value.shape == tangent.shape == (7, model.initial_state(params).size)


def test_the_interpolant_of_sdirk_has_the_slopes_of_both_ends():
    """Of y' = -y + t, whose slope at the end is that of the new state."""
    solver, start = Sdirk(Dense(lambda t, y, _: -y + t), jnp.full(1, 1e-12)), jnp.ones(1)
    first = solver.init(None, 0.0, 0.3, start, None)
    after, _, dense, *_ = solver.step(None, 0.0, 0.3, start, None, first, False)
    np.testing.assert_allclose(dense["k0"], 0.3 * (-start), rtol=1e-12)
    np.testing.assert_allclose(dense["k1"], 0.3 * (0.3 - after), rtol=1e-9)
