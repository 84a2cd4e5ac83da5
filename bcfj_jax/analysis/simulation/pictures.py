"""Pictures of a run: forces against time, and against penetration. Matplotlib is imported on first use."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.io.outputs import channels
from bcfj_jax.io.plots import Margins, engineering, figure, label, panels, save, style
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import Channel, quantity_of
from bcfj_jax.solve.simulation import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A contact of fewer samples is not resolved.
FEW_SAMPLES = 10


def _members(run: Run) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Per contact, its members' penetration and normal force."""
    grouped: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for name in run.force:
        force = channels({name: run.force[name]}, 1)
        depth = channels({name: run.penetration[name]})
        grouped[name] = {member: (depth[member], force[member][:, 0]) for member in force}
    return grouped


def _caption(run: Run) -> str:
    if run.status == "ok":
        return ""
    return f" (run failed at {format_si(run.failure_time, 's').replace(' u', ' µ')})"


def forces(run: Run, path: Path) -> None:
    """Normal force against time, one panel a contact, members on top of each other."""
    groups = _members(run)
    time_scale, time_prefix = engineering(run.times)
    with style():
        below = 0.85 if any(len(members) > 1 for members in groups.values()) else 0.55
        drawing, axes = figure(len(groups), margins=Margins(below=below))
        for axis, (name, members) in zip(axes, groups.items(), strict=True):
            scale, prefix = engineering(np.concatenate([force for _, force in members.values()]))
            for member, (_, force) in members.items():
                axis.plot(run.times * time_scale, force * scale, label=member)
            axis.set_title(f"{name}: normal force{_caption(run)}")
            axis.set_xlabel(label("time", "s", time_prefix))
            axis.set_ylabel(label("force", "N", prefix))
            axis.set_xlim(run.times[0] * time_scale, run.times[-1] * time_scale)
            if not any(np.nanmin(force, initial=0.0) < 0 for _, force in members.values()):
                axis.set_ylim(bottom=0.0)
            if len(members) > 1:
                place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.25)}
                axis.legend(ncols=len(members), fontsize=8, columnspacing=1.2, handlelength=1.2, **place)
        save(drawing, path)


def readings(run: Run, channels: Sequence[Channel], path: Path) -> None:
    """Each reading against time, one panel a reading, members on top of each other."""
    time_scale, time_prefix = engineering(run.times)
    with style():
        drawing, axes = figure(len(channels), margins=Margins())
        for axis, one in zip(axes, channels, strict=True):
            values = run.readings[one.name]
            scale, prefix = engineering(np.ravel(values), one.unit)
            lines = axis.plot(run.times * time_scale, values * scale)
            axis.set_title(f"{one.name}{_caption(run)}")
            axis.set_xlabel(label("time", "s", time_prefix))
            axis.set_ylabel(label(*quantity_of(one.name), prefix))
            axis.set_xlim(run.times[0] * time_scale, run.times[-1] * time_scale)
            if len(lines) > 1:
                axis.legend(lines, [f"{one.part}_{k + 1}" for k in range(len(lines))], ncols=len(lines), fontsize=8)
        save(drawing, path)


def loops(run: Run, path: Path) -> None:
    """Normal force against penetration, one panel a contact; the area enclosed is the energy it took."""
    groups = _members(run)
    with panels(len(groups), 2, path, 6.0, 4.4, Margins()) as axes:
        for axis, (name, members) in zip(axes, groups.items(), strict=True):
            _loop(axis, members, f"{name}: force against penetration{_caption(run)}")


def _loop(axis: Axes, members: dict[str, tuple[np.ndarray, np.ndarray]], title: str) -> None:
    from matplotlib.patches import Polygon

    depths = np.concatenate([depth for depth, _ in members.values()])
    deepest = np.nanmax(depths, initial=0.0)
    depth_scale, depth_prefix = engineering([deepest])
    pushes = np.concatenate([force for _, force in members.values()])
    force_scale, force_prefix = engineering(pushes)
    axis.set_title(title)
    axis.set_xlabel(label("penetration", "m", depth_prefix))
    axis.set_ylabel(label("force", "N", force_prefix))
    if deepest <= 0.0:
        axis.text(0.5, 0.5, "no contact at any sample", transform=axis.transAxes, ha="center", va="center")
        return
    work, coarse = 0.0, False
    for member, (depth, force) in members.items():
        # Flights are far longer than contacts are deep: show the surface's own neighbourhood.
        near = depth >= -0.04 * deepest
        x = np.where(near, depth, np.nan) * depth_scale
        pressed = depth > 0
        few = np.count_nonzero(pressed) < FEW_SAMPLES
        coarse = coarse or few
        (line,) = axis.plot(x, force * force_scale, marker="o" if few else "", label=member)
        corners = (np.append(depth[pressed], 0.0) * depth_scale, np.append(force[pressed], 0.0) * force_scale)
        taken = float(features.dissipated_work(np.abs(force), depth))
        if math.isfinite(taken):
            # An artist: the limits are set below, and matplotlib need not look for them.
            look = {"color": line.get_color(), "alpha": 0.15 / len(members), "linewidth": 0}
            axis.add_artist(Polygon(np.column_stack(corners), **look))
        work += taken
    axis.set_xlim(-0.04 * deepest * depth_scale, 1.05 * deepest * depth_scale)
    axis.set_ylim(bottom=0.0)
    # Upper left is free: the force rises with the penetration.
    text = "not resolved (too few samples)" if coarse else _dissipated(work, 1e-6 * deepest * np.nanmax(pushes))
    axis.text(0.04, 0.95, f"dissipated: {text}", transform=axis.transAxes, ha="left", va="top")
    if len(members) > 1:
        axis.legend(fontsize=8, loc="center left")


def _dissipated(work: float, noise: float) -> str:
    """The energy in words; below a millionth of the contact's own energy it is the integration's error."""
    if not math.isfinite(work):
        return "unknown, the run failed"
    if abs(work) < noise:
        return f"none (below {format_si(noise, 'J', 2)})".replace(" u", " µ")
    return format_si(work, "J", 4).replace(" u", " µ")
