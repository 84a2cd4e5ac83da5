"""A row of spheres: published velocities, momentum and energy, the reference's forces."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from bcfj_jax import InputError, scenes, simulate
from bcfj_jax.verification import oracles
from benchmarks.references import chain as reference

LADDER = [(3, 1.5), (4, 1.5), (5, 1.5), (10, 1.5), (3, 1.0), (5, 1.0), (3, 2.0)]


def struck(count, exponent, accuracy=1e-6):
    """A run until all spheres are apart, and its scene and parameters."""
    scene = scenes.chain(count)
    stiffness = dict(scene.defaults)["stiffness"] * 2e-5 ** (1.5 - exponent)
    params = scene.parameters(exponent=exponent, stiffness=stiffness)
    times = np.linspace(0.0, 2.0 * float(scene.horizon(params)), 401)
    return scene, params, simulate(scene, params, times, accuracy=accuracy)


@pytest.mark.parametrize(
    ("count", "exponent"),
    [pytest.param(*x, marks=pytest.mark.slow) for x in LADDER],
)
def test_published_velocities(count, exponent):
    # Physics sheet, B3 and B3': to nine digits, or seven.
    _, _, run = struck(count, exponent)
    assert run.status == "ok"
    velocities = run.trajectory[-1, count:]
    assert np.abs(velocities - oracles.CHAIN[count, exponent]).max() < 1e-6
    assert velocities.sum() == pytest.approx(1.0, abs=1e-12)
    assert all(force[-1, 0] == 0.0 for force in run.force.values())


@pytest.mark.full
def test_energy_is_kept():
    scene, params, run = struck(5, 1.5)
    flows = jax.jit(jax.vmap(lambda t, y: scene.flows(t, y, params)))(run.times, run.trajectory)
    total = flows.stored["kinetic"] + flows.stored["elastic"]
    assert np.abs(total / total[0] - 1.0).max() < 1e-6
    assert not np.any(flows.taken["damping"]) and not np.any(flows.taken["friction"])


@pytest.mark.full
def test_forces_of_a_lossy_row_are_those_of_the_reference():
    scene = scenes.chain(5, law="memory_free")
    params = scene.parameters(damping=0.3)
    run = simulate(scene, params, np.linspace(0.0, 2e-4, 301), accuracy=1e-5)
    row = reference.Chain(5, damping=0.3)
    forces = reference.forces(row, reference.simulate(row, run.times, 1e-12))
    found = np.stack([run.force[f"contact_{i}"][:, 0] for i in range(1, 5)], axis=1)
    assert np.abs(found - forces).max() < 1e-5 * forces.max()


@pytest.mark.slow
def test_a_law_stated_by_restitution_has_the_first_speed():
    scene = scenes.chain(2, law="exact")
    params = scene.parameters(restitution=0.7)
    run = simulate(scene, params, np.array([0.0, float(scene.horizon(params))]), accuracy=1e-5)
    assert np.allclose(run.trajectory[-1, 2:], [0.15, 0.85], atol=1e-6)


def test_a_row_needs_two():
    with pytest.raises(InputError, match="give a whole number from 2"):
        scenes.chain(1)
    assert scenes.chain(3) == scenes.chain(3) and scenes.chain(3) != scenes.chain(4)
