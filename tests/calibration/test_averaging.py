"""The mean of a Jacobian over a normal distribution, against its closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.noise.averaging import averaged, stepped
from calibration.search.refinement import End

PLACE = np.array([0.5, 0.4])
COVARIANCE = np.array([[4e-3, 1e-3], [1e-3, 2e-3]])


def end(jacobian):
    return End(PLACE, PLACE, 0.0, np.zeros(2), jacobian, True)


def cubic(points):
    """Residuals u0^3 and u0 u1^2: the mean of the slopes is exact by a rule of degree 3."""
    u, v = points.T
    jacobian = np.stack([np.stack([3 * u**2, 0 * u], -1), np.stack([v**2, 2 * u * v], -1)], 1)
    return np.stack([u**3, u * v**2], -1), jacobian


def test_mean_of_polynomial_slopes_is_that_of_the_normal_distribution():
    found = averaged(cubic, end(cubic(PLACE[None])[1][0]), COVARIANCE)
    (a, b), (aa, ab, bb) = PLACE, COVARIANCE[[0, 0, 1], [0, 1, 1]]
    expected = [[3 * (a**2 + aa), 0.0], [b**2 + bb, 2 * (a * b + ab)]]
    assert found.jacobian == pytest.approx(np.array(expected), rel=1e-12)


def test_arrival_of_a_spike_is_known_less_well_than_its_slope_says():
    # A spike of width w that arrives at u: the slope's mean is that of the spike smeared over the deviation s.
    times, width, deviation = np.linspace(0.0, 1.0, 400), 0.02, 0.03
    spike = lambda u, w: np.exp(-((times - u) ** 2) / (2 * w**2)) * width / w  # noqa: E731
    slope = lambda u, w: spike(u, w) * (times - u) / w**2  # noqa: E731

    def evaluate(points):
        return np.stack([spike(u, width) for (u,) in points]), np.stack([slope(u, width)[:, None] for (u,) in points])

    best = End(PLACE[:1], PLACE[:1], 0.0, spike(0.5, width), slope(0.5, width)[:, None], True)
    found = averaged(evaluate, best, np.array([[deviation**2]]))
    smeared = slope(0.5, np.hypot(width, deviation))
    local, mean, true = (float(np.linalg.norm(j)) for j in (best.jacobian, found.jacobian, smeared))
    assert mean < 0.7 * local and abs(mean - true) < 0.5 * (local - true)


def test_points_that_fail_are_left_out():
    def half(points):
        residuals, jacobians = cubic(points)
        bad = points[:, 0] > PLACE[0] + 0.07
        jacobians[bad] = np.nan
        return residuals, jacobians

    assert np.isfinite(averaged(half, end(np.ones((2, 2))), COVARIANCE).jacobian).all()
    none = averaged(lambda p: (cubic(p)[0], np.nan * cubic(p)[1]), end(np.ones((2, 2))), COVARIANCE)
    assert np.array_equal(none.jacobian, np.ones((2, 2)))


def test_a_step_leaves_a_little_minimum_for_the_one_that_the_mean_slope_points_to():
    # A straight line with a ripple on it: 40 waves a unit, steep enough for minima of their own.
    data = np.linspace(0.0, 1.0, 50)
    slope = np.ones((50, 1))

    def evaluate(points):
        u = points[:, :1]
        rippled = u - 0.45 + 0.01 * np.sin(2 * np.pi * 40 * u + 6 * data)
        return rippled, np.broadcast_to(slope, (len(points), 50, 1))

    at = np.array([0.52])
    best = End(at, at, float(np.sum(evaluate(at[None])[0] ** 2)), evaluate(at[None])[0][0], slope, True)
    found = stepped(evaluate, best)
    assert abs(found.point[0] - 0.45) < 0.003 < abs(at[0] - 0.45)
    assert found.cost == pytest.approx(np.sum(found.residuals**2)) and found.cost < best.cost
    outside = replace(best, jacobian=0.01 * slope)
    far = replace(best, residuals=20.0 * best.residuals, jacobian=20.0 * slope)
    assert stepped(evaluate, outside) is outside and stepped(evaluate, far) is far
    assert stepped(lambda p: (np.nan * evaluate(p)[0], slope[None]), best) is best
