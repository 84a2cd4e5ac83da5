"""Fits in which no contact has a part: a pin's reaction, a spring's force. Their verdict is that of the whole record."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bcfj_jax import Body, Mechanism
from bcfj_jax.contact.gaps import PointOnPlane
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Gravity, JointFriction, Spring
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.diagnostics.answers import whole_contact_test
from calibration.forward.model import build
from calibration.forward.runs import of_contacts

G, L, M, SPIN, RUB = 9.81, 0.4, 2.0, 0.01, 0.2


def fitted(scene, readings, free, times, level=0.01, **settings) -> Any:
    """A fit to readings with noise of a share of their peak."""
    rng, channels = np.random.default_rng(0), []
    for name, clean in readings.items():
        sigma = level * np.abs(clean).max()
        channels.append(Channel(name, clean + sigma * rng.standard_normal(clean.size), sigma))
    fixed = {name: float(x) for name, x in scene.parameters().items()}
    return fit(Problem(scene, fixed, (Experiment("a", times, tuple(channels)),), free), starts=4, **settings)


def pendulum():
    bar = Body(
        "bar", "hinge", center=(L, 0, 0), mass=M, inertia=SPIN, tilt=("z", 0.5), start={"angle": -0.2, "speed": 1.5}
    )
    return Mechanism("pendulum", [bar], loads=[Gravity(), JointFriction("rub", "bar", sliding=RUB, speed=0.01)])


def pin(times, rub=RUB, drag=0.0):
    """The pin's force along the bar and across it, by SciPy: dry friction, and a drag that the scene does not know."""
    whole = SPIN + M * L * L

    def rate(t, y):
        held = -rub * y[1] / np.hypot(y[1], 0.01) - drag * y[1]
        return [y[1], (-M * G * L * np.cos(y[0]) + held) / whole]

    angle, speed = solve_ivp(rate, (0.0, times[-1]), [0.3, 1.5], t_eval=times, rtol=1e-10, atol=1e-12).y
    turned = np.array([rate(0.0, y)[1] for y in np.stack([angle, speed], axis=1)])
    return {"bar.reaction.x in bar": M * (G * np.sin(angle) - L * speed**2),
            "bar.reaction.y in bar": M * (G * np.cos(angle) + L * turned)}  # fmt: skip


@pytest.mark.slow
def test_friction_from_a_pins_reaction():
    """Of a record in which nothing touches every sample counts: a model that misses is not called adequate."""
    times, free = np.linspace(0.0, 1.5, 61), (Free("bar.mass", 0.5, 8.0), Free("rub.sliding", 0.02, 2.0))
    found = fitted(pendulum(), pin(times), free, times, systematic=False)
    assert found.verdict == "identified" and not found.reasons
    for name, true in (("bar.mass", M), ("rub.sliding", RUB)):
        low, high = found.parameters[name].ci95
        assert low < true < high and high - low < 0.2 * true, name
    missed = fitted(pendulum(), pin(times, drag=2.0), free, times, systematic=False)
    assert missed.verdict == "misfit"
    assert missed.law.because[0].startswith("the model misses by") and "contact" not in " ".join(missed.reasons)


@pytest.mark.slow
def test_a_springs_stiffness_has_an_interval_with_its_sensors_errors():
    """x = A cos(w t), force k A cos(w t); of a force alone k may be wrong by the sensor's gain, of a share of the whole."""
    k, mass, amplitude = 250.0, 0.5, 0.03
    block = Body("block", "slide", axis="x", mass=mass, start={"position": amplitude})
    scene = Mechanism(
        "spring",
        [block],
        loads=[Spring("coil", ("ground", "block"), at=((-1, 0, 0), (0, 0, 0)), stiffness=k, free_length=1.0)],
    )
    times = np.linspace(0.0, 1.0, 81)
    pull = k * amplitude * np.cos(np.sqrt(k / mass) * times)
    found = fitted(scene, {"coil.pull": pull}, (Free("coil.stiffness", 50.0, 1000.0),), times)
    low, high = found.parameters["coil.stiffness"].ci95
    narrow, wide = found.parameters["coil.stiffness"].intervals["noise"]
    assert found.verdict == "identified" and low < narrow < k < wide < high < 1.05 * k


def test_when_a_fit_is_of_contacts():
    body = Body("mass", "slide", axis="x", mass=1.0, start={"position": 1.0})
    wall = Contact("wall", ("ground", "mass"), PointOnPlane(axis="x"), "memory_free")
    scene = Mechanism("one", [body], [wall], [Spring("coil", ("ground", "mass"), stiffness=1.0)],
                      given={"stiffness": 1e6, "exponent": 1.5, "damping": 0.1, "smoothing": 0.0})  # fmt: skip
    fixed, times = {name: float(x) for name, x in scene.parameters().items()}, np.linspace(0.0, 0.1, 20)

    def model(name, observed):
        problem = Problem(
            scene, fixed, (Experiment("a", times, (Channel(observed, times, 1.0),)),), (Free(name, 0.5, 2.0),)
        )
        return build(problem, problem.experiments)

    for name, observed, expected in (
        ("coil.stiffness", "coil.pull", False), ("mass.mass", "mass.acceleration.x", False),
        ("mass.mass", "wall.normal", True), ("stiffness", "mass.acceleration.x", True),
    ):  # fmt: skip
        one = model(name, observed)
        assert of_contacts(one) is expected
        tests = whole_contact_test(one, [], False)
        assert [t.reason for t in tests] == (["no contact begins within the records"] if expected else [])


@pytest.mark.full
def test_a_velocity_after_the_contact_is_evidence_of_its_loss():
    """A light gate reads the rebound once: no sample lies in contact, and none before it."""
    k, loss, fall = 2e4, 0.3, 9.80665
    ball = Body("ball", "slide", axis="y", mass=0.2, start={"position": "height"})
    plate = Contact("plate", ("ground", "ball"), PointOnPlane("y"), "memory_free", smoothing=False)
    scene = Mechanism(
        "gate", [ball], [plate], [Gravity("-y")], own=[(Quantity("height", "m", "height", 0.0), 0.1)],
        given={"stiffness": k, "exponent": 1.0, "damping": loss},
    )  # fmt: skip

    def late(height):
        def rates(t, y):
            depth = max(-y[0], 0.0)
            return [y[1], k * depth * max(1.0 - loss * y[1], 0.0) / 0.2 - fall]

        end = 1.3 * np.sqrt(2.0 * height / fall)
        return end, solve_ivp(rates, (0.0, end), [height, 0.0], rtol=1e-10, atol=1e-13, max_step=2e-4).y[1, -1]

    runs = []
    for height, error in ((0.05, 1.0), (0.1, -1.0), (0.2, 0.5)):
        end, speed = late(height)
        read = Channel("ball.velocity.y", np.array([speed + 0.002 * error]), 0.002)
        runs.append(Experiment(f"from {height}", np.array([end]), (read,), fixed={"height": height}))
    found = fit(Problem(scene, scene.parameters(), tuple(runs), (Free("damping", 0.03, 3.0),)), starts=4)
    low, high = found.parameters["damping"].ci95
    assert found.verdict == "identified" and low < loss < high < 1.1 * low, found.reasons
