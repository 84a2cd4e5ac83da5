"""NUTS against closed forms (normal and Student's t), and where it must refuse."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, t

from bcfj_jax.solve.batched_jvp import together
from calibration.uncertainty import posterior
from calibration.uncertainty.posterior import Chains

pytest.importorskip("numpyro", reason="NumPyro is the extra uq")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error")]

RNG = np.random.default_rng(1)
MATRIX = 60 * RNG.standard_normal((12, 3)) @ np.array([[1.0, 0.9, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
BEST = np.array([0.4, 0.5, 0.6])
NOISE = RNG.standard_normal(12)
NOISE -= MATRIX @ np.linalg.lstsq(MATRIX, NOISE)[0]
NAMES = ("a", "b", "c")


def linear(u):
    return jnp.asarray(MATRIX) @ (u - BEST) + NOISE


@pytest.mark.parametrize("estimated", [False, True], ids=["stated noise", "estimated noise"])
def test_linear_problem_has_the_covariance_intervals(estimated):
    freedom, before = 12 - 3, jax.config.values.copy()
    scale = float(NOISE @ NOISE) / freedom if estimated else 1.0
    quantile = float(t.ppf(0.975, freedom) if estimated else norm.ppf(0.975))
    owners = np.zeros(12, dtype=int) if estimated else None
    covariance = scale * np.linalg.inv(MATRIX.T @ MATRIX)
    found = posterior.sample(linear, BEST, covariance, NAMES, owners=owners, chains=Chains(draws=1500))
    assert not found.refusal and found.divergences == 0
    assert np.all(found.rhat < 1.01) and np.all(found.effective > 2000)
    for k, name in enumerate(NAMES):
        half = quantile * np.sqrt(covariance[k, k])
        # A quantile of 2.5 % from 2000 independent draws has an error of 0.06 sigma; four of them are 0.12 half-widths.
        assert found.intervals[name] == pytest.approx((BEST[k] - half, BEST[k] + half), abs=0.12 * half)
    assert jax.config.values == before


def test_residuals_whose_tangents_come_together_can_be_sampled():
    def ahead(u, changes):
        return (linear(u), jnp.zeros(())), changes @ jnp.asarray(MATRIX).T

    joint = together(lambda u: (linear(u), jnp.zeros(())), ahead)
    few = {"covariance": np.linalg.inv(MATRIX.T @ MATRIX), "labels": NAMES, "chains": Chains(warmup=50, draws=50)}
    found, plain = (posterior.sample(f, BEST, **few) for f in (lambda u: joint(u)[0], linear))
    assert found.draws == pytest.approx(plain.draws, rel=1e-6)


def test_two_modes_are_refused():
    # Chains that begin on either side of a ridge of 200 sigma squared stay there.
    twin = lambda u: jnp.array([2000 * (u[0] - 0.4) * (u[0] - 0.6)])  # noqa: E731
    found = posterior.sample(twin, np.array([0.5]), np.array([[0.02]]), ("a",), chains=Chains(warmup=200, draws=200))
    assert found.refusal and found.intervals == {"a": None}
    assert np.all(found.rhat > posterior.WORST_RHAT)


def test_failing_simulations_are_refused():
    # A tenth of a sigma from the optimum nothing simulates.
    half = lambda u: jnp.where(u < 0.501, 100 * (u - 0.5), jnp.nan)  # noqa: E731
    found = posterior.sample(half, np.array([0.5]), np.array([[1e-4]]), ("a",), chains=Chains(1, warmup=200, draws=200))
    assert found.divergences > 0 and "diverged" in found.refusal and found.intervals == {"a": None}
