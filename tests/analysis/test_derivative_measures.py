"""Features of histories and their derivatives in NumPy, against the same features differentiated by JAX."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names
from bcfj_jax.analysis.derivatives.measures import measure, sampling, vector
from bcfj_jax.analysis.derivatives.names import feature
from bcfj_jax.analysis.histories import correlations, shifts

CONTACTS = {"a": 0, "b": 2}
KINDS = (
    "peak",
    "largest",
    "mean",
    "impulse",
    "dissipated_work",
    "residual_oscillation",
    "contact_fraction",
    "ripple",
    "duration",
)
CYCLE = 0.31


def histories(t, changes):
    """Waves of three channels with flights, and smooth changes of them."""
    draw = np.random.default_rng(7)
    wave = np.stack(
        [np.cos(2 * np.pi * (t - s) / CYCLE) + 0.3 * np.cos(4 * np.pi * (t - s) / CYCLE) for s in (0, 0.04, 0.1)], 1
    )
    # No two crests are alike: which of them is the greatest is no tie.
    wave *= (1.0 + 0.02 * t[:, None]) * [1.0, 1.01, 1.03]
    depth = 1e-5 * (wave - 0.2)
    force = np.zeros((t.size, 3, 3))
    force[..., 0] = 1e3 * np.maximum(wave - 0.2, 0.0) ** 1.5
    phases = draw.uniform(0, 6, (changes, 1, 3))
    slope = np.zeros((changes, t.size, 3, 3))
    slope[..., 0] = 50.0 * np.sin(9.0 * t[None, :, None] + phases) * (depth > 0)
    moved = 1e-6 * np.cos(7.0 * t[None, :, None] + phases)
    return Histories(force, depth, np.gradient(depth, t, axis=0), None), Histories(slope, moved, 0.0 * moved, None)


@pytest.mark.parametrize(
    "even", [pytest.param(True, marks=pytest.mark.slow), pytest.param(False, marks=pytest.mark.slow)]
)
def test_the_same_as_jax(even):
    t = np.linspace(0.0, 2.0, 1201) ** (1.0 if even else 1.1)
    value, derivative = histories(t, 3)
    names = [f"{c}.{kind}" for c in ("a", "b", "b_2") for kind in KINDS] + ["a:b_1.delay", "b_1:b_2.delay"]
    wanted = [feature(name, CONTACTS) for name in names]
    numbers, slopes = measure(t, value, derivative, wanted, CONTACTS, turning=True)
    periods = [
        measure(t, value, derivative, [feature(f"{c}.period", CONTACTS)], CONTACTS, True)[0][0]
        for c in ("a", "b_1", "b_2")
    ]
    assert periods == pytest.approx([CYCLE] * 3, rel=1e-3)
    cycles = dict(zip(channel_names(CONTACTS), periods, strict=True))

    def function(force, depth):
        return vector(t, Histories(force, depth, None, None), wanted, CONTACTS, cycles)

    point = (jnp.asarray(value.force), jnp.asarray(value.penetration))
    push = jax.jit(lambda *tangents: jax.jvp(function, point, tangents))
    for k in range(3):
        expected, slope = push(jnp.asarray(derivative.force[k]), jnp.asarray(derivative.penetration[k]))
        assert numbers == pytest.approx(np.asarray(expected), rel=1e-8, abs=1e-12)
        assert slopes[:, k] == pytest.approx(np.asarray(slope), rel=1e-6, abs=1e-9)


@pytest.mark.full
def test_shifts_of_the_host_are_those_of_jax():
    t = np.linspace(0.0, 1.0, 401)
    a, b = np.sin(11.0 * t) + t, np.sin(11.0 * (t - 0.03))
    assert correlations(a, b, 60) == pytest.approx(
        np.asarray(correlations(jnp.asarray(a), jnp.asarray(b), 60)), abs=1e-12
    )
    host, traced = shifts(a, b, 60), shifts(jnp.asarray(a), jnp.asarray(b), 60)
    assert [float(x) for x in host] == pytest.approx([float(x) for x in traced], rel=1e-9)


def test_the_sampling_of_a_work_bounds_its_error():
    # d = sin(pi s), F = K d (1 + a d'), three contacts of s from 0 to 1: dW/da = 3 int K d d'^2 ds = 2 pi K.
    stiffness, loss = 1e3, 0.1
    for count in (3, 5, 8, 12, 30, 101):
        t = np.arange(0.0, 6.0, 1.0 / count) + 0.3 / count
        inside = (t % 2.0) < 1.0
        depth, rate = np.sin(np.pi * t), np.pi * np.cos(np.pi * t)
        slope = stiffness * depth * rate * inside
        force = stiffness * depth * inside + loss * slope
        full = np.zeros((t.size, 1, 3))
        value = Histories(full + force[:, None, None] * [1.0, 0.0, 0.0], depth[:, None], rate[:, None], None)
        moved = Histories((full + slope[:, None, None] * [1.0, 0.0, 0.0])[None], 0.0 * value.rate[None], None, None)
        moved = moved._replace(rate=moved.penetration)
        wanted = [feature("a.dissipated_work", {"a": 0}), feature("a.peak", {"a": 0})]
        found = measure(t, value, moved, wanted, {"a": 0}, False)[1][0, 0]
        at_most = sampling(t, value, moved, wanted, {"a": 0}, np.array([loss]))
        assert abs(found / (2.0 * np.pi * stiffness) - 1.0) < at_most[0, 0]
        # The derivative of the greatest force, at the fixed place of the summit.
        fine = np.linspace(0.0, 0.5, 200_001)
        wave, speed = np.sin(np.pi * fine), np.pi * np.cos(np.pi * fine)
        top = np.argmax(wave * (1.0 + loss * speed))
        peak = measure(t, value, moved, wanted, {"a": 0}, False)[1][1, 0]
        assert (
            abs(peak - stiffness * wave[top] * speed[top])
            <= at_most[1, 0] * max(abs(peak), stiffness * speed[top]) + 1e-3
        )
        assert np.isinf(at_most[0, 0]) == (count < 6)
    assert at_most[0, 0] < 0.01
