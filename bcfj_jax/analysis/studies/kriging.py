"""Ordinary kriging of values and, where they are known, first derivatives: the algebra, in JAX.

A Gaussian process of unknown constant mean b and covariance s^2 k over the unit box, k Matern's of order 5/2,

    k(x, x') = (1 + sqrt5 r + 5/3 r^2) exp(-sqrt5 r),   r^2 = sum_i ((x_i - x'_i)/l_i)^2   (Stein 1999; Rasmussen 2006)

whose realisations have one derivative: smooth enough for derivatives to be used, not as smooth as a Gaussian kernel's,
which a feature with kinks is not. A derivative of the process covaries with all else by derivatives of k (Morris,
Mitchell and Ylvisaker 1993). Observations are in the order point by point: value, then derivatives in G directions.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import cho_solve

_ROOT5 = 5.0**0.5


class Hyper(NamedTuple):
    """What a likelihood chooses.

    Attributes:
        length: (D,) correlation lengths, in shares of the box.
        nugget: () noise of values, as a part of s^2.
        rough: () noise of derivatives, as a part of their own variance under the kernel, 5/3 s^2/l^2.
    """

    length: Array
    nugget: Array
    rough: Array


class Fitted(NamedTuple):
    """Kriging ready to predict.

    Attributes:
        x: (N, D) points; hyper: the hyperparameters.
        factor: (M, M) lower Cholesky factor of the correlation, M = N (1 + G).
        weights: (M,) R^-1 (y - b h); trend: (M,) R^-1 h, h = 1 at values and 0 at derivatives; mass: () h R^-1 h.
        mean: () b; variance: () s^2.
    """

    x: Array
    hyper: Hyper
    factor: Array
    weights: Array
    trend: Array
    mass: Array
    mean: Array
    variance: Array


def covariance(a: Array, b: Array, length: Array, left: tuple[int, ...], right: tuple[int, ...]) -> Array:
    """Covariance over s^2 of observations at points a (n, D) with those at points b (m, D), lengths (D,).

    ``left``, ``right``: directions in which either's derivatives are, too: (n (1 + len(left)), m (1 + len(right))).
    """
    d = (a[:, None, :] - b[None, :, :]) / length
    # Kept off 0, where a root has no derivative.
    r = jnp.sqrt(jnp.sum(d**2, axis=-1) + 1e-30)
    fall = jnp.exp(-_ROOT5 * r)
    value = (1.0 + _ROOT5 * r + 5.0 / 3.0 * r**2) * fall
    slope = 5.0 / 3.0 * (1.0 + _ROOT5 * r) * fall
    at, to = jnp.array(left, int), jnp.array(right, int)
    # dk/dx' = slope d/l = -dk/dx, and d2k/dx_i dx'_j = 5/3 e ((1 + sqrt5 r) delta_ij - 5 d_i d_j)/(l_i l_j).
    by_right = slope[..., None] * d[..., to] / length[to]
    by_left = -slope[..., None] * d[..., at] / length[at]
    same = (at[:, None] == to[None, :]).astype(float)
    both = slope[..., None, None] * same - 25.0 / 3.0 * fall[..., None, None] * d[..., at, None] * d[..., None, to]
    both = both / (length[at][:, None] * length[to][None, :])
    first = jnp.concatenate([value[..., None], by_right], axis=-1)[:, :, None, :]
    rest = jnp.concatenate([by_left[..., None], both], axis=-1)
    blocks = jnp.concatenate([first, rest], axis=2)  # (n, m, 1 + L, 1 + R)
    return blocks.transpose(0, 2, 1, 3).reshape(len(a) * (1 + len(left)), len(b) * (1 + len(right)))


@partial(jax.jit, static_argnames="directions")
def solve(x: Array, y: Array, hyper: Hyper, directions: tuple[int, ...]) -> Fitted:
    """Kriging of observations y (M,) at points x (N, D), for given hyperparameters; s^2 of largest likelihood."""
    count, each = len(x), 1 + len(directions)
    noise = jnp.concatenate(
        [hyper.nugget[None], hyper.rough * 5.0 / 3.0 / hyper.length[jnp.array(directions, int)] ** 2]
    )
    matrix = covariance(x, x, hyper.length, directions, directions) + jnp.diag(jnp.tile(noise, count))
    factor = jnp.linalg.cholesky(matrix)
    h = jnp.tile(jnp.zeros(each).at[0].set(1.0), count)
    trend = cho_solve((factor, True), h)
    mass = h @ trend
    mean = trend @ y / mass
    weights = cho_solve((factor, True), y - mean * h)
    return Fitted(x, hyper, factor, weights, trend, mass, mean, (y - mean * h) @ weights / len(y))


def misfit(x: Array, y: Array, hyper: Hyper, directions: tuple[int, ...]) -> Array:
    """Minus the logarithm of the likelihood, b and s^2 at their best, over M and without constants."""
    found = solve(x, y, hyper, directions)
    return 0.5 * jnp.log(found.variance) + jnp.sum(jnp.log(jnp.diag(found.factor))) / len(y)


@partial(jax.jit, static_argnames="directions")
def left_out(fitted: Fitted, y: Array, directions: tuple[int, ...]) -> tuple[Array, Array]:
    """Error of each point's value (N,) as all other points predict it, and its variance over s^2 (N,).

    Leave-one-out in closed form (Dubrule 1983), a point with its derivatives at once:
    e = Q_ii^-1 (Q y)_i with covariance s^2 Q_ii^-1, Q = R^-1 - R^-1 h h R^-1/(h R^-1 h). The mean is estimated anew,
    the hyperparameters are not.
    """
    count, each = len(fitted.x), 1 + len(directions)
    inverse = cho_solve((fitted.factor, True), jnp.eye(len(y)))
    q = inverse - jnp.outer(fitted.trend, fitted.trend) / fitted.mass
    blocks = q.reshape(count, each, count, each)[jnp.arange(count), :, jnp.arange(count), :]
    spread = jnp.linalg.inv(blocks)
    error = jnp.einsum("nij,nj->ni", spread, (q @ y).reshape(count, each))
    return error[:, 0], spread[:, 0, 0]


@partial(jax.jit, static_argnames="directions")
def predict(fitted: Fitted, x: Array, directions: tuple[int, ...]) -> tuple[Array, Array]:
    """Mean (n,) and variance over s^2 (n,) of new values at points (n, D), that of the mean and the noise included."""
    cross = covariance(x, fitted.x, fitted.hyper.length, (), directions)
    mean = fitted.mean + cross @ fitted.weights
    known = jnp.sum(jax.scipy.linalg.solve_triangular(fitted.factor, cross.T, lower=True) ** 2, axis=0)
    drift = (1.0 - cross @ fitted.trend) ** 2 / fitted.mass
    return mean, jnp.maximum(1.0 - known, 0.0) + fitted.hyper.nugget + drift
