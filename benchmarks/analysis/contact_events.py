"""Trains of impacts: derivatives of when each contact begins, peaks and ends, of its peak and its impulse, and their price.

A ball bounces 10 and 30 times on K d^n (1 + a d'). The reference is a closed form where there is one (n = 1, a = 0), else
variational equations by SciPy at 1e-12 (``references.bounce_events``, which the closed form confirms to 1e-9). Errors are
relative to the derivative itself, or to 0.01 % of the number per 1 % of the parameter where it is smaller (the least that a
certificate counts). Beside it: the begins' derivatives from samples of the same level, as ``bj.sensitivity`` has periods.

    python -m benchmarks.analysis.contact_events    keeps results/contact_events.json and the tables of docs/derivatives.md
"""

from __future__ import annotations

import os
import time
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis import features
from bcfj_jax.analysis.derivatives.contact_events import TIGHTER, solved_at
from bcfj_jax.analysis.derivatives.jacobian import level
from bcfj_jax.analysis.derivatives.measures import _start_slope
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.core.programs import program
from bcfj_jax.solve.plan import plan
from benchmarks.common import markdown, put_in_readme, save
from benchmarks.references.bounce_events import KINDS, NAMES, closed, integrated

SCENE = bj.scenes.bounce(smoothing=False)
BALL = {"mass": 0.1, "gravity": 9.81, "drop_height": 0.05}
CASES = {
    "n = 1, undamped": {"stiffness": 1e5, "exponent": 1.0, "damping": 0.0},
    "n = 1.5, damped": {"stiffness": 1e5, "exponent": 1.5, "damping": 0.05},
    "n = 1.5, damped, hard": {"stiffness": 1e8, "exponent": 1.5, "damping": 0.05},
}
COUNTS, LEAST, REPEATS = (10, 30), 0.01, 7
TITLES = {"peak_time": "time of peak"}


def errors(
    found: Any, exact: dict[str, tuple[np.ndarray, np.ndarray]], p: dict[str, float], wrt: tuple[str, ...]
) -> dict:
    """Largest relative error of the derivatives of each kind, over contacts and parameters."""
    column, worst = [NAMES.index(n) for n in wrt], {}
    for kind in KINDS:
        value, slope = exact[kind]
        own = np.stack([getattr(found.derivative[n], kind)[: value.size] for n in wrt], axis=1)
        least = LEAST * np.abs(value)[:, None] / np.array([p[n] for n in wrt])
        worst[kind] = float(np.max(np.abs(own - slope[:, column]) / np.maximum(np.abs(slope[:, column]), least)))
    return worst


def from_samples(params: dict, end: float, wrt: tuple[str, ...], exact: Any, p: dict[str, float]) -> float:
    """The same of begins, by roots of the samples' cubics, at the level's tolerance by steps that end anywhere."""
    times = np.linspace(0.0, end, SCENE.samples)
    found = level(SCENE, params, times, wrt, plan(SCENE, "balanced"))
    depth, rate = found.value.penetration[:, 0], found.value.rate[:, 0]
    starts = [begin for begin, _ in features.contact_times(times, depth, rate)]
    by = [found.derivative.penetration[:, :, 0], found.derivative.rate[:, :, 0]]
    own = np.array([_start_slope(times, depth, rate, by[0], by[1], at) for at in starts])
    value, slope = exact["begin"]
    slope, many = slope[:, [NAMES.index(n) for n in wrt]], min(value.size, len(own))
    least = LEAST * np.abs(value)[:many, None] / np.array([p[n] for n in wrt])
    off = np.abs(own[:many] - slope[:many]) / np.maximum(np.abs(slope[:many]), least)
    # Of begins that lie between samples no derivative is known.
    return float(np.nanmax(off[1:])) if np.isfinite(off[1:]).any() else float("nan")


def seconds(run: Any) -> float:
    """CPU seconds, the median of a few."""
    run()
    spent = []
    for _ in range(REPEATS):
        begin = time.process_time()
        run()
        spent.append(time.process_time() - begin)
    return float(np.median(spent))


def case(name: str, count: int) -> dict[str, Any]:
    law = CASES[name]
    p = {**law, **BALL}
    simple = law["exponent"] == 1.0 and law["damping"] == 0.0
    # By an exponent of 1 and a damping of 0 the closed form has no derivative.
    wrt = tuple(n for n in NAMES if not simple or n not in ("exponent", "damping"))
    exact = (closed if simple else integrated)(p, count)
    flight = exact["begin"][0][-1] - exact["end"][0][-2]
    end = float(exact["end"][0][-1] + 0.3 * flight)
    params = SCENE.parameters(p)
    full, names = complete(SCENE, params, wrt)
    how = plan(SCENE, "balanced")
    loose, tight = (solved_at(SCENE, full, end, names, how, [], t) for t in (1.0, TIGHTER))
    apart = bj.contact_events(SCENE, params, np.array([0.0, end]), wrt)
    stated = max(float(np.nanmax(x["contact"][:5, :count])) for x in apart.apart.values())
    row = {
        "case": name, "contacts": count, "reference": "closed form" if simple else "variational equations",
        "contact_over_flight": float((exact["end"][0][0] - exact["begin"][0][0]) / flight), "found": int(tight.counts[0]),
        "level": errors(loose, exact, p, wrt), "given": errors(tight, exact, p, wrt), "stated": stated,
        "from_samples": from_samples(full, end, wrt, exact, p),
        "steps": {"level": loose.accepted + loose.rejected, "given": tight.accepted + tight.rejected},
    }  # fmt: skip
    times = np.linspace(0.0, end, 2001)
    plain = program("simulate", *_plain(full, times, how))[0]
    cpu = {
        "values_s": seconds(lambda: plain(dict(full), times, how)),
        "events_s": seconds(lambda: solved_at(SCENE, full, end, names, how, [], TIGHTER)),
        "samples_s": seconds(lambda: level(SCENE, full, times, names, how)),
    }
    print(name, count, row["level"], row["given"], row["from_samples"], cpu, flush=True)
    return {**row, **cpu}


def _plain(params: dict, times: np.ndarray, how: Any) -> tuple:
    from bcfj_jax.solve.simulation import _run

    return _run, (SCENE, ()), (dict(params), times, how)


def shape() -> dict[str, Any]:
    """Of the tenth contact, the derivative of its force by the damping: in its phase, and at fixed times."""
    p = {**CASES["n = 1.5, damped"], **BALL}
    found = bj.contact_events(
        SCENE, SCENE.parameters(p), np.array([0.0, 2.4]), ("damping", "stiffness"), features=["contact.peak_10"]
    )
    own = {name: found.derivative[name]["contact"] for name in found.wrt}
    return {
        "phases": found.phases.tolist(), "force": found.trains["contact"].force[9].tolist(),
        **{f"{n}_{k}": (p[n] * getattr(own[n], k)[9]).tolist() for n in own for k in ("force", "pointwise")},
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    head = [
        "law",
        "contacts",
        "contact over flight",
        *(TITLES.get(k, k) for k in KINDS),
        "stated",
        "begins from samples",
    ]
    shown = [[*head, "steps", "CPU, over a run without derivatives"]]
    for r in rows:
        own = [f"{r['given'][k]:.0e} ({r['level'][k]:.0e})" for k in KINDS]
        ratio = f"{r['events_s'] / r['values_s']:.1f}"
        few = [r["case"], str(r["contacts"]), f"1/{1.0 / r['contact_over_flight']:.0f}"]
        shown.append([*few, *own, f"{r['stated']:.0e}", f"{r['from_samples']:.2g}", str(r["steps"]["given"]), ratio])
    return markdown(shown)


def main() -> None:
    rows = [case(name, count) for name in CASES for count in COUNTS]
    save("contact_events", {"cases": rows, "least": LEAST, "shape": shape()})
    put_in_readme("contact-events", table(rows), "docs/derivatives.md")
    print(table(rows))


if __name__ == "__main__":
    main()
