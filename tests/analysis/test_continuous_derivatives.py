"""Derivatives of peaks, impulses and instants are the continuous curve's, and pass a touch with what laws remember of it."""

from __future__ import annotations

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps, loads
from bcfj_jax.analysis.crests import crest_with_error
from bcfj_jax.analysis.derivatives.differences import witnessed
from bcfj_jax.analysis.derivatives.jacobian import level
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import Plan

REMEMBERING = ("flores", "lankarani_nikravesh", "gonthier", "hunt_crossley", "exact", "zhang")
# d(impulse)/d(height) of a bounce, e = 0.7, by SciPy.
IMPULSE = {"flores": 0.197105, "lankarani_nikravesh": 0.21032, "gonthier": 0.19551, "hunt_crossley": 0.20704}


@pytest.mark.slow
def test_a_peak_is_that_of_the_continuous_force():
    m, h, g, k = 0.5, 0.1, 9.81, 1e7
    body = Body("b", "slide", axis="y", mass=m, start={"position": "height"})
    contact = Contact("c", ("ground", "b"), gaps.PointOnPlane("y"), "hertz", elastic="linear", values={"stiffness": k})
    height = (bj.Quantity("height", "m", "drop", 0.0), h)
    scene = Mechanism("drop", [body], [contact], [loads.Gravity("-y")], own=[height], end=0.2)
    # F = m g + sqrt((m g)^2 + 2 m g h k).
    root = np.sqrt((m * g) ** 2 + 2 * m * g * h * k)
    right = {
        "height": m * g * k / root, "b.mass": g + (m * g * g + g * h * k) / root,
        "gravity": m + (m * m * g + m * h * k) / root, "c.stiffness": m * g * h / root,
    }  # fmt: skip
    # Evenly, and more closely in the middle than at both ends.
    even = np.linspace(0.0, 1.0, 601)
    for times in (0.2 * even, 0.2 * (even + 0.9 * even * (1.0 - even) * (0.5 - even))):
        found = bj.sensitivity(scene, scene.parameters(), times, list(right), features=["c.peak"])
        assert found.features["c.peak"] == pytest.approx(m * g + root, rel=1e-6)
        for name, value in right.items():
            check = found.certificate.parameters[name]
            own = found.feature_derivatives[name]["c.peak"]
            assert check.feature_verdicts["c.peak"] == "trusted"
            assert abs(own / value - 1.0) <= check.features["c.peak"] + 1e-9 <= 1e-4


def test_a_crest_between_samples_states_its_error():
    # F = sin(w (t - s)): the derivative of the greatest value by the shift s is 0, by the amplitude 1.
    for count, shift in ((9, 0.01), (15, 0.02), (40, 0.003)):
        t = np.linspace(0.0, 1.0, count)
        wave = np.sin(np.pi * (t - shift))
        value, by, error = crest_with_error(t, wave, np.stack([-np.pi * np.cos(np.pi * (t - shift)), wave]))
        assert value == pytest.approx(1.0, abs=1e-3)
        assert np.all(np.abs(by - [0.0, 1.0]) <= error)
    flat = crest_with_error(np.arange(9.0), np.full(9, 2.0), np.full((1, 9), 3.0))
    assert flat[0] == 2.0 and flat[1][0] == 3.0 and flat[2][0] == 0.0


@pytest.mark.parametrize("law", [pytest.param(x, marks=() if x == "flores" else pytest.mark.slow) for x in IMPULSE])
@pytest.mark.slow
def test_remembering_laws_in_a_sensitivity(law):
    scene = bj.scenes.bounce(law=law)
    given = scene.parameters(restitution=0.7)
    wanted = ["contact.impulse", "contact.peak", "contact.impulse_1", "contact.peak_1"]
    found = bj.sensitivity(scene, given, np.linspace(0, 0.15, 15_001), ["drop_height"], features=wanted)
    own = found.feature_derivatives["drop_height"]
    assert own["contact.impulse"] == pytest.approx(IMPULSE[law], rel=1e-4)
    assert own["contact.impulse"] == pytest.approx(own["contact.impulse_1"], rel=1e-6)
    assert own["contact.peak"] == pytest.approx(own["contact.peak_1"], rel=1e-5)
    check = found.certificate.parameters["drop_height"]
    assert set(check.feature_verdicts.values()) == {"trusted"} and max(check.features.values()) < 1e-4


# The others, and in reverse: tests/contact/test_remembered_derivatives.py, too, in the slow tier.
@pytest.mark.slow
@pytest.mark.parametrize("way", ["ahead", "back"])
@pytest.mark.parametrize("law", REMEMBERING)
def test_a_memory_passes_the_touch(law, way):
    # Without gravity in the contact e does not depend on the speed: v' = e' sqrt(2 g h), so that d ln v'/d ln h = 1/2.
    scene = bj.scenes.bounce(law=law, smoothing=False)
    given = scene.parameters(restitution=0.7, drop_height=0.1)
    times = jnp.array([0.0, 0.16])

    def leaving(height, mode="forward", accuracy="balanced"):
        history = bj.reading_history(
            scene, {**given, "drop_height": height}, times, ["body.velocity.y"], accuracy=accuracy, mode=mode
        )
        return history["body.velocity.y"][-1]

    step = 1e-4
    right = float(leaving(0.1 + step, accuracy=1e-9) - leaving(0.1 - step, accuracy=1e-9)) / (2 * step)
    along = lambda h: jax.jvp(leaving, (h,), (1.0,))[1]  # noqa: E731
    ways = {"ahead": (along, jax.jacfwd(leaving)), "back": (jax.grad(lambda h: leaving(h, "reverse")),)}
    for slope in ways[way]:
        assert float(jax.jit(slope)(0.1)) == pytest.approx(right, rel=1e-4)


@pytest.mark.slow
def test_a_memory_passes_the_touch_of_implicit_steps():
    scene = replace(bj.scenes.bounce(law="flores"), implicit=True)
    given, times = scene.parameters(restitution=0.7), np.linspace(0, 0.2, 41)

    def leaving(height, mode="forward", accuracy=1e-5):
        history = bj.reading_history(
            scene, {**given, "drop_height": height}, times, ["body.velocity.y"], accuracy=accuracy, mode=mode
        )
        return history["body.velocity.y"][-1]

    right = float(leaving(0.101, accuracy=1e-7) - leaving(0.099, accuracy=1e-7)) / 2e-3
    ahead = jax.jit(lambda h: jax.jvp(leaving, (h,), (1.0,))[1])
    for along in (ahead, jax.jit(jax.grad(lambda h: leaving(h, "reverse")))):
        assert float(along(0.1)) == pytest.approx(right, rel=1e-3)


@pytest.mark.slow
def test_derivatives_land_at_every_accuracy():
    body = Body(
        "a",
        "planar",
        mass=0.006268,
        inertia=2.507e-7,
        start={"y": "height", "vx": 0.5715, "vy": -0.5715, "speed": 12.96},
    )
    contact = Contact(
        "c", ("ground", "a"), gaps.SphereOnPlane("y"), elastic="linear", friction="coulomb", values={"radius": 0.01}
    )
    given = {"stiffness": 4.256e8, "damping": 0.1127, "friction_dynamic": 0.0501, "friction_speed": 0.0595}
    height = (bj.Quantity("height", "m", "h", 0.0), 0.0105)
    scene = Mechanism("m", [body], [contact], [loads.Gravity("-y")], own=[height], given=given, end=8.2e-3)
    params, times = scene.parameters(), jnp.linspace(0, 8.2e-3, 41)

    def last(height, accuracy):
        found = bj.reading_history(scene, {**params, "height": height}, times, ["a.velocity.x"], accuracy=accuracy)
        return found["a.velocity.x"][-1]

    along = jax.jit(lambda h, accuracy: jax.jvp(lambda h: last(h, accuracy), (h,), (1.0,))[1])
    # Traced accuracies share one program; three steps of differences at 1e-9 agree on the number.
    for accuracy in (1e-2, 1e-5):
        assert float(along(0.0105, accuracy)) == pytest.approx(-1.614127, rel=1e-5)
    # What is not differentiated takes the steps of a run of values.
    plain, given = (
        jax.jit(lambda p, how=how: integrate(scene, p, times, bj.Plan(jnp.asarray(5e-6)), *how).accepted)
        for how in ((), ("forward", True))
    )
    assert int(plain(params)) == int(given(params))


@pytest.mark.slow
def test_walton_braun_through_many_contacts():
    # Each flight is e times the one before: begins are t1 (1 + 2 e + 2 e^2 + ...) but for the contacts' own lengths.
    scene, contacts = bj.scenes.bounce(law="walton_braun", smoothing=False), 17
    given = scene.parameters(restitution=0.9)
    first = np.sqrt(2 * 0.1 / 9.81)
    end = first * (1 + 2 * sum(0.9**k for k in range(1, contacts))) * 1.002 + 1e-3
    times, wrt = np.array([0.0, end]), ["drop_height", "restitution"]
    found = bj.contact_events(scene, given, times, wrt)
    assert found.counts["contact"] >= contacts and not found.reasons
    for name in wrt:
        step = 1e-4 * float(given[name])
        above, below = (
            bj.contact_events(scene, {**given, name: given[name] + s}, times, accuracy=1e-6).features
            for s in (step, -step)
        )
        for kind, k in itertools.product(("begin", "impulse", "center", "width", "peak"), (6, 16)):
            key = f"contact.{kind}_{k}"
            difference = (above[key] - below[key]) / (2 * step)
            least = 1e-2 * abs(found.features[key] / float(given[name]))
            assert abs(found.feature_derivatives[name][key] - difference) <= 1e-3 * max(abs(difference), least)


def test_a_witness_sees_what_all_tolerances_miss():
    values, bounds = np.array([2.0, 3.0]), np.full((2, 2), 1e-6)

    def features(at):
        return np.array([at[0] ** 2 * at[1], np.nan])

    right = np.array([[12.0, 4.0], [1.0, 1.0]])
    here, runs = features(values), []

    def counted(at):
        runs.append(at)
        return features(at)

    assert np.array_equal(witnessed(counted, here, values, right, bounds), bounds) and len(runs) == 1
    wrong = right * [[1.05, 1.0], [1.0, 1.0]]
    found = witnessed(features, here, values, wrong, bounds)
    assert 0.04 < found[0, 0] < 0.07 and found[0, 1] < 1e-4 and np.array_equal(found[1], bounds[1])


@pytest.mark.slow
def test_an_implicit_solver_has_the_same_continuous_derivatives():
    scene = bj.scenes.impact()
    params, times = scene.parameters(), np.linspace(0.0, 8e-5, 201)
    wrt = ("stiffness", "damping")
    found = [
        level(scene, params, times, wrt, Plan(np.asarray(1e-9), solver=solver)) for solver in ("kvaerno5", "tsit5")
    ]
    for part in ("force", "curve"):
        ours, theirs = (getattr(one.derivative, part) for one in found)
        assert ours == pytest.approx(theirs, rel=0, abs=1e-6 * np.abs(theirs).max())
