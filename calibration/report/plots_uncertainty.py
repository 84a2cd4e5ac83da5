"""Pictures of what is not known: profiles, posterior, correlation of parameters, autocorrelation of residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.io.page import Picture, counted
from bcfj_jax.io.plots import COLOURS, Margins, engineering, label, panels, plain, sheet
from calibration.fit import Fit
from calibration.uncertainty.estimates import one_by_one
from calibration.uncertainty.posterior import Posterior
from calibration.uncertainty.profile import Profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILES = ("profile.png", "posterior.png", "correlation.png", "residual_acf.png")
# Beyond so many thresholds a profile's own shape is all that a picture could show.
_CEILING = 1.6


def draw(fit: Fit, folder: Path) -> list[Picture]:
    """Those of ``FILES`` that a fit has something for: profiles and draws where there are any."""
    units = {name: p.unit for name, p in fit.parameters.items()} | {"reference_force": "N"}
    found, evidence = [], fit.evidence
    if several := list(evidence.profiles.values()):
        profiles(several, units, folder / FILES[0])
        shapes = ", ".join(f"{p.name} {p.shape}" for p in several)
        found.append(Picture(FILES[0], "Profiles", f"Cost along each parameter, the others fitted again: {shapes}."))
    if evidence.posterior is not None:
        posterior(evidence.posterior, units, folder / FILES[1])
        shows = f"Draws from the posterior of {', '.join(evidence.posterior.labels)}; 95 % shaded."
        found.append(Picture(FILES[1], "Posterior", shows))
    names = ["reference_force" if p.kind == "derived" else name for name, p in fit.parameters.items()]
    few = [names.index(name) for name in one_by_one(names)]
    if fit.correlation is not None and len(few) > 1:
        correlation(fit.correlation[np.ix_(few, few)], [names[k] for k in few], folder / FILES[2])
        apart = np.abs(np.asarray(fit.correlation) - np.eye(len(names)))
        i, k = np.unravel_index(int(np.argmax(apart)), apart.shape)
        most = f"{fit.correlation[i, k]:+.2f}, of {names[i]} and {names[k]}"
        shows = f"Correlations of the estimates; the largest is {most}."
        found.append(Picture(FILES[2], "Correlation of the estimates", shows))
    if series := residual_series(fit):
        residual_acf(series, folder / FILES[3])
        shows = f"Autocorrelation of the residuals of {counted(len(series), 'channel')} by lag, with the bounds of white noise."
        found.append(Picture(FILES[3], "Memory of the residuals", shows))
    return found


def residual_series(fit: Fit) -> dict[str, np.ndarray]:
    """White residuals (n,) of a fit in time order, by name of record and channel."""
    at, names = fit.optimum, [record.name for record in fit.records if not record.held_out]
    return {
        f"{names[int(i)]} {at.model.channels[j]}": at.end.residuals[s.rows]
        for s in at.series
        if s.rows.size > 3
        for i, j, _ in [np.unravel_index(s.rows[0], at.model.data.values.shape)]
    }


def profiles(found: Sequence[Profile], units: Mapping[str, str], path: Path) -> None:
    """Every profile with its threshold, its interval shaded, and the parabola that the covariance stands for."""
    with panels(len(found), 3, path, 4.2, 3.4) as axes:
        for axis, profile in zip(axes, found, strict=True):
            _profile(axis, profile, units[profile.name])


def _profile(axis: Axes, profile: Profile, unit: str) -> None:
    scale, prefix = _scale(profile.values, unit)
    search = np.log if profile.log else np.asarray
    half = search(profile.quadratic[1]) - search(profile.best)
    low, high = (search(v) for v in (profile.values[0], profile.values[-1]))
    if np.isfinite(half):
        low, high = (min(low, search(profile.best) - 1.15 * half), max(high, search(profile.best) + 1.15 * half))
        z = np.linspace(low, high, 201)
        parabola = profile.threshold * ((z - search(profile.best)) / half) ** 2
        values = np.exp(z) if profile.log else z
        axis.plot(values * scale, parabola, color=COLOURS[5], lw=1, ls="--", label="covariance")
    x, y = _between(profile, search)
    axis.plot((np.exp(x) if profile.log else x) * scale, y, color=COLOURS[0], label="profile")
    axis.plot(profile.values * scale, profile.rises, "o", ms=3.5, color=COLOURS[0])
    axis.axhline(profile.threshold, color=COLOURS[1], lw=1, label="95 %")
    if profile.interval:
        axis.axvspan(profile.interval[0] * scale, profile.interval[1] * scale, color="#e8eef6", lw=0, zorder=0)
    axis.set(
        ylim=(-0.03 * profile.threshold, _CEILING * profile.threshold), title=f"{profile.name}: {profile.shape}",
        xlabel=label(profile.name, unit, prefix), ylabel="cost above the best",
    )  # fmt: skip
    axis.legend(fontsize=8, loc="upper center", ncols=3, columnspacing=1.0, handlelength=1.4)


def _between(profile: Profile, search: Callable) -> tuple[np.ndarray, np.ndarray]:
    """The curve through the points: the signed root of the rise is nearly straight in the search coordinate."""
    from scipy.interpolate import PchipInterpolator

    z = search(profile.values)
    root = np.sign(profile.values - profile.best) * np.sqrt(np.maximum(profile.rises, 0.0))
    x = np.linspace(z[0], z[-1], 201)
    return x, PchipInterpolator(z, root)(x) ** 2


def _scale(values: np.ndarray, unit: str) -> tuple[float, str]:
    """A prefix where a unit may take one: N/m^n and 1 may not."""
    return engineering(values) if unit.isalpha() and unit != "kg" else (1.0, "")


def posterior(found: Posterior, units: Mapping[str, str], path: Path) -> None:
    """Marginals on the diagonal, with their 95 % interval, and pairs below it; units are SI, by label."""
    count = len(found.labels)
    draws = found.draws.reshape(-1, count)
    thinned = draws[:: max(1, len(draws) // 1000)]
    scales = [_scale(draws[:, k], units[name]) for k, name in enumerate(found.labels)]
    with sheet(path, count, count, width=2.4 * count + 1.0, height=2.2) as axes:
        for row, column in np.ndindex(count, count):
            axis = axes[row * count + column]
            axis.set_visible(column <= row)
            x, y = draws[:, column] * scales[column][0], thinned[:, row] * scales[row][0]
            axis.set_xlim(*np.quantile(x, [0.0, 1.0]))
            axis.tick_params(labelsize=7, labelbottom=row == count - 1, labelleft=row > 0 and column == 0)
            axis.locator_params(nbins=4)
            axis.ticklabel_format(useOffset=False, scilimits=(-4, 5))
            axis.xaxis.get_offset_text().set_fontsize(7)
            axis.yaxis.get_offset_text().set_fontsize(7)
            if column == row:
                _marginal(axis, x, found.intervals[found.labels[row]], scales[row][0])
            else:
                axis.plot(thinned[:, column] * scales[column][0], y, ".", ms=2, alpha=0.3, color=COLOURS[0])
            names = [label(name, units[name], scale[1]) for name, scale in zip(found.labels, scales, strict=True)]
            if row == count - 1:
                axis.set_xlabel(names[column], fontsize=8)
            if column == 0 and row:
                axis.set_ylabel(names[row], fontsize=8)
        axes[0].figure.suptitle(found.refusal or f"{len(draws)} draws, shaded: 95 %", fontsize=11)


def _marginal(axis: Axes, values: np.ndarray, interval: tuple[float, float] | None, scale: float) -> None:
    axis.hist(values, bins=40, color=COLOURS[0], alpha=0.8)
    axis.set_yticks([])
    axis.grid(False)
    if interval:
        axis.axvspan(interval[0] * scale, interval[1] * scale, color="#e8eef6", lw=0, zorder=0)


def correlation(matrix: np.ndarray, labels: Sequence[str], path: Path) -> None:
    """Correlations (P, P) of the estimates as a map with its numbers."""
    count = len(labels)
    with sheet(path, width=1.0 * count + 3.2, height=0.85 * count + 1.8) as (axis,):
        picture = axis.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
        for row, column in np.ndindex(count, count):
            dark = abs(matrix[row, column]) > 0.6
            text = f"{matrix[row, column]:.2f}"
            axis.text(column, row, text, ha="center", va="center", fontsize=9, color="white" if dark else "black")
        axis.set_xticks(range(count), list(labels), rotation=30, ha="right")
        axis.set_yticks(range(count), list(labels))
        axis.grid(False)
        axis.set_title("correlation of the estimates")
        axis.figure.colorbar(picture, ax=axis, shrink=0.8)


def residual_acf(series: Mapping[str, np.ndarray], path: Path) -> None:
    """Autocorrelation of white residuals (n,) by lag in samples, with the bounds that 95 % of white noise keeps."""
    with panels(len(series), 2, path, 6.0, 2.6, Margins()) as axes:
        for axis, (name, residuals) in zip(axes, series.items(), strict=True):
            lags = min(40, residuals.size // 3)
            bound = 1.96 / np.sqrt(max(residuals.size, 1))
            axis.axhspan(-bound, bound, color="#e8eef6", lw=0)
            values = autocorrelation(residuals, lags)
            axis.vlines(np.arange(1, lags + 1), 0.0, values, color=COLOURS[0])
            axis.plot(np.arange(1, lags + 1), values, "o", ms=3.5, color=COLOURS[0])
            axis.axhline(0.0, color=COLOURS[5], lw=0.8)
            outside = int(np.count_nonzero(np.abs(values) > bound))
            axis.locator_params(axis="x", integer=True)
            title = f"{plain(name)}: {outside} of {lags} lags outside (white: {0.05 * lags:.0f})"
            axis.set(title=title, ylim=(-1.05, 1.05), xlabel="lag [samples]", ylabel="autocorrelation")


def autocorrelation(residuals: np.ndarray, lags: int) -> np.ndarray:
    """Sample autocorrelation (lags,) of residuals (n,) at lags 1 to ``lags``; the mean of a residual is 0 by design."""
    power = float(residuals @ residuals)
    if power == 0.0:
        return np.zeros(lags)
    return np.array([residuals[k:] @ residuals[:-k] for k in range(1, lags + 1)]) / power
