"""Eight coefficients of the joint from noisy histories of its five contacts over 0.6 s: which are found, how fast.

The record is that of CVODES at 1e-8 (tests/data/joint_derivatives.npz), whose program is not ours: 20 normal forces
every millisecond, with noise of 2 % of each one's peak. All eight are set free first; the fit says which of them the
data do not tell, and those are fixed, at a value that is wrong by a factor of 1.8, and the others found from starts
all over their bounds.

    python -m benchmarks.calibration.joint_calibration [SEEDS] [--noise 0.02] [--starts 6] [--named damping]
writes results/joint_calibration.json and docs/fits_measured.md. Walls are of this process on the cores it may use.
"""

from __future__ import annotations

import re
import time
from typing import Any

import numpy as np

from bcfj_jax import InputError, scenes
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.xla.threads import cores
from benchmarks.analysis.derivatives import CONTACTS, load
from benchmarks.clock import Compilation, clocked, keep_programs
from benchmarks.common import Some, options, publish, save, table
from calibration import Channel, Experiment, Fit, Free, Problem, fit

SCENE = scenes.joint_of_keys(**PLAIN)
TRUTH = {name: float(value) for name, value in SCENE.parameters().items()}
# Bounds as factors of the truth. Three off where that is possible; steeper or flatter than these no contact is.
BOUNDS = {
    "stiffness": (1 / 3, 3.0),
    "exponent": (0.8, 4 / 3),
    "friction_static": (1 / 3, 3.0),
    "friction_dynamic": (1 / 3, 3.0),
    "damping": (1 / 3, 3.0),
    "clearance_seat_ball": (1 / 3, 3.0),
    "clearance_cage_ball": (1 / 3, 3.0),
    "contact_angle": (0.6, 1.5),
}
WRONG = 1.8


def problem(noise: float, seed: int, fixed: dict[str, float]) -> Problem:
    """The kept record with fresh noise; all of ``BOUNDS`` free but what is fixed."""
    kept, draw = load(), np.random.default_rng(seed)
    names = [f"{c}_{i + 1}" if count > 1 else c for c, count in CONTACTS.items() for i in range(count)]
    channels = []
    for name, force in zip(names, kept.force.T, strict=True):
        sigma = noise * float(np.abs(force).max())
        channels.append(Channel(f"{name}.normal", force + sigma * draw.standard_normal(force.size), sigma))
    free = tuple(Free(n, a * TRUTH[n], b * TRUTH[n]) for n, (a, b) in BOUNDS.items() if n not in fixed)
    experiment = Experiment("revolution", kept.times, tuple(channels))
    return Problem(SCENE, {**TRUTH, **fixed}, (experiment,), free)


def row(found: Fit, seed: int, took: dict[str, float]) -> dict[str, Any]:
    """What is kept of a fit."""
    parameters = {}
    for name, p in found.parameters.items():
        begin = [start["from"][name] / TRUTH[name] for start in found.starts]
        ends = p.ci95 and [end / TRUTH[name] for end in p.ci95]
        parameters[name] = {
            "estimate_over_truth": p.value / TRUTH[name], "ci95_over_truth": ends, "identifiable": p.identifiable,
            "recovered": bool(ends and ends[0] <= 1.0 <= ends[1]), "starts_over_truth": [min(begin), max(begin)],
        }  # fmt: skip
    return {
        "seed": seed, "verdict": found.verdict, "reasons": found.reasons, "parameters": parameters,
        "reduced_chi2": found.residual["reduced_chi2"], **took,
        "starts_at_the_optimum": next(int(t.value) for t in found.tests if t.name == "agreement of starts"),
    }  # fmt: skip


def unidentifiable(noise: float, starts: int, compilation: Compilation) -> tuple[list[str], dict[str, Any]]:
    """Names that a fit of all eight says the data do not tell, and how it says so."""
    compilation.since()
    begin = time.perf_counter()
    try:
        found = fit(problem(noise, 0, {}), seed=0, starts=starts)
        names = [name for name, p in found.parameters.items() if not p.identifiable]
        said, verdict = found.reasons, found.verdict
    except InputError as error:
        names, said, verdict = re.findall(r"\[free\.(\w+)\]", str(error)), [str(error)], "refused"
    wall, compiling = time.perf_counter() - begin, compilation.since()
    return names, {"named": names, "verdict": verdict, "said": said, "wall_s": wall, "compiling_s": compiling}


def main() -> None:
    """All eight, then what can be determined, seed by seed; the first of these compiles."""
    named = (Some(), "names that the data do not tell, where that is known already")
    given = options(__doc__, {"seeds": 3}, noise=0.02, starts=6, named=named)
    keep_programs()
    compilation = Compilation()
    named, eight = given.named, {"named": given.named, "verdict": "not asked in this run"}
    if not named:
        named, eight = unidentifiable(given.noise, given.starts, compilation)
        print(eight, flush=True)
    rows, fixed = [], {name: WRONG * TRUTH[name] for name in named}
    for seed in range(given.seeds):
        todo = problem(given.noise, seed, fixed)
        found, took = clocked(lambda seed=seed, todo=todo: fit(todo, seed=seed, starts=given.starts))
        rows.append(row(found, seed, took | {"compiling_s": compilation.since()}))
        print(rows[-1], flush=True)
    known = [p for r in rows for p in r["parameters"].values() if p["identifiable"]]
    save("joint_calibration", {
        "what": "joint, 0.6 s, 20 normal forces every 1 ms by CVODES, noise as a share of each peak",
        "noise": given.noise, "starts": given.starts, "cores_used": cores(), "bounds_over_truth": BOUNDS,
        "all_eight": eight, "fixed_at": {name: f"{WRONG} times the truth" for name in named}, "fits": rows,
        "identifiable": len(known), "recovered": sum(p["recovered"] for p in known),
        "wall_s_after_compilation": [r["wall_s"] - r["compiling_s"] for r in rows],
    })  # fmt: skip
    columns = {
        "seed": "{seed}", "verdict": "{verdict}",
        "recovered": lambda r: f"{sum(p['recovered'] for p in r['parameters'].values())} of {len(r['parameters'])}",
        "wall, compiled": lambda r: f"{r['wall_s'] - r['compiling_s']:.0f} s", "CPU": "{cpu_s:.0f} s",
        "starts at the optimum": lambda r: f"{r['starts_at_the_optimum']} of {given.starts}",
    }  # fmt: skip
    first = eight.get("wall_s", 0.0) - eight.get("compiling_s", 0.0)
    text = f"All eight free, in {first:.0f} s: {eight['verdict']}; not determined by the data: {', '.join(named) or 'none'}."
    text += f" That fixed at {WRONG} times the truth:\n\n{table(columns, rows)}"
    publish("joint_calibration", text, "docs/fits_measured.md")


if __name__ == "__main__":
    main()
