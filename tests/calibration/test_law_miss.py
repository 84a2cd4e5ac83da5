"""Intervals that allow for a law that misses, and for runs that differ: coverage on linear problems, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calibration.diagnostics import answers, fit_tests
from calibration.diagnostics.answers import Answer
from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.records import Record
from calibration.diagnostics.residual_tests import Series, overstated, residual_tests
from calibration.forward.coordinates import _logarithms, _reached
from calibration.search.refinement import End
from calibration.uncertainty import law_miss
from calibration.uncertainty.law_miss import clustered, discrepancy, neighbouring, shapes
from calibration.uncertainty.sets import QUANTILE

# One contact of 60 samples between 30 quiet ones on either side; peak 1, noise 0.002.
PHASE = np.linspace(0.0, 1.0, 60)
INSIDE = np.r_[np.zeros(30, bool), np.ones(60, bool), np.zeros(30, bool)]
CLOCK, SIGMA = np.arange(120.0), 2e-3
PULSE = np.r_[np.zeros(30), np.sin(np.pi * PHASE), np.zeros(30)]
# What a coefficient of size, one of shape and one of loss would change.
SLOPES = np.stack([PULSE, np.r_[np.zeros(30), np.sin(np.pi * PHASE) ** 2, np.zeros(30)], np.gradient(PULSE)], axis=1)


def noise_of(jacobian: np.ndarray) -> Spread:
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return Spread(covariance, len(jacobian) - jacobian.shape[1], np.zeros(jacobian.shape[1]), 1.0)


def series(values: np.ndarray, weights: np.ndarray, **more) -> Series:
    rows = np.arange(values.size)
    return Series(rows, INSIDE, SIGMA, estimated=True, clock=CLOCK, values=values, weights=weights, **more)


def process(rng: np.random.Generator, share: float, length: float) -> np.ndarray:
    """A draw of the squared-exponential process over the phase, by its Cholesky factor: not by the cosines of the code."""
    far = (PHASE[:, None] - PHASE) / length
    factor = np.linalg.cholesky(np.exp(-0.5 * far**2) + 1e-9 * np.eye(PHASE.size))
    return np.r_[np.zeros(30), share * factor @ rng.standard_normal(PHASE.size), np.zeros(30)]


def fitted(error: np.ndarray) -> tuple[np.ndarray, Spread, np.ndarray, np.ndarray]:
    """Least squares about the truth 0: estimate, spread by the noise that the residuals show, residuals, Jacobian."""
    at, *_ = np.linalg.lstsq(SLOPES, error, rcond=None)
    left = error - SLOPES @ at
    sigma = float(np.sqrt(left @ left / (error.size - SLOPES.shape[1])))
    jacobian = SLOPES / sigma
    return at, noise_of(jacobian), left / sigma, jacobian


def allowing(values: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray, noise: Spread) -> np.ndarray:
    """Half widths with a shape that the law misses."""
    one = series(values, np.full(120, jacobian[40, 0] / SLOPES[40, 0]))
    found = discrepancy([one], residuals, jacobian, noise)
    assert found is not None
    return np.array([found.half_width(unit) for unit in np.eye(3)])


@pytest.mark.parametrize("share", [0.003, 0.02])
def test_the_interval_holds_the_truth_where_the_law_misses(share):
    rng, count = np.random.default_rng(1), 80
    held = {"noise": 0, "discrepancy": 0}
    for _ in range(count):
        error = process(rng, share, 0.15) + SIGMA * rng.standard_normal(120)
        at, noise, residuals, jacobian = fitted(error)
        held["noise"] += int(np.sum(np.abs(at) < [noise.half_width(unit) for unit in np.eye(3)]))
        held["discrepancy"] += int(np.sum(np.abs(at) < allowing(PULSE + error, residuals, jacobian, noise)))
    coverage = {kind: n / (3 * count) for kind, n in held.items()}
    assert coverage["discrepancy"] > 0.88, coverage
    if share > 0.01:
        assert coverage["noise"] < 0.85, coverage


def test_without_a_miss_the_interval_is_that_of_the_noise():
    rng, ratios = np.random.default_rng(2), []
    for _ in range(12):
        error = SIGMA * rng.standard_normal(120)
        _, noise, residuals, jacobian = fitted(error)
        ratios += (
            allowing(PULSE + error, residuals, jacobian, noise) / [noise.half_width(unit) for unit in np.eye(3)]
        ).tolist()
    assert np.median(ratios) < 1.2 and np.quantile(ratios, 0.9) < 2.0, np.sort(ratios)


@pytest.mark.parametrize("memory", [0.0, 2.0])
def test_the_shape_is_a_process_over_the_phase_of_each_contact(memory):
    """Times its peak, in deviations, freed of the noise's memory by the Cholesky factor of its correlation; the same in all."""
    rng = np.random.default_rng(17)
    touching = np.zeros(40, bool)
    touching[3:10] = touching[20:22] = touching[30:] = True
    clock, weights = np.cumsum(rng.uniform(0.5, 1.5, 40)), rng.uniform(1.0, 3.0, 40)
    values = np.where(touching, -rng.uniform(1.0, 5.0, 40), 0.0)
    one = Series(5 + np.arange(40), touching, 1.0, clock=clock, values=values, weights=weights, memory=memory)
    apart = one._replace(rows=50 + np.arange(40), touching=np.zeros(40, bool))
    # The contact of two samples has no shape.
    phases, peaks = np.full(40, np.nan), np.zeros(40)
    for some in (slice(3, 10), slice(30, 40)):
        phases[some], peaks[some] = (clock[some] - clock[some][0]) / np.ptp(clock[some]), -values[some].min()
    factor = np.diag(weights)
    if memory:
        factor = np.linalg.solve(np.linalg.cholesky(np.exp(-np.abs(clock[:, None] - clock) / memory)), factor)
    residuals = rng.standard_normal(95)
    inside, deviations = 5 + np.flatnonzero(peaks), (peaks * weights)[peaks > 0.0]
    size = np.linalg.norm(residuals[inside]) / np.linalg.norm(deviations)
    for error, length in zip(shapes([one, apart], residuals), law_miss._LENGTHS, strict=True):
        covariance = np.nan_to_num(np.exp(-0.5 * ((phases[:, None] - phases) / length) ** 2)) * np.outer(peaks, peaks)
        found = error.columns[5:45] @ error.columns[5:45].T
        np.testing.assert_allclose(found, factor @ covariance @ factor.T, atol=0.02 * np.abs(found).max())
        assert not error.columns[:5].any() and not error.columns[45:].any()
        assert 3.0 * error.most == pytest.approx(2.0 * QUANTILE * size) and error.kind == "shape"
    assert shapes([apart], residuals) == []


def test_the_misses_size_does_not_depend_on_how_large_the_noise_is_said_to_be():
    rng = np.random.default_rng(20)
    error = process(rng, 0.02, 0.12) + SIGMA * rng.standard_normal(120)
    _, noise, residuals, jacobian = fitted(error)
    known, stated = (allowing(PULSE + error, x * residuals, x * jacobian, noise) for x in (1.0, 3.0))
    np.testing.assert_allclose(stated, known, rtol=1e-2)


def test_runs_of_one_coefficient_have_the_interval_of_their_mean():
    """J = 1 for every sample: a run's estimate is its mean, and the interval Student's of the G means."""
    rng, runs, samples = np.random.default_rng(3), 6, 40
    names = np.repeat(np.arange(runs), samples)
    error = np.repeat(rng.standard_normal(runs), samples) + 0.1 * rng.standard_normal(runs * samples)
    jacobian = np.ones((runs * samples, 1))
    found = clustered(names, error - error.mean(), jacobian, noise_of(jacobian))
    means = error.reshape(runs, samples).mean(axis=1)
    expected = stats.t.ppf(0.975, runs - 1) * stats.sem(means)
    np.testing.assert_allclose(found["runs"].half_width(np.ones(1)), expected, rtol=1e-12)
    np.testing.assert_allclose(found["robust"].half_width(np.ones(1)), expected, rtol=1e-12)


def test_one_more_run_scatters_as_a_prediction():
    """J = 1: Student's prediction interval of one more mean, t s sqrt(1 + 1/G)."""
    rng, runs, samples = np.random.default_rng(8), 5, 30
    error = np.repeat(rng.standard_normal(runs), samples)
    jacobian = np.ones((runs * samples, 1))
    found = clustered(np.repeat(np.arange(runs), samples), error - error.mean(), jacobian, noise_of(jacobian))
    means = error.reshape(runs, samples).mean(axis=1)
    expected = stats.t.ppf(0.975, runs - 1) * means.std(ddof=1) * np.sqrt(1.0 + 1.0 / runs)
    np.testing.assert_allclose(found["next run"].half_width(np.ones(1)), expected, rtol=1e-12)


def test_the_clustered_covariance_is_that_of_statsmodels():
    linear_model = pytest.importorskip("statsmodels.regression.linear_model")
    rng = np.random.default_rng(9)
    names, jacobian = np.repeat(np.arange(7), 25), rng.standard_normal((175, 3))
    values = jacobian @ [1.0, 2.0, 3.0] + rng.standard_normal(7)[names] + 0.3 * rng.standard_normal(175)
    theirs = linear_model.OLS(values, jacobian).fit()
    covariance = theirs.get_robustcov_results("cluster", groups=names, use_correction=False).cov_params()
    found = clustered(names, -theirs.resid, jacobian, noise_of(jacobian))
    np.testing.assert_allclose(found["robust"].covariance, 7.0 / 6.0 * covariance, rtol=1e-9)


@pytest.mark.parametrize("keep", [0.0, 0.9])
def test_neighbours_have_the_covariance_of_newey_and_west(keep):
    """With as many lags as Andrews' rule for the scores' correlation says."""
    linear_model = pytest.importorskip("statsmodels.regression.linear_model")
    rng = np.random.default_rng(11)
    jacobian = rng.standard_normal((400, 2)) + 1.0
    values = jacobian @ [1.0, 2.0] + remembering(rng, keep, 400)
    theirs = linear_model.OLS(values, jacobian).fit()
    noise, rows = noise_of(jacobian), np.arange(400)
    scores = theirs.resid[:, None] * jacobian @ noise.covariance
    c = max(abs(np.corrcoef(x[1:], x[:-1])[0, 1]) for x in scores.T)
    length = law_miss._length(scores)
    assert length == pytest.approx(1.0 + 1.1447 * (4.0 * c**2 / (1.0 - c**2) ** 2 * 400.0) ** (1 / 3), abs=1.1)
    one = Series(rows, rows >= 0, 1.0, clock=rows.astype(float), values=values, weights=np.ones(400))
    # Twice the same record, whose covariance is a half; the prediction's errors have the other sign.
    two = one._replace(rows=rows + 400)
    found = neighbouring([one, two], np.tile(-theirs.resid, 2), np.tile(jacobian, (2, 1)), noise)
    assert found is not None and found.covariance is not None
    wanted = theirs.get_robustcov_results("HAC", maxlags=length - 1, use_correction=False).cov_params() / 2.0
    parts = 800.0 / length
    np.testing.assert_allclose(found.covariance, wanted * parts / (parts - 1.0), rtol=1e-9)
    assert found.student == pytest.approx(parts - 1.0) and found.moved == ()


def test_few_samples_say_nothing_of_their_memory(monkeypatch):
    rows = np.arange(30)
    one = Series(rows, rows >= 0, 1.0, clock=rows.astype(float), values=rows, weights=np.ones(30))
    residuals, jacobian = np.where(rows % 2, 1.0, -1.0), np.ones((30, 1))
    for length, known in ((10, True), (11, False)):
        monkeypatch.setattr(law_miss, "_length", lambda scores, length=length: length)
        assert (neighbouring([one], residuals, jacobian, noise_of(jacobian)) is not None) == known
    few = one._replace(rows=rows[:15])
    assert neighbouring([few], residuals, jacobian, noise_of(jacobian)) is None


@pytest.mark.parametrize("loss", ["soft_l1", "cauchy"])
def test_the_covariance_of_a_robust_estimate_is_that_of_statsmodels(loss):
    """Huber's, of a scale that is 1: H1 of its robust linear model."""
    robust = pytest.importorskip("statsmodels.robust.robust_linear_model")
    norms = pytest.importorskip("statsmodels.robust.norms")

    class Norm(norms.RobustNorm):
        def psi(self, z):
            return z / np.sqrt(1.0 + z**2) if loss == "soft_l1" else z / (1.0 + z**2)

        def psi_deriv(self, z):
            return (1.0 + z**2) ** -1.5 if loss == "soft_l1" else (1.0 - z**2) / (1.0 + z**2) ** 2

    rng = np.random.default_rng(12)
    jacobian = np.column_stack([np.ones(40), rng.standard_normal((40, 2))])
    residuals = stats.t.rvs(3.0, size=40, random_state=rng)
    # Rows without information, as of samples that are not there, do not count.
    end = End(np.zeros(3), np.zeros(3), 0.0, np.r_[residuals, 0.0], np.r_[jacobian, np.zeros((1, 3))], True)
    found = fit_tests.spread(end, 40, [(np.eye(3), 0.5)], loss)
    model = robust.RLM(-residuals, jacobian, M=Norm())
    model.weights = np.ones(40)
    theirs = robust.RLMResults(model, np.zeros(3), model.normalized_cov_params, 1.0)
    np.testing.assert_allclose(found.covariance, theirs.bcov_scaled, rtol=1e-9)
    # The cost, half of whose second derivative is the mean of psi', rises by so much at a deviation.
    slope = np.mean(Norm().psi_deriv(residuals))
    share = theirs.bcov_scaled[0, 0] / model.normalized_cov_params[0, 0]
    assert found.rise == pytest.approx(share * slope, rel=1e-9)
    # Of the information J^T J its covariance is share times the inverse.
    ((change, variance),) = found.moved
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(change, -share * inverse @ inverse, rtol=1e-9)
    assert variance == 0.5


def remembering(rng: np.random.Generator, keep: float, count: int) -> np.ndarray:
    values = rng.standard_normal(count)
    for k in range(1, count):
        values[k] += keep * values[k - 1]
    return values


def test_neighbours_know_the_scatter_of_a_mean_of_samples_that_remember():
    """A mean of N samples of x_k = 0.8 x_(k-1) + e has the variance 25/N; taken for white noise, 2.8/N."""
    ratios = []
    for seed in range(20):
        values = remembering(np.random.default_rng(seed), 0.8, 2000)
        jacobian, rows = np.ones((2000, 1)), np.arange(2000)
        one = Series(rows, rows >= 0, 1.0, clock=rows.astype(float), values=values, weights=np.ones(2000))
        found = neighbouring([one], values - values.mean(), jacobian, noise_of(jacobian))
        assert found is not None and found.covariance is not None
        ratios.append(found.covariance[0, 0] * 2000.0 / 25.0)
    assert 0.75 < np.mean(ratios) < 1.1, ratios


def test_the_process_is_that_of_tinygp():
    kernels = pytest.importorskip("tinygp").kernels
    for length in law_miss._LENGTHS:
        ours = law_miss._modes(length) @ law_miss._modes(length).T
        np.testing.assert_allclose(
            ours, np.asarray(kernels.ExpSquared(length)(law_miss._GRID, law_miss._GRID)), atol=5e-3
        )


def test_two_runs_say_nothing_of_their_scatter():
    jacobian = np.ones((4, 1))
    assert clustered(np.array([0, 0, 1, 1]), np.ones(4), jacobian, noise_of(jacobian)) == {}


def test_a_run_that_determines_nothing_by_itself_leaves_the_clustered_interval():
    jacobian = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    found = clustered(
        np.array([0, 0, 1, 1, 2, 2]), np.array([1.0, -1.0, 1.0, -1.0, 0.5, 0.5]), jacobian, noise_of(jacobian)
    )
    assert list(found) == ["robust"]


@pytest.mark.parametrize(
    ("search", "data", "law", "verdict"),
    [
        ("converged", "determined", "consistent", "identified"),
        ("converged", "determined", "adequate", "adequate"),
        ("converged", "determined", "inadequate", "misfit"),
        ("converged", "partly", "adequate", "not_identified"),
        ("converged", "not_determined", "inadequate", "misfit"),
        ("not_converged", "determined", "consistent", "not_converged"),
    ],
)
def test_one_word_follows_from_three_answers(search, data, law, verdict):
    assert answers.verdict(Answer(search, []), Answer(data, []), Answer(law, [])) == verdict


@pytest.mark.parametrize(
    ("miss", "held_out", "word"),
    [(0.02, None, "adequate"), (0.04, None, "inadequate"), (0.02, 0.05, "adequate"), (0.02, 0.07, "inadequate")],
)
def test_a_law_is_adequate_up_to_the_threshold(miss, held_out, word):
    failed = [fit_tests.Test("order", 0.0, 1.0, False, "a shape is missed")]
    others = None if held_out is None else {"run": {"rms_error_of_peak": held_out}}
    found = answers.law(failed, miss, others, 0.03)
    assert found.answer == word and f"{100 * miss:.2g} % of the peak" in found.because[0]
    assert answers.law([fit_tests.Test("order", 1.0, 1.0, True, "")], miss, others, 0.03).answer == "consistent"


def test_what_is_missed_leaves_out_what_changes_from_sample_to_sample():
    rng = np.random.default_rng(4)
    residuals = rng.standard_normal(120) + np.where(INSIDE, 3.0, 0.0)
    found = answers.missed([series(PULSE, np.full(120, 1.0 / SIGMA))], residuals)
    assert found == pytest.approx(3.0 * SIGMA, rel=0.1)


def test_residuals_are_held_against_what_the_sensor_scatters_at_rest():
    rng = np.random.default_rng(5)
    values = PULSE + SIGMA * rng.standard_normal(120)
    one = series(values, np.full(120, 1.0 / SIGMA))
    assert answers.louder([one], np.where(INSIDE, 4.0, 0.0)) == pytest.approx(4.0, rel=0.3)
    assert answers.louder([one._replace(touching=np.roll(INSIDE, -30))], np.ones(120)) == 0.0
    failed = [fit_tests.Test("order", 0.0, 1.0, False, "a shape is missed")]
    assert "4 times what the sensor scatters" in answers.law(failed, 0.01, None, 0.03, 4.0).because[1]


def test_noise_that_was_stated_too_large_is_no_misfit():
    smooth = 0.2 * np.r_[np.zeros(30), np.sin(3.0 * np.pi * PHASE), np.zeros(30)]
    stated = series(PULSE, np.full(120, 1.0 / SIGMA))._replace(estimated=False)
    jacobian = SLOPES / SIGMA
    assert overstated(stated, smooth) and all(t.passed for t in residual_tests([stated], smooth, jacobian, False))
    assert not all(t.passed for t in residual_tests([stated], 20.0 * smooth, jacobian, False))


def test_a_contact_that_is_predicted_elsewhere_is_a_failed_search():
    def record(shift: int) -> Record:
        predicted = np.roll(PULSE, shift)
        return Record("run", False, CLOCK, {"contact.normal": PULSE}, {"contact.normal": predicted}, {}, {})

    assert answers.contacts_met([record(2)]).passed
    assert not answers.contacts_met([record(40)]).passed


def test_bounds_on_a_logarithmic_scale_are_never_left_by_rounding():
    rng = np.random.default_rng(6)
    for lower, upper in np.sort(10.0 ** rng.uniform(-9, 12, (400, 2)), axis=1):
        low, high = _logarithms(lower, upper)
        assert lower <= np.exp(low) <= lower * (1 + 1e-14) and upper * (1 - 1e-14) <= np.exp(high) <= upper
    assert np.exp(_logarithms(1.0, 3.0)[1]) <= 3.0


def test_the_far_end_of_the_unit_box_is_within_the_bounds():
    rng = np.random.default_rng(7)
    over = 0
    for lower, upper in np.sort(rng.uniform(-3.0, 3.0, (400, 2)), axis=1):
        low, high = _reached(lower, upper)
        over += lower + (upper - lower) > upper
        assert low == lower and low + (high - low) <= upper and upper - high <= 1e-15 * 3.0
    assert over > 0  # Without the correction some of these would be left.
