"""Errors that may act against fits of records with that very error planted, by SciPy and by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim
from shown import brief, drawn

import bcfj_jax as bj
from bcfj_jax import InputError, scenes, simulate
from bcfj_jax.io.units import toleranced
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.diagnostics import signatures
from calibration.diagnostics.catalogue import ACTS, SELDOM, SENSOR, Shape
from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.forward.coordinates import Coordinate
from calibration.noise.noise_model import Estimate
from calibration.search.refinement import End
from calibration.uncertainty import quote, systematic
from calibration.uncertainty.sets import QUANTILE, Error, mixture

SCENE = scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
TIMES = np.linspace(0.0, 1.6e-3, 161)


def problem(error, seed=0) -> Problem:
    params = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, **TRUTH}).items()}
    force = simulate(SCENE, params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    sigma = 2e-3 * float(force.max())
    values = error(force) + sigma * np.random.default_rng(seed).standard_normal(force.size)
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, (Experiment("drop", TIMES, (Channel("contact.normal", values, None),)),), free)


def test_of_a_record_without_a_contact_the_fastest_swing_stands_for_one():
    """Of a sine 2/w; of two of 1 and 0.5 deviations with w and 4 w, w rms(1, 8)/rms(1, 2); of a straight line all of it."""
    clock, w = np.linspace(0.0, 1.0, 20001), 2.0 * np.pi * 20.0
    assert signatures._passing(clock, np.sin(w * clock)) == pytest.approx(2.0 / w, rel=1e-3)
    both = np.sin(w * clock) + 0.5 * np.sin(4.0 * w * clock)
    assert signatures._passing(clock, both) == pytest.approx(2.0 / w * np.sqrt(5.0 / 65.0), rel=1e-3)
    assert signatures._passing(clock, 3.0 * clock) == 1.0


@pytest.mark.slow
def test_a_line_says_what_a_fit_of_that_error_moves_by(tmp_path, monkeypatch):
    """Of the mass and of a bend of the gain, as large as their lines say."""
    found = fit(problem(lambda f: f), starts=4)
    lines = {line.error: line for line in found.systematic.lines}
    mass = lines["mass"].amplitude
    one = fit(
        replace(problem(lambda f: f), params={**problem(lambda f: f).params, "mass": 0.1 * (1.0 + mass)}), starts=4
    )
    bend = lines["bend of the gain"].amplitude
    two = fit(problem(lambda f: f * (1.0 + bend * f / f.max())), starts=4)
    for name in TRUTH:
        for error, other in (("mass", one), ("bend of the gain", two)):
            moved = abs(np.log(other.parameters[name].least_squares / found.parameters[name].least_squares))
            assert moved == pytest.approx(lines[error].moves[name], rel=0.15, abs=2e-4), (name, error)
    brief(found, f"Fit: {found.verdict}")
    drawn(found, tmp_path, monkeypatch)
    for name, one in found.parameters.items():
        assert found.to_pandas().loc[name, "value"] == one.value
    assert found.to_xarray().sizes["parameter"] == len(found.parameters)


@pytest.mark.slow
def test_an_error_that_residuals_show_is_bounded_by_them():
    """Less noise lets less pass, and nothing more than is called large."""
    loud = fit(problem(lambda f: f), starts=4)
    calm = problem(lambda f: f)
    (experiment,) = calm.experiments
    (channel,) = experiment.channels
    clean = simulate(SCENE, calm.params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    values = clean + 0.05 * (channel.values - clean)
    quiet = fit(
        replace(calm, experiments=(replace(experiment, channels=(replace(channel, values=values),)),)), starts=4
    )
    for more, less in zip(loud.systematic.lines, quiet.systematic.lines, strict=False):
        if more.error in ("bend of the gain", "lag", "drift"):
            assert 0.0 < less.amplitude <= more.amplitude <= 0.1


def stated(tolerance: str) -> tuple[float, float | None]:
    return toleranced(tolerance, "kg", "problem.toml: [parameters] mass")


def test_a_tolerance_is_a_share_or_a_value():
    assert stated("0.55 kg +- 2 %") == (0.55, pytest.approx(0.011))
    assert stated("550 g ± 5 g") == (pytest.approx(0.55), pytest.approx(0.005))
    assert stated("0.55 kg") == (0.55, None)
    # A certificate's uncertainty with its coverage factor, as a limit of 95 %.
    for text in ("0.55 kg +- 2 %, k = 2", "0.55 kg +- 2 % (k=2)"):
        assert stated(text) == (0.55, pytest.approx(0.011 * QUANTILE / 2.0))
    with pytest.raises(InputError, match="tolerance"):
        stated("0.55 kg +- 2 %, k = 0")
    with pytest.raises(InputError, match="mass: a tolerance of '-2 %'"):
        stated("0.55 kg +- -2 %")
    with pytest.raises(InputError, match="mass"):
        stated("0.55 kg +- 2 mm")


@pytest.mark.slow
def test_what_is_known_better_widens_less():
    """Errors of the mass: none, 1 % (not said) and 5 %; every error at its limit is wider than any of these."""
    plain = problem(lambda f: f)
    widths = []
    for tolerances in ({"mass": 0.0}, {}, {"mass": 0.005}):
        found = fit(replace(plain, tolerances=tolerances), starts=4)
        p = found.parameters["stiffness"]
        assert p.ci95 and p.with_budget == p.ci95 == p.intervals["errors"]
        assert p.ci95[0] < p.intervals["noise"][0] < p.intervals["noise"][1] < p.ci95[1]
        widths.append(np.log(p.ci95[1] / p.ci95[0]))
    assert widths[0] <= 1.01 * widths[1] <= 1.01**2 * widths[2]
    bound = fit(plain, starts=4, intervals="bound").parameters["stiffness"].ci95
    assert np.log(bound[1] / bound[0]) > widths[2]


@pytest.mark.full
def test_an_error_that_no_residual_shows_is_allowed_for():
    """A lag of a five-hundredth of a contact, by SciPy: the law is consistent, the interval of the noise is wrong."""
    tau = 2e-6
    lagged = lambda f: lsim(((1.0,), (tau, 1.0)), f, TIMES)[1]  # noqa: E731
    found = fit(problem(lagged), starts=4)
    assert found.verdict == "identified"
    noise = {name: p.intervals["noise"] for name, p in found.parameters.items()}
    off = [not low < TRUTH[name] < high for name, (low, high) in noise.items()]
    assert any(off)
    for name, p in found.parameters.items():
        assert p.ci95 and p.ci95[0] < TRUTH[name] < p.ci95[1]


def test_a_stated_sensor_has_a_line_of_its_own():
    """A clock known to 1 us in place of half a sample, and a gain that is known for certain."""
    plain = problem(lambda f: f)
    (experiment,) = plain.experiments
    stated = {"time_offset": 0.0, "gain": 1.0}
    known = replace(experiment, fixed=stated, tolerances={"time_offset": 1e-6, "gain": 0.0})
    loose, tight = (fit(p, starts=4) for p in (plain, replace(plain, experiments=(known,))))
    assert loose.systematic and tight.systematic
    assert {"clock", "gain"} <= {line.error for line in loose.systematic.lines}
    named = {line.error: line for line in tight.systematic.lines}
    assert not {"clock", "gain"} & set(named) and named["time_offset"].amplitude <= 1.2
    for name in TRUTH:
        wide, narrow = (f.parameters[name].ci95 for f in (loose, tight))
        assert wide and narrow and wide[1] - wide[0] > 0.99 * (narrow[1] - narrow[0])


# --- a linear model, where all of it is a least-squares problem


class Model:
    """Of coordinates that are the quantities themselves."""

    loss, referenced, box, channels, unknowns = "linear", False, (np.full(2, -5.0), np.full(2, 10.0)), (), 2
    coordinates = tuple(Coordinate(name, None, False, -5.0, 5.0) for name in ("one", "two"))
    scene = SimpleNamespace(traits=SimpleNamespace(large=False, rough=False))

    def values(self, point: np.ndarray) -> np.ndarray:
        return -5.0 + 10.0 * np.asarray(point)


def test_a_line_is_what_a_fit_together_with_the_prior_lets_pass():
    """Its amplitude and the upper end of its interval, by least squares with a reading 0 of the amplitude."""
    rng = np.random.default_rng(1)
    jacobian, signature = rng.standard_normal((60, 2)), rng.standard_normal((60, 1)) + 1.0
    readings = 3.0 * signature[:, 0] + rng.standard_normal(60)
    start = np.linalg.lstsq(jacobian, readings)[0]
    left = jacobian @ start - readings
    end = End(np.full(2, 0.5), np.full(2, 0.5), float(left @ left), left, jacobian, True)
    spread = Spread(np.linalg.inv(jacobian.T @ jacobian), 58, np.zeros(2), 1.0)
    at = Optimum(Model(), (), end, Estimate({}, {}, []), spread)
    found = quote.quoted(at, [Error("a", "", 2.0, signature)])
    (line,) = found.lines
    assert line.says == "acts" and line.chance > 0.999 and line.cost["one"] == 1.0
    # Of three deviations of the prior the noise that the set leaves is 1 or so, and never below what was stated.
    lin, errors = quote.linear(at, [Error("a", "", 2.0, signature)], np.ones(2, bool))
    variance = mixture(lin, errors).variance
    rows = np.block([[jacobian, signature], [np.zeros((1, 2)), np.array([[np.sqrt(variance) * QUANTILE / 2.0]])]])
    solution = np.linalg.lstsq(rows, np.r_[-left, 0.0])[0]
    deviation = np.sqrt(variance * np.linalg.inv(rows.T @ rows)[2, 2])
    assert line.amplitude == pytest.approx(abs(solution[2]) + QUANTILE * deviation, rel=1e-6)
    moved = np.abs(10.0 * np.linalg.lstsq(jacobian, signature[:, 0])[0])
    assert list(line.moves.values()) == pytest.approx(list(line.amplitude * moved), rel=1e-6)
    # Type A and B add up in squares, and the interval is the coverage factor times their sum.
    for name, u in found.uncertainties.items():
        low, high = found.ends[found.names.index(name)]
        assert u.combined == pytest.approx(np.hypot(u.type_a, u.type_b))
        assert 0.5 * (high - low) == pytest.approx(u.coverage_factor * u.combined)


def test_a_set_that_leads_where_a_direction_is_lost_is_not_followed(monkeypatch):
    """As to where a motion no longer reaches a stop: intervals are then those about the optimum."""
    rng = np.random.default_rng(2)
    jacobian, signature = rng.standard_normal((60, 2)), rng.standard_normal((60, 1)) + 2.0
    readings = 3.0 * signature[:, 0] + rng.standard_normal(60)
    left = jacobian @ np.linalg.lstsq(jacobian, readings)[0] - readings
    end = End(np.full(2, 0.5), np.full(2, 0.5), float(left @ left), left, jacobian, True)
    spread = Spread(np.linalg.inv(jacobian.T @ jacobian), 58, np.zeros(2), 1.0)
    at, errors, asked = Optimum(Model(), (), end, Estimate({}, {}, []), spread), [Error("a", "", 2.0, signature)], []

    there = left, jacobian * [1.0, 0.0]
    monkeypatch.setattr(quote, "residuals_and_jacobian", lambda model, point: asked.append(point) or there)
    led = quote.quoted(at, errors, anew=lambda at, moved: errors)
    assert asked
    np.testing.assert_array_equal(led.ends, quote.quoted(at, errors).ends)


def test_errors_of_a_sensor_are_what_they_do_to_a_smooth_reading():
    """By small steps of each in closed form: a bell of 10 N; a contact that lasts 2 ms, and none."""
    clock = np.linspace(0.0, 0.01, 401)

    def bell(t: np.ndarray) -> np.ndarray:
        return 10.0 * np.exp(-0.5 * ((t - 0.005) / 1e-3) ** 2)

    force, h = bell(clock), 1e-4
    for longest, duration in ((2e-3, 2e-3), (np.inf, 0.01), (0.0, 0.01)):
        rows = 3 + np.arange(401)
        one = Series(rows, force > 1.0, 0.01, longest=longest, clock=clock, weights=np.full(401, 2.0))
        data = SimpleNamespace(values=np.zeros((1, 1, 404)), features=np.zeros((1, 2)))
        model: Any = SimpleNamespace(data=data, channels=("contact.normal",), scene=SCENE, coordinates=())
        readings = np.r_[0.0, 0.0, 0.0, force, 0.0].reshape(1, 1, -1)
        scene = signatures.scene_of(model, [one], readings, None)
        found = {name: systematic.of_channels(scene, own)[:, 0] for name, own in SENSOR.items()}
        curved = (bell(clock + h) - 2.0 * force + bell(clock - h)) / h**2
        wanted = {
            "gain": force,
            "bend of the gain": force**2 / 10.0,
            "lag": (bell(clock - 1e-4 * duration) - force) / 1e-4,
            "resonance": -(duration**2) * curved,
            "drift": 10.0 * (clock / 0.01 - 0.5),
            "rest": np.full(401, 10.0),
            # A sample is 25 us.
            "clock": (bell(clock - 1e-3 * 2.5e-5) - force) / 1e-3,
        }
        assert set(found) == set(wanted)
        for name, error in wanted.items():
            assert found[name].shape == (406,) and not found[name][:3].any() and not found[name][404:].any()
            np.testing.assert_allclose(
                found[name][rows], 2.0 * error, atol=0.02 * np.abs(2.0 * error).max(), err_msg=name
            )
        errors = systematic.of_sensor(scene, {"gain", "time_offset"})
        # What is fitted or stated is no error; neither is one of a record without a contact.
        assert [e.name for e in errors] == ["bend of the gain", "lag", "resonance", "drift", "rest"]
        apart = scene._replace(series=[one._replace(touching=force > 99.0)])
        assert not systematic.of_sensor(apart, {"gain"})


def swung(scene, read: str, times: np.ndarray, free: Free) -> Problem:
    """A reading of a motion without contact, with noise of 1e-3."""
    seen = bj.simulate(scene, scene.parameters(), times, read=[read]).readings[read]
    noisy = seen + 1e-3 * np.random.default_rng(0).standard_normal(times.size)
    return Problem(scene, scene.parameters(), (Experiment("swing", times, (Channel(read, noisy, 1e-3),)),), (free,))


@pytest.mark.full
def test_gravity_is_known_to_what_places_on_earth_differ_by():
    """A point's length of swing is in proportion to gravity, whatever its amplitude."""
    scene = bj.Mechanism(
        "pendulum",
        [bj.Body("bob", "hinge", axis="z", mass=1.0, center=("length", 0, 0), inertia=1e-9, start={"angle": 0.4})],
        loads=[bj.loads.Gravity("x")],
        own=[bj.Quantity("length", "m", "of the thread", 0.0, open_low=True)],
        given={"length": 0.5, "gravity": 9.81},
    )
    swing = swung(scene, "bob.angle", np.linspace(0.0, 3.0, 151), Free("length", 0.4, 0.6))
    for tolerances, wanted in (({}, 0.003), ({"gravity": 9.81e-4}, 1e-4)):
        (line,) = (
            x for x in fit(replace(swing, tolerances=tolerances), starts=4).systematic.lines if x.error == "gravity"
        )
        assert line.moves["length"] == pytest.approx(line.amplitude, rel=0.02)
        assert 0.9 * wanted < line.amplitude < 1.1 * wanted


@pytest.mark.slow
def test_what_may_be_zero_has_no_share_of_itself():
    """A fixed place and speed of a body's start have an error only where it is said; a mass has one."""
    place, speed = bj.Quantity("place", "m", "where it starts"), bj.Quantity("speed", "m/s", "how it starts")
    scene = bj.Mechanism(
        "swing",
        [bj.Body("b", "slide", axis="x", mass="weight", start={"position": "place", "velocity": "speed"})],
        loads=[bj.loads.JointSpring("spring", "b", stiffness="k")],
        own=[
            place,
            speed,
            bj.Quantity("weight", "kg", "mass", 0.0, open_low=True),
            bj.Quantity("k", "N/m", "spring", 0.0),
        ],
        given={"place": 0.1, "speed": 0.3, "weight": 1.0, "k": 50.0},
    )
    swing = swung(scene, "b.place.x", np.linspace(0.0, 2.0, 101), Free("k", 10.0, 200.0))
    for tolerances, wanted in (({}, {"weight"}), ({"place": 1e-3}, {"weight", "place"})):
        found = fit(replace(swing, tolerances=tolerances), starts=4)
        assert {line.error for line in found.systematic.lines} & {"place", "speed", "weight"} == wanted


def test_what_is_listed_with_several_numbers_acts_with_one_chance():
    """Of lags and of what nobody listed, in a scene without a motion: no list has more odds for being longer."""
    read = np.sin(np.pi * np.linspace(0.0, 1.0, 80)) ** 1.5
    own = Series(
        np.arange(80), np.ones(80, bool), 1.0, clock=np.linspace(0.0, 1e-3, 80), values=read, weights=np.ones(80)
    )
    scene = signatures.Scene(80, [own], [0], [read], [None], 1e-3, 1.0)
    found = {e.name: e for e in systematic.of_shape(scene, ())}
    assert {e.chance for e in found.values()} == {ACTS} and found["lag of 3% of a contact"].kind == "lag"
    two = Shape(
        lambda x, time: x.read[0][:, None] * time, "", 1.0, listed=lambda x: {"a": {"time": 1.0}, "b": {"time": 2.0}}
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(systematic, "SHAPES", (two, two._replace(chance=SELDOM, kind="one")))
        odds = [e.chance / (1.0 - e.chance) for e in systematic.of_shape(scene, ())]
    assert odds == pytest.approx([0.75, 0.75, 2.0 / 3.0, 2.0 / 3.0])
