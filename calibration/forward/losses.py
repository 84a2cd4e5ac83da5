"""What a residual costs: the sum of squares, or less where a few samples are not to decide.

As ``scipy.optimize.least_squares`` defines it: residuals of z = r^2 cost rho(z), the scale one standard deviation.
"""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

A = TypeVar("A", jax.Array, np.ndarray)


def loss_of(loss: str, squares: A) -> tuple[A, A]:
    """rho(z) of squared residuals z and its derivative by z."""
    if loss == "soft_l1":
        root = (1.0 + squares) ** 0.5
        return 2.0 * (root - 1.0), 1.0 / root
    if loss == "cauchy":
        cost = jnp.log1p(squares) if isinstance(squares, jax.Array) else np.log1p(squares)
        return cost, 1.0 / (1.0 + squares)
    return squares, 0.0 * squares + 1.0


def influence(loss: str, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """psi(r) = rho'(r^2) r, half the slope of the cost along r, and its own derivative."""
    _, weight = loss_of(loss, np.square(residuals))
    bend = {"soft_l1": weight**3, "cauchy": 2.0 * weight**2 - weight}.get(loss, weight)
    return weight * residuals, bend


def straightened(loss: str, residuals: np.ndarray, jacobians: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (..., N) whose squares sum to the cost, and their Jacobians (..., N, P)."""
    if loss == "linear":
        return residuals, jacobians
    squares = np.square(residuals)
    cost, slope = loss_of(loss, squares)
    share = np.sqrt(np.where(squares > 1e-12, cost / np.where(squares > 1e-12, squares, 1.0), 1.0))
    return residuals * share, (slope / share)[..., None] * jacobians
