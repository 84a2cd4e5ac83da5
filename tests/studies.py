"""Studies that tests share."""

from __future__ import annotations

import tomllib

import numpy as np

from bcfj_jax.analysis.axes import Axis
from bcfj_jax.analysis.studies.api import Finished
from bcfj_jax.analysis.studies.specification import Study, from_table
from benchmarks import processes

STUDY = processes.STUDY.format(steps=7)

# An impact without damping, whose peak is a product of powers: K^(1/(n+1)) ((n+1)/2 m v^2)^(n/(n+1)), n = 3/2.
IMPACT = """
[scene]
scene = { kind = "impact" }
parameters = { damping = 0.0 }
[vary.stiffness]
lower = 1e7
upper = 6e7
scale = "log"
[vary.mass]
lower = 0.5
upper = 1.0
scale = "log"
[vary.approach_speed]
lower = 0.6
upper = 1.6
scale = "log"
[results]
features = ["contact.peak"]
"""
POWERS = {"stiffness": 0.4, "mass": 0.6, "approach_speed": 1.2}


def peak(values: np.ndarray) -> np.ndarray:
    """Peak force (N,) [N] of stiffness, mass, approach speed (N, 3): K d^n with K d^(n+1)/(n+1) = m v^2/2."""
    stiffness, mass, speed = values.T
    return stiffness**0.4 * (1.25 * mass * speed**2) ** 0.6


def peak_variances(study: Study) -> np.ndarray:
    """V(x^p)/E(x^p)^2 (D,) of each factor of the peak, ln x uniform: E(x^p) = (b^p - a^p)/(p ln(b/a))."""

    def mean(axis: Axis, p: float) -> float:
        return (axis.upper**p - axis.lower**p) / (p * np.log(axis.upper / axis.lower))

    return np.array([mean(a, 2 * POWERS[a.name]) / mean(a, POWERS[a.name]) ** 2 - 1 for a in study.design.axes])


def ishigami(design: str) -> Finished:
    """A study whose feature is Ishigami's: sin x1 + 7 sin^2 x2 + x3^4/10 sin x1 on [-pi, pi]; no run is done."""
    study = from_table(tomllib.loads(IMPACT + f"[design]\n{design}"))
    whole = Finished(study, study.points, {}, np.ones(study.count, bool))
    x = np.pi * (2 * whole.shares.T - 1)
    y = np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])
    return whole._replace(columns={"contact.peak": y})
