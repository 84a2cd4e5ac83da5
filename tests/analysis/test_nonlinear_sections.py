"""Sections and bifurcations against closed forms: the logistic map, a ball that bounces by Newton's restitution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from joints import plain_joint

from bcfj_jax import nonlinear, scenes, simulate
from bcfj_jax.core.errors import InputError

GRAVITY, HEIGHT = 9.81, 0.1
DOUBLINGS = 3.0, 1.0 + math.sqrt(6.0)


def bouncing(e: float, end: float, samples: int = 8001):
    """Newton's restitution, delivered exactly at every bounce, on a surface so stiff that contacts take no time."""
    scene = scenes.bounce("exact", smoothing=False)
    params = scene.parameters(restitution=e, stiffness=1e12, drop_height=HEIGHT, gravity=GRAVITY)
    run = simulate(scene, params, np.linspace(0.0, end, samples), accuracy=1e-7)
    assert run.status == "ok"
    return nonlinear.impacts(run.times, run.penetration["contact"], run.rate["contact"])


def logistic(values, transients=20_000, kept=64):
    return nonlinear.map_bifurcation(lambda x, r: r * x * (1.0 - x), 0.3, values, transients=transients, kept=kept)


def test_logistic_map_doubles_its_period_at_3_and_at_1_plus_root_6():
    step = 1e-3
    values = np.arange(2.9, 3.5, step)
    periods = np.array([nonlinear.period_number(row, 1e-6) for row in logistic(values)])
    # Within a step of a doubling the orbit needs longer than it had.
    sure = np.min(np.abs(values[:, None] - DOUBLINGS), axis=1) > step
    assert np.array_equal(periods[sure], 1 + (values > DOUBLINGS[0])[sure] + 2 * (values > DOUBLINGS[1])[sure])
    for period, critical in zip((2, 4), DOUBLINGS, strict=True):
        assert values[np.argmax(periods >= period)] == pytest.approx(critical, abs=1.5 * step)


def test_logistic_map_on_its_branches():
    """1 - 1/r; [r + 1 +- sqrt((r - 3)(r + 1))]/(2 r)."""
    one, two = logistic([2.8, 3.3], kept=2)
    assert one == pytest.approx([1.0 - 1.0 / 2.8] * 2, rel=1e-12)
    root = math.sqrt(0.3 * 4.3)
    assert np.sort(two) == pytest.approx([(4.3 - root) / 6.6, (4.3 + root) / 6.6], rel=1e-12)


def test_period_number():
    k = np.arange(40)
    assert nonlinear.period_number(np.ones(40), 0.0) == 1
    assert nonlinear.period_number((k % 3) + 1e-9 * k, 1e-6) == 3
    assert nonlinear.period_number(np.stack([k % 2, k % 3], 1), 0.0) == 6
    assert nonlinear.period_number(np.sin(k), 1e-3) == 0
    assert nonlinear.period_number(np.where(k == 20, np.nan, 1.0), 1.0) == 0
    assert nonlinear.period_number(k % 3, 0.0, most=2) == 0


def test_impacts_of_parabolic_flights_are_exact_on_coarse_samples():
    """Three flights of 0.3 s, touches of no length: approach at g 0.15 s."""
    times = np.linspace(0.0, 0.9, 65)
    within = np.mod(times, 0.3)
    depth = -0.5 * GRAVITY * within * (0.3 - within)
    rate = -GRAVITY * (0.15 - within)
    found = nonlinear.impacts(times[1:-1], depth[1:-1], rate[1:-1])
    assert found.times == pytest.approx([0.3, 0.6], abs=1e-12)
    assert found.speeds == pytest.approx([0.15 * GRAVITY] * 2, rel=1e-12)


def test_no_touch_no_impact():
    times = np.linspace(0.0, 1.0, 11)
    assert nonlinear.impacts(times, -np.ones(11), np.zeros(11)).times.size == 0
    # Pressed from the first sample on: when it began is not known.
    assert nonlinear.impacts(times, 1e-6 * np.ones(11), np.zeros(11)).times.size == 0


@pytest.mark.parametrize("e", [0.5, 0.7, 0.85])
def test_bounces_decay_by_newtons_restitution_and_accumulate_at_zenos_time(e):
    """v_k = e^k sqrt(2 g h), t_k = t_0 + (2 v_0/g)(e + .. + e^k), sum to sqrt(2 h/g) (1 + e)/(1 - e)."""
    fall = math.sqrt(2.0 * HEIGHT / GRAVITY)
    zeno = fall * (1.0 + e) / (1.0 - e)
    count = 6
    end = fall * (1.0 + 2.0 * sum(e**k for k in range(1, count))) + 0.5 * fall * e**count
    found = bouncing(e, end)
    k = np.arange(count)
    assert found.speeds == pytest.approx(e**k * fall * GRAVITY, rel=5e-3)
    assert found.times + 2.0 * found.speeds * e / GRAVITY / (1.0 - e) == pytest.approx(zeno, rel=5e-3)


@pytest.mark.slow
def test_bouncing_has_one_fixed_point_whatever_the_restitution():
    """Period 1 and no bifurcation: an unforced bouncing ball comes to rest (Guckenheimer and Holmes 1983, 2.4)."""
    scene = scenes.bounce("exact", smoothing=False)
    params = scene.parameters(drop_height=HEIGHT, gravity=GRAVITY, stiffness=1e9)
    values = [0.5, 0.6, 0.7]
    speeds, reasons = nonlinear.impact_bifurcation(scene, params, "restitution", values, 0.36, 2, samples=4001)
    assert reasons == [""] * 3
    assert speeds[:, 1] / speeds[:, 0] == pytest.approx(values, rel=1e-2)
    settled, _ = nonlinear.impact_bifurcation(scene, params, "restitution", values, 1.0, 8, samples=4001)
    first = math.sqrt(2.0 * GRAVITY * HEIGHT)
    assert np.nanmax(settled[:, -1]) < 0.05 * first
    assert all(nonlinear.period_number(row[-4:], 0.1 * first) == 1 for row in settled)


@pytest.mark.slow
def test_an_impact_run_that_fails_is_nan_and_says_why():
    scene = scenes.bounce("exact", smoothing=False)
    params = scene.parameters(drop_height=HEIGHT, stiffness=1e9)
    speeds, reasons = nonlinear.impact_bifurcation(
        scene, params, "restitution", [0.5, 0.6, 0.7], 0.36, 2, samples=4001, max_steps=40
    )
    assert np.isnan(speeds).all()
    assert all("40 steps" in text for text in reasons)


def test_what_is_wrong_with_a_section_is_said():
    joint, bounce = plain_joint(), scenes.bounce()
    p = joint.parameters()
    with pytest.raises(InputError, match="no drive"):
        nonlinear.stroboscopic(bounce, bounce.parameters())
    quiet = plain_joint(fidelity="quasistatic")
    with pytest.raises(InputError, match="no dynamics"):
        nonlinear.stroboscopic(quiet, quiet.parameters())
    with pytest.raises(InputError, match="phase"):
        nonlinear.stroboscopic(joint, p, phase=7.0)
    with pytest.raises(InputError, match="more revolutions"):
        nonlinear.stroboscopic(joint, p, 10, transients=20)
    with pytest.raises(InputError, match="clearance_seat_cage"):
        nonlinear.bifurcation(joint, p, "clearance_seat_cag", [1e-5])
    with pytest.raises(InputError, match="list"):
        nonlinear.bifurcation(joint, p, "clearance_seat_cage", 1e-5)
    with pytest.raises(InputError, match="no contact 'seat'"):
        nonlinear.impact_bifurcation(bounce, bounce.parameters(), "damping", [0.1], 1.0, 2, contact="seat")


@pytest.mark.slow
def test_joint_has_a_fixed_point_and_each_value_is_the_section_it_has_alone():
    """The loaded joint repeats itself (docs/joint.md); a value that spends its steps is NaN and harms no other."""
    scene = plain_joint()
    values = np.array([8.0, 12.0])
    how = {"transients": 3, "phase": 0.5, "accuracy": 1e-4}
    found = nonlinear.bifurcation(scene, scene.parameters(), "drive_speed", values, 6, **how)
    assert found.reasons == ["", ""] and not found.failed.any()
    assert found.times == pytest.approx((np.arange(3, 7) * 2.0 * np.pi + 0.5) / values[:, None])
    alone = nonlinear.stroboscopic(scene, scene.parameters(drive_speed=values[1]), 6, **how)
    for contact, force in alone.force.items():
        size = np.abs(force[..., 0]).max()
        assert found.force[contact][1, ..., 0] == pytest.approx(force[..., 0], abs=1e-4 * size)
        assert nonlinear.period_number(force[..., 0], 1e-4 * size) == 1
    steps = {"max_steps": 2000, **how}
    some = nonlinear.bifurcation(scene, scene.parameters(), "drive_speed", values, 6, **steps)
    assert some.failed.all() and "2000 steps" in some.reasons[0]
    assert np.isnan(some.force["seat_ball"]).all()
