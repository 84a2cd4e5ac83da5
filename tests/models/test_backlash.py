"""Two bodies with play: Modelica's ElastoGap, free and driven, against SciPy; its limits and its loss."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax import laws, scenes, simulate
from bcfj_jax.contact.elastic import ELASTIC
from benchmarks.references import elasto_gap as reference

DRIVEN, FREE = scenes.backlash(), scenes.backlash(driven=False)
TIMES = np.linspace(0.0, 10.0, 501)


def case(scene, exponent, dashpot):
    """Parameters, and the reference's body: the follower as the driver sees it."""
    params = scene.parameters(exponent=exponent, dashpot=dashpot)
    p = {name: float(value) for name, value in params.items()}
    made = reference.ElastoGap(stiffness=p["stiffness"], damping=dashpot, exponent=exponent, lower=-0.5, upper=0.5)
    if scene is FREE:
        mass = p["mass"] * p["driver.mass"] / (p["mass"] + p["driver.mass"])
        return params, dataclasses.replace(made, mass=mass, start=(0.0, p["follower_speed"]))
    size, rate = p["drive_amplitude"], p["drive_frequency"]
    return params, dataclasses.replace(
        made, drive=p["mass"] * size * rate**2, frequency=rate, start=(0.0, -size * rate)
    )


def seen(scene, params, run):
    """Place and speed of the follower as the driver sees them, (T, 2)."""
    moving = jax.vmap(lambda t, y: scene.motions(t, y, params))(jnp.asarray(TIMES), jnp.asarray(run.trajectory))
    first, second = moving["driver"], moving["follower"]
    return np.stack([second.place[:, 0] - first.place[:, 0], second.velocity[:, 0] - first.velocity[:, 0]], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize(
    "scene",
    [pytest.param(DRIVEN, marks=pytest.mark.slow), pytest.param(FREE, marks=pytest.mark.full)],
    ids=["driven", "free"],
)
def test_elasto_gap(scene, exponent):
    for dashpot in (0.0, 1.5, 20.0):
        params, made = case(scene, exponent, dashpot)
        motion = reference.simulate(made, TIMES, 1e-12, max_step=5e-3)
        run = simulate(scene, params, TIMES, accuracy=1e-8)
        assert np.abs(seen(scene, params, run) - motion.states).max() < 1e-6
        # Signed: positive while the follower presses the stop ahead, which then presses it back.
        forces = reference.stop_forces(made, motion.states)
        assert np.abs(run.force["stop"][:, 0] + forces.sum(axis=1)).max() < 2e-5
        # A strong dashpot leaves too little speed to come back within the time.
        assert (forces[:, 1] < 0).any() and ((forces[:, 0] > 0).any() or dashpot == 20.0)


@pytest.mark.slow
def test_what_is_lost_is_what_the_reference_loses():
    params, made = case(DRIVEN, 1.5, 1.5)
    run = simulate(DRIVEN, params, TIMES, accuracy=1e-6)
    flows = jax.jit(jax.vmap(lambda t, y: DRIVEN.flows(t, y, params)))(jnp.asarray(TIMES), jnp.asarray(run.trajectory))
    lost = np.trapezoid(np.asarray(flows.taken["damping"]), TIMES)
    assert lost == pytest.approx(reference.simulate(made, TIMES, 1e-12, max_step=5e-3).loss[-1], rel=3e-3)


@pytest.mark.slow
def test_momentum_of_free_bodies():
    run = simulate(FREE, FREE.parameters(), TIMES)
    assert np.abs(run.trajectory[:, 2:].sum(axis=1) - 1.0).max() < 1e-12


@pytest.mark.parametrize("dashpot", [1.0, 10.0, 40.0, 200.0])
def test_restitution_is_that_of_the_closed_form(dashpot):
    # A body on one stop, n = 1: the same at every speed.
    scene = scenes.impact(law="elasto_gap")
    for speed in (0.3, 3.0):
        params = scene.parameters(mass=1.0, stiffness=1e3, exponent=1.0, dashpot=dashpot, approach_speed=speed)
        # The contact ends within half a period of the spring, or within some of an overdamped stop's.
        run = simulate(scene, params, np.array([0.0, 0.05, 2.0]), accuracy=1e-8)
        assert run.force["contact"][-1, 0] == 0.0
        assert -run.trajectory[-1, 1] / speed == pytest.approx(reference.restitution(1.0, 1e3, dashpot), abs=1e-7)


@pytest.mark.parametrize("elastic", ELASTIC)
def test_the_dashpot_is_limited_with_every_elastic_part(elastic):
    values = {
        "stiffness": 3e10, "exponent": 1.5, "reference_force": 2e4, "reference_penetration": 8e-5, "dashpot": 1e4,
        "effective_modulus": 1e11, "contact_length": 0.01, "radius": 0.03, "radius_difference": 1e-4,
        "bottoming_stiffness": 2e9, "bottoming_penetration": 5e-5, "bottoming_width": 2e-5,
    }  # fmt: skip
    law, c = laws.make("elasto_gap", elastic), {name: jnp.asarray(value) for name, value in values.items()}
    depth, rate = np.meshgrid([-1e-5, 0.0, 1e-6, 3e-5, 2e-4], [-10.0, -1e-3, 0.0, 1e-3, 10.0])
    spring, force = ELASTIC[elastic].force(depth, c), law.force(depth, rate, c)
    assert np.allclose(force, spring + np.clip(1e4 * rate, -spring, spring), rtol=1e-14, atol=0.0)
    assert np.all(force >= 0.0) and np.all(force <= 2.0 * spring) and np.all(force[depth <= 0.0] == 0.0)
    assert set(law.needs) == {*ELASTIC[elastic].needs, "dashpot"}
    # Modelica's own words for n = 1: f is what pulls the flanges together.
    if elastic == "linear":
        for v in (-2.0, 1e-4, 2.0):
            written = -reference.flange_force(-3e-5, -v, 0.0, 3e10, 1e4, 1.0)
            assert float(law.force(3e-5, v, c)) == pytest.approx(written, rel=1e-12)
