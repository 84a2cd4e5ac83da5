"""Readings by name: of contacts and bodies, in the contact's, any body's and the world's axes."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from joints import plain_joint

import bcfj_jax as bj
from bcfj_jax import InputError, reading_history, scenes, simulate
from bcfj_jax.mechanism.bodies import JOINTS
from bcfj_jax.mechanism.bodies import unit_of as start_unit
from bcfj_jax.mechanism.channels import unit_of
from bcfj_jax.mechanism.observed import observing

TIMES = np.linspace(0.0, 2e-3, 401)
READ = (
    "slider.acceleration.x", "slider.velocity.x", "slider.place.x", "journal.force.x", "journal.force.y",
    "journal.force.x in rod", "journal.force.y in rod", "journal.normal", "journal.penetration", "rod.angle",
    "rod.spin.z", "crank.torque", "rod.acceleration.x", "rod.acceleration.y",
)  # fmt: skip


@pytest.fixture(scope="module")
def run():
    scene = scenes.slider_crank()
    found = simulate(scene, scene.parameters(), TIMES, accuracy=1e-4, read=READ)
    assert found.status == "ok"
    return found


@pytest.mark.slow
def test_the_journal_pushes_the_slider(run):
    """Newton's third law: the force that is read acts on the rod."""
    force, gain = run.readings["journal.force.x"], run.readings["slider.acceleration.x"]
    assert np.abs(force).max() > 1e4
    np.testing.assert_allclose(0.14 * gain, -force, rtol=0, atol=1e-9 * np.abs(force).max())


def test_a_bodys_axes_turn_the_components_and_not_the_force(run):
    """Components in the rod's axes against those of the world turned by its angle, crank's turn and all, in NumPy."""
    angle = run.readings["rod.angle"] + scenes.slider_crank().parameters()["crank_speed"] * TIMES
    x, y = run.readings["journal.force.x"], run.readings["journal.force.y"]
    along = np.cos(angle) * x + np.sin(angle) * y
    across = -np.sin(angle) * x + np.cos(angle) * y
    size = np.abs(x).max()
    np.testing.assert_allclose(run.readings["journal.force.x in rod"], along, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(run.readings["journal.force.y in rod"], across, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(np.hypot(x, y), np.abs(run.readings["journal.normal"]), rtol=1e-9, atol=1e-9 * size)


def test_velocities_and_accelerations_are_derivatives(run):
    """Central differences of the places, away from impacts, to their own error of order h^2."""
    free = run.readings["journal.penetration"] < 0
    calm = free[2:] & free[1:-1] & free[:-2]
    h = TIMES[1] - TIMES[0]
    place, speed, gain = (run.readings[f"slider.{what}.x"] for what in ("place", "velocity", "acceleration"))
    np.testing.assert_allclose(((place[2:] - place[:-2]) / (2 * h))[calm], speed[1:-1][calm], rtol=0, atol=1e-6 * 26.0)
    np.testing.assert_allclose(
        ((speed[2:] - speed[:-2]) / (2 * h))[calm], gain[1:-1][calm], rtol=0, atol=1e-6 * 26.0 / h
    )
    assert np.abs(run.readings["rod.spin.z"]).max() > 100.0


@pytest.mark.slow
def test_the_drives_torque_is_the_power_that_the_bodies_gain(run):
    """Torque times speed against the derivative of all kinetic energy, in the flight before the first touch."""
    first = np.argmax(run.readings["journal.penetration"] > 0)
    part = slice(0, first)
    assert first > 20
    scene = scenes.slider_crank()
    p = scene.parameters()
    found = simulate(scene, p, TIMES[part], accuracy=1e-6, read=("crank.torque",))
    kinetic = jax.jit(jax.vmap(lambda t, y: scene.flows(t, y, p).stored["kinetic"]))
    energy = np.asarray(kinetic(TIMES[part], found.trajectory))
    power = found.readings["crank.torque"] * float(p["crank_speed"])
    rate = np.gradient(energy, TIMES[part], edge_order=2)[2:-2]
    np.testing.assert_allclose(power[2:-2], rate, rtol=0, atol=2e-3 * np.abs(power).max())


WRT = ("slider.mass", "stiffness")


def gain(values, mode="forward"):
    """Acceleration of the slider, by the values of WRT."""
    scene, times, read = scenes.slider_crank(), jnp.linspace(0.0, 2.6e-4, 27), "slider.acceleration.x"
    given = {**scene.parameters(), **dict(zip(WRT, values, strict=True))}
    return reading_history(scene, given, times, (read,), accuracy=1e-9, mode=mode)[read]


@functools.cache
def ahead():
    """Its values, and their derivatives (T, 2) by forward differentiation."""
    at = jnp.stack([scenes.slider_crank().parameters()[name] for name in WRT])
    return at, np.asarray(jax.jit(jax.jacfwd(gain))(at))


@pytest.mark.slow
def test_readings_are_differentiable():
    """Derivative of the slider's acceleration by its mass and by the stiffness against central differences."""
    (at, forward), value = ahead(), jax.jit(gain)
    for k in range(len(WRT)):
        step = jnp.zeros(2).at[k].set(1e-4 * at[k])
        differences = (value(at + step) - value(at - step)) / (2 * step[k])
        size = np.abs(np.asarray(differences)).max()
        assert size > 0
        np.testing.assert_allclose(forward[:, k], differences, rtol=0, atol=1e-6 * size)


@pytest.mark.slow
def test_readings_have_gradients():
    at, forward = ahead()
    backward = jax.jit(jax.grad(lambda values: jnp.sum(gain(values, "reverse"))))(at)
    assert np.asarray(backward) == pytest.approx(forward.sum(axis=0), rel=1e-6)


@pytest.mark.slow
def test_the_joints_bodies_are_read_too():
    scene = plain_joint()
    p, times = scene.parameters(), np.linspace(0.0, 0.1, 11)
    names = ("seat.torque", "head.angle", "ball.place.z", "seat_ball.force.x in head", "head_cage.force.z")
    found = simulate(scene, p, times, read=names).readings
    assert found["ball.place.z"].shape == found["seat_ball.force.x in head"].shape == (11, 6)
    # Of 1.8 kN m on the head and some per cent of friction.
    assert 1800.0 < found["seat.torque"][-1] < 1.06 * 1800.0
    assert found["head.angle"][-1] == pytest.approx(float(p["drive_speed"]) * 0.1, abs=1e-2)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("slidr.acceleration.x", "slider"),
        ("slider.acceleraton.x", "acceleration.x"),
        ("journal.force.q", "force"),
        ("journal.normal in rod", "leave the frame out"),
        ("journal.force.x in rodd", "rod"),
        ("slider.angle", "no angle"),
        ("rod.torque", "no torque"),
        ("journal.slip", "no slip"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_nearest(name, hint):
    scene = scenes.slider_crank()
    with pytest.raises(InputError) as raised:
        simulate(scene, scene.parameters(), TIMES[:3], read=(name,))
    assert hint in str(raised.value)
    assert bj.InputError is InputError


@pytest.mark.slow
def test_a_readings_feature_is_taken_and_differentiated_like_a_contacts():
    """Largest acceleration before the second touch, by the slider's mass: the wrapped model against the reading itself."""
    scene = scenes.slider_crank()
    p = scene.parameters()
    # Samples so dense about the largest one that the greatest of them is the curve's, which the feature is of.
    name, top = "slider.acceleration.x", 2.4187e-4
    for width in (1e-7, 1e-9):
        times = np.concatenate([np.linspace(0.0, 2.41e-4, 242), top + np.linspace(-width, width, 401), [2.6e-4]])
        read = np.abs(simulate(scene, p, times, accuracy=1e-5, read=(name,)).readings[name])
        top = times[np.argmax(read)]
    found = bj.sensitivity(
        scene, p, times, ("slider.mass",), features=("slider.acceleration.x.largest",), accuracy=1e-5, certify=False
    )
    largest = f"{name}.largest"
    assert found.features[largest] == pytest.approx(read.max(), rel=1e-6)

    @jax.jit
    @jax.jacfwd
    def slope(mass):
        history = reading_history(scene, {**p, "slider.mass": mass}, times, (name,), accuracy=1e-5)
        return jnp.abs(history[name]).max()

    assert found.feature_derivatives["slider.mass"][largest] == pytest.approx(float(slope(p["slider.mass"])), rel=1e-6)


def test_axes_that_are_not_known_are_refused():
    """The joint's rolling balls have a spin and no axes."""
    scene = plain_joint(spin=True)
    with pytest.raises(InputError, match=r"rotation of '.*' is not computed"):
        simulate(scene, scene.parameters(), np.linspace(0.0, 0.01, 3), read=("seat_cage.force.x in ball",))


@pytest.mark.parametrize("joint", tiers.ci([name for name in JOINTS if name != "fixed"], "hinge", "free", "universal"))
def test_what_a_start_names_is_a_reading(joint):
    """One vocabulary: a run reads at time 0 what its start was given, by the same names."""
    names = (*(plain := bj.Body("b", joint)).coordinates, *plain.rates)
    start = {name: 0.1 * (k + 1) for k, name in enumerate(names)}
    if "q0" in start:
        start |= {"q0": 0.8, "q1": 0.0, "q2": 0.6, "q3": 0.0}
    scene = bj.Mechanism("test", (bj.Body("b", joint, start=start, mass=1.0, inertia=1.0),))
    read = [f"b.{name}" for name in start]
    found = reading_history(scene, scene.parameters(), np.linspace(0.0, 1e-3, 3), read)
    for name, value in start.items():
        assert float(found[f"b.{name}"][0]) == pytest.approx(value, rel=1e-12), name
        assert unit_of(f"b.{name}") == start_unit(name)


@pytest.mark.parametrize("joint", ["slide", "hinge"])
def test_a_driven_body_reads_its_drive_and_starts_by_it(joint):
    place, speed = ("position", "velocity") if joint == "slide" else ("angle", "speed")
    body = bj.Body("b", joint, drive=bj.Drive(speed=3.0, start=0.25), mass=1.0, inertia=1.0)
    scene, times = bj.Mechanism("test", (body, bj.Body("c", "slide", mass=1.0))), np.linspace(0.0, 1e-3, 3)
    found = reading_history(scene, scene.parameters(), times, [f"b.{place}", f"b.{speed}"])
    np.testing.assert_allclose(found[f"b.{place}"], 0.25 + 3.0 * times, rtol=1e-12)
    np.testing.assert_allclose(found[f"b.{speed}"], 3.0, rtol=1e-12)
    with pytest.raises(InputError, match=r"body .b. start: .*its drive says where it is; give the drive.s own .start."):
        bj.Body("b", joint, start={place: 0.1}, drive=bj.Drive(speed=3.0))
    other = "angle" if joint == "slide" else "position"
    with pytest.raises(InputError, match=f"the joint of 'b' has no {other}; .*{place}"):
        reading_history(scene, scene.parameters(), times, [f"b.{other}"])


def test_a_period_is_one_turn_of_the_driven_hinge():
    scene = scenes.slider_crank()
    for speed in (30.0, -30.0):
        period, settled = scene.period(scene.parameters(crank_speed=speed))
        assert period == pytest.approx(2.0 * np.pi / 30.0, rel=1e-14) and settled == period
    with pytest.raises(InputError, match=r"crank drive.*other than 0"):
        scene.period(scene.parameters(crank_speed=0.0))


def test_a_reading_of_which_a_feature_is_stands_in_a_contacts_place():
    """Its value where a normal force does."""
    scene = scenes.slider_crank()
    params, shown = scene.parameters(), observing(scene, ["slider.velocity.x.peak"])
    start = scene.initial_state(params)
    found = jax.eval_shape(lambda y, p: shown.observe(jnp.zeros(()), y, shown.prepare(p)), start, params)
    assert found["slider.velocity.x"].force.shape == (3,)
