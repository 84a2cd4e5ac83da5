"""Friction that uses both coefficients at the joint's sliding speeds: what each law costs, and what it changes.

    python -m benchmarks.models.joint_friction [--stiff] [--lag] [--only TEXT]

Side by side in one process: the plain joint, with rolling balls, and with all options (rolling balls, window ends, bands), by
the default friction and by friction with a transition speed of 10 mm/s. A revolution (0.6 s) after the load is up is read.
Cost is in solver steps (attempted) and in seconds of the processor for the whole run, the least of some repetitions.
Rows of the law ``frictional_lag`` stand beside a run 25 times as accurate. ``--stiff`` adds the laws without memory at 10 mm/s,
minutes each; ``--lag`` measures ``frictional_lag`` and its neighbours alone and keeps the other rows; ``--only`` measures
the rows that contain a text, and the defaults, and keeps the other rows.
"""

from __future__ import annotations

import time

import numpy as np

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import known as kept
from benchmarks.common import options as asked
from benchmarks.common import save

TIMES, LATE = np.linspace(0.0, 0.9, 901), 0.3
SLOW = {"friction_speed": 0.01}
MEMORIES = (20e-3, 10e-3, 5e-3, 2e-3, 1e-3)
# Contacts that bear less than this [N] have no coefficient worth a mean.
LOADED = 200.0
REPEATS, MOST = 5, 400_000
# Of ``balanced`` 1e-2, whose tolerance this divides by 25.
TIGHT = 1e-4


ALL = {"spin": True, "window_ends": True, "bands": True}
ROLLING = {"": {}, ", rolling": {"spin": True}, ", all options": ALL}
WIDER = {"smoothing": 30e-6}
LAGS = {
    "": {},
    ", 10 ms": {"friction_memory": 10e-3},
    ", 0.05 s/m": {"friction_viscous": 0.05},
    ", not viscous": {"friction_viscous": 0.0},
    ", 10 ms, 0.2 s/m": {"friction_memory": 10e-3, "friction_viscous": 0.2},
}


def cases(stiff: bool, lag: bool) -> list[tuple[str, dict, dict]]:
    """Name, options of the joint, values."""
    found: list[tuple[str, dict, dict]] = [(f"default{name}", options, {}) for name, options in ROLLING.items()]
    for name, options in ROLLING.items():
        for more, values in LAGS.items():
            found.append((f"frictional_lag{more}{name}", options | {"friction": "frictional_lag"}, SLOW | values))
    found.append(("memory 5 ms, all options", ALL | {"friction": "memory"}, SLOW))
    if lag:
        return found
    for tau in MEMORIES:
        found.append((f"memory {1e3 * tau:g} ms", {"friction": "memory"}, SLOW | {"friction_memory": tau}))
    found.append(("memory 5 ms, bands", {"friction": "memory", "bands": True}, SLOW))
    for tau in (50e-3, 20e-3, 5e-3):
        options = {"friction": "memory", "spin": True}
        found.append((f"memory {1e3 * tau:g} ms, rolling", options, SLOW | {"friction_memory": tau}))
    found += [(f"coulomb {mu:g}", {"friction": "coulomb"}, SLOW | {"friction_dynamic": mu}) for mu in (0.03, 0.12)]
    found += [("brown_mcphee", {}, SLOW), ("step", {"friction": "step"}, SLOW)] if stiff else []
    return found


def ending(name: str) -> str:
    """Which joint a row is of: a key of ``ROLLING``."""
    return next(end for end in reversed(ROLLING) if name.endswith(end))


def measured(options: dict, values: dict, accuracy: float | str = "balanced") -> tuple[dict, np.ndarray]:
    """A row of the table, and the late normal forces (T, contacts)."""
    scene = bj.scenes.joint_of_keys(**PLAIN | options)
    params = scene.parameters(values | (WIDER if options.get("bands") else {}))
    seconds, found = np.inf, None
    for _ in range(REPEATS):
        start = time.process_time()
        found = bj.simulate(scene, params, TIMES, accuracy=accuracy, max_steps=MOST)
        seconds = min(seconds, time.process_time() - start)
        if seconds > 20.0 or accuracy == TIGHT:
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


def off(found: np.ndarray, known: np.ndarray) -> float:
    """Rms difference over the largest force."""
    return float(np.sqrt(np.mean((found - known) ** 2)) / known.max())


def main() -> None:
    given = asked(__doc__, stiff=False, lag=False, only="")
    rows, forces = {}, {}
    for name, options, values in cases(given.stiff, given.lag):
        if given.only not in name and not name.startswith("default"):
            continue
        rows[name], forces[name] = measured(options, values)
        if name.startswith("frictional_lag"):
            tight, known = measured(options, values, TIGHT)
            rows[name] |= {"rms_from_tight": off(forces[name], known), "tight": tight}
        print(name, rows[name], flush=True)
    for name, row in rows.items():
        base = f"default{ending(name)}"
        row["rms_from_default"] = off(forces[name], forces[base])
        near = f"memory 5 ms{ending(name)}"
        if near in forces:
            row["rms_from_5_ms"] = off(forces[name], forces[near])
        row["cost_of_default"] = row["cpu_s"] / rows["default"]["cpu_s"]
        row["cost_of_default_alike"] = row["cpu_s"] / rows[base]["cpu_s"]
    save("joint_friction", kept("joint_friction") | rows if given.lag or given.only else rows)


if __name__ == "__main__":
    main()
