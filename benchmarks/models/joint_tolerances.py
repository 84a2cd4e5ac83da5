"""What unequal balls, elastic parts by contact and stiffness from geometry change of the joint, and what they cost.

    python -m benchmarks.models.joint_tolerances [--alone]    writes results/joint_tolerances.json, prints tables

Once per turn: 3 s of the default joint with balls of various sizes; period and ripple (greatest less least) of the
pilot's normal force, over the last two thirds, where the start is forgotten. Spread: the 100 joints of
``examples/joint_tolerances.toml``. Price: every option beside the default in one process, run by run in turn; medians of
CPU time. ``--alone`` says that nothing else ran on the machine. Writes its tables into docs/joint.md.
"""

from __future__ import annotations

import tempfile
from functools import partial
from typing import Any

import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.analysis.histories import settled_period
from bcfj_jax.analysis.studies.specification import load
from benchmarks.clock import turns
from benchmarks.common import ROOT, markdown, options, publish, save

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
    times, found = np.linspace(0.0, 0.6, 601), {}

    def run(name: str) -> None:
        scene = bj.scenes.joint_of_keys(**OPTIONS[name])
        run = bj.simulate(scene, scene.parameters(), times)
        pilot = np.asarray(run.force[PILOT])[300:, 0]
        steps = run.stats["accepted"] + run.stats["rejected"]
        found[name] = {"steps": int(steps), "mean": float(pilot.mean()), "ripple": float(np.ptp(pilot))}

    spent = turns({name: partial(run, name) for name in OPTIONS}, ROUNDS)
    for name, row in found.items():
        row["cpu_s"] = float(np.median(spent[name]))
        row["us a step"] = 1e6 * row["cpu_s"] / row["steps"]
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
    alone = options(__doc__, alone=False).alone
    balls = {name: looked_at(values) for name, values in sizes().items()}
    content = {"alone": alone, "balls": balls, "class": spread(), "options": prices()}
    save("joint_tolerances", content)
    publish("joint_tolerances", tables(content), "docs/joint.md")


def tables(content: dict[str, Any]) -> str:
    """What docs/joint.md shows."""
    class_of, first = content["class"], content["options"]["default"]
    kN = {key: lambda row, key=key: f"{row[key] / 1e3:.2f} kN" for key in ("mean", "ripple", "largest ball force")}
    heads = {"mean": kN["mean"], "ripple": kN["ripple"], "largest force of a ball": kN["largest ball force"]}
    named = lambda rows: ({"name": name, **row} for name, row in rows.items())  # noqa: E731
    balls = {"balls": "{name}", "period of the pilot's force": "{period:.3f} s", **heads}

    def cell(name: str, x: float) -> str:
        return f"{x:.3f} s" if name.endswith("period") else f"{x / 1e3:.2f} kN"

    rows = [[f"`{name}`", *(cell(name, x) for x in values)] for name, values in class_of["features"].items()]
    quantiles = markdown([[f"{class_of['joints']} joints", "least", "5 %", "median", "95 %", "largest"], *rows])
    priced = harness.table({
        "option": "{name}", "steps": "{steps}", "CPU time a step": "{us a step:.0f} us",
        "CPU time over the default's": lambda row: f"{row['cpu_s'] / first['cpu_s']:.2f}", "pilot's mean force": kN["mean"],
    }, named(content["options"]))  # fmt: skip
    note = "" if content["alone"] else " Measured while other programs ran: the times are rough."
    price = f"The price, 0.6 s of the default joint, all in one process.{note}"
    return "\n\n".join((harness.table(balls, named(content["balls"])), quantiles, price, priced))


if __name__ == "__main__":
    main()
