"""Friction laws against their published formulas, mpmath and SciPy; their derivatives at rest; what they dissipate."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from oracles import within
from scipy.integrate import solve_ivp

from bcfj_jax import laws
from bcfj_jax.errors import InputError
from bcfj_jax.laws.friction import FRICTION, LuGre, Step
from bcfj_jax.quantities import CATALOGUE
from bcfj_jax.units import quantity

# The coefficients of the joint's paper at the ADAMS default speed of 100 mm/s; bristles of a steel contact.
C = {
    "friction_static": 0.12, "friction_dynamic": 0.03, "friction_speed": 0.1,
    "bristle_stiffness": 1e5, "bristle_damping": 30.0,
}  # fmt: skip
# Canudas de Wit et al. 1995, table I, under a normal force of 1 N and without the viscous part.
PUBLISHED = {
    "friction_static": 1.5, "friction_dynamic": 1.0, "friction_speed": 1e-3,
    "bristle_stiffness": 1e5, "bristle_damping": 1e5**0.5,
}  # fmt: skip
REGULAR = {name: law for name, law in FRICTION.items() if name != "lugre"}
SPEEDS = np.array([0.0, 1e-300, 1e-160, 1e-12, 1e-5, 1e-3, 0.03, 0.09, 0.1, 0.11, 0.5, 0.99, 1.0, 1.01, 30.0, 1e6])


# --- memory-free laws against their formulas


def test_coulomb():
    found = FRICTION["coulomb"].coefficient(SPEEDS, C)
    assert np.allclose(found, 0.03 * SPEEDS / np.hypot(SPEEDS, 0.1), rtol=1e-14, atol=0.0)


def cubic(x, x0, h0, x1, h1):
    """The STEP function as ADAMS defines it."""
    s = np.clip((x - x0) / (x1 - x0), 0.0, 1.0)
    return h0 + (h1 - h0) * s * s * (3.0 - 2.0 * s)


@pytest.mark.parametrize("ratio", [1.5, 10.0])
def test_step_is_the_step_of_the_sheet(ratio):
    slow, fast = 0.1, ratio * 0.1
    joints = np.array([slow, fast])
    v = np.sort(
        np.concatenate(
            [SPEEDS, np.linspace(0.0, 2.0 * fast, 401), joints, *(joints * (1.0 + s * 1e-9) for s in (-1, 1))]
        )
    )
    v = np.concatenate([-v[::-1], v])
    outer = np.sign(v) * np.where(np.abs(v) < fast, cubic(np.abs(v), slow, 0.12, fast, 0.03), 0.03)
    expected = np.where(np.abs(v) < slow, cubic(v, -slow, -0.12, slow, 0.12), outer)
    found = Step(ratio=ratio).coefficient(v, C)
    assert np.allclose(found, expected, rtol=1e-13, atol=1e-16)


def test_step_at_its_defaults():
    """By hand: half the static speed, the static speed, half-way to the dynamic speed, the dynamic speed, beyond."""
    found = FRICTION["step"].coefficient(np.array([0.05, 0.1, 0.55, 1.0, 7.0]), C)
    assert np.allclose(found, [0.0825, 0.12, 0.075, 0.03, 0.03], rtol=1e-14)


@pytest.mark.parametrize("joint", [0.1, 1.0])
def test_step_has_no_kink(joint):
    slope = jax.vmap(jax.grad(lambda v: FRICTION["step"].coefficient(v, C)))
    sides = joint * (1.0 + np.array([-1e-7, 0.0, 1e-7]))
    assert np.allclose(slope(sides), 0.0, atol=1e-6)  # against 1.8 at rest


@pytest.mark.parametrize("ratio", [1.0, -2.0, float("nan")])
def test_step_needs_its_speeds_in_order(ratio):
    with pytest.raises(InputError, match="ratio of dynamic to static speed"):
        Step(ratio=ratio)


def brown_mcphee(speed):
    """The formula of the paper as it stands, in mpmath."""
    r = speed / mpmath.mpf(C["friction_speed"])
    static, dynamic = mpmath.mpf(C["friction_static"]), mpmath.mpf(C["friction_dynamic"])
    return dynamic * mpmath.tanh(4 * r) + (static - dynamic) * r / (r * r / 4 + mpmath.mpf(3) / 4) ** 2


def test_brown_mcphee():
    law = FRICTION["brown_mcphee"]
    with mpmath.workdps(60):
        expected = [float(brown_mcphee(mpmath.mpf(float(v)))) for v in SPEEDS]
    assert np.allclose(law.coefficient(SPEEDS, C), expected, rtol=4e-15, atol=0.0)
    at_one = 0.03 * np.tanh(4.0) + 0.09
    assert law.coefficient(0.1, C) == within(at_one, 1e-15)
    grid = np.linspace(0.0, 1.0, 20001)
    peak = np.asarray(law.coefficient(grid, C))
    assert grid[peak.argmax()] == pytest.approx(0.1, rel=0.01) and peak.max() == pytest.approx(0.12, rel=1e-3)


def test_brown_mcphee_derivatives_in_the_square():
    """Value and two derivatives of the mobility in v.v, on both sides of its guard (4 v/v_t = sqrt 0.1)."""
    law, joint = FRICTION["brown_mcphee"], 0.025 * 0.1**0.5
    for speed in (1e-6, 1e-4, 3e-3, joint * (1 - 1e-9), joint * (1 + 1e-9), 0.01, 0.1, 3.0):
        square = speed**2
        with mpmath.workdps(60):
            expected = [
                float(
                    mpmath.diff(
                        lambda s: brown_mcphee(mpmath.sqrt(s)) / mpmath.sqrt(s),
                        mpmath.mpf(square),
                        n,
                        h=square * mpmath.mpf("1e-15"),
                    )
                )
                for n in range(3)
            ]
        first = jax.grad(law.mobility)
        found = [law.mobility(square, C), first(square, C), jax.grad(first)(square, C)]
        assert np.allclose(found, expected, rtol=1e-11, atol=0.0), speed


# --- every law, memory-free


@functools.cache
def derivatives(name):
    """Value, slope and curvature of mu(v), in v forward and reverse, and of the mobility in v.v."""
    law = FRICTION[name]

    def force(slip, c):
        return -law.mobility(jnp.sum(slip * slip), c) * slip

    def all_of(slip, c):
        power = functools.partial(lambda slip, c: jnp.sum(slip * force(slip, c)), c=c)
        square = jnp.sum(slip * slip)
        return (
            force(slip, c), jax.jacfwd(force)(slip, c), jax.jacrev(force)(slip, c), jax.hessian(power)(slip),
            jax.jacrev(force, argnums=1)(slip, c), jax.jacrev(jax.grad(power))(slip),
            jax.grad(law.mobility)(square, c), jax.grad(jax.grad(law.mobility))(square, c),
        )  # fmt: skip

    return jax.jit(all_of)


COMPONENT = st.floats(-1e6, 1e6, allow_subnormal=True) | st.sampled_from([0.0, 1e-300, -1e-300, 1e6, 1e-8, 0.1, 1.0])


@given(
    st.tuples(COMPONENT, COMPONENT, COMPONENT),
    st.floats(0.01, 2.0),
    st.floats(0.0, 1.0),
    st.floats(1e-5, 1.0),
)
@example((0.0, 0.0, 0.0), 0.12, 0.25, 0.1)
@example((1e-300, 0.0, 0.0), 0.12, 0.25, 0.1)
@example((1e6, 1e6, -1e6), 0.12, 0.0, 1e-5)
@example((0.1, 0.0, 0.0), 0.12, 0.25, 0.1)
@example((0.0, 1.0, 0.0), 0.12, 0.25, 0.1)
@pytest.mark.parametrize("name", FRICTION)
def test_dissipates_and_has_finite_derivatives(name, slip, static, share, speed):
    slip = np.array(slip)
    c = C | {"friction_static": static, "friction_dynamic": share * static, "friction_speed": speed}
    force, forward, reverse, *rest = derivatives(name)(slip, c)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves((force, forward, reverse, rest)))
    assert np.dot(force, slip) <= 0.0
    assert np.allclose(np.cross(force, slip), 0.0, atol=1e-12 * np.linalg.norm(force) * np.linalg.norm(slip) + 1e-300)
    assert np.linalg.norm(force) <= static * (1.0 + 2e-2)  # Brown-McPhee's peak passes mu_s a little
    scale = static / speed
    assert np.allclose(forward, reverse, rtol=1e-9, atol=1e-12 * scale)


@pytest.mark.parametrize("name", FRICTION)
def test_even_mobility_odd_coefficient(name):
    law = FRICTION[name]
    found = law.coefficient(SPEEDS, C)
    assert found.shape == SPEEDS.shape and not law.coefficient(0.0, C)
    assert np.array_equal(law.coefficient(-SPEEDS, C), -found)
    assert law.coefficient(1e6, C) == within(0.03, 1e-9)
    slope = jax.grad(lambda v: law.mobility(v * v, C))
    assert slope(0.0) == 0.0
    assert np.all(np.isfinite(law.coefficient(SPEEDS, {key: C[key] for key in law.needs})))


@pytest.mark.parametrize("name", FRICTION)
def test_slope_of_the_mobility_is_its_difference_quotient(name):
    """Smoothness: no jump of the mobility, nor of its derivative in v.v, over eight decades of speed."""
    law = FRICTION[name]
    slope = jax.jit(jax.vmap(jax.grad(law.mobility), in_axes=(0, None)))
    square = np.geomspace(1e-6, 1e2, 4001) ** 2
    value = np.asarray(law.mobility(square, C))
    middle = 0.5 * (square[1:] + square[:-1])
    quotient = np.diff(value) / np.diff(square)
    assert np.allclose(quotient, slope(middle, C), rtol=1e-3, atol=1e-3 * np.abs(quotient * middle).max() / middle)


# --- LuGre


def lugre_numpy(c):
    """z', g and traction along a line, in NumPy, with the true |v|."""
    static, dynamic, speed, stiffness, damping = c.values()

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
    law = LuGre()
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
    found = np.asarray(LuGre().settle(z0, slip, time, C))
    assert np.allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(z0).max())
    # and in two goes as in one
    half = LuGre().settle(z0, slip, 0.5 * time, C)
    assert np.allclose(LuGre().settle(half, slip, 0.5 * time, C), found, rtol=1e-12, atol=1e-20)


def test_lugre_rate_and_traction():
    _, rate, traction = lugre_numpy(C)
    z, v = np.meshgrid(np.linspace(-1e-6, 1e-6, 5), [-2.0, -0.1, -1e-4, 1e-4, 0.1, 2.0])
    line = [x[..., None] * np.array([0.0, 1.0, 0.0]) for x in (z, v)]
    assert np.allclose(LuGre().rate(*line, C)[..., 1], rate(z, v), rtol=1e-12, atol=1e-14)
    assert np.allclose(LuGre().traction(*line, C)[..., 1], traction(z, v), rtol=1e-12, atol=1e-12)
    assert not np.any(LuGre().traction(*line, C)[..., [0, 2]])


def test_lugre_is_a_spring_before_it_slides():
    """Under a small slow displacement x the traction is sigma0 x, along x, and springs back to nothing."""
    law, x = LuGre(), 1e-9 * np.array([0.6, 0.8])  # break-away is at 1.2e-6 m
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
    given_in = np.dot(slip, LuGre().traction(z, slip, c))
    stored = 1e5 * np.dot(z, LuGre().rate(z, slip, c))
    largest = np.linalg.norm(slip) * (1e5 * np.linalg.norm(z) + 0.48) + abs(stored)
    assert given_in - stored >= -1e-12 * largest


@functools.cache
def lugre_derivatives():
    """First and second derivatives of rate, traction and step in every argument."""
    law = LuGre()

    def total(z, slip, time, c):
        weights = jnp.arange(1.0, 3.0)
        vectors = (law.rate(z, slip, c), law.traction(z, slip, c), law.settle(z, slip, time, c))
        return sum(jnp.sum(weights * x) for x in vectors)

    everything = (0, 1, 2, 3)
    return jax.jit(lambda *x: (total(*x), jax.grad(total, everything)(*x), jax.hessian(total, everything)(*x)))


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
            (LuGre().rate(z, slip, batch), LuGre().rate(z[row], slip[row], c)),
            (LuGre().traction(z, slip, batch), LuGre().traction(z[row], slip[row], c)),
            (LuGre().settle(z, slip, time, batch), LuGre().settle(z[row], slip[row], time[row], c)),
        )
        assert all(np.allclose(many[row], one, rtol=1e-13, atol=0.0) for many, one in pairs)


# --- names


def test_laws_by_name():
    assert laws.make_friction(False) is None
    assert laws.make_friction(True) is laws.make_friction("brown_mcphee") is laws.FRICTION["brown_mcphee"]
    for name, law in laws.FRICTION.items():
        assert laws.make_friction(name) is law and isinstance(law, laws.AbstractFriction)
        assert law.bristles == (name == "lugre")
        assert set(law.needs) <= set(CATALOGUE)
        assert all(CATALOGUE[coefficient].valid(C[coefficient]) for coefficient in law.needs)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("brown-mcphee", "friction: no friction law 'brown-mcphee'; did you mean 'brown_mcphee'"),
        ("lugr", "did you mean 'lugre'"),
        ("qq", "known here: brown_mcphee, coulomb, lugre, step"),
    ],
)
def test_unknown_names_are_answered_with_the_nearest(name, told):
    with pytest.raises(InputError, match=told):
        laws.make_friction(name)


def test_coefficients_have_ranges_and_units():
    static = CATALOGUE["friction_static"]
    assert [static.valid(x) for x in (0.0, 1e-9, 2.0, 2.1)] == [False, True, True, False]
    assert CATALOGUE["friction_dynamic"].valid(0.0) and not CATALOGUE["friction_dynamic"].valid(-0.1)
    assert not CATALOGUE["friction_speed"].valid(0.0) and not CATALOGUE["bristle_stiffness"].valid(0.0)
    assert CATALOGUE["bristle_damping"].valid(0.0)
    given_as = {"friction_speed": "100 mm/s", "bristle_stiffness": "100 1/mm", "bristle_damping": "30 s/m"}
    for name, text in given_as.items():
        assert quantity(text, CATALOGUE[name].unit, "here") == within(C[name], 1e-12), name
