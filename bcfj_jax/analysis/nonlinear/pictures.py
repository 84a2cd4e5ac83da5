"""Pictures of sections, bifurcations and exponents: arrays in, path of a PNG out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bcfj_jax.analysis.nonlinear.exponents import Exponent
from bcfj_jax.io import plots

# Dots of a diagram shrink with their number: between a dot that is seen and a cloud that has structure.
_LARGE, _SMALL = 9.0, 0.5


def _dots(count: int) -> float:
    """Area of a dot [pt^2] where there are so many."""
    return float(np.clip(3000.0 / max(count, 1), _SMALL, _LARGE))


def draw_bifurcation(values: ArrayLike, points: ArrayLike, path: Path, *, parameter: str, reading: str) -> Path:
    """Section points against the parameter; where all points of a value are NaN its run failed, and a mark says so.

    Args:
        values: (P,) of the parameter, in the unit of its label.
        points: (P, N), or (P, N, m) for m members, each in a colour.
        path: of the PNG.
        parameter, reading: labels with units.
    """
    x, y = np.asarray(values, dtype=float), np.asarray(points, dtype=float)
    y = y.reshape(*y.shape[:2], -1)
    with plots.sheet(path, height=4.2) as (axis,):
        for k in range(y.shape[2]):
            at = np.broadcast_to(x[:, None], y.shape[:2])
            name = str(k + 1) if y.shape[2] > 1 else None
            axis.scatter(at, y[..., k], s=_dots(y[..., k].size), linewidths=0, label=name, rasterized=True)
        failed = np.isnan(y).all(axis=(1, 2))
        if failed.any():
            foot = axis.get_xaxis_transform()
            axis.plot(x[failed], np.zeros(failed.sum()), "kx", ms=5, label="failed", transform=foot, clip_on=False)
        if y.shape[2] > 1 or failed.any():
            axis.legend(ncols=8, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), markerscale=2, borderpad=0)
        axis.set(xlabel=parameter, ylabel=reading)
        axis.set_axisbelow(True)
        axis.set_xmargin(0.01)
    return path


def draw_section(x: ArrayLike, y: ArrayLike, path: Path, *, labels: tuple[str, str], title: str = "") -> Path:
    """Points of a Poincaré section in a plane of two readings; the first is marked, as an attractor has no order.

    Args:
        x, y: (N,), or (N, m) for m members, each in a colour.
        path: of the PNG.
        labels: of both axes, with units.
        title: of the picture.
    """
    first, second = (np.asarray(a, dtype=float).reshape(len(np.asarray(a)), -1) for a in (x, y))
    with plots.sheet(path, width=5.6, height=4.6) as (axis,):
        many = first.shape[1] > 1
        for k in range(first.shape[1]):
            name = str(k + 1) if many else None
            axis.scatter(first[:, k], second[:, k], s=max(2.0, _dots(first.size)), linewidths=0, label=name)
        if many:
            axis.legend(ncols=8, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), markerscale=2, borderpad=0)
        axis.set(xlabel=labels[0], ylabel=labels[1], title=title)
    return path


def draw_exponent(found: Exponent | dict[str, Exponent], path: Path) -> Path:
    """Convergence of an exponent, or of several by name: the estimate so far, a band for its standard error."""
    several = found if isinstance(found, dict) else {"": found}
    with plots.sheet(path, height=3.6) as (axis,):
        unit = "per iteration"
        for name, one in several.items():
            timed = one.interval != 1.0
            unit = "1/s" if timed else unit
            at = one.interval * np.arange(1, one.history.size + 1)
            (line,) = axis.plot(at, one.history, lw=1.2, label=f"{name}: {_value(one)}".lstrip(": "))
            if np.isfinite(one.standard_error):
                low, high = one.value - one.standard_error, one.value + one.standard_error
                axis.axhspan(low, high, color=line.get_color(), alpha=0.15, linewidth=0)
        axis.axhline(0.0, color="#4a4a4a", lw=0.8)
        axis.set(xlabel="time [s]" if unit == "1/s" else "iteration", ylabel=f"exponent [{unit}]")
        axis.set_xmargin(0.0)
        axis.legend(fontsize=9)
    return path


def _value(found: Exponent) -> str:
    if found.reason:
        return f"failed, {found.reason}"
    error = "" if np.isnan(found.standard_error) else f" ± {found.standard_error:.2g}"
    return f"{found.value:.4g}{error}"
