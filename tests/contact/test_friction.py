"""Friction laws against their published formulas, mpmath and SciPy; their derivatives at rest; what they dissipate."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from frictions import COMPONENT, C
from hypothesis import example, given
from hypothesis import strategies as st
from oracles import within

from bcfj_jax import laws
from bcfj_jax.contact.friction import FRICTION, Step
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import CATALOGUE
from bcfj_jax.io.units import quantity

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


@pytest.mark.full
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


@pytest.mark.full
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
    # A norm squares, and forces go down to 1e-200.
    assert np.allclose(np.cross(force, slip), 0.0, atol=1e-12 * np.abs(force).max() * np.abs(slip).max() + 1e-300)
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


# --- memory


def test_memory_settles_on_its_steady_curve_and_lags_by_tau():
    """At constant slip w approaches |v| as exp(-t/tau), and mu the steady curve; by hand mu(v_t) and mu(9 v_t)."""
    law = FRICTION["memory"]
    for speed in (1e-4, 0.03, 0.1, 0.4, 3.0):
        edge = 0.01
        settled = np.hypot(speed, edge) - edge
        rate, mobility = law.lag(jnp.asarray(speed**2), jnp.asarray(settled), C)
        assert abs(float(rate)) < 1e-12 * speed / C["friction_memory"]
        assert float(mobility) == within(float(law.mobility(jnp.asarray(speed**2), C)), 1e-9)
        behind = law.lag(jnp.asarray(speed**2), jnp.asarray(settled + 1e-3), C)[0]
        assert float(behind) == pytest.approx(-1e-3 / C["friction_memory"], rel=1e-9)
    assert law.coefficient(0.1, C) == within((0.03 + 0.09 / (1.0 + 1.0 / 81.0)) * np.tanh(4.0), 1e-14)
    assert law.coefficient(0.9, C) == within(0.03 + 0.09 / 82.0, 1e-12)
    peak = np.asarray(law.coefficient(np.linspace(0.0, 1.0, 2001), C)).max()
    assert 0.98 * 0.12 < peak < 0.12


def test_memory_answers_a_sudden_slip_with_no_falling_coefficient():
    """The instant's slope d(mu |u|/|u|)/du >= 0 at every slip of late, where the steady curve falls."""
    law = FRICTION["memory"]
    u, w = np.meshgrid(np.linspace(0.0, 2.0, 401), np.linspace(0.0, 2.0, 41))
    drag = np.asarray(law.lag(u * u, w, C)[1]) * u
    assert np.all(np.diff(drag, axis=1) >= -1e-12) and np.all(drag <= 0.12 + 1e-12)
    assert np.any(np.diff(np.asarray(law.coefficient(u[0], C))) < -1e-4)


def test_frictional_lag_relaxes_within_tau_to_the_curve_of_memory_and_a_viscous_part():
    law, c = FRICTION["frictional_lag"], C | {"friction_viscous": 0.2}
    square = np.array([1e-4, 0.03, 0.1, 0.4, 3.0, 1e6]) ** 2
    steady = FRICTION["memory"].mobility(square, C) + 0.2
    assert np.allclose(law.mobility(square, c), steady, rtol=1e-13, atol=0.0)
    # By hand: from rest to 3 v_t, where half of the fall is due, it has 1 - 1/e of that half after tau.
    times = np.array([0.0, 1.0, 3.0]) * C["friction_memory"]
    fallen = 0.5 * (1.0 - np.exp(-times / C["friction_memory"]))
    rate, mobility = law.lag(np.full(3, 0.09), fallen, c)
    assert np.allclose(rate, 0.5 * np.exp(-times / C["friction_memory"]) / C["friction_memory"], rtol=1e-13, atol=0.0)
    assert np.allclose(0.3 * mobility, (0.12 - 0.09 * fallen) * np.tanh(12.0) + 0.06, rtol=1e-13, atol=0.0)
    # At once no faster slip meets less friction, however far the fall is.
    u, x = np.meshgrid(np.linspace(0.0, 2.0, 401), np.linspace(0.0, 1.0, 41))
    drag = np.asarray(law.lag(u * u, x, c)[1]) * u
    assert np.all(np.diff(drag, axis=1) >= 0.199 * 0.005)


# --- names


def test_laws_by_name():
    assert laws.make_friction(False) is None
    assert laws.make_friction(True) is laws.make_friction("brown_mcphee") is laws.FRICTION["brown_mcphee"]
    for name, law in laws.FRICTION.items():
        assert laws.make_friction(name) is law and isinstance(law, laws.AbstractFriction)
        assert law.bristles == (name == "lugre") and law.lags == (name in ("memory", "frictional_lag"))
        assert set(law.needs) <= set(CATALOGUE)
        assert all(CATALOGUE[coefficient].valid(C[coefficient]) for coefficient in law.needs)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("brown-mcphee", "friction: no friction law 'brown-mcphee'; did you mean 'brown_mcphee'"),
        ("lugr", "did you mean 'lugre'"),
        ("qq", "known here: brown_mcphee, coulomb, frictional_lag, lugre, memory, step"),
    ],
)
def test_unknown_names_are_answered_with_the_nearest(name, remedy):
    with pytest.raises(InputError, match=remedy):
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


def test_a_law_with_a_state_says_how_it_changes_and_its_size():
    class Late(type(FRICTION["brown_mcphee"])):
        lags = True

    with pytest.raises(InputError, match="class Late: it lacks lag and reach"):
        Late()
