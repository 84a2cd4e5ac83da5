"""Features against closed forms."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax import features

pytestmark = pytest.mark.filterwarnings("error")

TIMES = np.linspace(0.0, 1.0, 4001)


def half_sines(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d = sin(8 pi t - 1) and its rate: contacts of 1/8 s every 1/4 s, the first at 1/(8 pi)."""
    return np.sin(8 * np.pi * times - 1), 8 * np.pi * np.cos(8 * np.pi * times - 1)


def test_peak_mean_impulse():
    force = np.sin(np.pi * TIMES) ** 2
    assert float(features.peak(force)) == pytest.approx(1.0)
    assert float(features.impulse(TIMES, force)) == pytest.approx(0.5)
    assert float(features.mean(TIMES * 2, force)) == pytest.approx(0.5)


def test_dissipated_work_is_the_area_of_the_loop():
    angle = 2 * np.pi * TIMES
    force, depth = 3.0 * np.sin(angle + 0.4), 2.0 * np.sin(angle)
    assert float(features.dissipated_work(force, depth)) == pytest.approx(math.pi * 3.0 * 2.0 * math.sin(0.4), rel=1e-5)


def test_onsets_are_found_between_coarse_samples():
    times = np.linspace(0.0, 1.0, 65)
    depth, rate = half_sines(times)
    found = features.onsets(times, depth, rate)
    starts = [1 / (8 * np.pi) + k / 4 for k in range(4)]
    assert [start for start, _ in found] == pytest.approx(starts, abs=2e-5)
    assert [end for _, end in found] == pytest.approx([s + 1 / 8 for s in starts], abs=2e-5)
    assert features.period(times, depth, rate) == pytest.approx(0.25, abs=1e-5)
    late = times > 0.1
    assert features.period(times[late], depth[late], rate[late]) == pytest.approx(0.25, abs=1e-5)


def test_open_ends():
    depth = TIMES - 0.5
    assert features.onsets(TIMES, depth, np.ones_like(depth))[0][0] == pytest.approx(0.5)
    assert math.isnan(features.onsets(TIMES, depth, np.ones_like(depth))[0][1])
    assert features.onsets(TIMES, -depth, -np.ones_like(depth))[0] == pytest.approx((0.0, 0.5))
    assert math.isnan(features.period(TIMES, depth, np.ones_like(depth)))
    assert features.onsets(TIMES, TIMES, np.ones_like(depth))[0][0] == 0.0
    assert features.onsets(TIMES, depth - 1, np.ones_like(depth)) == []


def test_a_contact_between_two_samples_is_told_by_the_rate():
    times = np.linspace(0.0, 1.0, 100)
    depth, rate = -np.abs(times - 0.4), np.where(times < 0.4, 1.0, -1.0)
    assert len(features.unseen(depth, rate)) == 1
    assert features.onsets(times, depth, rate)[0] == pytest.approx((0.4, 0.4))
    smooth = -0.5 - (times - 0.4) ** 2
    assert len(features.unseen(smooth, -2 * (times - 0.4))) == 0


def test_contact_fraction():
    depth, _ = half_sines(TIMES)
    assert float(features.contact_fraction(TIMES, depth)) == pytest.approx(0.5, abs=1e-6)
    assert float(features.contact_fraction(TIMES, np.zeros_like(depth))) == 0.0


def test_delay_resolves_less_than_a_sample():
    times = np.linspace(0.0, 1.0, 101)
    first, second = (np.exp(-(((times - t) / 0.1) ** 2)) for t in (0.3012, 0.6047))
    assert float(features.delay(times, first, second)) == pytest.approx(0.3035, abs=2e-5)
    assert float(features.peak_time(times, times)) == 1.0


def test_features_are_differentiable():
    times = jnp.asarray(TIMES)

    def force(scale):
        return scale * jnp.sin(jnp.pi * times) ** 2

    assert float(jax.grad(lambda s: features.impulse(times, force(s)))(2.0)) == pytest.approx(0.5)
    assert float(jax.grad(lambda s: features.peak(force(s)))(2.0)) == pytest.approx(1.0)
    slope = jax.grad(lambda s: features.peak_time(times, jnp.exp(-jnp.square((times - s) / 0.1))))(0.4)
    assert float(slope) == pytest.approx(1.0, abs=1e-3)
    share = jax.grad(lambda s: features.contact_fraction(times, times - s))(0.30001)
    assert float(share) == pytest.approx(-1.0, abs=1e-9)


def test_summary_of_a_failed_history_is_nan():
    depth, rate = half_sines(TIMES)
    depth[2000:] = rate[2000:] = np.nan
    found = features.summary(TIMES, depth, depth, rate)
    assert set(found) == set(features.UNITS)
    assert math.isnan(found["peak"])
    assert math.isnan(found["impulse"])
    assert found["contact_start"] == pytest.approx(1 / (8 * np.pi))
