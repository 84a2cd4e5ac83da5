"""NUTS against closed forms (normal and Student's t), and where it must refuse."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, t

from bcfj_jax.xla.batched_jvp import together
from calibration.uncertainty import posterior
from calibration.uncertainty.posterior import Around, Chains

pytest.importorskip("numpyro", reason="NumPyro is the extra uq")

pytestmark = pytest.mark.filterwarnings("error")

RNG = np.random.default_rng(1)
MATRIX = 60 * RNG.standard_normal((12, 3)) @ np.array([[1.0, 0.9, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
BEST = np.array([0.4, 0.5, 0.6])
NOISE = RNG.standard_normal(12)
NOISE -= MATRIX @ np.linalg.lstsq(MATRIX, NOISE)[0]
NAMES, STATED = ("a", "b", "c"), np.full(12, -1)


def linear(u):
    return jnp.asarray(MATRIX) @ (u - BEST) + NOISE


def test_the_density_is_that_of_stated_and_estimated_deviations():
    """exp(-cost/2), and cost^(-n/2) of n samples of one unknown deviation; its slope by differences."""
    owners = np.array([-1, 0, 1, -2, 1, 0, -1, 1, -2, 1, 0, 1])
    for loss, rho in (("linear", lambda z: z), ("cauchy", np.log1p)):
        energy = posterior._energy(linear, owners, loss)

        def wanted(u, rho=rho):
            cost = rho(np.asarray(linear(u)) ** 2)
            first, second = cost[owners == 0], cost[owners == 1]
            return 0.5 * (cost[owners == -1].sum() + 3 * np.log(first.sum()) + 5 * np.log(second.sum()))

        at = BEST + [0.01, -0.02, 0.005]
        assert float(energy(at)) == pytest.approx(wanted(at), rel=1e-12)
        steps = 1e-6 * np.eye(3)
        slope = [(wanted(at + step) - wanted(at - step)) / 2e-6 for step in steps]
        assert np.asarray(jax.grad(energy)(at)) == pytest.approx(slope, rel=1e-6)
    plain = posterior._energy(linear, STATED, "linear")
    assert float(plain(BEST)) == pytest.approx(0.5 * NOISE @ NOISE)


def test_whose_deviation_a_residual_has():
    data = SimpleNamespace(weights=np.array([[[1.0, 0.0], [2.0, 2.0]]]), features=np.zeros((1, 1)))
    model: Any = SimpleNamespace(channels=("f", "g"), data=data)
    assert posterior._owners(model, ["g"]).tolist() == [-1, -2, 0, 0, -1]
    assert posterior._owners(model, ["g", "f"]).tolist() == [1, -2, 0, 0, -1]


def test_draws_have_the_ends_of_95_percent_unless_chains_disagree():
    draws = np.random.default_rng(2).standard_normal((4, 2000, 2))
    good = posterior._summary(("a", "b"), draws, 0)
    for name in "ab":
        assert good.intervals[name] == pytest.approx((-1.96, 1.96), abs=0.12)
    assert not good.refusal
    apart = posterior._summary(("a", "b"), draws + np.array([0.0, 1.0]) * np.arange(4)[:, None, None], 0)
    assert apart.refusal.startswith("the chains disagree on b") and apart.intervals == {"a": None, "b": None}
    assert "1 of 8000 transitions diverged" in posterior._summary(("a", "b"), draws, 1).refusal


@pytest.mark.slow
@pytest.mark.parametrize("estimated", [False, True], ids=["stated noise", "estimated noise"])
def test_linear_problem_has_the_covariance_intervals(estimated):
    freedom, before = 12 - 3, jax.config.values.copy()
    scale = float(NOISE @ NOISE) / freedom if estimated else 1.0
    quantile = float(t.ppf(0.975, freedom) if estimated else norm.ppf(0.975))
    owners = np.zeros(12, dtype=int) if estimated else STATED
    covariance = scale * np.linalg.inv(MATRIX.T @ MATRIX)
    found = posterior.sample(linear, Around(BEST, covariance, NAMES), owners, "linear", Chains(draws=1500))
    assert not found.refusal and found.divergences == 0
    assert np.all(found.rhat < 1.01) and np.all(found.effective > 2000)
    for k, name in enumerate(NAMES):
        half = quantile * np.sqrt(covariance[k, k])
        # A quantile of 2.5 % from 2000 independent draws has an error of 0.06 sigma; four of them are 0.12 half-widths.
        assert found.intervals[name] == pytest.approx((BEST[k] - half, BEST[k] + half), abs=0.12 * half)
    assert jax.config.values == before


@pytest.mark.slow
def test_residuals_whose_tangents_come_together_can_be_sampled():
    def ahead(u, changes):
        return (linear(u), jnp.zeros(())), changes @ jnp.asarray(MATRIX).T

    joint = together(lambda u: (linear(u), jnp.zeros(())), ahead)
    around, few = Around(BEST, np.linalg.inv(MATRIX.T @ MATRIX), NAMES), Chains(warmup=50, draws=50)
    found, plain = (posterior.sample(f, around, STATED, "linear", few) for f in (lambda u: joint(u)[0], linear))
    assert found.draws == pytest.approx(plain.draws, rel=1e-6)


@pytest.mark.slow
def test_two_modes_are_refused():
    # Chains that begin on either side of a ridge of 200 sigma squared stay there.
    twin = lambda u: jnp.array([2000 * (u[0] - 0.4) * (u[0] - 0.6)])  # noqa: E731
    around = Around(np.array([0.5]), np.array([[0.02]]), ("a",))
    found = posterior.sample(twin, around, STATED[:1], "linear", Chains(warmup=200, draws=200))
    assert found.refusal and found.intervals == {"a": None}
    assert np.all(found.rhat > posterior.WORST_RHAT)


@pytest.mark.slow
def test_failing_simulations_are_refused():
    # A tenth of a sigma from the optimum nothing simulates.
    half = lambda u: jnp.where(u < 0.501, 100 * (u - 0.5), jnp.nan)  # noqa: E731
    around = Around(np.array([0.5]), np.array([[1e-4]]), ("a",))
    found = posterior.sample(half, around, STATED[:1], "linear", Chains(1, warmup=200, draws=200))
    assert found.divergences > 0 and "diverged" in found.refusal and found.intervals == {"a": None}
