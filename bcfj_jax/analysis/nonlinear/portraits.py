"""Pictures of sections, bifurcations and exponents; of a finished run phase portraits, contact modes over time, ball loads.

A contact with clearance is in free flight, in an impact, or in continuous contact (Flores and Ambrósio, Computers and
Structures 82, 2004), distinguished by the surfaces' overlap: free where there is none, an impact where the overlap lasts no
longer than ``impact_time``, else continuous.

Every picture is written as a PNG, whose path is given back; labels have their units. ``window``: (start, end) [s] of the run,
None for all of it. Drawing raises ``InputError`` for a name that the run or the scene has not, and for a window outside the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bcfj_jax.analysis.features import contact_times
from bcfj_jax.analysis.histories import Window, within
from bcfj_jax.analysis.nonlinear.exponents import Exponent
from bcfj_jax.core.errors import InputError, one_of
from bcfj_jax.io import plots
from bcfj_jax.io.outputs import channels
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.simulation import Run

UNKNOWN, FREE, IMPACT, CONTINUOUS = range(-1, 3)
MODES = ("free", "impact", "continuous")
_SHADES = {"free": "#e2e2e2", "impact": "#c4501b", "continuous": "#1f5fa8"}
# Dots of a diagram shrink with their number: between a dot that is seen and a cloud that has structure.
_LARGE, _SMALL = 9.0, 0.5
# A curve's place and rate by its name.
_Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]


def contact_modes(times: ArrayLike, penetration: ArrayLike, rate: ArrayLike, impact_time: float) -> np.ndarray:
    """Codes that count ``MODES`` of one contact's history, (T,); -1 where it is NaN.

    A contact that is cut off by either end of the history is continuous: how long it lasts is not known. One
    between two samples marks the sample before it.

    Args:
        times, penetration, rate: (T,) [s], [m] (negative: gap), [m/s], as in a ``Run``.
        impact_time: the longest contact that counts as an impact [s]; some times pi sqrt(m/k) of the pair.

    Raises:
        InputError: for an impact time that is not positive.
    """
    if not impact_time > 0.0:
        raise InputError("impact_time", f"{impact_time:g} s", "give more than 0")
    t, d, v = (np.asarray(x, dtype=float) for x in (times, penetration, rate))
    good = np.isfinite(d) & np.isfinite(v)
    found = np.full(t.shape, UNKNOWN, dtype=np.int8)
    # A failed run is NaN from somewhere on.
    stop = int(np.argmin(good)) if not good.all() else t.size
    found[:stop] = FREE
    if stop < 2:
        return found
    for start, end in contact_times(t[:stop], d[:stop], v[:stop]):
        first = max(int(np.searchsorted(t[:stop], start)), 0)
        last = stop if np.isnan(end) else int(np.searchsorted(t[:stop], end))
        whole = start > t[0] and not np.isnan(end)
        code = IMPACT if whole and end - start <= impact_time else CONTINUOUS
        if first == last:
            first = max(first - 1, 0)
        found[first:last] = code
    return found


def _states(run: Run) -> np.ndarray:
    if run.trajectory is None:
        raise InputError("run", "holds no states", "take one that simulate made")
    return run.trajectory


def _phases(path: Path, curves: _Curves, title: str, names: tuple[str, str], unit: str) -> Path:
    """Rates against places, with each curve's name where there are several."""
    every = (np.concatenate(parts) for parts in zip(*curves.values(), strict=True))
    (x_scale, x_prefix), (v_scale, v_prefix) = map(plots.engineering, every)
    with plots.panels(1, 1, path, 5.5, 4.4) as (axis,):
        for name, (place, rate) in curves.items():
            axis.plot(place * x_scale, rate * v_scale, lw=0.7, alpha=0.8, label=name)
        if unit == "m" and "gap" in names[0]:
            axis.axvline(0.0, color="#4a4a4a", lw=0.8, ls="--")
        axis.set(title=title, xlabel=plots.label(names[0], unit, x_prefix))
        axis.set_ylabel(plots.label(names[1], f"{unit}/s", v_prefix))
        if len(curves) > 1:
            axis.legend(ncols=min(len(curves), 3), fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    return path


def contact_portrait(run: Run, contact: str, path: Path, *, window: Window = None) -> Path:
    """Phase portrait of a contact: rate d' against penetration d, members on top of each other.

    d < 0 is the gap. Every loop around d = 0 is an impact; its loss of speed is the damping's.
    """
    one_of("contact", "contact", contact, run.penetration)
    part = within(run.times, window)
    depth, rate = (channels({contact: x[contact][part]}) for x in (run.penetration, run.rate))
    curves = {name: (depth[name], rate[name]) for name in depth}
    title, names = f"{contact}: rate against penetration", ("penetration (negative: gap)", "rate")
    return _phases(path, curves, title, names, "m")


def state_portrait(run: Run, scene: AbstractModel, coordinate: str, path: Path, *, window: Window = None) -> Path:
    """Phase portrait of a coordinate of the state: x' against x. The run is one of the scene, made by ``simulate``.

    ``coordinate``: of a joint "cage.x", "head.z", "ball[1].y", "head_turn" and the like; else the name of a body.
    """
    places = scene.coordinates()
    one_of("coordinate", "coordinate", coordinate, places)
    part, unit = within(run.times, window), "rad" if coordinate.endswith("turn") else "m"
    place, rate = (_states(run)[part, k] for k in places[coordinate])
    return _phases(path, {"": (place, rate)}, f"{coordinate}: rate against place", ("x", "x'"), unit)


def contact_raster(run: Run, path: Path, *, impact_time: float, window: Window = None) -> Path:
    """What every contact is doing over time: free, in an impact, in continuous contact; a row each member.

    The share of the time in either mode stands beside each row. White: the run failed. ``impact_time``: the longest
    contact that counts as an impact [s], see ``contact_modes``.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    part = within(run.times, window)
    times = run.times[part]
    # Over the whole run: a contact that the window cuts is as long as it is.
    depth, rate = channels(run.penetration), channels(run.rate)
    rows = {name: contact_modes(run.times, depth[name], rate[name], impact_time)[part] for name in depth}
    scale, prefix = plots.engineering(times)
    edges = np.concatenate([[times[0]], 0.5 * (times[1:] + times[:-1]), [times[-1]]]) * scale
    with plots.sheet(path, height=1.4 + 0.26 * len(rows)) as (axis,):
        table = np.ma.masked_less(np.array(list(rows.values())), 0)
        colours = ListedColormap([_SHADES[mode] for mode in MODES])
        axis.pcolormesh(edges, np.arange(len(rows) + 1), table, cmap=colours, vmin=-0.5, vmax=2.5, rasterized=True)
        axis.hlines(np.arange(1, len(rows)), edges[0], edges[-1], color="white", lw=1.5)
        axis.set_yticks(np.arange(len(rows)) + 0.5, list(rows), fontsize=8)
        axis.invert_yaxis()
        axis.grid(False)
        beside: dict[str, Any] = {"fontsize": 8, "transform": axis.get_yaxis_transform()}
        for k, codes in enumerate(rows.values()):
            shares = " / ".join(f"{100.0 * np.mean(codes == mode):.0f}" for mode in range(len(MODES)))
            axis.text(1.01, k + 0.5, f"{shares} %", va="center", **beside)
        axis.text(1.01, -0.1, "share", va="bottom", **beside)
        axis.set_xlabel(plots.label("time", "s", prefix))
        above: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderpad": 0.2}
        axis.legend([Patch(color=_SHADES[mode]) for mode in MODES], MODES, ncols=3, fontsize=8, **above)
    return path


def ball_loads(
    run: Run, scene: AbstractModel, path: Path, *, contact: str = "seat_ball", window: Window = None
) -> Path:
    """Load of every member of a contact around the drive's axis, polar: size of the normal force against azimuth.

    Azimuth = the drive's turn + 2 pi i/k of k members, evenly spaced. In the joint 0 is where the head's axis leans to.
    The run is one of the model, made by ``simulate``, whose drive turns; a revolution is a good window. Of the joint a
    contact is one that every ball has.
    """
    members = {name: count for name, count in scene.members.items() if count}
    if not (scene.drive_coordinate and members):
        raise InputError("scene", f"'{scene.kind}' has no members around a drive", "give a joint: it has balls")
    one_of("contact of a ball", "contact of a ball", contact, members)
    part = within(run.times, window)
    turn = _states(run)[part, scene.coordinates()[scene.drive_coordinate][0]]
    load = np.abs(run.force[contact][part, :, 0])
    scale, prefix = plots.engineering(load.ravel())
    with plots.style():
        from matplotlib.figure import Figure

        drawing = Figure(figsize=(5.6, 5.4), layout="constrained")
        axis: Any = drawing.add_subplot(projection="polar")
        count = members[contact]
        for k, azimuth in enumerate(2.0 * np.pi * np.arange(count) / count):
            # Thinner and thinner: where all members do the same, all are still seen.
            width = 0.8 + 2.4 * (1.0 - k / count)
            axis.plot(turn + azimuth, load[:, k] * scale, lw=width, label=str(k + 1))
        axis.set_title(f"{contact}: normal force [{prefix.replace('u', 'µ')}N] against azimuth", pad=16)
        axis.set_ylim(bottom=0.0)
        axis.set_rlabel_position(112.5)
        axis.legend(title="ball", fontsize=8, loc="lower left", bbox_to_anchor=(0.98, 0.0), borderpad=0)
        plots.save(drawing, path)
    return path


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
