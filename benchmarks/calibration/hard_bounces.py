"""Hard bounces: contacts of a thousandth of the flight and less, the exact law, noise estimated. Is a fit called wrong?

Records are by SciPy from the exact law, nothing smoothed: flights are parabolas in closed form, contacts are DOP853 up to
the event that ends them. A case draws stiffness, exponent and restitution; 60 samples lie in each contact, few in flight.

    python -m benchmarks.calibration.hard_bounces [--cases 36] [--minutes 60]    keeps results/hard_bounces.json
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from benchmarks.common import markdown, put_in_readme, save
from calibration import Channel, Experiment, Free, Problem, fit

MASS, HEIGHT, GRAVITY = 0.1, 0.1, 9.81
CONTACTS, NOISES = (3, 10, 30), (0.001, 0.01, 0.05)
SAMPLES, STARTS = 60, 12
SCENE = bj.scenes.bounce(smoothing=False)


def record(truth: dict[str, float], count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Times [s], forces [N], and the first contact as a share of the flight before it."""
    k, n, a = truth["stiffness"], truth["exponent"], truth["damping"]
    # By natural sizes: d = depth x, t = depth/speed s.
    speed = np.sqrt(2.0 * GRAVITY * HEIGHT)
    depth = (MASS * speed**2 * (n + 1.0) / (2.0 * k)) ** (1.0 / (n + 1.0))
    begin, flight = np.sqrt(2.0 * HEIGHT / GRAVITY), np.sqrt(2.0 * HEIGHT / GRAVITY)
    times, forces, share = [np.linspace(0.0, begin, 20, endpoint=False)], [np.zeros(20)], 0.0

    def force(d: Any, rate: Any) -> Any:
        return k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * rate, 0.0)

    def apart(_: float, s: np.ndarray) -> float:
        return s[0] - 1e-12

    apart.terminal, apart.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    unit, arriving = depth / speed, speed
    for _ in range(count):

        def motion(_: float, s: np.ndarray) -> tuple[float, float]:
            return s[1], (GRAVITY - force(depth * s[0], speed * s[1]) / MASS) * unit / speed

        start = (1e-11, arriving / speed)
        run = solve_ivp(motion, (0.0, 1e3), start, "DOP853", rtol=1e-11, atol=1e-14, events=apart, dense_output=True)
        if not run.t_events[0].size:  # It stays: gravity presses it deeper than it bounces.
            break
        end = float(run.t_events[0][0])
        inside = np.linspace(0.0, end, SAMPLES)
        place, rate = run.sol(inside)
        times.append(begin + unit * inside)
        forces.append(force(depth * place, speed * rate))
        arriving = -speed * float(run.y_events[0][0][1])
        share = share or unit * end / flight
        flight = 2.0 * arriving / GRAVITY
        last = begin + unit * end
        # In flight few samples, none at the contacts' ends.
        times.append(np.linspace(last, last + flight, 22)[1:-1])
        forces.append(np.zeros(20))
        begin = last + flight
    return np.concatenate(times), np.concatenate(forces), share


def case(seed: int) -> tuple[dict[str, float], int, float]:
    """Coefficients, contacts and noise of a case; restitution e from 0.3 to 0.98 by a = (1 - e)/speed, about."""
    rng = np.random.default_rng(seed)
    speed = np.sqrt(2.0 * GRAVITY * HEIGHT)
    n, restitution = rng.uniform(1.0, 2.2), rng.uniform(0.3, 0.98)
    truth = {"stiffness": 10.0 ** rng.uniform(4.0, 10.0), "exponent": n, "damping": (1.0 - restitution) / speed}
    return truth, CONTACTS[seed % 3], NOISES[(seed // 3) % 3]


def one(seed: int) -> dict[str, Any]:
    truth, count, noise = case(seed)
    times, force, share = record(truth, count)
    values = force + noise * force.max() * np.random.default_rng([seed, 1]).standard_normal(times.size)
    params = {k: float(v) for k, v in SCENE.parameters(mass=MASS, drop_height=HEIGHT, gravity=GRAVITY).items()}
    free = (
        Free("stiffness", truth["stiffness"] / 30.0, 30.0 * truth["stiffness"]),
        Free("exponent", 1.0, 3.0),
        Free("damping", 1e-4, 2.0),
    )
    problem = Problem(
        SCENE, {**params, **truth}, (Experiment("drop", times, (Channel("contact.normal", values, None),)),), free
    )
    begin = time.perf_counter()
    found = fit(problem, seed=seed, starts=STARTS)
    wall = time.perf_counter() - begin
    reference = found.reference
    assert reference is not None
    true = truth["stiffness"] * reference.penetration ** truth["exponent"]
    return {
        "seed": seed, "contacts": count, "noise": noise, "contact_over_flight": share, **truth, "verdict": found.verdict,
        "reasons": found.reasons, "force_error": reference.force / true - 1.0, "wall_s": wall,
        "damping_error": found.values["damping"] / truth["damping"] - 1.0,
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    shown = [["contacts", "noise", "fits", "verdicts", "force law within 5 % and 5 noises", "s a fit (median)"]]
    for count in CONTACTS:
        for noise in NOISES:
            own = [r for r in rows if r["contacts"] == count and r["noise"] == noise]
            if own:
                words = sorted({r["verdict"] for r in own})
                verdicts = ", ".join(f"{w} {sum(r['verdict'] == w for r in own)}" for w in words)
                good = sum(abs(r["force_error"]) < 0.05 + 5.0 * noise for r in own)
                wall = float(np.median([r["wall_s"] for r in own]))
                shown.append(
                    [str(count), f"{noise:.1%}", str(len(own)), verdicts, f"{good} of {len(own)}", f"{wall:.1f}"]
                )
    return markdown(shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=36)
    parser.add_argument("--minutes", type=float, default=60.0)
    given = parser.parse_args()
    begin, rows = time.perf_counter(), []
    for seed in range(given.cases):
        if time.perf_counter() - begin > 60.0 * given.minutes:
            break
        rows.append(one(seed))
        shown = {k: v for k, v in rows[-1].items() if k != "reasons"}
        print(
            {k: float(f"{v:.3g}") if isinstance(v, float) else v for k, v in shown.items()},
            rows[-1]["reasons"][:1],
            flush=True,
        )
    save("hard_bounces", {"cases": rows})
    put_in_readme("hard-bounces", table(rows), "docs/fits_measured.md")
    print(table(rows))


if __name__ == "__main__":
    main()
