"""What a measuring chain makes of a force, against SciPy; features as observables, against closed forms."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import plain_joint
from scipy.signal import lsim

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem, command, fit
from calibration.diagnostics.records import features_of
from calibration.forward import model
from calibration.forward.observables import fine
from calibration.forward.observables import low_pass as low_pass_by_steps
from calibration.problem import Observation
from calibration.report import plots
from calibration.search.refinement import finish

pytestmark = pytest.mark.filterwarnings("error")

# Undamped linear contact: F = v sqrt(K m) sin(w t) for half a period, w = sqrt(K/m).
MASS, SPEED, STIFFNESS = 0.1, 1.0, 1e5
OMEGA = np.sqrt(STIFFNESS / MASS)
PEAK, CONTACT = SPEED * np.sqrt(STIFFNESS * MASS), np.pi / OMEGA
IMPACT = scenes.impact(smoothing=False)
LAW = {"mass": MASS, "stiffness": STIFFNESS, "exponent": 1.0, "damping": 0.0}
DROP, GRAVITY = 0.05, 9.81
BOUNCE = scenes.bounce(smoothing=False)
# An operation at a time it compiles a hundred little programs.
low_pass = jax.jit(low_pass_by_steps)


def params(scene, **more) -> dict[str, float]:
    return {k: float(v) for k, v in scene.parameters(**LAW, **more).items()}


def half_sine(times: np.ndarray) -> np.ndarray:
    return np.where((times > 0) & (times < CONTACT), PEAK * np.sin(OMEGA * times), 0.0)


@pytest.mark.full
def test_low_pass_is_scipys():
    rng = np.random.default_rng(0)
    times, values = np.linspace(0.0, 0.02, 400), rng.standard_normal((400, 2))
    rate = 2 * np.pi * 300.0
    for column in range(2):
        _, out, _ = lsim(([rate], [1.0, rate]), values[:, column] - values[0, column], times)
        ours = low_pass(jnp.asarray(times), jnp.asarray(values), jnp.asarray(300.0))[:, column]
        np.testing.assert_allclose(ours, out + values[0, column], atol=1e-10)


@pytest.mark.full
def test_low_pass_of_nothing_and_of_no_time():
    times, values = jnp.array([0.0, 0.0, 1e-3, 3e-3]), jnp.array([[1.0], [5.0], [2.0], [2.0]])
    # So fast a sensor reads what is there; over no time it moves by nothing, and its derivative stays finite.
    np.testing.assert_allclose(low_pass(times, values, jnp.asarray(1e12))[2:], values[2:], atol=1e-8)
    assert low_pass(times, values, jnp.asarray(50.0))[1, 0] == 1.0
    slope = jax.jit(jax.jacfwd(lambda b: low_pass(times, values, b)))(jnp.asarray(50.0))
    assert np.isfinite(slope).all()


def test_fine_times_hold_the_given_ones():
    for first in (-1e-3, 0.0, 2e-3):
        times = jnp.asarray(first + np.array([0.0, 1e-3, 1.5e-3]))
        sampled, places = fine(times, 4)
        np.testing.assert_array_equal(sampled[places], times)
        assert float(sampled[0]) == min(first, 0.0) and np.all(np.diff(sampled) >= -1e-18)


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [60.0, 1000.0])
def test_a_slow_sensor_reads_the_filtered_force(bandwidth):
    """Forty readings of a contact by a sensor of first order, beside SciPy's at a hundred times the resolution."""
    times = np.linspace(-1e-3, 2.0 * CONTACT, 40)
    one = Experiment("a", times, (Channel("contact.normal", half_sine(times), 1.0),), fixed={"gain": 2.0})
    free = (Free("stiffness", 1e4, 1e6), Free("bandwidth", 10.0, 1e4))
    built = model.build(Problem(IMPACT, params(IMPACT, approach_speed=SPEED), (one,), free, 1e-6), (one,))
    point = jnp.asarray(built.point(np.array([STIFFNESS, bandwidth])))
    read = np.asarray(model.predictions(built, point))[0, 0]
    dense = np.linspace(0.0, times[-1], 40_001)
    rate = 2 * np.pi * bandwidth
    _, out, _ = lsim(([rate], [1.0, rate]), half_sine(dense), dense)
    np.testing.assert_allclose(read, 2.0 * np.interp(times, dense, out), atol=2e-4 * PEAK)
    _, jacobian = model.residuals_and_jacobian(built, point)
    ends = [model.residuals_and_jacobian(built, point.at[1].add(s * 1e-4))[0] for s in (-1, 1)]
    np.testing.assert_allclose(jacobian[:, 1], (ends[1] - ends[0]) / 2e-4, atol=1e-3 * np.abs(jacobian[:, 1]).max())


def seen(**features: float) -> tuple[Observation, ...]:
    return tuple(Observation(f"contact.{name}", value, 0.01 * value) for name, value in features.items())


@pytest.mark.slow
def test_features_are_those_of_the_closed_form():
    """A ball that bounces without loss: speed sqrt(2 g h), period of flight and contact, impulse 2 m v a contact."""
    speed = np.sqrt(2 * GRAVITY * DROP)
    # Contact on a spring under gravity: x'' = g - w^2 x from speed v; it lasts (pi + 2 atan(g/(w v)))/w.
    contact = (np.pi + 2 * np.arctan(GRAVITY / (OMEGA * speed))) / OMEGA
    period, fall = 2 * speed / GRAVITY + contact, speed / GRAVITY
    peak = MASS * GRAVITY + MASS * np.sqrt(GRAVITY**2 + (OMEGA * speed) ** 2)
    span = fall + 2.5 * period
    impulse = 3 * (2 * MASS * speed + MASS * GRAVITY * contact)
    wanted = seen(peak=peak, period=period, impulse=impulse, mean=impulse / span, contact_fraction=3 * contact / span)
    one = Experiment("a", np.zeros(0), (), features=wanted, span=span)
    problem = Problem(BOUNCE, params(BOUNCE, drop_height=DROP, gravity=GRAVITY), (one,), FREE, 1e-8)
    built = model.build(problem, (one,))
    point = jnp.asarray(built.point(np.array([STIFFNESS, MASS])))
    residuals, jacobian = model.residuals_and_jacobian(built, point)
    # In units of 1 % each: a contact is some 100 of 10001 samples long.
    np.testing.assert_allclose(residuals, 0.0, atol=0.05)
    # ln K by its box: dF/d ln K is F/2 but for the weight, and the period's is -contact/2 but for gravity.
    width = np.log(10.0)
    assert jacobian[0, 0] == pytest.approx(100 * width * 0.5, rel=0.02)
    slope = -0.5 * np.pi / OMEGA / period * 100 * width
    assert jacobian[1, 0] == pytest.approx(slope, rel=0.02)


FREE = (Free("stiffness", STIFFNESS / 5, 2 * STIFFNESS), Free("mass", MASS / 2, 2 * MASS))


@pytest.mark.slow
def test_features_alone_can_be_fitted(tmp_path):
    """Peak v sqrt(K m) and impulse 2 m v tell stiffness and mass, with intervals that follow from them by hand."""
    wanted = (Observation("contact.peak", PEAK, 0.01 * PEAK), Observation("contact.impulse", 2 * MASS * SPEED, 2e-3))
    wanted += (Observation("contact.mean", 2 * MASS * SPEED / (1.5 * CONTACT), 1.0),)
    one = Experiment("a", np.zeros(0), (), features=wanted, span=1.5 * CONTACT)
    problem = Problem(IMPACT, params(IMPACT, approach_speed=SPEED), (one,), FREE)
    found = fit(problem, starts=4)
    assert found.verdict == "identified", found.reasons
    for name, true in (("stiffness", STIFFNESS), ("mass", MASS)):
        assert found.parameters[name].value == pytest.approx(true, rel=2e-3)
    # ln m = ln J + const: 1 % of the impulse beside 1 N of its mean; ln K = 2 ln peak - ln m + const.
    mass = 1.0 / np.hypot(1.0 / 0.01, wanted[2].value / wanted[2].sigma)
    low, high = np.log(found.parameters["mass"].ci95)
    assert (high - low) / 2 == pytest.approx(1.96 * mass, rel=0.01)
    low, high = np.log(found.parameters["stiffness"].ci95)
    assert (high - low) / 2 == pytest.approx(1.96 * np.hypot(0.02, mass), rel=0.01)
    # Of pictures there is the loop; there are no readings to draw.
    plots.records(found, problem, tmp_path / "fit.png")
    plots.force_penetration(found, problem, tmp_path / "loop.png")
    assert [p.name for p in tmp_path.iterdir()] == ["loop.png"]
    assert f"a contact.peak: {PEAK:.4g} fitted" in command.text(found)


@pytest.mark.slow
def test_period_and_delay_of_a_joint_are_those_of_its_rotation():
    """Six equal balls in a turning plane: each repeats after 2 pi/w, and the next is a sixth of that ahead."""
    scene, speed = plain_joint(fidelity="kinematic"), 20.0
    period = 2 * np.pi / speed
    wanted = (Observation("seat_ball_1.period", period, 1e-3 * period),)
    wanted += tuple(
        Observation(f"seat_ball_1:seat_ball_{k}.delay", d * period, 1e-3 * period)
        for k, d in ((2, -1 / 6), (3, -1 / 3))
    )
    one = Experiment("a", np.zeros(0), (), features=wanted, span=4.2 * period)
    given = {k: float(v) for k, v in scene.parameters(drive_speed=speed, load_ramp=1e-6).items()}
    built = model.build(Problem(scene, given, (one,), (Free("drive_speed", speed / 2, 2 * speed),)), (one,))
    residuals, jacobian = model.residuals_and_jacobian(built, jnp.array([0.5]))
    np.testing.assert_allclose(residuals, 0.0, atol=1.0)
    # Every time goes with 1/w; the box is ln 4 wide.
    np.testing.assert_allclose(jacobian[:, 0], -1000 * np.log(4) * np.array([1, -1 / 6, -1 / 3]), rtol=0.02)


@pytest.mark.slow
def test_features_beside_a_history_weigh_as_they_are_stated():
    """Readings g F and a peak g P of one gain g: the least squares of both, by hand."""
    times, rng = np.linspace(0.0, CONTACT, 30), np.random.default_rng(0)
    readings, sigma = 1.1 * half_sine(times) + 2.0 * rng.standard_normal(30), 2.0
    peak = Observation("contact.peak", 1.05 * PEAK, 0.5)
    one = Experiment("a", times, (Channel("contact.normal", readings, sigma),), features=(peak,))
    free = (Free("gain", 0.5, 1.5, scale="linear"),)
    built = model.build(Problem(IMPACT, params(IMPACT, approach_speed=SPEED), (one,), free), (one,))
    end = finish(built, np.array([0.5]), np.array([0.5]))
    known = np.sum(half_sine(times) ** 2) / sigma**2 + PEAK**2 / peak.sigma**2
    best = (half_sine(times) @ readings / sigma**2 + PEAK * peak.value / peak.sigma**2) / known
    assert 0.5 + end.point[0] == pytest.approx(best, abs=1e-5)
    assert np.sum(end.jacobian**2) == pytest.approx(known, rel=1e-4)
    seen = features_of(built, (one,), end.residuals)["a contact.peak"]
    assert seen["fitted"] == pytest.approx(best * PEAK, rel=1e-4) and seen["measured"] == peak.value


def test_features_that_cannot_be_are_refused():
    def problem(name, sigma=1.0, span: float | None = 1.0):
        one = Experiment("a", np.zeros(0), (), features=(Observation(name, 1.0, sigma),) * 4, span=span)
        return Problem(BOUNCE, params(BOUNCE, drop_height=DROP), (one,), FREE)

    for arguments, words in (
        (("contact.peek",), "did you mean 'peak'"),
        (("contct.peak",), "no contact 'contct'"),
        (("contact.peak", 0.0), "feature_noise above 0"),
        (("contact.peak", 1.0, None), "give span"),
    ):
        with pytest.raises(InputError, match=words):
            problem(*arguments)
