"""Transition speed of friction and onset of penetration: what they change in the forces, and what they cost.

    python -m benchmarks.models.joint_knobs

One revolution of the default joint at 1 %, after the load is up. Differences are rms over all balls and both races,
relative to the peak, from the run with the sharpest value of the knob; cost is in solver steps (attempted).
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

import bcfj_jax as bj
from bcfj_jax.io.plots import style
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import IMAGES, save

SPEEDS = (0.01, 0.03, 0.1, 0.3)
ONSETS = (0.0, 0.2e-6, 1e-6, 5e-6, 20e-6)
TIMES, LATE, MAX_STEPS = np.linspace(0.0, 0.9, 901), 0.3, 1_000_000


def run(values: dict[str, float]) -> dict:
    """Histories of the second revolution and what they cost."""
    scene = bj.scenes.joint_of_keys(**PLAIN)
    params = scene.parameters(values)
    found = bj.simulate(scene, params, TIMES, max_steps=MAX_STEPS)
    late = found.times >= LATE
    force = np.stack([found.force[name][late, :, 0] for name in ("seat_ball", "head_ball")])
    drag = np.stack([found.force[name][late, :, 1] for name in ("seat_ball", "head_ball")])
    steps = found.stats["accepted"] + found.stats["rejected"]
    return {"time": found.times[late], "force": force, "drag": drag, "steps": steps, "wall_s": found.stats["wall_s"]}


def table(name: str, values: tuple[float, ...]) -> tuple[list[dict], list[dict]]:
    """Rows of one knob; the first value is the sharpest."""
    runs = [run({name: value}) for value in values]
    sharp = runs[0]["force"]
    rows = [
        {
            name: value,
            "rms_of_peak": float(np.sqrt(np.mean((r["force"] - sharp) ** 2)) / np.abs(sharp).max()),
            "peak_kN": float(np.abs(r["force"]).max() / 1e3),
            "steps": int(r["steps"]),
            "wall_s": float(r["wall_s"]),
        }
        for value, r in zip(values, runs, strict=True)
    ]
    return rows, runs


def main() -> None:
    # Values, unit and scale, by knob.
    knobs = {"friction_speed": (SPEEDS, "m/s", 1.0), "smoothing": (ONSETS, "µm", 1e6)}
    found = {name: table(name, values) for name, (values, _, _) in knobs.items()}
    for rows, _ in found.values():
        print(*rows, sep="\n")
    save("joint_knobs", {name: rows for name, (rows, _) in found.items()})
    with style():
        figure, axes = plt.subplots(2, 2, figsize=(11, 7))
        for (above, below), (name, (values, unit, scale)) in zip(axes.T, knobs.items(), strict=True):
            rows, runs = found[name]
            for value, r in zip(values, runs, strict=True):
                above.plot(r["time"], r["force"][0, :, 0] / 1e3, label=f"{value * scale:g} {unit}", linewidth=1)
            above.set(xlabel="time [s]", ylabel="seat_ball_1 normal force [kN]")
            above.legend(title=name, fontsize=8)
            places = range(len(values))
            below.bar(places, [row["steps"] / 1e3 for row in rows], width=0.5, label="steps [thousands]")
            below.set_xticks(list(places), [f"{value * scale:g}" for value in values])
            below.set(xlabel=f"{name} [{unit}]", ylabel="solver steps, 0.9 s [thousands]")
            twin = below.twinx()
            twin.plot(places, [100 * row["rms_of_peak"] for row in rows], "o-", color="C1")
            twin.set_ylabel("rms change of forces [% of peak]", color="C1")
            twin.grid(False)
        figure.tight_layout()
        figure.savefig(IMAGES / "joint_knobs.png", dpi=110)
        plt.close(figure)


if __name__ == "__main__":
    main()
