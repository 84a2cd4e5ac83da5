"""The trap test for MuJoCo's identification toolbox: a ball dropped on a plane, contact stiffness and damping unknown.

Its record is position and velocity, from MuJoCo itself: force is not one of its observables, and its contact is linear.
Six starts over the same three decades; the toolbox has no search over starts, so the best cost is taken.
"""

from __future__ import annotations

import contextlib
import io
import time
from typing import Any

import numpy as np

TRUTH = np.array([3000.0, 5.0])  # solref as (-stiffness, -damping), per unit of effective mass
LOWER, UPPER = np.array([100.0, 0.5]), np.array([1e5, 50.0])
NOISE = (1e-4, 1e-2)  # [m], [m/s]
STEP, RADIUS, DROP, LONGEST = 5e-4, 0.02, 0.1, 8.0
CONTACTS, STARTS, ITERATIONS, CLOSE = (1, 2, 10, 30), 6, 200, 0.02

_BALL = f"""
<mujoco><option timestep="{STEP}" integrator="RK4"/><worldbody>
<geom name="floor" type="plane" size="1 1 0.1" solref="-{TRUTH[0]} -{TRUTH[1]}" solimp="0.99 0.99 0.001" priority="1"/>
<body name="ball" pos="0 0 {DROP + RADIUS}"><joint name="z" type="slide" axis="0 0 1"/>
<geom type="sphere" size="{RADIUS}" mass="0.1"/></body></worldbody>
<sensor><jointpos name="position" joint="z"/><jointvel name="velocity" joint="z"/></sensor></mujoco>
"""


def rolled_out() -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """Specification, initial state, times and clean readings (T, 2) of a long run at the truth."""
    import mujoco
    from mujoco import rollout, sysid

    spec = mujoco.MjSpec.from_string(_BALL)  # pyright: ignore[reportAttributeAccessIssue]
    model = spec.compile()
    data = mujoco.MjData(model)  # pyright: ignore[reportAttributeAccessIssue]
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    found = rollout.rollout(model, data, start, np.zeros((int(LONGEST / STEP), 0)))
    state, readings = (np.asarray(a)[0] for a in found)
    return spec, start, state[:, 0], readings


def ends(times: np.ndarray, readings: np.ndarray) -> dict[int, int]:
    """Number of samples that hold so many contacts: up to the next one's onset."""
    touching = readings[:, 0] < -DROP
    onsets = np.flatnonzero(touching[1:] & ~touching[:-1])
    return {n: int(onsets[n]) for n in CONTACTS if n < onsets.size}


def one(spec: Any, initial: np.ndarray, times: np.ndarray, readings: np.ndarray, start: np.ndarray) -> dict[str, Any]:
    """One start of the toolbox: estimate, its 95 % interval of the stiffness, cost, seconds."""
    from mujoco import sysid

    def set_solref(s: Any, p: Any) -> None:
        s.geom("floor").solref = [-float(p.value[0]), -float(p.value[1])]

    params = sysid.ParameterDict()
    params.add(sysid.Parameter("solref", TRUTH, LOWER, UPPER, modifier=set_solref))
    params["solref"].value[:] = start
    model = spec.compile()
    control = sysid.TimeSeries(np.concatenate([[0.0], times]), np.zeros((times.size + 1, 0)))
    sensors = sysid.TimeSeries.from_names(times, readings, model)
    sequences = sysid.ModelSequences("ball", spec, "drop", initial, control, sensors)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    begin = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):  # It tells every iteration.
        found, result = sysid.optimize(params, residual, "mujoco", verbose=False, max_iters=ITERATIONS)
    seconds = time.process_time() - begin
    at = found.as_vector()
    residuals, _, _ = residual(at, found)
    _, half = sysid.calculate_intervals(residuals, result.jac)
    cost = float(sum(np.sum(np.square(r)) for r in residuals))
    return {"value": at.tolist(), "half": np.asarray(half).tolist(), "cost": cost, "seconds": seconds}


def peer(seeds: int) -> list[dict[str, Any]]:
    """Every case: share of starts and of seeds (best of all starts) recovered, and intervals that exclude the truth."""
    from absl import logging

    logging.set_verbosity(logging.ERROR)
    spec, initial, times, clean = rolled_out()
    cases = []
    for contacts, count in ends(times, clean).items():
        for noise in (0.0, 1.0):
            rows = []
            for seed in range(seeds):
                rng = np.random.default_rng([seed, contacts])
                noisy = clean + noise * np.array(NOISE) * rng.standard_normal(clean.shape)
                starts = np.exp(rng.uniform(np.log(LOWER), np.log(UPPER), (STARTS, 2)))
                found = [one(spec, initial, times[:count], noisy[:count], start) for start in starts]
                rows.append((min(found, key=lambda f: f["cost"]), found))
            every = [f for _, found in rows for f in found]

            def close(fit: dict[str, Any]) -> bool:
                return bool(np.all(np.abs(np.array(fit["value"]) / TRUTH - 1.0) <= CLOSE))

            def excluding(fit: dict[str, Any]) -> int:
                return int(np.sum(np.abs(np.array(fit["value"]) - TRUTH) > np.array(fit["half"])))

            cases.append({
                "contacts": contacts, "noise": list(noise * np.array(NOISE)), "seeds": seeds, "starts": STARTS,
                "starts_recovered": float(np.mean([close(f) for f in every])),
                "best_recovered": float(np.mean([close(best) for best, _ in rows])),
                "printed": 2 * len(every), "excluding": sum(excluding(f) for f in every),
                "printed_best": 2 * len(rows), "excluding_best": sum(excluding(best) for best, _ in rows),
                "median_cpu_s": float(np.median([f["seconds"] for f in every])),
            })  # fmt: skip
            print(cases[-1], flush=True)
    return cases
