"""Rotations against SciPy's, small, half a turn and any."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bcfj_jax.core import rotations

RNG = np.random.default_rng(3)
ANY = RNG.normal(size=(60, 3))
ANY *= (RNG.uniform(0.0, np.pi - 1e-6, 60) / np.linalg.norm(ANY, axis=1))[:, None]
SMALL = 10.0 ** RNG.uniform(-12, -3, (20, 1)) * RNG.normal(size=(20, 3))
HALF = np.pi * np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0]]])


@pytest.mark.parametrize("turns", [ANY, SMALL, np.zeros((1, 3)), HALF], ids=["any", "small", "none", "half a turn"])
def test_rotations_are_those_of_scipy(turns):
    theirs = Rotation.from_rotvec(turns)
    axes, quaternions = theirs.as_matrix(), theirs.as_quat(scalar_first=True)
    quaternions *= np.where(quaternions[:, :1] < 0.0, -1.0, 1.0)
    np.testing.assert_allclose(rotations.turned_by(turns), axes, atol=1e-15)
    np.testing.assert_allclose(rotations.matrix(3.0 * quaternions), axes, atol=1e-15)
    for ours in (rotations.quaternion(axes, np), jax.vmap(rotations.quaternion)(axes)):
        np.testing.assert_allclose(np.abs(np.sum(ours * quaternions, axis=1)), 1.0, rtol=1e-15)
    # Half a turn either way is one rotation.
    vectors, end = rotations.vector(axes), np.linalg.norm(turns, axis=1, keepdims=True) > np.pi - 1e-9
    sign = np.where(end & (np.sum(vectors * turns, axis=1, keepdims=True) < 0.0), -1.0, 1.0)
    np.testing.assert_allclose(sign * vectors, turns, rtol=1e-9, atol=1e-15)
    one = rotations.turned_by(turns[0]), rotations.vector(axes[0]), rotations.matrix(quaternions[0])
    for single, many in zip(one, (rotations.turned_by(turns), vectors, axes), strict=True):
        np.testing.assert_allclose(single, many[0], atol=1e-15)
