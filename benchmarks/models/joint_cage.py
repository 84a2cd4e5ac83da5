"""The cage as it is: what window ends, bands and rolling balls cost, and whether the free cage keeps to its windows.

    python -m benchmarks.models.joint_cage            some five minutes on two quiet cores; benchmarks/results/joint_cage.json
    python -m benchmarks.models.joint_cage cost       or any of: drift, balance, cost, fine

Cost: one revolution of the plain joint under full load, from 0.15 s on, at the level ``balanced`` and at a force error of
1e-4. Every variant is compiled before; runs of all variants take turns, and the median of each is kept. Drift: fifteen
revolutions, with no weight on bit and with 20 kN: the cage's mean speed about its own axis over the seat's, of the last ten.
Balance: energy of the first 0.1 s at a force error of 1e-4.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis import energy_balance
from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.clock import clocked, turns
from benchmarks.common import options, parts, publish, table

TURN = 0.6
VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "window ends": {"window_ends": True},
    "bands": {"bands": True},
    "window ends, bands": {"window_ends": True, "bands": True},
    "rolling balls": {"spin": True},
    "all": {"window_ends": True, "bands": True, "spin": True},
}
REPEATS = 7
# Revolutions in which a cage with 20 kN on bit comes to the ends of its windows.
_CROSSED = 5


def cost(accuracy: Any) -> dict[str, dict[str, float]]:
    """Steps, wall time and time per step of a run of 0.75 s, and that over the plain joint's; compile time beside."""
    times, runs = np.linspace(0.0, 0.15 + TURN, 751), {}
    found: dict[str, dict[str, float]] = {}
    for name, given in VARIANTS.items():
        scene = bj.scenes.joint_of_keys(**PLAIN | given)
        runs[name] = partial(bj.simulate, scene, scene.parameters(), times, accuracy=accuracy)
        run, took = clocked(runs[name])
        steps = int(run.stats["accepted"]) + int(run.stats["rejected"])
        found[name] = {"first_s": took["wall_s"], "steps": steps, "failed": float(run.status != "ok")}
        peaks = {c.name: float(np.abs(run.force[c.name][times >= 0.15, ..., 0]).max()) for c in scene.contacts}
        found[name] |= {f"{contact} [kN]": peak / 1e3 for contact, peak in peaks.items()}
    spent = turns(runs, REPEATS)
    for name, row in found.items():
        row["cpu_s"] = float(np.median(spent[name]))
        row["us_per_step"] = 1e6 * row["cpu_s"] / row["steps"]
        row["over_plain"] = row["cpu_s"] / found["plain"]["cpu_s"]
    if accuracy == "balanced":
        publish("joint_cost", cost_table(found), "docs/joint.md")
    return found


def cost_table(found: dict[str, dict[str, float]]) -> str:
    columns = {"joint": "{name}", "steps": "{steps:.0f}", "us a step": "{us_per_step:.0f}"}
    rows = ({"name": name, **row} for name, row in found.items())
    return table({**columns, "seconds over plain": "{over_plain:.2f}"}, rows)


def drift() -> dict[str, dict[str, float]]:
    """Mean speed of the cage about its axis over the seat's less 1, of ten revolutions once it has crossed its play."""
    times = np.linspace(0.0, (_CROSSED + 10) * TURN, 1000 * (_CROSSED + 10) + 1)
    found = {}
    for name in ("plain", "window ends", "window ends, bands", "all"):
        for weight in (0.0, 20e3):
            scene = bj.scenes.joint_of_keys(**PLAIN | VARIANTS[name])
            params = scene.parameters(axial_load=weight)
            run = bj.simulate(scene, params, times)
            c = constants(scene, params)

            def about(y: jax.Array, scene: Any = scene, c: Any = c) -> jax.Array:
                state = system.view(scene, c, y)
                return state.cage_spin @ state.cage_axis

            speed = np.asarray(jax.lax.map(about, jnp.asarray(run.trajectory), batch_size=1000))
            late = times >= _CROSSED * TURN - 1e-9
            turned = np.trapezoid(speed[late], times[late])
            if scene.azimuth is not None and run.trajectory is not None:
                turned = np.ptp(run.trajectory[late, scene.azimuth][[0, -1]])
            asked = float(params["drive_speed"]) * np.ptp(times[late])
            ends = run.force.get("cage_window_end")
            found[f"{name}, {weight / 1e3:g} kN"] = row = {
                "status": str(run.status),
                "speed_ratio_less_1": float(turned / asked - 1.0),
                "steps": int(run.stats["accepted"] + run.stats["rejected"]),
                **({} if ends is None else {"window ends mean [kN]": float(ends[late, :, 0].sum(1).mean() / 1e3)}),
            }
            for pilot in ("seat_cage", "head_cage"):
                row[f"{pilot} mean [kN]"] = float(run.force[pilot][late, 0].mean() / 1e3)
            print(name, weight, row, file=sys.stderr, flush=True)
    return found


def balance() -> dict[str, float]:
    """Closure of the energy balance of the first 0.1 s, load rise and all."""
    found = {}
    for name in ("plain", "all"):
        scene = bj.scenes.joint_of_keys(**PLAIN | VARIANTS[name])
        result = energy_balance.balance(scene, scene.parameters(), np.linspace(0.0, 0.1, 11), 1e-4)
        found[name] = float(result.closure)
    return found


PARTS: dict[str, Callable[[], Any]] = {
    "drift": drift,
    "balance": balance,
    "cost": partial(cost, "balanced"),
    "fine": partial(cost, 1e-4),
}


def main() -> None:
    """The parts asked for, into the results beside those that are there."""
    parts("joint_cage", PARTS, options(__doc__, {"parts": PARTS}).parts)


if __name__ == "__main__":
    main()
