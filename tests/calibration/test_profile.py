"""Profile likelihood against closed forms and against SciPy minimising the same cost with the parameter held."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares, minimize_scalar

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.diagnostics import fit_tests
from calibration.report import plots_uncertainty
from calibration.uncertainty import intervals, posterior, profile
from calibration.uncertainty.estimates import Estimates

NORMAL = 1.959963984540054
THRESHOLD = NORMAL**2
MASS, SPEED, SIGMA = 0.1, 1.0, 4.34
TIMES = np.linspace(0.0, 9e-4, 40)


def impact(free) -> Problem:
    """A record of F = 1e8 d^1.5 by DOP853 with noise of 1 % of the peak."""
    motion = lambda _, s: (s[1], -1e8 * max(s[0], 0.0) ** 1.5 / MASS)  # noqa: E731
    run = solve_ivp(motion, (0, TIMES[-1]), (0.0, SPEED), "DOP853", TIMES, rtol=1e-11, atol=1e-15, max_step=1e-5)
    force = 1e8 * np.maximum(run.y[0], 0.0) ** 1.5
    noisy = force + SIGMA * np.random.default_rng(5).standard_normal(TIMES.size)
    scene = scenes.impact(smoothing=False)
    known = {"mass": MASS, "approach_speed": SPEED, "stiffness": 1e8, "exponent": 1.5, "damping": 0.0}
    params = {k: float(v) for k, v in scene.parameters(**known).items()}
    return Problem(scene, params, (Experiment("a", TIMES, (Channel("contact.normal", noisy, SIGMA),)),), free)


def analytic(function, jacobian):
    """Batched residuals and Jacobians of functions of one point."""

    def both(points):
        return np.stack([function(u) for u in points]), np.stack([jacobian(u) for u in points])

    return both


def found_by(residuals, targets, best, **more):
    """Profiles with the threshold of stated noise."""
    every = [profile.Asked(name, k, THRESHOLD, residuals, best, *scale) for name, k, *scale in targets]
    return profile.profiles(every, **more)


def box(count):
    return [(f"u{i}", i) for i in range(count)]


def test_linear_problem_has_the_covariance_interval():
    rng = np.random.default_rng(3)
    matrix, best = 40 * rng.standard_normal((30, 3)), np.array([0.4, 0.5, 0.55])
    noise = rng.standard_normal(30)
    noise -= matrix @ np.linalg.lstsq(matrix, noise)[0]  # the optimum is exactly there
    both = analytic(lambda u: matrix @ (u - best) + noise, lambda u: matrix)
    found = found_by(both, box(3), best, labels=("u0", "u1", "u2"))
    half = NORMAL * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    for p, centre, h in zip(found, best, half, strict=True):
        assert p.shape == "bounded" and not p.notes
        assert p.interval == pytest.approx((centre - h, centre + h), abs=1e-9)
        assert p.quadratic == pytest.approx(p.interval, abs=1e-9)
        # The profile of a quadratic is a parabola.
        assert p.rises == pytest.approx(THRESHOLD * ((p.values - centre) / h) ** 2, abs=1e-6)


def test_profiles_drawn_at_once_are_those_drawn_one_after_the_other():
    matrix, best = np.diag([30.0, 40.0, 50.0]), np.full(3, 0.5)
    both = analytic(lambda u: matrix @ (u - best), lambda u: matrix)
    alone = found_by(both, box(3), best, labels=("u0", "u1", "u2"))
    at_once = found_by(both, box(3), best, labels=("u0", "u1", "u2"), at_once=True)
    assert [p.interval for p in at_once] == [p.interval for p in alone]


DEPTH = np.linspace(5e-5, 3e-4, 12)
LOG_REFERENCE = np.log(2e-4)


def power_law(log_k, n):
    """Residuals of F = K d^n in units of 3 % of the largest force, for data with noise of that size."""
    truth = 2e9 * DEPTH**1.5
    sigma = 0.03 * truth.max()
    data = truth + sigma * np.random.default_rng(0).standard_normal(DEPTH.size)
    return (np.exp(log_k + n * np.log(DEPTH)) - data) / sigma, np.exp(log_k + n * np.log(DEPTH)) / sigma


def profiled(target, end, sign, best_cost, bounds):
    """Where SciPy's minimum over the other parameter rises to the threshold."""
    rise = lambda c: minimize_scalar(lambda o: target(c, o), bounds=bounds(c), options={"xatol": 1e-12}).fun - best_cost  # noqa: E731
    return brentq(lambda c: rise(c) - THRESHOLD, end - sign * 0.02 * abs(end), end + sign * 0.02 * abs(end), xtol=1e-9)


def test_derived_stiffness_follows_its_own_profile():
    """Searched as (ln F, n) with F at a depth of 1 m, which is K: SciPy on (ln K, n) directly."""
    lower, width = np.array([np.log(1e7), 1.0]), np.array([np.log(1e5), 1.5])

    def split(u):
        return power_law(*(lower + u * width))

    def jacobian(u):
        _, force = split(u)
        return np.stack([force, force * np.log(DEPTH)], axis=1) * width

    best = least_squares(lambda u: split(u)[0], [0.46, 0.33], jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    cost = float(np.sum(split(best)[0] ** 2))
    stiffness, exponent = ("stiffness", 0, lower[0], width[0], True), ("n", 1, lower[1], width[1])
    both = analytic(lambda u: split(u)[0], jacobian)
    k, n = found_by(both, [stiffness, exponent], best, labels=("K", "n"))
    assert (k.shape, n.shape) == ("bounded", "bounded")
    width_k = np.log(k.interval[1] / k.interval[0])
    square = lambda log_k, n: float(np.sum(power_law(log_k, n)[0] ** 2))  # noqa: E731
    ridge = lambda log_k: (np.log(2e9) - log_k) / LOG_REFERENCE + 1.5  # noqa: E731
    for end, sign in zip(k.interval, (-1, 1), strict=True):
        expected = profiled(square, np.log(end), sign, cost, lambda c: (ridge(c) - 0.1, ridge(c) + 0.1))
        assert np.log(end) == pytest.approx(expected, abs=1e-5 * width_k)
    middle = lambda c: np.log(2e9) + (1.5 - c) * LOG_REFERENCE  # noqa: E731
    for end, sign in zip(n.interval, (-1, 1), strict=True):
        expected = profiled(lambda c, o: square(o, c), end, sign, cost, lambda c: (middle(c) - 0.5, middle(c) + 0.5))
        assert end == pytest.approx(expected, abs=1e-5 * (n.interval[1] - n.interval[0]))
    # The covariance's interval is not it: the threshold tells them apart.
    assert abs(np.log(k.interval[1] / k.quadratic[1])) > 1e-3


def test_banana_is_one_sided():
    """r = (20 (u1 - 0.4 - (u0 + 0.2)^2 / 2), 9 max(u0 - 0.3, 0)^2): over u1, the rise in u0 has a closed form."""
    curve = lambda u: np.array([20 * (u[1] - 0.4 - (u[0] + 0.2) ** 2 / 2), 9 * max(u[0] - 0.3, 0.0) ** 2])  # noqa: E731
    slope = lambda u: np.array([[-20 * (u[0] + 0.2), 20.0], [18 * max(u[0] - 0.3, 0.0), 0.0]])  # noqa: E731
    best = np.array([0.25, 0.4 + 0.45**2 / 2])
    u0, u1 = found_by(analytic(curve, slope), box(2), best, labels=("u0", "u1"))
    assert u0.shape == "one-sided" and u0.interval is None
    assert u0.ends[0] is None and u0.notes == ("below u0: it reaches its bound",)
    assert u0.ends[1] == pytest.approx(0.3 + np.sqrt(np.sqrt(THRESHOLD) / 9), abs=1e-5)
    # A quantity that ends there by nature has an interval up to it.
    (closed,) = found_by(analytic(curve, slope), [("u0", 0, 0.0, 1.0, False, True)], best, labels=("u0", "u1"))
    assert closed.shape == "bounded" and closed.interval == (0.0, u0.ends[1]) and not closed.notes
    # Downwards u0 follows to its bound and stays there, so that 20 (0.42 - u1) = 1.96; upwards along the banana.
    assert u1.shape == "bounded"
    assert u1.ends[0] == pytest.approx(0.42 - NORMAL / 20, abs=1e-5)
    assert u1.notes == ("the lower end of u1 rests on the bound of u0",)
    assert u1.ends[1] == pytest.approx(expected_upper(curve), abs=1e-5)


def expected_upper(curve) -> float:
    """Where SciPy's minimum over u0 rises to the threshold as u1 goes up."""

    def smallest(u1):
        return minimize_scalar(lambda u0: sum(curve((u0, u1)) ** 2), (0, 1), (0, 1), options={"xatol": 1e-10}).fun

    return brentq(lambda u1: smallest(u1) - THRESHOLD, 0.6, 1.0)


def test_flat_and_multimodal_have_no_interval():
    flat = analytic(lambda u: np.array([10 * (u[1] - 0.5)]), lambda u: np.array([[0.0, 10.0]]))
    idle, known = found_by(flat, box(2), np.full(2, 0.5), labels=("u0", "u1"))
    assert (idle.shape, idle.ends, known.shape) == ("flat", (None, None), "bounded")
    # Two optima of one cost, a fifth apart, with a ridge between them.
    wave = analytic(
        lambda u: np.array([6 * np.sin(5 * np.pi * (u[0] - 0.5))]),
        lambda u: np.array([[30 * np.pi * np.cos(5 * np.pi * (u[0] - 0.5))]]),
    )
    (twin,) = found_by(wave, box(1), np.array([0.5]), labels=("u0",), scouts=5)
    assert twin.shape == "multimodal" and twin.interval is None
    assert "the data fit as well near" in " ".join(twin.notes)


def test_a_better_optimum_is_said():
    # Between 0.5, where a start might stop, and 0.7 the cost falls again.
    function = lambda u: np.array([2 + np.cos(10 * np.pi * u[0]) * 0.3 - 6 * max(u[0] - 0.5, 0.0)])  # noqa: E731
    slope = lambda u: np.array([[-3 * np.pi * np.sin(10 * np.pi * u[0]) - 6 * (u[0] > 0.5)]])  # noqa: E731
    (found,) = found_by(analytic(function, slope), box(1), np.array([0.5]), labels=("u0",))
    assert found.shape == "multimodal" and found.interval is None
    assert "a better optimum" in " ".join(found.notes)


def test_failed_simulations_leave_the_side_open():
    def function(u):
        return np.array([5 * (u[0] - 0.5)]) if u[0] < 0.6 else np.array([np.nan])

    both = analytic(function, lambda u: np.array([[5.0]]))
    (found,) = found_by(both, box(1), np.array([0.5]), labels=("u0",))
    assert found.shape == "one-sided"
    assert found.ends == (pytest.approx(0.5 - NORMAL / 5, abs=1e-9), None)
    assert "no simulation succeeds" in found.notes[0] and found.values[-1] < 0.6


def test_an_end_that_rests_on_another_bound_is_said():
    # u1 would have to leave its box to follow u0.
    matrix = np.array([[30.0, -30.0], [3.0, 3.0]])
    both = analytic(lambda u: matrix @ (u - np.array([0.5, 0.9])), lambda u: matrix)
    u0, _ = found_by(both, box(2), np.array([0.5, 0.9]), labels=("u0", "u1"))
    assert u0.notes == ("the upper end of u0 rests on the bound of u1",)
    # With u1 = 1 held: |30 (d - 0.1), 3 (d + 0.1)|^2 = threshold.
    rise = lambda d: 900 * (d - 0.1) ** 2 + 9 * (d + 0.1) ** 2 - THRESHOLD  # noqa: E731
    assert u0.ends[1] == pytest.approx(0.5 + brentq(rise, 0.1, 0.5), abs=1e-6)


@pytest.fixture(scope="module")
def profiled_fit():
    return fit(impact((Free("stiffness", 1e7, 1e9), Free("exponent", 1.2, 1.8))), starts=4, intervals="profile")


@pytest.mark.slow
def test_fit_states_profiles_as_the_kind_of_its_intervals(profiled_fit):
    assert profiled_fit.verdict == "identified", profiled_fit.reasons
    found = profiled_fit.evidence.profiles
    assert found.keys() == {"stiffness", "exponent", "reference_force"}
    for name, p in profiled_fit.parameters.items():
        noise = p.intervals["noise"]
        assert p.interval_kind == "profile" and noise == found[name].interval
        # Noise of 1 %: nearly linear, so the covariance is right to a few hundredths of its half-width, and no better.
        half = (noise[1] - noise[0]) / 2
        assert noise == pytest.approx(found[name].quadratic, abs=0.05 * half)
        assert noise != pytest.approx(found[name].quadratic, abs=1e-6 * half)
    assert profiled_fit.reference.noise == found["reference_force"].interval


@pytest.mark.slow
def test_bent_interval_gives_way_to_its_profile(profiled_fit):
    at = profiled_fit.optimum
    before = [fit_tests.curvature_test("stiffness", 1.1), fit_tests.curvature_test("exponent", 5.0)]
    known = Estimates(profiled_fit.every, before)
    (parameters, tests), evidence = intervals.revised("covariance", at, known, 0)
    assert evidence.profiles.keys() == {"exponent"}
    noise = profiled_fit.parameters["exponent"].intervals["noise"]
    assert parameters["exponent"].ci95 == pytest.approx(noise, rel=1e-6)
    assert (
        parameters["stiffness"] is profiled_fit.parameters["stiffness"]
        and parameters["reference force"] is profiled_fit.reference
    )
    assert [(t.name, t.passed) for t in tests] == [("interval of stiffness", True), ("exponent determined", True)]


@pytest.mark.slow
def test_posterior_of_a_well_conditioned_fit_has_the_covariance_s_intervals(profiled_fit):
    pytest.importorskip("numpyro", reason="NumPyro is the extra uq")
    drawn = posterior.of_optimum(profiled_fit.optimum, posterior.Chains())
    assert not drawn.refusal, drawn.refusal
    for name, found in profiled_fit.evidence.profiles.items():
        low, high = found.quadratic
        # Four deviations of a quantile from 2000 draws, and what the profile itself differs.
        assert drawn.intervals[name] == pytest.approx((low, high), abs=0.15 * (high - low) / 2)


def test_unknown_kind_of_interval_is_refused():
    with pytest.raises(InputError, match="use one of covariance, profile, posterior"):
        fit(impact((Free("exponent", 1.2, 1.8),)), intervals="bootstrap")


@pytest.mark.slow
def test_pictures_are_those_there_is_something_for(profiled_fit, tmp_path):
    plots_uncertainty.draw(profiled_fit, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"profile.png", "correlation.png", "residual_acf.png"}


def test_withheld_profiles_keep_their_shape_and_no_interval():
    linear = analytic(lambda u: 30 * (u - 0.5), lambda u: np.array([[30.0]]))
    (found,) = found_by(linear, box(1), np.array([0.5]), labels=("u0",))
    bare = intervals.Evidence({"u0": found}).withheld("misfit").profiles["u0"]
    assert found.interval and bare.interval is None and bare.shape == "bounded"


def test_autocorrelation_of_a_first_order_process():
    # Of x_i = 0.6 x_(i-1) + w_i it is 0.6^k, known from 20 000 samples to some 0.01.
    noise, x = np.random.default_rng(0).standard_normal(20_000), np.zeros(20_000)
    for i in range(1, x.size):
        x[i] = 0.6 * x[i - 1] + noise[i]
    assert plots_uncertainty.autocorrelation(x, 4) == pytest.approx(0.6 ** np.arange(1, 5), abs=0.04)
