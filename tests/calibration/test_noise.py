"""Noise found in residuals: closed forms, SciPy, and levels and coverage by simulation of linear models."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from scipy import stats
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.optimize import minimize

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem
from calibration.diagnostics import fit_tests
from calibration.diagnostics.residual_tests import Series, correlation_of, residual_tests
from calibration.forward import model
from calibration.forward.coordinates import Coordinate
from calibration.forward.integration import Limit, errors
from calibration.forward.losses import influence, loss_of, straightened
from calibration.noise import estimation, noise_model
from calibration.noise.estimation import settle
from calibration.noise.scatter import scatter
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
    return np.asarray(model.predictions(built, jnp.array([0.5, 0.5])))[0, 0]


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
    ends = (finish(built, start, start),)
    settled, ends, found = settle(built, records, ends, problem.accuracy)
    spread = fit_tests.spread(ends[0], sum(r.samples for r in records), found.moved, loss)
    return settled, ends[0], found, spread


# Shared by records of one problem: a gain is a nuisance and so each record's own, the mass is not.
SHARED = (Free("mass", 0.05, 0.2),)


@pytest.mark.slow
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


def in_flight(flight: float, after: float, rows: int = 12) -> tuple[np.ndarray, float]:
    """Rows before the first contact, and their deviation's share, of three places that fall with these deviations."""
    rng, own = np.random.default_rng(5), ("body.z", "body.vz", "position_offset")
    axes = [
        Coordinate("stiffness", None, True, 0.0, 1.0),
        *(Coordinate(n, k, False, 0.0, 1.0) for k in range(3) for n in own),
    ]
    scene: Any = SimpleNamespace(coordinates=tuple(axes))
    series, masks, clock = [], [], np.linspace(0.0, 1.0, 40)
    for k in range(3):
        jacobian = np.zeros((clock.size, len(axes)))
        jacobian[:, 1 + 3 * k : 4 + 3 * k] = np.stack([1.0 + 0.0 * clock, clock, 1.0 + 0.0 * clock], axis=1)
        jacobian[rows:, 0] = clock[rows:]
        # A first state that is off counts as no noise.
        error = 30.0 + 50.0 * clock + np.where(np.arange(40) < rows, flight, after) * rng.standard_normal(40)
        error[rows:] -= 30.0 + 50.0 * clock[rows:]
        channel = Channel("body.place.z", np.ones(40), None)
        series.append(noise_model._Series((k, 0), channel, np.arange(40), np.diff(clock), error, jacobian, np.ones(40)))
        masks.append(noise_model._flying(scene, jacobian))
    return np.array(masks), noise_model._in_flight(series, masks)


def test_what_a_law_misses_says_nothing_of_the_noise_in_flight():
    """Flight weighs by its own scatter, where that is clearly less than what is left after contact."""
    masks, share = in_flight(flight=0.1, after=2.0)
    assert np.array_equal(masks, np.arange(40) < np.full((3, 1), 12))
    assert share == pytest.approx(0.05, rel=0.35)
    assert in_flight(flight=0.1, after=0.2)[1] == 1.0
    # Too few to tell: two rows more than the numbers of a first state, or a place's offset that alone moves them.
    assert in_flight(flight=0.1, after=2.0, rows=4)[1] == 1.0
    known: Any = SimpleNamespace(coordinates=(Coordinate("position_offset", 0, False, 0.0, 1.0),))
    assert not noise_model._flying(known, np.ones((40, 1))).any()


@pytest.mark.slow
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


def restricted(force, readings):
    """Of the logarithms of deviation and correlation time: - ln of the restricted likelihood, by dense matrices."""
    design = np.stack([force, np.ones(COUNT)], axis=1)
    lags = toeplitz(TIMES - TIMES[0])

    def parts(x):
        return np.exp(2.0 * x[0] - lags / np.exp(x[1]))

    def cost(x):
        inverse = np.linalg.inv(parts(x))
        information = design.T @ inverse @ design
        left = readings - design @ np.linalg.solve(information, design.T @ inverse @ readings)
        sizes = np.linalg.slogdet(parts(x))[1] + np.linalg.slogdet(information)[1]
        return 0.5 * float(sizes + left @ inverse @ left)

    return cost, parts, design


@pytest.mark.parametrize("sigma", [None, 2.0])
def test_memory_of_the_noise_is_that_of_the_restricted_likelihood(force, sigma):
    """Deviation and correlation time by a search over dense matrices; their doubt by the information about them."""
    step = TIMES[1] - TIMES[0]
    readings = force + 2.0 * autoregression(0.6, np.random.default_rng(11))
    settled, _, found, _ = solved(Channel("contact.normal", readings, sigma, correlation=None))
    cost, parts, design = restricted(force, readings)
    free = np.array([True, True]) if sigma is None else np.array([False, True])
    start = np.log([2.0, 2.0 * step])
    whole = lambda x: cost(np.where(free, np.insert(x, 0, 0.0)[-2:], start))  # noqa: E731
    best = minimize(whole, start[free], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}).x
    best = np.where(free, np.insert(best, 0, 0.0)[-2:], start)
    time = found.correlation["contact.normal"]
    assert time == pytest.approx(np.exp(best[1]), rel=1e-3)
    if sigma is None:
        assert found.sigma["contact.normal"] == pytest.approx(np.exp(best[0]), rel=1e-3)
    assert np.asarray(settled.data.weights)[0, 0] == pytest.approx(np.exp(-best[0]), rel=1e-3)
    memory = np.asarray(settled.data.memory)[0, 0]
    assert memory[0] == 0.0 and memory[1:] == pytest.approx(np.exp(-step / time), rel=1e-9)
    # What is expected of the information about both logarithms, 1/2 tr(P dV P dV), P what the fit leaves of V^-1.
    inverse = np.linalg.inv(parts(best))
    fitted = inverse @ design @ np.linalg.solve(design.T @ inverse @ design, design.T @ inverse)
    left, slopes = inverse - fitted, [2.0 * parts(best), parts(best) * toeplitz(TIMES) / np.exp(best[1])]
    information = np.array([[0.5 * np.trace(left @ a @ left @ b) for b in slopes] for a in slopes])
    doubt = np.linalg.inv(information)[1, 1] if sigma is None else 1.0 / information[1, 1]
    *others, (change, variance) = found.moved
    # Of 80 samples; the code has the formulas of many.
    assert variance == pytest.approx(doubt, rel=0.2)
    # How the information about gain and offset follows, an estimated deviation keeping that of the innovations.
    box = np.array([1.0, 200.0])

    def known(x):
        kept = (1.0 - np.exp(-2.0 * step / np.exp(x))) / (1.0 - np.exp(-2.0 * step / time)) if sigma is None else 1.0
        return np.outer(box, box) * (design.T @ np.linalg.solve(parts([best[0], x]), design)) * kept

    wanted = (known(best[1] + 1e-4) - known(best[1] - 1e-4)) / 2e-4
    np.testing.assert_allclose(change, wanted, rtol=0.02, atol=1e-3 * np.abs(wanted).max())
    assert len(others) == (sigma is None)
    for change, variance in others:
        np.testing.assert_allclose(change, -2.0 * known(best[1]), rtol=2e-3)
        assert variance == pytest.approx(0.5 / (COUNT - 2), rel=1e-9)


def test_errors_freed_of_their_memory_are_white():
    """Solved with the Cholesky factor of the covariance, samples at uneven times."""
    rng = np.random.default_rng(12)
    clock, weights = np.cumsum(rng.uniform(0.1, 2.0, 30)), rng.uniform(0.5, 2.0, 30)
    errors, rows = rng.standard_normal((30, 3)), np.arange(30)
    covariance = np.exp(-np.abs(clock[:, None] - clock) / 0.8) / np.outer(weights, weights)
    series = Series(rows, rows >= 0, 1.0, memory=0.8, clock=clock, weights=weights)
    for some in (errors, errors[:, 0]):
        wanted = solve_triangular(cholesky(covariance, lower=True), some, lower=True)
        np.testing.assert_allclose(series.white(some), wanted, rtol=1e-9, atol=1e-12)
    white = series._replace(memory=0.0).white(errors)
    np.testing.assert_allclose(white, weights[:, None] * errors, rtol=1e-15)


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


@pytest.mark.parametrize(("count", "lags"), [tiers.slow((25, (2, 3, 4))), (350, (1,))], ids=["few", "many"])
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
    quality = fit_tests.Spread(covariance, 10, np.zeros(2), 1.0)
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


def test_scatter_is_the_deviation_of_white_noise_on_a_smooth_signal():
    rng, t = np.random.default_rng(13), np.linspace(0.0, 1.0, 4000)
    values = 1e3 * t**2 + 2.0 * rng.standard_normal(4000)
    assert scatter(values) == pytest.approx(2.0, rel=0.06)
    values[::40] += 100.0
    assert scatter(values) == pytest.approx(2.0, rel=0.25)
    assert scatter(values[:11]) == 0.0 < scatter(values[:12])


def test_records_have_their_own_deviations_where_these_clearly_differ():
    """By a factor of three, of errors that are scatter; else none is told from the others."""
    rng, slow = np.random.default_rng(14), np.sin(np.linspace(0.0, 6.0, 2000))
    one, two, ten = (k * rng.standard_normal(2000) for k in (1.0, 2.0, 10.0))
    assert noise_model._ratios([one, ten]) == pytest.approx(10.0 ** np.array([-0.5, 0.5]), rel=0.08)
    assert noise_model._ratios([two, one, ten]) == pytest.approx(np.array([2.0, 1.0, 10.0]) / 20 ** (1 / 3), rel=0.08)
    assert noise_model._ratios([ten, one, 3.0 * slow + one]) == pytest.approx(
        10.0 ** (np.array([2.0, -1.0, -1.0]) / 3.0), rel=0.08
    )
    for others in ([one, two], [one, ten, 10.0 * slow + one], [0.0 * one, ten]):
        assert np.array_equal(noise_model._ratios(others), np.ones(len(others)))


def record(
    k: int, name: str, error: np.ndarray, design: np.ndarray, sigma=None, correlation: float | None = 0.0
) -> Any:
    channel = SimpleNamespace(observes=name, sigma=sigma, correlation=correlation)
    count = error.size
    deviation = np.full(count, sigma or 1.0)
    return noise_model._Series((k, 0), channel, np.arange(count), np.ones(count - 1), error, design, deviation)


def test_deviations_are_at_their_common_fixed_point():
    """Each channel's square over its freedom, by weighted least squares over all; below the integrator's, that one's."""
    rng = np.random.default_rng(15)
    designs = [rng.standard_normal((n, 2)) + 1.0 for n in (12, 9, 30)]
    sizes = (3.0, 0.2, 1.0)
    series = [
        record(k, name, size * rng.standard_normal(len(x)), x, 1.0 if name == "c" else None)
        for k, (name, size, x) in enumerate(zip("abc", sizes, designs, strict=True))
    ]
    rest = (np.zeros(0), np.zeros((0, 2)))
    start = {"a": 1.0, "b": 1.0}
    for limits in ({}, {"b": Limit(5.0, 10.0)}):
        found, rows = noise_model._converged(series, rest, start, {}, False, limits)
        deviations = np.repeat([found["a"], found["b"], 1.0], [12, 9, 30])
        white = np.concatenate(designs) / deviations[:, None]
        hat = white @ np.linalg.inv(white.T @ white) @ white.T
        error = np.concatenate([s.error for s in series]) / deviations
        left = error - hat @ error
        np.testing.assert_allclose(rows.residual, error, rtol=1e-12)
        parts = {"a": slice(0, 12), "b": slice(12, 21)}
        for name in ("a",) if limits else ("a", "b"):
            freedom = parts[name].stop - parts[name].start - np.trace(hat[parts[name], parts[name]])
            assert np.sum(left[parts[name]] ** 2) == pytest.approx(freedom, rel=1e-8)
    assert found["b"] == 10.0


def test_a_correlation_time_is_between_the_finest_step_and_the_longest_record(monkeypatch):
    """One long record, one of three samples, and one of samples so far apart that they know nothing of each other."""
    rng = np.random.default_rng(16)
    errors = autoregression(0.9, rng, 1500), autoregression(0.9, rng, 3), rng.standard_normal(3)
    series = [record(k, "f", x, np.ones((x.size, 1)), correlation=None) for k, x in enumerate(errors)]
    series[2] = series[2]._replace(gaps=np.full(2, 60.0))
    rest = (np.zeros(0), np.zeros((0, 1)))
    monkeypatch.setattr(noise_model, "_series", lambda *_: (series, rest))
    monkeypatch.setattr(noise_model, "_reweighed", lambda model, *_: model)
    model: Any = SimpleNamespace(loss="linear")
    _, found = noise_model.estimate(model, (), np.zeros(1))
    # The deviation of phi is sqrt(0.19/1500) = 0.011, of the deviation 8 %.
    assert np.exp(-1.0 / found.correlation["f"]) == pytest.approx(0.9, abs=0.035)
    assert found.sigma["f"] == pytest.approx(1.0, rel=0.25)


def weighed(weights, memory=(0.0, 0.0, 0.0), loss: str = "linear") -> Any:
    data = SimpleNamespace(weights=np.array([*weights, 0.0]), memory=np.array([*memory, 0.0]))
    return SimpleNamespace(data=data, loss=loss, observed_features=())


def test_what_changes_of_the_noise_is_a_share_of_a_weight_or_a_memory():
    plain, half = weighed((1.0, 2.0, 4.0)), weighed((0.5, 1.0, 2.0))
    assert estimation._change(plain, half) == pytest.approx(0.5)
    assert estimation._change(half, weighed((0.5, 1.5, 2.0))) == pytest.approx(0.5)
    assert estimation._change(plain, weighed((1.0, 2.0, 4.0), (0.0, 0.7, 0.2))) == pytest.approx(0.7)
    assert estimation._factor(plain, half) == 0.5 and estimation._factor(half, plain) == 2.0
    others = (
        weighed((0.5, 1.0, 2.1)),
        weighed((0.5, 1.0, 2.0), (0.0, 0.1, 0.1)),
        weighed((0.5, 1.0, 2.0), loss="cauchy"),
    )
    assert [estimation._factor(plain, other) for other in others] == [None] * 3


def test_ends_follow_the_refined_one_beside_them():
    """Where one factor is on all residuals, no optimum moves: costs alone do."""
    refined = End(np.zeros(2), np.full(2, 0.5), 8.0, np.array([2.0, 2.0]), np.eye(2), True)
    none = np.zeros((0, 2))
    beside, apart = (End(np.zeros(2), np.full(2, 0.5 + d), 9.0, none[:, 0], none, True) for d in (5e-4, 2e-3))
    stopped, failed = replace(beside, converged=False, cost=1.0), replace(beside, failure="no", cost=0.1)
    ends = (refined, beside, apart, stopped, failed)
    moved = list(estimation._all_moved(weighed((1.0, 1.0, 1.0)), ends, 3.0))
    assert [end.cost for end in moved] == pytest.approx([72.0, 72.0, 81.0, 9.0, 0.1])
    assert np.array_equal(moved[0].residuals, [6.0, 6.0]) and np.array_equal(moved[0].jacobian, 3.0 * np.eye(2))
    assert np.array_equal(moved[1].point, refined.point) and np.array_equal(moved[2].point, apart.point)
    # The failed one last, whatever its cost.
    last = estimation._ordered(weighed((1.0, 1.0, 1.0)), [failed, replace(apart, cost=99.0), refined])
    assert [end.cost for end in last] == [8.0, 99.0, 0.1]


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
@pytest.mark.parametrize("accuracy", tiers.ci([4e-4, 1e-7]))
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
    settled, ends, found = settle(built, (one,), (finish(built, at + 0.01, at + 0.01),), accuracy)
    assert found.integrator == ("contact.normal",) and not found.moved
    floor = found.sigma["contact.normal"]
    # The error itself, known here: what is left at the truth.
    left = np.asarray(model.predictions(built, jnp.asarray(at)))[0, 0] - 100.0 * np.sin(omega * times)
    assert floor >= max(3.0 * np.linalg.norm(left), 0.99e-5 * 100.0)
    spread = fit_tests.spread(ends[0], COUNT, found.moved, "linear")
    for k, unit in enumerate(np.eye(2)):
        assert abs(ends[0].point[k] - 0.5) < spread.half_width(unit)
    error = errors(settled, ends[0].point, ends[0].residuals)
    assert np.linalg.norm(error) < 0.5 and fit_tests.integration_test(error, ends[0].jacobian).passed
    # Taken for noise, it would be seen not to be white.
    series = Series(np.arange(COUNT), np.ones(COUNT, dtype=bool), 0.01, estimated=True)
    scaled = ends[0].residuals / np.std(ends[0].residuals)
    for own in (False, True):
        tests = residual_tests([series._replace(integrator=own)], scaled, ends[0].jacobian, False)
        assert all(t.passed for t in tests) == own
