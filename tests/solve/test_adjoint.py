"""The transpose of BDF's steps: the dot-product identity, and forward tangents along the same steps."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.mechanism.structure import AbstractStructure, Dense
from bcfj_jax.solve import adjoint, bdf
from bcfj_jax.solve.sdirk import Sdirk

TIMES = np.concatenate([[0.0], np.sort(np.random.default_rng(1).uniform(0, 3, 40)), [3.0]])
# Tangents this small have no say in the steps; the map is linear, so nothing is lost.
SMALL = 1e-30


def pol(t, y, args):
    """Van der Pol, driven: nonlinear, depends on time; one argument is no float."""
    mu, force, sign = args
    return jnp.stack([y[1], mu * (1 - y[0] ** 2) * y[1] - y[0] + sign * force * jnp.sin(3 * t)])


class Plain(Dense):
    """``Dense`` with the transposed solve that a structure has by itself."""

    solve_transposed = AbstractStructure.solve_transposed


def run(segment, controlled, tolerance, max_steps, cotangents):
    """Steps; outputs' change along mu, force and each start value (4,), forward and reverse."""
    args, start = (jnp.asarray(20.0), jnp.asarray(1.5), jnp.asarray(1)), jnp.array([2.0, 0.3])
    by_args = (jnp.zeros(4).at[0].set(1.0), jnp.zeros(4).at[1].set(1.0), None)
    by_start = jnp.zeros((4, 2)).at[2:].set(jnp.eye(2))

    @jax.jit
    def both(tolerance, cotangents):
        solver = Sdirk(Plain(pol), jnp.full(2, tolerance))
        counted = jnp.zeros((4,)).at[:controlled].set(1.0)
        # Those that are in the step control come first, one for each of the first parameters.
        changes = tuple(d if d is None else jnp.concatenate([(d * counted)[:controlled], SMALL * d]) for d in by_args)
        rows = jnp.concatenate([start[None], by_start[:controlled], SMALL * by_start])
        posed = bdf.Posed(solver, args, changes, rows, jnp.ones(2), 1e-6, 1e-15)
        steps = bdf.Steps(max_steps, bdf.ORDERS if controlled else 2, 0.01, segment)
        found = bdf.solve(posed, jnp.asarray(TIMES), steps)
        slopes = found.rows[:, 1 + controlled :] / SMALL
        forward = jnp.einsum("tkn,tn->k", jnp.where(jnp.isfinite(slopes), slopes, 0.0), cotangents)
        assert found.record is not None
        (mu, force, _), by = adjoint.pulled(solver, args, found.record, found.accepted, jnp.asarray(TIMES), cotangents)
        return found, forward, jnp.stack([mu, force, *by])

    found, forward, reverse = both(jnp.asarray(tolerance), cotangents)
    return found, np.asarray(forward), np.asarray(reverse)


def test_a_transposed_solve_is_one():
    args, y = (jnp.asarray(20.0), jnp.asarray(1.5), jnp.asarray(1)), jnp.array([0.7, -0.4])
    left, right = np.random.default_rng(3).normal(size=(2, 2))
    for structure in (Dense(pol), Plain(pol)):
        factors = structure.factor(0.1, y, args, 0.03)
        forward, back = (
            structure.solve(factors, jnp.asarray(right)),
            structure.solve_transposed(factors, jnp.asarray(left)),
        )
        assert left @ np.asarray(forward) == pytest.approx(right @ np.asarray(back), rel=1e-13)


COTANGENTS = jnp.asarray(np.random.default_rng(2).normal(size=(TIMES.size, 2)))


@pytest.mark.parametrize(
    ("segment", "controlled", "tolerance"),
    [(4096, 1, 1e-6), pytest.param(4096, 0, 1e-3, marks=pytest.mark.slow), pytest.param(7, 0, 1e-3, marks=pytest.mark.slow)],
)  # fmt: skip
def test_reverse_is_forward_along_the_same_steps(segment, controlled, tolerance):
    found, forward, reverse = run(segment, controlled, tolerance, 100_000, COTANGENTS)
    assert int(found.rejected) > 0 and int(found.record.orders.max()) == (5 if controlled else 2)
    assert np.max(np.abs(reverse - forward)) < 1e-10 * np.max(np.abs(forward))


@pytest.mark.slow
def test_segments_that_are_solved_again():
    whole, forward, _ = run(4096, 1, 1e-8, 100_000, COTANGENTS)
    found, _, reverse = run(50, 1, 1e-8, 100_000, COTANGENTS)
    assert int(found.accepted) == int(whole.accepted) > 150
    assert np.max(np.abs(reverse - forward)) < 1e-10 * np.max(np.abs(forward))


@pytest.mark.slow
def test_a_run_that_stopped_has_the_derivatives_of_what_it_reached():
    few = COTANGENTS.at[20:].set(0.0)
    found, forward, reverse = run(64, 1, 1e-6, 100, few)
    assert TIMES[19] < float(found.end) < 3.0 and np.any(forward)
    assert np.max(np.abs(reverse - forward)) < 1e-10 * np.max(np.abs(forward))
    assert np.all(np.isnan(run(64, 1, 1e-6, 100, COTANGENTS)[2]))
