"""The LuGre law against SciPy: steady state, exact step, spring, dissipation, derivatives."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from frictions import COMPONENT, C
from hypothesis import example, given
from hypothesis import strategies as st
from oracles import within
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from bcfj_jax.contact.friction import LuGre


class Bristles(LuGre):
    """Whole vectors out of ``bond``: z' = v - k z and the traction s z + m v, components along the last axis."""

    def rate(self, z, slip, c):
        """z' [m/s] of a deflection [m] at a slip velocity [m/s]."""
        return slip - self.bond(jnp.sum(slip * slip, -1), c)[0][..., None] * z

    def traction(self, z, slip, c):
        """The friction force is -N times this [-]."""
        _, stick, mobility = self.bond(jnp.sum(slip * slip, -1), c)
        return stick[..., None] * z + mobility[..., None] * slip

    def settle(self, z0, slip, time, c):
        """z after a time at constant slip: z0 exp(-k t) + v (1 - exp(-k t))/k."""
        forget = self.bond(jnp.sum(slip * slip, -1), c)[0]
        return jnp.exp(-forget * time)[..., None] * z0 - (jnp.expm1(-forget * time) / forget)[..., None] * slip


# Canudas de Wit et al. 1995, table I, under a normal force of 1 N and without the viscous part.
PUBLISHED = {
    "friction_static": 1.5, "friction_dynamic": 1.0, "friction_speed": 1e-3,
    "bristle_stiffness": 1e5, "bristle_damping": 1e5**0.5,
}  # fmt: skip


def lugre_numpy(c):
    """z', g and traction along a line, in NumPy, with the true |v|."""
    static, dynamic, speed, stiffness, damping = (c[name] for name in LuGre.needs)

    def g(v):
        return (dynamic + (static - dynamic) * np.exp(-((v / speed) ** 2))) / stiffness

    def rate(z, v):
        return v - np.abs(v) * z / g(v)

    return g, rate, lambda z, v: stiffness * z + damping * rate(z, v)


def integrate(rate, z0, v, time):
    """z after a time at constant slip, by SciPy."""
    run = solve_ivp(lambda _, z: rate(z, v), (0.0, time), np.atleast_1d(z0), method="Radau", rtol=1e-11, atol=1e-18)
    assert run.success
    return run.y[:, -1]


@pytest.mark.parametrize("c", [C, PUBLISHED], ids=["joint", "published"])
@pytest.mark.parametrize("speed", [-3.0, -0.1, 1e-4, 1e-3, 0.05, 2.0])
def test_lugre_steady_state(c, speed):
    law = Bristles()
    g, rate, traction = lugre_numpy(c)
    z = integrate(rate, 0.0, speed, 60.0 * g(speed) / abs(speed))
    expected = traction(z, speed)
    mu = c["friction_dynamic"] + (c["friction_static"] - c["friction_dynamic"]) * np.exp(
        -((speed / c["friction_speed"]) ** 2)
    )
    assert expected == pytest.approx([np.sign(speed) * mu], rel=1e-8)
    slip = np.array([speed, 0.0])
    late = law.settle(np.zeros(2), slip, 60.0 * g(speed) / abs(speed), c)
    assert np.allclose(law.traction(late, slip, c), [expected[0], 0.0], rtol=1e-8)
    assert np.abs(law.rate(late, slip, c)).max() < 1e-10 * abs(speed)
    # The state-free form: mu(v) rounded over 1e-3 v_s.
    rounding = np.hypot(1.0, 1e-3 * c["friction_speed"] / speed)
    assert law.coefficient(speed, c) == within(np.sign(speed) * mu / rounding, 1e-12)


@pytest.mark.parametrize("ages", [1e-6, 0.01, 0.6, 0.7, 3.0, 40.0])
@pytest.mark.parametrize("speed", [1e-3, 0.5])
def test_lugre_step_is_exact(ages, speed):
    """A bristle bent aside, in the plane, against SciPy on the vector equation; ``ages`` is time in units of g/|v|."""
    g, _, _ = lugre_numpy(C)
    slip, z0 = speed * np.array([0.6, -0.8]), np.array([-4e-7, 7e-7])
    time = ages * g(speed) / speed
    expected = integrate(lambda z, v: v - speed * z / g(speed), z0, slip, time)
    found = np.asarray(Bristles().settle(z0, slip, time, C))
    assert np.allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(z0).max())
    # and in two goes as in one
    half = Bristles().settle(z0, slip, 0.5 * time, C)
    assert np.allclose(Bristles().settle(half, slip, 0.5 * time, C), found, rtol=1e-12, atol=1e-20)


def test_lugre_rate_and_traction():
    _, rate, traction = lugre_numpy(C)
    z, v = np.meshgrid(np.linspace(-1e-6, 1e-6, 5), [-2.0, -0.1, -1e-4, 1e-4, 0.1, 2.0])
    line = [x[..., None] * np.array([0.0, 1.0, 0.0]) for x in (z, v)]
    assert np.allclose(Bristles().rate(*line, C)[..., 1], rate(z, v), rtol=1e-12, atol=1e-14)
    assert np.allclose(Bristles().traction(*line, C)[..., 1], traction(z, v), rtol=1e-12, atol=1e-12)
    assert not np.any(Bristles().traction(*line, C)[..., [0, 2]])


def test_lugre_is_a_spring_before_it_slides():
    """Under a small slow displacement x the traction is sigma0 x, along x, and springs back to nothing."""
    law, x = Bristles(), 1e-9 * np.array([0.6, 0.8])  # break-away is at 1.2e-6 m
    z = law.settle(np.zeros(2), x / 0.1, 0.1, C)
    assert np.allclose(law.traction(z, np.zeros(2), C), 1e5 * x, rtol=1e-3, atol=0.0)
    back = law.settle(z, -x / 0.1, 0.1, C)
    assert np.linalg.norm(back) < 2e-3 * np.linalg.norm(x)
    # At rest the bristle holds; over 3 s it relaxes by the 1e-9 v_s/g of the rounded |v|.
    g = lugre_numpy(C)[0](0.0)
    assert np.allclose(law.settle(z, np.zeros(2), 3.0, C), np.exp(-3.0 * 1e-10 / g) * z, rtol=1e-12, atol=0.0)


PLANE = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


@given(PLANE, PLANE, st.floats(-8.0, 1.0), st.floats(-9.0, -4.0), st.floats(0.0, 1.0))
def test_lugre_dissipates_within_its_limit(direction, bent, decade, bend, share):
    """Power put in less power stored, v.mu - sigma0 z.z', where sigma1 |v| <= 4 mu(v)."""
    slip, z = 10.0**decade * np.array(direction), 10.0**bend * np.array(bent)
    speed = np.linalg.norm(slip)
    steady = 0.03 + 0.09 * np.exp(-((speed / 0.1) ** 2))
    c = C | {"bristle_damping": share * 4.0 * steady / np.hypot(speed, 1e-10)}
    given_in = np.dot(slip, Bristles().traction(z, slip, c))
    stored = 1e5 * np.dot(z, Bristles().rate(z, slip, c))
    largest = np.linalg.norm(slip) * (1e5 * np.linalg.norm(z) + 0.48) + abs(stored)
    assert given_in - stored >= -1e-12 * largest


@functools.cache
def lugre_derivatives():
    """First and second derivatives of rate, traction and step in every argument."""
    law = Bristles()

    def total(z, slip, time, c):
        weights = jnp.arange(1.0, 3.0)
        vectors = (law.rate(z, slip, c), law.traction(z, slip, c), law.settle(z, slip, time, c))
        return sum(jnp.sum(weights * x) for x in vectors)

    everything = (0, 1, 2, 3)
    return jax.jit(lambda *x: (total(*x), jax.grad(total, everything)(*x), jax.hessian(total, everything)(*x)))


@pytest.mark.full
@given(st.tuples(COMPONENT, COMPONENT), st.sampled_from([0.0, 1e-300, 1e-6, 1.0]), st.floats(-1e-5, 1e-5))
@example((0.0, 0.0), 0.0, 0.0)
@example((0.0, 0.0), 1e-3, 1e-6)
@example((1e-300, 0.0), 1e-3, 1e-6)
@example((1e6, 0.0), 1e-3, 1e-6)
def test_lugre_derivatives_are_finite(slip, time, bent):
    found = lugre_derivatives()(jnp.array([bent, -bent]), jnp.array(slip), time, C)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(found))


def test_lugre_takes_a_batch():
    z, slip = np.full((4, 3), 1e-7), np.arange(12.0).reshape(4, 3) - 5.0
    time, speeds = np.linspace(0.0, 1e-6, 4), np.array([0.05, 0.1, 0.2, 0.4])
    batch = {name: np.full(4, value) for name, value in C.items()} | {"friction_speed": speeds}
    for row in range(4):
        c = C | {"friction_speed": speeds[row]}
        pairs = (
            (Bristles().rate(z, slip, batch), Bristles().rate(z[row], slip[row], c)),
            (Bristles().traction(z, slip, batch), Bristles().traction(z[row], slip[row], c)),
            (Bristles().settle(z, slip, time, batch), Bristles().settle(z[row], slip[row], time[row], c)),
        )
        assert all(np.allclose(many[row], one, rtol=1e-13, atol=0.0) for many, one in pairs)


@pytest.mark.slow
def test_a_bristle_has_its_derivative_through_a_touch():
    """It begins to bend in the last micrometre of the gap, where an explicit step ends: at every accuracy it is right."""
    start = {"y": "height", "vx": 0.5, "vy": -0.5, "speed": 10.0}
    body = bj.Body("b", "planar", mass=0.02, inertia=2.5e-6, start=start)
    contact = bj.Contact(
        "contact", ("ground", "b"), bj.gaps.SphereOnPlane("y"), friction="lugre", smoothing=False,
        values={"radius": 0.01},
    )  # fmt: skip
    given = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1, "friction_static": 0.15, "friction_dynamic": 0.1}
    given |= {"friction_speed": 0.05, "bristle_stiffness": 1e5, "bristle_damping": 10.0}
    own = [(bj.Quantity("height", "m", "height", 0.0), 0.0105)]
    scene = bj.Mechanism(
        "disc", [body], [contact], [bj.loads.Gravity("-y")], own=own, given=given, end=2e-3, implicit=False
    )
    params, times = scene.parameters(), jnp.array([0.0, 2e-3])

    @jax.jit
    def leaving(height, friction, accuracy):
        moved = {**params, "height": height, "friction_dynamic": friction}
        return bj.reading_history(scene, moved, times, ["b.velocity.x"], accuracy=accuracy)["b.velocity.x"][-1]

    at = 0.0105, 0.1
    for k, value in enumerate(at):
        step = 1e-4 * value * np.eye(2)[k]
        right = (leaving(*(at + step), 1e-9) - leaving(*(at - step), 1e-9)) / (2 * step[k])
        along = jax.jvp(lambda *x: leaving(*x, 1e-2), at, tuple(np.eye(2)[k]))[1]
        assert float(along) == pytest.approx(float(right), rel=1e-5)
