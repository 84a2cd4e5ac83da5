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

import bcfj_jax as bj
import benchmarks.common as harness
from benchmarks.common import load, publish, save
from benchmarks.references.impact import bounces, contact

ERRORS = (5e-2, 1e-2, 1e-3, 1e-4, 1e-5)
MASS, SPEED = 0.0167, 1.5
# stiffness chosen so that the penetration is about 25 um for every exponent
CASES = [(n, a) for n, a in itertools.product((1.0, 1.5, 2.5), (0.0, 0.11, 0.6))]
BOUNCES, DROP, GRAVITY = 5, 0.1, 9.81


def stiffness(exponent: float) -> float:
    return (exponent + 1) * MASS * SPEED**2 / (2 * 25e-6 ** (exponent + 1))


def worst(rows: list[list[float]]) -> list[float]:
    """The worst of each error over the rows, and the median number of steps, which stands last."""
    *errors, steps = zip(*rows, strict=True)
    return [*map(max, errors), statistics.median(steps)]


def impact_errors(error: float) -> list[float]:
    rows, scene = [], bj.scenes.impact()
    for n, a in CASES:
        law = {"stiffness": stiffness(n), "exponent": n, "damping": a}
        tight = contact(law, MASS, SPEED)

        times = np.linspace(0.0, 1.2 * tight.end, 2001)
        exact, impulse = tight.force(times), MASS * (SPEED + tight.rebound)
        params = scene.parameters({**law, "mass": MASS, "approach_speed": SPEED})
        ours = bj.simulate(scene, params, times, accuracy=error)
        got, peak = ours.force["contact"][:, 0], exact.max()
        peaks, impulses = abs(got.max() / peak - 1), abs(np.trapezoid(got - exact, times) / impulse)
        steps = ours.stats["accepted"] + ours.stats["rejected"]
        rows.append([peaks, impulses, float(np.max(np.abs(got - exact)) / peak), steps])
    return worst(rows)


def bounce_errors(error: float) -> list[float]:
    rows, scene = [], bj.scenes.bounce()
    for n, a in [(1.0, 0.05), (1.5, 0.11), (2.5, 0.2)]:
        law = {"stiffness": stiffness(n), "exponent": n, "damping": a}
        tight = bounces(law, MASS, DROP, GRAVITY, BOUNCES)
        peaks = [c.force(np.linspace(c.begin, c.end, 4001)).max() for c in tight]
        impulses = [MASS * (c.approach + c.rebound + GRAVITY * (c.end - c.begin)) for c in tight]
        # A rebound wrong by a fraction e shifts the next contact by some 3000 e of its duration. Contacts are sampled
        # widely enough that the shift is no error of the peak, and finely enough that the sampling is none either.
        margin, density = np.clip(1e4 * error, 2.0, 500.0), 100 if error > 1e-3 else 2000
        share = np.linspace(-margin, margin + 1, int(density * (2 * margin + 1)) + 1)
        clock = np.stack([c.begin + share * (c.end - c.begin) for c in tight])
        params = scene.parameters({**law, "mass": MASS, "drop_height": DROP, "gravity": GRAVITY})
        ours = bj.simulate(scene, params, clock.ravel(), accuracy=error)
        got = ours.force["contact"][:, 0].reshape(BOUNCES, -1)
        off = np.abs(got.max(axis=1) / peaks - 1), np.abs(np.trapezoid(got, clock, axis=1) / impulses - 1)
        rows.append([*(float(x.max()) for x in off), ours.stats["accepted"] + ours.stats["rejected"]])
    return worst(rows)


def table(result: dict[str, Any]) -> str:
    errors, steps = (lambda of, k: f"{{{of}[{k}]:.1e}}"), (lambda of, k: f"{{{of}[{k}]:.0f}}")
    impact = [(head, errors("impact", k)) for k, head in enumerate(("impact: peak", "impulse", "history"))]
    bounce = [
        (head, errors("bounce", k)) for k, head in enumerate((f"bounce, {result['bounces']} contacts: peak", "impulse"))
    ]
    columns = [("asked", "{asked:.0e}"), *impact, ("steps", steps("impact", 3)), *bounce, ("steps", steps("bounce", 2))]
    return harness.table(columns, result["rows"])


def main() -> None:
    rows = [{"asked": e, "impact": impact_errors(e), "bounce": bounce_errors(e)} for e in ERRORS]
    save("accuracy", {"rows": rows, "bounces": BOUNCES})
    publish("accuracy", table(load("accuracy")), "docs/accuracy.md")


if __name__ == "__main__":
    main()
