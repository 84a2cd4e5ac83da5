"""Does a diagnosis name the one imperfection of a record, and none of a clean record?

Single impacts by SciPy from the exact law, 1 to 4 runs at different speeds, noise 0.5 % of the peak at 1 m/s. Fifty records
have one imperfection each, whose largest effect on the force at 1 m/s is 3 to 10 deviations of the noise (a step of so many
of a quantisation, so many off the highest peak of a saturation). Fifty have none.

    python -m benchmarks.calibration.diagnosis [--records 50] [--seed 0] [--minutes 60]    keeps results/diagnosis.json
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from benchmarks.calibration import imperfect
from benchmarks.calibration.imperfect import MASS, NOISE, SCENE, STARTS, TRUTH
from benchmarks.clock import clocked, until
from benchmarks.common import markdown, options, publish, save
from calibration import Channel, Experiment, Fit, Free, Problem, fit
from calibration.selection.diagnosis import diagnose, rank

NOTHING = "nothing"
PLANTED = (
    "bandwidth", "resonance", "hum", "drift", "gain bend", "clock jitter", "quantisation", "saturation", "stop",
    "relaxation",
)  # fmt: skip
SPEEDS = {1: (1.0,), 2: (0.8, 1.2), 3: (0.75, 1.0, 1.3), 4: (0.7, 0.9, 1.1, 1.3)}
# Duration [s] of a record and peak [N] at 1 m/s: one sensor reads all runs.
TIMES, PLAIN = imperfect.motion(1.0)
SPAN, PEAK = float(TIMES[-1]), float(PLAIN.max())


def read(kind: str, speed: float, strength: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A record without noise; a strength of 1 is large."""
    if kind in ("stop", "relaxation"):
        return imperfect.motion(speed, **{kind: strength})
    times, force = imperfect.motion(speed)
    if kind == "bandwidth":
        force = imperfect.lagged(times, force, 0.2 * strength * SPAN)
    elif kind == "resonance":
        force = imperfect.resonant(times, force, 2.0 * np.pi * 4.0 / (max(strength, 1e-3) ** 0.5 * SPAN))
    elif kind == "hum":
        force = force + strength * PEAK * np.sin(2.0 * np.pi * 2.6 * times / SPAN + rng.uniform(0.0, 2.0 * np.pi))
    elif kind == "drift":
        force = force + strength * PEAK * times / SPAN
    elif kind == "gain bend":
        force = force * (1.0 + strength * force / PEAK)
    elif kind == "clock jitter":
        force = np.interp(times + strength * SPAN * rng.standard_normal(times.size), times, force)
    return times, force


@cache
def strength_of(kind: str, deviations: float) -> float:
    """The strength whose largest effect at 1 m/s is so many deviations of the noise; a force for what has no record."""
    size = deviations * NOISE * PEAK
    if kind in ("quantisation", "saturation"):
        return size
    if kind == "hum":
        return size / PEAK
    if kind == "clock jitter":
        return size / float(np.abs(np.gradient(PLAIN, TIMES)).max()) / SPAN
    low, high = 1e-6, 10.0
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        effect = np.abs(read(kind, 1.0, middle, np.random.default_rng(0))[1] - PLAIN).max()
        low, high = (middle, high) if effect < size else (low, middle)
    return float(np.sqrt(low * high))


def problem(kind: str, strength: float, runs: int, seed: int) -> Problem:
    """The record of one imperfection; none for ``NOTHING``."""
    rng, experiments = np.random.default_rng([seed, runs]), []
    sigma = NOISE * PEAK
    forces = {speed: read(kind, speed, strength, rng) for speed in SPEEDS[runs]}
    highest = max(float(force.max()) for _, force in forces.values())
    for k, (speed, (times, force)) in enumerate(forces.items()):
        values = force + sigma * rng.standard_normal(force.size)
        if kind == "quantisation":
            values = strength * np.round(values / strength)
        if kind == "saturation":
            values = np.minimum(values, highest - strength)
        channel = Channel("contact.normal", values, None)
        experiments.append(Experiment(f"run {k + 1}", times, (channel,), fixed={"approach_speed": speed}))
    params = {k: float(v) for k, v in SCENE.parameters({"mass": MASS, "approach_speed": 1.0, **TRUTH}).items()}
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, tuple(experiments), free)


def plan(records: int, seed: int) -> list[dict[str, Any]]:
    """Which imperfection, how large and in how many runs: evenly over kinds and runs, sizes at random."""
    rng, found = np.random.default_rng([21, seed]), []
    for k in range(records):
        size = float(3.0 * (10.0 / 3.0) ** rng.uniform())
        runs = 1 + (k // len(PLANTED) + k) % 4
        found.append({"planted": PLANTED[k % len(PLANTED)], "deviations": size, "runs": runs, "seed": 1000 * seed + k})
    return found


def fitted(planned: dict[str, Any]) -> tuple[Problem, Fit]:
    """A record, and the fit that knows nothing of its imperfection."""
    kind = planned["planted"]
    strength = 0.0 if kind == NOTHING else strength_of(kind, planned["deviations"])
    given = problem(kind, strength, planned["runs"], planned["seed"])
    return given, fit(given, seed=planned["seed"], starts=STARTS)


def ranking(planned: dict[str, Any], given: Problem, plain: Fit) -> dict[str, Any]:
    """What residuals alone say."""
    found, took = clocked(lambda: rank(given, plain))
    assert found is not None
    likely = {f.name: round(f.explained, 4) for f in found.found if f.likely}
    said = {"law": plain.law.answer, "by_residuals": found.named, "explained": likely}
    return {**planned, **said, "rank_s": took["wall_s"]}


def confirming(planned: dict[str, Any], given: Problem, plain: Fit) -> dict[str, Any]:
    """What fits say of it."""
    found, took = clocked(lambda: diagnose(given, plain, planned["seed"]))
    assert found is not None
    fits = [
        {
            "names": list(t.names), "bic_change": -t.gain, "confirmed": t.confirmed, "reason": t.reason,
            "law": t.fit.law.answer if t.fit else None,
        }
        for t in found.trials
    ]  # fmt: skip
    return {"named": found.named, "fits": fits, "diagnose_s": took["wall_s"]}


def table(planted: list[dict[str, Any]], clean: list[dict[str, Any]]) -> str:
    """By imperfection: named first by residuals alone, with fits, and whether the fit with it was confirmed."""
    shown = [["planted", "named by residuals", "named first with fits", "fit with it confirmed", "in its place"]]
    for kind in (*PLANTED, "all"):
        own = [f for f in planted if kind in (f["planted"], "all")]
        done = [f for f in own if "named" in f]
        right = sum(f["by_residuals"] == [f["planted"]] for f in own)
        first = sum(f["named"][:1] == [f["planted"]] for f in done)
        confirmed = sum(any(t["names"] == [f["planted"]] and t["confirmed"] for t in f["fits"]) for f in done)
        said = [f"{(f['by_residuals'] or ['none'])[0]} (residuals)" for f in own if f["by_residuals"] != [f["planted"]]]
        said += [f"{(f['named'] or ['none'])[0]} (fits)" for f in done if f["named"][:1] != [f["planted"]]]
        counts = f"{right} of {len(own)}", f"{first} of {len(done)}", f"{confirmed} of {len(done)}"
        shown.append([kind, *counts, "" if kind == "all" else ", ".join(said)])
    done = [f for f in clean if "named" in f]
    quiet = sum(not f["by_residuals"] for f in clean), sum(not f["named"] for f in done)
    said = ", ".join(f["by_residuals"][0] for f in clean if f["by_residuals"])
    counts = f"none named: {quiet[0]} of {len(clean)}", f"none named: {quiet[1]} of {len(done)}"
    return markdown([*shown, ["nothing", *counts, "", said]])


def main() -> None:
    given = options(__doc__, records=50, seed=0, minutes=60.0)
    planned = plan(given.records, given.seed)
    clean = [{**p, "planted": NOTHING, "deviations": 0.0, "seed": p["seed"] + 500} for p in planned]
    records = [(planned, *fitted(planned)) for planned in [*planned, *clean]]
    found = [ranking(*record) for record in records]
    keep(found, given.seed)
    # Many fits, and compiled anew for each number of runs.
    for k in until(given.minutes, sorted(range(len(found)), key=lambda k: found[k]["runs"])):
        found[k] |= confirming(*records[k])
        keep(found, given.seed)


def keep(found: list[dict[str, Any]], seed: int) -> None:
    planted, clean = found[: len(found) // 2], found[len(found) // 2 :]
    save("diagnosis", {"seed": seed, "planted": planted, "clean": clean})
    quick, slow = ([f[key] for f in found if key in f] or [0.0] for key in ("rank_s", "diagnose_s"))
    said = f"The ranking by residuals takes {np.median(quick):.2g} s (median)"
    said += f", with fits and their compilation {np.median(slow):.2g} s." if max(slow) else "."
    publish("diagnosis", f"{table(planted, clean)}\n\n{said}", "docs/fits_measured.md")


if __name__ == "__main__":
    main()
