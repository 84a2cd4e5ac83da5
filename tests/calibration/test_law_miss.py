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
from calibration.uncertainty.law_miss import _power, block_length, clustered, discrepancy, in_blocks

# One contact of 60 samples between 30 quiet ones on either side; peak 1, noise 0.002.
PHASE = np.linspace(0.0, 1.0, 60)
INSIDE = np.r_[np.zeros(30, bool), np.ones(60, bool), np.zeros(30, bool)]
CLOCK, SIGMA = np.arange(120.0), 2e-3
PULSE = np.r_[np.zeros(30), np.sin(np.pi * PHASE), np.zeros(30)]
# What a coefficient of size, one of shape and one of loss would change.
SLOPES = np.stack([PULSE, np.r_[np.zeros(30), np.sin(np.pi * PHASE) ** 2, np.zeros(30)], np.gradient(PULSE)], axis=1)


def noise_of(jacobian: np.ndarray) -> Spread:
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return Spread(covariance, 1.96, len(jacobian) - jacobian.shape[1], np.zeros(jacobian.shape[1]), 1.0)


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


@pytest.mark.full
@pytest.mark.parametrize("share", [pytest.param(0.003, marks=pytest.mark.slow), 0.02])
def test_the_interval_holds_the_truth_where_the_law_misses(share):
    rng, count = np.random.default_rng(1), 80
    held = {"noise": 0, "discrepancy": 0}
    for _ in range(count):
        error = process(rng, share, 0.15) + SIGMA * rng.standard_normal(120)
        at, noise, residuals, jacobian = fitted(error)
        found = discrepancy([series(PULSE + error, jacobian[:, 0] * 0 + 1.0 / SIGMA)], residuals, jacobian, noise)
        assert found is not None
        for kind, spread in (("noise", noise), ("discrepancy", found.spread)):
            held[kind] += int(np.sum(np.abs(at) < [spread.half_width(unit) for unit in np.eye(3)]))
    coverage = {kind: n / (3 * count) for kind, n in held.items()}
    assert coverage["discrepancy"] > 0.88, coverage
    if share > 0.01:
        assert coverage["noise"] < 0.85, coverage


def test_without_a_miss_the_interval_is_that_of_the_noise():
    rng, ratios = np.random.default_rng(2), []
    for _ in range(12):
        error = SIGMA * rng.standard_normal(120)
        _, noise, residuals, jacobian = fitted(error)
        found = discrepancy([series(PULSE + error, np.full(120, 1.0 / SIGMA))], residuals, jacobian, noise)
        assert found is not None
        ratios += [found.spread.half_width(unit) / noise.half_width(unit) for unit in np.eye(3)]
    assert np.median(ratios) < 1.2 and np.quantile(ratios, 0.9) < 2.0, np.sort(ratios)


@pytest.mark.parametrize("memory", [0.0, 2.0])
def test_the_cosines_are_of_the_phase_of_each_contact(memory):
    """Times its peak, in deviations, and freed of the noise's memory by the Cholesky factor of its correlation."""
    rng = np.random.default_rng(17)
    touching = np.zeros(40, bool)
    touching[3:10] = touching[20:22] = touching[30:] = True
    clock, weights = np.cumsum(rng.uniform(0.5, 1.5, 40)), rng.uniform(1.0, 3.0, 40)
    values = np.where(touching, -rng.uniform(1.0, 5.0, 40), 0.0)
    rows = 5 + np.arange(40)
    one = Series(rows, touching, 1.0, clock=clock, values=values, weights=weights, memory=memory)
    apart = one._replace(rows=50 + np.arange(40), touching=np.zeros(40, bool))
    basis, inside = law_miss._cosines([one, apart], 95)
    # The contact of two samples has no shape.
    assert inside == 17
    wanted = np.zeros((40, 24))
    for some in (slice(3, 10), slice(30, 40)):
        phase = np.linspace(0.0, 1.0, 1000)
        shapes = np.cos(np.pi * np.arange(24) * phase[:, None])
        at = (clock[some] - clock[some][0]) / np.ptp(clock[some])
        wanted[some] = np.stack([np.interp(at, phase, shape) for shape in shapes.T], axis=1) * -values[some].min()
    wanted *= weights[:, None]
    if memory:
        correlation = np.exp(-np.abs(clock[:, None] - clock) / memory)
        wanted = np.linalg.solve(np.linalg.cholesky(correlation), wanted)
    np.testing.assert_allclose(basis[rows], wanted, atol=3e-3 * np.abs(wanted).max())
    assert not basis[:5].any() and not basis[45:].any()


def dense(noise: float, power: np.ndarray, basis: np.ndarray, jacobian: np.ndarray, residuals: np.ndarray) -> float:
    """- ln of the restricted likelihood of residuals with the covariance noise 1 + B power B^T, by its matrix."""
    whole = noise * np.eye(len(basis)) + basis * power @ basis.T
    inverse = np.linalg.inv(whole)
    information = jacobian.T @ inverse @ jacobian
    left = residuals - jacobian @ np.linalg.solve(information, jacobian.T @ inverse @ residuals)
    sizes = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(information)[1]
    return 0.5 * float(sizes + left @ inverse @ left)


def test_the_restricted_likelihood_is_that_of_its_dense_covariance():
    rng = np.random.default_rng(18)
    basis, jacobian, residuals = rng.standard_normal((30, 5)), rng.standard_normal((30, 2)), rng.standard_normal(30)
    residuals -= jacobian @ np.linalg.lstsq(jacobian, residuals)[0]
    beside = basis - jacobian @ np.linalg.lstsq(jacobian, basis)[0]
    products = (beside.T @ beside, beside.T @ residuals, float(residuals @ residuals), 28)
    constant = 0.5 * np.linalg.slogdet(jacobian.T @ jacobian)[1]
    for noise, power in ((1.0, np.ones(5)), (0.3, rng.uniform(0.1, 4.0, 5)), (2.0, 1e-9 * np.ones(5))):
        found = law_miss._restricted(*products, noise, power) + constant
        assert found == pytest.approx(dense(noise, power, basis, jacobian, residuals), rel=1e-9)


@pytest.mark.parametrize(("seed", "share", "length"), [(19, 0.03, 0.12), (46, 0.003, 0.6)])
def test_what_the_law_misses_is_the_most_likely_process(seed, share, length):
    """Its size and the noise beside others, by dense matrices; the estimate's covariance, and how well that is known."""
    rng = np.random.default_rng(seed)
    error = process(rng, share, length) + SIGMA * rng.standard_normal(120)
    _, noise, residuals, jacobian = fitted(error)
    one = series(PULSE + error, np.full(120, 1.0 / SIGMA))
    found = discrepancy([one], residuals, jacobian, noise)
    assert found is not None and found.spread.covariance is not None
    basis, inverse = law_miss._cosines([one], 120)[0], np.linalg.inv(jacobian.T @ jacobian)
    (plain, first), (missed, second) = found.spread.moved
    size = plain[0, 0] / inverse[0, 0]
    np.testing.assert_allclose(plain, size * inverse, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.spread.covariance, plain + missed, rtol=1e-12)
    power = found.share**2 * _power(found.length)
    way = inverse @ jacobian.T @ basis
    np.testing.assert_allclose(missed, way * power @ way.T, rtol=1e-9, atol=1e-12)
    least = dense(size, power, basis, jacobian, residuals)
    # Without a process the residuals have the variance 1.
    assert size == pytest.approx(1.0, rel=1e-3)
    for b in (0.85, 1.15):
        assert dense(size, b * power, basis, jacobian, residuals) > least
    for length in law_miss._LENGTHS:
        if length != found.length:
            assert dense(size, found.share**2 * _power(length), basis, jacobian, residuals) > least
    assert first == pytest.approx(2.0 / 117.0, rel=1e-12)
    # As many numbers as a smoother of the residuals has.
    beside = np.eye(120) - jacobian @ inverse @ jacobian.T
    seen = np.linalg.eigvalsh(beside @ (basis * power @ basis.T) @ beside)
    assert second == pytest.approx(2.0 / np.sum(seen / (seen + size)), rel=1e-6)


def test_the_misses_size_does_not_depend_on_how_large_the_noise_is_said_to_be():
    rng = np.random.default_rng(20)
    error = process(rng, 0.02, 0.12) + SIGMA * rng.standard_normal(120)
    _, noise, residuals, jacobian = fitted(error)
    one = series(PULSE + error, np.full(120, 1.0 / SIGMA))
    known = discrepancy([one], residuals, jacobian, noise)
    assert known is not None and known.spread.covariance is not None and known.share > 0.0
    for scale in (0.5, 3.0):
        stated = discrepancy([one._replace(weights=scale * one.weights)], scale * residuals, scale * jacobian, noise)
        assert stated is not None and (stated.share, stated.length) == pytest.approx(
            (known.share, known.length), rel=1e-2
        )
        np.testing.assert_allclose(stated.spread.covariance, known.spread.covariance, rtol=2e-2, atol=1e-9)


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


@pytest.mark.parametrize(("keep", "length"), [(0.0, None), (0.9, None), (0.0, 7)])
def test_blocks_have_the_covariance_of_newey_and_west(keep, length, monkeypatch):
    """Where scores are 0 for a block's length at both ends, sums of blocks weigh lags as Bartlett's window does."""
    linear_model = pytest.importorskip("statsmodels.regression.linear_model")
    rng, quiet, count = np.random.default_rng(11), 60, 400
    jacobian = np.zeros((count + 2 * quiet, 2))
    jacobian[quiet:-quiet] = rng.standard_normal((count, 2)) + 1.0
    values = jacobian @ [1.0, 2.0] + remembering(rng, keep, len(jacobian))
    theirs = linear_model.OLS(values, jacobian).fit()
    noise, rows = noise_of(jacobian), np.arange(len(jacobian))
    scores = theirs.resid[:, None] * jacobian @ noise.covariance
    if length is None:
        length = max(1, round(max(block_length(column) for column in scores.T)))
        assert length < quiet and (length > 3) == (keep > 0.0)
    else:
        monkeypatch.setattr(law_miss, "block_length", lambda column: float(length))
    one = Series(rows, rows >= 0, 1.0, clock=rows.astype(float), values=values, weights=np.ones(len(rows)))
    # Twice the same record, whose covariance is a half; the prediction's errors have the other sign.
    two = one._replace(rows=rows + len(rows))
    found = in_blocks([one, two], np.tile(-theirs.resid, 2), np.tile(jacobian, (2, 1)), noise)
    assert found is not None and found.covariance is not None
    options = {"maxlags": length - 1, "use_correction": False}
    wanted = theirs.get_robustcov_results("HAC", **options).cov_params() / 2.0
    blocks = 2.0 * len(rows) / length
    wanted = wanted * len(rows) / (len(rows) - length + 1) * blocks / (blocks - 1.0)
    np.testing.assert_allclose(found.covariance, wanted, rtol=1e-9)
    assert found.student == pytest.approx(blocks - 1.0) and found.moved == ()


def test_fewer_than_three_blocks_say_nothing(monkeypatch):
    rows = np.arange(30)
    one = Series(rows, rows >= 0, 1.0, clock=rows.astype(float), values=rows, weights=np.ones(30))
    residuals, jacobian = np.where(rows % 2, 1.0, -1.0), np.ones((30, 1))
    for length, known in ((10.0, True), (11.0, False)):
        monkeypatch.setattr(law_miss, "block_length", lambda column, length=length: length)
        assert (in_blocks([one], residuals, jacobian, noise_of(jacobian)) is not None) == known
    few = one._replace(rows=rows[:15])
    assert in_blocks([few], residuals, jacobian, noise_of(jacobian)) is None


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


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.8, 0.95])
def test_the_length_of_a_block_is_that_of_arch(keep):
    bootstrap = pytest.importorskip("arch.bootstrap")
    values = remembering(np.random.default_rng(10), keep, 600)
    theirs = float(bootstrap.optimal_block_length(values)["circular"].iloc[0])
    assert block_length(values) == pytest.approx(theirs, rel=1e-9)


def test_blocks_know_the_scatter_of_a_mean_of_samples_that_remember():
    """A mean of N samples of x_k = 0.8 x_(k-1) + e has the variance 25/N; taken for white noise, 2.8/N."""
    ratios = []
    for seed in range(20):
        values = remembering(np.random.default_rng(seed), 0.8, 2000)
        jacobian, rows = np.ones((2000, 1)), np.arange(2000)
        one = Series(rows, rows >= 0, 1.0, clock=rows.astype(float), values=values, weights=np.ones(2000))
        found = in_blocks([one], values - values.mean(), jacobian, noise_of(jacobian))
        assert found is not None and found.covariance is not None
        ratios.append(found.covariance[0, 0] * 2000.0 / 25.0)
    assert 0.75 < np.mean(ratios) < 1.1, ratios


def test_the_process_is_that_of_tinygp():
    """Its correlation over the phase away from the ends, where the cosines are even, of two lengths."""
    kernels = pytest.importorskip("tinygp").kernels
    middle = PHASE[20:40]
    for length in (0.06, 0.12):
        waves = np.cos(np.pi * np.arange(24) * middle[:, None])
        theirs = np.asarray(kernels.ExpSquared(length)(middle, middle))
        ours = (waves * _power(length)) @ waves.T
        # On average over the whole phase the variance is 1, and a little more at its ends.
        assert 0.85 < ours[10, 10] <= 1.0
        np.testing.assert_allclose(ours / ours[10, 10], theirs, atol=0.01)


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
