"""Does a diagnosis name the one imperfection of a record, and none of a clean record?

Single impacts by SciPy from the exact law, 1 to 4 runs at different speeds, noise 0.5 % of the peak at 1 m/s. Fifty records
have one imperfection each, whose largest effect on the force at 1 m/s is 3 to 10 deviations of the noise (a step of so many
of a quantisation, so many off the highest peak of a saturation). Fifty have none.

    python -m benchmarks.calibration.diagnosis [--records 50] [--seed 0]    keeps results/diagnosis.json
"""

from __future__ import annotations

import os
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np

from benchmarks.calibration import imperfect
from benchmarks.calibration.imperfect import MASS, NOISE, SCENE, STARTS, TRUTH
from calibration import Channel, Experiment, Free, Problem

PLANTED = (
    "bandwidth", "resonance", "hum", "drift", "gain bend", "clock jitter", "quantisation", "saturation", "stop",
    "relaxation",
)  # fmt: skip
# Those of ``imperfect``, by the names of the suspects.
_SAME = {"bandwidth": "lag", "resonance": "resonance", "drift": "drift", "gain bend": "gain bend"}
SPEEDS = {1: (1.0,), 2: (0.8, 1.2), 3: (0.75, 1.0, 1.3), 4: (0.7, 0.9, 1.1, 1.3)}


def read(kind: str, speed: float, strength: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A record without noise."""
    if kind in ("stop", "relaxation"):
        return imperfect.motion(speed, **{kind: strength})
    times, force = imperfect.motion(speed)
    if kind in _SAME:
        return times, imperfect.SENSOR[_SAME[kind]](times, force, strength)
    if kind == "hum":
        frequency, phase = 2.6 / times[-1] * speed ** (-0.2), rng.uniform(0.0, 2.0 * np.pi)
        return times, force + strength * np.sin(2.0 * np.pi * frequency * times + phase)
    if kind == "clock jitter":
        return times, np.interp(times + strength * rng.standard_normal(times.size), times, force)
    return times, force


def strength_of(kind: str, deviations: float) -> float:
    """The strength whose largest effect at 1 m/s is so many deviations of the noise."""
    times, plain = imperfect.motion(1.0)
    size = deviations * NOISE * float(plain.max())
    if kind in ("hum", "quantisation", "saturation"):
        return size
    if kind == "clock jitter":
        return size / float(np.abs(np.gradient(plain, times)).max())
    low, high = 1e-6, 10.0
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        effect = np.abs(read(kind, 1.0, middle, np.random.default_rng(0))[1] - plain).max()
        low, high = (middle, high) if effect < size else (low, middle)
    return float(np.sqrt(low * high))


def problem(kind: str, strength: float, runs: int, seed: int) -> Problem:
    """The record of one imperfection; none for the kind "clean"."""
    rng, experiments = np.random.default_rng([seed, runs]), []
    sigma = NOISE * float(imperfect.motion(1.0)[1].max())
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


def plan(records: int) -> list[dict[str, Any]]:
    """Which imperfection, how large and in how many runs: evenly over kinds, sizes and runs."""
    rng, found = np.random.default_rng(21), []
    for k in range(records):
        size = float(3.0 * (10.0 / 3.0) ** rng.uniform())
        found.append({"planted": PLANTED[k % len(PLANTED)], "deviations": size, "runs": 1 + (k // len(PLANTED) + k) % 4})
    return found
