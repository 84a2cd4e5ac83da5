"""Records of imperfect worlds: does the interval to quote hold the truth, and how wide is it?

A single impact by SciPy from the exact law, or with one imperfection of the sensor, of the contact, of what was held fixed or
of the recorder, in three magnitudes: its largest effect on the force is 0.3, 2 and 10 deviations of the noise. "mixture" is
two of them at once, another pair for every seed. One run, or four or eight at different speeds. Priors were chosen on worlds
of ``SINGLE`` and their mixtures; ``OTHER`` and ``NOISES`` judge them. Widths are beside those of the former budget (every
error at once), and of an oracle that knows which error acts and how large it is.

    python -m benchmarks.calibration.imperfect [--replicates 20] [--runs 1 4 8] [--minutes 30] [--more] [--first 0]

keeps results/imperfect.json; ``--more`` goes on from the replicates that it holds.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Collection
from concurrent.futures import as_completed
from functools import cache
from typing import Any
from zlib import crc32

import numpy as np
from scipy.integrate import solve_ivp
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

import bcfj_jax as bj
import benchmarks.common as harness
from benchmarks.clock import pool, until
from benchmarks.common import Some, known, options, publish, save, told
from calibration import Channel, Experiment, Fit, Free, Problem, fit
from calibration.uncertainty.estimates import placed

SCENE = bj.scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
MASS, NOISE, SAMPLES, STARTS = 0.1, 5e-3, 160, 6
SPEEDS = {1: (1.0,), 4: (0.7, 0.9, 1.1, 1.3), 8: tuple(np.linspace(0.6, 1.4, 8).tolist())}
MAGNITUDES = (0.3, 2.0, 10.0)


def duration(speed: float) -> float:
    """About that of a contact without damping [s]."""
    k, n, _ = TRUTH.values()
    return 3.0 * (MASS * speed**2 * (n + 1.0) / (2.0 * k)) ** (1.0 / (n + 1.0)) / speed


# One sensor and one contact in all runs: their times and forces are shares of those of a contact at 1 m/s.
SPAN = 1.5 * duration(1.0)


@cache
def motion(
    speed: float,
    relaxation: float = 0.0,
    stop: float = 0.0,
    mass: float = MASS,
    faster: float = 0.0,
    bend: float = 0.0,
    loss: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and forces [N] of the exact law.

    Args:
        speed: of the approach [m/s], by what the record says; it is ``1 + faster`` times that.
        relaxation: share of the force that a Maxwell branch adds.
        stop: stiffness of a second contact behind 0.6 of the depth, as a share of the mean stiffness of the first.
        mass: [kg].
        bend: share by which the elastic force waves about a power of the depth.
        loss: share of the elastic force that a loss with the power 1/4 of the rate adds.
    """  # fmt: skip
    k, n, a = TRUTH.values()
    tau, behind, second = 0.3 * duration(1.0), 0.6 * 0.00021, stop * k * 0.00021 ** (n - 1.0)

    def elastic(d: Any, rate: Any) -> Any:
        depth = np.maximum(d, 0.0) / 0.00021
        wave = 1.0 + bend * (0.6 * np.sin(2.0 * depth) + 0.5 * np.cos(3.0 * depth) + 0.3 * np.sin(5.0 * depth + 1.0))
        lost = loss * rate / (rate**2 + 1e-4) ** 0.375
        layer = k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * rate + lost, 0.0) * wave
        return layer + second * np.maximum(d - behind, 0.0)

    def change(_: float, s: np.ndarray) -> list[float]:
        force = elastic(s[0], s[1])
        # The branch's elastic part follows the elastic force and forgets it with the time tau.
        stress = k * n * max(s[0], 0.0) ** (n - 1.0) * s[1] if s[0] > 0.0 else 0.0
        return [s[1], -(force + relaxation * s[2]) / mass, stress - s[2] / tau]

    times = np.linspace(0.0, 1.5 * duration(speed), SAMPLES)
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
    "gain bend": lambda t, f, s: f * (1.0 + s * f / motion(1.0)[1].max()),
    "lag": lambda t, f, s: lagged(t, f, s * 0.2 * SPAN),
    "drift": lambda t, f, s: f + s * f.max() * t / t[-1],
    "hum": lambda t, f, s: f + s * f.max() * np.sin(2.0 * np.pi * 1.7 * t / t[-1] + 1.0),
    "clock": lambda t, f, s: np.interp(t + 0.02 * s * t[-1] * np.sin(9.0 * t / t[-1]), t, f),
    "resonance": lambda t, f, s: resonant(t, f, 2.0 * np.pi * 4.0 / (max(s, 1e-3) ** 0.5 * SPAN)),
}
# What it makes of the motion itself.
CONTACT: dict[str, Callable[[float], dict[str, float]]] = {
    "relaxation": lambda s: {"relaxation": s},
    "second contact": lambda s: {"stop": s},
    "mass": lambda s: {"mass": MASS * (1.0 + s)},
    "speed": lambda s: {"faster": s},
}
SINGLE = (*SENSOR, *CONTACT)
# Worlds that no prior was chosen on: of the sensor, of the law, of the recorder (after the noise), and noise of another kind.
SENSOR |= {"zero phase": lambda t, f, s: gaussian_filter1d(f, 0.05 * s * f.size * SPAN / t[-1], mode="nearest")}
CONTACT |= {"smooth law": lambda s: {"bend": s}, "speed loss": lambda s: {"loss": s}}
RECORDER: dict[str, Callable[[np.ndarray, float, float], np.ndarray]] = {
    "quantised": lambda f, peak, s: np.round(f / (s * peak)) * s * peak,
    "saturated": lambda f, peak, s: np.minimum(f, (1.0 - min(s, 0.9)) * peak),
}
# Of intervals.
KINDS = ("noise", "quoted", "force")
NOISES = ("AR(1) noise", "proportional noise")
OTHER = ("zero phase", "smooth law", "speed loss", *RECORDER)
WORLDS = ("none", *SINGLE, "mixture", *OTHER, *NOISES)


def read(worlds: dict[str, float], speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and what the sensor reads with imperfections of given strengths."""
    changes = {key: v for w, strength in worlds.items() if w in CONTACT for key, v in CONTACT[w](strength).items()}
    times, force = motion(speed, **changes)
    for world, strength in worlds.items():
        force = SENSOR[world](times, force, strength) if world in SENSOR else force
    return times, force


def recorded(worlds: dict[str, float], force: np.ndarray, peak: float) -> np.ndarray:
    """What the recorder keeps of readings with their noise; ``peak`` is that of the fastest run."""
    for world, strength in worlds.items():
        force = RECORDER[world](force, peak, strength) if world in RECORDER else force
    return force


def scattered(worlds: Collection[str], force: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise of a mean variance of 1: white, with a memory of 0.6 a sample, or as large as the force (a fifth of it at rest)."""
    white = rng.standard_normal(force.size)
    if "AR(1) noise" in worlds:
        return lfilter([0.8], [1.0, -0.6], white, zi=[0.6 * rng.standard_normal()])[0]
    if "proportional noise" in worlds:
        size = 0.2 + np.abs(force) / np.abs(force).max()
        return white * size / np.sqrt(np.mean(size**2))
    return white


@cache
def strength_of(world: str, deviations: float) -> float:
    """The strength whose largest effect is so many deviations of the noise, by bisection."""
    _, plain = motion(1.0)
    target, low, high = deviations * NOISE * plain.max(), 1e-6, 1.0
    for _ in range(18):
        middle = np.sqrt(low * high)
        changed = recorded({world: middle}, read({world: middle}, 1.0)[1], float(plain.max()))
        effect = np.abs(changed - plain).max()
        low, high = (middle, high) if effect < target else (low, middle)
    return float(np.sqrt(low * high))


def imperfections(world: str, deviations: float, seed: int) -> dict[str, float]:
    """Imperfections and their strengths: none, one, or two that the seed draws."""
    rng = np.random.default_rng([seed, 77])
    names = rng.choice(SINGLE, 2, replace=False).tolist() if world == "mixture" else [world] if world != "none" else []
    return {name: 1.0 if name in NOISES else strength_of(name, deviations) for name in names}


def problem(worlds: dict[str, float], runs: int, seed: int) -> Problem:
    # Noise of its own: were it the same in every cell, a seed were one draw, whatever the number of cells.
    own = crc32(", ".join(f"{name} {strength:.2g}" for name, strength in worlds.items()).encode())
    rng, experiments = np.random.default_rng([seed, runs, own]), []
    # One sensor, whose noise is that of a share of the peak at 1 m/s.
    sigma = NOISE * float(motion(1.0)[1].max())
    for k, speed in enumerate(SPEEDS[runs]):
        times, force = read(worlds, speed)
        values = recorded(
            worlds, force + sigma * scattered(worlds, force, rng), float(motion(max(SPEEDS[runs]))[1].max())
        )
        channel = Channel("contact.normal", values, None)
        experiments.append(Experiment(f"run {k + 1}", times, (channel,), fixed={"approach_speed": speed}))
    params = {k: float(v) for k, v in SCENE.parameters({"mass": MASS, "approach_speed": 1.0, **TRUTH}).items()}
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, tuple(experiments), free)


def judged(found: Fit, worlds: dict[str, float], runs: int) -> dict[str, Any]:
    """By kind, how many intervals are given and hold the truth; widths beside the noise's (median), and the oracle's."""
    held: dict[str, list[int]] = {kind: [0, 0] for kind in KINDS}
    best, over, widths, off = oracle(found, worlds, runs), [], {}, {}

    def count(kind: str, ends: tuple[float, float] | None, true: float) -> None:
        if ends is not None:
            held[kind] = [held[kind][0] + 1, held[kind][1] + int(ends[0] <= true <= ends[1])]

    for k, (axis, (name, p)) in enumerate(zip(found.optimum.model.coordinates, found.parameters.items(), strict=True)):
        noise = p.intervals.get("noise")
        count("noise", noise, TRUTH[name])
        count("quoted", p.ci95, TRUTH[name])
        if p.ci95 and noise:
            over.append(_width(p.ci95, axis.log) / _width(noise, axis.log))
            for kind, value in (("value", p.value), ("least squares", p.least_squares)):
                error = _width((TRUTH[name], value), axis.log) / _width(noise, axis.log)
                off.setdefault(kind, []).append(float(f"{error:.3g}"))
        if p.ci95 and best is not None:
            widths[name] = float(f"{_width(p.ci95, axis.log) / best[k]:.3g}")
    if force := found.reference:
        count("force", force.ci95, TRUTH["stiffness"] * force.penetration ** TRUTH["exponent"])
    quoted = {"quoted": float(f"{np.median(over):.3g}")} if over else {}
    return {"verdict": found.verdict, **held, "widths": quoted, "oracle": widths, "off": off}


def oracle(found: Fit, worlds: dict[str, float], runs: int) -> np.ndarray | None:
    """Widths (P,) of 95 % about the optimum by one that knows which errors act, with their sizes as deviations."""
    if not all(w in SENSOR or w in CONTACT for w in worlds):
        return None
    end, sigma = found.optimum.end, NOISE * float(motion(1.0)[1].max())
    columns = [
        np.concatenate([(read({w: x}, v)[1] - motion(v)[1]) / sigma for v in SPEEDS[runs]]) for w, x in worlds.items()
    ]
    design = np.column_stack([end.jacobian[: sum(SAMPLES for _ in SPEEDS[runs])] * _deviations(found), *columns])
    precision = design.T @ design
    count = end.jacobian.shape[1]
    precision[count:, count:] += np.eye(len(columns))
    slopes = placed(found.optimum.model, end)[1]
    covariance = slopes @ np.linalg.inv(precision)[:count, :count] @ slopes.T
    return 2.0 * 1.959964 * np.sqrt(np.diag(covariance))


def _deviations(found: Fit) -> float:
    """The deviation that the fit took over the true one, by which its Jacobian is too small."""
    return found.noise["contact.normal"]["sigma"] / (NOISE * float(motion(1.0)[1].max()))


def _width(ends: tuple[float, float], log: bool) -> float:
    return float(np.log(ends[1] / ends[0]) if log else ends[1] - ends[0])


def one(world: str, deviations: float, runs: int, seed: int) -> tuple[str, dict[str, Any]]:
    """A fit of one record set, judged, and the cell that it belongs to."""
    worlds = imperfections(world, deviations, seed)
    found = fit(problem(worlds, runs, seed), seed=seed, starts=STARTS)
    return f"{world}|{deviations:g}|{runs}", judged(found, worlds, runs)


def added(cell: dict[str, dict[str, Any]], found: dict[str, Any]) -> None:
    """Count one fit in its cell, whose keys are verdicts."""
    kept = cell.setdefault(
        found["verdict"], {"fits": 0, **{k: [0, 0] for k in KINDS}, "widths": {}, "oracle": {}, "off": {}}
    )
    kept["fits"] += 1
    for kind in KINDS:
        kept[kind] = [a + b for a, b in zip(kept[kind], found[kind], strict=True)]
    for table in ("widths", "oracle", "off"):
        for kind, width in found[table].items():
            kept.setdefault(table, {}).setdefault(kind, []).extend(np.atleast_1d(width).tolist())


def shares(found: list[dict[str, Any]], kind: str) -> tuple[int, int]:
    """How many intervals of a kind hold the truth, and how many are given."""
    return sum(f[kind][1] for f in found), sum(f[kind][0] for f in found)


def every(found: list[dict[str, Any]], table: str, kind: str) -> list[float]:
    """All widths of a kind."""
    return [w for of in found for w in of.get(table, {}).get(kind, [])]


def table(cells: dict[str, dict[str, Any]], former: dict[str, float]) -> str:
    """A row a cell in which less than 95 % of the intervals to quote hold, the worst first."""
    shown = []
    for key, found in cells.items():
        world, magnitude, runs = key.split("|")
        held = {kind: shares(list(found.values()), kind) for kind in KINDS}
        width = float(np.median(every(list(found.values()), "widths", "quoted") or [np.nan]))
        shown.append({
            "world": world, "magnitude": magnitude, "runs": runs, "width": width,
            "verdicts": told({word: of["fits"] for word, of in sorted(found.items())}),
            "former": f"{width / former[key]:.2f}" if key in former else "",
            "share": held["quoted"][0] / max(held["quoted"][1], 1), **{kind: f"{a} of {b}" for kind, (a, b) in held.items()},
        })  # fmt: skip
    return harness.table({
        "imperfection": "{world}", "effect / noise": "{magnitude}", "runs": "{runs}", "verdicts": "{verdicts}",
        "noise holds": "{noise}", "quoted holds": "{quoted}", "force holds": "{force}",
        "width beside the noise's": "{width:.2g}", "over the former budget's": "{former}",
    }, sorted((row for row in shown if row["share"] < 0.95), key=lambda row: row["share"]))  # fmt: skip


def summary(cells: dict[str, dict[str, Any]], former: dict[str, float]) -> str:
    """By number of runs: worlds that priors were chosen on, and the others."""
    rows = []
    for (name, new), runs in itertools.product((("chosen on", False), ("judged on", True)), SPEEDS):
        own = {
            k: list(v.values()) for k, v in cells.items()
            if int(k.rpartition("|")[2]) == runs and (k.split("|")[0] in (*OTHER, *NOISES)) == new
        }  # fmt: skip
        fits = [of for found in own.values() for of in found]
        if not fits:
            continue
        low = sum(shares(v, "quoted")[0] < 0.88 * shares(v, "quoted")[1] for v in own.values())
        wide = {k: every(v, "widths", "quoted") for k, v in own.items() if k in former}
        ratios = [np.median(w) / former[k] for k, w in wide.items() if w]
        over = {parameter: every(fits, "oracle", parameter) for parameter in TRUTH}
        off, least = (
            np.sqrt(np.mean(np.square(every(fits, "off", kind) or [np.nan]))) for kind in ("value", "least squares")
        )
        rows.append({
            "worlds": name, "runs": runs, "fits": sum(of["fits"] for of in fits), "low": f"{low} of {len(own)}",
            "ratio": f"{np.median(ratios):.2f}" if ratios else "", "off": f"{off / least:.2f}",
            **{kind: f"{a / max(b, 1):.1%} of {b}" for kind, (a, b) in ((kind, shares(fits, kind)) for kind in KINDS)},
            **{parameter: f"{np.median(w):.2f}" if w else "" for parameter, w in over.items()},
        })  # fmt: skip
    return harness.table({
        "worlds": "{worlds}", "runs": "{runs}", "fits": "{fits}", "noise holds": "{noise}", "quoted holds": "{quoted}",
        "force holds": "{force}", "cells below .88": "{low}", "width over the former budget's": "{ratio}",
        "over an oracle's: damping": "{damping}", "stiffness": "{stiffness}", "exponent": "{exponent}",
        "error of the value over least squares' (rms)": "{off}",
    }, rows)  # fmt: skip


def main() -> None:
    given = options(
        __doc__, replicates=20, runs=Some([1, 4]), minutes=30.0, workers=os.cpu_count() or 1,
        more=(False, "go on from the replicates that are there"), first=(0, "seed of the first replicate"),
    )  # fmt: skip
    begin = time.perf_counter()
    # Cells of other numbers of runs stay as they were measured.
    kept = known("imperfect")
    # What goes on does so from the seeds that are there.
    first = kept.get("first", 0) if given.more else given.first
    former, of = kept.get("former", {}), lambda key: int(key.rpartition("|")[2]) in given.runs
    cells = {key: found for key, found in kept.get("cells", {}).items() if given.more or not of(key)}
    done = min((sum(v["fits"] for v in found.values()) for key, found in cells.items() if of(key)), default=0)
    plans = [(w, m, r) for w in WORLDS for m in ((0.0,) if w in ("none", *NOISES) else MAGNITUDES) for r in given.runs]
    with pool(given.workers) as processes:
        for seed in until(given.minutes, range(first + done, first + given.replicates)):
            for job in as_completed([processes.submit(one, *plan, seed) for plan in plans]):
                key, found = job.result()
                added(cells.setdefault(key, {}), found)
            strengths = {f"{w}|{m:g}": strength_of(w, m) for w, m in itertools.product((*SINGLE, *OTHER), MAGNITUDES)}
            save(
                "imperfect",
                {"cells": dict(sorted(cells.items())), "strengths": strengths, "former": former, "first": first},
            )
            print(seed, f"{time.perf_counter() - begin:.0f} s", flush=True)
    missed = "Cells in which less than 95 % of the intervals to quote hold:"
    publish("imperfect", f"{summary(cells, former)}\n\n{missed}\n\n{table(cells, former)}", "docs/fits_measured.md")


if __name__ == "__main__":
    main()
