"""Friction that uses both coefficients at the joint's sliding speeds: what each law costs, and what it changes.

    python -m benchmarks.models.joint_friction [--stiff]

Side by side in one process: the default joint, with and without rolling balls, and friction with a transition speed of
10 mm/s. A revolution (0.6 s) after the load is up is read. Cost is in solver steps (attempted) and in seconds of the processor
for the whole run, the least of some repetitions. ``--stiff`` adds the laws without memory at 10 mm/s, minutes each.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import save

TIMES, LATE = np.linspace(0.0, 0.9, 901), 0.3
SLOW = {"friction_speed": 0.01}
MEMORIES = (20e-3, 10e-3, 5e-3, 2e-3, 1e-3)
# Contacts that bear less than this [N] have no coefficient worth a mean.
LOADED = 200.0
REPEATS, MOST = 3, 400_000


def cases(stiff: bool) -> list[tuple[str, dict, dict]]:
    """Name, options of the joint, values."""
    found = [("default", {}, {}), ("default, rolling", {"spin": True}, {})]
    for tau in MEMORIES:
        found.append((f"memory {1e3 * tau:g} ms", {"friction": "memory"}, SLOW | {"friction_memory": tau}))
    found.append(("memory 5 ms, bands", {"friction": "memory", "bands": True}, SLOW))
    for tau in (50e-3, 20e-3, 5e-3):
        options = {"friction": "memory", "spin": True}
        found.append((f"memory {1e3 * tau:g} ms, rolling", options, SLOW | {"friction_memory": tau}))
    found += [(f"coulomb {mu:g}", {"friction": "coulomb"}, SLOW | {"friction_dynamic": mu}) for mu in (0.03, 0.12)]
    found += [("brown_mcphee", {}, SLOW), ("step", {"friction": "step"}, SLOW)] if stiff else []
    return found


def measured(options: dict, values: dict) -> tuple[dict, np.ndarray]:
    """A row of the table, and the late normal forces (T, contacts)."""
    scene = bj.scenes.joint(**PLAIN | options)
    params = scene.parameters(values)
    seconds, found = np.inf, None
    for _ in range(REPEATS):
        start = time.process_time()
        found = bj.simulate(scene, params, TIMES, max_steps=MOST)
        seconds = min(seconds, time.process_time() - start)
        if seconds > 20.0:
            break
    assert found is not None and found.trajectory is not None
    late = found.times >= LATE
    force = {name: np.asarray(part)[late].reshape(late.sum(), -1, 3) for name, part in found.force.items()}
    normal = np.abs(np.concatenate([part[..., 0] for part in force.values()], 1))
    drag = np.concatenate([np.hypot(part[..., 1], part[..., 2]) for part in force.values()], 1)
    loaded = normal > LOADED
    mu = drag[loaded] / normal[loaded]
    slip = np.concatenate([np.asarray(found.slip[name])[late].reshape(late.sum(), -1) for name in force], 1)
    steps = int(found.stats["accepted"] + found.stats["rejected"])
    row = {
        "steps": steps,
        "cpu_s": seconds,
        "us_per_step": 1e6 * seconds / steps,
        "wall_s": float(found.stats["wall_s"]),
        "peak_kN": {name: float(np.abs(part[..., 0]).max() / 1e3) for name, part in force.items()},
        "friction_W": float(np.mean(np.sum(drag * slip, 1))),
        "mean_mu": float(np.sum(drag[loaded]) / np.sum(normal[loaded])),
        "mu_5_50_95": [float(x) for x in np.quantile(mu, (0.05, 0.5, 0.95))],
        "share_below_half": float(np.mean(mu < 0.075)),
        "slip_5_50_95_mm_s": [float(1e3 * x) for x in np.quantile(slip[loaded], (0.05, 0.5, 0.95))],
    }
    return row, normal


def main() -> None:
    rows, forces = {}, {}
    for name, options, values in cases("--stiff" in sys.argv[1:]):
        rows[name], forces[name] = measured(options, values)
        print(name, rows[name], flush=True)
    for name, row in rows.items():
        rolling = name.endswith(", rolling")
        base = forces["default, rolling" if rolling else "default"]
        near = forces["memory 5 ms, rolling" if rolling else "memory 5 ms"]
        row["rms_from_default"] = float(np.sqrt(np.mean((forces[name] - base) ** 2)) / base.max())
        row["rms_from_5_ms"] = float(np.sqrt(np.mean((forces[name] - near) ** 2)) / near.max())
        row["cost_of_default"] = row["cpu_s"] / rows["default"]["cpu_s"]
    save("joint_friction", rows)


if __name__ == "__main__":
    main()
