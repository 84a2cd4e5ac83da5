"""What is said before and after the solve: idle and trading parameters, bad data, clearances that nothing shows."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.diagnostics import fit_tests, influence
from calibration.diagnostics.answers import clearance_tests, gap_of, whole_contact_test
from calibration.diagnostics.optimum import Optimum
from calibration.fit import AllStartsFailed
from calibration.forward import model
from calibration.forward.runs import contacts, failure, refusal
from calibration.noise.noise_model import Estimate
from calibration.search.refinement import End
from calibration.search.starts import referred
from calibration.uncertainty.estimates import estimates

pytestmark = pytest.mark.filterwarnings("error")

# A linear contact without loss: F = v sqrt(K m) sin(w t), half a period of 3.1 ms after a flight of 1 ms.
MASS, SPEED, STIFFNESS, GAP = 0.1, 1.0, 1e5, 1e-3
OMEGA, PEAK = np.sqrt(STIFFNESS / MASS), SPEED * np.sqrt(STIFFNESS * MASS)
TIMES = np.linspace(0.0, 6e-3, 50)
SCENE = scenes.impact(smoothing=False)
KNOWN = {"mass": MASS, "stiffness": STIFFNESS, "exponent": 1.0, "damping": 0.0}
PARAMS = {k: float(v) for k, v in SCENE.parameters(**KNOWN, approach_speed=SPEED, clearance_contact=GAP).items()}
LAW = (Free("stiffness", 1e4, 1e6), Free("clearance_contact", 1e-4, 3e-3, scale="linear"))


def force(times: np.ndarray) -> np.ndarray:
    phase = OMEGA * (times - GAP / SPEED)
    return np.where((phase > 0) & (phase < np.pi), PEAK * np.sin(phase), 0.0)


def problem(free=LAW, times=TIMES, readings=None, sigma: float | None = 1.0, seed=0, **more) -> Problem:
    noisy = force(times) + np.random.default_rng(seed).standard_normal(times.size)
    channel = Channel("contact.normal", noisy if readings is None else readings, sigma)
    return Problem(SCENE, PARAMS, (Experiment("a", times, (channel,)),), free, **more)


def at(free, values, times=TIMES):
    """Model and a point of it."""
    made = problem(free, times)
    built = model.build(made, made.experiments)
    order = [s.name for s in built.coordinates]
    return made, built, built.point(np.array([values[name] for name in order])), tuple(order)


@pytest.mark.slow
def test_directions_that_trade_are_named_with_what_separates_them():
    """A force history tells v sqrt(K m) and K/m: of stiffness, mass and speed one combination stays free."""
    free = (Free("stiffness", 1e4, 1e6), Free("mass", 0.01, 1.0), Free("approach_speed", 0.1, 10.0))
    made, built, point, labels = at(free, {"stiffness": STIFFNESS, "mass": MASS, "approach_speed": SPEED}, TIMES)
    built = jax.tree_util.tree_map(lambda x: x, built)
    built.data.fixed["clearance_contact"] = jnp.zeros(1)
    told = influence.at_start(made, built, labels, point, np.zeros(3))
    assert told["singular_values"][-1] < 1e-2 < 1.0 < told["singular_values"][1]
    (weak,) = told["weak"]
    assert set(weak["parameters"]) == set(labels)
    assert "trade against each other here" in weak["text"]
    assert "weighed mass" in weak["remedy"]
    # Their ranges are equal on a logarithmic scale; K and m rise together and v falls as much.
    jacobian = np.asarray(model.residuals_and_jacobian(built, jnp.asarray(point))[1])
    direction = np.linalg.svd(jacobian)[2][-1]
    np.testing.assert_allclose(direction / direction[0], [1.0, 1.0, -1.0], atol=1e-2)


@pytest.mark.slow
def test_what_moves_nothing_by_the_noise_is_refused():
    """Over a range of 0.1 % a stiffness moves a peak of 100 N by 0.05 N, all 25 readings together by a third of 1 N."""
    free = (Free("stiffness", 0.9995 * STIFFNESS, 1.0005 * STIFFNESS), LAW[1])
    made, built, point, labels = at(free, {"stiffness": STIFFNESS, "clearance_contact": GAP})
    with pytest.raises(InputError, match=r"\[free.stiffness\].*moves no residual by more than"):
        influence.at_start(made, built, labels, point, np.zeros(2))
    # Ten times the range and it is not.
    free = (Free("stiffness", 0.995 * STIFFNESS, 1.005 * STIFFNESS), LAW[1])
    made, built, point, labels = at(free, {"stiffness": STIFFNESS, "clearance_contact": GAP})
    assert influence.at_start(made, built, labels, point, np.zeros(2))["reach"]["stiffness"] > 1.0


def test_data_that_no_model_explains_are_refused():
    with pytest.raises(InputError, match=r"the force pulls.*flip its sign"):
        influence.refuse_data(problem(readings=-force(TIMES)))
    with pytest.raises(InputError, match="all 50 readings are 7 N"):
        influence.refuse_data(problem(readings=np.full(50, 7.0)))
    # With its zero free, a push on a large negative zero is a push.
    offset = (*LAW, Free("force_offset", -500.0, 500.0))
    influence.refuse_data(problem(offset, readings=force(TIMES) - 400.0))
    with pytest.raises(InputError, match="flip its sign"):
        influence.refuse_data(problem(offset, readings=400.0 - force(TIMES)))


@pytest.mark.full
@pytest.mark.parametrize(
    ("last", "gap", "passed", "words"),
    [
        (6e-3, GAP, True, ""),
        (0.5e-3, GAP, False, "never touches"),
        (2e-3, 0.0, False, "touches all the time"),
        (6e-3, 0.0, False, "only lets go"),
    ],
)
def test_a_clearance_must_be_seen_crossed(last, gap, passed, words):
    free = (LAW[0], Free("clearance_contact", 0.0, 3e-3))
    times = np.linspace(1e-4, last, 50)
    _, built, point, _ = at(free, {"stiffness": STIFFNESS, "clearance_contact": gap}, times)
    seen = contacts(built, point)
    (test,) = clearance_tests(built, seen)
    assert test.passed == passed and words in test.reason
    if passed:
        assert seen[0].durations == pytest.approx([np.pi / OMEGA], abs=1e-5)
        assert whole_contact_test(built, seen, True)[0].passed
        assert "shorter than a contact" in whole_contact_test(built, seen, False)[0].reason


@pytest.mark.slow
@pytest.mark.parametrize("gap", tiers.ci([0.3e-3, 1.2e-3], 1.2e-3))
def test_how_well_a_clearance_is_known_does_not_depend_on_how_large_it_comes_out(gap):
    """Else the verdict would pick large estimates, and intervals of those it picked would miss the truth."""
    known = 0.5e-3
    free = (LAW[0], Free("clearance_contact", 1e-4, 3e-3))
    assert free[1].log and not free[1].as_share and free[0].as_share
    made, built, point, _ = at(free, {"stiffness": STIFFNESS, "clearance_contact": gap})
    assert built.coordinates[1].drawn(np.array([0.0, 0.5, 1.0])) == pytest.approx(
        [0.0, (3e-7**0.5 - 1e-4) / 2.9e-3, 1.0]
    )
    width = np.array([np.log(100.0), 2.9e-3])
    jacobian = np.diag(width / [0.1, known])
    best = End(point, point, 0.0, np.zeros(2), jacobian, True)
    spread = fit_tests.spread(best, 50, [], "linear")
    found = estimates(Optimum(built, made.experiments, best, Estimate({}, {}, []), spread)).parameters
    gap_found, half = found["clearance_contact"], 1.96 * known
    assert gap_found.identifiable
    # Not beyond the bounds that were given.
    assert gap_found.ci95 == pytest.approx((max(gap - half, 1e-4), gap + half), rel=1e-3)


def test_little_minima_within_the_uncertainty_are_one_optimum_where_a_cost_is_rough():
    def ends(at, rise):
        places = [np.array([0.5, 0.5]), *([np.array([0.5 + at, 0.5])] * 3)]
        return tuple(
            End(p, p, 100.0 + rise * (i > 0), np.zeros(0), np.zeros((0, 2)), True) for i, p in enumerate(places)
        )

    def agreeing(at, rise, rough):
        return fit_tests.agreement(ends(at, rise), 1e-4 * np.eye(2), np.zeros(1), rough)[0].value

    # A deviation is 0.01; two draws of two coordinates are some 1.4 apart.
    assert agreeing(0.01, 5.0, True) == 4 and agreeing(0.01, 5.0, False) == 1
    assert agreeing(0.02, 5.0, True) == agreeing(0.01, 10.0, True) == 1
    assert agreeing(0.02, 0.05, True) == agreeing(0.02, 0.05, False) == 4


def test_names_that_mean_a_gap():
    assert gap_of("clearance_seat_cage") == "seat_cage" and gap_of("drop_height") == "contact"
    assert gap_of("stiffness") is None


def test_a_failed_simulation_is_given_its_reason(monkeypatch):
    honest = model.plan
    monkeypatch.setattr(model, "plan", lambda scene, accuracy, max_steps: honest(scene, accuracy, max_steps=2))
    _, built, point, _ = at(LAW, {"stiffness": STIFFNESS, "clearance_contact": GAP})
    assert failure(built, point) == "the step budget of 2 steps was spent"


@pytest.mark.slow
def test_all_starts_failing_names_the_commonest_reason(monkeypatch):
    honest = model.plan
    monkeypatch.setattr(model, "plan", lambda scene, accuracy, max_steps: honest(scene, accuracy, max_steps=2))
    with pytest.raises(AllStartsFailed, match="none of 32 starting points simulates: the step budget of 2 steps"):
        fit(problem(), starts=4)


@pytest.mark.slow
def test_fits_of_other_data_compile_nothing_and_a_short_record_is_said_to_be_short():
    first = fit(problem(), starts=4)
    assert first.verdict == "identified", first.reasons
    assert first.parameters["clearance_contact"].value == pytest.approx(GAP, rel=0.05)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, _, **__: compiled.append(name) if name == "/jax/core/compile/backend_compile_duration" else None
    )
    try:
        second = fit(problem(seed=1), starts=4)
        assert compiled == []
        assert second.values != first.values
        # Up to 2 ms the force still rises: a whole contact was not seen.
        short = fit(problem(times=np.linspace(0.0, 2e-3, 50)), starts=4)
    finally:
        jax.monitoring.clear_event_listeners()
    assert short.verdict != "identified"
    assert any("shorter than a contact" in reason for reason in short.reasons)


@pytest.mark.slow
def test_a_point_whose_values_contradict_each_other_is_named_and_passed_over():
    scene = scenes.impact(law="hertz", elastic="two_stage", smoothing=False)
    free = (Free("stiffness", 1e4, 1e6), Free("exponent", 1.0, 2.0), Free("bottoming_width", 1e-6, 1e-2))
    params = {k: float(v) for k, v in scene.parameters(mass=MASS, bottoming_penetration=1e-3).items()}
    experiment = Experiment("a", TIMES, (Channel("contact.normal", force(TIMES), 1.0),))
    built = model.build(Problem(scene, params, (experiment,), free), (experiment,))
    wide, narrow = (built.point(np.array([STIFFNESS, 1.0, width])) for width in (5e-3, 1e-4))
    assert not refusal(built, narrow)
    told = "bottoming_width = 0.005 is more than bottoming_penetration = 0.001"
    assert told in refusal(built, wide) and told in failure(built, wide)
    far = built.at_depth(0.5)
    assert referred(far, [wide, narrow]).log_depth == referred(far, [narrow]).log_depth != 0.5
    assert referred(far, [wide]).log_depth == 0.5
