"""Posterior of the parameters by NUTS (NumPyro, the extra ``uq``), on the same log-density as the fit.

The prior is uniform in the search box. A deviation that is estimated is integrated out under the prior 1/sigma, which
leaves cost^(-n/2) of its n samples and, for a linear model, Student's t with the covariance's degrees of freedom.
Correlation times, and noise that grows with the reading, stay as the fit left them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.extras import library
from calibration.diagnostics.optimum import Optimum
from calibration.forward.losses import loss_of
from calibration.forward.model import Model

# Gelman and Rubin's statistic above which chains have not mixed, and how many there are.
WORST_RHAT, _CHAINS = 1.01, 4
# The sampler's.
LIBRARY = "numpyro.infer"


class Chains(NamedTuple):
    """What the sampler does; ``warmup`` and ``draws`` are a chain's."""

    seed: int = 0
    warmup: int = 300
    draws: int = 1000


class Around(NamedTuple):
    """An optimum: unit-box coordinates (P,), their covariance, the first guess of the sampler's metric, and their names."""

    place: np.ndarray
    covariance: np.ndarray
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Posterior:
    """Draws and what they are worth."""

    labels: tuple[str, ...]
    draws: np.ndarray  # (chains, draws, P) of the parameters, SI
    # rhat, effective: per parameter, potential scale reduction of split chains and effective sample size.
    rhat: np.ndarray
    effective: np.ndarray
    divergences: int  # number of transitions that diverged
    refusal: str  # why no interval may be read from the draws; "" if they may

    @property
    def intervals(self) -> dict[str, tuple[float, float] | None]:
        """95 % of the probability by label, tails of 2.5 %; None where refused."""
        if self.refusal:
            return dict.fromkeys(self.labels)
        ends = np.quantile(self.draws, [0.025, 0.975], axis=(0, 1)).T
        return {name: (float(low), float(high)) for name, (low, high) in zip(self.labels, ends, strict=True)}


def of_optimum(at: Optimum, chains: Chains) -> Posterior:
    """Sample a problem's parameters around its optimum; with a reference force, that follows the others."""
    assert at.spread.covariance is not None
    model, names = at.model, at.labels
    owners = _owners(model, list(at.noise.sigma))
    around = Around(at.end.point, at.spread.covariance, names)
    found = sample(model.residuals, around, owners, model.loss, chains)
    values = model.values(found.draws)
    if model.referenced:
        k, n = model.pair()
        force = values[..., k] * np.exp(values[..., n] * model.log_depth)
        values, names = np.concatenate([values, force[..., None]], axis=-1), (*names, "reference_force")
    return _summary(names, values, found.divergences)


def sample(
    residuals: Callable[[Array], Array], around: Around, owners: np.ndarray, loss: str, chains: Chains
) -> Posterior:
    """Sample unit-box coordinates with density exp(-cost/2), and cost^(-n/2) for samples whose deviation is estimated.

    Args:
        residuals: weighted residuals (N,) of a point (P,), which JAX can differentiate forwards.
        owners: (N,) which estimated deviation each residual has, 0 to K - 1; -1: stated; -2: no sample.

    Raises:
        InputError: where NumPyro is not installed.
    """
    infer = library(LIBRARY, "intervals = posterior", "uq")
    energy = _energy(residuals, owners, loss)

    def potential(z: Array) -> Array:
        u = jax.nn.sigmoid(z)
        return energy(u) - jnp.sum(jnp.log(u) + jnp.log1p(-u))

    # Logits make the box unbounded; their covariance is that of u over the slope of the sigmoid.
    centre = np.clip(around.place, 1e-4, 1.0 - 1e-4)
    stretch = 1.0 / (centre * (1.0 - centre))
    metric = around.covariance * np.outer(stretch, stretch)
    # Starts wider apart than the posterior, without which agreement of the chains would mean little.
    wide = np.random.default_rng(chains.seed).multivariate_normal(np.zeros(centre.size), 4.0 * metric, _CHAINS)
    how = {"inverse_mass_matrix": jnp.asarray(metric), "dense_mass": True, "forward_mode_differentiation": True}
    counts = {"num_warmup": chains.warmup, "num_samples": chains.draws, "num_chains": _CHAINS}
    kernel = infer.NUTS(potential_fn=potential, **how)
    sampler = infer.MCMC(kernel, **counts, chain_method="vectorized", progress_bar=False)
    first = jnp.asarray(np.log(centre / (1 - centre)) + wide)
    sampler.run(jax.random.key(chains.seed), init_params=first, extra_fields=("diverging",))
    points = np.asarray(jax.nn.sigmoid(sampler.get_samples(group_by_chain=True)))
    return _summary(around.labels, points, int(np.sum(sampler.get_extra_fields()["diverging"])))


def _owners(model: Model, estimated: Sequence[str]) -> np.ndarray:
    """Whose deviation each residual of a model has: places in ``estimated``, -1 stated, -2 no sample."""
    owners = np.array([estimated.index(c) if c in estimated else -1 for c in model.channels], dtype=int)
    weights = np.asarray(model.data.weights)
    readings = np.where(weights > 0, owners[None, :, None], -2)
    return np.concatenate([readings.ravel(), np.full(model.data.features.size, -1)])


def _energy(residuals: Callable[[Array], Array], owners: np.ndarray, loss: str) -> Callable[[Array], Array]:
    """Negative log-likelihood of a point (P,)."""

    def energy(u: Array) -> Array:
        costs = loss_of(loss, jnp.square(residuals(u)))[0]
        whole = 0.5 * jnp.sum(jnp.where(owners == -1, costs, 0.0))
        for k in range(owners.max() + 1):
            own = owners == k
            whole += 0.5 * int(own.sum()) * jnp.log(jnp.sum(jnp.where(own, costs, 0.0)))
        return whole

    return energy


def _summary(labels: tuple[str, ...], draws: np.ndarray, divergences: int) -> Posterior:
    from numpyro.diagnostics import effective_sample_size, split_gelman_rubin

    rhat, effective = split_gelman_rubin(draws), effective_sample_size(draws)
    refusal = ""
    if divergences:
        refusal = f"{divergences} of {draws[..., 0].size} transitions diverged: the sampler cannot follow the posterior"
    elif not np.all(rhat <= WORST_RHAT):
        worst = int(np.argmax(np.where(np.isfinite(rhat), rhat, np.inf)))
        refusal = f"the chains disagree on {labels[worst]} (R-hat {rhat[worst]:.3f} > {WORST_RHAT}): draw more"
    return Posterior(labels, draws, np.asarray(rhat), np.asarray(effective), divergences, refusal)
