"""The extremes: whatever the box holds ends well or says why not; and what was mended for it, one test each."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import within

import bcfj_jax as bj
from bcfj_jax import InputError, scenes, sensitivity, simulate
from bcfj_jax.contact.restitution import delivered_restitution, undamped_duration
from bcfj_jax.core.status import OK, reason
from bcfj_jax.solve.plan import plan
from bcfj_jax.solve.simulation import outcome
from benchmarks.analysis.extremes import energies, ramp

BALL, GRAVITY, BUDGET = 0.016731, 9.81, 4000


def decades(low, high, *corners):
    """Numbers spread by decades, and values that have none."""
    spread = st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))
    return st.one_of(spread, *(st.just(corner) for corner in corners))


BOX = {
    "stiffness": decades(1e3, 1e13),
    "exponent": st.floats(1.0, 3.0),
    "mass": decades(1e-3 * BALL, 1e3 * BALL),
    "smoothing": decades(1e-9, 1e-4, 0.0),
}
LOSS = {
    "exact": {"restitution": st.floats(0.0, 1.0)},
    "memory_free": {"damping": decades(1e-4, 1e2, 0.0)},
    "adams_impact": {"dashpot": decades(1e-3, 1e5, 0.0), "damping_depth": decades(1e-9, 1e-3)},
}
START = {
    "impact": {"approach_speed": decades(1e-6, 50.0, 0.0), "clearance_contact": decades(1e-9, 5e-3, 0.0)},
    "bounce": {"drop_height": decades(5e-14, 127.0, 0.0)},
}


@functools.cache
def attempt(kind, law):
    """The scene, and a compiled run of it with the derivative of its force in one direction of all parameters."""
    scene = scenes.make(kind, law=law)
    how = plan(scene, "balanced", BUDGET)

    @jax.jit
    def run(params, moves, times):
        def force(p):
            solution, readings = outcome(scene, p, times, how, "forward", True)
            return readings["contact"].force, solution

        return jax.jvp(force, (params,), (moves,), has_aux=True)

    return scene, run


def energy(kind, params, states):
    """Kinetic, of the height and of a power law [J], at T instants; and how much the body's sag is worth."""
    total, sag = energies({name: np.array([float(value)]) for name, value in params.items()}, kind, states[None])
    return total[0], float(np.max(sag))


# Compiling each takes seconds; a bounce is an impact, and a flight.
SLOW = set(itertools.product(START, LOSS)) - {("bounce", "exact")}


@pytest.mark.full
@pytest.mark.parametrize(
    ("kind", "law"),
    [pytest.param(*x, marks=pytest.mark.slow if x in SLOW else ()) for x in itertools.product(START, LOSS)],
)
@settings(max_examples=40)
@given(data=st.data(), end=decades(1e-7, 1e3, 0.0))
def test_every_case_ends_well_or_says_why_not(kind, law, data, end):
    scene, run = attempt(kind, law)
    box = BOX | LOSS[law] | START[kind]
    params = scene.parameters({name: data.draw(values, name) for name, values in box.items()})
    try:
        scene.check(params)
    except InputError:
        return
    until = end or float(scene.horizon(params)) or 1e-3
    times = jnp.linspace(0.0, until, 17)
    moves = {name: jnp.where(value != 0, value, 1e-6) for name, value in params.items()}
    force, slope, solution = run(params, moves, times)
    assert int(solution.accepted + solution.rejected) <= BUDGET
    if int(solution.code) != OK:
        assert reason(int(solution.code), BUDGET) and 0.0 <= float(solution.end) <= until
        assert not np.all(np.isfinite(force))
        return
    assert np.all(np.isfinite(force)) and np.all(np.isfinite(slope))
    total, sag = energy(kind, params, np.asarray(solution.states))
    # A hundredth, what "balanced" promises of a force, of all energy there is.
    assert np.max(total - total[0]) <= 1e-2 * (abs(total[0]) + sag) + 1e-300


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("impact", "stiffness", 0.0), ("impact", "exponent", 0.9), ("impact", "exponent", 3.1),
        ("impact", "restitution", 1.1), ("impact", "restitution", -0.1), ("impact", "mass", 0.0),
        ("impact", "clearance_contact", -1e-9), ("impact", "smoothing", -1e-9), ("impact", "approach_speed", np.nan),
        ("bounce", "drop_height", -1.0), ("bounce", "gravity", np.inf),
        ("joint", "friction_static", 0.0), ("joint", "friction_static", 2.1), ("joint", "friction_speed", 0.0),
    ],
)  # fmt: skip
def test_what_is_outside_is_refused_with_the_limit(kind, name, value):
    scene = scenes.make(kind, law="exact")
    with pytest.raises(InputError, match=f"{name} = .* is out of range.*must be"):
        scene.parameters({name: value})


# --- What was mended, one test each ---


@pytest.mark.full
def test_a_body_thrown_out_of_its_regularisation_is_measured_by_that():
    """1 um/s, but 100 um within the onset of a steel surface: it leaves with 300 m/s, and once took 20 000 steps."""
    scene = scenes.impact("hertz")
    params = scene.parameters(stiffness=1e13, smoothing=1e-4, approach_speed=1e-6, mass=BALL)
    run = simulate(scene, params, np.linspace(0.0, 1e3, 11), max_steps=500)
    assert run.status == "ok"
    thrown = np.sqrt(2 * 1e13 * ramp(0.0, 1e-4) ** 2.5 / 2.5 / BALL)
    assert -run.rate["contact"][-1] == within(thrown, 1e-2)


@pytest.mark.full
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("impact", {"approach_speed": 0.0}),
        ("impact", {"approach_speed": 1e-6, "clearance_contact": 1e-9}),
        pytest.param("bounce", {"drop_height": 0.0, "stiffness": 1e13}, marks=pytest.mark.slow),
    ],
)
def test_a_body_at_rest_within_a_regularisation_has_no_approach_speed(kind, values):
    """Damping by an approach speed of nothing is rigid to a body that is thrown out: 20 000 steps and no end."""
    scene = scenes.make(kind, law="exact")
    params = scene.parameters(restitution=0.5, smoothing=1e-5, **values)
    for verb in (simulate, functools.partial(sensitivity, wrt=("stiffness",))):
        with pytest.raises(
            InputError, match=f"scene '{kind}' smoothing.* 1e-05 m the contact pushes the body away.*memory_free"
        ):
            verb(scene, params, np.array([0.0, 1e-3]))
    # Where the law needs no such speed the body leaves with what is stored.
    free = scenes.make(kind, law="hertz")
    params = free.parameters(smoothing=1e-5, **values)
    run = simulate(free, params, np.linspace(0.0, 1e-3, 11), max_steps=1000)
    assert run.status == "ok"
    away = -run.penetration["contact"][-1]
    left = ramp(-float(values.get("clearance_contact", 0.0)), 1e-5)
    energy = float(params["stiffness"]) * left**2.5 / 2.5
    speed = np.sqrt(2 * energy / BALL + values.get("approach_speed", 0.0) ** 2)
    fallen = 2 * GRAVITY * away if kind == "bounce" else 0.0
    assert np.hypot(run.rate["contact"][-1], np.sqrt(fallen)) == within(speed, 1e-2)


@pytest.mark.slow
def test_a_small_regularisation_does_not_change_what_a_restitution_delivers():
    scene = scenes.bounce("exact")
    params = scene.parameters(restitution=0.6, stiffness=1e11, smoothing=1e-6, drop_height=1e-2)
    fall = np.sqrt(2 * 1e-2 / GRAVITY)
    run = simulate(scene, params, np.array([0.0, 1.5 * fall]), accuracy=1e-5)
    up = -run.rate["contact"][-1]
    kept = np.sqrt(up**2 - 2 * GRAVITY * run.penetration["contact"][-1]) / (GRAVITY * fall)
    assert kept == within(0.6, 1e-3)


@pytest.mark.slow
def test_rest_within_a_wide_regularisation():
    """Its ups and downs there are no flights: to have learned a new approach speed in them made the law rigid."""
    scene = scenes.bounce("flores")
    values = {"stiffness": 779e3, "exponent": 1.0, "restitution": 0.06, "mass": 1.89e-5, "smoothing": 1.4e-9}
    params = scene.parameters(**values, drop_height=0.0)
    run = simulate(scene, params, np.linspace(0.0, 1e-3, 65), max_steps=2000)
    assert run.status == "ok"
    assert run.force["contact"][-1, 0] == within(1.89e-5 * GRAVITY, 1e-2)


@pytest.mark.slow
def test_a_short_run_ends_where_it_was_asked_to():
    """Let go on a soft surface, the natural first step is some seconds: a run of 0.1 us once went on for that long."""
    scene = scenes.bounce("memory_free")
    params = scene.parameters(stiffness=1e3, exponent=3.0, mass=1e-3 * BALL, drop_height=0.0)
    run = simulate(scene, params, np.array([0.0, 1e-7]), max_steps=50)
    assert run.status == "ok"
    assert run.penetration["contact"][-1] == within(0.5 * GRAVITY * 1e-14, 1e-6)
    alone = simulate(scene, params, np.zeros(1), max_steps=50)
    assert alone.status == "ok" and alone.penetration["contact"][0] == 0.0


@pytest.mark.slow
def test_energy_is_not_created_by_many_bounces():
    """Seven hundred without loss gained 13 % at "balanced": what one may add is now shared among them."""
    scene = scenes.bounce("hertz")
    params = scene.parameters(stiffness=2.55e6, exponent=1.0, mass=8.15, drop_height=1e-3)
    run = simulate(scene, params, np.linspace(0.0, 20.0, 2001))
    assert run.status == "ok"
    total, _ = energy("bounce", params, run.trajectory)
    assert abs(total / total[0] - 1.0).max() < 1e-2


@pytest.mark.slow
def test_derivatives_beyond_all_numbers_are_a_failure():
    """A body that stands where it would fall away stays; its derivative cosh(w t)/w^2 overflows, once "ok"."""

    def away(t, bodies, p):
        return [bj.loads.Action("left", force=(1e6 * bodies.place("left")[0] + p["push"], 0.0, 0.0))]

    # Another body swings, so that steps are short.
    swings = bj.Body("swings", "slide", mass=1.0, start={"position": 0.1})
    scene = bj.Mechanism(
        "unstable",
        [bj.Body("left", "particle", mass=1.0), swings],
        loads=[bj.Load("away", away), bj.loads.JointSpring("spring", "swings", stiffness=1e6)],
        own=[(bj.Quantity("push", "N", "force on it"), 0.0)],
    )
    found = sensitivity(
        scene, scene.parameters(), np.linspace(0.0, 2.0, 201), ("push",), features=("left.place.x.mean",), accuracy=0.1,
        certify=False,
    )  # fmt: skip
    assert found.status == "failed" and found.reason == "the derivatives stopped being finite"
    # Velocity's derivative, sinh(w t)/w, is the first to overflow, at w t = log(2 w 1.8e308).
    assert found.failure_time == pytest.approx(1e-3 * (np.log(2e3) + np.log(np.finfo(float).max)), abs=0.02)
    # The run itself did not fail.
    assert found.features["left.place.x.mean"] == 0.0
    assert np.isnan(found.feature_derivatives["push"]["left.place.x.mean"])


@pytest.mark.slow
def test_certified_derivatives_of_many_bounces_do_not_grow():
    """Steps of certified derivatives end on contacts: rounding does not grow; in flight nothing bears a force."""
    scene, drop = scenes.bounce("hertz", smoothing=False), 1e-3
    params = scene.parameters(stiffness=1e13, drop_height=drop)
    times = np.linspace(0.0, 20_000 * np.sqrt(2 * drop / GRAVITY), 101)
    landed = sensitivity(scene, params, times, ("drop_height",), accuracy=0.1, max_steps=4_000_000)
    assert landed.status == "ok" and not landed.force["contact"].any()
    assert not np.any(landed.derivative["drop_height"]["contact"])
    check = landed.certificate.parameters["drop_height"]
    assert check.verdict == "trusted" and check.growth < 1e3 and np.isnan(check.breakdown)


@pytest.mark.slow
def test_far_flights_cost_nothing():
    """Rounding of a place that is far away once counted as a step's error, and no step was short enough for it."""
    scene = scenes.impact("memory_free")
    params = scene.parameters(stiffness=1e13, exponent=1.0, damping=0.0, approach_speed=1e-3, clearance_contact=5e-3)
    contact = float(undamped_duration(1e13, 1.0, float(params["mass"]), 1e-3))
    run = simulate(scene, params, np.array([0.0, 5.0 + 0.5 * contact, 1e3]), accuracy=1e-4, max_steps=1000)
    assert run.status == "ok"
    assert -run.rate["contact"][-1] == within(1e-3 * float(delivered_restitution(0.0)), 1e-3)
