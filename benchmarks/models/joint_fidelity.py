"""What the cheaper fidelities of the joint cost in accuracy: kinematic and quasistatic beside dynamic.

    python -m benchmarks.models.joint_fidelity        a minute or two; prints the table and keeps it in benchmarks/results

The default joint over its last revolution before 3 s, at 360 angles. Peak and mean are those of the normal force's size
over all angles and balls; rms is the difference from the dynamic model, all balls, as a fraction of the dynamic peak.
"""

from __future__ import annotations

import os
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.models.joint.scene import FIDELITIES, PLAIN
from benchmarks.common import save

END, ANGLES, REPEATS = 3.0, 360, 3


def run(fidelity: str) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Normal force of every contact over the revolution (360, ...), and seconds."""
    scene = bj.scenes.joint_of_keys(fidelity=fidelity, **PLAIN)
    params = scene.parameters()
    turn = 2.0 * np.pi / float(params["drive_speed"])
    times = END - turn + turn * np.arange(1, ANGLES + 1) / ANGLES
    first = bj.simulate(scene, params, times)
    if first.status != "ok":
        raise SystemExit(f"{fidelity}: {first.reason}")
    walls = [bj.simulate(scene, params, times).stats["wall_s"] for _ in range(REPEATS)]
    seconds = {"wall_s": float(np.median(walls)), "compile_s": first.stats["compile_s"]}
    return {name: force[..., 0] for name, force in first.force.items()}, seconds


def compare(force: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Peak and mean [N], and the difference from the dynamic force as fractions of the dynamic peak."""
    peak = np.abs(truth).max()
    return {
        "peak_N": float(np.abs(force).max()),
        "mean_N": float(np.abs(force).mean()),
        "peak_difference": float((np.abs(force).max() - peak) / peak),
        "mean_difference": float((np.abs(force).mean() - np.abs(truth).mean()) / peak),
        "rms_difference": float(np.sqrt(np.mean((force - truth) ** 2)) / peak),
    }


def table(contacts: dict[str, dict[str, dict[str, float]]], seconds: dict[str, dict[str, float]]) -> str:
    """The Markdown table: a row a contact and fidelity, then the seconds."""
    kilonewtons = {f"{key}": lambda x, key=key: f"{x[f'{key}_N'] / 1e3:.2f} kN" for key in ("peak", "mean")}
    differs = {f"{key} differs": lambda x, key=key: f"{100 * x[f'{key}_difference']:+.1f} %" for key in ("peak", "rms")}
    rows = [{"name": name, "fidelity": f, **x} for name, found in contacts.items() for f, x in found.items()]
    spent = {"fidelity": "{name}", "wall": lambda x: f"{1e3 * x['wall_s']:.0f} ms", "compile": "{compile_s:.1f} s"}
    forces = harness.table({"contact": "{name}", "fidelity": "{fidelity}", **kilonewtons, **differs}, rows)
    return f"{forces}\n\n{harness.table(spent, ({'name': name, **x} for name, x in seconds.items()))}"


def main() -> None:
    runs: dict[str, Any] = {fidelity: run(fidelity) for fidelity in FIDELITIES}
    truth = runs["dynamic"][0]
    contacts = {
        name: {fidelity: compare(force[name], truth[name]) for fidelity, (force, _) in runs.items()} for name in truth
    }
    seconds = {fidelity: spent for fidelity, (_, spent) in runs.items()}
    save("joint_fidelity", {"end_s": END, "angles": ANGLES, "contacts": contacts, "seconds": seconds})
    print(table(contacts, seconds))


if __name__ == "__main__":
    main()
