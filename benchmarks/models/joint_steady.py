"""Derivatives of the joint's steady motion: the periodic orbit's, beside CVODES' and those of a long run.

    python -m benchmarks.models.joint_steady    writes results/joint_steady.json, prints a table

CVODES' are those of the last pitch of the file of ``benchmarks.analysis.derivatives`` (0.5 s to 0.6 s: the start is
forgotten), by logarithms of the same parameters. The long run is 3 s; its derivatives are averaged over the last turn.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives.jacobian import level
from bcfj_jax.analysis.derivatives.names import feature
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.steady import SAMPLES, Steady, steady
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.analysis.derivatives import CONTACTS, MOVED, errors, load
from benchmarks.common import markdown, save

SCENE = bj.scenes.joint_of_keys(**PLAIN)
NAMES = tuple(dict.fromkeys(name for own in MOVED.values() for name in own))
PITCH, LONG_S, MAX_STEPS = 0.1, 3.0, 400_000
# What moves a mean by less than 0.01 % per 1 % of a parameter counts as that much.
LEAST = 0.01


def orbit(end: float = 0.6) -> Steady:
    """Steady motion from a run until ``end`` [s], a whole number of pitches."""
    params = SCENE.parameters()
    run = bj.simulate(SCENE, params, np.linspace(0.0, end, round(end / 1e-3) + 1))
    assert run.trajectory is not None
    wanted = [feature(f"{c}.{kind}", SCENE.members) for c in CONTACTS for kind in ("mean", "peak", "period")]
    found = steady(Problem(SCENE, params, run.times, NAMES, wanted, max_steps=MAX_STEPS), run.trajectory[-1], end)
    assert found is not None
    return found


def by_logarithm(slopes: np.ndarray) -> np.ndarray:
    """Derivatives (P, T, C) by ``NAMES``, per SI unit, as (T, C, 8) by the logarithms of ``MOVED``."""
    params = SCENE.parameters()
    shares = {name: float(params[name]) * slope for name, slope in zip(NAMES, slopes, strict=True)}
    return np.stack([np.sum([shares[name] for name in own], axis=0) for own in MOVED.values()], -1)


def turned(pitches: int) -> np.ndarray:
    """Channels (20,) whose last do what these do so many pitches later: ball j does what ball j + 1 did."""
    parts, first = [], 0
    for members in CONTACTS.values():
        parts.append(first + (np.arange(members) + pitches) % members)
        first += members
    return np.concatenate(parts)


def means(slopes: np.ndarray) -> np.ndarray:
    """Derivatives (5, 8) of the contacts' means from those (T, 20, 8) of forces, the ends of a pitch both in T."""
    every, parts, first = np.trapezoid(slopes, axis=0) / (len(slopes) - 1), [], 0
    for members in CONTACTS.values():
        parts.append(every[first : first + members].mean(axis=0))
        first += members
    return np.stack(parts)


def apart(found: Steady, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Relative difference (5, 8) of derivatives of means."""
    size = np.array([found.features[f"{c}.mean"] for c in CONTACTS])[:, None]
    return np.abs(first - second) / np.maximum(np.abs(second), LEAST * size)


def beside_cvodes(found: Steady) -> dict[str, Any]:
    """By parameter: relative L2 difference of histories, of 5 ms averages and pointwise, and the worst of the means."""
    kept, own = load(), by_logarithm(found.derivative[..., 0])
    exact, force = (x[-SAMPLES:, turned(1)] for x in (kept.slope, kept.force))
    figures = (errors(own, exact), errors(own, exact, 1), apart(found, means(own), means(exact)).max(axis=0))
    looser = kept.settings["convergence"]["sensitivities at 1e-06"]
    return {
        "force": float(np.linalg.norm(found.force[..., 0] - force) / np.linalg.norm(force)),
        "parameters": {
            name: {"5 ms": float(a), "pointwise": float(b), "mean": float(c), "reference's own": looser[name]["5 ms"]}
            for name, a, b, c in zip(MOVED, *figures, strict=True)
        },
    }


def beside_a_long_run(found: Steady) -> dict[str, Any]:
    """By parameter and level: the worst relative difference of derivatives of means over the last turn of 3 s."""
    params, times = SCENE.parameters(), np.linspace(0.0, LONG_S, round(LONG_S / 1e-3) + 1)
    own, rows = means(by_logarithm(found.derivative[..., 0])), {}
    for tolerance in (0.02, 0.005):
        how = Plan(np.asarray(tolerance), MAX_STEPS, plan(SCENE).tangents)  # pyright: ignore[reportArgumentType]
        last = level(SCENE, params, times, NAMES, how).derivative.force[:, -6 * (SAMPLES - 1) - 1 :, :, 0]
        worst = apart(found, means(by_logarithm(last)), own).max(axis=0)
        rows[f"{tolerance:g}"] = dict(zip(MOVED, worst.tolist(), strict=True))
    return rows


def main() -> None:
    found = orbit()
    cvodes, run = beside_cvodes(found), beside_a_long_run(found)
    content = {"memory": found.memory, "off": found.off, "steps": found.steps, "CVODES": cvodes, "3 s": run}
    save("joint_steady", {"what": "derivatives of steady motion by 8 logarithms, relative differences", **content})
    table = [["parameter", "5 ms", "pointwise", "means", "reference's own", *(f"3 s at {x}, means" for x in run)]]
    for name, row in cvodes["parameters"].items():
        table.append([name, *(f"{100 * x:.2g} %" for x in (*row.values(), *(run[x][name] for x in run)))])
    print(markdown(table), cvodes["force"], found.memory, found.off, found.steps)


if __name__ == "__main__":
    main()
