"""The contact regularisation: the ramp itself, and what it leaves unchanged in an impact."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from oracles import impact, within

from bcfj_jax import laws
from bcfj_jax.contact.normal import regularised_force
from bcfj_jax.contact.restitution import (
    damped_penetration,
    delivered_restitution,
    undamped_duration,
    undamped_peak,
    undamped_penetration,
)
from bcfj_jax.core.numerics import smooth_ramp


def ramp_and_derivatives(x):
    """r and its slope by (d, w), with their gradients and Hessians."""

    def both(y):
        return jnp.stack(smooth_ramp(y[0], y[1]))

    return both(x), jax.jacrev(both)(x), jax.jacfwd(jax.jacrev(both))(x)


ramp_derivatives = jax.jit(jax.vmap(ramp_and_derivatives))


def by_distance(distance, width):
    """r, slope, dr/dd and d2r/dd2 on an array of three distances."""
    value, gradient, hessian = ramp_derivatives(jnp.stack([distance, jnp.full_like(distance, width)], axis=1))
    return (np.asarray(v) for v in (value[:, 0], value[:, 1], gradient[:, 0, 0], hessian[:, 0, 0, 0]))


@pytest.mark.parametrize("width", [1e-9, 2e-5, 0.3])
def test_smooth_ramp_joins_its_neighbours(width):
    for seam, value, slope in ((-width, 0.0, 0.0), (width, width, 1.0)):
        ramp, rise, autodiff, bend = by_distance(seam + width * np.array([-1e-9, 0.0, 1e-9]), width)
        assert np.allclose(ramp, value, rtol=2e-9, atol=1e-24 * width)
        assert np.allclose(rise, slope, atol=1e-15) and np.allclose(autodiff, slope, atol=1e-15)
        assert np.allclose(width * bend, 0.0, atol=2e-9)  # 15 s^2 (1 - s)^2 / w, which is 0 at both seams
    ramp, rise, autodiff, bend = by_distance(width * np.array([-0.7, 0.0, 0.4]), width)
    s = np.array([0.15, 0.5, 0.7])
    assert np.allclose(ramp, 2.0 * width * (2.5 * s**4 - 3.0 * s**5 + s**6), rtol=1e-13)
    assert np.allclose(rise, s**3 * (10.0 - 15.0 * s + 6.0 * s**2), rtol=1e-13) and np.allclose(
        autodiff, rise, rtol=1e-13
    )
    assert np.allclose(bend, 15.0 * s**2 * (1.0 - s) ** 2 / width, rtol=1e-12)
    far = width * np.array([1.0, 1.5, 100.0])
    assert not np.any(smooth_ramp(-far, width)) and np.all(smooth_ramp(far, width)[0] == far)


# XLA's programs for a CPU take subnormal numbers, below 2.2e-308 in magnitude, as 0.
@given(st.floats(-1e-2, 1e-2, allow_subnormal=False), st.just(0.0) | st.floats(1e-12, 1e-2))
@example(0.0, 0.0)
@example(1e-5, 1e-5)
@example(-1e-5, 1e-5)
def test_smooth_ramp_is_finite_and_sharp_without_width(distance, width):
    value, *others = ramp_derivatives(jnp.array([[distance, width]] * 3))
    assert all(np.all(np.isfinite(x)) for x in (value, *others))
    if width == 0.0:
        assert (value[0, 0], value[0, 1]) == (max(distance, 0.0), float(distance > 0.0))


@pytest.mark.full
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("chi", [0.0, 0.634828])
def test_smoothing_changes_neither_peak_nor_restitution(exponent, share, chi):
    """The bound that ``regularised_force`` states, for a regularisation of width w = share * d0: no effect at all.

    The elastic part keeps its potential, now along r(d), and (1 + a d') separates in the first integral; so the
    impulse m v0 (1 + e) is unchanged too. The duration grows by 2 w / v0, to first order.
    """
    mass, speed = 0.4, 1.5
    params = {"stiffness": 3e10, "exponent": exponent, "damping": chi / speed}
    numbers = (params["stiffness"], exponent, mass, speed)
    depth = float(damped_penetration(chi, *numbers) if chi else undamped_penetration(*numbers))
    width = share * depth
    law = laws.make("memory_free")

    run = impact(jax.jit(lambda d, rate: regularised_force(law, d, rate, params, width)), mass, speed, onset=width)
    assert run.restitution == pytest.approx(float(delivered_restitution(chi)), abs=1e-8)
    assert run.penetration == within(depth, 1e-8)
    if not chi:  # a damped peak comes before the deepest point, and may lie inside the blend
        assert run.peak == within(float(undamped_peak(*numbers)), 1e-8)
        assert run.duration - float(undamped_duration(*numbers)) == within(2.0 * width / speed, 0.6 * share)
