"""A response surface: a feature between the points of a finished study, with what it is worth.

Kriging (``kriging``) over shares of the parameters' ranges, in the logarithm on log axes; with the study's derivatives
where it kept any (gradient-enhanced kriging: Morris, Mitchell and Ylvisaker 1993; Laurent 2019). Correlation lengths
and noise by maximum likelihood; the deviation's size by it or by leave-one-out (Bachoc 2013), whichever says more, so
that neither a kernel that does not fit nor points that happen to be easy make it too small.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.analysis.axes import Axis
from bcfj_jax.analysis.studies import kriging
from bcfj_jax.analysis.studies.finished import Finished, Source, read
from bcfj_jax.analysis.studies.kriging import Fitted, Hyper
from bcfj_jax.core.errors import InputError
from bcfj_jax.xla.programs import program

# Observations: the likelihood takes their cube in time and their square in memory.
MOST = 2000
# Fewer points than this for each parameter do not determine its correlation length.
_FEWEST_EACH = 3
# Correlation lengths in shares of the box; noise from rounding to as large as the feature itself, and of derivatives
# that mean nothing far larger than any that the feature can have.
_LENGTHS, _NOISES, _ROUGH = (0.02, 30.0), (1e-10, 1.0), (1e-10, 1e6)
# Lengths and noise of derivatives to start from: good ones, and bad ones, to which there is a wall in between.
_STARTS = ((0.3, 1e-6), (1.5, 1e-6), (1.5, 1e2))


class Error(NamedTuple):
    """How wrong a surface is, each point predicted from all others, with the hyperparameters of all.

    Attributes:
        rms, largest: of the errors, in the feature's unit.
        spread: standard deviation of the feature over the points, to compare with.
        within_1, within_2: share of errors within one and two predicted deviations; 0.68 and 0.95 for Gaussian ones.
        points, dropped: used, and left out since the run failed or has no such feature.
    """

    rms: float
    largest: float
    spread: float
    within_1: float
    within_2: float
    points: int
    dropped: int


class Surface(eqx.Module):
    """A feature as a function of the varied parameters: a pytree, to be called within jit, grad and vmap.

    Attributes:
        feature: its name; axes: the D parameters.
        directions: numbers of the parameters whose derivatives were used; () if it is a plain one.
        fitted: kriging of the feature over ``scale``, shifted by ``offset``.
        offset, scale: of the feature; inflation: () of the variance by leave-one-out, 1 or more.
        error: what the surface is worth.
    """

    feature: str = eqx.field(static=True)
    axes: tuple[Axis, ...] = eqx.field(static=True)
    directions: tuple[int, ...] = eqx.field(static=True)
    fitted: Fitted
    offset: Array
    scale: Array
    inflation: Array
    error: Error = eqx.field(static=True)

    def predict(self, values: ArrayLike) -> tuple[Array, Array]:
        """Mean (M,) and standard deviation (M,) of the feature at values (M, D) [SI] of the parameters.

        The deviation is of what a run there would give. Beyond the study's ranges the surface goes back to the mean
        of the study, and says so by its deviation alone.
        """
        values = jnp.atleast_2d(jnp.asarray(values, float))
        shares = jnp.stack([axis.share(values[:, k], jnp) for k, axis in enumerate(self.axes)], axis=1)
        mean, variance = kriging.predict(self.fitted, shares, self.directions)
        return self.offset + self.scale * mean, self.scale * jnp.sqrt(self.inflation * self.fitted.variance * variance)


def predicted(surface: Surface, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``Surface.predict`` by a compiled program, NumPy arrays."""
    return program("surface", _predict, (), (surface, values))[0](surface, values)


def _predict(surface: Surface, values: Array) -> tuple[Array, Array]:
    return surface.predict(values)


def fit(source: Source, feature: str, derivatives: bool = True) -> Surface:
    """A response surface of a feature over a finished study.

    Args:
        source: what ``bcfj_jax.study`` gave back, or the study's folder.
        feature: such as "contact.peak".
        derivatives: whether to use the columns d(feature)/d(parameter) of varied parameters, where there are any.

    Raises:
        InputError: for a feature that is not there or does not vary, and too few or too many points.
    """
    found = read(source)
    where = f"feature '{feature}'"
    y = found.feature(feature)
    slopes, directions = _slopes(found, feature) if derivatives else (np.zeros((len(y), 0)), ())
    kept = np.isfinite(y) & np.isfinite(slopes).all(axis=1)
    x, y, slopes = found.shares[kept], y[kept], slopes[kept]
    least, rows = _FEWEST_EACH * len(found.study.names), y.size * (1 + len(directions))
    if y.size < least:
        raise InputError(where, f"{y.size} usable points of {kept.size}", f"{least} are needed: draw more")
    if rows > MOST:
        remedy = "say derivatives=False" if y.size <= MOST and directions else "make a study of fewer points"
        raise InputError(where, f"{rows} values and derivatives, more than the limit of {MOST}", remedy)
    offset, scale = np.mean(y), np.std(y)
    if scale <= 1e-12 * np.max(np.abs(y)):
        raise InputError(where, f"is {y[0]:.6g} at every point", "vary parameters that change it")
    observed = np.concatenate([(y - offset)[:, None], slopes], axis=1).ravel() / scale
    arguments = likeliest(x, observed, directions), x, observed
    fitted, (error, spread) = program("kriging", _krige, (directions,), arguments)[0](*arguments)
    variance = spread * float(fitted.variance)
    inflation = max(1.0, np.mean(error**2 / variance))
    ratio = np.abs(error) / np.sqrt(inflation * variance)
    assessed = Error(
        float(scale * np.sqrt(np.mean(error**2))), float(scale * np.max(np.abs(error))), float(scale),
        float(np.mean(ratio < 1.0)), float(np.mean(ratio < 2.0)), int(y.size), int(np.count_nonzero(~kept)),
    )  # fmt: skip
    numbers: tuple[Any, Any, Any] = (np.asarray(offset), np.asarray(scale), np.asarray(inflation))
    return Surface(feature, found.study.design.axes, directions, fitted, *numbers, assessed)


def _slopes(found: Finished, feature: str) -> tuple[np.ndarray, tuple[int, ...]]:
    """Derivatives (N, G) by the shares of those parameters that the study differentiated by, and their numbers."""
    columns, directions = [], []
    for k, axis in enumerate(found.study.design.axes):
        name = f"d({feature})/d({axis.name})"
        if name not in found.columns:
            continue
        columns.append(np.where(found.ok, found.columns[name], np.nan) * axis.steepness(found.values[:, k]))
        directions.append(k)
    return np.stack(columns, axis=1) if columns else np.zeros((len(found.values), 0)), tuple(directions)


def likeliest(x: np.ndarray, y: np.ndarray, directions: tuple[int, ...]) -> np.ndarray:
    """Logarithms of the hyperparameters of the largest likelihood of observations y (M,) at points x (N, D), from a
    few starts.
    """
    from scipy.optimize import minimize

    count = x.shape[1]
    noises = [_NOISES, _ROUGH] if directions else [_NOISES]
    bounds = [tuple(np.log(ends)) for ends in [_LENGTHS] * count + noises]
    value = program("likelihood", _value, (directions,), (np.zeros(len(bounds)), x, y))[0]

    def cost(logs: np.ndarray) -> tuple[float, np.ndarray]:
        found, slope = value(logs, x, y)
        # Where rounding leaves no Cholesky factor: a wall, off which the line search steps back.
        return (float(found), np.asarray(slope)) if np.isfinite(found) else (1e10, np.zeros_like(logs))

    best: Any = None
    for length, rough in _STARTS if directions else _STARTS[:2]:
        start = np.log([length] * count + [1e-6, rough])[: len(bounds)]
        found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 100})
        best = found if best is None or found.fun < best.fun else best
    return best.x


def _krige(directions: tuple[int, ...], logs: Array, x: Array, y: Array) -> tuple[Fitted, tuple[Array, Array]]:
    fitted = kriging.solve(x, y, _hyper(logs, x.shape[1]), directions)
    return fitted, kriging.left_out(fitted, y, directions)


def _value(directions: tuple[int, ...], logs: Array, x: Array, y: Array) -> tuple[Array, Array]:
    return jax.value_and_grad(lambda p: kriging.misfit(x, y, _hyper(p, x.shape[1]), directions))(logs)


def _hyper(logs: Array, count: int) -> Hyper:
    """Lengths, then noise of values, then that of derivatives where there are any."""
    found = jnp.exp(logs)
    return Hyper(found[:count], found[count], found[-1])
