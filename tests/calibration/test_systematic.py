"""The systematic budget against fits of records with that very error planted, by SciPy and by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim
from shown import brief, drawn

from bcfj_jax import InputError, scenes, simulate
from bcfj_jax.io.units import toleranced
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.diagnostics import systematic
from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.diagnostics.systematic import Budget, Error, Moving, budget_of
from calibration.forward.coordinates import Coordinate
from calibration.noise.noise_model import Estimate
from calibration.search.refinement import End
from calibration.uncertainty.estimates import Parameter, Reference, widened

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


@pytest.mark.full
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
            moved = abs(np.log(other.values[name] / found.values[name]))
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
    with pytest.raises(InputError, match="mass: a tolerance of '-2 %'"):
        stated("0.55 kg +- -2 %")
    with pytest.raises(InputError, match="mass"):
        stated("0.55 kg +- 2 mm")


def test_what_is_known_better_widens_less():
    """Errors of the mass: none, 1 % (not said) and 5 %; of what the residuals let pass no more is allowed for."""
    plain = problem(lambda f: f)
    widths = []
    for tolerances in ({"mass": 0.0}, {}, {"mass": 0.005}):
        p = fit(replace(plain, tolerances=tolerances), starts=4).parameters["stiffness"]
        assert p.with_budget and p.ci95
        assert p.with_budget[0] < p.ci95[0] < p.ci95[1] < p.with_budget[1]
        widths.append(np.log(p.with_budget[1] / p.with_budget[0]))
    assert widths[0] <= widths[1] <= widths[2]


@pytest.mark.full
def test_an_error_that_no_residual_shows_is_allowed_for():
    """A lag of a five-hundredth of a contact, by SciPy: the law is consistent, the interval of the noise is wrong."""
    tau = 2e-6
    lagged = lambda f: lsim(((1.0,), (tau, 1.0)), f, TIMES)[1]  # noqa: E731
    found = fit(problem(lagged), starts=4)
    assert found.verdict == "identified"
    off = [p.ci95 and not p.ci95[0] < TRUTH[name] < p.ci95[1] for name, p in found.parameters.items()]
    assert any(off)
    for name, p in found.parameters.items():
        assert p.with_budget and p.with_budget[0] < TRUTH[name] < p.with_budget[1]


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
    assert not {"clock", "gain"} & set(named) and named["time_offset"].amplitude <= 1.0
    wide, narrow = (f.parameters["stiffness"].with_budget for f in (loose, tight))
    assert wide and narrow and wide[0] < narrow[0] < narrow[1] < wide[1]


# --- the budget of a linear model, where all of it is a least-squares problem

MODEL: Any = SimpleNamespace(loss="linear")
NAMES = ("one", "two")


class Linear:
    """Residuals J x - y of 60 samples, three errors of the prediction, and how the estimates move with x."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)
        self.jacobian = self.rng.standard_normal((60, 2)) + np.linspace(0.0, 2.0, 60)[:, None]
        self.signatures = self.rng.standard_normal((60, 3)) + np.linspace(0.0, 3.0, 60)[:, None]
        self.most = np.array([0.5, 2.0, 0.1])
        self.slopes = np.array([[1.0, 0.3], [-0.2, 2.0]])

    def fitted(self, readings: np.ndarray) -> tuple[np.ndarray, End]:
        """Estimates and the optimum."""
        at = np.linalg.lstsq(self.jacobian, readings)[0]
        left = self.jacobian @ at - readings
        return self.slopes @ at, End(at, at, float(left @ left), left, self.jacobian, True)

    def budget(self, end: End, alone=()) -> Budget:
        errors = [Error(n, "", m, s) for n, m, s in zip("abc", self.most, self.signatures.T, strict=True)]
        spread = Spread(np.linalg.inv(self.jacobian.T @ self.jacobian), 1.96, 58, np.zeros(2), 1.0)
        at = Optimum(MODEL, (), end, Estimate({}, {}, []), spread)
        return budget_of(at, errors, Moving(NAMES, self.slopes, np.ones(2)), alone)


def test_errors_together_are_least_squares_with_what_is_known_of_them():
    """Each error as a further unknown, with a reading 0 of it whose deviation is what is called large, over 1.96."""
    linear = Linear(0)
    _, end = linear.fitted(1.7 * linear.rng.standard_normal(60))
    variance = end.cost / 58
    groups = {(): ["abc"], (("a", "c"),): ["ba", "bc"], (("c",),): ["abc"]}
    for alone, combinations in groups.items():
        found = linear.budget(end, alone)
        assert [line.error for line in found.lines] == ["a", "b", "c"]
        assert not found.corrections[0].any() and not found.deviations[0].any()
        assert len(found.corrections) == 1 + len(combinations)
        for chosen, correction, deviation in zip(
            combinations, found.corrections[1:], found.deviations[1:], strict=True
        ):
            some = ["abc".index(name) for name in chosen]
            rows = np.block(
                [
                    [linear.jacobian / np.sqrt(variance), linear.signatures[:, some] / np.sqrt(variance)],
                    [np.zeros((len(some), 2)), np.diag(1.959964 / linear.most[some])],
                ]
            )
            solution = np.linalg.lstsq(rows, np.r_[-end.residuals / np.sqrt(variance), np.zeros(len(some))])[0]
            covariance = np.linalg.inv(rows.T @ rows)[:2, :2]
            covariance -= variance * np.linalg.inv(linear.jacobian.T @ linear.jacobian)
            np.testing.assert_allclose(correction, linear.slopes @ solution[:2], rtol=1e-9)
            spread = np.diag(linear.slopes @ covariance @ linear.slopes.T)
            np.testing.assert_allclose(deviation, np.sqrt(spread), rtol=1e-7)


def test_a_single_error_is_what_a_fit_together_with_the_estimates_lets_pass():
    """Its amplitude and the upper end of its interval, by least squares; no more than is called large."""
    linear = Linear(1)
    _, end = linear.fitted(1.7 * linear.rng.standard_normal(60))
    variance, seen = end.cost / 58, 0
    for line, own, most in zip(linear.budget(end).lines, linear.signatures.T, linear.most, strict=True):
        design = np.column_stack([linear.jacobian, own])
        amplitude = abs(np.linalg.lstsq(design, end.residuals)[0][2])
        limit = amplitude + 1.959964 * np.sqrt(variance * np.linalg.inv(design.T @ design)[2, 2])
        assert line.amplitude == pytest.approx(min(limit, most), rel=1e-9)
        seen += limit < most
        moved = np.abs(linear.slopes @ np.linalg.lstsq(linear.jacobian, own)[0])
        assert list(line.moves.values()) == pytest.approx(list(line.amplitude * moved), rel=1e-9)
    assert seen == 2


def test_an_error_that_moves_one_estimate_alone_has_a_line():
    linear = Linear(3)
    linear.slopes = np.diag([1.0, 2.0])
    left = np.linalg.lstsq(linear.jacobian, linear.signatures[:, 2])[0]
    # Moves the second estimate, none, and the first.
    linear.signatures = np.column_stack(
        [linear.jacobian[:, 1], linear.signatures[:, 2] - linear.jacobian @ left, linear.jacobian[:, 0]]
    )
    _, end = linear.fitted(linear.rng.standard_normal(60))
    lines = linear.budget(end).lines
    assert [line.error for line in lines] == ["a", "c"]
    # The residuals say nothing of either: each is as large as is called large.
    assert [line.amplitude for line in lines] == [0.5, 0.1]
    np.testing.assert_allclose([list(line.moves.values()) for line in lines], [[0.0, 1.0], [0.1, 0.0]], atol=1e-12)


def test_the_correction_leads_back_to_the_truth():
    """Errors drawn as the budget takes them to be: corrected estimates are nearer, widened intervals hold the truth."""
    linear, plain, corrected, held, bare = Linear(2), 0.0, 0.0, 0, 0
    half = 1.96 * np.sqrt(np.diag(linear.slopes @ np.linalg.inv(linear.jacobian.T @ linear.jacobian) @ linear.slopes.T))
    for _ in range(300):
        amplitudes = linear.most / 1.959964 * linear.rng.standard_normal(3)
        # The prediction has the errors that the readings have not.
        estimate, end = linear.fitted(linear.rng.standard_normal(60) - linear.signatures @ amplitudes)
        found = linear.budget(end)
        plain += np.sum(estimate**2)
        corrected += np.sum((estimate + found.corrections[1]) ** 2)
        for k, name in enumerate(NAMES):
            below, above = found.widened(name, half[k])
            held += -below < -estimate[k] < above
            bare += abs(estimate[k]) < half[k]
    assert corrected < 0.5 * plain
    assert bare < 0.9 * 600 and held > 0.95 * 600


def test_a_widened_interval_holds_those_of_the_estimate_and_of_the_corrected_one():
    """Corrections are added to half widths; what scatters is added in squares."""
    none, up, down = np.zeros(1), np.array([0.3]), np.array([-0.2])
    budget = Budget([], ("x",), np.stack([none, up, down]), np.stack([none, none + 0.4, none + 0.1]))
    first, second = np.hypot(0.5, 1.959964 * 0.4), np.hypot(0.5, 1.959964 * 0.1)
    below, above = budget.widened("x", 0.5)
    assert above == pytest.approx(0.3 + first) and below == pytest.approx(max(0.2 + second, first))
    calm = Budget([], ("x",), np.stack([none, up]), np.stack([none, none]))
    assert calm.widened("x", 0.5) == pytest.approx((0.5, 0.8))


def test_each_side_of_an_interval_is_widened_by_its_own_half():
    reach = lambda half: (2.0 * half, 3.0 * half)  # noqa: E731
    linear = Coordinate("gain", None, False, -10.0, 10.0)
    assert widened(linear, Parameter(1.0, "", (0.0, 3.0), True, ""), reach) == pytest.approx((-1.0, 7.0))
    assert widened(linear, Parameter(1.0, "", (-8.0, 8.0), True, ""), reach) == pytest.approx((-10.0, 10.0))
    assert widened(linear, Parameter(1.0, "", None, False, ""), reach) is None
    decades = Coordinate("stiffness", None, True, np.log(1e-3), np.log(1e3))
    assert widened(decades, Parameter(2.0, "", (1.0, 4.0), True, ""), reach) == pytest.approx((0.5, 16.0))
    force = Reference(1e-6, 2.0, (1.0, 4.0)).widened(reach).with_budget
    assert force == pytest.approx((0.5, 16.0))
    assert Reference(1e-6, 2.0, None).widened(reach).with_budget is None


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
        model: Any = SimpleNamespace(data=data, coordinates=(Coordinate("gain", None, True, 0.0, 1.0),))
        readings = np.r_[0.0, 0.0, 0.0, force].reshape(1, 1, -1)
        found = systematic._signatures(model, readings, [one])
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
        errors = systematic.of_sensor(model, readings, [one], frozenset({"time_offset"}))
        # What is fitted or stated is no error; neither is one of a record without a contact.
        assert [e.name for e in errors] == ["bend of the gain", "lag", "resonance", "drift", "rest"]
        assert not systematic.of_sensor(model, readings, [one._replace(touching=force > 99.0)], frozenset())
