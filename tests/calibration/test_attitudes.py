"""An attitude is a reading and an observable: by its rotation, whatever the sign of the quaternion."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bcfj_jax as bj
from bcfj_jax.core.rotations import quaternion
from calibration import Channel, Experiment, Free, Problem, attitudes, fit

QUATERNION = [f"body.attitude.q{k}" for k in range(4)]
SPIN = [f"body.spin.{k}" for k in "xyz"]
START = dict(wx=3.0, wy=-2.0, wz=5.0, q0=0.5, q1=-0.5, q2=0.1, q3=0.7)
# A free top: no contact, no weight; its greatest inertia is what is sought.
TOP = bj.Mechanism(
    "top",
    [bj.Body("body", joint="free", inertia=(1e-3, 2e-3, "third"), start=START)],
    own=[bj.Quantity("third", "kg m^2", "inertia about z", 0.0)],
    given=dict(mass=0.3, third=2.5e-3),
)
TIMES = np.linspace(0.0, 2.0, 41)


def scalar_first(rotation):
    return rotation.as_quat(scalar_first=True)


def test_a_quaternion_of_axes_is_that_of_scipy_and_has_its_derivative():
    drawn = Rotation.random(200, random_state=0)
    wanted = scalar_first(drawn)
    wanted *= np.where(wanted[:, :1] < 0, -1, 1)
    assert np.allclose(quaternion(jnp.asarray(drawn.as_matrix())), wanted, rtol=0, atol=1e-14)
    # About an axis, cos(a/2) and sin(a/2) at any angle.
    turn = lambda a: quaternion(jnp.array([[jnp.cos(a), -jnp.sin(a), 0], [jnp.sin(a), jnp.cos(a), 0], [0, 0, 1.0]]))  # noqa: E731
    for angle in (0.0, 0.3, 1.7, 3.0, -2.5):
        assert np.allclose(jax.jacfwd(turn)(angle), [-np.sin(angle / 2) / 2, 0, 0, np.cos(angle / 2) / 2], atol=1e-13)


def test_the_error_is_the_rotation_vector_in_the_world():
    first, by = Rotation.random(300, random_state=1), Rotation.random(300, random_state=2)
    p, q = (scalar_first(x).T * np.random.default_rng(0).choice([-1, 1], 300) for x in (by * first, first))
    assert np.allclose(attitudes.rotation(jnp.asarray(p), jnp.asarray(q)), by.as_rotvec().T, atol=1e-12)
    assert np.allclose(attitudes.rotation(jnp.asarray(q), jnp.asarray(q)), 0.0, atol=1e-15)
    slope = jax.jacfwd(lambda p: attitudes.rotation(p, jnp.asarray(q[:, :1])))(jnp.asarray(q[:, :1]))
    assert np.isfinite(slope).all() and np.abs(slope).max() > 1.0


def test_a_hinge_and_a_frame():
    scene = bj.Mechanism(
        "two",
        [bj.Body("rod", joint="hinge", axis="x", start=dict(speed=1.5)), bj.Body("ball", joint="particle")],
        given=dict(mass=1.0, inertia=1.0),
    )
    names = ["rod.attitude.q0", "rod.attitude.q1", "ball.attitude.q0", "ball.attitude.q1 in rod"]
    found = bj.reading_history(scene, scene.parameters(), TIMES, names)
    half = 0.75 * TIMES
    for name, wanted in zip(names, (np.cos(half), np.sin(half), np.ones(41), -np.sin(half)), strict=True):
        assert np.allclose(found[name], wanted, atol=1e-9), name


def record(signs=False, spin=""):
    names = [*QUATERNION, *([f"{s}{spin}" for s in SPIN])]
    found = bj.reading_history(TOP, TOP.parameters(), TIMES, names, accuracy=1e-9)
    values = np.array([found[n] for n in names])
    rng = np.random.default_rng(3)
    noise = Rotation.from_rotvec(2e-3 * rng.standard_normal((41, 3)))
    measured = noise * Rotation.from_quat(values[:4].T, scalar_first=True)
    quaternions = scalar_first(measured) * (rng.choice([-1, 1], 41)[:, None] if signs else 1)
    return quaternions.T, values[4:]


def problem(quaternions, more=(), sigma=2e-3):
    channels = [Channel(n, x, sigma) for n, x in zip(QUATERNION, quaternions, strict=False)]
    experiment = Experiment("toss", TIMES, (*channels, *more))
    return Problem(TOP, dict(TOP.parameters()), (experiment,), (Free("third", 1e-3, 2.9e-3),))


@pytest.mark.slow
@pytest.mark.parametrize("signs", [False, True])
def test_an_attitude_is_fitted_to_whatever_its_sign(signs):
    found = fit(problem(record(signs)[0]), starts=4)
    # Noise of 2 mrad in 41 attitudes; three numbers each.
    assert found.parameters["third"].value == pytest.approx(2.5e-3, abs=2e-6)
    assert found.residual["samples"] == 3 * 41
    assert found.residual["chi2"] == pytest.approx(3 * 41, abs=4 * np.sqrt(2 * 123))


def test_a_part_of_an_attitude_is_refused():
    quaternions, _ = record()
    with pytest.raises(bj.InputError, match="without q3"):
        problem(quaternions[:3])
    with pytest.raises(bj.InputError, match="length of 2"):
        problem(2.0 * quaternions)


def test_spin_in_the_bodys_axes_is_told_from_the_worlds():
    quaternions, world = record()
    _, own = record(spin=" in body")
    problem(quaternions, [Channel(n, x, 0.1) for n, x in zip(SPIN, world, strict=True)])
    with pytest.raises(bj.InputError, match=r"write 'body[.]spin[.]x in body'"):
        problem(quaternions, [Channel(n, x, 0.1) for n, x in zip(SPIN, own, strict=True)])


def test_spin_without_two_readings_in_a_row_is_taken():
    quaternions, world = record()
    world = np.where(np.arange(41) % 2, np.nan, world)
    kept = problem(quaternions, [Channel(n, x, 0.1) for n, x in zip(SPIN, world, strict=True)])
    assert len(kept.experiments[0].channels) == 6
