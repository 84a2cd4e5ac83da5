"""Design of the joint against cage forces: clearances and geometry within the ranges usual for such joints.

    python -m benchmarks.analysis.design          # two objectives, some five minutes on one core
    python -m benchmarks.analysis.design cage_ball.largest
    python -m benchmarks.analysis.design draw     # the page's table and pictures from the kept result

The greatest force of the cage's windows on a ball, and the seat pilot's, each made least by equilibria over one pitch
of the balls under full load, and checked by the equations of motion with friction, by two solvers, after the load has
risen and a pitch has passed. Ranges are those of the physics sheet, 5.1; tolerances are GUESSES of what grinding holds.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.analysis.designs import result
from bcfj_jax.analysis.designs.confirm import By, confirm
from bcfj_jax.analysis.designs.objective import objective
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.clock import clocked
from benchmarks.common import IMAGES, Some, known, load, options, publish, save

# Lower, upper, tolerance. PCR/r_ball 3.8 to 4.6 would leave the spheres: the pitch circle stays 1 mm about its place.
FREE = {
    "offset": ("2.84 mm", "4.97 mm", "20 um"),
    "contact_angle": ("35 deg", "45 deg", "1 deg"),
    "pitch_radius": ("34.5 mm", "36.5 mm", "20 um"),
    "clearance_seat_cage": ("20 um", "100 um", "10 um"),
    "clearance_head_cage": ("20 um", "100 um", "10 um"),
    # From -30 um on, but the model takes no window smaller than its ball, nor may a tolerance make it so.
    "clearance_cage_ball": ("5 um", "40 um", "5 um"),
    "clearance_seat_ball": ("10 um", "60 um", "5 um"),
    "clearance_head_ball": ("10 um", "60 um", "5 um"),
}
OBJECTIVES = ("cage_ball.largest", "seat_cage.peak")
STARTS, SAMPLES = 8, 49


def times(params: dict) -> np.ndarray:
    """One pitch of the balls, after the load's rise and a pitch more [s]."""
    pitch = 2.0 * np.pi / 6.0 / float(params["drive_speed"])
    return float(params["load_ramp"]) + pitch + np.linspace(0.0, pitch, SAMPLES)


def main(names: list[str]) -> None:
    scene, motion = bj.scenes.joint_of_keys(fidelity="quasistatic", **PLAIN), bj.scenes.make("joint", **PLAIN)
    params = scene.parameters()
    t, results = times(params), {}
    for name in names or OBJECTIVES:
        found, took = clocked(lambda name=name: bj.design(scene, params, t, name, FREE, starts=STARTS))
        print(f"{name}: {found.status}, {took['cpu_s']:.0f} s of one core\n  {found.reason}", flush=True)
        wanted = objective(name, (), motion.members)
        designs = (params, t), ({**params, **found.values}, t)
        other = confirm(scene, By(motion, "sdirk2", 1e-4), designs, wanted, found.gain)
        print(f"  {found.values}\n  {found.confirmation}\n  {other}\n  {found.robustness}")
        if name == OBJECTIVES[0]:
            result.draw_starts(found, IMAGES / "design_starts.png")
            result.draw_slices(found, IMAGES / "design.png")
        results[name] = {**found.content(), "by_sdirk2": other._asdict(), "seconds": took["cpu_s"]}
    # Objectives may be run apart.
    designs = {**known("design").get("designs", {}), **results}
    save("design", {"designs": {name: designs[name] for name in OBJECTIVES if name in designs}})
    publish("design", table(load("design")["designs"]), "docs/design.md")


def table(kept: dict[str, Any]) -> str:
    """The table of the page."""

    def gain(key: str) -> Callable[[dict[str, Any]], str]:
        return lambda one: _less(one.get(key, one)["after"], one.get(key, one)["gain"], one.get(key, one)["before"])

    rows: list[tuple[str, Any]] = [
        *((f"`{name}`", partial(_value, name)) for name in FREE), ("status", "{status}"),
        ("equilibrium, before", "{before:.0f} N"), ("after", gain("")),
        ("motion, RODAS3 at 1e-6, before", "{confirmation[before]:.0f} N"), ("after", gain("confirmation")),
        ("motion, SDIRK2 at 1e-4, before", "{by_sdirk2[before]:.0f} N"), ("after", gain("by_sdirk2")),
        ("worst over tolerances, by gradient", "{robustness[linear_worst]:.0f} N"),
        ("by runs", "{robustness[sampled_worst]:.0f} N"),
        ("standard deviation, by gradient", "{robustness[linear_deviation]:.1f} N"),
        ("by runs", "{robustness[sampled_deviation]:.1f} N"),
        ("starts that agree", lambda one: f"{one['agree']} of {len(one['starts'])}"),
        ("CPU seconds, programs at hand", "{seconds:.0f}"),
    ]  # fmt: skip
    cell = lambda of, one: of.format_map(one) if isinstance(of, str) else of(one)  # noqa: E731
    columns = {f"`{name}`": lambda row, one=one: cell(row[1], one) for name, one in kept.items()}
    return harness.table({"": lambda row: row[0], **columns}, rows)


def _less(after: float, gain: float, before: float) -> str:
    return f"{after:.0f} N ({-100.0 * gain / before:+.1f} %)"


def _value(name: str, one: dict) -> str:
    value, before, unit = one["values"][name], one["before_values"][name], one["free"][name]["unit"]
    scale, shown = (np.degrees(1.0), "deg") if unit == "rad" else (1e6, "um") if "clearance" in name else (1e3, "mm")
    side = one["at_bound"].get(name)
    return f"{before * scale:.4g} -> {value * scale:.5g} {shown}" + (f", {side} bound" if side else "")


if __name__ == "__main__":
    names = options(__doc__, {"names": Some()}).names
    publish("design", table(load("design")["designs"]), "docs/design.md") if names == ["draw"] else main(names)
