"""The joint's coefficients from its own forces: a small joint in equilibrium, whose truth is known."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from joints import LITTLE, plain_joint

from calibration import Channel, Experiment, Free, Problem, fit
from calibration.forward.model import build, residuals_and_jacobian
from calibration.search.evaluate import evaluator

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error")]

SCENE = plain_joint(**{**LITTLE, "fidelity": "quasistatic"})
TRUTH = {name: float(value) for name, value in SCENE.parameters().items()}
TIMES = np.linspace(0.06, 0.66, 25)
NAMES = [f"{groove}_{i}.normal" for groove in ("seat_ball", "head_ball") for i in (1, 2, 3)]
FREE = (
    Free("stiffness", TRUTH["stiffness"] / 3, TRUTH["stiffness"] * 3),
    Free("contact_angle", np.radians(25.0), np.radians(60.0)),
    Free("clearance_seat_ball", TRUTH["clearance_seat_ball"] / 3, TRUTH["clearance_seat_ball"] * 3),
)


def problem(forces, sigmas) -> Problem:
    channels = (Channel(name, values, float(s)) for name, values, s in zip(NAMES, forces, sigmas, strict=True))
    return Problem(SCENE, TRUTH, (Experiment("revolution", TIMES, tuple(channels)),), FREE)


@pytest.fixture(scope="module")
def clean():
    """Forces (6, T): residuals of deviation 1 against a record of nothing."""
    empty = problem(np.zeros((6, TIMES.size)), np.ones(6))
    model = build(empty, empty.experiments)
    point = jnp.asarray(model.point(np.array([TRUTH[axis.name] for axis in model.coordinates])))
    return np.asarray(residuals_and_jacobian(model, point)[0]).reshape(6, -1)


def noisy(clean, noise, seed) -> Problem:
    sigmas = noise * np.abs(clean).max(axis=1)
    return problem(clean + sigmas[:, None] * np.random.default_rng(seed).standard_normal(clean.shape), sigmas)


def test_equilibria_identify_stiffness_contact_angle_and_clearance(clean):
    for seed in range(2):
        found = fit(noisy(clean, 0.003, seed), seed=seed, starts=4)
        assert found.verdict == "identified", found.reasons
        for f in FREE:
            low, high = np.log(found.parameters[f.name].intervals["noise"] or (np.nan, np.nan))
            # Two half-widths are 3.9 deviations: one in 10^4 misses. No interval is so wide that it is of no use.
            assert abs(np.log(TRUTH[f.name]) - 0.5 * (low + high)) < high - low
            assert high - low < 0.8


def test_what_noise_hides_is_named(clean):
    found = fit(noisy(clean, 0.02, 0), starts=4)
    assert found.verdict == "not_identified"
    assert [name for name, p in found.parameters.items() if not p.identifiable] == ["clearance_seat_ball"]
    assert any("do not determine clearance_seat_ball" in reason for reason in found.reasons)
    assert all(p.ci95 is None for p in found.parameters.values())


def test_points_side_by_side_are_those_one_by_one(clean):
    made = noisy(clean, 0.01, 0)
    model = build(made, made.experiments)
    points = np.random.default_rng(0).uniform(0.4, 0.6, (3, 3))[[2, 1, 0, 2]]
    residuals, jacobians = evaluator(model)(points)
    for point, r, j in zip(points, residuals, jacobians, strict=True):
        alone = residuals_and_jacobian(model, jnp.asarray(point))
        assert np.array_equal(r, alone[0])
        assert np.array_equal(j, alone[1])
