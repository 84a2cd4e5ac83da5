"""The joint's coefficients from its own forces: a small joint in equilibrium, whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from joints import LITTLE

from bcfj_jax import InputError, scenes, simulate
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.evaluate import evaluator
from calibration.model import batch, build

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error")]

SCENE = scenes.joint(**{**LITTLE, "fidelity": "quasistatic"})
TRUTH = {name: float(value) for name, value in SCENE.parameters().items()}
TIMES, NOISE = np.linspace(0.06, 0.66, 25), 0.01
FREE = (
    Free("stiffness", TRUTH["stiffness"] / 3, TRUTH["stiffness"] * 3),
    Free("exponent", 1.2, 2.0),
    Free("contact_angle", np.radians(25.0), np.radians(60.0)),
)


@pytest.fixture(scope="module")
def clean():
    run = simulate(SCENE, SCENE.parameters(), TIMES)
    assert run.status == "ok"
    return {f"{name}_{i + 1}.normal": run.force[name][:, i, 0] for name in ("seat_ball", "head_ball") for i in range(3)}


def problem(clean, free=FREE, seed=0):
    draw = np.random.default_rng(seed)
    channels = tuple(
        Channel(name, force + (sigma := NOISE * np.abs(force).max()) * draw.standard_normal(force.size), sigma)
        for name, force in clean.items()
    )
    return Problem(SCENE, TRUTH, (Experiment("revolution", TIMES, channels),), free)


def test_equilibria_tell_stiffness_exponent_and_contact_angle(clean):
    for seed in range(2):
        found = fit(problem(clean, seed=seed), seed=seed, starts=4)
        assert found.verdict == "identified", found.reasons
        for f in FREE:
            low, high = found.parameters[f.name].ci95
            # Three half-widths: one in 300 million misses, and no interval is wider than what makes it of use.
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            assert abs(TRUTH[f.name] - middle) < 3 * half
            assert half < 0.2 * TRUTH[f.name]


def test_what_equilibria_do_not_tell_is_named(clean):
    free = (*FREE, Free("damping", TRUTH["damping"] / 3, TRUTH["damping"] * 3))
    with pytest.raises(InputError, match=r"'damping' moves no residual"):
        fit(problem(clean, free), starts=4)


def test_points_one_by_one_are_those_of_a_batch(clean):
    made = problem(clean)
    model = build(made, made.experiments)
    points = np.random.default_rng(0).uniform(0.45, 0.55, (3, 3))[[0, 1, 0, 2]]
    residuals, jacobians = evaluator(model, -10.0)(points)
    expected = [np.asarray(a) for a in batch(model, points, np.asarray(-10.0))]
    for found, other in zip((residuals, jacobians), expected, strict=True):
        # Newton ends at a force error of 1e-9 of the peak; the noise is 1e-2 of it.
        assert np.allclose(found, other, rtol=1e-5, atol=1e-5)
