"""Hard bounces: contacts of a thousandth of the flight and less, the exact law, noise estimated. Is a fit called wrong?

Records are by SciPy from the exact law, nothing smoothed: flights are parabolas in closed form, contacts are DOP853 up to
the event that ends them. A case draws stiffness, exponent and restitution; 60 samples lie in each contact, few in flight.

    python -m benchmarks.calibration.hard_bounces [--cases 36] [--minutes 60]    keeps results/hard_bounces.json
"""

from __future__ import annotations

from typing import Any

import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from benchmarks.clock import clocked, until
from benchmarks.common import options, publish, save, tally, told
from benchmarks.references.impact import bounces
from calibration import Channel, Experiment, Free, Problem, fit

MASS, HEIGHT, GRAVITY = 0.1, 0.1, 9.81
CONTACTS, NOISES = (3, 10, 30), (0.001, 0.01, 0.05)
SAMPLES, STARTS = 60, 12
SCENE = bj.scenes.bounce(smoothing=False)


def record(truth: dict[str, float], count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Times [s], forces [N], and the first contact as a share of the flight before it."""
    found = bounces(truth, MASS, HEIGHT, GRAVITY, count)
    times, forces = [np.linspace(0.0, found[0].begin, 20, endpoint=False)], [np.zeros(20)]
    for one in found:
        times.append(np.linspace(one.begin, one.end, SAMPLES))
        forces.append(one.force(times[-1]))
        # In flight few samples, none at the contacts' ends.
        times.append(np.linspace(one.end, one.end + 2.0 * one.rebound / GRAVITY, 22)[1:-1])
        forces.append(np.zeros(20))
    return np.concatenate(times), np.concatenate(forces), (found[0].end - found[0].begin) / found[0].begin


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
    stiffness = Free("stiffness", truth["stiffness"] / 30.0, 30.0 * truth["stiffness"])
    free = (stiffness, Free("exponent", 1.0, 3.0), Free("damping", 1e-4, 2.0))
    drop = Experiment("drop", times, (Channel("contact.normal", values, None),))
    problem = Problem(SCENE, {**params, **truth}, (drop,), free)
    found, took = clocked(lambda: fit(problem, seed=seed, starts=STARTS))
    reference = found.reference
    assert reference is not None
    true = truth["stiffness"] * reference.penetration ** truth["exponent"]
    return {
        "seed": seed, "contacts": count, "noise": noise, "contact_over_flight": share, **truth, "verdict": found.verdict,
        "reasons": found.reasons, "force_error": reference.force / true - 1.0, "wall_s": took["wall_s"],
        "damping_error": found.values["damping"] / truth["damping"] - 1.0,
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    by = {(c, n): [r for r in rows if (r["contacts"], r["noise"]) == (c, n)] for c in CONTACTS for n in NOISES}

    def good(own: list[dict[str, Any]]) -> str:
        return f"{sum(abs(r['force_error']) < 0.05 + 5.0 * r['noise'] for r in own)} of {len(own)}"

    return harness.table({
        "contacts": lambda own: own[0]["contacts"], "noise": lambda own: f"{own[0]['noise']:.1%}", "fits": len,
        "verdicts": lambda own: told(tally(r["verdict"] for r in own)), "force law within 5 % and 5 noises": good,
        "s a fit (median)": lambda own: f"{np.median([r['wall_s'] for r in own]):.1f}",
    }, (own for own in by.values() if own))  # fmt: skip


def main() -> None:
    given, rows = options(__doc__, cases=36, minutes=60.0), []
    for seed in until(given.minutes, range(given.cases)):
        rows.append(one(seed))
        print(rows[-1], flush=True)
    save("hard_bounces", {"cases": rows})
    publish("hard-bounces", table(rows), "docs/fits_measured.md")


if __name__ == "__main__":
    main()
