"""The systematic budget against fits of records with that very error planted, by SciPy and by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bcfj_jax import scenes, simulate
from calibration import Channel, Experiment, Free, Problem, fit

SCENE = scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
TIMES = np.linspace(0.0, 1.6e-3, 161)


def problem(error, seed=0) -> Problem:
    params = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, **TRUTH}).items()}
    force = simulate(SCENE, params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    sigma = 2e-3 * float(force.max())
    values = error(force) + sigma * np.random.default_rng(seed).standard_normal(force.size)
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, (Experiment("drop", TIMES, (Channel("contact.normal", values, None),)),), free)


@pytest.mark.full
def test_a_line_says_what_a_fit_of_that_error_moves_by():
    """Of one percent of the mass, and of a bend of the gain as large as its line says."""
    found = fit(problem(lambda f: f), starts=4)
    lines = {line.error: line for line in found.systematic}
    one = fit(replace(problem(lambda f: f), params={**problem(lambda f: f).params, "mass": 0.101}), starts=4)
    bend = lines["bend of the gain"].amplitude
    two = fit(problem(lambda f: f * (1.0 + bend * f / f.max())), starts=4)
    for name in TRUTH:
        for error, other in (("mass", one), ("bend of the gain", two)):
            moved = abs(np.log(other.values[name] / found.values[name]))
            assert moved == pytest.approx(lines[error].moves[name], rel=0.15, abs=2e-4), (name, error)


@pytest.mark.slow
def test_an_error_that_residuals_show_is_bounded_by_them():
    """Less noise lets less pass, and nothing more than is called large."""
    loud = fit(problem(lambda f: f), starts=4)
    calm = problem(lambda f: f)
    (experiment,) = calm.experiments
    (channel,) = experiment.channels
    clean = simulate(SCENE, calm.params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    values = clean + 0.05 * (channel.values - clean)
    quiet = fit(
        replace(calm, experiments=(replace(experiment, channels=(replace(channel, values=values),)),)), starts=4
    )
    for more, less in zip(loud.systematic, quiet.systematic, strict=False):
        if more.error in ("bend of the gain", "lag", "drift"):
            assert 0.0 < less.amplitude <= more.amplitude <= 0.1
