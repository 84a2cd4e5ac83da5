"""Ten bounces calibrated from times, peaks and impulses of their contacts, beside the same records from force samples.

Records are those of ``trap`` (exact law by SciPy, white noise), and of a contact a thousand times as hard; stiffness is free
over three decades. Twice: by ``calibration.fit``, whose search for samples grows with the record; and by its least squares
alone, on all data at once, from starts all over the bounds, where a spiky residual shows.

    python -m benchmarks.calibration.events_fit [--seeds 10] [--minutes 20]
        keeps results/events_fit.json and the tables of docs/fits_measured.md
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from scipy.stats import qmc

import bcfj_jax as bj
import benchmarks.common as harness
from benchmarks.calibration import hard_bounces, trap
from benchmarks.clock import clocked, until
from benchmarks.common import options, publish, save, tally, told
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
    found, took = clocked(lambda: fit(given, seed=seed, starts=STARTS))
    row: dict[str, Any] = {"verdict": found.verdict, **took, "error": {}, "half": {}, "false": {}}
    costs = np.array([s["chi2"] if s["chi2"] is not None else np.inf for s in found.starts])
    row["starts"] = int(np.sum(costs <= costs.min() + _NEAR))
    for name, true in truth.items():
        of = (lambda x: x) if name == "exponent" else np.log
        row["error"][name] = float(of(found.values[name]) - of(true))
        ends = found.parameters[name].ci95
        row["half"][name] = float(0.5 * (of(ends[1]) - of(ends[0]))) if ends else None
        row["false"][name] = bool(not ends[0] <= true <= ends[1]) if ends else None
    return row


def plain(given: Problem, record: str, seed: int) -> dict[str, Any]:
    """Least squares on all data at once, from starts all over the bounds: how many end near the best."""
    model = build(given, given.experiments)
    points = qmc.Sobol(3, rng=seed).random(PLAIN)
    evaluate = evaluator(model)
    truth = np.array([[RECORDS[record][a.name] for a in model.coordinates]])
    best = float(cost_of(evaluate(np.repeat(model.point(truth), 12, axis=0))[0])[0])
    blocks = np.array_split(points, -(-PLAIN // 12))
    costs, took = clocked(lambda: np.concatenate([levenberg(evaluate, block, 80, 1e-2).costs for block in blocks]))
    return {"near": int(np.sum(costs <= best + _NEAR)), "of": PLAIN, "cpu_s": took["cpu_s"]}


def table(rows: list[dict[str, Any]]) -> str:
    shown = []
    for name, noise, data in itertools.product(RECORDS, NOISES, ("samples", "events")):
        own = [r[data] for r in rows if r["record"] == name and r["noise"] == noise]
        if not own:
            continue
        ends = [x for r in own for x in r["false"].values() if x is not None]
        half = [np.median([r["half"][n] for r in own if r["half"][n] is not None] or [np.nan]) for n in RECORDS[name]]
        rms = [np.sqrt(np.mean([r["error"][n] ** 2 for r in own])) for n in RECORDS[name]]
        shown.append({
            "record": name, "noise": noise, "data": data, "fits": len(own), "verdicts": told(tally(r["verdict"] for r in own)),
            "starts": f"{sum(r['starts'] for r in own)} of {STARTS * len(own)}", "false": f"{sum(ends)} of {len(ends)}",
            "half": half, "rms": rms, "cpu": np.median([r["cpu_s"] for r in own]),
        })  # fmt: skip
    errors = {"half width K, n, a": "half", "error, rms, K, n, a": "rms"}
    return harness.table({
        "record": "{record}", "noise": "{noise:.1%}", "data": "{data}", "fits": "{fits}", "verdicts": "{verdicts}",
        "starts that agree": "{starts}", "intervals that exclude the truth": "{false}",
        **{
            head: lambda r, k=key: f"{100 * r[k][0]:.2g} %, {r[k][1]:.2g}, {100 * r[k][2]:.2g} %" for head, key in errors.items()
        },
        "CPU s (median)": "{cpu:.2f}",
    }, shown)  # fmt: skip


def plain_table(rows: list[dict[str, Any]]) -> str:
    cells = {f"from {data}": f"{{{data}[near]}} of {{{data}[of]}}" for data in ("samples", "events")}
    return harness.table({"record": "{record}", "noise": "{noise:.1%}", **cells}, rows)


def main() -> None:
    given = options(__doc__, seeds=10, minutes=20.0)
    rows, alone, warm = [], [], set()
    records = {name: record(name) for name in RECORDS}
    for noise, (name, (times, force)) in itertools.product(NOISES, records.items()):
        of = problems(name, times, force, noise, 0)
        alone.append({"record": name, "noise": noise, **{data: plain(p, name, 0) for data, p in of.items()}})
        print(alone[-1], flush=True)
    todo = itertools.product(range(given.seeds), NOISES, records.items())
    for seed, noise, (name, (times, force)) in until(given.minutes, todo):
        row: dict[str, Any] = {"record": name, "noise": noise, "seed": seed}
        for data, p in problems(name, times, force, noise, seed).items():
            if (name, data) not in warm:  # Programs are compiled once.
                fit(p, seed=seed, starts=STARTS)
                warm.add((name, data))
            row[data] = fitted(p, RECORDS[name], seed)
        rows.append(row)
        print(row, flush=True)
        save("events_fit", {"records": rows, "least_squares": alone, "starts": STARTS})
    alone_text = f"Least squares alone, all data at once, {PLAIN} starts over the bounds; near the best:"
    text = f"{table(rows)}\n\n{alone_text}\n\n{plain_table(alone)}"
    publish("events-fit", text, "docs/fits_measured.md")


if __name__ == "__main__":
    main()
