"""Records of imperfect worlds: does the headline interval, with its systematic budget, hold the truth?

A single impact by SciPy from the exact law, or with one imperfection of the sensor or of the contact, in four magnitudes: its
largest effect on the force is 0.3, 1, 3 and 10 deviations of the noise. One run, or four at different speeds.

    python -m benchmarks.calibration.imperfect [--replicates 6] [--minutes 30] [--seed 0]    keeps results/imperfect.json
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from benchmarks.common import markdown, put_in_readme, save
from calibration import Channel, Experiment, Fit, Free, Problem, fit
from calibration.diagnostics.systematic import total

SCENE = bj.scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
MASS, NOISE, SAMPLES, STARTS = 0.1, 5e-3, 160, 6
SPEEDS = {1: (1.0,), 4: (0.7, 0.9, 1.1, 1.3)}
MAGNITUDES = (0.3, 1.0, 3.0, 10.0)


def motion(speed: float, relaxation: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and forces [N] of the exact law; ``relaxation``: share of the force that a Maxwell branch adds."""
    k, n, a = TRUTH.values()
    depth = (MASS * speed**2 * (n + 1.0) / (2.0 * k)) ** (1.0 / (n + 1.0))
    duration = 3.0 * depth / speed
    tau = 0.3 * duration

    def elastic(d: Any, rate: Any) -> Any:
        return k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * rate, 0.0)

    def change(_: float, s: np.ndarray) -> list[float]:
        force = elastic(s[0], s[1])
        # The branch's elastic part follows the elastic force and forgets it with the time tau.
        stress = k * n * max(s[0], 0.0) ** (n - 1.0) * s[1] if s[0] > 0.0 else 0.0
        return [s[1], -(force + relaxation * s[2]) / MASS, stress - s[2] / tau]

    times = np.linspace(0.0, 1.5 * duration, SAMPLES)
    run = solve_ivp(change, (0.0, times[-1]), (0.0, speed, 0.0), "DOP853", t_eval=times, rtol=1e-10, atol=1e-13)
    inside = run.y[0] > 0.0
    return times, np.where(inside, elastic(run.y[0], run.y[1]) + relaxation * run.y[2], 0.0)


def lagged(times: np.ndarray, force: np.ndarray, tau: float) -> np.ndarray:
    """Through a first-order sensor, exactly for a force that is linear between samples."""
    step, out = times[1] - times[0], np.zeros_like(force)
    kept = np.exp(-step / tau)
    for i in range(1, force.size):
        behind = (force[i] - force[i - 1]) * tau / step
        out[i] = force[i] - behind + (out[i - 1] - force[i - 1] + behind) * kept
    return out


def resonant(times: np.ndarray, force: np.ndarray, omega: float) -> np.ndarray:
    """Through a second-order sensor of 5 % damping."""
    run = solve_ivp(
        lambda t, s: [s[1], omega**2 * (np.interp(t, times, force) - s[0]) - 0.1 * omega * s[1]],
        (0.0, times[-1]), (0.0, 0.0), t_eval=times, max_step=0.2 / omega, rtol=1e-6, atol=1e-6,
    )  # fmt: skip
    return run.y[0]


Change = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
# What a strength of the imperfection makes of a record; a strength of 1 is large.
SENSOR: dict[str, Change] = {
    "gain bend": lambda t, f, s: f * (1.0 + s * f / f.max()),
    "lag": lambda t, f, s: lagged(t, f, s * 0.2 * t[-1]),
    "drift": lambda t, f, s: f + s * f.max() * t / t[-1],
    "hum": lambda t, f, s: f + s * f.max() * np.sin(2.0 * np.pi * 1.7 * t / t[-1] + 1.0),
    "clock": lambda t, f, s: np.interp(t + 0.02 * s * t[-1] * np.sin(9.0 * t / t[-1]), t, f),
    "resonance": lambda t, f, s: resonant(t, f, 2.0 * np.pi * 4.0 / (max(s, 1e-3) ** 0.5 * t[-1])),
}
WORLDS = ("none", *SENSOR, "relaxation")


def read(world: str, speed: float, strength: float) -> tuple[np.ndarray, np.ndarray]:
    times, force = motion(speed, strength if world == "relaxation" else 0.0)
    return times, SENSOR[world](times, force, strength) if world in SENSOR else force


def strength_of(world: str, deviations: float) -> float:
    """The strength whose largest effect is so many deviations of the noise, by bisection."""
    if world == "none":
        return 0.0
    _, plain = motion(1.0)
    target, low, high = deviations * NOISE * plain.max(), 1e-6, 1.0
    for _ in range(18):
        middle = np.sqrt(low * high)
        effect = np.abs(read(world, 1.0, middle)[1] - plain).max()
        low, high = (middle, high) if effect < target else (low, middle)
    return float(np.sqrt(low * high))


def problem(world: str, strength: float, runs: int, seed: int) -> Problem:
    rng, experiments = np.random.default_rng([seed, runs]), []
    # One sensor, whose noise is that of a share of the peak at 1 m/s.
    sigma = NOISE * float(motion(1.0)[1].max())
    for k, speed in enumerate(SPEEDS[runs]):
        times, force = read(world, speed, strength)
        values = force + sigma * rng.standard_normal(force.size)
        experiments.append(
            Experiment(
                f"run {k + 1}", times, (Channel("contact.normal", values, None),), fixed={"approach_speed": speed}
            )
        )
    params = {k: float(v) for k, v in SCENE.parameters({"mass": MASS, "approach_speed": 1.0, **TRUTH}).items()}
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, tuple(experiments), free)


def judged(found: Fit) -> dict[str, Any]:
    """By kind, how many intervals are given and hold the truth; the headline also with its budget."""
    held: dict[str, list[int]] = {"noise": [0, 0], "headline": [0, 0], "with budget": [0, 0]}
    for axis, (name, p) in zip(found.optimum.model.coordinates, found.parameters.items(), strict=True):
        true = TRUTH[name]
        budget = total(found.systematic, name)
        for kind, ends, more in (
            ("noise", p.intervals.get("noise"), 0.0), ("headline", p.ci95, 0.0), ("with budget", p.ci95, budget),
        ):  # fmt: skip
            if ends is not None:
                low, high = (
                    (ends[0] * np.exp(-more), ends[1] * np.exp(more)) if axis.log else (ends[0] - more, ends[1] + more)
                )
                held[kind][0] += 1
                held[kind][1] += int(low <= true <= high)
    return {"verdict": found.verdict, **held}


def table(cells: dict[str, list[dict[str, Any]]]) -> str:
    rows = [["imperfection", "effect / noise", "runs", "verdicts", "noise holds", "headline holds", "with its budget"]]
    shown = []
    for key, found in cells.items():
        world, magnitude, runs = key.split("|")
        words = sorted({f["verdict"] for f in found})
        verdicts = ", ".join(f"{w} {sum(f['verdict'] == w for f in found)}" for w in words)
        shares, worst = [], 1.0
        for kind in ("noise", "headline", "with budget"):
            given, held = (sum(f[kind][i] for f in found) for i in (0, 1))
            shares.append(f"{held} of {given}")
            worst = held / given if given else 1.0
        shown.append((worst, [world, magnitude, runs, verdicts, *shares]))
    shown.sort(key=lambda x: x[0])
    return markdown([*rows, *(row for _, row in shown)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=6)
    parser.add_argument("--minutes", type=float, default=30.0)
    given = parser.parse_args()
    begin, cells = time.perf_counter(), {}
    plans = [(w, m, r) for w in WORLDS for m in (MAGNITUDES if w != "none" else (0.0,)) for r in SPEEDS]
    strengths = {(w, m): strength_of(w, m) for w, m, _ in plans}
    for seed in range(given.replicates):
        for world, magnitude, runs in plans:
            if time.perf_counter() - begin > 60.0 * given.minutes:
                break
            found = fit(problem(world, strengths[world, magnitude], runs, seed), seed=seed, starts=STARTS)
            cells.setdefault(f"{world}|{magnitude:g}|{runs}", []).append(judged(found))
        save("imperfect", {"cells": cells, "strengths": {f"{w}|{m:g}": s for (w, m), s in strengths.items()}})
        print(seed, f"{time.perf_counter() - begin:.0f} s", flush=True)
    sums = {
        k: [sum(f[k][i] for c in cells.values() for f in c) for i in (0, 1)]
        for k in ("noise", "headline", "with budget")
    }
    said = "; ".join(f"{k}: {held / max(count, 1):.1%} of {count}" for k, (count, held) in sums.items())
    put_in_readme("imperfect", f"{table(cells)}\n\nAll: {said}.", "docs/calibration.md")
    print(table(cells), said, sep="\n\n")


if __name__ == "__main__":
    main()
