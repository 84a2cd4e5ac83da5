"""Lyapunov exponents against closed forms and published numbers."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest
from joints import plain_joint

from bcfj_jax import nonlinear, scenes
from bcfj_jax.analysis.nonlinear.exponents import from_growth
from bcfj_jax.core.errors import InputError


def henon(s):
    return jnp.stack([1.0 - 1.4 * s[0] ** 2 + s[1], 0.3 * s[0]])


def lorenz(t, y):
    return jnp.stack([10.0 * (y[1] - y[0]), y[0] * (28.0 - y[2]) - y[1], y[0] * y[1] - 8.0 / 3.0 * y[2]])


def test_logistic_map_has_the_logarithm_of_two():
    found = nonlinear.map_exponent(lambda x: 4.0 * x * (1.0 - x), 0.3, 50_000)
    assert found.value == pytest.approx(math.log(2.0), abs=1e-3)
    assert abs(found.value - math.log(2.0)) < 5 * found.standard_error < 5e-3
    assert found.history.shape == found.growth.shape == (50_000,)
    assert found.history[-1] == found.value


def test_logistic_map_on_a_cycle_has_the_cycles_multiplier():
    """r = 3.2: x+- = [r + 1 +- sqrt((r - 3)(r + 1))]/(2 r), multiplier 4 + 2 r - r^2 over two iterations."""
    r = 3.2
    found = nonlinear.map_exponent(lambda x: r * x * (1.0 - x), 0.3, 2000, transients=500)
    assert found.value == pytest.approx(0.5 * math.log(abs(4.0 + 2.0 * r - r * r)), rel=1e-9)


def test_superstable_orbit_has_no_tangent_left():
    assert nonlinear.map_exponent(lambda x: 2.0 * x * (1.0 - x), 0.5, 10, batches=0).value == -math.inf


@pytest.mark.parametrize("way", ["map_exponent", "two_trajectories"])
def test_henon_map(way):
    """0.41922: Sprott, Chaos and time-series analysis, 2003; Wolf et al., Physica D 16, 1985: 0.603 bits, 0.418."""
    found = getattr(nonlinear, way)(henon, jnp.array([0.1, 0.1]), 50_000, transients=100)
    assert found.value == pytest.approx(0.419, rel=0.02)


def test_state_of_a_map_may_be_a_tree():
    as_tree = nonlinear.map_exponent(
        lambda s: {"x": 1.0 - 1.4 * s["x"] ** 2 + s["y"], "y": 0.3 * s["x"]}, {"x": 0.1, "y": 0.1}, 500
    )
    as_array = nonlinear.map_exponent(henon, jnp.array([0.1, 0.1]), 500)
    assert as_tree.value == pytest.approx(as_array.value, rel=1e-9)


@pytest.mark.full
def test_lorenz_system():
    """0.9056: Sprott, Chaos and time-series analysis, 2003; Viswanath 1998 has 0.90566."""
    found = nonlinear.flow_exponent(lorenz, [1.0, 1.0, 20.0], 1500, interval=0.5, transients=40)
    assert found.value == pytest.approx(0.9056, rel=0.05)
    assert found.standard_error < 0.03
    assert found.history[-1] == found.value and found.interval == 0.5


@pytest.mark.parametrize(
    ("damping", "slowest"), [(0.3, -0.15), (5.0, -1.0), (0.0, 0.0)], ids=["swinging", "creeping", "undamped"]
)
def test_linear_oscillator_has_the_real_part_of_its_slowest_root(damping, slowest):
    """x'' + c x' + 4 x = 0: -c/2 where it swings, else [-c + sqrt(c^2 - 16)]/2; long after the orbit is at rest."""
    field = lambda t, y: jnp.stack([y[1], -4.0 * y[0] - damping * y[1]])  # noqa: E731
    found = nonlinear.flow_exponent(field, [1.0, 0.0], 400, interval=1.0, transients=20)
    # A tangent that swings is as long as its phase says: ln 2 over the 400 s.
    assert found.value == pytest.approx(slowest, abs=0.002)


def test_flow_that_cannot_be_solved_says_so():
    found = nonlinear.flow_exponent(lambda t, y: y**2, [1.0], 4, interval=0.5, batches=2, max_steps=500)
    assert math.isnan(found.value) and math.isnan(found.standard_error)
    assert found.reason


def test_standard_error_is_that_of_independent_batches():
    """White growths of unit variance: 1/sqrt(N), within what 20 batches can tell."""
    rng = np.random.default_rng(1)
    growth = rng.normal(size=200_000)
    found = from_growth(growth, 0.5, 20)
    assert found.standard_error == pytest.approx(2.0 / math.sqrt(200_000), rel=0.4)
    assert abs(found.value) < 4 * found.standard_error


@pytest.mark.slow
def test_body_at_rest_on_its_surface_has_its_dampings_exponent():
    """m z'' = m g - K d^n (1 + a d'), K d0^n = m g: linearised z'' + a g z' + w^2 z = 0, exponent -a g/2."""
    scene = scenes.bounce(smoothing=False)
    damping = 20.0
    params = scene.parameters(drop_height=0.0, damping=damping)
    found = nonlinear.scene_exponent(scene, params, 50, interval=0.02, settle=0.5)
    assert not found.reason
    assert found.value == pytest.approx(-0.5 * damping * 9.81, rel=5e-3)


def test_what_is_wrong_with_an_exponent_is_said():
    scene = scenes.bounce()
    with pytest.raises(InputError, match="no period of its own"):
        nonlinear.scene_exponent(scene, scene.parameters(), 10)
    with pytest.raises(InputError, match="must be > 0"):
        nonlinear.scene_exponent(scene, scene.parameters(), 10, interval=-1.0, settle=0.0)
    joint = plain_joint()
    with pytest.raises(InputError, match="settle"):
        nonlinear.scene_exponent(joint, joint.parameters(load_ramp=2.0), 10, settle=1.0)
    with pytest.raises(InputError, match="batches"):
        nonlinear.map_exponent(lambda x: x, 0.3, 10)
    with pytest.raises(InputError, match="iterations"):
        nonlinear.map_exponent(lambda x: x, 0.3, 0)
    with pytest.raises(InputError, match="separation"):
        nonlinear.two_trajectories(lambda x: x, 0.3, 30, separation=0.0)


@pytest.mark.slow
def test_run_out_of_steps_has_no_exponent():
    scene = scenes.bounce(smoothing=False)
    found = nonlinear.scene_exponent(scene, scene.parameters(), 4, interval=0.1, settle=0.3, max_steps=30, batches=2)
    assert math.isnan(found.value) and "30 steps" in found.reason


@pytest.mark.slow
def test_joint_forgets_its_start_with_the_default_smoothing_and_not_with_a_small_one():
    """docs/joint.md: the default run converges to ten digits; with 1 um a start shaken by 5e-15 m parts.

    -68.0 +- 0.1 is what two runs of another solver found (benchmarks/analysis/nonlinear.py).
    """
    scene = plain_joint()
    calm = nonlinear.scene_exponent(scene, scene.parameters(), 12, settle=1.2, batches=4)
    assert calm.value == pytest.approx(-68.0, rel=0.05)
    rattles = scene.parameters(smoothing=1e-6)
    rattling = nonlinear.scene_exponent(scene, rattles, 12, settle=1.2, batches=4, accuracy=1e-6)
    assert rattling.value > 15.0


def test_what_two_trajectories_have_in_common_is_not_distinguished():
    """A phase beside the logistic map is exactly neutral, and would hold the exponent at 0 or above on a cycle."""

    def step(s):
        return jnp.stack([3.2 * s[0] * (1.0 - s[0]), s[1] + 0.1])

    start, scales = jnp.array([0.3, 0.0]), np.array([1.0, 0.0])
    found = nonlinear.two_trajectories(step, start, 400, transients=500, scales=scales)
    assert found.value == pytest.approx(0.5 * math.log(abs(4.0 + 6.4 - 3.2**2)), rel=1e-3)
