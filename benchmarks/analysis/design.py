"""Design of the joint against cage forces: clearances and geometry within the ranges usual for such joints.

    python -m benchmarks.analysis.design          # two objectives, some five minutes on one core
    python -m benchmarks.analysis.design cage_ball.largest
    python -m benchmarks.analysis.design draw     # the page's table and pictures from the kept result

The greatest force of the cage's windows on a ball, and the seat pilot's, each made least by equilibria over one pitch
of the balls under full load, and checked by the equations of motion with friction, by two solvers, after the load has
risen and a pitch has passed. Ranges are those of the physics sheet, 5.1; tolerances are GUESSES of what grinding holds.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis.designs import result
from bcfj_jax.analysis.designs.confirm import By, confirm
from bcfj_jax.analysis.designs.objective import objective
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import RESULTS, ROOT, load, markdown, put_in_readme, save

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
        begin = time.process_time()
        found = bj.design(scene, params, t, name, FREE, starts=STARTS)
        wall = time.process_time() - begin
        print(f"{name}: {found.status}, {wall:.0f} s of one core\n  {found.reason}", flush=True)
        wanted = objective(name, (), motion.members)
        designs = (params, t), ({**params, **found.values}, t)
        other = confirm(scene, By(motion, "sdirk2", 1e-4), designs, wanted, found.gain)
        print(f"  {found.values}\n  {found.confirmation}\n  {other}\n  {found.robustness}")
        images = ROOT / "docs" / "images"
        if name == OBJECTIVES[0]:
            result.draw_starts(found, images / "design_starts.png")
            result.draw_slices(found, images / "design.png")
        results[name] = {**found.content(), "by_sdirk2": other._asdict(), "seconds": wall}
    # Objectives may be run apart.
    kept = load("design")["designs"] if (RESULTS / "design.json").exists() else {}
    designs = {name: one for name, one in {**kept, **results}.items() if name in OBJECTIVES}
    save("design", {"designs": {name: designs[name] for name in OBJECTIVES if name in designs}})
    draw()


def draw() -> None:
    """The table of the page."""
    kept = load("design")["designs"]
    rows = [["", *(f"`{name}`" for name in kept)]]

    def row(text: str, of) -> None:
        rows.append([text, *(of(one) for one in kept.values())])

    for name in FREE:
        row(f"`{name}`", lambda one, name=name: _value(one, name))
    row("status", lambda one: one["status"])
    row("equilibrium, before", lambda one: f"{one['before']:.0f} N")
    row("after", lambda one: _less(one["after"], one["gain"], one["before"]))
    for key, text in (("confirmation", "motion, RODAS3 at 1e-6"), ("by_sdirk2", "motion, SDIRK2 at 1e-4")):
        row(f"{text}, before", lambda one, key=key: f"{one[key]['before']:.0f} N")
        row("after", lambda one, key=key: _less(one[key]["after"], one[key]["gain"], one[key]["before"]))
    row("worst over tolerances, by gradient", lambda one: f"{one['robustness']['linear_worst']:.0f} N")
    row("by runs", lambda one: f"{one['robustness']['sampled_worst']:.0f} N")
    row("standard deviation, by gradient", lambda one: f"{one['robustness']['linear_deviation']:.1f} N")
    row("by runs", lambda one: f"{one['robustness']['sampled_deviation']:.1f} N")
    row("starts that agree", lambda one: f"{one['agree']} of {len(one['starts'])}")
    row("CPU seconds, programs at hand", lambda one: f"{one['seconds']:.0f}")
    put_in_readme("design", markdown(rows), "docs/design.md")


def _less(after: float, gain: float, before: float) -> str:
    return f"{after:.0f} N ({-100.0 * gain / before:+.1f} %)"


def _value(one: dict, name: str) -> str:
    value, before, unit = one["values"][name], one["before_values"][name], one["free"][name]["unit"]
    scale, shown = (np.degrees(1.0), "deg") if unit == "rad" else (1e6, "um") if "clearance" in name else (1e3, "mm")
    side = one["at_bound"].get(name)
    return f"{before * scale:.4g} -> {value * scale:.5g} {shown}" + (f", {side} bound" if side else "")


if __name__ == "__main__":
    draw() if sys.argv[1:] == ["draw"] else main(sys.argv[1:])
