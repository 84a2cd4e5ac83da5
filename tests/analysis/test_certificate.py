"""The certificate calls each derivative what it is: good, good on average, kinked, chaotic, without influence."""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest
from bumps import bumps
from joints import plain_joint

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives import certificate
from bcfj_jax.analysis.derivatives.certificate import Growth, Seen, averaged, compare, difference, growth, norm
from bcfj_jax.analysis.derivatives.differences import Beside, against
from bcfj_jax.analysis.derivatives.table import drivers, unknown

TRUSTED, AVERAGED, NOT = "trusted", "averaged only", "not differentiable here"
BOUNCE = bj.scenes.bounce(smoothing=False)
SOFT = BOUNCE.parameters(stiffness=1e4, damping=0.05, drop_height=0.1)
TIMES = np.linspace(0.0, 1.0, 2001)
NAMES = ("stiffness", "damping", "gravity")


def bounced(accuracy, **options):
    return bj.sensitivity(BOUNCE, SOFT, TIMES, NAMES, accuracy=accuracy, **options)


def test_a_comparison_with_what_failed_is_infinitely_apart():
    line = np.stack([TIMES, 2.0 * TIMES], 1)
    broken = np.where(TIMES[:, None] < 0.25, line, np.nan)
    for pair in ((line, broken), (broken, line)):
        found = difference(TIMES, *pair, 1e-3, 0.1)
        assert found.relative == np.inf and found.where == found.broken == pytest.approx(0.25)

    def failing(worst):
        """Forces whose runs fail beyond a change of the parameter."""
        return lambda values: np.where(abs(values[0] - 1.0) > worst, np.nan, values[0] * line)

    step = np.array([1.0])
    for worst, relative in ((0.0, np.inf), (1.0, 0.0)):
        found = against(Beside(TIMES, failing(worst), np.array([1.0]), 1e-9, 0.05), step, line)
        assert found.pointwise.relative == pytest.approx(relative, abs=1e-9)
    # Where the longer step alone fails, nothing excuses a wrong derivative.
    h = 0.3 * 1e-9 ** (1.0 / 3.0)
    found = against(Beside(TIMES, failing(0.5 * h), np.array([1.0]), 1e-9, 0.05), step, 1.5 * line)
    assert 0.2 < found.pointwise.relative < 0.5


def test_a_run_that_fails_late_is_compared_until_then():
    line = np.stack([TIMES, 2.0 * TIMES], 1)

    def forces(values):
        """Forces of runs that fail at 0.6 s above the parameter's value."""
        whole = values[0] * line
        return np.where(TIMES[:, None] < 0.6, whole, np.nan) if values[0] > 1.0 else whole

    good, wrong = (against(Beside(TIMES, forces, np.ones(1), 1e-9, 0.05), np.ones(1), k * line) for k in (1.0, 1.5))
    assert good.until == wrong.until == pytest.approx(0.5995)
    assert good.pointwise.relative < 1e-6 and 0.2 < wrong.pointwise.relative < 0.5
    calm, levels = Growth(1.0, 0.0), compare("levels", TIMES, line, 1.01 * line, 0.0, 0.05)
    features = {"contact.peak": 0.01, "contact.mean": 0.05, "contact.impulse": 0.5}
    found = certificate.check([levels, good], Seen(features, calm, 1.0, np.nan))
    assert found.verdict == TRUSTED and "after 0.5995 s" in found.unchecked
    assert list(found.feature_verdicts.values()) == [TRUSTED, AVERAGED, NOT]
    assert certificate.check([levels, wrong], Seen(features, calm, 1.0, np.nan)).verdict == NOT
    # A run that fails at once checks nothing: the derivative stays what the levels say it is.
    nothing = against(Beside(TIMES, lambda values: np.nan * line, np.ones(1), 1e-9, 0.05), np.ones(1), line)
    found = certificate.check([levels, nothing], Seen(features, calm, 1.0, np.nan))
    assert found.verdict == TRUSTED and found.pointwise == levels.pointwise.relative and not found.lost
    assert found.unchecked == "central differences check nothing: a run beside this one failed"


def test_differences_that_are_noise_check_nothing():
    line, draw = np.stack([TIMES, 2.0 * TIMES], 1), np.random.default_rng(1)

    def forces(values):
        return values[0] * line + 0.01 * draw.normal(size=line.shape)

    noise, calm = against(Beside(TIMES, forces, np.ones(1), 1e-9, 0.05), np.ones(1), line), Growth(1.0, 0.0)
    assert noise.vague
    assert not against(Beside(TIMES, lambda x: x[0] * line, np.ones(1), 1e-9, 0.05), np.ones(1), line).vague
    levels = compare("levels", TIMES, line, 1.01 * line, 0.0, 0.05)
    found = certificate.check([levels, noise], Seen({}, calm, 1.0, np.nan))
    assert found.verdict == TRUSTED and found.unchecked == certificate.VAGUE and found.compared_with == ("levels",)
    # Tangents that grow beyond all measure are then not believed, though tolerances agree about them.
    assert certificate.check([levels, noise], Seen({}, Growth(1e7, 9.0), 1.0, np.nan)).verdict == NOT
    assert certificate.check([levels], Seen({}, Growth(1e7, 9.0), 1.0, np.nan, vague=True)).verdict == NOT


def test_a_longer_step_is_taken_only_where_the_shorter_disagrees():
    line, runs = np.stack([TIMES, 2.0 * TIMES], 1), []

    def forces(values):
        runs.append(values[0])
        return values[0] * line

    for slope, count in ((1.0, 2), (1.2, 4)):
        runs.clear()
        against(Beside(TIMES, forces, np.ones(1), 1e-6, 0.05), np.ones(1), slope * line, enough=0.03)
        assert len(runs) == count


def test_a_longer_step_is_taken_where_the_shorter_disagrees_by_more_than_a_small_noise():
    line, runs = np.stack([TIMES, 2.0 * TIMES], 1), []

    def found(error, slope):
        runs.clear()
        rng = np.random.default_rng(0)

        def forces(values):
            runs.append(values[0])
            return values[0] * line + error * np.sqrt(np.mean(line**2)) * rng.choice([-1.0, 1.0], line.shape)

        return against(Beside(TIMES, forces, np.ones(1), error, 0.05), np.ones(1), slope * line, enough=1e-4)

    assert found(1e-5, 1.0).pointwise.relative == 0.0 and len(runs) == 2
    # 3 % is more than the noise of .9 %, and a noise of 40 % hides too much.
    assert found(1e-5, 1.03).pointwise.relative > 0.01 and len(runs) == 4
    assert not found(3e-3, 1.0).vague and len(runs) == 4


@pytest.mark.slow
def test_the_budget_ends_the_comparison_and_says_so():
    # At 1e-6 the direction of all is bad at this loose tolerance, so that each parameter is asked for.
    told = []
    found = bounced(0.5, levels=1, budget=0.0, tell=told.append)
    first, bounded = told
    assert first.certificate is None and first.feature_derivatives == found.feature_derivatives
    assert [set(c.feature_verdicts) for c in bounded.certificate.parameters.values()] == [set(found.features)] * 3
    for check in found.certificate.parameters.values():
        assert "the budget of 0 s was spent" in check.unchecked
        assert len(check.compared_with) == 1


def bumped(accuracy, end=3.0, **options):
    """A ball on bumps until ``end`` [s]: a derivative's error grows by 3.5 a second, 1 % to 30 % in one."""
    scene = bumps()
    times = np.linspace(0.0, end, 2001)
    return bj.sensitivity(scene, scene.parameters(), times, ("stiffness", "drop_height"), accuracy=accuracy, **options)


@pytest.mark.slow
def test_a_loose_tolerance_is_caught_and_tightened_away():
    loose = bumped(0.5, levels=1).certificate
    assert loose.verdict == NOT
    for check in loose.parameters.values():
        assert check.verdict == NOT
        # 6 % of the averages at 2 s.
        assert 1.5 < check.breakdown < 2.6
        assert "tighter accuracy" in check.remark
    tight = bumped("reference")
    assert tight.certificate.verdict == TRUSTED
    assert max(c.average for c in tight.certificate.parameters.values()) < 0.01
    assert np.isnan([c.breakdown for c in tight.certificate.parameters.values()]).all()
    # Balanced promises 3 % of the averages. Where it is not as good at once, it is tightened.
    assert all(c.average < 0.03 for c in bumped("balanced").certificate.parameters.values())
    climbed = bumped(0.02, end=4.0)
    assert climbed.stats["levels"] > 3
    assert climbed.certificate.reported < climbed.certificate.tolerances[0] / 4
    assert all(c.average < 0.06 for c in climbed.certificate.parameters.values())


@functools.cache
def over_stated(height):
    """Pointwise errors of the derivatives of a drop from there, over the figures that the certificate states."""
    params = {**SOFT, "drop_height": jnp.asarray(height)}
    # Variational equations by SciPy are 1e-5 to 4e-5 away from these.
    tight = bj.sensitivity(BOUNCE, params, TIMES, NAMES, accuracy=1e-9, certify=False)
    found = bj.sensitivity(BOUNCE, params, TIMES, NAMES)
    ratios = []
    for name in NAMES:
        best = tight.derivative[name]["contact"]
        error = norm(TIMES, found.derivative[name]["contact"] - best) / norm(TIMES, best)
        ratios.append(error / found.certificate.parameters[name].pointwise)
    return ratios


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.09, 0.1])
def test_the_figure_stated_is_not_less_than_the_error_itself(height):
    assert max(over_stated(height)) < 1.0


@pytest.mark.slow
def test_the_figure_stated_is_the_size_of_the_error():
    ratios = [ratio for height in (0.08, 0.09, 0.0999, 0.1, 0.1001, 0.11, 0.12) for ratio in over_stated(height)]
    assert max(ratios) < 1.0 and np.median(ratios) > 1.0 / 3.0, ratios


@pytest.mark.slow
def test_a_jump_exactly_at_an_output_time_is_caught():
    # Kelvin and Voigt's force jumps at the touch, by dashpot times speed, at 10 us.
    scene = bj.scenes.impact("kelvin_voigt", smoothing=False)
    params = scene.parameters(clearance_contact=1.5e-5, stiffness=1e8, dashpot=200.0)
    for times in (np.array([1e-5]), np.linspace(0.0, 1e-4, 201)):
        found = bj.sensitivity(scene, params, times, ("clearance_contact", "dashpot"))
        check = found.certificate.parameters["clearance_contact"]
        assert check.verdict == NOT
        assert check.breakdown == pytest.approx(1e-5, abs=6e-6)
        assert "kink or a jump" in check.remark
        assert any("central differences" in what for what in check.compared_with)
        assert found.certificate.parameters["dashpot"].verdict == TRUSTED


def voigt(times, mass, speed, clearance, stiffness, dashpot):
    """Force on a spring and dashpot that are struck at clearance over speed, in closed form (T,), until they would pull."""
    since = np.maximum(times - clearance / speed, 0.0)
    decay = dashpot / (2.0 * mass)
    turn = np.sqrt(stiffness / mass - decay**2)
    gone = np.exp(-decay * since)
    depth = speed / turn * gone * np.sin(turn * since)
    rate = speed * gone * (np.cos(turn * since) - decay / turn * np.sin(turn * since))
    return np.where(since > 0.0, np.maximum(stiffness * depth + dashpot * rate, 0.0), 0.0)


@pytest.mark.slow
def test_the_derivative_of_a_force_that_jumps_is_its_closed_form():
    # The force jumps at the touch, at clearance over speed, between two samples. Steps land there: the tangents jump, too.
    scene = bj.scenes.impact("kelvin_voigt", smoothing=False)
    given = {"mass": 2.35, "approach_speed": 0.246, "clearance_contact": 3.4e-7, "stiffness": 5.1e10, "dashpot": 1.32e5}
    times, values = np.linspace(0.0, 3.3e-5, 401), np.array(list(given.values()))
    found = bj.sensitivity(scene, scene.parameters(given), times, tuple(given)[:3])
    for k, name in enumerate(found.wrt):
        step = 1e-6 * values[k] * np.eye(5)[k]
        exact = (voigt(times, *(values + step)) - voigt(times, *(values - step))) / (2.0 * step[k])
        error = norm(times, found.derivative[name]["contact"][:, :1] - exact[:, None]) / norm(times, exact[:, None])
        check = found.certificate.parameters[name]
        assert check.verdict == TRUSTED and error < check.pointwise < 2e-3


@pytest.mark.slow
def test_a_kink_at_the_only_output_time_is_caught():
    # A linear spring without smoothing: dF/d(clearance) is 0 before the touch and K v after it.
    scene = bj.scenes.impact("hertz", smoothing=False)
    params = scene.parameters(clearance_contact=1.5e-5, exponent=1.0, stiffness=1e8)
    kinked = bj.sensitivity(scene, params, np.array([1e-5]), ("clearance_contact",))
    assert kinked.certificate.verdict == NOT
    # Hertz's force leaves zero with a slope of zero: nothing to see at the touch.
    smooth = bj.sensitivity(
        scene, scene.parameters(clearance_contact=1.5e-5), np.linspace(0, 5e-5, 101), ("clearance_contact",)
    )
    assert smooth.certificate.verdict == TRUSTED


@pytest.mark.slow
def test_a_chaotic_bounce_is_called_chaotic():
    scene = bumps()
    found = bj.sensitivity(scene, scene.parameters(), np.linspace(0.0, 8.0, 2001), ("stiffness", "drop_height"))
    for check in found.certificate.parameters.values():
        assert check.verdict == NOT
        assert check.growth > 1e6
        assert 1.0 < check.exponent < 10.0
        assert f"{check.exponent:.3g} per second" in check.remark
        # Off by 1e-6 at first, by 10 % after ln(1e5)/3.5 s.
        assert 2.0 < check.breakdown < 6.0
    # The same motion until its second bounce is not chaotic yet.
    short = bj.sensitivity(scene, scene.parameters(), np.linspace(0.0, 0.3, 2001), ("stiffness", "drop_height"))
    assert short.certificate.verdict == TRUSTED


@pytest.mark.slow
def test_no_influence_is_trusted():
    scene = bj.scenes.impact("hertz", smoothing=False)
    far = bj.sensitivity(scene, scene.parameters(clearance_contact=1.0), np.linspace(0.0, 1e-4, 51), ("stiffness",))
    check = far.certificate.parameters["stiffness"]
    assert (check.verdict, check.remark, check.influence) == (TRUSTED, "no influence", 0.0)
    assert not np.any(far.derivative["stiffness"]["contact"])
    zero = "at all 51 samples the force of contact is 0, and a shorter contact needs more samples"
    assert drivers(far) == []
    assert unknown(far) == f"What drives contact.peak is not known: {zero}"


def test_the_first_line_is_of_the_peak_that_moves_by_most_newtons():
    peaks = {"loaded.peak": 1e4, "grazed.peak": 10.0, "loaded.mean": 5e3, "grazed.mean": 1.0}
    slopes = {"gap": {"loaded.peak": 1e3, "grazed.peak": 5.0, "loaded.mean": 0.0, "grazed.mean": float("nan")}}
    given = {"wrt": ["gap"], "values": {"gap": 1.0}, "features": peaks, "feature_derivatives": slopes}
    (line,) = drivers(cast(Any, SimpleNamespace(steady=None, certificate=None, **given)))
    assert line == "gap drives loaded.peak: +0.1 % per %"
    # Steady motion alone, before the run has any feature.
    steady = SimpleNamespace(reason="", features=peaks, feature_derivatives=slopes, apart={})
    alone = {**given, "features": {}, "feature_derivatives": {"gap": {}}}
    (line,) = drivers(cast(Any, SimpleNamespace(steady=steady, certificate=None, **alone)))
    assert line == "gap drives steady loaded.peak: +0.1 % per %"


@pytest.mark.slow
def test_a_failed_run_is_not_differentiable():
    found = bounced("balanced", max_steps=60)
    assert found.status == "failed"
    assert "60 steps" in found.reason
    for check in found.certificate.parameters.values():
        assert (check.verdict, check.remark, check.breakdown) == (NOT, "the run failed", found.failure_time)


@pytest.mark.slow
def test_each_parameter_by_differences_on_request():
    found = bounced("reference", differences="each")
    assert found.certificate.direction is None
    for check in found.certificate.parameters.values():
        assert check.verdict == TRUSTED
        assert sum("central differences" in what for what in check.compared_with) == 1
    none = bounced("reference", differences="none")
    assert all(len(c.compared_with) == 1 for c in none.certificate.parameters.values())


def test_averages_and_norms():
    t = np.linspace(0.0, 1.0, 101) ** 1.5  # uneven
    line = np.stack([2.0 * t, np.ones_like(t)], axis=-1)
    mean = averaged(t, line, 0.1)
    inside = (t > 0.06) & (t < 0.94)
    assert mean[inside] == pytest.approx(line[inside], rel=1e-12)
    assert mean[0, 0] == pytest.approx(0.05)  # cut at the end: the mean of 2 t over [0, 0.05]
    assert float(norm(t, line[:, 1:])) == pytest.approx(1.0)
    assert np.isfinite(norm(t, 1e200 * line))
    lost = np.where(t[:, None] < 0.5, line, 3.0 * line)
    found = difference(t, lost, line, 0.0, 0.1)
    assert 0.5 <= found.broken < 0.53
    assert difference(t, line, line, 0.0, 0.1).relative == 0.0
    assert difference(t, np.where(t[:, None] < 0.5, line, np.nan), line, 0.0, 0.1).relative == np.inf


def test_growth():
    t = np.linspace(0.0, 2.0, 400)
    found = growth(t, np.exp(9.0 * t)[:, None])
    assert found.exponent == pytest.approx(9.0, rel=1e-2)
    assert found.factor > 1e6
    assert growth(t, np.zeros((400, 3))).factor == 1.0
    assert growth(t, np.full((400, 1), 1e-14)).factor == 1.0  # rounding
    assert growth(t, np.where(t < 1.0, 1.0, np.inf)[:, None]).factor == np.inf


@pytest.mark.slow
def test_a_ladder_of_smoothing():
    scene = bj.scenes.impact("kelvin_voigt")
    params = scene.parameters(clearance_contact=1.5e-5, stiffness=1e8, dashpot=200.0)
    widths = (4e-6, 1e-6, 2e-6)
    ladder = bj.smoothing_ladder(scene, params, np.linspace(0.0, 1e-4, 401), ("clearance_contact",), widths)
    assert [step.value for step in ladder] == sorted(widths)
    assert ladder[0].bias == 0.0 < ladder[1].bias < ladder[2].bias < 0.2
    # Wider is gentler: the jump's derivative falls with the width.
    sizes = [step.size["clearance_contact"] for step in ladder]
    assert sizes[0] > sizes[1] > sizes[2] > 0
    assert all(step.status == "ok" and step.steps > 0 for step in ladder)
    with pytest.raises(bj.InputError, match="no knob 'smooting'; did you mean 'smoothing'"):
        bj.smoothing_ladder(scene, params, TIMES, ("mass",), widths, knob="smooting")
    with pytest.raises(bj.InputError, match="has no friction_speed"):
        bj.smoothing_ladder(scene, params, TIMES, ("mass",), widths, knob="friction_speed")
    with pytest.raises(bj.InputError, match="smoothing = -1"):
        bj.smoothing_ladder(scene, params, TIMES, ("mass",), (-1.0,))


@pytest.mark.slow
def test_the_joint_is_bounded_and_its_rattle_is_chaotic():
    scene = plain_joint()
    params = scene.parameters()
    times = np.linspace(0.0, 0.3, 301)
    wrt = ("seat_ball.stiffness", "friction_static", "clearance_seat_cage")
    features = ("seat_ball.peak", "seat_ball_2.mean", "seat_ball:head_ball.delay")
    found = bj.sensitivity(scene, params, times, wrt, features=features)
    assert found.certificate.verdict != NOT
    for name, check in found.certificate.parameters.items():
        assert check.growth < 1e6
        assert check.average < 0.1
        assert found.derivative[name]["seat_ball"].shape == (301, 6, 3)
        assert np.isfinite(found.feature_derivatives[name]["seat_ball.peak"])
    # Sharper than the balls' clearance, free balls rattle.
    sharp = bj.sensitivity(scene, {**params, "smoothing": jnp.asarray(5e-6)}, times, wrt, features=features)
    assert sharp.certificate.verdict == NOT
