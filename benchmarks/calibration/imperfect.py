"""Records of imperfect worlds: does the headline interval, with its systematic budget, hold the truth?

A single impact by SciPy from the exact law, or with one imperfection of the sensor, of the contact or of what was held
fixed, in three magnitudes: its largest effect on the force is 0.3, 2 and 10 deviations of the noise. "mixture" is two of
them at once, another pair for every seed. One run, or four or eight at different speeds.

    python -m benchmarks.calibration.imperfect [--replicates 20] [--runs 1 4 8] [--minutes 30] [--more]

keeps results/imperfect.json; ``--more`` goes on from the replicates that it holds.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing import get_context
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from benchmarks.common import RESULTS, load, markdown, put_in_readme, save
from calibration import Channel, Experiment, Fit, Free, Problem, fit

SCENE = bj.scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
MASS, NOISE, SAMPLES, STARTS = 0.1, 5e-3, 160, 6
SPEEDS = {1: (1.0,), 4: (0.7, 0.9, 1.1, 1.3), 8: tuple(np.linspace(0.6, 1.4, 8).tolist())}
MAGNITUDES = (0.3, 2.0, 10.0)


@cache
def motion(
    speed: float, relaxation: float = 0.0, stop: float = 0.0, mass: float = MASS, faster: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and forces [N] of the exact law.

    Args:
        speed: of the approach [m/s], by what the record says; it is ``1 + faster`` times that.
        relaxation: share of the force that a Maxwell branch adds.
        stop: stiffness of a second contact behind 0.6 of the depth, as a share of the mean stiffness of the first.
        mass: [kg].
    """
    k, n, a = TRUTH.values()
    depth = (MASS * speed**2 * (n + 1.0) / (2.0 * k)) ** (1.0 / (n + 1.0))
    duration = 3.0 * depth / speed
    tau, behind, second = 0.3 * duration, 0.6 * 0.00021, stop * k * 0.00021 ** (n - 1.0)

    def elastic(d: Any, rate: Any) -> Any:
        layer = k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * rate, 0.0)
        return layer + second * np.maximum(d - behind, 0.0)

    def change(_: float, s: np.ndarray) -> list[float]:
        force = elastic(s[0], s[1])
        # The branch's elastic part follows the elastic force and forgets it with the time tau.
        stress = k * n * max(s[0], 0.0) ** (n - 1.0) * s[1] if s[0] > 0.0 else 0.0
        return [s[1], -(force + relaxation * s[2]) / mass, stress - s[2] / tau]

    times = np.linspace(0.0, 1.5 * duration, SAMPLES)
    begin = (0.0, speed * (1.0 + faster), 0.0)
    run = solve_ivp(change, (0.0, times[-1]), begin, "DOP853", t_eval=times, rtol=1e-10, atol=1e-13)
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
# What it makes of the motion itself.
CONTACT: dict[str, Callable[[float], dict[str, float]]] = {
    "relaxation": lambda s: {"relaxation": s},
    "second contact": lambda s: {"stop": s},
    "mass": lambda s: {"mass": MASS * (1.0 + s)},
    "speed": lambda s: {"faster": s},
}
SINGLE = (*SENSOR, *CONTACT)
WORLDS = ("none", *SINGLE, "mixture")


def read(worlds: dict[str, float], speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and what the sensor reads with imperfections of given strengths."""
    changes = {key: v for w, strength in worlds.items() if w in CONTACT for key, v in CONTACT[w](strength).items()}
    times, force = motion(speed, **changes)
    for world, strength in worlds.items():
        force = SENSOR[world](times, force, strength) if world in SENSOR else force
    return times, force


@cache
def strength_of(world: str, deviations: float) -> float:
    """The strength whose largest effect is so many deviations of the noise, by bisection."""
    _, plain = motion(1.0)
    target, low, high = deviations * NOISE * plain.max(), 1e-6, 1.0
    for _ in range(18):
        middle = np.sqrt(low * high)
        effect = np.abs(read({world: middle}, 1.0)[1] - plain).max()
        low, high = (middle, high) if effect < target else (low, middle)
    return float(np.sqrt(low * high))


def imperfections(world: str, deviations: float, seed: int) -> dict[str, float]:
    """Imperfections and their strengths: none, one, or two that the seed draws."""
    rng = np.random.default_rng([seed, 77])
    names = rng.choice(SINGLE, 2, replace=False).tolist() if world == "mixture" else [world] if world != "none" else []
    return {name: strength_of(name, deviations) for name in names}


def problem(worlds: dict[str, float], runs: int, seed: int) -> Problem:
    rng, experiments = np.random.default_rng([seed, runs]), []
    # One sensor, whose noise is that of a share of the peak at 1 m/s.
    sigma = NOISE * float(motion(1.0)[1].max())
    for k, speed in enumerate(SPEEDS[runs]):
        times, force = read(worlds, speed)
        values = force + sigma * rng.standard_normal(force.size)
        channel = Channel("contact.normal", values, None)
        experiments.append(Experiment(f"run {k + 1}", times, (channel,), fixed={"approach_speed": speed}))
    params = {k: float(v) for k, v in SCENE.parameters({"mass": MASS, "approach_speed": 1.0, **TRUTH}).items()}
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, tuple(experiments), free)


def judged(found: Fit) -> dict[str, Any]:
    """By kind, how many intervals are given and hold the truth, and how wide they are beside the noise's (median)."""
    held: dict[str, list[float]] = {"noise": [0, 0], "headline": [0, 0], "with budget": [0, 0]}
    widths: dict[str, list[float]] = {"headline": [], "with budget": []}
    for axis, (name, p) in zip(found.optimum.model.coordinates, found.parameters.items(), strict=True):
        noise = p.intervals.get("noise")
        for kind, ends in (("noise", noise), ("headline", p.ci95), ("with budget", p.with_budget)):
            if ends is None:
                continue
            held[kind][0] += 1
            held[kind][1] += int(ends[0] <= TRUTH[name] <= ends[1])
            if kind in widths and noise:
                widths[kind].append(_width(ends, axis.log) / _width(noise, axis.log))
    medians = {k: float(f"{np.median(w):.3g}") for k, w in widths.items() if w}
    return {"verdict": found.verdict, **held, "widths": medians}


def _width(ends: tuple[float, float], log: bool) -> float:
    return float(np.log(ends[1] / ends[0]) if log else ends[1] - ends[0])


def one(world: str, deviations: float, runs: int, seed: int) -> tuple[str, dict[str, Any]]:
    """A fit of one record set, judged, and the cell that it belongs to."""
    found = fit(problem(imperfections(world, deviations, seed), runs, seed), seed=seed, starts=STARTS)
    return f"{world}|{deviations:g}|{runs}", judged(found)


KINDS = ("noise", "headline", "with budget")


def added(cell: dict[str, dict[str, Any]], found: dict[str, Any]) -> None:
    """Count one fit in its cell, whose keys are verdicts."""
    kept = cell.setdefault(found["verdict"], {"fits": 0, **{k: [0, 0] for k in KINDS}, "widths": {}})
    kept["fits"] += 1
    for kind in KINDS:
        kept[kind] = [a + b for a, b in zip(kept[kind], found[kind], strict=True)]
    for kind, width in found["widths"].items():
        kept["widths"].setdefault(kind, []).append(width)


def shares(found: list[dict[str, Any]], kind: str) -> tuple[int, int]:
    """How many intervals of a kind hold the truth, and how many are given."""
    return sum(f[kind][1] for f in found), sum(f[kind][0] for f in found)


def table(cells: dict[str, dict[str, Any]]) -> str:
    head = ["imperfection", "effect / noise", "runs", "verdicts", "noise holds", "headline holds", "with its budget"]
    rows = [[*head, "widths beside the noise's"]]
    shown = []
    for key, found in cells.items():
        world, magnitude, runs = key.split("|")
        verdicts = ", ".join(f"{word} {of['fits']}" for word, of in sorted(found.items()))
        held = [shares(list(found.values()), kind) for kind in KINDS]
        widths = [[w for of in found.values() for w in of["widths"].get(k, [])] for k in KINDS[1:]]
        wide = ", ".join(f"{np.median(w):.2g}" for w in widths if w)
        cell = [world, magnitude, runs, verdicts, *(f"{a} of {b}" for a, b in held), wide]
        shown.append(([a / b if b else 1.0 for a, b in reversed(held)], cell))
    shown.sort(key=lambda x: x[0])
    return markdown([*rows, *(row for _, row in shown)])


def summary(cells: dict[str, dict[str, Any]]) -> str:
    """All cells, and of the fits that are called identified."""
    every = [of for found in cells.values() for of in found.values()]
    sure = [found["identified"] for found in cells.values() if "identified" in found]
    said = []
    for name, fits in (("All", every), ("`identified` alone", sure)):
        held = {kind: shares(fits, kind) for kind in KINDS}
        parts = [f"{k} {a / max(b, 1):.1%} of {b}" for k, (a, b) in held.items()]
        said.append(f"{name}, {sum(of['fits'] for of in fits)} fits: {'; '.join(parts)}.")
    return "\n".join(said)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=20)
    parser.add_argument("--runs", type=int, nargs="+", default=[1, 4], choices=SPEEDS)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--more", action="store_true", help="go on from the replicates that are there")
    given = parser.parse_args()
    begin = time.perf_counter()
    # Cells of other numbers of runs stay as they were measured.
    known = load("imperfect")["cells"] if (RESULTS / "imperfect.json").exists() else {}
    cells = {key: found for key, found in known.items() if given.more or int(key.rpartition("|")[2]) not in given.runs}
    own = [found for key, found in cells.items() if int(key.rpartition("|")[2]) in given.runs]
    done = min((sum(of["fits"] for of in found.values()) for found in own), default=0)
    plans = [(w, m, r) for w in WORLDS for m in (MAGNITUDES if w != "none" else (0.0,)) for r in given.runs]
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        for seed in range(done, given.replicates):
            if time.perf_counter() - begin > 60.0 * given.minutes:
                break
            for done in as_completed([pool.submit(one, *plan, seed) for plan in plans]):
                key, found = done.result()
                added(cells.setdefault(key, {}), found)
            strengths = {f"{w}|{m:g}": strength_of(w, m) for w in SINGLE for m in MAGNITUDES}
            save("imperfect", {"cells": dict(sorted(cells.items())), "strengths": strengths})
            print(seed, f"{time.perf_counter() - begin:.0f} s", flush=True)
    put_in_readme("imperfect", f"{table(cells)}\n\n{summary(cells)}", "docs/fits_measured.md")
    print(table(cells), summary(cells), sep="\n\n")


if __name__ == "__main__":
    main()
