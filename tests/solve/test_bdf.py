"""BDF of a state and its tangents against variational equations solved by SciPy."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bcfj_jax.mechanism.structure import Dense
from bcfj_jax.solve import bdf
from bcfj_jax.solve.sdirk import Sdirk

TIMES = np.sort(np.concatenate([[0.0, 3.0], np.random.default_rng(1).uniform(0, 3, 200)]))


def pol(t, y, mu):
    """Van der Pol, driven: nonlinear, depends on time."""
    return jnp.stack([y[1], mu * ((1 - y[0] ** 2) * y[1]) - y[0] + jnp.sin(3 * t)])


class Idle(bdf.AbstractWatch):
    """Looks at nothing; with a watch there are rates."""

    def begin(self, start):
        return ()

    def after(self, seen, end, length, read):
        return seen


def solved(function, start, value, tolerance, times, max_steps=100_000, watch=None):
    """Rows (T, 1 + 1 + n, n): the state, then its tangents by the field's argument and by each start value."""
    n = start.size

    def run(tolerance, value):
        solver = Sdirk(Dense(function), jnp.full(n, tolerance))
        rows = jnp.concatenate([start[None], jnp.zeros((1, n)), jnp.eye(n)])
        change = jnp.zeros(1 + n).at[0].set(1.0)
        posed = bdf.Posed(solver, value, change, rows, jnp.ones(n), 1e-6, 1e-15)
        return bdf.solve(posed, jnp.asarray(times), bdf.Steps(max_steps, watch=watch))

    return jax.jit(run)(jnp.asarray(tolerance), jnp.asarray(value))


def variational(mu):
    """State and tangents by mu and both start values, side by side."""

    def right(t, z):
        y, s = z[:2], z[2:].reshape(3, 2)
        j = np.array([[0, 1], [-2 * mu * y[0] * y[1] - 1, mu * (1 - y[0] ** 2)]])
        push = np.array([[0, (1 - y[0] ** 2) * y[1]], [0, 0], [0, 0]])
        f = [y[1], mu * ((1 - y[0] ** 2) * y[1]) - y[0] + np.sin(3 * t)]
        return np.concatenate([f, (s @ j.T + push).ravel()])

    start = np.array([2.0, 0.3, 0, 0, 1, 0, 0, 1])
    found = solve_ivp(right, (0, 3), start, rtol=1e-12, atol=1e-14, method="DOP853", t_eval=TIMES)
    return found.y.T.reshape(-1, 4, 2)


@pytest.mark.full
@pytest.mark.parametrize("mu", [0.5, 50.0])
def test_state_and_tangents_converge_together(mu):
    exact, start = variational(mu), jnp.array([2.0, 0.3])
    errors, steps = [], []
    for tolerance in (1e-4, 1e-6, 1e-8):
        found = solved(pol, start, mu, tolerance, TIMES)
        sizes = np.maximum(1.0, np.abs(exact).max((0, 2)))[:, None]
        errors.append((np.abs(np.asarray(found.rows) - exact) / sizes).max((0, 2)))
        steps.append(int(found.accepted + found.rejected))
    errors = np.array(errors)
    assert np.all(errors < 100.0 * np.array([1e-4, 1e-6, 1e-8])[:, None]), errors
    # Of order 4 or so: a hundredth of the error for some three times the steps. Order 2 takes ten times.
    assert steps[2] < 5.0 * steps[1] and steps[1] < 5.0 * steps[0], steps


def test_tangents_are_bounded_however_stiff():
    def follow(t, y, p):
        return -1e7 * (y - jnp.sin(p * t)) * (1.0 + 0.1 * y * y)

    times = np.linspace(0.1, 1.0, 7)
    found = solved(follow, jnp.array([0.5]), 1.3, 1e-6, times, watch=Idle())
    state, by_p, by_start = np.asarray(found.rows)[:, :, 0].T
    assert np.allclose(state, np.sin(1.3 * times), atol=1e-4)
    assert np.allclose(by_p, times * np.cos(1.3 * times), atol=1e-4)
    assert np.all(np.abs(by_start) < 1e-5)
    # Of the state's polynomial, not of a tangent's.
    assert np.allclose(np.asarray(found.rates)[:, 0], 1.3 * np.cos(1.3 * times), atol=1e-2)
    assert int(found.accepted) < 300


@pytest.mark.slow
def test_a_spent_budget_and_a_blow_up_end_where_they_are():
    short = solved(pol, jnp.array([2.0, 0.3]), 2.0, 1e-8, TIMES, max_steps=50)
    rows = np.asarray(short.rows)
    assert 0 < float(short.end) < 3.0 and int(short.accepted + short.rejected) == 50
    assert np.all(np.isfinite(rows[float(short.end) >= TIMES])) and np.all(np.isnan(rows[float(short.end) < TIMES]))
    # y' = y^2 from 1 is infinite at 1.
    gone = solved(lambda t, y, p: p * y * y, jnp.array([1.0]), 1.0, 1e-6, np.linspace(0, 2, 9), max_steps=3000)
    assert float(gone.end) == pytest.approx(1.0, abs=1e-3)
    assert np.all(np.isnan(np.asarray(gone.rows)[5:]))
