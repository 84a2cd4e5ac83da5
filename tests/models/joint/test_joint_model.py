"""The joint as everything outside sees it: what instruments on its bodies read, and what follows from its options."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import plain_joint

from bcfj_jax.models.joint.observe import resultants

JOINT = plain_joint()
PARAMS = JOINT.parameters(joint_angle=0.1)


# An operation at a time, each of these compiles a hundred little programs.
motions = jax.jit(JOINT.motions)


@functools.cache
def jolted():
    """What is computed once a run, and a state near the start in which everything moves and touches."""
    rng = np.random.default_rng(3)
    prepared, y = jax.jit(JOINT.prepare)(PARAMS), jax.jit(JOINT.initial_state)(PARAMS)
    return prepared, y + 0.3 * JOINT.error_scale(PARAMS) * rng.standard_normal(y.size)


@pytest.mark.slow
def test_bodies_move_as_their_states_say():
    prepared, y = jolted()
    t, step = jnp.asarray(0.03), 1e-9
    change = jax.jit(JOINT.vector_field)(t, y, prepared)
    here, ahead = (jax.device_get(motions(t, at, prepared)) for at in (y, y + step * change))
    assert set(here) == set(JOINT.body_names)
    for name, body in here.items():
        after = ahead[name]
        moved = (after.place - body.place) / step
        assert np.asarray(moved) == pytest.approx(np.asarray(body.velocity), rel=1e-4, abs=1e-5), name
        gained = (after.velocity - body.velocity) / step
        assert np.asarray(gained) == pytest.approx(np.asarray(body.acceleration), rel=1e-3, abs=1.0), name
        if body.axes is None:
            continue
        assert np.asarray(body.axes.T @ body.axes) == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(body.axes) == pytest.approx(1.0)
        turned = (after.axes - body.axes) / step
        spins = np.cross(body.spin, body.axes.T).T
        if name == "cage":
            # Without window ends it has no azimuth: about its own axis, its axes turn with the seat.
            turned, spins = turned[:, 2], spins[:, 2]
            assert np.asarray(turned) == pytest.approx(np.asarray(spins), rel=1e-4, abs=1e-5)
            continue
        assert np.asarray(turned) == pytest.approx(np.asarray(spins), rel=1e-4, abs=1e-5)
        if body.angle is not None:
            assert float((after.angle - body.angle) / step) == pytest.approx(
                float(body.spin @ body.axes[:, 2]), rel=1e-4
            )


@pytest.mark.slow
def test_forces_in_world_axes_are_the_whole_forces():
    prepared, y = jolted()
    read, summed = jax.jit(JOINT.observe)(jnp.zeros(()), y, prepared), resultants(JOINT, prepared, y)
    for name, reading in read.items():
        assert reading.world is not None
        size = np.linalg.norm(np.asarray(reading.world), axis=-1)
        assert np.asarray(jnp.sum(reading.world.reshape(-1, 3), 0)) == pytest.approx(
            np.asarray(summed[name]), rel=1e-12
        )
        if not name.endswith("_ball"):
            # One normal and two tangents at right angles.
            assert size == pytest.approx(np.linalg.norm(np.asarray(reading.force), axis=-1), rel=1e-9)


@pytest.mark.slow
def test_the_drive_torque_is_that_of_the_energy_balance():
    prepared, y = jolted()
    t = jnp.asarray(0.03)
    seat, flows = motions(t, y, prepared)["seat"], jax.jit(JOINT.flows)(t, y, prepared)
    assert float(seat.drive * (seat.spin @ seat.axes[:, 2])) == pytest.approx(float(flows.given["drive"]), rel=1e-12)


def test_levels_are_options():
    levels = JOINT.coarser()
    assert [level.name for level in levels] == ["kinematic", "quasistatic"]
    still = dataclasses.replace(JOINT, **levels[1].options)
    assert still == plain_joint(fidelity="quasistatic") and still.full() == JOINT
    assert not still.traits.history and still.body_names == () and still.tables == ()
    undecided = dataclasses.replace(JOINT, **JOINT.choice_options())
    assert undecided.traits.open and [level.name for level in undecided.coarser()][-1] == "dynamic"
