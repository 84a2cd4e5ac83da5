"""The joint's 3 s by solvers that share no code with the package, kept as a file; and how far the package is from it.

    python -m benchmarks.models.joint_reference          solves, and writes tests/data/joint_3s.npz (needs the extra ``bench``)
    python -m benchmarks.models.joint_reference check    runs the package at five accuracies against that file

The states are those of CVODES on the C field of ``joint_casadi``. Their forces are read by ``joint.observe``, as
the package's own are. The file holds every contact's force (T, members, 3) as float32 at 1 ms, and settings as JSON.

How well it converged stands in its settings, by a tighter tolerance and by LSODA.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import ROOT, keep_arrays, kept_arrays, options, save

PATH = ROOT / "tests" / "data" / "joint_3s.npz"
TOLERANCE, TIGHTER, LSODA_TOLERANCE = 1e-9, 1e-10, 1e-8
ACCURACIES = (5e-2, 1e-2, 1e-3, 1e-4, 1e-5)
NOTE = (
    "Where the onset is narrower than the balls' play (smoothing below 20 um by default), balls that carry nothing "
    "rattle without order, and no two solvers agree there to better than 0.5 to 1 N rms."
)


class Reference(NamedTuple):
    """A kept history: times (T,) [s], per contact force (T, 3) or (T, 6, 3) [N], the settings it was made with."""

    times: np.ndarray
    force: dict[str, np.ndarray]
    settings: dict[str, Any]


def load(path: Path = PATH) -> Reference:
    """The kept file."""
    kept, settings = kept_arrays(path)
    force = {name.removeprefix("force."): x for name, x in kept.items() if name.startswith("force.")}
    return Reference(kept["times"], force, settings)


def peaks(force: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Greatest normal force of each contact [N], over its members."""
    return {name: float(np.max(np.abs(part[..., 0]))) for name, part in force.items()}


def errors(found: Mapping[str, np.ndarray], reference: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Per contact the worst rms error of a member's component, as a fraction of the contact's peak normal force."""
    peak = peaks(reference)
    return {
        name: float(np.max(np.sqrt(np.mean((found[name] - exact) ** 2, axis=0)))) / peak[name]
        for name, exact in reference.items()
    }


def make() -> None:
    """Solve, measure the convergence, and write the file."""
    import jax

    import bcfj_jax as bj
    from bcfj_jax.models.joint.constants import constants
    from bcfj_jax.models.joint.observe import observe
    from benchmarks.references.joint_casadi import cvodes, default_scales
    from benchmarks.references.joint_peers import SOLVERS

    scene = bj.scenes.joint_of_keys(**PLAIN)
    params, scales = scene.parameters(), default_scales(scene)
    times = np.linspace(0.0, 3.0, 3001)
    made = constants(scene, params)
    read = jax.jit(jax.vmap(lambda y: {name: one.force for name, one in observe(scene, made, y).items()}))
    solves = {
        "CVODES": lambda: cvodes(scene, params, times, TOLERANCE, scales),
        "CVODES, tighter": lambda: cvodes(scene, params, times, TIGHTER, scales),
        "LSODA": lambda: SOLVERS["LSODA (SciPy, C field)"](
            scene, params, times, LSODA_TOLERANCE, scales, max_wall_s=1200.0
        ),
    }
    force, steps = {}, {}
    for name, solve in solves.items():
        peer = solve()
        if peer.failed:
            raise SystemExit(f"{name}: {peer.failed}")
        force[name] = {contact: np.asarray(part) for contact, part in read(peer.states).items()}
        steps[name] = peer.steps
        print(f"{name}: {peer.steps} steps, {peer.wall_s:.1f} s", flush=True)
    kept = force.pop("CVODES")
    settings = {
        "solver": "CVODES (CasADi, BDF, direct linear solver) on the C field of benchmarks/references/joint_casadi.py",
        "tolerance": TOLERANCE,
        "unit_of_the_tolerance": "a place of 50 um, a speed of 0.1 m/s, a turn or spin of these over 35.5 mm",
        "steps": steps.pop("CVODES"),
        "versions": {name: version(name) for name in ("casadi", "scipy", "numpy")},
        "peak_normal_force_N": peaks(kept),
        "convergence": {
            "what": "worst rms of a member's component against this file, over the contact's peak normal force",
            f"CVODES at {TIGHTER:g}": errors(force["CVODES, tighter"], kept),
            f"LSODA at {LSODA_TOLERANCE:g}": errors(force["LSODA"], kept),
            "note": NOTE,
        },
        "scene": "joint, every option at its default",
        "parameters": {name: float(value) for name, value in params.items()},
    }
    keep_arrays(PATH, settings, times, {f"force.{name}": part for name, part in kept.items()})
    print(json.dumps(settings["convergence"], indent=2))


def check() -> None:
    """Errors of the package against the file, contact by contact, at ``ACCURACIES``; kept as joint_accuracy.json."""
    import bcfj_jax as bj

    reference = load()
    scene = bj.scenes.joint_of_keys(**PLAIN)
    params = scene.parameters(reference.settings["parameters"])
    rows = []
    for accuracy in ACCURACIES:
        run = bj.simulate(scene, params, reference.times, accuracy=accuracy, max_steps=1_000_000)
        if run.status != "ok":
            raise SystemExit(f"{accuracy:g}: {run.reason}")
        top = peaks(reference.force)
        found = peaks(run.force)
        row = {
            "asked": accuracy,
            "rms": errors(run.force, reference.force),
            "peak": {name: abs(found[name] / top[name] - 1.0) for name in top},
            "accepted": run.stats["accepted"],
            "rejected": run.stats["rejected"],
        }
        rows.append(row)
        worst = "  ".join(f"{name} {value:.1e}" for name, value in row["rms"].items())
        print(f"{accuracy:.0e}: {worst}  {row['accepted']}+{row['rejected']} steps", flush=True)
    unit = "fraction of the contact's peak normal force"
    kept = {key: reference.settings[key] for key in ("solver", "tolerance", "convergence")}
    save("joint_accuracy", {"unit": unit, "reference": kept, "rows": rows})


if __name__ == "__main__":
    check() if options(__doc__, {"what": "make"}).what == "check" else make()
