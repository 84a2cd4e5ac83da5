"""Histories against closed forms, brute-force sums and SciPy; against noise; their derivatives against differences."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import correlate

from bcfj_jax.analysis import histories
from bcfj_jax.core.errors import InputError

pytestmark = pytest.mark.filterwarnings("error")

TIMES = np.linspace(0.0, 3.0, 3001)
STEP = 1e-3
TURN = 0.6137

# Forces of a revolution over its phase [1], of mean and size one or so, from smooth to impacts.
SHAPES = {
    "sine": lambda x: 2 + np.sin(2 * np.pi * x + 0.3),
    "half_sines": lambda x: np.maximum(0.0, np.sin(2 * np.pi * x)) ** 1.5,
    "overtones": lambda x: 3 + np.sin(2 * np.pi * x) + 0.8 * np.cos(12 * np.pi * x) + 0.3 * np.sin(4 * np.pi * x + 1),
    "bilateral": lambda x: pulse(x, 0.3, 0.03) - pulse(x, 0.8, 0.03),
    "impacts": lambda x: pulse(x, 0.4, 0.006) + 0.3 * pulse(x, 0.55, 0.004),
}
EVERY = pytest.mark.parametrize("shape", SHAPES)


def pulse(x: np.ndarray, middle: float, width: float) -> np.ndarray:
    """Gaussian pulse once in every unit of x."""
    return np.exp(-((((x - middle + 0.5) % 1 - 0.5) / width) ** 2))


# --- period


@EVERY
@pytest.mark.parametrize("turn", [0.06, 0.3, 0.6, TURN, 1.1, 1.45])
@pytest.mark.parametrize("start", [0.0, 0.21])
def test_period_is_found_to_a_tenth_of_a_sample(shape, turn, start):
    force = 2e4 * SHAPES[shape](TIMES / turn + start)
    # Impacts of width 0.006 * 0.06 s last less than a sample.
    exact = 0.1 if turn > 0.1 or shape != "impacts" else 0.5
    assert histories.period(TIMES, force) == pytest.approx(turn, abs=exact * STEP)


def test_period_of_a_window_sees_the_window_only():
    force = np.where(TIMES < 1.0, np.sin(2 * np.pi * TIMES / 0.13), np.sin(2 * np.pi * TIMES / 0.41))
    assert histories.period(TIMES, force, (0.0, 0.99)) == pytest.approx(0.13, abs=1e-4)
    assert histories.period(TIMES, force, (1.0, 3.0)) == pytest.approx(0.41, abs=1e-4)


def test_period_of_the_paper():
    """Q19, Q25: 0.61 s is 1.63 Hz to 1.64 Hz, through a start-up impact and 5 % of unevenness in the peaks."""
    uneven = 1 + 0.05 * np.cos(7 * np.floor(TIMES / 0.613))
    force = 20.32e3 * uneven * SHAPES["impacts"](TIMES / 0.613) + 4e4 * np.exp(-(((TIMES - 0.02) / 0.008) ** 2))
    assert 1.0 / histories.period(TIMES, force, (0.1, 3.0)) == pytest.approx(1.63, abs=0.005)
    assert histories.period(TIMES, force, (0.1, 3.0)) == pytest.approx(0.613, abs=2e-4)
    # The start-up holds more than all that follows: no period of the whole.
    assert math.isnan(histories.period(TIMES, force))


def test_period_on_uneven_times():
    times = np.sort(np.random.default_rng(0).uniform(0.0, 3.0, 3000))
    assert histories.period(times, SHAPES["half_sines"](times / TURN)) == pytest.approx(TURN, abs=1e-3)


def test_period_is_the_greatest_of_the_correlation_summed_pair_by_pair():
    times, force = TIMES[::5], SHAPES["overtones"](TIMES[::5] / TURN)
    x = force - np.mean(force)
    lags = np.arange(60, 200)
    n = [1 - np.sum((x[k:] - x[:-k]) ** 2) / np.sum(x[k:] ** 2 + x[:-k] ** 2) for k in lags]
    assert histories.period(times, force) == pytest.approx(lags[np.argmax(n)] * 5 * STEP, abs=0.6 * 5 * STEP)


@pytest.mark.parametrize(
    "force",
    [
        TIMES,
        np.ones_like(TIMES),
        np.zeros_like(TIMES),
        np.full_like(TIMES, 0.1) + 1e-17,
        np.sin(np.pi * TIMES / 3),
        np.sin(2 * np.pi * TIMES / 3),
        np.sin(2 * np.pi * TIMES / 2.3),
        np.exp(-5 * TIMES),
        np.exp(-(((TIMES - 1.0) / 0.02) ** 2)),
        np.exp(-(((TIMES - 1.0) / 0.02) ** 2)) - np.exp(-(((TIMES - 1.7) / 0.02) ** 2)),
        np.random.default_rng(1).standard_normal(3001),
        np.where(TIMES > 2.9, np.nan, np.sin(20 * TIMES)),
        np.where(TIMES > 2.9, np.inf, np.sin(20 * TIMES)),
    ],
)
def test_what_does_not_repeat_itself_has_no_period(force):
    assert math.isnan(histories.period(TIMES, force))


@given(
    shape=st.sampled_from(sorted(SHAPES)),
    turn=st.floats(0.25, 1.2),
    start=st.floats(0.0, 1.0),
    noise=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**32 - 1),
)
def test_period_stands_noise(shape, turn, start, noise, seed):
    """Noise of a tenth of the history's size moves the period by less than 1/2 %; offset and scale by nothing."""
    force = SHAPES[shape](TIMES / turn + start)
    noisy = force + noise * np.std(force) * np.random.default_rng(seed).standard_normal(force.size)
    found = histories.period(TIMES, noisy)
    assert found == pytest.approx(turn, rel=5e-3)
    assert histories.period(TIMES, -7 * noisy + 3) == pytest.approx(found, rel=1e-9)


def test_period_needs_samples():
    with pytest.raises(InputError, match="window: 7 samples; a period needs 8 or more"):
        histories.period(TIMES, TIMES, (0.0, 0.006))


# --- delay


@EVERY
@pytest.mark.parametrize("shift", [-0.29, -0.1234, 0.0, 0.04, 0.22, 0.3])
def test_delay_is_positive_where_the_second_comes_later(shape, shift):
    first, second = 2e4 * SHAPES[shape](TIMES / TURN), 5e2 - 3e3 * -SHAPES[shape]((TIMES - shift) / TURN)
    assert float(histories.delay(TIMES, first, second, TURN)) == pytest.approx(shift, abs=0.1 * STEP)
    assert float(histories.delay(TIMES, second, first, TURN)) == pytest.approx(-shift, abs=0.1 * STEP)
    late = histories.delay(TIMES, first, second, TURN, (1.0, 2.9))
    assert float(late) == pytest.approx(shift, abs=0.1 * STEP)


def test_a_shift_of_more_than_half_a_period_comes_round():
    first, second = (SHAPES["half_sines"]((TIMES - s) / TURN) for s in (0.0, 0.7 * TURN))
    assert float(histories.delay(TIMES, first, second, TURN)) == pytest.approx(-0.3 * TURN, abs=1e-4)


def test_delay_on_uneven_times():
    times = np.sort(np.random.default_rng(0).uniform(0.0, 3.0, 3000))
    first, second = (SHAPES["half_sines"]((times - s) / TURN) for s in (0.0, 0.0421))
    assert float(histories.delay(times, first, second, TURN)) == pytest.approx(0.0421, abs=1e-3)


def test_delay_is_near_the_greatest_of_scipys_correlation():
    """Of single pulses, whose windows do not matter."""
    first, second = (np.exp(-(((TIMES - t) / 0.05) ** 2)) for t in (1.4, 1.52034))
    lag = np.argmax(correlate(second, first)) - (TIMES.size - 1)
    found = float(histories.delay(TIMES, first, second, 1.0))
    assert found == pytest.approx(lag * STEP, abs=0.6 * STEP)
    assert found == pytest.approx(0.12034, abs=0.05 * STEP)
    assert found == pytest.approx(float(histories.delay(TIMES, first, second)), abs=0.05 * STEP)


def test_delay_is_the_greatest_of_numpys_correlation_coefficients():
    rng = np.random.default_rng(4)
    smooth = np.convolve(rng.standard_normal(700), np.hanning(40), mode="valid")
    first, second = smooth[17:617], smooth[:600] + 0.3 * rng.standard_normal(600)
    lags = np.arange(-50, 51)
    match = [np.corrcoef(first[max(0, -k) : 600 - max(0, k)], second[max(0, k) : 600 - max(0, -k)])[0, 1] for k in lags]
    found = float(histories.delay(np.arange(600.0), first, second, 100.0))
    assert found == pytest.approx(lags[np.argmax(match)], abs=1.5)
    assert found == pytest.approx(17.0, abs=1.0)


@given(
    shape=st.sampled_from(sorted(SHAPES)),
    shift=st.floats(-0.29, 0.29),
    noise=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**32 - 1),
)
def test_delay_stands_noise(shape, shift, noise, seed):
    rng = np.random.default_rng(seed)
    first, second = (SHAPES[shape]((TIMES - s) / TURN) for s in (0.0, shift))
    size = noise * np.std(first)
    first, second = (x + size * rng.standard_normal(x.size) for x in (first, second))
    assert float(histories.delay(TIMES, first, second, TURN)) == pytest.approx(shift, abs=3 * STEP)


@pytest.mark.slow
def test_delay_is_differentiable():
    first = jnp.asarray(SHAPES["sine"](TIMES / TURN))

    def value(s):
        return histories.delay(TIMES, first, 2 + jnp.sin(2 * jnp.pi * (TIMES - s) / TURN + 0.3) ** 3, TURN)

    traced = jax.jit(value)
    slope, wanted = float(jax.jit(jax.grad(value))(0.05)), float(traced(0.05 + 1e-6) - traced(0.05 - 1e-6)) / 2e-6
    assert slope == pytest.approx(wanted, rel=1e-5)
    assert slope == pytest.approx(1.0, abs=0.02)
    assert traced(0.05) == pytest.approx(float(value(0.05)), abs=1e-12)


def test_delay_of_what_does_not_correlate_is_nan():
    sine = np.sin(2 * np.pi * TIMES / TURN)
    for other in (
        np.ones_like(TIMES),
        np.full_like(TIMES, 0.1),
        np.zeros_like(TIMES),
        np.where(TIMES > 2, np.nan, sine),
    ):
        assert math.isnan(histories.delay(TIMES, sine, other, TURN))
        assert math.isnan(histories.delay(TIMES, other, sine, TURN))


@pytest.mark.parametrize("wrong", [0.0, -0.6, math.nan, 3.1, 0.003])
def test_delay_needs_a_period_inside_the_history(wrong):
    with pytest.raises(InputError, match=r"period: .*give one"):
        histories.delay(TIMES, TIMES, TIMES, wrong)


# --- settling


@pytest.mark.parametrize("tolerance", [0.01, 0.05, 0.2])
def test_settling_of_a_decay_is_that_of_its_formula(tolerance):
    """exp(-a t) (1 - exp(-a P)) S = tolerance * peak, with the peak of a square wave of size 1."""
    turn, decay, size = 0.5, 4.0, 3.0
    force = 10.0 + size * np.exp(-decay * TIMES)
    wanted = math.log(size * (1 - math.exp(-decay * turn)) / (tolerance * force[-501])) / decay
    found = histories.settling_time(TIMES, force, turn, tolerance)
    assert found == pytest.approx(max(wanted, 0.0), abs=1.01 * STEP)


@EVERY
def test_settling_of_the_paper(shape):
    """Q31: periodic from 0.585 s on; the last sample off it, 0.584 s, is the last that does not repeat itself."""
    force = 1e4 * SHAPES[shape](TIMES / 0.61)
    assert histories.settling_time(TIMES, force, 0.61) == 0.0
    force[TIMES < 0.5845] += 5e4
    assert histories.settling_time(TIMES, force, 0.61) == pytest.approx(0.585)
    assert histories.settling_time(TIMES, -force, 0.61) == pytest.approx(0.585)


def test_what_never_settles_has_no_settling_time():
    assert math.isnan(histories.settling_time(TIMES, np.exp(TIMES), 0.6))
    assert math.isnan(histories.settling_time(TIMES, np.where(TIMES < 1.9, 5.0, 1.0), 0.6))
    assert histories.settling_time(TIMES, np.where(TIMES < 1.7, 5.0, 1.0), 0.6) == pytest.approx(1.7)
    assert math.isnan(histories.settling_time(TIMES, np.where(TIMES < 1.0, np.nan, 1.0), 0.6))


@pytest.mark.parametrize(("turn", "tolerance", "says"), [(1.6, 0.05, "at most 1.5 s"), (0.6, 0.0, "tolerance: 0")])
def test_settling_needs_two_periods_and_a_tolerance(turn, tolerance, says):
    with pytest.raises(InputError, match=says):
        histories.settling_time(TIMES, TIMES, turn, tolerance)


def test_period_of_a_few_samples_without_order_is_found_or_not_but_never_fails():
    for seed in range(300):
        rng = np.random.default_rng(seed)
        values = rng.standard_normal(rng.integers(8, 30))
        found = histories.period(np.arange(values.size), values)
        assert np.isnan(found) or found > 0.0
