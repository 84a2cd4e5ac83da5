"""Is the force error what was asked for? Errors of impact and bounce against an independent tight solver.

For each requested force error: the worst error over a set of scenes of peak force, impulse and (impact only) the
whole history, in fractions of the peak, and the steps it took. The reference is SciPy's DOP853 at 1e-12 with its own
NumPy force law and an event at every touch.

    python -m benchmarks.solve.accuracy    measures, keeps benchmarks/results/accuracy.json, and docs/accuracy.md
"""

from __future__ import annotations

import itertools
import statistics
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from benchmarks.common import load, markdown, put_in_readme, save

ERRORS = (5e-2, 1e-2, 1e-3, 1e-4, 1e-5)
MASS, SPEED = 0.0167, 1.5
# stiffness chosen so that the penetration is about 25 um for every exponent
CASES = [(n, a) for n, a in itertools.product((1.0, 1.5, 2.5), (0.0, 0.11, 0.6))]
BOUNCES, DROP, GRAVITY = 5, 0.1, 9.81


def stiffness(exponent: float) -> float:
    return (exponent + 1) * MASS * SPEED**2 / (2 * 25e-6 ** (exponent + 1))


def contact(k: float, n: float, a: float, speed: float, gravity: float) -> Any:
    """One contact, from touch to separation, tight."""

    def force(d, rate):
        return k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * rate, 0.0)

    def separated(_, y):
        return y[0]

    separated.terminal, separated.direction = True, -1
    motion = lambda _, y: (y[1], gravity - force(y[0], y[1]) / MASS)  # noqa: E731
    run = solve_ivp(
        motion, (0, 1), (1e-18, speed), "DOP853", rtol=1e-12, atol=(1e-17, 1e-13), events=separated, dense_output=True
    )
    return run, force


def impact_errors(error: float) -> tuple[float, float, float, float]:
    rows = []
    scene = bj.scenes.impact()
    for n, a in CASES:
        run, force = contact(stiffness(n), n, a, SPEED, 0.0)
        end = run.t[-1]
        times = np.linspace(0.0, 1.2 * end, 2001)
        inside = times <= end
        states = run.sol(times[inside])
        exact = np.zeros(times.size)
        exact[inside] = force(*states)
        params = scene.parameters(stiffness=stiffness(n), exponent=n, damping=a, mass=MASS, approach_speed=SPEED)
        ours = bj.simulate(scene, params, times, accuracy=error)
        got = ours.force["contact"][:, 0]
        peak = exact.max()
        impulse = MASS * (SPEED - run.y[1, -1])
        rows.append(
            (
                abs(got.max() / peak - 1),
                abs(np.trapezoid(got - exact, times) / impulse),
                float(np.max(np.abs(got - exact)) / peak),
                ours.stats["accepted"] + ours.stats["rejected"],
            )
        )
    worst = [max(row[k] for row in rows) for k in range(3)]
    return worst[0], worst[1], worst[2], statistics.median(row[3] for row in rows)


def bounce_errors(error: float) -> tuple[float, float, float]:
    rows = []
    scene = bj.scenes.bounce()
    for n, a in [(1.0, 0.05), (1.5, 0.11), (2.5, 0.2)]:
        speed = np.sqrt(2 * GRAVITY * DROP)
        peaks, impulses, windows, now = [], [], [], np.sqrt(2 * DROP / GRAVITY)
        for _ in range(BOUNCES):
            run, force = contact(stiffness(n), n, a, speed, GRAVITY)
            states = run.sol(np.linspace(0, run.t[-1], 4001))
            peaks.append(force(*states).max())
            rebound = -run.y[1, -1]
            impulses.append(MASS * (speed + rebound) + MASS * GRAVITY * run.t[-1])
            windows.append((now, run.t[-1]))
            now += run.t[-1] + 2 * rebound / GRAVITY
            speed = rebound
        # A rebound wrong by a fraction e shifts the next contact by some 3000 e of its duration. Contacts are sampled
        # widely enough that the shift is no error of the peak, and finely enough that the sampling is none either.
        margin, density = np.clip(1e4 * error, 2.0, 500.0), 100 if error > 1e-3 else 2000
        count = int(density * (2 * margin + 1)) + 1
        times = np.concatenate([np.linspace(t - margin * d, t + (margin + 1) * d, count) for t, d in windows])
        params = scene.parameters(
            stiffness=stiffness(n), exponent=n, damping=a, mass=MASS, drop_height=DROP, gravity=GRAVITY
        )
        ours = bj.simulate(scene, params, times, accuracy=error)
        got = ours.force["contact"][:, 0].reshape(BOUNCES, -1)
        clock = times.reshape(BOUNCES, -1)
        rows.append(
            (
                max(abs(got[k].max() / peaks[k] - 1) for k in range(BOUNCES)),
                max(abs(np.trapezoid(got[k], clock[k]) / impulses[k] - 1) for k in range(BOUNCES)),
                ours.stats["accepted"] + ours.stats["rejected"],
            )
        )
    return max(r[0] for r in rows), max(r[1] for r in rows), statistics.median(r[2] for r in rows)


def table(result: dict[str, Any]) -> str:
    rows = [
        [
            "asked",
            "impact: peak",
            "impulse",
            "history",
            "steps",
            f"bounce, {result['bounces']} contacts: peak",
            "impulse",
            "steps",
        ]
    ]
    for row in result["rows"]:
        i, b = row["impact"], row["bounce"]
        cells = [
            f"{row['asked']:.0e}",
            *(f"{x:.1e}" for x in i[:3]),
            f"{i[3]:.0f}",
            *(f"{x:.1e}" for x in b[:2]),
            f"{b[2]:.0f}",
        ]
        rows.append(cells)
    return markdown(rows)


def main() -> None:
    rows = [{"asked": e, "impact": impact_errors(e), "bounce": bounce_errors(e)} for e in ERRORS]
    save("accuracy", {"rows": rows, "bounces": BOUNCES})
    put_in_readme("accuracy", table(load("accuracy")), "docs/accuracy.md")
    print(table(load("accuracy")))


if __name__ == "__main__":
    main()
