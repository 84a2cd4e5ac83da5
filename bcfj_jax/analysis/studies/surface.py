"""A response surface: a feature between the points of a finished study, with what it is worth.

Ordinary kriging over shares of the parameters' ranges, in the logarithm on log axes: a Gaussian process of unknown constant
mean b and covariance s^2 k over the unit box, k Matern's of order 5/2,

    k(x, x') = (1 + sqrt5 r + 5/3 r^2) exp(-sqrt5 r),   r^2 = sum_i ((x_i - x'_i)/l_i)^2   (Stein 1999; Rasmussen 2006)

whose realisations have one derivative: smooth enough for derivatives to be used, not as smooth as a Gaussian kernel's, which
a feature with kinks is not. Derivatives that the study kept are used (Morris, Mitchell and Ylvisaker 1993; Laurent 2019):
one covaries with all else by derivatives of k. Observations are in the order point by point: value, then derivatives.

Correlation lengths and noise by maximum likelihood; the deviation's size by it or by leave-one-out (Bachoc 2013), whichever
says more, so that neither a kernel that does not fit nor points that happen to be easy make it too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_solve
from jax.typing import ArrayLike

from bcfj_jax.analysis.axes import Axis
from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.studies import view
from bcfj_jax.analysis.studies.api import Finished, Source, read
from bcfj_jax.analysis.studies.command import DONE, INTERRUPTED, finished
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.page import brief
from bcfj_jax.xla.programs import program

_ROOT5 = 5.0**0.5


class Hyper(NamedTuple):
    """What a likelihood chooses."""

    length: Array  # (D,) correlation lengths, in shares of the box
    nugget: Array  # () noise of values, as a part of s^2
    rough: Array  # () noise of derivatives, as a part of their own variance under the kernel, 5/3 s^2/l^2


class Fitted(NamedTuple):
    """Kriging ready to predict."""

    x: Array  # (N, D) points
    hyper: Hyper
    factor: Array  # (M, M) lower Cholesky factor of the correlation, M = N (1 + G)
    weights: Array  # (M,) R^-1 (y - b h)
    trend: Array  # (M,) R^-1 h, h = 1 at values and 0 at derivatives
    mass: Array  # () h R^-1 h
    mean: Array  # () b
    variance: Array  # () s^2


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
    """How wrong a surface is, each point predicted from all others, with the hyperparameters of all."""

    # rms, largest, spread: of the errors, and the feature's own standard deviation over the points, in its unit.
    rms: float
    largest: float
    spread: float
    # within_1, within_2: share of errors within one and two predicted deviations; 0.68 and 0.95 for Gaussian ones.
    within_1: float
    within_2: float
    # points, dropped: used, and left out since the run failed or has no such feature.
    points: int
    dropped: int


class Surface(eqx.Module):
    """A feature as a function of the varied parameters: a pytree, to be called within jit, grad and vmap."""

    feature: str = eqx.field(static=True)  # its name
    axes: tuple[Axis, ...] = eqx.field(static=True)  # the D parameters
    # Numbers of the parameters whose derivatives were used; () if it is a plain one.
    directions: tuple[int, ...] = eqx.field(static=True)
    fitted: Fitted  # kriging of the feature over ``scale``, shifted by ``offset``
    # offset, scale: of the feature.
    offset: Array
    scale: Array
    inflation: Array  # () of the variance by leave-one-out, 1 or more
    error: Error = eqx.field(static=True)  # what the surface is worth

    def predict(self, values: ArrayLike) -> tuple[Array, Array]:
        """Mean (M,) and standard deviation (M,) of what runs at values (M, D) [SI] of the parameters would give.

        Beyond the study's ranges the surface goes back to the mean of the study, and says so by its deviation alone.
        """
        values = jnp.atleast_2d(jnp.asarray(values, float))
        shares = jnp.stack([axis.share(values[:, k], jnp) for k, axis in enumerate(self.axes)], axis=1)
        mean, variance = predict(self.fitted, shares, self.directions)
        return self.offset + self.scale * mean, self.scale * jnp.sqrt(self.inflation * self.fitted.variance * variance)


def predicted(surface: Surface, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``Surface.predict`` by a compiled program, NumPy arrays."""
    return program("surface", _predict, (), (surface, values))[0](surface, values)


def _predict(surface: Surface, values: Array) -> tuple[Array, Array]:
    return surface.predict(values)


def fit(source: Source, feature: str, derivatives: bool = True) -> Surface:
    """A response surface of a feature ("contact.peak") over a finished study.

    Args:
        source: what ``bcfj_jax.study`` gave back, or the study's folder.
        feature: its name.
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
    """Logarithms of the likeliest hyperparameters of observations y (M,) at points x (N, D), from a few starts."""
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
    fitted = solve(x, y, _hyper(logs, x.shape[1]), directions)
    return fitted, left_out(fitted, y, directions)


def _value(directions: tuple[int, ...], logs: Array, x: Array, y: Array) -> tuple[Array, Array]:
    return jax.value_and_grad(lambda p: misfit(x, y, _hyper(p, x.shape[1]), directions))(logs)


def _hyper(logs: Array, count: int) -> Hyper:
    """Lengths, then noise of values, then that of derivatives where there are any."""
    found = jnp.exp(logs)
    return Hyper(found[:count], found[count], found[-1])


# ``bcfj study surface``: a table of errors, ``surface.json`` and pictures.

JSON = "surface.json"
_CURVE, _MAP = 241, 81  # points
# What the columns mean, for the screen.
_MEANING = (
    "Errors at each point of a surface through all other points; spread: standard deviation of the feature itself."
)


def run(what: str, out: Path | None, features: Sequence[str], derivatives: bool) -> tuple[str, int]:
    """Surfaces of some features, or of all; in words, and the exit code: 5 while the study is not finished."""
    found, folder, first = finished(what, out)
    if found is None:
        return first, INTERRUPTED
    good, errors = found.each(lambda name: fit(found, name, derivatives), features)
    outputs.write_json(folder / JSON, {one.feature: content(one) for one in good})
    for one in good:
        name = f"surface-{one.feature.replace(':', '-')}.png"
        draw(one, found, outputs.inside(folder, name, f"feature {one.feature}"))
    refused = [f"{name}: no surface: {why}" for name, why in errors.items()]
    return "\n".join([table(good), *refused, f"results in {folder}"]), DONE


def content(one: Surface) -> dict[str, Any]:
    """What ``surface.json`` says of a feature."""
    hyper, names = one.fitted.hyper, [axis.name for axis in one.axes]
    return {
        "derivatives": [names[k] for k in one.directions],
        "correlation_length": dict(zip(names, hyper.length.tolist(), strict=True)),
        "noise": float(one.scale * np.sqrt(one.fitted.variance * hyper.nugget)),
        "leave_one_out": one.error._asdict(),
    }


def table(good: Sequence[Surface]) -> str:
    """Leave-one-out errors, a row a feature."""
    rows = [["", "points", "left out", "rms error", "largest", "spread", "within 1, 2 deviations"]]
    for one in good:
        e = one.error
        numbers = (brief(x, feature_unit(one.feature)) for x in (e.rms, e.largest, e.spread))
        within = f"{100 * e.within_1:.0f} %, {100 * e.within_2:.0f} %"
        called = f"{one.feature}{' (with derivatives)' if one.directions else ''}"
        rows.append([called, str(e.points), str(e.dropped), *numbers, within])
    return f"{report.text(rows)}\n\n{_MEANING}"


def draw(one: Surface, found: Finished, path: Path) -> None:
    """One parameter: a curve with its band; two: maps of the feature and of its deviation; more: curves through the middle."""
    if len(one.axes) == 2:
        _maps(one, found, path)
    else:
        _curves(one, found, path)


def _unit(one: Surface) -> tuple[str, str]:
    kind = one.feature.rpartition(".")[2]
    return kind.replace("_", " "), feature_unit(one.feature)


def _scale(panel: Any, which: str, axis: Axis) -> None:
    """A parameter's scale, with few ticks of plain numbers on a log one, where ranges are often short of a decade."""
    if axis.scale != "log":
        return
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    panel.set(**{f"{which}scale": "log"})
    line = panel.xaxis if which == "x" else panel.yaxis
    line.set_major_locator(MaxNLocator(5) if axis.upper < 5 * axis.lower else LogLocator(subs=(1.0, 2.0, 5.0)))
    line.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    line.set_minor_locator(NullLocator())


def _curves(one: Surface, found: Finished, path: Path) -> None:
    middle = np.array([float(axis.at(np.array(0.5))) for axis in one.axes])
    kind, unit = _unit(one)
    y = found.feature(one.feature)
    lines = []
    for k, axis in enumerate(one.axes):
        values = np.tile(middle, (_CURVE, 1))
        values[:, k] = axis.at(np.linspace(0.0, 1.0, _CURVE))
        lines.append((values[:, k], *predicted(one, values)))
    scale, prefix = plots.engineering(np.concatenate([mean for _, mean, _ in lines]))
    with plots.panels(len(lines), 2 if len(lines) == 4 else 3, path, 4.6 if len(lines) > 1 else 6.5, 3.6) as axes:
        ends = [(mean + side * deviation) * scale for _, mean, deviation in lines for side in (-2, 2)]
        margin = 0.05 * np.ptp(ends)
        for k, (panel, (x, mean, deviation)) in enumerate(zip(axes, lines, strict=True)):
            low, high = (mean - 2 * deviation) * scale, (mean + 2 * deviation) * scale
            panel.fill_between(x, low, high, alpha=0.25, lw=0, label="± 2 deviations")
            panel.plot(x, mean * scale, label="surface")
            if len(lines) == 1:
                panel.plot(found.values[:, 0], y * scale, "o", ms=4, color="#333333", label="study")
            _scale(panel, "x", one.axes[k])
            # One scale for all, so that what matters shows.
            if len(lines) > 1:
                panel.set_ylim(np.min(ends) - margin, np.max(ends) + margin)
            panel.set(xlabel=view.label(found.study, one.axes[k].name), ylabel=plots.label(kind, unit, prefix))
            rest = "" if len(lines) == 1 else ", the others in the middle"
            panel.set_title(f"{one.feature}{rest if k == 0 else ''}")
            if k == 0:
                panel.legend(fontsize=8)


def _maps(one: Surface, found: Finished, path: Path) -> None:
    ends = [axis.at(np.linspace(0.0, 1.0, _MAP)) for axis in one.axes]
    mesh = np.meshgrid(*ends, indexing="ij")
    mean, deviation = (x.reshape(_MAP, _MAP) for x in predicted(one, np.stack([m.ravel() for m in mesh], 1)))
    good = np.isfinite(found.feature(one.feature))
    kind, unit = _unit(one)
    with plots.panels(2, 2, path, 5.2, 4.2) as axes:
        for panel, field, called in ((axes[0], mean, kind), (axes[1], deviation, "deviation")):
            scale, prefix = plots.engineering(field.ravel())
            panel.grid(False)
            drawn = panel.contourf(*mesh, field * scale, levels=24)
            panel.figure.colorbar(drawn, ax=panel, label=plots.label(called, unit, prefix))
            panel.plot(*found.values[good].T, "o", ms=3.5, mfc="none", mec="white", mew=0.9)
            _scale(panel, "x", one.axes[0])
            _scale(panel, "y", one.axes[1])
            panel.set(xlabel=view.label(found.study, one.axes[0].name))
            panel.set(ylabel=view.label(found.study, one.axes[1].name))
        axes[0].contour(*mesh, mean, levels=8, colors="white", linewidths=0.6)
        axes[0].set_title(f"{one.feature}; circles: the study's points")
        axes[1].set_title(f"{one.feature}: predicted deviation")
