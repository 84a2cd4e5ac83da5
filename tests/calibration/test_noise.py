"""Noise found in residuals: closed forms, SciPy, and levels and coverage by simulation of linear models."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.linalg import cholesky, toeplitz

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem
from calibration.diagnostics import fit_tests
from calibration.diagnostics.residual_tests import Series, correlation_of, residual_tests
from calibration.forward import model
from calibration.forward.integration import errors
from calibration.forward.losses import influence, loss_of, straightened
from calibration.noise import noise_model
from calibration.noise.estimation import settle
from calibration.search.refinement import End, finish

pytestmark = pytest.mark.filterwarnings("error")

COUNT = 80
TIMES = np.linspace(0.0, 0.9e-3, COUNT)
SCENE = scenes.impact(smoothing=False)
PARAMS = {k: float(v) for k, v in SCENE.parameters(mass=0.1, approach_speed=1.0, stiffness=1e8).items()}


def history() -> np.ndarray:
    """Force of the impact at TIMES; what follows is linear in a gain and an offset, so least squares are exact."""
    one = Experiment("a", TIMES, (Channel("contact.normal", np.ones(COUNT), 1.0),))
    problem = Problem(SCENE, PARAMS, (one,), FREE)
    built = model.build(problem, (one,))
    return np.asarray(model.predictions(built, jnp.array([0.5, 0.5]), jnp.asarray(0.0)))[0, 0]


FREE = (Free("gain", 0.5, 1.5, scale="linear"), Free("force_offset", -100.0, 100.0))


@pytest.fixture(scope="module")
def force():
    return history()


def solved(*channels: Channel, loss: str = "linear"):
    """Settled fit from the truth, each channel a record of its own; the covariance by name of coordinate, SI."""
    records = tuple(Experiment(f"r{k}", TIMES, (c,)) for k, c in enumerate(channels))
    problem = Problem(SCENE, PARAMS, records, SHARED if len(records) > 1 else FREE, loss=loss)
    built = model.build(problem, records)
    start = np.full(len(built.coordinates), 0.5)
    ends = (finish(built, start, start, 0.0),)
    settled, ends, found = settle(built, records, ends, 0.0, problem.accuracy)
    spread = fit_tests.spread(ends[0], sum(r.samples for r in records), found.moved, loss)
    return settled, ends[0], found, spread


# Shared by records of one problem: a gain is a nuisance and so each record's own, the mass is not.
SHARED = (Free("mass", 0.05, 0.2),)


@pytest.mark.full
def test_one_estimated_deviation_is_cost_over_degrees_of_freedom(force):
    readings = force + 3.0 * np.random.default_rng(0).standard_normal(COUNT)
    _, end, found, spread = solved(Channel("contact.normal", readings, None))
    design = np.stack([force, np.ones(COUNT)], axis=1)
    coefficients, (square,), *_ = np.linalg.lstsq(design, readings, rcond=None)
    sigma = np.sqrt(square / (COUNT - 2))
    assert found.sigma["contact.normal"] == pytest.approx(sigma, rel=1e-6)
    assert 0.5 + end.point[0] == pytest.approx(coefficients[0], rel=1e-6)
    covariance = sigma**2 * np.linalg.inv(design.T @ design)
    half = stats.t.ppf(0.975, COUNT - 2) * np.sqrt(covariance[0, 0])
    assert spread.half_width(np.array([1.0, 0.0])) == pytest.approx(half, rel=1e-6)


@pytest.mark.slow
def test_stated_and_estimated_noise_mix(force):
    """Two records of one parameter, one ten times as noisy and not told so: each deviation is its own record's."""
    rng = np.random.default_rng(1)
    quiet, loud = force + 1.0 * rng.standard_normal(COUNT), force + 10.0 * rng.standard_normal(COUNT)
    stated, unknown = Channel("contact.normal", quiet, 1.0), Channel("contact.normal", loud, None)
    _, end, found, spread = solved(stated, unknown)
    # Of one parameter: leverage of the loud record is its share of the information, some 1 %.
    assert found.sigma["contact.normal"] == pytest.approx(10.0, rel=0.25)
    loud_rows = end.jacobian[COUNT : 2 * COUNT, 0] ** 2
    share = loud_rows.sum() / np.sum(end.jacobian[:, 0] ** 2)
    freedom = COUNT - share
    # Welch and Satterthwaite: the doubt is only in the loud record's part of the information.
    quantile = stats.t.ppf(0.975, freedom / share**2)
    assert spread.quantile_of(np.ones(1)) == pytest.approx(quantile, rel=1e-9)
    assert share < 0.05
    residual = end.residuals[COUNT : 2 * COUNT]
    assert np.sum(residual**2) == pytest.approx(freedom, rel=1e-3)


@pytest.mark.full
def test_noise_that_grows_with_the_reading_weighs_the_model_not_the_data(force):
    """With weights from the data a gain is biased by -2 times the relative variance; from the model it is not."""
    rng = np.random.default_rng(2)
    gains = []
    for _ in range(30):
        readings = force * (1.0 + 0.2 * rng.standard_normal(COUNT)) + 1.0 * rng.standard_normal(COUNT)
        _, end, _, _ = solved(Channel("contact.normal", readings, 1.0, relative=0.2))
        gains.append(0.5 + end.point[0])
    error = np.std(gains) / np.sqrt(len(gains))
    assert abs(np.mean(gains) - 1.0) < 4.0 * error
    assert error < 0.01 < 0.2**2 / 2


def autoregression(memory: float, rng: np.random.Generator, count: int = COUNT) -> np.ndarray:
    """White noise through the Cholesky factor of the exact correlation matrix."""
    return cholesky(toeplitz(memory ** np.arange(count)), lower=True) @ rng.standard_normal(count)


def test_whitening_is_that_of_the_correlation_matrix(force):
    memory, sigma = 0.7, 2.0
    step = TIMES[1] - TIMES[0]
    readings = force + sigma * autoregression(memory, np.random.default_rng(3))
    channel = Channel("contact.normal", readings, sigma, correlation=-step / np.log(memory))
    _, end, _, spread = solved(channel)
    error = sigma**2 * toeplitz(memory ** np.arange(COUNT))
    design = np.stack([force, np.ones(COUNT)], axis=1)
    information = design.T @ np.linalg.solve(error, design)
    best = np.linalg.solve(information, design.T @ np.linalg.solve(error, readings))
    assert [0.5 + end.point[0], -100.0 + 200.0 * end.point[1]] == pytest.approx(best, rel=1e-5)
    covariance = np.linalg.inv(information) / np.outer([1.0, 200.0], [1.0, 200.0])
    np.testing.assert_allclose(spread.covariance, covariance, rtol=1e-6)


@pytest.mark.slow
def test_declared_correlation_keeps_its_coverage(force):
    """Memory 0.6 between samples, found with its deviation: 95 % intervals of the offset, where it matters most."""
    rng, inside, naive, misfits = np.random.default_rng(4), 0, 0, 0
    series = Series(np.arange(COUNT), np.ones(COUNT, dtype=bool), 0.01, declared=True, estimated=True)
    design = np.stack([force, np.ones(COUNT)], axis=1)
    plain = np.linalg.inv(design.T @ design)
    for _ in range(200):
        readings = force + 2.0 * autoregression(0.6, rng)
        _, end, _, spread = solved(Channel("contact.normal", readings, None, correlation=None))
        inside += abs(200.0 * end.point[1] - 100.0) < 200.0 * spread.half_width(np.array([0.0, 1.0]))
        misfits += not all(t.passed for t in residual_tests([series], end.residuals, end.jacobian, False))
        beta = plain @ design.T @ readings
        sigma = np.sqrt(np.sum((readings - design @ beta) ** 2) / (COUNT - 2))
        naive += abs(beta[1]) < stats.t.ppf(0.975, COUNT - 2) * sigma * np.sqrt(plain[1, 1])
    print("covered", inside, "as white", naive, "misfits", misfits)
    # Binomial(200, 0.95): below 181 has a chance of 0.005. Taken as white it is far below.
    assert inside >= 181
    assert naive < 165
    # Order, correlation and outliers: 7e-3 by their levels; above 6 of 200 has a chance of 1e-3.
    assert misfits <= 6


def test_correlation_that_is_not_declared_is_reported(force):
    readings = force + 2.0 * autoregression(0.6, np.random.default_rng(5))
    for declared in (0.0, None):
        _, end, found, _ = solved(Channel("contact.normal", readings, None, correlation=declared))
        series = Series(np.arange(COUNT), np.ones(COUNT, dtype=bool), 0.01, declared=declared is None, estimated=True)
        tests = residual_tests([series], end.residuals, end.jacobian, False)
        failed = [t for t in tests if not t.passed]
        assert bool(failed) == (declared == 0.0)
        if failed:
            assert "correlate by 0." in failed[0].reason and "the sensor has a memory" in failed[0].reason
        else:
            step = TIMES[1] - TIMES[0]
            assert np.exp(-step / found.correlation["contact.normal"]) == pytest.approx(0.6, abs=0.25)


@pytest.mark.parametrize(("count", "lags"), [(25, (2, 3, 4)), (350, (1,))], ids=["few", "many"])
def test_correlation_has_its_level(count, lags):
    """p-values of white noise after a fit of five smooth columns are uniform where it matters."""
    rng, t = np.random.default_rng(6), np.linspace(0.0, 1.0, count)
    basis = np.linalg.qr(np.stack([np.sin(np.pi * k * t) for k in range(1, 6)], axis=1))[0]
    first, second = (np.concatenate([np.arange(count - lag) + k * lag for lag in lags]) for k in (0, 1))
    rows = np.arange(count)
    found = []
    for _ in range(1000):
        e = rng.standard_normal(count)
        found.append(correlation_of(e - basis @ (basis.T @ e), basis, first, second, rows))
    chances = np.array([p for _, p in found])
    # Three standard deviations of a binomial's share.
    for level in (0.5, 0.05, 0.005):
        assert abs(np.mean(chances < level) - level) < 3.5 * np.sqrt(level * (1 - level) / 1000)
    assert abs(np.mean([c for c, _ in found])) < 0.05


def test_a_robust_loss_bears_outliers_and_says_so(force):
    rng = np.random.default_rng(7)
    readings = force + 3.0 * rng.standard_normal(COUNT)
    wrong = rng.choice(COUNT, 4, replace=False)
    readings[wrong] += 300.0
    results = {}
    for loss in ("linear", "soft_l1", "cauchy"):
        _, end, _, spread = solved(Channel("contact.normal", readings, 3.0), loss=loss)
        results[loss] = abs(end.point[1] - 0.5) / spread.half_width(np.array([0.0, 1.0]))
    # The mean of 4 outliers of 300 N among 80 samples is 15 N; the deviation of a mean is 0.3 N.
    assert results["linear"] > 10.0
    assert results["cauchy"] < 1.0 and results["soft_l1"] < 1.5


def test_robust_losses_are_scipys():
    from scipy.optimize import least_squares

    r = np.array([-3.0, -0.5, 1e-9, 0.2, 4.0])
    for loss in ("linear", "soft_l1", "cauchy"):
        theirs = least_squares(lambda x: r + 0 * x, [0.0], loss=loss, max_nfev=1)
        assert 0.5 * np.sum(loss_of(loss, r**2)[0]) == pytest.approx(theirs.cost, rel=1e-12)
        psi, bend = influence(loss, r)
        step = 1e-6
        ends = [0.5 * loss_of(loss, (r + s * step) ** 2)[0] for s in (-1, 1)]
        np.testing.assert_allclose(psi, (ends[1] - ends[0]) / (2 * step), atol=1e-8)
        slopes = [influence(loss, r + s * step)[0] for s in (-1, 1)]
        np.testing.assert_allclose(bend, (slopes[1] - slopes[0]) / (2 * step), atol=1e-8)
        straight, jacobian = straightened(loss, jnp.asarray(r), jnp.eye(5))
        np.testing.assert_allclose(np.sum(straight**2), 2.0 * theirs.cost, rtol=1e-9)
        np.testing.assert_allclose(np.asarray(jacobian.T @ straight), psi, rtol=1e-6, atol=1e-12)


def test_held_out_prediction_has_its_level():
    """A line through 12 points, held out far outside them: without the line's own error it fails most of the time."""
    rng, inside, outside = np.random.default_rng(8), np.linspace(0, 1, 12), np.linspace(5, 6, 12)
    design, far = (np.stack([np.ones(12), x], axis=1) for x in (inside, outside))
    covariance = np.linalg.inv(design.T @ design)
    quality = fit_tests.Spread(covariance, 1.96, 10, np.zeros(2), 1.0)
    failed = plain = 0
    for _ in range(2000):
        error = covariance @ design.T @ rng.standard_normal(12)
        r = far @ error - rng.standard_normal(12)
        push = far.T @ r
        square = r @ r - push @ np.linalg.solve(np.linalg.inv(covariance) + far.T @ far, push)
        failed += not fit_tests.held_out_test(float(square), 12, quality).passed
        plain += stats.chi2.sf(r @ r, 12) < fit_tests.LEVEL
    assert failed <= 8  # 1e-3 of 2000 is 2
    assert plain > 200


def bad(channel: Channel) -> str:
    with pytest.raises(InputError) as error:
        Problem(SCENE, PARAMS, (Experiment("a", TIMES, (channel,)),), FREE)
    return str(error.value)


def test_noise_that_makes_a_sample_exact_is_refused(force):
    assert "would be exact" in bad(Channel("contact.normal", force, 0.0, relative=0.02))
    assert "0.1 kN + 2 % of reading" in bad(Channel("contact.normal", force, 0.0, relative=0.02))
    assert "state both" in bad(Channel("contact.normal", force, None, relative=0.02))
    assert "correlation time of -1 s" in bad(Channel("contact.normal", force, 1.0, correlation=-1.0))


def test_spread_of_ends_needs_rank():
    end = End(np.zeros(2), np.zeros(2), 0.0, np.zeros(5), np.outer(np.arange(5.0), [1.0, 2.0]), True)
    spread = fit_tests.spread(end, 5, [], "linear")
    assert spread.covariance is None and spread.half_width(np.ones(2)) == np.inf
    assert not fit_tests.rank_test(spread).passed


def test_noise_is_known_where_all_is_stated(force):
    records = tuple(Experiment("a", TIMES, (Channel("contact.normal", force, 1.0, c),)) for c in (0.0, 0.1))
    assert noise_model.known(records[:1]) and not noise_model.known(records[1:])


@pytest.mark.full
@pytest.mark.parametrize("accuracy", [pytest.param(4e-4, marks=pytest.mark.slow), 1e-7])
def test_noise_below_the_integrators_error_is_the_integrators(accuracy):
    """A clean record of a linear contact, in closed form: what is left is no noise, and no interval rests on it."""
    scene, omega = scenes.impact(smoothing=False), np.sqrt(1e5 / 0.1)
    params = scene.parameters(mass=0.1, approach_speed=1.0, stiffness=1e5, exponent=1.0, damping=0.0)
    times = np.linspace(0.0, 0.99 * np.pi / omega, COUNT)
    one = Experiment("a", times, (Channel("contact.normal", 100.0 * np.sin(omega * times), None),))
    free = (Free("stiffness", 1e4, 1e6), Free("mass", 0.01, 1.0))
    problem = Problem(scene, {k: float(v) for k, v in params.items()}, (one,), free, accuracy)
    built = model.build(problem, (one,))
    at = np.full(2, 0.5)
    settled, ends, found = settle(built, (one,), (finish(built, at + 0.01, at + 0.01, 0.0),), 0.0, accuracy)
    assert found.integrator == ("contact.normal",) and not found.moved
    floor = found.sigma["contact.normal"]
    # The error itself, known here: what is left at the truth.
    left = np.asarray(model.predictions(built, jnp.asarray(at), jnp.asarray(0.0)))[0, 0] - 100.0 * np.sin(omega * times)
    assert floor >= max(3.0 * np.linalg.norm(left), 0.99e-5 * 100.0)
    spread = fit_tests.spread(ends[0], COUNT, found.moved, "linear")
    for k, unit in enumerate(np.eye(2)):
        assert abs(ends[0].point[k] - 0.5) < spread.half_width(unit)
    error = errors(settled, ends[0].point, 0.0, ends[0].residuals)
    assert np.linalg.norm(error) < 0.5 and fit_tests.integration_test(error, ends[0].jacobian).passed
    # Taken for noise, it would be seen not to be white.
    series = Series(np.arange(COUNT), np.ones(COUNT, dtype=bool), 0.01, estimated=True)
    scaled = ends[0].residuals / np.std(ends[0].residuals)
    for own in (False, True):
        tests = residual_tests([series._replace(integrator=own)], scaled, ends[0].jacobian, False)
        assert all(t.passed for t in tests) == own
