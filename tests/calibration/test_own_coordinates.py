"""An experiment has tangents by its own coordinates alone; the Jacobian is that of all by all."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import bcfj_jax as bj
from calibration import Channel, Experiment, Free, Observation, Problem
from calibration.forward import model as forward

SCENE = bj.scenes.impact()
LAW = dict(SCENE.parameters())


def experiment(k, count, features):
    times = np.linspace(0.0, 2e-4, count)
    force = np.asarray(bj.force_history(SCENE, LAW, times)["contact"])[:, 0]
    peak = (Observation("contact.peak", 500.0, 5.0),) if features else ()
    return Experiment(f"r{k}", times, (Channel("contact.normal", force, 5.0),), features=peak)


OWN = (("time_offset", "gain"), False), (("approach_speed",), True), ((), True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "features"), [OWN[0], *(pytest.param(*case, marks=pytest.mark.slow) for case in OWN[1:])]
)
def test_the_jacobian_is_the_dense_one(own, features):
    bounds = {"time_offset": (-1e-5, 1e-5), "gain": (0.9, 1.1), "approach_speed": (0.8, 1.2)}
    free = (Free("stiffness", 1e9, 1e11), Free("exponent", 1.0, 2.0), *(Free(n, *bounds[n], each=True) for n in own))
    problem = Problem(SCENE, LAW, (experiment(0, 20, features), experiment(1, 21, features)), free)
    model = forward.build(problem, problem.experiments)
    assert (model.own is None) == (not own)
    if own:
        assert model.own.shape == (2, 2 + len(own)) and len(model.coordinates) == 2 + 2 * len(own)
    point = np.random.default_rng(0).uniform(0.3, 0.7, len(model.coordinates))
    residuals, jacobian = forward.residuals_and_jacobian(model, point)
    dense = jax.jit(jax.jacfwd(model.residuals))(point)
    assert residuals.shape == (2 * 21 + 2 * features,)
    np.testing.assert_allclose(jacobian, dense, rtol=0, atol=1e-11 * np.abs(dense).max())
