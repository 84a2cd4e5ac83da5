"""Parts of the search for filters that nobody stated, against SciPy and by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import signal

import bcfj_jax as bj
from calibration import Channel, Experiment, Filter, Free, Problem, fit
from calibration.diagnostics.residual_tests import Series
from calibration.search.refinement import End
from calibration.uncertainty import unstated_filter
from calibration.uncertainty.unstated_filter import Ambiguity, Tried


@pytest.mark.parametrize("one", [Filter("butterworth", 1), Filter("bessel", 4), Filter("butterworth", 4)])
def test_a_pass_is_scipys_of_an_input_that_is_linear_between_samples(one):
    rng, step, cutoff = np.random.default_rng(1), 1e-4, 150.0
    clock = step * np.arange(400)
    values = 3.0 + np.cumsum(rng.standard_normal((2, 400, 1)), axis=1)
    how = {"norm": "mag"} if one.kind == "bessel" else {}
    design = signal.bessel if one.kind == "bessel" else signal.butter
    system = design(one.order, 2.0 * np.pi * cutoff, analog=True, output="zpk", **how)
    for row, found in zip(values[..., 0], unstated_filter._once(values, one, cutoff, step)[..., 0], strict=True):
        # At rest at its first value before.
        wanted = row[0] + signal.lsim(signal.ZerosPolesGain(*system), row - row[0], clock)[1]
        np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_filter_without_its_delay_shifts_no_slow_signal():
    """Of a slow wave, sampled four times as finely as it is read; run both ways, the gain is squared."""
    clock = np.arange(0.0, 1.0, 2.5e-4)
    values = np.sin(2.0 * np.pi * 2.0 * clock) * np.exp(-40.0 * (clock - 0.5) ** 2)
    times = clock[::4]
    for one in (Filter("butterworth", 2), Filter("bessel", 4), Filter("butterworth", 2, True)):
        found = unstated_filter._passed(clock, values[None, :, None], times, one, 100.0)[0, :, 0]
        np.testing.assert_allclose(found, values[::4], atol=3e-3)
    high = np.sin(2.0 * np.pi * 20.0 * clock) * np.exp(-40.0 * (clock - 0.5) ** 2)
    gains = [
        np.ptp(unstated_filter._passed(clock, high[None, :, None], times, Filter("butterworth", 2, both), 20.0))
        / np.ptp(high)
        for both in (False, True)
    ]
    assert gains == pytest.approx([np.sqrt(0.5), 0.5], rel=0.02)


def test_readings_between_samples_are_on_straight_lines():
    clock, values = np.array([0.0, 1.0, 3.0]), np.array([[[1.0], [2.0], [6.0]]])
    found = unstated_filter._at(np.array([-1.0, 0.0, 0.5, 2.0, 3.0, 4.0]), clock, values)
    assert found[0, :, 0] == pytest.approx([1.0, 1.0, 1.5, 4.0, 6.0, 6.0])


def tried(residuals: np.ndarray) -> Tried:
    return Tried(None, np.inf, np.zeros(1), float(residuals @ residuals), residuals, np.zeros((residuals.size, 1)))


def test_an_excess_counts_samples_that_do_not_correlate():
    """m ln(S/S_min), m = n (1 - c)/(1 + c); by S - S_min where that is less and every deviation is stated."""
    rows = np.arange(100)
    best = tried(np.where(rows // 3 % 2 == 0, 1.0, -1.0) * (1.0 + 0.01 * rows))
    own = best.residuals
    kept = max((own[1:] @ own[:-1]) / (own @ own), 0.0)
    assert 0.05 < kept < 0.5
    other = tried(1.1 * own)
    stated = [Series(rows, rows >= 0, 1.0)]
    by_size = 100.0 * (1.0 - kept) / (1.0 + kept) * np.log(1.21)
    assert unstated_filter._excess(other, best, [stated[0]._replace(estimated=True)]) == pytest.approx(by_size)
    assert unstated_filter._excess(other, best, stated) == pytest.approx(min(by_size, 0.21 * own @ own))
    small = tried(0.1 * own)
    assert unstated_filter._excess(tried(0.11 * own), small, stated) == pytest.approx(0.0021 * own @ own)
    # However they correlate, a contact says as much as twelve samples; fewer samples say as much as they are.
    flat = tried(np.ones(100))
    estimated = [stated[0]._replace(estimated=True)]
    assert unstated_filter._excess(tried(2.0 * flat.residuals), flat, estimated) == pytest.approx(12.0 * np.log(4.0))
    few = [Series(rows[:5], rows[:5] >= 0, 1.0, estimated=True)]
    one, two = tried(np.ones(5)), tried(2.0 * np.ones(5))
    assert unstated_filter._excess(two, one, few) == pytest.approx(5.0 * np.log(4.0))


def test_the_hull_holds_the_interval_and_keeps_to_the_bounds():
    one = tried(np.ones(3))
    found = Ambiguity(one, 10.0, np.array([-1.0, np.log(2.0), -np.inf]), np.array([0.5, np.log(3.0), np.inf]), None)
    assert found.decisive and not found._replace(plain=9.9).decisive
    gain = False, (-5.0, 5.0)
    assert found.ends(0, (0.0, 2.0), *gain) == (-1.0, 2.0) and found.ends(0, (-2.0, 0.0), *gain) == (-2.0, 0.5)
    assert found.ends(2, (0.0, 2.0), *gain) == (-5.0, 5.0)
    assert found.ends(1, (2.2, 2.4), True, np.log([1.0, 2.5])) == pytest.approx((2.0, 2.5))
    assert found.ends(1, (2.2, 2.4), True) == pytest.approx((2.0, 3.0))


def test_the_hull_is_over_all_cut_offs_that_are_not_excluded(monkeypatch):
    """Two filters with the plain fit at the head of each; estimates, deviations and excess on straight lines between."""
    rows = np.arange(50)
    series = [Series(rows, rows >= 0, 1.0, longest=0.01)]
    # Excess over the best, whose square is 50, of 50 samples: 50 ln(S/50).
    chains = [
        [(0.0, 1.0, 52.0), (1.0, 2.0, 50.0), (3.0, 4.0, 60.0)],
        [(0.0, 1.0, 52.0), (-2.0, 1.0, 53.0), (-9.0, 1.0, 80.0)],
    ]
    places = {}

    def made(k: int, i: int) -> Tried:
        z, deviation, square = chains[k][i]
        one = Tried(
            None,
            1000.0 / (1 + i) / (1 + k),
            np.array([z]),
            square,
            np.sqrt(square / 50.0) * (-1.0) ** rows,
            np.ones((50, 1)),
        )
        places[id(one)] = np.array([z, -z]), np.array([deviation, deviation])
        return one

    kept = [[made(k, i) for i in range(3)] for k in (0, 1)]
    plain = kept[0][0]
    monkeypatch.setattr(unstated_filter, "_Sampled", lambda *_: None)
    monkeypatch.setattr(unstated_filter, "_chains", lambda *_: kept)
    monkeypatch.setattr(unstated_filter, "_scaled", lambda at, one: places.get(id(one), places[id(plain)]))
    end = End(np.zeros(1), np.zeros(1), 52.0, plain.residuals, plain.jacobian, True)
    halves = np.array([0.5, 0.7])
    at: Any = SimpleNamespace(model=None, experiments=(), series=series, end=end)
    found = unstated_filter.ambiguity(at, halves)
    assert found is not None and found.plain == pytest.approx(50.0 * np.log(1.04)) and found.best is kept[0][1]
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for chain in chains:
        for where in np.arange(0.0, 2.01, 0.25):
            z, deviation, over = (
                np.interp(where, [0.0, 1.0, 2.0], part)
                for part in ([c[0] for c in chain], [c[1] for c in chain], [50.0 * np.log(c[2] / 50.0) for c in chain])
            )
            if over < 5.99:
                reach = halves * deviation * np.sqrt(1.0 - over / 5.99)
                low, high = np.minimum(low, [z, -z] - reach), np.maximum(high, [z, -z] + reach)
    assert found.low == pytest.approx(low) and found.high == pytest.approx(high)
    assert found.slowest is kept[1][1]
    # Where the slowest filter of a kind is not excluded, there is no end.
    monkeypatch.setattr(unstated_filter, "_chains", lambda *_: [kept[0][:2]])
    found = unstated_filter.ambiguity(at, halves)
    assert found is not None and np.array_equal(found.low, [-np.inf] * 2) and np.array_equal(found.high, [np.inf] * 2)
    at.series = [series[0]._replace(longest=np.inf)]
    assert unstated_filter.ambiguity(at, halves) is None


@pytest.mark.slow
def test_one_step_is_the_fit_with_a_filter_that_does_little(monkeypatch):
    """Against the search from the same point; a filter that does much is no step away."""
    scene = bj.scenes.impact(smoothing=False)
    params = scene.parameters(stiffness=1e8, exponent=1.5, damping=0.1, mass=0.1, approach_speed=1.0)
    times = np.linspace(0.0, 1.6e-3, 161)
    force = bj.simulate(scene, params, times, accuracy=1e-8).force["contact"][:, 0]
    values = force + 5e-3 * force.max() * np.random.default_rng(0).standard_normal(force.size)
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    record = Experiment("drop", times, (Channel("contact.normal", values, 5e-3 * force.max()),))
    at = fit(Problem(scene, params, (record,), free), starts=4, systematic=False).optimum
    contact = 1e-3
    sampled = unstated_filter._Sampled(at.model, at.experiments, contact)
    plain = Tried(None, np.inf, at.end.point, at.end.cost, at.end.residuals, at.end.jacobian)
    near, steps = sampled.read(plain.point), 0
    deviations = np.sqrt(np.diag(np.linalg.inv(plain.jacobian.T @ plain.jacobian)))
    for passed in unstated_filter.FILTERS[:6]:
        for cutoff in (45.0 / contact, 15.0 / contact):
            step, read = sampled.fitted(near, passed, cutoff)
            if read is near:
                monkeypatch.setattr(unstated_filter, "_LITTLE", 0.0)
                (searched, _), steps = sampled.fitted(near, passed, cutoff), steps + 1
                monkeypatch.undo()
                assert step.square == pytest.approx(searched.square, abs=0.02)
                assert np.all(np.abs(step.point - searched.point) < 0.1 * deviations)
    assert steps >= 6
    assert sampled.fitted(near, unstated_filter.FILTERS[0], 0.7 / contact)[1] is not near
