"""The trap test: a bouncing mass, 1 to 30 contacts, stiffness from three decades. Is a verdict confidently wrong?

Records are made by our own integrator (tight) and by SciPy from the exact law: flights are parabolas in closed form,
contacts are DOP853 to 1e-12 up to the event that ends them. The fit integrates at its own, looser accuracy.

python benchmarks/trap.py [SEEDS] [--workers N] [--peer SEEDS]    writes results/trap.json, prints a table
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import numpy as np
from _common import ROOT, markdown, save
from scipy.integrate import solve_ivp

from bcfj_jax import scenes, simulate
from calibration import Channel, Experiment, Free, Problem, fit

# A 0.1 kg rubber-like ball dropped from 0.1 m: 43 N, 5.7 mm deep, 12 ms of contact, 5 % of its speed lost.
TRUTH = {"stiffness": 1e5, "exponent": 1.5, "damping": 0.05}
MASS, HEIGHT, GRAVITY = 0.1, 0.1, 9.81
SCENE = scenes.bounce(smoothing=False)
FREE = (Free("stiffness", 10**3.5, 10**6.5), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 0.5))
CONTACTS, NOISES, SOURCES = (1, 2, 10, 30), (0.0, 0.01), ("own", "scipy")
# Samples [s]: close from a little before each contact to a little after it, coarse in flight. A single contact must be
# read so closely for its exponent to be known to 2 % at all.
STEPS, MARGIN, COARSE = {1: 1e-4, 2: 1e-4, 10: 5e-4, 30: 5e-4}, 4e-3, 4e-3
STARTS, CLOSE = 12, 0.02
# Of the fit's integration. Errors add up from contact to contact: at 1e-5 the forces of the tenth are wrong by 4e-4 of
# the peak, which moves chi2 by 0.6, at 1e-7 by 6e-6 and 0.007, for twice the steps.
ACCURACY = 1e-7


class Contact(NamedTuple):
    """Begin and end [s], and the force [N] as a function of time between them."""

    begin: float
    end: float
    force: Any


def exact(count: int) -> list[Contact]:
    """The first contacts of the exact law K d^n (1 + a d'), nothing smoothed, by SciPy with an event at their end."""
    k, n, a = TRUTH.values()

    def force(d, rate):
        return k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * rate, 0.0)

    def motion(_, s):
        return s[1], GRAVITY - force(s[0], s[1]) / MASS

    def apart(_, s):
        return s[0] - 1e-15

    apart.terminal, apart.direction = True, -1
    begin, speed, found = np.sqrt(2.0 * HEIGHT / GRAVITY), np.sqrt(2.0 * GRAVITY * HEIGHT), []
    for _ in range(count):
        run = solve_ivp(
            motion, (0.0, 1.0), (1e-14, speed), "DOP853", rtol=1e-12, atol=1e-15, events=apart, dense_output=True
        )
        end = float(run.t_events[0][0])
        found.append(Contact(begin, begin + end, lambda t, run=run, begin=begin: force(*run.sol(t - begin))))
        speed = -float(run.y_events[0][0][1])
        begin += end + 2.0 * speed / GRAVITY
    return found


def record(count: int, source: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and force [N] of so many contacts, without noise."""
    found = exact(count)
    grid, last = [np.zeros(1)], 0.0
    for c in found:
        grid.append(np.arange(last + COARSE, c.begin - MARGIN, COARSE))
        grid.append(np.arange(c.begin - MARGIN, c.end + MARGIN, STEPS[count]))
        last = grid[-1][-1]
    times = np.concatenate(grid)
    if source == "own":
        params = SCENE.parameters({"mass": MASS, "drop_height": HEIGHT, "gravity": GRAVITY, **TRUTH})
        return times, simulate(SCENE, params, times, accuracy=1e-8).force["contact"][:, 0]
    force = np.zeros(times.size)
    for c in found:
        inside = (times >= c.begin) & (times <= c.end)
        force[inside] = c.force(times[inside])
    return times, force


def problem(times: np.ndarray, force: np.ndarray, noise: float, seed: int) -> Problem:
    """The record with noise of that share of its peak, stated; of a clean one it is to be estimated."""
    sigma = noise * float(force.max())
    values = force + sigma * np.random.default_rng([seed, times.size]).standard_normal(times.size)
    params = {k: float(v) for k, v in SCENE.parameters(mass=MASS, drop_height=HEIGHT, gravity=GRAVITY).items()}
    experiment = Experiment("drop", times, (Channel("contact.normal", values, sigma or None),))
    return Problem(SCENE, {**params, **TRUTH}, (experiment,), FREE, accuracy=ACCURACY)


def one(found: Any, seconds: float) -> dict[str, Any]:
    """What is kept of a fit: errors relative to the truth, intervals printed and how many exclude it."""
    error = {name: found.parameters[name].value / true - 1.0 for name, true in TRUTH.items()}
    intervals = [(found.parameters[name].ci95, true) for name, true in TRUTH.items()]
    if found.reference:
        true = TRUTH["stiffness"] * found.reference.penetration ** TRUTH["exponent"]
        error["reference_force"] = found.reference.force / true - 1.0
        intervals.append((found.reference.ci95, true))
    printed = [(ends, true) for ends, true in intervals if ends]
    excluding = sum(not ends[0] <= true <= ends[1] for ends, true in printed)
    return {
        "verdict": found.verdict, "reasons": found.reasons, "error": error, "printed": len(printed),
        "excluding": excluding, "seconds": seconds,
    }  # fmt: skip


def fits(task: tuple[str, int, float, range]) -> list[dict[str, Any]]:
    """All seeds of one case's part, in this process."""
    source, contacts, noise, seeds = task
    jax.config.update("jax_compilation_cache_dir", str(ROOT / "build" / "jax-cache"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    times, force = record(contacts, source)
    rows = []
    for seed in seeds:
        begin = time.process_time()
        found = fit(problem(times, force, noise, seed), seed=seed, starts=STARTS)
        rows.append(one(found, time.process_time() - begin))
    return rows


def summary(source: str, contacts: int, noise: float, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A case: share recovered, verdicts, intervals.

    Recovered is the force law: reference force and exponent within 2 %. Shares of each parameter stand beside it.
    """
    within = {
        name: float(np.mean([abs(r["error"].get(name, np.inf)) <= CLOSE for r in rows]))
        for name in ("stiffness", "exponent", "damping", "reference_force")
    }
    both = [max(abs(r["error"].get(name, np.inf)) for name in ("exponent", "reference_force")) <= CLOSE for r in rows]
    verdicts = [r["verdict"] for r in rows]
    reasons = [reason for r in rows for reason in r["reasons"]]
    return {
        "source": source, "contacts": contacts, "noise": noise, "seeds": len(rows), "recovered": float(np.mean(both)),
        "within_2_percent": within, "verdicts": {v: verdicts.count(v) for v in sorted(set(verdicts))},
        "reasons": {r: reasons.count(r) for r in sorted(set(reasons), key=reasons.count)[-5:]},
        "printed": sum(r["printed"] for r in rows), "excluding": sum(r["excluding"] for r in rows),
        "rms_error": {n: float(np.sqrt(np.mean([r["error"][n] ** 2 for r in rows]))) for n in rows[0]["error"]},
        "median_cpu_s": float(np.median([r["seconds"] for r in rows])),
    }  # fmt: skip


def table(cases: list[dict[str, Any]]) -> str:
    """The cases as Markdown."""
    rows = [["record by", "contacts", "noise", "recovered within 2 %", "verdicts", "intervals that exclude the truth"]]
    for c in cases:
        verdicts = ", ".join(f"{v} {n}" for v, n in c["verdicts"].items())
        share = f"{c['excluding']} of {c['printed']}"
        rows.append([c["source"], str(c["contacts"]), f"{c['noise']:.0%}", f"{c['recovered']:.1%}", verdicts, share])
    return markdown(rows)


def main() -> None:
    """Run all cases, and the peer if asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--contacts", type=int, nargs="*", choices=CONTACTS, default=CONTACTS)
    parser.add_argument("--peer", type=int, default=0, help="seeds for mujoco.sysid on equivalent records")
    given = parser.parse_args()
    cases = [(source, contacts, noise) for source in SOURCES for contacts in given.contacts for noise in NOISES]
    size = max(1, -(-given.seeds // (2 * given.workers)))
    blocks = [range(k, min(k + size, given.seeds)) for k in range(0, given.seeds, size)]
    tasks: list[tuple[str, int, float, range]] = [(*case, block) for case in cases for block in blocks]
    done: dict[tuple, list] = {case: [] for case in cases}
    begin, summaries = time.perf_counter(), []
    with ProcessPoolExecutor(given.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for task, rows in zip(tasks, pool.map(fits, tasks), strict=True):
            done[task[:3]] += rows
            if len(done[task[:3]]) == given.seeds:
                source, contacts, noise, _ = task
                summaries.append(summary(source, contacts, noise, done[task[:3]]))
                print(summaries[-1], flush=True)
    printed, excluding = (sum(c[key] for c in summaries) for key in ("printed", "excluding"))
    result: dict[str, Any] = {
        "truth": TRUTH, "starts": STARTS, "stiffness_bounds": [FREE[0].lower, FREE[0].upper], "cases": summaries,
        "printed": printed, "excluding": excluding, "excluding_share": excluding / max(printed, 1),
        "wall_s": time.perf_counter() - begin,
    }  # fmt: skip
    if given.peer:
        from trap_mujoco import peer

        result["mujoco_sysid"] = peer(given.peer)
    save("trap", result)
    print(table(summaries))
    print(f"\n{excluding} of {printed} printed intervals exclude the truth.")


if __name__ == "__main__":
    main()
