"""Long records as short tables: the error that is asked for, the filter's gain in closed form, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bcfj_jax as bj


@given(st.integers(0, 1000), st.integers(2, 200), st.floats(0.0, 3.0))
def test_straight_lines_stay_within_the_error(seed, count, error):
    random = np.random.default_rng(seed)
    times, values = np.cumsum(random.uniform(0.1, 2.0, count)), np.cumsum(random.normal(size=count))
    found = bj.thinned(times, values, error)
    off = np.abs(np.interp(times, found.times, found.values) - values).max()
    assert found.error == off <= error * (1.0 + 1e-12) + 1e-12 and found.filtered == 0.0
    assert set(found.times) <= set(times) and found.times[0] == times[0] and found.times[-1] == times[-1]


def test_what_is_straight_is_its_corners():
    times = np.linspace(0.0, 3.0, 301)
    values = np.interp(times, [0.0, 1.0, 2.5, 3.0], [0.0, 5.0, 5.0, -2.0])
    np.testing.assert_allclose(bj.thinned(times, values, 1e-9).times, [0.0, 1.0, 2.5, 3.0], atol=1e-12)


def test_a_sine_needs_rows_as_far_apart_as_its_chords_allow():
    """A chord of h departs from a curve of curvature c by c h^2/8; a line may leave it by twice the error."""
    times = np.linspace(0.0, 10.0, 100_001)
    rows = bj.thinned(times, np.sin(times), 1e-4).times.size
    # Of the mean over a period of sqrt(|sin|), .7628.
    least = 10.0 * 0.7628 / np.sqrt(16.0 * 1e-4)
    assert 0.9 * least < rows < 1.6 * least


@pytest.mark.parametrize("frequency", [5.0, 20.0, 35.0])
def test_the_filter_has_its_gain_and_no_delay(frequency):
    step, band = 1e-3, 20.0
    times = np.arange(4001) * step
    values = np.sin(2.0 * np.pi * frequency * times)
    gain = 1.0 / (1.0 + (np.tan(np.pi * frequency * step) / np.tan(np.pi * band * step)) ** 8)
    found = bj.thinned(times, values, 0.0, band)
    inside = (found.times > 1.0) & (found.times < 3.0)
    np.testing.assert_allclose(found.values[inside], gain * np.interp(found.times, times, values)[inside], atol=2e-4)
    assert found.filtered == pytest.approx((1.0 - gain) * np.sqrt(0.5), abs=0.01)  # Ends aside.


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (([0.0, 1.0, 1.0], [0.0, 1.0, 2.0], 0.1), r"times\[2\] = 1 follows 1"),
        (([0.0], [1.0], 0.1), "2 or more finite times"),
        (([0.0, 1.0], [0.0, np.nan], 0.1), "finite"),
        (([0.0, 1.0], [0.0, 1.0], -1.0), "error"),
        (([0.0, 1.0, 3.0], [0.0, 1.0, 2.0], 0.1, 0.2), "steps of 1 to 2 s"),
        (([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], 0.1, 0.7), "0.7 Hz of a record at 1 Hz.*0.5 Hz"),
    ],
)
def test_what_is_no_record_is_refused(given, said):
    with pytest.raises(bj.InputError, match=said):
        bj.thinned(*given)
