"""A solver so coarse that it moves the estimates: the fit goes on more tightly, and says so."""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax import scenes
from bcfj_jax.models.joint.scene import PLAIN
from calibration import Channel, Experiment, Free, Problem
from calibration.diagnostics import fit_tests
from calibration.diagnostics.solver_error import LITTLE, corrected, covered
from calibration.forward import integration, model
from calibration.search.refinement import finish

pytestmark = pytest.mark.filterwarnings("error")

COUNT, MASS, STIFFNESS, SIGMA = 60, 0.1, 1e5, 1e-5
FREE = (Free("stiffness", 1e4, 1e6), Free("mass", 0.01, 1.0))


def test_what_an_interval_covers_when_the_estimate_is_moved():
    assert covered(0.0) == pytest.approx(0.95, abs=1e-12)
    draws = np.random.default_rng(0).standard_normal(1_000_000)
    assert covered(0.5) == pytest.approx(np.mean(np.abs(draws + 0.5) < 1.959964), abs=1e-3)


def test_shift_is_that_of_the_worst_combination():
    rng = np.random.default_rng(1)
    jacobian, error = rng.standard_normal((40, 3)), rng.standard_normal(40)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    moved = covariance @ jacobian.T @ error
    assert fit_tests.shift(error, jacobian) == pytest.approx(np.sqrt(moved @ np.linalg.solve(covariance, moved)))
    # What no coordinate can take on moves nothing, however large it is.
    beside = error - jacobian @ moved
    assert fit_tests.shift(1e6 * beside, jacobian) < 1e-6
    assert np.isnan(fit_tests.shift(np.full(40, np.nan), jacobian))


@pytest.fixture(scope="module")
def coarse():
    """A clean record of a linear contact in closed form, known to 1e-7 of its peak, and its model at 1e-2."""
    scene, omega = scenes.impact(smoothing=False), np.sqrt(STIFFNESS / MASS)
    params = scene.parameters(mass=MASS, approach_speed=1.0, stiffness=STIFFNESS, exponent=1.0, damping=0.0)
    times = np.linspace(0.0, 0.99 * np.pi / omega, COUNT)
    one = Experiment("a", times, (Channel("contact.normal", 100.0 * np.sin(omega * times), SIGMA),))
    problem = Problem(scene, {k: float(v) for k, v in params.items()}, (one,), FREE, 1e-2)
    built = model.build(problem, (one,))
    return built, finish(built, np.full(2, 0.51), np.full(2, 0.51))


def deviations(built, end):
    """How far off the truth, in the middle of the box, estimates are, in deviations."""
    sigma = np.sqrt(np.diag(fit_tests.spread(end, COUNT, [], "linear").covariance))
    return np.abs(end.point - 0.5) / sigma


@pytest.mark.slow
def test_a_coarse_solver_that_moves_the_estimates_is_tightened(coarse):
    built, end = coarse
    errors = integration.errors(built, end.point, end.residuals)
    first = fit_tests.shift(errors, end.jacobian)
    # The record has no noise: all that an estimate is off by is the solver's.
    assert deviations(built, end).max() > 1.0
    assert not fit_tests.integration_test(errors, end.jacobian).passed
    found = corrected(built, end, errors)
    assert deviations(found.model, found.end).max() < LITTLE
    assert fit_tests.integration_test(found.errors, found.end.jacobian).value < LITTLE
    assert float(found.model.how.tolerance) < float(built.how.tolerance) / 50.0
    assert len(found.notes) == 1 and f"{first:.2g} of their deviation" in found.notes[0]
    assert "tighter" in found.notes[0]


@pytest.mark.slow
def test_a_solver_that_is_good_enough_is_left_as_it_is(coarse):
    built, end = coarse
    errors = np.zeros(end.residuals.size)
    found = corrected(built, end, errors)
    assert found.model is built and found.end is end and found.errors is errors and not found.notes
    # Nor where nothing is known of it: the test of the fit says that.
    unknown = corrected(built, end, errors + np.nan)
    assert unknown.model is built and unknown.end is end and not unknown.notes


@pytest.mark.slow
def test_the_joint_with_all_options_runs_at_the_accuracy_asked_for_next():
    """Steps that BDF chooses for the tangents, too, are many at loose tolerances, and a fit's budget is enough for them."""
    scene = scenes.make("joint", unequal=True, **dict.fromkeys(PLAIN, True))
    truth = {name: float(v) for name, v in scene.parameters(smoothing=30e-6).items()}
    times = np.linspace(0.0, 0.3, 31)
    record = Experiment("a", times, (Channel("seat_cage.normal", np.zeros(31), 1.0),))
    free = tuple(Free(name, truth[name] / 3, truth[name] * 3) for name in ("stiffness", "clearance_cage_ball"))
    problem = Problem(scene, truth, (record,), free, 3e-4)
    built = model.build(problem, (record,))
    at = built.point(np.array([truth[axis.name] for axis in built.coordinates]))
    residuals, jacobian = model.residuals_and_jacobian(built, at)
    assert built.how.tangents and np.isfinite(residuals).all() and np.isfinite(jacobian).all()
