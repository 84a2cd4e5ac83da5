"""Estimates on their scales, and the ends of their intervals: by differences and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax import scenes
from bcfj_jax.core.quantities import Quantity
from calibration import Channel, Experiment, Free, Problem
from calibration.diagnostics import fit_tests
from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.optimum import Optimum
from calibration.forward import model
from calibration.forward.coordinates import Coordinate
from calibration.noise.noise_model import Estimate
from calibration.search.refinement import End
from calibration.uncertainty import estimates, intervals, profile, unstated_filter
from calibration.uncertainty.estimates import REFERENCE, Estimates, Parameter, Reference

DEPTH = 2e-4
FREE = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("mass", 0.05, 0.2, scale="linear"))
NAMES = ("stiffness", "exponent", "mass")


@pytest.fixture(scope="module", params=["linear", "log"])
def built(request):
    """A model that searches a reference force in place of the stiffness; its exponent on either scale."""
    scene = scenes.impact(smoothing=False)
    params = {k: float(v) for k, v in scene.parameters(mass=0.1, approach_speed=1.0, stiffness=1e8).items()}
    one = Experiment("a", np.linspace(0.0, 1e-3, 20), (Channel("contact.normal", np.ones(20), 1.0),))
    free = (FREE[0], Free("exponent", 1.0, 2.5, scale=request.param), FREE[2])
    found = model.build(Problem(scene, params, (one,), free), (one,)).at_depth(float(np.log(DEPTH)))
    assert found.referenced
    return found


def optimum(point) -> End:
    return End(point, point, 0.0, np.zeros(3), np.eye(3), True)


def at(built, point, known: Spread) -> Optimum:
    """An optimum whose coordinates are NAMES."""
    one = Experiment("a", np.zeros(0), ())
    return Optimum(built, (one,), optimum(point), Estimate({}, {}, []), known)


def spread(seed: int) -> Spread:
    root = 0.004 * np.random.default_rng(seed).standard_normal((3, 3))
    return Spread(root @ root.T, 17, np.zeros(3), 1.0)


def test_estimates_move_with_the_unit_box_as_their_scales_do(built):
    point = np.array([0.4, 0.6, 0.3])

    def scaled(u):
        values = built.values(u)
        return np.array([np.log(v) if a.log else v for v, a in zip(values, built.coordinates, strict=True)])

    z, slopes = estimates.placed(built, optimum(point))
    assert z == pytest.approx(scaled(point), rel=1e-12)
    steps = 1e-6 * np.eye(3)
    wanted = np.stack([(scaled(point + step) - scaled(point - step)) / 2e-6 for step in steps], axis=1)
    np.testing.assert_allclose(slopes, wanted, rtol=1e-6, atol=1e-9)


def test_a_quantitys_own_least_is_no_bound(built):
    """An exponent of 1 has an interval on one side; a mass at a bound that the user gave is at it."""
    found = estimates.estimates(at(built, np.array([0.4, 0.0, 0.0]), spread(1)))
    exponent, mass = (found.parameters[name] for name in NAMES[1:])
    assert exponent.at_bound == "" and exponent.ci95[0] == pytest.approx(1.0) == exponent.value
    assert mass.at_bound == "lower"
    passed = {t.name: t.passed for t in found.tests}
    assert passed["exponent inside its bounds"] and not passed["mass inside its bounds"]


def test_intervals_are_about_the_estimates_on_their_scales(built):
    """By a linear propagation of the covariance; the reference force at its penetration, K d^n."""
    point, known = np.array([0.4, 0.6, 0.3]), spread(1)
    values = built.values(point)
    _, slopes = estimates.placed(built, optimum(point))
    found = estimates.ends_of(at(built, point, known))
    force = found[REFERENCE]
    halves = 1.959964 * np.sqrt(np.diag(slopes @ known.covariance @ slopes.T))
    for name, axis, value, half in zip(NAMES, built.coordinates, values, halves, strict=True):
        ends = value * np.exp([-half, half]) if axis.log else value + np.array([-half, half])
        assert found[name] == pytest.approx(tuple(ends), rel=1e-6)
    # ln F_ref = ln K + n ln d_ref.
    log = built.coordinates[1].log
    way = slopes[0] + np.log(DEPTH) * slopes[1] * (values[1] if log else 1.0)
    half = 1.959964 * np.sqrt(way @ known.covariance @ way)
    assert force == pytest.approx(tuple(values[0] * DEPTH ** values[1] * np.exp([-half, half])), rel=1e-6)
    # What is not determined to a factor of two has none.
    wide = known._replace(covariance=1e6 * known.covariance)
    assert estimates.ends_of(at(built, point, wide))[REFERENCE] is None


def test_ends_stay_where_the_quantity_can_be_and_within_the_bounds():
    gap = Quantity("clearance", "m", "a gap", low=0.0)
    axis = Coordinate("clearance", None, False, -1.0, 3e-5)
    assert estimates._reach(axis, gap, 1e-5, 5e-6) == 1.0
    # A closed gap is no smaller; its interval has less than half of its width below.
    assert estimates._reach(axis, gap, 1e-5, 4e-5) == pytest.approx(0.25)
    assert estimates._reach(axis, gap, 1e-5, np.inf) == 1.0
    assert estimates.in_si(0.0, 5e-5, False, (-1.0, 3e-5)) == (0.0, 3e-5)
    decades = Coordinate("stiffness", None, True, np.log(0.5), np.log(8.0))
    assert estimates._reach(decades, gap, 2.0, np.log(3.0)) == 1.0
    assert estimates.in_si(np.log(2.0 / 5.0), np.log(10.0), True, decades[3:5]) == pytest.approx((0.5, 8.0))


def test_half_the_length_of_an_interval_is_on_its_scale():
    assert intervals.half((1.0, 4.0), False) == 1.5 and intervals.half((1.0, 4.0), True) == pytest.approx(np.log(2.0))
    assert intervals.half(None, True) == np.inf


def test_intervals_that_replace_others_bring_their_own_tests(built):
    """One as wide as a factor of two, or as half of the range, is none."""
    old = {name: Parameter(1.0, "", (0.9, 1.1), True, "") for name in NAMES}
    force = Reference(2.0, "N", (1.0, 4.0), True, "", penetration=DEPTH)
    ends = {"stiffness": (1e8, 3.9e8), "mass": (0.06, 0.22), "reference_force": (1.1, 4.0)}
    place = at(built, np.full(3, 0.5), spread(1))
    tests = [
        fit_tests.Test(name, 1.0, 1.0, False, "old")
        for name in ("interval of mass", "mass determined", "weak direction", "x")
    ]

    def other(ends, why):
        return intervals.replaced("profile", place, Estimates({**old, REFERENCE: force}, tests), ends, why)

    found = other(ends, {}).parameters
    reference = found[REFERENCE]
    assert found["exponent"] == old["exponent"]
    assert found["stiffness"].ci95 == ends["stiffness"] and found["stiffness"].interval_kind == "profile"
    assert found["mass"].ci95 is None and not found["mass"].identifiable
    assert reference.ci95 == ends["reference_force"] and reference.interval_kind == "profile"
    wide = {"reference_force": (1.0, 4.1), "stiffness": None, "mass": (0.06, 0.2)}
    found, again = other(wide, {"stiffness": "it is flat"})
    reference = found[REFERENCE]
    assert found["stiffness"].ci95 is None and found["mass"].ci95 == (0.06, 0.2) and reference.ci95 is None
    again = {t.name: t for t in again}
    assert set(again) == {"weak direction", "x", "stiffness determined", "mass determined"}
    assert again["mass determined"].passed and again["mass determined"].value == pytest.approx(0.07)
    assert not again["stiffness determined"].passed and again["stiffness determined"].reason == "it is flat"
    # Where every parameter is bounded no direction is weak.
    whole = {"stiffness": (1e8, 3.9e8), "exponent": (1.4, 1.6), "mass": (0.06, 0.2)}
    again = {t.name: t for t in other(whole, {}).tests}
    assert "weak direction" not in again and all(again[f"{name} determined"].passed for name in NAMES)


def test_deviations_behind_a_filter_are_those_of_its_jacobian(built):
    """Of the estimates and, last, of the logarithm of the reference force; of residuals of variance 1."""
    point, jacobian = np.array([0.4, 0.6, 0.3]), np.random.default_rng(2).standard_normal((9, 3)) * [1.0, 1e3, 1e-2]
    one = unstated_filter.Tried(None, np.inf, point, 0.0, np.zeros(9), jacobian)
    z, deviations = unstated_filter._scaled(at(built, np.full(3, 0.5), spread(1)), one)
    where, slopes = estimates.placed(built, optimum(point))
    values = built.values(point)
    assert z == pytest.approx([*where, np.log(values[0] * DEPTH ** values[1])], rel=1e-9)
    covariance, width = np.linalg.inv(jacobian.T @ jacobian), built.box[1]
    wanted = np.sqrt([*np.diag(slopes @ covariance @ slopes.T), width[0] ** 2 * covariance[0, 0]])
    np.testing.assert_allclose(deviations, wanted, rtol=1e-6)


def test_what_a_profile_holds_is_the_value_of_its_name(built, monkeypatch):
    """The stiffness as the force at a depth of 1 m, between its own bounds; each about the optimum's own value."""
    asked = {}

    def drawn(every, **more):
        asked.update({one.name: one for one in every})
        return ()

    monkeypatch.setattr(profile, "profiles", drawn)
    point, known = np.array([0.4, 0.6, 0.3]), spread(1)
    profile.of_optimum(at(built, point, known))
    assert list(asked) == ["stiffness", "reference_force", "exponent", "mass"]
    values = dict(zip(NAMES, built.values(point), strict=True))
    values["reference_force"] = values["stiffness"] * DEPTH ** values["exponent"]
    for name, one in asked.items():
        assert one.physical(one.place[one.index]) == pytest.approx(values[name], rel=1e-9)
        assert one.log == (name != "mass" and (name != "exponent" or built.coordinates[1].log))
        assert one.threshold == pytest.approx(1.959964**2)
    ends = {name: (one.physical(0.0), one.physical(1.0)) for name, one in asked.items()}
    assert ends["stiffness"] == pytest.approx((1e7, 1e9)) and ends["exponent"] == pytest.approx((1.0, 2.5))
    assert ends["mass"] == pytest.approx((0.05, 0.2))
    asked.clear()
    profile.of_optimum(at(built, point, known), only=["exponent"])
    assert list(asked) == ["exponent"]
    # The square of the interval's quantile, times what a robust loss makes of the rise.
    known = known._replace(rise=1.5)
    assert known.rise_allowed(np.ones(3)) == pytest.approx(1.5 * 1.959964**2)
    assert known._replace(covariance=None).rise_allowed(np.ones(3)) == pytest.approx(1.5 * 1.959964**2)
    # Student's t of 5 degrees of freedom, from tables.
    assert known._replace(student=5.0).rise_allowed(np.ones(3)) == pytest.approx(1.5 * 2.570582**2)
