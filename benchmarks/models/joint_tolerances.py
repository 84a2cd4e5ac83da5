"""What unequal balls, elastic parts by contact and stiffness from geometry change of the joint, and what they cost.

    python -m benchmarks.models.joint_tolerances [--alone]    writes results/joint_tolerances.json, prints tables

Once per turn: 3 s of the default joint with balls of various sizes; period and ripple (greatest less least) of the
pilot's normal force, over the last two thirds, where the start is forgotten. Spread: the 100 joints of
``examples/joint_tolerances.toml``. Price: every option beside the default in one process, run by run in turn; medians of
CPU time. ``--alone`` says that nothing else ran on the machine. Writes its tables into docs/joint.md.
"""

from __future__ import annotations

import sys
import tempfile
import time
from typing import Any

import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis.histories import settled_period
from bcfj_jax.analysis.studies.specification import load
from benchmarks.common import ROOT, markdown, put_in_readme, save

TIMES = np.linspace(0.0, 3.0, 3001)
PILOT, ROUNDS = "seat_cage", 7
TURN = 0.6
UM = 1e-6
QUANTILES = [0.0, 0.05, 0.5, 0.95, 1.0]


def sizes() -> dict[str, dict[str, float]]:
    """By name, oversizes and extra clearances of the balls [m]."""
    normal = np.random.default_rng(24).normal(size=(2, 6)) * 10 * UM
    contacts = ("seat_ball", "head_ball", "cage_ball")
    clearances = {f"{c}_{i + 1}.extra_clearance": x for c in contacts for i, x in enumerate(normal[1])}
    return {
        "equal balls": {},
        "one ball 10 um oversize": {"ball_1.oversize": 10 * UM},
        "balls 2 and 5 20 um oversize": {"ball_2.oversize": 20 * UM, "ball_5.oversize": 20 * UM},
        "oversizes of 10 um rms": {f"ball_{i + 1}.oversize": x for i, x in enumerate(normal[0])},
        "extra clearances of 10 um rms": clearances,
    }


def looked_at(values: dict[str, float]) -> dict[str, Any]:
    """Period [s] and ripple [N] of the pilot's force, and the largest ball force [N]."""
    scene = bj.scenes.joint(bj.scenes.JointGeometry(unequal=True))
    run = bj.simulate(scene, scene.parameters(values), TIMES)
    settled = TIMES[-1] / 3.0 <= TIMES
    pilot = np.asarray(run.force[PILOT])[:, 0]
    return {
        "period": settled_period(TIMES, pilot),
        "mean": float(pilot[settled].mean()),
        "ripple": float(np.ptp(pilot[settled])),
        "largest ball force": float(np.asarray(run.force["seat_ball"])[settled][..., 0].max()),
        "status": run.status,
    }


OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "unequal balls": {"unequal": True},
    "stiffness from geometry": {"stiffness": "geometry"},
    "pilots liu_sphere": {"elastics": {"seat_cage": "liu_sphere", "head_cage": "liu_sphere"}},
    "pilots bai_zhao": {"elastics": {"seat_cage": "bai_zhao", "head_cage": "bai_zhao"}},
    "all of these": {
        "unequal": True, "stiffness": "geometry", "elastics": {"seat_cage": "liu_sphere", "head_cage": "liu_sphere"},
    },
}  # fmt: skip


def prices() -> dict[str, dict[str, float]]:
    """Of each option steps and CPU seconds of 0.6 s, and the pilot's mean force."""
    times = np.linspace(0.0, 0.6, 601)
    cases = {name: bj.scenes.joint_of_keys(**options) for name, options in OPTIONS.items()}
    spent: dict[str, list[float]] = {name: [] for name in cases}
    found = {}
    for _ in range(ROUNDS + 1):
        for name, scene in cases.items():
            begin = time.process_time()
            run = bj.simulate(scene, scene.parameters(), times)
            spent[name].append(time.process_time() - begin)
            pilot = np.asarray(run.force[PILOT])[300:, 0]
            steps = run.stats["accepted"] + run.stats["rejected"]
            found[name] = {"steps": int(steps), "mean": float(pilot.mean()), "ripple": float(np.ptp(pilot))}
    for name, seconds in spent.items():
        # The first round compiles.
        found[name]["cpu_s"] = float(np.median(seconds[1:]))
        found[name]["us a step"] = 1e6 * found[name]["cpu_s"] / found[name]["steps"]
    return found


def spread() -> dict[str, Any]:
    """Quantiles of each feature over the joints of the example."""
    with tempfile.TemporaryDirectory() as folder:
        found = bj.study(ROOT / "examples" / "joint_tolerances.toml", folder)
        good = found.column("status") == "ok"
        names = [feature.name for feature in load(ROOT / "examples" / "joint_tolerances.toml").features]
        quantiles = {name: np.quantile(found.column(name)[good], QUANTILES).tolist() for name in names}
        turns = int((np.abs(found.column(f"{PILOT}.period")[good] - TURN) <= 0.01).sum())
    counts = {"joints": len(good), "failed": int((~good).sum()), "with the period of a turn": turns}
    return counts | {"quantiles": QUANTILES, "features": quantiles}


def main() -> None:
    balls = {name: looked_at(values) for name, values in sizes().items()}
    class_of = spread()
    priced = prices()
    content = {"alone": "--alone" in sys.argv, "balls": balls, "class": class_of, "options": priced}
    save("joint_tolerances", content)
    put_in_readme("joint_tolerances", tables(content), "docs/joint.md")


def tables(content: dict[str, Any]) -> str:
    """What docs/joint.md shows."""
    balls, class_of, priced = content["balls"], content["class"], content["options"]
    rows = [["balls", "period of the pilot's force", "mean", "ripple", "largest force of a ball"]]
    for name, row in balls.items():
        newtons = (f"{row[key] / 1e3:.2f} kN" for key in ("mean", "ripple", "largest ball force"))
        rows.append([name, f"{row['period']:.3f} s", *newtons])
    text = markdown(rows)
    rows = [[f"{class_of['joints']} joints", "least", "5 %", "median", "95 %", "largest"]]
    for name, values in class_of["features"].items():
        unit = "s" if name.endswith("period") else "kN"
        rows.append([f"`{name}`", *(f"{x:.3f} s" if unit == "s" else f"{x / 1e3:.2f} kN" for x in values)])
    text += "\n\n" + markdown(rows)
    first = priced["default"]
    rows = [["option", "steps", "CPU time a step", "CPU time over the default's", "pilot's mean force"]]
    for name, row in priced.items():
        costs = (f"{row['steps']}", f"{row['us a step']:.0f} us", f"{row['cpu_s'] / first['cpu_s']:.2f}")
        rows.append([name, *costs, f"{row['mean'] / 1e3:.2f} kN"])
    note = "" if content["alone"] else " Measured while other programs ran: the times are rough."
    return f"{text}\n\nThe price, 0.6 s of the default joint, all in one process.{note}\n\n{markdown(rows)}"


if __name__ == "__main__":
    main()
