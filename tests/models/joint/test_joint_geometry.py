"""Geometry and statics of the joint, against NumPy, mpmath and the numbers of the physics sheet (5.2, 5.5)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import agrees, within

from bcfj_jax.models.joint import geometry

RP, E = 0.0355, 0.0045
RC = float(np.hypot(RP, E))
DEFLECTION = np.radians(23.0)
AROUND = np.linspace(-np.pi, np.pi, 721)

centre = jax.jit(geometry.ball_centre)


def numpy_axes(beta: float) -> tuple[np.ndarray, np.ndarray]:
    """Axis of the head and its azimuth-zero direction: the seat's, turned about y."""
    return np.array([np.sin(beta), 0.0, np.cos(beta)]), np.array([np.cos(beta), 0.0, -np.sin(beta)])


@given(
    phi=st.floats(-20.0, 20.0),
    beta=st.floats(-1.5, 1.5),
    ratio=st.floats(-0.9, 0.9),
    rc=st.floats(1e-3, 10.0),
)
def test_constant_velocity(phi, beta, ratio, rc):
    e = ratio * rc
    p = np.asarray(centre(phi, beta, rc, e))
    head, first = numpy_axes(beta)
    assert np.linalg.norm(p - e * np.array([0.0, 0.0, 1.0])) == within(rc, 1e-12)
    assert np.linalg.norm(p + e * head) == within(rc, 1e-12)
    assert abs(p @ np.asarray(geometry.bisector(beta))) <= 1e-12 * rc
    # The same azimuth about either axis, without a jump: compared as directions.
    for x in (p[0], p @ first):
        length = np.hypot(x, p[1])
        assert np.allclose((x / length, p[1] / length), (np.cos(phi), np.sin(phi)), atol=1e-12, rtol=0.0)


def test_ball_centre_is_where_the_two_track_circles_cross():
    # Either circle as a curve in its own plane, with no use of the bisecting plane.
    phi, beta = mpmath.mpf("0.7"), mpmath.mpf(float(DEFLECTION))
    e, rc = mpmath.mpf(E), mpmath.mpf(RC)

    def gap(seat, head):
        outer = [rc * mpmath.cos(seat) * mpmath.cos(phi), rc * mpmath.cos(seat) * mpmath.sin(phi)]
        outer.append(e + rc * mpmath.sin(seat))
        x, y, z = [rc * mpmath.cos(head) * f(phi) for f in (mpmath.cos, mpmath.sin)] + [rc * mpmath.sin(head) - e]
        inner = [x * mpmath.cos(beta) + z * mpmath.sin(beta), y, z * mpmath.cos(beta) - x * mpmath.sin(beta)]
        return outer, [a - b for a, b in zip(outer, inner, strict=True)]

    seat, head = mpmath.findroot(lambda s, h: gap(s, h)[1][:2], (-0.2, 0.2))
    outer, difference = gap(seat, head)
    assert max(abs(d) for d in difference) < 1e-14
    assert np.allclose(centre(0.7, DEFLECTION, RC, E), [float(x) for x in outer], rtol=1e-13, atol=0.0)


def test_shapes_and_axes():
    assert centre(AROUND, DEFLECTION, RC, E).shape == (721, 3)
    assert centre(AROUND[:, None], jnp.array([0.0, 0.2]), RC, E).shape == (721, 2, 3)
    assert geometry.bisector(0.3).shape == geometry.head_axis(0.3).shape == (3,)
    assert np.allclose(geometry.head_axis(0.3), (np.sin(0.3), 0.0, np.cos(0.3)), rtol=1e-15)
    assert np.allclose(geometry.bisector(0.6), geometry.head_axis(0.3), rtol=1e-15)
    assert geometry.track_radius(RP, E) == within(RC, 1e-15)


def test_derivatives_are_finite_and_right_where_formulas_degenerate():
    def everything(x):
        phi, beta, e = x
        parts = (
            geometry.ball_centre(phi, beta, RC, e).sum(),
            geometry.deflected_cage_load(1e4, phi, 0.7, beta, geometry.track_radius(RP, e), e),
        )
        return jnp.stack(parts)

    forward, backward = jax.jit(jax.jacfwd(everything)), jax.jit(jax.jacrev(everything))
    second = jax.jit(jax.hessian(everything))
    for phi in (0.0, np.pi / 2, 0.7, np.pi):
        for beta in (0.0, DEFLECTION):
            for e in (0.0, E):
                x = jnp.array([phi, beta, e])
                slopes = forward(x)
                assert np.all(np.isfinite(slopes)) and np.all(np.isfinite(second(x)))
                assert np.allclose(slopes, backward(x), rtol=1e-12, atol=1e-9)
                step = 1e-6
                for k in range(3):
                    up, down = (everything(x.at[k].add(s)) for s in (step, -step))
                    assert np.allclose(slopes[:, k], (up - down) / (2 * step), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_deflected_cage_load_balances_the_ball(direction):
    # Contact normals built from the ball's own position; the cage takes what the two tracks leave.
    alpha, normal = np.radians(40.0), 1e4
    head, first = numpy_axes(DEFLECTION)
    for phi in np.linspace(0.0, 6.0, 13):
        p = np.asarray(centre(phi, DEFLECTION, RC, E))
        across_seat = direction * np.array([-np.sin(phi), np.cos(phi), 0.0])
        across_head = direction * (-np.sin(phi) * first + np.cos(phi) * np.array([0.0, 1.0, 0.0]))
        n_seat = np.sin(alpha) * across_seat + np.cos(alpha) * (p - [0.0, 0.0, E]) / RC
        n_head = np.sin(alpha) * across_head + np.cos(alpha) * (p + E * head) / RC
        # The seat presses inwards and back, the head outwards and on.
        force = normal * (n_head - n_seat)
        load = float(geometry.deflected_cage_load(normal, direction * phi, alpha, DEFLECTION, RC, E))
        assert np.allclose(force, load * np.asarray(geometry.bisector(DEFLECTION)), rtol=1e-12, atol=1e-8)


def test_unevenness_of_ball_loads():
    assert agrees(geometry.kappa(np.pi / 4, DEFLECTION, RC, E), "1.62")
    # Concentric tracks: as documented.
    assert geometry.kappa(0.7, 0.3, RC, 0.0) == np.inf and np.isnan(geometry.kappa(0.7, 0.0, RC, 0.0))
