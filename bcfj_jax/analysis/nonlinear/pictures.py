"""Pictures of sections, bifurcations and exponents: arrays in, path of a PNG out; labels with their units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bcfj_jax.analysis.nonlinear.exponents import Exponent
from bcfj_jax.io import plots

# Dots of a diagram shrink with their number: between a dot that is seen and a cloud that has structure.
_LARGE, _SMALL = 9.0, 0.5


def _scattered(axis: Any, x: np.ndarray, y: np.ndarray, least: float = 0.0) -> bool:
    """Dots (N, m) of m members, each in a colour; whether there are several. Area of a dot in pt^2."""
    many, count = y.shape[1] > 1, y.size
    size = max(least, float(np.clip(3000.0 / max(count, 1), _SMALL, _LARGE)))
    for k in range(y.shape[1]):
        axis.scatter(x[:, k], y[:, k], s=size, linewidths=0, label=str(k + 1) if many else None, rasterized=not least)
    return many


def _legend(axis: Any) -> None:
    axis.legend(ncols=8, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), markerscale=2, borderpad=0)


def draw_bifurcation(values: ArrayLike, points: ArrayLike, path: Path, *, parameter: str, reading: str) -> Path:
    """Section points (P, N), or (P, N, m) of m members, each in a colour, against values (P,) in the unit of their label.

    Where all points of a value are NaN its run failed, and a mark says so.
    """
    x, y = np.asarray(values, dtype=float), np.asarray(points, dtype=float)
    y = y.reshape(*y.shape[:2], -1)
    with plots.sheet(path, height=4.2) as (axis,):
        flat = y.reshape(-1, y.shape[2])
        many = _scattered(axis, np.repeat(x, y.shape[1])[:, None] * np.ones(flat.shape), flat)
        failed = np.isnan(y).all(axis=(1, 2))
        if failed.any():
            foot = axis.get_xaxis_transform()
            axis.plot(x[failed], np.zeros(failed.sum()), "kx", ms=5, label="failed", transform=foot, clip_on=False)
        if many or failed.any():
            _legend(axis)
        axis.set(xlabel=parameter, ylabel=reading)
        axis.set_axisbelow(True)
        axis.set_xmargin(0.01)
    return path


def draw_section(x: ArrayLike, y: ArrayLike, path: Path, *, labels: tuple[str, str], title: str = "") -> Path:
    """Points (N,), or (N, m) of m members, of a Poincaré section in a plane of two readings."""
    first, second = (np.asarray(a, dtype=float).reshape(len(np.asarray(a)), -1) for a in (x, y))
    with plots.panels(1, 1, path, 5.1, 4.6) as (axis,):
        if _scattered(axis, first, second, least=2.0):
            _legend(axis)
        axis.set(xlabel=labels[0], ylabel=labels[1], title=title)
    return path


def draw_exponent(found: Exponent | dict[str, Exponent], path: Path) -> Path:
    """Convergence of an exponent, or of several by name: the estimate so far, a band for its standard error."""
    several = found if isinstance(found, dict) else {"": found}
    with plots.sheet(path, height=3.6) as (axis,):
        for name, one in several.items():
            at = one.interval * np.arange(1, one.history.size + 1)
            (line,) = axis.plot(at, one.history, lw=1.2, label=f"{name}: {_value(one)}".lstrip(": "))
            if np.isfinite(one.standard_error):
                low, high = one.value - one.standard_error, one.value + one.standard_error
                axis.axhspan(low, high, color=line.get_color(), alpha=0.15, linewidth=0)
        axis.axhline(0.0, color="#4a4a4a", lw=0.8)
        timed = any(one.interval != 1.0 for one in several.values())
        axis.set(
            xlabel="time [s]" if timed else "iteration", ylabel=f"exponent [{'1/s' if timed else 'per iteration'}]"
        )
        axis.set_xmargin(0.0)
        axis.legend(fontsize=9)
    return path


def _value(found: Exponent) -> str:
    if found.reason:
        return f"failed, {found.reason}"
    error = "" if np.isnan(found.standard_error) else f" ± {found.standard_error:.2g}"
    return f"{found.value:.4g}{error}"
