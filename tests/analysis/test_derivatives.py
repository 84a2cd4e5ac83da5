"""Derivatives of force histories: forward = reverse = differences, and finite where it hurts.

A reverse program takes ten seconds to compile, so each is compiled once for many tests.
"""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracles import close

from bcfj_jax import force_history, scenes
from bcfj_jax.contact.restitution import undamped_duration

ACCURACY = 1e-9
NAMES = ("stiffness", "exponent", "damping", "mass", "approach_speed", "clearance_contact", "smoothing")
AT = dict(zip(NAMES, (1e10, 1.5, 0.1, 0.02, 1.5, 2e-6, 1e-6), strict=True))
IMPACT = scenes.impact("memory_free")
SOFT = {"stiffness": 1e4, "damping": 0.05, "drop_height": 0.1}  # contacts long beside a difference's step
BOUNCE = scenes.bounce("memory_free", smoothing=False)
BOUNCE_TIMES = (0.1457, 0.1500, 0.434, 0.438)


def impact_force(theta, mode="auto"):
    """Normal force at the times theta[7:] under the parameters theta[:7]."""
    values = IMPACT.parameters(dict(zip(NAMES, theta[:7], strict=True)))
    return force_history(IMPACT, values, theta[7:], accuracy=ACCURACY, mode=mode)["contact"][:, 0]


def bounce_force(theta):
    """Normal force within the first and the second bounce."""
    values = BOUNCE.parameters(dict(zip(SOFT, theta, strict=True)))
    return force_history(BOUNCE, values, jnp.array(BOUNCE_TIMES), accuracy=ACCURACY)["contact"][:, 0]


def point(times, **changes):
    """theta of ``impact_force``."""
    return jnp.array([*({**AT, **changes}.values()), *times])


def contact_time(**changes):
    """Undamped duration of a contact [s] at the given speed, or at 1.5 m/s where that is 0."""
    v = {**AT, **changes}
    return float(undamped_duration(v["stiffness"], v["exponent"], v["mass"], v["approach_speed"] or 1.5))


POINT = point(AT["clearance_contact"] / 1.5 + contact_time() * np.array([0.2, 0.45, 0.7]))


@pytest.fixture(scope="module")
def impact():
    """The compiled programs of one impact: value, Jacobians by direction, and gradients of a batch."""

    def loss(theta):
        return jnp.sum(jnp.square(impact_force(theta) / 1e3))

    return SimpleNamespace(
        force=jax.jit(impact_force),
        forward=jax.jit(jax.jacfwd(impact_force)),
        reverse=jax.jit(jax.jacrev(impact_force)),
        only_forward=jax.jit(jax.jacfwd(lambda x: impact_force(x, "forward"))),
        only_reverse=jax.jit(jax.jacrev(lambda x: impact_force(x, "reverse"))),
        batched_gradients=jax.jit(jax.vmap(jax.grad(loss))),
        gradient_of_batch=jax.jit(jax.grad(lambda x: jnp.sum(jax.vmap(loss)(x)))),
        gradient=jax.jit(jax.grad(loss)),
    )


def differences(function, theta, relative):
    """Fourth-order central differences, in relative changes: columns d f / d ln theta."""
    columns = []
    for k in range(theta.size):
        step = jnp.zeros(theta.size).at[k].set(relative * theta[k])
        near = function(theta + step) - function(theta - step)
        far = function(theta + 2 * step) - function(theta - 2 * step)
        columns.append((8 * near - far) / (12 * relative))
    return np.stack(columns, axis=1)


@pytest.mark.slow
def test_all_directions_agree(impact):
    # The same discrete solution differentiated twice: rounding over some 500 steps.
    expected = impact.only_forward(POINT) * POINT
    for way in (impact.forward, impact.reverse, impact.only_reverse):
        close(way(POINT) * POINT, expected, 1e-9)


@pytest.mark.slow
def test_impact_against_differences(impact):
    # Noise: a force error of 1e-9 over a step of 1e-3. Truncation: (1e-3)^4. Both are well below 1e-5.
    close(impact.only_forward(POINT) * POINT, differences(impact.force, POINT, 1e-3), 1e-5)


@pytest.mark.slow
def test_times_against_an_offset(impact):
    jacobian = impact.forward(POINT)
    by_time = np.diag(jacobian[:, 7:])
    assert not np.any(jacobian[:, 7:] - np.diag(by_time))  # a force depends on its own time alone
    start = jnp.zeros(POINT.size).at[7:].set(1.0)
    by_offset = jax.jit(jax.jacfwd(lambda offset: impact_force(POINT - offset * start)))(0.0)
    assert np.asarray(by_offset) == pytest.approx(-by_time, rel=1e-12)
    h = 1e-3 * contact_time()
    slope = (impact.force(POINT + h * start) - impact.force(POINT - h * start)) / (2 * h)
    # Second order: (pi h)^2 / 6 of the largest slope, 2e-6, and more near the onset where F''' is large.
    assert np.asarray(slope) == pytest.approx(by_time, abs=5e-5 * np.abs(by_time).max())


@pytest.fixture(scope="module")
def bounce():
    return SimpleNamespace(
        force=jax.jit(bounce_force),
        forward=jax.jit(jax.jacfwd(bounce_force)),
        reverse=jax.jit(jax.jacrev(bounce_force)),
    )


@pytest.mark.slow
def test_bounces(bounce):
    theta = jnp.array(list(SOFT.values()))
    assert np.all(bounce.force(theta) > 1.0)  # every time is inside a contact
    forward = bounce.forward(theta) * theta
    close(bounce.reverse(theta) * theta, forward, 1e-9)
    # A drop 3e-4 higher comes 1 % of a contact later at the second bounce: truncation 1e-8, noise 3e-6.
    expected = differences(bounce.force, theta, 3e-4)
    close(forward[:2], expected[:2], 1e-5)
    # Steps are not differentiated, and one that straddles a kink (the end of the first contact, the touch of
    # the second) has an error that depends on where. Against SciPy the derivatives are off by 3e-5 there.
    close(forward[2:], expected[2:], 1e-4)


CASES = {
    "touching at time 0": {"clearance_contact": 0.0},
    "sharp": {"smoothing": 0.0},
    "undamped, sharp": {"damping": 0.0, "clearance_contact": 0.0, "smoothing": 0.0},
    "at rest, smooth": {"approach_speed": 0.0, "clearance_contact": 0.0},
    "at rest, sharp": {"approach_speed": 0.0, "clearance_contact": 0.0, "smoothing": 0.0},
    "never in contact, smooth": {"clearance_contact": 1.0},
    "never in contact, sharp": {"clearance_contact": 1.0, "smoothing": 0.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_finite(impact, case, n):
    changes = {"stiffness": 1e10 * 1e-5 ** (1.5 - n), "exponent": n, **CASES[case]}
    # Time 0 and, undamped and sharp, the very instant of separation.
    theta = point([0.0, 0.5 * contact_time(**changes), contact_time(**changes)], **changes)
    forward, reverse = np.asarray(impact.only_forward(theta)), np.asarray(impact.only_reverse(theta))
    assert np.all(np.isfinite(impact.force(theta))) and np.all(np.isfinite(forward)) and np.all(np.isfinite(reverse))
    assert "never" not in case or not (np.any(forward) or np.any(reverse))


@pytest.mark.slow
def test_gradients_of_batches(impact):
    points = POINT * jnp.linspace(0.99, 1.01, 3)[:, None]
    one_by_one = np.stack([impact.gradient(each) for each in points]) * points
    # Other programs round otherwise and rounding may move a step: the accuracy asked for, with a margin.
    close(impact.batched_gradients(points) * points, one_by_one, 1e-7)
    close(impact.gradient_of_batch(points) * points, one_by_one, 1e-7)


CORNERS = {
    "stiffness": st.sampled_from([1e3, 1e10]),
    "exponent": st.sampled_from([1.0, 1.5, 3.0]) | st.floats(1.0, 3.0),
    "damping": st.sampled_from([0.0, 0.111, 10.0]),
    "speed": st.sampled_from([0.0, 1e-9, 1.5]),
    "clearance": st.sampled_from([0.0, 1e-9, 2e-6, 1.0]),
    "smoothing": st.sampled_from([0.0, 1e-9, 1e-6]),
}


@pytest.mark.slow
@given(**CORNERS)
@settings(max_examples=40)
@example(stiffness=1e10, exponent=1.0, damping=0.0, speed=0.0, clearance=0.0, smoothing=0.0)
def test_impact_is_finite_over_the_box(impact, stiffness, exponent, damping, speed, clearance, smoothing):
    # Times: the start, in contact, the very end; K d^n of 1e-5 m is the same for every exponent.
    stiffness = stiffness * 1e-5 ** (1.5 - exponent)
    changes = {"stiffness": stiffness, "exponent": exponent, "damping": damping, "approach_speed": speed}
    duration = contact_time(**changes)
    theta = point(duration * np.array([0.0, 0.5, 1.0]), **changes, clearance_contact=clearance, smoothing=smoothing)
    assert np.all(np.isfinite(impact.force(theta)))
    assert np.all(np.isfinite(impact.only_forward(theta)))


@pytest.fixture(scope="module")
def restituting():
    """Value and Jacobian of bounces whose damping is stated by restitution, over (K, n, m, e, height, smoothing)."""
    scene = scenes.bounce("flores")
    names = ("stiffness", "exponent", "mass", "restitution", "drop_height", "smoothing")

    def force(theta):
        values = scene.parameters(dict(zip(names, theta, strict=True)))
        return force_history(scene, values, jnp.linspace(0.0, 0.6, 13), mode="forward")["contact"][:, 0]

    return jax.jit(lambda theta: (force(theta), jax.jacfwd(force)(theta)))


@given(
    exponent=st.sampled_from([1.0, 1.5, 3.0]),
    restitution=st.sampled_from([0.0, 0.5, 1.0]),
    height=st.sampled_from([0.0, 1e-6, 1e-3, 0.1]),
    smoothing=st.sampled_from([0.0, 1e-6]),
)
# Found here: let go on the surface, nothing has an approach speed, and a restitution below 1 was rigid.
@example(exponent=1.5, restitution=0.0, height=0.0, smoothing=1e-6)
@settings(max_examples=20)
@pytest.mark.slow
def test_bounces_are_finite_over_the_box(restituting, exponent, restitution, height, smoothing):
    stiffness = 1e4 * 1e-2 ** (1.5 - exponent)
    value, jacobian = restituting(jnp.array([stiffness, exponent, 0.0167, restitution, height, smoothing]))
    assert np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian))
