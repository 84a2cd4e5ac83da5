"""The slider-crank with a clearance joint: ideal kinematics, and the reference until the two differ."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

from bcfj_jax import scenes, simulate
from bcfj_jax.solve.measured_error import measured
from benchmarks.references import slider_crank as reference

pytestmark = pytest.mark.usefixtures("optimised")
B6 = reference.SliderCrank()
SCENE, LATCHED = scenes.slider_crank(), scenes.slider_crank(law="lankarani_nikravesh")
# Turns of the crank until which forces keep what is asked, by clearance [m]. Later the two differ: a force is off by ten
# times what is asked from 1.85 turns (1 %) and 0.89 turns (0.1 %) at 0.2 mm, from 1.83 and 1.28 turns at 0.5 mm; at
# 0.05 mm, where the journal settles on its bearing, not within 2.5 turns. Runs at 1e-9 differ by 1 % from 4 to 5 turns on.
UNTIL = {5e-5: {1e-2: 0.9, 1e-3: 1.8}, 2e-4: {1e-2: 1.8, 1e-3: 0.8}, 5e-4: {1e-2: 1.25, 1e-3: 1.2}}
COUNT = 3001


@functools.cache
def of(clearance, law="hunt_crossley"):
    """The reference's mechanism, its motion and readings over the longest time needed."""
    made = dataclasses.replace(B6, journal_radius=0.01 - clearance, law=law)
    turns = max(UNTIL[clearance].values()) if law == "hunt_crossley" else 0.25
    motion = reference.simulate(made, np.linspace(0.0, turns * made.period, COUNT))
    return made, motion, reference.readings(made, motion)


def ours(scene, made, times, asked):
    """A run of the same mechanism, and its parameters."""
    values = {"clearance_journal": made.clearance, "radius": made.journal_radius, "stiffness": made.stiffness}
    values |= {"damping": made.damping} if "damping" in scene.quantities else {"restitution": made.restitution}
    params = scene.parameters(values)
    run = simulate(scene, params, times, accuracy=asked)
    assert run.status == "ok"
    return run, params


@jax.jit
def moving(params, times, states):
    return jax.vmap(lambda t, y: SCENE.motions(t, y, params))(times, states)


def off(found, expected):
    """Rms of the difference over the largest expected."""
    return np.sqrt(np.mean(np.square(np.asarray(found) - expected))) / np.abs(expected).max()


def test_ideal_kinematics():
    scene = scenes.slider_crank(ideal=True)
    params = scene.parameters()
    times = np.linspace(0.0, float(scene.horizon(params)), 101)
    assert simulate(scene, params, times).status == "ok"
    found = jax.jit(jax.vmap(lambda t: scene.motions(t, jnp.zeros(0), params)))(jnp.asarray(times))
    exact, rim, pull = reference.ideal(B6, times), B6.crank * B6.speed, B6.crank * B6.speed**2
    slider, rod = found["slider"], found["rod"]
    for value, expected, size in (
        (slider.place[:, 0], exact.position, B6.crank),
        (slider.velocity[:, 0], exact.velocity, rim),
        (slider.acceleration[:, 0], exact.acceleration, pull),
        (rod.spin[:, 2], exact.angle_rate, B6.speed),
        (rod.spin_rate[:, 2], exact.angle_acceleration, B6.speed**2),
    ):
        assert np.abs(value - expected).max() < 1e-9 * size
    # The rod's end is on the slider.
    tip = np.asarray(rod.place) + 0.5 * B6.rod * np.asarray(rod.axes)[..., 0]
    assert np.abs(tip - np.asarray(slider.place)).max() < 1e-12


@pytest.mark.full
@pytest.mark.parametrize("asked", tiers.ci([1e-2, 1e-3], 1e-3))
@pytest.mark.parametrize("clearance", tiers.ci(UNTIL, 5e-4))
def test_forces_and_motion_are_those_of_the_reference(clearance, asked):
    made, motion, read = of(clearance)
    run, params = ours(SCENE, made, motion.times, asked)
    found = moving(params, jnp.asarray(motion.times), jnp.asarray(run.trajectory))
    early = motion.times <= UNTIL[clearance][asked] * made.period
    times, truth = motion.times[early], np.stack([read.normal, *2 * [np.zeros(COUNT)]], axis=1)[early]
    forces = measured(
        asked, 0.0, times, {"journal": run.force["journal"][early]}, {"journal": truth}, tolerance=0.0, wall_s=0.0
    )
    assert forces.worst < asked and np.isnan(forces.agree_until)
    slider = found["slider"]
    # Beside the largest of each; the joint's play is a small part of the slider's way.
    for value, expected, allowed in (
        (slider.place[:, 0], motion.states[:, 1], 0.1 * asked),
        (slider.velocity[:, 0], motion.states[:, 3], asked),
        (slider.acceleration[:, 0], read.slider_acceleration, asked),
        (found["crank"].drive, read.torque, asked),
        (found["rod"].spin_rate[:, 2], read.rod_acceleration, asked),
    ):
        assert off(np.asarray(value)[early], expected[early]) < allowed


@pytest.mark.slow
def test_a_latched_approach_speed():
    # The reference latches the speed at the instant of touch; the memory lags by a third of 0.1 um.
    made, motion, read = of(2e-4, "lankarani_nikravesh")
    run, _ = ours(LATCHED, made, motion.times, 1e-5)
    assert len(motion.touches) >= 9
    for touch, speed in motion.touches:
        memory = run.trajectory[np.searchsorted(motion.times, touch), -1]
        assert abs(memory / speed - 1.0) < (3e-3 if speed > 1.0 else 0.2)
    assert off(run.force["journal"][:, 0], read.normal) < 5e-3


@pytest.mark.slow
def test_rubbing_takes_what_the_reference_says():
    made = dataclasses.replace(
        B6, friction="brown_mcphee", friction_static=0.1, friction_dynamic=0.05, friction_speed=0.1
    )
    times = np.linspace(0.0, 0.3 * made.period, 401)
    motion = reference.simulate(made, times)
    read = reference.readings(made, motion)
    scene = scenes.slider_crank(friction=True)
    params = scene.parameters(stiffness=made.stiffness, damping=made.damping)
    run = simulate(scene, params, times, accuracy=1e-3)
    assert off(run.force["journal"][:, 0], read.normal) < 1e-3
    flows = jax.vmap(lambda t, y: scene.flows(t, y, params))(jnp.asarray(times), jnp.asarray(run.trajectory))
    taken = np.asarray(flows.taken["friction"] + flows.taken["damping"])
    assert np.trapezoid(taken, times) == pytest.approx(motion.loss[-1], rel=2e-2)
    assert len({scenes.slider_crank(friction=True), scene}) == 1
