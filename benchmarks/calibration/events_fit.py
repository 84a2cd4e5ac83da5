"""Ten bounces calibrated from times, peaks and impulses of their contacts, beside the same records from force samples.

Records are those of ``trap`` (exact law by SciPy, white noise), and of a contact a thousand times as hard; stiffness is free
over three decades. Twice: by ``calibration.fit``, whose search for samples grows with the record; and by its least squares
alone, on all data at once, from starts all over the bounds, where a spiky residual shows.

    python -m benchmarks.calibration.events_fit [--seeds 10] [--minutes 20]
        keeps results/events_fit.json and the tables of docs/fits_measured.md
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np
from scipy.stats import qmc

import bcfj_jax as bj
from benchmarks.calibration import hard_bounces, trap
from benchmarks.common import markdown, put_in_readme, save
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.forward.model import build
from calibration.impacts.trains import observations
from calibration.search.descent import cost_of, levenberg
from calibration.search.evaluate import evaluator

SCENE = bj.scenes.bounce(smoothing=False)
BALL = {"mass": 0.1, "drop_height": 0.1, "gravity": 9.81}
COUNT, NOISES, STARTS, PLAIN = 10, (0.01, 0.001), 12, 64
# Least squares ends near the best where it costs no more than so much above it.
_NEAR = 10.0
RECORDS = {
    "soft": {"stiffness": 1e5, "exponent": 1.5, "damping": 0.05},
    "hard": {"stiffness": 1e8, "exponent": 1.5, "damping": 0.05},
}


def record(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and force [N] of ten contacts, without noise."""
    if name == "soft":
        return trap.record(COUNT, "scipy")
    times, force, _ = hard_bounces.record(RECORDS[name], COUNT)
    # A sample at the end of one piece is that at the begin of the next.
    keep = np.append(np.diff(times) > 0.0, True)
    return times[keep], force[keep]


def problems(name: str, times: np.ndarray, force: np.ndarray, noise: float, seed: int) -> dict[str, Problem]:
    """The same noisy record, as samples and as events."""
    truth, sigma = RECORDS[name], noise * float(force.max())
    values = force + sigma * np.random.default_rng([seed, int(1e6 * noise)]).standard_normal(times.size)
    k = truth["stiffness"]
    free = (Free("stiffness", k / 10**1.5, k * 10**1.5), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 0.5))
    params = {n: float(v) for n, v in SCENE.parameters({**BALL, **truth}).items()}
    seen = observations("contact.normal", times, values, sigma)
    events = Experiment("drop", np.zeros(0), (), features=seen, span=float(times[-1]))
    samples = Experiment("drop", times, (Channel("contact.normal", values, sigma),))
    return {
        "samples": Problem(SCENE, params, (samples,), free, accuracy=trap.ACCURACY),
        "events": Problem(SCENE, params, (events,), free),
    }


def fitted(given: Problem, truth: dict[str, float], seed: int) -> dict[str, Any]:
    """What is kept of a fit: errors and half widths, by logarithms of stiffness and damping."""
    begin, wall = time.process_time(), time.perf_counter()
    found = fit(given, seed=seed, starts=STARTS)
    cpu, wall = time.process_time() - begin, time.perf_counter() - wall
    row: dict[str, Any] = {"verdict": found.verdict, "cpu_s": cpu, "wall_s": wall, "error": {}, "half": {}, "false": {}}
    costs = np.array([s["chi2"] if s["chi2"] is not None else np.inf for s in found.starts])
    row["starts"] = int(np.sum(costs <= costs.min() + _NEAR))
    for name, true in truth.items():
        of = (lambda x: x) if name == "exponent" else np.log
        row["error"][name] = float(of(found.values[name]) - of(true))
        ends = found.parameters[name].ci95
        row["half"][name] = float(0.5 * (of(ends[1]) - of(ends[0]))) if ends else None
        row["false"][name] = bool(not ends[0] <= true <= ends[1]) if ends else None
    return row


def plain(given: Problem, seed: int) -> dict[str, Any]:
    """Least squares on all data at once, from starts all over the bounds: how many end near the best."""
    model = build(given, given.experiments)
    points = qmc.Sobol(3, rng=seed).random(PLAIN)
    evaluate = evaluator(model)
    truth = np.array([[RECORDS[n][a.name] for a in model.coordinates] for n in RECORDS if _is(given, n)])
    best = float(cost_of(evaluate(np.repeat(model.point(truth), 12, axis=0))[0])[0])
    begin, costs = time.process_time(), []
    for block in np.array_split(points, -(-PLAIN // 12)):
        costs.append(levenberg(evaluate, block, 80, 1e-2).costs)
    costs = np.concatenate(costs)
    return {"near": int(np.sum(costs <= best + _NEAR)), "of": PLAIN, "cpu_s": time.process_time() - begin}


def _is(given: Problem, name: str) -> bool:
    return given.params["stiffness"] == RECORDS[name]["stiffness"]


def table(rows: list[dict[str, Any]]) -> str:
    head = ["record", "noise", "data", "fits", "verdicts", "starts that agree", "intervals that exclude the truth"]
    shown = [[*head, "half width K, n, a", "error, rms, K, n, a", "CPU s (median)"]]
    for name in RECORDS:
        for noise in NOISES:
            for data in ("samples", "events"):
                own = [r[data] for r in rows if r["record"] == name and r["noise"] == noise]
                if not own:
                    continue
                words = sorted({r["verdict"] for r in own})
                verdicts = ", ".join(f"{w} {sum(r['verdict'] == w for r in own)}" for w in words)
                ends = [x for r in own for x in r["false"].values() if x is not None]
                half = [
                    np.median([r["half"][n] for r in own if r["half"][n] is not None] or [np.nan])
                    for n in RECORDS[name]
                ]
                rms = [np.sqrt(np.mean([r["error"][n] ** 2 for r in own])) for n in RECORDS[name]]
                starts = f"{sum(r['starts'] for r in own)} of {STARTS * len(own)}"
                cells = (f"{100 * x[0]:.2g} %, {x[1]:.2g}, {100 * x[2]:.2g} %" for x in (half, rms))
                cpu = f"{np.median([r['cpu_s'] for r in own]):.2f}"
                case = [name, f"{noise:.1%}", data, str(len(own)), verdicts, starts, f"{sum(ends)} of {len(ends)}"]
                shown.append([*case, *cells, cpu])
    return markdown(shown)


def plain_table(rows: list[dict[str, Any]]) -> str:
    shown = [["record", "noise", "from samples", "from events"]]
    for r in rows:
        cells = [f"{r[d]['near']} of {r[d]['of']}" for d in ("samples", "events")]
        shown.append([r["record"], f"{r['noise']:.1%}", *cells])
    return markdown(shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=20.0)
    given = parser.parse_args()
    begin, rows, alone, warm = time.perf_counter(), [], [], set()
    records = {name: record(name) for name in RECORDS}
    for noise in NOISES:
        for name, (times, force) in records.items():
            of = problems(name, times, force, noise, 0)
            alone.append({"record": name, "noise": noise, **{data: plain(p, 0) for data, p in of.items()}})
            print(alone[-1], flush=True)
    for seed in range(given.seeds):
        for noise in NOISES:
            for name, (times, force) in records.items():
                if time.perf_counter() - begin > 60.0 * given.minutes:
                    break
                row: dict[str, Any] = {"record": name, "noise": noise, "seed": seed}
                for data, p in problems(name, times, force, noise, seed).items():
                    if (name, data) not in warm:  # Programs are compiled once.
                        fit(p, seed=seed, starts=STARTS)
                        warm.add((name, data))
                    row[data] = fitted(p, RECORDS[name], seed)
                rows.append(row)
                print(
                    name,
                    noise,
                    seed,
                    {d: (row[d]["verdict"], row[d]["cpu_s"], row[d]["error"]) for d in ("samples", "events")},
                    flush=True,
                )
                save("events_fit", {"records": rows, "least_squares": alone, "starts": STARTS})
    alone_text = f"Least squares alone, all data at once, {PLAIN} starts over the bounds; near the best:"
    text = f"{table(rows)}\n\n{alone_text}\n\n{plain_table(alone)}"
    put_in_readme("events-fit", text, "docs/fits_measured.md")
    print(text)


if __name__ == "__main__":
    main()
