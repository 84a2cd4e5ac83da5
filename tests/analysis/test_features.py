"""Features against closed forms."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.chebyshev import Chebyshev
from scipy.integrate import solve_ivp

from bcfj_jax.analysis import features
from bcfj_jax.core.errors import InputError

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


def test_dissipated_work_of_an_impact_is_the_kinetic_energy_lost():
    """m d'' = -F with Hunt and Crossley's damping, from SciPy: (m/2) (v0^2 - v1^2)."""

    def force(d, v):
        return np.maximum(0.0, 1e9 * np.maximum(d, 0.0) ** 1.5 * (1 + 0.8 * v))

    gone = lambda t, y: y[0] + 1e-12  # noqa: E731
    gone.terminal, gone.direction = True, -1
    run = solve_ivp(
        lambda t, y: [y[1], -force(*y)], (0, 1), [0.0, 1.0], events=gone, rtol=1e-10, atol=1e-14, max_step=2e-6
    )
    work = float(features.dissipated_work(force(*run.y), run.y[0]))
    assert work == pytest.approx(0.5 * (1 - run.y[1, -1] ** 2), rel=1e-5)
    assert work > 0.1


def test_contacts_are_found_between_coarse_samples():
    times = np.linspace(0.0, 1.0, 65)
    depth, rate = half_sines(times)
    found = features.contact_times(times, depth, rate)
    starts = [1 / (8 * np.pi) + k / 4 for k in range(4)]
    assert [start for start, _ in found] == pytest.approx(starts, abs=2e-5)
    assert [end for _, end in found] == pytest.approx([s + 1 / 8 for s in starts], abs=2e-5)
    assert features.contact_interval(times, depth, rate) == pytest.approx(0.25, abs=1e-5)
    late = times > 0.1
    assert features.contact_interval(times[late], depth[late], rate[late]) == pytest.approx(0.25, abs=1e-5)


def test_open_ends():
    depth = TIMES - 0.5
    assert features.contact_times(TIMES, depth, np.ones_like(depth))[0][0] == pytest.approx(0.5)
    assert math.isnan(features.contact_times(TIMES, depth, np.ones_like(depth))[0][1])
    assert features.contact_times(TIMES, -depth, -np.ones_like(depth))[0] == pytest.approx((0.0, 0.5))
    assert math.isnan(features.contact_interval(TIMES, depth, np.ones_like(depth)))
    assert features.contact_times(TIMES, TIMES, np.ones_like(depth))[0][0] == 0.0
    assert features.contact_times(TIMES, depth - 1, np.ones_like(depth)) == []


def test_a_contact_between_two_samples_is_found_by_the_rate():
    times = np.linspace(0.0, 1.0, 100)
    depth, rate = -np.abs(times - 0.4), np.where(times < 0.4, 1.0, -1.0)
    assert len(features.unseen(times, depth, rate)) == 1
    assert features.contact_times(times, depth, rate)[0] == pytest.approx((0.4, 0.4))
    smooth = -0.5 - (times - 0.4) ** 2
    assert len(features.unseen(times, smooth, -2 * (times - 0.4))) == 0
    # What rests far off turns by rounding.
    still = np.zeros(100)
    still[50:52] = 1e-12, -1e-12
    assert len(features.unseen(times, still - 0.1, still)) == 0


def test_contact_fraction():
    depth, _ = half_sines(TIMES)
    assert float(features.contact_fraction(TIMES, depth)) == pytest.approx(0.5, abs=1e-6)
    assert float(features.contact_fraction(TIMES, np.zeros_like(depth))) == 0.0


def test_delay_resolves_less_than_a_sample():
    times = np.linspace(0.0, 1.0, 101)
    first, second = (np.exp(-(((times - t) / 0.1) ** 2)) for t in (0.3012, 0.6047))
    assert float(features.delay(times, first, second)) == pytest.approx(0.3035, abs=2e-4)


def test_features_of_the_contract_are_one_number_each():
    depth, rate = half_sines(TIMES)
    force = np.maximum(0.0, depth)
    found = {
        "peak": features.peak(force),
        "mean": features.mean(TIMES, force),
        "impulse": features.impulse(TIMES, force),
        "period": features.period(TIMES, force),
        "dissipated_work": features.dissipated_work(force, depth),
        "residual_oscillation": features.residual_oscillation(TIMES, force),
        "contact_fraction": features.contact_fraction(TIMES, depth),
        "delay": features.delay(TIMES, force, np.roll(force, 80)),
    }
    assert {name for name, value in found.items() if np.shape(value) == () and np.isfinite(value)} == set(found)
    assert found["period"] == pytest.approx(features.contact_interval(TIMES, depth, rate), rel=1e-3)
    assert float(found["residual_oscillation"]) == float(features.oscillation(TIMES, force, None).amplitude)
    assert float(found["delay"]) == pytest.approx(0.02, abs=1e-4)


def test_features_are_differentiable():
    times = jnp.asarray(TIMES)

    def force(scale):
        return scale * jnp.sin(jnp.pi * times) ** 2

    assert float(jax.grad(lambda s: features.impulse(times, force(s)))(2.0)) == pytest.approx(0.5)
    assert float(jax.grad(lambda s: features.peak(force(s)))(2.0)) == pytest.approx(1.0)
    share = jax.grad(lambda s: features.contact_fraction(times, times - s))(0.30001)
    assert float(share) == pytest.approx(-1.0, abs=1e-9)
    # A parabola a - 4 (t - 1/2)^2 is above 0 for a^(1/2); its samples are 1/2000 of that apart.
    closed = jax.value_and_grad(lambda a: features.duration(times, a - 4.0 * (times - 0.5) ** 2))(0.3)
    np.testing.assert_allclose(closed, (0.3**0.5, 0.5 / 0.3**0.5), rtol=2e-4)


def test_summary_of_a_failed_history_is_nan():
    depth, rate = half_sines(TIMES)
    depth[2000:] = rate[2000:] = np.nan
    found = features.summary(TIMES, depth, depth, rate)
    assert set(found) == set(features.UNITS)
    assert math.isnan(found["peak"])
    assert math.isnan(found["impulse"])
    assert found["contact_start"] == pytest.approx(1 / (8 * np.pi))


# --- windows, the no-clearance fit and the loss of a pair (physics sheet, sections 6 and 7)

PAPER = np.linspace(0.0, 3.0, 3001)
WINDOW = (1.18, 1.82)


def joint_force(times: np.ndarray, scale=1.0):
    """A smooth course of one revolution [N] and a fast oscillation of size ``scale`` N."""
    return 9e3 + 4e3 * np.cos(2 * np.pi * times / 0.64) + scale * np.sin(2 * np.pi * times / 0.02)


def test_a_window_holds_both_its_ends():
    part = features.within(PAPER, WINDOW)
    assert PAPER[part][[0, -1]] == pytest.approx(WINDOW)
    assert part.stop - part.start == 641
    assert features.within(PAPER, None) == slice(0, 3001)
    assert features.within(PAPER, (0.0, 3.0)) == slice(0, 3001)
    assert float(features.peak(joint_force(PAPER)[features.within(PAPER, (1.27, 1.29))])) == pytest.approx(
        13e3, rel=1e-3
    )


@pytest.mark.parametrize(
    ("times", "window", "says"),
    [
        (PAPER, (1.8, 1.2), "window: 1.8 s to 1.2 s; give a start before the end"),
        (PAPER, (1.2, math.nan), "give a start before the end"),
        (PAPER, (2.5, 3.1), "window: 2.5 s to 3.1 s; stay inside the history, 0 s to 3 s"),
        (PAPER, (-0.1, 1.0), "stay inside the history"),
        (PAPER, (1.0001, 1.0002), "window: 0 samples; take a wider window"),
        (PAPER, (1.0, 1.008), "window: 9 samples for order 9; take a wider window, of at least 10 samples"),
        (PAPER[::-1], WINDOW, "times[1] = 2.999 follows 3; times must increase"),
        (np.where(PAPER == 1.0, math.nan, PAPER), WINDOW, "finite times"),
        (PAPER[:, None], WINDOW, "times: shape (3001, 1)"),
        (PAPER[:-1], WINDOW, "history: shape (3001,) over times of shape (3000,)"),
    ],
)
def test_what_is_wrong_with_a_window_is_said(times, window, says):
    with pytest.raises(InputError) as error:
        features.oscillation(times, joint_force(PAPER), window)
    assert says in str(error.value)


@pytest.mark.parametrize("order", [-1, 2.5])
def test_an_order_is_a_whole_number(order):
    with pytest.raises(InputError, match="order"):
        features.no_clearance_fit(PAPER, PAPER, WINDOW, order)


def test_traced_times_are_refused_and_traced_forces_are_not():
    with pytest.raises(InputError, match="traced"):
        jax.jit(lambda t: features.oscillation(t, PAPER, WINDOW).rms)(PAPER)
    forces = jnp.stack([joint_force(PAPER, scale) for scale in (10.0, 20.0)])
    found = jax.jit(jax.vmap(lambda f: features.oscillation(PAPER, f, WINDOW)))(forces)
    assert found.largest.shape == (2,)
    assert found.rms[1] == pytest.approx(float(features.oscillation(PAPER, forces[1], WINDOW).rms), rel=1e-12)


def test_a_polynomial_is_its_own_no_clearance_course():
    course = Chebyshev([5e3, 300, -200, 100, 50, -40, 30, 20, -10, 7], domain=list(WINDOW))
    fit = features.no_clearance_fit(PAPER, course(PAPER), WINDOW)
    assert fit.coefficients == pytest.approx(course.coef, abs=1e-8)
    assert fit.fitted == pytest.approx(course(fit.times), rel=1e-12)
    found = features.oscillation(PAPER, course(PAPER), WINDOW)
    assert float(found.largest) < 1e-8
    assert np.isfinite(jax.grad(lambda f: features.oscillation(PAPER, f, WINDOW).rms)(jnp.zeros(3001))).all()


@pytest.mark.parametrize("order", [0, 1, 5, 9, 12])
@pytest.mark.parametrize("window", [WINDOW, (1.52, 2.75), None])
def test_the_fit_is_that_of_numpy(order, window):
    rng = np.random.default_rng(order)
    times = np.sort(rng.uniform(0.0, 3.0, 500))
    window = window or (times[0], times[-1])
    force = joint_force(times, 800.0) + rng.normal(0.0, 50.0, 500)
    inside = (times >= window[0]) & (times <= window[1])
    other = Chebyshev.fit(times[inside], force[inside], order, domain=list(window))
    fit = features.no_clearance_fit(times, force, window, order)
    assert fit.coefficients == pytest.approx(other.coef, rel=1e-9, abs=1e-7)
    r = force[inside] - other(times[inside])
    assert fit.residual == pytest.approx(r, abs=1e-7)
    wanted = np.max(np.abs(r)), np.std(r), np.ptp(r) / 2, np.std(r) / np.mean(np.abs(other(times[inside])))
    # The residual of a fit with a constant in it has no mean.
    assert [float(x) for x in features.oscillation(times, force, window, order)] == pytest.approx(wanted, rel=1e-9)


def test_residual_oscillation_of_a_sine_on_a_polynomial():
    """32 periods of 0.02 s in 0.64 s are all but orthogonal to ten polynomials."""
    course = Chebyshev([9e3, 4e3, -2e3], domain=list(WINDOW))
    times = np.linspace(*WINDOW, 64001)
    found = features.oscillation(times, course(times) + 500 * np.sin(2 * np.pi * times / 0.02), WINDOW)
    assert float(found.rms) == pytest.approx(500 / math.sqrt(2), rel=0.02)
    assert float(found.amplitude) == pytest.approx(500, rel=0.1)
    assert float(found.relative) == pytest.approx(float(found.rms) / np.mean(np.abs(course(times))), rel=1e-3)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), noise=st.floats(0.0, 200.0))
def test_noise_adds_to_the_oscillation_no_more_than_itself(seed, noise):
    """The residual is a projection: |rms(F + e) - rms(F)| <= rms(e), and 10 of 641 degrees are the course's."""
    force, error = joint_force(PAPER, 500.0), noise * np.random.default_rng(seed).standard_normal(3001)
    clean, noisy = (features.oscillation(PAPER, f, WINDOW) for f in (force, force + error))
    size = np.sqrt(np.mean(error[features.within(PAPER, WINDOW)] ** 2))
    assert abs(float(noisy.rms - clean.rms)) <= size * (1 + 1e-9) + 1e-9
    assert float(noisy.rms) == pytest.approx(math.hypot(float(clean.rms), noise), rel=0.05, abs=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("name", features.Oscillation._fields)
def test_derivative_of_the_oscillation_is_that_of_differences(name):
    def value(x):
        force = joint_force(PAPER, 500.0) + x * jnp.sin(40 * PAPER) ** 5 * 1e3 + 100 * jnp.sin(x * 30 * PAPER)
        return getattr(features.oscillation(PAPER, force, WINDOW), name)

    step = 1e-6
    wanted = (float(value(1.3 + step)) - float(value(1.3 - step))) / (2 * step)
    assert abs(wanted) > 1e-4
    assert float(jax.grad(value)(1.3)) == pytest.approx(wanted, rel=1e-6)
    assert float(jax.jvp(value, (1.3,), (1.0,))[1]) == pytest.approx(wanted, rel=1e-6)


def test_a_failed_history_has_no_oscillation():
    force = joint_force(PAPER)
    force[1500:] = np.nan
    assert np.isnan(np.array(features.oscillation(PAPER, force, WINDOW))).all()
    assert np.isfinite(np.array(features.oscillation(PAPER, force, (0.2, 0.84)))).all()


def test_transfer_loss_of_the_paper():
    """Q26 to Q28: 39.84 kN in, 38.76 kN out, 2.71 % lost."""
    pulse = np.sin(np.pi * TIMES) ** 2
    assert float(features.transfer_loss(39.84e3 * pulse, 38.76e3 * pulse[::2])) == pytest.approx(0.0271, abs=5e-5)
    assert math.isnan(features.transfer_loss(0 * pulse, pulse))
    assert math.isnan(features.transfer_loss(pulse, np.where(TIMES > 0.5, np.nan, pulse)))
    slopes = jax.grad(lambda a, b: features.transfer_loss(a * pulse, b * pulse), (0, 1))(40.0, 38.0)
    assert [float(s) for s in slopes] == pytest.approx([38.0 / 40.0**2, -1 / 40.0])
    assert float(jax.grad(lambda a: jnp.nan_to_num(features.transfer_loss(a * pulse, pulse)))(0.0)) == 0.0


def test_onset_is_where_a_force_first_reaches_a_share_of_its_settled_peak():
    t = np.linspace(0.0, 3.0, 301)
    # A line to 4 N at 0.8 s, then steady: half of it at 0.4 s; the sign does not count.
    f = np.minimum(5.0 * t, 4.0)
    assert features.onset_time(t, f) == pytest.approx(0.4, abs=1e-12) == features.onset_time(t, -f)
    assert features.onset_time(t, f, share=0.1, level=10.0) == pytest.approx(0.2, abs=1e-12)
    assert features.onset_time(t, f, level=10.0) == np.inf == features.onset_time(t, 0.0 * t)
    # An overshoot before the last third is no settled peak.
    assert features.onset_time(t, f + 50.0 * (np.abs(t - 1.0) < 0.05)) == pytest.approx(0.4, abs=1e-12)
